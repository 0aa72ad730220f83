"""Votes, sigmoids and coupled probabilities against slow references."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize
from scipy.special import expit

from palpate.classifiers.mkl._pairs import (
    all_pairs,
    couple,
    fit_sigmoids,
    fit_temperature,
    put_left_out,
    sharpen,
    side_with_votes,
    vote,
)

from .conftest import platt_loss

IDENTITY = np.array([[1.0, 0.0]])  # slope 1, offset 0


def test_votes_count_won_pairs_and_decisions_break_ties():
    pairs = all_pairs(3)
    assert_array_equal(pairs, [[0, 1], [0, 2], [1, 2]])
    # Class 1 beats 0 and 2; then a circle in which class 2 wins most clearly.
    decisions = np.array([[1.0, -1.0, -1.0], [1.0, -1.0, 5.0]])
    scores = vote(decisions, pairs, 3)
    assert scores.argmax(axis=1).tolist() == [1, 2]
    assert_array_equal(np.round(scores[0]), [1, 2, 0])
    # The clarity of decisions never outweighs a vote.
    assert np.abs(scores - [[1, 2, 0], [1, 1, 1]]).max() < 0.5


def test_decisions_of_zero_are_half_a_vote_each():
    assert_allclose(vote(np.zeros((1, 6)), all_pairs(4), 4), 1.5)


def test_sigmoids_minimise_platts_loss_of_what_is_no_padding(rng):
    labels = np.where(rng.random((5, 40)) < 0.4, 1.0, -1.0)
    scores = 0.7 * labels + rng.normal(size=(5, 40))
    padding = ((0, 0), (0, 5))
    sigmoids = fit_sigmoids(
        np.pad(scores, padding, constant_values=9.0), np.pad(labels, padding)
    )
    for sigmoid, score, label in zip(sigmoids, scores, labels, strict=True):
        best = minimize(platt_loss, [0, 0], (score, label), tol=1e-12)
        # Where the optimiser without derivatives stops.
        assert_allclose(sigmoid, best.x, atol=1e-4)


def test_decisions_that_are_wrong_say_nothing():
    labels = np.array([[1.0, 1, 1, -1]])
    assert_allclose(fit_sigmoids(-labels, labels), [[0, np.log(4 / 2)]])


def test_perfect_and_constant_decisions_have_finite_sigmoids():
    labels = np.repeat([[1.0, -1.0]], 10, axis=0).T.reshape(1, -1)
    for scores in (1e6 * labels, 1e-9 * labels, np.zeros_like(labels)):
        assert np.isfinite(fit_sigmoids(scores, labels)).all()


def test_two_classes_are_their_sigmoid():
    chances = couple(np.array([[0.3], [-2.0]]), IDENTITY, all_pairs(2))
    assert_allclose(chances[:, 1], expit([0.3, -2.0]), rtol=1e-12)


@pytest.mark.parametrize("n_classes", [3, 5])
def test_coupling_minimises_the_pairwise_squares(rng, n_classes):
    pairs = all_pairs(n_classes)
    second = rng.uniform(0.1, 0.9, size=len(pairs))
    decisions = np.log(second / (1 - second))[None]
    (coupled,) = couple(decisions, np.repeat(IDENTITY, len(pairs), axis=0), pairs)

    def loss(p):
        i, j = pairs.T
        return ((second * p[i] - (1 - second) * p[j]) ** 2).sum()

    constraint = {"type": "eq", "fun": lambda p: p.sum() - 1}
    start = np.full(n_classes, 1 / n_classes)
    best = minimize(loss, start, constraints=constraint, tol=1e-14)
    # SLSQP's own accuracy.
    assert_allclose(coupled, best.x, atol=1e-5)


def test_probabilities_side_with_the_votes_at_the_least_change(rng):
    chances = rng.dirichlet(np.ones(5), size=20)
    winners = rng.integers(5, size=20)
    sided = side_with_votes(chances, winners)
    assert_array_equal(sided.argmax(axis=1), winners)
    assert_allclose(sided.sum(axis=1), 1, rtol=1e-12)
    for before, after, winner in zip(chances, sided, winners, strict=True):
        wanted = [{"type": "eq", "fun": lambda p: p.sum() - 1}]
        wanted += [
            {"type": "ineq", "fun": lambda p, k=k, w=winner: p[w] - p[k]}
            for k in range(5)
        ]
        least = minimize(
            lambda p, q=before: ((p - q) ** 2).sum(),
            before,
            constraints=wanted,
            tol=1e-14,
        )
        # SLSQP's own accuracy, and the hair by which the winner is ahead.
        assert_allclose(after, least.x, atol=1e-6)


def test_the_temperature_undoes_a_power(rng):
    chances = rng.dirichlet(np.ones(4), size=20_000)
    codes = np.array([rng.choice(4, p=p) for p in chances])
    # 20,000 draws know the power to about 1 %.
    assert_allclose(fit_temperature(sharpen(chances, 0.4), codes), 2.5, rtol=0.05)
    assert_allclose(sharpen(sharpen(chances, 0.4), 2.5), chances, rtol=1e-8)


def test_perfect_touches_have_a_finite_temperature():
    power = fit_temperature(np.full((50, 2), [0.9, 0.1]), np.zeros(50, int))
    sharp = sharpen(np.array([[0.9, 0.1]]), power)
    # One touch in 52 is taken to be another, which bounds how certain the rest are.
    assert_allclose(sharp[0, 0], 51 / 52, rtol=1e-3)


def test_left_out_decisions_replace_those_of_the_own_class():
    pairs, codes = all_pairs(3), np.array([0, 1, 2])
    left_out = np.array([[np.nan, 10, 20], [30, np.nan, 40], [50, 60, np.nan]])
    decisions = np.zeros((3, 3))
    put_left_out(decisions, left_out, codes, pairs)
    assert_array_equal(decisions, [[10, 20, 0], [30, 0, 40], [0, 50, 60]])
