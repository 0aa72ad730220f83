"""Pins in a dome and a gel in three colours: what a press does to their pictures."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import label

from palpate import ObjectRecogniser
from palpate.simulation import (
    GelCamera,
    PlacedObject,
    SensorPose,
    TacTipPins,
    find_object,
    simulate_touches,
)

DOWN = SensorPose((0, 0, 50), (0, 0, -1))
PINS = TacTipPins()


@pytest.mark.parametrize(("n_rings", "n_pins"), [(1, 7), (3, 37), (6, 127)])
def test_pins_are_hexagonal(n_rings, n_pins):
    pins = TacTipPins(n_rings=n_rings)
    assert pins.n_pins == n_pins == len(pins.roots_mm)
    pitch = 0.85 * 20 / n_rings
    distances = np.linalg.norm(pins.roots_mm[:, None] - pins.roots_mm, axis=2)
    np.fill_diagonal(distances, np.inf)
    assert_allclose(distances.min(axis=1), pitch, rtol=1e-5)
    assert_allclose(np.linalg.norm(pins.roots_mm, axis=1).max(), 17, rtol=1e-5)


def test_tips_at_rest_lie_on_a_smaller_sphere():
    """Inward normals of a sphere meet at its centre, 42 mm before the lens."""
    away = np.linalg.norm(PINS.tips_mm() - (0, 0, 62 - 20), axis=1)
    assert_allclose(away, 20 - PINS.pin_length_mm, rtol=1e-5)


def test_every_pin_is_one_white_spot():
    picture = PINS.no_contact()
    assert picture.shape == (300, 300)
    assert label(picture > 128)[1] == 127
    pixels = PINS.pixels()
    rows, cols = np.round(pixels[:, :2]).astype(int).T
    assert (picture[rows, cols] == 255).all()
    area = np.pi * (pixels[:, 2] ** 2).sum()
    # Discs of 4 pixels across, smoothed at their edges.
    assert_allclose(picture.sum(dtype=float) / 255, area, rtol=0.2)


def test_camera_sees_tips_by_perspective():
    wide = replace(PINS, pin_length_mm=0.0)
    row, col, _ = wide.pixels()[np.argmax(wide.roots_mm[:, 0])]
    # Root at x = 17: depth 42 + sqrt(20^2 - 17^2); the rim, at 42, is at 0.68 heights.
    expected = 150 - 0.5 + 0.68 * 300 * (17 / 20) * 42 / (42 + np.sqrt(400 - 289))
    assert_allclose((row, col), (149.5, expected), rtol=1e-5)


def test_flat_press_spreads_the_middle_and_leaves_the_rest():
    press = PINS.press(find_object("flat"), DOWN)
    at_rest, pressed = PINS.tips_mm(), PINS.tips_mm(press)
    middle = np.linalg.norm(PINS.roots_mm, axis=1) < 6
    inner = np.linalg.norm(at_rest[middle, :2], axis=1)
    # On a flat floor pins stand straight: tips return above their roots.
    roots = np.linalg.norm(PINS.roots_mm[middle], axis=1)
    spread = np.linalg.norm(pressed[middle, :2], axis=1)
    assert_allclose(spread, roots, atol=0.15)
    assert (spread >= inner - 1e-3).all()
    assert (pressed[middle, 2] < at_rest[middle, 2]).all()
    far = np.linalg.norm(PINS.roots_mm, axis=1) > 16.5
    assert np.abs(pressed[far] - at_rest[far]).max() < 0.4


def test_dent_is_the_domes():
    press = PINS.press(find_object("edge"), DOWN)
    same = PINS.dome.press(find_object("edge"), DOWN)
    assert_array_equal(press.contact.displacement_mm, same.contact.displacement_mm)


def test_turning_the_object_by_a_sixth_turns_the_pins():
    still = PINS.tips_mm(PINS.press(find_object("point"), DOWN))
    angle = np.pi / 3
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = still[:, :2] @ turn.T
    nearest = np.linalg.norm(turned[:, None] - still[:, :2], axis=2).min(axis=1)
    # A cone pressed on the axis, sampled on square nodes.
    assert nearest.max() < 0.2


def test_nothing_touched_is_no_contact_and_noise_is_reproducible():
    nothing = find_object("nothing")
    assert_array_equal(PINS.touch(nothing, DOWN), PINS.no_contact())
    noisy = PINS.touch(nothing, DOWN, rng=np.random.default_rng(2))
    assert_array_equal(noisy, PINS.touch(nothing, DOWN, rng=np.random.default_rng(2)))
    assert (noisy != PINS.no_contact()).any()


def test_sets_of_pin_touches_keep_the_no_contact_frame():
    touches = simulate_touches(["box", "pen"], 3, PINS, random_state=0)
    assert touches.images.shape == (6, 300, 300)
    assert_array_equal(touches.whole["no_contact"], PINS.no_contact())


def test_drift_is_the_cameras():
    drifted = PINS.drifted(np.random.default_rng(0))
    dome = PINS.dome.drifted(np.random.default_rng(0))
    assert drifted == replace(PINS, dome=dome) != PINS


@pytest.fixture(scope="module")
def ball():
    """A picture without noise of a ball that is pressed from straight above."""
    gel = GelCamera()
    thing = find_object("ball")
    top = float(thing.mesh.vertices[:, 2].max())
    press = gel.press(PlacedObject(thing), SensorPose((0.0, 0.0, top + 5), (0, 0, -1)))
    return gel, press, gel.image(press).astype(float) - gel.no_contact()


def test_each_colour_is_brighter_where_the_dent_leans_towards_its_light(ball):
    gel, press, change = ball
    assert press.touched
    _, n_cols = gel.image_shape
    red = change[..., 0]
    # One side of a round dent leans towards the red light, and the other away.
    left, right = red[:, : n_cols // 2], red[:, n_cols // 2 :]
    assert left.mean() * right.mean() < 0
    # The three lights are 120 degrees apart: their changes, as shares, sum to about 0.
    share = change / gel.no_contact().astype(float)
    assert abs(share.sum(axis=2)).max() < 0.15 * abs(share).max()


def test_where_nothing_is_touched_nothing_changes(ball):
    gel, _, change = ball
    assert abs(change).max() > 20
    assert (gel.image() == gel.no_contact()).all()
    noisy = gel.image(rng=np.random.default_rng(0)).astype(float)
    assert (noisy - gel.no_contact()).std() == pytest.approx(gel.dome.noise_sd, rel=0.1)


@pytest.mark.slow
def test_touches_have_channels_and_are_recognised():
    names = ["ball", "pen", "box"]
    gel = GelCamera(image_shape=(48, 64))
    training = simulate_touches(names, 20, gel, n_sessions=4, random_state=0)
    new_touches = simulate_touches(names, 10, gel, n_sessions=2, random_state=1)
    assert training.images.shape == (60, 48, 64, 3)
    assert [*training.channels] == ["r", "g", "b"]
    recogniser = ObjectRecogniser().fit(training)
    best = recogniser.classes_[recogniser.log_likelihood(new_touches).argmax(axis=1)]
    assert np.mean(best == new_touches.object) > 0.5  # chance is a third


def test_another_mounting_looks_otherwise_and_the_same_seed_the_same():
    gel = GelCamera()
    first, again = (gel.remounted(np.random.default_rng(3)) for _ in range(2))
    assert first == again
    assert (first.no_contact() != gel.no_contact()).any()
    assert gel.drifted(np.random.default_rng(0)).dome.gain != gel.dome.gain


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (TacTipPins, {"n_rings": 0}, "n_rings must be at least 1"),
        (TacTipPins, {"spread": 1.0}, "spread must be finite and between 0.05 and 0.9"),
        (TacTipPins, {"pin_radius_mm": 0.0}, "pin_radius_mm must be positive"),
        (GelCamera, {"image_shape": (4, 160)}, "image_shape must be at least 8, got 4"),
        (GelCamera, {"width_mm": 0}, "width_mm must be positive"),
        (GelCamera, {"colours": (1, 0, 1)}, "colours must be positive"),
        (GelCamera, {"colours": (1.0, 1.0)}, r"colours must be 3 .*got \(1.0, 1.0\)"),
        (GelCamera, {"image_shape": (24, 32, 24)}, "image_shape must be a pair"),
        (GelCamera, {"image_shape": (4000, 4000)}, "at most 8000000 pixels"),
        (GelCamera, {"shift_mm": (np.nan, 0.0)}, "shift_mm must be finite"),
    ],
)
def test_what_is_no_sensor_is_refused(kind, options, message):
    with pytest.raises(ValueError, match=message):
        kind(**options)


def test_a_gel_takes_lists_and_arrays_as_a_dome_does():
    rest = GelCamera(image_shape=(24, 32), shift_mm=(0.5, 0.0)).no_contact()
    lists = GelCamera([24, 32], colours=[1.0, 1.0, 1.0], shift_mm=np.array([0.5, 0.0]))
    assert_array_equal(lists.no_contact(), rest)
