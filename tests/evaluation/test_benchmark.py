"""The benchmark on drawn sets whose answer is known from how they were drawn."""

import json
import re
import sys

import numpy as np
import pytest

from palpate import Touches
from palpate.evaluation import benchmark

from .conftest import often_idle

NAMES = np.repeat(["a", "b", "c"], 20)


def drawn(images=None, **columns):
    """Three objects of 20 touches; the images are noise unless given."""
    if images is None:
        images = np.random.default_rng(0).normal(size=(60, 3, 8))
    return Touches(images, object=NAMES, geometry="none", **columns)


def entry_of(touches, protocol="blocks", recognisers=("3-NN",), **more):
    options = {"protocols": [protocol], "recognisers": recognisers, **more}
    (entry,) = benchmark({"set": touches}, **options)["benchmark"]
    return entry


def test_where_only_the_load_tells_objects_apart_its_control_is_right():
    rng = np.random.default_rng(0)
    weight = {"a": 1.0, "b": 10.0, "c": 100.0}
    images = rng.random((60, 3, 8))
    images /= images.sum(axis=(1, 2), keepdims=True)
    loads = np.array([weight[name] for name in NAMES])
    entry = entry_of(drawn(images * loads[:, None, None]), recognisers=["3-NN"])
    assert entry["controls"]["total load"] == 1
    assert entry["controls"]["majority"] == pytest.approx(1 / 3)
    # 60 touches at chance: four standard errors.
    assert abs(entry["controls"]["sorted pixels"] - 1 / 3) < 0.25
    assert entry["controls"]["disc centre"] is None


def test_objects_met_in_no_other_session_are_left_out_and_counted():
    session = np.tile(["x", "y"], 30)
    session[NAMES == "c"] = "x"
    entry = entry_of(drawn(session=session), "sessions")
    assert entry["left_out"] == ["c"]
    assert entry["n_asked"] == 40


def test_an_object_alone_in_its_category_is_taught_and_never_asked():
    touches = drawn(category=np.repeat(["x", "x", "y"], 20))
    options = {"recognisers": ["3-NN"], "protocols": ["categories"]}
    result = benchmark({"set": touches}, **options)
    assert "set, categories: never asked (1): c." in result.summary()


def test_touches_of_nan_alone_are_left_out_and_named():
    images = np.random.default_rng(0).normal(size=(60, 3, 8))
    images[3] = np.nan
    options = {"recognisers": ["default", "3-NN"], "protocols": ["halves"]}
    result = benchmark({"set": drawn(images)}, **options)
    (entry,), (skip,) = result["benchmark"], result["skipped"]
    assert entry["n_touches"] == 59
    assert [row["reason"] for row in entry["rows"]] == [None, None]
    assert skip["reason"] == "left out 1 touch of NaN alone."


def test_the_protocol_of_categories_recognises_them():
    objects = np.repeat(["a1", "a2", "b1", "b2"], 8)
    images = np.random.default_rng(0).normal(size=(32, 3, 8))
    touches = Touches(images, object=objects, category=[n[0] for n in objects])
    assert entry_of(touches, "categories")["label"] == "category"


def test_idle_frames_that_name_the_object_are_a_control():
    frames = np.arange(12).reshape(12, 1, 1) // 4 * np.ones((12, 3, 8))
    frame_rows = np.repeat(np.arange(12), 5)
    entry = entry_of(drawn(set_idle=frames, idle_of=frame_rows))
    assert entry["controls"]["idle frame"] == 1
    assert entry_of(drawn())["controls"]["idle frame"] is None
    # Of frames that are not there, or texts, nothing can be told.
    for odd in (frame_rows + 1, frame_rows - 1, frame_rows.astype(str)):
        entry = entry_of(drawn(set_idle=frames, idle_of=odd))
        assert entry["controls"]["idle frame"] is None


def test_touches_without_contact_are_scored_apart():
    """Bright objects, and a fifth of each object's touches are the bare frame."""
    images = np.random.default_rng(0).normal(size=(60, 3, 8)) + 5
    bare = np.arange(24.0).reshape(3, 8)
    images[::5] = bare
    row = entry_of(drawn(images, no_contact=bare))["rows"][0]
    assert row["no_contact"] == pytest.approx(1 / 3)  # all are the same: one answer
    assert entry_of(drawn())["rows"][0]["no_contact"] is None


def test_touches_that_say_nothing_are_not_named_after_the_first_object():
    entry = entry_of(often_idle(0, "an_idle_one"), "random", ["default"], repeats=1)
    assert entry["rows"][0]["no_contact"] == 0


def test_an_error_becomes_a_row_and_a_bad_archive_a_reason(tmp_path):
    drawn().save(tmp_path / "deep.npz")
    np.savez(tmp_path / "bad.npz", counts=np.ones(3))
    names = ["HOG SVM", "corradi2015", "3-NN"]
    result = benchmark(tmp_path, recognisers=names, protocols=["subjects", "halves"])
    (entry,) = result["benchmark"]
    assert entry["archive"] == "deep.npz"
    reasons = [row["reason"] for row in entry["rows"]]
    assert "at least 8 taxels" in reasons[0] or "palpate[bench]" in reasons[0]
    assert "for a sensor 'dome', got 'none'" in reasons[1]
    assert reasons[2] is None
    skipped = {(s["archive"], s["protocol"]): s["reason"] for s in result["skipped"]}
    assert "images" in skipped["bad.npz", None]
    assert "'subject'" in skipped["deep.npz", "subjects"]
    text = " ".join(part for part in result.summary() if isinstance(part, str))
    assert all(reason in text for reason in [*reasons[:2], *skipped.values()])


