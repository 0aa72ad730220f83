"""A library of format 2 becomes one of today with the same content.

`data/format2.zip` has that library and, as JSON, its content as it was read then:
touches of two sensors, in colour, with frames and gaps, and changes of every kind
between them.
"""

import hashlib
import json
import shutil
import sqlite3
import zipfile
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from palpate.library import LibraryError, TouchLibrary, check_library

N_TOUCHES, N_CHANGES = 29, 5


@pytest.fixture
def old(tmp_path):
    zipfile.ZipFile(Path(__file__).parent / "data" / "format2.zip").extractall(tmp_path)
    return tmp_path / "library"


@pytest.fixture
def state(old):
    return json.loads((old.parent / "state.json").read_text())


def _files(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def _assert_same(folder, state):
    with TouchLibrary.open(folder) as library:
        listed = [row._asdict() for row in library.list(limit=None, retracted=True)]
        fields = state["rows"][0].keys()  # those that there were then
        rows = [
            {name: row[name] for name in (*fields,) if name in row} for row in listed
        ]
        for row in rows:
            image = library.image(row["id"])
            native = image.astype(image.dtype.newbyteorder("="))  # as it gave them then
            row["sha256"] = hashlib.sha256(native.tobytes()).hexdigest()
        assert rows == state["rows"]
        assert [list(o) for o in library.objects()] == state["objects"]
        assert [list(s) for s in library.sensors()] == state["sensors"]
        for session, image in state["no_contact"].items():
            assert library.no_contact(session).tolist() == image
        frames = library.touches("session = s3").columns["press_frames"]
        drawn = np.random.default_rng(0).normal(size=(5, 4, 6, 7))
        np.testing.assert_array_equal(frames, drawn)


def test_everything_is_as_it_was_and_the_old_folder_untouched(old, state, tmp_path):
    before = _files(old)
    report = TouchLibrary.migrate(old, tmp_path / "new")
    assert report == (N_TOUCHES, N_CHANGES, [], 0, [])
    assert _files(old) == before
    _assert_same(tmp_path / "new", state)
    assert check_library(tmp_path / "new").ok
    with TouchLibrary.open(tmp_path / "new") as library:
        actions = [change.action for change in library.history()]
    assert actions == ["rename", "merge", "rename", "retract", "restore"]


def test_format_1_is_format_2_without_seals(old, state, tmp_path, alter):
    tables = ("objects", "recordings", "layouts", "files", "changes", "touches")
    drop = "ALTER TABLE {} DROP COLUMN seal"
    alter(old, *map(drop.format, tables), "PRAGMA user_version = 1")
    TouchLibrary.migrate(old, tmp_path / "new")
    _assert_same(tmp_path / "new", state)


@pytest.mark.parametrize("n_steps", range(1, 11))
def test_a_stopped_migration_goes_on(old, state, tmp_path, monkeypatch, alter, n_steps):
    """Also of a library whose last change was made while the clock was behind."""
    alter(old, "UPDATE changes SET time_s = 1 WHERE action = 'restore'")
    new = tmp_path / "new"
    remaining = iter(range(n_steps))

    class Stopping(sqlite3.Connection):
        def execute(self, sql, values=()):
            if sql == "COMMIT" and next(remaining, None) is None:
                raise KeyboardInterrupt
            return super().execute(sql, values)

    with monkeypatch.context() as patch:
        patch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=Stopping))
        with pytest.raises(KeyboardInterrupt):
            TouchLibrary.migrate(old, new)
    assert not TouchLibrary.is_library(new)  # a part of a library is none
    with TouchLibrary.open(shutil.copytree(new, tmp_path / "used"), create=True):
        pass
    with pytest.raises(LibraryError, match="used must be a new or empty folder"):
        TouchLibrary.migrate(old, tmp_path / "used")  # it would take that one's place
    TouchLibrary.migrate(old, new)
    _assert_same(new, state)
    assert check_library(new).ok
    assert not [*new.glob(".migrating*")]


@pytest.mark.parametrize("version", [1, 2])
def test_an_old_library_is_refused_with_the_way_out(old, alter, version):
    alter(old, f"PRAGMA user_version = {version}")
    for create in (False, True):
        with pytest.raises(LibraryError, match=r"`TouchLibrary.migrate\(.*, NEW\)`"):
            TouchLibrary.open(old, create=create)
    report = check_library(old)
    assert (report.ok, [p.kind for p in report.problems]) == (False, ["version"])


