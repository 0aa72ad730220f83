"""Hu moments, scaled pixels, the two PCA encodings, and encodings by name."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context

from palpate.encodings import (
    CentroidMoments,
    EdgeHistograms,
    EncodingUnion,
    GridLevels,
    HuMoments,
    OrientedPCA,
    PadShapes,
    PolarGradients,
    RingPatterns,
    RingQuantiles,
    ScaledPixels,
    TaxelVector,
    ZernikeMoments,
    ZernikePCA,
    encoder_named,
)

from .conftest import blobs, turned

KINDS = {
    "hu": HuMoments,
    "log-hu": HuMoments,
    "zernike": ZernikeMoments,
    "zernike-noll": ZernikeMoments,
    "zernike-noll-abs": ZernikeMoments,
    "zernike-pca": ZernikePCA,
    "oriented-pca": OrientedPCA,
    "scaled-pixels": ScaledPixels,
    "centroid-moments": CentroidMoments,
    "polar-gradients": PolarGradients,
    "taxels": TaxelVector,
    "grid-levels": GridLevels,
    "edge-histograms": EdgeHistograms,
    "ring-patterns": RingPatterns,
    "ring-quantiles": RingQuantiles,
    "pad-shapes": PadShapes,
}


def by_definition(image):
    """Hu's seven of an image, from sums over its taxels about its centroid."""
    row, col = np.indices(image.shape)
    mass = image.sum()
    y, x = (row * image).sum() / mass, (col * image).sum() / mass

    def eta(p, q):
        mu = ((col - x) ** p * (row - y) ** q * image).sum()
        return mu / mass ** (1 + (p + q) / 2)

    a = complex(eta(2, 0) - eta(0, 2), 2 * eta(1, 1))
    b = complex(eta(3, 0) - 3 * eta(1, 2), 3 * eta(2, 1) - eta(0, 3))
    c = complex(eta(3, 0) + eta(1, 2), eta(2, 1) + eta(0, 3))
    fourth = b * c.conjugate() ** 3
    squares = [eta(2, 0) + eta(0, 2), abs(a) ** 2, abs(b) ** 2, abs(c) ** 2]
    return [*squares, fourth.real, (a * c.conjugate() ** 2).real, fourth.imag]


@pytest.mark.parametrize("gain", [1.0, 1e-30, 1e30])
@pytest.mark.parametrize("region", ["disc", "frame"])
@pytest.mark.parametrize("shape", [(15, 22), (22, 15), (16, 16)])
def test_hu_moments_are_those_of_the_definition(rng, disc_mask, shape, region, gain):
    image = rng.uniform(1, 9, size=shape)
    mask = disc_mask(*shape) if region == "disc" else np.ones(shape, bool)
    above = np.where(mask, image - image[mask].min(), 0)
    relative = above / above.sum() * mask.sum()
    ours = HuMoments(region=region).fit_transform(gain * image[np.newaxis])[0]
    # Rounding of central moments, relative to the largest of equal degree.
    assert_allclose(ours, by_definition(relative), rtol=1e-7, atol=1e-18)
    raw = HuMoments(region=region, levels="raw").fit_transform(gain * image[None])[0]
    degree = np.array([1.0, 2, 3, 3, 6, 4, 6])
    assert_allclose(
        raw * gain**degree, by_definition(image * mask), rtol=1e-7, atol=1e-18
    )


def test_hu_moments_stay_when_the_image_turns_and_the_last_sees_mirrors(rng):
    images = blobs(rng)
    hu = HuMoments(log=True)
    straight = hu.fit_transform(images)
    around = hu.transform(np.stack([turned(image, 37) for image in images]))
    mirrored = hu.transform(images[:, :, ::-1])
    # Resampling, in decades.
    assert_allclose(around[:, :4], straight[:, :4], atol=0.02)
    # A mirror changes the sign of the seventh moment alone.
    assert_allclose(mirrored[:, :6], straight[:, :6], atol=1e-6)
    assert_allclose(mirrored[:, 6], -straight[:, 6], atol=1e-6)


@pytest.mark.parametrize("levels", ["raw", "above-least"])
def test_without_mass_hu_moments_are_zero(levels):
    blank = np.stack([np.zeros((8, 8)), np.full((8, 8), -3.0)])
    assert_array_equal(HuMoments(levels=levels).fit_transform(blank), 0)


