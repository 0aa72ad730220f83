"""Twofold runs with settings chosen inside the training half."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.model_selection import StratifiedKFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from palpate.encodings import KernelPCA
from palpate.studies.liu2014.methods import (
    Fused,
    GaussianSVM,
    Half,
    Neighbours,
    Twofold,
    median_distance,
    nested_figure,
    paper_figure,
)

SCALED = Twofold(scaled=True, inner_folds=2)


@pytest.fixture
def clouds(rng):
    """Three overlapping clouds of 20 touches with 4 features of uneven scale."""
    codes = np.repeat(np.arange(3), 20)
    middles = rng.normal(size=(3, 4))
    features = middles[codes] + 0.8 * rng.normal(size=(60, 4))
    return features * [1, 10, 0.1, 3], codes


@pytest.fixture
def halves(clouds):
    return next(StratifiedKFold(2, shuffle=True, random_state=0).split(*clouds))


class Recorder:
    """A method with three settings that remembers what it was shown."""

    settings = ({"k": 1}, {"k": 3}, {"k": 5})

    def __init__(self):
        self.shown = []

    def answers(self, train, codes, test):
        self.shown.append((train.copy(), codes.copy()))
        return np.concatenate(
            [Neighbours(s["k"]).answers(train, codes, test) for s in self.settings]
        )


METHODS = [
    GaussianSVM((0.1, 1.0, 3.0), (0.1, 10.0)),
    Fused(GaussianSVM((0.1, 1.0), (10.0,)), (0.5, 2.0), (1, 3)),
    Recorder(),
]


@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
def test_the_choice_never_sees_the_test_half(method, clouds, halves, rng):
    features, codes = clouds
    train, test = halves
    honest = SCALED.half(method, features, codes, train, test, 0)
    poisoned = codes.copy()
    poisoned[test] = (codes[test] + 1) % 3
    wrong = SCALED.half(method, features, poisoned, train, test, 0)
    assert wrong.chosen == honest.chosen
    assert (wrong.right != honest.right).any()
    moved = features.copy()
    moved[test] = rng.normal(scale=1e3, size=moved[test].shape)
    assert SCALED.half(method, moved, codes, train, test, 0).chosen == honest.chosen


def test_a_method_is_only_shown_training_touches(clouds, halves):
    features, codes = clouds
    train, test = halves
    method = Recorder()
    raw = Twofold(scaled=False, inner_folds=2)
    raw.half(method, features, codes, train, test, 0)
    allowed = {tuple(row) for row in features[train]}
    assert [len(shown) for shown, _ in method.shown] == [15, 15, 30]
    for shown, _ in method.shown:
        assert {tuple(row) for row in shown} <= allowed


def test_the_choice_prefers_the_setting_that_generalises(clouds, halves):
    features, codes = clouds
    # A kernel far narrower than any distance knows nothing of other touches.
    method = GaussianSVM((1e-3, 1.0), (10.0,))
    half = SCALED.half(method, features, codes, *halves, 0)
    assert half.chosen == 1
    assert half.right[1] > half.right[0]


def test_a_run_tests_every_touch_once(clouds):
    features, codes = clouds
    run = SCALED.run(Neighbours(), features, codes, (0, 1))
    assert [half.n_test for half in run] == [30, 30]


def test_figures_by_hand():
    settings = [{"C": 1}, {"C": 2}]
    runs = [
        [Half(0, np.array([0.5, 1.0]), 10), Half(1, np.array([0.5, 0.8]), 10)],
        [Half(1, np.array([0.0, 0.6]), 10), Half(1, np.array([0.2, 0.4]), 10)],
    ]
    nested = nested_figure(settings, runs)
    # Run 1: (0.5 + 0.8) / 2, run 2: (0.6 + 0.4) / 2; sd with n - 1.
    assert_allclose(nested["ours"], 57.5)
    assert_allclose(nested["sd"], np.std([65, 50], ddof=1))
    assert (nested["chosen"], nested["chosen_share"]) == ({"C": 2}, 0.75)
    paper = paper_figure(settings, runs)
    assert_allclose(paper["ours"], 70.0)
    assert paper["chosen"] == {"C": 2}
    assert nested_figure(settings, runs[:1])["sd"] is None


def test_halves_of_uneven_size_are_pooled_by_touches():
    run = [Half(0, np.array([1.0]), 30), Half(0, np.array([0.0]), 10)]
    assert nested_figure([{}], [run])["ours"] == pytest.approx(75)


def test_scaling_is_that_of_the_training_half(clouds, halves):
    features, codes = clouds
    train, test = halves
    method = GaussianSVM((1.0,), (10.0,))
    unit = median_distance(StandardScaler().fit_transform(features[train]))
    reference = make_pipeline(StandardScaler(), SVC(C=10, gamma=0.5 / unit**2))
    reference.fit(features[train], codes[train])
    half = SCALED.half(method, features, codes, train, test, 0)
    assert half.right[0] == reference.score(features[test], codes[test])


def test_a_constant_feature_does_not_matter(clouds, halves):
    features, codes = clouds
    padded = np.column_stack([features, np.full(60, 0.1)])
    for one in (GaussianSVM((1.0,), (10.0,)), Neighbours()):
        plain = SCALED.half(one, features, codes, *halves, 0)
        same = SCALED.half(one, padded, codes, *halves, 0)
        assert_array_equal(same.right, plain.right)


def test_fusion_is_kernel_pca_then_the_classifier(clouds, halves):
    features, codes = clouds
    train, test = halves
    fused = Fused(Neighbours(), (0.5, 2.0), (2, 5))
    answers = fused.answers(features[train], codes[train], features[test])
    assert len(answers) == len(fused.settings) == 4
    for setting, answer in zip(fused.settings, answers, strict=True):
        sigma = setting["kpca_width"] * median_distance(features[train])
        fusion = KernelPCA(setting["components"], sigma=sigma).fit(features[train])
        scores = fusion.transform(features[train]), fusion.transform(features[test])
        expected = Neighbours().answers(scores[0], codes[train], scores[1])[0]
        assert_array_equal(answer, expected)


def test_three_neighbours_vote():
    train = np.array([[0.0], [1.0], [1.2], [9.0]])
    codes = np.array([0, 1, 1, 2])
    assert Neighbours().answers(train, codes, np.array([[0.2]]))[0, 0] == 1


@pytest.mark.parametrize(
    ("touches", "expected"),
    [([[0.0], [3.0], [3.0]], 3.0), ([[0.0], [1.0], [5.0]], 4.0), ([[2.0], [2.0]], 1.0)],
)
def test_median_distance_of_touches_that_differ(touches, expected):
    assert median_distance(np.array(touches)) == expected
