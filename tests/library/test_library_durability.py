"""Killed writers, several writers, full disks and flipped bits lose no touch.

Every acknowledged touch is kept, and no answer is silently wrong.
"""

import os
import random
import shutil
import signal
import sqlite3
import time
import warnings
from collections import Counter
from contextlib import suppress
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import (
    LibraryError,
    SensorDescription,
    TouchLibrary,
    check_library,
)

from .conftest import outcome_elsewhere, press_of, rows_of, started

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes")


def _write(folder, first, n_times, pipe):
    """Add touches and retract some; acknowledge on a pipe what was done."""
    with TouchLibrary.open(folder, create=True) as library:
        for seed in range(first, first + n_times):
            ids = library.add(press_of(seed, 1 + seed % 3))
            os.write(pipe, f"{seed} {' '.join(ids)}\n".encode())
            if seed % 7 == 0:
                library.retract(ids[0], reason="wet")
                os.write(pipe, f"{-seed} {ids[0]}\n".encode())


def _acknowledged(pipe):
    with os.fdopen(pipe) as stream:
        lines = stream.read().splitlines(keepends=True)
    whole = [line.split() for line in lines if line.endswith("\n")]
    return {int(seed): ids for seed, *ids in whole}


def _kill_writers(folder, n_times):
    """Kill two writers at random moments; return everything they acknowledged.

    This happens `n_times`, and on a busy machine again until a touch is
    acknowledged: the first writers may be killed while they make the library.
    """
    rng = random.Random(3)
    acknowledged = {}
    number = 0
    while number < n_times or not acknowledged:
        first = 1 + number * 2000
        writers = [started(_write, folder, first + 1000 * n, 100_000) for n in range(2)]
        time.sleep(rng.uniform(0.005, 0.12))
        for process, pipe in writers:
            os.kill(process.pid, signal.SIGKILL)
            process.join()
            acknowledged |= _acknowledged(pipe)
        number += 1
    return acknowledged


def _assert_all_there(folder, acknowledged):
    assert acknowledged
    with TouchLibrary.open(folder) as library:
        listed = [row.id for row in library.list(limit=None, retracted=True)]
        assert len(set(listed)) == len(listed)
        retracted = {*listed} - {row.id for row in library.list(limit=None)}
        for seed, keys in acknowledged.items():
            if seed <= 0:
                assert set(keys) <= retracted
                continue
            expected = press_of(seed, 1 + seed % 3).images
            assert_array_equal(np.stack([library.image(k) for k in keys]), expected)
            # Touches of one writer are in its order.
            places = [listed.index(key) for key in keys]
            assert places == sorted(places)
        assert str(library.check()).endswith("all present and as they were written.")
        assert not library.repair().rebuilt
        assert [r.id for r in library.list(limit=None, retracted=True)] == listed


@pytest.mark.parametrize("n_times", [6, pytest.param(60, marks=pytest.mark.slow)])
def test_killed_writers_lose_nothing_acknowledged(tmp_path, n_times):
    _assert_all_there(tmp_path, _kill_writers(tmp_path, n_times))


def test_two_writers_at_once_lose_nothing(tmp_path):
    """Touches that both add are stored once. Readers open the library meanwhile."""
    writers = [started(_write, tmp_path, first, 15) for first in (1, 11)]
    while any(process.is_alive() for process, _ in writers):
        if TouchLibrary.is_library(tmp_path):
            with TouchLibrary.open(tmp_path, create=True) as library:
                assert len(library.list(limit=None)) <= 100
    acknowledged = {}
    for process, pipe in writers:
        acknowledged |= _acknowledged(pipe)
        process.join()
        assert process.exitcode == 0
    assert sorted(acknowledged) == [-21, -14, -7, *range(1, 26)]
    _assert_all_there(tmp_path, acknowledged)
    ids = {key for keys in acknowledged.values() for key in keys}
    assert {row.id for row in rows_of(tmp_path)} == ids


def test_what_is_in_the_log_alone_is_there(library, tmp_path):
    """A killed writer leaves acknowledged touches in the log, and no index of it."""
    ids = library.add(press_of(1, 30))
    copy = shutil.copytree(library.folder, tmp_path / "killed")
    (copy / "library.sqlite-shm").unlink()
    assert (copy / "library.sqlite-wal").stat().st_size
    with TouchLibrary.open(copy) as library:
        assert [row.id for row in library.list(limit=None)] == ids
        assert library.check().ok


def test_no_touch_is_acknowledged_into_a_database_that_is_gone(library, tmp_path):
    folder, away = library.folder, tmp_path / "away"
    (key,) = library.add(press_of(1))
    folder.rename(away)
    for change in (
        lambda: library.add(press_of(2)),
        lambda: library.retract(key, reason="wet"),
    ):
        with pytest.raises(LibraryError, match="was removed or replaced since"):
            change()
    TouchLibrary.open(folder, create=True).close()  # another one in its place
    with pytest.raises(LibraryError, match="was removed or replaced since"):
        library.add(press_of(2))
    shutil.rmtree(folder)
    away.rename(folder)
    library.add(press_of(2))
    assert len(library) == 2
    assert library.check().ok


