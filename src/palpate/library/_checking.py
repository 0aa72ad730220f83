"""Is everything there, is it as it was written, and what can be made of the rest."""

from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, NamedTuple

from .._durable import PARTIAL
from .._progress import Progress
from . import _changes, _rows, _store
from ._changes import Names, change_files, file_fault, known_changes, read_change
from ._entering import enter_lost_rows, sheet_in, spare_files
from ._files import CELLS, adopt, file_path, read_file
from ._reading import is_whole
from ._rows import FROM, SET_ASIDE, StoredTouch, damaged_touches, layouts, recordings
from ._store import CHANGES, FILE_NAME, IMAGES, LibraryError, NewerLibrary, Store

_SHOWN = 20
_KEPT = "t.retraction IS NULL"
_RETRACTED = f"t.retraction IS NOT NULL AND t.retraction NOT IN ({SET_ASIDE})"


class Problem(NamedTuple):
    """Something found by a check: its kind, the file concerned, and a sentence.

    `kind` is "database", "disk", "version", "image", "array", "change", "file without
    touches", "partial file" or "unprotected". Of the `touches` with these ids the image
    or the row cannot be read or, of an array, they are read without it.
    """

    kind: str
    path: str
    what: str
    touches: list[str]


class CheckReport(NamedTuple):
    """What a check found; `ok` when nothing is wrong with any acknowledged touch.

    `n_set_aside` touches, which an earlier repair found no image of, are not among
    the `n_touches` in `n_files` image files; `problems` say what is damaged, and which
    touches it concerns.
    """

    ok: bool
    n_touches: int
    n_files: int
    problems: list[Problem]
    n_set_aside: int = 0

    def __str__(self) -> str:
        sound = "all present and as they were written."
        state = (
            sound
            if self.ok
            else f"{len(self.problems)} problem{'s' * (len(self.problems) > 1)}."
        )
        files = f"{self.n_files} file{'s' * (self.n_files != 1)}"
        lines = [f"{self.n_touches} touches in {files}: {state}"]
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
    adopted = adopt(Path(folder) / IMAGES)
    try:
        with closing(Store(Path(folder))) as store:
            enter_lost_rows(store, adopted)
            return _checked(store, progress)
    except LibraryError as error:
        kinds = {NewerLibrary: "version", _store.DatabaseUnavailable: "disk"}
        kind = next((k for t, k in kinds.items() if isinstance(error, t)), "database")
        return CheckReport(False, 0, 0, [Problem(kind, FILE_NAME, str(error), [])])


def _checked(store: Store, progress: bool | None) -> CheckReport:
    if problems := database_problems(store):
        return CheckReport(False, 0, 0, problems)
    problems = row_problems(store)
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
    if not store.sealed:
        what = "Rows are not protected by seals until the library is next written to."
        remarks.append(Problem("unprotected", FILE_NAME, what, []))
    # What should be there, its files, and what is set aside.
    aside = f"coalesce(retraction IN ({SET_ASIDE}), 0)"
    [counts] = store.rows(
        f"SELECT count(*) - sum({aside}), count(DISTINCT iif({aside}, NULL, file)), "
        f"sum({aside}) FROM touches"
    )
    n_touches, n_files, n_aside = (int(count or 0) for count in counts)
    return CheckReport(not problems, n_touches, n_files, problems + remarks, n_aside)


def database_problems(store: Store) -> list[Problem]:
    """Return what SQLite, and the seals of its rows, find wrong with the database."""
    rows = store.rows("PRAGMA integrity_check(5)")
    found = [f"SQLite says: {text}" for (text,) in rows if text != "ok"]
    try:
        touches = [] if found else [*damaged_touches(store).values()]
        tables = () if found or not store.sealed else _store.SEALED
        keys = {table: store.broken(table) for table in tables}
    except _store.DatabaseDamaged as error:
        return [Problem("database", FILE_NAME, str(error), [])]
    for table, broken in keys.items():
        if broken:
            found.append(
                f"{len(broken)} rows of {table} must be as they were written, got "
                "others; --repair makes them anew from the files."
            )
    return [Problem("database", FILE_NAME, what, touches) for what in found]


