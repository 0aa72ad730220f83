"""Rows that another program altered: refused or left out, found, and restored."""

import io
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary, check_library, repair_library
from palpate.library._files import packed


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "lab"
    with TouchLibrary.open(place, create=True) as library:
        images = np.arange(6 * 4, dtype=np.uint8).reshape(6, 2, 2)
        labels = ["mug", "pen", "cap"] * 2
        library.add(Touches(images, object=labels, force_n=np.arange(6.0), note=labels))
    return place


def _alter(folder, *statements):
    with closing(sqlite3.connect(folder / "library.sqlite")) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()


def _state(folder):
    with TouchLibrary.open(folder) as library:
        return library.list(limit=None, retracted=True), library.objects()


ALTERED = {
    "force": ("UPDATE touches SET force_n = 6.7e-78 WHERE number = 2", 1),
    "json": ("UPDATE touches SET extra = '{\"note\": ' WHERE number = 2", 1),
    "retraction": ("UPDATE touches SET retraction = 0 WHERE number = 2", 1),
    "unsealed": ("UPDATE touches SET seal = NULL WHERE number = 2", 1),
    "object": ("UPDATE objects SET name = 'pan' WHERE name = 'pen'", 2),
    "layout": ("UPDATE layouts SET columns = '['", 6),
    "recording": ("UPDATE recordings SET whole = '{'", 6),
    "file": ("UPDATE files SET offset = offset + 1", 6),
}


@pytest.mark.parametrize(("statement", "n_damaged"), ALTERED.values(), ids=ALTERED)
def test_altered_rows_are_refused_left_out_found_and_restored(
    folder, statement, n_damaged
):
    before = _state(folder)
    _alter(folder, statement)
    with TouchLibrary.open(folder) as library:
        second = before[0][1].id
        for read in (library.touches, library.select, library.list, library.objects):
            with pytest.raises(
                LibraryError, match=f"(?s){n_damaged} touches.*{second}"
            ):
                read()
        with pytest.raises(LibraryError, match="Rows must be as they were written"):
            library.count("force_n > 100")
        if n_damaged < 6:
            with pytest.warns(UserWarning, match=f"{n_damaged} touches are damaged"):
                rest = library.touches(damaged="skip")
            assert len(rest) == 6 - n_damaged
            with pytest.warns(UserWarning, match="left out"):
                assert len(library.list(damaged="skip")) == 6 - n_damaged
            with pytest.warns(UserWarning, match="left out"):
                assert len(library.select(damaged="skip")) == 6 - n_damaged
        report = library.check()
    assert not report.ok
    assert second in report.problems[0].touches
    assert repair_library(folder).rebuilt
    assert _state(folder) == before
    assert check_library(folder).ok


def test_only_the_rows_that_are_shown_are_judged(folder):
    """A page of a large library does not wait for all of it."""
    _alter(folder, ALTERED["force"][0])
    with TouchLibrary.open(folder) as library:
        assert len(library.list(limit=1)) == 1
        with pytest.raises(LibraryError, match="1 touches are damaged"):
            library.list(limit=2)


def test_a_seal_is_the_same_wherever_it_is_computed(folder):
    """Libraries move between machines and versions of Python."""
    _alter(folder, "UPDATE layouts SET columns = '[]', seal = x'cb52469e861df4af'")
    with TouchLibrary.open(folder) as library:
        assert library.count() == 6


def test_a_damaged_row_is_not_sealed_by_a_change(folder):
    _alter(folder, ALTERED["force"][0])
    with TouchLibrary.open(folder) as library:
        second = library._store.rows(
            "SELECT lower(hex(id)) FROM touches WHERE number = 2"
        )[0][0]
        with pytest.raises(LibraryError, match=r"a damaged row of touches.*--repair"):
            library.retract([second], reason="wet")


def test_rows_that_vanished_are_noticed(folder):
    _alter(folder, "DELETE FROM touches WHERE number = 3")
    with TouchLibrary.open(folder) as library:
        with pytest.raises(LibraryError, match="got missing rows of touches"):
            library.touches()
        assert not library.check().ok
    assert repair_library(folder).rebuilt
    assert len(_state(folder)[0]) == 6


def test_a_row_that_only_its_index_knows_is_missing(folder):
    with closing(sqlite3.connect(folder / "library.sqlite")) as database:
        sql = "SELECT rootpage FROM sqlite_master WHERE name = 'objects'"
        [page] = database.execute(sql).fetchone()
        [size] = database.execute("PRAGMA page_size").fetchone()
    whole = bytearray((folder / "library.sqlite").read_bytes())
    here = slice((page - 1) * size, page * size)
    assert whole[here].count(b"mug") == 1
    whole[here] = whole[here].replace(b"mug", b"jug")
    (folder / "library.sqlite").write_bytes(whole)
    with TouchLibrary.open(folder) as library:
        new = Touches(np.full((1, 2, 2), 99, dtype=np.uint8), object=["mug"])
        with pytest.raises(LibraryError, match="got missing rows of objects"):
            library.add(new)


