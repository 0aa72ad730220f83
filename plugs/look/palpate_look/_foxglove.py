"""MCAP for Foxglove: images and decisions as ROS 2 messages, beliefs as JSON.

Topics: `/tactile` and `/touch` of `sensor_msgs/msg/Image`, `/decision` of
`rcl_interfaces/msg/Log`, `/belief` of JSON (`/belief.posterior.mug` can be plotted).
That has no schema, for rosbags opens no file with a JSON schema in it; so what was
touched comes back through `palpate library add FILE --topic /touch`.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._log import Belief, Log, nanoseconds

Array = NDArray[Any]
_IMAGE, _SAID = "sensor_msgs/msg/Image", "rcl_interfaces/msg/Log"
_ENCODINGS = {"u1": "mono8", "u2": "mono16"}
_RGB, _INFO = ("r", "g", "b"), 20


class FoxgloveLog(Log):
    """An MCAP file; `Log` explains the rest.

    8 and 16 bits stay what they are, all else is written as float32: exact to 24 bits.
    Three channels r, g and b are one picture; others have a topic each, `/tactile/x`.
    """

    def __init__(self, path: str | Path) -> None:
        from mcap.writer import Writer
        from rosbags.typesys import Stores, get_typestore

        super().__init__(path)
        self._types: Any = get_typestore(Stores.LATEST)
        self._file = self.path.open("xb")
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library="palpate")
        self._schemas: dict[str, int] = {"": 0}
        self._channels: dict[str, int] = {}

    def _image(
        self, name: str, image: Array, time_s: float, channels: Sequence[str] | None
    ) -> None:
        if image.ndim == 2 or tuple(channels or ()) == _RGB:
            self._picture(f"/{name}", image, time_s)
            return
        for index, channel in enumerate(channels or range(image.shape[2])):
            self._picture(f"/{name}/{channel}", image[..., index], time_s)

    def _picture(self, topic: str, image: Array, time_s: float) -> None:
        if image.ndim == 3:
            encoding, image = "rgb8", image.astype(np.uint8)
        elif (kind := image.dtype.str[1:]) in _ENCODINGS:
            encoding = _ENCODINGS[kind]
        else:
            encoding, image = "32FC1", image.astype(np.float32)
        little = np.ascontiguousarray(image, image.dtype.newbyteorder("<"))
        message = self._types.types[_IMAGE](
            header=self._types.types["std_msgs/msg/Header"](
                stamp=self._stamp(time_s), frame_id="tactile"
            ),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=little.nbytes // image.shape[0],
            data=little.reshape(-1).view(np.uint8),
        )
        self._send(topic, _IMAGE, message, time_s)

    def _belief(self, belief: Belief, time_s: float) -> None:
        written = json.dumps(belief, allow_nan=False, default=str)
        self._send("/belief", "", written.encode(), time_s)

    def _said(self, words: str, time_s: float) -> None:
        message = self._types.types[_SAID](
            stamp=self._stamp(time_s),
            level=_INFO,
            name="palpate",
            msg=words,
            file="",
            function="",
            line=0,
        )
        self._send("/decision", _SAID, message, time_s)

    def _stamp(self, time_s: float) -> Any:
        seconds, rest = divmod(nanoseconds(time_s), 10**9)
        stamp = self._types.types["builtin_interfaces/msg/Time"]
        return stamp(sec=seconds, nanosec=rest)

    def _send(self, topic: str, kind: str, message: Any, time_s: float) -> None:
        if topic not in self._channels:
            if kind not in self._schemas:
                text, _ = self._types.generate_msgdef(kind, ros_version=2)
                known = {"name": kind, "encoding": "ros2msg", "data": text.encode()}
                self._schemas[kind] = self._writer.register_schema(**known)
            encoding = "cdr" if kind else "json"
            self._channels[topic] = self._writer.register_channel(
                topic, encoding, self._schemas[kind]
            )
        data = self._types.serialize_cdr(message, kind) if kind else message
        at = nanoseconds(time_s)
        self._writer.add_message(self._channels[topic], at, bytes(data), at)

    def _end(self) -> None:
        if not self._file.closed:
            self._writer.finish()
            self._file.close()
