"""Touches added to a library, and what is known of them without reading an image.

Adding writes files first, then the database, then the answer to the caller. Touches
that come back changed, renamed since or read from an export, are known again. A touch's
id follows from what it was called when it was first added. An export calls it by its
object's present name, and fills cells that only some touches have; so the ids that it
may have had before are looked for as well.
"""

import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from itertools import islice, product
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._checks import check_option, check_positive
from .._progress import Progress
from ..touches import GEOMETRIES, Touches
from . import _rows
from ._changes import Names, find_object, next_time
from ._files import (
    IDENTITY,
    Sheet,
    file_path,
    identity,
    leave_mark,
    packed,
    publish,
    sheet_of,
)
from ._rows import FROM, SET_ASIDE, Numbers, layouts, shape_of, without_damaged
from ._store import FEATURES, FILE_NAME, LibraryError, Store
from ._where import COLUMNS, Condition, parse_where

_TOUCHES_PER_FILE = 256
_BYTES_PER_FILE = 32 * 2**20
_TOGETHER = 32
_KNOWN = "SELECT count(*) FROM files WHERE name = ?"


class SensorDescription(NamedTuple):
    """What is known of the sensor that took some touches.

    Attributes
    ----------
    name : str
        Tells this sensor from others, such as "camera:BathTip 2".
    kind : str or None
        Such as "camera", "array" or "simulated".
    unit : str or None
        Unit of the images, such as "kPa" or "grey level".
    pitch_mm : float or None
        Distance of neighbouring taxels in mm.
    geometry : {"dome", "array", "plane", "none"} or None
        How its taxels lie; None leaves it as the touches say.
    """

    name: str
    kind: str | None = None
    unit: str | None = None
    pitch_mm: float | None = None
    geometry: str | None = None

    def checked(self) -> "SensorDescription":
        """Return itself, or say what is wrong with it."""
        if not isinstance(self.name, str) or not self.name.strip():
            raise ValueError(f"sensor name must be a text, got {self.name!r}.")
        if self.pitch_mm is not None:
            check_positive("pitch_mm", self.pitch_mm)
        check_option("geometry", self.geometry, (None, *GEOMETRIES))
        return self


class ObjectRow(NamedTuple):
    """An object, its touches not retracted, and its pairs of session and episode."""

    name: str
    category: str | None
    n_touches: int
    n_episodes: int


class TouchRow(NamedTuple):
    """One touch of a library without its image.

    `id` follows from the image and the labels; `object`, `category`, `session`,
    `episode`, `sensor` and `order` are what the touch came with, `n_rows` x `n_cols`
    of `dtype` its image. `time_s` is the touch's own time, `added_s` when it was added
    (both seconds; the latter since 1970), `force_n` in newtons; `n_channels` is None
    where images have no axis of channels; `reason` says why it is `retracted`.
    """

    id: str
    object: str | None
    category: str | None
    session: str | int | float | None
    episode: str | int | float | None
    sensor: str | None
    order: float | None
    time_s: float | None
    force_n: float | None
    n_rows: int
    n_cols: int
    n_channels: int | None
    dtype: str
    added_s: float
    retracted: bool
    reason: str | None

    @property
    def image_shape(self) -> tuple[int, ...]:
        """(n_rows, n_cols[, n_channels]) of its image."""
        return shape_of(self.n_rows, self.n_cols, self.n_channels)


class Stats(NamedTuple):
    """How much a library holds; sizes in bytes."""

    n_touches: int
    n_retracted: int
    n_objects: int
    n_sessions: int
    n_files: int
    database_bytes: int
    image_bytes: int
    feature_bytes: int


def condition(
    store: Store, where: str | None, damaged: str = "raise", *, retracted: bool = False
) -> Condition:
    """Return a filter as SQL; retracted touches are left out unless asked for.

    Damaged rows are refused, or left out and told where `damaged` is "skip"; it may be
    "unseen" where the caller looks at the rows that it finds.
    """
    kept = "1" if damaged == "unseen" else without_damaged(store, damaged)
    kept += "" if retracted else " AND t.retraction IS NULL"
    if where is not None and not isinstance(where, str):
        raise TypeError(
            f"where must be a filter or None, got {type(where).__name__}. Write for "
            'example "object = mug".'
        )
    if where is None or not where.strip():
        return Condition(kept, [])
    extra = {c.name for known in layouts(store).values() for c in known if not c.wide}
    parsed = parse_where(where, extra)
    return Condition(f"{kept} AND {parsed.sql}", parsed.values)


def numbers_of(store: Store, where: str | None, damaged: str = "raise") -> Numbers:
    """Return the numbers of the touches that meet a filter, in the order added."""
    sql, values = condition(store, where, damaged)
    rows = store.rows(f"SELECT t.number {FROM} WHERE {sql} ORDER BY t.number", values)
    return np.fromiter((row[0] for row in rows), dtype=np.int64, count=len(rows))


def list_objects(store: Store) -> list[ObjectRow]:
    """Return objects with touches by name; a category may be of one merged into it."""
    without_damaged(store, "raise")
    rows = store.rows(
        "WITH given AS (SELECT object, session, episode, count(*) AS n FROM touches "
        "WHERE retraction IS NULL GROUP BY object, session, episode), "
        "visits AS (SELECT coalesce(o.merged_into, o.id) AS key, sum(n) AS n "
        "FROM given JOIN objects o ON o.id = object GROUP BY key, session, episode) "
        "SELECT o.name, (SELECT category FROM objects WHERE (id = o.id "
        "OR merged_into = o.id) AND category IS NOT NULL "
        "ORDER BY merged_into IS NOT NULL, id LIMIT 1), sum(n), count(*) "
        "FROM visits JOIN objects o ON o.id = key GROUP BY o.id ORDER BY o.name"
    )
    return [ObjectRow(*row) for row in rows]


