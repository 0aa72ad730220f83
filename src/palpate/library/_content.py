"""The parts of a touch in the database: cells, and bytes for longer values.

Short values (numbers and text, at most `WIDE` numbers a touch) are cells; longer ones
(a press as thirty frames) are bytes beside the image. Images are kept without loss: a
picture that came as JPEG or PNG as the bytes it came in, others as their values, packed
by Zstandard where that halves them.

A touch's id follows from its image and what tells touches apart. Its row carries the
SHA-256 of the image (`image`), of a picture's file and of wide columns (`content`), and
of all of the row's values (`digest`).
"""

import hashlib
import io
import json
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import pairwise
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.lib import format as npy

from .._types import PLAIN_KINDS, RGB, Array
from ..touches import Touches, TouchesError, decode_bytes
from ._store import LibraryError, from_json

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_LEVEL = 1  # of Zstandard: the fastest
_ID_BYTES = 16  # of SHA-256: two touches of 10^12 share one in 10^14
MAX_HEADER = 2**14  # bytes of a .npy header; ours have 128
_MAX_ARRAY = 2**30  # bytes of an array in the database
# What stands for values that lack, of a kind; else NaN.
_NOTHING = {"U": "", "S": b"", "M": np.datetime64("NaT"), "m": np.timedelta64("NaT")}
PICTURE = "picture"  # a form of images: the file it came in
_PLAIN, _PACKED = "plain", "packed"
WIDE = 16  # values; longer columns stand beside the row
CELLS: tuple[str, ...] = (
    *("object", "category", "session", "episode", "sensor", "order"),
    *("time_s", "force_n", "press", "frame", "source_path"),
)
# What tells two touches with the same image apart: an id follows from these.
IDENTITY = (
    *("object", "session", "episode", "sensor", "order", "time_s", "force_n"),
    *("press", "frame", "position_mm", "position_raw"),
)
_CANONICAL = json.JSONEncoder(
    sort_keys=True, separators=(",", ":"), allow_nan=False, check_circular=False
)


