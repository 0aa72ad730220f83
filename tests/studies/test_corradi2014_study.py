"""The Corradi 2014 study on few touches: its rows, and its statistics."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.decomposition import PCA

from palpate import Touches
from palpate.encodings import OrientedPCA, ZernikePCA
from palpate.evaluation import davies_bouldin
from palpate.simulation import DomeCamera, simulate_touches
from palpate.studies import STUDIES, run_study
from palpate.studies.corradi2014 import Corradi2014Plan, pictures
from palpate.studies.corradi2014.judging import (
    Recording,
    answers,
    candidate_features,
    compare_fold,
    compared_rows,
    corrected_t_test,
    encode,
    holm,
    judge,
    judge_unseen,
)
from palpate.studies.corradi2014.plan import (
    CLASSIFIERS,
    COUNTS,
    TABLE_2,
    Shapes,
    near_duplicates,
    recorded_shapes,
    variants,
)

from .conftest import page_of, titles_of

STUDY = STUDIES["corradi2014"]
TINY = Corradi2014Plan.quick(
    n_touches=10, encodings=("hu", "zernike-pca"), choice_step=8, runs=1
)


@pytest.fixture(scope="module")
def in_few_pixels():
    camera = DomeCamera(image_shape=(64, 64))

    def small(objects, n_touches, sensor, *more, **others):
        return simulate_touches(objects, n_touches, sensor or camera, *more, **others)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.studies.corradi2014.plan.simulate_touches", small)
        yield


@pytest.fixture(scope="module")
def result(in_few_pixels):
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PALPATE_DATA", raising=False)
        return run_study("corradi2014", plan=TINY, workers=1)


def stripes(codes, rng):
    """Noisy discs of as many waves as their code, and one more."""
    x = np.linspace(-1, 1, 32)
    waves = np.sin(2 * np.pi * (codes[:, None, None] + 1) * x) * np.ones((32, 1))
    noisy = waves + rng.normal(scale=0.5, size=waves.shape)
    return (noisy * (np.hypot(x[:, None], x) <= 1)).astype(np.float32)


@pytest.fixture
def discs(rng):
    codes = np.repeat([0, 1, 2], 20)
    return stripes(codes, rng), codes


def test_every_row_has_a_figure_and_a_name_of_its_own(result):
    assert result["study"] == "corradi2014"
    names = [(row["name"], row["data"], row["table"]) for row in result["rows"]]
    assert len(set(names)) == len(names)
    for row in result["rows"]:
        assert {"name", "paper", "ours", "sd", "data", "unit"} <= set(row)
        assert row["ours"] >= 0
        assert row["unit"] == "index" or row["ours"] <= 100
        assert row["data"] in ("simulated", "simulated-pins")


def test_every_encoding_meets_every_classifier_on_both_images(result):
    rows = [row for row in result["rows"] if row["table"] == "Fig. 3"]
    combinations = {
        (r["data"], r["encoding"], r["classifier"], r["variant"], r["folds"])
        for r in rows
    }
    assert len(combinations) == len(rows) == 2 * 2 * len(CLASSIFIERS) * 2 * 2
    assert [row["paper"] for row in rows if row["paper"]] == [96.4]


def test_table_2_stands_beside_the_paper(result):
    for row in result["rows"]:
        if row["table"] == "Table 2":
            sensor = ["simulated", "simulated-pins"].index(row["data"])
            published = TABLE_2[row["encoding"]][row["variant"]][sensor]
            assert row["paper"] == (published if row["q"] == 2 else None)


def test_image_and_derivative_are_tested_in_pairs(result):
    assert len(result["paired"]) == 2 * 2 * len(CLASSIFIERS)
    for row in result["paired"]:
        assert 0 <= row["p"] <= row["p_together"] <= 1
    assert set(result["duplicates"]) == {"simulated", "simulated-pins"}


def test_missing_touches_are_told(result):
    assert len(result["skipped"]) == 2
    assert all("PALPATE_DATA" in sentence for sentence in result["skipped"])


def test_tables_and_report_show_every_figure(result, tmp_path):
    again = json.loads(json.dumps(result))
    titles = [title.split(":")[0] for title in titles_of(STUDY, again)[:3]]
    assert titles == ["Table 2", "Fig. 3", "Fig. 3"]
    page, shown = page_of(STUDY, again, tmp_path)
    assert [text.split(":")[0] for text in shown] == ["Fig. 2", "Table 2", "Fig. 3"]
    assert "96.4" in page


@pytest.mark.slow
def test_pictures_have_a_panel_per_set(result):
    drawn = pictures(result)
    assert len(drawn["table2"].axes) == 2
    assert len(drawn["fig3"].axes) == 4


def shapes_of(discs, codes, test_images=None):
    place = np.tile(np.arange(20), 3)
    images = variants(discs)
    return Shapes("drawn", images, test_images, codes, place % 5, place // 10)


@pytest.mark.slow
def test_labels_of_the_second_half_do_not_choose(discs, rng):
    images, codes = discs
    plan = Corradi2014Plan.quick(choice_step=2)
    straight = judge(shapes_of(images, codes), "image", "hu", plan)
    spoilt = codes.copy()
    second = np.tile(np.arange(20), 3) >= 10
    spoilt[second] = rng.permutation(spoilt[second])
    other = judge(shapes_of(images, spoilt), "image", "hu", plan)

    def chosen(judged):
        return [row["n_components"] for row in judged.rows]

    assert chosen(other) == chosen(straight)
    assert [r["ours"] for r in other.rows] != [r["ours"] for r in straight.rows]


@pytest.mark.slow
def test_turned_test_images_lower_pixels_and_not_moments(discs):
    images, codes = discs
    test_images = variants(np.ascontiguousarray(images.transpose(0, 2, 1)))
    plan = Corradi2014Plan.quick(choice_step=2)
    by_encoding = {
        name: judge(shapes_of(images, codes, test_images), "image", name, plan)
        for name in ("zernike", "zernike-pca")
    }
    for judged in by_encoding.values():
        assert judged.folds["1-NN"].mean() > 95
        assert not [row for row in judged.rows if row["table"] == "Table 2"]


@pytest.mark.parametrize(
    ("name", "encoder"), [("zernike-pca", ZernikePCA), ("oriented-pca", OrientedPCA)]
)
def test_components_of_a_fold_are_those_of_the_estimator(name, encoder, discs):
    images, _ = discs
    train, test = np.arange(0, 60, 2), np.arange(1, 60, 2)
    encoded = encode(name, images, None, (2, 5))
    ours = encoded.features(train, test, (2, 5))
    theirs = encoder(5).fit(images[train])
    for count in (2, 5):
        for part, rows in zip(ours[count], (train, test), strict=True):
            # Signs of directions are arbitrary; digits lost by squaring features.
            expected = np.abs(theirs.transform(images[rows])[:, :count])
            assert_allclose(np.abs(part), expected, atol=1e-5 * expected.max())


def test_fewer_touches_than_components_have_fewer_directions(rng):
    images = rng.normal(size=(6, 24, 24)).astype(np.float32)
    rows = np.arange(6)
    (both,) = (
        encode("zernike-pca", images, None, (40,)).features(rows, rows, (40,)).values()
    )
    features = encode("zernike", images, None, (71,)).train[71]
    assert both[0].shape == (6, 5)
    variances = PCA(5).fit(features).explained_variance_
    assert_allclose(both[0].var(axis=0, ddof=1), variances, rtol=1e-6)


@pytest.mark.parametrize("kind", CLASSIFIERS)
def test_every_classifier_learns_two_far_clusters(kind, rng):
    train = np.r_[rng.normal(size=(20, 2)), 30 + rng.normal(size=(20, 2))]
    codes = np.repeat([0, 1], 20)
    predicted = answers(kind, train, codes, np.array([[0.0, 0.0], [30.0, 30.0]]), 0)
    assert_array_equal(predicted, [0, 1])


def test_corrected_t_test_is_wider_than_the_plain_one():
    differences = np.array([[1.0, 2.0, 3.0, 2.0, 2.0]])
    mean, error, p = corrected_t_test(differences)
    # Variance 0.5; (1 / 5 + 1 / 4) * 0.5 = 0.225 instead of 0.1.
    assert (mean, error) == (2.0, pytest.approx(np.sqrt(0.225)))
    assert 0.005 < p < 0.05
    assert corrected_t_test(np.zeros((2, 5))) == (0.0, 0.0, 1.0)
    assert corrected_t_test(np.ones((2, 5))) == (1.0, 0.0, 0.0)


def test_holm_steps_down():
    # 0.01 * 4, 0.02 * 3, 0.03 * 2 raised to the one before, 0.5.
    assert_allclose(holm([0.02, 0.5, 0.01, 0.03]), [0.06, 0.5, 0.04, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]


def test_repeated_touches_are_counted(rng):
    discs = rng.normal(size=(10, 8, 8)).astype(np.float32)
    assert near_duplicates(discs) == 0
    discs[3] = 2 * discs[7]
    assert near_duplicates(discs) == 20


@pytest.fixture
def recording(rng):
    """Two categories of three objects, ten touches each: one wave, or two."""
    codes, objects = np.repeat([0, 1], 30), np.repeat(np.arange(6), 10)
    return Recording(variants(stripes(codes, rng)), codes, objects, objects % 3)


def test_unseen_objects_of_clear_categories_are_named(recording):
    plan = Corradi2014Plan.quick(fold_limit=3, thinning=1)
    rows = judge_unseen(recording, "image", "zernike-pca", plan)
    assert [row["classifier"] for row in rows] == list(CLASSIFIERS)
    assert rows[0]["ours"] > 90
    assert len(rows[0]["n_components"]) == 3


def test_the_best_encoding_is_chosen_without_the_tested_objects(recording):
    plan = Corradi2014Plan.quick(fold_limit=3, thinning=1)
    names = ("zernike-pca", "zernike")
    features = {name: candidate_features(recording, name) for name in names}
    first = compare_fold(recording, features, 0, plan)
    broken = {n: [p.copy() for p in parts] for n, parts in features.items()}
    for parts in broken.values():
        parts[0][recording.fold == 0] = 0
    second = compare_fold(recording, broken, 0, plan)
    assert second["inner"] == first["inner"]
    assert second["right"] != first["right"]
    rows = compared_rows([first, second])
    lead = {r["after"]: r["ours"] for r in rows if "less" in r["name"]}
    assert set(lead) == {1, 10}


def test_candidates_and_counts_are_known():
    plan = Corradi2014Plan()
    assert plan.candidates[0] == "zernike-pca"
    assert Corradi2014Plan.quick().candidates == plan.candidates[:3]
    assert set(plan.encodings) <= set(COUNTS)
    assert plan.counts("hu") == (1, 2, 3, 4, 5, 6, 7)
    assert Corradi2014Plan.quick().counts("hu") == (3, 7)


def test_a_first_look_names_recorded_shapes_with_turned_tests_alone(rng):
    images = rng.integers(0, 255, (20, 32, 32), dtype=np.uint8)
    touches = Touches(images, object=np.repeat(["flat", "edge"], 10))
    names = [s.data for s in recorded_shapes(touches, 0)]
    assert names == ["tactip4", "tactip4, test turned"]
    first_look = Corradi2014Plan.quick()
    (turned,) = recorded_shapes(touches, 0, upright=first_look.recorded_upright)
    assert turned.data == "tactip4, test turned"
    assert not np.allclose(turned.test_images["image"], turned.images["image"])


@pytest.mark.slow
@pytest.mark.realdata
def test_quick_has_rows_of_recorded_touches(data_folder):
    measured = run_study(
        "corradi2014", data=data_folder, quick=True, workers=1, progress=False
    )
    sets = {row["data"] for row in measured["rows"] if "data" in row}
    assert {"tactip4, test turned", "bathtip50, unseen objects"} <= sets


def test_the_index_is_that_of_the_second_half(discs):
    images, codes = discs
    plan = Corradi2014Plan.quick(choice_step=8)
    judged = judge(shapes_of(images, codes), "image", "hu", plan)
    second = np.tile(np.arange(20), 3) >= 10
    features = encode("hu", images, None, (7,)).train[7]
    (row,) = [r for r in judged.rows if r.get("q") == 2]
    assert row["n_components"] == 7
    assert row["ours"] == pytest.approx(davies_bouldin(features[second], codes[second]))
