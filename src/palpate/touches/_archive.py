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
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib import format as npy

from .._durable import replacing
from .._types import PLAIN_KINDS, Array
from . import _columns
from ._columns import Arrays, TouchesError, belongs_to_whole, refuse_large
from ._containers import whole_labels

_WHOLE_NAMES = "set_whole_names"
_MAX_MEMBERS = 1000  # of an archive; ours have some twenty
_MAX_HEADER = 2**14  # bytes of a .npy header; ours have 128
_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_MAX_ZIP_END = 22 + 2**16  # its last record, with the longest comment
_MAX_CODE_POINT = 0x10FFFF  # of Unicode
_EPOCH = (1980, 1, 1, 0, 0, 0)  # one date for all, so equal touches give equal files
# bzip2 and LZMA inflate a whole block at a time, whatever limit they are given.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_archive(path: Path, max_bytes: int) -> tuple[Array, Arrays, Arrays]:
    """Return images, columns and what describes the whole set of a touch archive."""
    with _explained(path):
        with zipfile.ZipFile(path) as archive:
            # The count at the end of the file, with which zipfile does not compare.
            n = len(archive.infolist())
            with path.open("rb") as file:
                file.seek(max(0, path.stat().st_size - _MAX_ZIP_END))
                end = file.read()
            count = end[end.rfind(b"PK\x05\x06") + 10 :][:2]
            if int.from_bytes(count, "little") not in (n, 0xFFFF):
                raise TouchesError(
                    f"it must hold the arrays that its directory counts, got {n}. "
                    "The file is damaged: write or fetch it again."
                )
            arrays = _inflated(archive, max_bytes)
        images = _columns.checked_images(arrays.pop("images"))
        names = arrays.pop(_WHOLE_NAMES, np.array([], dtype=np.str_)).ravel()
        parts = _columns.sorted_out(arrays, images, [str(name) for name in names])
        _columns.check_layout(images, *parts)
        return images, *parts


def write_archive(path: Path, images: Array, columns: Arrays, whole: Arrays) -> None:
    """Write a touch archive: all of it or nothing."""
    if path.suffix.lower() != ".npz":
        raise TouchesError(
            f"A touch archive must have a name that ends in .npz, got {path}. "
            f"Write to {path.with_name(path.name + '.npz')}."
        )
    arrays: Arrays = {"images": images, **columns, **whole}
    unsettled = {name: a for name, a in whole.items() if not belongs_to_whole(name)}
    mistakable = [n for n, a in unsettled.items() if a.shape[:1] == images.shape[:1]]
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
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def __str__(self) -> str:
        size = " x ".join(map(str, self.shape)) or "one"
        return f"{self.info.filename.removesuffix('.npy')} ({size} {self.dtype})"


def _inflated(archive: zipfile.ZipFile, max_bytes: int) -> Arrays:
    infos = archive.infolist()
    _refuse_odd_members(infos)
    refuse_large("its arrays", sum(info.file_size for info in infos), max_bytes)
    members = [_described(archive, info) for info in infos]
    arrays = {member.info.filename.removesuffix(".npy"): member for member in members}
    wide = [name for name, member in arrays.items() if len(member.shape) in (3, 4)]
    is_plain = "images" not in arrays and len(wide) == 1  # that others wrote
    if is_plain:
        images = arrays["images"] = arrays.pop(wide[0])
        labels = {"label", "labels", "y"} & set(arrays)
        if "y" in labels and arrays["y"].shape[:1] != images.shape[:1]:  # an axis
            labels.remove("y")
        if labels and "object" not in arrays:
            arrays["object"] = arrays.pop(min(labels))
    if "images" not in arrays:
        held = ", ".join(map(str, members)) or "nothing"
        flat = not wide and any(len(member.shape) == 2 for member in members)
        fix = "Rename the array of images, or give another file."
        raise TouchesError(
            "this is not a touch archive: it must hold an array named images "
            f"(n_touches, n_rows, n_cols); it holds {held}. "
            f"{_columns.VECTORS if flat else fix}"
        )
    read = {name: _array(archive, member) for name, member in arrays.items()}
    if is_plain and "object" in read:
        read["object"] = whole_labels(read["object"])
    return read


def _described(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Member:
    """Read the type and shape of one array; refuse what is not plain."""
    name = info.filename
    with archive.open(info) as stream:
        header = io.BytesIO(stream.read(_MAX_HEADER))
    try:
        read = _READERS[npy.read_magic(header)]
        shape, _, dtype = read(header, max_header_size=_MAX_HEADER)
    except Exception as error:
        # The header is a Python literal: numpy fails on it in many ways.
        raise _bad_array(name, f"{error}"[:80] or "no header") from error
    if dtype.kind not in PLAIN_KINDS or dtype.hasobject:
        what = "Python objects (a pickle)" if dtype.hasobject else str(dtype)
        raise TouchesError(
            f"{name} must hold plain numbers or text, got {what}. "
            "Pickles are never read; store it as an array of numbers or text."
        )
    if dtype.itemsize == 0 or any(n < 0 for n in shape):
        raise _bad_array(name, f"shape {shape} of {dtype}")
    promised, n_bytes = prod(shape) * dtype.itemsize, info.file_size - header.tell()
    if n_bytes != promised:
        raise TouchesError(
            f"{name} must hold the {promised} bytes that its header promises, got "
            f"{n_bytes}. The file is damaged: write or fetch it again."
        )
    return _Member(info, shape, dtype)


def _array(archive: zipfile.ZipFile, member: _Member) -> Array:
    try:
        with archive.open(member.info) as stream:
            array = npy.read_array(stream, max_header_size=_MAX_HEADER)
            if stream.read(1):  # the end of a member checks its CRC
                raise EOFError("an array goes on after its end")
    except MemoryError as error:
        raise TouchesError(f"{member} needs more memory than there is.") from error
    if array.dtype.kind == "U" and array.size:
        code = np.dtype(np.uint32).newbyteorder(array.dtype.byteorder)
        # No Python string can hold other characters.
        if array.ravel("K").view(code).max() > _MAX_CODE_POINT:
            raise _bad_array(member.info.filename, "characters outside Unicode")
    return np.asarray(array)


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Name the file in every error; zipfile and zlib raise many kinds."""
    try:
        yield
    except TouchesError as error:
        raise TouchesError(f"{path}: {error}") from error
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


def _refuse_odd_members(infos: list[zipfile.ZipInfo]) -> None:
    names = [info.filename for info in infos]
    odd = [f"{len(names)} of them"] * (len(names) > _MAX_MEMBERS)
    odd += [f"{name!r} twice" for name, n in Counter(names).items() if n > 1]
    for info in infos:
        name = info.filename
        odd += [f"an encrypted member, {name!r}"] * (info.flag_bits & 1)
        odd += [f"another file, {name!r}"] * (not name.endswith(".npy"))
        is_plain = info.compress_type in _METHODS
        odd += [f"zip method {info.compress_type} for {name!r}"] * (not is_plain)
    if odd:
        raise TouchesError(
            f"it must hold at most {_MAX_MEMBERS} arrays (.npy) of different names, "
            f"stored or deflated, got {odd[0]}. Write it with numpy.savez, "
            "numpy.savez_compressed or Touches.save."
        )


def _bad_array(name: str, got: str) -> TouchesError:
    return TouchesError(
        f"{name} must be an array as numpy.save writes it, got {got}. The file is "
        "damaged or no touch archive: write or fetch it again."
    )


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