@pytest.mark.parametrize(
    ("recogniser", "module", "extra"),
    [("HOG SVM", "skimage.feature", "bench"), ("small CNN", "torch", "cnn")],
)
def test_without_its_package_the_row_says_what_to_install(
    monkeypatch, recogniser, module, extra
):
    monkeypatch.setitem(sys.modules, module, None)
    row, nearest = entry_of(drawn(), recognisers=[recogniser, "3-NN"])["rows"]
    assert f'pip install "palpate[{extra}]"' in row["reason"]
    assert row["accuracy"] is None
    assert nearest["reason"] is None


def test_a_cnn_tells_stripes_by_their_direction():
    pytest.importorskip("torch", reason='needs the extra "cnn"')
    rng = np.random.default_rng(0)
    wave = np.sin(np.arange(16) + rng.uniform(0, 6, (60, 1)))[:, :, None]
    across = np.swapaxes(wave, 1, 2)
    lying = np.where((NAMES == "a")[:, None, None], wave, across)
    images = np.where((NAMES == "c")[:, None, None], wave * across, lying)
    row = entry_of(drawn(images), "halves", ["small CNN"])["rows"][0]
    # Nothing but the direction of the stripes tells; of 30 touches one may be wrong.
    assert row["accuracy"] > 0.96


@pytest.fixture(scope="module")
def learnt():
    """Benchmark the default on patterns that every recogniser tells apart."""
    rng = np.random.default_rng(0)
    images = np.repeat(rng.normal(size=(3, 3, 8)), 20, axis=0)
    touches = drawn(images + 0.05 * rng.normal(size=(60, 3, 8)))
    options = {
        "recognisers": ["default", "roots SVM"],
        "protocols": ["blocks", "halves"],
    }
    return benchmark({"set <1>": touches}, **options, touches=(1, 3))


def test_default_is_not_behind_where_all_are_right(learnt):
    json.dumps(learnt, allow_nan=False)
    blocks, halves = learnt["benchmark"]
    assert (blocks["n_folds"], halves["n_folds"]) == (5, 1)
    default, simple = blocks["rows"]
    assert default["after"] == {"1": 1.0, "3": 1.0}
    assert simple["after"] == {"1": 1.0}
    assert default["log_loss"] < np.log(3)
    assert simple["log_loss"] is None
    assert default["sd"] == 0
    assert halves["rows"][0]["sd"] is None
    assert default["seconds"].keys() == {"learn", "per_touch"}
    assert "encoding" in default["chosen"]
    behind = blocks["behind"]
    assert (behind["recogniser"], behind["points"]) == ("roots SVM", 0)
    assert behind["verdict"] == "not behind"


def marked(places, side, geometry):
    """Twenty touches each of three objects, which differ in where a mark is."""
    images = np.abs(0.02 * np.random.default_rng(0).normal(size=(60, side, side)))
    for image, (row, col) in zip(images, np.repeat(places, 20, axis=0), strict=True):
        image[row - 1 : row + 2, col - 1 : col + 2] += 1
    return Touches(images, object=NAMES, geometry=geometry)


def test_default_sees_the_place_where_only_the_place_tells():
    touches = marked([[2, 8], [8, 2], [13, 8]], 16, "array")
    entry = entry_of(touches, "halves", ("default", "taxels SVM"))
    assert [row["accuracy"] for row in entry["rows"]] == [1, 1]
    assert entry["behind"]["verdict"] == "not behind"


def test_a_default_blind_to_turns_is_behind_where_only_turns_tell():
    # Three places on one ring of a dome, which is never looked at upright.
    touches = marked([[5, 10], [10, 5], [15, 10]], 21, "dome")
    entry = entry_of(touches, "halves", ("default", "taxels SVM"))
    default, taxels = (row["accuracy"] for row in entry["rows"])
    assert taxels > 0.95
    assert default < 0.7
    assert entry["behind"]["points"] == pytest.approx(100 * (taxels - default))
    assert entry["behind"]["verdict"] == "behind"


def test_the_page_holds_every_table_and_loads_nothing(learnt, tmp_path):
    pytest.importorskip("matplotlib", reason='needs the extra "plot"')
    page = learnt.write_report(tmp_path / "b.html").read_text()
    assert "<script" not in page
    assert not re.findall(r"(?:src|href)=", page)
    assert "set &lt;1&gt;" in page
    (title, columns, lines), *_ = learnt.summary()
    assert title == "set <1>: 60 touches"
    assert {len(line) for line in lines} == {len(columns)}
    assert ["  default", "100.0", "0.0", "100.0"] in [line[:4] for line in lines]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"recognisers": ["CNN"]}, "recognisers must be one of 'default'"),
        ({"protocols": ["thirds"]}, "protocols must be one of 'subjects'"),
        ({"label": "size"}, "label must be one of 'object', 'category'"),
        ({"touches": 5}, r"touches must hold numbers of touches, .* got 5"),
        ({"touches": (1, 0)}, "^touches must be at least 1, got 0"),
        ({"repeats": 0}, "^repeats must be at least 1, got 0"),
        ({"seed": -1}, "seed must be at least 0, got -1"),
    ],
)
def test_arguments_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        benchmark({"set": drawn()}, **arguments)


@pytest.mark.parametrize("archives", [[], {}])
def test_no_archive_is_refused(archives):
    with pytest.raises(ValueError, match="archives must hold one archive or more"):
        benchmark(archives)


def test_an_empty_folder_names_the_fix(tmp_path):
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(ValueError, match=r"\(\.npz\) or folder.* `Touches\.save`"):
            benchmark(path)
