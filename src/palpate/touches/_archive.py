"""Touch archives: `.npz` files of plain arrays, read without trusting them.

Every array is stored under its name, in the type it has. Where an array of the
whole set happens to be as long as the set (a selection can make it so), its name
is listed in `set_whole_names`, so that reading does not take it for a column.

Sizes are checked twice before anything is inflated: those in the zip directory
and those that follow from the shape and type in each array's own header; the two
must agree. Nothing is ever unpickled. Reading inflates at most what was checked.
"""

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .._durable import replacing
from .._types import Array
from ._columns import (
    PLAIN_KINDS,
    Arrays,
    TouchesError,
    belongs_to_whole,
    checked_images,
    sorted_out,
)

_WHOLE_NAMES = "set_whole_names"
_CHUNK = 2**20
_MAX_MEMBERS = 1000
_MAX_HEADER = 2**14
_VERSIONS = (b"\x01\x00", b"\x02\x00")
_MAX_ZIP_END = 22 + 2**16
_MAX_CODE_POINT = 0x10FFFF
_EPOCH = (1980, 1, 1, 0, 0, 0)  # one date for all, so equal touches give equal files
# bzip2 and LZMA inflate a whole block at a time, whatever limit they are given.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_archive(path: Path, max_bytes: int) -> tuple[Array, Arrays, Arrays]:
    """Return images, columns and what describes the whole set of a touch archive.

    Raises
    ------
    TouchesError
        The file is no touch archive, is damaged, holds pickles, or its arrays do
        not fit together.
    """
    if not path.is_file():
        raise TouchesError(f"{path} must be a file, got none there. Check the path.")
    with _explained(path), zipfile.ZipFile(path) as archive:
        arrays = _inflated(path, archive, max_bytes)
    try:
        images = checked_images(arrays.pop("images"))
        names = arrays.pop(_WHOLE_NAMES, np.array([], dtype=np.str_)).ravel()
        return images, *sorted_out(arrays, images, [str(name) for name in names])
    except TouchesError as error:
        raise TouchesError(f"{path}: {error}") from error


def write_archive(path: Path, images: Array, columns: Arrays, whole: Arrays) -> None:
    """Write a touch archive: all of it or nothing.

    Raises
    ------
    TouchesError
        The name does not end in `.npz`, or the file cannot be written.
    """
    if path.suffix.lower() != ".npz":
        raise TouchesError(
            f"A touch archive must have a name that ends in .npz, got {path}. "
            f"Write to {path.with_name(path.name + '.npz')}."
        )
    arrays: Arrays = {"images": images, **columns, **whole}
    mistakable = [
        name
        for name, array in whole.items()
        if not belongs_to_whole(name) and array.ndim and len(array) == len(images)
    ]
    if mistakable:
        arrays[_WHOLE_NAMES] = np.array(mistakable)
    for name in arrays:
        _refuse_odd_name(path, name)
    try:
        with replacing(path) as file, zipfile.ZipFile(file, "w") as archive:
            for name, array in arrays.items():
                info = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
                info.compress_type = zipfile.ZIP_DEFLATED
                info.external_attr = 0o644 << 16
                with archive.open(info, "w", force_zip64=True) as member:
                    npy.write_array(member, array, allow_pickle=False)
    except OSError as error:
        reason = error.strerror or error
        raise TouchesError(
            f"{path} must be a file that can be written, got: {reason}. "
            "Check that its folder exists, may be written to and has room."
        ) from error


class _Member(NamedTuple):
    """One array of an archive, as its header describes it."""

    info: zipfile.ZipInfo
    n_header_bytes: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool

    def __str__(self) -> str:
        size = " x ".join(map(str, self.shape)) or "one"
        return f"{self.info.filename.removesuffix('.npy')} ({size} {self.dtype})"