class Column(NamedTuple):
    """One column of some touches: its type, the shape of a row, and where it is."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    wide: bool

    @classmethod
    def of(cls, name: str, array: Array) -> "Column":
        """Return the column that an array of one row per touch is."""
        return cls(name, array.dtype.str, array.shape[1:], not _fits_cells(array))

    @classmethod
    def all_of(cls, text: str) -> "list[Column]":
        """Return columns from JSON; ValueError or TypeError where it holds others."""
        columns = [cls(n, d, tuple(s), bool(w)) for n, d, s, w in from_json(text)]
        for column in columns:
            if not isinstance(column.name, str) or np.dtype(column.dtype).hasobject:
                raise ValueError(f"a column of {column.dtype}")
            prod(column.shape)
        return columns


class Image(NamedTuple):
    """An image as it is stored: its form, its bytes, and those of wide columns."""

    form: str
    data: bytes
    more: bytes | None

    def digest(self) -> bytes:
        """Return the SHA-256 that a touch's row has as `content`.

        A picture may be decoded to slightly other levels one day: its file counts.
        """
        digest = hashlib.sha256(self.form.encode() + b"\0")
        if self.form == PICTURE:
            digest.update(self.data)
        if self.more is not None:
            digest.update(b"\0" + hashlib.sha256(self.more).digest())
        return digest.digest()


def image_digest(image: Array) -> bytes:
    """Return the SHA-256 of an array: its type, its shape and its values."""
    digest = hashlib.sha256(f"{image.dtype.str} {image.shape}".encode())
    is_time = image.dtype.kind in "Mm"  # which Python's buffers do not know
    digest.update(image.tobytes() if is_time else np.ascontiguousarray(image).data)
    return digest.digest()


def identity(digest: bytes, cells: dict[str, Any], wide: bytes) -> bytes:
    """Return the id of a touch: of its image, plain `cells`, and of `wide` columns."""
    plain = {n: cells[n] for n in IDENTITY if n in cells}
    whole = {n: whole_numbers(c) for n, c in plain.items() if c is not None}
    content = digest + b"\0" + canonical(whole).encode() + wide
    return hashlib.sha256(content).digest()[:_ID_BYTES]


def wide_identities(
    layout: Sequence[Column], parts: Sequence[bytes | None]
) -> list[bytes]:
    """Return what wide columns, packed, add to what the id of each touch follows from.

    Mostly nothing: what tells touches apart fits into cells.
    """
    wide = {column.name for column in layout if column.wide}
    names = [name for name in IDENTITY if name in wide]
    if not names:
        return [b""] * len(parts)
    pieces = []
    for more in parts:
        rows = unpacked_rows(more, layout)
        pieces.append(b"".join(b"\0" + n.encode() + rows[n].tobytes() for n in names))
    return pieces


def whole_numbers(cell: Any) -> Any:
    """Write 3.0 as 3, so that the type of a column does not tell touches apart."""
    if isinstance(cell, list):
        return [whole_numbers(item) for item in cell]
    return int(cell) if isinstance(cell, float) and cell.is_integer() else cell


def canonical(value: Any) -> str:
    """Return `value` as JSON that is the same whenever the value is."""
    return _CANONICAL.encode(value)


def id_bytes(key: str) -> bytes:
    try:
        return bytes.fromhex(key)
    except (ValueError, TypeError) as error:
        raise LibraryError(
            f"id must be 32 hexadecimal digits as `add` returns them, got {key!r}."
        ) from error


def digest_of(values: Iterable[Any]) -> bytes:
    """Return the SHA-256 of the values of a row as Python writes them in a tuple."""
    return hashlib.sha256(repr(tuple(values)).encode()).digest()


def packs_well(image: Array) -> bool:
    """Tell whether packing halves an image; for others it costs more than it saves."""
    plain = image.tobytes()
    return 2 * len(zstd.compress(plain, _LEVEL)) < len(plain)


def stored_image(
    image: Array, file: bytes | None, more: bytes | None, *, packs: bool
) -> Image:
    """Return an image as it is stored: its file, or its values, packed or plain."""
    if file is not None:
        return Image(PICTURE, file, more)
    plain = image.tobytes()
    if packs:
        return Image(_PACKED, zstd.compress(plain, _LEVEL), more)
    return Image(_PLAIN, plain, more)


def unpacked_image(
    stored: Image, shape: tuple[int, ...], dtype: np.dtype[Any]
) -> Array:
    """Return an image, or LibraryError where its bytes are not those of one."""
    if stored.form == PICTURE:
        pixels = prod(shape[:2])
        colour = shape[2:] == (len(RGB),)
        try:
            levels = decode_bytes(stored.data, max_pixels=pixels, colour=colour)
        except TouchesError as error:
            raise LibraryError(str(error)) from error
        if levels.shape != shape or levels.dtype != dtype:
            raise LibraryError("A picture must have the size and type of its row.")
        return levels
    n_bytes = prod(shape) * dtype.itemsize
    data = stored.data
    if stored.form != _PLAIN:
        data = _unpacked(data, n_bytes)
    if len(data) != n_bytes:
        raise LibraryError(f"An image must have {n_bytes} bytes, got {len(data)}.")
    return np.frombuffer(data, dtype).reshape(shape)


def packed_rows(wide: dict[str, Array], row: int) -> bytes | None:
    """Return one touch's row of wide columns as bytes, or None without any."""
    if not wide:
        return None
    data = b"".join(array[row : row + 1].tobytes() for array in wide.values())
    return zstd.compress(data, _LEVEL)


def unpacked_rows(more: bytes | None, layout: Sequence[Column]) -> dict[str, Array]:
    """Return one touch's row of each wide column."""
    columns = [column for column in layout if column.wide]
    dtypes = [np.dtype(column.dtype) for column in columns]
    sizes = [prod(c.shape) * d.itemsize for c, d in zip(columns, dtypes, strict=True)]
    data = _unpacked(more or b"", sum(sizes))
    rows, start = {}, 0
    for column, dtype, size in zip(columns, dtypes, sizes, strict=True):
        row = np.frombuffer(data[start : start + size], dtype)
        rows[column.name] = row.reshape(column.shape)
        start += size
    return rows


def packed_array(array: Array) -> bytes:
    """Return an array of a whole recording, with its type and shape, packed."""
    if array.dtype.kind not in PLAIN_KINDS:
        raise ValueError(f"dtype must be of plain values, got {array.dtype}.")
    stream = io.BytesIO()
    npy.write_array(stream, np.asarray(array), allow_pickle=False)
    return zstd.compress(stream.getvalue(), _LEVEL)


