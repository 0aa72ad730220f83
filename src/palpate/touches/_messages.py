"""Frames out of ROS messages, from a bag or off the wire, without ROS.

What each kind means stands with `palpate.library.read_bag`. A message is any object
with the fields of its kind.
"""

from typing import Any

import numpy as np

from .._types import Array
from ._columns import TouchesError
from ._pictures import decode_bytes

_IMAGE = "sensor_msgs/msg/Image"
_PICTURE = "sensor_msgs/msg/CompressedImage"
_CLOUD = "sensor_msgs/msg/PointCloud2"
_GREY = {"mono8": "u1", "8UC1": "u1", "mono16": "u2", "16UC1": "u2", "32FC1": "f4"}
_RGB, _BGR = (0, 1, 2), (2, 1, 0)
_COLOUR = {"rgb8": _RGB, "bgr8": _BGR, "rgba8": _RGB, "bgra8": _BGR}
_LUMA = np.array([0.299, 0.587, 0.114])
# What sensor_msgs/msg/PointField calls the types of fields.
_POINT_TYPES = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), 1))


def shows_frame(kind: str) -> bool:
    """Tell whether messages of a kind hold a frame: pictures, clouds, arrays."""
    arrays = kind.startswith("std_msgs/msg/") and kind.endswith("MultiArray")
    return arrays or kind in (_IMAGE, _PICTURE, _CLOUD)


def frame_of_message(message: Any, kind: str, where: str = "A message") -> Array:
    """Return what a message of a kind such as `sensor_msgs/msg/Image` shows."""
    if kind == _IMAGE:
        return _picture(message, where)
    if kind == _PICTURE:
        try:
            return decode_bytes(np.asarray(message.data, np.uint8).tobytes())
        except TouchesError as error:
            raise TouchesError(f"{where}: {error}") from error
    if kind == _CLOUD:
        return _cloud(message, where)
    if shows_frame(kind):
        return _array(message, where)
    raise TouchesError(
        f"{where} must be {_IMAGE}, {_PICTURE}, {_CLOUD} or a std_msgs array such as "
        f"std_msgs/msg/Float32MultiArray, got {kind}."
    )


def _cloud(message: Any, where: str) -> Array:
    """Return the reading of each point, (n_rows, n_cols), as a cloud lays them out."""
    fields = {str(f.name): f for f in message.fields if str(f.name) not in "xyz"}
    names = [name for name in fields if name == "intensity"] or list(fields)
    n_rows, n_cols = int(message.height), int(message.width)
    if len(names) != 1 or fields[names[0]].datatype not in _POINT_TYPES:
        listed = ", ".join(fields) or "none"
        raise TouchesError(
            f"{where} must have one reading a point beside x, y and z, or a field "
            f"intensity, got the fields {listed}."
        )
    field = fields[names[0]]
    order = ">" if message.is_bigendian else "<"
    dtype = np.dtype(order + _POINT_TYPES[field.datatype])
    content = np.asarray(message.data, dtype=np.uint8)
    step, row_step = int(message.point_step), int(message.row_step)
    inside = 0 <= field.offset <= step - dtype.itemsize and row_step >= n_cols * step
    if not inside or not n_rows * n_cols or content.size != row_step * n_rows:
        raise TouchesError(
            f"{where} must hold {n_rows} rows of {n_cols} points of {step} bytes, got "
            f"{content.size} bytes in rows of {row_step}."
        )
    points = content.reshape(n_rows, row_step)[:, : n_cols * step]
    cells = points.reshape(n_rows, n_cols, step)[..., field.offset :]
    values = np.ascontiguousarray(cells[..., : dtype.itemsize]).view(dtype)[..., 0]
    return values.astype(dtype.newbyteorder("="))


def _picture(message: Any, where: str) -> Array:
    n_rows, n_cols, step = int(message.height), int(message.width), int(message.step)
    encoding = str(message.encoding)
    if encoding not in _GREY and encoding not in _COLOUR:
        encodings = ", ".join([*_GREY, *_COLOUR])
        raise TouchesError(f"{where} must be encoded as {encodings}, got {encoding!r}.")
    n_channels = 1 if encoding in _GREY else 4 if "a" in encoding else 3
    order = ">" if message.is_bigendian else "<"
    dtype = np.dtype(order + _GREY.get(encoding, "u1"))
    row_bytes = n_cols * n_channels * dtype.itemsize
    content = np.asarray(message.data, dtype=np.uint8).tobytes()
    if step < row_bytes or not row_bytes or len(content) != step * n_rows:
        raise TouchesError(
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
        raise TouchesError(
            f"{where} must hold one array of rows and columns, got dimensions "
            f"{sizes} for {len(values)} values."
        )
    return values[start:].reshape(shape)
