"""Writing touches of a library in other forms."""

import secrets
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches
from ._database import Database
from ._errors import LibraryError
from ._files import PARTIAL
from ._lerobot import episodes_in_order, write_lerobot
from ._parquet import write_parquet
from ._query import AT_ONCE, FROM, chunks
from ._reading import common_shape, read_touches

_NO_LIMIT = 2**62


def export_touches(
    database: Database, folder: Path, numbers: NDArray[np.int64], path: Path
) -> int:
    """Write touches to `path`, whose ending says how; return how many."""
    common_shape(database, numbers)
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
    try:
        n_written = _WRITERS[kind](partial, database, folder, numbers)
        partial.replace(path)
    except OSError as error:
        raise LibraryError(
            f"{path} must be a place with room for {len(numbers)} touches, got: "
            f"{error.strerror or error}. Nothing is left there; free space, or give "
            "another one."
        ) from error
    finally:
        _remove(partial)
    return n_written


def _archive(
    partial: Path,
    database: Database,
    folder: Path,
    numbers: NDArray[np.int64],
) -> int:
    read_touches(database, folder, numbers, _NO_LIMIT).save(partial)
    return len(numbers)


def _parquet(
    partial: Path,
    database: Database,
    folder: Path,
    numbers: NDArray[np.int64],
) -> int:
    return write_parquet(partial, _parts(database, folder, numbers))


def _lerobot(
    partial: Path,
    database: Database,
    folder: Path,
    numbers: NDArray[np.int64],
) -> int:
    return write_lerobot(
        partial,
        _episodes(database, numbers),
        lambda rows: read_touches(database, folder, rows, _NO_LIMIT),
    )


_WRITERS = {".npz": _archive, ".parquet": _parquet, "": _lerobot}


def _remove(partial: Path) -> None:
    """Remove what a failed export has left; a finished one has another name."""
    if partial.is_dir():
        shutil.rmtree(partial, ignore_errors=True)
    with suppress(OSError):
        partial.unlink()


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
