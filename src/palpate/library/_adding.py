"""Touches added to a library, and what is known of them without reading an image.

Touches that come back changed, renamed since or read from an export, are known again. A
touch's id follows from what it was called when it was first added. An export calls it
by its object's present name, and fills cells that only some touches have; so the ids
that it may have had before are looked for as well.
"""

import time
from collections.abc import Iterator
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from .._checks import check_option, check_positive
from .._parallel import Progress
from .._types import GEOMETRIES
from ..touches import Touches
from ._changes import Names, find_object
from ._content import (
    IDENTITY,
    Column,
    earlier_cell,
    identity,
    image_digest,
    packed_rows,
    packs_well,
    plain_cells,
    runs_alike,
    stored_image,
    wide_identities,
)
from ._rows import (
    FROM,
    Batch,
    Recording,
    Tables,
    enter_array,
    new_rows,
    plain_values,
    write_rows,
)
from ._store import (
    FEATURES,
    FILE_NAME,
    LibraryError,
    Store,
)
from ._where import Condition, parse_where

_TOUCHES_AT_ONCE = 256  # in one transaction
_BYTES_AT_ONCE = 32 * 2**20  # of images in it
_LAYOUTS = "SELECT id FROM layouts ORDER BY id"


class SensorDescription(NamedTuple):
    """The sensor that took some touches, as far as it is known.

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
        sides = self.n_rows, self.n_cols, self.n_channels
        return tuple(n for n in sides if n is not None)


class Stats(NamedTuple):
    """Counts and sizes of a library; bytes, images among those of the database.

    Objects and sessions are those of touches that are not retracted.
    """

    n_touches: int
    n_retracted: int
    n_objects: int
    n_sessions: int
    n_changes: int
    database_bytes: int
    feature_bytes: int


def condition(
    tables: Tables, where: str | None, *, retracted: bool = False
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
    layouts = [tables.layout(key) for (key,) in tables.store.rows(_LAYOUTS)]
    extra = {column.name for layout in layouts for column in layout if not column.wide}
    parsed = parse_where(where, extra)
    return Condition(f"{kept} AND {parsed.sql}", parsed.values)


def list_objects(store: Store) -> list[ObjectRow]:
    """Return objects with touches by name; a category may be of one merged into it."""
    rows = store.rows(
        "WITH given AS (SELECT object, session, episode, count(*) AS n, "
        "min(iif(category IS NULL, NULL, number)) AS first FROM touches "
        "WHERE retraction IS NULL GROUP BY object, session, episode), "
        "visits AS (SELECT coalesce(o.merged_into, o.id) AS key, sum(n) AS n, "
        # The category first given to the object itself counts before those of others.
        "min(iif(o.merged_into IS NULL, first, NULL)) AS own, min(first) AS first "
        "FROM given JOIN objects o ON o.id = object GROUP BY key, session, episode), "
        "sums AS (SELECT key, coalesce(min(own), min(first)) AS first, sum(n) AS n, "
        "count(*) AS n_visits FROM visits GROUP BY key) "
        "SELECT o.name, t.category, n, n_visits FROM sums "
        "JOIN objects o ON o.id = key LEFT JOIN touches t ON t.number = first "
        "ORDER BY o.name"
    )
    return [ObjectRow(*row) for row in rows]


def stats_of(store: Store) -> Stats:
    [row] = store.rows(
        "SELECT count(*), count(retraction), (SELECT count(*) FROM changes), "
        "count(DISTINCT iif(retraction IS NULL, nullif(session, ''), NULL)) "
        "FROM touches"
    )
    n_touches, n_retracted, n_changes, n_sessions = row
    files = store.folder.glob(f"{FILE_NAME}*")
    features = (store.folder / FEATURES).rglob("*")
    return Stats(
        n_touches - n_retracted,
        n_retracted,
        len(list_objects(store)),
        n_sessions,
        n_changes,
        sum(path.stat().st_size for path in files),
        sum(path.stat().st_size for path in features if path.is_file()),
    )


def add_touches(
    store: Store,
    touches: Touches,
    sensor: SensorDescription | None,
    progress: bool | None,
) -> list[str]:
    """Store touches and return their ids, in their order; see `TouchLibrary.add`."""
    ids: list[str] = []
    n_bytes = max(1, touches.images[0].nbytes)
    step = max(1, min(_TOUCHES_AT_ONCE, _BYTES_AT_ONCE // n_bytes))
    recording = _recording(touches, sensor)
    try:
        with Progress(len(touches), "Adding touches", progress) as bar:
            for start in range(0, len(touches), step):
                part = touches[start : start + step]
                batches = [_batch(alike, recording) for alike in runs_alike(part)]
                keys = store.write(partial(_store_batches, store, batches))
                ids += [key.hex() for key in keys]
                bar.advance(len(part))
    except LibraryError as error:
        if not ids:
            raise
        raise type(error)(
            f"{error} {len(ids)} of {len(touches)} touches are stored; add them all "
            "again, none is stored twice."
        ) from error
    return ids


def _recording(touches: Touches, sensor: SensorDescription | None) -> Recording:
    """Return what is the same for all of `touches`, but for arrays."""
    name, kind, unit, pitch_mm, _ = sensor or SensorDescription("")
    pitch_mm = None if pitch_mm is None else float(pitch_mm)
    described = name or None, kind, unit, pitch_mm, touches.geometry
    images = touches.images
    return Recording(b"", *described, images.shape[1:], images.dtype, {})


def _batch(touches: Touches, recording: Recording) -> Batch:
    """Return touches ready to be stored, each with its id."""
    layout, values, wide = [], {}, {}
    for name, array in touches.columns.items():
        column = Column.of(name, array)
        layout.append(column)
        if column.wide:
            wide[name] = np.ascontiguousarray(array)
        else:
            values[name] = plain_cells(name, array)
    images = np.ascontiguousarray(touches.images)
    files = [None] * len(images) if touches.files is None else touches.files
    packs = touches.files is None and packs_well(images[0])
    stored = [
        stored_image(image, file, packed_rows(wide, place), packs=packs)
        for place, (image, file) in enumerate(zip(images, files, strict=True))
    ]
    each = range(len(images))
    plain = [{name: cells[row] for name, cells in values.items()} for row in each]
    digests = [image_digest(image) for image in images]
    rows = new_rows(layout, plain, digests, stored, time.time())
    arrays = {n: a for n, a in touches.whole.items() if n != "geometry"}
    keys = {n: image_digest(array) for n, array in arrays.items()}
    recording = recording._replace(whole={n: key.hex() for n, key in keys.items()})
    return Batch(
        layout, recording, {keys[n]: a for n, a in arrays.items()}, rows, stored
    )


def _store_batches(store: Store, batches: list[Batch]) -> list[bytes]:
    return [key for batch in batches for key in _store_batch(store, batch)]


def _store_batch(store: Store, batch: Batch) -> list[bytes]:
    """Store touches that are not in the library yet, within a job; return all ids."""
    _refuse_other_channels(store, batch.recording)
    for digest, array in batch.arrays.items():
        enter_array(store, digest, array)  # it may have been lost meanwhile
    ids = _matched(store, batch)
    sql = "SELECT id FROM touches WHERE id IN (?)"
    stored = {row[0] for row in store.among(sql, ids)}
    new = {key: place for place, key in enumerate(ids) if key not in stored}
    if new:
        kept = batch if len(new) == len(ids) else batch.picked(sorted(new.values()))
        write_rows(store, kept)
    return ids


def _refuse_other_channels(store: Store, recording: Recording) -> None:
    """Refuse grey touches of a sensor that gave colour before, and the reverse."""
    sensor, now = recording.sensor, [*recording.image_shape[2:], None][0]
    sql = "SELECT n_channels FROM recordings WHERE sensor = ? LIMIT 1"
    before = store.first_row(sql, [sensor]) if sensor else None
    if before is not None and before[0] != now:
        was, got = (f"{n or 'no'} channels" for n in (before[0], now))
        raise LibraryError(
            f"Images of sensor {sensor!r} must have {was} like those in the "
            f"library, got {got}. Convert them, give the sensor another name, or use "
            "another library."
        )


def _matched(store: Store, batch: Batch) -> list[bytes]:
    """Return the ids of touches, those under which they are stored already.

    A touch is another's return when the image is the same, all that tells touches apart
    too but for former names and cells that were empty or numbers, and both have one
    name.
    """
    labels = {row.label for row in batch.rows}
    present = {label: find_object(store, label) for label in labels}
    now = {name: match[1] if match else name for name, match in present.items()}
    names = Names(store)
    ids = [row.key for row in batch.rows]
    maybe: dict[bytes, tuple[bytes, str | None]] = {}
    parts = wide_identities(batch.layout, [image.more for image in batch.images])
    values = plain_values(batch.rows)
    for row, cells, wide in zip(batch.rows, values, parts, strict=True):
        called = [row.label, now[row.label], *names.former(now[row.label])]
        for earlier in _earlier(cells, list(dict.fromkeys(called))):
            key = identity(row.image, earlier, wide)
            if key != row.key:
                maybe.setdefault(key, (row.key, now[row.label]))
    if not maybe:
        return ids
    sql = f"SELECT t.id, o.name {FROM} WHERE t.id IN (?)"
    there = {key for key, _ in store.among(sql, ids)}
    before = {
        maybe[key][0]: key
        for key, name in store.among(sql, list(maybe))
        if maybe[key][0] not in there and maybe[key][1] == name
    }
    return [before.get(key, key) for key in ids]


def _earlier(
    values: dict[str, Any], names: list[str | None]
) -> Iterator[dict[str, Any]]:
    """Return what may have set a touch apart from others when it was first added."""
    now = {n: values[n] for n in IDENTITY if values.get(n) is not None}
    pairs = {name: (cell, earlier_cell(cell)) for name, cell in now.items()}
    forms = [
        names if name == "object" else [cell, *[before] * (before != cell)]
        for name, (cell, before) in pairs.items()
    ]
    if any(len(form) > 1 for form in forms):
        for cells in product(*forms):
            yield {**values, **dict(zip(now, cells, strict=True))}