def unpacked_array(data: bytes) -> Array:
    """Return what `packed_array` packed; LibraryError where it is none."""
    stream = io.BytesIO(_unpacked(data, None))
    try:
        array: Array = npy.read_array(
            stream, allow_pickle=False, max_header_size=MAX_HEADER
        )
    except Exception as error:  # the header is a literal: it fails in many ways
        raise LibraryError(f"An array must be whole, got: {error}.") from error
    return array


def _unpacked(data: bytes, n_bytes: int | None) -> bytes:
    """Return what was packed, never more than `n_bytes` and one."""
    most = (_MAX_ARRAY if n_bytes is None else n_bytes) + 1
    try:
        unpacked = zstd.ZstdDecompressor().decompress(data, most)
    except (zstd.ZstdError, TypeError) as error:
        raise LibraryError(f"Packed bytes must be whole, got: {error}.") from error
    if len(unpacked) == most or (n_bytes is not None and len(unpacked) != n_bytes):
        raise LibraryError(f"Packed bytes must be {n_bytes} unpacked, got others.")
    return unpacked


def column_array(columns: Sequence[Column], cells: Sequence[Any]) -> Array:
    """Return cells as one array; None is NaN, NaT or empty.

    Numbers among text become text.
    """
    dtypes = {np.dtype(column.dtype) for column in columns}
    is_text = any(dtype.kind == "U" for dtype in dtypes)
    if any(cell is None for cell in cells):
        kind = "U" if is_text else np.dtype(columns[0].dtype).kind
        blank: Any = np.full(columns[0].shape, _NOTHING.get(kind, np.nan))
        blank = blank if kind in "Mm" else blank.tolist()
        cells = [blank if cell is None else cell for cell in cells]
    if is_text:
        return np.array(cells, dtype=np.str_)
    array = np.array(cells)
    dtype = np.result_type(*dtypes)
    if array.dtype.kind == "O" and dtype.kind in "biuf":  # None in vectors
        array = array.astype(np.float64)
    lacks = array.dtype.kind == "f" and np.isnan(array).any()
    if lacks and dtype.kind in "biu":
        dtype = np.result_type(dtype, np.float16)
    return array.astype(dtype)


def _fits_cells(array: Array) -> bool:
    kind, n_numbers = array.dtype.kind, prod(array.shape[1:])
    if n_numbers > WIDE or not n_numbers or kind not in "biufU":
        return False
    if kind == "f":
        return array.dtype.itemsize <= 8 and not np.isinf(array).any()
    return kind != "u" or array.dtype.itemsize < 8 or int(array.max()) < 2**63


def runs_alike(touches: Touches) -> list[Touches]:
    """Return touches in parts, each infinite in the same columns throughout.

    A column that holds infinity stands beside the rows, out of reach of filters.
    """
    changes = np.zeros(len(touches) - 1, dtype=bool)
    for array in touches.columns.values():
        if array.dtype.kind == "f" and prod(array.shape[1:]) <= WIDE:
            there = np.isinf(array).reshape(len(array), -1).any(axis=1)
            changes |= np.diff(there)
    if not changes.any():
        return [touches]
    cuts = [0, *(np.flatnonzero(changes) + 1), len(touches)]
    return [touches[start:end] for start, end in pairwise(cuts)]


def plain_cells(name: str, array: Array) -> list[Any]:
    """Return the plain values of a column; NaN is None."""
    if array.dtype.kind == "f":
        array = array + 0.0  # SQLite knows no negative zero
    if array.dtype.kind == "f" and np.isnan(array).any():
        gaps, array = np.isnan(array), array.astype(object)
        array[gaps] = None
    if array.dtype.kind == "U":
        try:
            "".join(array.ravel().tolist()).encode()
        except UnicodeEncodeError as error:
            raise LibraryError(
                f"column {name!r} must be text that UTF-8 can hold, got {error}. "
                "Clean it first."
            ) from error
    if array.dtype.kind == "b":
        array = array.astype(np.int64)  # as SQLite gives them back
    cells: list[Any] = array.tolist()
    return cells


def earlier_cell(cell: Any) -> Any:
    """Return nothing for an empty text or place, and the number that a text spells."""
    if isinstance(cell, list):
        return None if all(number is None for number in cell) else cell
    if not isinstance(cell, str):
        return cell
    for kind in (int, float):
        with suppress(ValueError):
            number = kind(cell)
            plain = isinstance(number, int) or np.isfinite(number)
            return number if plain and str(number) == cell else cell
    return cell or None
