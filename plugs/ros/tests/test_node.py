"""The node, driven through a stand-in for rclpy; its bag gives the same beliefs again.

The messages are those of rosbags, with the fields of ROS; nothing here needs ROS.
"""

import shutil
import sys
import types
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from palpate import ObjectRecogniser, Touches
from palpate.library import read_bag
from palpate.sensors import TouchDetector

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
RATE_HZ = 20


class Answer:
    """A response of a service."""

    def __init__(self, **given):
        self.__dict__.update(given)


class StandIn:
    """Stands for `rclpy.node.Node`: keeps what is declared, published and offered."""

    parameters: ClassVar[dict] = {}

    def __init__(self, name):
        self.published, self.services, self.heard, self.warned = [], {}, {}, []

    def declare_parameter(self, name, value):
        return types.SimpleNamespace(value=self.parameters.get(name, value))

    def get_parameter(self, name):
        return types.SimpleNamespace(value=self.parameters.get(name, ""))

    def create_subscription(self, kind, topic, callback, depth):
        self.heard[topic] = callback

    def create_publisher(self, kind, topic, depth):
        publish = lambda message: self.published.append((topic, message))  # noqa: E731
        return types.SimpleNamespace(publish=publish)

    def create_service(self, kind, name, callback):
        self.services[name] = callback

    def get_clock(self):
        now = types.SimpleNamespace(nanoseconds=0)
        return types.SimpleNamespace(now=lambda: now)

    def get_logger(self):
        warn = lambda text, **_: self.warned.append(text)  # noqa: E731
        return types.SimpleNamespace(warning=warn)

    def call(self, name, **request):
        return self.services[f"~/{name}"](Answer(**request), Answer())


def dimension(label="", size=0, stride=0):
    return STORE.types["std_msgs/msg/MultiArrayDimension"](label, size, stride)


def doubles():
    known = STORE.types
    layout = known["std_msgs/msg/MultiArrayLayout"]([], 0)
    return known["std_msgs/msg/Float64MultiArray"](layout, np.empty(0))


@pytest.fixture
def ros(monkeypatch):
    """Put modules of ROS in place that hold what the node takes from them."""

    def module(name, **held):
        made = types.ModuleType(name)
        made.__dict__.update(held)
        monkeypatch.setitem(sys.modules, name, made)
        return made

    module("rclpy", node=module("rclpy.node", Node=StandIn))
    held = {
        "Float32MultiArray": STORE.types["std_msgs/msg/Float32MultiArray"],
        "Float64MultiArray": doubles,
        "MultiArrayDimension": dimension,
        "String": STORE.types["std_msgs/msg/String"],
    }
    module("std_msgs", msg=module("std_msgs.msg", **held))
    image = STORE.types["sensor_msgs/msg/Image"]
    module("sensor_msgs", msg=module("sensor_msgs.msg", Image=image))
    services = {"SetBool": object, "Trigger": object}
    module("std_srvs", srv=module("std_srvs.srv", **services))
    monkeypatch.delitem(sys.modules, "palpate_ros.node", raising=False)
    import palpate_ros.node

    monkeypatch.setattr(StandIn, "parameters", {})
    return palpate_ros.node


def pressed(rng, kind):
    """A press: a ridge along rows or columns, somewhere, with noise."""
    row, col = np.mgrid[:12, :12]
    across = row if kind == "rows" else col
    centre = rng.uniform(4, 8)
    image = 60 + 120 * np.exp(-((across - centre) ** 2) / 4)
    return np.clip(image + rng.normal(scale=2, size=(12, 12)), 0, 255).astype(np.uint8)


def rest(rng, n):
    return list(
        np.clip(60 + rng.normal(scale=2, size=(n, 12, 12)), 0, 255).astype("u1")
    )


def episode(rng, kind, n=3):
    frames = rest(rng, 12)
    for _ in range(n):
        frames += [pressed(rng, kind)] * 5 + rest(rng, 5)
    return frames


def message(image, number):
    stamp = STORE.types["builtin_interfaces/msg/Time"](
        number // RATE_HZ, number % RATE_HZ * (10**9 // RATE_HZ)
    )
    header = STORE.types["std_msgs/msg/Header"](stamp, "pad")
    size = (*image.shape, "mono8", 0, image.shape[1])
    return STORE.types["sensor_msgs/msg/Image"](header, *size, image.ravel())


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    rng = np.random.default_rng(0)
    kinds = ["rows"] * 16 + ["columns"] * 16
    images = np.stack([pressed(rng, kind) for kind in kinds])
    touches = Touches(images, object=kinds, no_contact=np.full((12, 12), 60, np.uint8))
    path = tmp_path_factory.mktemp("model") / "two.palpate"
    ObjectRecogniser().fit(touches).save(path)
    return path


