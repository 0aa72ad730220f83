"""Touches in Parquet: one row a touch, written and read some at a time.

`image` is a fixed-shape tensor of the sensor's own type; where images are pictures (8
bits, grey or r, g, b, larger than an array) it is their files, JPEG or PNG, as the
feature `Image` of the package `datasets` shows them. Columns keep their names, those of
several numbers a touch are lists. `recording` says to which entry of the metadata
`palpate` (JSON) a touch belongs: those hold what describes all of its touches alike,
such as the no-contact image, pads, channels and geometry.

A path is a file, a folder of them whose names may carry a column (`object=mug/`), or an
address of a store that fsspec knows (`s3://bucket/touches.parquet`).
"""

import json
import re
from base64 import b64decode, b64encode
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import pairwise
from math import prod
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np

from .._checks import ARRAY_SIDE, listed, nearest_path, size_text
from .._extras import needed
from .._types import FORMER, RGB, Array, Indices
from ._columns import Arrays, TouchesError, refuse_large
from ._pictures import decode_bytes, png_bytes

ENDINGS = (".parquet", ".pq")
FORMAT = 2  # 1 had one recording alone
_NO_JSON = (ValueError, TypeError, KeyError, AttributeError, RecursionError)
_ROWS_AT_ONCE = 512  # of which memory holds
_BYTES_AT_ONCE = 64 * 2**20  # as many images at once
_IMAGE, _RECORDING = "image", "recording"
_URL = re.compile(r"([a-z][a-z0-9+.-]+):/+(.*)", re.DOTALL)
_PART = re.compile(r"([^/=]+)=([^/]*)")
_HIVE_NULL = "__HIVE_DEFAULT_PARTITION__"  # as others name a folder of what lacks
_READING = "Reading Parquet"
# What stores say of a file that changes when it is written anew.
_STAMPS = ("size", "ETag", "etag", "md5", "mtime", "LastModified", "created")


def url_of(path: str | PathLike[str]) -> str | None:
    """Return the address of a store outside, or None where a path is one of this disk.

    A `Path` makes one slash of two.
    """
    parts = _URL.fullmatch(str(path))
    if parts is None:
        return None
    scheme, rest = parts.groups()
    return f"file:///{rest}" if scheme == "file" else f"{scheme}://{rest}"


def is_parquet(path: str | PathLike[str]) -> bool:
    """Tell whether a path is a Parquet file, a folder of them, or an address of one."""
    place = Path(path)
    if url_of(path) is not None or place.is_file():
        return place.suffix.lower() in ENDINGS
    if not place.is_dir() or (place / "meta" / "info.json").is_file():
        return False  # a LeRobotDataset is read by its own package
    return any(next(place.rglob(f"*{ending}"), None) for ending in ENDINGS)


def write_parquet(
    file: Any,
    parts: Iterable[tuple[Array, Arrays, list[bytes] | None, Array]],
    channels: tuple[str, ...] | None,
    recordings: Sequence[Mapping[str, Any]],
    named: Mapping[str, str] | None = None,
) -> None:
    """Write touches to an open file, a row group for each part.

    A part is images, columns, the files of images that came as pictures, and the
    number of each touch's entry in `recordings`; each entry has the arrays of its
    `whole`, and may have more that JSON holds. `named` are the types of columns that
    the path carries. Raises TouchesError for a column that Parquet does not hold.
    """
    pa = needed("pyarrow", "parquet", "Writing Parquet")
    pq = needed("pyarrow.parquet", "parquet", "Writing Parquet")
    with ExitStack() as stack:
        writer = None
        for images, columns, files, numbers in parts:
            if taken := sorted({_IMAGE, _RECORDING} & {*columns}):
                raise TouchesError(
                    f"Columns in Parquet must not be called {taken[0]}, which is one "
                    "of its own. Write an archive (.npz), or call it something else."
                )
            # What a camera gives, and a viewer shows.
            large = min(images.shape[1:3]) > ARRAY_SIDE
            levels = images.dtype == np.uint8 and channels in (None, RGB)
            if files is None and large and levels:
                files = [png_bytes(image) for image in images]
            shown = _tensor(pa, images) if files is None else _pictures(pa, files)
            arrays = {name: _arrow(pa, name, array) for name, array in columns.items()}
            recording = pa.array(np.asarray(numbers, np.int32))
            table = pa.table({_IMAGE: shown, **arrays, _RECORDING: recording})
            if writer is None:
                dtypes = {
                    n: a.dtype.str for n, a in {_IMAGE: images, **columns}.items()
                }
                dtypes |= named or {}
                about = _metadata(pa, table.schema, dtypes, recordings)
                schema = table.schema.with_metadata(about)
                writer = stack.enter_context(
                    pq.ParquetWriter(file, schema, compression="zstd")
                )
            writer.write_table(table.cast(writer.schema))