def test_a_disk_that_fills_while_touches_are_added_is_reported(library):
    """SQLite's own limit on pages fails in the same way as a full disk."""
    touches, n_stored = press_of(1, 600, 40), []
    message = "of 600 touches are stored; add them all again, none is stored twice"
    before = library.add(press_of(2))
    run = library._store._connection.execute
    n_pages = run("PRAGMA page_count").fetchone()[0]
    while len(library) < 601:
        n_pages += 15
        run(f"PRAGMA max_page_count = {n_pages}")
        with suppress(LibraryError):
            library.add(touches)
            break
        n_stored.append(len(library) - 1)  # whole transactions alone
        with pytest.raises(LibraryError, match=r"full\. Free space") as refusal:
            library.add(touches)
        told = f"{n_stored[-1]} {message}" in str(refusal.value)
        assert told == (n_stored[-1] > 0)
        assert library.check().ok
    assert sorted(set(n_stored)) == [0, 256, 512]
    assert before[0] == library.list(limit=1)[0].id
    run(f"PRAGMA max_page_count = {run('PRAGMA page_count').fetchone()[0]}")
    with pytest.raises(LibraryError, match=r"full\. Free space"):
        library.retract(before, reason="wet" * 999_999)
    assert library.check().ok


def _under_limit(n_bytes, task, *arguments):
    """Return the outcome of `task` in a process whose files may have `n_bytes`."""

    def prepare():
        import resource

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, n_bytes))

    return outcome_elsewhere(partial(task, *arguments), prepare)


def _rows(folder):
    with TouchLibrary.open(folder) as library:
        return len(library.list(limit=None)), library.touches().images.sum()


def _add(folder, n_touches=256):
    with TouchLibrary.open(folder) as library:
        for seed in range(100, 103):
            library.add(press_of(seed, n_touches, 20))


def _files(folder):
    """Return all files but the index of the log, which SQLite can make anew."""
    files = [p for p in folder.iterdir() if not p.name.endswith("-shm")]
    return {p.name: content for p in files if (content := p.read_bytes())}


def _backup(folder):
    with TouchLibrary.open(folder) as library:
        return library.backup(folder.with_name("copy"))


def _export(folder):
    with TouchLibrary.open(folder) as library:
        return library.export(folder.with_name("e.npz"))


def test_a_full_disk_is_said_of_the_place_that_is_full(tmp_path, monkeypatch):
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(press_of(1, 100, 20))
    outcome = _under_limit(4096, _export, folder)
    assert f"{tmp_path / 'e.npz'} must be a place with room for 100 to" in outcome
    assert list(tmp_path.iterdir()) == [folder]
    connect = sqlite3.connect

    def with_little_room(place, **how):
        connection = connect(place, **how)
        if how == {}:  # where the copy goes
            connection.execute("PRAGMA max_page_count = 5")
        return connection

    with TouchLibrary.open(folder) as library:
        monkeypatch.setattr(sqlite3, "connect", with_little_room)
        with pytest.raises(LibraryError, match="copy must be a place with room for a"):
            library.backup(tmp_path / "copy")
    assert list(tmp_path.iterdir()) == [folder]


def test_a_real_failing_write_is_reported_and_the_library_stays_whole(tmp_path):
    """The write fails within the log, its index, a copy, or a new database."""
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(press_of(1, 100, 20))
    before = _files(folder)
    expected = str(_rows(folder))
    # Without 32 KiB for the shared index of its log, SQLite says "disk I/O error".
    for limit in (100, 4096):
        assert _under_limit(limit, _rows, folder) == expected
        assert "all present" in _under_limit(limit, check_library, folder)
        assert "rebuilt=False" in _under_limit(
            limit, TouchLibrary.repair_folder, folder
        )
        assert "ree space" in _under_limit(limit, _add, folder)
    assert _files(folder) == before
    for limit in (40_000, 120_000, 250_000):
        assert "ree space" in _under_limit(limit, _add, folder)
        assert check_library(folder).ok
        assert _rows(folder)[0] in (100, 356, 612)
    assert "ree space" in _under_limit(50_000, _backup, folder)
    assert not list((tmp_path / "copy").glob("*"))
    assert _backup(folder) == _rows(folder)[0]


def test_a_repair_without_room_leaves_the_old_database(tmp_path, alter):
    folder = tmp_path / "lab"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(press_of(1, 100, 20))
    alter(folder, "UPDATE touches SET force_n = 9 WHERE number = 2")
    before = _files(folder)
    for limit in (4096, 50_000):
        assert "ree space" in _under_limit(limit, TouchLibrary.repair_folder, folder)
        assert _files(folder) == before
    repair = TouchLibrary.repair_folder(folder)
    assert (repair.rebuilt, repair.n_touches, len(repair.lost)) == (True, 99, 1)
    shutil.rmtree(folder / "damaged")
    content = (folder / "library.sqlite").read_bytes()
    (folder / "library.sqlite").write_bytes(b"\0" * 100 + content[100:])
    before = _files(folder)
    for limit in (4096, 50_000, 150_000):  # a new first page is tried on a copy
        assert "ree space" in _under_limit(limit, TouchLibrary.repair_folder, folder)
        assert _files(folder) == before
    assert TouchLibrary.repair_folder(folder).n_touches == 99
    assert check_library(folder).ok


