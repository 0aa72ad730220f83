"""Whether everything in a library is as it was written; repairs, and copies of it.

A repair makes a new database of what is whole in a damaged one.
"""

import os
import secrets
import shutil
import tempfile
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from .._durable import PARTIAL, flush_all, flush_folder
from .._parallel import Progress
from .._types import Array
from ._changes import Change, Names, change_rows, enter_change
from ._content import id_bytes, identity, wide_identities
from ._reading import stored_array, whole_image
from ._rows import (
    LOST,
    Batch,
    StoredTouch,
    Tables,
    plain_values,
    stored_images,
    stored_touches,
    write_rows,
)
from ._store import (
    AT_ONCE,
    DAMAGED,
    FILE_NAME,
    PAGE_BYTES,
    DatabaseDamaged,
    DatabaseUnavailable,
    LibraryError,
    OtherVersion,
    Store,
    chained,
    refuse_used,
    room_for,
)

_PROBLEMS_LISTED = 20  # ids of a problem that are listed
_OLD_LOSS = "left out"
_LEFT_OUT = "SELECT 1 FROM arrays WHERE digest = ? AND content = ?"
_LOGS = ("-wal", "-shm")
_N_PAGES = slice(28, 32)  # of a header, by the format of SQLite's files


class Problem(NamedTuple):
    """Something found by a check: its kind, a sentence, and the touches concerned.

    `kind` is "database", "disk", "version", "touch", "change", "array", "missing"
    (numbers or order are not those that were counted), "lost" (there were more once) or
    "left out": an array that an earlier repair did not find whole. Touches of "array"
    and "left out" are read without it, those of "touch" are not. `touches` are ids.
    """

    kind: str
    what: str
    touches: list[str]


class CheckReport(NamedTuple):
    """The result of a check; `ok` when nothing is wrong that a repair has not seen."""

    ok: bool
    n_touches: int
    problems: list[Problem]

    def __str__(self) -> str:
        n_problems = f"{len(self.problems)} problem{'s' * (len(self.problems) > 1)}."
        state = "all present and as they were written." if self.ok else n_problems
        n_touches = f"{self.n_touches} touch{'es' * (self.n_touches != 1)}"
        lines = [f"{n_touches}: {state}"]
        lines += [f"{p.kind}: {p.what}" for p in self.problems[:_PROBLEMS_LISTED]]
        if len(self.problems) > _PROBLEMS_LISTED:
            lines.append(f"... and {len(self.problems) - _PROBLEMS_LISTED} more")
        return "\n".join(lines)


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


def check_library(folder: str | Path, *, progress: bool | None = None) -> CheckReport:
    """Read everything in a library and compare it with its digests.

    Nothing is changed. Of a library that is too damaged to open, or that another
    palpate made, the LibraryError is a problem of the report.

    Parameters
    ----------
    folder : path
        The library.
    progress : bool, optional
        Show a bar on standard error when it takes over two seconds; by default
        where that is a terminal.
    """
    try:
        with closing(Store(Path(folder))) as store:
            return check_store(store, progress)
    except LibraryError as error:
        kinds = {OtherVersion: "version", DatabaseUnavailable: "disk"}
        kind = next((k for t, k in kinds.items() if isinstance(error, t)), "database")
        return CheckReport(False, 0, [Problem(kind, str(error), [])])


def repair_library(folder: Path, progress: bool | None) -> RepairReport:
    """Repair a library that is closed; see `TouchLibrary.repair_folder`."""
    with _opened(folder) as old:
        report = check_store(old, progress)
        # That there were more touches once is all: what is there is accepted.
        kinds = {problem.kind for problem in report.problems} - {_OLD_LOSS}
        fewer = kinds == {"lost"} and any(old.n_lost())
        if old.path.name != FILE_NAME or not (report.ok or fewer):
            return _rebuild(folder, old, progress)
        old.accept()
        tally = old.tally()
        return RepairReport(False, tally.n_touches, tally.n_changes, [], 0, None)


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


def check_store(store: Store, progress: bool | None) -> CheckReport:
    """Check a library that is open; see `check_library`."""
    problems: list[Problem] = []
    tables = Tables(store)
    n_touches = 0

    def gather(*parts: Callable[[Tables, bool | None], Iterator[Problem]]) -> None:
        for part in parts:
            try:
                problems.extend(part(tables, progress))
            except DatabaseDamaged as error:
                problems.append(Problem("database", str(error), []))

    with store.moment():
        gather(_database_problems, _touch_problems, _array_problems, _change_problems)
        try:
            n_touches = store.count("SELECT count(*) FROM touches")
        except LibraryError as error:
            problems.append(Problem("database", str(error), []))
    gather(_lost)  # of now, as the counts beside the database are
    ok = all(problem.kind == _OLD_LOSS for problem in problems)
    return CheckReport(ok, n_touches, problems)


def _database_problems(tables: Tables, progress: bool | None) -> Iterator[Problem]:
    """Tell what SQLite itself finds."""
    rows = tables.store.rows("PRAGMA integrity_check(20)")
    for text in (text for (text,) in rows if text != "ok"):
        yield Problem("database", f"SQLite says: {text}.", [])
    odd = tables.store.rows("PRAGMA foreign_key_check")[:_PROBLEMS_LISTED]
    for table, key, parent, _ in odd:
        what = f"Row {key} of {table} refers to no row of {parent}."
        yield Problem("database", what, [])