def _metadata(
    pa: Any,
    schema: Any,
    dtypes: Mapping[str, str],
    recordings: Sequence[Mapping[str, Any]],
) -> dict[str, str]:
    """Return what a Parquet file of palpate says of itself."""
    plain = [
        {**entry, "whole": {n: _encoded(a) for n, a in entry["whole"].items()}}
        for entry in recordings
    ]
    about = {"format": FORMAT, "dtypes": dict(dtypes), "recordings": plain}
    metadata = {"palpate": json.dumps(about)}
    if pa.types.is_struct(schema.field(_IMAGE).type):
        features = {field.name: _feature(pa, field.type) for field in schema}
        features[_IMAGE] = {"_type": "Image"}
        metadata["huggingface"] = json.dumps({"info": {"features": features}})
    return metadata


def parquet_parts(
    path: str | PathLike[str], max_bytes: int, max_pixels: int
) -> Iterator[tuple[tuple[Array, Arrays, Arrays], list[bytes] | None]]:
    """Yield what `parquet_rows` does, of all files of a path."""
    n_parts = 0
    for name in parquet_files(path):
        for part in parquet_rows(name, max_bytes, max_pixels):
            n_parts += 1
            yield part
    if not n_parts:
        raise TouchesError(f"{path} must hold at least one touch, got none.")


@contextmanager
def _reader(name: str) -> Iterator[tuple[Any, Any]]:
    """Open a file with pyarrow, or say that it is no whole Parquet."""
    pq = needed("pyarrow.parquet", "parquet", _READING)
    pa = needed("pyarrow", "parquet", _READING)
    try:
        with _opened(name) as stream:
            yield pa, pq.ParquetFile(stream)
    except (pa.ArrowException, OSError, OverflowError) as error:
        raise TouchesError(
            f"{name} must be a whole Parquet file, got: {error}. Write it anew."
        ) from error


def parquet_files(path: str | PathLike[str]) -> list[str]:
    """Return the files of a path in their order, each as a path or an address."""
    url = url_of(path)
    if url is None:
        place = Path(path)
        if not place.exists():
            raise TouchesError(
                f"{path} must be Parquet of touches, got nothing there. "
                f"{nearest_path(place) or 'Check the path.'}"
            )
        if not place.is_dir():
            return [str(place)]
        paths = sorted(place.rglob("*"))
        shown = [p for p in paths if not p.name.startswith(".")]
        return [str(path) for path in shown if path.suffix.lower() in ENDINGS]
    system, place_there = _in_store(url)
    try:
        if system.isfile(place_there):
            return [url]
        listed = [n for n in system.find(place_there) if n.lower().endswith(ENDINGS)]
    except (ValueError, OSError) as error:
        raise _no_store(url, error) from error
    if not listed:
        raise TouchesError(f"{url} must hold Parquet files, got none there.")
    return [system.unstrip_protocol(name) for name in sorted(listed)]


def _in_store(url: str) -> tuple[Any, str]:
    """Return the file system of an address, and the place in it."""
    fsspec = needed("fsspec.core", "parquet", "Reading from a store")
    try:
        system, place = fsspec.url_to_fs(url)
    except (ValueError, ImportError, OSError) as error:
        raise _no_store(url, error) from error
    return system, place


