"""Topics of ROS 2 over DDS, without ROS: what rmw_cyclonedds and Fast DDS put there.

A topic `/tactile` of `sensor_msgs/msg/Image` is `rt/tactile` of the DDS type
`sensor_msgs::msg::dds_::Image_`, in XCDR1. Eclipse Cyclone DDS carries the bytes;
rosbags makes them and reads them, since Cyclone's Python takes milliseconds an image.
The network is that of `CYCLONEDDS_URI`, where set.
"""

import re
import time
from functools import cache
from typing import Any, NamedTuple

from .._extras import needed
from ._contract import SensorError

MAX_MESSAGE = 2**26
_WHAT = "A topic of ROS 2"
_DEPTH = 64
_LOOK_S = 0.05
# What DDS calls the policies that keep a writer and a reader apart.
_POLICIES = {2: "durability", 4: "deadline", 8: "liveliness", 11: "reliability"}
_REPRESENTATION = 23
_POLICIES[_REPRESENTATION] = "data representation"


class Endpoint(NamedTuple):
    """A publisher that DDS has discovered: topic and kind as ROS writes them."""

    topic: str
    kind: str
    reliable: bool


class DdsNode:
    """A participant in a domain: it discovers, subscribes and publishes.

    Parameters
    ----------
    domain : int
        What `ROS_DOMAIN_ID` is to ROS.

    Raises
    ------
    ImportError
        cyclonedds or rosbags is missing; the message names the extra.
    SensorError
        The domain cannot be entered: a network that is not there.
    """

    def __init__(self, domain: int) -> None:
        domains = needed("cyclonedds.domain", "ros", _WHAT)
        builtin = needed("cyclonedds.builtin", "ros", _WHAT)
        store()
        try:
            self._participant = domains.DomainParticipant(domain)
        except Exception as error:  # DDSException, of which the cause is in its log
            raise SensorError(
                f"DDS cannot enter domain {domain}: {error} Check CYCLONEDDS_URI and "
                "that its network is up."
            ) from error
        self.domain = domain
        self._discovery = builtin.BuiltinDataReader(
            self._participant, builtin.BuiltinTopicDcpsPublication
        )

    def publishers(self) -> list[Endpoint]:
        """Return the publishers of ROS topics that are seen now."""
        policy = needed("cyclonedds.qos", "ros", _WHAT).Policy
        seen = []
        for sample in self._discovery.read(N=1000):
            name = str(getattr(sample, "topic_name", "") or "")
            kind = ros_kind(str(getattr(sample, "type_name", "") or ""))
            if not name.startswith("rt/") or kind is None or not _alive(sample):
                continue
            reliable = policy.Reliability.BestEffort not in sample.qos
            seen.append(Endpoint(name.removeprefix("rt"), kind, reliable))
        return seen

    def subscribe(self, topic: str, kind: str, *, reliable: bool) -> "DdsReader":
        """Return what reads the messages of a topic, none from before this call."""
        return DdsReader(self._participant, topic, kind, reliable=reliable)

    def publish(self, topic: str, kind: str) -> "DdsWriter":
        """Return what writes messages of a kind to a topic, reliably."""
        return DdsWriter(self._participant, topic, kind)

    def close(self) -> None:
        """Leave the domain; readers and writers end with it."""
        self._discovery = self._participant = None


class DdsReader:
    """The messages of one topic, as bytes."""

    def __init__(
        self, participant: Any, topic: str, kind: str, *, reliable: bool
    ) -> None:
        core = needed("cyclonedds.core", "ros", _WHAT)
        sub = needed("cyclonedds.sub", "ros", _WHAT)
        self.kind = kind
        quality = _quality(reliable=reliable)
        self._reader = sub.DataReader(
            participant, _topic(participant, topic, kind), qos=quality
        )
        states = core.ViewState.Any | core.InstanceState.Any | core.SampleState.NotRead
        self._waitset = core.WaitSet(participant)
        self._waitset.attach(core.ReadCondition(self._reader, states))

    def take(self, wait_s: float) -> list[bytes]:
        """Return the messages that came, waiting so long for the first."""
        if not self._waitset.wait(int(wait_s * 1e9)):
            return []
        samples = self._reader.take(N=_DEPTH)
        return [one.raw for one in samples if hasattr(one, "raw")]

    @property
    def n_publishers(self) -> int:
        """How many publishers it is matched with now."""
        return len(self._reader.get_matched_publications())

    @property
    def hindrance(self) -> str:
        """The policy of a publisher that keeps it from being heard, or ""."""
        status = self._reader.get_requested_incompatible_qos_status()
        if not status.total_count:
            return ""
        number = int(status.last_policy_id)
        return _POLICIES.get(number, f"policy {number}")


