"""The database: shared transactions, pictures, types, and folders it lies in."""

import os
import shutil
import signal
import sqlite3
import tempfile
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path

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

from .conftest import outcome_elsewhere, press_of, rows_of


@pytest.fixture
def library(library):
    library.add(press_of(0))
    return library


@contextmanager
def _another_writing(library):
    """Have another thread write until the block ends."""
    begun, go_on = threading.Event(), threading.Event()

    def hold():
        begun.set()
        assert go_on.wait(60)

    with ThreadPoolExecutor(1) as pool:
        holding = pool.submit(library._store.write, hold)
        assert begun.wait(60)
        try:
            yield
        finally:
            go_on.set()
        holding.result()


def _at_once(library, *jobs):
    """Run jobs in threads that all wait while another thread is writing."""
    with ThreadPoolExecutor(len(jobs)) as pool, _another_writing(library):
        futures = [pool.submit(job) for job in jobs]
        for _ in range(20_000):
            if len(library._store._waiting) == len(jobs):
                break
            time.sleep(0.001)
    return futures


def _adding(library, seeds, **options):
    return [lambda seed=seed: library.add(press_of(seed, **options)) for seed in seeds]


def test_those_who_wait_share_a_transaction_and_get_their_own_ids(library, tmp_path):
    seeds = range(1, 41)  # more than share a transaction
    run = []
    library._store._connection.set_trace_callback(run.append)
    futures = _at_once(library, *_adding(library, seeds))
    library._store._connection.set_trace_callback(None)
    # The thread that held them up, then 32 of the jobs, then the other jobs.
    assert run.count("COMMIT") == 3
    with TouchLibrary.open(tmp_path / "alone", create=True) as alone:
        assert [f.result() for f in futures] == [alone.add(press_of(s)) for s in seeds]
    for seed, future in zip(seeds, futures, strict=True):
        assert_array_equal(library.image(future.result()[0]), press_of(seed).images[0])
    touches = library.touches()
    for place, seed in enumerate(touches.columns["press"]):
        loads = press_of(seed).columns["loads"][0]
        assert_array_equal(touches.columns["loads"][place], loads)
    assert library.check().ok


def test_unlike_touches_do_not_mix_and_equal_ones_are_one(library):
    """The touches differ in columns, types, sensors and image sizes."""
    pad = SensorDescription("pad", "array")
    forces = Touches(np.ones((1, 5, 6), np.uint8), object=["o"], force_n=[1])
    futures = _at_once(
        library,
        *_adding(library, (1, 2, 3, 3, 3)),
        lambda: library.add(press_of(4), sensor=pad),
        lambda: library.add(Touches(np.ones((2, 9, 9)), object=["a", "b"])),
        lambda: library.add(forces),
        lambda: library.add(forces.with_columns(force_n=[1.5])),
    )
    assert [len(future.result()) for future in futures] == [1] * 6 + [2, 1, 1]
    assert len({future.result()[0] for future in futures[2:5]}) == 1
    assert len(library) == 1 + 4 + 4
    assert library.touches("force_n = 1").columns["force_n"].dtype.kind == "i"
    assert library.check().ok


def test_a_job_that_fails_takes_back_what_it_did_alone(library):
    store = library._store

    def fail():
        store.insert("objects", {"name": "ghost"})
        raise ZeroDivisionError

    pad = SensorDescription("pad")
    library.add(press_of(1), sensor=pad)
    colour = Touches(np.ones((1, 5, 6, 3), np.uint8), channels=["r", "g", "b"])
    futures = _at_once(
        library,
        *_adding(library, range(10, 14)),
        lambda: store.write(fail),
        lambda: library.add(colour, sensor=pad),
        *_adding(library, range(14, 18)),
    )
    with pytest.raises(ZeroDivisionError):
        futures[4].result()
    with pytest.raises(LibraryError, match="must have no channels"):
        futures[5].result()
    assert all(len(f.result()) == 1 for f in futures[:4] + futures[6:])
    assert not store.first_row("SELECT 1 FROM objects WHERE name = 'ghost'")
    assert len(library) == 2 + 8
    assert library.check().ok


def test_all_waiting_writers_learn_of_a_full_disk_and_nothing_is_half_stored(library):
    """SQLite's own limit on pages fails in the same way as a full disk."""
    run = library._store._connection.execute
    n_pages = run("PRAGMA page_count").fetchone()[0]
    run(f"PRAGMA max_page_count = {n_pages}")
    adding = _adding(library, range(1, 9), side=3000)
    for future in _at_once(library, *adding):
        match = r"full\. Free space.*what was acknowledged is kept"
        with pytest.raises(LibraryError, match=match):
            future.result()
    assert len(library) == 1
    run("PRAGMA max_page_count = 1000000")
    assert [len(add()) for add in adding] == [1] * 8
    assert library.check().ok


