"""Is everything there, is it as it was written, and what can be made of the rest."""

import json
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .._progress import Progress
from ._adding import ARRAYS, IMAGES, MISSING, SET_ASIDE, enter_sheet
from ._changes import CHANGES, apply_change, make_change, read_change
from ._database import FILE_NAME, Database
from ._errors import LibraryError
from ._files import PARTIAL, file_path, read_file, read_values
from ._sheet import Sheet, image_digest, read_sheet

DAMAGED = "damaged"
_STALE_S = 86_400.0
_SHOWN = 20


class Problem(NamedTuple):
    """Something found by a check.

    Attributes
    ----------
    kind : str
        "database", "image", "array", "file without touches", "partial file" or
        "version".
    path : str
        The file concerned.
    what : str
        What is wrong, in a sentence.
    touches : list of str
        Ids of the touches that cannot be read because of it.
    """

    kind: str
    path: str
    what: str
    touches: list[str]


class CheckReport(NamedTuple):
    """What a check found; `ok` when nothing is wrong with any acknowledged touch."""

    ok: bool
    n_touches: int
    n_files: int
    problems: list[Problem]

    def __str__(self) -> str:
        head = f"{self.n_touches} touches in {self.n_files} files: " + (
            "all present and as they were written."
            if self.ok
            else f"{len(self.problems)} problems."
        )
        lines = [f"{p.kind}: {p.path}: {p.what}" for p in self.problems[:_SHOWN]]
        more = len(self.problems) - _SHOWN
        return "\n".join([head, *lines, *([f"... and {more} more"] * (more > 0))])


class RepairReport(NamedTuple):
    """What a repair did.

    `rebuilt` tells whether the database was made anew from the files; `n_recovered`
    counts touches that it did not know (any more), `n_set_aside` those retracted
    since their image is gone, `n_restored` those whose image is back.
    """

    rebuilt: bool
    n_recovered: int
    n_set_aside: int
    n_restored: int


class _Stored(NamedTuple):
    id: str
    offset: int
    place: int
    digest: bytes
    n_rows: int
    n_cols: int
    dtype: str
    wide: bool


def check_library(folder: str | Path, *, progress: bool | None = None) -> CheckReport:
    """Read everything in a library and compare it with its checksums.

    Nothing is changed; a library too damaged to open is told of as well.

    Parameters
    ----------
    folder : path
        The library.
    progress : bool, optional
        Show a bar on standard error when it takes over two seconds; by default
        where that is a terminal.
    """
    folder = Path(folder)
    try:
        database = Database(folder / FILE_NAME, create=False)
    except LibraryError as error:
        kind = "version" if "this palpate reads up to" in str(error) else "database"
        problem = Problem(kind, FILE_NAME, str(error), [])
        return CheckReport(False, 0, 0, [problem])
    try:
        problems = _database_problems(database)
        n_touches, n_files = _counts(database)
        problems += _image_problems(database, folder, progress)
        problems += _array_problems(database, folder)
        spare = [*_spare_files(database, folder), *_partial_files(folder)]
        return CheckReport(not problems, n_touches, n_files, problems + spare)
    except LibraryError as error:
        problem = Problem("database", FILE_NAME, str(error), [])
        return CheckReport(False, 0, 0, [problem])
    finally:
        database.close()


def repair_library(folder: str | Path, *, progress: bool | None = None) -> RepairReport:
    """Make a damaged library whole as far as its files allow; nothing is deleted.

    A database that is damaged or lost is set aside and made anew from the image
    files, which carry all labels, and from the recorded changes. Touches whose image
    is missing or altered are retracted with that reason, and come back when it does
    or when they are added again. Nobody else may be writing meanwhile.

    Parameters
    ----------
    folder : path
        The library.
    progress : bool, optional
        As for `check_library`.

    Raises
    ------
    LibraryError
        A newer palpate made the library, or there is none.
    """
    folder = Path(folder)
    rebuilt = _set_aside_database(folder)
    database = Database(folder / FILE_NAME, create=rebuilt)
    try:
        n_recovered = _enter_all(database, folder, replay=rebuilt)
        lost, found = _lost_and_found(database, folder, progress)
        if lost:
            make_change(
                database, folder, {"action": "retract", "ids": lost, "reason": MISSING}
            )
        if found:
            make_change(database, folder, {"action": "restore", "ids": found})
        _sweep(folder)
        return RepairReport(rebuilt, n_recovered, len(lost), len(found))
    finally:
        database.close()


