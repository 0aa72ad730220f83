"""Rules that every public estimator of images keeps.

scikit-learn's own checks cover estimators of feature vectors; they decline
estimators of images (3-D arrays), so those get the checks below.
"""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from palpate.encodings import (
    CentroidMoments,
    EncodingUnion,
    FourierDescriptors,
    HuMoments,
    OrientedPCA,
    PolarGradients,
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
)
from palpate.recognition import read_model, write_model

ENCODERS = [
    CentroidMoments(),
    FourierDescriptors(),
    ShapeGeometry(),
    TaxelVector(),
    EncodingUnion([ShapeGeometry(), ZernikeMoments(order=4)]),
    EncodingUnion([ShapeGeometry(), ZernikeMoments(order=4)], balanced=True),
    ZernikeMoments(),
    ZernikeMoments(output="noll", method="sample"),
    HuMoments(),
    HuMoments(levels="raw", log=True),
    OrientedPCA(),
    PolarGradients(n_rings=3, n_harmonics=4),
    ScaledPixels(),
    ScaledPixels(4, min_anisotropy=None),
    ZernikePCA(),
]
CLEANERS = [
    ArrayCleanUp(),
    DerivativeMagnitude(),
    DomeCrop(),
    OrientationRegulariser(),
]
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


@image_estimators
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int16, np.uint8])
def test_checked_images_of_any_type_are_transformed_alike(encoder, dtype, touches):
    levels = (200 * touches.clip(0)).astype(dtype)
    fitted = clone(encoder).fit(levels)
    assert_array_equal(fitted.transform_checked(levels), fitted.transform(levels))


@image_estimators
def test_pickle_and_model_file_keep_the_encoding(encoder, touches, tmp_path):
    fitted = clone(encoder).fit(touches)
    expected = fitted.transform(touches)
    again = pickle.loads(pickle.dumps(fitted))
    assert_array_equal(again.transform(touches), expected)
    stored = write_model(tmp_path / "e.palpate", fitted)
    read = read_model(stored, type(fitted))
    assert_array_equal(read.transform(touches), expected)


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
    with pytest.raises(ValueError, match="fitted on 10 x 10"):
        clone(encoder).fit(touches).transform(touches[:, :8])
    spoilt = touches.copy()
    spoilt[3, 0, 0] = np.inf
    with pytest.raises(ValueError, match="touch 3"):
        clone(encoder).fit(spoilt)


@image_estimators
def test_text_and_empty_sets_are_refused(encoder):
    with pytest.raises(TypeError, match="must be numbers"):
        clone(encoder).fit(np.array([[["a"]]]))
    with pytest.raises(ValueError, match="at least one touch"):
        clone(encoder).fit(np.zeros((0, 4, 4)))
