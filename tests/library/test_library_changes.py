"""What changes leave behind, what a check says of each file, what a repair takes up."""

import json
import os
import sqlite3
import time
from contextlib import closing

import numpy as np
import pytest

from palpate import Touches
from palpate.library import (
    LibraryError,
    TouchLibrary,
    check_library,
    repair_library,
)

DAY_S = 86_400


def touches(names, seed=0, **columns):
    images = np.random.default_rng(seed).integers(0, 255, (len(names), 3, 3), np.uint8)
    return Touches(images, object=list(names), **columns)


@pytest.fixture
def folder(tmp_path):
    """A library of three objects."""
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        library.add(touches("aabbcc"))
    return tmp_path / "library"


def changes_of(folder):
    """Return the contents of the files of changes, in the order of their names."""
    return [json.loads(p.read_text()) for p in sorted((folder / "changes").iterdir())]


def state_of(folder):
    with TouchLibrary.open(folder) as library:
        return library.list(limit=None, retracted=True), library.objects()


def rebuilt(folder):
    """Lose the database and have it made anew; return what is in it."""
    (folder / "library.sqlite").unlink()
    assert repair_library(folder).rebuilt
    assert check_library(folder).ok
    return state_of(folder)


def test_changes_follow_one_another_even_while_the_clock_stands_still(
    folder, monkeypatch
):
    """Or while it is set back: they come after the touches that they concern, too."""
    last = time.time()
    monkeypatch.setattr(time, "time", lambda: 1000.0)
    with TouchLibrary.open(folder) as library:
        for old, new in ("ax", "xy", "ya", "az"):
            library.rename_object(old, new)
        library.add(touches("a", 1))
        library.rename_object("a", "q")
    monkeypatch.undo()
    made = changes_of(folder)
    assert [one["new"] for one in made] == ["x", "y", "a", "z", "q"]
    times = [one["time_s"] for one in made]
    assert (np.diff(times) > 1e-6).all()
    assert last - 10 < times[0] < times[-1] < last + 0.1
    names = sorted(p.stem for p in (folder / "changes").iterdir())
    assert [one["after"] for one in made] == [None, *names[:-1]]
    assert [int(n.split("-")[0]) for n in names] == [int(t * 1e6) for t in times]
    assert all(len(n.split("-")[0]) == 17 for n in names)
    before = state_of(folder)
    assert [row.object for row in before[0]] == [*"zzbbcc", "q"]
    assert rebuilt(folder) == before


def test_a_change_is_made_now_where_the_clock_is_right(folder):
    start = time.time()
    with TouchLibrary.open(folder) as library:
        library.rename_object("a", "x")
    assert start <= changes_of(folder)[0]["time_s"] <= time.time()


def test_what_changes_nothing_leaves_nothing(folder):
    with TouchLibrary.open(folder) as library:
        first = library.list(limit=1)[0].id
        assert library.retract(first, reason="wet") == 1
        assert library.retract(first, reason="wet") == 0
        assert library.restore(object="b") == 0
        assert library.restore(first) == 1
        assert library.retract([], reason="none") == 0
        assert len(changes_of(folder)) == 2
        assert library.check().ok
        for old, new in (("a", "b"), ("nobody", "x"), ("b", "b")):
            with pytest.raises(LibraryError):
                library.rename_object(old, new)
        for one in "ab":
            with pytest.raises(LibraryError, match="which are one"):
                library.merge_objects(one, one)
    assert len(changes_of(folder)) == 2
    assert not check_library(folder).problems


def test_touches_are_chosen_by_ids_or_by_their_object(folder):
    with TouchLibrary.open(folder) as library:
        ids = [row.id for row in library.list()]
        for how in ({}, {"ids": ids[:1], "object": "a"}):
            with pytest.raises(ValueError, match="Give either ids or object"):
                library.retract(**how, reason="wet")
        library.merge_objects("a", "b")
        library.retract(ids[0], reason="wet")
        # Those of the merged one are of the object; the retracted one is left as it is.
        assert library.retract(object="a", reason="dry") == 3
        rows = library.list(retracted=True)
        assert [row.reason for row in rows] == ["wet", *["dry"] * 3, None, None]
        assert library.restore(object="b") == 4
        assert library.restore(iter(ids)) == 0
    before = state_of(folder)
    assert [(row.name, row.n_touches) for row in before[1]] == [("b", 4), ("c", 2)]
    assert rebuilt(folder) == before


