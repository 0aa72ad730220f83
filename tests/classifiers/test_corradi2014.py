"""The two classifiers of Corradi et al. 2014: naive Bayes, and a machine per label.

Densities are compared with those of scipy, machines with scikit-learn's.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import logsumexp
from scipy.stats import gaussian_kde, iqr, norm
from sklearn.svm import SVC

from palpate.classifiers import KernelDensityNaiveBayes, OnePerLabelSVC

# Two routes through float64, over sums of a few hundred terms.
ROUNDING = 1e-10


@pytest.fixture
def learnt(rng):
    """Four labels, 20 to 50 touches each, seven features of very different size."""
    labels = np.repeat(["corner", "edge", "flat", "point"], [20, 30, 40, 50])
    touches = rng.normal(size=(140, 7)) * np.logspace(-4, 4, 7)
    mixed = rng.permutation(140)
    return touches[mixed], labels[mixed]


@pytest.fixture
def new_touches(rng, learnt):
    return rng.normal(size=(70, 7)) * learnt[0].std(axis=0) * 2


def slow_log_likelihood(learnt, new, width):
    """Sum over features of log densities; `width(values, feature)` in its unit."""
    touches, labels = learnt
    result = np.zeros((len(new), 4))
    for place, name in enumerate(np.unique(labels)):
        for feature in range(touches.shape[1]):
            values = touches[labels == name, feature]
            each = norm.logpdf(new[:, [feature]], values, width(values, feature))
            result[:, place] += logsumexp(each, axis=1) - np.log(len(values))
    return result


# scipy's name for Scott's rule is "silverman": (3 n / 4)^(-1/5) deviations.
@pytest.mark.parametrize(
    ("bandwidth", "width"),
    [
        ("scott", lambda v, all_v: gaussian_kde(v, "silverman").factor * v.std(ddof=1)),
        (
            "silverman",
            lambda v, all_v: 0.9 * min(v.std(ddof=1), iqr(v) / 1.349) / len(v) ** 0.2,
        ),
        (0.25, lambda v, all_v: 0.25 * all_v.std(ddof=1)),
    ],
)
def test_bandwidths_follow_their_rule(learnt, new_touches, bandwidth, width):
    model = KernelDensityNaiveBayes(bandwidth).fit(*learnt)
    slow = slow_log_likelihood(
        learnt, new_touches, lambda v, k: width(v, learnt[0][:, k])
    )
    assert_allclose(model.log_likelihood(new_touches), slow, rtol=ROUNDING)


def test_far_touches_keep_finite_and_exact_likelihoods(learnt, new_touches):
    far = new_touches + 500 * learnt[0].std(axis=0)
    model = KernelDensityNaiveBayes(0.1).fit(*learnt)

    def width(values, feature):
        return 0.1 * learnt[0][:, feature].std(ddof=1)

    log_likelihood = model.log_likelihood(far)
    assert log_likelihood.max() < -1e6
    assert_allclose(
        log_likelihood, slow_log_likelihood(learnt, far, width), rtol=ROUNDING
    )
    assert np.isfinite(model.log_likelihood(np.full((1, 7), 1e308))).all()


def test_features_that_never_vary_are_ignored(learnt, new_touches):
    touches, labels = learnt
    padded = np.c_[np.full(140, 0.1), touches]
    model = KernelDensityNaiveBayes().fit(padded, labels)
    plain = KernelDensityNaiveBayes().fit(touches, labels)
    assert_array_equal(
        model.log_likelihood(np.c_[np.full(70, 9.0), new_touches]),
        plain.log_likelihood(new_touches),
    )
    nothing = KernelDensityNaiveBayes().fit(np.ones((3, 2)), [0, 1, 1])
    assert_array_equal(nothing.log_likelihood([[5, 5]]), [[0, 0]])


def test_labels_without_spread_get_a_bandwidth():
    # One label touched once; one that never varies; one with half its values equal.
    values = np.array([[0.0], [3.0], [3.0], [7.0], [7.0], [7.0], [7.0], [9.0]])
    labels = [0, 1, 1, 2, 2, 2, 2, 2]
    pooled = values.std(ddof=1)
    scott = KernelDensityNaiveBayes("scott", min_bandwidth=0.05).fit(values, labels)
    assert_allclose(scott.bandwidths_[:2, 0], [(4 / 3) ** 0.2, 0.05], rtol=1e-12)
    silverman = KernelDensityNaiveBayes("silverman").fit(values, labels)
    sd = values[3:].std(ddof=1)
    assert_allclose(
        silverman.bandwidths_[:, 0] * pooled,
        [0.9 * pooled, 1e-2 * pooled, 0.9 * sd * 5**-0.2],
        rtol=1e-12,
    )


@pytest.fixture
def clouds(rng):
    labels = np.repeat(["corner", "edge", "flat", "point"], 15)
    centres = np.repeat(rng.normal(size=(4, 5)), 15, axis=0)
    mixed = rng.permutation(60)
    return (centres + rng.normal(size=(60, 5)))[mixed], labels[mixed]


@pytest.mark.parametrize("kernel", ["linear", "poly", "rbf", "sigmoid"])
@pytest.mark.parametrize("gamma", ["scale", "auto", 0.2])
def test_machines_are_scikit_learns(kernel, gamma, clouds, rng):
    touches, labels = clouds
    new = rng.normal(size=(30, 5))
    model = OnePerLabelSVC(C=3.0, kernel=kernel, gamma=gamma).fit(touches, labels)
    each = [
        SVC(C=3.0, kernel=kernel, gamma=gamma)
        .fit(touches, labels == name)
        .decision_function(new)
        for name in model.classes_
    ]
    # The same machines; kernels are evaluated by another routine, in float64.
    assert_allclose(model.decision_values(new), np.transpose(each), atol=1e-9)


@pytest.mark.parametrize(
    ("values", "winner"),
    [
        pytest.param([0.1, -1.0, -2.0], 0, id="one claims"),
        pytest.param(
            [9.0, 0.1, -2.0], 1, id="the largest label, not the largest value"
        ),
        pytest.param([9.0, -0.1, 0.2], 2, id="gaps do not matter"),
        pytest.param([9.0, 9.0, 9.0], 2, id="all claim"),
        pytest.param([-3.0, -0.5, -1.0], 1, id="none claims: the largest value"),
        pytest.param([-1.0, -0.5, -0.5], 1, id="none claims: the first of equals"),
        pytest.param(
            [-1.0, -2.0, 0.0], 2, id="zero is no claim, but the largest value"
        ),
    ],
)
def test_the_last_label_that_claims_wins_or_else_the_largest_value(
    values, winner, monkeypatch
):
    model = OnePerLabelSVC().fit([[0.0], [1.0], [2.0]], [0, 1, 2])
    decisions = np.array([values])
    monkeypatch.setattr(model, "decision_values", lambda X: decisions)
    assert_array_equal(model.predict([[0.0]]), [winner])


def test_only_supporting_touches_are_kept(clouds):
    model = OnePerLabelSVC().fit(*clouds)
    assert (model.coefficients_ != 0).any(axis=1).all()
    kept = {tuple(touch) for touch in model.support_touches_}
    assert kept <= {tuple(touch) for touch in clouds[0]}
    # Each machine balances the labels: its coefficients add up to zero (libsvm
    # stops at 1e-3, the sum is kept exactly).
    assert_allclose(model.coefficients_.sum(axis=0), 0, atol=1e-9)


def test_equal_touches_do_not_break_the_scale():
    model = OnePerLabelSVC().fit(np.ones((4, 2)), [0, 0, 1, 1])
    assert model.gamma_ == 1.0
    assert np.isfinite(model.decision_values([[1, 1]])).all()
