"""A pool of machines: weights by touches left out, parts by name, and refusals."""

from copy import copy

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import log_softmax
from sklearn.naive_bayes import GaussianNB

from palpate.classifiers import (
    EncodingPool,
    FromProbabilities,
    KernelDensityBayes,
    KernelRidgeClassifier,
    TouchClassifier,
)

*_, RehearsedMachine = EncodingPool.MACHINES


@pytest.fixture
def problem(rng):
    """Two features that tell three labels, and three that are noise."""
    labels = np.repeat(["ball", "mug", "pen"], 30)
    telling = rng.normal(scale=0.3, size=(90, 2)) + np.repeat(np.eye(3, 2), 30, axis=0)
    X = np.hstack([telling, rng.normal(size=(90, 3))])
    return X, labels, np.tile(np.repeat(np.arange(5), 6), 3)


def test_noise_weighs_nothing_beside_a_part_that_tells(problem):
    X, labels, groups = problem
    pool = EncodingPool({"telling": 2, "noise": 3}, together=False)
    pool.fit(X, labels, groups=groups)
    assert pool.weights_["telling"] > 0.8
    posteriors = dict(zip(pool.weights_, pool.left_out_posteriors(), strict=True))
    # A part of noise has flat posteriors, whatever its weight.
    assert (
        posteriors["noise"].std(axis=1).mean()
        < 0.1 * posteriors["telling"].std(axis=1).mean()
    )
    assert pool.score(X, labels) > 0.9


def test_pool_of_one_part_is_its_machine_at_another_temperature(problem):
    X, labels, groups = problem
    pool = EncodingPool({"all": 5}).fit(X, labels, groups=groups)
    alone = KernelRidgeClassifier(max_choice_touches=800).fit(X, labels, groups=groups)
    scaled = pool.weights_["all"] * alone.log_likelihood(X)
    assert_allclose(pool.log_likelihood(X), log_softmax(scaled, axis=1), atol=1e-9)


@pytest.mark.parametrize("n_rare", [30, 10], ids=["even", "rare"])
def test_weights_are_a_minimum_of_the_stated_loss(problem, n_rare):
    X, labels, groups = (array[: 60 + n_rare] for array in problem)
    pool = EncodingPool({"one": 1, "other": 1, "noise": 3}, together=False)
    left_out = pool.fit(X, labels, groups=groups).left_out_posteriors()
    codes = np.searchsorted(pool.classes_, labels)
    # Each label adds the same to the loss.
    shares = len(codes) / 3 / np.bincount(codes)[codes]

    def loss(weights):
        pooled = log_softmax(np.tensordot(weights, left_out, 1), axis=1)
        away = (weights - 1 / 3) * 3
        log_posterior = pooled[np.arange(len(codes)), codes]
        return -(shares * log_posterior).sum() + (away**2).sum() / 2

    weights = np.array(list(pool.weights_.values()))
    for step in 0.01 * np.vstack([np.eye(3), -np.eye(3)]):
        # Convex, so a point that no neighbour beats is the minimum.
        assert loss(np.maximum(weights + step, 0)) >= loss(weights) - 1e-6


def test_few_touches_leave_the_pool_near_the_mean(rng):
    X, labels = rng.normal(size=(4, 2)), ["ball", "ball", "mug", "mug"]
    pool = EncodingPool({"x": 1, "y": 1}, together=False).fit(X, labels)
    assert_allclose([*pool.weights_.values()], 0.5, atol=0.15)


def test_machine_for_all_parts_learns_what_none_tells_alone(rng):
    # The label is the exclusive or of two signs: neither tells anything alone.
    X = rng.uniform(-1, 1, size=(200, 2))
    labels = np.where(X[:, 0] * X[:, 1] > 0, "same", "other")
    separate = EncodingPool({"x": 1, "y": 1}, together=False).fit(X, labels)
    together = EncodingPool({"x": 1, "y": 1}).fit(X, labels)
    assert separate.score(X, labels) < 0.75
    assert together.score(X, labels) > 0.9
    assert together.weights_["all together"] == max(together.weights_.values())


def test_a_pool_keeps_the_contract_of_touch_classifiers(problem, reread):
    X, labels, groups = problem
    pool = EncodingPool({"telling": 2, "noise": 3}).fit(X, labels, groups=groups)
    assert isinstance(pool, TouchClassifier)
    left_out = pool.left_out_log_likelihood()
    assert left_out.shape == (90, 3)
    # A touch is named no better when left out than when learnt.
    codes = np.searchsorted(pool.classes_, labels)
    rows = np.arange(90)
    learnt = log_softmax(pool.log_likelihood(X), axis=1)
    assert left_out[rows, codes].mean() < learnt[rows, codes].mean()
    again = reread(pool)
    np.testing.assert_array_equal(again.log_likelihood(X), pool.log_likelihood(X))


