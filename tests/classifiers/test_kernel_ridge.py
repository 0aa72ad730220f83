"""Kernel ridge classification: left-out scores against refitting, and refusals."""

import itertools
import pickle
from copy import copy

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax
from sklearn.base import clone

from palpate.classifiers import KernelRidgeClassifier


@pytest.fixture
def problem(rng):
    labels = np.repeat(["ball", "mug", "pen"], 20)
    X = rng.normal(size=(60, 4)) + 1.5 * np.repeat(np.eye(3, 4), 20, axis=0)
    return X, labels, np.tile(np.repeat(np.arange(5), 4), 3)


def test_left_out_scores_are_those_of_a_machine_that_never_met_the_group(problem):
    X, labels, groups = problem
    machine = KernelRidgeClassifier(widths=[1.0], ridges=[0.1])
    machine.fit(X, labels, groups=groups)
    for group in range(5):
        out = groups == group
        _, slow = by_hand(machine, X, labels, out)
        # Both solve the same 60 x 60 systems; only rounding differs.
        assert_allclose(machine.left_out_scores_[out], slow, atol=1e-10)


@pytest.mark.parametrize("spread", [1.0, 8.0])
def test_width_and_ridge_have_the_least_loss_of_smoothed_labels(spread):
    # At spread 8 every setting tells all left-out touches apart, and the loss of labels
    # that are not smoothed is 0 but for rounding.
    rng = np.random.default_rng(0)
    labels = np.repeat([0, 1, 2], [6, 10, 14])
    X = spread * rng.normal(size=(3, 4))[labels] + rng.normal(size=(30, 4))
    counts = np.bincount(labels)
    smoothed = np.full((30, 3), 0.5 / 32)
    smoothed[np.arange(30), labels] = 31 / 32
    losses = {}
    for setting in itertools.product((0.5, 1.0, 2.0, 4.0), (0.003, 0.03, 0.3)):
        machine = KernelRidgeClassifier([setting[0]], [setting[1]]).fit(X, labels)

        def loss(temperature, scores=machine.left_out_scores_):
            logits = temperature * scores - np.log(counts)
            each = -(smoothed * log_softmax(logits, axis=1)).sum(axis=1)
            return sum(each[labels == c].mean() for c in range(3)) / 3

        losses[setting] = minimize_scalar(loss, bounds=(0.05, 400)).fun
    machine = KernelRidgeClassifier(ridges=(0.003, 0.03, 0.3)).fit(X, labels)
    assert (machine.width_, machine.ridge_) == min(losses, key=losses.get)


def test_temperature_makes_left_out_touches_calibrated(problem):
    X, labels, groups = problem
    machine = KernelRidgeClassifier().fit(X, labels, groups=groups)
    left_out = machine.left_out_log_likelihood()
    codes = np.searchsorted(machine.classes_, labels)
    loss = -left_out[np.arange(60), codes].mean()
    assert loss == pytest.approx(machine.log_loss_)
    for factor in (0.8, 1.25):
        machine.temperature_ *= factor
        other = machine.left_out_log_likelihood()
        machine.temperature_ /= factor
        assert -other[np.arange(60), codes].mean() > loss


def test_refit_keeps_the_choices(problem):
    X, labels, _ = problem
    machine = KernelRidgeClassifier().fit(X[:40], labels[:40])
    chosen = machine.width_, machine.ridge_, machine.unit_
    machine.refit(X, labels)
    assert machine.classes_.tolist() == ["ball", "mug", "pen"]
    assert (machine.width_, machine.ridge_, machine.unit_) == chosen


def test_the_choice_is_made_on_part_of_many_touches(problem):
    X, labels, _ = problem
    whole = KernelRidgeClassifier().fit(X, labels)
    few = KernelRidgeClassifier(max_choice_touches=30).fit(X, labels)
    # The median distance, in which widths count, is that of other touches.
    assert few.unit_ != whole.unit_
    assert len(few.touches_) == 60