def _database_problems(database: Database) -> list[Problem]:
    found = [row[0] for row in database.rows("PRAGMA quick_check(5)")]
    wrong = [] if found == ["ok"] else found
    return [
        Problem("database", FILE_NAME, f"SQLite says: {text}", []) for text in wrong
    ]


def _counts(database: Database) -> tuple[int, int]:
    row = database.one("SELECT count(*), count(DISTINCT file) FROM touches")
    return (0, 0) if row is None else (int(row[0]), int(row[1]))


def _image_problems(
    database: Database, folder: Path, progress: bool | None
) -> list[Problem]:
    files = database.rows("SELECT id, name FROM files ORDER BY id")
    problems = []
    with Progress(len(files), "Checking files", progress) as bar:
        for key, name in files:
            problem = _image_problem(database, folder, key, name.hex())
            problems += [] if problem is None else [problem]
            bar.advance(1)
    return problems


def _image_problem(
    database: Database, folder: Path, key: int, name: str
) -> Problem | None:
    kept = "retraction IS NULL"
    rows = _touches_in(database, key, kept)
    if not rows:
        return None
    try:
        read_file(folder / IMAGES, name)
    except LibraryError as error:
        path = file_path(folder / IMAGES, name)
        short = path.relative_to(folder).as_posix()
        lost = _unreadable(path, rows)
        what = f"{str(error).replace(f'{path} ', 'It ')} {len(lost)} touches are lost."
        return Problem("image", short, what, lost)
    return None


def _touches_in(database: Database, file: int, state: str) -> list[_Stored]:
    """Return what a file should hold: touches in this state."""
    rows = database.rows(
        "SELECT lower(hex(t.id)), f.offset, t.place, t.image, r.n_rows, r.n_cols, "
        "r.dtype, l.columns FROM touches t JOIN recordings r ON r.id = t.recording "
        "JOIN layouts l ON l.id = t.layout JOIN files f ON f.id = t.file "
        f"WHERE t.file = ? AND {state}",
        [file],
    )
    return [
        _Stored._make((*row[:-1], any(column[3] for column in json.loads(row[-1]))))
        for row in rows
    ]


def _unreadable(path: Path, rows: list[_Stored]) -> list[str]:
    """Return the touches whose image is gone from a damaged file.

    Wide columns have no checksum of their own: touches with such are lost as well.
    """
    lost = []
    for row in rows:
        dtype = np.dtype(row.dtype)
        shape = (row.n_rows, row.n_cols)
        start = row.offset + row.place * row.n_rows * row.n_cols * dtype.itemsize
        try:
            image = read_values(path, start, shape, dtype)
            whole = image_digest(image) == row.digest and not row.wide
        except LibraryError:
            whole = False
        lost += [] if whole else [row.id]
    return lost


def _array_problems(database: Database, folder: Path) -> list[Problem]:
    problems = []
    names = {
        name
        for (whole,) in database.rows("SELECT whole FROM recordings")
        for name in json.loads(whole).values()
    }
    for name in sorted(names):
        try:
            read_file(folder / ARRAYS, name)
        except LibraryError as error:
            path = file_path(folder / ARRAYS, name)
            short = path.relative_to(folder).as_posix()
            problems.append(Problem("array", short, str(error), []))
    return problems


