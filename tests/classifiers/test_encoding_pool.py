"""A pool of machines: weights by touches left out, parts by name, and refusals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import log_softmax
from sklearn.naive_bayes import GaussianNB

from palpate.classifiers import (
    EncodingPool,
    FromProbabilities,
    KernelDensityBayes,
    KernelRidgeClassifier,
    TouchClassifier,
)


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
