"""Reading touches back: rows from the database, images from the files; their features.

Features are computed once and kept beside the library. That is a cache and nothing
more: it lies in `features/`, one folder per encoder and version, and may be deleted
at any time. Each file holds the ids of some touches and their features under the name
of its content; a damaged one is computed again.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from math import prod
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._types import Array, Floats, Indices
from ..touches import FORMER, Labelled, Touches
from . import _files, _rows
from ._files import Column, column_array, file_path, image_digest, packed, read_file
from ._rows import DTYPE, Numbers, StoredTouch, distinct, layouts, plain_values, rows_at
from ._store import FEATURES, IMAGES, LibraryError, Store, from_json, room_for
from ._where import COLUMNS

IN_MEMORY = 256 * 2**20
NO_LIMIT = 2**62
_FIX = "`palpate library check --repair` sets such touches aside and keeps the rest."
_TASKS_PER_FILE = 16
_ID = "S16"  # a last byte of zero is no matter among equals
Encode = Callable[[Touches], Floats]


def common_kind(store: Store, numbers: Numbers) -> tuple[tuple[int, ...], str]:
    """Return the shape and type of all images, or say what is mixed."""
    what = f"r.n_rows, r.n_cols, {COLUMNS['n_channels']}, {DTYPE}, r.whole"
    rows = distinct(store, what, numbers)
    found = sorted({(_rows.shape_of(*sides), dtype) for *sides, dtype, _ in rows})
    if not found:
        raise LibraryError(
            "The selection must hold at least one touch, got none. "
            "See `palpate library list`, and widen --where."
        )
    if len(found) > 1:
        kinds = "; ".join(f"{' x '.join(map(str, s))} {dtype}" for s, dtype in found)
        mixed = len({len(shape) for shape, _ in found}) > 1
        one = "n_channels is null" if mixed else f"n_rows = {found[0][0][0]}"
        raise LibraryError(
            f"Touches must have one image size and type, got {kinds}. Choose one with "
            f'--where, for example "sensor = NAME" or "{one}".'
        )
    wholes = [_entries(row[-1]) for row in rows]
    for name in ("channels", "pads"):
        if len({entries.get(name) for entries in wholes}) > 1:
            raise LibraryError(
                f"Touches must have the same {name}, got several. Choose those of one "
                'sensor or session with --where, for example "sensor = NAME".'
            )
    return found[0]


def read_touches(
    store: Store,
    numbers: Numbers,
    max_bytes: int = NO_LIMIT,
    in_memory: int = IN_MEMORY,
) -> Touches:
    """Return touches with all columns; beyond `in_memory` bytes in a mapped file."""
    size, dtype = common_kind(store, numbers)
    shape = (len(numbers), *size)
    n_bytes = prod(shape) * np.dtype(dtype).itemsize
    if n_bytes > max_bytes:
        raise LibraryError(
            f"Images of {len(numbers)} touches must take at most {max_bytes} bytes, "
            f"got {n_bytes}. Choose fewer with --where, or raise max_bytes."
        )
    if n_bytes > in_memory:
        scratch = store.folder if os.access(store.folder, os.W_OK) else None
        with tempfile.TemporaryFile(dir=scratch) as file:  # the mapping keeps it
            images: Array = np.memmap(file, dtype=dtype, mode="w+", shape=shape)
    else:
        images = np.empty(shape, dtype)
    columns = read_columns(store, numbers, images)
    return Touches(images, **columns, **read_whole(store, numbers))


def read_images(folder: Path, rows: Sequence[StoredTouch]) -> Array:
    """Return images, (n_touches, *image_shape), of files alone, digests checked."""
    # Touches that follow one another in one file are read at once.
    runs = groupby(enumerate(rows), lambda at: (at[1].file, at[1].number - at[0]))
    images = [_run_of_images(folder, [row for _, row in run]) for _, run in runs]
    return np.concatenate(images)


def with_images(store: Store, numbers: Numbers) -> Numbers:
    """Return the touches whose images are whole, and tell how many are left out."""
    whole = [is_whole(store, row) for rows in rows_at(store, numbers) for row in rows]
    if not all(whole):
        warnings.warn(
            f"{whole.count(False)} touches are left out: their images in "
            f"{store.folder} are missing or altered.",
            stacklevel=4,
        )
    return np.asarray(numbers[np.array(whole, bool)])


def is_whole(store: Store, row: StoredTouch) -> bool:
    try:
        read_images(store.folder, [row])
        if any(column.wide for column in layouts(store)[row.layout]):
            read_file(store.images, row.file.hex())
    except LibraryError:
        return False
    return True


def read_columns(
    store: Store, numbers: Numbers, images: Array | None = None
) -> dict[str, Array]:
    """Return columns and fill `images`; without these, none that stand in files."""
    used = {row[0] for row in distinct(store, "t.layout", numbers)}
    known = {key: layout for key, layout in layouts(store).items() if key in used}
    columns = _columns_of(known)
    if images is None:
        columns = {n: c for n, c in columns.items() if not any(o.wide for o in c)}
    wide = {
        key: [c.name for c in layout if c.wide and c.name in columns]
        for key, layout in known.items()
    }
    parts: dict[str, list[Array]] = {name: [] for name in columns}
    done = 0
    for rows in rows_at(store, numbers):
        if images is not None:
            images[done : done + len(rows)] = read_images(store.folder, rows)
            done += len(rows)
        values = plain_values(rows)
        sheets: dict[bytes, dict[str, Array]] = {}
        for row, value in zip(rows, values, strict=True):
            if wide[row.layout] and row.file not in sheets:
                arrays = read_file(store.images, row.file.hex())
                sheets[row.file] = _files.read_sheet(arrays).wide
            value |= {n: sheets[row.file][n][row.number] for n in wide[row.layout]}
        for name, alike in columns.items():
            cells = [value.get(name) for value in values]
            parts[name].append(column_array(alike, cells))
    return _labelled({name: _joined(arrays) for name, arrays in parts.items()})


def read_whole(store: Store, numbers: Numbers) -> dict[str, Array]:
    """Return what is the same for all touches; warn of files lost or altered."""
    rows = distinct(store, "r.geometry, r.whole", numbers)
    geometries = {row[0] for row in rows}
    if len(known := sorted(geometries - {None})) > 1:
        raise LibraryError(
            f"Touches must have one geometry, got {', '.join(known)}. Choose one with "
            '--where, for example "geometry = array".'
        )
    entries = [_entries(row[1]) for row in rows]
    same = {n: h for n, h in entries[0].items() if all(e.get(n) == h for e in entries)}
    read = {n: read_array(store, n, h) for n, h in same.items()}
    whole = {n: array for n, array in read.items() if array is not None}
    if len(geometries) == 1 and None not in geometries:
        whole["geometry"] = np.array(geometries.pop())
    return whole


def _entries(whole: str) -> dict[str, str]:
    """Return the names of files by what they hold, some under former names."""
    return {FORMER.get(n, n): file for n, file in from_json(whole).items()}


def read_array(store: Store, entry: str, name: str) -> Array | None:
    """Return an array of whole recordings, or warn and return None where it is lost."""
    folder = store.arrays
    path = file_path(folder, name)
    try:
        return read_file(folder, name)[0]
    except (LibraryError, IndexError) as error:
        warnings.warn(
            f"{error} Touches are read without their {entry}, {path.stem[:12]}; "
            "add them again to bring it back. `palpate library check` lists them.",
            stacklevel=2,
        )
        return None


def _run_of_images(folder: Path, run: list[StoredTouch]) -> Array:
    """Return neighbouring images of one file, each checked against its digest."""
    first = run[0]
    path = file_path(folder / IMAGES, first.file.hex())
    size, dtype = first.image_shape, np.dtype(first.dtype)
    start = first.offset + first.number * prod(size) * dtype.itemsize
    try:
        images = _files.read_values(path, start, (len(run), *size), dtype)
    except LibraryError as error:
        raise LibraryError(f"Touch {first.key.hex()}: {error} {_FIX}") from error
    for image, row in zip(images, run, strict=True):
        if image_digest(image) != row.digest:
            raise LibraryError(
                f"Touch {row.key.hex()}: its image in {path} must be as it was "
                f"added, got altered values. {_FIX}"
            )
    return images


def _columns_of(known: dict[int, list[Column]]) -> dict[str, list[Column]]:
    """Return all forms of each column; those of unlike shapes are refused."""
    columns: dict[str, list[Column]] = {}
    for column in (column for layout in known.values() for column in layout):
        alike = columns.setdefault(column.name, [])
        if alike and alike[0].shape != column.shape:
            raise LibraryError(
                f"Column {column.name!r} must have one shape, got {alike[0].shape} and "
                f"{column.shape} a row. Choose touches with --where."
            )
        alike.append(column)
    return columns


def _joined(arrays: list[Array]) -> Array:
    if len({array.dtype.kind == "U" for array in arrays}) > 1:
        arrays = [array.astype(np.str_) for array in arrays]
    return np.concatenate(arrays)


def _labelled(columns: dict[str, Array]) -> dict[str, Array]:
    """Refuse touches of which only some have an object."""
    for name in ("object", "category"):
        lacking = name in columns and (columns[name] == "").any()
        if lacking and name == "object" and (columns[name] != "").any():
            raise LibraryError(
                "Either all touches must have an object or none, got "
                f"{int((columns[name] == '').sum())} without. Leave those out with "
                '--where "object is not null".'
            )
        if lacking:
            del columns[name]
    return columns


class Selection(Labelled):
    """Touches of a library without their images, in the order added.

    Made by `TouchLibrary.select`; the library must stay open. What is added later is
    not in it.

    Attributes
    ----------
    columns : dict of ndarray
        Columns of short values, one row per touch.
    """

    def __init__(self, store: Store, numbers: Numbers) -> None:
        self._store, self._numbers = store, numbers
        common_kind(store, numbers)
        self._columns = read_columns(store, numbers)

    def __len__(self) -> int:
        return len(self._numbers)

    def __repr__(self) -> str:
        return f"<Selection: {len(self)} touches of {str(self._store.folder)!r}>"

    @property
    def touch_id(self) -> NDArray[np.str_]:
        """Id of each touch, shape (n_touches,): 32 hexadecimal digits."""
        return np.array([key.hex() for key in self._ids()])

    @property
    def whole(self) -> dict[str, Array]:
        """What describes all of the touches alike, by name; see `Touches`."""
        return read_whole(self._store, self._numbers)

    def __getitem__(self, rows: ArrayLike) -> Selection:
        """Pick touches by their places, which must rise; no image is read."""
        return Selection(self._store, self._picked(rows))

    def touches(self, rows: ArrayLike) -> Touches:
        """Read some of the touches, given by their places in the selection.

        Places must rise; each is read once.
        """
        return read_touches(self._store, self._picked(rows))

    def features(self, key: str, encode: Encode) -> Floats:
        """Return features of all touches, (n_touches, n_features).

        New touches are encoded 512 at a time through joblib, so that
        `joblib.parallel_config` decides where. Workers read the images themselves:
        the folder must be found under the same path wherever they run.

        Parameters
        ----------
        key : str
            Letters and digits that stand for the encoder and all it has learnt;
            features under one key are computed once and then read.
        encode : callable
            Makes features (n, n_features) of `Touches`; called for what is new.
        """
        if not key.isalnum():
            raise ValueError(f"key must be letters and digits, got {key!r}.")
        cache = self._store.folder / FEATURES / key
        ids = np.array(self._ids(), _ID)
        known_ids, known = _cached(cache)
        missing = np.flatnonzero(~np.isin(ids, known_ids))
        if len(missing):
            self._encode_new(cache, encode, missing, ids[missing])
            known_ids, known = _cached(cache)
        return known[np.searchsorted(known_ids, ids)]

    def _encode_new(
        self, cache: Path, encode: Encode, rows: Indices, ids: Array
    ) -> None:
        """Encode touches; what is done is kept now and then, should this be stopped."""
        from joblib import Parallel, delayed

        layout = {n: a for n, a in self.whole.items() if n in FORMER.values()}
        encode_some = partial(_encoded, self._store.folder, encode, layout)
        parts = Parallel(return_as="generator")(
            delayed(encode_some)(some)
            for some in rows_at(self._store, self._numbers[rows])
        )
        waiting: list[Floats] = []
        n_kept = n_done = 0
        for number, part in enumerate(parts, start=1):
            waiting.append(part)
            n_done += len(part)
            if number % _TASKS_PER_FILE == 0 or n_done == len(ids):
                plain = ids[n_kept:n_done].view(np.uint8).reshape(-1, 16)
                content = packed([plain, np.concatenate(waiting)])
                fix = "Free space; touches are not affected."
                with room_for("features", cache, fix):
                    cache.mkdir(parents=True, exist_ok=True)
                    _files.publish(cache, content)
                waiting, n_kept = [], n_done

    def _ids(self) -> list[bytes]:
        sql = "SELECT id FROM touches WHERE number IN (?) ORDER BY number"
        return [row[0] for row in self._store.among(sql, self._numbers.tolist())]

    def _picked(self, rows: ArrayLike) -> Numbers:
        places = np.asarray(rows)
        if places.ndim != 1 or (len(places) > 1 and (np.diff(places) <= 0).any()):
            raise LibraryError(
                "rows must be places in the selection that rise, got others. "
                "Sort them and drop those that come twice."
            )
        return np.asarray(self._numbers[places])


def _cached(cache: Path) -> tuple[Array, Floats]:
    """Return all ids in the cache, sorted, and their features."""
    ids, features = [np.empty(0, _ID)], []
    for path in sorted(cache.glob("*/*.npy")):
        try:
            some_ids, some = read_file(cache, path.stem)
        except (LibraryError, ValueError):
            path.unlink(missing_ok=True)
            continue
        ids.append(np.ascontiguousarray(some_ids).view(_ID).ravel())
        features.append(some)
    every = np.concatenate(ids)
    order = np.argsort(every, kind="stable")
    joined = np.concatenate(features) if features else np.empty((0, 0))
    return every[order], joined[order]


def _encoded(
    folder: Path, encode: Encode, layout: dict[str, Array], rows: list[StoredTouch]
) -> Floats:
    """Encode some touches; runs wherever joblib sends it, without the database."""
    touches = Touches(read_images(folder, rows), **layout)
    return np.asarray(encode(touches), dtype=np.float64)
