"""LeRobotDatasets of format v3.0 as touches, for `palpate.library.read_bag`.

One feature of images, arrays or a video is read; it needs pyarrow, not lerobot, and
for videos PyAV: most are AV1, which OpenCV does not decode. Of others' datasets the
object is what the task says, `episode` its number, `time_s` its timestamp, unless they
have features of these names; of palpate's own, all that was exported comes back.
"""

import json
from collections.abc import Sequence
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate import Touches
from palpate.library import LibraryError
from palpate.touches import decode_bytes

Array = NDArray[Any]
TACTILE, RGB = "observation.tactile", ("r", "g", "b")
_MAX_INFO = 16 * 2**20
_LARGEST_WHOLE = 2**24  # below it float32 holds every whole number
_APART_S = 1e-3  # a picture's time and the one that the table tells
_LABELS = ("object", "category", "session", "episode", "subject", "sensor")
_NUMBERS = ("time_s", "order")
_MEASURED = tuple(
    f"observation.{name}" for name in ("position_mm", "direction", "force_n")
)


def is_dataset(path: Path) -> bool:
    """Tell whether a folder says that it is a LeRobotDataset."""
    return (path / "meta" / "info.json").is_file()


def read(
    folder: Path, feature: str | None, object: str | None, max_bytes: int
) -> Touches:
    """Return the frames of one feature as touches; `read_bag` explains the rest."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        info = _info(folder)
        features: dict[str, Any] = info["features"]
        name = _chosen_feature(features, feature)
        film = features[name]["dtype"] == "video"  # stands beside the table
        shape = tuple(int(n) for n in features[name]["shape"])
        if (film or features[name]["dtype"] == "image") and shape[2] not in (1, 3):
            shape = (*shape[1:], shape[0])  # written down with channels first
        n_frames = int(info["total_frames"])
        if (n_bytes := n_frames * prod(shape) * 4) > max_bytes:
            raise LibraryError(
                f"The frames of {folder} must take at most {max_bytes} bytes, got "
                f"{n_bytes}. Cut it, or raise max_bytes."
            )
        single = [n for n, f in features.items() if list(f["shape"]) == [1]]
        wanted = [n for n in (*_LABELS, *_NUMBERS) if n in single]
        wanted += [name, *_MEASURED, "task_index", "episode_index", "timestamp"]
        kept = [n for n in wanted if n in features and not (film and n == name)]
        paths = sorted((folder / "data").glob("*/*.parquet"))
        table = pa.concat_tables([pq.read_table(path, columns=kept) for path in paths])
        if len(table) != n_frames:
            raise ValueError(f"{len(table)} frames where it counts {n_frames}")
        tasks = pq.read_table(folder / "meta" / "tasks.parquet").to_pydict()
        images = _filmed(folder, name, shape, table) if film else None
        return _touches_of(table, name, shape, info, tasks, object, images)
    except (LibraryError, ImportError):
        raise
    except (pa.ArrowException, OSError, LookupError, TypeError, ValueError) as error:
        raise LibraryError(
            f"{folder} must be a LeRobotDataset of format v3.0, got: {error}. "
            "It may be damaged; fetch it again."
        ) from error


def _info(folder: Path) -> dict[str, Any]:
    path = folder / "meta" / "info.json"
    if path.stat().st_size > _MAX_INFO:
        raise ValueError(f"{path.name} of {path.stat().st_size} bytes")
    info: dict[str, Any] = json.loads(path.read_text())
    if not str(info["codebase_version"]).startswith("v3."):
        raise LibraryError(
            f"{folder} must be a LeRobotDataset of format v3.0, got "
            f"{info['codebase_version']!r}. lerobot has a script that converts it."
        )
    return info


def _chosen_feature(features: dict[str, Any], wanted: str | None) -> str:
    """Return the feature that is read: the one named, ours, or the only one."""
    kinds = {name: str(feature["dtype"]) for name, feature in features.items()}
    several = {name for name, f in features.items() if prod(f["shape"]) > 1}
    able = sorted(n for n in several if kinds[n] != "string")
    wide = [n for n in able if len(features[n]["shape"]) > 1]
    usual = TACTILE if TACTILE in able else wide[0] if len(wide) == 1 else None
    name = usual if wanted is None else wanted
    if name is None or name not in able:
        raise LibraryError(
            "The feature (--topic) must be an image, a video or an array of it "
            f"({', '.join(able) or 'none'}), got {wanted!r}."
        )
    return name


def _touches_of(
    table: Any,
    name: str,
    shape: tuple[int, ...],
    info: dict[str, Any],
    tasks: dict[str, Any],
    object: str | None,
    images: Array | None,
) -> Touches:
    about = info.get("palpate", {})
    if images is not None:
        pass
    elif info["features"][name]["dtype"] == "image":
        images = _pictures(table[name], shape)
        if about.get("grey") and images.ndim == 4:  # three channels that are the same
            images = images[..., 0]
    else:
        images = _numbers_of(table[name], shape if len(shape) > 1 else (1, *shape))
        dtype = np.dtype(about.get("dtype") or images.dtype)
        exact = dtype.kind == "f" or np.abs(images).max(initial=0) < _LARGEST_WHOLE
        if dtype.kind in "iuf" and exact:
            images = images.astype(dtype)
    columns: dict[str, Any] = {}
    for column in (*_LABELS, *_NUMBERS, *_MEASURED):
        if column in table.column_names:
            size = info["features"][column]["shape"]
            values = np.array(table[column].to_pylist()) if column in _LABELS else None
            if values is None:
                values = _numbers_of(table[column], [] if size == [1] else size)
            columns[column.removeprefix("observation.")] = values
    if not about:  # another's: its episodes are visits, and tasks say what is done
        columns.setdefault("episode", table["episode_index"].to_numpy())
        time_s = table["timestamp"].to_numpy().astype(np.float64)
        columns.setdefault("time_s", time_s)
        # lerobot leaves the column of texts without a name of its own.
        texts = tasks.get("task") or tasks["__index_level_0__"]
        named = dict(zip(tasks["task_index"], texts, strict=True))
        task = [named[i] for i in table["task_index"].to_pylist()]
        columns.setdefault("object", task)
    if object is not None:
        columns["object"] = np.full(len(images), object)
    whole: dict[str, Any] = {}
    if images.ndim == 4 and images.shape[3] == len(RGB):
        whole["channels"] = RGB
    for entry, value in about.get("whole", {}).items():
        if entry in ("channels", "pads", "pad_names", "geometry", "no_contact"):
            like = images.dtype if entry == "no_contact" else None
            whole[entry] = np.array(value, dtype=like)
    return Touches(images, **columns, **whole, set_topic=np.array(name))


def _filmed(folder: Path, name: str, shape: tuple[int, ...], table: Any) -> Array:
    """Return the pictures of a video that the times of the table's rows name."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        import av
    except ImportError as error:
        raise ImportError(
            f"{name} is a video, which needs av, which is not installed: pip install av"
        ) from error
    where = [f"videos/{name}/{n}" for n in ("chunk_index", "file_index")]
    begins = f"videos/{name}/from_timestamp"
    paths = sorted((folder / "meta" / "episodes").glob("*/*.parquet"))
    columns = ["episode_index", *where, begins]
    table_of_episodes = pa.concat_tables(
        [pq.read_table(path, columns=columns) for path in paths]
    )
    episodes = {row["episode_index"]: row for row in table_of_episodes.to_pylist()}
    wanted: dict[Path, list[tuple[float, int]]] = {}
    rows = zip(table["episode_index"], table["timestamp"], strict=True)
    for row, (episode, time_s) in enumerate(rows):
        record = episodes[episode.as_py()]
        chunk, file = (record[key] for key in where)
        path = folder / "videos" / name / f"chunk-{chunk:03d}" / f"file-{file:03d}.mp4"
        wanted.setdefault(path, []).append((record[begins] + time_s.as_py(), row))
    images = np.empty((len(table), *shape), np.uint8)
    for path, frames in wanted.items():
        frames.sort(reverse=True)
        try:
            with av.open(str(path)) as film:
                for frame in film.decode(video=0):
                    while frames and abs(frame.time - frames[-1][0]) <= _APART_S:
                        levels = frame.to_ndarray(format="rgb24")
                        if levels.shape != shape:
                            raise ValueError(
                                f"pictures of {levels.shape} in {path.name}"
                            )
                        images[frames.pop()[1]] = levels
        except av.FFmpegError as error:
            raise ValueError(f"{path.name}: {error}") from error
        if frames:
            raise ValueError(f"no picture at {frames[-1][0]:.4f} s of {path.name}")
    return images


def _numbers_of(column: Any, shape: Sequence[int]) -> Array:
    """Return numbers of a column that may be lists of lists, (n_rows, *shape)."""
    flat = column.combine_chunks()
    while hasattr(flat.type, "value_type"):
        flat = flat.flatten()
    values: Array = flat.to_numpy(zero_copy_only=False).reshape(len(column), *shape)
    return values


def _pictures(column: Any, shape: tuple[int, ...]) -> Array:
    images = np.empty((len(column), *shape[: 2 if shape[2] == 1 else 3]), np.uint8)
    for row, file in enumerate(column):
        levels = decode_bytes(file["bytes"].as_py() or b"", colour=shape[2] == 3)
        if levels.shape != images.shape[1:] or levels.dtype != np.uint8:
            raise ValueError(f"frame {row} of {levels.shape} {levels.dtype}")
        images[row] = levels
    return images