def test_no_ridge_is_refused(problem):
    X, labels, _ = problem
    with pytest.raises(ValueError, match="ridges must hold at least one value"):
        KernelRidgeClassifier(ridges=[]).fit(X, labels)


def test_equal_touches_give_equal_posteriors():
    machine = KernelRidgeClassifier().fit(np.ones((6, 2)), ["a", "b"] * 3)
    assert_allclose(machine.predict_proba(np.ones((1, 2))), 0.5)


@pytest.mark.parametrize("shift", [1e7, 1e9])
def test_touches_far_from_the_origin_are_told_apart_as_well(problem, shift):
    X, labels, _ = problem
    near, far = (KernelRidgeClassifier().fit(X + s, labels) for s in (0, shift))
    assert (far.width_, far.ridge_) == (near.width_, near.ridge_)
    # Features far out are known to 2e-16 of the shift; weights make it 100 times more.
    assert_allclose(far.scores(X + shift), near.scores(X), atol=1e-13 * shift)
    assert_allclose(far.left_out_scores_, near.left_out_scores_, atol=1e-13 * shift)
    again = far.refit(X[:40] + shift, labels[:40]).scores(X + shift)
    assert_allclose(
        again, near.refit(X[:40], labels[:40]).scores(X), atol=1e-13 * shift
    )


def test_scores_are_sums_of_the_kernel(problem):
    X, labels, _ = problem
    machine = KernelRidgeClassifier().fit(X, labels)
    assert_allclose(machine.touches_ + machine.mean_, X)
    distance = ((X[:, None] - X) ** 2).sum(axis=2)
    kernel = np.exp(-machine.width_ / machine.unit_ * distance)
    slow = kernel @ machine.coefficients_ + 1 / 3
    # Distances by inner products, and coefficients up to some hundreds.
    assert_allclose(machine.scores(X), slow, atol=1e-10)


def test_features_whose_squares_just_keep_to_the_range_are_learnt(problem):
    X, labels, _ = problem
    machine = KernelRidgeClassifier().fit(X, labels)
    with pytest.raises(ValueError, match=r"X must be at most 1e\+150 .*e\+200"):
        machine.refit(1e200 * X, labels)
    large = KernelRidgeClassifier().fit(1e148 * X, labels)
    assert_allclose(large.scores(1e148 * X), machine.scores(X), atol=1e-8)


def test_all_touches_as_landmarks_are_the_machine_itself(problem):
    X, labels, groups = problem
    exact = KernelRidgeClassifier().fit(X, labels, groups=groups)
    through = KernelRidgeClassifier(max_touches=10, n_landmarks=60)
    through.fit(X, labels, groups=groups)
    # The landmarks' kernel gets 1e-8 on its diagonal to be invertible.
    assert_allclose(through.scores(X), exact.scores(X), atol=1e-5)
    assert_allclose(through.left_out_scores_, exact.left_out_scores_, atol=1e-5)
    assert_allclose(through.predict_proba(X), exact.predict_proba(X), atol=1e-3)


@pytest.mark.parametrize("n_landmarks", [5, 30])
def test_left_out_scores_through_landmarks_are_those_of_refitting(problem, n_landmarks):
    """With 5 landmarks a group of 12 touches gives the larger of the two matrices."""
    X, labels, groups = problem
    settings = {"widths": [1.0], "ridges": [0.1], "n_landmarks": n_landmarks}
    machine = KernelRidgeClassifier(max_touches=10, **settings)
    machine.fit(X, labels, groups=groups)
    landmarks = machine.touches_ + machine.mean_
    assert len(landmarks) <= n_landmarks

    def kernel(a, b):
        return np.exp(-((a[:, None] - b) ** 2).sum(axis=2) / machine.unit_)

    between_landmarks = kernel(landmarks, landmarks) + 1e-8 * np.eye(len(landmarks))
    features = np.linalg.solve(
        np.linalg.cholesky(between_landmarks), kernel(landmarks, X)
    ).T
    targets = (labels[:, None] == machine.classes_) - 1 / 3
    for group in range(5):
        out = groups == group
        learnt = features[~out]
        inner = learnt.T @ learnt + 0.1 * np.eye(len(landmarks))
        slow = features[out] @ np.linalg.solve(inner, learnt.T @ targets[~out]) + 1 / 3
        assert_allclose(machine.left_out_scores_[out], slow, atol=1e-5)  # single


