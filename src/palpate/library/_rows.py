"""The table of touches: one function writes its rows, one reads them."""

import hashlib
import json
import warnings
from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._checks import check_option
from ._files import CELLS, Column, Sheet, canonical, header
from ._store import AT_ONCE, SEALED, LibraryError, Store, from_json, holders
from ._where import COLUMNS

Numbers = NDArray[np.int64]
_SHOWN = 20
MISSING = "its image is missing or altered"
# Retractions that a repair made, since it found no image.
SET_ASIDE = (
    f"SELECT id FROM changes WHERE json_extract(content, '$.reason') = '{MISSING}'"
)
FROM = (
    "FROM touches t JOIN recordings r ON r.id = t.recording "
    "LEFT JOIN objects given ON given.id = t.object "
    "LEFT JOIN objects o ON o.id = coalesce(given.merged_into, given.id) "
)
_JOINED = (
    f"{FROM} LEFT JOIN files f ON f.id = t.file "
    "LEFT JOIN changes c ON c.id = t.retraction "
)
DTYPE = "substr(r.dtype, instr(r.dtype, ')') + 1)"
# Where each field of `StoredTouch` and `TouchRow` stands.
_FIELDS = {
    **COLUMNS,
    "dtype": DTYPE,
    "key": "t.id",
    "file": "f.name",
    "offset": "f.offset",
    "number": "t.place",
    "digest": "t.image",
    "layout": "t.layout",
    "extra": "t.extra",
    "own_sensor": "t.sensor",
    "retracted": "t.retraction IS NOT NULL",
    "reason": "json_extract(c.content, '$.reason')",
}
_RECORDED = SEALED["recordings"][2:-1]
_INSERT = (
    f"INSERT INTO touches ({', '.join(SEALED['touches'][1:-1])}) "
    f"VALUES {holders(19)} ON CONFLICT (id) DO "
)
_HEALED = [f'"{n}"' for n in (*CELLS[1:], "extra", "layout", "recording", "file")]
_HEAL = (
    f"UPDATE SET {', '.join(f'{n} = excluded.{n}' for n in _HEALED)}, "
    "place = excluded.place, "
    f"retraction = iif(retraction IN ({SET_ASIDE}), NULL, retraction)"
)


class StoredTouch(NamedTuple):
    """What the database knows of a touch: where its image is, and its plain values.

    The image is the one of this `number` in `file`, where images begin at `offset`,
    with SHA-256 `digest`. `layout` is the key of its columns, `extra` the values of
    those that are no cells, as JSON; `cells` stand in the order of `CELLS`.
    """

    key: bytes
    file: bytes
    offset: int
    number: int
    digest: bytes
    n_rows: int
    n_cols: int
    n_channels: int | None
    dtype: str
    layout: int
    extra: str | None
    cells: tuple[Any, ...]

    @property
    def image_shape(self) -> tuple[int, ...]:
        """(n_rows, n_cols[, n_channels]) of its image."""
        return shape_of(self.n_rows, self.n_cols, self.n_channels)


def shape_of(*sides: int | None) -> tuple[int, ...]:
    return tuple(n for n in sides if n is not None)


_NAMED = StoredTouch._fields[:-1]
_CELLS = tuple("own_sensor" if name == "sensor" else name for name in CELLS)


def plain_values(rows: Sequence[StoredTouch]) -> list[dict[str, Any]]:
    """Return all plain values of each touch by the name of their column."""
    extras = from_json(f"[{','.join(row.extra or '{}' for row in rows)}]")
    return [
        dict(zip(CELLS, row.cells, strict=True)) | extra
        for row, extra in zip(rows, extras, strict=True)
    ]


def read_rows(
    store: Store, fields: tuple[str, ...], tail: str, values: Sequence[Any]
) -> list[tuple[Any, ...]]:
    """Return fields of touches; `tail` is the query from WHERE on."""
    listed = ", ".join(_FIELDS[name] for name in fields)
    return store.rows(f"SELECT {listed} {_JOINED} {tail}", values)


