"""One flush a touch: rows that a power cut takes are entered again from their files.

A touch is acknowledged when its file is on the disk. Its row is committed but flushed
later, so a power cut may take it, with all rows after it. That is played by putting the
database back as it was flushed last, in a copy of the library: nobody locks its mark.
"""

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import (
    LibraryError,
    TouchLibrary,
    _adding,
    check_library,
    repair_library,
)
from palpate.library import _files as files

FULL, NORMAL = 2, 1


def _press(seed, n_touches=1, **columns):
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 255, (n_touches, 5, 4), dtype=np.uint8)
    known = {"object": ["mug"] * n_touches, "press": [seed] * n_touches}
    return Touches(images, **(known | columns))


def _no_room(handle):
    raise OSError(28, os.strerror(28))


def _database(folder):
    return [p for p in Path(folder).glob("library.sqlite*") if "-shm" not in p.name]


def _marks(folder):
    return list((Path(folder) / "images").glob(".adding-*"))


class _PowerCut:
    """Keeps what was flushed, and a copy of the library as a power cut leaves it."""

    def __init__(self, folder):
        self.folder = folder
        self.flush()

    def flush(self):
        self.kept = {path.name: path.read_bytes() for path in _database(self.folder)}

    def __call__(self, to, *, names_too=False):
        shutil.copytree(self.folder, to)
        for path in to.glob("library.sqlite*"):
            path.unlink()
        for name, content in self.kept.items():
            (to / name).write_bytes(content)
        if names_too:
            for number, path in enumerate(sorted((to / "images").glob("*/*.npy"))):
                path.rename(to / "images" / f".partial-{number:016x}")
        return to


def _everything(folder):
    with TouchLibrary.open(folder) as library:
        rows = [row._replace(id=row.id) for row in library.list(limit=None)]
        touches = library.touches()
        return rows, library.objects(), touches


def _assert_equal(got, expected):
    assert got[:2] == expected[:2]
    assert_array_equal(got[2].images, expected[2].images)
    assert got[2].columns.keys() == expected[2].columns.keys()
    for name, column in expected[2].columns.items():
        assert_array_equal(got[2].columns[name], column)
    assert got[2].whole.keys() == expected[2].whole.keys()


