"""Rules that every public estimator of images keeps.

scikit-learn's own checks cover estimators of feature vectors; they decline
estimators of images (3-D arrays), so those get the checks below.
"""

import pickle
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from palpate.encodings import (
    CentroidMoments,
    EdgeHistograms,
    EncodingUnion,
    FourierDescriptors,
    GridLevels,
    HuMoments,
    OrientedPCA,
    PadShapes,
    PolarGradients,
    RingPatterns,
    RingQuantiles,
    RootScaler,
    ScaledPixels,
    ShapeGeometry,
    TaxelVector,
    ZernikeMoments,
    ZernikePCA,
)
from palpate.images import (
    ArrayCleanUp,
    DerivativeMagnitude,
    DomeCrop,
    OrientationRegulariser,
    PressPose,
)

ENCODERS = [
    CentroidMoments(),
    EdgeHistograms(),
    FourierDescriptors(),
    ShapeGeometry(),
    ShapeGeometry("outer"),
    TaxelVector(),
    EncodingUnion([ShapeGeometry(), ZernikeMoments(order=4)]),
    EncodingUnion([ShapeGeometry(), ZernikeMoments(order=4)], balanced=True),
    ZernikeMoments(),
    ZernikeMoments(output="noll", method="sample"),
    GridLevels(),
    GridLevels(4, blur=0.7, root=False, unit=True),
    GridLevels(spectrum=True, pads=[[0, 0, 4, 10], [5, 0, 5, 6]]),
    HuMoments(),
    HuMoments(levels="raw", log=True),
    OrientedPCA(),
    PadShapes(),
    PadShapes([[0, 0, 4, 10], [5, 0, 5, 6]]),
    PolarGradients(n_rings=3, n_harmonics=4),
    RingPatterns(),
    RingQuantiles(),
    ScaledPixels(),
    ScaledPixels(4, min_anisotropy=None),
    ZernikePCA(),
]
CLEANERS = [ArrayCleanUp(), DerivativeMagnitude(), DomeCrop(), OrientationRegulariser()]
encoders = pytest.mark.parametrize("encoder", ENCODERS, ids=repr)
image_estimators = pytest.mark.parametrize("encoder", [*ENCODERS, *CLEANERS], ids=repr)


@encoders
def test_one_finite_row_per_touch(encoder, touches):
    features = clone(encoder).fit(touches).transform(touches)
    assert features.shape[0] == len(touches)
    assert features.ndim == 2
    assert np.isfinite(features).all()


@image_estimators
def test_touch_is_encoded_alone(encoder, touches):
    fitted = clone(encoder).fit(touches)
    together = fitted.transform(touches)
    alone = np.concatenate([fitted.transform(t[np.newaxis]) for t in touches])
    # One row and many go through different BLAS kernels: rounding only.
    assert_allclose(alone, together, rtol=1e-12, atol=1e-12)
    assert_array_equal(fitted.transform(touches), together)


@image_estimators
def test_learning_at_once_or_anew_is_learning(encoder, touches):
    expected = clone(encoder).fit(touches).transform(touches)
    assert_array_equal(clone(encoder).fit_transform(touches), expected)
    anew = clone(encoder).fit(touches[::-2]).fit(touches)
    assert_array_equal(anew.transform(touches), expected)


learnt_from_one = pytest.mark.parametrize(
    "encoder",
    [e for e in [*ENCODERS, *CLEANERS] if not isinstance(e, OrientedPCA | ZernikePCA)],
    ids=repr,
)


@learnt_from_one
def test_one_touch_is_enough_to_learn_from(encoder, touches):
    assert len(clone(encoder).fit_transform(touches[:1].tolist())) == 1


@image_estimators
@pytest.mark.parametrize(
    "dtype", [np.float64, ">f4", np.float32, np.int16, np.uint8, bool]
)
def test_checked_images_of_any_type_are_transformed_alike(encoder, dtype, touches):
    levels = (200 * touches.clip(0)).astype(dtype)
    fitted = clone(encoder).fit(levels)
    transformed = fitted.transform(levels)
    assert_array_equal(fitted.transform_checked(levels), transformed)
    # The same sums of the same numbers; Hu's are in the precision of the images.
    rtol = 1e-5 if isinstance(encoder, HuMoments) else 1e-12
    assert_allclose(transformed, fitted.transform(levels.astype(float)), rtol=rtol)


