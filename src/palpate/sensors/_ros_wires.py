"""Topics and services of ROS 2 without ROS: over DDS, and over zenoh.

Over DDS it is what rmw_cyclonedds puts there. A topic `/tactile` of
`sensor_msgs/msg/Image` is `rt/tactile` of the DDS type
`sensor_msgs::msg::dds_::Image_`, in XCDR1; Fast DDS names and writes topics alike. A
service is a topic of requests (`rq/...Request`) and one of replies (`rr/...Reply`),
each with a client's number and the request's before the message: rmw_cyclonedds does
so, rmw_fastrtps carries the two elsewhere, where Cyclone's Python does not reach.
Eclipse Cyclone DDS carries the bytes; rosbags makes them and reads them, since
Cyclone's Python takes milliseconds an image. The network is that of `CYCLONEDDS_URI`.

Over zenoh it is the layout of rmw_zenoh. A message of a topic has the key
`DOMAIN/TOPIC/TYPE/HASH` and, beside its bytes, the number of the message, its time and
its writer. Who is there is told by tokens under `@ros2_lv`. Sessions meet at a router
(`ros2 run rmw_zenoh_cpp rmw_zenohd`), at localhost unless `ZENOH_SESSION_CONFIG_URI`
names a file of zenoh's configuration; `ZENOH_CONFIG_OVERRIDE` (`KEY=VALUE;...`) changes
single values, as for rmw_zenoh.
"""

import os
import secrets
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from .._extras import needed
from ._contract import SensorError
from .ros import (
    DEPTH,
    SET_BOOL,
    TRIGGER,
    WHAT,
    Answer,
    Endpoint,
    answered,
    ros_kind,
    store,
    wire_kind,
)

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
_ROUTER = "tcp/localhost:7447"
_TOKENS = "@ros2_lv"
_QUALITY = f"::,{DEPTH}:,:,:,,"  # reliable, volatile, the last 64
_RECENT_S = 2.0  # after its last message a publisher counts as there
# What ROS publishes as the type hashes of services: rosbags knows those of messages.
SERVICE_HASHES = {
    TRIGGER: "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    SET_BOOL: "RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
}


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
    bare = _struct.__wrapped__(kind)
    bare.serialize = lambda self, **_: self.raw
    bare.deserialize = staticmethod(lambda data, **_: _carried(bare, data))
    return bare


def _carried(kind: Any, data: bytes) -> Any:
    sample = kind.__new__(kind)
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
    kept = policy.History.KeepLast(DEPTH)
    # What a reader gets that comes later is a history of its own, of one by default.
    for_late = [policy.DurabilityService(0, kept, -1, -1, -1)] if keep_last else []
    return needed("cyclonedds.qos", "ros", WHAT).Qos(
        policy.Reliability.Reliable(wait_ns)
        if reliable
        else policy.Reliability.BestEffort,
        policy.Durability.TransientLocal if keep_last else policy.Durability.Volatile,
        kept,
        *for_late,
        policy.DataRepresentation(use_cdrv0_representation=True),
    )


def _policy(status: Any) -> str:
    """Return the policy that a status of DDS blames, or ""."""
    if not status.total_count:
        return ""
    number = int(status.last_policy_id)
    return _POLICIES.get(number, f"policy {number}")


class ZenohNode:
    """A session of zenoh, with the methods of `DdsNode`."""

    hint = f"that a router runs at {_ROUTER} or where ZENOH_SESSION_CONFIG_URI says"

    def __init__(self, domain: int) -> None:
        zenoh = needed("zenoh", "zenoh", "A topic over zenoh")
        store()
        try:
            self._session = zenoh.open(_configuration(zenoh))
        except Exception as error:  # ZError, and what a file that is none raises
            raise SensorError(
                f"zenoh cannot open a session: {error} Check ZENOH_SESSION_CONFIG_URI "
                "and ZENOH_CONFIG_OVERRIDE."
            ) from error
        self._domain, self._number = domain, 0
        self._held: list[Any] = []
        self._watches: dict[str, Any] = {}
        self._tokens: set[str] = set()
        self._seen: dict[str, dict[str, float]] = {}  # by topic the time of each kind
        prefix = f"{_TOKENS}/{domain}/{self._session.zid()}/0"
        self._prefix, self._node = prefix, "%/%/palpate"
        self._declare(f"{prefix}/0/NN/{self._node}")
        self._held.append(
            self._session.liveliness().declare_subscriber(
                f"{_TOKENS}/{domain}/**", self._token, history=True
            )
        )

    def publishers(self, topic: str) -> list[Endpoint]:
        """Return the publishers that have told of themselves, or sent on `topic`."""
        if topic not in self._seen:
            self._seen[topic] = {}
            key = f"{self._domain}{topic}/*/*"
            # Not all who publish in this layout have tokens.
            watch = self._session.declare_subscriber(key, self._watched(topic))
            self._watches[topic] = watch
        senders = [Endpoint(topic, kind) for kind in [*self._seen[topic]]]
        return [*senders, *_publishers(self._tokens)]

    def subscribe(self, topic: str, kind: str, *, reliable: bool) -> "ZenohReader":
        """Return what reads the messages of a topic, none from before this call."""
        watch = self._watches.pop(topic, None)
        if watch is not None:
            watch.undeclare()
        reader = ZenohReader(self._session, self._domain, topic, kind, self._tokens)
        # What is told of is there already, for those who wait for it.
        self._declare(self._endpoint("MS", topic, kind, type_hash(kind)))
        return reader

    def publish(self, topic: str, kind: str) -> "ZenohWriter":
        """Return what writes messages of a kind to a topic."""
        key = f"{self._domain}{topic}/{wire_kind(kind)}/{type_hash(kind)}"
        writer = ZenohWriter(self._session, key)
        self._declare(self._endpoint("MP", topic, kind, type_hash(kind)))
        return writer

    def serve(self, service: str, kind: str, answer: Answer) -> "ZenohService":
        """Return a service that answers requests by a function of the message."""
        key = f"{self._domain}{service}/{wire_kind(kind)}/*"
        served = ZenohService(self._session, key, kind, answer)
        self._declare(self._endpoint("SS", service, kind, SERVICE_HASHES[kind]))
        return served

    def close(self) -> None:
        """End the session; readers and writers end with it."""
        self._held = []
        self._session.close()

    def _endpoint(self, what: str, name: str, kind: str, hash_: str) -> str:
        self._number += 1
        start = f"{self._prefix}/{self._number}/{what}/{self._node}"
        mangled = name.replace("/", "%")
        return f"{start}/{mangled}/{wire_kind(kind)}/{hash_}/{_QUALITY}"

    def _declare(self, key: str) -> None:
        self._held.append(self._session.liveliness().declare_token(key))

    def _token(self, sample: Any) -> None:
        key = str(sample.key_expr)
        gone = "DELETE" in str(sample.kind)
        (self._tokens.discard if gone else self._tokens.add)(key)

    def _watched(self, topic: str) -> Any:
        def watch(sample: Any) -> None:
            kind = ros_kind(str(sample.key_expr).split("/")[-2])
            if kind is not None:
                self._seen[topic][kind] = time.monotonic()

        return watch