class DdsWriter:
    """Writes messages of one kind to one topic."""

    def __init__(self, participant: Any, topic: str, kind: str) -> None:
        pub = needed("cyclonedds.pub", "ros", _WHAT)
        self._kind, self._type = kind, dds_type(kind)
        quality = _quality(reliable=True)
        self._writer = pub.DataWriter(
            participant, _topic(participant, topic, kind), qos=quality
        )

    def write(self, message: Any) -> None:
        """Write a message of rosbags' type of its kind."""
        self.write_bytes(bytes(store().serialize_cdr(message, self._kind)))

    def write_bytes(self, raw: bytes) -> None:
        """Write a message that is bytes already, with CDR's head of four."""
        sample = self._type.__new__(self._type)
        sample.raw = raw
        self._writer.write(sample)

    def wait_for_reader(self, wait_s: float) -> bool:
        """Wait until somebody reads it; return whether somebody does."""
        end_s = time.monotonic() + wait_s
        while not self._writer.get_matched_subscriptions():
            if time.monotonic() > end_s:
                return False
            time.sleep(_LOOK_S)
        return True


@cache
def store() -> Any:
    """Return rosbags' types of ROS 2, and vision_msgs' classification."""
    typesys = needed("rosbags.typesys", "ros", _WHAT)
    types = typesys.get_typestore(typesys.Stores.LATEST)
    texts = {
        "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
        "vision_msgs/msg/Classification": (
            "std_msgs/Header header\nvision_msgs/ObjectHypothesis[] results\n"
        ),
    }
    for name, text in texts.items():
        types.register(typesys.get_types_from_msg(text, name))
    return types


def ros_kind(name: str) -> str | None:
    """Return `sensor_msgs/msg/Image` of `sensor_msgs::msg::dds_::Image_`, else None."""
    parts = re.fullmatch(r"(\w+)::msg::dds_::(\w+)_", name)
    return parts and f"{parts[1]}/msg/{parts[2]}"


@cache
def dds_type(kind: str) -> Any:
    """Return a type of Cyclone DDS, made of rosbags' fields, that carries bytes."""
    made = _struct.__wrapped__(kind)
    made.serialize = lambda self, **_: self.raw
    made.deserialize = staticmethod(lambda data, **_: _carried(made, data))
    return made


def _carried(made: Any, data: bytes) -> Any:
    sample = made.__new__(made)
    sample.raw = bytes(data)
    return sample


@cache
def _struct(kind: str) -> Any:
    idl = needed("cyclonedds.idl", "ros", _WHAT)
    package, _, name = kind.split("/")
    fields = {field: _field(node) for field, node in store().fielddefs[kind][1]}
    dds_name = f"{package}.msg.dds_.{name}_"
    return idl.make_idl_struct(f"{name}_", dds_name, fields)


def _field(node: Any) -> Any:
    """Return what Cyclone DDS calls the type of a field."""
    types = needed("cyclonedds.idl.types", "ros", _WHAT)
    what, about = node
    if what.name == "NAME":
        return _struct(about)
    if what.name == "BASE":
        plain = {"string": str, "bool": bool, "byte": types.uint8}
        return plain.get(about[0]) or getattr(types, about[0])
    if what.name == "ARRAY":
        return types.array[_field(about[0]), about[1]]
    return types.sequence[_field(about[0])]


def _topic(participant: Any, topic: str, kind: str) -> Any:
    topics = needed("cyclonedds.topic", "ros", _WHAT)
    return topics.Topic(participant, f"rt/{topic.strip('/')}", dds_type(kind))


def _quality(*, reliable: bool) -> Any:
    qos = needed("cyclonedds.qos", "ros", _WHAT)
    policy = qos.Policy
    wait_ns = 100_000_000
    return qos.Qos(
        policy.Reliability.Reliable(wait_ns)
        if reliable
        else policy.Reliability.BestEffort,
        policy.History.KeepLast(_DEPTH),
        policy.DataRepresentation(use_cdrv0_representation=True),
    )


def _alive(sample: Any) -> bool:
    """Tell whether what DDS has discovered is still there."""
    core = needed("cyclonedds.core", "ros", _WHAT)
    information = getattr(sample, "sample_info", None)
    return information is None or bool(
        information.instance_state & core.InstanceState.Alive
    )