def row_problems(store: Store) -> list[Problem]:
    """Name touches whose rows are not what the sheet in their file says."""
    names, known, whole = Names(store), layouts(store), recordings(store)
    columns = ", ".join(f't."{name}"' for name in CELLS[1:])
    problems = []
    for key, name in store.rows("SELECT id, name FROM files ORDER BY id"):
        sheet = sheet_in(store, name.hex())
        if sheet is None:
            continue  # such a file is a problem of its own
        cells, extras = _rows.plain_cells(sheet)
        places = {touch: place for place, touch in enumerate(sheet.ids)}
        rows = store.rows(
            "SELECT t.id, t.place, t.image, t.extra, t.layout, t.recording, o.name, "
            f"{columns} {FROM} WHERE t.file = ?",
            [key],
        )
        wrong = []
        for touch, place, *got in rows:
            got[2:4] = known[got[2]], whole[got[3]]
            if places.get(touch) == place:
                label = names.now(cells[0][place], sheet.added_s)
                given = [column[place] for column in cells[1:]]
                said = [sheet.digests[place], extras[place], sheet.layout]
                if got == [*said, sheet.recording, label, *_as_stored(given)]:
                    continue
            wrong.append(touch.hex())
        if wrong:
            what = (
                f"{len(wrong)} touches must be as {name.hex()[:12]}.npy says, got "
                "other values; --repair makes the database anew from the files."
            )
            problems.append(Problem("database", FILE_NAME, what, wrong))
    return problems


def _as_stored(cells: list[Any]) -> Iterator[Any]:
    """Yield cells, from the second on, as SQLite keeps them: some as real numbers."""
    for name, cell in zip(CELLS[1:], cells, strict=True):
        if name in ("time_s", "force_n") and isinstance(cell, str):
            with suppress(ValueError):
                cell = float(cell)
        yield cell


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
    lost = [row.key.hex() for row in rows if not is_whole(store, row)]
    if state != _KEPT and not lost:
        return []
    end = "are lost." if state == _KEPT else "that are retracted cannot come back."
    what = f"{fault.what} {len(lost)} touches {end}"
    return [fault._replace(what=what, touches=lost)]


def touches_in(store: Store, file: int, state: str) -> list[StoredTouch]:
    return _rows.stored_touches(store, f"WHERE t.file = ? AND {state}", [file])


def _fault(store: Store, kind: str, name: str) -> Problem | None:
    """Return what is wrong with a file of images or arrays, whomever it concerns."""
    try:
        read_file(store.folder / kind, name)
    except LibraryError as error:
        path = file_path(store.folder / kind, name)
        what = str(error).replace(f"{path} ", "It ")
        short = path.relative_to(store.folder).as_posix()
        return Problem(kind.removesuffix("s"), short, what, [])
    return None


def array_problems(store: Store) -> list[Problem]:
    users: dict[str, dict[int, str]] = {}
    for key, whole in store.rows("SELECT id, whole FROM recordings ORDER BY id"):
        for entry, name in _store.from_json(whole).items():
            users.setdefault(name, {})[key] = entry
    problems = []
    for name, entries in sorted(users.items()):
        fault = _fault(store, _store.ARRAYS, name)
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
    return {name for (text,) in rows for name in _store.from_json(text)["arrays"]}


def _change_problems(store: Store) -> Iterator[Problem]:
    """Name what the database and the files of changes do not agree on."""
    known, files = known_changes(store), change_files(store)
    told = _changes.told_changes(known | _changes.readable_changes(files))
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
            done = "carries it out" if name in told else "sets it aside"
            what = (
                f"The database lacks this {action}: it has been lost and "
                f"made anew, or a writer was killed. --repair {done}."
            )
        except (OSError, ValueError) as error:
            what = f"It must be a change, got: {error}. --repair sets it aside."
        yield Problem("change", f"{CHANGES}/{name}.json", what, [])


def _leftovers(store: Store) -> Iterator[Problem]:
    spare = "No touch is found in it; harmless. --repair takes its touches in."
    begun = "A writer was killed, or is writing it now; harmless."
    partial = sorted(store.folder.rglob(f"{PARTIAL}*"))
    left = [("file without touches", path, spare) for path in spare_files(store)]
    for kind, path, what in left + [("partial file", path, begun) for path in partial]:
        with suppress(OSError):  # renamed meanwhile; empty ones wait to be written to
            if path.stat().st_size:
                yield Problem(kind, path.relative_to(store.folder).as_posix(), what, [])
