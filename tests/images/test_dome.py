"""Cutting discs: exact averages, statistics of the disc, invariance to shifts."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from palpate.images import DomeCrop, find_rims

SHAPE = (120, 160)


def draw_dome(row, col, radius=60.0, shape=SHAPE):
    """A dome in a bright surround, with a soft contact that moves with it."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    y, x = y - row, x - col
    share = np.clip(radius - np.hypot(y, x) + 0.5, 0, 1)
    contact = 100 * np.exp(-((y + 12) ** 2 / 200 + (x - 9) ** 2 / 70))
    return np.rint(share * (90 + 0.4 * y + contact) + (1 - share) * 250).astype(
        np.uint8
    )


def domes(rng, n=8):
    places = np.array([55.0, 70.0]) + rng.uniform(-5, 5, size=(n, 2))
    return np.stack([draw_dome(row, col) for row, col in places])


def cut(image, row, col, radius, size):
    """The grey disc of `radius` pixels about a place of an image."""
    crop = DomeCrop(output="grey").fit(np.zeros_like(image)[np.newaxis])
    rims = crop.rims(image[np.newaxis])
    crop.disc_radius_, crop.size_ = radius, size
    return crop.cut(image[np.newaxis], replace(rims, row=[row], col=[col]))[0]


def slow_average(image, row, col, radius, size):
    """Overlap of every cell with every pixel, one by one."""
    cell = 2 * radius / size
    result = np.zeros((size, size))
    for i, j in np.ndindex(size, size):
        top, left = row - radius + i * cell, col - radius + j * cell
        for y, x in np.ndindex(image.shape):
            high = min(top + cell, y + 0.5) - max(top, y - 0.5)
            wide = min(left + cell, x + 0.5) - max(left, x - 0.5)
            result[i, j] += image[y, x] * max(high, 0) * max(wide, 0) / cell**2
    return result


@pytest.mark.parametrize(
    ("row", "col", "radius", "size"),
    [
        *((5.3, 6.6, 5.2, size) for size in (1, 2, 5, 9)),
        pytest.param(5.5, 6.5, 6, 12, id="pixels as they are"),
        pytest.param(5.5, 6.5, 6, 6, id="two by two"),
    ],
)
@pytest.mark.parametrize("dtype", [np.uint8, np.float64])
def test_cells_are_area_averages(rng, disc_mask, row, col, radius, size, dtype):
    image = rng.integers(0, 256, (12, 14)).astype(dtype)
    disc = cut(image, row, col, radius, size)
    wanted = slow_average(image, row, col, radius, size) * disc_mask(size, size)
    # Single precision keeps seven digits of levels up to 255.
    np.testing.assert_allclose(disc, wanted, atol=3e-5)


def test_disc_beyond_the_frame_repeats_the_edge(rng):
    image = rng.integers(0, 256, (12, 14)).astype(np.uint8)
    wide = np.pad(image, 9, mode="edge")
    disc, wanted = cut(image, 2.3, 12.1, 6.7, 8), cut(wide, 11.3, 21.1, 6.7, 8)
    # The same averages from other integral images.
    np.testing.assert_allclose(disc, wanted, atol=3e-5)


def test_far_levels_keep_their_digits(rng, disc_mask):
    image, place = rng.random((40, 40)), (19.2, 20.4, 12.3, 9)
    near, far = cut(image, *place), cut(image + 1000, *place)
    # A thousand in single precision is good to 6e-5.
    np.testing.assert_allclose(far - 1000 * disc_mask(9, 9), near, atol=1e-4)


def test_standard_discs_have_mean_zero_and_variance_one(rng, disc_mask):
    discs = DomeCrop.standardise(rng.gamma(2, 30, size=(4, 31, 31)))
    mask = disc_mask(31, 31)
    # Single precision, averaged over hundreds of pixels.
    np.testing.assert_allclose(discs[:, mask].mean(axis=1), 0, atol=1e-6)
    np.testing.assert_allclose(discs[:, mask].var(axis=1), 1, atol=1e-5)
    np.testing.assert_array_equal(discs[:, ~mask], 0)
    assert discs.dtype == np.float32


def test_standard_discs_ignore_gain_offset_and_surround(rng, disc_mask):
    discs = rng.random((3, 21, 21))
    other = 40 * discs + 7 + 500 * ~disc_mask(21, 21)
    # Rounding of single precision alone.
    np.testing.assert_allclose(
        DomeCrop.standardise(other), DomeCrop.standardise(discs), atol=1e-6
    )


