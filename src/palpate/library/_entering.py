"""Touches and changes that files hold and the database lacks, entered into it.

A touch is acknowledged when its file is on the disk, which carries its labels too; its
row is committed, but flushed with the next ones. A power cut may take such rows. So
who adds keeps a mark locked meanwhile, and who finds one that nobody locks enters the
files without a row.
"""

import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from . import _changes as changes
from . import _rows
from ._files import Sheet, left_marks, read_file, read_sheet
from ._store import (
    DatabaseDamaged,
    DatabaseUnavailable,
    LibraryError,
    Store,
    Unreadable,
)

DAMAGED = "damaged"
NO_SHEET = (
    *(LibraryError, ValueError, KeyError, TypeError, AttributeError),
    *(OverflowError, RecursionError),
)


def sheet_in(store: Store, name: str) -> Sheet | None:
    """Return the touches in a file, or None where it is not what it should be."""
    with suppress(*NO_SHEET):
        return read_sheet(read_file(store.images, name))
    return None


def spare_files(store: Store) -> list[Path]:
    """Return files of images that the database does not know (any more, or yet)."""
    known = {row[0].hex() for row in store.rows("SELECT name FROM files")}
    paths = sorted(store.images.glob("*/*.npy"))
    return [path for path in paths if path.stem not in known and path.is_file()]


def enter_lost_rows(store: Store, adopted: bool) -> None:
    """Enter touches whose rows a power cut has taken, before anything is read.

    `adopted` tells whether every whole file has its name again. If something cannot be
    entered now, a warning says so, the marks stay, and the next opening tries again.
    """
    with left_marks(store.images) as marks:
        if not marks:
            return
        try:
            n_unread = enter_files(store)
            reason = "files cannot be read or named" if n_unread or not adopted else ""
            # Rows of a killed program are known, but may not be on the disk yet.
            store.flush_log()
        except (LibraryError, OSError) as error:
            reason = str(error)
        if reason:
            warnings.warn(
                f"{store.folder} may lack touches that were added to it just before "
                f"the machine or a program stopped: {reason}",
                stacklevel=4,
            )
            return
        for mark in marks:
            with suppress(OSError):
                mark.unlink()


def enter_files(store: Store) -> int:
    """Enter touches of unknown files by time; return how many cannot be read."""
    n_unread, sheets = _spare_sheets(store)
    for key in sorted(sheets):
        _enter_sheet(store, key[1], sheets[key], late=True)
    return n_unread


def _spare_sheets(store: Store) -> tuple[int, dict[tuple[float, str], set[bytes]]]:
    """Return how many unknown files cannot be read, and what to skip in the others.

    Each is given, by time and name, with the ids of touches that a later file holds
    too: of two files with one touch, the later one counts, as nobody was told of the
    first one.
    """
    n_unread, ids = 0, {}
    for path in spare_files(store):
        try:
            sheet = read_sheet(read_file(store.images, path.stem))
            ids[sheet.added_s, path.stem] = set(sheet.ids)
        except Unreadable:
            n_unread += 1
        except NO_SHEET:
            continue
    later: set[bytes] = set()
    for key in sorted(ids, reverse=True):
        ids[key], later = ids[key] & later, later | ids[key]
    return n_unread, ids


def enter_all(store: Store, *, anew: bool) -> tuple[int, int]:
    """Enter unknown files and changes by time; return how many touches and changes.

    A change that the database does not know is carried out unless somebody was told
    of a later one, but not of it: then it stays where it is.
    """
    known = changes.known_changes(store)
    found = changes.readable_changes(changes.change_files(store))
    told = changes.told_changes(found | known) - set(known)
    before = store.count("SELECT count(*) FROM touches")
    _, sheets = _spare_sheets(store)
    steps = [(added_s, "touches", name) for added_s, name in sheets]
    steps += ((found[name]["time_s"], "change", name) for name in told)
    n_changes = 0
    for time_s, kind, name in sorted(steps):
        if kind == "change":
            n_changes += _carried_out(store, name, found[name], anew=anew)
        else:
            _enter_sheet(store, name, sheets[time_s, name], late=not anew)
    changes.retract_again(store, before)
    return store.count("SELECT count(*) FROM touches") - before, n_changes


def _enter_sheet(store: Store, name: str, skipped: set[bytes], *, late: bool) -> None:
    """Enter unknown touches of a file, but for those `skipped`.

    With `late`, under the names that their objects have now.
    """
    sheet = sheet_in(store, name)
    if sheet is None:
        return
    if late and "object" in sheet.values:
        names, labels = changes.Names(store), sheet.values["object"]
        now = [names.now(label, sheet.added_s, merged=False) for label in labels]
        sheet = replace(sheet, values={**sheet.values, "object": now})
    known = store.among("SELECT id FROM touches WHERE id IN (?)", sheet.ids)
    skipped = skipped | {row[0] for row in known}
    _entered(store, _rows.write_rows, sheet, name, (), skipped)


def _carried_out(
    store: Store, name: str, content: dict[str, Any], *, anew: bool
) -> bool:
    """Carry out a change: in its place among all others, or as one made now."""
    if anew:
        touches_alone = content["action"] in ("retract", "restore")
        enter = changes.enter_change if touches_alone else changes.apply_change
        return _entered(store, enter, name, content)
    again = {n: v for n, v in content.items() if n not in ("time_s", "digest")}
    try:
        n_changed = changes.make_change(store, **again)
    except (DatabaseUnavailable, DatabaseDamaged):
        raise
    except NO_SHEET:
        return False
    set_aside(store.folder, changes.change_files(store)[name])
    return bool(n_changed)


def _entered(store: Store, enter: Callable[..., Any], *what: Any) -> bool:
    """Enter touches or a change; return False where it says nothing (any more)."""
    try:
        with store.writing():
            enter(store, *what)
    except (DatabaseUnavailable, DatabaseDamaged):
        raise
    except NO_SHEET:
        return False
    return True


def set_aside(folder: Path, *paths: Path) -> None:
    """Move files to a new folder in `damaged/`."""
    away = folder / DAMAGED / f"{int(time.time() * 1e6)}"
    for path in (path for path in paths if path.exists()):
        away.mkdir(parents=True, exist_ok=True)
        path.replace(away / path.name)