@image_estimators
def test_pickle_and_model_file_keep_the_encoding(encoder, touches, reread):
    fitted = clone(encoder).fit(touches)
    expected = fitted.transform(touches)
    again = pickle.loads(pickle.dumps(fitted))
    assert_array_equal(again.transform(touches), expected)
    assert_array_equal(reread(fitted).transform(touches), expected)


@image_estimators
def test_input_is_left_alone(encoder, touches):
    before = touches.copy()
    clone(encoder).fit(touches).transform(touches)
    assert_array_equal(touches, before)


@image_estimators
def test_blank_touches_have_a_defined_result(encoder, touches):
    fitted = clone(encoder).fit(touches)
    for blank in (np.zeros_like(touches[:2]), np.full_like(touches[:2], 7)):
        assert np.isfinite(fitted.transform(blank)).all()


@image_estimators
def test_errors_say_what_to_do(encoder, touches):
    with pytest.raises(NotFittedError):
        clone(encoder).transform(touches)
    with pytest.raises(ValueError, match=r"X\[np.newaxis\]"):
        clone(encoder).fit(touches[0])
    learnt = clone(encoder).fit(touches)
    before = learnt.transform(touches)
    with pytest.raises(ValueError, match="fitted on 10 x 10"):
        learnt.transform(touches[:, :8])
    if isinstance(encoder, OrientedPCA | ZernikePCA):  # others learn from any touches
        with pytest.raises(ValueError, match="touches that differ"):
            learnt.fit(np.ones((3, 8, 8)))
    assert_array_equal(learnt.transform(touches), before)
    spoilt = touches.copy()
    spoilt[3, 0, 0] = np.inf
    with pytest.raises(ValueError, match="touch 3"):
        clone(encoder).fit(spoilt)


@image_estimators
def test_text_and_empty_sets_are_refused(encoder):
    for odd in (np.array([[["a"]]]), np.ones((1, 4, 4), complex)):
        with pytest.raises(TypeError, match="must be numbers"):
            clone(encoder).fit(odd)
    with pytest.raises(ValueError, match="at least one touch"):
        clone(encoder).fit(np.zeros((0, 4, 4)))


