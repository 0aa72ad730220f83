"""What a killed writer cannot show: what is flushed and read, and in which order."""

import os
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary, check_library, repair_library


def _presses(seed=0):
    """Four touches with a press of twenty numbers each, too long for a cell."""
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 255, (4, 6, 6), dtype=np.uint8)
    return Touches(images, object=["a", "b"] * 2, loads=rng.normal(size=(4, 20)))


class _Traced(sqlite3.Connection):
    """Notes its commits among the flushes and renames."""

    events = None

    def execute(self, sql, *values):
        if self.events is not None and sql == "COMMIT":
            self.events.append("commit")
        return super().execute(sql, *values)


@pytest.fixture
def traced(tmp_path, monkeypatch):
    """An open library, and the list of what it does to the disk."""
    events = []
    monkeypatch.setattr(
        sqlite3,
        "connect",
        lambda *given, connect=sqlite3.connect, **more: connect(
            *given, factory=_Traced, **more
        ),
    )
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        library.add(_presses(9))
        library.rename_object("a", "old")
        with monkeypatch.context() as patch:
            fsync, replace = os.fsync, type(tmp_path).replace

            def flush(handle):
                folder = Path(f"/proc/self/fd/{handle}").is_dir()
                events.append("folder" if folder else "file")
                fsync(handle)

            def rename(path, target):
                events.append("rename")
                return replace(path, target)

            patch.setattr(os, "fsync", flush)
            patch.setattr(type(tmp_path), "replace", rename)
            patch.setattr(_Traced, "events", events)
            yield library, events


needs_proc = pytest.mark.skipif(
    not Path("/proc/self/fd").is_dir(), reason="tells files from folders"
)


@needs_proc
def test_touches_are_on_the_disk_before_the_database_knows_them(traced):
    library, events = traced
    library.add(_presses())
    assert events == ["file", "rename", "commit"]


@needs_proc
def test_names_to_write_to_are_on_the_disk_before_they_are_used(traced):
    """Some are made now and then, two folders flushed; a touch takes one flush more."""
    library, events = traced
    for seed in range(10, 50):
        library.add(_presses(seed))
    text = " ".join(events)
    assert text.count("folder folder file rename commit") == text.count("folder fol")
    assert text.count("folder folder") in (2, 3)
    assert text.count("file rename commit") == 40
    made = {p.name for p in (library.folder / "images").glob(".partial-*")}
    assert made
    library.close()
    assert not list(library.folder.rglob(".partial-*"))


@needs_proc
def test_a_no_contact_image_is_not_flushed_with_every_touch(traced):
    """It is once more where it is found, since another program may just write it."""
    library, events = traced
    for seed in range(3):
        events.clear()
        library.add(_presses(seed).with_columns(no_contact=np.zeros((6, 6))))
    assert events == ["file", "rename", "commit"]


@needs_proc
def test_a_change_is_on_the_disk_before_the_database_knows_it(traced):
    library, events = traced
    library.rename_object("old", "new")
    assert events == ["file", "rename", "folder", "commit"]


def test_a_change_waits_for_the_disk(traced):
    """A change was made last: SQLite flushes its log at each commit at 2 (FULL)."""
    connection = traced[0]._store._connection
    assert connection.execute("PRAGMA synchronous").fetchone() == (2,)
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert connection.execute("PRAGMA foreign_keys").fetchone() == (1,)


@pytest.fixture
def altered(tmp_path):
    """A library of presses in which one number of one press is another."""
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(_presses())
    [path] = (folder / "images").rglob("*.npy")
    content = bytearray(path.read_bytes())
    place = content.index(_presses().columns["loads"][2, 3].tobytes())
    content[place + 7] ^= 1
    path.write_bytes(content)
    return folder


def test_an_altered_press_is_not_read(altered):
    with TouchLibrary.open(altered) as library:
        assert library.image(library.list()[0].id).shape == (6, 6)
        with pytest.raises(LibraryError, match="altered content"):
            library.touches()


def test_touches_with_an_altered_press_are_set_aside_with_their_file(altered):
    """Which of the four is altered cannot be known, though all images are whole."""
    [problem] = check_library(altered).problems
    assert len(problem.touches) == 4
    assert repair_library(altered).n_set_aside == 4
    assert check_library(altered).ok
    with TouchLibrary.open(altered) as library:
        assert len(library) == 0
        library.add(_presses())
        assert len(library) == 4
        assert library.check().ok


def test_a_rebuild_goes_by_time_and_not_by_name(tmp_path):
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_presses())
        library.rename_object("a", "c")
        library.rename_object("b", "a")
        library.add(_presses(1))
    for number, path in enumerate(sorted((tmp_path / "changes").iterdir())):
        path.rename(path.with_name(f"{9 - number:017d}-00000000.json"))
    (tmp_path / "library.sqlite").unlink()
    assert repair_library(tmp_path).n_changes == 2
    with TouchLibrary.open(tmp_path) as library:
        assert [row.object for row in library.list()] == [*"caca", *"abab"]