def stored_touches(store: Store, tail: str, values: Sequence[Any]) -> list[StoredTouch]:
    """Return the rows of touches; `tail` is the query from WHERE on."""
    rows = read_rows(store, _NAMED + _CELLS, tail, values)
    n = len(_NAMED)
    return [StoredTouch._make((*row[:n], row[n:])) for row in rows]


def rows_at(store: Store, numbers: Numbers) -> Iterator[list[StoredTouch]]:
    """Return the rows of touches by their rising numbers, `AT_ONCE` at a time."""
    for start in range(0, len(numbers), AT_ONCE):
        piece = numbers[start : start + AT_ONCE].tolist()
        where = f"WHERE t.number IN {holders(len(piece))} ORDER BY t.number"
        yield stored_touches(store, where, piece)


def read_one(store: Store, key: str) -> StoredTouch:
    number = store.key_of("touches", "id", id_bytes(key))
    if number is None:
        raise LibraryError(
            f"id must be that of a touch in the library, got {key!r}. "
            "See `palpate library list`."
        )
    return stored_touches(store, "WHERE t.number = ?", [number])[0]


def damaged_touches(
    store: Store, last: int | None = None, first: int = 1
) -> dict[int, str]:
    """Return touches whose rows are damaged, ids by numbers, from `first` to `last`.

    A row is damaged when its seal is broken or that of a row it refers to.
    """
    if not store.sealed:
        return {}
    bad = {t: _listed(store.broken(t)) for t in SEALED if t != "touches"}
    numbers = _listed(store.broken("touches", last, first))
    if {numbers, *bad.values()} == {"()"}:
        return {}
    found = store.rows(
        f"SELECT number, lower(hex(id)) FROM touches WHERE number IN {numbers} "
        f"OR object IN (SELECT id FROM objects WHERE id IN {bad['objects']} "
        f"OR merged_into IN {bad['objects']}) OR recording IN {bad['recordings']} "
        f"OR layout IN {bad['layouts']} OR file IN {bad['files']} "
        f"OR retraction IN {bad['changes']} ORDER BY number"
    )
    return dict(found)


def _listed(keys: Sequence[int]) -> str:
    return f"({', '.join(map(str, keys))})"


def without_damaged(
    store: Store, damaged: str, last: int | None = None, first: int = 1
) -> str:
    """Return SQL that leaves damaged touches out, or refuse them; `damaged` says which.

    Whether one meets a filter cannot be known: of all touches none may be damaged.
    """
    check_option("damaged", damaged, ("raise", "skip"))
    found = damaged_touches(store, last, first)
    if not found:
        return "1"
    some = ", ".join([*found.values()][:_SHOWN]) + ", ..." * (len(found) > _SHOWN)
    told = f"{len(found)} touches are damaged in {store.path}: {some}."
    if damaged == "raise":
        raise LibraryError(
            f"Rows must be as they were written, got others: {told} Restore them with "
            '`palpate library check --repair`, or leave them out with damaged="skip".'
        )
    warnings.warn(f"{told} They are left out.", stacklevel=2)
    return f"t.number NOT IN {_listed([*found])}"


def layouts(store: Store) -> dict[int, list[Column]]:
    rows = store.rows("SELECT id, columns FROM layouts ORDER BY id")
    return {key: Column.all_of(from_json(text)) for key, text in rows}


def distinct(store: Store, what: str, numbers: Numbers) -> list[tuple[Any, ...]]:
    """Return the different values of `what` over touches, in the order met."""
    sql = f"SELECT DISTINCT {what} {FROM} WHERE t.number IN (?)"
    return list(dict.fromkeys(store.among(sql, numbers.tolist())))


def id_bytes(key: str) -> bytes:
    try:
        return bytes.fromhex(key)
    except (ValueError, TypeError) as error:
        raise LibraryError(
            f"id must be 32 hexadecimal digits as `add` returns them, got {key!r}."
        ) from error


