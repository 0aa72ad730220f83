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


class Task:
    """What the robot is to do; its JSON may set every field."""

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
    content = words.encode() + b"\0"
    return struct.pack("<I", len(content)) + content + padding(len(content))


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

    def __init__(self, task):
        from cyclonedds.domain import DomainParticipant

        self.task = task
        self.participant = DomainParticipant(task.domain)
        self.readers = []

    def writer(self, topic, name):
        from cyclonedds.pub import DataWriter

        best_effort = name == IMAGE and not self.task.reliable
        message_type = self._type(name)
        about, quality = self._topic(topic, message_type), self._quality(best_effort)
        writer = DataWriter(self.participant, about, qos=quality)

        def write(raw):
            sample = message_type.__new__(message_type)
            sample.raw = raw
            writer.write(sample)

        return write

    def listen(self, topic, name, take):
        from cyclonedds.sub import DataReader

        message_type = self._type(name)
        about = self._topic(topic, message_type)
        reader = DataReader(self.participant, about, qos=self._quality(False))

        def follow():
            for sample in reader.take_iter():
                if hasattr(sample, "raw"):
                    take(sample.raw)

        threading.Thread(target=follow, daemon=True).start()
        return lambda: len(reader.get_matched_publications())

    def _topic(self, topic, message_type):
        from cyclonedds.topic import Topic

        return Topic(self.participant, f"rt{topic}", message_type)

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

        message_type = getattr(ros_peer, name.rpartition("::")[2])
        message_type.serialize = lambda self, **_: self.raw

        def carried(data, **_):
            sample = message_type.__new__(message_type)
            sample.raw = bytes(data)
            return sample

        message_type.deserialize = staticmethod(carried)
        return message_type


class ZenohWire:
    """The robot's side of zenoh, in the layout of rmw_zenoh but without its tokens."""

    def __init__(self, task):
        import zenoh

        configuration = zenoh.Config()
        configuration.insert_json5("mode", '"client"')
        configuration.insert_json5("connect/endpoints", json.dumps([task.endpoint]))
        configuration.insert_json5("scouting/multicast/enabled", "false")
        self.task, self.session = task, zenoh.open(configuration)
        self.declared = []

    def writer(self, topic, name):
        key = f"{self.task.domain}{topic}/{name}/{HASHES[name]}"
        publisher = self.session.declare_publisher(key)
        self.declared.append(publisher)
        numbers = iter(range(1, 10**9))

        def write(raw):
            head = struct.pack("<qqB", next(numbers), time.time_ns(), 16)
            publisher.put(raw, attachment=head + b"robot-of-palpate")

        return write

    def listen(self, topic, name, take):
        key = f"{self.task.domain}{topic}/{name}/*"
        follow = lambda sample: take(sample.payload.to_bytes())  # noqa: E731
        self.declared.append(self.session.declare_subscriber(key, follow))
        mangled = topic.replace("/", "%")
        tokens = f"@ros2_lv/{self.task.domain}/*/*/*/MP/*/*/*/{mangled}/{name}/*/*"
        return lambda: len([*self.session.liveliness().get(tokens)])


class FastDdsWire:
    """The robot's side of Fast DDS: a program in C++ carries its bytes."""

    def __init__(self, task):
        command = [task.program, str(task.domain), task.topic, task.prefix]
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
    """Publishes frames in time and keeps what it sent and received."""

    def __init__(self, task):
        self.task, self.rng = task, np.random.default_rng(1)
        self.wire = WIRES[task.via](task)
        self.publish = self.wire.writer(task.topic, IMAGE)
        self.command = self.wire.writer(f"{task.prefix}/command", STRING)
        self.sent, self.ends, self.received = [], [], {}
        self.receive("belief", CLASSIFICATION, classification_of)
        words = lambda raw: {"text": text_at(raw, 4)[0]}  # noqa: E731
        for name in ("decision", "answer"):
            self.receive(name, STRING, words)
        self.rest = [resting(self.rng, task.shape) for _ in range(37)]
        self.due_s = time.monotonic()

    def receive(self, name, kind, read):
        messages = self.received.setdefault(name, [])
        take = lambda raw: messages.append({"at": time.time_ns(), **read(raw)})  # noqa: E731
        count_publishers = self.wire.listen(f"{self.task.prefix}/{name}", kind, take)
        if name == "belief":
            self.believers = count_publishers

    def frame(self, image):
        self.due_s += 1 / self.task.rate_hz
        time.sleep(max(0.0, self.due_s - time.monotonic()))
        now = time.time_ns()
        self.publish(image_bytes(image, *divmod(now, 10**9)))
        self.sent.append(now)

    def resting(self, n_frames):
        for number in range(n_frames):
            self.frame(self.rest[number % len(self.rest)])

    def run(self):
        end_s = time.monotonic() + self.task.wait_s
        while not self.believers():
            self.resting(5)
            if time.monotonic() > end_s:
                raise SystemExit("nobody publishes beliefs")
        self.resting(15)
        start = len(self.sent)
        for kind in self.task.kinds:
            press = pressed(self.rng, kind, self.task.shape)
            for _ in range(6):
                self.frame(press)
            self.ends.append(len(self.sent))
            self.resting(10)
        for command in self.task.commands:
            n_answers = len(self.received["answer"])
            self.command(b"\0\1\0\0" + text(command))
            for _ in range(100):
                self.resting(4)
                if len(self.received["answer"]) > n_answers:
                    break
        if self.task.other_shape:
            for _ in range(30):
                self.frame(resting(self.rng, self.task.other_shape))
        self.resting(5)
        time.sleep(0.5)
        return {
            "sent": self.sent,
            "from": start,
            "ends": [self.sent[end] for end in self.ends],
            **self.received,
        }


WIRES = {"dds": DdsWire, "zenoh": ZenohWire, "fastdds": FastDdsWire}


def main(written):
    task = Task()
    vars(task).update(json.loads(written))
    task.shape = tuple(task.shape)
    print(json.dumps(Robot(task).run()), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