@pytest.mark.parametrize("names_too", [False, True], ids=["rows", "rows and names"])
@pytest.mark.parametrize("first", [TouchLibrary, check_library, repair_library])
def test_acknowledged_touches_come_back(tmp_path, first, names_too):
    """With categories, wide columns, no-contact images and a name from before."""
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_press(1, 3))
        library.rename_object("mug", "cup")  # a change is flushed, with all before it
        cut = _PowerCut(folder)
        library.add(_press(2))
        library.add(_press(3, 300, session=np.arange(300) // 100))
        no_contact = np.ones((5, 4), np.uint8)
        loads = np.arange(40.0).reshape(2, 20)
        library.add(_press(4, 2, category=["cups"] * 2, loads=loads))
        library.add(_press(5, no_contact=no_contact), episode="e")
        [aside] = library.add(_press(1))
        lost = cut(tmp_path / "lost", names_too=names_too)
    expected = _everything(folder)
    assert len(expected[0]) == 3 + 1 + 300 + 2 + 1
    assert aside in [row.id for row in expected[0]]
    opened = first(lost)
    if isinstance(opened, TouchLibrary):
        opened.close()
    else:
        assert not _marks(lost)
    assert check_library(lost).problems == []
    _assert_equal(_everything(lost), expected)
    assert repair_library(lost).n_recovered == 0


def test_nothing_is_taken_up_while_who_adds_is_there(tmp_path):
    """A file without a row may be one of somebody at work; once closed, none is."""
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_press(1))
        _spare(folder, _press(2))
        [mark] = _marks(folder)
        with TouchLibrary.open(folder) as other:
            assert len(other) == 1
            other.add(_press(3))
            assert len(_marks(folder)) == 2
        assert _marks(folder) == [mark]
        assert [p.kind for p in check_library(folder).problems] == [
            "file without touches"
        ]
    assert not _marks(folder)
    with TouchLibrary.open(folder) as library:
        assert len(library) == 2


def _spare(folder, touches):
    """Put a whole file into a library whose database does not know it."""
    other = folder.parent / "other"
    with TouchLibrary.open(other, create=True) as library:
        library.add(touches)
    for path in (other / "images").glob("*/*.npy"):
        place = folder / "images" / path.parent.name
        place.mkdir(exist_ok=True)
        path.replace(place / path.name)
    shutil.rmtree(other)


def _leave_a_mark(folder):
    (folder / "images" / ".adding-left").touch()


def test_rows_before_a_retraction_are_flushed_with_it(tmp_path):
    """What a change concerns is on the disk before it; it is not undone either."""
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        ids = library.add(_press(1, 2))
        library.retract(ids[:1], reason="wet")
        cut = _PowerCut(folder)
        library.add(_press(2))
        lost = cut(tmp_path / "lost")
    with TouchLibrary.open(lost) as library:
        assert len(library) == 2
        assert [row.reason for row in library.list(retracted=True)].count("wet") == 1


class _Watched(sqlite3.Connection):
    """Notes at each commit how it is flushed."""

    events = None

    def execute(self, sql, *values):
        if sql == "COMMIT":
            [level] = super().execute("PRAGMA synchronous").fetchone()
            self.events.append(level)
        return super().execute(sql, *values)


@pytest.fixture
def events(monkeypatch):
    """Commits by how they are flushed, and flushes of folders and files."""
    connect, fsync = sqlite3.connect, os.fsync
    _Watched.events = []

    def noted(handle):
        _Watched.events.append(Path(f"/proc/self/fd/{handle}").readlink().name)
        fsync(handle)

    monkeypatch.setattr(
        sqlite3, "connect", lambda *a, **k: connect(*a, factory=_Watched, **k)
    )
    monkeypatch.setattr(os, "fsync", noted)
    return _Watched.events


def test_a_touch_takes_one_flush_and_a_change_flushes_its_row(tmp_path, events):
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(1))
        for n_flushed in (1, 2):
            events.clear()
            library.add(_press(1 + n_flushed))
            assert len(events) == 2
            assert str(events[0]).startswith(".partial-")
            assert events[1] == NORMAL
        events.clear()
        library.rename_object("mug", "cup")
        assert events[-1] == FULL
        events.clear()
        library.add(_press(9))
        assert events[-1] == NORMAL
        events.clear()
    assert events == ["library.sqlite-wal"]  # closing flushes what is left
    assert not _marks(tmp_path)


def test_the_mark_is_on_the_disk_before_any_row_needs_it(tmp_path, events):
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        events.clear()
        library.add(_press(1))
        [mark] = _marks(tmp_path / "lab")
        assert mark.stat().st_size == 0
        assert events[:2] == ["images", "lab"]
        assert events.index(NORMAL) > 2
        events.clear()
        library.add(_press(2, 300))
        assert _marks(tmp_path / "lab") == [mark]
    assert events[-1] == "library.sqlite-wal"
    events.clear()
    TouchLibrary.open(tmp_path / "lab").close()  # nothing was added
    assert not events


@pytest.mark.parametrize("locks", ["none", "refused"])
def test_where_files_cannot_be_locked_every_row_is_flushed(
    tmp_path, events, monkeypatch, locks
):
    def refused(*_):
        raise OSError(95, os.strerror(95))

    if locks == "none":
        monkeypatch.setattr(files, "fcntl", None)
    else:
        monkeypatch.setattr(files.fcntl, "flock", refused)
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(1))
        events.clear()
        library.add(_press(2))
        assert events[-1] == FULL
        assert not _marks(tmp_path)


