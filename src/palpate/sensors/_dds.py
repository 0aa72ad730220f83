"""Topics and services of ROS 2 over DDS, without ROS: what rmw_cyclonedds puts there.

A topic `/tactile` of `sensor_msgs/msg/Image` is `rt/tactile` of the DDS type
`sensor_msgs::msg::dds_::Image_`, in XCDR1; Fast DDS names and writes topics alike. A
service is a topic of requests (`rq/...Request`) and one of replies (`rr/...Reply`),
each with a client's number and the request's before the message: rmw_cyclonedds does
so, rmw_fastrtps carries the two elsewhere, where Cyclone's Python does not reach.
Eclipse Cyclone DDS carries the bytes; rosbags makes them and reads them, since
Cyclone's Python takes milliseconds an image. The network is that of `CYCLONEDDS_URI`.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from .._extras import needed
from ._contract import SensorError
from .ros import DEPTH, WHAT, Answer, Endpoint, answered, ros_kind, store, wire_kind

# What DDS calls the policies that keep a writer and a reader apart.
_POLICIES = {2: "durability", 4: "deadline", 8: "liveliness", 11: "reliability"}
_REPRESENTATION = 23
_POLICIES[_REPRESENTATION] = "data representation"
_CDR_HEAD, _REQUEST_HEAD = 4, 16
_CONFIGURATION = "CYCLONEDDS_URI"
_BUFFERS = (
    '<CycloneDDS><Domain Id="any"><Internal><SocketReceiveBufferSize max="4MB"/>'
    "</Internal></Domain></CycloneDDS>"
)


class DdsNode:
    """A participant in a domain of DDS, what `ROS_DOMAIN_ID` is to ROS.

    `hint` is what to look at where a topic is not found.
    """

    hint = "CYCLONEDDS_URI"

    def __init__(self, domain: int) -> None:
        domains = needed("cyclonedds.domain", "ros", WHAT)
        builtin = needed("cyclonedds.builtin", "ros", WHAT)
        store()
        try:
            with _large_buffers():
                self._participant = domains.DomainParticipant(domain)
        except Exception as error:  # DDSException, of which the cause is in its log
            raise SensorError(
                f"DDS cannot enter domain {domain}: {error} Check CYCLONEDDS_URI and "
                "that its network is up."
            ) from error
        self._discovery = builtin.BuiltinDataReader(
            self._participant, builtin.BuiltinTopicDcpsPublication
        )

    def publishers(self, topic: str) -> list[Endpoint]:
        """Return the publishers of ROS topics that are seen now, of any topic."""
        alive = needed("cyclonedds.core", "ros", WHAT).InstanceState.Alive
        seen = []
        for sample in self._discovery.read(N=1000):
            name = str(getattr(sample, "topic_name", "") or "")
            kind = ros_kind(str(getattr(sample, "type_name", "") or ""))
            about = getattr(sample, "sample_info", None)
            is_there = about is None or about.instance_state & alive
            if name.startswith("rt/") and kind is not None and is_there:
                seen.append(Endpoint(name.removeprefix("rt"), kind))
        return seen

    def subscribe(self, topic: str, kind: str, *, reliable: bool) -> "DdsReader":
        """Return what reads the messages of a topic, none from before this call."""
        about = _topic(self._participant, f"rt{topic}", kind)
        return DdsReader(self._participant, about, kind, reliable=reliable)

    def publish(self, topic: str, kind: str) -> "DdsWriter":
        """Return what writes messages of a kind to a topic, reliably.

        The last message is kept for readers that ask for it (transient local).
        """
        about = _topic(self._participant, f"rt{topic}", kind)
        return DdsWriter(self._participant, about, kind, keep_last=True)

    def serve(self, service: str, kind: str, answer: Answer) -> "DdsService":
        """Return a service that answers requests by a function of the message."""
        return DdsService(self._participant, service, kind, answer)

    def close(self) -> None:
        """Leave the domain; readers and writers end with it."""
        self._discovery = self._participant = None


class DdsReader:
    """The messages of one topic, as bytes."""

    def __init__(
        self, participant: Any, topic: Any, kind: str, *, reliable: bool
    ) -> None:
        core = needed("cyclonedds.core", "ros", WHAT)
        sub = needed("cyclonedds.sub", "ros", WHAT)
        self.kind = kind
        quality = _quality(reliable=reliable)
        self._reader = sub.DataReader(participant, topic, qos=quality)
        states = core.ViewState.Any | core.InstanceState.Any | core.SampleState.NotRead
        self._waitset = core.WaitSet(participant)
        self._waitset.attach(core.ReadCondition(self._reader, states))

    def take(self, wait_s: float) -> list[bytes]:
        """Return the messages that came, waiting so long for the first."""
        if not self._waitset.wait(int(wait_s * 1e9)):
            return []
        samples = self._reader.take(N=DEPTH)
        return [sample.raw for sample in samples if hasattr(sample, "raw")]

    @property
    def n_publishers(self) -> int:
        """Number of publishers it is matched with now."""
        return len(self._reader.get_matched_publications())

    @property
    def hindrance(self) -> str:
        """The policy of a publisher that keeps it from being heard, or ""."""
        return _policy(self._reader.get_requested_incompatible_qos_status())


class DdsWriter:
    """Writes messages of one kind to one topic."""

    def __init__(
        self, participant: Any, topic: Any, kind: str, *, keep_last: bool = False
    ) -> None:
        pub = needed("cyclonedds.pub", "ros", WHAT)
        self._type = dds_type(kind)
        quality = _quality(reliable=True, keep_last=keep_last)
        self._writer = pub.DataWriter(participant, topic, qos=quality)

    def write_bytes(self, raw: bytes) -> None:
        """Write a message that is bytes already, with CDR's head of four."""
        sample = self._type.__new__(self._type)
        sample.raw = raw
        self._writer.write(sample)

    @property
    def hindrance(self) -> str:
        """The policy of a reader that keeps it from hearing, or ""."""
        return _policy(self._writer.get_offered_incompatible_qos_status())