@pytest.mark.parametrize("level", [0, 1e-30, 0.1, 77, -1e6])
def test_constant_disc_becomes_zeros(level):
    np.testing.assert_array_equal(DomeCrop.standardise(np.full((2, 9, 9), level)), 0)


@pytest.mark.parametrize("seed", range(5))
def test_shifted_touch_gives_the_same_disc(seed):
    rng = np.random.default_rng(seed)
    crop = DomeCrop(output="grey").fit(domes(rng))
    first, second = rng.uniform(-4, 4, size=(2, 2))
    here, there = (draw_dome(55 + d, 70 + r) for d, r in (first, second))
    discs = crop.transform(np.stack([here, there]))
    # Contact slopes of 7 levels a pixel times centres good to 0.1, and rounding.
    assert np.sqrt(np.mean((discs[0] - discs[1]) ** 2)) < 1


def test_centre_of_the_rim_is_the_centre_of_the_canvas(rng):
    row, col = 54.37, 71.81
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    spot = 150 * np.exp(-((y - row) ** 2 + (x - col) ** 2) / (2 * 6**2))
    share = np.clip(60.5 - np.hypot(y - row, x - col), 0, 1)
    image = np.where(share > 0, 60 + spot, 250)
    image = share * image + (1 - share) * 250
    crop = DomeCrop(output="grey").fit(image[np.newaxis])
    disc = crop.transform(image[np.newaxis])[0] - 60
    disc[disc < 20] = 0
    i, j = np.mgrid[: crop.size_, : crop.size_]
    centroid = (disc * i).sum() / disc.sum(), (disc * j).sum() / disc.sum()
    # The rim itself is found to some hundredths of a pixel.
    np.testing.assert_allclose(centroid, (crop.size_ - 1) / 2, atol=0.1)


def test_turned_touch_gives_a_turned_disc(rng):
    image = draw_dome(60.4, 59.1, 45.0, shape=(120, 120))
    crop = DomeCrop(output="grey").fit(image[np.newaxis])
    discs = crop.transform(np.stack([image, np.rot90(image)]))
    # The rim is found to a few hundredths of a pixel either way.
    assert np.sqrt(np.mean((discs[1] - np.rot90(discs[0])) ** 2)) < 0.3


def test_safe_disc_stays_in_rim_and_frame(rng):
    images = domes(rng)
    crop = DomeCrop(margin=0.0).fit(images)
    rims = crop.rims(images)
    reach = np.minimum(rims.row, 119 - rims.row) + 0.5
    # The 98 % quantile of eight touches lies between the two shortest.
    assert reach.min() <= crop.disc_radius_ <= np.sort(reach)[1]
    less = DomeCrop(margin=0.1).fit(images)
    assert less.disc_radius_ == pytest.approx(0.9 * crop.disc_radius_)


def test_rim_wholly_in_the_frame_bounds_the_disc():
    images = np.stack([draw_dome(58.0 + d, 75.0, 40.0) for d in range(4)])
    crop = DomeCrop(margin=0.0).fit(images)
    # The drawn radius, found to some hundredths of a pixel.
    assert crop.disc_radius_ == pytest.approx(40, abs=0.1)


@pytest.mark.parametrize("size", [None, 32, 500])
def test_canvas_is_never_larger_than_the_disc(rng, size):
    crop = DomeCrop(size=size).fit(domes(rng))
    native = int(2 * crop.disc_radius_)
    assert crop.size_ == (32 if size == 32 else native)


def test_a_touch_without_a_rim_has_the_typical_one_as_not_visible(rng):
    images = domes(rng)
    images[2] = rng.integers(0, 256, SHAPE)
    crop = DomeCrop().fit(images)
    rims = crop.rims(images)
    np.testing.assert_array_equal(rims.visible, np.arange(8) != 2)
    # A touch without a rim is cut about the typical one.
    assert (rims.row[2], rims.col[2]) == (crop.rim_row_, crop.rim_col_)


def test_touch_without_a_rim_is_refused_by_name(rng):
    images = domes(rng)
    crop = DomeCrop(missing="refuse").fit(images)
    images[2] = images[5] = rng.integers(0, 256, SHAPE)
    with pytest.raises(ValueError, match=re.escape("touch 2 (2 of 8 touches)")):
        crop.transform(images)
    with pytest.raises(ValueError, match="missing='inscribed'"):
        DomeCrop(missing="refuse").fit(rng.random((3, 50, 60)))