def test_a_mark_that_cannot_be_flushed_is_none(tmp_path, events, monkeypatch):
    with TouchLibrary.open(tmp_path, create=True) as library:
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", _no_room)
            with pytest.raises(LibraryError, match="0 of 1 are stored; free space"):
                library.add(_press(1))
        assert not _marks(tmp_path)
        library.add(_press(1))
        assert events.index("images") < events.index(NORMAL)
        assert len(_marks(tmp_path)) == 1


def test_touches_that_come_back_are_flushed_with_their_rows(tmp_path, events):
    """Their files alone would not tell that they are no longer set aside."""
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(1))
        next((tmp_path / "images").glob("*/*.npy")).unlink()
        assert library.repair().n_set_aside == 1
        events.clear()
        library.add(_press(1))
        assert events[-1] == FULL
        assert len(library) == 1


def test_a_library_that_cannot_be_written_to_says_what_it_leaves_out(
    tmp_path, monkeypatch
):
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_press(1))
        cut = _PowerCut(folder)
        library.add(_press(2))
        lost = cut(tmp_path / "lost")
    connect = sqlite3.connect

    class Locked(sqlite3.Connection):
        def execute(self, sql, *values):
            if sql == "BEGIN IMMEDIATE":
                super().execute("PRAGMA query_only = ON")
            return super().execute(sql, *values)

    with monkeypatch.context() as patch:
        patch.setattr(
            sqlite3, "connect", lambda *a, **k: connect(*a, factory=Locked, **k)
        )
        with pytest.warns(UserWarning, match="may lack touches"):
            library = TouchLibrary.open(lost)
        assert len(library) == 1
        library.close()
    assert _marks(lost)
    with TouchLibrary.open(lost) as library:
        assert len(library) == 2
    assert not _marks(lost)


@pytest.mark.parametrize("flushed", [False, True])
def test_a_forked_child_leaves_the_mark_to_its_parent(tmp_path, flushed):
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(1))
        if flushed:
            library.rename_object("mug", "cup")
        child = os.fork()
        if not child:
            library.close()
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
        assert len(_marks(tmp_path)) == 1
        library.add(_press(2))
        assert len(library) == 2
    assert not _marks(tmp_path)


def test_rows_of_a_killed_program_are_flushed_before_its_mark_goes(tmp_path, events):
    child = os.fork()
    if not child:
        TouchLibrary.open(tmp_path, create=True).add(_press(1))
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert len(_marks(tmp_path)) == 1
    events.clear()
    with TouchLibrary.open(tmp_path) as library:
        assert events == ["library.sqlite-wal"]
        assert not _marks(tmp_path)
        assert len(library) == 1


def test_two_programs_may_enter_rows_at_once(lost):
    """None of them reads before all are there."""
    with files.left_marks(lost / "images"), TouchLibrary.open(lost) as library:
        assert len(library) == 2


def test_a_file_without_a_row_is_entered_under_the_present_name(tmp_path):
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_press(1))
        _spare(folder, _press(2))
        library.rename_object("mug", "cup")
    _leave_a_mark(folder)
    with TouchLibrary.open(folder) as library:
        assert [row.object for row in library.list()] == ["cup", "cup"]


def test_without_a_log_every_row_is_flushed(tmp_path, events):
    TouchLibrary.open(tmp_path, create=True).close()
    database = sqlite3.connect(tmp_path / "library.sqlite")
    database.execute("PRAGMA journal_mode = DELETE")
    database.close()
    with TouchLibrary.open(tmp_path) as library:
        library.add(_press(1))
        assert events[-1] == FULL
        assert not _marks(tmp_path)


def test_a_folder_named_like_a_file_is_passed_over(tmp_path):
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(1))
    (tmp_path / "images" / "ab" / f"{'ab' * 32}.npy").mkdir(parents=True)
    _leave_a_mark(tmp_path)
    with TouchLibrary.open(tmp_path) as library:
        assert len(library) == 1
    assert not _marks(tmp_path)


