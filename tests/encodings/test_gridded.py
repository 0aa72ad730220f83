"""Levels on a grid, edges, rings, pads, slopes of a gel: known without the code."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.encodings import (
    EdgeHistograms,
    GridLevels,
    PadShapes,
    PhotometricGradients,
    RingPatterns,
    RingQuantiles,
    encoder_named,
)

from .conftest import blobs


def test_cells_are_means_of_equal_squares():
    image = np.arange(32.0).reshape(1, 8, 4)
    cells = GridLevels(4, root=False).fit_transform(image)
    assert_allclose(cells, [[2.5, 4.5, 10.5, 12.5, 18.5, 20.5, 26.5, 28.5]])


def test_few_taxels_are_left_as_they_are_and_roots_keep_signs():
    image = np.array([[[4.0, -9.0, 0.0]]])
    assert_allclose(GridLevels().fit_transform(image), [[2, -3, 0]])


def test_blur_of_one_point_is_a_gaussian():
    image = np.zeros((1, 21, 21))
    image[0, 10, 10] = 1
    blurred = GridLevels(blur=1.5).fit_transform(image).reshape(21, 21)
    row, col = np.mgrid[-10:11, -10:11]
    gauss = np.exp(-(row**2 + col**2) / (2 * 1.5**2))
    # Five cells from the border 2e-4 of a Gaussian is cut off and made up for.
    assert_allclose(blurred[5:16, 5:16], (gauss / gauss.sum())[5:16, 5:16], rtol=1e-3)


def test_blur_keeps_what_is_even():
    assert_allclose(GridLevels(blur=2.0).fit_transform(np.full((1, 5, 9), 4)), 2)


def test_a_spectrum_is_the_same_wherever_a_contact_lies_on_its_pad(rng):
    """The pads' contacts move each by itself; what rests there is taken off."""
    pads, rest = [[0, 0, 9, 12], [0, 13, 9, 7]], rng.random((9, 20))
    contacts = rng.random((2, 3, 4)) + 1

    def placed(contacts, *places):
        image = np.zeros((9, 20))
        for (top, left), contact in zip(places, contacts, strict=True):
            image[top : top + 3, left : left + 4] = contact
        return image

    images = rest + np.stack(
        [
            placed(contacts, (0, 0), (6, 16)),
            placed(contacts, (4, 8), (1, 13)),
            # As one is turned by half, so are the sizes of its coefficients.
            placed([contacts[0][::-1, ::-1], contacts[1]], (4, 8), (1, 13)),
            placed(contacts[::-1], (0, 0), (6, 16)),
            placed(2 * contacts, (0, 0), (6, 16)),
        ]
    )
    spectra = GridLevels(spectrum=True, pads=pads, baseline=rest).fit(images)
    first, moved, turned, other, harder = spectra.transform(images)
    assert_allclose(moved, first, rtol=1e-9, atol=1e-9)
    assert_allclose(turned, first, rtol=1e-9, atol=1e-9)
    assert_allclose(harder, np.sqrt(2) * first)
    assert np.abs(other - first).max() > 0.05 * first.max()
    # Of one pad it is the transform of the image, padded by zeros.
    whole = GridLevels(root=False, spectrum=True).fit_transform(images)
    assert_allclose(whole[0], np.abs(np.fft.rfft2(images[0], (18, 40))).ravel())
    of_each_pad = [
        GridLevels(root=False, spectrum=True).fit_transform(images[:, :9, :12]),
        GridLevels(root=False, spectrum=True).fit_transform(images[:, :9, 13:]),
    ]
    of_pads = GridLevels(root=False, spectrum=True, pads=pads).fit_transform(images)
    assert_allclose(of_pads, np.hstack(of_each_pad))