@pytest.mark.parametrize("when", ["in a job", "after the commit"])
def test_an_interrupt_concerns_one_thread_alone(library, monkeypatch, when):
    """Touches of other threads are stored, and their changes are in the history."""
    store, pending = library._store, [True]

    def interrupt(*_):
        if pending and pending.pop():
            raise KeyboardInterrupt

    changes = [lambda: library.rename_object("o", "x")]
    if when == "in a job":
        changes.append(lambda: store.write(interrupt))
    jobs = [*_adding(library, range(1, 9)), *changes]
    note = store.note_count
    if when == "after the commit":
        skip = iter([True])  # the transaction of the thread that holds them up

        def noted():
            note()
            if not next(skip, False):
                interrupt()

        monkeypatch.setattr(store, "note_count", noted)
    errors = [f.exception() for f in _at_once(library, *jobs)]
    assert [type(error) for error in errors if error] == [KeyboardInterrupt]
    n_interrupted = sum(error is not None for error in errors[:8])
    assert len(library) >= 1 + 8 - n_interrupted
    if errors[8] is None:
        assert library.count("object = x") == 1
        assert len(library.history()) == 1
    assert not store._waiting
    assert library.check().ok


def test_a_stream_from_several_threads_keeps_each_threads_order(library):
    def stream(first):
        return [library.add(press_of(seed))[0] for seed in range(first, first + 10)]

    with ThreadPoolExecutor(8) as pool:
        streams = list(pool.map(stream, range(10, 90, 10)))
    listed = [row.id for row in library.list(limit=None)]
    assert len(set(listed)) == len(listed) == 81
    for keys in streams:
        assert [listed.index(key) for key in keys] == sorted(map(listed.index, keys))


@pytest.mark.parametrize("n_bytes", [0, 1])
def test_a_library_whose_making_was_killed_is_made(tmp_path, n_bytes):
    """A kill leaves an empty file, or a header without a table."""
    path = tmp_path / "library.sqlite"
    path.touch()
    if n_bytes:
        with closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA page_size = 8192")
            database.execute("PRAGMA journal_mode = WAL")
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(press_of(1))
        assert library.check().ok


@pytest.mark.parametrize("colour", [False, True])
def test_pictures_are_kept_as_the_bytes_they_came_in(tmp_path, rng, colour):
    """The pictures are JPEG turned by its Exif orientation, and PNG."""
    Pillow = pytest.importorskip("PIL.Image")
    shape = (6, 9, 3) if colour else (6, 9)
    for ending in ("jpg", "png"):
        (tmp_path / ending / "mug").mkdir(parents=True)
        for n in range(4):
            picture = Pillow.fromarray(rng.integers(0, 255, shape, dtype=np.uint8))
            exif = Pillow.Exif()
            exif[0x0112] = (1, 3, 1, 4)[n] if ending == "jpg" else 1
            path = tmp_path / ending / "mug" / f"{n}.{ending}"
            picture.save(path, exif=exif)
        touches = Touches.load(tmp_path / ending, colour=colour)
        paths = sorted((tmp_path / ending / "mug").iterdir())
        with TouchLibrary.open(tmp_path / f"lab {ending}", create=True) as library:
            # Picked, put together and labelled, each keeps its own file.
            mixed = Touches.concatenate([touches[[3, 1]], touches[:1]])
            library.add(mixed.with_columns(press=[0, 1, 2]))
            library.add(touches[2].with_columns(press=[3]))
            expected = [paths[n].read_bytes() for n in (3, 1, 0, 2)]
            assert library.select().files() == expected
            assert_array_equal(library.touches().images, touches.images[[3, 1, 0, 2]])
            assert library.check().ok
            assert library.add(touches.with_columns(press=[2, 1, 3, 0])) == [
                library.list()[n].id for n in (2, 1, 3, 0)
            ]
            pixels = Touches(touches.images, **touches.columns, **touches.whole)
            assert pixels.files is None
            library.add(pixels.with_columns(press=[2, 1, 3, 0]))
            assert len(library) == 4  # an id follows from the levels


KINDS = [">f4", "<f8", "f2", "?", "i1", ">i2", "<u2", ">u4", "i8", "u8", "longdouble"]


