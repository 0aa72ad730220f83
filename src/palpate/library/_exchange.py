"""Touches from ROS 2 bags; of a library as archive, Parquet or LeRobotDataset.

Bags and MCAP files are read without ROS installed. Every message of the chosen topic is
one touch:

- `sensor_msgs/msg/Image`, encodings mono8, mono16, 8UC1, 16UC1, 32FC1, rgb8, bgr8,
  rgba8 and bgra8; colour becomes its luma (ITU-R BT.601), rounded.
- `std_msgs/msg/*MultiArray`: the last two dimensions of `layout.dim` that are longer
  than one are rows and columns; without a layout the values are one row.

`time_s` is the stamp in the message's header, or the time of recording where there
is none (both in seconds since 1970); `order` counts the messages.

A bag in SQLite (`.db3`) has no checksum, and one in MCAP may lack it: a flipped bit in
a message is read as it stands. `set_bag_sha256`, of times and messages as they were
read, is kept with the touches: the bag can be compared with it from then on.

A Parquet file has one row per touch: `image` is a list of n_rows * n_cols values (times
n_channels where images have these), row by row, in the sensor's own type; columns keep
their names, vectors become lists. What describes the whole set stands in the schema's
metadata under `palpate`, as JSON.

A LeRobotDataset (format v3.0 [1]_) is the layout of robot learning's most used
recordings: `data/` holds frames, `meta/info.json` their features, `meta/episodes/`
where each episode lies, `meta/tasks.parquet` the tasks, `meta/stats.json` the spread of
each feature. One touch is one frame, one object in one session (and episode) is one
episode, and its task is "touch <object>".

References
----------
.. [1] LeRobotDataset v3.0, https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

import hashlib
import json
import secrets
import shutil
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import did_you_mean
from .._durable import PARTIAL, flush_all, flush_folder
from .._extras import needed
from .._types import Array, Floats
from ..touches import Touches
from ._reading import common_kind, read_touches
from ._rows import FROM, Numbers
from ._store import AT_ONCE, LibraryError, Store, room_for

MAX_BYTES = 4 * 2**30
_IMAGE = "sensor_msgs/msg/Image"
_GREY = {"mono8": "u1", "8UC1": "u1", "mono16": "u2", "16UC1": "u2", "32FC1": "f4"}
_RGB, _BGR = (0, 1, 2), (2, 1, 0)
_COLOUR = {"rgb8": _RGB, "bgr8": _BGR, "rgba8": _RGB, "bgra8": _BGR}
_LUMA = np.array([0.299, 0.587, 0.114])
_LEROBOT_VERSION = "v3.0"
_FRAMES_PER_SECOND = 1
_FILE = "chunk-{:03d}/file-{:03d}.parquet"


def read_bag(
    path: str | Path,
    topic: str,
    *,
    object: str | None = None,
    max_bytes: int = MAX_BYTES,
) -> Touches:
    """Read one topic of a ROS 2 bag (a folder, `.mcap` or `.db3`) as touches.

    Parameters
    ----------
    path : path
        The bag.
    topic : str
        A topic of images or of arrays.
    object : str, optional
        What is touched in all of it.
    max_bytes : int, default=4 GiB
        Most memory that the images may take.

    Raises
    ------
    ImportError
        rosbags is missing; the message names the extra.
    LibraryError
        It is no bag, lacks the topic, or a message is no image.
    """
    highlevel = needed("rosbags.highlevel", "ros", "Reading ROS 2 bags")
    typesys = needed("rosbags.typesys", "ros", "Reading ROS 2 bags")
    types = typesys.get_typestore(typesys.Stores.LATEST)
    bag = Path(path)
    try:
        with highlevel.AnyReader([bag], default_typestore=types) as reader:
            images, times, digest = _messages(reader, topic, max_bytes)
    except LibraryError:
        raise
    except Exception as error:  # rosbags raises many kinds on damaged bags
        raise LibraryError(
            f"{bag} must be a ROS 2 bag or an MCAP file, got: "
            f"{error or type(error).__name__}. Check the path; it may be damaged."
        ) from error
    labels = None if object is None else np.full(len(images), object)
    return Touches(
        np.stack(images),
        object=labels,
        order=np.arange(len(images)),
        time_s=np.array(times),
        set_topic=np.array(topic),
        set_bag_sha256=np.array(digest),
    )


def _messages(
    reader: Any, topic: str, max_bytes: int
) -> tuple[list[Array], list[float], str]:
    chosen = [c for c in reader.connections if c.topic == topic]
    if not chosen:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        listed = ", ".join(f"{name} of {kinds[name]}" for name in sorted(kinds))
        raise LibraryError(
            f"topic must be one of the bag ({listed or 'it has none'}), got {topic!r}."
            f"{did_you_mean(topic, kinds)}"
        )
    images: list[Array] = []
    times: list[float] = []
    n_bytes = 0
    digest = hashlib.sha256()
    for connection, recorded_ns, raw in reader.messages(connections=chosen):
        digest.update(f"{recorded_ns} {len(raw)} ".encode() + bytes(raw))
        message = reader.deserialize(raw, connection.msgtype)
        where = f"message {len(images)} of {topic}"
        image = _image(message, connection.msgtype, where)
        if images and (image.shape, image.dtype) != (images[0].shape, images[0].dtype):
            raise LibraryError(
                f"All images of {topic} must have one size and type, got "
                f"{image.shape} {image.dtype} in {where} after {images[0].shape} "
                f"{images[0].dtype}."
            )
        n_bytes += image.nbytes
        if n_bytes > max_bytes:
            raise LibraryError(
                f"The images of {topic} must take at most {max_bytes} bytes. Cut the "
                "bag, or raise max_bytes."
            )
        images.append(image)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        if stamp is None or not (stamp.sec or stamp.nanosec):
            times.append(recorded_ns / 1e9)
        else:
            times.append(float(stamp.sec + stamp.nanosec / 1e9))
    if not images:
        raise LibraryError(f"topic must have messages, got none in {topic!r}.")
    return images, times, digest.hexdigest()


def _image(message: Any, kind: str, where: str) -> Array:
    if kind == _IMAGE:
        return _picture(message, where)
    if kind.startswith("std_msgs/msg/") and kind.endswith("MultiArray"):
        return _array(message, where)
    raise LibraryError(
        f"{where} must be {_IMAGE} or a std_msgs array such as "
        f"std_msgs/msg/Float32MultiArray, got {kind}."
    )


def _picture(message: Any, where: str) -> Array:
    n_rows, n_cols, step = int(message.height), int(message.width), int(message.step)
    encoding = str(message.encoding)
    if encoding not in _GREY and encoding not in _COLOUR:
        known = ", ".join([*_GREY, *_COLOUR])
        raise LibraryError(f"{where} must be encoded as {known}, got {encoding!r}.")
    n_channels = 1 if encoding in _GREY else 4 if "a" in encoding else 3
    order = ">" if message.is_bigendian else "<"
    dtype = np.dtype(order + _GREY.get(encoding, "u1"))
    row_bytes = n_cols * n_channels * dtype.itemsize
    content = np.asarray(message.data, dtype=np.uint8).tobytes()
    if step < row_bytes or not row_bytes or len(content) != step * n_rows:
        raise LibraryError(
            f"{where} must hold {n_rows} rows of {step} bytes, got {len(content)} "
            f"bytes for {n_cols} columns of {encoding}."
        )
    rows = np.frombuffer(content, np.uint8).reshape(n_rows, step)[:, :row_bytes]
    values = np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="))
    if encoding in _GREY:
        return values
    colours = values.reshape(n_rows, n_cols, n_channels)[..., list(_COLOUR[encoding])]
    grey: Array = np.rint(colours @ _LUMA).astype(np.uint8)
    return grey


def _array(message: Any, where: str) -> Array:
    values = np.asarray(message.data)
    sizes = [int(d.size) for d in message.layout.dim if int(d.size) > 1]
    shape = (1, len(values)) if not sizes else (1, *sizes)[-2:]
    start = int(message.layout.data_offset)
    n_values = shape[0] * shape[1]
    if len(sizes) > 2 or n_values != len(values) - start or not n_values:
        raise LibraryError(
            f"{where} must hold one array of rows and columns, got dimensions "
            f"{sizes} for {len(values)} values."
        )
    return values[start:].reshape(shape)


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
    starts = range(0, len(numbers), AT_ONCE)
    parts = (read_touches(store, numbers[s : s + AT_ONCE]) for s in starts)
    _write_tables(path, map(_parquet_table, parts), compression="zstd")


def _write_lerobot(path: Path, store: Store, numbers: Numbers) -> None:
    pa = needed("pyarrow", "parquet", "Writing a LeRobotDataset")
    data = path / "data" / _FILE.format(0, 0)
    data.parent.mkdir(parents=True)
    dataset = _Dataset()
    episodes = (read_touches(store, some) for some in _episodes(store, numbers))
    _write_tables(data, (_frame_table(pa, dataset.add(e)) for e in episodes))
    _write_meta(pa, path / "meta", dataset)


_WRITERS: dict[str, Callable[[Path, Store, Numbers], None]] = {
    ".npz": lambda path, store, numbers: read_touches(store, numbers).save(path),
    ".parquet": _write_parquet,
    "": _write_lerobot,
}


def _write_tables(path: Path, tables: Iterable[Any], **options: Any) -> None:
    """Write tables of one schema into one Parquet file, one row group each."""
    pq = needed("pyarrow.parquet", "parquet", "Writing Parquet")
    writer: Any = None
    with ExitStack() as closing:
        for table in tables:
            if writer is None:
                writer = pq.ParquetWriter(path, table.schema, **options)
                closing.enter_context(writer)
            writer.write_table(table.cast(writer.schema))


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


def _episodes(store: Store, numbers: Numbers) -> list[Numbers]:
    """Return the numbers of the touches of each object, session and episode."""
    columns = "o.name, t.session, t.episode, t.number"
    sql = f"SELECT {columns} {FROM} WHERE t.number IN (?) ORDER BY t.number"
    groups: dict[tuple[Any, ...], list[int]] = {}
    for *key, number in store.among(sql, numbers.tolist()):
        groups.setdefault(tuple(key), []).append(number)
    return [np.array(some) for some in groups.values()]


class _Dataset:
    """What a LeRobotDataset says of its episodes, gathered one by one."""

    def __init__(self) -> None:
        self.tasks: dict[str, int] = {}
        self.rows: list[dict[str, Any]] = []
        self.features: dict[str, Any] = {}
        self._spread: dict[str, Floats] = {}  # sum, of squares, least, most

    @property
    def n_frames(self) -> int:
        """Frames of all episodes so far."""
        return int(self.rows[-1]["dataset_to_index"]) if self.rows else 0

    def add(self, touches: Touches) -> dict[str, Array]:
        """Take in the touches of one episode, all of one object; return its frames."""
        task = f"touch {'' if touches.object is None else touches.object[0]}".strip()
        task_index = self.tasks.setdefault(task, len(self.tasks))
        number, first = len(self.rows), self.n_frames
        frames = _lerobot_frames(touches, number, first, task_index)
        for name, values in frames.items():
            shape = list(values.shape[1:]) or [1]
            feature = {"dtype": values.dtype.name, "shape": shape, "names": None}
            self.features.setdefault(name, feature)
            wide = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
            sums = np.stack([wide.sum(0), (wide**2).sum(0), wide.min(0), wide.max(0)])
            if name in self._spread:
                known = self._spread[name]
                sums[:2] += known[:2]
                sums[2] = np.minimum(known[2], sums[2])
                sums[3] = np.maximum(known[3], sums[3])
            self._spread[name] = sums
        self.rows.append(
            {
                "episode_index": number,
                "tasks": [task],
                "length": len(touches),
                "data/chunk_index": 0,
                "data/file_index": 0,
                "dataset_from_index": first,
                "dataset_to_index": first + len(touches),
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
        )
        return frames

    def spread(self) -> dict[str, Any]:
        """Return minimum, maximum, mean and deviation of each feature over all."""
        result = {}
        for name, (total, squares, least, most) in self._spread.items():
            mean = total / self.n_frames
            sd = np.sqrt(np.maximum(squares / self.n_frames - mean**2, 0))
            shape = self.features[name]["shape"]
            values = {"min": least, "max": most, "mean": mean, "std": sd}
            result[name] = {k: v.reshape(shape).tolist() for k, v in values.items()}
            result[name]["count"] = [self.n_frames]
        return result


def _lerobot_frames(
    touches: Touches, episode: int, first: int, task: int
) -> dict[str, Array]:
    """Return frames by feature; where times are not known, they count touches."""
    n_touches = len(touches)
    number = np.arange(n_touches, dtype=np.int64)
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
        "episode_index": np.full(n_touches, episode, np.int64),
        "index": first + number,
        "task_index": np.full(n_touches, task, np.int64),
    }


def _frame_table(pa: Any, frames: dict[str, Array]) -> Any:
    arrays = {}
    for name, values in frames.items():
        nested = pa.from_numpy_dtype(values.dtype)
        for _ in values.shape[1:]:
            nested = pa.list_(nested)
        arrays[name] = pa.array(values.tolist() if values.ndim > 1 else values, nested)
    return pa.table(arrays)


def _write_meta(pa: Any, meta: Path, dataset: _Dataset) -> None:
    pq = needed("pyarrow.parquet", "parquet", "Writing a LeRobotDataset")
    info = {
        "codebase_version": _LEROBOT_VERSION,
        "robot_type": None,
        "total_episodes": len(dataset.rows),
        "total_frames": dataset.n_frames,
        "total_tasks": len(dataset.tasks),
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": _FRAMES_PER_SECOND,
        "splits": {"train": f"0:{len(dataset.rows)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": dataset.features,
    }
    episodes = meta / "episodes" / _FILE.format(0, 0)
    episodes.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(dataset.rows), episodes)
    tasks = dataset.tasks
    table = pa.table({"task_index": list(tasks.values()), "task": list(tasks)})
    # Readers take the task's name from the index of a pandas table.
    about = {"index_columns": ["task"], "columns": [], "column_indexes": []}
    table = table.replace_schema_metadata({"pandas": json.dumps(about)})
    pq.write_table(table, meta / "tasks.parquet")
    (meta / "info.json").write_text(json.dumps(info, indent=4))
    (meta / "stats.json").write_text(json.dumps(dataset.spread()))