def test_the_mark_stays_where_closing_cannot_flush(tmp_path, monkeypatch):
    """After a power cut the rows are entered from their files."""
    library = TouchLibrary.open(tmp_path, create=True)
    library.add(_press(1))
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", _no_room)
        library.close()
    assert len(_marks(tmp_path)) == 1


@pytest.fixture
def lost(tmp_path):
    """A library that a power cut left without the row of its second touch."""
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_press(1))
        library.rename_object("mug", "cup")
        cut = _PowerCut(folder)
        library.add(_press(2))
        return cut(tmp_path / "lost")


@pytest.mark.parametrize("trouble", ["full", "unreadable"])
def test_what_the_disk_refuses_once_is_entered_later(lost, monkeypatch, trouble):
    if trouble == "full":
        newest = max((lost / "images").glob("*/*.npy"), key=lambda p: p.stat().st_mtime)
        newest.rename(lost / "images" / ".partial-0")
    call = {"full": os.fsync, "unreadable": Path.read_bytes}[trouble]

    def failing(what):
        if trouble == "full" or what.suffix == ".npy":
            raise OSError(5, os.strerror(5))
        return call(what)

    with monkeypatch.context() as patch:
        patch.setattr(
            *{os.fsync: (os, "fsync")}.get(call, (Path, "read_bytes")), failing
        )
        with pytest.warns(UserWarning, match="may lack touches"):
            TouchLibrary.open(lost).close()
    assert _marks(lost)
    with TouchLibrary.open(lost) as library:
        assert len(library) == 2
    assert not _marks(lost)
    assert check_library(lost).problems == []


def test_of_two_files_with_a_touch_the_acknowledged_one_counts(tmp_path, monkeypatch):
    """A writer was killed before the commit; the touch came again, corrected."""
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_press(1))
        _spare(folder, _press(2, category=["tools"]))
        library.rename_object("mug", "cup")
        cut = _PowerCut(folder)
        library.add(_press(2, category=["dishes"]))
        lost = cut(tmp_path / "lost")
    expected = _everything(folder)
    _assert_equal(_everything(lost), expected)
    assert check_library(lost).problems == []


def test_a_file_that_is_written_again_does_not_come_back(tmp_path, monkeypatch):
    """Another program renamed the object between a touch's file and its row."""
    folder, first = tmp_path / "lab", []
    publish = _adding.publish

    def renamed_meanwhile(images, content, *known):
        name = publish(images, content, *known)
        if not first:
            first.append(content)
            other.rename_object("mug", "cup")
        return name

    library, other = (TouchLibrary.open(folder, create=True) for _ in range(2))
    with library, other:
        other.add(_press(1))
        monkeypatch.setattr(_adding, "publish", renamed_meanwhile)
        cut = _PowerCut(folder)
        library.add(_press(2, category=["tools"]))
        cut.flush()
        lost = cut(tmp_path / "lost")
    assert len(list((folder / "images").glob("*/*.npy"))) == 2
    (lost / "images" / ".partial-0").write_bytes(first[0])
    _assert_equal(_everything(lost), _everything(folder))


def test_the_category_of_a_merged_object_stays_its_own(tmp_path):
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_press(1, category=["tools"]))
        library.add(_press(2, object=["cup"]))
        library.merge_objects("mug", "cup")
        cut = _PowerCut(folder)
        library.add(_press(3, category=["dishes"]))
        lost = cut(tmp_path / "lost")
    assert _everything(lost)[1] == _everything(folder)[1]