def _touch_problems(tables: Tables, progress: bool | None) -> Iterator[Problem]:
    """Name touches that are not as they were written, and places where some lack."""
    store = tables.store
    tally = store.tally()
    names = tables.names()
    chain, n_read, number = b"", 0, 0
    with Progress(tally.n_touches, "Checking touches", progress) as bar:
        while rows := _next_rows(store, number):
            number = rows[-1].number
            for row in rows:
                n_read += 1
                if what := _touch_fault(tables, row, names):
                    yield Problem("touch", what, [row.shown])
                if isinstance(row.digest, bytes):
                    chain = chained(chain, [row.digest])
            bar.advance(len(rows))
    if n_read != tally.n_touches or chain != tally.touches:
        yield Problem(
            "missing",
            f"{tally.n_touches} touches must be there in the order added, got {n_read} "
            "or others.",
            [],
        )


def _next_rows(
    store: Store, number: int, most: int = AT_ONCE, *, named: bool = True
) -> list[StoredTouch]:
    """Return the rows after this number, at most so many."""
    tail = "WHERE t.number > ? ORDER BY t.number LIMIT ?"
    return stored_touches(store, tail, [number, most], named=named)


def _touch_fault(tables: Tables, row: StoredTouch, names: Names | None) -> str | None:
    """Return what is wrong with a touch, or None; `names` are as for `is_sound`."""
    if not isinstance(row.key, bytes) or not tables.is_sound(row, names):
        return f"Row {row.number} must be as it was written, got other values."
    image = whole_image(tables, row)
    if image is None:
        return f"The image of touch {row.key.hex()} must be as it was added."
    [values] = plain_values([row])
    [wide] = wide_identities(tables.layout(row.layout), [image.more])
    if row.key != identity(row.image, {**values, "object": row.label}, wide):
        return f"The id of touch {row.key.hex()} must follow from what it holds."
    return None


def _array_problems(tables: Tables, progress: bool | None) -> Iterator[Problem]:
    users: dict[str, list[tuple[int, str]]] = {}
    store = tables.store
    for (key,) in store.rows("SELECT id FROM recordings ORDER BY id"):
        for entry, digest in tables.recording(key).whole.items():
            users.setdefault(digest, []).append((key, entry))
    for digest, entries in sorted(users.items()):
        try:
            stored_array(tables, digest)
        except LibraryError as error:
            left_out = store.first_row(_LEFT_OUT, [bytes.fromhex(digest), LOST])
            sql = (
                "SELECT lower(hex(id)) FROM touches WHERE recording IN (?) "
                "ORDER BY number"
            )
            rows = store.among(sql, [key for key, _ in entries])
            what = (
                f"{error} {len(rows)} touches are read without their {entries[0][1]}."
            )
            kind = _OLD_LOSS if left_out else "array"
            yield Problem(kind, what, [row[0] for row in rows])


def _change_problems(tables: Tables, progress: bool | None) -> Iterator[Problem]:
    """Compare changes, and what touches and objects are with what changes say."""
    store = tables.store
    tally = store.tally()
    rows = change_rows(store)
    chain = b""
    retracted: dict[str, int] = {}
    numbers = dict(store.rows("SELECT lower(hex(id)), number FROM touches"))
    for key, digest, change in rows:
        if change is None:
            yield Problem("change", f"Change {key} must be as it was made.", [])
            continue
        chain = chained(chain, [digest])
        ids = [id_bytes(touch).hex() for touch in change.content.get("ids", ())]
        for touch in ids:
            # One that a repair lost may have been added again since.
            if not 0 < numbers.get(touch, 0) <= change.after:
                continue
            if change.action == "retract":
                retracted.setdefault(touch, key)
            elif change.action == "restore":
                retracted.pop(touch, None)
    if len(rows) != tally.n_changes or chain != tally.changes:
        what = f"{tally.n_changes} changes must be there, got {len(rows)} or others."
        yield Problem("missing", what, [])
    sql = "SELECT lower(hex(id)), retraction FROM touches WHERE retraction IS NOT NULL"
    recorded = dict(store.rows(sql))
    if odd := sorted(key for key, _ in recorded.items() ^ retracted.items()):
        what = "Touches must be retracted as the changes say, got others."
        yield Problem("change", what, list(dict.fromkeys(odd)))


def _lost(tables: Tables, progress: bool | None) -> Iterator[Problem]:
    if lost := tables.store.lost():
        yield Problem("lost", lost, [])


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
            n_lost += not _carried_out(store, waiting.popleft())
        store.write(partial(write_rows, store, rest, numbers))
    return n_lost + sum(not _carried_out(store, change) for change in waiting)


def _carried_out(store: Store, change: Change) -> bool:
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
                if _touch_fault(tables, row, None) is None:
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
            rows = _next_rows(old, number, named=False)
        except DatabaseDamaged:
            if number >= last:
                return
            rows = []
            with suppress(DatabaseDamaged):
                rows = _next_rows(old, number, 1, named=False)
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
