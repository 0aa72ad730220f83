"""Foxglove: a file (MCAP) or a running app; all messages are those of ROS 2.

Topics: `/tactile` and `/touch` of `sensor_msgs/msg/Image`, `/decision` of
`rcl_interfaces/msg/Log`, `/belief` of `palpate_msgs/msg/Belief`, whose text stands
beside it as its schema: any reader of MCAP that knows ROS 2 decodes it, rosbags too,
and `/belief.results[:]{class_id=="mug"}.score` is what Foxglove plots. Touches
come back through `palpate library add FILE --topic /touch`.
"""

import re
from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._log import Belief, Log, nanoseconds

Array = NDArray[Any]
_IMAGE, _LOG = "sensor_msgs/msg/Image", "rcl_interfaces/msg/Log"
_BELIEF, _HYPOTHESIS = "palpate_msgs/msg/Belief", "vision_msgs/msg/ObjectHypothesis"
# Results are in the order of probability; "unknown" is none of the learnt objects.
_TEXTS = {
    _HYPOTHESIS: "string class_id\nfloat64 score\n",
    _BELIEF: (
        "std_msgs/Header header\nuint32 episode\nuint32 touch\n"
        "vision_msgs/ObjectHypothesis[] results\n"
        "string best\nstring decision\nstring reason\n"
    ),
}
_ENCODINGS = {"u1": "mono8", "u2": "mono16"}
_RGB, _INFO = ("r", "g", "b"), 20


class Schema(NamedTuple):
    """The text of a kind of message, with those of its fields."""

    kind: str
    text: bytes


class RosLog(Log):
    """A log of messages of ROS 2; `Log` explains the rest.

    8 and 16 bits stay what they are, all else is written as float32: exact to 24 bits.
    Three channels r, g and b are one picture; others have a topic each, `/tactile/x`.
    """

    def __init__(self, path: str | Path | None = None) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        super().__init__(path)
        self._types: Any = get_typestore(Stores.LATEST)
        for kind, text in _TEXTS.items():
            self._types.register(get_types_from_msg(text, kind))
        self._channels: dict[str, Any] = {}

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
            header=self._header(time_s),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=little.nbytes // image.shape[0],
            data=little.reshape(-1).view(np.uint8),
        )
        self._send(topic, _IMAGE, message, time_s)

    def _belief(self, belief: Belief, time_s: float) -> None:
        shares = dict(belief["posterior"])
        if belief["unknown"] is not None:
            shares["unknown"] = belief["unknown"]
        hypothesis = self._types.types[_HYPOTHESIS]
        message = self._types.types[_BELIEF](
            header=self._header(time_s),
            episode=belief["episode"],
            touch=belief["touch"],
            results=[
                hypothesis(str(name), float(share))
                for name, share in sorted(shares.items(), key=lambda item: -item[1])
            ],
            best=str(belief["best"] or ""),
            decision=str(belief["decision"] or ""),
            reason=belief["reason"],
        )
        self._send("/belief", _BELIEF, message, time_s)

    def _decision(self, words: str, time_s: float) -> None:
        message = self._types.types[_LOG](
            stamp=self._header(time_s).stamp,
            level=_INFO,
            name="palpate",
            msg=words,
            file="",
            function="",
            line=0,
        )
        self._send("/decision", _LOG, message, time_s)

    def _header(self, time_s: float) -> Any:
        seconds, rest = divmod(nanoseconds(time_s), 10**9)
        stamp = self._types.types["builtin_interfaces/msg/Time"]
        header = self._types.types["std_msgs/msg/Header"]
        return header(stamp=stamp(sec=seconds, nanosec=rest), frame_id="tactile")

    def _send(self, topic: str, kind: str, message: Any, time_s: float) -> None:
        if topic not in self._channels:
            text, _ = self._types.generate_msgdef(kind, ros_version=2)
            self._channels[topic] = self._channel(topic, Schema(kind, text.encode()))
        raw = bytes(self._types.serialize_cdr(message, kind))
        self._write(self._channels[topic], raw, nanoseconds(time_s))

    @abstractmethod
    def _channel(self, topic: str, schema: Schema) -> Any:
        """Return what the messages of a topic are written to."""

    @abstractmethod
    def _write(self, channel: Any, raw: bytes, at_ns: int) -> None: ...


class FoxgloveLog(RosLog):
    """An MCAP file; `RosLog` explains the rest."""

    def __init__(self, path: str | Path) -> None:
        from mcap.writer import Writer

        super().__init__(path)
        self._file = self.path.open("xb")
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library="palpate")
        self._schemas: dict[str, int] = {}

    def _channel(self, topic: str, schema: Schema) -> int:
        if schema.kind not in self._schemas:
            self._schemas[schema.kind] = self._writer.register_schema(
                name=schema.kind, encoding="ros2msg", data=schema.text
            )
        number = self._schemas[schema.kind]
        return int(self._writer.register_channel(topic, "cdr", number))

    def _write(self, channel: int, raw: bytes, at_ns: int) -> None:
        self._writer.add_message(channel, at_ns, raw, at_ns)

    def _end(self) -> None:
        if not self._file.closed:
            self._writer.finish()
            self._file.close()


class FoxgloveLive(RosLog):
    """A server that Foxglove connects to: "Open connection", `ws://127.0.0.1:8765`.

    Parameters
    ----------
    address : str
        `ws://HOST:PORT`; port 0 takes a free one. Whoever reaches it sees the sensor.

    Attributes
    ----------
    port : int
        Where it listens.

    Raises
    ------
    ImportError
        foxglove-sdk is missing.
    ValueError
        The address is none.
    OSError
        The port is taken.
    """

    def __init__(self, address: str | Path) -> None:
        match = re.fullmatch(r"ws:/+([^/:]+):(\d{1,5})/?", str(address))
        if match is None:
            raise ValueError(f"It must be like ws://127.0.0.1:8765, got {address!s}.")
        try:
            import foxglove
        except ImportError as error:
            raise ImportError(
                "A running Foxglove needs foxglove, which is not installed: "
                "pip install foxglove-sdk"
            ) from error
        super().__init__()
        self._foxglove, self._context = foxglove, foxglove.Context()
        host, port = match[1], int(match[2])
        try:
            self._server = foxglove.start_server(
                name="palpate", host=host, port=port, context=self._context
            )
        except Exception as error:  # of its own kind, where the port is taken
            raise OSError(
                f"Foxglove cannot be served at {address!s}: {error}"
            ) from error
        self.port = int(self._server.port)

    def _channel(self, topic: str, schema: Schema) -> Any:
        return self._foxglove.Channel(
            topic,
            message_encoding="cdr",
            schema=self._foxglove.Schema(
                name=schema.kind, encoding="ros2msg", data=schema.text
            ),
            context=self._context,
        )

    def _write(self, channel: Any, raw: bytes, at_ns: int) -> None:
        channel.log(raw, log_time=at_ns)

    def _end(self) -> None:
        self._server.stop()
