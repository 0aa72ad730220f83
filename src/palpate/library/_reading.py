"""Reading touches back: rows from the database, images from the files."""

import json
import os
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches
from ._database import Database
from ._errors import LibraryError
from ._files import ARRAYS, IMAGES, file_path, read_file, read_values
from ._query import FROM, chunks, distinct, id_bytes
from ._sheet import CELLS, Column, column_array, image_digest, read_sheet

IN_MEMORY = 256 * 2**20

_CELLS_SQL = ", ".join(
    "o.name" if name == "object" else f't."{name}"' for name in CELLS
)


class Place(NamedTuple):
    """Where the image of a touch stands."""

    key: bytes
    file: bytes
    offset: int
    place: int
    digest: bytes


class Shape(NamedTuple):
    """What all images of a selection have in common."""

    n_rows: int
    n_cols: int
    dtype: str


def common_shape(database: Database, numbers: NDArray[np.int64]) -> Shape:
    """Return the one size and type of all images, or say what is mixed."""
    found: dict[Shape, str] = {}
    for n_rows, n_cols, dtype, sensor in distinct(
        database, "r.n_rows, r.n_cols, r.dtype, r.sensor", numbers
    ):
        found.setdefault(Shape(n_rows, n_cols, dtype), str(sensor))
    if not found:
        raise LibraryError(
            "The selection must hold at least one touch, got none. "
            "See `palpate library list`, and widen --where."
        )
    if len(found) > 1:
        kinds = "; ".join(f"{s.n_rows} x {s.n_cols} {s.dtype}" for s in sorted(found))
        raise LibraryError(
            f"Touches must have one image size and type, got {kinds}. Choose one with "
            '--where, for example "sensor = NAME" or "n_rows = '
            f'{min(found).n_rows}".'
        )
    return next(iter(found))


def read_images(
    database: Database, folder: Path, numbers: NDArray[np.int64], shape: Shape
) -> NDArray[Any]:
    """Return images (n_touches, n_rows, n_cols); each is checked against its digest.

    Beyond `IN_MEMORY` bytes the array is mapped to a temporary file, so that the
    system may put its pages aside.
    """
    dtype = np.dtype(shape.dtype)
    images = _room((len(numbers), shape.n_rows, shape.n_cols), dtype, folder)
    done = 0
    for piece in chunks(numbers):
        some = images_at(folder, places_of(database, piece), shape)
        images[done : done + len(some)] = some
        done += len(some)
    return images


def images_at(folder: Path, places: list[Place], shape: Shape) -> NDArray[Any]:
    """Return images from their files alone, without the database."""
    dtype = np.dtype(shape.dtype)
    size = (shape.n_rows, shape.n_cols)
    n_bytes = shape.n_rows * shape.n_cols * dtype.itemsize
    blocks = []
    for run in _runs(places):
        path = file_path(folder / IMAGES, run[0].file.hex())
        blocks.append(_block(path, run[0], (len(run), *size), dtype, n_bytes, run))
    return np.concatenate(blocks)


def read_touches(
    database: Database, folder: Path, numbers: NDArray[np.int64], max_bytes: int
) -> Touches:
    """Return touches with all their columns; see `TouchLibrary.touches`."""
    shape = common_shape(database, numbers)
    dtype = np.dtype(shape.dtype)
    n_bytes = len(numbers) * shape.n_rows * shape.n_cols * dtype.itemsize
    if n_bytes > max_bytes:
        raise LibraryError(
            f"Images of {len(numbers)} touches must take at most {max_bytes} bytes, "
            f"got {n_bytes}. Choose fewer with --where, or raise max_bytes."
        )
    images = read_images(database, folder, numbers, shape)
    columns = read_columns(database, folder, numbers)
    return Touches(images, **columns, **read_whole(database, folder, numbers))


def read_columns(
    database: Database, folder: Path, numbers: NDArray[np.int64], *, wide: bool = True
) -> dict[str, NDArray[Any]]:
    """Return the columns of touches, one row each."""
    layouts = _layouts(database, numbers)
    columns = _columns_of(layouts)
    if not wide:
        columns = {n: c for n, c in columns.items() if not any(o.wide for o in c)}
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in columns}
    for piece in chunks(numbers):
        cells = _cells(database, folder, piece, columns, layouts)
        for name, alike in columns.items():
            parts[name].append(column_array(alike, cells[name]))
    joined = {name: _joined(arrays) for name, arrays in parts.items()}
    return _labelled(joined)


