"""The clean-up of pressure arrays against facts known without the code."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone

from palpate.images import ArrayCleanUp, ChannelMean, fill_dead_taxels


def resized(images, shape=(33, 33)):
    return ArrayCleanUp(shape, output="resized").fit_transform(images)


def with_gamma(image, gamma):
    clean_up = ArrayCleanUp(np.shape(image), gamma=gamma, output="gamma")
    return clean_up.fit_transform([image])[0]


def filtered(images):
    """Only filter: images of their own size, whose largest level is a power of two."""
    clean_up = ArrayCleanUp(images.shape[1:], gamma=1, output="filtered")
    return clean_up.fit_transform(images)


def binarised(images, n_partitions, **options):
    """Only threshold: images of their own size, no level far below the mean."""
    shape, options = images.shape[1:], {"gamma": 1, "n_sd": 1e9, **options}
    return ArrayCleanUp(shape, n_partitions=n_partitions, **options).fit_transform(
        images
    )


@pytest.fixture
def lopsided():
    """A 10 x 10 block of foreground, pressed four times harder on its left half."""
    image = np.zeros((20, 20))
    image[5:15, 5:10], image[5:15, 10:15] = 200, 50
    return image[np.newaxis]


@pytest.mark.parametrize(
    ("small", "large"),
    [((10, 10), (33, 33)), ((4, 7), (9, 7)), ((1, 5), (3, 64)), ((2, 2), (300, 2))],
)
def test_enlarging_is_the_bilinear_of_opencv(small, large, rng):
    images = rng.random((3, *small))
    expected = [cv2.resize(image, large[::-1]) for image in images]
    # OpenCV computes the weights in single precision.
    assert_allclose(resized(images, large), expected, atol=1e-6)


@pytest.mark.parametrize("shape", [(33, 33), (5, 40), (3, 3), (10, 10)])
def test_a_constant_image_stays_constant_at_any_size(shape):
    assert_allclose(resized(np.full((2, 10, 10), 7.0), shape), 7.0, rtol=1e-14)


def test_shrinking_skips_no_taxel():
    each_alone = np.eye(12)[:, np.newaxis, :]
    assert resized(each_alone, (1, 3)).sum(axis=2).min() > 0.1


@pytest.mark.parametrize("shape", [33, (33,), (33, 33, 1)])
def test_resize_refuses_what_is_no_size(shape):
    with pytest.raises(ValueError, match="two integers"):
        resized(np.ones((1, 10, 10)), shape)
    with pytest.raises(ValueError, match="at least 1"):
        resized(np.ones((1, 10, 10)), (33, 0))


def test_gamma_has_its_closed_form():
    image = [[0.0, 64.0, 256.0, -5.0]]
    assert_allclose(with_gamma(image, 0.5), [[0, 128, 256, 0]])
    assert_allclose(with_gamma(image, 2.0), [[0, 16, 256, 0]])
    assert_allclose(with_gamma(image, 1.0), [[0, 64, 256, 0]], rtol=1e-14)
    assert_allclose(with_gamma(np.zeros((2, 2)), 0.5), 0)
    assert np.isfinite(with_gamma([[1e300, 3e299]], 2)).all()


def test_noise_filter_zeroes_what_is_far_below_the_mean():
    image = np.full((1, 10, 10), 128.0)
    image[0, 0, 0] = 6.0  # mean 126.8, sd 12.1: the threshold is 102.5
    levels = filtered(image)
    assert levels[0, 0, 0] == 0
    assert_array_equal(levels[0].ravel()[1:], 128)


def test_noise_filter_does_nothing_to_a_mostly_empty_image(touches):
    sparse = np.where(touches > 0.8, touches, 0.0)
    sparse[:, 0, 0] = 1
    assert (sparse.mean(axis=(1, 2)) < 2 * sparse.std(axis=(1, 2))).all()
    assert_array_equal(filtered(sparse), sparse)


def test_constant_image_has_no_foreground():
    constant = np.full((1, 9, 9), 40.0)
    assert not binarised(constant, 3).any()


def test_partitions_of_33_pixels_are_17_and_16(rng):
    image = rng.random((1, 33, 33))
    binary = binarised(image, 2)
    halves = (slice(0, 17), slice(17, 33))
    for rows in halves:
        for cols in halves:
            alone = binarised(image[:, rows, cols], 1)
            assert_array_equal(binary[:, rows, cols], alone)


def test_partitions_find_the_lightly_pressed_side(lopsided):
    whole, parts = binarised(lopsided, 1), binarised(lopsided, 2)
    assert whole.sum() == 50
    assert_array_equal(parts, lopsided > 0)


@pytest.mark.parametrize(("level", "foreground"), [(200.0, True), (20.0, False)])
def test_constant_partition_is_judged_by_the_whole_image(level, foreground):
    image = np.zeros((1, 8, 8))
    image[0, :4, :4] = level
    image[0, 5, 5] = 255
    binary = binarised(image, 2)
    assert (binary[0, :4, :4] == foreground).all()
    assert not binary[0, :4, 4:].any()


def test_rounding_does_not_make_a_constant_partition_uneven():
    image = np.zeros((1, 8, 8))
    image[0, 4:, 4:] = 100
    image[0, :4, :4] = 1 + 1e-15 * np.arange(16).reshape(4, 4)
    assert not binarised(image, 2)[0, :4, :4].any()


def test_min_contrast_keeps_noise_in_the_background(rng):
    image = 5 + rng.normal(scale=1.0, size=(1, 20, 20))
    image[0, 10:, 10:] += np.pad(np.full((6, 6), 200.0), 2)
    noise = np.s_[0, :10, :10]
    assert binarised(image, 2)[noise].mean() > 0.3
    assert not binarised(image, 2, min_contrast=0.1)[noise].any()


def test_dead_taxels_of_a_plane_are_restored():
    row, col = np.mgrid[:7, :6].astype(float)
    plane = 4 * row - 2 * col
    holed = np.stack([plane, plane])
    holed[0, 2:5, 3] = holed[1, 1:4, 1:4] = np.nan
    assert_allclose(fill_dead_taxels(holed), [plane, plane], atol=1e-12)


def test_filled_taxels_stay_within_the_living_ones(rng):
    images = rng.random((20, 6, 8))
    images[rng.random(images.shape) < 0.4] = np.nan
    images[:, 0, 0] = rng.random(20)
    filled = fill_dead_taxels(images)
    alive = ~np.isnan(images)
    assert_array_equal(filled[alive], images[alive])
    for image, complete in zip(images, filled, strict=True):
        assert np.nanmin(image) - 1e-12 <= complete.min()
        assert complete.max() <= np.nanmax(image) + 1e-12


def test_dead_taxels_are_refused_when_asked(touches):
    touches[3, 2, 2] = np.nan
    with pytest.raises(ValueError, match=r'1 NaN in touch 3.*dead="fill"'):
        fill_dead_taxels(touches, dead="refuse")
    with pytest.raises(ValueError, match="dead must be one of"):
        fill_dead_taxels(touches, dead="drop")
    touches[5] = np.nan
    with pytest.raises(ValueError, match="only NaN in touch 5"):
        fill_dead_taxels(touches)


def test_each_step_goes_on_from_the_one_before(touches):
    enlarged = resized(touches)
    corrected = np.stack([with_gamma(image, 0.7) for image in enlarged])
    chain = ArrayCleanUp(gamma=0.7, n_partitions=3, min_contrast=0.2)
    steps = clone(chain).set_params(output="filtered").fit_transform(touches)
    assert_array_equal(steps, np.where(steps == 0, 0, corrected))
    expected = binarised(steps, 3, min_contrast=0.2)
    assert_array_equal(chain.fit_transform(touches), expected)


def test_clean_up_does_not_depend_on_the_unit(touches):
    clean_up = ArrayCleanUp().fit(touches)
    assert_array_equal(clean_up.transform(touches), clean_up.transform(255 * touches))


def test_clean_up_turns_with_the_image(touches):
    clean_up = ArrayCleanUp(shape=(32, 32)).fit(touches)
    turned = clean_up.transform(np.rot90(touches, axes=(1, 2)))
    assert_array_equal(turned, np.rot90(clean_up.transform(touches), axes=(1, 2)))


def test_clean_up_fills_or_refuses_dead_taxels(touches):
    holed = touches.copy()
    holed[:, 4, 4] = np.nan
    cleaned = ArrayCleanUp(output="filtered").fit_transform(holed)
    assert np.isfinite(cleaned).all()
    with pytest.raises(ValueError, match="no dead taxels"):
        ArrayCleanUp(dead="refuse").fit(holed)


def test_lists_of_unequal_lengths_are_refused():
    with pytest.raises(ValueError, match=r"one array of shape .*unequal lengths\. Bri"):
        resized([[[1, 2], [3]]])


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.float64])
def test_the_size_of_a_force_does_not_depend_on_where_it_points(rng, dtype):
    images = rng.integers(0, 200, (9, 4, 5, 3)).astype(dtype)
    size = ChannelMean(squared=True).fit_transform(images)
    assert_allclose(size, np.sqrt((images.astype(float) ** 2).mean(axis=3)), rtol=1e-5)
    turned = np.roll(images.astype(float), 1, axis=3) * [1, -1, 1]
    assert_allclose(ChannelMean(squared=True).fit_transform(turned), size, rtol=1e-5)
    grey = images[..., 0]
    assert_array_equal(ChannelMean(squared=True).fit_transform(grey), grey)
    with pytest.raises(ValueError, match="squared must be"):
        ChannelMean(squared="yes").fit(images)
