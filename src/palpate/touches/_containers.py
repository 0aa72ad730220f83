"""Arrays of other programs: HDF5, zarr, TIFF, MATLAB, raw bytes, BMP, WebP; of ROS.

Every reader asks for shape and type first and reads nothing that is larger than
`max_bytes`. Of several arrays in a file, the only one of three or four axes is the
images; others as long as it are columns under the last part of their names, `label`,
`labels` or `y` the object unless one is called so; of two of one name that of the
images' group is meant. Pickles, objects and function handles are refused.

Messages of ROS, from a bag or off the wire, are any objects with the fields of their
kind; what each kind means stands with `palpate.library.read_bag`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._extras import needed
from .._types import Array
from ._columns import (
    VECTORS,
    Arrays,
    TouchesError,
    belongs_to_whole,
    checked_shape,
    refuse_large,
)
from ._pictures import decode_bytes

CONTAINERS = (".h5", ".hdf5", ".zarr", ".tif", ".tiff", ".mat", ".bmp", ".webp")
RAW = (".raw", ".bin", ".dat")
_LABELS = ("label", "labels", "y")  # the last may be an axis
_MAX_ARRAYS = 1000  # of a file; as many as members of an archive
_MAX_DEPTH = 50  # groups within groups
_MAX_RANK = 5  # of what is read: channels, and frames of presses
_PLAIN = "biufSU"
_LUMA = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
_WHITE_IS_0, _PALETTE = 0, 3  # of TIFF
_FIRST, _LAST = [0, 1, 2], [2, 1, 0]  # where red, green and blue stand
_GREY = {"mono8": "u1", "8UC1": "u1", "mono16": "u2", "16UC1": "u2", "32FC1": "f4"}
_COLOUR = {"rgb8": _FIRST, "bgr8": _LAST, "rgba8": _FIRST, "bgra8": _LAST}
# What sensor_msgs/msg/PointField calls the types of fields.
_POINT_TYPES = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), 1))


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
    kind = np.dtype(np.object_)
    with suppress(TypeError, ValueError, SyntaxError):
        kind = np.dtype(dtype)
    if kind.kind not in "biuf" or kind.names or kind.subdtype:
        raise TouchesError(
            f"dtype must be a type of numbers such as uint16 or <f4, got {dtype!r}."
        )
    sides = (*checked_shape(shape), *([len(channels)] if channels else []))
    n_bytes, frame = path.stat().st_size, prod(sides) * kind.itemsize
    refuse_large(str(path), n_bytes, max_bytes)
    with path.open("rb") as file:
        start = file.read(4096)
    is_text = re.search(rb"\d[.,; \t]", start) is not None and b"\n" in start
    if is_text and not start.strip(b"0123456789+-.,;eE \t\r\n"):
        raise TouchesError(
            f"{path} must be numbers as a machine holds them, got a text of numbers: "
            f"{start[:20].decode()!r}... Rename it to end in .txt, or .csv."
        )
    if not frame or not n_bytes or n_bytes % frame:
        raise TouchesError(
            f"{path} must be frames of {' x '.join(map(str, sides))} {kind}, "
            f"{frame} bytes each, got {n_bytes} bytes. Correct shape or dtype."
        )
    levels = np.fromfile(path, kind).reshape(-1, *sides)
    named = {"channels": np.array(channels)} if channels else {}
    return {"images": levels.astype(kind.newbyteorder("=")), **named}


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
        fix = "Rename it, or take it out."
        if not wide and any(len(e.shape) == 2 for e in plain.values()):
            fix = VECTORS
        elif len({n.rpartition("/")[2] for n in named or wide}) == 1:  # one a group
            fix = "Join those of all groups, and name the object of each touch."
        raise TouchesError(
            f"{path} must hold one array of images (n_touches, n_rows, n_cols), or "
            f"one named images, got {listed or 'no array'}. {fix}"
        )
    images = (named or wide)[0]
    n_touches = plain[images].shape[0]
    chosen = {images: "images"}
    long = {n for n, e in plain.items() if e.shape[:1] == (n_touches,)}
    beside = {name.rpartition("/")[2] for name in long}
    if not beside & {"object", *_LABELS}:
        _refuse_touches_last(path, plain, images)
    group = images.rpartition("/")[0]  # of two of one name that beside the images
    ordered = sorted(plain, key=lambda n: n.rpartition("/")[0] != group)
    labels = [n for n in ordered if n in long and n.rpartition("/")[2] in _LABELS]
    label = None
    if "object" not in beside and labels:
        label = min(labels, key=lambda n: _LABELS.index(n.rpartition("/")[2]))
    for name in ordered:
        last = name.rpartition("/")[2]
        column = "object" if name == label else last
        rows = name in long or belongs_to_whole(column)
        if name != images and rows and column not in chosen.values():
            chosen[name] = column
    n_bytes = sum(plain[name].n_bytes for name in chosen)
    refuse_large(f"The arrays of {path}", n_bytes, max_bytes)
    arrays = {column: _text(plain[name].read()) for name, column in chosen.items()}
    if "object" in arrays:
        arrays["object"] = whole_labels(arrays["object"])
    return arrays


def whole_labels(labels: Array) -> Array:
    """Return whole numbers as integers: MATLAB's are all floats."""
    if labels.dtype.kind != "f":
        return labels
    with np.errstate(invalid="ignore"):  # NaN and infinity, which are not whole
        whole = labels.astype(np.int64)
    return whole if np.array_equal(whole, labels) else labels


