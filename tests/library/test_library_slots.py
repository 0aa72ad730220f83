"""One flush a file: what a kill, a power cut or another program may do in between.

A touch is written to an empty file whose name is on the disk already, flushed, renamed,
and committed. The folder is not flushed after the renaming, so a power cut may undo it:
that is played by renaming back. What was not flushed is played by zeros and cuts; what
becomes of rows is in `test_library_power.py`.
"""

import multiprocessing
import os
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary, check_library, repair_library

FORK = multiprocessing.get_context("fork")
BEFORE = Path(__file__).parent / "data" / "format2_before_slots.zip"


def _press(seed, n_touches=1):
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 255, (n_touches, 40, 60), dtype=np.uint8)
    return Touches(images, object=["mug"] * n_touches, press=[seed] * n_touches)


def _image_files(folder):
    return sorted((folder / "images").glob("*/*.npy"))


def _undo_renaming(folder):
    for number, path in enumerate(_image_files(folder)):
        path.rename(folder / "images" / f".partial-{number:016x}")


class _Killed(sqlite3.Connection):
    """Counts steps of writing; at the last one the process is gone."""

    left = None

    @classmethod
    def step(cls):
        if cls.left is not None:
            cls.left -= 1
            if cls.left < 0:
                os._exit(9)

    def execute(self, sql, *values):
        if sql != "COMMIT":
            return super().execute(sql, *values)
        self.step()
        done = super().execute(sql, *values)
        self.step()
        return done


def _add_until_killed(folder, n_steps, pipe):
    connect, fsync, replace, unlink = sqlite3.connect, os.fsync, Path.replace, os.unlink

    def stepping(call):
        def then(*given, **more):
            _Killed.step()
            return call(*given, **more)

        return then

    sqlite3.connect = lambda *a, **k: connect(*a, factory=_Killed, **k)
    os.fsync, Path.replace, os.unlink = map(stepping, (fsync, replace, unlink))
    with TouchLibrary.open(folder) as library:
        _Killed.left = n_steps
        for seed in (1, 2):  # the first one makes slots, the second one has them
            [key] = library.add(_press(seed))
            os.write(pipe, f"{seed} {key}\n".encode())
        os._exit(0)


def _killed_after(folder, n_steps):
    """Return what was acknowledged, ids by seeds, and whether all steps were made."""
    reading, writing = os.pipe()
    process = FORK.Process(target=_add_until_killed, args=(folder, n_steps, writing))
    process.start()
    os.close(writing)
    with os.fdopen(reading) as stream:
        told = dict(line.split() for line in stream)
    process.join()
    return {int(seed): key for seed, key in told.items()}, process.exitcode == 0


def _take_rows(folder, empty):
    """Undo every commit, none of which was flushed alone."""
    for path in folder.glob("library.sqlite*"):
        path.unlink()
    shutil.copy(empty / "library.sqlite", folder)


@pytest.mark.parametrize("power", ["on", "cut", "cut, rows lost"])
def test_a_kill_at_any_step_leaves_whole_touches_or_nothing(tmp_path, power):
    TouchLibrary.open(tmp_path / "empty", create=True).close()
    finished, n_steps = False, 0
    while not finished:
        folder = shutil.copytree(tmp_path / "empty", tmp_path / f"{n_steps}")
        told, finished = _killed_after(folder, n_steps)
        if power != "on":
            _undo_renaming(folder)
        if power == "cut, rows lost":
            _take_rows(folder, tmp_path / "empty")
        _assert_whole(folder, told)
        n_steps += 1
    # Folders, and for each touch a flush, a renaming and both sides of a commit.
    assert n_steps > 10


def _assert_whole(folder, told):
    with TouchLibrary.open(folder) as library:
        keys = [row.id for row in library.list()]
        assert set(told.values()) <= set(keys)
        assert len(keys) <= len(told) + 1
        known = library.touches() if keys else ()
        for image, press in zip(*_both(known), strict=True):
            assert_array_equal(image, _press(press).images[0])
        report = check_library(folder)
        assert report.ok, str(report)
        gained = library.repair().n_recovered
        assert len(library) == len(keys) + gained
        for seed, key in told.items():
            assert library.add(_press(seed)) == [key]
        assert check_library(folder).ok


def _both(touches):
    return (touches.images, touches.columns["press"]) if touches else ((), ())


@pytest.fixture
def folder(tmp_path):
    """Two touches whose renaming a power cut has undone."""
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        for seed in (1, 2):
            library.add(_press(seed))
    _undo_renaming(tmp_path / "lab")
    assert not _image_files(tmp_path / "lab")
    return tmp_path / "lab"


