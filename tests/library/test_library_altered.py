"""Altered rows and pages are refused and reported; all other touches are kept."""

import os
import shutil
import sqlite3
import threading
import time
import warnings
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest

from palpate.library import (
    LibraryError,
    TouchLibrary,
    _upkeep,
    check_library,
)

from .conftest import press_of, rows_of

PAGE = 8192


REFUSED = {
    "force": ("UPDATE touches SET force_n = 6.7e-78 WHERE number = 2", "2"),
    "no force": ("UPDATE touches SET force_n = NULL WHERE number = 2", "2"),
    "text": ("UPDATE touches SET force_n = '1.0' WHERE number = 2", "2"),
    "json": ("UPDATE touches SET extra = '{\"note\": ' WHERE number = 2", "2"),
    "label": ("UPDATE touches SET label = 'mug' WHERE number = 2", "2"),
    "its object": ("UPDATE touches SET object = 1 WHERE number IN (2, 5)", "25"),
    "no object": ("UPDATE touches SET object = NULL WHERE number = 2", "2"),
    "other object": ("UPDATE objects SET name = 'pan' WHERE name = 'pen'", "25"),
    "merged": ("UPDATE objects SET merged_into = 1 WHERE name = 'pen'", "25"),
    "id": (f"UPDATE touches SET id = x'{'00' * 16}' WHERE number = 2", "2"),
    "digest": ("UPDATE touches SET digest = x'00' WHERE number = 2", "2"),
    "content": ("UPDATE touches SET content = image WHERE number = 2", "2"),
    "time": ("UPDATE touches SET added_s = 0 WHERE number = 2", "2"),
    "layout": ("UPDATE layouts SET columns = '['", "123456"),
    "deep layout": ("UPDATE layouts SET columns = printf('%.*c', 9999, '[')", "123456"),
    "odd layout": ("UPDATE layouts SET columns = '[5]'", "123456"),
    "odd names": ("UPDATE layouts SET columns = '[[[1],2,[],0]]'", "123456"),
    "recording": ("UPDATE recordings SET unit = 'bar'", "123456"),
    "size": ("UPDATE recordings SET n_rows = 1000000000000", "123456"),
    "whole": ('UPDATE recordings SET whole = \'{"a":"../../x"}\'', "123456"),
    "image": ("UPDATE images SET image = x'00' WHERE number = 2", "2"),
    "form": ("UPDATE images SET form = 'picture' WHERE number = 2", "2"),
    "more": ("UPDATE images SET more = x'00' WHERE number = 2", "2"),
    "no image": ("DELETE FROM images WHERE number = 2", "2"),
    "a name's change": (
        'UPDATE changes SET content = \'{"old":"cap"}\' WHERE id = 1',
        "36",
    ),
    "no change": ("DELETE FROM changes WHERE id = 1", "36"),
    "a change's place": ("UPDATE changes SET after = 3 WHERE id = 1", "36"),
}


@pytest.mark.parametrize(("statement", "numbers"), REFUSED.values(), ids=REFUSED)
def test_what_is_altered_is_refused_left_out_found_and_set_aside(
    folder, alter, statement, numbers
):
    before, lost_rows = rows_of(folder), [int(n) - 1 for n in numbers]
    alter(folder, statement)
    with TouchLibrary.open(folder) as library:
        for read in (library.touches, lambda: library.select().touches(range(5))):
            with pytest.raises(LibraryError):
                read()
        if len(lost_rows) < 6:
            with pytest.warns(UserWarning, match="left out"):
                undamaged = library.touches(damaged="skip")
            assert len(undamaged) == 5 - len({*lost_rows} - {3})
        report = library.check()
    assert not report.ok
    assert len(report.problems) < 20
    repair = TouchLibrary.repair_folder(folder)
    assert check_library(folder).ok
    assert repair.rebuilt
    assert list(folder.glob("damaged/*/library.sqlite"))
    kept = rows_of(folder)
    n_lost = len(before) - len(kept)
    assert n_lost == len(repair.lost)
    if "change" in statement:  # touches are whole, but under their first names
        assert [r._replace(object=None) for r in kept] == [
            r._replace(object=None) for r in before
        ]
    elif "objects" in statement or "SET object" in statement:
        assert kept == before
    else:
        assert kept == [row for n, row in enumerate(before) if n not in lost_rows]


