"""Touches and changes that files hold and the database lacks, entered into it.

A touch added by itself is acknowledged when its file is on the disk, which carries its
labels too; its row is committed, but flushed with the next ones. A power cut may take
such rows. Whoever adds so leaves a mark with the start of the machine it was made in,
and whoever finds a mark of another start enters the files without a row.
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
    IMAGES,
    DatabaseDamaged,
    DatabaseUnavailable,
    LibraryError,
    Store,
)

DAMAGED = "damaged"
NO_SHEET = (LibraryError, ValueError, KeyError, TypeError, AttributeError)


def sheet_in(store: Store, name: str) -> Sheet | None:
    """Return the touches in a file, or None where it is not what it should be."""
    with suppress(*NO_SHEET):
        return read_sheet(read_file(store.folder / IMAGES, name))
    return None


def spare_files(store: Store) -> list[Path]:
    """Return files of images that the database does not know (any more, or yet)."""
    known = {row[0].hex() for row in store.rows("SELECT name FROM files")}
    paths = sorted((store.folder / IMAGES).glob("*/*.npy"))
    return [path for path in paths if path.stem not in known]


def take_up(store: Store) -> None:
    """Enter touches whose rows a power cut has taken; their files are named again.

    Where the library cannot be written to, a warning tells so.
    """
    if not (marks := left_marks(store.folder / IMAGES)):
        return
    try:
        enter_all(store, anew=False, with_changes=False)
    except LibraryError as error:
        warnings.warn(
            f"Touches that were added to {store.folder} just before the machine "
            f"stopped are left out until they can be entered: {error}",
            stacklevel=4,
        )
        return
    for mark in marks:
        with suppress(OSError):
            mark.unlink()


def enter_all(
    store: Store, *, anew: bool, with_changes: bool = True
) -> tuple[int, int]:
    """Enter unknown files by time; return how many touches and changes were gained.

    A change that the database does not know is carried out unless somebody was told
    of a later one, but not of it: then it stays where it is.
    """
    known = changes.known_changes(store)
    found = changes.readable_changes(
        changes.change_files(store) if with_changes else {}
    )
    told = changes.told_changes(found | known) - set(known)
    before = store.count("SELECT count(*) FROM touches")
    steps: list[tuple[float, str, str]] = []
    for path in spare_files(store):
        if sheet := sheet_in(store, path.stem):
            steps.append((sheet.added_s, "touches", path.stem))
    steps += ((found[name]["time_s"], "change", name) for name in told)
    n_changes = 0
    for _, kind, name in sorted(steps):
        if kind == "change":
            n_changes += _carried_out(store, name, found[name], anew=anew)
        elif sheet := sheet_in(store, name):
            if not anew and "object" in sheet.values:  # they enter late
                names = changes.Names(store)
                labels = sheet.values["object"]
                now = [names.now(label, sheet.added_s) for label in labels]
                sheet = replace(sheet, values={**sheet.values, "object": now})
            _entered(store, _rows.write_rows, sheet, name)
    changes.retract_again(store, before)
    return store.count("SELECT count(*) FROM touches") - before, n_changes


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