def test_refit_keeps_weights_and_widths(problem):
    X, labels, groups = problem
    pool = EncodingPool({"telling": 2, "noise": 3}).fit(X, labels, groups=groups)
    weights = dict(pool.weights_)
    without_pen = labels != "pen"
    pool.refit(X[without_pen], labels[without_pen], groups=groups[without_pen])
    assert pool.weights_ == weights
    assert pool.classes_.tolist() == ["ball", "mug"]
    assert pool.left_out_log_likelihood().shape == (60, 2)
    with pytest.raises(ValueError, match="5 features"):
        pool.refit(X[without_pen, :4], labels[without_pen], groups=groups[without_pen])


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_touch_whose_class_was_left_out_whole_is_no_gap_of_a_rehearsed_one(share):
    class Machine:
        def left_out_log_likelihood(self):
            return np.array([[-np.inf, -np.inf], [0.0, -1.0]])

    machine = RehearsedMachine(Machine(), Machine(), np.eye(2), share)
    rows = machine.left_out_log_likelihood()
    assert_allclose(rows[0], np.log([0.5, 0.5]))
    assert_allclose(rows[1], log_softmax([0.0, -1.0]))


@pytest.mark.parametrize(
    "machine", [KernelDensityBayes(), FromProbabilities(GaussianNB())], ids=repr
)
@pytest.mark.parametrize("groups", ["of each label", "one"])
def test_labels_left_out_whole_say_nothing_of_the_weights(problem, machine, groups):
    X, labels, _ = problem
    two = np.flatnonzero(labels != "pen")
    codes = np.unique(labels, return_inverse=True)[1]
    group = codes[two] if groups == "of each label" else np.zeros(60)
    pool = EncodingPool({"telling": 2, "noise": 3}, machine, together=False)
    pool.fit(X[two], labels[two], groups=group)
    # No touch is left to learn its label from: the weights stay those of no touches.
    assert_allclose(list(pool.weights_.values()), 0.5)
    assert_allclose(pool.left_out_, -np.log(2))


def test_any_touch_classifier_can_be_the_machine(problem):
    X, labels, groups = problem
    machine = FromProbabilities(GaussianNB())
    pool = EncodingPool({"telling": 2, "noise": 3}, machine).fit(X, labels, groups)
    assert pool.score(X, labels) > 0.9


@pytest.mark.parametrize(
    ("parts", "error", "message"),
    [
        ({"a": 2, "b": 2}, ValueError, r"add up to the 5 features of X, got 4"),
        ({"a": 5, "b": 0}, ValueError, r"parts\['b'\] must be at least 1, got 0"),
        ({"a": 2.5, "b": 2.5}, TypeError, r"parts\['a'\] must be an integer"),
    ],
)
def test_parts_that_do_not_fit_are_refused(problem, parts, error, message):
    X, labels, _ = problem
    with pytest.raises(error, match=message):
        EncodingPool(parts).fit(X, labels)