def _refuse_touches_last(
    path: Path, entries: Mapping[str, _Entry], images: str
) -> None:
    """Refuse images whose last axis, not the first, is as long as the labels."""
    *_, n_last = shape = entries[images].shape
    for name, entry in entries.items():
        is_label = name.rpartition("/")[2] in ("object", *_LABELS[:2])
        if is_label and entry.shape == (n_last,):
            raise TouchesError(
                f"{path} must hold {images} (n_touches, n_rows, n_cols), got "
                f"{' x '.join(map(str, shape))} and {n_last} values of {name}. Bring "
                "touches to the first axis: in MATLAB permute(x, [3 1 2])."
            )


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
            if name.count("/") > _MAX_DEPTH:  # each is sought from the first on
                raise TouchesError(
                    f"{path} must hold arrays at most {_MAX_DEPTH} groups deep."
                )
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
                name_of_kind = item.attrs.get("MATLAB_class")
                is_named = isinstance(name_of_kind, bytes)
                kind = name_of_kind.decode() if is_named else ""
                is_label = name.rpartition("/")[2] in ("object", *_LABELS)
                if is_label and kind not in {"", *_MATLAB_KINDS}:
                    raise _no_numbers(path, kind, name)
                is_text = kind == "char" and len(entry.shape) == 2
                entry = _rows_of_text(entry) if is_text else _turned(entry)
            entries[name] = entry

        file.visititems(note)  # follows no link out of the file
        return _chosen(path, entries, max_bytes)


def _turned(entry: _Entry) -> _Entry:
    """Return an entry with its axes in MATLAB's order; a vector has one axis."""
    shape = entry.shape[::-1]
    flat = len(shape) == 2 and 1 in shape
    sides = (prod(shape),) if flat else shape
    return _Entry(sides, entry.dtype, lambda: entry.read().T.reshape(sides))


def _rows_of_text(entry: _Entry) -> _Entry:
    """Return a matrix of letters, columns first, as a text a row, without blanks."""
    kind = np.dtype(f"<U{entry.shape[0]}")

    def read() -> Array:
        letters = np.ascontiguousarray(entry.read().T, "<u4")
        return np.char.rstrip(letters.view(kind)[:, 0])

    return _Entry(entry.shape[1:], kind, read)


def _hdf5_entry(h5py: Any, item: Any, max_bytes: int) -> _Entry:
    if h5py.check_string_dtype(item.dtype) is None:
        return _Entry(item.shape, item.dtype, lambda: np.asarray(item[()]))

    def texts() -> Array:
        refuse_large(item.name, item.id.get_storage_size(), max_bytes)
        return np.array(item.asstr("utf-8")[()], dtype=np.str_)

    return _Entry(item.shape, np.dtype("U16"), texts)


def _zarr(path: Path, max_bytes: int) -> Arrays:
    zarr = needed("zarr", "files", "A zarr folder")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of versions and what others wrote
        root = zarr.open(str(path), mode="r")
        single = isinstance(root, zarr.Array)
        members = {"images": root} if single else dict(root.members(max_depth=4))
        members = dict(sorted(members.items()))  # threads read them in any order
        if len(members) > _MAX_ARRAYS:
            raise TouchesError(f"{path} must hold at most {_MAX_ARRAYS} arrays.")
        entries = {
            name: _zarr_entry(item)
            for name, item in members.items()
            if isinstance(item, zarr.Array)
        }
        for name, item in members.items():
            chunk = prod(getattr(item, "chunks", ())) * 8
            refuse_large(f"A chunk of {name} in {path}", chunk, max_bytes)
        return _chosen(path, entries, max_bytes)


