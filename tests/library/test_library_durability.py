"""Killed writers, several writers, full disks, damaged files: no touch is lost."""

import errno
import hashlib
import io
import multiprocessing
import os
import random
import signal
import sqlite3
import time

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

FORK = multiprocessing.get_context("fork")


def _press(seed, n_touches=1):
    """Touches that the seed alone decides."""
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 255, (n_touches, 6, 6), dtype=np.uint8)
    return Touches(
        images, object=[f"o{seed % 5}"] * n_touches, press=[seed] * n_touches
    )


def _write_until_killed(folder, first, pipe):
    with TouchLibrary.open(folder, create=True) as library:
        for seed in range(first, first + 100_000):
            ids = library.add(_press(seed, 1 + seed % 3))
            os.write(pipe, f"{seed} {' '.join(ids)}\n".encode())


def _start(target, *arguments):
    """Run `target` in another process; return it and what it acknowledges."""
    reading, writing = os.pipe()
    process = FORK.Process(target=target, args=(*arguments, writing), daemon=True)
    process.start()
    os.close(writing)
    return process, reading


def _acknowledged(pipe):
    with os.fdopen(pipe) as stream:
        lines = stream.read().splitlines(keepends=True)
    whole = [line.split() for line in lines if line.endswith("\n")]
    return {int(seed): ids for seed, *ids in whole}


def _kill_writers(folder, n_times):
    """Kill writers at random moments; return everything they acknowledged.

    So many, and on a busy machine more, until one has acknowledged something.
    """
    rng = random.Random(3)
    acknowledged = {}
    number = 0
    while number < n_times or not acknowledged:
        process, pipe = _start(_write_until_killed, folder, number * 1000)
        time.sleep(rng.uniform(0.01, 0.12))
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        acknowledged |= _acknowledged(pipe)
        number += 1
    return acknowledged


def _assert_all_there(folder, acknowledged):
    ids = [key for keys in acknowledged.values() for key in keys]
    assert ids
    with TouchLibrary.open(folder) as library:
        listed = [row.id for row in library.list(limit=None)]
        assert len(set(listed)) == len(listed)
        assert set(ids) <= set(listed)
        for seed, keys in acknowledged.items():
            expected = _press(seed, 1 + seed % 3).images
            assert_array_equal(np.stack([library.image(k) for k in keys]), expected)
        report = library.check()
        assert {p.kind for p in report.problems} <= {
            "partial file",
            "file without touches",
        }
        assert report.ok
        # What a killed writer had written but not acknowledged can be taken in.
        gained = library.repair().n_recovered
        assert len(library) == len(listed) + gained
        assert library.check().ok


def test_a_killed_writer_loses_nothing_acknowledged(tmp_path):
    _assert_all_there(tmp_path, _kill_writers(tmp_path, 8))


@pytest.mark.slow
def test_a_hundred_killed_writers_lose_nothing_acknowledged(tmp_path):
    _assert_all_there(tmp_path, _kill_writers(tmp_path, 100))


def _write_some(folder, first, pipe):
    with TouchLibrary.open(folder, create=True) as library:
        for seed in range(first, first + 15):
            ids = library.add(_press(seed, 1 + seed % 3))
            os.write(pipe, f"{seed} {' '.join(ids)}\n".encode())


def test_two_writers_at_once_lose_nothing(tmp_path):
    """They also add some touches both: those are one."""
    started = [_start(_write_some, tmp_path, first) for first in (0, 10)]
    acknowledged = {}
    for process, pipe in started:
        acknowledged |= _acknowledged(pipe)
        process.join()
        assert process.exitcode == 0
    assert sorted(acknowledged) == list(range(25))
    _assert_all_there(tmp_path, acknowledged)
    with TouchLibrary.open(tmp_path) as library:
        assert len(library) == sum(len(ids) for ids in acknowledged.values())


class _Full:
    """A disk that is full from the n-th call on."""

    def __init__(self, call, after):
        self.call, self.left = call, after

    def __call__(self, *arguments, **options):
        self.left -= 1
        if self.left < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self.call(*arguments, **options)


@pytest.mark.parametrize(
    ("name", "after"), [("open", 0), ("open", 1), *(("fsync", n) for n in range(6))]
)
def test_a_full_disk_is_reported_and_the_library_stays_whole(
    tmp_path, monkeypatch, name, after
):
    touches = _press(1, 600).with_columns(no_contact=np.zeros((6, 6), np.uint8))
    with TouchLibrary.open(tmp_path, create=True) as library:
        before = library.add(_press(2))
        with monkeypatch.context() as patch:
            patch.setattr(os, name, _Full(getattr(os, name), after))
            with pytest.raises(LibraryError, match="free space"):
                library.add(touches)
        assert not any(p.stat().st_size for p in tmp_path.rglob(".partial-*"))
        n_stored = len(library) - 1
        assert n_stored in (0, 256, 512)  # whole files alone
        assert library.check().ok
        assert set(before) < {*before, *library.add(touches)}
        assert len(library) == 601


def test_a_disk_that_fills_in_the_database_is_reported(tmp_path):
    """SQLite's own limit on pages stands for a full disk: it fails the same way."""
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(0))
        connection = library._store._connection
        n_pages = connection.execute("PRAGMA page_count").fetchone()[0]
        connection.execute(f"PRAGMA max_page_count = {n_pages}")
        match = r"full\..*what was acknowledged is kept"
        with pytest.raises(LibraryError, match=match):
            _fill(library)
        n_left = len(library)
        connection.execute("PRAGMA max_page_count = 1000000")
        assert library.check().ok
        library.add(_press(999, 40))
        assert len(library) == n_left + 40


