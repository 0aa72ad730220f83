"""Reading touches back: rows from the database, images from the files."""

import os
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from itertools import groupby
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from .._types import Array
from ..touches import FORMER, Touches
from ._array_files import file_path, read_file, read_values
from ._rows import (
    DTYPE,
    Numbers,
    StoredTouch,
    distinct,
    layouts,
    plain_values,
    rows_at,
    shape_of,
)
from ._sheet import Column, column_array, image_digest, read_sheet
from ._store import ARRAYS, IMAGES, LibraryError, Store, from_json
from ._where import COLUMNS

IN_MEMORY = 256 * 2**20
NO_LIMIT = 2**62
_FIX = "`palpate library check --repair` sets such touches aside and keeps the rest."


def common_kind(store: Store, numbers: Numbers) -> tuple[tuple[int, ...], str]:
    """Return the shape and type of all images, or say what is mixed."""
    what = f"r.n_rows, r.n_cols, {COLUMNS['n_channels']}, {DTYPE}, r.whole"
    rows = distinct(store, what, numbers)
    found = sorted({(shape_of(*sides), dtype) for *sides, dtype, _ in rows})
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
    mapped = n_bytes > in_memory
    images = _mapped(shape, dtype, store.folder) if mapped else np.empty(shape, dtype)
    columns = read_columns(store, numbers, images)
    return Touches(images, **columns, **read_whole(store, numbers))


def read_images(folder: Path, rows: Sequence[StoredTouch]) -> Array:
    """Return images, (n_touches, *image_shape), of files alone, digests checked."""
    return np.concatenate([_run_of_images(folder, run) for run in _runs(rows)])


def with_images(store: Store, numbers: Numbers) -> Numbers:
    """Return the touches whose images are whole, and tell how many are left out."""
    whole = [is_whole(store, row) for rows in rows_at(store, numbers) for row in rows]
    if not all(whole):
        warnings.warn(
            f"{whole.count(False)} touches are left out: their images in "
            f"{store.folder} are missing or altered.",
            stacklevel=3,
        )
    some: Numbers = numbers[np.array(whole, bool)]
    return some


def is_whole(store: Store, row: StoredTouch) -> bool:
    """Tell whether the image of a touch, and its wide columns, can be read."""
    try:
        read_images(store.folder, [row])
        if any(column.wide for column in layouts(store)[row.layout]):
            read_file(store.folder / IMAGES, row.file.hex())
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
        if any(wide.values()):
            _add_wide(store, rows, wide, values)
        for name, alike in columns.items():
            cells = [value.get(name) for value in values]
            parts[name].append(column_array(alike, cells))
    return _labelled({name: _joined(arrays) for name, arrays in parts.items()})


def read_whole(store: Store, numbers: Numbers) -> dict[str, Array]:
    """Return what is the same for all touches; warn of files lost or altered."""
    rows = distinct(store, "r.geometry, r.whole", numbers)
    geometries = {row[0] for row in rows}
    if len(geometries - {None}) > 1:
        raise LibraryError(
            "Touches must have one geometry, got "
            f"{', '.join(sorted(geometries - {None}))}. Choose one with --where, for "
            'example "geometry = array".'
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
    folder = store.folder / ARRAYS
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


def _mapped(shape: tuple[int, ...], dtype: str, folder: Path) -> Array:
    scratch = folder if os.access(folder, os.W_OK) else None
    with tempfile.TemporaryFile(dir=scratch) as file:  # the mapping keeps it
        return np.memmap(file, dtype=dtype, mode="w+", shape=shape)


def _runs(rows: Sequence[StoredTouch]) -> Iterator[list[StoredTouch]]:
    """Group touches that follow one another in one file."""
    pairs = enumerate(rows)
    for _, run in groupby(pairs, lambda pair: (pair[1].file, pair[1].number - pair[0])):
        yield [row for _, row in run]


def _run_of_images(folder: Path, run: list[StoredTouch]) -> Array:
    """Return neighbouring images of one file, each checked against its digest."""
    first = run[0]
    path = file_path(folder / IMAGES, first.file.hex())
    size, dtype = first.image_shape, np.dtype(first.dtype)
    start = first.offset + first.number * prod(size) * dtype.itemsize
    try:
        images = read_values(path, start, (len(run), *size), dtype)
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


def _add_wide(
    store: Store,
    rows: list[StoredTouch],
    names: dict[int, list[str]],
    values: list[dict[str, Any]],
) -> None:
    """Add the wide values of each touch, by `names` of its layout, from its file."""
    wide: dict[bytes, dict[str, Array]] = {}
    for row, value in zip(rows, values, strict=True):
        if names[row.layout] and row.file not in wide:
            arrays = read_file(store.folder / IMAGES, row.file.hex())
            wide[row.file] = read_sheet(arrays).wide
        value |= {n: wide[row.file][n][row.number] for n in names[row.layout]}


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
