"""Full disks, lost databases, altered arrays and changes: found, named and mended."""

import errno
import multiprocessing
import os
import shutil
import signal
import sqlite3
from contextlib import closing
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import (
    LibraryError,
    TouchLibrary,
    check_library,
    repair_library,
)


def _touches(seed=0):
    """Twenty touches of two objects."""
    images = np.random.default_rng(seed).integers(0, 255, (20, 6, 6), dtype=np.uint8)
    return Touches(images, object=["a", "b"] * 10, press=np.arange(20))


@pytest.fixture
def folder(tmp_path):
    """A library in whose past `a` became a mug and `b` was retracted."""
    place = tmp_path / "library"
    with TouchLibrary.open(place, create=True) as library:
        library.add(_touches())
        library.rename_object("a", "mug")
        library.retract(object="b", reason="wet")
    return place


def _state(folder):
    with TouchLibrary.open(folder) as library:
        return library.list(limit=None, retracted=True)


def _under_limit(n_bytes, task, *arguments):
    """Run `task` in another process whose files may have `n_bytes`; return its text."""

    def run():
        import resource

        os.close(reading)
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, n_bytes))
        try:
            said = str(task(*arguments))
        except LibraryError as error:
            said = f"{type(error).__name__}: {error}"
        os.write(writing, said.encode())

    reading, writing = os.pipe()
    process = multiprocessing.get_context("fork").Process(target=run, daemon=True)
    process.start()
    os.close(writing)
    with os.fdopen(reading) as stream:
        said = stream.read()
    process.join()
    return said


def _listed(folder):
    with TouchLibrary.open(folder) as library:
        return len(library.list(limit=None)), library.touches().images.sum()


def _files(folder):
    """Everything but the index of the log, which SQLite makes anew when it needs it."""
    found = (p for p in folder.rglob("*") if p.is_file() and p.suffix != ".sqlite-shm")
    return {path: path.read_bytes() for path in found}


def _add(folder):
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_touches(1))


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="limits of a process")


@needs_fork
def test_a_library_on_a_full_disk_is_read_and_not_called_damaged(folder):
    """Without 32 KiB for the shared index of its log, SQLite says "disk I/O error"."""
    before = _state(folder)
    expected = str(_listed(folder))
    files = _files(folder)
    assert _under_limit(4096, _listed, folder) == expected
    assert "all present and as they were" in _under_limit(4096, check_library, folder)
    assert "rebuilt=False" in _under_limit(4096, repair_library, folder)
    said = _under_limit(100, _add, folder)
    assert "must have room" in said
    assert "free space" in said
    assert _files(folder) == files
    assert _state(folder) == before


@needs_fork
def test_what_is_in_the_log_alone_is_read_on_a_full_disk(folder, tmp_path):
    """A killed writer leaves acknowledged touches in the log."""
    copy = tmp_path / "killed"
    with TouchLibrary.open(folder) as library:
        library.add(_touches(1))
        expected = str(_listed(folder))
        shutil.copytree(folder, copy)
    (copy / "library.sqlite-shm").unlink()
    assert (copy / "library.sqlite-wal").stat().st_size
    assert _under_limit(4096, _listed, copy) == expected
    assert str(_listed(copy)) == expected


@needs_fork
def test_a_repair_without_room_leaves_the_old_database(folder):
    before = _state(folder)
    path = folder / "library.sqlite"
    whole = path.read_bytes()
    scribbled = whole[:4096] + b"\xaa" * (len(whole) - 4096)
    path.write_bytes(scribbled)
    said = _under_limit(16_384, repair_library, folder)
    assert "must have room for a new database" in said
    assert "The old one is left as it was" in said
    assert path.read_bytes() == scribbled
    assert not (folder / "damaged").exists()
    assert not list(folder.rglob(".partial-*"))
    assert repair_library(folder).rebuilt
    assert [p.read_bytes() for p in folder.glob("damaged/*/library.sqlite")] == [
        scribbled
    ]
    assert _state(folder) == before


@pytest.mark.parametrize("damage", ["lost", "empty", "only its logs"])
def test_a_lost_database_is_not_replaced_by_an_empty_one(folder, damage):
    before = _state(folder)
    path = folder / "library.sqlite"
    path.unlink()
    if damage == "empty":
        path.write_bytes(b"")
    if damage == "only its logs":
        path.with_name("library.sqlite-wal").write_bytes(b"x" * 5000)
    for create in (True, False):
        with pytest.raises(LibraryError, match="check --repair"):
            TouchLibrary.open(folder, create=create)
    assert TouchLibrary.is_library(folder)
    assert not check_library(folder).ok
    assert repair_library(folder).rebuilt
    assert _state(folder) == before
    assert check_library(folder).ok