def test_merged_objects_stay_one_through_merges_renames_and_repairs(folder):
    with TouchLibrary.open(folder) as library:
        library.merge_objects("a", "b")
        library.rename_object("a", "bowl")
        library.merge_objects("bowl", "c")
        library.rename_object("c", "cup")
        library.add(touches("ab", 1))
        assert [row.name for row in library.objects()] == ["b", "cup"]
    before = state_of(folder)
    assert [row.object for row in before[0]] == [*["cup"] * 7, "b"]
    assert rebuilt(folder) == before
    with TouchLibrary.open(folder) as library:
        library.add(touches("a", 2))
    assert state_of(folder)[0][-1].object == "cup"


@pytest.mark.parametrize("name", ["", "  ", None, 5, "a\nb", "\x07", "\ud800"])
def test_names_are_texts_that_can_be_printed(folder, name):
    with TouchLibrary.open(folder) as library:
        with pytest.raises(LibraryError, match="new name must be"):
            library.rename_object("a", name)
        with pytest.raises(LibraryError, match="object must be one in the library"):
            library.rename_object(name, "x")
    assert not (folder / "changes").exists()


def test_one_spelling_of_a_name_is_another(folder):
    """An e with an accent is one letter, or a letter and a mark."""
    with TouchLibrary.open(folder) as library:
        library.rename_object("a", "cafe\u0301")
        assert library.objects()[-1].name == "caf\u00e9"
        library.rename_object("cafe\u0301", "b2")
        assert [row.name for row in library.objects()] == ["b", "b2", "c"]


@pytest.mark.parametrize(("n_objects", "more"), [(20, False), (21, True)])
def test_unknown_names_are_told_with_twenty_known_ones(tmp_path, n_objects, more):
    names = [f"thing {k:02}" for k in range(n_objects)]
    with TouchLibrary.open(tmp_path, create=True) as library:
        with pytest.raises(LibraryError, match=r"library \(it has none\), got 'x'"):
            library.rename_object("x", "y")
        library.add(touches(names))
        with pytest.raises(LibraryError) as refused:
            library.rename_object("thing 7", "y")
    listed = ", ".join(map(repr, names[:20])) + ", ..." * more
    assert f"library ({listed}), got 'thing 7'" in str(refused.value)
    assert "Did you mean" in str(refused.value)


def new_change(folder, **content):
    """Write a change that no database knows; return the check and what repairs do."""
    (folder / "changes").mkdir(exist_ok=True)
    path = folder / "changes" / "99999999999999999-00000000.json"
    path.write_text(json.dumps(content))
    [problem] = check_library(folder).problems
    assert problem.kind == "change"
    assert problem.path == f"changes/{path.name}"
    assert not check_library(folder).ok
    done = repair_library(folder)
    assert check_library(folder).ok
    return problem.what, done.n_changes, [row.name for row in state_of(folder)[1]]


NOW = 4e9


def test_a_change_of_an_older_file_without_a_digest_is_carried_out(folder):
    what, n_changes, names = new_change(
        folder, action="rename", old="a", new="x", time_s=NOW
    )
    assert what.startswith("The database lacks this rename: it has been lost")
    assert what.endswith("--repair carries it out.")
    assert (n_changes, names) == (1, ["b", "c", "x"])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"action": "rename", "old": "a", "new": "x", "time_s": 4}, "without a time"),
        ({"action": "erase", "time_s": NOW}, "no change"),
        (
            {"action": "rename", "old": "a", "new": "x", "time_s": NOW, "digest": "0"},
            "altered content",
        ),
    ],
)
def test_what_is_no_change_is_set_aside(folder, content, said):
    what, n_changes, names = new_change(folder, **content)
    assert what.startswith("It must be a change, got: ")
    assert said in what
    assert what.endswith("--repair sets it aside.")
    assert (n_changes, names) == (0, ["a", "b", "c"])
    assert len(list(folder.glob("damaged/*/*.json"))) == 1


