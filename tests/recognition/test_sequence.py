"""How touches add up: closed cases of floor, trust and posterior."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.recognition import SequenceCalibration, doubts, log_posteriors, with_floor


def test_posterior_is_the_normalised_product():
    likelihood = np.array([[0.5, 0.25], [0.2, 0.6]])
    posterior = np.exp(
        log_posteriors(np.log(likelihood), np.log([0.5, 0.5]), SequenceCalibration())
    )
    assert_allclose(posterior[0], [2 / 3, 1 / 3])
    assert_allclose(posterior[1], [0.1 / 0.25, 0.15 / 0.25])


def test_prior_enters_once():
    flat = np.zeros((3, 2))
    posterior = np.exp(log_posteriors(flat, np.log([0.8, 0.2]), SequenceCalibration()))
    assert_allclose(posterior, [[0.8, 0.2]] * 3)


def test_one_impossible_touch_does_not_rule_an_object_out():
    with np.errstate(divide="ignore"):
        impossible = np.log([[0.0, 1.0]])
    floored = np.exp(with_floor(impossible, 0.01))
    assert_allclose(floored, [[0.005, 0.995]])


def test_without_floor_likelihoods_keep_their_ratio():
    raw = np.array([[-1000.0, -1003.0]])
    kept = with_floor(raw, 0)
    assert kept[0, 0] - kept[0, 1] == pytest.approx(3)


def test_fully_correlated_touches_are_worth_one():
    touch = np.log([[0.7, 0.3]])
    after = log_posteriors(
        np.repeat(touch, 9, axis=0), np.log([0.5, 0.5]), SequenceCalibration(1, 1)
    )
    assert_allclose(np.exp(after), [[0.7, 0.3]] * 9)


def test_the_best_object_does_not_depend_on_the_trust(rng):
    steps = rng.normal(size=(20, 5))
    prior = np.full(5, -np.log(5))
    best = log_posteriors(steps, prior, SequenceCalibration()).argmax(axis=1)
    tempered = log_posteriors(steps, prior, SequenceCalibration(0.4, 0.3)).argmax(
        axis=1
    )
    assert (best == tempered).all()


def test_doubt_is_exact_near_certainty():
    # 1 - p rounds to 0 in double precision here; the sum of the others does not.
    log_posterior = np.array([np.log1p(-2e-20), np.log(1e-20), np.log(1e-20)])
    assert doubts(log_posterior) == pytest.approx(2e-20)
