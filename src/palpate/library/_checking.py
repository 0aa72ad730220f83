"""Whether everything is there, and as it was written."""

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from .._parallel import Progress
from ._changes import Names, change_rows
from ._content import id_bytes, identity, wide_identities
from ._reading import stored_array, whole_image
from ._rows import (
    LOST,
    StoredTouch,
    Tables,
    plain_values,
    stored_touches,
)
from ._store import (
    AT_ONCE,
    DatabaseDamaged,
    DatabaseUnavailable,
    LibraryError,
    OtherVersion,
    Store,
    chained,
)

_PROBLEMS_LISTED = 20  # ids of a problem that are listed
LEFT_OUT = "left out"
_LEFT_OUT = "SELECT 1 FROM arrays WHERE digest = ? AND content = ?"


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
    ok = all(problem.kind == LEFT_OUT for problem in problems)
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
        while rows := next_rows(store, number):
            number = rows[-1].number
            for row in rows:
                n_read += 1
                if what := touch_fault(tables, row, names):
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


def next_rows(
    store: Store, number: int, most: int = AT_ONCE, *, named: bool = True
) -> list[StoredTouch]:
    """Return the rows after this number, at most so many."""
    tail = "WHERE t.number > ? ORDER BY t.number LIMIT ?"
    return stored_touches(store, tail, [number, most], named=named)


def touch_fault(tables: Tables, row: StoredTouch, names: Names | None) -> str | None:
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
            kind = LEFT_OUT if left_out else "array"
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
            else:
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
