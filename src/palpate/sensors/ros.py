"""Messages and services of ROS 2 as rosbags makes and reads them, named as ROS does.

Both wires, DDS and zenoh, carry the same bytes (CDR) and name types alike:
`sensor_msgs::msg::dds_::Image_` is `sensor_msgs/msg/Image`.
"""

import re
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from .._extras import needed

WHAT = "A topic of ROS 2"
MAX_MESSAGE = 2**26  # bytes: 64 MiB hold any image
DEPTH = 64  # messages that may wait
STRING, CLASSIFICATION = "std_msgs/msg/String", "vision_msgs/msg/Classification"
TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"
# What is not among rosbags' own types, as ROS writes it.
_MESSAGES = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    CLASSIFICATION: "std_msgs/Header header\nvision_msgs/ObjectHypothesis[] results\n",
}
_ANSWER = "bool success\nstring message\n"
_SERVICES = {TRIGGER: ("", _ANSWER), SET_BOOL: ("bool data\n", _ANSWER)}

Answer = Callable[[Any], tuple[bool, str]]


class Endpoint(NamedTuple):
    """A publisher that was discovered: topic and kind as ROS writes them."""

    topic: str
    kind: str


class Header(NamedTuple):
    """Time (`sec`, `nanosec`) and frame of a message."""

    sec: int
    nanosec: int
    frame_id: str


@cache
def store() -> Any:
    """Return rosbags' types of ROS 2, with those of vision_msgs and std_srvs."""
    typesys = needed("rosbags.typesys", "ros", WHAT)
    types = typesys.get_typestore(typesys.Stores.LATEST)
    for name, text in _MESSAGES.items():
        types.register(typesys.get_types_from_msg(text, name))
    for name, texts in _SERVICES.items():
        for part, text in zip(("Request", "Response"), texts, strict=True):
            read = typesys.get_types_from_msg(text, f"{name}_{part}")
            # rosbags calls these std_srvs/srv/msg/..., ROS does not.
            types.register({f"{name}_{part}": fields for fields in read.values()})
    return types


def ros_kind(name: str) -> str | None:
    """Return `sensor_msgs/msg/Image` of `sensor_msgs::msg::dds_::Image_`, else None."""
    parts = re.fullmatch(r"(\w+)::msg::dds_::(\w+)_", name)
    return parts and f"{parts[1]}/msg/{parts[2]}"


def wire_kind(kind: str) -> str:
    """Return `sensor_msgs::msg::dds_::Image_` of `sensor_msgs/msg/Image`."""
    package, group, name = kind.split("/")
    return f"{package}::{group}::dds_::{name}_"


def read_message(raw: bytes, kind: str) -> Any:
    """Return the message in bytes; damaged ones raise whatever rosbags raises."""
    return store().deserialize_cdr(raw, kind)


def write_message(message: Any, kind: str) -> bytes:
    """Return a message as bytes, with CDR's head of four."""
    return bytes(store().serialize_cdr(message, kind))


def text_message(text: str) -> Any:
    """Return a `std_msgs/msg/String`."""
    return store().types[STRING](text)


def answered(raw: bytes, kind: str, answer: Answer) -> bytes | None:
    """Return the response of a service to a request, both in bytes.

    `kind` is that of the service, such as `std_srvs/srv/Trigger`. A damaged request has
    no response.
    """
    try:
        request = read_message(raw, f"{kind}_Request")
    except Exception:  # rosbags raises many kinds on damaged bytes
        return None
    message = store().types[f"{kind}_Response"](*answer(request))
    return write_message(message, f"{kind}_Response")


def classification(header: Header, shares: dict[str, float]) -> Any:
    """Return a `vision_msgs/msg/Classification`: names and probabilities in order."""
    types = store().types
    stamp = types["builtin_interfaces/msg/Time"](header.sec, header.nanosec)
    head = types["std_msgs/msg/Header"](stamp, header.frame_id)
    kind = types["vision_msgs/msg/ObjectHypothesis"]
    return types[CLASSIFICATION](head, [kind(*share) for share in shares.items()])