def test_touches_whose_image_is_gone_are_named(old, tmp_path):
    gone = sorted((old / "images").rglob("*.npy"), key=lambda p: p.stat().st_size)[0]
    with closing(sqlite3.connect(old / "library.sqlite")) as database:
        sql = (
            "SELECT lower(hex(t.id)) FROM touches t JOIN files f ON f.id = t.file "
            "WHERE f.name = ? ORDER BY number"
        )
        ids = [r[0] for r in database.execute(sql, [bytes.fromhex(gone.stem)])]
    gone.unlink()
    report = TouchLibrary.migrate(old, tmp_path / "new")
    assert report.lost == ids
    assert report.n_touches == N_TOUCHES - len(ids)
    assert check_library(tmp_path / "new").ok


def test_an_altered_image_costs_its_touch_alone(old, tmp_path):
    [path] = [p for p in (old / "images").rglob("*.npy") if np.load(p).shape[0] == 8]
    content = bytearray(path.read_bytes())
    content[128 + 42] ^= 1  # the second image, after a header of 128 bytes
    path.write_bytes(content)
    report = TouchLibrary.migrate(old, tmp_path / "new")
    assert len(report.lost) == 1
    assert report.n_touches == N_TOUCHES - 1


def test_a_forged_image_is_found_since_its_id_does_not_follow(old, tmp_path, alter):
    """A migration computes every digest and the chain anew, as a forger might."""
    another = "(SELECT image FROM touches WHERE number = 1)"
    alter(old, f"UPDATE touches SET place = 0, image = {another} WHERE number = 2")
    assert TouchLibrary.migrate(old, tmp_path / "new").lost == []
    [problem] = check_library(tmp_path / "new").problems
    with TouchLibrary.open(tmp_path / "new") as library:
        forged = library.list(limit=2, retracted=True)[1].id
    assert (problem.kind, problem.touches) == ("touch", [forged])
    assert "must follow from what it holds" in problem.what


def test_a_lost_baseline_is_reported(old, tmp_path):
    for path in (old / "arrays").rglob("*.npy"):
        if np.load(path).shape == (6, 7):
            path.write_bytes(b"x" + path.read_bytes())
    report = TouchLibrary.migrate(old, tmp_path / "new")
    assert report.lost_arrays == ["no_contact"]
    assert (report.n_touches, report.lost) == (N_TOUCHES, [])
    assert check_library(tmp_path / "new").ok


def test_files_that_the_database_does_not_know_are_counted(old, tmp_path):
    stray = old / "images" / "ab" / f"{'ab' * 32}.npy"
    stray.parent.mkdir(exist_ok=True)
    stray.write_bytes(b"x")
    assert TouchLibrary.migrate(old, tmp_path / "new").n_unknown_files == 1


def test_a_change_whose_file_is_lost_follows_from_the_rows(old, state, tmp_path):
    for path in (old / "changes").glob("*.json"):
        if json.loads(path.read_text())["action"] == "retract":
            path.unlink()
    TouchLibrary.migrate(old, tmp_path / "new")
    _assert_same(tmp_path / "new", state)


def test_what_is_no_old_library_is_refused(old, tmp_path):
    with pytest.raises(LibraryError, match=r"no library\.sqlite in it"):
        TouchLibrary.migrate(tmp_path / "nothing", tmp_path / "new")
    TouchLibrary.migrate(old, tmp_path / "new")
    with pytest.raises(LibraryError, match="got format 3"):
        TouchLibrary.migrate(tmp_path / "new", tmp_path / "newer")
    with pytest.raises(LibraryError, match="new or empty folder"):
        TouchLibrary.migrate(old, tmp_path / "new")
    (old / "library.sqlite").write_bytes(b"x" * 5000)
    with pytest.raises(LibraryError, match="must be a sound library"):
        TouchLibrary.migrate(old, tmp_path / "newest")
    assert not (tmp_path / "newest").exists()


@pytest.mark.parametrize(
    "cells",
    [
        "changes SET content = '{'",
        "changes SET content = '{}'",
        "changes SET content = '[]'",
        "recordings SET whole = '{'",
        "recordings SET whole = '[]'",
        "recordings SET dtype = 'zz'",
        "touches SET extra = '{'",
    ],
)
def test_a_damaged_cell_is_told_in_one_sentence(old, tmp_path, alter, cells):
    alter(old, f"UPDATE {cells}")
    with pytest.raises(LibraryError, match=r"must be a sound library, got: .*Repair"):
        TouchLibrary.migrate(old, tmp_path / "new")


def test_a_begun_migration_of_another_library_is_not_continued(
    old, tmp_path, monkeypatch, alter
):
    new, other = tmp_path / "new", tmp_path / "other"
    shutil.copytree(old, other)
    alter(other, "UPDATE touches SET id = randomblob(16)")

    def stopped(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", stopped)  # after all touches are written
        with pytest.raises(KeyboardInterrupt):
            TouchLibrary.migrate(old, new)
    with pytest.raises(LibraryError, match="touches of another library"):
        TouchLibrary.migrate(other, new)