@pytest.mark.parametrize("kind", KINDS)
def test_images_of_any_type_come_back_to_the_bit(tmp_path, kind):
    """Images have the least and the largest value; differences may wrap around."""
    dtype = np.dtype(kind)
    bounds = [0, 1]
    if dtype.kind in "iu":
        bounds = [np.iinfo(dtype).min, np.iinfo(dtype).max]
    if dtype.kind == "f":
        bounds = [np.finfo(dtype).tiny, np.finfo(dtype).max]
    wild = np.array([*bounds, *bounds[::-1], 1, 0] * 4, dtype).reshape(1, 4, 6)
    smooth = (np.arange(3 * 40 * 60) // 50 % 100).reshape(3, 40, 60).astype(dtype)
    for number, images in enumerate((wild, smooth, smooth[:, ::-1, ::2], wild[:, :1])):
        folder = tmp_path / f"{number}"
        with TouchLibrary.open(folder, create=True) as library:
            ids = library.add(Touches(images))
            read = library.touches().images
            assert (read.dtype, read.tobytes()) == (dtype, images.tobytes())
            assert library.image(ids[-1]).tobytes() == images[-1].tobytes()
            assert library.check().ok
            assert library.add(Touches(images.copy())) == ids


@pytest.mark.parametrize("kind", [">f4", "?", "c8", "f2", "u8", "S5", "M8[s]", "U9"])
def test_columns_and_arrays_of_any_type_come_back_to_the_bit(tmp_path, kind):
    dtype = np.dtype(kind)
    values = np.array([0, 1, 2**63 - 1] * 60).reshape(3, 60)
    if dtype.kind in "fc":
        values = values / -3
        values[:2, :2] = [[np.nan, -0.0], [np.inf, -np.inf]]
    with np.errstate(over="ignore"):
        wide = values.astype(np.uint64 if kind == "u8" else values.dtype)
        wide = (wide + (kind == "u8")).astype(dtype)
    columns = {"wide": wide, "short": wide[:, :2], "single": wide[:, 0]}
    with TouchLibrary.open(tmp_path, create=True) as library:
        images = np.eye(3, dtype=np.float32)[:, None]
        images[0, 0, 1:] = np.nan, -0.0
        library.add(Touches(images, **columns, set_table=wide))
        read = library.touches()
        assert read.images.tobytes() == images.tobytes()
        assert read.whole["set_table"].tobytes() == wide.tobytes()
        for name, column in columns.items():
            assert_array_equal(read.columns[name], column)
        back = read.columns["wide"]  # in the byte order of this machine
        assert (back.dtype.kind, back.dtype.itemsize) == (dtype.kind, dtype.itemsize)
        assert back.astype(dtype).tobytes() == wide.tobytes()
        assert library.check().ok


def _be_nobody():
    """Give up the right to write in this process, and make warnings errors."""
    if os.geteuid() == 0:
        os.setuid(65534)
    warnings.simplefilter("error")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs another user")
def test_a_library_in_a_folder_that_may_not_be_written_to_is_read(folder):
    def read():
        with TouchLibrary.open(place) as library:
            rows = library.list(limit=None, retracted=True), library.touches().images
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                features = library.select().features("key", summed).tolist()
            if said:
                assert "folder with room to keep features in" in str(said[0].message)
            return rows, library.check().ok, library.history(), features

    def summed(touches):
        return touches.images.sum(axis=(1, 2), dtype=float)[:, None]

    def add():
        with TouchLibrary.open(place) as library:
            library.add(press_of(1))

    def make():
        TouchLibrary.open(outer / "new" / "lab", create=True)

    def backup():
        with TouchLibrary.open(place) as library, tempfile.TemporaryDirectory() as to:
            return library.backup(Path(to) / "copy")

    with tempfile.TemporaryDirectory() as readable_by_all:
        outer = Path(readable_by_all)
        outer.chmod(0o755)
        place = shutil.copytree(folder, outer / "lab")
        expected = str(read())
        shutil.rmtree(place / "features")
        before = {path: path.read_bytes() for path in place.iterdir()}
        for path in before:
            path.chmod(0o444)
        for leave in (0o777, 0o555):  # to a group's folder, and to none
            place.chmod(leave)
            assert outcome_elsewhere(read, _be_nobody) == expected
            assert "may be written to" in outcome_elsewhere(add, _be_nobody)
            assert outcome_elsewhere(backup, _be_nobody) == "6"
            # A log or its index of another's would keep the owner from writing.
            shutil.rmtree(place / "features", ignore_errors=True)
            assert {path: path.read_bytes() for path in place.iterdir()} == before
        assert "folder that can be made" in outcome_elsewhere(make, _be_nobody)
        place.chmod(0o755)


def test_a_library_that_its_owner_wrote_to_is_read_no_further(folder, monkeypatch):
    """A reader who may not write has no lock: pages may be of two moments."""
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda *_: False)
        reader = TouchLibrary.open(folder)
    with reader:
        n_touches = len(reader)
        with TouchLibrary.open(folder) as owner:
            owner.add(press_of(99))
        with pytest.raises(LibraryError, match="was written to"):
            reader.touches()
    with TouchLibrary.open(folder) as again:
        assert len(again) == n_touches + 1


