"""Is everything there, is it as it was written, and what can be made of the rest."""

import json
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import NamedTuple

from .._durable import PARTIAL
from .._progress import Progress
from ._array_files import file_path, read_file
from ._changes import change_files, file_fault, known_changes, read_change
from ._reading import read_images
from ._rows import SET_ASIDE, StoredTouch, layouts, stored_touches
from ._store import (
    ARRAYS,
    CHANGES,
    FILE_NAME,
    IMAGES,
    DatabaseUnavailable,
    LibraryError,
    NewerLibrary,
    Store,
)

_SHOWN = 20
_KEPT = "t.retraction IS NULL"
_RETRACTED = f"t.retraction IS NOT NULL AND t.retraction NOT IN ({SET_ASIDE})"


class Problem(NamedTuple):
    """Something found by a check: its kind, the file concerned, and a sentence.

    `kind` is "database", "disk", "version", "image", "array", "change", "file without
    touches" or "partial file". Of the `touches` with these ids the image cannot be read
    or, of an array, they are read without it.
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
        sound = "all present and as they were written."
        state = sound if self.ok else f"{len(self.problems)} problems."
        lines = [f"{self.n_touches} touches in {self.n_files} files: {state}"]
        if self.n_set_aside:
            lines.append(
                f"{self.n_set_aside} touches are set aside: their images were missing "
                "or altered. They come back when their files do and the library is "
                "repaired, or when they are added again."
            )
        lines += [f"{p.kind}: {p.path}: {p.what}" for p in self.problems[:_SHOWN]]
        if len(self.problems) > _SHOWN:
            lines.append(f"... and {len(self.problems) - _SHOWN} more")
        return "\n".join(lines)


def check_library(folder: str | Path, *, progress: bool | None = None) -> CheckReport:
    """Read everything in a library and compare it with its checksums.

    Nothing is changed; a library too damaged to open is reported as well.

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
            return _checked(store, progress)
    except LibraryError as error:
        kind = "database"
        if isinstance(error, NewerLibrary | DatabaseUnavailable):
            kind = "version" if isinstance(error, NewerLibrary) else "disk"
        return CheckReport(False, 0, 0, [Problem(kind, FILE_NAME, str(error), [])])


def _checked(store: Store, progress: bool | None) -> CheckReport:
    problems = database_problems(store)
    found: dict[str, list[Problem]] = {_KEPT: [], _RETRACTED: []}
    for key, name in image_files(store, "Checking files", progress):
        for state, bad in found.items():
            bad += image_problem(store, key, name, state)
    problems += found[_KEPT]
    remarks = found[_RETRACTED]
    known = left_out(store)
    for problem in array_problems(store):
        noted = Path(problem.path).stem in known
        (remarks if noted else problems).append(problem)
    problems += _change_problems(store)
    remarks += _leftovers(store)
    # What should be there, its files, and what is set aside.
    aside = f"coalesce(retraction IN ({SET_ASIDE}), 0)"
    [counts] = store.rows(
        f"SELECT count(*) - sum({aside}), count(DISTINCT iif({aside}, NULL, file)), "
        f"sum({aside}) FROM touches"
    )
    n_touches, n_files, n_aside = (int(count or 0) for count in counts)
    return CheckReport(not problems, n_touches, n_files, problems + remarks, n_aside)


def database_problems(store: Store) -> list[Problem]:
    """Return what SQLite finds wrong with the database."""
    found = [text for (text,) in store.rows("PRAGMA quick_check(5)") if text != "ok"]
    return [Problem("database", FILE_NAME, f"SQLite says: {t}", []) for t in found]


def image_files(
    store: Store, what: str, progress: bool | None
) -> Iterator[tuple[int, str]]:
    """Go through key and name of all files of images, with a bar called `what`."""
    files = store.rows("SELECT id, name FROM files ORDER BY id")
    with Progress(len(files), what, progress) as bar:
        for key, name in files:
            yield key, name.hex()
            bar.advance(1)


