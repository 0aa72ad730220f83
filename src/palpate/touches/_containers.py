"""Arrays in files of other programs: HDF5, zarr, TIFF, MATLAB, raw bytes, BMP, WebP.

Every reader asks for shape and type first and reads nothing that is larger than
`max_bytes`. Of several arrays in a file, the only one of three or four axes is the
images; others as long as it are columns under the last part of their names, `label`,
`labels` or `y` the object. Pickles, objects and function handles are refused.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._extras import needed
from .._types import Array
from ._columns import Arrays, TouchesError, belongs_to_whole

CONTAINERS = (".h5", ".hdf5", ".zarr", ".tif", ".tiff", ".mat", ".bmp", ".webp")
RAW = (".raw", ".bin", ".dat")
_LABELS = ("label", "labels", "y")
_MAX_ARRAYS = 1000  # of a file; as many as members of an archive
_MAX_RANK = 5  # of what is read: channels, and frames of presses
_PLAIN = "biufSU"


def _n_bytes(shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
    return prod([int(n) for n in shape]) * int(dtype.itemsize)


class _Entry(NamedTuple):
    """An array of a file before it is read."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[], Array]

    @property
    def n_bytes(self) -> int:
        return _n_bytes(self.shape, self.dtype)


def container_arrays(path: Path, max_bytes: int, max_pixels: int) -> Arrays:
    """Return what `Touches` is made of, by name, of a file of another program."""
    ending = path.suffix.lower()
    try:
        if ending in (".tif", ".tiff"):
            return {"images": _tiff(path, max_bytes)}
        if ending in (".bmp", ".webp"):
            return {"images": _picture(path, max_bytes, max_pixels)}
        if ending == ".mat":
            return _mat(path, max_bytes)
        return (_zarr if ending == ".zarr" else _hdf5)(path, max_bytes)
    except (TouchesError, ImportError):
        raise
    except MemoryError as error:
        raise TouchesError(f"{path} needs more memory than there is.") from error
    except Exception as error:
        # Each reader raises a dozen kinds on damaged files.
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise TouchesError(
            f"{path} must be a whole {ending} file of numbers, got: {reason}. "
            "Write it again."
        ) from error


def raw_arrays(
    path: Path,
    shape: tuple[int, int] | None,
    dtype: str | None,
    max_bytes: int,
    channels: Sequence[str] | None = None,
) -> Arrays:
    """Return frames without a header, one after another, rows first."""
    if shape is None or dtype is None:
        raise TouchesError(
            f"{path} holds numbers alone, so shape and dtype must be given, got "
            f"{shape} and {dtype}. Such as 16x16 and uint16."
        )
    try:
        kind = np.dtype(dtype)
    except TypeError as error:
        raise TouchesError(
            f"dtype must be a type of numbers such as uint16 or <f4, got {dtype!r}."
        ) from error
    if kind.kind not in "biuf" or kind.names or kind.subdtype:
        raise TouchesError(
            f"dtype must be a type of numbers such as uint16 or <f4, got {dtype!r}."
        )
    sides = (*shape, *([len(channels)] if channels else []))
    n_bytes, frame = path.stat().st_size, prod(sides) * kind.itemsize
    _refuse_large(str(path), n_bytes, max_bytes)
    if not frame or not n_bytes or n_bytes % frame:
        raise TouchesError(
            f"{path} must be frames of {' x '.join(map(str, sides))} {kind}, "
            f"{frame} bytes each, got {n_bytes} bytes. Correct shape or dtype."
        )
    levels = np.fromfile(path, kind).reshape(-1, *sides)
    named = {"channels": np.array(channels)} if channels else {}
    return {"images": levels.astype(kind.newbyteorder("=")), **named}


def _refuse_large(what: str, n_bytes: int, max_bytes: int) -> None:
    if n_bytes > max_bytes:
        raise TouchesError(
            f"{what} must take at most {max_bytes} bytes, got {n_bytes}. Split it, or "
            "raise max_bytes if you trust it."
        )