def _rings(seed, n_each=30, n_groups=10):
    """Return touches on rings about one another: each lies between its neighbours."""
    rng = np.random.default_rng(seed)
    labels = np.repeat(np.arange(5), n_each)
    angle = rng.uniform(0, 2 * np.pi, len(labels))
    radius = 1 + 0.12 * labels + 0.02 * rng.normal(size=len(labels))
    touches = radius[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return touches, labels, n_groups * labels + np.tile(np.arange(n_groups), 15)


def test_labels_between_others_are_told_by_what_is_said_of_all_together(reread):
    touches, labels, groups = _rings(0)
    pool = EncodingPool({"place": 2}).fit(touches, labels, groups=groups)
    new, truth, _ = _rings(1)
    log_posterior = pool.log_likelihood(new)
    uncorrected = log_softmax(
        np.tensordot(
            [*pool.weights_.values()], pool.log_likelihood_by_part(new), axes=1
        ),
        axis=1,
    )
    rows = np.arange(len(truth))
    assert (uncorrected.argmax(axis=1) == truth).mean() < 0.8
    assert (log_posterior.argmax(axis=1) == truth).mean() > 0.95
    # What is said of touches left out is as sure as what is said of new ones.
    left_out = pool.left_out_log_likelihood()[rows, labels].mean()
    assert left_out == pytest.approx(log_posterior[rows, truth].mean(), abs=0.1)
    centred = uncorrected - uncorrected.mean(axis=1, keepdims=True)
    matrix = pool.scaling_
    expected = log_softmax(centred + centred @ matrix[:-1] + matrix[-1], axis=1)
    assert_allclose(log_posterior, expected, atol=1e-9)
    assert_array_equal(reread(pool).log_likelihood(new), log_posterior)
    # Others are learnt with the penalty that was chosen; a label less is one less.
    fewer = copy(pool).refit(touches[30:], labels[30:], groups=groups[30:])
    assert fewer.scaling_.shape == (5, 4)
    assert fewer.penalty_ == pool.penalty_
    assert fewer.score(new[30:], truth[30:]) > 0.9
    kept = copy(pool).refit(touches, labels, groups=groups, keep_shape=True)
    assert_array_equal(kept.scaling_, matrix)


def test_the_matrix_is_that_of_least_loss_and_penalty():
    touches, labels, groups = _rings(2)
    pool = EncodingPool({"place": 2}).fit(touches, labels, groups=groups)
    (machine,), (weight,) = pool.machines_.values(), pool.weights_.values()
    logits = weight * log_softmax(machine.left_out_log_likelihood(), axis=1)
    logits -= logits.mean(axis=1, keepdims=True)

    def loss(matrix):
        log_posterior = log_softmax(logits + logits @ matrix[:-1] + matrix[-1], axis=1)
        of_label = log_posterior[np.arange(len(labels)), labels]
        gaps = (of_label[:, np.newaxis] - log_posterior).sum(axis=1)
        smoothed = (
            gaps / (len(labels) + 2) / 4 - of_label
        )  # Laplace's rule of succession
        return pool.penalty_ * (matrix**2).sum() / 2 + smoothed.mean()

    matrix = pool.scaling_
    assert_array_equal(matrix[:-1], matrix[:-1].T)
    shares, directions = np.linalg.eigh(matrix[:-1])
    assert shares.min() > -1e-12  # no difference between labels gets less
    factors = directions * np.sqrt(np.maximum(shares, 0))
    for move in 0.02 * np.random.default_rng(0).normal(size=(40, *matrix.shape)):
        near = factors + move[:-1]
        moved = np.vstack([near @ near.T, matrix[-1] + move[-1]])
        assert loss(moved) > loss(matrix) - 1e-6


@pytest.mark.parametrize("groups", [None, np.repeat(np.arange(30), 5)])
def test_where_nothing_more_can_be_told_all_is_left_as_it_is(groups):
    rng = np.random.default_rng(0)
    labels = np.tile(np.arange(3), 50)
    # Labels that are drawn say nothing, whatever touches of one group have in common.
    touches = rng.normal(size=(30, 2)).repeat(5, axis=0)
    pool = EncodingPool({"noise": 2}).fit(touches, labels, groups=groups)
    assert pool.scaling_ is None
    assert pool.penalty_ is None
    again = pool.refit(*_rings(0)[:2])
    assert again.scaling_ is None  # that choice stays


def test_very_many_labels_are_not_corrected(lower):
    touches, labels, groups = _rings(0)
    with pytest.MonkeyPatch.context() as patch:
        lower(patch, work_of_scaling=len(labels) * 25 // 8)
        pool = EncodingPool({"place": 2}).fit(touches, labels, groups=groups)
    assert pool.scaling_ is None


@pytest.mark.parametrize("limit", ["rows", "work"])
def test_a_label_that_is_seldom_left_out_is_not_taken_for_one_never_met(
    limit, lower, monkeypatch
):
    touches, labels, groups = _rings(0)
    if limit == "rows":  # so many answers that of some labels none is left out
        least = "palpate.classifiers._touch_classifier.LEAST_LABELS"
        monkeypatch.setattr(least, 4)
        lower(monkeypatch, answers_left_out=len(labels) * 4)
    else:  # so many touches that those of a seldom one fall between
        lower(monkeypatch, work_of_scaling=25 * 25)
        kept = (labels != 2) | (np.cumsum(labels == 2) < 4)
        kept[:4] = False
        touches, labels, groups = touches[kept], labels[kept], groups[kept]
    pool = EncodingPool({"place": 2}).fit(touches, labels, groups=groups)
    new, truth, _ = _rings(1)
    uncorrected = copy(pool)
    uncorrected.scaling_ = None
    for label in range(5):
        of_label = truth == label
        before = uncorrected.score(new[of_label], truth[of_label])
        assert pool.score(new[of_label], truth[of_label]) > before - 0.2


@pytest.mark.parametrize("begin", [[0, 0, 0], [0, 2, 4]], ids=["one", "several"])
def test_sessions_correct_whichever_label_each_began_with(begin):
    touches, labels, _ = _rings(0)
    session = np.tile(np.arange(3), 50)
    order = np.lexsort(((labels - np.take(begin, session)) % 5, session))
    pool = EncodingPool({"place": 2})
    pool.fit(touches[order], labels[order], groups=session[order])
    assert pool.penalty_ is not None


def test_a_label_of_two_sessions_is_left_out_as_well_as_it_is_recognised():
    touches, labels, _ = _rings(0)
    session = np.tile(np.arange(6), 25)
    kept = (labels != 2) | (session < 2)  # both in one run
    pool = EncodingPool({"place": 2})
    pool.fit(touches[kept], labels[kept], groups=session[kept])
    left_out = pool.left_out_log_likelihood()[labels[kept] == 2, 2]
    assert pool.penalty_ is not None
    assert -left_out.mean() < np.log(5)  # no worse than knowing nothing


def test_two_sessions_tell_how_far_to_correct_and_one_does_not():
    touches, labels, _ = _rings(0)
    pool = EncodingPool({"place": 2})
    for n_sessions in (1, 2, 3):
        sessions = np.tile(np.arange(n_sessions), 150 // n_sessions)
        pool.fit(touches, labels, groups=sessions)
        assert (pool.scaling_ is not None) == (n_sessions > 1)