def test_a_change_that_cannot_be_carried_out_is_set_aside(folder):
    _, n_changes, names = new_change(
        folder, action="rename", old="nobody", new="x", time_s=NOW
    )
    assert (n_changes, names) == (0, ["a", "b", "c"])


def test_a_repair_counts_the_changes_that_it_carried_out(folder):
    """Made anew from its files alone, some of which say nothing (any more)."""
    with TouchLibrary.open(folder) as library:
        library.rename_object("a", "x")
        library.retract(object="b", reason="wet")
    before = state_of(folder)
    last = max((folder / "changes").iterdir())
    content = json.loads(last.read_text())
    after = {"time_s": content["time_s"] + 1, "after": last.stem}
    for k, change in enumerate(
        [{"action": "rename", "old": "nobody", "new": "y"}, {"action": "merge"}]
    ):
        path = last.with_name(f"{int(last.stem[:17]) + k + 1:017}-0000000{k}.json")
        path.write_text(json.dumps({**change, **after}))
        after = {"time_s": after["time_s"] + 1, "after": path.stem}
    (folder / "library.sqlite").unlink()
    # The two that say nothing are set aside with what was written beside them.
    assert repair_library(folder) == (True, 6, 0, 0, 2, 0, 2)
    assert len(list(folder.glob("damaged/*/*.json"))) == 2
    assert state_of(folder) == before
    assert check_library(folder).ok


