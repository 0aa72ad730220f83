"""Touches from bags of ROS 2 and 1 and MCAP files, without ROS; a message is a touch.

- `sensor_msgs/msg/Image`, encodings mono8, mono16, 8UC1, 16UC1, 32FC1, rgb8, bgr8,
  rgba8 and bgra8; colour becomes its luma (ITU-R BT.601), rounded.
- `sensor_msgs/msg/CompressedImage` that is a JPEG or PNG, read as other pictures are.
- `sensor_msgs/msg/PointCloud2` of taxels: one reading a point, its field `intensity`,
  or the only one beside x, y and z; height and width are rows and columns.
- `std_msgs/msg/*MultiArray`: the last two dimensions of `layout.dim` that are longer
  than one are rows and columns; without a layout the values are one row.

`time_s` is the stamp in the message's header, or the time of recording where there
is none (both in seconds since 1970); `order` counts the messages.

A bag in SQLite (`.db3`) has no checksum, and one in MCAP may lack it: a flipped bit in
a message is read as it stands. `set_bag_sha256`, of times and messages as they were
read, is kept with the touches: the bag can be compared with it from then on.
"""

import bz2
import hashlib
import threading
from functools import cache, partial
from importlib import import_module, metadata
from io import BytesIO
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from .._checks import did_you_mean
from .._extras import needed
from .._types import Array
from ..touches import Touches, TouchesError, frame_reader
from ._store import LibraryError

MAX_BYTES = 4 * 2**30  # as of Touches.load
_KINDS = (
    "sensor_msgs/msg/Image, sensor_msgs/msg/CompressedImage, "
    "sensor_msgs/msg/PointCloud2"
)
_PARTS = {".mcap", ".db3", ".db3-wal", ".db3-shm"}
_SIMULATED_S = 1e8  # three years: stamps of the world's clock are later
_room = threading.local()  # how much the bag that is read may still unpack to


def read_bag(
    path: str | Path,
    topic: str | None = None,
    *,
    object: str | None = None,
    max_bytes: int = MAX_BYTES,
) -> Touches:
    """Read one topic of a bag of ROS, or of what packages add, as touches.

    Parameters
    ----------
    path : path
        The bag (a folder, `.mcap`, `.db3`, or `.bag` of ROS 1); with the package of
        `plugs/lerobot` the folder of a LeRobotDataset too: its features are topics.
    topic : str, optional
        A topic of images, point clouds or arrays; may be left out where it is the only
        one.
    object : str, optional
        What is touched in all of it.
    max_bytes : int, default=4 GiB
        Most memory that the images may take. What is compressed may unpack to a
        sixteenth of it and 64 times the size of the bag.

    Raises
    ------
    ImportError
        rosbags is missing; the message names the extra.
    LibraryError
        It is no bag, unpacks to too much, lacks the topic, or a message is no image.
    """
    for plugged in _readers(Path(path)):
        touches: Touches = plugged.read(Path(path), topic, object, max_bytes)
        return touches
    highlevel = needed("rosbags.highlevel", "ros", "Reading ROS bags")
    typesys = needed("rosbags.typesys", "ros", "Reading ROS bags")
    types = typesys.get_typestore(typesys.Stores.LATEST)
    bag = Path(path)
    _have_unpacking_counted()
    try:
        size = sum(part.stat().st_size for part in (bag, *bag.glob("*")))
        _room.left, _room.bag = max_bytes // 16 + 64 * size, bag
        with highlevel.AnyReader([bag], default_typestore=types) as reader:
            topic = _chosen_topic(reader, topic)
            images, times, digest = _messages(reader, topic, max_bytes)
        return Touches(
            np.stack(images),
            object=None if object is None else np.full(len(images), object),
            order=np.arange(len(images)),
            time_s=np.array(times),
            set_topic=np.array(topic),
            set_bag_sha256=np.array(digest),
        )
    except (LibraryError, ImportError):
        raise
    except TouchesError as error:  # a message that is no image, or no touch
        raise LibraryError(str(error)) from error
    except Exception as error:  # rosbags raises many kinds on damaged bags
        raise LibraryError(
            f"{bag} must be a bag of ROS or an MCAP file, got: "
            f"{str(error).rstrip('.') or type(error).__name__}. Check the path; of a "
            "recording that was cut off `ros2 bag reindex` mends the folder, `mcap "
            "recover` an .mcap and `rosbag reindex` a .bag."
        ) from error
    finally:
        _room.left = inf


def is_recording(path: Path) -> bool:
    """Tell whether `read_bag` is for a file or folder, by its name and its files."""
    by_name = path.suffix.lower() in (".mcap", ".db3", ".bag")
    endings = {part.suffix for part in path.glob("*")}  # without metadata it was cut
    of_bag = _says_bag(path / "metadata.yaml") or set() < endings <= _PARTS
    return by_name or of_bag or bool(_readers(path))


