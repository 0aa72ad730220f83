"""Make a damaged library whole as far as its files allow; nothing is deleted."""

import secrets
import time
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, NamedTuple

from .._durable import PARTIAL, flush_folder
from . import _changes as changes
from . import _checking as checking
from ._array_files import read_file
from ._rows import MISSING, SET_ASIDE, write_rows
from ._sheet import Sheet, read_sheet
from ._store import (
    FILE_NAME,
    IMAGES,
    DatabaseDamaged,
    DatabaseUnavailable,
    LibraryError,
    NewerLibrary,
    Store,
    holds_files,
)

DAMAGED = "damaged"
_STALE_S = 86_400.0
_LOGS = ("-wal", "-shm", "-journal")
_NO_SHEET = (LibraryError, ValueError, KeyError, TypeError, AttributeError)


class RepairReport(NamedTuple):
    """What a repair did.

    `rebuilt` tells whether the database was made anew from the files; `n_recovered`
    counts touches that it did not know (any more), `n_set_aside` those retracted
    since their image is gone, `n_restored` those whose image is back; `n_changes`
    counts changes carried out or written anew, `n_left_out` arrays of whole
    recordings (no-contact images) that are gone.
    """

    rebuilt: bool
    n_recovered: int
    n_set_aside: int
    n_restored: int
    n_changes: int = 0
    n_left_out: int = 0


def repair_library(folder: str | Path, *, progress: bool | None = None) -> RepairReport:
    """Make a damaged library whole as far as its files allow; nothing is deleted.

    A database that is damaged or lost is made anew from the image files, which carry
    all labels, and from the recorded changes; the old one is set aside when the new
    one is complete. Changes that a sound database lacks are carried out. Touches
    whose image is missing or altered are retracted with that reason, and come back
    when it does or when they are added again. Nobody else may be writing meanwhile.

    Parameters
    ----------
    folder : path
        The library.
    progress : bool, optional
        As for `check_library`.

    Raises
    ------
    LibraryError
        A newer palpate made the library, there is none, or the disk is full or not
        to be read: then the library is left as it was.
    """
    folder = Path(folder)
    gained = _make_anew(folder) if _is_damaged(folder) else None
    with closing(Store(folder)) as store:
        n_recovered, n_changes = gained or _enter_all(store)
        n_changes += _mend_changes(store)
        lost, found = _lost_and_found(store, progress)
        if lost:
            changes.make_change(store, action="retract", ids=lost, reason=MISSING)
        if found:
            changes.make_change(store, action="restore", ids=found)
        n_left_out = _leave_out_arrays(store)
        _sweep(folder)
    counts = n_recovered, len(lost), len(found), n_changes, n_left_out
    return RepairReport(gained is not None, *counts)


def _is_damaged(folder: Path) -> bool:
    """Tell whether the database is damaged; a failing disk is no damage."""
    try:
        with closing(Store(folder)) as store:
            return bool(checking.database_problems(store))
    except (NewerLibrary, DatabaseUnavailable):
        raise
    except LibraryError as error:
        if not isinstance(error, DatabaseDamaged) and not holds_files(folder):
            raise
        return True


def _make_anew(folder: Path) -> tuple[int, int]:
    """Make the database from the files, and only then set the old one aside."""
    path = folder / FILE_NAME
    partial = folder / f"{PARTIAL}{secrets.token_hex(8)}.sqlite"
    try:
        with closing(Store(folder, create=True, name=partial.name)) as store:
            gained = _enter_all(store)
            store.rows("PRAGMA wal_checkpoint(TRUNCATE)")
        _set_aside(folder, *_with_logs(path))
        partial.replace(path)
        flush_folder(folder)
    except (OSError, DatabaseUnavailable) as error:
        raise LibraryError(
            f"{folder} must have room for a new database, got: {error} The old one is "
            "left as it was; free space and repair again."
        ) from error
    finally:
        for left in _with_logs(partial):
            with suppress(OSError):
                left.unlink()
    return gained