def test_hu_moments_have_names(rng):
    names = HuMoments(3).fit(blobs(rng)).get_feature_names_out()
    assert names.tolist() == ["hu1", "hu2", "hu3"]


def test_scaled_pixels_are_means_over_areas(rng):
    image = rng.normal(size=(1, 6, 9))
    straight = {"min_anisotropy": None}
    assert_allclose(
        ScaledPixels(3, **straight).fit_transform(image)[0],
        image.reshape(3, 2, 3, 3).mean(axis=(1, 3)).ravel(),
    )
    # Cells that cut pixels: 2.5 pixels of 5 along each side.
    half = ScaledPixels(2, **straight).fit_transform(np.ones((1, 5, 5)))
    assert_allclose(half, 1)
    row = np.arange(5.0)
    (cells,) = ScaledPixels(2, **straight).fit_transform(np.tile(row, (1, 5, 1)))
    # (0 + 1 + 2 / 2) / 2.5 and (2 / 2 + 3 + 4) / 2.5
    assert_allclose(cells, [0.8, 3.2, 0.8, 3.2])


def test_scaled_pixels_do_not_enlarge(rng):
    image = rng.normal(size=(2, 4, 5))
    same = ScaledPixels(13, min_anisotropy=None).fit_transform(image)
    assert_allclose(same, image.reshape(2, -1))


@pytest.mark.parametrize(
    "encoder", [ScaledPixels(13), OrientedPCA(4)], ids=["pixels", "pca"]
)
def test_turned_images_have_nearly_the_same_pixels(encoder, rng):
    images = blobs(rng)
    straight = encoder.fit_transform(images)
    around = encoder.transform(np.stack([turned(image, 100) for image in images]))
    away = np.linalg.norm(around - straight, axis=1)
    # Two interpolations; without regularising, turned images are as far as others.
    to_another = np.linalg.norm(straight - straight[::-1], axis=1)
    assert (away < 0.15 * to_another).all()


@pytest.mark.parametrize("encoder", [OrientedPCA, ZernikePCA])
def test_principal_components_are_uncorrelated_and_fall(encoder, rng):
    images = rng.normal(size=(40, 16, 16))
    fitted = encoder(5).fit(images)
    covariance = np.cov(fitted.transform(images).T)
    variances = np.diag(covariance)
    # Rounding of products of about 40 touches.
    assert_allclose(covariance, np.diag(variances), atol=1e-10 * variances[0])
    assert (np.diff(variances) < 0).all()
    total = fitted.first_.transform(images).var(axis=0, ddof=1).sum()
    assert_allclose(variances / total, fitted.explained_variance_ratio_)


@pytest.mark.parametrize("encoder", [OrientedPCA, ZernikePCA])
def test_components_are_as_many_as_asked_or_as_touches_or_as_hold_the_share(
    encoder, rng
):
    images = rng.normal(size=(12, 16, 16))
    whole = encoder(None).fit(images)
    # Twelve touches about their mean span eleven directions; the twelfth is empty.
    assert whole.n_components_ == 12
    assert encoder(500).fit(images).n_components_ == 12
    share = encoder(0.6).fit(images)
    kept = whole.explained_variance_ratio_.cumsum()
    assert share.n_components_ == (kept < 0.6).sum() + 1
    for value, message in ((0, "at least 1"), (1.5, "between 0"), (1.0, "below 1")):
        with pytest.raises(ValueError, match=f"n_components must be .*{message}"):
            encoder(value).fit(images)


@pytest.mark.parametrize("encoder", [OrientedPCA, ZernikePCA])
@pytest.mark.parametrize("scale", [1e-300, 1e-170, 1e170, 1e300])
def test_components_do_not_depend_on_the_size_of_levels(encoder, scale, rng):
    images = rng.normal(size=(12, 16, 16))
    plain, scaled = encoder().fit(images), encoder().fit(scale * images)
    assert scaled.n_components_ == plain.n_components_ > 1
    # Rounding of scaled levels, times the condition of the small eigenvalues.
    shares = scaled.explained_variance_ratio_
    assert_allclose(shares, plain.explained_variance_ratio_, rtol=1e-9)
    expected = scale * np.abs(plain.transform(images))
    scores = np.abs(scaled.transform(scale * images))
    assert_allclose(scores, expected, rtol=0, atol=1e-8 * expected.max())


