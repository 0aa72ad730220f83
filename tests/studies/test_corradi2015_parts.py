"""Parts of the Corradi 2015 study against facts known without its code."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.recognition import ObjectRecogniser
from palpate.studies.corradi2015 import Corradi2015Plan
from palpate.studies.corradi2015.episodes import (
    Answered,
    Partition,
    accuracy,
    category_folds,
    confusion,
    draw_orders,
    draw_partition,
    only_idle,
)
from palpate.studies.corradi2015.plan import (
    N_FREQUENCIES,
    N_RINGS,
    Encoded,
    Encoder,
    moment_normalised,
    polar_fourier,
)
from palpate.studies.corradi2015.recognisers import (
    BagOfTouches,
    ClusterBayes,
    Densities,
    Mixtures,
    Nuisance,
)

ROW, COL = np.mgrid[:61, :61] - 30.0


def blob(x, y, width, height, degrees):
    """A skewed smooth patch; its long tail points along `degrees`."""
    turn = np.deg2rad(degrees)
    u = np.cos(turn) * (COL - x) + np.sin(turn) * (ROW - y)
    v = -np.sin(turn) * (COL - x) + np.cos(turn) * (ROW - y)
    along = np.where(u > 0, u / (2 * width), u / width)
    return np.exp(-(along**2) - (v / height) ** 2).astype(np.float32)


def test_partitions_are_disjoint_and_of_the_sizes_asked_for():
    codes = np.repeat([0, 1, 2], [120, 80, 40])
    partition = draw_partition(codes, 60, 30, 45, (0, 1))
    assert_array_equal(np.bincount(codes[partition.train]), [60, 45, 10])
    assert partition.episodes.shape == (3, 30)
    assert not np.isin(partition.episodes, partition.train).any()
    for truth, rows in zip(partition.truth, partition.episodes, strict=True):
        assert (codes[rows] == truth).all()
        assert len(np.unique(rows)) == 30
    again = draw_partition(codes, 60, 30, 45, (0, 1))
    assert_array_equal(again.episodes, partition.episodes)


def test_orders_are_of_one_object_each():
    codes = np.repeat([0, 1], 6)
    episodes, which = draw_orders(codes, 4, 3, (0,))
    assert episodes.shape == (6, 4)
    assert (codes[episodes] == which[:, np.newaxis]).all()
    assert_array_equal(which, [0, 0, 0, 1, 1, 1])


def test_touches_without_contact_become_episodes_of_their_own():
    partition = Partition(np.arange(2), np.array([[2, 3], [4, 5]]), np.array([0, 1]))
    idle = np.array([True, False, False, True, True, True])
    alone = only_idle(partition, idle)
    assert_array_equal(alone.episodes, [[3], [4], [5]])
    assert_array_equal(alone.truth, [0, 1, 1])
    assert only_idle(partition, None) is None
    assert only_idle(partition, np.zeros(6, dtype=bool)) is None


def test_answers_become_shares():
    answers, truth = np.array([[0, 0], [0, 1]]), np.array([0, 1])
    answered = [Answered("ten objects", "drawn", "ours", answers, truth, {})]
    assert_allclose(accuracy(answered), [[0.5, 1.0]])
    assert_allclose(confusion(answered, 1, 2), [[1, 0], [1, 0]])


def test_polar_fourier_does_not_see_the_angle():
    image = blob(5, -4, 4, 3, 20)
    turned = np.stack([np.rot90(image, k) for k in range(4)])
    features = polar_fourier(np.ascontiguousarray(turned))
    # A quarter turn moves samples onto samples, but for single precision.
    assert_allclose(features, features[[0] * 4], atol=1e-5)


def test_rings_are_constant_where_the_image_is_round():
    round_image = np.exp(-(ROW**2 + COL**2) / 200).astype(np.float32)
    features = polar_fourier(round_image[np.newaxis]).reshape(N_RINGS, N_FREQUENCIES)
    assert (features[:, 0] > 0.01).all()
    # What linear interpolation adds to a bell of height 1 and width 14.
    assert_allclose(features[:, 1:], 0, atol=1e-3)


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(blob(6, -5, 4, 3, 0), id="shifted"),
        pytest.param(blob(0, 0, 4, 3, 70), id="turned"),
        pytest.param(blob(0, 0, 4, 3, 180), id="turned over"),
        pytest.param(blob(0, 0, 6, 4.5, 0), id="larger"),
        pytest.param(3 * blob(0, 0, 4, 3, 0), id="stronger"),
    ],
)
def test_moment_normalised_patches_do_not_see_place_angle_size_and_strength(other):
    patches = moment_normalised(np.stack([blob(0, 0, 4, 3, 0), other]))
    assert_allclose(patches.sum(axis=1), 1)
    # Pixels 2 to 5 times smaller than the patch: a few per cent of the largest.
    assert_allclose(patches[1], patches[0], atol=0.06 * patches[0].max())


def test_a_patch_of_nothing_is_zero():
    assert_array_equal(moment_normalised(np.zeros((1, 9, 9), np.float32)), 0)


@pytest.fixture
def two_places():
    """Ten touches of each of two objects: nine at one place, one at the other's."""
    places = np.array([[0.0, 0.0], [10.0, 0.0]])
    which = np.r_[[0] * 9, 1, [1] * 9, 0]
    jitter = 1e-3 * np.random.default_rng(0).normal(size=(20, 2))
    return places[which] + jitter, np.repeat([0, 1], 10), places


def test_clusters_count_touches_with_one_added(two_places):
    train, codes, places = two_places
    episodes = np.repeat(places[:1], 3, axis=0)[np.newaxis]
    scores = ClusterBayes((2,)).scores(train, codes, episodes)
    odds = scores[0, :, 0] - scores[0, :, 1]
    # (9 + 1) / (10 + 2) against (1 + 1) / (10 + 2), each time.
    assert_allclose(odds, np.log(5) * np.arange(1, 4))


