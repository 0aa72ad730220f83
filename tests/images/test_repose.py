"""Re-posing against exact turns, exact shifts and an independent implementation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import affine_transform

from palpate.images import repose

both = pytest.mark.parametrize("interpolation", ["linear", "cubic"])


@both
@pytest.mark.parametrize("turns", [0, 1, 2, 3, 4])
def test_quarter_turns_are_exact(turns, interpolation, rng):
    images = rng.random((3, 7, 7))
    turned = repose(images, 90 * turns, interpolation=interpolation)
    # Clockwise as displayed: rot90 with k < 0.
    assert_array_equal(turned, np.rot90(images, -turns, axes=(1, 2)))


@both
def test_whole_shifts_move_pixels_and_bring_in_zeros(interpolation, rng):
    images = rng.random((2, 6, 8))
    moved = repose(images, 0, (2, -3), interpolation=interpolation)
    assert_array_equal(moved[:, 2:, :-3], images[:, :-2, 3:])
    assert not moved[:, :2].any()
    assert not moved[:, :, -3:].any()


def test_linear_agrees_with_scipy(rng):
    images = rng.random((4, 9, 12))
    angle, shift = np.deg2rad(37), np.array([1.2, -0.7])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    centre = np.array([4, 5.5])
    expected = [
        affine_transform(
            image, turn, centre - turn @ (centre + shift), order=1, mode="grid-constant"
        )
        for image in images
    ]
    assert_allclose(repose(images, 37, shift), expected, atol=1e-10)


def test_cubic_keeps_a_parabola():
    row, col = np.mgrid[:15, :15] - 7.0
    angle = np.deg2rad(25)
    turned = np.cos(angle) * col + np.sin(angle) * row
    moved = repose((col**2)[np.newaxis], 25, interpolation="cubic")
    inside = np.hypot(row, col) < 5
    # Keys' cubic reproduces polynomials up to the second degree.
    assert_allclose(moved[0][inside], turned[inside] ** 2, atol=1e-9)


def test_turns_before_it_shifts():
    image = np.zeros((1, 9, 9))
    image[0, 4, 7] = 1.0
    moved = repose(image, 90, (0, 1))
    assert_array_equal(np.argwhere(moved[0] > 0.5), [[7, 5]])


@both
def test_a_larger_canvas_keeps_the_total(interpolation, touches):
    moved = repose(
        touches, np.arange(12) * 29, shape=(20, 20), interpolation=interpolation
    )
    # Interpolation of smooth images preserves their sum closely, not exactly.
    assert_allclose(moved.sum(axis=(1, 2)), touches.sum(axis=(1, 2)), rtol=0.02)


def test_nearest_edges_leave_a_constant_image_alone():
    constant = np.full((2, 6, 9), 3.0)
    moved = repose(constant, 33, (5, 5), edges="nearest")
    assert_allclose(moved, 3.0)
    assert (repose(constant, 33, (5, 5)) == 0).any()


def test_each_touch_has_its_own_pose(rng, touches):
    angle, shift = rng.uniform(0, 360, 12), rng.uniform(-2, 2, (12, 2))
    gain = rng.uniform(0.8, 1.2, 12)
    together = repose(touches, angle, shift, gain)
    alone = [repose(touches[[i]], angle[i], shift[i], gain[i])[0] for i in range(12)]
    assert_array_equal(together, alone)


def test_many_large_images_are_worked_on_in_blocks(rng):
    images = rng.random((30, 120, 120))
    angle = rng.uniform(0, 360, 30)
    assert_array_equal(
        repose(images, angle)[[0, 17, 29]],
        repose(images[[0, 17, 29]], angle[[0, 17, 29]]),
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"angle_deg": [1, 2]}, "angle_deg must be a number or of shape"),
        ({"shift_px": 1.0}, r"shift_px must be of shape \(2,\)"),
        ({"gain": np.nan}, "gain must be finite"),
        ({"edges": "wrap"}, "edges must be one of"),
        ({"interpolation": "sinc"}, "interpolation must be one of"),
        ({"shape": (0, 4)}, "at least 1"),
    ],
)
def test_bad_arguments_are_refused(options, message, touches):
    with pytest.raises(ValueError, match=message):
        repose(touches, **options)


def test_dead_taxels_are_refused(touches):
    touches[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="Fill dead taxels"):
        repose(touches, 10)
