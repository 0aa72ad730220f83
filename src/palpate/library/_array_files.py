"""Files of a library: plain `.npy` arrays, named after their content, never changed.

A file holds one or several arrays, one after the other, each exactly as
`numpy.save` writes it; `numpy.load` reads the first. It gets its name, the SHA-256
of its bytes, only when all of it is on the disk. Reading never unpickles, and reads
no more than the size of the file allows.
"""

import hashlib
import io
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from .._durable import flush_folder, write_bytes
from .._types import Array
from ._store import LibraryError

_MAX_HEADER = 2**14
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_NAME = re.compile("[0-9a-f]{64}")
_PLAIN_KINDS = "biufcSUMm"


def file_path(folder: Path, name: str) -> Path:
    """Return where the file called `name` (64 hexadecimal digits) stands."""
    if not _NAME.fullmatch(name):
        raise LibraryError(
            f"Files must be named by 64 hexadecimal digits, got {name!r}."
        )
    return folder / name[:2] / f"{name}.npy"


def packed(arrays: Sequence[Array]) -> bytes:
    """Return arrays as the bytes of one file."""
    stream = io.BytesIO()
    for array in arrays:
        npy.write_array(stream, np.asarray(array, order="C"), allow_pickle=False)
    return stream.getvalue()


def publish(folder: Path, content: bytes) -> str:
    """Put a file in place and return its name; afterwards it is on the disk."""
    name = hashlib.sha256(content).hexdigest()
    target = file_path(folder, name)
    if target.is_file() and target.read_bytes() == content:
        flush_folder(target.parent)
        return name
    if not target.parent.is_dir():
        target.parent.mkdir(parents=True, exist_ok=True)
        flush_folder(folder)
    write_bytes(target, content)
    return name


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
        array, start = _array_at(path, content, start)
        arrays.append(array)
    return arrays


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise LibraryError(f"{path} must be readable, got: {reason}.") from error


def _array_at(path: Path, content: bytes, start: int) -> tuple[Array, int]:
    """Return the array that begins at a byte, and where it ends."""
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
    values = np.frombuffer(content[first:last], dtype=dtype)
    return values.reshape(shape), last


def _no_array(path: Path, got: str) -> LibraryError:
    return LibraryError(
        f"{path} must hold plain arrays as numpy.save writes them, got {got}. "
        "It is damaged: `palpate library check --repair` sets it aside."
    )
