"""Adding touches: files first, then the database, then the answer to the caller.

Touches that come back changed, renamed since or read from an export, are known
again. A touch's id follows from what it was called when it was first added. An
export calls it by its object's present name, and fills cells that only some touches
have; so the ids that it may have had before are looked for as well.
"""

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import product
from math import isfinite
from typing import Any

from .._progress import Progress
from ..touches import Touches
from ._array_files import file_path, packed, publish
from ._changes import find_object, next_time, renamings
from ._listing import SensorDescription
from ._rows import FROM, SET_ASIDE, write_rows
from ._sheet import IDENTITY, Sheet, identity, sheet_of
from ._store import ARRAYS, IMAGES, LibraryError, Store
from ._where import COLUMNS

_TOUCHES_PER_FILE = 256
_BYTES_PER_FILE = 32 * 2**20


def add_touches(
    store: Store,
    touches: Touches,
    sensor: SensorDescription | None,
    progress: bool | None,
) -> list[str]:
    """Store touches and return their ids, in their order; see `TouchLibrary.add`."""
    ids: list[str] = []
    n_bytes = max(1, touches.images[0].nbytes)
    step = max(1, min(_TOUCHES_PER_FILE, _BYTES_PER_FILE // n_bytes))
    try:
        recording = _recording(store, touches, sensor)
        with Progress(len(touches), "Adding touches", progress) as bar:
            for start in range(0, len(touches), step):
                part = touches[start : start + step]
                sheet = _matched(store, sheet_of(part, recording, time.time()))
                _store_sheet(store, sheet)
                ids += [key.hex() for key in sheet.ids]
                bar.advance(len(part))
    except OSError as error:
        raise LibraryError(
            f"{store.folder} must have room for the touches, got: "
            f"{error.strerror or error}. {len(ids)} of {len(touches)} are stored; "
            "free space and add them all again, none is stored twice."
        ) from error
    return ids


def _recording(
    store: Store, touches: Touches, sensor: SensorDescription | None
) -> dict[str, Any]:
    """Return what is the same for all of `touches`; arrays go to files."""
    known = (sensor or SensorDescription(""))._replace(geometry=touches.geometry)
    described = known._asdict()
    n_rows, n_cols, *channels = touches.images.shape[1:]
    _refuse_other_channels(store, known.name, channels)
    arrays = store.folder / ARRAYS
    whole = {n: array for n, array in touches.whole.items() if n != "geometry"}
    return {
        "sensor": described.pop("name") or None,
        **described,
        "n_rows": n_rows,
        "n_cols": n_cols,
        "dtype": "".join(f"({n},)" for n in channels) + touches.images.dtype.str,
        "whole": {n: publish(arrays, packed([array])) for n, array in whole.items()},
    }


def _refuse_other_channels(store: Store, sensor: str, channels: list[int]) -> None:
    """Refuse grey touches of a sensor that gave colour before, and the reverse."""
    sql = f"SELECT DISTINCT {COLUMNS['n_channels']} FROM recordings r WHERE sensor = ?"
    before = store.one(sql, [sensor])
    now = channels[0] if channels else None
    if before is not None and before[0] != now:
        was, got = (f"{n or 'no'} channels" for n in (before[0], now))
        raise LibraryError(
            f"Images of sensor {sensor!r} must have {was} like those in the library, "
            f"got {got}. Convert them, give the sensor another name, or use another "
            "library."
        )


def _store_sheet(store: Store, sheet: Sheet) -> None:
    """Store the touches of a sheet that are not in the library yet."""
    found = store.among(
        f"SELECT t.id, f.name, coalesce(t.retraction IN ({SET_ASIDE}), 0) "
        "FROM touches t JOIN files f ON f.id = t.file WHERE t.id IN (?)",
        sheet.ids,
    )
    images = store.folder / IMAGES
    names = {name for _, name, _ in found}
    gone = {n for n in names if not file_path(images, n.hex()).is_file()}
    lost = {key for key, name, aside in found if aside or name in gone}
    sound = {key for key, _, _ in found} - lost
    new = {key: row for row, key in enumerate(sheet.ids) if key not in sound}
    if not new:
        return
    kept = sheet.picked(sorted(new.values()))
    name = publish(images, packed(kept.arrays()))
    with store.writing():
        if (now := next_time(store)) > kept.added_s:  # another changed names since
            kept = replace(kept, added_s=now)
            name = publish(images, packed(kept.arrays()))
        write_rows(store, kept, name, lost)


def _matched(store: Store, sheet: Sheet) -> Sheet:
    """Return a sheet whose touches have the ids under which they are stored already.

    A touch is another's return when the image is the same, all that tells touches apart
    too but for former names and cells that were empty or numbers, and both have one
    name.
    """
    labels = sheet.values.get("object", [None] * len(sheet.ids))
    found = {label: find_object(store, label) for label in set(labels)}
    now = {name: known[1] if known else name for name, known in found.items()}
    former: dict[str | None, list[str]] = {name: [] for name in now.values()}
    for old, new in renamings(store):
        for name, before in former.items():
            if new == name or new in before:
                before.append(old)
    maybe: dict[bytes, tuple[bytes, str | None]] = {}
    for row, label in enumerate(labels):
        names = [label, now[label], *former[now[label]]]
        for cells in _earlier(sheet, row, list(dict.fromkeys(names))):
            key = identity(sheet.digests[row], cells, sheet.wide, row)
            if key != sheet.ids[row]:
                maybe.setdefault(key, (sheet.ids[row], now[label]))
    if not maybe:
        return sheet
    sql = f"SELECT t.id, o.name {FROM} WHERE t.id IN (?)"
    there = {key for key, _ in store.among(sql, sheet.ids)}
    stored = {
        maybe[key][0]: key
        for key, name in store.among(sql, list(maybe))
        if maybe[key][0] not in there and maybe[key][1] == name
    }
    return replace(sheet, ids=[stored.get(key, key) for key in sheet.ids])


def _earlier(
    sheet: Sheet, row: int, names: list[str | None]
) -> Iterator[dict[str, Any]]:
    """Return what may have set a touch apart from others when it was first added."""
    now = {n: cells[row] for n, cells in sheet.values.items() if n in IDENTITY}
    plain = [name for name, cell in now.items() if not isinstance(cell, list)]
    forms = [
        names
        if name == "object"
        else list(dict.fromkeys([now[name], _before(now[name])]))
        for name in plain
    ]
    if any(len(form) > 1 for form in forms):
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
