"""Bags of ROS 2 that are whole files but hold messages that no program writes."""

import sqlite3
import struct
from functools import cache
from itertools import product

import lz4.frame
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.rosbag2.writer import zstd  # of the standard library from 3.14 on
from rosbags.typesys import Stores, get_typestore

SIZES = [0, 1, 2, 3, 4, 5, 7, 255, 2**16, 2**31, 2**32 - 1]
ENCODINGS = [
    "mono8",
    "mono16",
    "16UC1",
    "32FC1",
    "rgb8",
    "bgra8",
    "",
    "yuv422",
    "é" * 99,
]
KINDS = ["UInt8", "Int16", "Float32", "Float64", "Int64", "Byte"]
# Values that replace a cell of the table of messages.
CELLS = [None, "text", -1, 2**62, 0.5, b"", b"\0" * 4, b"\0\1\0\0" * 64]


@cache
def store():
    return get_typestore(Stores.ROS2_HUMBLE)


def bag(chance, folder):
    """Write a bag of the topic /pad, SQLite or MCAP, with a share of odd messages."""
    plugin = chance.choice([StoragePlugin.SQLITE3, StoragePlugin.MCAP])
    odd_share, n_messages = chance.choice([0.0, 0.2, 1.0]), chance.choice([0, 1, 3])
    path = folder / "bag"
    writer = Writer(path, version=9, storage_plugin=plugin)
    if chance.random() < 0.2:
        modes = [CompressionMode.MESSAGE, CompressionMode.FILE]
        modes += [CompressionMode.STORAGE] * (plugin is StoragePlugin.MCAP)
        writer.set_compression(chance.choice(modes), CompressionFormat.ZSTD)
    picture = chance.random() < 0.5
    kind = chance.choice(KINDS)
    with writer:
        connections = {}
        for number in range(n_messages):
            odd = chance.random() < odd_share
            if odd and chance.random() < 0.3:
                picture, kind = chance.random() < 0.5, chance.choice(KINDS)
            message = _image(chance, odd) if picture else _array(chance, odd, kind)
            if odd and chance.random() < 0.1:
                message = store().types["std_msgs/msg/String"]("no touch")
            name = message.__msgtype__
            if name not in connections:
                connections[name] = writer.add_connection(
                    "/pad", name, typestore=store()
                )
            raw = bytes(store().serialize_cdr(message, name))
            if odd and chance.random() < 0.5:
                raw = _damaged(raw, chance)
            time_ns = chance.choice([0, 10**9, 2**62]) if odd else number * 10**9
            writer.write(connections[name], time_ns, raw)
    if plugin is StoragePlugin.SQLITE3 and chance.random() < 0.3:
        _alter_rows(path, chance)
    return path


def _image(chance, odd):
    types, order = store().types, chance.choice([0, 1])
    values = np.arange(12, dtype=np.uint16).reshape(3, 4)
    rows, cols, step, encoding = 3, 4, 8, "mono16"
    content = values.astype(">u2" if order else "<u2").tobytes()
    if odd:
        rows, cols, step = (
            chance.choice([right, right, *SIZES]) for right in (rows, cols, step)
        )
        encoding = chance.choice(ENCODINGS)
        order = chance.choice([order, 255])
        content = content[: chance.choice([0, 11, 24])] * chance.choice([1, 3])
        if chance.random() < 0.3:
            content = b"\x00\x00\x80\x7f" * 12  # infinity as 32FC1
    when = types["builtin_interfaces/msg/Time"](
        *(chance.choice([-(2**31), 0, 2**31 - 1]), 2**32 - 1) if odd else (7, 5)
    )
    header = types["std_msgs/msg/Header"](when, "pad")
    data = np.frombuffer(content, np.uint8)
    return types["sensor_msgs/msg/Image"](
        header, rows, cols, encoding, order, step, data
    )