@pytest.fixture
def model(learnt, tmp_path):
    """A model of one's own, since a node writes over it when it learns."""
    return Path(shutil.copy(learnt, tmp_path))


@pytest.fixture
def node(ros, model):
    StandIn.parameters = {"model": str(model), "error": 0.05}
    return ros.PalpateNode()


def play(node, frames):
    for number, image in enumerate(frames):
        node.heard["tactile"](message(image, number))


def beliefs(node):
    return [m for topic, m in node.published if topic == "~/belief"]


def test_frames_become_beliefs(node):
    play(node, episode(np.random.default_rng(1), "rows"))
    assert len(beliefs(node)) == 3
    last = beliefs(node)[-1]
    names = [one.label for one in last.layout.dim]
    assert sorted(names) == ["columns", "rows"]
    posterior = dict(zip(names, last.data, strict=True))
    assert posterior["rows"] > 0.9
    # The rest is the probability of something never learnt.
    assert 0.9 < sum(last.data) <= 1
    evidence = [m for topic, m in node.published if topic == "~/evidence"]
    assert [one.label for one in evidence[0].layout.dim] == names
    decisions = [m.data for topic, m in node.published if topic == "~/decision"]
    assert decisions[-1] in ("rows", "")


def test_a_bag_of_the_node_gives_the_same_beliefs(node, ros, tmp_path):
    """Frames and beliefs are recorded; replayed through the library and a new node."""
    frames = episode(np.random.default_rng(2), "columns")
    play(node, frames)
    image_kind, belief_kind = "sensor_msgs/msg/Image", "std_msgs/msg/Float64MultiArray"
    with rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        heard = writer.add_connection("/tactile", image_kind, typestore=STORE)
        said = writer.add_connection("/palpate/belief", belief_kind, typestore=STORE)
        for number, image in enumerate(frames):
            raw = STORE.serialize_cdr(message(image, number), image_kind)
            writer.write(heard, number * 10**9 // RATE_HZ, raw)
        for number, belief in enumerate(beliefs(node)):
            belief.data = np.asarray(belief.data)
            writer.write(said, number, STORE.serialize_cdr(belief, belief_kind))
    recorded = read_bag(tmp_path / "bag", "/palpate/belief")
    stream = read_bag(tmp_path / "bag", "/tactile")

    again = ros.PalpateNode()
    play(again, stream.images)
    replayed = np.array([np.asarray(b.data) for b in beliefs(again)])
    assert replayed.tobytes() == recorded.images[:, 0].tobytes()

    touches = TouchDetector().touches_in(stream)
    assert len(touches) == len(recorded)
    belief = ObjectRecogniser.load(StandIn.parameters["model"]).start()
    for touch, expected in zip(touches, recorded.images[:, 0], strict=True):
        belief = belief.update(touch)
        assert [belief.posterior[n] for n in ("columns", "rows")] == expected.tolist()


def test_teaching_learning_and_a_new_episode(node, model):
    rng = np.random.default_rng(3)
    assert not node.call("teach", data=True).success  # of what?
    assert "after touches that teach" in node.call("learn").message
    StandIn.parameters["object"] = "knob"
    assert node.call("teach", data=True).message == "Touches teach knob."
    knob = rest(rng, 12)
    for _ in range(8):
        press = np.array(rest(rng, 1)[0])
        press[5:8, 5:8] = 200
        knob += [press] * 5 + rest(rng, 5)
    play(node, knob)
    assert node.published == []
    assert node.call("teach", data=False).success
    assert node.call("learn").message == "8 touches of knob"
    assert "knob" in ObjectRecogniser.load(model).classes_
    assert node.call("start_session").success
    play(node, knob[:32])
    names = [one.label for one in beliefs(node)[-1].layout.dim]
    assert names[np.argmax(beliefs(node)[-1].data)] == "knob"
    count = len(beliefs(node))
    assert node.call("start_episode").success
    play(node, knob[22:32])
    assert len(beliefs(node)) == count + 1


def test_odd_messages_are_told_and_passed_over(node, ros):
    short = message(np.zeros((4, 4), np.uint8), 0)
    short.height = 9
    node.heard["tactile"](short)
    assert "must hold 9 rows of 4 bytes, got 16" in node.warned[0]
    frames = rest(np.random.default_rng(0), 10)
    play(node, [*frames[:9], pressed(np.random.default_rng(0), "rows")])
    assert "Leave it alone" in node.warned[1]  # the baseline is asked for again
    StandIn.parameters = {}
    with pytest.raises(ValueError, match="must name a model file"):
        ros.PalpateNode()
