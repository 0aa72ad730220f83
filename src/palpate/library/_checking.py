"""Is everything there, is it as it was written, and what can be made of the rest."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .._progress import Progress
from ._adding import SET_ASIDE
from ._changes import change_files, file_fault, known_changes, read_change
from ._database import FILE_NAME, Database
from ._errors import DatabaseUnavailable, LibraryError, NewerLibrary
from ._files import ARRAYS, CHANGES, IMAGES, PARTIAL, file_path, read_file, read_values
from ._sheet import image_digest

_SHOWN = 20
_KEPT = "retraction IS NULL"
_RETRACTED = f"retraction IS NOT NULL AND retraction NOT IN ({SET_ASIDE})"


class Problem(NamedTuple):
    """Something found by a check.

    Attributes
    ----------
    kind : str
        "database", "disk", "version", "image", "array", "change", "file without
        touches" or "partial file".
    path : str
        The file concerned.
    what : str
        What is wrong, in a sentence.
    touches : list of str
        Ids of the touches that it concerns: their image cannot be read or, of an
        array, they are read without it.
    """

    kind: str
    path: str
    what: str
    touches: list[str]


class CheckReport(NamedTuple):
    """What a check found; `ok` when nothing is wrong with any acknowledged touch.

    `n_set_aside` touches, which an earlier repair found no image of, are not among
    the `n_touches`.
    """

    ok: bool
    n_touches: int
    n_files: int
    problems: list[Problem]
    n_set_aside: int = 0

    def __str__(self) -> str:
        lines = [
            f"{self.n_touches} touches in {self.n_files} files: "
            + (
                "all present and as they were written."
                if self.ok
                else f"{len(self.problems)} problems."
            )
        ]
        if self.n_set_aside:
            lines.append(
                f"{self.n_set_aside} touches are set aside: their images were missing "
                "or altered. They come back when their files do and the library is "
                "repaired, or when they are added again."
            )
        lines += [f"{p.kind}: {p.path}: {p.what}" for p in self.problems[:_SHOWN]]
        more = len(self.problems) - _SHOWN
        return "\n".join([*lines, *([f"... and {more} more"] * (more > 0))])


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
        return _not_read(error)
    try:
        problems = database_problems(database)
        lost, remarks = _image_problems(database, folder, progress)
        problems += lost
        arrays = array_problems(database, folder)
        known = left_out(database)
        problems += [p for p in arrays if Path(p.path).stem not in known]
        problems += change_problems(database, folder)
        remarks += [p for p in arrays if Path(p.path).stem in known]
        remarks += [*_spare_files(database, folder), *_partial_files(folder)]
        counts = _counts(database)
        return CheckReport(not problems, *counts[:2], problems + remarks, counts[2])
    except LibraryError as error:
        return _not_read(error)
    finally:
        database.close()


def _not_read(error: LibraryError) -> CheckReport:
    kind = "database"
    if isinstance(error, NewerLibrary | DatabaseUnavailable):
        kind = "version" if isinstance(error, NewerLibrary) else "disk"
    return CheckReport(False, 0, 0, [Problem(kind, FILE_NAME, str(error), [])])


def database_problems(database: Database) -> list[Problem]:
    """Return what SQLite finds wrong with the database."""
    found = [row[0] for row in database.rows("PRAGMA quick_check(5)")]
    wrong = [] if found == ["ok"] else found
    return [
        Problem("database", FILE_NAME, f"SQLite says: {text}", []) for text in wrong
    ]


def _counts(database: Database) -> tuple[int, int, int]:
    """Return the touches that should be there, their files, and those set aside."""
    aside = f"coalesce(retraction IN ({SET_ASIDE}), 0)"
    row = database.one(
        f"SELECT count(*) - sum({aside}), count(DISTINCT iif({aside}, NULL, file)), "
        f"sum({aside}) FROM touches"
    )
    n_touches, n_files, n_aside = (int(cell or 0) for cell in row or (0, 0, 0))
    return n_touches, n_files, n_aside


def _image_problems(
    database: Database, folder: Path, progress: bool | None
) -> tuple[list[Problem], list[Problem]]:
    """Return what is wrong with images of touches, and of retracted ones."""
    files = database.rows("SELECT id, name FROM files ORDER BY id")
    problems: list[Problem | None] = []
    remarks: list[Problem | None] = []
    with Progress(len(files), "Checking files", progress) as bar:
        for key, name in files:
            file = (database, folder, key, name.hex())
            problems.append(image_problem(*file))
            remarks.append(image_problem(*file, _RETRACTED))
            bar.advance(1)
    return [p for p in problems if p is not None], [p for p in remarks if p is not None]


def image_problem(
    database: Database, folder: Path, key: int, name: str, state: str = _KEPT
) -> Problem | None:
    """Return what is wrong with a file of images that touches stand in."""
    rows = touches_in(database, key, state)
    if not rows:
        return None
    try:
        read_file(folder / IMAGES, name)
    except LibraryError as error:
        path = file_path(folder / IMAGES, name)
        short = path.relative_to(folder).as_posix()
        lost = _unreadable(path, rows)
        if state != _KEPT and not lost:
            return None
        end = "are lost." if state == _KEPT else "that are retracted cannot come back."
        what = f"{str(error).replace(f'{path} ', 'It ')} {len(lost)} touches {end}"
        return Problem("image", short, what, lost)
    return None


def touches_in(database: Database, file: int, state: str) -> list[_Stored]:
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


def array_problems(database: Database, folder: Path) -> list[Problem]:
    """Return what is wrong with arrays of whole recordings."""
    users: dict[str, dict[int, str]] = {}
    for key, whole in database.rows("SELECT id, whole FROM recordings ORDER BY id"):
        for entry, name in json.loads(whole).items():
            users.setdefault(name, {})[key] = entry
    problems = []
    for name, keys in sorted(users.items()):
        try:
            read_file(folder / ARRAYS, name)
        except LibraryError as error:
            path = file_path(folder / ARRAYS, name)
            short = path.relative_to(folder).as_posix()
            touches = _touches_of(database, list(keys))
            what = (
                f"{str(error).replace(f'{path} ', 'It ')} {len(touches)} touches are "
                f"read without their {next(iter(keys.values()))}; adding them again "
                "brings it back."
            )
            problems.append(Problem("array", short, what, touches))
    return problems


def _touches_of(database: Database, recordings: list[int]) -> list[str]:
    sql = "SELECT lower(hex(id)) FROM touches WHERE recording = ? ORDER BY number"
    return [row[0] for key in recordings for row in database.rows(sql, [key])]


def left_out(database: Database) -> set[str]:
    """Return the names of arrays that an earlier repair found lost."""
    rows = database.rows("SELECT content FROM changes WHERE action = 'leave_out'")
    return {name for (text,) in rows for name in json.loads(text)["arrays"]}


def change_problems(database: Database, folder: Path) -> list[Problem]:
    """Return what the database and the files of changes do not agree on."""
    known, files = known_changes(database), change_files(folder)
    told = []
    for name, brief in known.items():
        fault = file_fault(folder, name, brief)
        if fault is not None:
            what = (
                f"It must be as it was written, got: {fault}. The database knows this "
                f"{brief['action']}; --repair writes its file anew."
            )
            told.append((name, what))
    for name in sorted(files.keys() - known.keys()):
        try:
            action = read_change(files[name])["action"]
        except (OSError, ValueError) as error:
            what = f"It must be a change, got: {error}. --repair sets it aside."
        else:
            what = (
                f"The database lacks this {action}: it has been lost and made anew, or "
                "a writer was killed. --repair carries it out."
            )
        told.append((name, what))
    return [
        Problem("change", f"{CHANGES}/{name}.json", what, []) for name, what in told
    ]


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