def _array(chance, odd, kind):
    types = store().types
    sizes, offset, n_values = [3, 4], 0, 12
    if odd:
        sizes = chance.choice([[], [12], [3, 4, 1], *([s, 4] for s in SIZES), SIZES])
        offset = chance.choice([0, 1, 12, 2**31, 2**32 - 1])
        n_values = chance.choice([0, 11, 12, 13])
    dims = [types["std_msgs/msg/MultiArrayDimension"]("d", n, n) for n in sizes]
    layout = types["std_msgs/msg/MultiArrayLayout"](dims, offset)
    message_type = types[f"std_msgs/msg/{kind}MultiArray"]
    dtype = {"UInt8": np.uint8, "Byte": np.uint8}.get(kind) or getattr(np, kind.lower())
    values = np.arange(n_values).astype(dtype)
    if odd and values.dtype.kind == "f" and n_values:
        values[0] = chance.choice([np.nan, np.inf, 1.0])
    return message_type(layout, values)


def _damaged(raw, chance):
    """Return a message with another 4-byte word, often a length, or cut."""
    at = 4 * chance.randrange(len(raw) // 4)
    word = chance.choice([0, 1, 2**16, 2**31 - 1, 2**32 - 1]).to_bytes(4, "little")
    return chance.choice([raw[:at], raw[:at] + word + raw[at + 4 :], raw[at:], b""])


def _alter_rows(path, chance):
    """Give a column of a SQLite bag a value of another kind."""
    for file in path.glob("*.db3"):
        column = chance.choice(["topic_id", "timestamp", "data"])
        with sqlite3.connect(file) as database:
            value = chance.choice(CELLS)
            try:
                database.execute(f"UPDATE messages SET {column} = ?", [value])
            except sqlite3.IntegrityError:
                return
        database.close()


def bombs(folder, n_bytes):
    """Write small bags that unpack to `n_bytes`: whole ones, then forged ones."""
    folder.mkdir(exist_ok=True)
    whole, forged = [], []
    modes = [CompressionMode.MESSAGE, CompressionMode.FILE, CompressionMode.STORAGE]
    kind = "std_msgs/msg/UInt8MultiArray"
    layout = store().types["std_msgs/msg/MultiArrayLayout"]([], 0)
    values = store().types[kind](layout, np.zeros(n_bytes, np.uint8))
    raw = store().serialize_cdr(values, kind)
    for plugin, mode in product(StoragePlugin, modes):
        if (plugin, mode) == (StoragePlugin.SQLITE3, CompressionMode.STORAGE):
            continue
        path = folder / f"{plugin.name}_{mode.name}"
        writer = Writer(path, version=9, storage_plugin=plugin)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            writer.write(writer.add_connection("/pad", kind, typestore=store()), 0, raw)
        whole.append(path)
    zeros, stream = bytes(n_bytes), zstd.ZstdCompressor()
    for name, compression, packed, size in [
        ("true", "lz4", lz4.frame.compress(zeros), n_bytes),
        ("lying", "lz4", lz4.frame.compress(zeros, store_size=False), 1000),
        ("no_size", "zstd", stream.compress(zeros) + stream.flush(), 1000),
        ("frames", "zstd", zstd.compress(zeros[: 2**20]) * (n_bytes // 2**20), n_bytes),
    ]:
        forged.append(folder / f"{name}.mcap")
        forged[-1].write_bytes(_one_chunk(compression, packed, size))
    return whole, forged


def _one_chunk(compression, packed, size):
    """Return an MCAP file of one chunk that claims to unpack to `size`, no index."""
    kind = struct.pack("<I", len(compression)) + compression.encode()
    chunk = struct.pack("<QQQI", 0, 0, size, 0) + kind + struct.pack("<Q", len(packed))
    records = [(1, b"\4\0\0\0ros2\0\0\0\0"), (6, chunk + packed), (2, bytes(20))]
    written = b"".join(struct.pack("<BQ", op, len(r)) + r for op, r in records)
    return b"\x89MCAP0\r\n" + written + b"\x89MCAP0\r\n"