def test_bags_compare_histograms_by_chi_squared(two_places):
    train, codes, places = two_places
    episodes = places[[0, 1]][np.newaxis]
    scores = BagOfTouches((2,)).scores(train, codes, episodes)[0]
    touched = np.array([[1.0, 0.0], [0.5, 0.5]])
    learnt = np.array([[0.9, 0.1], [0.1, 0.9]])
    expected = [[-((s - k) ** 2 / (s + k)).sum() / 2 for k in learnt] for s in touched]
    assert_allclose(scores, expected)


def test_the_number_of_clusters_is_the_one_that_recognises():
    rng = np.random.default_rng(0)
    corners = np.array([[0, 0], [9, 9], [0, 9], [9, 0]], dtype=float)
    codes = np.repeat([0, 1], 24)
    # Diagonal corners belong together: two clusters cannot tell the objects apart.
    which = np.r_[np.tile([0, 1], 12), np.tile([2, 3], 12)]
    train = corners[which] + 0.1 * rng.normal(size=(48, 2))
    assert BagOfTouches((1, 4)).choose(train, codes) == 4


def test_one_component_is_the_gaussian_of_the_object(rng):
    codes = np.repeat([0, 1], 40)
    train = rng.normal(size=(80, 2)) + 3 * codes[:, np.newaxis]
    episodes = rng.normal(size=(5, 1, 2)) + 1.5
    scores = Mixtures(1).scores(train, codes, episodes)[:, 0]
    densities = []
    for code in (0, 1):
        of_object = train[codes == code]
        covariance = np.cov(of_object.T, bias=True)
        away = episodes[:, 0] - of_object.mean(axis=0)
        squared = np.einsum("ij,jk,ik->i", away, np.linalg.inv(covariance), away)
        densities.append(-0.5 * (squared + np.log(np.linalg.det(covariance))))
    odds = densities[1] - densities[0]
    # The lift of the covariances is a thousandth of the variance.
    assert_allclose(scores[:, 1] - scores[:, 0], odds, atol=0.05)


@pytest.mark.parametrize(("n_touches", "singular"), [(30, 0.0), (4, 100.0)])
def test_fewer_touches_than_features_make_singular_covariances(
    rng, n_touches, singular
):
    codes = np.repeat(np.arange(20), n_touches)
    facts = Mixtures(1).facts(rng.normal(size=(len(codes), 6)), codes)
    assert facts["n_features"] == 6
    assert facts["parameters"] == 6 + 21
    assert facts["singular"] == singular


def test_a_control_that_tells_everything_is_seen(rng):
    codes = np.repeat([0, 1], 12)
    train = codes[:, np.newaxis] + 0.01 * rng.normal(size=(24, 2))
    scores = Nuisance("brightness").scores(train, codes, np.ones((1, 2, 2)))
    assert_array_equal(scores.argmax(axis=-1), [[1, 1]])


@pytest.fixture
def dome_touches(rng):
    """Touches of two objects seen by a small round camera picture."""
    row, col = np.mgrid[:60, :60] - 29.5
    inside = np.hypot(row, col) < 27
    images = []
    for number in range(24):
        pressed = np.exp(-((row - 6 * (number % 2)) ** 2 + col**2) / 60)
        image = 90 + 70 * pressed + row + rng.normal(scale=2, size=row.shape)
        images.append(cv2.GaussianBlur(np.where(inside, image, 20.0), (3, 3), 0))
    names = np.array(["pen", "mug"] * 12)
    return Touches(
        np.clip(images, 0, 255).astype(np.uint8),
        object=names,
        category=np.where(names == "pen", "stick", "cup"),
        geometry="dome",
    )


def test_densities_are_the_preset(dome_touches):
    encoded = Encoder(dome_touches)(dome_touches)
    values = encoded.features["Zernike"]
    rows = np.array([[0, 2, 4], [1, 3, 5]])
    scores = Densities().scores(values, encoded.codes, values[rows])
    recogniser = ObjectRecogniser("corradi2015").fit(dome_touches)
    for episode, belief_rows in zip(scores, rows, strict=True):
        belief = recogniser.start(strangers=0)
        for after, row in zip(episode, belief_rows, strict=True):
            belief.update(dome_touches[int(row)])
            posterior = [belief.posterior[name] for name in encoded.names.tolist()]
            # Discs are in single precision; posteriors near 0 and 1 hide no more.
            assert_allclose(np.exp(after), posterior, atol=1e-4)


def test_all_features_are_finite_and_one_row_a_touch(dome_touches):
    encoded = Encoder(dome_touches)(dome_touches)
    for values in encoded.features.values():
        assert len(values) == len(dome_touches)
        assert np.isfinite(values).all()
    assert encoded.idle is None


def test_a_category_is_tested_on_objects_that_were_not_learnt():
    objects = np.repeat(["mug_a", "mug_b", "pen_a", "pen_b", "pen_c"], 25)
    category = np.char.partition(objects, "_")[:, 0]
    touches = Touches(np.zeros((125, 8, 8)), object=objects, category=category)
    names, codes = np.unique(objects, return_inverse=True)
    encoded = Encoded(names, codes, {}, None)
    by_category, folds = category_folds(Corradi2015Plan(orders=2), touches, encoded)
    assert len(folds) == 2
    for fold in folds:
        tested = np.unique(objects[fold.episodes])
        assert len(tested) == 2
        assert not np.isin(tested, objects[fold.train]).any()
        truth = by_category.names[fold.truth]
        assert_array_equal(category[fold.episodes[:, 0]], truth)
