"""Another process on the network: messages whose types are written here by hand.

`python ros_peer.py TOPIC WHAT [DOMAIN]` publishes until its standard input ends.
"""

import sys
import threading
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic


@dataclass
class Time_(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header_(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time_
    frame_id: str


@dataclass
class Image_(IdlStruct, typename="sensor_msgs.msg.dds_.Image_"):
    header: Header_
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class Dimension_(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayDimension_"):
    label: str
    size: uint32
    stride: uint32


@dataclass
class Layout_(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayLayout_"):
    dim: sequence[Dimension_]
    data_offset: uint32


@dataclass
class Float32_(IdlStruct, typename="std_msgs.msg.dds_.Float32MultiArray_"):
    layout: Layout_
    data: sequence[float32]


@dataclass
class String_(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class Hypothesis_(IdlStruct, typename="vision_msgs.msg.dds_.ObjectHypothesis_"):
    class_id: str
    score: float64


@dataclass
class Classification_(IdlStruct, typename="vision_msgs.msg.dds_.Classification_"):
    header: Header_
    results: sequence[Hypothesis_]


def picture(number, side=12, *, height=None, encoding="mono8"):
    """Return a picture of grey level `number`; `height` may lie."""
    header = Header_(Time_(1000 + number, 500_000_000), "pad")
    data = [number % 250] * side * side
    size = side if height is None else height
    return Image_(header, size, side, encoding, 0, side, data)


def message(what, number):
    if what == "array":
        layout = Layout_([Dimension_("rows", 3, 6), Dimension_("cols", 2, 2)], 0)
        return Float32_(layout, [number + 0.5] * 6)
    if what == "string":
        return String_("no image")
    if what == "hostile":  # each fourth is right
        kinds = [
            picture(number),
            picture(number, height=2**32 - 1),
            picture(number, height=5),
            picture(number, encoding="yuv422"),
        ]
        return kinds[number % 4]
    if what == "resize" and number >= 20:
        return picture(number, side=8)
    return picture(number)


def main(topic, what, domain="0"):
    """Publish at about 100 Hz, in bursts of eight if asked, once there is a reader."""
    first = message(what, 0)
    reliability = Policy.Reliability.BestEffort
    if what == "reliable":
        reliability = Policy.Reliability.Reliable(10**9)
    plain = Policy.DataRepresentation(use_cdrv0_representation=True)
    qos = Qos(reliability, Policy.History.KeepLast(10), plain)
    participant = DomainParticipant(int(domain))
    about = Topic(participant, f"rt{topic}", type(first))
    writer = DataWriter(participant, about, qos=qos)
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set())).start()
    number = 0
    while not ended.is_set():
        if writer.get_matched_subscriptions():
            writer.write(message(what, number))
            number += 1
        if what != "burst" or number % 8 == 0:
            time.sleep(0.08 if what == "burst" else 0.01)


if __name__ == "__main__":
    main(*sys.argv[1:])