def _zarr_entry(item: Any) -> _Entry:
    dtype = np.dtype(item.dtype)
    if dtype.kind != "T":  # texts of any length
        return _Entry(item.shape, dtype, lambda: np.array(item))
    return _Entry(item.shape, np.dtype("U16"), lambda: np.array(item[...].tolist()))


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
        refuse_large(str(path), _n_bytes(series.shape, series.dtype), max_bytes)
        tile = _n_bytes(series.keyframe.chunks, series.dtype)
        refuse_large(f"A tile of {path}", tile, max_bytes)
        axes, samples = series.axes, file.pages[0].samplesperpixel
        photometric, n_bits = (
            int(file.pages[0].photometric),
            file.pages[0].bitspersample,
        )
        sides = [n for axis, n in zip(axes, series.shape, strict=True) if axis != "S"]
        sides = sides[:-2]
        if np.count_nonzero(np.array(sides) > 1) > 1:  # all would be touches
            raise TouchesError(
                f"{path} must hold a page for each touch, got pages along {axes} "
                f"{series.shape}. Save those of one channel and depth by themselves."
            )
        levels: Array = series.asarray(maxworkers=1)
    if photometric == _PALETTE:
        raise TouchesError(
            f"{path} must hold levels, got numbers of colours in a palette. Convert it."
        )
    if photometric == _WHITE_IS_0 and levels.dtype.kind in "bu":
        levels = levels ^ levels.dtype.type(2**n_bits - 1)
    if "S" in axes:  # colours may come one after another
        levels = np.moveaxis(levels, axes.index("S"), -1)
    if samples > 1:
        if samples != 3 or "S" not in axes or levels.dtype.kind != "u":
            raise TouchesError(
                f"{path} must be in grey or in red, green and blue, got {samples} "
                "values a pixel. Convert it."
            )
        levels = np.rint(levels @ _LUMA).astype(levels.dtype)
    return levels.reshape(-1, *levels.shape[-2:])


def _picture(path: Path, max_bytes: int, max_pixels: int) -> Array:
    """Return a BMP or WebP as one touch in grey; of these Pillow knows the size."""
    from PIL import Image, ImageOps

    with Image.open(path, formats=["BMP", "WEBP"]) as picture:
        n_cols, n_rows = picture.size
        if n_cols * n_rows > max_pixels:
            raise TouchesError(
                f"{path} must have at most {max_pixels} pixels, got {n_cols} x "
                f"{n_rows}. Make it smaller, or raise `max_pixels` if you trust it."
            )
        refuse_large(str(path), n_cols * n_rows, max_bytes)
        if getattr(picture, "n_frames", 1) > 1:
            raise TouchesError(f"{path} must be one picture, got an animated one.")
        if picture.mode in ("RGBA", "LA", "PA"):
            low = picture.getchannel("A").getextrema()[0]
            if low < 255:
                raise TouchesError(f"{path} must have no transparent parts.")
        upright = ImageOps.exif_transpose(picture)
        return np.array(upright.convert("L"))[None]


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
    refuse_large(str(path), path.stat().st_size, max_bytes)
    # Elements may be packed a thousandfold; what they unpack to is in their headers.
    sizes = [prod(shape) * 8 for shape, _ in listed.values()]
    refuse_large(f"The arrays of {path}", sum(sizes), max_bytes)
    numbers = [n for n, (_, kind) in listed.items() if kind in _MATLAB_KINDS]
    left = [name for name in listed if name not in numbers]
    if wanted := [n for n in left if not numbers or n in ("object", *_LABELS)]:
        raise _no_numbers(path, listed[wanted[0]][1], wanted[0])
    read = loadmat(path, variable_names=numbers, mat_dtype=False, squeeze_me=False)
    entries = {}
    for name in numbers:
        array = np.asarray(read[name])
        if array.dtype.kind == "U":  # rows of text are filled up with blanks
            array = np.char.rstrip(array)
        flat = array.ravel() if 1 in array.shape and array.ndim == 2 else array
        entries[name] = _Entry(flat.shape, flat.dtype, lambda a=flat: a)  # type: ignore[misc]
    return _chosen(path, entries, max_bytes)


def _no_numbers(path: Path, kind: str, name: str) -> TouchesError:
    return TouchesError(
        f"{path} must hold numbers and rows of text, got {kind} {name}. Cells, "
        "structures and strings are not read: in MATLAB save each field by itself, and "
        "names as char(names)."
    )