def _chosen(path: Path, entries: Mapping[str, _Entry], max_bytes: int) -> Arrays:
    """Read the images and what is as long as they are; the rest stays where it is."""
    plain = {
        name: entry
        for name, entry in entries.items()
        if entry.dtype.kind in _PLAIN and len(entry.shape) <= _MAX_RANK
    }
    wide = [n for n, e in plain.items() if len(e.shape) in (3, 4) and e.n_bytes]
    named = [name for name in wide if name.rpartition("/")[2] == "images"]
    if len(named or wide) != 1:
        listed = ", ".join(
            f"{n} ({' x '.join(map(str, e.shape)) or 'one'} {e.dtype})"
            for n, e in [*entries.items()][:8]
        )
        raise TouchesError(
            f"{path} must hold one array of images (n_touches, n_rows, n_cols), or "
            f"one named images, got {listed or 'no array'}. Rename it, or take it out."
        )
    images = (named or wide)[0]
    n_touches = plain[images].shape[0]
    chosen = {images: "images"}
    for name, entry in plain.items():
        last = name.rpartition("/")[2]
        column = "object" if last in _LABELS else last
        rows = entry.shape[:1] == (n_touches,) or belongs_to_whole(column)
        if name != images and rows and column not in chosen.values():
            chosen[name] = column
    n_bytes = sum(plain[name].n_bytes for name in chosen)
    _refuse_large(f"The arrays of {path}", n_bytes, max_bytes)
    return {column: _text(plain[name].read()) for name, column in chosen.items()}


def _text(array: Array) -> Array:
    """Return bytes as text; numbers in this machine's order of bytes."""
    if array.dtype.kind == "S":
        return np.char.decode(array, "utf-8")
    return np.asarray(array, array.dtype.newbyteorder("="))


def _hdf5(path: Path, max_bytes: int, *, columns_first: bool = False) -> Arrays:
    """Return arrays of an HDF5 file; MATLAB lists its axes the other way round."""
    h5py = needed("h5py", "files", "An HDF5 file")
    with h5py.File(path, "r") as file:
        entries: dict[str, _Entry] = {}

        def note(name: str, item: Any) -> None:
            if not isinstance(item, h5py.Dataset) or item.shape is None:
                return
            if item.external or item.is_virtual:
                raise TouchesError(
                    f"{path}: {name} must lie in the file itself, got one that points "
                    "to other files. Copy it into one file."
                )
            if len(entries) == _MAX_ARRAYS:
                raise TouchesError(f"{path} must hold at most {_MAX_ARRAYS} arrays.")
            entry = _hdf5_entry(h5py, item, max_bytes)
            if columns_first:
                entry = _turned(entry)
            entries[name] = entry

        file.visititems(note)  # follows no link out of the file
        return _chosen(path, entries, max_bytes)


def _turned(entry: _Entry) -> _Entry:
    """Return an entry with its axes in MATLAB's order; a vector has one axis."""
    shape = entry.shape[::-1]
    flat = len(shape) == 2 and 1 in shape
    sides = (prod(shape),) if flat else shape
    return _Entry(sides, entry.dtype, lambda: entry.read().T.reshape(sides))


def _hdf5_entry(h5py: Any, item: Any, max_bytes: int) -> _Entry:
    if h5py.check_string_dtype(item.dtype) is None:
        return _Entry(item.shape, item.dtype, lambda: np.asarray(item[()]))

    def texts() -> Array:
        _refuse_large(item.name, item.id.get_storage_size(), max_bytes)
        return np.array(item.asstr()[()], dtype=np.str_)

    return _Entry(item.shape, np.dtype("U16"), texts)


def _zarr(path: Path, max_bytes: int) -> Arrays:
    zarr = needed("zarr", "files", "A zarr folder")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of versions and what others wrote
        root = zarr.open(str(path), mode="r")
        single = isinstance(root, zarr.Array)
        members = {"images": root} if single else dict(root.members(max_depth=4))
        if len(members) > _MAX_ARRAYS:
            raise TouchesError(f"{path} must hold at most {_MAX_ARRAYS} arrays.")
        entries = {
            name: _Entry(item.shape, np.dtype(item.dtype), lambda a=item: np.array(a))  # type: ignore[misc]
            for name, item in members.items()
            if isinstance(item, zarr.Array)
        }
        for name, item in members.items():
            chunk = prod(getattr(item, "chunks", ())) * 8
            _refuse_large(f"A chunk of {name} in {path}", chunk, max_bytes)
        return _chosen(path, entries, max_bytes)