@pytest.mark.parametrize(
    ("encoder", "error", "message"),
    [
        (ArrayCleanUp(output="edges"), ValueError, "output must be one of"),
        (ArrayCleanUp(gamma=0), ValueError, "gamma must be positive"),
        (ArrayCleanUp(n_sd=-1), ValueError, "n_sd must be positive"),
        (ArrayCleanUp((10, 10), n_partitions=11), ValueError, "at most 10, got 11"),
        (ArrayCleanUp(n_partitions=0), ValueError, "n_partitions .* at least 1"),
        (ArrayCleanUp(n_partitions=1.5), TypeError, "n_partitions .*integer"),
        (ArrayCleanUp(min_contrast=2), ValueError, "between 0 and 1"),
        (CentroidMoments(-1), ValueError, "order must be at least 0"),
        (CentroidMoments(21), ValueError, "order must be at most 20"),
        (CentroidMoments(width=0), ValueError, "width must be positive"),
        (CentroidMoments(normalise="max"), ValueError, "normalise must be one of"),
        (CentroidMoments(centre_power=-1), ValueError, "centre_power must be positive"),
        (DomeCrop(missing="guess"), ValueError, "missing must be one of"),
        (DomeCrop(output="raw"), ValueError, "output must be one of"),
        (DomeCrop(margin=0.6), ValueError, "margin must be finite and between"),
        (DomeCrop(size=0), ValueError, "size must be at least 1"),
        (DomeCrop(size=12.5), TypeError, "size must be an integer"),
        (DerivativeMagnitude("all"), ValueError, "region must be one of 'frame', 'di"),
        (EdgeHistograms(0), ValueError, "n_orientations must be at least 1"),
        (EdgeHistograms(cell=17), ValueError, "cell must be at most 16, got 17"),
        (FourierDescriptors(0), ValueError, "n must be at least 1"),
        (FourierDescriptors(2.5), TypeError, "n must be an integer"),
        (FourierDescriptors(resample=2), ValueError, "resample must be at least 3"),
        (GridLevels(0), ValueError, "cells must be at least 1, got 0"),
        (GridLevels(blur=-1), ValueError, "blur must be finite and between 0"),
        (GridLevels(root="no"), ValueError, "root must be .* False, True, got 'no'"),
        (GridLevels(spectrum=3), ValueError, "spectrum must be .* True, got 3"),
        (GridLevels(pads=[[0, 0, 99, 4]]), ValueError, r"got \[0, 0, 99, 4\]"),
        (HuMoments(8), ValueError, "at most 7, got 8"),
        (OrientationRegulariser(2), ValueError, "min_anisotropy must be .*between 0"),
        (PadShapes([1, 2, 3, 4]), ValueError, r"shape \(n_pads, 4\).* shape \(4,\)"),
        (PadShapes([[0, 0, 2.5, 1]]), ValueError, "must be integers .* got float64"),
        (PadShapes([[0, 0, 4, 4], [5, 5, 6, 5]]), ValueError, r"got \[5, 5, 6, 5\]"),
        (PadShapes(np.empty((0, 4), int)), ValueError, "got none"),
        (PadShapes(np.uint8([[250, 0, 10, 4]])), ValueError, r"got \[250, 0, 10, 4\]"),
        (RingPatterns(17), ValueError, "n_rings must be at most 16, got 17"),
        (RingPatterns(radii=()), ValueError, "at least one radius, got none"),
        (RingPatterns(radii=(2, 30)), ValueError, "radii must be .* 25, got 30"),
        (RingPatterns(n_points=3), ValueError, "n_points must be .* got 3"),
        (RingQuantiles(n_quantiles=1.5), TypeError, "n_quantiles must be an integer"),
        (ShapeGeometry("inner"), ValueError, "edges must be one of 'all', 'outer'"),
        (ZernikeMoments(-1), ValueError, "order must be at least 0, got -1"),
        (ZernikeMoments(101), ValueError, "order must be at most 100, got 101"),
        (ZernikeMoments(2.5), TypeError, "order must be an integer, got float"),
        (ZernikeMoments(0, drop_constant=True), ValueError, "at least 1, got 0"),
        (ZernikeMoments(method="fast"), ValueError, "method must be .*'exact', 'sam"),
        (ZernikeMoments(output="real"), ValueError, "output must be one of 'abs'"),
        (ZernikeMoments(weight="n"), ValueError, r"weight must be one of 'n\+1'"),
        (ZernikeMoments(disc="outer"), ValueError, "disc must be one of 'inscribed'"),
        (ZernikeMoments(radius=0), ValueError, "radius must be positive"),
        (ZernikeMoments(radius=np.nan), ValueError, "radius must be .* and finite"),
        (ZernikeMoments(centre=5.0), ValueError, r"centre must be a pair \(row, col\)"),
        (ZernikeMoments(centre=(1, 2, 3)), ValueError, r"centre must be a pair \(row"),
        (ZernikeMoments(centre=(np.inf, 2)), ValueError, r"centre\[0\] must be finite"),
        (ZernikeMoments(centre=(50, 4)), ValueError, "10 x 10 frame in it"),
        (
            ZernikeMoments(method="sample", radius=0.3),
            ValueError,
            r"centre \(4.5, 4.5\) and radius 0.3",
        ),
        (
            ZernikeMoments(output="noll", repeat_negative=True),
            ValueError,
            "repeat_negative must be False",
        ),
        (ZernikePCA(output="complex"), ValueError, "output must be one of 'abs', 'nol"),
    ],
)
def test_bad_parameters_are_refused_at_fit(encoder, error, message, touches):
    with pytest.raises(error, match=message):
        encoder.fit(touches)


def changes_of(encoder, before, after):
    """Return how far images move in an encoding, as a share of their spread."""
    fitted = clone(encoder).fit(before)
    features, moved = fitted.transform(before), fitted.transform(after)
    spread = np.linalg.norm(features - features.mean(axis=0), axis=1).mean()
    return np.linalg.norm(features - moved, axis=1).mean() / spread


# A quarter turn and a whole taxel resample nothing.
ALTERED = {
    "turns": lambda images: np.rot90(images, axes=(1, 2)),
    "shifts": lambda images: np.roll(images, (1, 2), axis=(1, 2)),
    "gain": lambda images: 2 * images,
}


# An unbalanced union is left out: its small moments count for nothing beside an area
# in taxels. So are pads, which lie beside the pressed region here.
comparable = [
    e
    for e in ENCODERS
    if getattr(e, "balanced", True) and getattr(e, "pads", None) is None
]