def _says_bag(path: Path) -> bool:
    """Tell whether a file begins as that of a bag; others are about something else."""
    try:
        with path.open("rb") as file:
            return b"rosbag2_bagfile_information" in file.read(2**12)
    except OSError:
        return False


def _readers(path: Path) -> list[Any]:
    """Return the modules of installed packages that read what lies there.

    Entry points of the group `palpate.recordings`: modules with `is_dataset(path)` and
    `read(path, topic, object, max_bytes)`.
    """
    plugged = [
        point.load() for point in metadata.entry_points(group="palpate.recordings")
    ]
    able = [module for module in plugged if module.is_dataset(path)]
    if not able and (path / "meta" / "info.json").is_file():
        raise LibraryError(
            f"{path} looks like a LeRobotDataset: install what reads it, plugs/lerobot."
        )
    return able


@cache
def _have_unpacking_counted() -> None:
    """Count what rosbags is about to unpack: it has no limit, and sizes may lie."""
    bags: Any = import_module("rosbags.rosbag2.reader")
    chunks: Any = import_module("rosbags.rosbag2.storage_mcap")
    old: Any = import_module("rosbags.rosbag1.reader").decompressors
    zstd, unpack = bags.zstd, chunks.decompress
    openers = {"zstd": zstd.open, "lz4": import_module("lz4.frame").open}
    bags.zstd = SimpleNamespace(
        decompress=lambda data: zstd.decompress(_counted(data, zstd.open)),
        open=lambda file, mode: zstd.open(_counted(file, zstd.open), mode),
    )
    chunks.decompress = lambda data, kind, *sizes: unpack(
        _counted(data, openers[kind]) if kind in openers else data, kind, *sizes
    )
    for kind, opener in {**openers, "bz2": bz2.open}.items():
        if kind in old:
            old[kind] = partial(_counted_old, old[kind], opener)


def _counted_old(unpack: Any, opener: Any, packed: bytes) -> Any:
    """Unpack a chunk of a bag of ROS 1, if what room is left allows."""
    return unpack(_counted(packed, opener))


def _counted(packed: Any, opener: Any) -> Any:
    """Return packed bytes or a file of them, if they unpack to what room is left."""
    file = packed if hasattr(packed, "read") else BytesIO(packed)
    unpacked = opener(file)
    while piece := unpacked.read(2**20):
        _room.left = getattr(_room, "left", inf) - len(piece)
        if _room.left < 0:
            raise LibraryError(
                f"{_room.bag} must unpack to at most max_bytes / 16 and 64 times its "
                "size, got more. If you trust it raise max_bytes or rosbags-convert it."
            )
    file.seek(0)
    return packed


def _chosen_topic(reader: Any, topic: str | None) -> str:
    """Return the topic that is read; the only one that can be where none is named."""
    kinds = {c.topic: str(c.msgtype) for c in reader.connections}
    able: list[str] = [name for name, kind in kinds.items() if frame_reader(kind)]
    if topic in kinds:
        return str(topic)
    if topic is None and len(able) == 1:
        return able[0]
    listed = ", ".join(f"{n} of {kind}" for n, kind in sorted(kinds.items())) or "none"
    raise LibraryError(
        f"topic must be one of the bag ({listed}), got {topic!r}."
        f"{did_you_mean(topic or '', kinds)}"
    )


def _messages(
    reader: Any, topic: str, max_bytes: int
) -> tuple[list[Array], list[float], str]:
    chosen = [c for c in reader.connections if c.topic == topic]
    images: list[Array] = []
    stamps: list[float] = []
    recorded: list[float] = []
    n_bytes = 0
    digest = hashlib.sha256()
    for connection, recorded_ns, raw in reader.messages(connections=chosen):
        digest.update(f"{recorded_ns} {len(raw)} ".encode() + bytes(raw))
        message = reader.deserialize(raw, connection.msgtype)
        where = f"message {len(images)} of {topic}"
        if (read_frame := frame_reader(connection.msgtype)) is None:
            raise LibraryError(
                f"{where} must be {_KINDS} or a std_msgs array such as "
                f"std_msgs/msg/Float32MultiArray, got {connection.msgtype}."
            )
        image = read_frame(message, where)
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
        stamps.append(0.0 if stamp is None else float(stamp.sec + stamp.nanosec / 1e9))
        recorded.append(recorded_ns / 1e9)
    if len(images) < (n_counted := sum(c.msgcount for c in chosen)):
        raise LibraryError(
            f"{topic} must have {n_counted} messages, as its bag counts them, got "
            f"{len(images)}. Copy the bag again; of its .db3 or .mcap, given by "
            "itself, what is there is read."
        )
    if not images:
        raise LibraryError(f"topic must have messages, got none in {topic!r}.")
    # Of a clock that began at 0 that is a time, else it says that there is none.
    began = 0 < max(stamps) < _SIMULATED_S
    times = [s if began else s or r for s, r in zip(stamps, recorded, strict=True)]
    return images, times, digest.hexdigest()
