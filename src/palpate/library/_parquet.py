"""Touches as a Parquet file: one row per touch, readable by any table tool."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches
from ._errors import LibraryError
from ._extra import needed

FORMAT = 1


def parquet_table(touches: Touches) -> Any:
    """Return touches as a pyarrow table.

    `image` is a list of n_rows * n_cols values, row by row, in the sensor's own type;
    columns keep their names, vectors become lists. What describes the whole set
    stands in the schema's metadata under `palpate`, as JSON.

    Raises
    ------
    ImportError
        pyarrow is missing; the message names the extra.
    LibraryError
        A column has a type that Parquet lacks.
    """
    pa = needed("pyarrow", "parquet", "Writing Parquet")
    columns = {"image": touches.images, **touches.columns}
    arrays = {name: _arrow(pa, name, array) for name, array in columns.items()}
    n_rows, n_cols = touches.images.shape[1:]
    about = {
        "format": FORMAT,
        "n_rows": n_rows,
        "n_cols": n_cols,
        "dtype": touches.images.dtype.str,
        "whole": {name: array.tolist() for name, array in touches.whole.items()},
    }
    table = pa.table(arrays)
    return table.replace_schema_metadata({"palpate": json.dumps(about, default=str)})


def write_parquet(path: Path, parts: Iterator[Touches]) -> int:
    """Write touches, one row group per part; return how many there were."""
    pq = needed("pyarrow.parquet", "parquet", "Writing Parquet")
    n_touches, writer = 0, None
    try:
        for part in parts:
            table = parquet_table(part)
            if writer is None:
                writer = pq.ParquetWriter(path, table.schema, compression="zstd")
            writer.write_table(table.cast(writer.schema))
            n_touches += len(part)
    finally:
        if writer is not None:
            writer.close()
    return n_touches


def _arrow(pa: Any, name: str, array: NDArray[Any]) -> Any:
    """Return one column; every further axis becomes one flat list per row."""
    native = array.astype(array.dtype.newbyteorder("="))
    try:
        if array.ndim == 1:
            return pa.array(native)
        flat = np.ascontiguousarray(native).reshape(-1)
        return pa.FixedSizeListArray.from_arrays(
            pa.array(flat), int(np.prod(array.shape[1:]))
        )
    except (pa.ArrowException, ValueError, TypeError) as error:
        raise LibraryError(
            f"Column {name!r} must have a type that Parquet holds, got "
            f"{array.dtype}. Leave it out, or convert it."
        ) from error