def test_changes_that_a_database_lacks_are_reported_and_carried_out(folder):
    """As when it was lost and made anew by hand, or put back from last week."""
    before = _state(folder)
    (folder / "library.sqlite").unlink()
    away = folder.with_name("away")
    (folder / "changes").rename(away)
    repair_library(folder)
    assert {row.object for row in _state(folder)} == {"a", "b"}
    away.rename(folder / "changes")
    report = check_library(folder)
    assert not report.ok
    assert [p.kind for p in report.problems] == ["change", "change"]
    assert "The database lacks this rename" in str(report)
    done = repair_library(folder)
    assert (done.rebuilt, done.n_changes) == (False, 2)
    assert _state(folder) == before
    assert check_library(folder).ok
    assert repair_library(folder).n_changes == 0


@pytest.mark.parametrize("content", [b"{}", b"\xff", b"", None])
def test_altered_changes_are_reported_and_written_anew(folder, content):
    with TouchLibrary.open(folder) as library:
        library.restore([row.id for row in library.list("press < 6", retracted=True)])
        library.merge_objects("b", "mug")
    before = _state(folder)
    assert sum(row.retracted for row in before) == 7
    for path in (folder / "changes").iterdir():
        if content is None:
            path.unlink()
        else:
            path.write_bytes(content)
    report = check_library(folder)
    assert [p.kind for p in report.problems] == ["change"] * 4
    assert not report.ok
    assert repair_library(folder).n_changes == 4
    assert check_library(folder).ok
    assert _state(folder) == before
    (folder / "library.sqlite").unlink()
    repair_library(folder)
    assert _state(folder) == before


def test_ids_altered_in_a_change_are_noticed(folder):
    path = max((folder / "changes").iterdir())
    key = _state(folder)[1].id
    assert key in path.read_text()
    path.write_text(path.read_text().replace(key, "00" * 16))
    assert "altered content" in str(check_library(folder))


def test_a_file_that_is_no_change_is_set_aside(folder):
    before = _state(folder)
    for name, text in {"1": "[]", "2": '{"action": ["x"]}', "3": "no"}.items():
        (folder / "changes" / f"{name}.json").write_text(text)
    assert len(check_library(folder).problems) == 3
    repair_library(folder)
    assert check_library(folder).ok
    assert len(list(folder.glob("damaged/*/*.json"))) == 3
    assert _state(folder) == before


def test_a_change_that_is_not_acknowledged_leaves_no_file(folder, monkeypatch):
    """The disk fails after the file is in place: a rebuild must not find it."""
    before = _state(folder)
    flush = os.fsync
    seen = []

    def fail_in_place(handle):
        found = sorted((folder / "changes").glob("*.json"))
        if len(found) == 3:
            seen.extend(found)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(handle)

    with TouchLibrary.open(folder) as library:
        monkeypatch.setattr(os, "fsync", fail_in_place)
        with pytest.raises(LibraryError, match="Nothing was changed; free space"):
            library.rename_object("mug", "cup")
        assert seen
        assert len(list((folder / "changes").iterdir())) == 2
    assert _state(folder) == before
    assert check_library(folder).ok


@pytest.mark.parametrize("lost", [True, False])
def test_a_damaged_array_costs_no_touch(folder, lost):
    """Everything else is read; the array is named, and comes back when added again."""
    baseline = np.full((6, 6), 3, np.uint8)
    again = _touches(1).with_columns(no_contact=baseline, set_unit="kPa")
    with TouchLibrary.open(folder) as library:
        ids = library.add(again)
        [path] = [
            p for p in (folder / "arrays").rglob("*.npy") if np.load(p).shape == (6, 6)
        ]
        path.unlink() if lost else path.write_bytes(b"altered")
        where = "session is null and object = a"
        with pytest.warns(UserWarning, match="read without their no_contact"):
            read = library.touches(where)
        assert_array_equal(read.images, again.images[::2])
        assert read.no_contact is None
        assert str(read.whole["set_unit"]) == "kPa"
        with pytest.warns(UserWarning, match="check"):
            assert "no_contact" not in library.select(where).whole
        with pytest.warns(UserWarning, match="no_contact"):
            assert library.no_contact() is None
        report = library.check()
        [problem] = report.problems
        assert (report.ok, problem.kind, problem.touches) == (False, "array", ids)
        assert "adding them again brings it back" in problem.what
        assert library.repair().n_left_out == 1
        report = library.check()
        assert report.ok
        assert "20 touches are read without their no_contact" in str(report)
        assert library.repair().n_left_out == 0
        library.add(again)
        assert_array_equal(library.no_contact(), baseline)
        assert not library.check().problems
        assert_array_equal(library.touches(where).no_contact, baseline)


