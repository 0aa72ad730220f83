"""Touches that come back changed: renamed since, or read from an export.

A touch's id follows from what it was called when it was first added. An export calls
it by its object's present name, and fills cells that only some touches have; so the
ids that it may have had before are looked for as well.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import product
from math import isfinite
from typing import Any

from ._changes import renamings
from ._database import Database
from ._query import AT_ONCE, FROM
from ._sheet import IDENTITY, Sheet, identity


def matched(database: Database, sheet: Sheet) -> Sheet:
    """Return a sheet whose touches have the ids under which they are stored already.

    A touch is another's return when the image is the same, all that tells touches
    apart is the same but for former names of the object and for cells that were
    empty or numbers, and both go by one name now.
    """
    labels = sheet.values.get("object", [None] * len(sheet.ids))
    now = {label: _present(database, label) for label in set(labels)}
    former = _former_names(database, set(now.values()))
    maybe: dict[bytes, tuple[bytes, str | None]] = {}
    for row, label in enumerate(labels):
        names = [label, now[label], *former.get(now[label], [])]
        for cells in _earlier(sheet, row, list(dict.fromkeys(names))):
            key = identity(sheet.digests[row], cells, sheet.wide, row)
            if key != sheet.ids[row]:
                maybe.setdefault(key, (sheet.ids[row], now[label]))
    if not maybe:
        return sheet
    known = _names(database, sheet.ids)
    stored = {
        maybe[key][0]: key
        for key, name in _names(database, list(maybe)).items()
        if maybe[key][0] not in known and maybe[key][1] == name
    }
    return replace(sheet, ids=[stored.get(key, key) for key in sheet.ids])


def _present(database: Database, label: str | None) -> str | None:
    """Return the name of the object that touches labelled so now belong to."""
    row = database.one(
        "SELECT o.name FROM objects given "
        "JOIN objects o ON o.id = coalesce(given.merged_into, given.id) "
        "WHERE given.name = ?",
        [label],
    )
    return label if row is None else str(row[0])


def _former_names(
    database: Database, present: set[str | None]
) -> dict[str | None, list[str]]:
    """Return the names that touches of each object may have been added under."""
    former: dict[str | None, list[str]] = {name: [] for name in present}
    for old, new in renamings(database):
        for name, before in former.items():
            if new == name or new in before:
                before.append(old)
    return former


def _earlier(
    sheet: Sheet, row: int, names: list[str | None]
) -> Iterator[dict[str, Any]]:
    """Return what may have told a touch from others when it was first added."""
    now = {n: cells[row] for n, cells in sheet.values.items() if n in IDENTITY}
    forms = [
        names if name == "object" else list(dict.fromkeys([cell, _before(cell)]))
        for name, cell in now.items()
        if not isinstance(cell, list)
    ]
    if all(len(form) == 1 for form in forms):
        return
    plain = [name for name, cell in now.items() if not isinstance(cell, list)]
    for cells in product(*forms):
        yield {**now, **dict(zip(plain, cells, strict=True))}


def _before(cell: Any) -> Any:
    """Return nothing for an empty text, and the number that a text spells."""
    if not isinstance(cell, str):
        return cell
    for kind in (int, float):
        with suppress(ValueError):
            number = kind(cell)
            plain = isinstance(number, int) or isfinite(number)
            return number if plain and str(number) == cell else cell
    return cell or None


def _names(database: Database, ids: list[bytes]) -> dict[bytes, str | None]:
    """Return the present object of each of these touches that is in the library."""
    found: dict[bytes, str | None] = {}
    for start in range(0, len(ids), AT_ONCE):
        piece = ids[start : start + AT_ONCE]
        marks = ", ".join("?" * len(piece))
        sql = f"SELECT t.id, o.name {FROM} WHERE t.id IN ({marks})"
        found.update(database.rows(sql, piece))
    return found
