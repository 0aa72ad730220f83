"""Files of a library: plain `.npy` arrays, and the touches in them as rows of values.

A file holds one or several arrays, one after the other, each exactly as
`numpy.save` writes it; `numpy.load` reads the first. It gets its name, the SHA-256
of its bytes, only when all of it is on the disk, and is never changed. Reading never
unpickles, and reads no more than the size of the file allows.

Short values (numbers and text, at most `WIDE` numbers a touch) become cells of the
database; longer ones (a press as thirty frames) stay arrays in the touch's own file.
The same cells are written into that file as well, so that a lost database can be
rebuilt from the files.
"""

import hashlib
import io
import json
import os
import re
import secrets
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from math import isfinite, prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib import format as npy

from .._durable import PARTIAL, flush_folder, make_slots, write_bytes
from .._types import Array
from ..touches import Touches
from ._store import LibraryError, Store, Unreadable

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

_MAX_HEADER = 2**14
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_NAME = re.compile("[0-9a-f]{64}")
_PLAIN_KINDS = "biufcSUMm"
_SLOTS = 16
_ID_BYTES = 16
_MARK = ".adding-"
_END = 66  # the digits of a SHA-256, a quote and a bracket
_flushed: set[tuple[str, int, int]] = set()
WIDE = 16
CELLS = (
    *("object", "category", "session", "episode", "sensor", "order"),
    *("time_s", "force_n", "press", "frame", "source_path"),
)
# What tells two touches with the same image apart.
_TELLING = (name for name in CELLS if name not in ("category", "source_path"))
IDENTITY = (*_TELLING, "position_mm", "position_raw")
_CANONICAL = json.JSONEncoder(
    sort_keys=True, separators=(",", ":"), allow_nan=False, check_circular=False
)


def file_path(folder: Path, name: str) -> Path:
    """Return where the file called `name` (64 hexadecimal digits) stands."""
    if not _NAME.fullmatch(name):
        raise LibraryError(
            f"Files must be named by 64 hexadecimal digits, got {name!r}."
        )
    return folder.joinpath(name[:2], f"{name}.npy")


def packed(arrays: Sequence[Array]) -> bytes:
    parts = ((header(array.shape, array.dtype), array.tobytes()) for array in arrays)
    return b"".join(chain.from_iterable(parts))


@lru_cache
def header(shape: tuple[int, ...], dtype: np.dtype[Any]) -> bytes:
    """Return what `numpy.save` writes before the values of an array."""
    if dtype.kind not in _PLAIN_KINDS:
        raise ValueError(f"dtype must be of plain values, got {dtype}.")
    described = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False}
    stream = io.BytesIO()
    npy.write_array_header_1_0(stream, {**described, "shape": shape})
    return stream.getvalue()


def publish(
    folder: Path, content: bytes, name: str = "", slots: list[Path] | None = None
) -> str:
    """Put a file in place and return its name; afterwards it is on the disk.

    `name` is its SHA-256 where that is known. With `slots`, which are filled when they
    are used up, that takes one flush; after a power cut `adopt` gives it its name
    again.
    """
    name = name or hashlib.sha256(content).hexdigest()
    target = file_path(folder, name)
    if target.is_file() and target.read_bytes() == content:
        about = target.stat()
        known = str(target), about.st_ino, about.st_ctime_ns
        if known not in _flushed:
            flush_folder(target.parent)
            _flushed.add(known)
        return name
    if slots is not None:
        slots += [] if slots else make_slots(folder, _SLOTS)
        with suppress(FileNotFoundError, IndexError):  # taken by another meanwhile
            if not target.parent.is_dir():
                target.parent.mkdir(exist_ok=True)
            write_bytes(target, content, slots.pop())
            return name
    if not target.parent.is_dir():
        target.parent.mkdir(parents=True, exist_ok=True)
        flush_folder(folder)
    write_bytes(target, content)
    return name


def adopt(folder: Path) -> bool:
    """Name files that stand whole in slots, where a power cut has undone that.

    Return whether none had to stay there, since the disk is full or fails.
    """
    done = True
    for slot in folder.glob(f"{PARTIAL}*"):
        try:
            content = slot.read_bytes() if slot.is_file() else b""
            if content[-_END:] == _end(hashlib.sha256(content[:-_END])):
                publish(folder, content)
                slot.unlink()
        except FileNotFoundError:  # another program was faster
            continue
        except OSError:
            done = False
    return done