def _no_store(url: str, error: Exception) -> TouchesError:
    return TouchesError(f"{url} must be an address that fsspec can open, got: {error}.")


def _opened(name: str) -> Any:
    """Open a file, by its path or address, to read."""
    if url_of(name) is None:
        return Path(name).open("rb")
    system, place = _in_store(name)
    return system.open(place, "rb")


def file_stamp(name: str) -> tuple[str, ...]:
    """Return what changes when a file is written anew: its size, and time or digest."""
    if url_of(name) is None:
        status = Path(name).stat()
        return str(status.st_size), str(status.st_mtime_ns)
    system, place = _in_store(name)
    about = system.info(place)
    return tuple(str(about[key]) for key in _STAMPS if key in about)


class FileIndex(NamedTuple):
    """What a file says of its touches before any image is read.

    `columns` have one short value a touch, `kind` is the shape and type of an image
    (None of pictures, which are decoded to know), `whole` what describes all touches of
    each recording alike, `numbers` the place in it of each touch's recording, `n_rows`
    the touches of each row group.
    """

    columns: Arrays
    kind: str | None
    whole: list[Arrays]
    numbers: Indices
    n_rows: list[int]


def parquet_index(name: str) -> FileIndex:
    """Read a file's columns of short values, and what it says of itself."""
    with _reader(name) as (pa, reader):
        schema, about = _schema_of(name, reader)
        short = [
            field.name
            for field in schema
            if not isinstance(field.type, pa.BaseExtensionType)
            and not pa.types.is_nested(field.type)
            and not pa.types.is_binary(field.type)
            and field.name != _IMAGE
        ]
        table = reader.read(columns=short).combine_chunks()
        groups = [reader.metadata.row_group(i) for i in range(reader.num_row_groups)]
        n_rows = [group.num_rows for group in groups]
    held = {n: pa.chunked_array(table[n]).combine_chunks() for n in short}
    columns = _columns(pa, name, held, about, sum(n_rows))
    recording = columns.pop(_RECORDING, None) if _has_recordings(about) else None
    keys, numbers = np.unique(
        np.zeros(sum(n_rows), int) if recording is None else recording,
        return_inverse=True,
    )
    kind = schema.field(_IMAGE).type
    is_tensor = isinstance(kind, pa.FixedShapeTensorType)
    shown = (
        f"{size_text(tuple(kind.shape))} of {kind.value_type}" if is_tensor else None
    )
    whole = [_whole(name, about, int(key)) for key in keys]
    return FileIndex(columns, shown, whole, numbers, n_rows)


def _named(name: str, dtypes: Mapping[str, str]) -> dict[str, Any]:
    """Return the columns that the folders of a file's path carry.

    One that the writer had as numbers is numbers; what lacks is NaN.
    """
    named: dict[str, Any] = {}
    for key, text in _PART.findall(name):
        value = "" if text == _HIVE_NULL else unquote(text)
        named[key] = value
        with suppress(TypeError, ValueError):
            dtype = np.dtype(dtypes.get(key, "U"))
            if dtype.kind in "iuf":
                named[key] = np.array(value or "nan").astype(dtype)[()]
    return named


def _schema_of(name: str, reader: Any) -> tuple[Any, dict[str, Any]]:
    """Return the schema of a file of touches, and what it says of itself."""
    schema = reader.schema_arrow
    about = _about(name, schema.metadata or {})
    if _IMAGE not in schema.names:
        raise TouchesError(
            f"{name} must have a column {_IMAGE!r} of pictures or tensors, got "
            f"{listed(schema.names, 5) or 'no column'}. Rename the one that has them; "
            "a table with a column for each taxel is read by pandas and "
            "`Touches.from_frame`."
        )
    twice = sorted({key for key in schema.names if schema.names.count(key) > 1})
    if twice:
        raise TouchesError(
            f"{name} must have columns of names that differ, got {twice[0]!r} twice. "
            "Rename one."
        )
    return schema, about