def _tiff(path: Path, max_bytes: int) -> Array:
    """Return the pages of a TIFF, (n_pages, n_rows, n_cols); one page is one touch."""
    tifffile = needed("tifffile", "files", "A TIFF file")
    with tifffile.TiffFile(path) as file:
        if len(file.series) != 1:
            raise TouchesError(
                f"{path} must hold pictures of one size and type, got "
                f"{len(file.series)} kinds. Split it."
            )
        series = file.series[0]
        _refuse_large(str(path), _n_bytes(series.shape, series.dtype), max_bytes)
        tiles = [page.keyframe for page in series.pages[:1]]
        for page in tiles:
            piece = _n_bytes(page.chunks, series.dtype)
            _refuse_large(f"A tile of {path}", piece, max_bytes)
        levels: Array = series.asarray(maxworkers=1)
        axes, samples = series.axes, file.pages[0].samplesperpixel
    if samples > 1:
        levels = _luma(path, levels, axes, samples)
    images: Array = levels.reshape(-1, *levels.shape[-2:])
    return images


def _luma(path: Path, levels: Array, axes: str, samples: int) -> Array:
    if samples != 3 or not axes.endswith("S") or levels.dtype.kind != "u":
        raise TouchesError(
            f"{path} must be in grey or in red, green and blue, got {samples} values "
            "a pixel. Convert it."
        )
    grey = levels @ np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
    luma: Array = np.rint(grey).astype(levels.dtype)
    return luma


def _picture(path: Path, max_bytes: int, max_pixels: int) -> Array:
    """Return a BMP or WebP as one touch in grey; of these Pillow knows the size."""
    from PIL import Image

    with Image.open(path, formats=["BMP", "WEBP"]) as picture:
        n_cols, n_rows = picture.size
        if n_cols * n_rows > max_pixels:
            raise TouchesError(
                f"{path} must have at most {max_pixels} pixels, got {n_cols} x "
                f"{n_rows}. Make it smaller, or raise max_pixels if you trust it."
            )
        _refuse_large(str(path), n_cols * n_rows, max_bytes)
        if getattr(picture, "n_frames", 1) > 1:
            raise TouchesError(f"{path} must be one picture, got an animated one.")
        if picture.mode in ("RGBA", "LA", "PA"):
            low = picture.getchannel("A").getextrema()[0]
            if low < 255:
                raise TouchesError(f"{path} must have no transparent parts.")
        return np.array(picture.convert("L"))[None]


def _mat(path: Path, max_bytes: int) -> Arrays:
    """Return arrays of a MATLAB file: up to version 7 by scipy, 7.3 is HDF5.

    MATLAB counts rows first, and touches often come last; a name says what is meant:
    only arrays (n_touches, n_rows, n_cols) are images.
    """
    from scipy.io import loadmat, matlab

    major, _ = matlab.matfile_version(str(path))
    if major == 2:
        return _hdf5(path, max_bytes, columns_first=True)
    listed = {name: (shape, kind) for name, shape, kind in matlab.whosmat(path)}
    _refuse_large(str(path), path.stat().st_size, max_bytes)
    # Elements may be packed a thousandfold; what they unpack to is in their headers.
    sizes = [prod(shape) * 8 for shape, _ in listed.values()]
    _refuse_large(f"The arrays of {path}", sum(sizes), max_bytes)
    numbers = [n for n, (_, kind) in listed.items() if kind in _MATLAB_KINDS]
    read = loadmat(path, variable_names=numbers, mat_dtype=False, squeeze_me=False)
    entries = {}
    for name in numbers:
        array = np.asarray(read[name])
        flat = array.ravel() if 1 in array.shape and array.ndim == 2 else array
        entries[name] = _Entry(flat.shape, flat.dtype, lambda a=flat: a)  # type: ignore[misc]
    return _chosen(path, entries, max_bytes)


_MATLAB_KINDS = {
    *("double", "single", "logical", "char"),
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
}