_MATLAB_KINDS = {
    *("double", "single", "logical", "char"),
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
}


def frame_reader(kind: str) -> Callable[[Any, str], Array] | None:
    """Return what reads the frame of a message of a kind; None where it holds none.

    It takes the message and what to call it.
    """
    if kind.startswith("std_msgs/msg/") and kind.endswith("MultiArray"):
        return _message_array
    return {
        "sensor_msgs/msg/Image": _message_picture,
        "sensor_msgs/msg/CompressedImage": _coded_picture,
        "sensor_msgs/msg/PointCloud2": _cloud,
    }.get(kind)


def _coded_picture(message: Any, where: str) -> Array:
    try:
        return decode_bytes(np.asarray(message.data, np.uint8).tobytes())
    except TouchesError as error:
        raise TouchesError(f"{where}: {error}") from error


def _cloud(message: Any, where: str) -> Array:
    """Return the reading of each point, (n_rows, n_cols), as a cloud lays them out."""
    fields = {str(f.name): f for f in message.fields if str(f.name) not in "xyz"}
    names = [name for name in fields if name == "intensity"] or list(fields)
    n_rows, n_cols = int(message.height), int(message.width)
    field = fields[names[0]] if len(names) == 1 else None
    if field is None or field.datatype not in _POINT_TYPES or int(field.count) > 1:
        several = {n: f" ({f.count} a point)" for n, f in fields.items() if f.count > 1}
        listed = ", ".join(name + several.get(name, "") for name in fields)
        raise TouchesError(
            f"{where} must have one reading a point beside x, y and z, or a field "
            f"intensity, got the fields {listed or 'none'}."
        )
    order = ">" if message.is_bigendian else "<"
    dtype = np.dtype(order + _POINT_TYPES[field.datatype])
    content = np.asarray(message.data, dtype=np.uint8)
    step, row_step = int(message.point_step), int(message.row_step)
    inside = 0 <= field.offset <= step - dtype.itemsize and row_step >= n_cols * step
    if not inside or not n_rows * n_cols or content.size != row_step * n_rows:
        raise TouchesError(
            f"{where} must hold {n_rows} rows of {n_cols} points of {step} bytes, got "
            f"{content.size} bytes in rows of {row_step}."
        )
    points = content.reshape(n_rows, row_step)[:, : n_cols * step]
    cells = points.reshape(n_rows, n_cols, step)[..., field.offset :]
    values = np.ascontiguousarray(cells[..., : dtype.itemsize]).view(dtype)[..., 0]
    return values.astype(dtype.newbyteorder("="))


def _message_picture(message: Any, where: str) -> Array:
    n_rows, n_cols, step = int(message.height), int(message.width), int(message.step)
    encoding = str(message.encoding)
    if encoding not in _GREY and encoding not in _COLOUR:
        encodings = ", ".join([*_GREY, *_COLOUR])
        raise TouchesError(f"{where} must be encoded as {encodings}, got {encoding!r}.")
    n_channels = 1 if encoding in _GREY else 4 if "a" in encoding else 3
    order = ">" if message.is_bigendian else "<"
    dtype = np.dtype(order + _GREY.get(encoding, "u1"))
    row_bytes = n_cols * n_channels * dtype.itemsize
    content = np.asarray(message.data, dtype=np.uint8).tobytes()
    if step < row_bytes or not row_bytes * n_rows or len(content) != step * n_rows:
        raise TouchesError(
            f"{where} must hold {n_rows} rows of {step} bytes, got {len(content)} "
            f"bytes for {n_cols} columns of {encoding}."
        )
    rows = np.frombuffer(content, np.uint8).reshape(n_rows, step)[:, :row_bytes]
    values = np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="))
    if encoding in _GREY:
        return values
    colours = values.reshape(n_rows, n_cols, n_channels)[..., _COLOUR[encoding]]
    grey: Array = np.rint(colours @ _LUMA).astype(np.uint8)
    return grey


def _message_array(message: Any, where: str) -> Array:
    values = np.asarray(message.data)
    sizes = [int(d.size) for d in message.layout.dim if int(d.size) > 1]
    shape = (1, len(values)) if not sizes else (1, *sizes)[-2:]
    start = int(message.layout.data_offset)
    n_values = shape[0] * shape[1]
    if len(sizes) > 2 or n_values != len(values) - start or not n_values:
        raise TouchesError(
            f"{where} must hold one array of rows and columns, got dimensions "
            f"{sizes} for {len(values)} values."
        )
    return values[start:].reshape(shape)