@pytest.mark.parametrize(
    ("image", "direction"),
    [
        pytest.param(np.tile(np.arange(64.0), (64, 1)), 0, id="across"),
        pytest.param(np.tile(np.arange(64.0)[:, None], 64), 90, id="down"),
        pytest.param(np.add.outer(np.arange(64.0), np.arange(64.0)), 45, id="oblique"),
    ],
)
def test_a_slope_votes_for_its_direction_alone(image, direction):
    """0, 45 and 90 degrees each lie between two of 4 directions (22.5, 67.5...)."""
    votes = EdgeHistograms(4).fit_transform(image[np.newaxis]).reshape(7, 7, 4, 4)
    middle = votes[3, 3, 0]
    near = [(direction // 45 - 1) % 4, direction // 45]
    assert_allclose(middle[near], middle[near[0]], rtol=1e-4)
    assert_allclose(np.delete(middle, near), 0, atol=1e-6)
    # Eight equal votes in a block of length 1.
    assert_allclose(middle[near[0]], 1 / np.sqrt(8), rtol=1e-3)


def test_edges_are_blind_to_sign_and_gain(rng):
    smooth = blobs(rng, 20, 96)
    encoder = EdgeHistograms()
    features = encoder.fit_transform(smooth)
    assert_allclose(encoder.transform(-5 * smooth), features, atol=1e-4)


@pytest.mark.parametrize(
    ("shape", "rows", "cols"),
    [((14, 41), 4, 12), ((10, 10), 4, 4), ((300, 200), 12, 8)],
)
def test_edges_of_any_size_have_cells_enough(shape, rows, cols):
    features = EdgeHistograms().fit_transform(np.ones((1, *shape)))
    assert features.shape == (1, (rows - 1) * (cols - 1) * 36)


@pytest.mark.parametrize("encoder", [RingPatterns(), RingQuantiles()], ids=repr)
def test_rings_are_blind_to_quarter_turns(encoder, rng):
    smooth = blobs(rng, 20, 96)
    features = encoder.fit_transform(smooth)
    turned = encoder.transform(np.rot90(smooth, axes=(1, 2)))
    # Sums in another order, after which a place may fall on the other side.
    assert_allclose(turned, features, atol=0.05)


def test_patterns_of_a_flat_a_bright_and_a_dark_place():
    """On a flat disc all places are as high as the pixel; on a peak none is."""
    features = RingPatterns(1, (2,), 8).fit_transform(np.full((1, 40, 40), 7.0))
    assert_allclose(features, [[0] * 8 + [1, 0]])
    row, col = np.mgrid[:101, :101]
    cone = -np.hypot(row - 50.0, col - 50)[np.newaxis]
    peak = RingPatterns(16, (4,), 8, contrast=0).fit_transform(cone).reshape(16, 10)
    # Within three pixels of the top some pixels see nothing that is higher.
    assert peak[0, 0] > 0
    assert_allclose(peak[4:, 0], 0)
    # On a slope nearly half of the places are higher.
    assert_allclose((peak[8:, 3:5] ** 2).sum(axis=1), 1, atol=0.1)


def test_contrast_hides_faint_texture(rng):
    slope = np.tile(np.linspace(0, 1, 96), (1, 96, 1))
    noisy = slope + 0.001 * rng.standard_normal((1, 96, 96))
    moved = []
    for contrast in (0.06, 0.0):
        encoder = RingPatterns(1, (5,), contrast=contrast).fit(slope)
        moved.append(
            np.linalg.norm(encoder.transform(noisy) - encoder.transform(slope))
        )
    assert moved[0] < 0.5 * moved[1]


def test_quantiles_of_rings_of_levels():
    row, col = np.mgrid[:64, :64] - 31.5
    rings = (np.hypot(row, col) >= 16) * 10.0
    levels = RingQuantiles(2, 3).fit_transform(rings[np.newaxis]).reshape(2, 2, 3)[0]
    assert_allclose(levels, [[0, 0, 0], [10, 10, 10]])


def test_gradient_of_a_slope_is_its_steepness():
    slope = np.tile(3.0 * np.arange(64), (1, 64, 1))
    gradient = RingQuantiles(4, 1).fit_transform(slope).reshape(2, 4)[1]
    assert_allclose(gradient, 3)


def test_gradients_of_levels_that_single_precision_cannot_hold_are_refused(rng):
    images = rng.random((6, 24, 24))
    gradients = encoder_named("polar-gradients")
    for scale in (1e38, 1e200):
        with pytest.raises(
            ValueError, match=r"at most 1e\+37 in size, got .* in touch"
        ):
            gradients.fit(scale * images)
    with pytest.raises(ValueError, match="Divide all images by one number"):
        gradients.fit(images).transform(1e38 * images)
    assert np.isfinite(gradients.fit(9e36 * images).transform(9e36 * images)).all()


@pytest.mark.parametrize(
    "name", ["edge-histograms", "polar-gradients", "ring-patterns", "ring-quantiles"]
)
def test_where_images_lie_in_memory_changes_nothing(rng, name):
    images = rng.random((3, 40, 40))
    encoder = encoder_named(name).fit(images)
    expected, kept = encoder.transform(images), []
    for size in rng.integers(500, 10_000, 40):
        kept.append(np.empty(size, np.uint8))  # what comes next lies elsewhere
        assert_array_equal(encoder.transform(images), expected)


def test_gradients_of_levels_whose_squares_vanish_count_like_others(rng):
    images = rng.random((2, 40, 40))
    quantiles = RingQuantiles()
    expected = quantiles.fit(images).transform(images)
    small = quantiles.transform(1e-25 * images)
    assert_allclose(small, 1e-25 * expected, rtol=1e-5, atol=0)


PADS = [[0, 0, 5, 4], [0, 5, 5, 4]]
NAMES = ["load", "row", "col", "down", "across", "area", "quarter", "half"]
NAMES += ["largest", "mean"]


def test_shape_numbers_of_a_bar_and_an_empty_pad():
    """A bar of three taxels of level 4 down the second column of four."""
    hand = np.zeros((1, 5, 9))
    hand[0, 1:4, 1], hand[0, :, 4] = 4, np.nan
    features = PadShapes(PADS).fit_transform(hand)[0]
    bar = dict(zip(NAMES, features, strict=False))
    half = 2.5
    assert_allclose(bar["load"], np.sqrt(12))
    assert_allclose([bar["row"], bar["col"]], [0, -0.5 / half], atol=1e-12)
    assert_allclose([bar["down"], bar["across"]], [np.sqrt(2 / 3) / half, 0], atol=1e-7)
    assert_allclose([bar["area"], bar["quarter"], bar["half"]], 3 / 20)
    assert_allclose([bar["largest"], bar["mean"]], 2)
    assert_allclose(features[17:34], 0)
    assert_allclose(features[34:36], [1, 0])
    assert_allclose(features[36:], features[:5])


def test_covariance_and_axes_of_a_diagonal():
    features = PadShapes().fit_transform(np.eye(9)[np.newaxis])[0]
    spread = np.sqrt(60 / 9) / 4.5
    assert_allclose(features[[3, 4, 10]], spread)
    assert_allclose(features[[11, 12]], [np.sqrt(2) * spread, 0], atol=1e-7)
    assert_allclose(features[13:], 0, atol=1e-12)


def test_hand_of_six_pads_without_load_is_zeros():
    boxes = [[0, 7 * k, 13, 6] for k in range(6)]
    features = PadShapes(boxes).fit_transform(np.full((2, 14, 41), np.nan))
    assert features.shape == (2, 6 * 17 + 6 + 15 * 5)
    assert_allclose(features, 0)


LIGHTS = np.array([[-1.0, 0.0], [0.5, 0.87], [0.5, -0.87]])


def lit(slopes, gain=1.0):
    """A grey gel of level 100, brighter where it falls towards a light."""
    return 100 + gain * slopes @ LIGHTS.T


@pytest.fixture
def dented(rng):
    return rng.normal(size=(5, 12, 16, 2))


def test_slopes_are_recovered(dented):
    flat = np.full((12, 16, 3), 100.0)
    encoder = PhotometricGradients(LIGHTS, baseline=flat).fit(lit(dented))
    roots = encoder.transform(lit(dented))
    slopes = (np.sign(roots) * roots**2).reshape(5, 2, 12, 16)
    assert_allclose(np.moveaxis(slopes, 1, 3), dented, atol=1e-9)


def test_what_all_lights_share_is_no_slope(dented):
    # Equal lights from all around: one level more in every channel tilts nothing.
    even = LIGHTS - LIGHTS.mean(axis=0)
    encoder = PhotometricGradients(even).fit(lit(dented))
    brighter = encoder.transform(lit(dented) + 7.0)
    assert_allclose(brighter, encoder.transform(lit(dented)), atol=1e-5)


def test_untouched_gel_has_no_slopes(dented):
    touches = np.concatenate([np.repeat(lit(0 * dented), 3, axis=0), lit(dented)])
    encoder = PhotometricGradients(LIGHTS).fit(touches)
    assert_allclose(encoder.transform(touches[:1]), 0, atol=1e-6)


@pytest.mark.parametrize("shape", [(), (12, 16), (12, 16, 1), (11, 16, 3)])
def test_a_baseline_that_is_no_such_image_is_refused(shape, dented):
    with pytest.raises(ValueError, match=r"of shape \(12, 16, 3\) .* got one of shape"):
        PhotometricGradients(LIGHTS, baseline=np.ones(shape)).fit(lit(dented))


@pytest.mark.parametrize(
    "lights", [[[1, 0], [2, 0], [3, 0]], [[1, 0], [0, 1]], [1, 0, 0]]
)
def test_lights_that_tell_no_slopes_are_refused(lights, dented):
    with pytest.raises(ValueError, match=r"a direction \(row, column\) for each of 3"):
        PhotometricGradients(lights).fit(lit(dented))


def test_grey_images_are_refused(dented):
    with pytest.raises(ValueError, match="for each of 1 channels"):
        PhotometricGradients(LIGHTS).fit(dented[..., 0])