def write_rows(
    store: Store,
    sheet: Sheet,
    name: str,
    healed: Collection[bytes] = (),
    skipped: Collection[bytes] = (),
) -> None:
    """Enter touches of the file `name`: new ones, and `healed`, which lost theirs.

    Those in `skipped` are left out.
    """
    rows = list(_rows(store, sheet, name, skipped))
    store.run_many(_INSERT + "NOTHING", [r for r in rows if r[0] not in healed])
    if healed:
        store.run_many(_INSERT + _HEAL, [r for r in rows if r[0] in healed])


def _rows(
    store: Store, sheet: Sheet, name: str, skipped: Collection[bytes]
) -> Iterator[tuple[Any, ...]]:
    """Return what `_INSERT` names of each touch that is not `skipped`."""
    layout = {"columns": json.dumps([list(column) for column in sheet.layout])}
    recording = {name: sheet.recording[name] for name in _RECORDED}
    recording["whole"] = canonical(sheet.recording["whole"])
    recording["digest"] = hashlib.sha256(canonical(sheet.recording).encode()).digest()
    keys = (
        _key(store, "layouts", layout, "columns"),
        _key(store, "recordings", recording, "digest"),
        _file_key(store, sheet, name),
    )
    cells, extras = plain_cells(sheet)
    here = [row for row, key in enumerate(sheet.ids) if key not in skipped]
    objects = {
        label: _object_key(store, label, category)
        for label, category in {cells[0][row]: cells[1][row] for row in here}.items()
        if label is not None
    }
    for row in here:
        key, label = sheet.ids[row], cells[0][row]
        yield (
            key,
            objects.get(label),
            *(column[row] for column in cells[1:]),
            extras[row],
            *keys,
            row,
            sheet.digests[row],
            sheet.added_s,
        )


def plain_cells(sheet: Sheet) -> tuple[list[list[Any]], list[str | None]]:
    """Return the columns of `CELLS`, and the other plain values of each touch."""
    scalar = {c.name for c in sheet.layout if c.shape == () and c.name in sheet.values}
    blank = [None] * len(sheet.ids)
    cells = [sheet.values[n] if n in scalar else blank for n in CELLS]
    more = [n for n in sheet.values if n not in CELLS or n not in scalar]
    places = range(len(sheet.ids))
    extras = ({n: sheet.values[n][row] for n in more} for row in places)
    return cells, [canonical(extra) if extra else None for extra in extras]


def move_rows(store: Store, sheet: Sheet, name: str) -> None:
    """Note that touches stand in the file `name`, and change nothing else of them."""
    key = _file_key(store, sheet, name)
    store.run_many(
        "UPDATE touches SET file = ?, place = ? WHERE id = ?",
        [(key, place, touch) for place, touch in enumerate(sheet.ids)],
    )


def recordings(store: Store) -> dict[int, dict[str, Any]]:
    """Return what is the same for all touches of a recording, by its key."""
    rows = store.rows(f"SELECT id, {', '.join(_RECORDED)}, whole FROM recordings")
    return {
        key: dict(zip(_RECORDED, known, strict=True)) | {"whole": from_json(whole)}
        for key, *known, whole in rows
    }


def _file_key(store: Store, sheet: Sheet, name: str) -> int:
    file = {
        "name": bytes.fromhex(name),
        "n_touches": len(sheet.ids),
        "offset": len(header(sheet.images.shape, sheet.images.dtype)),
    }
    return _key(store, "files", file, "name")


def _object_key(store: Store, name: str, category: str | None) -> int:
    """Return the key of an object; the first category given for it is kept."""
    key = _key(store, "objects", {"name": name, "category": category}, "name")
    if category is not None:
        store.run(
            "UPDATE objects SET category = ? WHERE id = ? AND category IS NULL",
            [category, key],
        )
    return key


def _key(store: Store, table: str, values: dict[str, Any], unique: str) -> int:
    """Return the key of the row with this unique value, entering it where it lacks."""
    found = store.key_of(table, unique, values[unique])
    return store.insert(table, values) if found is None else found
