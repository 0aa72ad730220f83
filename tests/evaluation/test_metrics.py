"""Figures of merit against closed cases."""

import numpy as np
import pytest
from sklearn.metrics import davies_bouldin_score, roc_auc_score

from palpate.evaluation import calibration_error, davies_bouldin, roc_area
from palpate.evaluation._trial import mean_share


def test_bins_have_equal_mass():
    """The error of 25 episodes by hand, in bins of three and of two."""
    confidence, hit = np.linspace(0, 1, 25), np.arange(25) % 2
    ends = np.cumsum([3] * 5 + [2] * 5)[:-1]
    bins = zip(np.split(confidence, ends), np.split(hit, ends), strict=True)
    error = sum(len(b) * abs(b.mean() - h.mean()) for b, h in bins) / 25
    mixed = np.random.default_rng(0).permutation(25)
    assert calibration_error(confidence[mixed], hit[mixed]) == pytest.approx(error)


def test_which_of_equal_beliefs_come_first_does_not_matter(rng):
    hit = np.repeat([1, 0], 10)
    assert calibration_error([0.5] * 20, hit) == 0
    confidence = np.repeat([0.6, 0.9], 10)
    mixed = rng.permutation(20)
    error = calibration_error(confidence, hit)
    assert calibration_error(confidence[mixed], hit[mixed]) == pytest.approx(error)


def test_roc_area_agrees_with_scikit_learn(rng):
    known_scores, unknown_scores = rng.integers(0, 9, 50), rng.integers(3, 12, 40)
    truth = np.repeat([0, 1], [50, 40])
    expected = roc_auc_score(truth, np.r_[known_scores, unknown_scores])
    assert roc_area(known_scores, unknown_scores) == pytest.approx(expected)


def test_there_are_ten_bins_unless_another_number_is_asked_for(rng):
    # Two bins of two: beliefs 0.6 right half the time, beliefs 0.9 always right.
    error = calibration_error([0.6, 0.9, 0.6, 0.9], [0, 1, 1, 1], n_bins=2)
    assert error == pytest.approx((0.1 + 0.1) / 2)
    # Of three episodes each is a bin by itself.
    error = calibration_error([0.1, 0.5, 0.7], [1, 0, 1])
    assert error == pytest.approx((0.9 + 0.5 + 0.3) / 3)
    belief = np.linspace(0.1, 1, 40)
    hit = rng.random(40) < belief
    of_bins = [calibration_error(belief, hit, n_bins) for n_bins in (9, 10, 11)]
    assert len(set(of_bins)) == 3
    assert calibration_error(belief, hit) == of_bins[1]


def test_mean_radii_are_scikit_learns(rng):
    touches, labels = rng.normal(size=(60, 5)), rng.integers(4, size=60)
    expected = davies_bouldin_score(touches, labels)
    assert davies_bouldin(touches, labels, q=1) == pytest.approx(expected, rel=1e-12)


def test_radii_are_means_of_powers_by_hand():
    # Distances to the centroids: (3, 1, 1, 3) about 0 and 1, 1 about 10.
    points = [[-3.0], [-1.0], [1.0], [3.0], [9.0], [11.0]]
    labels = ["a"] * 4 + ["b"] * 2
    assert davies_bouldin(points, labels) == pytest.approx((np.sqrt(5) + 1) / 10)
    # The 300th mean is nearly the largest.
    expected = (3 * 0.5 ** (1 / 300) + 1) / 10
    assert davies_bouldin(points, labels, q=300) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("q", [1, 2])
def test_one_centroid_for_two_clusters_is_infinitely_bad(q):
    points = [[-0.1], [0.1], [-0.3], [0.3], [5.0]]
    assert davies_bouldin(points, [0, 0, 1, 1, 2], q=q) == np.inf
    same = [[2.0], [2.0], [2.0]]
    assert davies_bouldin(same, [0, 1, 2], q=q) == np.inf


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match="at least two different ones, got 1"):
        davies_bouldin([[0.0], [1.0]], ["a", "a"])
    with pytest.raises(ValueError, match="q must be finite and between 1"):
        davies_bouldin([[0.0], [1.0]], ["a", "b"], q=0)
    with pytest.raises(ValueError, match=r"confidence must hold a number .* \(0,\)"):
        calibration_error([], [])
    with pytest.raises(ValueError, match="confidence must hold no NaN, got one"):
        calibration_error([0.5, np.nan], [1, 0])
    with pytest.raises(ValueError, match="each of 2 episodes, got 1"):
        calibration_error([0.5, 0.6], [1])
    with pytest.raises(ValueError, match="n_bins must be at least 1"):
        calibration_error([0.5], [1], n_bins=0)
    with pytest.raises(ValueError, match="unknown_scores must hold a number"):
        roc_area([1.0], [])
    with pytest.raises(ValueError, match="known_scores must hold no NaN"):
        roc_area([np.nan], [1.0])


@pytest.mark.parametrize("q", [1, 2, 300])
@pytest.mark.parametrize("scale", [1e-200, 100.0, 1e200])
def test_immense_and_tiny_features_and_powers_are_borne(q, scale, rng):
    touches, labels = rng.normal(size=(30, 3)), np.arange(30) % 3
    index = davies_bouldin(touches, labels, q=q)
    assert np.isfinite(index)
    assert davies_bouldin(scale * touches, labels, q=q) == pytest.approx(index, 1e-9)


def test_clusters_far_from_the_origin_keep_their_distances(rng):
    # Whole numbers are exact also beside 1e15.
    touches, labels = rng.integers(0, 50, (30, 3)).astype(float), np.arange(30) % 3
    index = davies_bouldin(touches, labels)
    assert davies_bouldin(touches + 1e15, labels) == pytest.approx(index, rel=1e-12)


def test_clusters_of_one_touch_have_no_radius():
    assert davies_bouldin([[0.0], [10.0]], ["a", "b"]) == 0
    # Radii 1 and 0, 9 apart: both clusters count the pair.
    assert davies_bouldin([[0.0], [2.0], [10.0]], ["a", "a", "b"]) == pytest.approx(
        1 / 9
    )


@pytest.mark.parametrize(("share", "is_one"), [(1e-15, True), (1e-13, False)])
def test_centroids_that_rounding_cannot_tell_apart_are_one(share, is_one):
    points = [[-1.0], [1.0], [-1.0 + share], [1.0 + share]]
    index = davies_bouldin(points, [0, 0, 1, 1])
    assert np.isinf(index) == is_one


def test_a_control_that_is_right_as_often_has_the_same_figure():
    """The verdict compares them: by rounding alone neither is ahead."""
    touch, control = np.array([5, 5, 6, 5]) / 6, np.array([4, 5, 6, 6]) / 6
    assert touch.mean() > control.mean()
    assert mean_share(touch) == mean_share(control) == 0.875
