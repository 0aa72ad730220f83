"""Surfaces as radii of directions, and a filter of poses, on shapes that are known."""

import numpy as np
import pytest
from known_surfaces import standing_ellipse
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.exploration._place_filter import (
    Looseness,
    PlaceFilter,
    UnlearntSurfaces,
    out_of_frames,
)
from palpate.exploration._surface import (
    AZIMUTHS,
    HEIGHTS,
    SurfaceTable,
    directions,
    faces_of,
    learnt_surface,
    mesh_surface,
    met_along,
    turned_surfaces,
)
from palpate.simulation import DomeCamera, find_object

DOME = DomeCamera(image_shape=(32, 32), n_nodes=16)


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
    table = SurfaceTable([standing_ellipse(60, 40), standing_ellipse(30, 30)])
    points = directions()[8, ::6]
    states = np.array([[0], [1]])
    outside, variance = table.look_up(states, 50 * points)
    assert_allclose(outside[1], 20, atol=1e-6)
    # A step of 5 degrees with straight lines between: below 1 mm of an ellipse.
    assert_allclose(outside[0], 50 - table.mean_mm[0][8, ::6], atol=1)
    assert_allclose(variance, 1.25)


def test_lines_meet_an_ellipse_where_they_should():
    table = SurfaceTable([standing_ellipse(60, 40)])
    far, direction = np.array([[200.0, 10, 0]]), np.array([[-1.0, 0, 0]])
    radius, _ = met_along(table, np.zeros(1, int), far, direction)
    assert_allclose(radius, 60 * np.sqrt(1 - (10 / 40) ** 2), atol=0.5)


@pytest.mark.parametrize("aim_mm", [10.0, None])
def test_a_body_turned_is_met_where_its_mesh_on_that_side_is(aim_mm):
    """Lines aim at one height above the table, or at the box's middle."""
    box, upper = find_object("box"), HEIGHTS >= 0
    usual, *others = [mesh_surface(box, face, DOME, aim_mm) for face in range(3)]
    middles = (directions() * usual.mean_mm[..., None])[upper].reshape(-1, 3)
    body = aim_mm or 30.0, middles
    turned = turned_surfaces(body, aim_mm, DOME.membrane_radius_mm)
    # Top, nearest and farthest side of 160 x 110 x 60 mm on its three sides; on its
    # top it is as it was. A hull of points 5 degrees apart, and 5 mm for any press.
    expected = sorted(map(_extent, [usual, *others]))
    assert_allclose(sorted(map(_extent, turned)), expected, atol=6)


def _extent(surface):
    level = surface.mean_mm[HEIGHTS == 0]
    return surface.mean_mm[-1].mean(), level.min(), level.max()


def test_touches_that_span_no_body_tell_of_no_other_face():
    assert turned_surfaces((10.0, np.zeros((6, 3))), 10.0, 20.0) == []


# The filter, on surfaces that are known.


def _contacts(surface, pose, azimuths):
    """Points on a surface that stands in a pose."""
    radii = np.interp(azimuths, AZIMUTHS, surface.mean_mm[8], period=2 * np.pi)
    local = np.stack(
        [radii * np.cos(azimuths), radii * np.sin(azimuths), 0 * radii], axis=1
    )
    return out_of_frames(local, np.asarray(pose))


def _weighed(place_filter):
    shares = np.exp(place_filter.log_evidence - place_filter.log_evidence.max())
    return shares / shares.sum()


def test_the_filter_finds_the_turn_and_the_place_of_anstanding_ellipse():
    oval, pose = standing_ellipse(90, 50), (0.6, 5.0, -4.0, 0.0)
    place_filter = PlaceFilter.before(SurfaceTable([oval]), 36, Looseness())
    for point in _contacts(oval, pose, np.arange(12) * 2.4):
        place_filter = place_filter.met(point)
    best = place_filter.mean[_weighed(place_filter).argmax()]
    # An oval looks alike every half turn. Tables are straight lines of 5 degrees, and
    # each contact is believed to 1.8 mm.
    assert abs((best[0] - 0.6 + np.pi / 2) % np.pi - np.pi / 2) < np.deg2rad(4)
    assert_allclose(best[1:3], [5, -4], atol=1.5)