def test_landmarks_are_spread_over_each_label_in_whatever_order(problem):
    X, _, _ = problem
    labels = np.tile(["ball", "mug", "pen"], 20)
    machine = KernelRidgeClassifier(max_touches=10, n_landmarks=20).fit(X, labels)
    kept = ((machine.touches_ + machine.mean_)[:, None] - X) ** 2
    names = labels[kept.sum(axis=2).argmin(axis=1)]
    counts = np.unique(names, return_counts=True)
    assert counts[0].tolist() == ["ball", "mug", "pen"]
    assert np.ptp(counts[1]) <= 1


def test_no_touch_is_more_like_another_than_that_itself(problem):
    """Products of touches far out exceed their squared lengths, by rounding."""
    X, labels, _ = problem
    far = X + 1e7 * (labels == "pen")[:, None]
    machine = KernelRidgeClassifier(widths=[4.0]).fit(far, labels)
    centred = far - machine.mean_
    products = (-2 * centred) @ machine.touches_.T
    assert (
        products + (centred**2).sum(axis=1)[:, None] + machine.squared_norms_
    ).min() < 0
    machine.coefficients_ = np.eye(60)
    kernel = machine.scores(far) - 1 / 3
    # 1/3 is added and taken away again.
    assert kernel.max() <= 1 + 1e-15


def test_a_label_very_far_out_is_refused_with_what_to_do(problem):
    X, labels, _ = problem
    far = X + 1e8 * (labels == "pen")[:, None]
    with pytest.raises(ValueError, match=r"X must not hold touches so far.*scale the"):
        KernelRidgeClassifier().fit(far, labels)


def uneven(rng, n_each=(80, 10), spread=0.9):
    """Touches of two overlapping labels, one taught eight times as often."""
    labels = np.repeat(["common", "rare"], n_each)
    centre = np.repeat([[0.0, 0.0], [2.0, 0.0]], n_each, axis=0)
    return centre + spread * rng.normal(size=(sum(n_each), 2)), labels


def test_posterior_is_the_one_under_equal_priors_however_unequal_the_touches(rng):
    machine = KernelRidgeClassifier().fit(*uneven(rng))
    X, labels = uneven(rng, (400, 400))
    right = machine.predict(X) == labels
    common, rare = (right[labels == name].mean() for name in machine.classes_)
    # Both are 2.2 standard deviations apart: 87 % of either are on their own side.
    assert rare > 0.7
    assert abs(common - rare) < 0.2
    posterior = machine.predict_proba(X)[np.arange(800), (labels == "rare").astype(int)]
    assert -np.log(posterior).mean() < 0.45


def by_hand(machine, X, labels, out, weights=None):
    """Coefficients, and scores of touches left `out`, by solving all anew."""
    targets = (labels[:, None] == machine.classes_) - 1 / len(machine.classes_)
    squared = ((X[:, None] - X) ** 2).sum(axis=2)
    kernel = np.exp(-machine.width_ * squared / machine.unit_)
    weights = np.ones(len(X)) if weights is None else weights
    regular = kernel + np.diag(machine.ridge_ / weights)
    dual = np.linalg.solve(regular[np.ix_(~out, ~out)], targets[~out])
    left_out = kernel[np.ix_(out, ~out)] @ dual + 1 / len(machine.classes_)
    return np.linalg.solve(regular, targets), left_out


