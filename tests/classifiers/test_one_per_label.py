"""One machine per label: scikit-learn's SVCs one by one, and the rule for winners."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.svm import SVC

from palpate.classifiers import OnePerLabelSVC


@pytest.fixture
def learnt(rng):
    labels = np.repeat(["corner", "edge", "flat", "point"], 15)
    centres = np.repeat(rng.normal(size=(4, 5)), 15, axis=0)
    mixed = rng.permutation(60)
    return (centres + rng.normal(size=(60, 5)))[mixed], labels[mixed]


@pytest.mark.parametrize("kernel", ["linear", "poly", "rbf", "sigmoid"])
@pytest.mark.parametrize("gamma", ["scale", "auto", 0.2])
def test_machines_are_scikit_learns(kernel, gamma, learnt, rng):
    touches, labels = learnt
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


def test_only_supporting_touches_are_kept(learnt):
    model = OnePerLabelSVC().fit(*learnt)
    assert (model.coefficients_ != 0).any(axis=1).all()
    kept = {tuple(touch) for touch in model.support_touches_}
    assert kept <= {tuple(touch) for touch in learnt[0]}
    # Each machine balances the labels: its coefficients add up to zero (libsvm
    # stops at 1e-3, the sum is kept exactly).
    assert_allclose(model.coefficients_.sum(axis=0), 0, atol=1e-9)


def test_equal_touches_do_not_break_the_scale():
    model = OnePerLabelSVC().fit(np.ones((4, 2)), [0, 0, 1, 1])
    assert model.gamma_ == 1.0
    assert np.isfinite(model.decision_values([[1, 1]])).all()


def test_one_label_is_refused():
    with pytest.raises(ValueError, match="at least two labels, got 1 class"):
        OnePerLabelSVC().fit([[0.0], [1.0]], ["edge", "edge"])