def test_an_older_no_contact_image_stands_in_for_a_damaged_one(folder):
    with TouchLibrary.open(folder) as library:
        for value in (1, 2):
            baseline = np.full((6, 6), value, np.uint8)
            library.add(_touches(value).with_columns(no_contact=baseline))
        [newest] = [
            p for p in (folder / "arrays").rglob("*.npy") if (np.load(p) == 2).all()
        ]
        newest.unlink()
        with pytest.warns(UserWarning, match="no_contact"):
            assert (library.no_contact() == 1).all()


def test_a_library_that_cannot_be_opened_has_no_touches(folder):
    (folder / "library.sqlite").write_bytes(b"no database" * 99)
    report = check_library(folder)
    assert not report.ok
    assert (report.n_touches, report.n_files, report.n_set_aside) == (0, 0, 0)
    assert str(report).startswith("0 touches in 0 files: 1 problem.\ndatabase: ")


def test_a_sheet_written_again_keeps_the_names_that_touches_came_with(folder):
    """The renames are carried out over it when the database is lost as well."""
    before = _state(folder)
    [path] = (folder / "images").rglob("*.npy")
    content = bytearray(path.read_bytes())
    content[-40] ^= 1  # in the table behind the images
    path.write_bytes(content)
    assert not check_library(folder).ok
    repair_library(folder)
    assert _state(folder) == before
    (folder / "library.sqlite").unlink()
    repair_library(folder)
    assert _state(folder) == before
    assert check_library(folder).ok


@pytest.mark.parametrize("n_lost", [1, 20, 21, 23])
def test_at_most_twenty_problems_are_shown(tmp_path, n_lost):
    with TouchLibrary.open(tmp_path, create=True) as library:
        for seed in range(n_lost):
            library.add(_touches(seed))
    for path in (tmp_path / "images").rglob("*.npy"):
        path.unlink()
    lines = str(check_library(tmp_path)).splitlines()
    more = [f"... and {n_lost - 20} more"] * (n_lost > 20)
    assert lines[0].endswith(
        f"file{'s' * (n_lost > 1)}: {n_lost} problem{'s' * (n_lost > 1)}."
    )
    assert lines[min(n_lost, 20) + 1 :] == more


def test_touches_set_aside_are_counted_apart(folder):
    with TouchLibrary.open(folder) as library:
        first = set((folder / "images").rglob("*.npy"))
        library.add(_touches(1))
        [second] = set((folder / "images").rglob("*.npy")) - first
        second.unlink()
        assert library.repair().n_set_aside == 20
        report = library.check()
    assert (report.n_touches, report.n_files, report.n_set_aside) == (20, 1, 20)
    assert str(report).startswith("20 touches in 1 file: all present")
    assert "20 touches are set aside" in str(report)


def test_lost_images_of_retracted_touches_are_reported(folder):
    """They are left out already, so nothing is wrong; but they cannot be restored."""
    retracted = [row.id for row in _state(folder) if row.retracted]
    with TouchLibrary.open(folder) as library:
        library.retract(object="mug", reason="wet")
        library.restore(library.add(_touches())[0])
    next((folder / "images").rglob("*.npy")).unlink()
    active, gone = check_library(folder).problems
    assert (len(active.touches), len(gone.touches)) == (1, 19)
    assert set(retracted) < set(gone.touches)
    assert "retracted cannot come back" in gone.what
    assert repair_library(folder).n_set_aside == 1
    report = check_library(folder)
    assert report.ok
    assert "19 touches that are retracted" in str(report)


class _Hurried(sqlite3.Connection):
    """Waits a tenth of a second for others, where a library waits for a minute."""

    def execute(self, sql, *values):
        hurried = "PRAGMA busy_timeout = 100" if "busy_timeout" in sql else sql
        return super().execute(hurried, *values)


def test_a_database_that_another_keeps_to_itself_is_left_alone(folder, monkeypatch):
    hurried = partial(sqlite3.connect, factory=_Hurried)
    files = _files(folder)
    with closing(sqlite3.connect(folder / "library.sqlite")) as other:
        other.execute("PRAGMA locking_mode = EXCLUSIVE")
        other.execute("SELECT * FROM touches").fetchall()
        monkeypatch.setattr(sqlite3, "connect", hurried)
        [problem] = check_library(folder).problems
        assert problem.kind == "disk"
        assert "Another program" in problem.what
        with pytest.raises(LibraryError, match="wait, or end it"):
            repair_library(folder)
    assert _files(folder) == files
    assert check_library(folder).ok