def test_touches_learnt_later_count_as_if_learnt_with_the_others(rng):
    labels = np.repeat(["ball", "mug", "pen", "tin"], 150)
    places = dict(zip(["ball", "mug", "pen", "tin", "cup"], np.eye(5), strict=True))
    X = 0.4 * rng.normal(size=(600, 5)) + np.array([places[n] for n in labels])
    groups = np.arange(600) // 10
    machine = KernelRidgeClassifier(max_choice_touches=200)
    machine.fit(X, labels, groups=groups)
    first = machine.coefficients_.copy()
    # Ten of a known label, twice, one of them in a group that was there; then a new
    # label; then so many that all are learnt again.
    refitted = machine
    for more in (["mug"] * 10, ["pen"] * 10, ["cup"] * 12, ["tin"] * 200):
        new = np.array([places[name] for name in more])
        X = np.concatenate([X, new + 0.4 * rng.normal(size=new.shape)])
        labels = np.concatenate([labels, more])
        later = groups[-1] + 1 + np.arange(len(more)) // 5
        later[0] = 3
        groups = np.concatenate([groups, later])
        # What is learnt later may count less than the first touches.
        weights = np.where(np.arange(len(X)) < 600, 1.0, 0.25)
        refitted = copy(refitted).refit(X, labels, groups=groups, weights=weights)
        last = groups == groups[-1]
        coefficients, left_out = by_hand(refitted, X, labels, last, weights)
        assert_allclose(refitted.coefficients_, coefficients, atol=1e-10)
        assert_allclose(refitted.left_out_scores_[last], left_out, atol=1e-10)
    assert_array_equal(machine.coefficients_, first)


@pytest.fixture
def many(rng):
    """So many touches that a few more are learnt by what they add."""
    labels = np.repeat(["mug", "pen"], 300)
    return rng.normal(size=(600, 3)) + (labels == "pen")[:, np.newaxis], labels


@pytest.mark.parametrize("changed", ["touch", "label", "fewer", "none", "weight"])
def test_touches_that_changed_are_learnt_again(many, changed):
    X, labels = many
    machine = KernelRidgeClassifier(max_choice_touches=100).fit(X, labels)
    later, named = np.concatenate([X, X[:5] + 0.1]), np.append(labels, ["mug"] * 5)
    if changed == "touch":
        later[7] += 0.5
    elif changed == "label":
        named[7] = "pen"
    elif changed == "fewer":
        later, named = later[9:], named[9:]
    elif changed == "none":
        later, named = X, labels
    weights = np.ones(len(later))
    weights[7] -= 0.5 * (changed == "weight")
    again = copy(machine).refit(later, named, weights=weights)
    wanted, _ = by_hand(again, later, named, np.arange(len(later)) == 0, weights)
    assert_allclose(again.coefficients_, wanted, atol=1e-10)


@pytest.mark.parametrize("max_touches", [10_000, 500], ids=["exact", "landmarks"])
def test_learning_anew_forgets_what_was_solved_before(many, max_touches):
    X, labels = many
    machine = KernelRidgeClassifier(
        max_choice_touches=100, ridges=[0.1], max_touches=max_touches, n_landmarks=40
    )
    machine.fit(X, labels)
    more = np.r_[X, X[:5]], np.append(labels, labels[:5])
    machine.set_params(ridges=[0.01]).fit(*more)
    fresh = clone(machine).fit(*more)
    assert_array_equal(machine.log_likelihood(X), fresh.log_likelihood(X))


def test_the_kernel_kept_for_later_touches_is_not_pickled(many):
    X, labels = many
    machine = KernelRidgeClassifier(max_choice_touches=100).fit(X, labels)
    # 600 x 600 values would be 2.9 MB.
    assert len(pickle.dumps(machine)) < 200_000
    again = pickle.loads(pickle.dumps(machine)).refit(X[1:], labels[1:])
    assert_allclose(again.scores(X), machine.refit(X[1:], labels[1:]).scores(X))