def parquet_rows(
    name: str,
    max_bytes: int,
    max_pixels: int,
    groups: Sequence[int] | None = None,
    rows: Array | None = None,
) -> Iterator[tuple[tuple[Array, Arrays, Arrays], list[bytes] | None]]:
    """Yield images, columns and what describes all, and files of the images.

    One recording at a time.
    Of all of a file, or of some row groups and of `rows`, counted from their first.
    """
    with _reader(name) as (pa, reader):
        _, about = _schema_of(name, reader)
        size = _batch_size(name, reader, max_bytes)
        batches = reader.iter_batches(batch_size=size, row_groups=groups)
        for batch in _picked(pa, batches, rows):
            held = dict(zip(batch.schema.names, batch.columns, strict=True))
            most = max_pixels, max_bytes
            images, files = _images(pa, name, held.pop(_IMAGE), about, *most)
            arrays = _columns(pa, name, held, about, batch.num_rows)
            arrays.pop("images", None)
            numbers = np.zeros(batch.num_rows, int)
            if _has_recordings(about):
                numbers = arrays.pop(_RECORDING, numbers)
            cuts = [0, *(np.flatnonzero(np.diff(numbers)) + 1), batch.num_rows]
            for start, stop in pairwise(cuts):
                part = {n: array[start:stop] for n, array in arrays.items()}
                whole = _whole(name, about, int(numbers[start]))
                kept = None if files is None else files[start:stop]
                yield (images[start:stop], part, whole), kept


