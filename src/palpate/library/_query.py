"""Questions to the database: which touches, and what is known of them."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._database import Database
from ._errors import LibraryError
from ._records import TouchRow
from ._where import Condition, parse_where

FROM = (
    "FROM touches t JOIN recordings r ON r.id = t.recording "
    "LEFT JOIN objects given ON given.id = t.object "
    "LEFT JOIN objects o ON o.id = coalesce(given.merged_into, given.id) "
)
AT_ONCE = 512


def condition(
    database: Database, where: str | None, *, retracted: bool = False
) -> Condition:
    """Return a filter as SQL; retracted touches are left out unless asked for."""
    kept = "1" if retracted else "t.retraction IS NULL"
    if where is not None and not isinstance(where, str):
        raise TypeError(
            f"where must be a filter or None, got {type(where).__name__}. Write for "
            'example "object = mug".'
        )
    if where is None or not where.strip():
        return Condition(kept, [])
    parsed = parse_where(where, _extra_names(database))
    return Condition(f"{kept} AND {parsed.sql}", parsed.values)


def numbers_of(database: Database, where: Condition) -> NDArray[np.int64]:
    """Return the numbers of the touches that meet a filter, in the order added."""
    rows = database.rows(
        f"SELECT t.number {FROM} WHERE {where.sql} ORDER BY t.number", where.values
    )
    return np.fromiter((row[0] for row in rows), dtype=np.int64, count=len(rows))


def count_touches(database: Database, where: Condition) -> int:
    """Return how many touches meet a filter."""
    row = database.one(f"SELECT count(*) {FROM} WHERE {where.sql}", where.values)
    return 0 if row is None else int(row[0])


def list_touches(
    database: Database, where: Condition, limit: int | None, offset: int
) -> list[TouchRow]:
    """Return what is known of touches, newest last, without reading an image."""
    rows = database.rows(
        "SELECT lower(hex(t.id)), o.name, t.category, t.session, t.episode, "
        'coalesce(t.sensor, r.sensor), t."order", t.time_s, t.force_n, r.n_rows, '
        "r.n_cols, r.dtype, t.added_s, t.retraction IS NOT NULL, c.content "
        f"{FROM} LEFT JOIN changes c ON c.id = t.retraction "
        f"WHERE {where.sql} ORDER BY t.number LIMIT ? OFFSET ?",
        [*where.values, -1 if limit is None else limit, offset],
    )
    return [TouchRow._make((*r[:13], bool(r[13]), _reason(r[14]))) for r in rows]


def chunks(numbers: NDArray[np.int64]) -> Iterator[list[int]]:
    """Cut numbers of touches into pieces that one query takes."""
    for start in range(0, len(numbers), AT_ONCE):
        yield numbers[start : start + AT_ONCE].tolist()


def distinct(
    database: Database, what: str, numbers: NDArray[np.int64]
) -> list[tuple[Any, ...]]:
    """Return the different values of `what` over touches, in the order met."""
    found: dict[tuple[Any, ...], None] = {}
    for piece in chunks(numbers):
        marks = ", ".join("?" * len(piece))
        sql = f"SELECT DISTINCT {what} {FROM} WHERE t.number IN ({marks})"
        found.update(dict.fromkeys(database.rows(sql, piece)))
    return list(found)


def id_bytes(key: str) -> bytes:
    """Return an id as it stands in the database."""
    try:
        return bytes.fromhex(key)
    except (ValueError, TypeError) as error:
        raise LibraryError(
            f"id must be 32 hexadecimal digits as `add` returns them, got {key!r}."
        ) from error


def _extra_names(database: Database) -> set[str]:
    rows = database.rows("SELECT columns FROM layouts")
    return {c[0] for row in rows for c in json.loads(row[0]) if not c[3]}


def _reason(content: str | None) -> str | None:
    return None if content is None else json.loads(content).get("reason")
