"""Threads that add touches at once share files and flushes, and nothing else."""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import LibraryError, SensorDescription, TouchLibrary, check_library

N_THREADS = 8


def _press(seed, n_touches=1):
    rng = np.random.default_rng(seed)
    return Touches(
        rng.integers(0, 255, (n_touches, 5, 6), dtype=np.uint8),
        object=["o" * (1 + seed)] * n_touches,  # texts of any length
        press=[seed] * n_touches,
        loads=rng.normal(size=(n_touches, 20)),
    )


@pytest.fixture
def library(tmp_path):
    with TouchLibrary.open(tmp_path / "lab", create=True) as opened:
        opened.add(_press(0))
        yield opened


def _all_at_once(library, monkeypatch, adding, fsync=os.fsync):
    """Add from threads: one begins and cannot go on until the others wait for it."""
    begun, go_on = Event(), Event()

    def held(handle):
        monkeypatch.setattr(os, "fsync", fsync)
        begun.set()
        assert go_on.wait(60)
        os.fsync(handle)

    monkeypatch.setattr(os, "fsync", held)
    with ThreadPoolExecutor(len(adding)) as pool:
        first, *others = adding
        futures = [pool.submit(first)]
        assert begun.wait(60)
        futures += [pool.submit(add) for add in others]
        while len(library._store.waiting) < len(adding):
            time.sleep(0.001)
        go_on.set()
    return futures


def _adding(library, seeds, **how):
    return [lambda seed=seed: library.add(_press(seed), **how) for seed in seeds]


def test_those_who_wait_share_one_file_and_get_their_own_ids(library, monkeypatch):
    seeds = range(1, 1 + N_THREADS)
    n_files = library.stats().n_files
    futures = _all_at_once(library, monkeypatch, _adding(library, seeds))
    assert library.stats().n_files == n_files + 2  # of the first, and of the others
    for seed, future in zip(seeds, futures, strict=True):
        [key] = future.result()
        [row] = library.list(f"id = '{key}'")
        assert (row.object, row.time_s) == ("o" * (1 + seed), None)
        assert_array_equal(library.image(key), _press(seed).images[0])
    touches = library.touches()
    for number, seed in enumerate(touches.columns["press"]):
        expected = _press(seed).columns["loads"][0]
        assert_array_equal(touches.columns["loads"][number], expected)
    assert library.check().problems == []
    (library.folder / "library.sqlite").unlink()
    library.close()
    library.repair()
    assert check_library(library.folder).ok
    with TouchLibrary.open(library.folder) as again:
        assert len(again) == 1 + N_THREADS


def test_ids_do_not_depend_on_company(library, monkeypatch, tmp_path):
    seeds = range(1, 1 + N_THREADS)
    futures = _all_at_once(library, monkeypatch, _adding(library, seeds))
    with TouchLibrary.open(tmp_path / "alone", create=True) as alone:
        expected = [alone.add(_press(seed)) for seed in seeds]
    assert [future.result() for future in futures] == expected


def test_the_same_touch_from_all_threads_is_one(library, monkeypatch):
    futures = _all_at_once(library, monkeypatch, _adding(library, [3] * N_THREADS))
    assert len({future.result()[0] for future in futures}) == 1
    assert len(library) == 2


def test_unlike_touches_do_not_mix(library, monkeypatch):
    """Other columns, of another type, another sensor, another image size."""
    pad = SensorDescription("pad", "array")
    large = Touches(np.ones((2, 9, 9)), object=["a", "b"])
    forces = Touches(np.ones((1, 5, 6), np.uint8), object=["o"], force_n=[1])
    adding = [
        *_adding(library, (1, 2, 3)),
        *_adding(library, (4,), sensor=pad),
        lambda: library.add(large),
        lambda: library.add(forces),
        lambda: library.add(forces.with_columns(force_n=[1.5])),
    ]
    futures = _all_at_once(library, monkeypatch, adding)
    assert [len(future.result()) for future in futures] == [1] * 4 + [2, 1, 1]
    # The second and third touch share a file.
    assert library.stats().n_files == 1 + len(adding) - 1
    assert library.check().problems == []
    dtypes = {library.touches("force_n = 1").columns["force_n"].dtype.kind}
    assert dtypes == {"i"}


def test_one_failure_of_the_disk_is_tried_again_alone(library, monkeypatch):
    """Two flushes fail: that of the first, who is alone, and that of the others."""
    fsync, left = os.fsync, [True, True]

    def failing(handle):
        if left and left.pop():
            raise OSError(28, os.strerror(28))
        fsync(handle)

    adding = _adding(library, range(1, 1 + N_THREADS))
    first, *others = _all_at_once(library, monkeypatch, adding, failing)
    with pytest.raises(LibraryError, match="0 of 1 are stored; free space"):
        first.result()
    assert all(len(future.result()) == 1 for future in others)
    assert len(library) == N_THREADS
    assert library.check().problems == []


def test_a_full_disk_is_told_to_everyone(library, monkeypatch):
    def full(handle):
        raise OSError(28, os.strerror(28))

    adding = _adding(library, range(1, 1 + N_THREADS))
    for future in _all_at_once(library, monkeypatch, adding, full):
        with pytest.raises(LibraryError, match="0 of 1 are stored; free space"):
            future.result()
    monkeypatch.undo()
    assert len(library) == 1
    assert [len(add()) for add in adding] == [1] * N_THREADS
    assert library.check().problems == []


def test_an_interrupted_thread_leaves_the_others_to_it(library, monkeypatch):
    fsync, left = os.fsync, [True]

    def interrupted(handle):
        if left and left.pop():
            raise KeyboardInterrupt
        fsync(handle)

    adding = _adding(library, range(1, 1 + N_THREADS))
    first, *others = _all_at_once(library, monkeypatch, adding, interrupted)
    with pytest.raises(KeyboardInterrupt):
        first.result()
    assert all(len(future.result()) == 1 for future in others)
    assert not library._store.waiting
    assert library.check().problems == []


def test_a_stream_from_several_threads_keeps_each_threads_order(library):
    def stream(first):
        return [library.add(_press(seed))[0] for seed in range(first, first + 10)]

    with ThreadPoolExecutor(N_THREADS) as pool:
        streams = list(pool.map(stream, range(10, 10 + 10 * N_THREADS, 10)))
    listed = [row.id for row in library.list(limit=None)]
    assert len(set(listed)) == len(listed) == 1 + 10 * N_THREADS
    for keys in streams:
        assert [listed.index(key) for key in keys] == sorted(map(listed.index, keys))
    assert library.check().problems == []