def test_contacts_tell_two_sizes_apart_as_their_densities_say():
    small, large = standing_ellipse(50, 50), standing_ellipse(60, 60)
    loose = Looseness(placement_mm=1e-3, height_mm=1e-3, sensor_mm=1e-3, shift_share=0)
    place_filter = PlaceFilter.before(SurfaceTable([small, large]), 4, loose)
    place_filter = place_filter.met(np.array([50.0, 0, 0]))
    # 10 mm off at a variance of 1.25 mm2, and what nothing explains: 0.03 over 150 mm.
    normal = 0.97 / np.sqrt(2 * np.pi * 1.25)
    expected = np.log(normal + 2e-4) - np.log(normal * np.exp(-100 / 2.5) + 2e-4)
    assert_allclose(
        place_filter.log_evidence[0] - place_filter.log_evidence[4], expected, atol=0.02
    )


def test_free_space_speaks_against_what_reaches_into_it():
    small, large = standing_ellipse(30, 30), standing_ellipse(80, 80)
    place_filter = PlaceFilter.before(SurfaceTable([small, large]), 4, Looseness())
    # Past the small one at 50 mm, through the large one.
    place_filter = place_filter.met_nothing(
        np.array([200.0, 50, 0]), np.array([-200.0, 50, 0])
    )
    assert place_filter.log_evidence[0] > -0.1
    assert place_filter.log_evidence[4] < -2


def test_an_object_that_shifts_is_followed():
    oval, azimuths = standing_ellipse(90, 50), np.arange(40) * 2.4
    place_filter = PlaceFilter.before(SurfaceTable([oval]), 36, Looseness())
    for number, azimuth in enumerate(azimuths):
        slid = 0.2 * number  # 8 mm in the end, a twentieth of its size
        point = _contacts(oval, (0.6, slid, 0, 0), np.array([azimuth]))[0]
        place_filter = place_filter.met(point)
    best = place_filter.mean[_weighed(place_filter).argmax()]
    assert_allclose(best[1:3], [8, 0], atol=2.5)


def test_a_first_contact_with_an_unlearnt_surface_has_the_density_of_the_process():
    loose = Looseness(placement_mm=4, height_mm=3, sensor_mm=2)
    before = UnlearntSurfaces.before(np.array([50.0, 90.0]), 10.0, loose)
    first = before.met(np.array([70.0, 0, 0]))
    # Terms of mean, turn-free part, roughness, placement along x, noise, and sensor.
    variances = np.array(
        [100 + 900 + r**2 + 16 + n**2 + 4 for r in (4, 10, 25) for n in (1, 2, 4)]
    )
    density = (np.exp(-200 / variances) / np.sqrt(2 * np.pi * variances)).mean()
    # A share of 0.03 over 150 mm is explained by nothing; both are 20 mm off.
    expected = np.log(0.97 * density + 2e-4)
    assert_allclose(first.log_evidence, [expected, expected], rtol=1e-9)
    again = first.met(np.array([70.0, 1, 0]))
    assert (again.log_evidence - first.log_evidence > first.log_evidence + 1).all()


@pytest.mark.parametrize(
    ("loose", "message"),
    [
        ({"placement_mm": 0.0}, "placement_mm must be positive and finite, got 0.0"),
        ({"height_mm": 0}, "height_mm must be positive"),
        ({"sensor_mm": -1.0}, "sensor_mm must be finite and between 0.0"),
        ({"shift_share": np.nan}, "shift_share must be finite"),
    ],
)
def test_what_is_no_looseness_is_refused(loose, message):
    with pytest.raises(ValueError, match=message):
        Looseness(**loose)