@pytest.mark.parametrize("name", KINDS)
def test_every_name_makes_an_encoder_with_that_many_features(name, rng):
    images = blobs(rng, n=8, size=24)
    few = encoder_named(name, 4).fit_transform(images)
    assert few.shape == (8, 4)
    pytest.importorskip("pandas")
    with config_context(transform_output="pandas"):
        in_frames = encoder_named(name, 4).fit_transform(images)
    assert_array_equal(np.asarray(in_frames), few)
    encoder = encoder_named(name)
    assert type(encoder) is KINDS[name]
    assert len(encoder.fit_transform(images)) == 8


def test_fewer_components_are_the_first_of_more(rng):
    images = blobs(rng, n=8, size=24)
    for name in set(KINDS) - {"scaled-pixels"}:
        few, more = (encoder_named(name, n).fit_transform(images) for n in (2, 5))
        # The same sums, in products of other sizes.
        assert_allclose(few, more[:, :2], rtol=1e-9, atol=1e-12)


def test_names_joined_by_plus_are_a_union(rng):
    images = blobs(rng, n=8, size=24)
    both = encoder_named("hu + zernike", 3)
    assert isinstance(both, EncodingUnion)
    parts = [encoder_named(name, 3).fit_transform(images) for name in ("hu", "zernike")]
    assert_array_equal(both.fit_transform(images), np.hstack(parts))


def test_one_number_holds_for_each_part_of_a_union_as_far_as_it_can(rng):
    images = blobs(rng, n=12, size=24)

    def sizes(name, n_components):
        union = encoder_named(name, n_components).fit(images)
        return [part.transform(images).shape[1] for part in union.encoders_]

    assert sizes("hu+zernike-pca", 8) == [7, 8]
    assert sizes("hu+scaled-pixels", 10) == [7, 9]
    assert sizes("zernike-pca+scaled-pixels", 400) == [12, 169]
    shares = ZernikePCA(0.6).fit(images).n_components_
    assert sizes("hu+zernike-pca", 0.6) == [7, shares]
    # Or there is one for each part.
    union = encoder_named("hu+zernike-pca+scaled-pixels", (3, 5, None))
    assert [p.n_components for p in union.encoders[:2]] == [3, 5]
    assert union.fit_transform(images).shape == (12, 3 + 5 + 169)
    with pytest.raises(ValueError, match=r"one number for each of hu.zernike, got 1"):
        encoder_named("hu+zernike", (3,))


@pytest.mark.parametrize("balanced", [False, True])
def test_a_union_refuses_complex_features(balanced, rng):
    encoders = [HuMoments(), ZernikeMoments(output="complex")]
    with pytest.raises(
        ValueError, match=r"complex ones of ZernikeMoments.*real output"
    ):
        EncodingUnion(encoders, balanced=balanced).fit(blobs(rng, size=24))


@pytest.mark.parametrize(
    ("encoder", "message"),
    [
        (EncodingUnion(["hu"]), "encoders must be .* got 'hu'. Pass one"),
        (EncodingUnion("hu"), "encoders must be a list of encoders, got 'hu'"),
        (EncodingUnion(None), "encoders must be a list of encoders, got None"),
        (EncodingUnion([HuMoments]), "got <class .*HuMoments"),
        (EncodingUnion([None]), "encoders must be .* got None. Pass one"),
    ],
)
def test_what_is_no_encoder_is_refused(encoder, message):
    with pytest.raises(TypeError, match=message):
        encoder.fit(np.zeros((2, 8, 8)))


def test_options_reach_the_encoder():
    encoder = encoder_named("zernike", 5, order=4, output="noll")
    assert isinstance(encoder[0], ZernikeMoments)
    assert (encoder[0].order, encoder[0].output) == (4, "noll")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("zernicke",),
            f"name must be one of {', '.join(map(repr, KINDS))}, or .*'zernicke'",
        ),
        (("hu+",), "got 'hu\\+'"),
        (("scaled-pixels", 5), "square number .*got 5. Use 4 or 9"),
        (("zernike", 0), "n_components must be at least 1, got 0"),
        (("hu+zernike", 0), "n_components must be at least 1, got 0"),
        (("hu+zernike-pca", 1.5), "n_components must be .*between 0"),
    ],
)
def test_wrong_names_and_counts_say_what_is_right(arguments, message):
    with pytest.raises(ValueError, match=message):
        encoder_named(*arguments)
