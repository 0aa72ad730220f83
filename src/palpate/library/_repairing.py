"""A new database of what is whole of a damaged library; copies of a whole one."""

import os
import secrets
import shutil
import tempfile
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from .._durable import PARTIAL, flush_all, flush_folder
from .._parallel import Progress
from .._types import Array
from ._changes import Change, change_rows, enter_change
from ._checking import LEFT_OUT, check_store, next_rows, touch_fault
from ._reading import stored_array
from ._rows import Batch, StoredTouch, Tables, stored_images, write_rows
from ._store import (
    DAMAGED,
    FILE_NAME,
    PAGE_BYTES,
    DatabaseDamaged,
    DatabaseUnavailable,
    LibraryError,
    Store,
    refuse_used,
    room_for,
)

_LOGS = ("-wal", "-shm")
_N_PAGES = slice(28, 32)  # of a header, by the format of SQLite's files


class RepairReport(NamedTuple):
    """The result of a repair.

    `rebuilt` tells whether a new database was made, of the `n_touches` and `n_changes`
    that were whole; `lost` names touches that were not, and `n_changes_lost` counts
    changes. The damaged database is kept as `set_aside`.
    """

    rebuilt: bool
    n_touches: int
    n_changes: int
    lost: list[str]
    n_changes_lost: int
    set_aside: str | None


def repair_library(folder: str | Path, *, progress: bool | None = None) -> RepairReport:
    """Make a new database of what is whole in a damaged one; nothing is deleted.

    Touches keep their ids and their order. The damaged database goes to `damaged/` in
    the library when the new one is complete. Touches that are lost can be added again.
    Nobody else may be writing meanwhile.

    Parameters
    ----------
    folder : path
        The library.
    progress : bool, optional
        As for `check_library`.

    Raises
    ------
    LibraryError
        There is no library, another palpate made it, nothing of it can be read, or the
        disk is full or not to be read: then the library is left as it was.
    """
    folder = Path(folder)
    with _opened(folder) as old:
        report = check_store(old, progress)
        # That there were more touches once is all: what is there is accepted.
        kinds = {problem.kind for problem in report.problems} - {LEFT_OUT}
        fewer = kinds == {"lost"} and any(old.n_lost())
        if old.path.name != FILE_NAME or not (report.ok or fewer):
            return _rebuild(folder, old, progress)
        old.accept()
        tally = old.tally()
        return RepairReport(False, tally.n_touches, tally.n_changes, [], 0, None)


@contextmanager
def _opened(folder: Path) -> Iterator[Store]:
    """Open a damaged library; one whose first page is damaged with that of another.

    All libraries have one schema, which stands there, and the numbers of the pages
    where tables begin.
    """
    with ExitStack() as stack:
        try:
            old = Store(folder, alone=True)
            stack.callback(old.close)
            old.rows("SELECT number, n_touches FROM touches, tally LIMIT 0")
        except DatabaseDamaged as damaged:
            stack.close()
            copy = _with_new_first_page(folder)
            if copy is None:
                raise
            stack.callback(_unlink, copy)
            try:
                old = Store(folder, name=copy.name)
            except LibraryError:
                raise damaged from None
            stack.callback(old.close)
        yield old


