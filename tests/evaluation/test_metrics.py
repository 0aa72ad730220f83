"""Figures of merit against closed cases."""

import numpy as np
import pytest
from sklearn.metrics import roc_auc_score

from palpate.evaluation import (
    calibration_bins,
    calibration_error,
    roc_area,
    spread,
)


def test_perfect_beliefs_have_no_error():
    assert calibration_error([1.0] * 10, [True] * 10) == 0


def test_sure_and_always_wrong_is_the_worst():
    assert calibration_error([1.0] * 10, [False] * 10) == 1


def test_bins_have_equal_mass():
    confidence = np.linspace(0, 1, 25)
    _, _, counts = calibration_bins(confidence, confidence > 0.5)
    assert counts.tolist() == [3] * 5 + [2] * 5


def test_known_calibration_error():
    # Two bins of two: beliefs 0.6 right half the time, beliefs 0.9 always right.
    error = calibration_error([0.6, 0.9, 0.6, 0.9], [0, 1, 1, 1], n_bins=2)
    assert error == pytest.approx((0.1 + 0.1) / 2)


def test_calibrated_draws_have_a_small_error(rng):
    belief = rng.uniform(0.3, 1, 20_000)
    hit = rng.random(20_000) < belief
    # Standard error of a bin of 2,000 is about 0.01.
    assert calibration_error(belief, hit) < 0.02


def test_roc_area_agrees_with_scikit_learn(rng):
    known, unknown = rng.integers(0, 9, 50), rng.integers(3, 12, 40)
    truth = np.repeat([0, 1], [50, 40])
    expected = roc_auc_score(truth, np.r_[known, unknown])
    assert roc_area(known, unknown) == pytest.approx(expected)


def test_spread_is_that_of_a_sample_and_nothing_for_one():
    assert spread([1.0, 3.0]) == pytest.approx(np.sqrt(2))
    assert spread([[1.0, 5.0], [3.0, 5.0], [5.0, 5.0]]).tolist() == [2.0, 0.0]
    assert spread([7.0]) == 0


def test_there_are_ten_bins_unless_another_number_is_asked_for():
    belief = np.linspace(0.1, 1, 40)
    means, shares, counts = calibration_bins(belief, belief > 0)
    assert len(means) == len(shares) == 10
    assert counts.tolist() == [4] * 10
    np.testing.assert_allclose(means, belief.reshape(10, 4).mean(axis=1))
    assert len(calibration_bins(belief[:3], [1, 0, 1])[0]) == 3
    rng = np.random.default_rng(0)
    hit = rng.random(40) < belief
    ten = calibration_error(belief, hit, n_bins=10)
    assert calibration_error(belief, hit) == ten != calibration_error(belief, hit, 11)


def test_areas_of_few_scores_are_counted_by_hand():
    assert roc_area([1.0], [2.0]) == 1
    assert roc_area([2.0], [1.0]) == 0
    assert roc_area([1.0, 1.0], [1.0]) == 0.5
    assert roc_area([1.0, 3.0], [2.0, 4.0, 0.0]) == pytest.approx(3 / 6)
