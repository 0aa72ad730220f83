"""What is known of touches, objects and sensors, found without reading an image."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from .._checks import check_option, check_positive
from ..touches import GEOMETRIES
from ._rows import FROM, Numbers, layouts, read_rows, shape_of, without_damaged
from ._store import ARRAYS, FEATURES, FILE_NAME, IMAGES, Store
from ._where import Condition, parse_where


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

    `time_s` is the touch's own time, `added_s` when it was added (both seconds; the
    latter since 1970), `force_n` in newtons; `n_channels` is None where images have no
    axis of channels; `reason` says why it is retracted.
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


def list_touches(
    store: Store,
    where: str | None,
    limit: int | None,
    offset: int,
    retracted: bool,
    damaged: str,
) -> list[TouchRow]:
    """Return what is known of touches, newest last, without reading an image."""
    some = [-1 if limit is None else limit, offset]
    if where is None and damaged == "raise":  # rows that are not shown are no matter
        sql, values = condition(store, None, "unseen", retracted=retracted)
        query = (
            f"SELECT number FROM touches t WHERE {sql} ORDER BY number LIMIT ? OFFSET ?"
        )
        found = store.rows(query, some)
        page = bool(found) and len(found) == limit
        ends = (found[-1][0], found[0][0] if offset else 1) if page else ()
        without_damaged(store, damaged, *ends)
    else:
        sql, values = condition(store, where, damaged, retracted=retracted)
    some = [*values, *some]
    tail = f"WHERE {sql} ORDER BY t.number LIMIT ? OFFSET ?"
    rows = read_rows(store, TouchRow._fields, tail, some)
    return [TouchRow._make((*known, bool(gone), why)) for *known, gone, why in rows]


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
    """Return how much there is, in touches and in bytes."""
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
        _bytes_below(store.folder / IMAGES) + _bytes_below(store.folder / ARRAYS),
        _bytes_below(store.folder / FEATURES),
    )


def _bytes_below(folder: Path) -> int:
    return sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())