def read_whole(
    database: Database, folder: Path, numbers: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Return what is the same for all touches: geometry, no-contact image and more.

    Entries that differ between recordings are left out, and, with a warning, those
    whose file is missing or altered.
    """
    rows = distinct(database, "r.geometry, r.whole", numbers)
    geometries = {row[0] for row in rows}
    if len(geometries - {None}) > 1:
        raise LibraryError(
            "Touches must have one geometry, got "
            f"{', '.join(sorted(geometries - {None}))}. Choose one with --where, for "
            'example "geometry = array".'
        )
    entries = [json.loads(row[1]) for row in rows]
    same = {n: h for n, h in entries[0].items() if all(e.get(n) == h for e in entries)}
    read = {n: read_array(folder, n, h) for n, h in same.items()}
    whole = {n: array for n, array in read.items() if array is not None}
    if len(geometries) == 1 and None not in geometries:
        whole["geometry"] = np.array(geometries.pop())
    return whole


def read_array(folder: Path, entry: str, name: str) -> NDArray[Any] | None:
    """Return an array of whole recordings, or warn and return None where it is lost."""
    path = file_path(folder / ARRAYS, name)
    try:
        return read_file(folder / ARRAYS, name)[0]
    except (LibraryError, IndexError) as error:
        warnings.warn(
            f"{error} Touches are read without their {entry}, {path.stem[:12]}; "
            "add them again to bring it back. `palpate library check` lists them.",
            stacklevel=2,
        )
        return None


def read_one_image(database: Database, folder: Path, key: str) -> NDArray[Any]:
    """Return the image of one touch, checked against its digest."""
    row = database.one(
        "SELECT t.id, f.name, f.offset, t.place, t.image, r.n_rows, r.n_cols, r.dtype "
        f"{FROM} JOIN files f ON f.id = t.file WHERE t.id = ?",
        [id_bytes(key)],
    )
    if row is None:
        raise LibraryError(
            f"id must be that of a touch in the library, got {key!r}. "
            "See `palpate library list`."
        )
    place, (n_rows, n_cols, dtype) = Place(*row[:5]), row[5:]
    plain = np.dtype(dtype)
    path = file_path(folder / IMAGES, place.file.hex())
    n_bytes = n_rows * n_cols * plain.itemsize
    block = _block(path, place, (1, n_rows, n_cols), plain, n_bytes, [place])
    image: NDArray[Any] = block[0]
    return image


def _block(
    path: Path,
    first: Place,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    n_bytes: int,
    run: Sequence[Place],
) -> NDArray[Any]:
    """Return neighbouring images of one file, each checked against its digest."""
    try:
        block = read_values(path, first.offset + first.place * n_bytes, shape, dtype)
    except LibraryError as error:
        raise LibraryError(f"Touch {first.key.hex()}: {error} {_FIX}") from error
    for image, place in zip(block, run, strict=True):
        if image_digest(image) != place.digest:
            raise LibraryError(
                f"Touch {place.key.hex()}: its image in {path} must be as it was "
                f"added, got altered values. {_FIX}"
            )
    return block


_FIX = "`palpate library check --repair` sets such touches aside and keeps the rest."


def places_of(database: Database, numbers: list[int]) -> list[Place]:
    """Return where the images of at most `AT_ONCE` touches stand."""
    marks = ", ".join("?" * len(numbers))
    rows = database.rows(
        "SELECT t.id, f.name, f.offset, t.place, t.image FROM touches t "
        f"JOIN files f ON f.id = t.file WHERE t.number IN ({marks}) ORDER BY t.number",
        numbers,
    )
    return [Place(*row) for row in rows]


def _runs(places: list[Place]) -> Iterator[list[Place]]:
    """Group places that follow one another in one file."""
    run: list[Place] = []
    for place in places:
        if run and (place.file, place.place) != (run[-1].file, run[-1].place + 1):
            yield run
            run = []
        run.append(place)
    if run:
        yield run


def _room(shape: tuple[int, ...], dtype: np.dtype[Any], folder: Path) -> NDArray[Any]:
    if int(np.prod(shape)) * dtype.itemsize <= IN_MEMORY:
        return np.empty(shape, dtype)
    scratch = folder if os.access(folder, os.W_OK) else None
    with tempfile.TemporaryFile(dir=scratch) as file:  # the mapping keeps it
        return np.memmap(file, dtype=dtype, mode="w+", shape=shape)


def _layouts(database: Database, numbers: NDArray[np.int64]) -> dict[int, list[Column]]:
    used = {row[0] for row in distinct(database, "t.layout", numbers)}
    return {
        key: [Column(n, d, tuple(s), bool(w)) for n, d, s, w in json.loads(text)]
        for key, text in database.rows("SELECT id, columns FROM layouts ORDER BY id")
        if key in used
    }


def _columns_of(layouts: dict[int, list[Column]]) -> dict[str, list[Column]]:
    """Return all forms of each column; those of unlike shapes are refused."""
    columns: dict[str, list[Column]] = {}
    for layout in layouts.values():
        for column in layout:
            alike = columns.setdefault(column.name, [])
            if alike and alike[0].shape != column.shape:
                raise LibraryError(
                    f"Column {column.name!r} must have one shape, got "
                    f"{alike[0].shape} and {column.shape} a row. Choose touches with "
                    "--where."
                )
            alike.append(column)
    return columns


def _cells(
    database: Database,
    folder: Path,
    numbers: list[int],
    columns: dict[str, list[Column]],
    layouts: dict[int, list[Column]],
) -> dict[str, list[Any]]:
    """Return the cells of some touches by column; None where there is none."""
    marks = ", ".join("?" * len(numbers))
    rows = database.rows(
        f"SELECT {_CELLS_SQL}, t.extra, t.layout, f.name, t.place {FROM} "
        f"JOIN files f ON f.id = t.file WHERE t.number IN ({marks}) ORDER BY t.number",
        numbers,
    )
    wide_names = {
        key: [c.name for c in layout if c.wide and c.name in columns]
        for key, layout in layouts.items()
    }
    cells: dict[str, list[Any]] = {name: [] for name in columns}
    sheets: dict[bytes, Any] = {}
    for *known, extra, layout, file, place in rows:
        values = dict(zip(CELLS, known, strict=True))
        if extra is not None:
            values |= json.loads(extra)
        if wide_names[layout]:
            if file not in sheets:
                sheets[file] = read_sheet(read_file(folder / IMAGES, file.hex()))
            values |= {n: sheets[file].wide[n][place] for n in wide_names[layout]}
        for name, column in cells.items():
            column.append(values.get(name))
    return cells


def _joined(arrays: list[NDArray[Any]]) -> NDArray[Any]:
    if len({array.dtype.kind == "U" for array in arrays}) > 1:
        arrays = [array.astype(np.str_) for array in arrays]
    return np.concatenate(arrays)


def _labelled(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
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