UNNOTICED = {
    "last": "DELETE FROM touches WHERE number = 6",
    "one": "DELETE FROM touches WHERE number = 3",
    "touch and image": "DELETE FROM images WHERE number = 6; "
    "DELETE FROM touches WHERE number = 6",
    "retraction": "UPDATE touches SET retraction = NULL",
    "retracted": "UPDATE touches SET retraction = 1 WHERE number = 1",
    "other reason": "UPDATE touches SET retraction = 1 WHERE number = 4",
    "last change": "UPDATE touches SET retraction = NULL; "
    "DELETE FROM changes WHERE id = 2",
    "reason": 'UPDATE changes SET content = replace(content, "wet", "dry")',
    "count": "UPDATE tally SET n_touches = 5",
    "no count": "DELETE FROM tally",
    "arrays": "DELETE FROM arrays",
    "order": "UPDATE touches SET number = 9 WHERE number = 2; "
    "UPDATE images SET number = 9 WHERE number = 2",
}


@pytest.mark.parametrize("statements", UNNOTICED.values(), ids=UNNOTICED)
def test_what_reading_cannot_notice_is_found_by_a_check(folder, alter, statements):
    before = {row.id for row in rows_of(folder)}
    alter(folder, *statements.split("; "))
    assert not check_library(folder).ok
    TouchLibrary.repair_folder(folder)
    assert {problem.kind for problem in check_library(folder).problems} <= {"left out"}
    gone = before - {row.id for row in rows_of(folder)}
    assert len(gone) == ("DELETE FROM touches" in statements)


def test_a_flip_that_makes_bytes_a_text_is_no_crash(folder):
    """One byte of a row is the type of a cell; text is the type of bytes plus one."""
    path = folder / "library.sqlite"
    with closing(sqlite3.connect(path)) as database:
        [[n_bytes]] = database.execute("SELECT length(content) FROM arrays")
    content = bytearray(path.read_bytes())
    cell_type = 12 + 2 * n_bytes  # follows that of a digest of 32 bytes
    header = bytes([4, 12 + 2 * 32, 0x80 | cell_type >> 7, cell_type & 0x7F])
    content[content.index(header) + 3] ^= 1
    path.write_bytes(content)
    kinds = {problem.kind for problem in check_library(folder).problems}
    assert kinds == {"array", "database"}
    with TouchLibrary.open(folder) as library, pytest.warns(UserWarning, match="check"):
        assert library.touches().no_contact is None


