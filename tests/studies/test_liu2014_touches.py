"""The touches of the Liu 2014 study, what is counted on them, and twofold runs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.model_selection import StratifiedKFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from palpate import Touches
from palpate.encodings import KernelPCA
from palpate.simulation import find_parts, simulate_presses
from palpate.studies.liu2014 import (
    REAL,
    Liu2014Plan,
    recorded_touches,
    reposed_presses,
    simulated_presses,
)
from palpate.studies.liu2014.methods import (
    Fused,
    GaussianSVM,
    Half,
    Job,
    Neighbours,
    median_distance,
    nested_figure,
    paper_figure,
)
from palpate.studies.liu2014.plan import (
    CLASS_SETS,
    count_pieces,
    encode,
    footprints,
    overlap,
)


def test_class_sets_are_those_of_the_parts():
    parts = find_parts()
    hollow = tuple(part.number for part in parts if part.hollow)
    solid = tuple(
        part.number for part in parts if not part.hollow and part.category != "bar"
    )
    assert CLASS_SETS["all hollow"] == hollow == (3, 5, 7, 9, 11)
    assert CLASS_SETS["all solid"] == solid == (4, 6, 8, 10, 12)
    assert CLASS_SETS["all"] == tuple(part.number for part in parts)
    assert CLASS_SETS["3 vs 7 vs 12"] == (3, 7, 12)


def test_class_sets_need_two_pressed_parts():
    class_sets = Liu2014Plan(parts=(3, 7, 12)).class_sets
    assert class_sets == {
        "3 vs 7 vs 12": (3, 7, 12),
        "all hollow": (3, 7),
        "all": (3, 7, 12),
    }


def test_every_condition_presses_the_same_places(tiny_plan):
    plan = tiny_plan()
    light, heavy = (simulated_presses(plan, load) for load in (1.0, 5.0))
    thick = simulated_presses(plan, cover_mm=2.0)
    for other in (heavy, thick):
        for column in ("position_mm", "angle_deg", "tilt_deg", "part"):
            assert_array_equal(other.columns[column], light.columns[column])
        assert (other.images != light.images).any()


def test_the_plan_changes_how_parts_are_pressed(tiny_plan):
    touches = simulated_presses(tiny_plan(presses={"max_turn_deg": 5.0}))
    angle = (touches.columns["angle_deg"] + 180) % 360 - 180
    assert np.abs(angle).max() <= 5


def test_a_condition_is_pressed_with_its_own_load(tiny_plan):
    """Rows that are called 1 kgf were pressed with the load of `presses`."""
    plan = tiny_plan(presses={"load_kgf": (3.0, 4.5)})
    assert np.ptp(simulated_presses(plan).columns["force_n"]) > 1
    assert_array_equal(simulated_presses(plan, 1.0).columns["force_n"], 9.80665)


def test_reposing_leaves_shape_and_takes_strength(rng):
    images = np.zeros((8, 10, 10))
    images[:, 4:6, 4:6] = 100 * rng.uniform(1, 9, (8, 1, 1))
    images[0] = 0
    touches = Touches(images, object=list("abcdabcd"))
    reposed = reposed_presses(touches, seed=3)
    total = reposed.images.sum(axis=(1, 2))
    assert total[0] == 0
    assert ((total[1:] >= 0.8) & (total[1:] <= 1.2)).all()
    assert np.ptp(total[1:]) > 0.05
    assert_array_equal(reposed.object, touches.object)
    assert_array_equal(reposed.images, reposed_presses(touches, seed=3).images)
    assert (reposed.images != reposed_presses(touches, seed=4).images).any()


def test_features_are_joined_geometry_first(tiny_plan):
    encoded = encode(simulated_presses(tiny_plan()).images, 2, 40)
    both = encoded.features("FD+GE", 5)
    assert_array_equal(both[:, :2], encoded.features("GE", 40))
    assert_array_equal(both[:, 2:], encoded.features("FD", 5))
    assert encoded.features("FD+GE", 40).shape == (18, 42)


@pytest.mark.parametrize("by_argument", [True, False], ids=["data", "environment"])
def test_recorded_presses_are_found_by_argument_or_environment(
    by_argument, tmp_path, monkeypatch
):
    (tmp_path / "taxel10x10").mkdir()
    touches = Touches(np.ones((2, 10, 10)), object=["a", "b"])
    touches.save(tmp_path / "taxel10x10" / "taxel10x10.npz")
    monkeypatch.setenv("PALPATE_DATA", "" if by_argument else str(tmp_path))
    loaded = recorded_touches(tmp_path if by_argument else None, REAL)
    assert_array_equal(loaded.images, touches.images)


def test_missing_presses_are_a_sentence_or_a_refusal(tmp_path, monkeypatch):
    monkeypatch.delenv("PALPATE_DATA", raising=False)
    assert "`data` or PALPATE_DATA" in recorded_touches(None, REAL)
    monkeypatch.setenv("PALPATE_DATA", str(tmp_path))
    left_out = recorded_touches(None, REAL)
    assert f"{tmp_path} has no" in left_out
    assert "`fetch(taxel10x10)`" in left_out
    fix = r"a folder that holds .*Call `fetch\(taxel10x10\)` with that folder, or leave"
    with pytest.raises(ValueError, match=fix):
        recorded_touches(tmp_path / "gone", REAL)


def test_pieces_touch_at_corners():
    images = np.zeros((4, 5, 5), dtype=bool)
    images[1, [0, 1], [0, 1]] = True
    images[2, [0, 2], [0, 2]] = True
    images[3] = True
    assert_array_equal(count_pieces(images), [0, 1, 2, 1])


def test_overlap_is_shared_over_either():
    images = np.zeros((3, 4, 4), dtype=bool)
    images[0, :2] = images[1, :2] = True
    others = np.zeros_like(images)
    others[0, :2] = others[1, 1:3] = True
    assert_allclose(overlap(images, others), [1, 1 / 3, 0])


def test_footprints_have_the_area_of_the_parts():
    names = ["square13", "square13-hole8", "hexagon10-hole6", "disc13"]
    touches = simulate_presses(names, 4, random_state=0)
    pixel_mm2 = (20 / 66) ** 2
    area = footprints(touches, (66, 66)).sum(axis=(1, 2)) * pixel_mm2
    true = [part.area_mm2 for part in find_parts(names) for _ in range(4)]
    # Pixels along the edge are in or out: about half a pixel's width at random.
    assert_allclose(area, true, rtol=0.03)


def test_footprints_lie_where_the_presses_are():
    touches = simulate_presses(
        "square13", 3, tilt_sd_deg=0, roughness_um=0, random_state=1
    )
    whole = encode(touches.images, 1, 1).binary
    true_footprints = footprints(touches, (33, 33))
    for image, truth in zip(whole, true_footprints, strict=True):
        centre = np.argwhere(image).mean(axis=0)
        # Gains and the gaps between taxels move it by less than half a taxel.
        assert_allclose(np.argwhere(truth).mean(axis=0), centre, atol=1.0)


def half_of(method, features, codes, train, test, scaling="z-scored"):
    """Choose on one half and test on the other."""
    job = Job({"features": scaling}, features, codes, method)
    return job.half(train, test, seed=0, inner_folds=2)


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
    """A method with three settings that remembers its training touches and labels."""

    settings = ({"k": 1}, {"k": 3}, {"k": 5})

    def __init__(self):
        self.training = []

    def answers(self, train, codes, test):
        self.training.append((train.copy(), codes.copy()))
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
    honest = half_of(method, features, codes, train, test)
    poisoned = codes.copy()
    poisoned[test] = (codes[test] + 1) % 3
    wrong = half_of(method, features, poisoned, train, test)
    assert wrong.chosen == honest.chosen
    assert (wrong.right != honest.right).any()
    moved = features.copy()
    moved[test] = rng.normal(scale=1e3, size=moved[test].shape)
    assert half_of(method, moved, codes, train, test).chosen == honest.chosen


def test_a_method_is_only_shown_training_touches(clouds, halves):
    features, codes = clouds
    train, test = halves
    method = Recorder()
    half_of(method, features, codes, train, test, "raw")
    allowed = {tuple(row) for row in features[train]}
    assert [len(training) for training, _ in method.training] == [15, 15, 30]
    for training, _ in method.training:
        assert {tuple(row) for row in training} <= allowed


def test_the_choice_prefers_the_setting_that_generalises(clouds, halves):
    features, codes = clouds
    # A kernel far narrower than any distance knows nothing of other touches.
    method = GaussianSVM((1e-3, 1.0), (10.0,))
    half = half_of(method, features, codes, *halves)
    assert half.chosen == 1
    assert half.right[1] > half.right[0]


def test_a_run_tests_every_touch_once(clouds):
    features, codes = clouds
    job = Job({"features": "raw"}, features, codes, Neighbours())
    run = job.run(Liu2014Plan(), 1)
    assert [half.n_test for half in run] == [30, 30]


def test_figures_are_those_worked_out_by_hand():
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
    half = half_of(method, features, codes, train, test)
    assert half.right[0] == reference.score(features[test], codes[test])


def test_a_constant_feature_does_not_matter(clouds, halves):
    features, codes = clouds
    padded = np.column_stack([features, np.full(60, 0.1)])
    for method in (GaussianSVM((1.0,), (10.0,)), Neighbours()):
        plain = half_of(method, features, codes, *halves)
        same = half_of(method, padded, codes, *halves)
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
