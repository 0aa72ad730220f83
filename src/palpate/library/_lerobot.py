"""Touches as a LeRobotDataset, the layout of robot learning's most used recordings.

Format v3.0: `data/` holds frames, `meta/info.json` their features, `meta/episodes/`
where each episode lies, `meta/tasks.parquet` the tasks, `meta/stats.json` the spread of
each feature. One touch is one frame, one object in one session (and episode) is one
episode, and its task is "touch <object>".

References
----------
.. [1] LeRobotDataset v3.0, https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches
from ._extra import needed

VERSION = "v3.0"
FRAMES_PER_SECOND = 1
_SHARED = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
_FILE = "chunk-{:03d}/file-{:03d}.parquet"


def lerobot_frames(
    touches: Touches, episode: int, first: int, task: int
) -> dict[str, NDArray[Any]]:
    """Return the frames of one episode by feature: the one mapping there is.

    Parameters
    ----------
    touches : Touches
        The episode.
    episode, first, task : int
        Number of the episode, of its first frame in the whole set, of its task.

    Returns
    -------
    features : dict of ndarray
        `observation.tactile` (n, n_rows, n_cols) float32; where known,
        `observation.position_mm` (n, 3) and `observation.force_n` (n, 1) float32; and
        what every LeRobotDataset has. `timestamp` is seconds since the first touch,
        or the number of the touch where times are not known.
    """
    n_touches = len(touches)
    number = np.arange(n_touches)
    time_s = touches.columns.get("time_s", number)
    columns = {"observation.tactile": touches.images.astype(np.float32)}
    for name in ("position_mm", "force_n"):
        if name in touches.columns:
            values = touches.columns[name].reshape(n_touches, -1)
            columns[f"observation.{name}"] = values.astype(np.float32)
    return {
        **columns,
        "timestamp": (time_s - time_s[0]).astype(np.float32),
        "frame_index": number,
        "episode_index": np.full(n_touches, episode),
        "index": first + number,
        "task_index": np.full(n_touches, task),
    }


def write_lerobot(
    folder: Path, episodes: list[Any], read: Callable[[Any], Touches]
) -> int:
    """Write a LeRobotDataset and return its number of frames.

    Parameters
    ----------
    folder : Path
        A new folder.
    episodes : list
        What `read` makes the touches of one episode of, all with one object.
    read : callable
        See `episodes`.
    """
    needed("pyarrow.parquet", "parquet", "Writing a LeRobotDataset")
    tasks: dict[str, int] = {}
    spread = _Spread()
    rows: list[dict[str, Any]] = []
    features: dict[str, Any] = {}
    path = folder / "data" / _FILE.format(0, 0)
    path.parent.mkdir(parents=True)
    with _Writer(path) as writer:
        for number, key in enumerate(episodes):
            touches = read(key)
            task = f"touch {'' if touches.object is None else touches.object[0]}"
            place = tasks.setdefault(task.strip(), len(tasks))
            first = rows[-1]["dataset_to_index"] if rows else 0
            frames = lerobot_frames(touches, number, first, place)
            features = features or _features(frames)
            spread.add(frames)
            writer.write(_table(frames))
            rows.append(_episode(number, task.strip(), first, len(touches)))
    _write_meta(folder, rows, tasks, features, spread)
    return int(rows[-1]["dataset_to_index"])


class _Writer:
    """A Parquet file that begins with its first table."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._writer: Any = None

    def __enter__(self) -> "_Writer":
        return self

    def __exit__(self, *error: object) -> None:
        if self._writer is not None:
            self._writer.close()

    def write(self, table: Any) -> None:
        if self._writer is None:
            pq = needed("pyarrow.parquet", "parquet", "Writing a LeRobotDataset")
            self._writer = pq.ParquetWriter(self._path, table.schema)
        self._writer.write_table(table)


class _Spread:
    """Minimum, maximum, mean and standard deviation over all frames, streamed."""

    def __init__(self) -> None:
        self._sums: dict[str, list[Any]] = {}

    def add(self, frames: dict[str, NDArray[Any]]) -> None:
        for name, values in frames.items():
            wide = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
            found = [len(wide), wide.sum(0), (wide**2).sum(0), wide.min(0), wide.max(0)]
            if name in self._sums:
                known = self._sums[name]
                sums = [a + b for a, b in zip(known[:3], found[:3], strict=True)]
                least = np.minimum(known[3], found[3])
                most = np.maximum(known[4], found[4])
                found = [*sums, least, most]
            self._sums[name] = found

    def told(self, features: dict[str, Any]) -> dict[str, Any]:
        result = {}
        for name, (count, total, squares, least, most) in self._sums.items():
            mean = total / count
            sd = np.sqrt(np.maximum(squares / count - mean**2, 0))
            shape = features[name]["shape"]
            values = {"min": least, "max": most, "mean": mean, "std": sd}
            result[name] = {k: v.reshape(shape).tolist() for k, v in values.items()}
            result[name]["count"] = [count]
        return result


def _features(frames: dict[str, NDArray[Any]]) -> dict[str, Any]:
    told = {}
    for name, values in frames.items():
        shape = list(values.shape[1:]) or [1]
        dtype = _SHARED.get(name, "float32")
        told[name] = {"dtype": dtype, "shape": shape, "names": None}
    return told


def _table(frames: dict[str, NDArray[Any]]) -> Any:
    pa = needed("pyarrow", "parquet", "Writing a LeRobotDataset")
    arrays = {}
    for name, values in frames.items():
        kind = _SHARED.get(name, "float32")
        typed = values.astype(kind)
        nested = getattr(pa, kind)()
        for _ in range(values.ndim - 1):
            nested = pa.list_(nested)
        arrays[name] = pa.array(typed.tolist() if values.ndim > 1 else typed, nested)
    return pa.table(arrays)


def _episode(number: int, task: str, first: int, n_frames: int) -> dict[str, Any]:
    return {
        "episode_index": number,
        "tasks": [task],
        "length": n_frames,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": first,
        "dataset_to_index": first + n_frames,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }


def _write_meta(
    folder: Path,
    rows: list[dict[str, Any]],
    tasks: dict[str, int],
    features: dict[str, Any],
    spread: _Spread,
) -> None:
    pa = needed("pyarrow", "parquet", "Writing a LeRobotDataset")
    pq = needed("pyarrow.parquet", "parquet", "Writing a LeRobotDataset")
    info = {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": len(rows),
        "total_frames": rows[-1]["dataset_to_index"],
        "total_tasks": len(tasks),
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FRAMES_PER_SECOND,
        "splits": {"train": f"0:{len(rows)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
    meta = folder / "meta"
    episodes = meta / "episodes" / _FILE.format(0, 0)
    episodes.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(rows), episodes)
    table = pa.table({"task_index": list(tasks.values()), "task": list(tasks)})
    # Readers take the task's name from the index of a pandas table.
    about = {"index_columns": ["task"], "columns": [], "column_indexes": []}
    table = table.replace_schema_metadata({"pandas": json.dumps(about)})
    pq.write_table(table, meta / "tasks.parquet")
    (meta / "info.json").write_text(json.dumps(info, indent=4))
    (meta / "stats.json").write_text(json.dumps(spread.told(features)))


def episodes_in_order(keys: list[tuple[Any, ...]]) -> Iterator[list[int]]:
    """Group rows by key, in the order in which keys first appear."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for row, key in enumerate(keys):
        groups.setdefault(key, []).append(row)
    yield from groups.values()