class ZenohReader:
    """The messages of one topic, as bytes."""

    hindrance = ""  # zenoh keeps nobody apart by quality of service

    def __init__(
        self, session: Any, domain: int, topic: str, kind: str, tokens: set[str]
    ) -> None:
        self.kind, self._tokens = kind, tokens
        self._endpoint = Endpoint(topic, kind)
        self._waiting: deque[bytes] = deque(maxlen=DEPTH)
        self._arrived, self._last_s = threading.Condition(), float("-inf")
        key = f"{domain}{topic}/{wire_kind(kind)}/*"
        self._subscriber = session.declare_subscriber(key, self._put)

    def take(self, wait_s: float) -> list[bytes]:
        """Return the messages that came, waiting so long for the first."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._waiting), wait_s)
            messages = [*self._waiting]
            self._waiting.clear()
        return messages

    @property
    def n_publishers(self) -> int:
        """Number of publishers with a token, or 1 where one sent a moment ago."""
        n_tokens = sum(p == self._endpoint for p in _publishers(self._tokens))
        return n_tokens or int(time.monotonic() - self._last_s < _RECENT_S)

    def _put(self, sample: Any) -> None:
        raw = sample.payload.to_bytes()
        with self._arrived:
            self._last_s = time.monotonic()
            self._waiting.append(raw)
            self._arrived.notify()


class ZenohWriter:
    """Writes messages of one kind to one topic."""

    hindrance = ""

    def __init__(self, session: Any, key: str) -> None:
        self._publisher = session.declare_publisher(key)
        self._number, self._name = 0, secrets.token_bytes(16)

    def write_bytes(self, raw: bytes) -> None:
        """Write a message that is bytes already, with CDR's head of four."""
        self._number += 1
        beside = _beside(self._number, self._name)
        self._publisher.put(raw, attachment=beside)


class ZenohService:
    """A service, as zenoh's queries."""

    def __init__(self, session: Any, key: str, kind: str, answer: Answer) -> None:
        self._kind, self._answer = kind, answer
        self._waiting: deque[Any] = deque(maxlen=DEPTH)
        put = self._waiting.append
        # Clients of rmw_zenoh ask those only who say that they answer all.
        self._queryable = session.declare_queryable(key, put, complete=True)

    def poll(self) -> None:
        """Answer the requests that have come; one that is damaged has no answer."""
        while self._waiting:
            query = self._waiting.popleft()
            try:
                raw, head = query.payload.to_bytes(), query.attachment.to_bytes()
                number, name = struct.unpack("<q", head[:8])[0], head[17:33]
            except Exception:  # parts may be missing
                query.drop()
                continue
            reply = answered(raw, self._kind, self._answer)
            if reply is not None:
                beside = _beside(number, name)
                query.reply(query.key_expr, reply, attachment=beside)
            query.drop()


def type_hash(kind: str) -> str:
    """Return what ROS calls a message's type hash, `RIHS01_...`."""
    return str(store().hash_rihs01(kind))


def _publishers(tokens: set[str]) -> Iterator[Endpoint]:
    """Yield what the tokens of publishers tell."""
    for key in [*tokens]:
        parts = key.split("/")
        kind = ros_kind(parts[10]) if len(parts) > 10 and parts[5] == "MP" else None
        if kind is not None:
            yield Endpoint(parts[9].replace("%", "/"), kind)


def _beside(number: int, name: bytes) -> bytes:
    """Return what rmw_zenoh puts beside a message: its number, time and writer."""
    head = struct.pack("<qqB", number, time.time_ns(), len(name))
    return head + name


def _configuration(zenoh: Any) -> Any:
    path = os.environ.get("ZENOH_SESSION_CONFIG_URI", "")
    if path:
        chosen = zenoh.Config.from_file(path)
    else:
        chosen = zenoh.Config()
        chosen.insert_json5("mode", '"peer"')
        chosen.insert_json5("connect/endpoints", f'["{_ROUTER}"]')
        chosen.insert_json5("listen/endpoints", '["tcp/localhost:0"]')
        chosen.insert_json5("scouting/multicast/enabled", "false")
    for part in os.environ.get("ZENOH_CONFIG_OVERRIDE", "").split(";"):
        name, _, value = part.partition("=")
        if name.strip():
            chosen.insert_json5(name.strip(), value)
    return chosen
