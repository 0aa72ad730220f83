"""Surfaces as radii of directions, against shapes whose radii are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.exploration._surface import (
    AZIMUTHS,
    HEIGHTS,
    RadialSurface,
    SurfaceTable,
    directions,
    faces_of,
    learnt_surface,
    mesh_surface,
    met_along,
)
from palpate.simulation import DomeCamera, find_object

DOME = DomeCamera(image_shape=(32, 32), n_nodes=16)


def _ellipse(a, b):
    """Radii of a standing cylinder that is an ellipse seen from above."""
    along, across = np.cos(AZIMUTHS) / a, np.sin(AZIMUTHS) / b
    flat = 1 / np.hypot(along, across)
    radii = np.repeat(flat[None], len(HEIGHTS), axis=0)
    return RadialSurface(radii, np.full(radii.shape, 0.25), 1.0)


def _from_above(rng, count):
    outs = rng.standard_normal((count, 3))
    outs[:, 2] = np.abs(outs[:, 2])
    return outs / np.linalg.norm(outs, axis=1)[:, None]


@pytest.mark.parametrize(
    ("faces", "numbers"),
    [
        ({"face": ["top", "side", "top"]}, [1, 0, 1]),
        ({"face": [2, 0, 2]}, [2, 0, 2]),
        ({}, [0, 0, 0]),
    ],
)
def test_faces_are_numbers_or_names(faces, numbers):
    assert faces_of(Touches(np.ones((3, 2, 2)), **faces)).tolist() == numbers


def test_a_ball_that_was_touched_is_round_and_the_place_of_each_recording_is_not_it():
    rng = np.random.default_rng(0)
    outs, recording = _from_above(rng, 60), np.repeat([0, 1, 2], 20)
    aside = np.array([[6, 0, 0], [-6, 3, 0], [0, -3, 0]])[recording]
    surface = learnt_surface(50 * outs + aside, recording, 5.0)
    reached = np.deg2rad(10) < HEIGHTS
    # Aside by 6 mm moves radii by as much; the recordings' own terms take it up.
    assert_allclose(surface.mean_mm[reached], 50, atol=1.5)
    assert surface.symmetry() == len(AZIMUTHS)


def test_what_was_never_touched_is_not_known():
    rng = np.random.default_rng(1)
    outs = _from_above(rng, 200)
    one_side = outs[outs[:, 0] > 0.3]
    radii = 50 + 10 * one_side[:, 0]
    surface = learnt_surface(radii[:, None] * one_side, np.zeros(len(radii), int), 5.0)
    middle = len(HEIGHTS) // 2
    seen, unseen = surface.variance_mm2[middle, [0, len(AZIMUTHS) // 2]]
    # Where it was touched the place of the recording is left, 3 mm and more.
    assert unseen > 2 * seen


def test_a_pressed_box_is_as_far_as_its_sides():
    surface = mesh_surface(find_object("box"), 0, DOME)
    row = int(np.flatnonzero(HEIGHTS >= 0)[0])
    # 160 x 110 x 60 mm; the dome of 20 mm is pressed in by 3 to 12 mm.
    for azimuth, half in ((0, 80), (18, 55), (36, 80)):
        assert half + 8 < surface.mean_mm[row, azimuth] < half + 18
    assert 30 + 8 < surface.mean_mm[-1].mean() < 30 + 18
    assert surface.symmetry() == 2


@pytest.mark.parametrize(
    ("name", "order"), [("ball", 72), ("mug", 1), ("pen", 2), ("porridge pot", 72)]
)
def test_symmetry_is_that_of_the_thing(name, order):
    assert mesh_surface(find_object(name), 0, DOME).symmetry() == order


def test_a_table_is_looked_up_as_it_was_made():
    table = SurfaceTable([_ellipse(60, 40), _ellipse(30, 30)])
    points = directions()[8, ::6]
    states = np.array([[0], [1]])
    outside, variance = table.look_up(states, 50 * points)
    assert_allclose(outside[1], 20, atol=1e-6)
    # A step of 5 degrees with straight lines between: below 1 mm of an ellipse.
    assert_allclose(outside[0], 50 - table.mean_mm[0][8, ::6], atol=1)
    assert_allclose(variance, 1.25)


def test_lines_meet_an_ellipse_where_they_should():
    table, offset = SurfaceTable([_ellipse(60, 40)]), np.array([0.0, 10.0, 0.0])
    far, direction = np.array([[200.0, 10, 0]]), np.array([[-1.0, 0, 0]])
    radius, _ = met_along(table, np.zeros(1, int), far, direction)
    assert offset[1] == far[0, 1]
    assert_allclose(radius, 60 * np.sqrt(1 - (10 / 40) ** 2), atol=0.5)