def _with_new_first_page(folder: Path) -> Path | None:
    """Return a copy of a database with a new first page, if that may help."""
    path = folder / FILE_NAME
    content = path.read_bytes()
    log = path.with_name(f"{path.name}-wal")
    if len(content) <= PAGE_BYTES or (log.exists() and log.stat().st_size):
        return None
    with tempfile.TemporaryDirectory() as scratch:
        Store(Path(scratch), create=True).close()
        page = bytearray((Path(scratch) / FILE_NAME).read_bytes()[:PAGE_BYTES])
    page[_N_PAGES] = (len(content) // PAGE_BYTES).to_bytes(4, "big")
    copy = folder / f"{PARTIAL}{secrets.token_hex(8)}.sqlite"
    try:
        with room_for("a copy", folder, "Free space and repair again."):
            copy.write_bytes(page + content[PAGE_BYTES:])
    except BaseException:
        _unlink(copy)
        raise
    return copy


def _unlink(path: Path) -> None:
    for log in ("", *_LOGS):
        with suppress(OSError):
            path.with_name(f"{path.name}{log}").unlink()


def _rebuild(folder: Path, old: Store, progress: bool | None) -> RepairReport:
    """Make a new database, and only then set the old one aside."""
    rebuilt = folder / f"{PARTIAL}{secrets.token_hex(8)}.sqlite"
    away = folder / DAMAGED / f"{int(time.time() * 1e6)}"
    lost: list[str] = []
    try:
        with closing(Store(folder, create=True, name=rebuilt.name)) as new:
            changes, n_lost = _readable_changes(old)
            with Progress(_n_known(old), "Keeping touches", progress) as bar:
                n_lost += enter_all(new, _readable_touches(old, lost, bar), changes)
            tally = new.tally()
            new.rows("PRAGMA wal_checkpoint(TRUNCATE)")
        old.close()
        _exchange(folder / FILE_NAME, rebuilt, away)
    except OSError as error:
        raise LibraryError(
            f"{folder} must have room for a new database, got: {error}. Free space and "
            "repair again."
        ) from error
    finally:
        _unlink(rebuilt)
    with closing(Store(folder)) as new:
        new.accept()
    counts = tally.n_touches, tally.n_changes
    return RepairReport(True, *counts, lost, n_lost, str(away / FILE_NAME))


def _exchange(path: Path, rebuilt: Path, away: Path) -> None:
    """Put the database `rebuilt` in the place of another, which is kept in `away`.

    At every moment there is one of both in the place. A log is taken from there first:
    of another database it would be taken for its own.
    """
    away.mkdir(parents=True)
    with suppress(OSError):  # a file system without them
        shutil.copymode(path, rebuilt)
    try:
        os.link(path, away / path.name)
    except OSError:  # no links on this file system
        shutil.copyfile(path, away / path.name)
    logs = [path.with_name(f"{path.name}{log}") for log in _LOGS]
    moved = [log for log in logs if log.exists()]
    for log in moved:
        log.replace(away / log.name)
    try:
        rebuilt.replace(path)
    except OSError:
        for log in moved:
            (away / log.name).replace(log)
        raise
    flush_folder(path.parent)


def _n_known(old: Store, table: str = "touches", key: str = "number") -> int:
    """Return the largest key of a table, by the count of it where that is damaged."""
    with suppress(DatabaseDamaged):
        return old.count(f"SELECT max({key}) FROM {table}")
    return int(getattr(old.tally(), f"n_{table}"))


def enter_all(
    store: Store,
    touches: Iterator[tuple[Sequence[int], Batch]],
    changes: Iterable[Change],
) -> int:
    """Enter touches under their numbers, and each change when it was made.

    Returns how many changes could not be carried out, since what they concern is not
    there.
    """
    waiting = deque(changes)
    n_lost = 0
    for numbers, rest in touches:
        while waiting and waiting[0].after < numbers[-1]:
            place = bisect_left(numbers, waiting[0].after + 1)
            if place:
                part = rest.picked(range(place))
                store.write(partial(write_rows, store, part, numbers[:place]))
                numbers = numbers[place:]
                rest = rest.picked(range(place, place + len(numbers)))
            n_lost += not carried_out(store, waiting.popleft())
        store.write(partial(write_rows, store, rest, numbers))
    return n_lost + sum(not carried_out(store, change) for change in waiting)


def carried_out(store: Store, change: Change) -> bool:
    """Enter a change; return False where what it concerns is not there."""
    try:
        return bool(store.write(partial(enter_change, store, change)))
    except (DatabaseDamaged, DatabaseUnavailable):
        raise
    except (LibraryError, KeyError):
        return False


def _readable_changes(old: Store) -> tuple[list[Change], int]:
    """Return the changes that are as they were made, and how many are not."""
    changes, n_lost = [], 0
    for key in range(1, _n_known(old, "changes", "id") + 1):
        rows = []
        with suppress(DatabaseDamaged):
            rows = change_rows(old, "WHERE id = ?", [key])
        change = rows[0][2] if rows else None
        if change is None:
            n_lost += 1
            changes += _retracted_by(old, key)
        else:
            changes.append(change)
    return changes, n_lost


def _retracted_by(old: Store, key: int) -> list[Change]:
    """Return a retraction of what a damaged change left out, for it stays left out."""
    with suppress(DatabaseDamaged):
        sql = "SELECT lower(hex(id)) FROM touches WHERE retraction = ?"
        if ids := [row[0] for row in old.rows(sql, [key])]:
            content = {"ids": ids, "reason": "left out by a change that was damaged"}
            return [Change(time.time(), "retract", content, _n_known(old))]
    return []


def _readable_touches(
    old: Store, lost: list[str], bar: Progress
) -> Iterator[tuple[list[int], Batch]]:
    """Yield touches that are whole, alike ones together; `lost` gets the others."""
    tables = Tables(old)
    for rows in _readable_rows(old, lost):
        whole = []
        for row in rows:
            with suppress(LibraryError):
                if touch_fault(tables, row, None) is None:
                    whole.append(row)
                    continue
            lost.append(row.shown)
        for _, alike in groupby(whole, lambda r: (r.layout, r.recording, r.added_s)):
            together = list(alike)
            yield [row.number for row in together], _batch_again(tables, together)
        bar.advance(len(rows))


def _readable_rows(old: Store, lost: list[str]) -> Iterator[list[StoredTouch]]:
    """Yield rows in their order; where many together cannot be read, each by itself."""
    number, last = 0, _n_known(old)
    while True:
        try:
            rows = next_rows(old, number, named=False)
        except DatabaseDamaged:
            if number >= last:
                return
            rows = []
            with suppress(DatabaseDamaged):
                rows = next_rows(old, number, 1, named=False)
            number += 1
            if not rows or rows[0].number != number:
                lost.append(f"number {number}")
                continue
        if not rows:
            return
        number = rows[-1].number
        yield rows


def _batch_again(tables: Tables, rows: list[StoredTouch]) -> Batch:
    """Return touches of one layout and recording as they were when they were added."""
    recording = tables.recording(rows[0].recording)
    arrays = {bytes.fromhex(d): _array(tables, d) for d in recording.whole.values()}
    images = [stored.image for stored in stored_images(tables, rows)]
    whole = [image for image in images if image is not None]
    return Batch(tables.layout(rows[0].layout), recording, arrays, rows, whole)


def _array(tables: Tables, digest: str) -> Array | None:
    try:
        return stored_array(tables, digest)
    except LibraryError:
        return None


def backup_library(store: Store, folder: Path, *, progress: bool | None = None) -> int:
    """Copy a library to a new folder while it is used; return how many touches."""
    refuse_used(folder)
    is_new = not folder.exists()
    copy = folder / f"{PARTIAL}{secrets.token_hex(8)}"
    n_pages = store.count("PRAGMA page_count")
    try:
        with (
            room_for("a copy", folder, "Free space, or give another folder."),
            Progress(n_pages, "Copying", progress) as bar,
        ):
            folder.mkdir(parents=True, exist_ok=True)
            copy.touch()  # SQLite leaves leave for a group out
            store.backup(copy, lambda left, total: bar.reach(total - left))
            flush_all(copy)
            copy.replace(folder / FILE_NAME)
            flush_folder(folder)
            flush_folder(folder.absolute().parent)
    finally:
        with suppress(OSError):
            copy.unlink()
        if is_new:
            with suppress(OSError):  # not where the copy is whole
                folder.rmdir()
    with closing(Store(folder)) as done:
        done.accept()
        return done.tally().n_touches