@pytest.mark.parametrize("encoder", comparable, ids=repr)
@pytest.mark.parametrize("change", ALTERED)
def test_an_encoder_is_blind_to_the_changes_that_it_names(encoder, change, touches):
    pressed = np.pad(np.where(touches > 0.3, touches, 0), [(0, 0), (6, 6), (6, 6)])
    moved = changes_of(encoder, pressed, ALTERED[change](pressed))
    # Interpolation moves images of 22 x 22 taxels by up to 0.16 where they are turned.
    assert (moved < 0.2) == (change in encoder.blind_to)


NAMING = [e for e in ENCODERS if hasattr(e, "get_feature_names_out")]


@encoders
def test_frames_for_all_of_scikit_learn_change_no_number(encoder, touches):
    pytest.importorskip("pandas")
    alone = clone(encoder).fit(touches).transform(touches)
    with config_context(transform_output="pandas"):
        in_frames = clone(encoder).fit(touches).transform(touches)
    assert_array_equal(np.asarray(in_frames), alone)


@pytest.mark.parametrize("encoder", NAMING, ids=repr)
def test_every_column_has_a_name_of_its_own(encoder, touches):
    colour = np.stack([touches, touches[::-1] ** 2, 3 * touches], axis=-1)
    for images in (touches, colour):
        fitted = clone(encoder).fit(images)
        names = fitted.get_feature_names_out().tolist()
        assert len({*names}) == len(names) == fitted.transform(images).shape[1]
    with pytest.raises(NotFittedError):
        clone(encoder).get_feature_names_out()


COLOUR = [e for e in [*ENCODERS, *CLEANERS] if not isinstance(e, DomeCrop)]


@pytest.mark.parametrize("encoder", COLOUR, ids=repr)
def test_channels_are_transformed_one_by_one(encoder, touches):
    """An encoder learns from all channels as if they were touches."""
    colour = np.stack([touches, touches[::-1] ** 2, 3 * touches], axis=-1)
    fitted = clone(encoder).fit(colour)
    assert fitted.image_shape_ == (10, 10, 3)
    transformed = fitted.transform(colour)
    assert_array_equal(fitted.transform_checked(colour), transformed)
    if isinstance(encoder, EncodingUnion):
        parts = [clone(part).fit_transform(colour) for part in encoder.encoders]
        expected = np.hstack(parts)
        if encoder.balanced:
            expected = np.hstack([RootScaler().fit_transform(p) for p in parts])
    else:
        planes = np.concatenate(np.split(colour, 3, axis=-1))[..., 0]
        grey = clone(encoder)
        if getattr(encoder, "unit", False):
            grey.set_params(unit=False)
        by_channel = np.split(grey.fit(planes).transform(planes), 3)
        joined = np.hstack if transformed.ndim == 2 else partial(np.stack, axis=-1)
        expected = joined(by_channel)
        if getattr(encoder, "unit", False):
            expected = expected / np.linalg.norm(expected, axis=1, keepdims=True)
    # The touches are in another order: rounding only.
    assert_allclose(transformed, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("encoder", COLOUR, ids=repr)
def test_channels_other_than_learnt_are_refused(encoder, touches):
    colour = np.stack([touches, touches], axis=-1)
    fitted = clone(encoder).fit(colour)
    with pytest.raises(ValueError, match=r"10 x 10 taxels, .* fitted on 10 x 10 x 2"):
        fitted.transform(touches)
    with pytest.raises(ValueError, match=r"10 x 10 x 1 taxels, .* fitted on 10 x 10 x"):
        fitted.transform(colour[..., :1])
    colour[3, 0, 0, 1] = np.inf
    with pytest.raises(ValueError, match=r"touch 3 \(1 of 12"):
        fitted.transform(colour)


def test_a_crop_of_grey_images_refuses_channels_and_says_how_to_make_grey(touches):
    with pytest.raises(ValueError, match=r"one channel, X\[..., 0\], or their mean"):
        DomeCrop().fit(touches[..., np.newaxis])


def test_press_pose_keeps_the_rules(touches):
    assert PressPose().__sklearn_tags__().input_tags.three_d_array
    labels = np.arange(len(touches)) % 2
    before = touches.copy()
    pose = clone(PressPose(symmetry=2)).fit(touches, labels)
    assert_array_equal(touches, before)
    again = pickle.loads(pickle.dumps(pose))
    for name in ("x_mm", "y_mm", "angle_deg", "sd_mm", "sd_deg"):
        values = getattr(pose.estimate(touches, labels), name)
        assert_array_equal(getattr(again.estimate(touches, labels), name), values)
    with pytest.raises(ValueError, match=r"X\[np.newaxis\]"):
        PressPose().fit(touches[0], labels)