def test_counts_that_never_reached_the_disk_are_refused_and_repaired(folder):
    """Where the end of a page is missing SQLite reads zeros: a row of NULLs."""
    path, before = folder / "library.sqlite", rows_of(folder)
    content = bytearray(path.read_bytes())
    integer, digest = 1, 12 + 2 * 32
    place = content.index(bytes([6, 0, integer, digest, integer, digest]))
    content[place : -(-place // PAGE) * PAGE] = bytes(-place % PAGE)
    path.write_bytes(content)
    with pytest.raises(LibraryError, match="got no count of its touches"):
        TouchLibrary.open(folder)
    assert not check_library(folder).ok
    assert TouchLibrary.repair_folder(folder).rebuilt
    assert check_library(folder).ok
    assert rows_of(folder) == before


def test_an_image_on_a_broken_page_is_left_out_and_named_alone(library):
    """The end of an image is on pages of its own; each begins with the next one's."""
    ids = library.add(press_of(1, 3, side=3000))
    library.close()
    path = library.folder / "library.sqlite"
    with closing(sqlite3.connect(path)) as database:
        [[image]] = database.execute("SELECT image FROM images WHERE number = 2")
    content = bytearray(path.read_bytes())
    page = content.index(image[-9000:-8900]) // PAGE * PAGE
    content[page : page + 4] = b"\xff" * 4
    path.write_bytes(content)
    with TouchLibrary.open(library.folder) as opened:
        with pytest.warns(UserWarning, match="^1 touches are left out: their images"):
            assert len(opened.touches(damaged="skip")) == 2
        named = [problem.touches for problem in opened.check().problems]
    assert [ids[1]] in named


def test_an_older_database_put_back_is_reported_until_it_is_accepted(folder):
    """The check reports it also after touches were added since."""
    before = (folder / "library.sqlite").read_bytes()
    with TouchLibrary.open(folder) as library:
        library.add(press_of(1, 3))
        library.rename_object("mug", "cup")
    (folder / "library.sqlite").write_bytes(before)
    for n_added in range(2):
        message = "once held 3 more touches and 1 more changes"
        with pytest.warns(UserWarning, match=message) as warned:
            library = TouchLibrary.open(folder)
        assert warned[0].filename == __file__
        with library:
            if n_added:
                library.add(press_of(2))
        [problem] = check_library(folder).problems
        assert problem.kind == "lost"
        assert "3 more touches and 1 more changes" in problem.what
    repair = TouchLibrary.repair_folder(folder)
    assert (repair.rebuilt, repair.n_touches, repair.set_aside) == (False, 7, None)
    assert check_library(folder).ok
    assert len(rows_of(folder)) == 7


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """Four hundred touches with changes in their past, many pages of each table."""
    place = tmp_path_factory.mktemp("large") / "lab"
    with TouchLibrary.open(place, create=True) as library:
        for seed in range(8):
            library.add(press_of(seed, 50, side=60), session=f"s{seed}")
        library.rename_object("oo", "cup")
        library.add(press_of(1, 20, side=60), session="later")
        library.merge_objects("ooo", "o")
        library.retract(object="oooo", reason="wet")
    return place


def _facts(folder):
    with TouchLibrary.open(folder) as library:
        rows = library.list(limit=None, retracted=True)
        return rows, {row.id: library.image(row.id).tobytes() for row in rows}


INDEX, TABLE = (2, 10), (13,)  # pages of an index, and leaves of a table


@pytest.mark.parametrize(("kinds", "n_pages"), [(INDEX, 99), (TABLE, 1), (TABLE, 4)])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_repair_keeps_all_that_is_whole_and_deletes_nothing(
    large, tmp_path, kinds, n_pages, seed
):
    before, images = _facts(large)
    folder = shutil.copytree(large, tmp_path / "lab")
    path = folder / "library.sqlite"
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(seed)
    # The first byte of a page is its kind; the first page stays whole.
    pages = [p for p in range(1, len(content) // PAGE) if content[p * PAGE] in kinds]
    for page in rng.permutation(pages)[:n_pages]:
        span = slice(page * PAGE + 100, (page + 1) * PAGE - 8)
        content[span] = rng.bytes(span.stop - span.start)
    path.write_bytes(content)
    assert not check_library(folder).ok
    repair = TouchLibrary.repair_folder(folder)
    kept, kept_images = _facts(folder)
    assert kept == [row for row in before if row.id in kept_images]
    assert kept_images.items() <= images.items()
    if kinds == INDEX:
        assert repair.lost == []
    # A row of the table of touches takes more than 200 bytes, that of an image more.
    assert len(repair.lost) <= n_pages * PAGE // 200
    assert len(kept) + len(repair.lost) == len(before)
    named = {key for key in repair.lost if not key.startswith("number ")}
    assert named <= images.keys() - kept_images.keys()
    assert Path(repair.set_aside).read_bytes() == bytes(content)
    assert check_library(folder).ok


def test_a_repair_that_fails_leaves_the_library_as_it_was(folder, alter, monkeypatch):
    alter(folder, "UPDATE touches SET force_n = 9 WHERE number = 2")
    before = (folder / "library.sqlite").read_bytes()
    replace = Path.replace

    def fail(path, target):
        if path.name.startswith(".partial"):
            raise OSError(28, os.strerror(28))
        return replace(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fail)
        with pytest.raises(LibraryError, match="must have room for a new database"):
            TouchLibrary.repair_folder(folder)
    assert (folder / "library.sqlite").read_bytes() == before
    assert not list(folder.glob(".partial-*"))
    assert "Row 2 must be" in str(check_library(folder))
    assert TouchLibrary.repair_folder(folder).n_touches == 5


def test_what_another_adds_after_a_repair_is_not_lost(folder, alter):
    """The touch is refused, or is in the new database, not only in the old one."""
    with TouchLibrary.open(folder) as other:
        assert len(other) == 5
        alter(folder, "UPDATE touches SET force_n = 9 WHERE number = 2")
        ids = []
        with suppress(LibraryError):
            TouchLibrary.repair_folder(folder)
        with suppress(LibraryError):
            ids = other.add(press_of(1))
    with TouchLibrary.open(folder) as library, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the row that was altered
        assert {*ids} <= {row.id for row in library.list(damaged="skip")}


@pytest.mark.parametrize("damage", ["empty", "cut", "text", "scribbled", "lost"])
def test_a_database_of_which_nothing_is_left_is_not_replaced(folder, damage):
    path = folder / "library.sqlite"
    whole = path.read_bytes()
    broken = {
        "empty": b"",
        "cut": whole[:PAGE],
        "text": b"no database" * 99,
        "scribbled": whole[:100] + b"\xaa" * (len(whole) - 100),
    }
    path.write_bytes(broken[damage]) if damage != "lost" else path.unlink()
    assert not check_library(folder).ok
    for act in (
        lambda: TouchLibrary.open(folder).list(),
        lambda: TouchLibrary.repair_folder(folder),
    ):
        with pytest.raises(
            LibraryError,
            match=r"backup|`TouchLibrary\.repair_folder`|no library\.sqlite",
        ):
            act()
    assert not (folder / "damaged").exists()
    if damage != "lost":
        assert path.read_bytes() == broken[damage]
        assert str(check_library(folder)).startswith(
            "0 touches: 1 problem.\ndatabase: "
        )


def test_a_check_is_of_what_there_was_when_it_began(folder, monkeypatch):
    """Another program that adds, renames and retracts meanwhile damages nothing."""
    read, others = _upkeep._next_rows, ["pad", "pot"]

    def read_after_another(store, number):
        if number and others:
            with TouchLibrary.open(folder) as other:
                other.rename_object(other.objects()[0].name, others[-1])
                ids = other.add(press_of(100 + len(others)))
                other.retract(ids, reason=f"wet {others.pop()}")
        return read(store, number)

    monkeypatch.setattr(_upkeep, "_next_rows", read_after_another)
    for n_touches in (6, 7):
        with TouchLibrary.open(folder) as library:
            check = library.check() if len(others) == 2 else check_library(folder)
        assert (
            str(check) == f"{n_touches} touches: all present and as they were written."
        )
    assert not others


def test_a_backup_is_a_library_made_while_others_add(large, tmp_path):
    folder = shutil.copytree(large, tmp_path / "lab")
    copy, stop, added = tmp_path / "a" / "copy", threading.Event(), []

    def stream():
        with TouchLibrary.open(folder) as other:
            while not stop.is_set():
                added.append(other.add(press_of(100 + len(added)))[0])

    with TouchLibrary.open(folder) as library:
        before = [row.id for row in library.list(limit=None, retracted=True)]
        thread = threading.Thread(target=stream)
        thread.start()
        while not added:
            time.sleep(0.001)
        n_copied = library.backup(copy)
        stop.set()
        thread.join()
        assert library.check().ok
        history = library.history()
    assert sorted(p.name for p in copy.iterdir())[:2] == [
        *("library.count", "library.sqlite")
    ]
    assert check_library(copy).ok
    with TouchLibrary.open(copy) as copied:
        ids = [row.id for row in copied.list(limit=None, retracted=True)]
        assert copied.history() == history
    assert len(ids) == n_copied > len(before)
    assert ids == (before + added)[: len(ids)]


def test_a_backup_goes_to_a_new_or_empty_folder(folder, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    (tmp_path / "empty").mkdir()
    with TouchLibrary.open(folder) as library:
        for name, got in (("full", "files in it"), ("full/x", "a file")):
            with pytest.raises(LibraryError, match=f"new or empty folder, got {got}"):
                library.backup(tmp_path / name)
        with pytest.raises(LibraryError):
            library.backup(folder)
        assert library.backup(tmp_path / "empty") == 6
        with pytest.raises(LibraryError, match="files in it"):
            library.backup(tmp_path / "empty")
    assert rows_of(tmp_path / "empty") == rows_of(folder)
