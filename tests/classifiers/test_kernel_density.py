"""The kernel density classifier against densities written out slowly in float64."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from palpate.classifiers import KernelDensityBayes

BANDWIDTHS = ["pooled", "per-object", "full"]
# Rounding of float32 products of a few dozen numbers of size ten, in nats.
SINGLE = 1e-4
# float64: sums and Cholesky factors of 22 features.
DOUBLE = 1e-9

each_bandwidth = pytest.mark.parametrize("bandwidth", BANDWIDTHS)


@pytest.fixture(scope="module")
def learnt():
    """Ten objects, 31 to 40 touches each, 22 correlated features far from zero."""
    rng = np.random.default_rng(1)
    counts = np.arange(31, 41)
    labels = np.repeat([f"thing {i}" for i in range(10)], counts)
    mixing = rng.normal(size=(22, 22))
    centres = np.repeat(rng.normal(size=(10, 22)), counts, axis=0)
    touches = (centres + rng.standard_t(4, size=centres.shape)) @ mixing
    touches = touches * np.logspace(-3, 3, 22) + 5000.0
    mixed = rng.permutation(len(labels))
    return touches[mixed], labels[mixed]


@pytest.fixture(scope="module")
def new_touches(learnt):
    noise = np.random.default_rng(2).normal(size=learnt[0][:70].shape)
    return learnt[0][:70] + 0.2 * learnt[0].std(axis=0) * noise


def slow_log_likelihood(model, touches, labels, new, *, spread=None, kept=None):
    """The definition, object by object, with scipy's normal density.

    `spread` are the touches that pooled covariances come from; `kept` of shape
    (len(new), len(touches)) says which touches each new one meets.
    """
    spread = touches if spread is None else spread
    kept = np.ones((len(new), len(touches)), bool) if kept is None else kept
    columns = []
    for name in model.classes_:
        of_object = labels == name
        if model.bandwidth == "full":
            covariance = np.cov(spread.T)
        elif model.bandwidth == "pooled":
            covariance = np.diag(spread.var(axis=0, ddof=1))
        else:
            covariance = np.diag(touches[of_object].var(axis=0, ddof=1))
        unit = model.scale * np.sqrt(np.diag(covariance))
        kernel = multivariate_normal(
            cov=covariance * model.scale**2 / np.outer(unit, unit)
        )
        differences = (new[:, np.newaxis] - touches[of_object]) / unit
        densities = kernel.logpdf(differences) - np.log(unit).sum()
        densities = densities.reshape(len(new), of_object.sum())
        densities[~kept[:, of_object]] = -np.inf
        n_met = np.maximum(kept[:, of_object].sum(axis=1), 1)
        columns.append(logsumexp(densities, axis=1) - np.log(n_met))
    return np.stack(columns, axis=1)


@each_bandwidth
@pytest.mark.parametrize("scale", [1.0, 0.3])
@pytest.mark.parametrize(
    ("precision", "error"), [("single", SINGLE), ("double", DOUBLE)]
)
def test_densities_agree_with_the_definition(
    bandwidth, scale, precision, error, learnt, new_touches
):
    model = KernelDensityBayes(bandwidth, scale=scale, precision=precision)
    log_likelihood = model.fit(*learnt).log_likelihood(new_touches)
    slow = slow_log_likelihood(model, *learnt, new_touches)
    assert log_likelihood.dtype == np.float64
    assert_allclose(log_likelihood, slow, rtol=1e-5, atol=error)


@each_bandwidth
@pytest.mark.parametrize("distance", [30, 300, 1e5])
def test_densities_hundreds_of_deviations_away_stay_exact(
    bandwidth, distance, learnt, new_touches
):
    model = KernelDensityBayes(bandwidth, precision="single").fit(*learnt)
    away = new_touches + distance * learnt[0].std(axis=0)
    slow = slow_log_likelihood(model, *learnt, away)
    log_likelihood = model.log_likelihood(away)
    assert np.isfinite(log_likelihood).all()
    # 1e-3 nats is promised; beyond 1e8 nats the digits of the covariance end first,
    # the smallest spread being 1e-6 of the size of the features.
    assert_allclose(log_likelihood, slow, rtol=1e-11, atol=1e-3)


def test_objects_far_apart_keep_finite_and_exact_likelihoods():
    rng = np.random.default_rng(0)
    here, there = rng.normal(loc=[[[0]], [[500]]], size=(2, 300, 5))
    # The spread is that of the near object alone, so the far one is 500 of it away.
    model = KernelDensityBayes(precision="single").fit(here, np.full(300, "near"))
    touches, labels = np.r_[here, there], np.repeat(["near", "far"], 300)
    model.refit(touches, labels)
    log_likelihood = model.log_likelihood(touches)
    slow = slow_log_likelihood(model, touches, labels, touches, spread=here)
    assert_allclose(log_likelihood, slow, rtol=1e-12, atol=1e-3)
    assert log_likelihood.min() < -1e5
    assert_array_equal(model.predict(touches), labels)
    assert np.isfinite(model.predict_log_proba(touches)).all()


@pytest.mark.parametrize(
    ("precision", "error"), [("single", SINGLE), ("double", DOUBLE)]
)
@pytest.mark.parametrize("n_touches", [2, 31, 32, 33, 70])
def test_a_touch_alone_is_a_touch_in_a_batch(
    n_touches, precision, error, learnt, new_touches
):
    model = KernelDensityBayes(precision=precision).fit(*learnt)
    batch = model.log_likelihood(new_touches[:n_touches])
    alone = [model.log_likelihood(touch[np.newaxis])[0] for touch in new_touches]
    # Matrix-vector and matrix-matrix products add up in different orders.
    assert_allclose(batch, alone[:n_touches], atol=error)


@each_bandwidth
@pytest.mark.parametrize("precision", ["single", "double"])
def test_learning_and_forgetting_leave_the_others_to_the_bit(
    bandwidth, precision, learnt, new_touches
):
    touches, labels = learnt
    model = KernelDensityBayes(bandwidth, precision=precision).fit(touches, labels)
    before = model.log_likelihood(new_touches)
    wild = 40 * touches[:77] - 3 * touches[100:177]
    for name, place in (("a first one", 0), ("thing 44", 5), ("zebra", 10)):
        model.refit(np.r_[touches, wild], np.r_[labels, np.full(77, name)])
        assert model.classes_[place] == name
        with_it = model.log_likelihood(new_touches)
        assert_array_equal(np.delete(with_it, place, axis=1), before)
        model.refit(touches, labels)
        assert_array_equal(model.log_likelihood(new_touches), before)
    others = labels != "thing 3"
    model.refit(touches[others], labels[others])
    assert_array_equal(model.log_likelihood(new_touches), np.delete(before, 3, axis=1))


@each_bandwidth
@pytest.mark.parametrize("grouped", [False, True])
def test_leave_one_out_is_the_mean_over_the_other_touches(bandwidth, grouped, learnt):
    fitted, labels = learnt[0][:150], learnt[1][:150]
    model = KernelDensityBayes(bandwidth, scale=0.7).fit(fitted, labels)
    extra = 1.5 * fitted[:9] - 0.5 * fitted[9:18]
    touches, labels = np.r_[fitted, extra], np.r_[labels, np.full(9, "added")]
    groups = np.arange(159) // 3 if grouped else np.arange(159)
    model.refit(touches, labels, groups if grouped else None)
    log_likelihood = model.left_out_log_likelihood()
    kept = groups[:, np.newaxis] != groups
    slow = slow_log_likelihood(
        model, touches, labels, touches, spread=fitted, kept=kept
    )
    # Covariances of 150 touches by two routes.
    assert_allclose(log_likelihood, slow, rtol=1e-8)


def test_left_out_object_without_other_touches_is_impossible():
    three = [[0.0], [1.0], [2.0]], ["a", "b", "b"]
    left_out = KernelDensityBayes().fit(*three).left_out_log_likelihood()
    assert_array_equal(np.isneginf(left_out), [[True, False], [False] * 2, [False] * 2])


def test_precision_chosen_for_few_touches_and_narrow_bandwidths(learnt):
    touches, labels = learnt
    assert KernelDensityBayes().fit(touches, labels).dtype_ == "float32"
    for n_touches, dtype in ((256, "float64"), (257, "float32")):
        few = KernelDensityBayes().fit(touches[:n_touches], labels[:n_touches])
        assert few.dtype_ == dtype
    assert KernelDensityBayes(scale=0.05).fit(touches, labels).dtype_ == "float64"


def test_no_touches_are_kept_by_reference(learnt, new_touches):
    touches = learnt[0].copy()
    model = KernelDensityBayes().fit(touches, learnt[1])
    before = model.log_likelihood(new_touches)
    touches[:] = 0
    assert_array_equal(model.log_likelihood(new_touches), before)


def test_many_touches_of_one_object_are_summed_in_blocks():
    rng = np.random.default_rng(7)
    touches = rng.normal(size=(40_000, 2))
    labels = np.repeat(["few", "many"], [10, 39_990])
    model = KernelDensityBayes(precision="single").fit(touches, labels)
    new = rng.normal(size=(64, 2))
    slow = slow_log_likelihood(model, touches, labels, new)
    assert_allclose(model.log_likelihood(new), slow, atol=SINGLE)


def test_touches_learnt_again_are_checked():
    model = KernelDensityBayes().fit([[0.0], [1.0]], ["a", "b"])
    with pytest.raises(TypeError, match="labels of one kind, got text and numbers"):
        model.refit([[0.0], [1.0], [2.0]], ["a", "b", 3])
    with pytest.raises(ValueError, match=r"2 features, but .* 1 features"):
        model.refit([[2.0, 1.0]], ["c"])
    for bad in (np.nan, np.inf, -np.inf):
        with pytest.raises(ValueError, match=r"NaN|infinity"):
            model.refit([[0.0], [bad]], ["a", "b"])
    assert_array_equal(model.predict([[0.0]]), ["a"])
    assert_array_equal(model.refit([[0.0]], ["b"]).predict([[9.0]]), ["b"])


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
    per_object = KernelDensityBayes("per-object").fit(touches, labels)
    pooled = KernelDensityBayes("pooled").fit(touches, labels)
    new = [[0.5, 0.5], [9.0, -9.0]]
    log_likelihood = per_object.log_likelihood(new)
    assert_allclose(log_likelihood[:, 0], pooled.log_likelihood(new)[:, 0], rtol=1e-12)
    assert (log_likelihood[:, 1] != pooled.log_likelihood(new)[:, 1]).all()


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
    log_likelihood = model.log_likelihood([[2.0, 0.5], [5.0, 4.0]])
    assert_allclose(
        [log_likelihood[0, 0], log_likelihood[1, 1]], [at_a, at_b], rtol=1e-12
    )


@each_bandwidth
def test_absurd_touches_get_finite_answers(bandwidth, learnt):
    model = KernelDensityBayes(bandwidth).fit(*learnt)
    absurd = np.full((2, 22), 1e308) * [[1], [-1]]
    assert np.isfinite(model.log_likelihood(absurd)).all()
    assert np.isfinite(model.predict_proba(absurd)).all()