def test_images_that_are_gone_are_left_out_and_told(folder):
    with TouchLibrary.open(folder) as library:
        [path] = (folder / "images").rglob("*.npy")
        content = bytearray(path.read_bytes())
        content[128 + 4] ^= 1
        path.write_bytes(content)
        with pytest.raises(LibraryError, match="altered values"):
            library.touches()
        with pytest.warns(UserWarning, match="1 touches are left out") as told:
            assert library.touches(damaged="skip").columns["force_n"].tolist() == [
                *(0, 2, 3, 4, 5)
            ]
    assert told[0].filename == __file__


def test_damaged_is_one_of_two_words(folder):
    match = "damaged must be"
    with TouchLibrary.open(folder) as library, pytest.raises(ValueError, match=match):
        library.touches(damaged="ignore")


def test_a_library_without_seals_is_read_and_gets_them_when_written_to(folder):
    """As version 1 made it; until then `check` says so, and rows are compared alone."""
    before = _state(folder)
    tables = "objects", "recordings", "layouts", "files", "changes", "touches"
    drop = [f"ALTER TABLE {table} DROP COLUMN seal" for table in tables]
    _alter(folder, *drop, "PRAGMA user_version = 1")
    assert _state(folder) == before
    report = check_library(folder)
    assert report.ok
    assert [problem.kind for problem in report.problems] == ["unprotected"]
    sealed = shutil.copytree(folder, folder.with_name("sealed"))
    with TouchLibrary.open(sealed) as library:
        library.rename_object("mug", "cup")
        assert not library.check().problems
    _alter(sealed, ALTERED["force"][0])
    with TouchLibrary.open(sealed) as library, pytest.raises(LibraryError):
        library.touches()
    _alter(folder, ALTERED["force"][0])
    assert "got other values" in str(check_library(folder))
    assert repair_library(folder).rebuilt
    assert _state(folder) == before


def test_touches_that_only_the_database_knows_survive_its_repair(folder):
    """Their file is lost, they are set aside; then a row of another one is altered."""
    other = Touches(np.full((2, 2, 2), 9, np.uint8), object=["pen"] * 2, press=[1, 2])
    known = set((folder / "images").rglob("*.npy"))
    with TouchLibrary.open(folder) as library:
        library.add(other)
        [path] = set((folder / "images").rglob("*.npy")) - known
        content = path.read_bytes()
        path.unlink()
        assert library.repair().n_set_aside == 2
    before = _state(folder)
    _alter(folder, ALTERED["force"][0])
    assert repair_library(folder).rebuilt
    assert _state(folder) == before
    path.write_bytes(content)
    assert repair_library(folder).n_restored == 2
    assert check_library(folder).ok


def test_a_row_that_was_taken_back_is_not_remembered(folder):
    with TouchLibrary.open(folder) as library:
        store = library._store
        known = []

        def entered_and_taken_back():
            with store.writing():
                known.append(store.insert("layouts", {"columns": "[]"}))
                known.append(store.key_of("layouts", "columns", "[]"))
                raise RuntimeError

        with pytest.raises(RuntimeError):
            entered_and_taken_back()
        assert known == [2, 2]
        assert store.key_of("layouts", "columns", "[]") is None
        images = np.full((1, 2, 2), 7, dtype=np.uint8)
        library.add(Touches(images, weight=[2.5]))  # another layout takes that key
        assert library.touches("weight = 2.5").columns["weight"].tolist() == [2.5]


PACKED = {
    "no axis": np.array(3.5),
    "empty": np.zeros((0, 4), np.float32),
    "columns first": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    "every other": np.arange(24, dtype=">i4").reshape(4, 6)[::2, ::-1],
    "big": np.arange(4, dtype=">f8"),
    "days": np.array(["2026-01-02", "2026-03-04"], dtype="M8[D]"),
    "text": np.array(["mug", "", "\u00fcber"]),
    "bytes": np.array([b"a", b"bc"]),
}


@pytest.mark.parametrize("array", PACKED.values(), ids=PACKED)
def test_arrays_are_written_as_numpy_does(array):
    stream = io.BytesIO()
    np.save(stream, np.asarray(array, order="C"), allow_pickle=False)
    assert packed([array, array]) == 2 * stream.getvalue()


@pytest.mark.parametrize("dtype", [object, [("a", "i4"), ("b", object)], [("a", "i4")]])
def test_arrays_that_are_no_plain_values_are_not_written(dtype):
    with pytest.raises(ValueError, match="dtype must be of plain values, got"):
        packed([np.zeros(2, dtype=dtype)])