def _touches(seed, n_touches=12):
    rng = np.random.default_rng(seed)
    return Touches(
        rng.integers(0, 255, (n_touches, 5, 6), dtype=np.uint8),
        object=rng.choice(["mug", "pen", "cap"], n_touches),
        force_n=rng.uniform(0.5, 2, n_touches),
        press=np.arange(n_touches),
        position_mm=rng.normal(size=(n_touches, 3)),
        note=rng.choice(["slow", "quick"], n_touches),
        wave=rng.normal(size=(n_touches, 40)),
        no_contact=np.full((5, 6), seed, np.uint8),
    )


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A library with every kind of change in its past, with and without its log.

    Most of the library `log` is in a log that nobody has emptied, as after a kill.
    """
    place = tmp_path_factory.mktemp("sound")
    with TouchLibrary.open(place / "lab", create=True) as library:
        for seed in range(6):
            pad = SensorDescription("pad", "array", "kPa", 4.0, "array")
            library.add(_touches(seed), session=f"s{seed}", sensor=pad)
        library.rename_object("mug", "cup")
        library.add(_touches(7, 3), session="later")
        library.merge_objects("cap", "cup")
        library.retract(object="pen", reason="wet")
        library.restore(
            [row.id for row in library.list("press < 4", limit=None, retracted=True)]
        )
        shutil.copytree(place / "lab", place / "log")
    for shared in place.glob("*/library.sqlite-shm"):
        shared.unlink()
    assert (place / "log" / "library.sqlite-wal").stat().st_size > 100_000
    return place


def _truth(folder):
    """Return all that a library holds, and its warnings."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with TouchLibrary.open(folder) as library:
            rows = library.list(limit=None, retracted=True)
            touches = library.touches()
            state = (
                {row.id: (row, library.image(row.id).tobytes()) for row in rows},
                [row.id for row in rows],
                {n: c.tolist() for n, c in touches.columns.items()},
                {n: c.tolist() for n, c in touches.whole.items()},
                touches.images.tobytes(),
                library.select("session = s2 and force_n > 1").touch_id.tolist(),
                (library.count("note = slow"), library.stats()[:5]),
                (library.objects(), library.sensors(), library.history()),
                np.asarray(library.no_contact("s3")).tolist(),
            )
    return state, [str(warning.message) for warning in warned]


def _outcome(folder, truth, where):
    """Judge one flip; a bare exception or a silently wrong answer fails."""
    try:
        state, warned = _truth(folder)
    except LibraryError:
        state, warned = None, []
    report = check_library(folder)
    noticed = not report.ok or bool(warned)
    assert state in (None, truth) or noticed, f"silently wrong: {where}"
    assert state == truth or not report.ok, f"check saw nothing: {where}"
    if report.ok:
        return "no matter"
    before = {p.name: p.read_bytes() for p in folder.glob("library.sqlite")}
    try:
        repair = TouchLibrary.repair_folder(folder)
    except LibraryError as error:
        # A flipped version looks newer; a flipped header cannot be read.
        assert before == {p.name: p.read_bytes() for p in folder.glob("library.sqlite")}
        return "newer" if "Update palpate" in str(error) else "refused"
    after = check_library(folder)
    assert after.ok, f"{where}: {after}"
    with TouchLibrary.open(folder) as library:
        ids = [row.id for row in library.list(limit=None, retracted=True)]
        images = {key: library.image(key).tobytes() for key in ids}
    assert ids == [key for key in truth[1] if key in images], where
    assert all(truth[0][key][1] == image for key, image in images.items()), where
    assert len(ids) + len(repair.lost) >= len(truth[1]) or not repair.rebuilt, where
    n_lost = len(truth[1]) - len(ids)
    return ("restored", "one lost")[n_lost] if n_lost < 2 else "several lost"


@pytest.mark.parametrize(("name", "suffix"), [("lab", ""), ("log", "-wal")])
@pytest.mark.slow
def test_flips_are_never_silently_wrong(sound, tmp_path, name, suffix):
    """Flip one bit at a time anywhere in a file."""
    rng, n_flips = random.Random(2), 300
    truth, warned = _truth(shutil.copytree(sound / name, tmp_path / "truth"))
    assert not warned
    table = Counter()
    for _ in range(n_flips):
        folder = shutil.copytree(sound / name, tmp_path / "flipped")
        path = folder / f"library.sqlite{suffix}"
        content = bytearray(path.read_bytes())
        bit = rng.randrange(8 * len(content))
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        table[_outcome(folder, truth, f"{path.name} bit {bit}")] += 1
        shutil.rmtree(folder)
    print(dict(table))
    assert table["refused"] <= n_flips / 10  # a damaged header cannot be read
    assert n_flips - table["no matter"] > n_flips / 6
    if not suffix:  # a flip costs a page of rows; in a log, all that follows it
        assert table["several lost"] <= n_flips / 5