def test_changes_that_fit_their_files_and_others_are_told_apart(folder):
    with TouchLibrary.open(folder) as library:
        library.rename_object("a", "x")
        library.rename_object("b", "y")
    first, second = sorted((folder / "changes").iterdir())
    content = json.loads(second.read_text())
    first.unlink()
    second.write_text(json.dumps({**content, "new": "z"}))
    gone, altered = check_library(folder).problems
    assert "got: No such file or directory. The database knows this rename" in gone.what
    assert "got: altered content. The database knows this rename" in altered.what
    before = state_of(folder)
    assert repair_library(folder).n_changes == 2
    assert state_of(folder) == before
    assert rebuilt(folder) == before
    assert repair_library(folder) == (False, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize("n_lost", [1, 3])
def test_a_retraction_whose_file_is_lost_is_written_as_it_still_stands(folder, n_lost):
    with TouchLibrary.open(folder) as library:
        ids = [row.id for row in library.list()]
        library.retract(ids[:4], reason="wet")
        library.restore(ids[1:3])
        library.retract(ids[2], reason="dry")
    for path in sorted((folder / "changes").iterdir())[:n_lost]:
        path.unlink()
    before = state_of(folder)
    assert [row.reason for row in before[0]] == ["wet", None, "dry", "wet", None, None]
    report = check_library(folder)
    assert [p.kind for p in report.problems] == ["change"] * n_lost
    assert repair_library(folder).n_changes == n_lost
    assert check_library(folder).ok
    assert state_of(folder) == before
    made = changes_of(folder)
    assert [one["action"] for one in made] == ["retract", "restore", "retract"]
    # Of the first what it leaves out to this day.
    assert made[0]["ids"] == [ids[0], ids[3]]
    assert rebuilt(folder) == before


def test_files_begun_by_a_writer_are_left_for_a_day(folder):
    ages = {"old": DAY_S + 0.5, "young": DAY_S - 20, "now": 0}
    paths = {name: folder / "images" / f".partial-{name}" for name in ages}
    for name, age in ages.items():
        paths[name].write_bytes(b"x")
        os.utime(paths[name], times=(time.time() - age,) * 2)
    report = check_library(folder)
    assert report.ok
    assert [p.kind for p in report.problems] == ["partial file"] * 3
    assert {p.path for p in report.problems} == {
        f"images/.partial-{name}" for name in ages
    }
    repair_library(folder)
    assert {name for name, path in paths.items() if path.exists()} == {"young", "now"}


def test_touches_of_a_file_that_the_database_lacks_are_taken_in_under_their_names(
    folder, tmp_path
):
    """As when a database was put back from last week, and changed since."""
    old = (folder / "library.sqlite").read_bytes()
    with TouchLibrary.open(folder) as library:
        ids = library.add(touches("ad", 1))
    (folder / "library.sqlite").write_bytes(old)
    with TouchLibrary.open(folder) as library:
        library.rename_object("a", "x")
        report = library.check()
        assert report.ok
        [problem] = report.problems
        assert problem.kind == "file without touches"
        assert (folder / problem.path).is_file()
        done = library.repair()
        assert (done.rebuilt, done.n_recovered, done.n_changes) == (False, 2, 0)
        rows = library.list()
    # Added before the rename: what was an "a" is an "x" today.
    assert [row.object for row in rows] == [*"xxbbcc", "x", "d"]
    assert [row.id for row in rows[6:]] == ids
    assert check_library(folder).problems == []


def test_retractions_are_carried_out_again_on_touches_that_come_late(folder):
    old = (folder / "library.sqlite").read_bytes()
    with TouchLibrary.open(folder) as library:
        ids = library.add(touches("aab", 1))
        library.retract(ids[:2], reason="wet")
        library.restore(ids[0])
    changes = [p.read_text() for p in sorted((folder / "changes").iterdir())]
    assert len(changes) == 2
    before = state_of(folder)
    (folder / "library.sqlite").write_bytes(old)
    done = repair_library(folder)
    assert (done.n_recovered, done.n_changes) == (3, 2)
    assert [row.retracted for row in state_of(folder)[0]] == [
        row.retracted for row in before[0]
    ]
    assert rebuilt(folder)[0] == state_of(folder)[0]


def test_a_check_counts_touches_files_and_what_is_set_aside(folder):
    with TouchLibrary.open(folder) as library:
        library.add(touches("de", 1))
        library.add(touches("fgh", 2))
    report = check_library(folder)
    assert report == (True, 11, 3, [], 0)
    assert str(report) == "11 touches in 3 files: all present and as they were written."
    images = sorted((folder / "images").rglob("*.npy"))
    two = next(path for path in images if len(np.load(path)) == 2)
    content = two.read_bytes()
    two.unlink()
    report = check_library(folder)
    [problem] = report.problems
    assert (report.ok, report.n_touches, report.n_files) == (False, 11, 3)
    assert (problem.kind, problem.path) == (
        "image",
        two.relative_to(folder).as_posix(),
    )
    assert problem.what.endswith(" 2 touches are lost.")
    assert len(problem.touches) == 2
    done = repair_library(folder)
    assert (done.n_set_aside, done.n_restored, done.rebuilt) == (2, 0, False)
    report = check_library(folder)
    assert report == (True, 9, 2, [], 2)
    assert str(report).splitlines()[1].startswith("2 touches are set aside: their ")
    two.write_bytes(content)
    done = repair_library(folder)
    assert (done.n_set_aside, done.n_restored) == (0, 2)
    assert check_library(folder) == (True, 11, 3, [], 0)


def test_one_altered_image_costs_one_touch_and_moves_the_others(folder):
    [path] = (folder / "images").rglob("*.npy")
    content = bytearray(path.read_bytes())
    content[128 + 9 * 2] ^= 1  # the third image of nine bytes
    path.write_bytes(content)
    before = state_of(folder)[0]
    [problem] = check_library(folder).problems
    assert problem.touches == [before[2].id]
    assert " 1 touches are lost." in problem.what
    assert repair_library(folder).n_set_aside == 1
    after = state_of(folder)[0]
    assert [row.id for row in after] == [row.id for row in before]
    assert [row.retracted for row in after] == [k == 2 for k in range(6)]
    report = check_library(folder)
    assert (report.ok, report.n_touches, report.n_set_aside) == (True, 5, 1)
    with TouchLibrary.open(folder) as library:
        assert (
            library.touches().images == touches("aabbcc").images[[0, 1, 3, 4, 5]]
        ).all()
    assert not path.exists()
    assert list(folder.glob("damaged/*/*.npy"))


def test_a_row_that_is_not_what_its_file_says_has_the_database_made_anew(folder):
    before = state_of(folder)
    with closing(sqlite3.connect(folder / "library.sqlite")) as database:
        for table in (
            "objects",
            "recordings",
            "layouts",
            "files",
            "changes",
            "touches",
        ):
            database.execute(f"ALTER TABLE {table} DROP COLUMN seal")
        database.execute("PRAGMA user_version = 1")  # when rows had no seals
        database.execute("UPDATE touches SET object = 3 WHERE number = 2")
        database.commit()
    report = check_library(folder)
    assert not report.ok
    assert [p.kind for p in report.problems] == ["database", "unprotected"]
    assert report.problems[0].touches == [before[0][1].id]
    assert report.problems[0].what.startswith("1 touches must be as ")
    assert repair_library(folder).rebuilt
    assert state_of(folder) == before
    assert len(list(folder.glob("damaged/*/library.sqlite"))) == 1


@pytest.mark.parametrize(("application", "version"), [(0, 2), (0x70616C70, 0)])
def test_the_database_of_something_else_is_no_library(folder, application, version):
    path = folder / "library.sqlite"
    with closing(sqlite3.connect(path)) as database:
        database.execute(f"PRAGMA application_id = {application}")
        database.execute(f"PRAGMA user_version = {version}")
    with pytest.raises(
        LibraryError, match="must be the database of a library of touch"
    ):
        TouchLibrary.open(folder)
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA user_version = 3")
    report = check_library(folder)
    [problem] = report.problems
    assert problem.kind == "version"
    assert report == (False, 0, 0, [problem], 0)
    with pytest.raises(LibraryError, match="Update palpate"):
        repair_library(folder)


@pytest.mark.parametrize(
    ("table", "statement", "n_touches"),
    [
        ("touches", "UPDATE touches SET force_n = 5 WHERE number = 4", 1),
        ("objects", "UPDATE objects SET name = 'x' WHERE name = 'b'", 2),
        ("files", "UPDATE files SET n_touches = 7", 6),
    ],
)
def test_rows_that_another_program_wrote_are_told_with_their_touches(
    folder, table, statement, n_touches
):
    before = state_of(folder)
    with closing(sqlite3.connect(folder / "library.sqlite")) as database:
        database.execute(statement)
        database.commit()
    report = check_library(folder)
    assert report[:3] == (False, 0, 0)
    [problem] = report.problems
    assert problem.kind == "database"
    assert problem.what.startswith(f"1 rows of {table} must be as they were written")
    assert len(problem.touches) == n_touches
    assert repair_library(folder).rebuilt
    assert state_of(folder) == before


def test_arrays_of_the_whole_set_are_told_with_their_touches(folder):
    frame = np.arange(9, dtype=np.uint8).reshape(3, 3)
    with TouchLibrary.open(folder) as library:
        ids = library.add(touches("de", 1, no_contact=frame, set_scale=frame * 2.0))
        ids += library.add(touches("f", 2, no_contact=frame))
    assert not check_library(folder).problems
    [path] = [
        p for p in (folder / "arrays").rglob("*.npy") if (np.load(p) == frame).all()
    ]
    path.unlink()
    report = check_library(folder)
    [problem] = report.problems
    assert (report.ok, problem.kind) == (False, "array")
    assert problem.path == path.relative_to(folder).as_posix()
    assert problem.touches == ids
    assert "3 touches are read without their no_contact; adding them" in problem.what
    assert repair_library(folder) == (False, 0, 0, 0, 0, 1, 0)
    report = check_library(folder)
    assert report.ok
    assert report.problems == [problem]
    assert repair_library(folder).n_left_out == 0


@pytest.mark.parametrize("name", ["time_s", "force_n"])
def test_numbers_that_a_database_keeps_as_others_are_no_problem(folder, name):
    """It keeps them as real ones; texts of digits stay texts."""
    large = np.array([2**64 - 1, 7], dtype=np.uint64)
    with TouchLibrary.open(folder) as library:
        library.add(touches("de", 1, session=["12", "2.0"], **{name: large}))
        assert library.list("object = d")[0].session == "12"
        assert (
            library.touches("object in (d, e)").columns[name].tolist() == large.tolist()
        )
    assert not check_library(folder).problems


def test_a_database_that_lacks_a_table_is_no_sound_one(folder):
    before = state_of(folder)
    with closing(sqlite3.connect(folder / "library.sqlite")) as database:
        database.execute("DROP TABLE changes")
    with pytest.raises(
        LibraryError, match=r"no such table.*run `palpate library check`"
    ):
        state_of(folder)
    assert [p.kind for p in check_library(folder).problems] == ["database"]
    assert repair_library(folder).rebuilt
    assert state_of(folder) == before
