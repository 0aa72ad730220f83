"""Zernike moments as an estimator: columns, types of images, batches, refusals."""

import pickle
import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone

from palpate.encodings import ZernikeMoments

METHODS = pytest.mark.parametrize("method", ["exact", "sample"])


@METHODS
def test_all_outputs_and_weights_come_from_one_set_of_moments(method, touches):
    def encode(**options):
        return ZernikeMoments(7, method=method, **options).fit_transform(touches)

    values, plain = encode(output="complex"), encode(output="complex", weight="none")
    half = ZernikeMoments(7).fit(touches).indices_.tolist()
    n, m = np.array(half).T
    # Rounding of sums of a hundred numbers of order 1.
    close = {"rtol": 0, "atol": 1e-14}
    assert_allclose(values, plain * (n + 1) / np.pi, **close)
    assert_allclose(encode(), np.abs(values), **close)
    degrees = ZernikeMoments(7, output="noll").fit(touches).indices_.tolist()
    pairs = [half.index([n, abs(m)]) for n, m in degrees]
    sine = np.array([m < 0 for _, m in degrees])
    noll = np.where(sine, -values.imag[:, pairs], values.real[:, pairs])
    assert_allclose(encode(output="noll"), noll, **close)
    assert_allclose(encode(output="noll_abs"), np.abs(noll), **close)
    factor = np.sqrt((n + 1) * np.where(m > 0, 2, 1)) / np.pi
    assert_allclose(
        encode(output="complex", weight="noll"), plain * factor, rtol=0, atol=1e-14
    )


def test_columns_are_named_and_counted(touches):
    half = ZernikeMoments().fit(touches)
    both = ZernikeMoments(repeat_negative=True).fit(touches)
    assert half.transform(touches).shape == (12, 72)
    assert both.transform(touches).shape == (12, 136)
    assert ZernikeMoments(output="noll").fit_transform(touches).shape == (12, 136)
    assert half.indices_[:4].tolist() == [[0, 0], [1, 1], [2, 0], [2, 2]]
    assert both.indices_[:4].tolist() == [[0, 0], [1, -1], [1, 1], [2, -2]]
    assert half.get_feature_names_out()[3] == "zernike2,2"
    dropped = ZernikeMoments(drop_constant=True).fit(touches)
    assert_array_equal(dropped.indices_, half.indices_[1:])
    assert_array_equal(dropped.transform(touches), half.transform(touches)[:, 1:])


@pytest.mark.parametrize("shape", [(24, 24), (24, 31)])
def test_single_precision_is_close(shape, rng):
    images = rng.normal(size=(70, *shape))
    double = ZernikeMoments(23).fit_transform(images)
    single = ZernikeMoments(23, precision="single").fit_transform(images)
    assert_allclose(single, double, rtol=0, atol=2e-6 * double.max())
    assert not np.array_equal(single, double)


def test_negative_m_repeat_magnitudes_and_conjugate_moments(touches):
    encoder = ZernikeMoments(6, repeat_negative=True)
    sizes = encoder.fit_transform(touches)
    values = clone(encoder).set_params(output="complex").fit_transform(touches)
    mirror = [encoder.indices_.tolist().index([n, -m]) for n, m in encoder.indices_]
    assert_array_equal(sizes, sizes[:, mirror])
    assert_array_equal(values, values[:, mirror].conj())
    assert_allclose(sizes, np.abs(values), rtol=1e-14)  # one more rounding


def test_the_default_disc_is_inscribed_to_the_outer_edge(touches):
    wide = np.concatenate([touches, touches], axis=2)
    default = ZernikeMoments().fit(wide)
    assert default.centre_ == (4.5, 9.5)
    assert default.radius_ == 5
    explicit = ZernikeMoments(centre=(4.5, 9.5), radius=5).fit_transform(wide)
    assert_array_equal(default.transform(wide), explicit)
    around = ZernikeMoments(disc="circumscribed").fit(wide)
    assert_allclose(around.radius_, np.hypot(5, 10))


@METHODS
@pytest.mark.parametrize("order", [15, 21])
def test_a_touch_is_encoded_alone(method, order, rng):
    images = rng.normal(size=(70, 20, 20))
    encoder = ZernikeMoments(order, method=method).fit(images)
    alone = np.vstack([encoder.transform(image[np.newaxis]) for image in images])
    # The order of sums in products of different sizes.
    assert_allclose(alone, encoder.transform(images), rtol=1e-12, atol=1e-12)


def test_views_of_any_stride_are_encoded(rng):
    images = rng.normal(size=(4, 24, 24))
    encoder = ZernikeMoments().fit(images)
    for view in (images[:, ::-1], images.transpose(0, 2, 1), images[::2]):
        assert_array_equal(
            encoder.transform(view), encoder.transform(np.ascontiguousarray(view))
        )


def test_a_large_batch_is_converted_in_blocks(rng):
    images = rng.integers(0, 256, size=(600, 150, 150), dtype=np.uint8)
    encoder = ZernikeMoments().fit(images)
    encoder.transform(images[:1])
    tracemalloc.start()
    encoder.transform(images)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < images.nbytes  # as float64 the images alone are eight times that


@pytest.mark.parametrize("order", [15, 21])
def test_pickle_keeps_the_encoding_and_stays_small(order, touches):
    fitted = ZernikeMoments(order, centre=(4.2, 4.9)).fit(touches)
    stored = pickle.dumps(fitted)
    assert len(stored) < 10_000  # tables are rebuilt, not stored
    assert_array_equal(
        pickle.loads(stored).transform(touches), fitted.transform(touches)
    )


def test_an_empty_press_is_encoded_by_zeros():
    assert_array_equal(ZernikeMoments().fit_transform(np.zeros((2, 8, 8))), 0)


@pytest.mark.parametrize("level", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [(6, 5), (0, 0)], ids=["inside", "outside the disc"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("order", [15, 21])
def test_nan_and_infinity_are_refused(level, place, dtype, order, touches):
    encoder = ZernikeMoments(order).fit(touches)
    broken = touches.astype(dtype)
    broken[(3, *place)] = level
    with pytest.raises(ValueError, match=r"NaN or infinity in touch 3 \(1 of 12"):
        encoder.transform(broken)
    with pytest.raises(ValueError, match=r"NaN or infinity in touch 3 \(1 of 12"):
        encoder.fit(broken)


def test_sums_beyond_float64_are_refused():
    with pytest.raises(ValueError, match="Divide them by a constant"):
        ZernikeMoments().fit_transform(np.full((1, 10, 10), 1e308))
