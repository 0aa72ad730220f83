"""The Davies-Bouldin index against closed forms and scikit-learn."""

import numpy as np
import pytest
from sklearn.metrics import davies_bouldin_score

from palpate.evaluation import davies_bouldin


@pytest.mark.parametrize(
    ("points", "labels", "index"),
    [
        ([[0, 0], [2, 2], [3, 3], [5, 5]], [0, 0, 1, 2], (5 / 4) / 3),
        ([[0, 1], [1, 1], [3, 4]], [0, 0, 1], 0.12803687993289598),
    ],
)
def test_known_values_of_mean_radii(points, labels, index):
    # Sums of a few numbers.
    assert davies_bouldin(points, labels, q=1) == pytest.approx(index, rel=1e-14)


def test_mean_radii_are_scikit_learns(rng):
    touches, labels = rng.normal(size=(60, 5)), rng.integers(4, size=60)
    expected = davies_bouldin_score(touches, labels)
    assert davies_bouldin(touches, labels, q=1) == pytest.approx(expected, rel=1e-12)


def test_root_mean_square_radii_are_eq_9():
    # Distances to the centroids: (3, 1, 1, 3) about 0 and 1, 1 about 10.
    points = [[-3.0], [-1.0], [1.0], [3.0], [9.0], [11.0]]
    labels = ["a"] * 4 + ["b"] * 2
    assert davies_bouldin(points, labels) == pytest.approx((np.sqrt(5) + 1) / 10)
    assert davies_bouldin(points, labels, q=1) == pytest.approx((2 + 1) / 10)


def test_each_cluster_counts_its_worst_neighbour():
    points = [[0.0], [2.0], [4.0], [6.0], [100.0], [102.0]]
    labels = [0, 0, 1, 1, 2, 2]
    # Radii 1; centroids 1, 5, 101: 2 / 4, 2 / 4, 2 / 96.
    assert davies_bouldin(points, labels) == pytest.approx((0.5 + 0.5 + 2 / 96) / 3)


def test_scale_and_place_do_not_matter(rng):
    touches, labels = rng.normal(size=(30, 3)), np.arange(30) % 3
    moved = davies_bouldin(7 - 3 * touches, labels)
    assert moved == pytest.approx(davies_bouldin(touches, labels), rel=1e-12)


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


@pytest.mark.parametrize("q", [1, 2, 300])
@pytest.mark.parametrize("scale", [1e-200, 100.0, 1e200])
def test_immense_and_tiny_features_and_powers_are_borne(q, scale, rng):
    touches, labels = rng.normal(size=(30, 3)), np.arange(30) % 3
    index = davies_bouldin(touches, labels, q=q)
    assert np.isfinite(index)
    assert davies_bouldin(scale * touches, labels, q=q) == pytest.approx(index, 1e-9)


def test_large_powers_are_the_largest_distance():
    # Distances 1 and 3 about 0, all 1 about 10; the 300th mean is nearly the largest.
    points = [[-3.0], [-1.0], [1.0], [3.0], [9.0], [11.0]]
    labels = ["a"] * 4 + ["b"] * 2
    expected = (3 * 0.5 ** (1 / 300) + 1) / 10
    assert davies_bouldin(points, labels, q=300) == pytest.approx(expected, rel=1e-12)


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