@pytest.mark.skipif(os.name != "posix", reason="of POSIX")
def test_a_library_of_a_group_can_be_written_by_all_of_it(tmp_path, alter):
    before = os.umask(0o002)
    try:
        with TouchLibrary.open(tmp_path / "group", create=True) as library:
            library.add(press_of(1))
            library.backup(tmp_path / "copy")
    finally:
        os.umask(before)
    alter(tmp_path / "copy", "UPDATE touches SET force_n = 9")
    assert TouchLibrary.repair_folder(tmp_path / "copy").rebuilt
    for name in ("group", "copy"):
        assert (tmp_path / name / "library.sqlite").stat().st_mode & 0o777 == 0o664


def test_a_database_that_another_keeps_to_itself_is_left_alone(
    folder, monkeypatch, lower
):
    lower(monkeypatch, database_patience_s=0.05, database_patience_alone_s=0.05)
    before = (folder / "library.sqlite").read_bytes()
    with TouchLibrary.open(folder) as library:
        with closing(sqlite3.connect(folder / "library.sqlite")) as other:
            other.execute("BEGIN IMMEDIATE")
            assert len(library.touches()) == 5  # readers wait for nobody
            for write in (
                lambda: library.add(press_of(1)),
                lambda: library.rename_object("mug", "cup"),
            ):
                with pytest.raises(
                    LibraryError, match=r"locked\. Another.*wait, or en"
                ):
                    write()
        library.add(press_of(1))
    with closing(sqlite3.connect(folder / "library.sqlite")) as other:
        other.execute("PRAGMA locking_mode = EXCLUSIVE")
        other.execute("SELECT * FROM touches").fetchall()
        [problem] = check_library(folder).problems
        assert problem.kind == "disk"
        assert "Another program" in problem.what
        with pytest.raises(LibraryError, match="wait, or end it"):
            TouchLibrary.repair_folder(folder)
    assert check_library(folder).ok
    assert (folder / "library.sqlite").read_bytes() != before


def test_a_library_that_another_is_making_is_waited_for(tmp_path):
    place = tmp_path / "library.sqlite"
    other = sqlite3.connect(place, check_same_thread=False, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    threading.Timer(0.2, other.close).start()
    with TouchLibrary.open(tmp_path, create=True) as library:
        assert len(library) == 0


@pytest.mark.parametrize("kind", ["nfs4", "cifs", "smb3", "fuse.sshfs"])
def test_a_network_file_system_is_warned_of(folder, monkeypatch, tmp_path, kind):
    mounts, read_text = tmp_path / "my mounts", Path.read_text

    def read(path, *how, **more):
        listed = mounts if path == Path("/proc/self/mounts") else path
        return read_text(listed, *how, **more)

    monkeypatch.setattr(Path, "read_text", read)
    with TouchLibrary.open(folder):
        pass  # a system without a list of mounts
    place = str(folder.parent).replace(" ", "\\040")
    mounts.write_text(f"/dev/a / ext4 rw 0 0\nhost:/b {place} {kind} rw 0 0\n")
    with pytest.warns(UserWarning, match=rf"network file system \({kind}\)") as warned:
        TouchLibrary.open(folder).close()
    assert warned[0].filename == __file__
    mounts.write_text(f"host:/b / {kind} rw 0 0\n/dev/a {place} ext4 rw 0 0\n")
    TouchLibrary.open(folder).close()
    mounts.write_text(f"/dev/a / ext4 rw 0 0\nhost:/b {place}2 {kind} rw 0 0\n")
    TouchLibrary.open(folder).close()


def test_the_connection_has_the_settings_that_the_library_relies_on(library):
    """With synchronous = 2 (FULL) SQLite flushes its log at each commit."""
    run = library._store._connection.execute
    settings = {
        "synchronous": 2,
        "journal_mode": "wal",
        "foreign_keys": 1,
        "page_size": 8192,
    }
    for name, value in settings.items():
        assert run(f"PRAGMA {name}").fetchone() == (value,)


def test_the_view_has_the_rows_of_a_list_in_their_order(folder):
    with closing(sqlite3.connect(folder / "library.sqlite")) as database:
        rows = database.execute(
            "SELECT id, object, force_n, n_rows, n_cols, retracted_because "
            "FROM touch_list"
        ).fetchall()
    expected = [
        (r.id, r.object, r.force_n, r.n_rows, r.n_cols, r.reason)
        for r in rows_of(folder)
    ]
    assert rows == expected


def test_what_is_interrupted_while_it_waits_is_not_done_later(library):
    """The job that waits for another thread is given up for good."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    main = threading.main_thread().ident
    interrupt = threading.Timer(0.3, signal.pthread_kill, (main, signal.SIGINT))
    with _another_writing(library):
        interrupt.start()
        try:
            with pytest.raises(KeyboardInterrupt):
                library.add(press_of(1))
        finally:
            interrupt.join()
            signal.signal(signal.SIGINT, before)
    library.add(press_of(2))
    assert len(library) == 1 + 1
