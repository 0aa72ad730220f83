"""A topic of ROS 2 as a sensor: images, clouds or arrays that somebody publishes."""

import time
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._checks import check_count, check_option, check_positive
from .._types import Array
from ..touches import TouchesError, frame_reader
from ._contract import LiveSensor, Reading, SensorError
from ._ros_wires import DdsNode, DdsReader, ZenohNode, ZenohReader
from .ros import MAX_MESSAGE, Header, read_message

# What carries topics: both have these methods and attributes.
RosNode = DdsNode | ZenohNode
RosReader = DdsReader | ZenohReader
VIA = ("dds", "zenoh")
_TICK_S = 0.2  # between looks at whether to stop
_MATCH_S = 1.0  # until publisher and reader have met
_HEADERS = 4096  # of the newest frames


def open_node(domain: int, via: str) -> RosNode:
    """Return a participant in a domain of ROS over "dds" or "zenoh".

    Raises
    ------
    ImportError
        What carries it is not installed.
    SensorError
        The network, or its configuration, is not there.
    """
    _check(domain, via)
    return DdsNode(domain) if via == "dds" else ZenohNode(domain)


def _check(domain: int, via: str) -> None:
    check_count("domain", domain, at_least=0, at_most=232)
    check_option("via", via, VIA)


class RosSensor(LiveSensor):
    """Frames that are published on a topic of ROS 2; no ROS is needed here.

    Parameters
    ----------
    topic : str
        Its name, such as "/tactile".
    image_shape : (int, int), optional
        (n_rows, n_cols) that its frames must have; without it the first message is
        waited for at once, and says.
    domain : int, default=0
        What `ROS_DOMAIN_ID` is to its publisher, 0 to 232.
    qos : {"best_effort", "reliable"}, default="best_effort"
        Best effort hears all publishers; reliable asks again for what was lost, and
        hears no publisher of best effort, as drivers of cameras are.
    wait_s : float, default=20
        How long connecting waits for the first message.
    via : {"dds", "zenoh"}, default="dds"
        What carries it: DDS, which Cyclone and Fast DDS speak, or rmw_zenoh's zenoh.

    Notes
    -----
    Messages are those of `palpate.library.read_bag`; colour becomes luma. A message
    that is damaged, of another size, another type of numbers or not finite is counted
    as lost, and `lost` says why: never is a frame made of it. A publisher that goes
    and comes back is heard again.
    """

    queue_length = 64

    def __init__(
        self,
        topic: str,
        image_shape: tuple[int, int] | None = None,
        *,
        domain: int = 0,
        qos: str = "best_effort",
        wait_s: float = 20.0,
        via: str = "dds",
    ) -> None:
        self.topic = "/" + topic.strip("/")
        _check(domain, via)
        self.domain, self._via = int(domain), via
        check_option("qos", qos, ("best_effort", "reliable"))
        self._reliable = qos == "reliable"
        self._wait_s = check_positive("wait_s", wait_s)
        self._node: RosNode | None = None
        self._reader: RosReader | None = None
        self._headers: OrderedDict[float, Header] = OrderedDict()
        self._first: list[Reading] = []
        self._given_shape = image_shape
        shape = (1, 1) if image_shape is None else image_shape
        super().__init__(f"topic {self.topic}", "as published", shape, np.uint8)
        if image_shape is None:
            try:
                self._open()
            finally:
                self._close()

    def _open(self) -> None:
        end_s = time.monotonic() + self._wait_s
        self._node = node = open_node(self.domain, self._via)
        kind = self._kind(node, end_s)
        self._reader = node.subscribe(self.topic, kind, reliable=self._reliable)
        self._learn(self._first_frames(self._reader, end_s))

    def _kind(self, node: RosNode, end_s: float) -> str:
        """Wait for a publisher of the topic; return the kind of its messages."""
        while True:
            seen = node.publishers(self.topic)
            kinds = sorted({p.kind for p in seen if p.topic == self.topic})
            able = [kind for kind in kinds if frame_reader(kind)]
            if len(kinds) == 1 and able:
                return kinds[0]
            if kinds:
                raise SensorError(
                    f"{self.topic} must hold messages of one kind that is an image, a "
                    f"cloud or an array, got {', '.join(kinds)}. Name another topic."
                )
            if time.monotonic() > end_s:
                others = ", ".join(sorted({p.topic for p in seen})) or "none"
                raise SensorError(
                    f"Nobody publishes {self.topic} in domain {self.domain} (waited "
                    f"{self._wait_s:g} s; topics seen: {others}). Start its publisher, "
                    f"or check the name, domain= and {node.hint}."
                )
            if self._stop.wait(0.05):
                raise SensorError(f"{self.name} was disconnected.")

    def _first_frames(self, reader: RosReader, end_s: float) -> list[Reading]:
        """Return the frames that came together first, at least one."""
        self.lost = ""
        while True:
            frames = [*filter(None, map(self._frame, reader.take(_TICK_S)))]
            if frames:
                return frames
            if time.monotonic() > end_s or self._stop.is_set():
                raise SensorError(self.lost or self._silence(reader))
            waited_s = time.monotonic() - end_s + self._wait_s
            if waited_s > _MATCH_S and reader.hindrance and not reader.n_publishers:
                raise SensorError(self._silence(reader))

    def _silence(self, reader: RosReader) -> str:
        """Return why nothing is heard, as far as DDS knows."""
        if not reader.n_publishers:
            if reader.hindrance:
                return (
                    f"{self.topic} has a publisher that does not match, by its "
                    f"{reader.hindrance}. Leave qos out, or change the publisher's."
                )
            return f"nobody publishes {self.topic} now. Start its publisher again."
        return f"{self.topic} has a publisher that sends nothing."

    def _learn(self, first: list[Reading]) -> None:
        """Take size and type of the first frame, or explain that they are others."""
        expected, frame = self._given_shape, first[0].image
        if expected is not None and frame.shape != tuple(expected):
            raise SensorError(
                f"{self.topic} gives frames of {frame.shape[0]} x {frame.shape[1]}, "
                f"shape asks for {expected[0]} x {expected[1]}. Leave shape out."
            )
        self._given_shape = self.image_shape = frame.shape
        self.dtype = frame.dtype
        self._first = [reading for reading in first if self._is_alike(reading.image)]

    def _grab(self) -> Sequence[Reading]:
        if self._first:
            first, self._first = self._first, []
            return first
        assert self._reader is not None
        read = filter(None, map(self._frame, self._reader.take(_TICK_S)))
        frames = [frame for frame in read if self._is_alike(frame.image)]
        if not frames and not self._reader.n_publishers:
            self.lost = self._silence(self._reader)
        return frames

    def _is_alike(self, frame: Array) -> bool:
        if (frame.shape, frame.dtype) == (self.image_shape, self.dtype):
            return True
        was = "{} x {} of {}".format(*self.image_shape, self.dtype)
        now = "{} x {} of {}".format(*frame.shape, frame.dtype)
        self._refuse(f"{self.topic} gives frames of {now} now, it gave {was}. Restart.")
        return False

    def _frame(self, raw: bytes) -> Reading | None:
        """Return the frame in a message; None, and `lost` says why, without one."""
        assert self._reader is not None
        kind, where = self._reader.kind, f"A message of {self.topic}"
        try:
            if len(raw) > MAX_MESSAGE:
                raise TouchesError(f"{where} must have at most 64 MiB, got {len(raw)}.")
            message: Any = read_message(raw, kind)
            read_frame = frame_reader(kind)
            assert read_frame is not None  # no other kind is read
            frame = read_frame(message, where)
            if frame.size == 0 or (frame.dtype.kind == "f" and np.isinf(frame).any()):
                raise TouchesError(f"{where} must hold finite readings.")
        except TouchesError as error:
            self._refuse(str(error))
        except Exception as error:  # rosbags raises many kinds on damaged bytes
            self._refuse(f"{where} is damaged: {str(error) or type(error).__name__}.")
        else:
            return Reading(frame, device_time_s=self._stamped(message))
        return None

    def _stamped(self, message: Any) -> float | None:
        """Return when a message was made, in seconds, and keep its header."""
        header = getattr(message, "header", None)
        if header is None or not (header.stamp.sec or header.stamp.nanosec):
            return None
        kept = Header(header.stamp.sec, header.stamp.nanosec, str(header.frame_id))
        time_s = float(kept.sec + kept.nanosec / 1e9)
        self._headers[time_s] = kept
        if len(self._headers) > _HEADERS:
            self._headers.popitem(last=False)
        return time_s

    def header_at(self, device_time_s: float) -> Header | None:
        """Return the header of the message with this `device_time_s`, None if old."""
        return self._headers.get(device_time_s)

    def _refuse(self, why: str) -> None:
        self._count_missed(1)
        self.lost = why

    def _close(self) -> None:
        self._reader = None
        if self._node is not None:
            self._node.close()
        self._node = None
