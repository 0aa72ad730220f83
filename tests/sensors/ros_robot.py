"""A robot in another process: it presses a pad, publishes frames and hears beliefs.

`python ros_robot.py '{"via": "dds", "domain": 3, ...}'` writes one line of JSON when it
is done: when each frame was sent, and every belief, decision and answer that came. Its
types, its bytes and its layout of keys are written here by hand; nothing is palpate's.
"""

import json
import struct
import subprocess
import sys
import threading
import time

import numpy as np

IMAGE = "sensor_msgs::msg::dds_::Image_"
STRING = "std_msgs::msg::dds_::String_"
CLASSIFICATION = "vision_msgs::msg::dds_::Classification_"
# As `ros2 topic info -v` prints them.
HASHES = {
    IMAGE: "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    STRING: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
}
FRAME_ID = "pad"


class Asked:
    """What the robot is to do; every field may be given."""

    via, domain, endpoint, program = "dds", 0, "", ""
    topic, prefix = "/pad", "/palpate"
    rate_hz, shape, other_shape = 100.0, (12, 12), None
    kinds, commands = ("rows",) * 4, ()
    reliable, wait_s = False, 60.0


def pressed(rng, kind, shape):
    """Return a press: a ridge along rows or columns, somewhere, with noise."""
    row, col = np.mgrid[: shape[0], : shape[1]]
    across = row / shape[0] if kind == "rows" else col / shape[1]
    ridge = 120 * np.exp(-((across - rng.uniform(0.3, 0.7)) ** 2) / 0.03)
    return noisy(rng, 60 + ridge)


def resting(rng, shape):
    """Return a frame of nothing."""
    return noisy(rng, np.full(shape, 60.0))


def noisy(rng, levels):
    return np.clip(levels + rng.normal(scale=2, size=levels.shape), 0, 255).astype("u1")


def image_bytes(image, seconds, nanoseconds):
    """Return a `sensor_msgs/msg/Image` in CDR, little-endian."""
    raw = struct.pack("<4sIi", b"\0\1\0\0", seconds, nanoseconds) + text(FRAME_ID)
    raw += struct.pack("<III", *image.shape, 6) + b"mono8\0" + b"\0"
    raw += padding(len(raw))
    return raw + struct.pack("<II", image.shape[1], image.size) + image.tobytes()


def text(words):
    """Return a text in CDR, and what fills it up to four bytes."""
    held = words.encode() + b"\0"
    return struct.pack("<I", len(held)) + held + padding(len(held))


def padding(length):
    return b"\0" * (-length % 4)


def classification_of(raw):
    """Return stamp, frame and probabilities of a `vision_msgs/msg/Classification`."""
    seconds, nanoseconds = struct.unpack_from("<iI", raw, 4)
    frame, at = text_at(raw, 12)
    (count,) = struct.unpack_from("<I", raw, at)
    at, results = at + 4, []
    for _ in range(count):
        name, at = text_at(raw, at)
        at += -(at - 4) % 8
        results.append((name, struct.unpack_from("<d", raw, at)[0]))
        at += 8
    stamp = seconds * 10**9 + nanoseconds
    return {"stamp": stamp, "frame_id": frame, "results": results}


def text_at(raw, at):
    """Return the text at a place of CDR, and where the next field of four begins."""
    (length,) = struct.unpack_from("<I", raw, at)
    words = raw[at + 4 : at + 4 + length - 1].decode()
    return words, at + 4 + length + (-length % 4)


class DdsWire:
    """The robot's side of DDS."""

    def __init__(self, asked):
        from cyclonedds.domain import DomainParticipant

        self.asked = asked
        self.participant = DomainParticipant(asked.domain)
        self.readers = []

    def writer(self, topic, name):
        from cyclonedds.pub import DataWriter

        best_effort = name == IMAGE and not self.asked.reliable
        made = self._type(name)
        writer = DataWriter(
            self.participant, self._topic(topic, made), qos=self._quality(best_effort)
        )

        def write(raw):
            sample = made.__new__(made)
            sample.raw = raw
            writer.write(sample)

        return write

    def listen(self, topic, name, take):
        from cyclonedds.core import (
            InstanceState,
            ReadCondition,
            SampleState,
            ViewState,
            WaitSet,
        )
        from cyclonedds.sub import DataReader

        made = self._type(name)
        quality = self._quality(False)
        reader = DataReader(self.participant, self._topic(topic, made), qos=quality)
        waiting = WaitSet(self.participant)
        states = ViewState.Any | InstanceState.Any | SampleState.NotRead
        waiting.attach(ReadCondition(reader, states))

        def follow():
            while True:
                waiting.wait(10**8)
                for sample in reader.take(N=64):
                    if hasattr(sample, "raw"):
                        take(sample.raw)

        threading.Thread(target=follow, daemon=True).start()
        return lambda: len(reader.get_matched_publications())

    def _topic(self, topic, made):
        from cyclonedds.topic import Topic

        return Topic(self.participant, f"rt{topic}", made)

    def _quality(self, best_effort):
        from cyclonedds.core import Policy, Qos

        return Qos(
            Policy.Reliability.BestEffort
            if best_effort
            else Policy.Reliability.Reliable(10**9),
            Policy.History.KeepLast(64),
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )

    def _type(self, name):
        """Return the type of that name; its bytes are made by hand."""
        import ros_peer

        made = getattr(ros_peer, name.rpartition("::")[2])
        made.serialize = lambda self, **_: self.raw

        def carried(data, **_):
            sample = made.__new__(made)
            sample.raw = bytes(data)
            return sample

        made.deserialize = staticmethod(carried)
        return made


