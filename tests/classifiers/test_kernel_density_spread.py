"""Kernel density where spreads are zero, too few, or beyond all measure."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

from palpate.classifiers import KernelDensityBayes

each_bandwidth = pytest.mark.parametrize("bandwidth", ["pooled", "per-object", "full"])


@pytest.fixture
def learnt(rng):
    return rng.normal(size=(300, 22)), np.arange(300) % 7


@pytest.fixture
def new_touches(rng):
    return rng.normal(size=(70, 22))


@each_bandwidth
def test_features_that_never_vary_are_ignored(bandwidth, learnt, new_touches):
    touches, labels = learnt
    # 0.1 has no exact binary form: its mean is off by rounding.
    padded = np.c_[np.full(len(touches), 0.1), touches, np.zeros(len(touches))]
    model = KernelDensityBayes(bandwidth).fit(padded, labels)
    assert_array_equal(np.flatnonzero(~model.varies_), [0, 23])
    elsewhere = np.c_[np.full(70, 7.0), new_touches, np.full(70, -1e9)]
    plain = KernelDensityBayes(bandwidth).fit(touches, labels)
    assert_array_equal(
        model.log_likelihood(elsewhere), plain.log_likelihood(new_touches)
    )


@each_bandwidth
def test_equal_touches_say_nothing(bandwidth):
    labels = ["a", "b", "b"]
    model = KernelDensityBayes(bandwidth, prior="counts").fit(np.ones((3, 4)), labels)
    assert_array_equal(model.log_likelihood([[1, 2, 3, 4], [1, 1, 1, 1]]), 0)
    assert_allclose(model.predict_proba([[5, 5, 5, 5]]), [[1 / 3, 2 / 3]])
    assert_array_equal(model.left_out_log_likelihood()[1:], 0)


def test_repeated_features_and_too_few_touches_lose_directions():
    rng = np.random.default_rng(6)
    few = rng.normal(size=(5, 8))
    assert KernelDensityBayes("full").fit(few, [0, 0, 0, 1, 1]).points_.shape == (5, 4)
    touches, labels = rng.normal(size=(40, 3)), np.arange(40) % 2
    new = rng.normal(size=(9, 3))
    repeated = KernelDensityBayes("full").fit(np.c_[touches, touches], labels)
    plain = KernelDensityBayes("full").fit(touches, labels)
    assert repeated.points_.shape == (40, 3)
    # Only the volume element differs, by the same constant for every object.
    assert_allclose(
        repeated.predict_proba(np.c_[new, new]), plain.predict_proba(new), atol=1e-9
    )


def test_an_object_touched_once_takes_the_pooled_variances():
    touches, labels = [[0.0, 0.0], [1.0, 2.0], [3.0, 1.0]], ["once", "twice", "twice"]
    own = KernelDensityBayes("per-object").fit(touches, labels)
    pooled = KernelDensityBayes("pooled").fit(touches, labels)
    new = [[0.5, 0.5], [9.0, -9.0]]
    found = own.log_likelihood(new)
    assert_allclose(found[:, 0], pooled.log_likelihood(new)[:, 0], rtol=1e-12)
    assert (found[:, 1] != pooled.log_likelihood(new)[:, 1]).all()


def test_variances_of_an_object_have_a_floor():
    # The first object does not vary in the first feature, the second in neither.
    touches = np.array([[2.0, 0.0], [2.0, 1.0], [5.0, 4.0], [5.0, 4.0], [7.0, 3.0]])
    labels = ["a", "a", "b", "b", "c"]
    model = KernelDensityBayes("per-object", min_variance=0.01).fit(touches, labels)
    pooled = touches.var(axis=0, ddof=1)
    at_a = norm.logpdf(0, 0, np.sqrt(0.01 * pooled[0]))
    sd_a = np.sqrt(0.5)  # unbiased, of 0 and 1
    at_a += norm.logpdf(0.5, 0, sd_a)
    at_b = norm.logpdf(0, 0, np.sqrt(0.01 * pooled)).sum()
    found = model.log_likelihood([[2.0, 0.5], [5.0, 4.0]])
    assert_allclose([found[0, 0], found[1, 1]], [at_a, at_b], rtol=1e-12)


@each_bandwidth
def test_absurd_touches_get_finite_answers(bandwidth, learnt):
    model = KernelDensityBayes(bandwidth).fit(*learnt)
    absurd = np.full((2, 22), 1e308) * [[1], [-1]]
    assert np.isfinite(model.log_likelihood(absurd)).all()
    assert np.isfinite(model.predict_proba(absurd)).all()


def test_variances_that_overflow_are_refused():
    with pytest.raises(ValueError, match="variances below 1e308"):
        KernelDensityBayes().fit([[1e300], [-1e300]], [0, 1])
