"""Adding touches: files first, then the database, then the caller is told."""

import hashlib
import json
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from .._progress import Progress
from ..touches import Touches
from ._database import Database
from ._errors import LibraryError
from ._files import ARRAYS, IMAGES, file_path, header_size, packed, publish
from ._matching import matched
from ._records import SensorDescription
from ._sheet import CELLS, Sheet, canonical, sheet_of

TOUCHES_PER_FILE = 256
BYTES_PER_FILE = 32 * 2**20
MISSING = "its image is missing or altered"
# Retractions that a repair made, since it found no image.
SET_ASIDE = (
    f"SELECT id FROM changes WHERE json_extract(content, '$.reason') = '{MISSING}'"
)

_RECORDING = (
    "sensor",
    "kind",
    "unit",
    "pitch_mm",
    "geometry",
    "n_rows",
    "n_cols",
    "dtype",
)
_INSERT = (
    "INSERT INTO touches (id, object, category, session, episode, sensor, "
    '"order", time_s, force_n, press, frame, source_path, extra, layout, recording, '
    f"file, place, image, added_s) VALUES ({', '.join('?' * 19)}) "
    "ON CONFLICT (id) DO NOTHING"
)


def add_touches(
    database: Database,
    folder: Path,
    touches: Touches,
    sensor: SensorDescription | None,
    progress: bool | None,
) -> list[str]:
    """Store touches and return their ids, in their order; see `TouchLibrary.add`."""
    recording = recording_of(folder, touches, sensor)
    ids: list[str] = []
    try:
        with Progress(len(touches), "Adding touches", progress) as bar:
            for part in _parts(touches):
                sheet = matched(database, sheet_of(part, recording, time.time()))
                store_sheet(database, folder, sheet)
                ids += [key.hex() for key in sheet.ids]
                bar.advance(len(part))
    except OSError as error:
        raise LibraryError(
            f"{folder} must have room for the touches, got: "
            f"{error.strerror or error}. {len(ids)} of {len(touches)} are stored; "
            "free space and add them all again, none is stored twice."
        ) from error
    return ids


def recording_of(
    folder: Path, touches: Touches, sensor: SensorDescription | None
) -> dict[str, Any]:
    """Return what is the same for all of `touches`; arrays go to files."""
    whole = {name: a for name, a in touches.whole.items() if name != "geometry"}
    told = (SensorDescription("") if sensor is None else sensor)._asdict()
    n_rows, n_cols = touches.images.shape[1:]
    try:
        names = {n: publish(folder / ARRAYS, packed([a])) for n, a in whole.items()}
    except OSError as error:
        raise LibraryError(
            f"{folder} must have room for the touches, got: "
            f"{error.strerror or error}. None of {len(touches)} is stored; free space "
            "and add them again."
        ) from error
    return {
        "sensor": told["name"] or None,
        "kind": told["kind"],
        "unit": told["unit"],
        "pitch_mm": told["pitch_mm"],
        "geometry": touches.geometry,
        "n_rows": n_rows,
        "n_cols": n_cols,
        "dtype": touches.images.dtype.str,
        "whole": names,
    }


def store_sheet(database: Database, folder: Path, sheet: Sheet) -> None:
    """Store the touches of a sheet that are not in the library yet."""
    known = _known(database, sheet.ids)
    names = {name for name, _ in known.values()}
    gone = {n for n in names if not file_path(folder / IMAGES, n.hex()).is_file()}
    lost = {key for key, (name, aside) in known.items() if aside or name in gone}
    new = {
        key: row for row, key in enumerate(sheet.ids) if key not in known or key in lost
    }
    if not new:
        return
    kept = sheet.picked(sorted(new.values()))
    name = publish(folder / IMAGES, packed(kept.arrays()))
    with database.writing():
        enter_sheet(database, kept, name, lost)