class ZenohWire:
    """The robot's side of zenoh, in the layout of rmw_zenoh but without its tokens."""

    def __init__(self, asked):
        import zenoh

        configuration = zenoh.Config()
        configuration.insert_json5("mode", '"client"')
        configuration.insert_json5("connect/endpoints", json.dumps([asked.endpoint]))
        configuration.insert_json5("scouting/multicast/enabled", "false")
        self.asked, self.session = asked, zenoh.open(configuration)
        self.held = []

    def writer(self, topic, name):
        key = f"{self.asked.domain}{topic}/{name}/{HASHES[name]}"
        publisher = self.session.declare_publisher(key)
        self.held.append(publisher)
        numbers = iter(range(1, 10**9))

        def write(raw):
            head = struct.pack("<qqB", next(numbers), time.time_ns(), 16)
            publisher.put(raw, attachment=head + b"robot-of-palpate")

        return write

    def listen(self, topic, name, take):
        key = f"{self.asked.domain}{topic}/{name}/*"
        follow = lambda sample: take(sample.payload.to_bytes())  # noqa: E731
        self.held.append(self.session.declare_subscriber(key, follow))
        mangled = topic.replace("/", "%")
        tokens = f"@ros2_lv/{self.asked.domain}/*/*/*/MP/*/*/*/{mangled}/{name}/*/*"
        return lambda: len([*self.session.liveliness().get(tokens)])


class FastDdsWire:
    """The robot's side of Fast DDS: a program in C++ carries its bytes."""

    def __init__(self, asked):
        command = [asked.program, str(asked.domain), asked.topic, asked.prefix]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self.process = subprocess.Popen(command, **pipes)
        self.takers, self.n_believers = {}, 0
        threading.Thread(target=self._follow, daemon=True).start()

    def writer(self, topic, name):
        letter = b"I" if name == IMAGE else b"C"

        def write(raw):
            self.process.stdin.write(letter + struct.pack("<I", len(raw)) + raw)
            self.process.stdin.flush()

        return write

    def listen(self, topic, name, take):
        self.takers[topic.rpartition("/")[2][:1].encode()] = take
        return lambda: self.n_believers

    def _follow(self):
        while head := self.process.stdout.read(5):
            letter, length = struct.unpack("<cI", head)
            raw = self.process.stdout.read(length)
            if letter == b"m":
                (self.n_believers,) = struct.unpack("<i", raw)
            else:
                self.takers[letter](raw)


class Robot:
    """Publishes frames in time and keeps what it sent and heard."""

    def __init__(self, asked):
        self.asked, self.rng = asked, np.random.default_rng(1)
        self.wire = WIRES[asked.via](asked)
        self.publish = self.wire.writer(asked.topic, IMAGE)
        self.command = self.wire.writer(f"{asked.prefix}/command", STRING)
        self.sent, self.ends, self.heard = [], [], {}
        self.hear("belief", CLASSIFICATION, classification_of)
        words = lambda raw: {"text": text_at(raw, 4)[0]}  # noqa: E731
        for name in ("decision", "answer"):
            self.hear(name, STRING, words)
        self.rest = [resting(self.rng, asked.shape) for _ in range(37)]
        self.due_s = time.monotonic()

    def hear(self, name, kind, read):
        kept = self.heard.setdefault(name, [])
        take = lambda raw: kept.append({"at": time.time_ns(), **read(raw)})  # noqa: E731
        there = self.wire.listen(f"{self.asked.prefix}/{name}", kind, take)
        if name == "belief":
            self.believers = there

    def frame(self, image):
        self.due_s += 1 / self.asked.rate_hz
        time.sleep(max(0.0, self.due_s - time.monotonic()))
        now = time.time_ns()
        self.publish(image_bytes(image, *divmod(now, 10**9)))
        self.sent.append(now)

    def resting(self, n_frames):
        for number in range(n_frames):
            self.frame(self.rest[number % len(self.rest)])

    def run(self):
        end_s = time.monotonic() + self.asked.wait_s
        while not self.believers():
            self.resting(5)
            if time.monotonic() > end_s:
                raise SystemExit("nobody publishes beliefs")
        self.resting(15)
        start = len(self.sent)
        for kind in self.asked.kinds:
            press = pressed(self.rng, kind, self.asked.shape)
            for _ in range(6):
                self.frame(press)
            self.ends.append(len(self.sent))
            self.resting(10)
        for command in self.asked.commands:
            n_answers = len(self.heard["answer"])
            self.command(b"\0\1\0\0" + text(command))
            for _ in range(100):
                self.resting(4)
                if len(self.heard["answer"]) > n_answers:
                    break
        if self.asked.other_shape:
            for _ in range(30):
                self.frame(resting(self.rng, self.asked.other_shape))
        self.resting(5)
        time.sleep(0.5)
        return {
            "sent": self.sent,
            "from": start,
            "ends": [self.sent[end] for end in self.ends],
            **self.heard,
        }


WIRES = {"dds": DdsWire, "zenoh": ZenohWire, "fastdds": FastDdsWire}


def main(written):
    asked = Asked()
    vars(asked).update(json.loads(written))
    asked.shape = tuple(asked.shape)
    print(json.dumps(Robot(asked).run()), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
