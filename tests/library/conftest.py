"""Fixtures of the library: an empty one, one with touches, and altered rows."""

import multiprocessing
import os
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate.library import TouchLibrary
from palpate.touches import Touches

from ..cli.conftest import palpate as palpate


def press_of(seed, n_touches=1, side=5):
    """Return touches drawn by a seed, of an object whose name has any length."""
    rng = np.random.default_rng(seed)
    return Touches(
        rng.integers(0, 255, (n_touches, side, 6), dtype=np.uint8),
        object=["o" * (1 + seed % 9)] * n_touches,
        press=[seed] * n_touches,
        loads=rng.normal(size=(n_touches, 20)),
    )


def started(target, *arguments):
    """Run `target` in another process; return it and a pipe of what it writes."""
    reading, writing = os.pipe()
    fork = multiprocessing.get_context("fork")
    process = fork.Process(target=target, args=(*arguments, writing), daemon=True)
    process.start()
    os.close(writing)
    return process, reading


def outcome_elsewhere(task, prepare=lambda: None):
    """Return as text what a task returns or raises in a process of its own."""

    def run(pipe):
        prepare()
        try:
            outcome = str(task())
        except BaseException as error:
            outcome = f"{type(error).__name__}: {error}"
        os.write(pipe, outcome.encode())
        os._exit(0)

    process, pipe = started(run)
    with os.fdopen(pipe) as stream:
        outcome = stream.read()
    process.join()
    return outcome


def assert_alike(read, expected):
    """Fail where touches that were read are not those that are expected."""
    assert read.images.dtype == expected.images.dtype
    assert_array_equal(read.images, expected.images)
    for arrays, expected_arrays in (
        (read.columns, expected.columns),
        (read.whole, expected.whole),
    ):
        assert set(arrays) == set(expected_arrays)
        for name, array in expected_arrays.items():
            assert_array_equal(arrays[name], array, err_msg=name)
            assert arrays[name].dtype.kind == array.dtype.kind


def rows_of(folder):
    """Return every row of a library, also the retracted ones."""
    with TouchLibrary.open(folder) as library:
        return library.list(limit=None, retracted=True)


@pytest.fixture
def library(tmp_path):
    """An empty library, open."""
    with TouchLibrary.open(tmp_path / "library", create=True) as opened:
        yield opened


@pytest.fixture
def seven(rng):
    """Seven touches of two objects in two sessions, one taxel dead."""
    images = rng.normal(size=(7, 3, 4)).astype(np.float32)
    images[:, 0, 0] = np.nan
    images[2, 1, 1] = np.nan  # a reading that one touch lacks
    return Touches(
        images,
        object=["cup"] * 3 + ["pen"] * 4,
        session=["a", "a", "b", "a", "a", "a", "b"],
        time_s=100 + np.arange(7) * 0.5,
        order=np.arange(7)[::-1],
        force_n=np.linspace(0.1, 1, 7),
        position_mm=rng.normal(size=(7, 3)),
        no_contact=np.zeros((3, 4), np.float32),
    )


@pytest.fixture
def alter():
    """Run statements on the database of a library, as another program might."""

    def run(folder, *statements):
        with closing(sqlite3.connect(folder / "library.sqlite")) as database:
            for statement in statements:
                database.execute(statement)
            database.commit()

    return run


@pytest.fixture
def folder(tmp_path):
    """Six touches of three objects; one was retracted."""
    place = tmp_path / "lab"
    with TouchLibrary.open(place, create=True) as library:
        images = np.arange(6 * 4, dtype=np.uint8).reshape(6, 2, 2)
        labels = ["mug", "pen", "cap"] * 2
        library.add(
            Touches(
                images,
                object=labels,
                force_n=np.arange(6.0),
                note=labels,
                no_contact=images[0],
            )
        )
        library.rename_object("cap", "hat")
        library.retract(library.list()[3].id, reason="wet")
    return place