@pytest.mark.parametrize("lost", [False, True], ids=["kept", "lost"])
@pytest.mark.parametrize("first", [check_library, repair_library, TouchLibrary.open])
def test_an_undone_renaming_is_done_again(folder, first, lost):
    if lost:
        (folder / "library.sqlite").unlink()
        first = repair_library
    opened = first(folder)
    if isinstance(opened, TouchLibrary):
        opened.close()
    assert len(_image_files(folder)) == 2
    assert not list(folder.rglob(".partial-*"))
    assert check_library(folder).problems == []
    with TouchLibrary.open(folder) as library:
        expected = np.concatenate([_press(1).images, _press(2).images])
        assert_array_equal(library.touches().images, expected)


@pytest.mark.parametrize("torn", ["cut", "zeros", "empty", "header", "text"])
def test_what_is_not_whole_in_a_slot_is_left_there(folder, torn):
    """Nobody was told of it, and nothing of it is taken in, even after a lost database.

    The first touch was flushed before the power went, the second was not.
    """
    slot = sorted((folder / "images").glob(".partial-*"))[0]
    content = slot.read_bytes()
    slot.write_bytes(
        {
            "cut": content[:-1],
            "zeros": content[:500] + bytes(1000) + content[1500:],
            "empty": b"",
            "header": bytes(64) + content[64:],
            "text": content[:-100] + b"0" + content[-99:],
        }[torn]
    )
    (folder / "library.sqlite").unlink()
    assert repair_library(folder).n_recovered == 1
    assert slot.is_file()
    remarks = {p.kind for p in check_library(folder).problems}
    assert remarks == (set() if torn == "empty" else {"partial file"})
    with TouchLibrary.open(folder) as library:
        assert len(library) == 1


@pytest.mark.parametrize("meanwhile", ["opened", "removed"])
def test_another_program_may_come_between_flush_and_renaming(
    tmp_path, monkeypatch, meanwhile
):
    """One that opens the library names the file; a repair may remove old slots."""
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(1))
        replace = Path.replace

        def late(path, target):
            monkeypatch.setattr(Path, "replace", replace)
            if meanwhile == "opened":
                TouchLibrary.open(tmp_path).close()
                assert Path(target).is_file()
            else:
                for slot in tmp_path.rglob(".partial-*"):
                    slot.unlink()
            return replace(path, target)

        monkeypatch.setattr(Path, "replace", late)
        library.add(_press(2))
        library.add(_press(3))
        assert library.check().problems == []
        expected = np.concatenate([_press(seed).images for seed in (1, 2, 3)])
        assert_array_equal(library.touches().images, expected)


def test_a_slot_that_cannot_be_written_to_is_reported(tmp_path, monkeypatch):
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(1))

        def full(handle):
            raise OSError(28, os.strerror(28))

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(LibraryError, match="0 of 1 are stored; free space"):
                library.add(_press(2))
        assert library.check().problems == []
        library.add(_press(2))
        assert len(library) == 2


@pytest.fixture
def old(tmp_path):
    """A library written before slots: six touches of presses, and a renaming."""
    shutil.unpack_archive(BEFORE, tmp_path / "old")
    return tmp_path / "old"


OLD_IDS = [
    *("37a4068bd3f75f056d7d835271310f78", "cebc91905d7e27897488a8a81091e722"),
    *("ac7925e31e126098090179051114db7f", "c57170bfd70c9fe477d15d24207e58bf"),
    *("0849dfbd4a0c044b9b09854c49bb4b54", "79ff39ea02de11ed13978374559c799b"),
]


def _old_touches():
    return Touches(
        np.random.default_rng(1).integers(0, 255, (4, 4, 5), dtype=np.uint8),
        object=["mug", "pen"] * 2,
        force_n=np.arange(4) + 0.5,
        press=np.arange(4),
        loads=np.arange(80.0).reshape(4, 20),
        no_contact=np.full((4, 5), 3, np.uint8),
    )


def test_a_library_from_before_is_read_checked_and_added_to(old):
    assert check_library(old).problems == []
    with TouchLibrary.open(old) as library:
        assert [row.id for row in library.list()] == OLD_IDS
        touches = library.touches()
        assert touches.columns["object"].tolist() == ["cup", "pen"] * 3
        assert_array_equal(touches.images[:4], _old_touches().images)
        assert_array_equal(
            touches.columns["loads"][:4], _old_touches().columns["loads"]
        )
        sensor = library.sensors()[0]
        again = library.add(_old_touches(), session="monday", sensor=sensor)
        assert again == OLD_IDS[:4]
        library.add(_old_touches(), session="wednesday", sensor=sensor)
        assert len(library) == 10
        assert library.check().problems == []


def test_a_library_from_before_is_repaired(old):
    with TouchLibrary.open(old) as library:
        before = library.list(), library.objects()
    (old / "library.sqlite").unlink()
    done = repair_library(old)
    assert (done.n_recovered, done.n_changes) == (6, 1)
    with TouchLibrary.open(old) as library:
        assert (library.list(), library.objects()) == before
    largest = max(_image_files(old), key=lambda path: path.stat().st_size)
    largest.write_bytes(largest.read_bytes()[:-1])
    assert repair_library(old).n_set_aside == 4
    assert check_library(old).ok
