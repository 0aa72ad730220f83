"""Touches of a library as archive, Parquet file or LeRobotDataset.

A Parquet file has one row per touch: `image` is a list of n_rows * n_cols values (times
n_channels where images have these), row by row, in the sensor's own type; columns keep
their names, vectors become lists. What describes the whole set stands in the schema's
metadata under `palpate`, as JSON.

Of touches all must have an object or none, whatever they are written to.
"""

import json
import secrets
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from .._durable import PARTIAL, flush_all, flush_folder
from .._extras import needed
from .._types import Array
from ..touches import Touches
from ._lerobot import part_of, write_lerobot, write_tables
from ._reading import common_kind, read_columns, read_touches
from ._rows import Numbers
from ._store import AT_ONCE, LibraryError, Store, room_for


def export_touches(store: Store, numbers: Numbers, path: Path) -> int:
    """Write touches to `path`, whose ending says how; return how many."""
    common_kind(store, numbers)
    path = path if path.name else path.absolute()  # "." and ".." have no name
    kind = path.suffix.lower()
    if kind not in _WRITERS:
        raise LibraryError(
            "What is exported must be an archive (.npz), a Parquet file (.parquet) or "
            f"a folder for a LeRobotDataset, got {path.name!r}."
        )
    if not path.parent.is_dir():
        raise LibraryError(
            f"What is exported must go to a folder that exists, got {str(path)!r}. "
            f"Make {str(path.parent)!r} first."
        )
    if not kind and path.exists() and (not path.is_dir() or any(path.iterdir())):
        got = "files in it" if path.is_dir() else "a file"
        raise LibraryError(
            f"{path} must be a new or empty folder, got {got}. Give another one."
        )
    partial = path.with_name(f"{PARTIAL}{secrets.token_hex(8)}{kind}")
    fix = "Nothing is left there; free space, or give another one."
    try:
        with room_for(f"{len(numbers)} touches", path, fix):
            _WRITERS[kind](partial, store, numbers)
            flush_all(partial)
            partial.replace(path)
            flush_folder(path.absolute().parent)
    finally:  # what a failed export has left; a finished one has another name
        if partial.is_dir():
            shutil.rmtree(partial, ignore_errors=True)
        with suppress(OSError):
            partial.unlink()
    return len(numbers)


def _write_parquet(path: Path, store: Store, numbers: Numbers) -> None:
    """Write one row group for every `AT_ONCE` touches."""
    common = read_columns(store, numbers)
    starts = range(0, len(numbers), AT_ONCE)
    rows = (np.arange(s, min(s + AT_ONCE, len(numbers))) for s in starts)
    parts = (part_of(store, numbers, some, common) for some in rows)
    write_tables(path, map(_parquet_table, parts), compression="zstd")


def _parquet_table(touches: Touches) -> Any:
    pa = needed("pyarrow", "parquet", "Writing Parquet")
    columns = {"image": touches.images, **touches.columns}
    sides = ("n_rows", "n_cols", "n_channels")
    about = {
        "format": 1,
        **dict(zip(sides, touches.images.shape[1:], strict=False)),
        "dtype": touches.images.dtype.str,
        "whole": {name: array.tolist() for name, array in touches.whole.items()},
    }
    table = pa.table({name: _arrow(pa, name, array) for name, array in columns.items()})
    return table.replace_schema_metadata({"palpate": json.dumps(about, default=str)})


def _arrow(pa: Any, name: str, array: Array) -> Any:
    """Return one column; every further axis becomes one flat list per row."""
    native = array.astype(array.dtype.newbyteorder("="))
    try:
        if array.ndim == 1:
            return pa.array(native)
        flat = pa.array(np.ascontiguousarray(native).reshape(-1))
        return pa.FixedSizeListArray.from_arrays(flat, int(np.prod(array.shape[1:])))
    except (pa.ArrowException, ValueError, TypeError) as error:
        raise LibraryError(
            f"Column {name!r} must have a type that Parquet holds, got "
            f"{array.dtype}. Leave it out, or convert it."
        ) from error


_WRITERS: dict[str, Callable[[Path, Store, Numbers], None]] = {
    ".npz": lambda path, store, numbers: read_touches(store, numbers).save(path),
    ".parquet": _write_parquet,
    "": write_lerobot,
}