def leave_mark(store: Store) -> bool:
    """Leave a locked mark: rows may not be flushed. Return whether there is one.

    It stays until the store is closed with all rows on the disk. A power cut, or the
    end of a killed program, removes the lock but not the mark. No mark is made where
    files cannot be locked, or where the database has no write-ahead log.
    """
    if not store.marks and store.has_log and fcntl is not None:
        folder = store.images
        folder.mkdir(exist_ok=True)
        begun = folder / f"{PARTIAL}{secrets.token_hex(8)}"
        mark = begun.with_name(f"{_MARK}{secrets.token_hex(8)}")
        file = begun.open("xb")
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
            begun.rename(mark)
            store.slots += make_slots(folder, _SLOTS)  # the mark is flushed with them
        except OSError:  # no locks, or no room: that is told when a file is written
            file.close()
            begun.unlink(missing_ok=True)
            mark.unlink(missing_ok=True)
            return False
        store.marks[mark] = file
    return bool(store.marks)


@contextmanager
def left_marks(folder: Path) -> Iterator[list[Path]]:
    """Hold the marks that no running program locks; their rows may be missing."""
    with ExitStack() as held:
        found = []
        for mark in folder.glob(f"{_MARK}*"):
            with suppress(OSError):
                file = held.enter_context(mark.open("rb"))
                if fcntl is not None:
                    # Several programs may look after one mark at once.
                    fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
                found.append(mark)
        yield found


def _end(start: "hashlib._Hash") -> bytes:
    """Return what ends a file of this digest so far: the last value of its sheet."""
    return start.hexdigest().encode() + b'"}'


def read_values(
    path: Path, start: int, shape: tuple[int, ...], dtype: np.dtype[Any]
) -> Array:
    """Return values that begin at a byte of a file; the caller checks them."""
    n_bytes = prod(shape) * dtype.itemsize
    with _readable(path), path.open("rb") as file:
        room = os.fstat(file.fileno()).st_size - start
        file.seek(max(0, start))
        content = file.read(min(n_bytes, max(0, room)))
    if len(content) != n_bytes or dtype.hasobject:
        raise LibraryError(f"{path} must be whole, got a file that is cut short.")
    return np.frombuffer(content, dtype=dtype).reshape(shape)


def read_file(folder: Path, name: str) -> list[Array]:
    """Return all arrays of a file, which must be what its name says."""
    path = file_path(folder, name)
    with _readable(path):
        content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != name:
        raise LibraryError(f"{path} must be as it was written, got altered content.")
    arrays, start = [], 0
    while start < len(content):
        stream = io.BytesIO(content[start : start + _MAX_HEADER + 16])
        try:
            read_header = _HEADERS[npy.read_magic(stream)]
            shape, fortran, dtype = read_header(stream, max_header_size=_MAX_HEADER)
        except Exception as error:  # the header is a literal: it fails in many ways
            raise _no_array(path, str(error)[:80]) from error
        if dtype.hasobject or dtype.kind not in _PLAIN_KINDS or fortran:
            raise _no_array(path, f"values of {dtype}")
        first = start + stream.tell()
        last = first + prod(shape) * dtype.itemsize
        if not dtype.itemsize or min(shape, default=0) < 0 or last > len(content):
            raise _no_array(path, f"shape {shape} of {dtype}")
        arrays.append(np.frombuffer(content[first:last], dtype).reshape(shape))
        start = last
    return arrays


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise Unreadable(f"{path} must be readable, got: {reason}.") from error


def _no_array(path: Path, got: str) -> LibraryError:
    return LibraryError(
        f"{path} must hold plain arrays as numpy.save writes them, got {got}. "
        "It is damaged: `palpate library check --repair` sets it aside."
    )