def _with_logs(path: Path) -> list[Path]:
    """Return the files of a database, its logs first: none may meet another one."""
    return [*(path.with_name(f"{path.name}{log}") for log in _LOGS), path]


def _set_aside(folder: Path, *paths: Path) -> None:
    """Move files to a new folder in `damaged/`."""
    there = [path for path in paths if path.exists()]
    if not there:
        return
    away = folder / DAMAGED / f"{int(time.time() * 1e6)}"
    away.mkdir(parents=True)
    for path in there:
        path.replace(away / path.name)


def _enter_all(store: Store) -> tuple[int, int]:
    """Enter unknown files by time; return how many touches and changes were gained."""
    known = changes.known_changes(store)
    before = store.count("SELECT count(*) FROM touches")
    steps: list[tuple[float, str, Path]] = []
    for path in checking.spare_files(store):
        if sheet := _sheet_in(store, path.stem):
            steps.append((sheet.added_s, "touches", path))
    for name, path in changes.change_files(store).items():
        if name not in known:
            with suppress(OSError, ValueError):
                steps.append((changes.read_change(path)["time_s"], "change", path))
    n_changes = 0
    for _, kind, path in sorted(steps):
        if kind == "change":
            change = path.stem, changes.read_change(path)
            if _entered(store, changes.apply_change, *change):
                n_changes += 1
            else:  # it is noted all the same
                with store.writing():
                    changes.enter_change(store, *change)
        elif sheet := _sheet_in(store, path.stem):
            _entered(store, write_rows, sheet, path.stem)
    return store.count("SELECT count(*) FROM touches") - before, n_changes


def _sheet_in(store: Store, name: str) -> Sheet | None:
    """Return the touches in a file, or None where it is not what it should be."""
    try:
        return read_sheet(read_file(store.folder / IMAGES, name))
    except _NO_SHEET:
        return None


def _entered(store: Store, enter: Callable[..., Any], *what: Any) -> bool:
    """Enter touches or a change; return False where it says nothing (any more)."""
    try:
        with store.writing():
            enter(store, *what)
    except (DatabaseUnavailable, DatabaseDamaged):
        raise
    except _NO_SHEET:
        return False
    return True


def _mend_changes(store: Store) -> int:
    """Write damaged files of changes anew; set aside those that say nothing."""
    known, files = changes.known_changes(store), changes.change_files(store)
    bad = [name for name in known if changes.file_fault(store, name, known[name])]
    _set_aside(store.folder, *(files[n] for n in bad if n in files))
    for name in bad:
        changes.write_again(store, name)
    unknown = (path for name, path in files.items() if name not in known)
    _set_aside(store.folder, *unknown)
    return len(bad)


def _lost_and_found(store: Store, progress: bool | None) -> tuple[list[str], list[str]]:
    """Return touches whose image is gone, and those set aside whose image is back."""
    lost: list[str] = []
    found: list[str] = []
    for key, name in checking.image_files(store, "Reading files", progress):
        for problem in checking.image_problem(store, key, name):
            lost += problem.touches
        rows = checking.touches_in(store, key, f"t.retraction IN ({SET_ASIDE})")
        if rows and _sheet_in(store, name) is not None:
            found += [row.key.hex() for row in rows]
    return lost, found


def _leave_out_arrays(store: Store) -> int:
    """Set altered arrays aside and note them, so that the rest is read without them."""
    bad = checking.array_problems(store)
    _set_aside(store.folder, *(store.folder / problem.path for problem in bad))
    known = checking.left_out(store)
    names = [n for problem in bad if (n := Path(problem.path).stem) not in known]
    if names:
        changes.make_change(store, action="leave_out", arrays=names)
    return len(names)


def _sweep(folder: Path) -> None:
    """Remove partial files that no living writer can be writing."""
    for path in folder.rglob(f"{PARTIAL}*"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _STALE_S:
                path.unlink()