def test_an_old_mark_makes_no_one_wait(tmp_path):
    """Nothing is missing, so that nothing is written."""
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.retract(library.add(_press(1, 2))[:1], reason="wet")
    _leave_a_mark(tmp_path)
    other = sqlite3.connect(tmp_path / "library.sqlite", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with TouchLibrary.open(tmp_path) as library:
        assert len(library) == 1
    other.close()
    assert not _marks(tmp_path)


@pytest.mark.parametrize(
    "sheet",
    [
        {"added_s": 10**400},
        {"added_s": float("nan")},
        {"ids": ["ab"]},
        {"values": {"object": ["mug"], "session": [2**70]}},
        {"values": {"object": [{"a": 1}], "session": [1]}},
        {"recording": {"whole": {"no_contact": 5}}},
        "[" * 200_000,
    ],
)
def test_hostile_files_keep_no_one_from_opening(tmp_path, sheet):
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_press(1))
    if isinstance(sheet, dict):
        recording = dict.fromkeys(["sensor", "kind", "unit", "pitch_mm", "geometry"])
        recording |= {"n_rows": 5, "n_cols": 4, "dtype": "|u1", "whole": {}}
        sheet = {
            "format": 1,
            "layout": [["object", "<U3", [], False], ["session", "<i8", [], False]],
            "values": {"object": ["mug"], "session": [1]},
            "added_s": 1.0,
            "ids": ["ab" * 16],
        } | sheet
        sheet["recording"] = recording | sheet.get("recording", {})
        sheet = json.dumps(sheet)
    text = np.frombuffer(sheet.encode(), np.uint8)
    content = files.packed([np.zeros((1, 5, 4), np.uint8), text])
    files.publish(folder / "images", content)
    _leave_a_mark(folder)
    with TouchLibrary.open(folder) as library:
        assert len(library) == 1
    assert check_library(folder).ok


def test_a_damaged_row_is_told_by_a_check_whatever_mark_is_left(tmp_path):
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(1))
        library.rename_object("mug", "cup")
    database = sqlite3.connect(tmp_path / "library.sqlite")
    database.execute("UPDATE changes SET content = replace(content, '_s', '_r')")
    database.commit()
    database.close()
    _leave_a_mark(tmp_path)
    TouchLibrary.open(tmp_path).close()
    _leave_a_mark(tmp_path)
    assert {p.kind for p in check_library(tmp_path).problems} == {"database"}


def _mounted(disk, folder):
    folder.mkdir(exist_ok=True)
    subprocess.run(["mount", "-o", "loop", disk, folder], check=True)
    return folder / "lab"


@pytest.mark.slow
@pytest.mark.skipif(
    os.geteuid() != 0 or not shutil.which("mkfs.ext4"), reason="needs root and ext4"
)
@pytest.mark.parametrize("seed", range(4))
def test_a_real_file_system_after_a_power_cut(tmp_path, seed):
    """What a stopped writer's disk holds at a moment, its caches gone, is mounted."""
    disk, copy, there = tmp_path / "disk", tmp_path / "copy", tmp_path / "mounted"
    with disk.open("wb") as file:
        file.truncate(96 * 2**20)
    subprocess.run(["mkfs.ext4", "-q", "-F", disk], check=True)
    try:
        folder = _mounted(disk, there)
    except subprocess.CalledProcessError:
        pytest.skip("needs a loop device")
    reading, writing = os.pipe()
    try:
        if not (child := os.fork()):
            library = TouchLibrary.open(folder, create=True)
            for number in range(100_000):
                [key] = library.add(_press(number))
                os.write(writing, f"{number} {key}\n".encode())
        os.close(writing)
        time.sleep(np.random.default_rng(seed).uniform(0.5, 2))
        os.kill(child, signal.SIGSTOP)
        shutil.copyfile(disk, copy)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    finally:
        subprocess.run(["umount", there], check=True)
    with os.fdopen(reading) as stream:
        lines = [line for line in stream if line.endswith("\n")]
    told = dict(line.split() for line in lines)
    assert told
    folder = _mounted(copy, there)
    try:
        with TouchLibrary.open(folder) as library:
            assert len(told) <= len(library) <= len(told) + 1
            for number, key in told.items():
                expected = _press(int(number)).images[0]
                assert_array_equal(library.image(key), expected)
            assert library.check().problems == []
    finally:
        subprocess.run(["umount", there], check=True)
