"""Writing touches of a library in other forms."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches
from ._database import Database
from ._errors import LibraryError
from ._lerobot import episodes_in_order, write_lerobot
from ._parquet import write_parquet
from ._reading import AT_ONCE, FROM, chunks, common_shape, read_touches

_NO_LIMIT = 2**62


def export_touches(
    database: Database, folder: Path, numbers: NDArray[np.int64], path: Path
) -> int:
    """Write touches to `path`, whose ending says how; return how many."""
    common_shape(database, numbers)
    if path.suffix.lower() == ".npz":
        read_touches(database, folder, numbers, _NO_LIMIT).save(path)
        return len(numbers)
    if path.suffix.lower() == ".parquet":
        partial = path.with_name(f".{path.name}.partial")
        try:
            n_written = write_parquet(partial, _parts(database, folder, numbers))
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
        return n_written
    if path.suffix:
        raise LibraryError(
            "What is exported must be an archive (.npz), a Parquet file (.parquet) or "
            f"a folder for a LeRobotDataset, got {path.name!r}."
        )
    return write_lerobot(
        path,
        _episodes(database, numbers),
        lambda rows: read_touches(database, folder, rows, _NO_LIMIT),
    )


def _parts(
    database: Database, folder: Path, numbers: NDArray[np.int64]
) -> Iterator[Touches]:
    for start in range(0, len(numbers), AT_ONCE):
        some = numbers[start : start + AT_ONCE]
        yield read_touches(database, folder, some, _NO_LIMIT)


def _episodes(
    database: Database, numbers: NDArray[np.int64]
) -> list[NDArray[np.int64]]:
    """Return the numbers of the touches of each object, session and episode."""
    keys = []
    for piece in chunks(numbers):
        marks = ", ".join("?" * len(piece))
        sql = f"SELECT o.name, t.session, t.episode {FROM} WHERE t.number IN ({marks})"
        keys += database.rows(f"{sql} ORDER BY t.number", piece)
    return [numbers[rows] for rows in episodes_in_order(keys)]