def _inflated(path: Path, archive: zipfile.ZipFile, max_bytes: int) -> Arrays:
    """Return every array, once all headers are known to be in order."""
    infos = archive.infolist()
    _refuse_lost_members(path, len(infos))
    _refuse_odd_members(path, infos)
    n_bytes = sum(info.file_size for info in infos)
    if n_bytes > max_bytes:
        raise TouchesError(
            f"{path} must inflate to at most {_mib(max_bytes)} MiB, got "
            f"{_mib(n_bytes)} MiB. Raise max_bytes if you trust the file."
        )
    members = [_described(path, archive, info) for info in infos]
    arrays = {one.info.filename.removesuffix(".npy"): one for one in members}
    if "images" not in arrays:
        held = ", ".join(map(str, members)) or "nothing"
        raise TouchesError(
            f"{path} is not a touch archive: it must hold an array named "
            f"images (n_touches, n_rows, n_cols); it holds {held}. "
            "Rename the array of images, or give another file."
        )
    return {name: _array(path, archive, member) for name, member in arrays.items()}


def _described(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Member:
    with archive.open(info) as stream:
        member = _parsed_header(path, info, stream)
    n_bytes = prod(member.shape) * member.dtype.itemsize
    if info.file_size != member.n_header_bytes + n_bytes:
        raise TouchesError(
            f"{path}: {info.filename} must hold the {n_bytes} bytes that its "
            f"header promises, got {info.file_size - member.n_header_bytes}. "
            "The file is damaged: write or fetch it again."
        )
    return member


def _array(path: Path, archive: zipfile.ZipFile, member: _Member) -> Array:
    try:
        flat = np.empty(prod(member.shape), dtype=member.dtype)
    except MemoryError as error:
        n_bytes = member.info.file_size
        raise TouchesError(
            f"{path}: {member} needs {_mib(n_bytes)} MiB, more than there is. "
            "Split the archive into smaller ones."
        ) from error
    with archive.open(member.info) as stream:
        stream.read(member.n_header_bytes)
        _fill(flat.view(np.uint8), stream)
    _refuse_bad_text(path, member, flat)
    if member.fortran:
        return flat.reshape(member.shape[::-1]).T
    return flat.reshape(member.shape)


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn whatever zipfile and zlib stumble over into one error."""
    try:
        yield
    except TouchesError:
        raise
    except PermissionError as error:
        raise TouchesError(
            f"{path} must be readable, got: {error.strerror}. Change its permissions."
        ) from error
    except Exception as error:
        # zipfile alone raises eight kinds on damaged files.
        raise TouchesError(
            f"{path} must be a touch archive (.npz), got a file that cannot be read "
            f"as one: {error or type(error).__name__}. "
            "It may be cut short or damaged: write or fetch it again."
        ) from error


def _refuse_lost_members(path: Path, n_found: int) -> None:
    """Compare with the count at the end of the file, which zipfile does not."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _MAX_ZIP_END))
        end = file.read()
    count = end[end.rfind(b"PK\x05\x06") + 10 :][:2]
    if int.from_bytes(count, "little") not in (n_found, 0xFFFF):
        raise TouchesError(
            f"{path} must hold the arrays that its directory counts, got {n_found}. "
            "The file is damaged: write or fetch it again."
        )


def _refuse_odd_members(path: Path, infos: list[zipfile.ZipInfo]) -> None:
    if len(infos) > _MAX_MEMBERS:
        raise TouchesError(
            f"{path} must hold at most {_MAX_MEMBERS} arrays, got {len(infos)}. "
            "One archive is one set of touches: split it."
        )
    seen: set[str] = set()
    for info in infos:
        name = info.filename
        if name in seen:
            raise TouchesError(
                f"{path} must hold each array once, got {name!r} twice. "
                "Write the archive again with names of their own."
            )
        seen.add(name)
        if not name.endswith(".npy") or info.flag_bits & 1:
            what = "an encrypted member" if info.flag_bits & 1 else "another file"
            raise TouchesError(
                f"{path} must hold plain .npy arrays alone, got {what}, {name!r}. "
                "Write it with numpy.savez or Touches.save."
            )
        if info.compress_type not in _METHODS:
            raise TouchesError(
                f"{path} must be stored or deflated, got zip method "
                f"{info.compress_type} for {name!r}. Write it with numpy.savez, "
                "numpy.savez_compressed or Touches.save."
            )


def _parsed_header(path: Path, info: zipfile.ZipInfo, stream: IO[bytes]) -> _Member:
    """Read the type and shape of one array; refuse what is not plain."""
    raw = _raw_header(path, info, stream)
    read = npy.read_array_header_1_0 if raw[6] == 1 else npy.read_array_header_2_0
    header = io.BytesIO(raw)
    try:
        npy.read_magic(header)
        shape, fortran, dtype = read(header, max_header_size=_MAX_HEADER)
    except Exception as error:
        # The header is a Python literal: numpy fails on it in many ways.
        raise _bad_header(path, info, f"{error}"[:80] or "no header") from error
    if dtype.kind not in PLAIN_KINDS or dtype.hasobject:
        what = "Python objects (a pickle)" if dtype.hasobject else str(dtype)
        raise TouchesError(
            f"{path}: {info.filename} must hold plain numbers or text, got {what}. "
            "Pickles are never read; store it as an array of numbers or text."
        )
    if dtype.itemsize == 0 or any(n < 0 for n in shape):
        raise _bad_header(path, info, f"shape {shape} of {dtype}")
    return _Member(info, len(raw), shape, dtype, fortran)


def _raw_header(path: Path, info: zipfile.ZipInfo, stream: IO[bytes]) -> bytes:
    """Return the bytes before the values, without trusting the length they give."""
    start = stream.read(8)
    if len(start) < 8 or start[:6] != b"\x93NUMPY" or start[6:8] not in _VERSIONS:
        raise _bad_header(path, info, f"a start of {start!r}")
    n_length = 2 if start[6] == 1 else 4
    length = stream.read(n_length)
    n_bytes = int.from_bytes(length, "little")
    if n_bytes > _MAX_HEADER:
        raise _bad_header(path, info, f"a header of {n_bytes} bytes")
    return start + length + stream.read(n_bytes)


def _bad_header(path: Path, info: zipfile.ZipInfo, got: str) -> TouchesError:
    return TouchesError(
        f"{path}: {info.filename} must be an array as numpy.save writes it, got "
        f"{got}. The file is damaged or no touch archive: write or fetch it again."
    )


def _fill(flat: NDArray[np.uint8], stream: IO[bytes]) -> None:
    """Read exactly `flat` from `stream`; the end of a member checks its CRC."""
    start = 0
    while start < len(flat):
        chunk = stream.read(min(_CHUNK, len(flat) - start))
        if not chunk:
            raise EOFError("an array ends early")
        flat[start : start + len(chunk)] = np.frombuffer(chunk, np.uint8)
        start += len(chunk)
    if stream.read(1):
        raise EOFError("an array goes on after its end")


def _refuse_bad_text(path: Path, member: _Member, flat: Array) -> None:
    """Refuse text that no Python string can hold."""
    if member.dtype.kind != "U" or not len(flat):
        return
    code = np.dtype(np.uint32).newbyteorder(member.dtype.byteorder)
    if flat.view(code).max() > _MAX_CODE_POINT:
        raise _bad_header(path, member.info, "characters outside Unicode")


def _refuse_odd_name(path: Path, name: str) -> None:
    """Refuse names that a zip file would change."""
    try:
        kept = zipfile.ZipInfo(name).filename == name and len(name.encode()) < 2**15
    except UnicodeEncodeError:
        kept = False
    if not kept:
        raise TouchesError(
            f"{path}: names of columns must be plain short text, got {name!r}. "
            "Rename that column."
        )


def _mib(n_bytes: int) -> int:
    return -(-n_bytes // 2**20)