def stats_of(store: Store) -> Stats:
    without_damaged(store, "raise")
    [row] = store.rows(
        "SELECT count(*), count(retraction), (SELECT count(*) FROM files), "
        "(SELECT count(*) FROM (SELECT DISTINCT session FROM touches)) FROM touches"
    )
    n_touches, n_retracted, n_files, n_sessions = row
    return Stats(
        n_touches - n_retracted,
        n_retracted,
        len(list_objects(store)),
        n_sessions,
        n_files,
        sum(p.stat().st_size for p in store.folder.glob(f"{FILE_NAME}*")),
        _bytes_below(store.images) + _bytes_below(store.arrays),
        _bytes_below(store.folder / FEATURES),
    )


def _bytes_below(folder: Path) -> int:
    return sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())


def add_touches(
    store: Store,
    touches: Touches,
    sensor: SensorDescription | None,
    progress: bool | None,
) -> list[str]:
    """Store touches and return their ids, in their order; see `TouchLibrary.add`.

    Of small sets that several threads add, those that wait while one is written go
    together next: into one file and one transaction.
    """
    shares = len(touches) / _TOUCHES_PER_FILE, touches.images.nbytes / _BYTES_PER_FILE
    arrays = {"": touches.images, **touches.columns, **touches.whole}
    native = all(
        array.dtype.isnative for array in arrays.values()
    )  # as joined ones are
    if max(shares) * _TOGETHER > 1 or not native:
        return _add_all(store, touches, sensor, progress)
    kind = sensor, [(n, array.dtype.str.split("U")[0]) for n, array in arrays.items()]
    ids: Future[list[str]] = Future()
    with store.turn:
        store.waiting[ids] = kind, touches
        store.turn.wait_for(lambda: ids.done() or not store.leads)
        if ids.done():
            return ids.result()
        store.leads, alike = True, {ids: touches}
        alike |= {f: t for f, (other, t) in store.waiting.items() if other == kind}
    group = dict(islice(alike.items(), _TOGETHER))
    try:
        with suppress(*[Exception] * (len(group) > 1)):
            together = (
                Touches.concatenate(group.values()) if len(group) > 1 else touches
            )
            keys = iter(_add_all(store, together, sensor, False))
            for future, some in group.items():
                future.set_result(list(islice(keys, len(some))))
        if not ids.done():  # one of the others may have spoilt it
            return _add_all(store, touches, sensor, False)
    finally:
        with store.turn:
            del store.waiting[ids]
            store.waiting = {f: w for f, w in store.waiting.items() if not f.done()}
            store.leads = False
            store.turn.notify_all()
    return ids.result()


def _add_all(
    store: Store,
    touches: Touches,
    sensor: SensorDescription | None,
    progress: bool | None,
) -> list[str]:
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
    # Grey touches of a sensor that gave colour before are refused, and the reverse.
    sql = f"SELECT DISTINCT {COLUMNS['n_channels']} FROM recordings r WHERE sensor = ?"
    before, now = store.one(sql, [known.name]), channels[0] if channels else None
    if before is not None and before[0] != now:
        was, got = (f"{n or 'no'} channels" for n in (before[0], now))
        raise LibraryError(
            f"Images of sensor {known.name!r} must have {was} like those in the "
            f"library, got {got}. Convert them, give the sensor another name, or use "
            "another library."
        )
    arrays = store.arrays
    whole = {n: array for n, array in touches.whole.items() if n != "geometry"}
    return {
        "sensor": described.pop("name") or None,
        **described,
        "n_rows": n_rows,
        "n_cols": n_cols,
        "dtype": "".join(f"({n},)" for n in channels) + touches.images.dtype.str,
        "whole": {n: publish(arrays, packed([array])) for n, array in whole.items()},
    }


def _store_sheet(store: Store, sheet: Sheet) -> None:
    """Store the touches of a sheet that are not in the library yet."""
    found = store.among(
        f"SELECT t.id, f.name, coalesce(t.retraction IN ({SET_ASIDE}), 0) "
        "FROM touches t JOIN files f ON f.id = t.file WHERE t.id IN (?)",
        sheet.ids,
    )
    images = store.images
    names = {name for _, name, _ in found}
    gone = {n for n in names if not file_path(images, n.hex()).is_file()}
    lost = {key for key, name, aside in found if aside or name in gone}
    sound = {key for key, _, _ in found} - lost
    new = {key: row for row, key in enumerate(sheet.ids) if key not in sound}
    if not new:
        return
    kept = sheet.picked(sorted(new.values())) if len(new) < len(sheet.ids) else sheet
    # What a file alone would not tell after a power cut is flushed with the row.
    flushed = bool(lost) or not leave_mark(store)
    name = publish(images, *kept.packed(), store.slots)
    with store.writing(flushed=flushed):
        late = (now := next_time(store)) > kept.added_s  # another changed names since
        if late and not store.count(_KNOWN, [bytes.fromhex(name)]):
            kept = replace(kept, added_s=now)
            file_path(images, name).unlink()  # no row will name it
            name = publish(images, *kept.packed(), store.slots)
        _rows.write_rows(store, kept, name, lost)


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
    for _, _, old, new in reversed(Names(store).known):
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
