"""Sight beside touch and moved cameras, on drawn touches whose truth is known."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.evaluation import Plan
from palpate.studies import STUDIES, corradi2015, run_study
from palpate.studies.corradi2015 import Corradi2015Plan, beside
from palpate.studies.corradi2015.beside import beside_tasks, moved_rows, sight_rows
from palpate.studies.corradi2015.plan import Objects

NAMES = ("mug_a", "mug_b", "mug_c", "pen_a", "pen_b", "pen_c")
PLAN = Corradi2015Plan(touches=(1, 5, 30), orders=4)


def drawn(names, noise, rng, **columns):
    """Values of 3 x 24 electrodes, sixteen touches of each object."""
    images = [
        np.random.default_rng(sum(map(ord, name))).normal(size=(3, 24))
        + noise * rng.normal(size=(16, 3, 24))
        for name in names
    ]
    return Touches(
        np.concatenate(images),
        object=np.repeat(names, 16),
        category=np.repeat([name.split("_")[0] for name in names], 16),
        geometry="none",
        **columns,
    )


def photographed(names, archive, of_name):
    """Write eight photographs of each object, with 40 words of `of_name` each."""
    rows = [np.bincount([of_name(name)] * 40, minlength=12) for name in names]
    counts = np.repeat(rows, 8, axis=0)
    np.savez(archive, counts=counts, object=np.repeat(names, 8))
    return beside.read_photographs(archive)


def test_photographs_are_roots_of_shares(tmp_path):
    photographs = photographed(NAMES, tmp_path / "w.npz", NAMES.index)
    np.testing.assert_allclose((photographs.words**2).sum(axis=1), 1)
    assert photographs.words[8].argmax() == 1
    assert photographs.object[8] == NAMES[1]


def test_telling_photographs_help_touches_that_tell_nothing(rng, tmp_path):
    touches = drawn(NAMES, 1e3, rng)
    photographs = photographed(NAMES, tmp_path / "w.npz", NAMES.index)
    right = beside.sight(touches, photographs, Plan(touches=(1, 30)))
    # "last" tests a quarter of 16 touches, so that nothing is said after 30.
    assert {sense: list(curve) for sense, curve in right.items()} == {
        "touch": [1],
        "sight": [0],
        "both": [1],
    }
    assert_array_equal(right["sight"][0], np.ones(6))
    # Chance is 1/6.
    assert right["touch"][1].mean() < 0.5
    assert right["both"][1].mean() > 0.9


def test_photographs_of_unseen_objects_name_their_category(rng, tmp_path):
    touches = drawn((*NAMES[:2], *NAMES[3:5]), 1, rng)
    of_kind = {name: 3 * name.startswith("pen") for name in NAMES}
    photographs = photographed(NAMES, tmp_path / "w.npz", of_kind.__getitem__)
    right = beside.sight(
        touches, photographs, Plan(label="category", touches=(1,), orders=4)
    )
    # Two folds, one object of each category in each.
    assert_array_equal(right["sight"][0], np.ones(4))


def test_objects_without_photographs_are_left_out(rng, tmp_path):
    touches = drawn(NAMES, 0.1, rng)
    photographs = photographed((*NAMES[:4], "key_a"), tmp_path / "w.npz", len)
    right = beside.sight(touches, photographs, Plan(touches=(1,), orders=2))
    assert_array_equal(right["touch"][1], np.ones(4))


def test_the_first_authors_figures_stand_beside_ours(rng, tmp_path):
    photographs = photographed(NAMES, tmp_path / "w.npz", NAMES.index)
    rows = sight_rows(PLAN, drawn(NAMES, 0.1, rng), photographs, "object")
    paper = {(r["recogniser"], r["touches"]): r["paper"] for r in rows}
    assert paper["both", 1] == 45.2
    assert paper["touch", 1] == 18.8
    assert paper["sight", 0] == 39.7
    assert {row["objects"] for row in rows} == {6}
    assert len({row["name"] for row in rows}) == len(rows)
    (table,) = STUDIES["corradi2015"].tables({"rows": rows, "confusion": {}})
    title, columns, lines = table
    assert title.startswith("Objects, with a photograph, recorded")
    assert columns == ["recogniser", "0", "1"]
    by_name = {line[0]: line[1:] for line in lines}
    assert by_name["first author, both"] == ["-", "45.2"]
    assert by_name["sight"] == ["100±0", "-"]


@pytest.mark.parametrize("at", [5, 9, 12])
def test_a_jump_is_found_where_it_is(at, rng):
    centres = rng.normal(scale=0.1, size=(20, 2))
    centres[at:] += 6
    assert beside.jump_of(centres) == at


def moved_touches(rng):
    """Two objects whose camera moved after seven touches, and two where it stood."""
    names = (*beside.MOVED[:2], "box_a", "can_a")
    order = np.tile(rng.permutation(16), 4)
    rim = rng.normal(scale=0.1, size=(64, 3))
    rim[:32][order[:32] >= 7] += 9
    return drawn(names, 0.1, rng, order=order, **{beside.RIM: rim})


def test_touches_are_parted_where_the_camera_moved(rng):
    touches = moved_touches(rng)
    early = beside.before_the_move(touches)
    assert_array_equal(early[:32], touches.order[:32] < 7)
    assert early[32:].all()


def test_moved_objects_are_tested_on_the_other_side_alone(rng):
    rows = moved_rows(PLAN, moved_touches(rng))
    ours = [row for row in rows if row["recogniser"] == "default"]
    # Seven touches before the move, nine after: both ways one and five are answered.
    assert {(row["table"], row["touches"]) for row in ours} == {
        (f"moved, {way}", k) for way in beside.WAYS for k in (1, 5)
    }
    # These touches do not change as the camera moves.
    assert all(row["ours"] == 100 and row["objects"] == 2 for row in ours)
    assert {row["recogniser"] for row in rows} > {"brightness", "sorted pixels"}


def test_missing_photographs_and_columns_are_named_as_skipped(rng, tmp_path):
    tasks, skipped = beside_tasks(PLAN, drawn(NAMES, 1, rng), tmp_path)
    assert tasks == []
    assert "no bathtip/visual_words50.npz" in skipped[0]
    assert "no object among bowl_whitebig" in skipped[1]
    (tmp_path / "bathtip").mkdir()
    photographed(NAMES, tmp_path / "bathtip" / "visual_words50.npz", NAMES.index)
    without_rim = drawn((beside.MOVED[0], "box_a"), 1, rng)
    tasks, skipped = beside_tasks(PLAN, without_rim, tmp_path)
    assert len(tasks) == 2
    assert "no columns 'order' and 'rim_circle" in skipped[0]
    tasks, skipped = beside_tasks(PLAN, moved_touches(rng), tmp_path)
    assert (len(tasks), skipped) == (3, [])


@pytest.mark.parametrize("later", [True, False])
def test_sight_and_moved_cameras_come_with_the_later_experiments(
    later, rng, monkeypatch
):
    touches = drawn(NAMES, 1, rng)
    objects = Objects("bathtip", touches, touches)
    tasks_and_skipped = ([lambda: [{"name": "beside"}]], ["Left out."])
    stubs = {
        "recorded_touches": touches,
        "recorded_objects": objects,
        "simulated_objects": objects,
        "beside_tasks": tasks_and_skipped,
        "unseen_beliefs": {},
        "confusions": {},
        **{n: [] for n in ("learnt_tasks", "later_tasks", "experiment_rows")},
        **{n: [] for n in ("unseen_rows", "timing_rows")},
    }
    for name, answer in stubs.items():
        modules = (corradi2015, corradi2015.episodes, corradi2015.stated)
        module = next(module for module in modules if hasattr(module, name))
        monkeypatch.setattr(module, name, lambda *_, it=answer: fresh(it))
    plan = Corradi2015Plan(later=later)
    result = run_study("corradi2015", plan=plan, workers=1, progress=False)
    assert [row["name"] for row in result["rows"]] == (["beside"] if later else [])
    assert result["skipped"] == (["Left out."] if later else [])
    assert not Corradi2015Plan.quick().later


def fresh(answer):
    """Return lists as new ones: the study adds to them."""
    return list(answer) if isinstance(answer, list) else answer