def _batch_size(name: str, reader: Any, max_bytes: int) -> int:
    """Return how many rows memory holds at once; refuse row groups that are larger."""
    largest, n_bytes = 0, 1  # of a row group in the file, and of a row in memory
    for group in map(reader.metadata.row_group, range(reader.num_row_groups)):
        # What repeats takes nothing in the file, and as much as all else in memory.
        n_values = sum(group.column(i).num_values for i in range(group.num_columns))
        in_memory = max(8 * n_values, group.total_byte_size)
        n_bytes = max(n_bytes, in_memory // max(1, group.num_rows))
        largest = max(largest, group.total_byte_size, n_bytes)
    refuse_large(f"A row group of {name}", largest, max_bytes)
    return max(1, min(_ROWS_AT_ONCE, _BYTES_AT_ONCE // n_bytes))


def _picked(pa: Any, batches: Iterator[Any], rows: Array | None) -> Iterator[Any]:
    """Yield batches with some rows alone, counted through all of them."""
    first = 0
    for batch in batches:
        here = rows
        if rows is not None:
            here = rows[(rows >= first) & (rows < first + batch.num_rows)] - first
        first += batch.num_rows
        if here is None:
            yield batch
        elif len(here):
            yield batch.take(pa.array(here))


def _about(name: str, metadata: Mapping[bytes, bytes]) -> dict[str, Any]:
    """Return what the file says of itself; of another program's it is nothing."""
    try:
        about: dict[str, Any] = json.loads(metadata.get(b"palpate", b"{}"))
        if about.get("format", FORMAT) > FORMAT:
            raise TouchesError(
                f"{name} must be of Parquet format {FORMAT} or older, got "
                f"{about['format']}. Update palpate."
            )
        if about.get("format") == 1:  # all images one recording, sides beside
            sides = [n for n in ("n_rows", "n_cols", "n_channels") if n in about]
            about["shape"] = [int(about[n]) for n in sides]
            about["dtypes"] = {_IMAGE: about["dtype"]}
            about["recordings"] = [{"whole": about["whole"]}]
        about["format"] = int(about.get("format", 1))
        about["dtypes"] = {**about.get("dtypes", {})}
        about["recordings"] = [
            {**entry, "whole": {**entry["whole"]}}
            for entry in about.get("recordings", [])
        ]
    except _NO_JSON as error:
        if isinstance(error, TouchesError):
            raise
        raise TouchesError(
            f"{name} must say of itself in JSON what it holds, got: {error!r}. Write "
            "it anew."
        ) from error
    return about


def _has_recordings(about: Mapping[str, Any]) -> bool:
    """Tell whether the column `recording` is palpate's own, or another program's."""
    return int(about["format"]) > 1


def _whole(name: str, about: Mapping[str, Any], number: int) -> Arrays:
    """Return what describes all touches of a recording."""
    recordings = about["recordings"]
    try:
        whole = recordings[number]["whole"] if recordings else {}
        return {n: _decoded(value) for n, value in whole.items()}
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise TouchesError(
            f"{name} must have recording {number} among its metadata, got: {error!r}. "
            "Write it anew."
        ) from error


def _columns(
    pa: Any, name: str, held: Mapping[str, Any], about: Mapping[str, Any], n_rows: int
) -> Arrays:
    """Return the columns that a file has and those that its path carries."""
    dtypes = about["dtypes"]
    columns = {
        column: _as_written(_numpy(pa, name, column, values), dtypes.get(column, ""))
        for column, values in held.items()
    }
    for column, value in _named(name, dtypes).items():
        if column != _IMAGE:
            columns.setdefault(column, np.full(n_rows, value))
    return columns


def _as_written(array: Array, dtype: str) -> Array:
    """Return an array in the type that the writer had, where it fits that."""
    try:
        wanted = np.dtype(dtype)
    except TypeError:
        return array
    kinds = wanted.kind, array.dtype.kind
    same = kinds[0] == kinds[1] or kinds == ("b", "u")
    return array.astype(wanted) if same and wanted.itemsize == array.itemsize else array


def _images(
    pa: Any,
    name: str,
    column: Any,
    about: Mapping[str, Any],
    max_pixels: int,
    max_bytes: int,
) -> tuple[Array, list[bytes] | None]:
    """Return images, and the files they were decoded from, if they were."""
    kind = column.type
    if pa.types.is_struct(kind) and "bytes" in [field.name for field in kind]:
        column, kind = column.field("bytes"), pa.binary()
    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
        files = column.to_pylist()
        return _decoded_files(name, files, about, max_pixels, max_bytes)
    array = _numpy(pa, name, _IMAGE, column)
    if shape := about.get("shape"):
        if min(shape) < 1 or prod(shape) != array[0].size:
            raise TouchesError(
                f"{name} must have images of {shape} values, got {array[0].size}."
            )
        array = array.reshape(-1, *shape)
    if array.ndim not in (3, 4) or array.dtype.kind not in "biuf":
        raise TouchesError(
            f"{name} must have images of rows and columns of numbers, got "
            f"{kind}. Write tensors (pyarrow.fixed_shape_tensor) or pictures."
        )
    return _as_written(array, about["dtypes"].get(_IMAGE, "")), None


def _decoded_files(
    name: str,
    files: list[bytes | None],
    about: Mapping[str, Any],
    max_pixels: int,
    max_bytes: int,
) -> tuple[Array, list[bytes]]:
    names = {name for entry in about["recordings"] for name in entry["whole"]}
    colour = "channels" in {FORMER.get(name, name) for name in names}
    whole = [file for file in files if file is not None]
    if len(whole) < len(files):
        raise TouchesError(
            f"{name} must hold every picture itself, got {len(files) - len(whole)} "
            "without bytes. Write them into it."
        )
    images: list[Array] = []
    for file in whole:
        images.append(decode_bytes(file, max_pixels=max_pixels, colour=colour))
        n_bytes = len(images) * images[0].nbytes
        refuse_large(f"Pictures of {name} at once", n_bytes, max_bytes)
    shapes = {image.shape for image in images}
    if len(shapes) > 1:
        raise TouchesError(
            f"{name} must hold pictures of one size, got "
            f"{' and '.join(' x '.join(map(str, s)) for s in sorted(shapes)[:2])}."
        )
    return np.stack(images), whole


def _numpy(pa: Any, name: str, column_name: str, column: Any) -> Array:
    """Return a column of Arrow as an array; what lacks is NaN or ""."""
    kind = column.type
    if isinstance(kind, pa.BaseExtensionType):
        if isinstance(kind, pa.FixedShapeTensorType) and not column.null_count:
            tensor: Array = column.to_numpy_ndarray()
            return tensor
        raise _no_column(name, column_name, kind)
    if pa.types.is_dictionary(kind):
        return _numpy(pa, name, column_name, column.dictionary_decode())
    is_text = pa.types.is_string(kind) or pa.types.is_large_string(kind)
    if is_text or pa.types.is_binary(kind):
        blank = "" if is_text else b""
        return np.array([blank if v is None else v for v in column.to_pylist()])
    of_one_size = pa.types.is_fixed_size_list(kind)
    if of_one_size or pa.types.is_list(kind) or pa.types.is_large_list(kind):
        sizes = {*column.value_lengths().to_pylist()}  # None of a list that lacks
        if None in sizes or len(sizes) > 1:
            raise _no_column(name, column_name, "lists of unequal length")
        flat = _numpy(pa, name, column_name, column.flatten())
        return flat.reshape(len(column), *sizes, *flat.shape[1:])
    array: Array = column.to_numpy(zero_copy_only=False)
    if array.dtype.kind == "O":
        if not pa.types.is_boolean(kind):
            raise _no_column(name, column_name, kind)
        array = np.array([np.nan if v is None else float(v) for v in array])
    return array


def _no_column(name: str, column: str, got: object) -> TouchesError:
    return TouchesError(
        f"{name} must have numbers or text in column {column!r}, got {got}. Leave it "
        "out, or convert it."
    )


def _arrow(pa: Any, name: str, array: Array) -> Any:
    """Return one column; several numbers a touch are lists of a fixed length."""
    native = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("=")))
    flat = native.reshape(-1)
    try:
        # Of numpy's bytes pyarrow takes those before the first zero alone.
        column = pa.array(flat.tolist() if flat.dtype.kind == "S" else flat)
        for size in reversed(array.shape[1:]):
            column = pa.FixedSizeListArray.from_arrays(column, size)
    except (pa.ArrowException, ValueError, TypeError) as error:
        raise TouchesError(
            f"Column {name!r} must have a type that Parquet holds, got "
            f"{array.dtype}. Leave it out, or convert it."
        ) from error
    return column


def _tensor(pa: Any, images: Array) -> Any:
    """Return images as a tensor; several readers refuse one with permuted axes.

    There is none of true and false: these are 0 and 1.
    """
    if images.dtype == np.bool_:
        images = images.astype(np.uint8)
    flat = _arrow(pa, _IMAGE, images.reshape(len(images), -1))
    shape = images.shape[1:]
    kind = pa.fixed_shape_tensor(flat.type.value_type, shape)
    return pa.ExtensionArray.from_storage(kind, flat)


def _pictures(pa: Any, files: list[bytes]) -> Any:
    kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    return pa.array([{"bytes": file, "path": None} for file in files], kind)


def _feature(pa: Any, kind: Any) -> dict[str, Any]:
    """Return what `datasets` calls a type of Arrow."""
    if pa.types.is_fixed_size_list(kind):
        inner = _feature(pa, kind.value_type)
        return {"feature": inner, "length": kind.list_size, "_type": "Sequence"}
    names = {"double": "float64", "float": "float32", "halffloat": "float16"}
    return {"dtype": names.get(str(kind), str(kind)), "_type": "Value"}


def _encoded(array: Array) -> dict[str, Any]:
    if array.dtype.kind == "U":
        return {"text": array.tolist()}
    data = b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
    return {"dtype": array.dtype.str, "shape": array.shape, "base64": data}


def _decoded(value: Any) -> Array:
    if not isinstance(value, dict):  # of format 1
        return np.array(value)
    if "text" in value:
        return np.array(value["text"], dtype=np.str_)
    dtype = np.dtype(value["dtype"])
    if dtype.hasobject:
        raise ValueError(f"values of {dtype}")
    return np.frombuffer(b64decode(value["base64"]), dtype).reshape(value["shape"])
