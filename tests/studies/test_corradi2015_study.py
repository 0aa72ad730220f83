"""The Corradi 2015 study on few touches: its rows, and that they repeat."""

import json
from functools import partial

import numpy as np
import pytest

from palpate.simulation import DomeCamera, simulate_touches
from palpate.studies import STUDIES, run_study
from palpate.studies.corradi2015 import Corradi2015Plan, pictures
from palpate.studies.corradi2015.episodes import worst_pairs

from .conftest import page_of, rows_of, titles_of

STUDY = STUDIES["corradi2015"]

TINY = {
    "partitions": 2,
    "default_partitions": 1,
    "n_train": 8,
    "n_test": 4,
    "few_train": 6,
    "touches": (1, 4, 30),
    "n_simulated": 12,
    "orders": 2,
    "clusters": (4, 8),
    "components": (1, 2),
    "timed": (60,),
    "later": False,
}


@pytest.fixture(scope="module")
def small_camera():
    small = partial(simulate_touches, camera=DomeCamera(image_shape=(64, 64)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.studies.corradi2015.plan.simulate_touches", small)
        yield


@pytest.fixture(scope="module")
def result(small_camera):
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PALPATE_DATA", raising=False)
        plan = Corradi2015Plan(**TINY)
        return run_study("corradi2015", plan=plan, workers=1, progress=False)


def test_every_recogniser_has_a_figure_after_each_number_of_touches(result):
    rows = rows_of(result, table="ten objects")
    names = {row["recogniser"] for row in rows}
    assert {"corradi2015", "default", "k-means", "mixtures of 2"} <= names
    assert {"bag, Fourier", "bag, moments", "disc centre", "brightness"} <= names
    for name in names - {"idle, corradi2015", "idle, default"}:
        # 30 touches are more than an episode has.
        touches = [row["touches"] for row in rows_of(result, recogniser=name)]
        assert touches[:2] == [1, 4]
    for row in rows:
        assert 0 <= row["ours"] <= 100
        assert row["data"] == "simulated"
        assert row["partitions"] in (1, 2)


def test_the_same_camera_at_the_same_place_tells_no_object(result):
    # Chance is 10 %; after 4 touches of 10 objects 50 % has a chance below 1e-3.
    (row,) = rows_of(result, recogniser="disc centre", touches=4)
    assert row["ours"] < 50


def test_mixtures_say_how_under_determined_they_are(result):
    row = rows_of(result, recogniser="mixtures of 2")[0]
    n = row["n_features"]
    # Eight touches an object cannot span two covariances of more features.
    assert n > 8
    assert row["singular"] == 100
    whole = [2 * (k + k * (k + 1) / 2) + 1 for k in (np.floor(n), np.ceil(n))]
    assert whole[0] <= row["parameters"] <= whole[1]


def test_confusions_are_shares_and_pairs_are_sorted():
    confusion = np.array([[0.6, 0.4, 0.0], [0.2, 0.7, 0.1], [0.0, 0.0, 1.0]])
    pairs = worst_pairs(confusion, ["pen", "brush", "mug"])
    assert pairs[0] == {"objects": ["pen", "brush"], "share": pytest.approx(30.0)}
    assert pairs[1] == {"objects": ["brush", "mug"], "share": pytest.approx(5.0)}


def test_objects_never_learnt_share_one_belief(result):
    curves = result["unseen"]["simulated"]["corradi2015"]
    assert len(curves) == 5
    for curve in curves.values():
        assert np.shape(curve) == (4, 10)
        # Ten numbers rounded to four decimals.
        np.testing.assert_allclose(np.sum(curve, axis=1), 1, atol=5e-4)


def test_timings_stand_beside_the_papers(result):
    rows = rows_of(result, table="timings")
    encode = next(row for row in rows if row["name"].startswith("Zernike"))
    assert encode["paper"] == 3.7
    assert all(row["unit"] == "ms" and row["ours"] > 0 for row in rows)


def test_missing_touches_are_named_as_skipped_and_json_holds_everything(result):
    assert "`data` or PALPATE_DATA" in result["skipped"][0]
    assert json.loads(json.dumps(result))["study"] == "corradi2015"


@pytest.mark.slow
def test_the_same_seed_gives_the_same_figures(result, monkeypatch):
    monkeypatch.delenv("PALPATE_DATA", raising=False)
    plan = Corradi2015Plan(**{**TINY, "default_partitions": 0})
    again = run_study("corradi2015", plan=plan, workers=1, progress=False)
    for name in ("corradi2015", "bag, moments", "mixtures of 2"):
        assert rows_of(again, recogniser=name, table="ten objects") == rows_of(
            result, recogniser=name, table="ten objects"
        )
    assert again["unseen"] == result["unseen"]


@pytest.mark.slow
def test_tables_pictures_and_report(result, tmp_path, monkeypatch):
    drawn = pictures(result)
    monkeypatch.setattr("palpate.studies.corradi2015.pictures", lambda _: drawn)
    titles = titles_of(STUDY, result)
    assert titles[0].startswith("Ten objects, simulated")
    assert "Milliseconds, one thread" in titles
    names = [path.name for path in STUDY.write_pictures(tmp_path, result)]
    assert names == [
        f"corradi2015-{n}.png" for n in ("accuracy", "confusion", "unseen")
    ]
    page, shown = page_of(STUDY, result, tmp_path)
    assert "Most confused pairs" in page
    assert [text.split(":")[0] for text in shown] == ["Fig. 7", "Fig. 6", "Fig. 8"]


@pytest.mark.slow
@pytest.mark.realdata
def test_recorded_touches_are_recognised_as_the_paper_says(data_folder):
    result = run_study("corradi2015", data=data_folder, quick=True, progress=False)
    figures = {
        row["touches"]: row["ours"]
        for row in rows_of(result, data="bathtip", recogniser="corradi2015")
        if row["table"] == "ten objects"
    }
    # Five partitions of ten objects: a standard error of 5 points after 15 touches.
    assert figures[15] == pytest.approx(87, abs=9)
    assert figures[30] == pytest.approx(95, abs=9)