def _fill(library):
    for seed in range(1, 300):
        library.add(_press(seed, 40))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs limits of a process")
def test_a_limit_on_file_size_in_the_middle_of_an_import(tmp_path):
    """A real failing write, half-way through a file."""

    def fill(folder, pipe):
        import resource

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        with TouchLibrary.open(folder) as library:
            resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
            try:
                library.add(_press(7, 256))
                library.add(Touches(np.ones((30, 200, 200)), object=["big"] * 30))
            except LibraryError as error:
                os.write(pipe, f"{error}".encode())

    TouchLibrary.open(tmp_path, create=True).close()
    process, pipe = _start(fill, tmp_path)
    with os.fdopen(pipe) as stream:
        message = stream.read()
    process.join()
    assert "0 of 30 are stored; free space" in message
    with TouchLibrary.open(tmp_path) as library:
        assert len(library) == 256
        assert library.check().ok


@pytest.fixture
def filled(tmp_path):
    """A library with changes in its past; what it held is in `expected`."""
    with TouchLibrary.open(tmp_path, create=True) as library:
        for seed in range(10):
            library.add(_press(seed, 3), session=f"s{seed % 2}")
        library.rename_object("o1", "mug")
        library.add(_press(11, 2))  # another object of the freed name o1
        library.merge_objects("o2", "o3")
        library.retract(object="o4", reason="broken")
        library.restore([library.list(retracted=True, limit=None)[12].id])
    return tmp_path


def _state(folder):
    with TouchLibrary.open(folder) as library:
        rows = library.list(limit=None, retracted=True)
        return sorted(rows, key=lambda row: row.id), library.objects()


@pytest.mark.parametrize("damage", ["lost", "empty", "truncated", "scribbled"])
def test_a_damaged_database_is_named_and_rebuilt(filled, damage):
    before = _state(filled)
    path = filled / "library.sqlite"
    content = path.read_bytes()
    for log in filled.glob("library.sqlite-*"):
        log.unlink()
    if damage == "lost":
        path.unlink()
    else:
        broken = {
            "empty": b"",
            "truncated": content[: 4096 * 3 + 100],
            "scribbled": content[:4096] + b"\xaa" * (len(content) - 4096),
        }
        path.write_bytes(broken[damage])
    report = check_library(filled)
    assert not report.ok
    assert report.problems[0].kind == "database"
    assert "library.sqlite" in str(report)
    assert repair_library(filled).rebuilt
    assert check_library(filled).ok
    assert _state(filled) == before
    assert not repair_library(filled).rebuilt


def test_a_missing_and_an_altered_file_are_found_set_aside_and_come_back(filled):
    with TouchLibrary.open(filled) as library:
        library.restore(object="o4")
    before = _state(filled)
    missing, altered, *_ = sorted((filled / "images").rglob("*.npy"))
    kept = missing.read_bytes(), altered.read_bytes()
    missing.unlink()
    altered.write_bytes(kept[1][:130] + bytes([kept[1][130] ^ 1]) + kept[1][131:])
    report = check_library(filled)
    assert not report.ok
    found = {p.path.split("/")[-1]: p.touches for p in report.problems}
    assert len(found[missing.name]) >= 2
    assert len(found[altered.name]) == 1
    n_lost = sum(map(len, found.values()))
    assert repair_library(filled).n_set_aside == n_lost
    with TouchLibrary.open(filled) as library:
        assert len(library) == len(library.touches("object is not null"))
        gone = [r for r in library.list(limit=None, retracted=True) if r.reason]
        assert sum("missing or altered" in row.reason for row in gone) == n_lost
    missing.write_bytes(kept[0])
    altered.write_bytes(kept[1])
    assert repair_library(filled).n_restored == n_lost
    assert _state(filled) == before


def test_a_lost_whole_set_array_is_named(tmp_path):
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(_press(1).with_columns(no_contact=np.zeros((6, 6))))
        next((tmp_path / "arrays").rglob("*.npy")).unlink()
        assert [p.kind for p in library.check().problems] == ["array"]


def test_a_newer_library_is_neither_read_nor_repaired(filled):
    database = sqlite3.connect(filled / "library.sqlite")
    database.execute("PRAGMA user_version = 3")
    database.close()
    assert [p.kind for p in check_library(filled).problems] == ["version"]
    with pytest.raises(LibraryError, match="Update palpate"):
        repair_library(filled)


def _packed(*arrays):
    """Return arrays as a library writes them into one file."""
    stream = io.BytesIO()
    for array in arrays:
        np.save(stream, array)
    return stream.getvalue()


def test_hostile_files_are_not_taken_in(filled):
    """Files with a right name and wrong content change nothing and break nothing."""
    before = _state(filled)
    text = b'{"format": 1, "layout": [["object", "<U1", [], false]], "values": {}}'
    hostile = [
        _packed(np.zeros((1, 6, 6)), np.frombuffer(text, np.uint8)),
        _packed(np.zeros(3)),
        b"\x93NUMPY\x01\x00\x76\x00{'descr': '|O', 'shape': (1,)}",
        b"\x93NUMPY\x01\x00\xff\xff",
        b"nothing",
        b"",
    ]
    for content in hostile:
        name = hashlib.sha256(content).hexdigest()
        path = filled / "images" / name[:2] / f"{name}.npy"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    assert check_library(filled).ok
    assert repair_library(filled).n_recovered == 0
    assert _state(filled) == before