def enter_sheet(
    database: Database,
    sheet: Sheet,
    name: str,
    healed: Collection[bytes] = (),
) -> None:
    """Enter touches whose file is in place; those in the library already stay.

    Those in `healed`, whose file has been lost, are found in this one from now on.
    """
    layout = json.dumps([list(column) for column in sheet.layout])
    file = {
        "name": bytes.fromhex(name),
        "n_touches": len(sheet.ids),
        "offset": header_size(sheet.images),
    }
    keys = (
        _key(database, "layouts", {"columns": layout}, "columns"),
        _recording_key(database, sheet.recording),
        _key(database, "files", file, "name"),
    )
    rows = list(_rows(database, sheet, keys))
    database.run_many(_INSERT, rows)
    database.run_many(
        "UPDATE touches SET extra = ?, layout = ?, file = ?, place = ?, "
        f"retraction = iif(retraction IN ({SET_ASIDE}), NULL, retraction) WHERE id = ?",
        [(r[12], r[13], r[15], r[16], r[0]) for r in rows if r[0] in healed],
    )


def _known(database: Database, ids: list[bytes]) -> dict[bytes, tuple[bytes, bool]]:
    """Return the file of those of `ids` that are there, and whether it was lost."""
    found = database.rows(
        f"SELECT t.id, f.name, coalesce(t.retraction IN ({SET_ASIDE}), 0) "
        "FROM touches t JOIN files f ON f.id = t.file "
        f"WHERE t.id IN ({', '.join('?' * len(ids))})",
        ids,
    )
    return {key: (name, bool(aside)) for key, name, aside in found}


def _parts(touches: Touches) -> Iterator[Touches]:
    n_bytes = max(1, touches.images[0].nbytes)
    step = max(1, min(TOUCHES_PER_FILE, BYTES_PER_FILE // n_bytes))
    for start in range(0, len(touches), step):
        yield touches[start : start + step]


def _rows(
    database: Database, sheet: Sheet, keys: tuple[int, int, int]
) -> Iterator[tuple[Any, ...]]:
    blank = [None] * len(sheet.ids)
    scalar = {column.name for column in sheet.layout if column.shape == ()}
    cells = [
        sheet.values[name] if name in sheet.values and name in scalar else blank
        for name in CELLS
    ]
    more = [name for name in sheet.values if name not in CELLS or name not in scalar]
    labels, categories = cells[:2]
    kinds = dict(zip(labels, categories, strict=True))
    objects = {
        name: _object_key(database, name, category)
        for name, category in kinds.items()
        if name is not None
    }
    layout, recording, file = keys
    for row, key in enumerate(sheet.ids):
        extra = {name: sheet.values[name][row] for name in more}
        yield (
            key,
            objects.get(labels[row]),
            *(column[row] for column in cells[1:]),
            canonical(extra) if extra else None,
            layout,
            recording,
            file,
            row,
            sheet.digests[row],
            sheet.added_s,
        )


def _object_key(database: Database, name: str, category: str | None) -> int:
    """Return the key of an object; the first category told of it is kept."""
    key = _key(database, "objects", {"name": name, "category": category}, "name")
    database.run(
        "UPDATE objects SET category = ? WHERE id = ? AND category IS NULL",
        [category, key],
    )
    return key


def _recording_key(database: Database, recording: dict[str, Any]) -> int:
    text = canonical(recording)
    values = {name: recording[name] for name in _RECORDING}
    values["whole"] = canonical(recording["whole"])
    values["digest"] = hashlib.sha256(text.encode()).digest()
    return _key(database, "recordings", values, "digest")


def _key(database: Database, table: str, values: dict[str, Any], unique: str) -> int:
    """Return the key of the row with this unique value, entering it where it lacks."""
    found = database.one(f"SELECT id FROM {table} WHERE {unique} = ?", [values[unique]])
    if found is not None:
        return int(found[0])
    names, marks = ", ".join(values), ", ".join("?" * len(values))
    return database.added(
        f"INSERT INTO {table} ({names}) VALUES ({marks})", list(values.values())
    )
