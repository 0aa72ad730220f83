"""Moments, orientation and derivative of drawn images; images turned and shifted."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import affine_transform

from palpate.images import DerivativeMagnitude, OrientationRegulariser, repose


def steepness(images):
    return DerivativeMagnitude("frame").fit_transform(images)


def drop(angle_deg, size=101, long=18.0, short=9.0, skew=0.25):
    """An elongated blob about the middle, its longer tail towards `angle_deg`."""
    axis = np.arange(size) - (size - 1) / 2
    x, y = np.meshgrid(axis, axis)
    a = np.deg2rad(angle_deg)
    along, across = x * np.cos(a) + y * np.sin(a), y * np.cos(a) - x * np.sin(a)
    width = long * np.exp(skew * np.sign(along))
    return np.exp(-(along**2) / (2 * width**2) - across**2 / (2 * short**2))


def turned(images, least=0.02):
    """Images turned so that their long axis lies along the columns."""
    return OrientationRegulariser(least).fit_transform(np.asarray(images))


@pytest.mark.parametrize(("gain", "rtol"), [(1, 1e-7), (0.01, 1e-5)])
def test_levels_count_from_the_least_in_the_disc_and_by_their_contrast(
    disc_mask, gain, rtol
):
    image = drop(30)
    disc, inside = disc_mask(*image.shape), disc_mask(95, 95)
    other = np.where(disc, gain * image - 7, -99.0)
    expected, regular = (turned([i])[0][3:-3, 3:-3][inside] for i in (image, other))
    # Taking off 7 and adding it again rounds, most beside 0.01; at the edge -99 shines
    # in.
    assert_allclose(regular + 7, gain * expected, rtol=rtol, atol=1e-9)


@pytest.mark.parametrize(
    "image",
    [np.zeros((9, 9)), np.full((9, 9), 4.0), drop(0, 41, 6, 6, 0)],
    ids=["blank", "flat", "round"],
)
def test_what_has_no_direction_is_not_turned(disc_mask, image):
    mask = disc_mask(*image.shape)
    assert_array_equal(turned([image], least=0)[0], image * mask)


def test_a_line_is_as_anisotropic_as_can_be(disc_mask):
    line = np.eye(11)
    assert turned([line], least=1 - 1e-9)[0, 5, 2:9].min() > 0.5
    cross = (line + line[::-1]) * disc_mask(11, 11)
    assert_array_equal(turned([cross], least=1e-9), [cross])


@pytest.mark.parametrize("angle", [-170, -120, -90, -30, 20, 45, 75, 135, 180])
def test_the_longer_tail_gives_the_direction(angle):
    regular = turned(np.stack([drop(0), drop(angle)]))
    # Linear interpolation of a blob ten pixels wide.
    assert_allclose(regular[1], regular[0], atol=0.02)


def test_images_below_the_threshold_stay(disc_mask):
    image = drop(40)[np.newaxis]
    kept = OrientationRegulariser(min_anisotropy=0.9).fit_transform(image)
    assert_array_equal(kept, image * disc_mask(101, 101))


def test_derivative_of_a_slope_is_its_steepness():
    x, y = np.meshgrid(np.arange(6.0), np.arange(5.0))
    slope = (3 * x + 4 * y)[np.newaxis]
    # Central differences span two pixels: 2 * hypot(3, 4).
    assert_allclose(steepness(slope), np.full((1, 3, 4), 10.0))
    assert_array_equal(steepness(slope + 5), steepness(slope))


def test_no_difference_reaches_across_the_rim(disc_mask):
    inside = disc_mask(21, 21) * 50.0
    assert_array_equal(DerivativeMagnitude().fit_transform(inside[np.newaxis]), 0)
    whole = DerivativeMagnitude(region="frame").fit_transform(inside[np.newaxis])
    assert whole.max() == pytest.approx(np.hypot(50, 50))


def test_derivative_refuses_what_it_cannot_differentiate():
    with pytest.raises(ValueError, match="at least 3 x 3 pixels"):
        steepness(np.zeros((1, 2, 5)))


each_interpolation = pytest.mark.parametrize("interpolation", ["linear", "cubic"])


@each_interpolation
@pytest.mark.parametrize("turns", [0, 1, 2, 3, 4])
def test_quarter_turns_are_exact(turns, interpolation, rng):
    images = rng.random((3, 7, 7))
    turned = repose(images, 90 * turns, interpolation=interpolation)
    # Clockwise as displayed: rot90 with k < 0.
    assert_array_equal(turned, np.rot90(images, -turns, axes=(1, 2)))


@each_interpolation
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


@each_interpolation
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


@pytest.mark.parametrize(("n", "size"), [(12, 10), (30, 120)], ids=["one", "blocks"])
def test_each_touch_has_its_own_pose(rng, n, size):
    images = rng.random((n, size, size))
    angle, shift = rng.uniform(0, 360, n), rng.uniform(-2, 2, (n, 2))
    gain = rng.uniform(0.8, 1.2, n)
    together = repose(images, angle, shift, gain)
    alone = [repose(images[[i]], angle[i], shift[i], gain[i])[0] for i in range(n)]
    assert_array_equal(together, alone)


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