def _spare_files(database: Database, folder: Path) -> Iterator[Problem]:
    """Name files that a killed writer left before it acknowledged them."""
    known = {row[0].hex() for row in database.rows("SELECT name FROM files")}
    for path in sorted((folder / IMAGES).glob("*/*.npy")):
        if path.stem not in known:
            what = "No touch is found in it; harmless. --repair takes its touches in."
            short = path.relative_to(folder).as_posix()
            yield Problem("file without touches", short, what, [])


def _partial_files(folder: Path) -> Iterator[Problem]:
    for path in sorted(folder.rglob(f"{PARTIAL}*")):
        short = path.relative_to(folder).as_posix()
        what = "A writer was killed, or is writing it now; harmless."
        yield Problem("partial file", short, what, [])


def _set_aside_database(folder: Path) -> bool:
    """Move a damaged database away; return whether it was one."""
    path = folder / FILE_NAME
    try:
        database = Database(path, create=False)
    except LibraryError as error:
        if "this palpate reads up to" in str(error):
            raise
    else:
        try:
            if not _database_problems(database):
                return False
        except LibraryError:
            pass
        finally:
            database.close()
    if not path.exists() and not any((folder / IMAGES).glob("*/*.npy")):
        raise LibraryError(
            f"{folder} must be a library of touches, got no sign of one."
        )
    away = folder / DAMAGED / f"{int(time.time() * 1e6)}"
    away.mkdir(parents=True)
    for name in (FILE_NAME, f"{FILE_NAME}-wal", f"{FILE_NAME}-shm"):
        if (folder / name).exists():
            (folder / name).replace(away / name)
    return True


def _enter_all(database: Database, folder: Path, *, replay: bool) -> int:
    """Enter all files that the database does not know; return the touches gained.

    With `replay`, changes are carried out between them, in the order of time.
    """
    known = {row[0].hex() for row in database.rows("SELECT name FROM files")}
    before = _counts(database)[0]
    steps: list[tuple[float, str, Path]] = []
    for path in sorted((folder / IMAGES).glob("*/*.npy")):
        if path.stem not in known and (sheet := _sheet_in(folder, path)) is not None:
            steps.append((sheet.added_s, "touches", path))
    if replay:
        for path in sorted((folder / CHANGES).glob("*.json")):
            with suppress(OSError, ValueError, KeyError):
                steps.append((float(read_change(path)["time_s"]), "change", path))
    for _, kind, path in sorted(steps):
        with (
            suppress(LibraryError, ValueError, KeyError, TypeError),
            database.writing(),
        ):
            if kind == "change":
                apply_change(database, path.stem, read_change(path))
            elif (sheet := _sheet_in(folder, path)) is not None:
                enter_sheet(database, sheet, path.stem)
    return _counts(database)[0] - before


def _sheet_in(folder: Path, path: Path) -> Sheet | None:
    """Return the touches in a file, or None where it is not what it should be."""
    try:
        return read_sheet(read_file(folder / IMAGES, path.stem))
    except (LibraryError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _lost_and_found(
    database: Database, folder: Path, progress: bool | None
) -> tuple[list[str], list[str]]:
    """Return touches whose image is gone, and those set aside whose image is back."""
    lost: list[str] = []
    found: list[str] = []
    files = database.rows("SELECT id, name FROM files ORDER BY id")
    aside = f"t.retraction IN ({SET_ASIDE})"
    with Progress(len(files), "Reading files", progress) as bar:
        for key, name in files:
            path = file_path(folder / IMAGES, name.hex())
            bad = _image_problem(database, folder, key, name.hex())
            lost += [] if bad is None else bad.touches
            rows = _touches_in(database, key, aside)
            if rows and _sheet_in(folder, path) is not None:
                found += [row.id for row in rows]
            bar.advance(1)
    return lost, found


def _sweep(folder: Path) -> None:
    """Remove partial files that no living writer can be writing."""
    for path in folder.rglob(f"{PARTIAL}*"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _STALE_S:
                path.unlink()