class Column(NamedTuple):
    """One column of some touches: its type, the shape of a row, and where it is."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    wide: bool

    @classmethod
    def all_of(cls, layout: list[Any]) -> "list[Column]":
        """Return columns from what JSON makes of them."""
        return [cls(n, d, tuple(s), bool(w)) for n, d, s, w in layout]


@dataclass(frozen=True)
class Sheet:
    """Some touches as they are stored together in one file.

    `values` are the plain values per touch of the columns in `layout` that are not
    wide, `recording` a row of that table, the same for all; `added_s` counts from 1970,
    `ids` have 16 bytes each, `digests` are the SHA-256 of the images.
    """

    layout: list[Column]
    values: dict[str, list[Any]]
    wide: dict[str, Array]
    images: Array
    recording: dict[str, Any]
    added_s: float
    ids: list[bytes]
    digests: list[bytes]

    def packed(self) -> tuple[bytes, str]:
        """Return the file and its name, the SHA-256 of all of it.

        It holds images, wide columns, the rest, and the SHA-256 of all that.
        """
        sheet = {
            "format": 1,
            "layout": [list(column) for column in self.layout],
            "values": self.values,
            "recording": self.recording,
            "added_s": self.added_s,
            "ids": [key.hex() for key in self.ids],
            "written": "0" * 64,
        }
        text = np.frombuffer(canonical(sheet).encode(), dtype=np.uint8)
        start = packed([self.images, *self.wide.values(), text])[:-_END]
        digest = hashlib.sha256(start)
        end = _end(digest)
        digest.update(end)
        return start + end, digest.hexdigest()

    def picked(self, rows: Sequence[int]) -> "Sheet":
        return replace(
            self,
            values={n: [cells[i] for i in rows] for n, cells in self.values.items()},
            wide={name: array[list(rows)] for name, array in self.wide.items()},
            images=self.images[list(rows)],
            ids=[self.ids[i] for i in rows],
            digests=[self.digests[i] for i in rows],
        )


def sheet_of(touches: Touches, recording: dict[str, Any], added_s: float) -> Sheet:
    """Return touches as a sheet, each with its identity."""
    layout, values, wide = [], {}, {}
    for name, array in touches.columns.items():
        is_wide = not _fits_cells(array)
        layout.append(Column(name, array.dtype.str, array.shape[1:], is_wide))
        if is_wide:
            wide[name] = np.ascontiguousarray(array)
        else:
            values[name] = _cells(name, array)
    images = np.ascontiguousarray(touches.images)
    digests = [image_digest(image) for image in images]
    known = [(n, values[n]) for n in IDENTITY if n in values]
    ids = [
        identity(d, {n: cells[row] for n, cells in known}, wide, row)
        for row, d in enumerate(digests)
    ]
    return Sheet(layout, values, wide, images, recording, added_s, ids, digests)


def read_sheet(arrays: Sequence[Array]) -> Sheet:
    """Return the sheet that `Sheet.packed` wrote; many errors where it is none."""
    images, *blocks, text = arrays
    if images.ndim not in (3, 4) or text.dtype != np.uint8:
        raise ValueError("no images, or no sheet after them")
    sheet = json.loads(text.tobytes())
    if sheet["format"] != 1:
        raise ValueError(f"sheet format {sheet['format']!r}")
    layout = Column.all_of(sheet["layout"])
    names = [column.name for column in layout if column.wide]
    wide = dict(zip(names, blocks, strict=True))
    ids = [bytes.fromhex(key) for key in sheet["ids"]]
    if {*map(len, ids)} - {_ID_BYTES}:
        raise ValueError("ids of another length")
    lengths = {len(ids), len(images), *map(len, sheet["values"].values())}
    if lengths | {len(array) for array in wide.values()} != {len(images)}:
        raise ValueError("columns of unequal length")
    digests = [image_digest(image) for image in images]
    same = sheet["recording"], float(sheet["added_s"])
    if not all(map(_NAME.fullmatch, same[0]["whole"].values())):
        raise ValueError("arrays without a name")
    if not isfinite(same[1]):
        raise ValueError("no time")
    return Sheet(layout, sheet["values"], wide, images, *same, ids, digests)


def column_array(columns: Sequence[Column], cells: Sequence[Any]) -> Array:
    """Return cells as one array; None is NaN or "", numbers among text become text."""
    dtypes = {np.dtype(column.dtype) for column in columns}
    is_text = any(dtype.kind == "U" for dtype in dtypes)
    if any(cell is None for cell in cells):
        nothing = "" if is_text else np.nan
        blank = np.full(columns[0].shape, nothing).tolist()
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


def image_digest(image: Array) -> bytes:
    """Return the SHA-256 of an image: its type, its shape and its values."""
    digest = hashlib.sha256(f"{image.dtype.str} {image.shape}".encode())
    digest.update(np.ascontiguousarray(image).data)
    return digest.digest()


def canonical(value: Any) -> str:
    """Return `value` as JSON that is the same whenever the value is."""
    return _CANONICAL.encode(value)


def _fits_cells(array: Array) -> bool:
    kind, n_numbers = array.dtype.kind, prod(array.shape[1:])
    if n_numbers > WIDE or not n_numbers or kind not in "biufU":
        return False
    if kind == "f":
        return array.dtype.itemsize <= 8 and not np.isinf(array).any()
    return kind != "u" or array.dtype.itemsize < 8 or int(array.max()) < 2**63


def _cells(name: str, array: Array) -> list[Any]:
    """Return the plain values of a column; NaN is None."""
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
    cells: list[Any] = array.tolist()
    return cells


def identity(
    digest: bytes, cells: dict[str, Any], wide: dict[str, Array], row: int
) -> bytes:
    """Return the id of a touch: of its image, plain `cells` and its `row` of `wide`."""
    known = {n: cells[n] for n in IDENTITY if n in cells}
    whole = {n: _whole_numbers(cell) for n, cell in known.items() if cell is not None}
    parts = [digest, canonical(whole).encode()]
    parts += [n.encode() + wide[n][row].tobytes() for n in IDENTITY if n in wide]
    return hashlib.sha256(b"\0".join(parts)).digest()[:_ID_BYTES]


def _whole_numbers(cell: Any) -> Any:
    """Write 3.0 as 3, so that the type of a column does not tell touches apart."""
    if isinstance(cell, list):
        return [_whole_numbers(item) for item in cell]
    return int(cell) if isinstance(cell, float) and cell.is_integer() else cell