class DdsService:
    """A service in the layout of rmw_cyclonedds."""

    def __init__(
        self, participant: Any, service: str, kind: str, answer: Answer
    ) -> None:
        self._kind, self._answer = kind, answer
        ask, reply = f"{kind}_Request", f"{kind}_Response"
        requests = _topic(participant, f"rq{service}Request", ask)
        replies = _topic(participant, f"rr{service}Reply", reply)
        self._reader = DdsReader(participant, requests, ask, reliable=True)
        self._writer = DdsWriter(participant, replies, reply)

    def poll(self) -> None:
        """Answer the requests that have come; one that is damaged has no answer."""
        for raw in self._reader.take(0.0):
            start = _CDR_HEAD + _REQUEST_HEAD
            head, body = raw[_CDR_HEAD:start], raw[:_CDR_HEAD] + raw[start:]
            reply = answered(body, self._kind, self._answer)
            if reply is not None:
                self._writer.write_bytes(reply[:_CDR_HEAD] + head + reply[_CDR_HEAD:])


@contextmanager
def _large_buffers() -> Iterator[None]:
    """Let sockets hold a dozen frames of 640 x 480, unless the user says otherwise.

    Cyclone's own 1 MB holds three, and what comes beside that is lost. Of a list of
    configurations the later ones count.
    """
    configuration = os.environ.get(_CONFIGURATION, "")
    os.environ[_CONFIGURATION] = ",".join(filter(None, (_BUFFERS, configuration)))
    try:
        yield
    finally:
        if configuration:
            os.environ[_CONFIGURATION] = configuration
        else:
            del os.environ[_CONFIGURATION]


@cache
def dds_type(kind: str) -> Any:
    """Return a type of Cyclone DDS, made of rosbags' fields, that carries bytes."""
    struct = _struct.__wrapped__(kind)
    struct.serialize = lambda self, **_: self.raw
    struct.deserialize = staticmethod(lambda data, **_: _carried(struct, data))
    return struct


def _carried(struct: Any, data: bytes) -> Any:
    sample = struct.__new__(struct)
    sample.raw = bytes(data)
    return sample


@cache
def _struct(kind: str) -> Any:
    idl = needed("cyclonedds.idl", "ros", WHAT)
    types = needed("cyclonedds.idl.types", "ros", WHAT)
    _, group, name = kind.split("/")
    fields = {field: _field(node) for field, node in store().fielddefs[kind][1]}
    if group == "srv":
        fields = {"client": types.uint64, "number": types.int64, **fields}
    return idl.make_idl_struct(f"{name}_", wire_kind(kind).replace("::", "."), fields)


def _field(node: Any) -> Any:
    """Return what Cyclone DDS calls the type of a field."""
    types = needed("cyclonedds.idl.types", "ros", WHAT)
    what, about = node
    if what.name == "NAME":
        return _struct(about)
    if what.name == "BASE":
        plain = {"string": str, "bool": bool, "byte": types.uint8}
        return plain.get(about[0]) or getattr(types, about[0])
    if what.name == "ARRAY":
        return types.array[_field(about[0]), about[1]]
    return types.sequence[_field(about[0])]


def _topic(participant: Any, name: str, kind: str) -> Any:
    topics = needed("cyclonedds.topic", "ros", WHAT)
    return topics.Topic(participant, name, dds_type(kind))


def _quality(*, reliable: bool, keep_last: bool = False) -> Any:
    policy = needed("cyclonedds.qos", "ros", WHAT).Policy
    wait_ns = 100_000_000
    return needed("cyclonedds.qos", "ros", WHAT).Qos(
        policy.Reliability.Reliable(wait_ns)
        if reliable
        else policy.Reliability.BestEffort,
        policy.Durability.TransientLocal if keep_last else policy.Durability.Volatile,
        policy.History.KeepLast(DEPTH),
        policy.DataRepresentation(use_cdrv0_representation=True),
    )


def _policy(status: Any) -> str:
    """Return the policy that a status of DDS blames, or ""."""
    if not status.total_count:
        return ""
    number = int(status.last_policy_id)
    return _POLICIES.get(number, f"policy {number}")