@pytest.mark.parametrize("shape", [(10, 10), (1, 1), (33, 21), (64, 200)])
def test_sensor_without_a_rim_uses_the_inscribed_disc(rng, shape):
    images = rng.random((3, *shape))
    crop = DomeCrop().fit(images)
    side = min(shape)
    assert not crop.has_rim_
    assert (crop.disc_radius_, crop.size_) == (side / 2, side)
    assert not crop.rims(images).visible.any()
    top, left = ((n - side) // 2 for n in shape)
    if (sum(shape)) % 2 == 0:
        square = images[:, top : top + side, left : left + side]
        # Levels up to 1, standardised, in single precision.
        np.testing.assert_allclose(
            crop.transform(images), DomeCrop.standardise(square), atol=1e-5
        )


def test_no_contact_frame_gives_the_radius(rng):
    images, frame = domes(rng), draw_dome(55, 70, 60.0)
    crop = DomeCrop().fit(images, no_contact=frame)
    assert crop.rim_radius_ == DomeCrop().fit(frame[np.newaxis]).rim_radius_
    rims = find_rims(images, no_contact=frame)
    np.testing.assert_array_equal(crop.rims(images).row, rims.row)


def test_grey_output_keeps_the_levels(rng):
    images = domes(rng)
    grey = DomeCrop(output="grey").fit(images).transform(images)
    standard = DomeCrop().fit(images).transform(images)
    np.testing.assert_array_equal(DomeCrop.standardise(grey), standard)


def test_wrong_images_are_refused(rng):
    images = domes(rng)
    crop = DomeCrop().fit(images)
    with pytest.raises(ValueError, match="rims must be as many as images"):
        crop.cut(images, crop.rims(images[:1]))
    with pytest.raises(ValueError, match="discs must be square"):
        DomeCrop.standardise(images)


def real_touches(data_folder, step):
    paths = sorted((data_folder / "bathtip/originals").glob("*/*/*.jpg"))[::step]
    return np.stack([cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in paths])


@pytest.mark.realdata
def test_safe_disc_of_some_touches_is_safe_for_others(data_folder):
    images = real_touches(data_folder, 8)
    crop = DomeCrop().fit(images[::2])
    rims = crop.rims(images[1::2])
    sides = np.stack([rims.row, 479 - rims.row, rims.col, 639 - rims.col]) + 0.5
    assert np.mean(sides.min(axis=0) >= crop.disc_radius_) >= 0.95
    # The frame cuts the rim on the left, above and below: the disc is smaller.
    assert 180 < crop.disc_radius_ < 240 < crop.rim_radius_
    assert crop.size_ == 128


def test_levels_that_single_precision_cannot_hold_are_refused(rng):
    images = rng.random((3, 50, 50))
    crop = DomeCrop(20).fit(images)
    large = images.copy()
    large[1] *= 1e200
    with pytest.raises(ValueError, match=r"at most 1e\+37 in size, got 1e\+200 in tou"):
        DomeCrop(20).fit(large)
    with pytest.raises(ValueError, match=r"in touch 1\. Divide all images"):
        crop.transform(large)
    # Just within, the standardised discs are those of ordinary levels.
    np.testing.assert_allclose(
        crop.transform(1e36 * images), crop.transform(images), atol=1e-5
    )


def test_channels_are_cut_about_one_rim_and_keep_how_they_differ():
    row, col = np.mgrid[:100, :120]
    inside = np.hypot(row - 48, col - 61) < 40
    grey = np.where(inside, 90.0 + 0.2 * row, 255)[np.newaxis]
    colour = np.stack([grey - 20 * inside, grey, grey + 20 * inside], axis=3)
    crop = DomeCrop().fit(grey)
    discs = crop.by_channel(colour)
    alone = crop.transform(grey)
    assert discs.shape == (*alone.shape, 3)
    assert np.allclose(discs.mean(axis=3), alone, atol=1e-4)
    deviation = (0.2 * row)[np.hypot(row - 48, col - 61) < crop.disc_radius_].std()
    difference = (discs[..., 2] - discs[..., 0])[alone != 0]
    assert np.allclose(difference, 40 / deviation, rtol=0.02)
    flat = DomeCrop(missing="inscribed").fit(np.full((2, 30, 30), 7.0))
    assert not flat.by_channel(np.full((2, 30, 30, 3), 7.0)).any()