def image_problem(
    store: Store, key: int, name: str, state: str = _KEPT
) -> list[Problem]:
    """Return what is wrong with a file of images that touches stand in, if anything."""
    rows = touches_in(store, key, state)
    fault = _fault(store, IMAGES, name) if rows else None
    if fault is None:
        return []
    # Wide columns have no checksum of their own: touches with such are lost as well.
    wide = {n for n, columns in layouts(store).items() if any(c.wide for c in columns)}
    lost = [r.key.hex() for r in rows if r.layout in wide or not _is_whole(store, r)]
    if state != _KEPT and not lost:
        return []
    end = "are lost." if state == _KEPT else "that are retracted cannot come back."
    what = f"{fault.what} {len(lost)} touches {end}"
    return [fault._replace(what=what, touches=lost)]


def touches_in(store: Store, file: int, state: str) -> list[StoredTouch]:
    """Return what a file should hold: touches in this state."""
    return stored_touches(store, f"WHERE t.file = ? AND {state}", [file])


def _fault(store: Store, kind: str, name: str) -> Problem | None:
    """Return what is wrong with a file of images or arrays, whomever it concerns."""
    try:
        read_file(store.folder / kind, name)
    except LibraryError as error:
        path = file_path(store.folder / kind, name)
        what = str(error).replace(f"{path} ", "It ")
        return Problem(kind.removesuffix("s"), _short(store, path), what, [])
    return None


def _short(store: Store, path: Path) -> str:
    return path.relative_to(store.folder).as_posix()


def _is_whole(store: Store, row: StoredTouch) -> bool:
    with suppress(LibraryError):
        return bool(len(read_images(store.folder, [row])))
    return False


def array_problems(store: Store) -> list[Problem]:
    """Return what is wrong with arrays of whole recordings."""
    users: dict[str, dict[int, str]] = {}
    for key, whole in store.rows("SELECT id, whole FROM recordings ORDER BY id"):
        for entry, name in json.loads(whole).items():
            users.setdefault(name, {})[key] = entry
    problems = []
    for name, entries in sorted(users.items()):
        fault = _fault(store, ARRAYS, name)
        if fault is not None:
            sql = "SELECT id FROM touches WHERE recording IN (?) ORDER BY number"
            touches = [row[0].hex() for row in store.among(sql, list(entries))]
            what = (
                f"{fault.what} {len(touches)} touches are read without their "
                f"{next(iter(entries.values()))}; adding them again brings it back."
            )
            problems.append(fault._replace(what=what, touches=touches))
    return problems


def left_out(store: Store) -> set[str]:
    """Return the names of arrays that an earlier repair found lost."""
    rows = store.rows("SELECT content FROM changes WHERE action = 'leave_out'")
    return {name for (text,) in rows for name in json.loads(text)["arrays"]}


def _change_problems(store: Store) -> Iterator[Problem]:
    """Name what the database and the files of changes do not agree on."""
    known, files = known_changes(store), change_files(store)
    for name, brief in known.items():
        fault = file_fault(store, name, brief)
        if fault is not None:
            what = (
                f"It must be as it was written, got: {fault}. The database knows this "
                f"{brief['action']}; --repair writes its file anew."
            )
            yield Problem("change", f"{CHANGES}/{name}.json", what, [])
    for name in sorted(files.keys() - known.keys()):
        try:
            action = read_change(files[name])["action"]
            what = (
                f"The database lacks this {action}: it has been lost and made anew, or "
                "a writer was killed. --repair carries it out."
            )
        except (OSError, ValueError) as error:
            what = f"It must be a change, got: {error}. --repair sets it aside."
        yield Problem("change", f"{CHANGES}/{name}.json", what, [])


def spare_files(store: Store) -> list[Path]:
    """Return files of images that the database does not know (any more, or yet)."""
    known = {row[0].hex() for row in store.rows("SELECT name FROM files")}
    paths = sorted((store.folder / IMAGES).glob("*/*.npy"))
    return [path for path in paths if path.stem not in known]


def _leftovers(store: Store) -> Iterator[Problem]:
    """Name what a killed writer left; it is harmless."""
    what = "No touch is found in it; harmless. --repair takes its touches in."
    for path in spare_files(store):
        yield Problem("file without touches", _short(store, path), what, [])
    what = "A writer was killed, or is writing it now; harmless."
    for path in sorted(store.folder.rglob(f"{PARTIAL}*")):
        yield Problem("partial file", _short(store, path), what, [])
