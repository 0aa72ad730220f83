"""The node by itself, and with its process and a robot over real DDS.

A stand-in for rclpy has topics on the wire; the robot (`ros_robot.py`) is another
process with bytes made by hand. Nothing here needs ROS.
"""

import ast
import shutil
import subprocess
import sys
import threading
import types
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar

import pytest
from ros_network import NUMBER, heard_by, learn, robot, variables

from palpate_ros.process import PalpateProcess, ProcessError, command_line, wire

HERE = Path(__file__).parent
STRING = "std_msgs/msg/String"
DOMAIN = 150 + NUMBER
PARAMETERS = {
    "model": "desk.palpate",
    "topic": "/pad",
    "library": "",
    "error": 0.05,
    "palpate": sys.executable,
}


class Answer:
    """A request or a response of a service."""

    def __init__(self, **fields):
        self.__dict__.update(fields)


class StandIn:
    """Stands for `rclpy.node.Node`: what it publishes and hears is on the wire."""

    parameters: ClassVar[dict] = {}

    def __init__(self, name):
        from palpate.sensors import ros_place

        self.services, self.ended = {}, threading.Event()
        self.wire = ros_place(f"ros:/desk?domain={DOMAIN}").open_node()

    def get_fully_qualified_name(self):
        return "/palpate"

    def declare_parameter(self, name, value):
        return types.SimpleNamespace(value=self.parameters.get(name, value))

    def get_parameter(self, name):
        return types.SimpleNamespace(value=self.parameters.get(name, ""))

    def create_publisher(self, kind, topic, depth):
        from palpate.sensors.ros import text_message, write_message

        writer = self.wire.publish(topic.replace("~", "/palpate"), STRING)

        def publish(message):
            writer.write_bytes(write_message(text_message(message.data), STRING))

        return types.SimpleNamespace(publish=publish)

    def create_subscription(self, kind, topic, callback, depth, **_):
        from palpate.sensors.ros import read_message

        topic = topic.replace("~", "/palpate")
        reader = self.wire.subscribe(topic, STRING, reliable=True)

        def follow():
            while not self.ended.is_set():
                for raw in reader.take(0.05):
                    callback(read_message(raw, STRING))

        threading.Thread(target=follow, daemon=True).start()

    def create_service(self, kind, name, callback, **_):
        self.services[name] = callback

    def create_timer(self, period_s, callback, **_):
        self.timer = callback

    def call(self, name, **request):
        return self.services[f"~/{name}"](Answer(**request), Answer())


@pytest.fixture
def ros(monkeypatch):
    """Put modules of ROS in place with the names that the node imports."""

    def module(name, **names):
        instance = types.ModuleType(name)
        instance.__dict__.update(names)
        monkeypatch.setitem(sys.modules, name, instance)
        return instance

    module("rclpy", node=module("rclpy.node", Node=StandIn))
    module("rclpy.callback_groups", ReentrantCallbackGroup=object)
    module("rclpy.executors", MultiThreadedExecutor=object)
    module("std_msgs", msg=module("std_msgs.msg", String=Answer))
    module("std_srvs", srv=module("std_srvs.srv", SetBool=object, Trigger=object))
    monkeypatch.delitem(sys.modules, "palpate_ros.node", raising=False)
    import palpate_ros.node

    monkeypatch.setattr(StandIn, "parameters", {})
    return palpate_ros.node


def test_the_process_gets_the_domain_and_wire_of_ros():
    assert wire({}) == "domain=0&via=dds"
    zenoh = {"ROS_DOMAIN_ID": "7", "RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}
    assert wire(zenoh) == "domain=7&via=zenoh"
    line = command_line({**PARAMETERS, "library": "lab"}, zenoh, "/desk/palpate")
    assert line == [
        sys.executable,
        *("live", "desk.palpate", "--sensor", "ros:/pad?domain=7&via=zenoh"),
        *("--publish", "ros:/desk/palpate?domain=7&via=zenoh&services=no"),
        *("--episodes", "0", "--timeout", "1e9", "--error", "0.05"),
        *("--library", "lab"),
    ]


def test_a_missing_model_or_command_is_named():
    with pytest.raises(ProcessError, match="model must name a model file"):
        command_line({**PARAMETERS, "model": ""}, {}, "/palpate")
    with pytest.raises(ProcessError, match=r"got 'nowhere'.*pip install"):
        command_line({**PARAMETERS, "palpate": "nowhere"}, {}, "/palpate")


def test_a_process_that_ends_is_reported_and_ros_variables_stay_out(
    monkeypatch, tmp_path
):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    code = "import os, sys; sys.exit(3 + ('PYTHONPATH' in os.environ))"
    process = PalpateProcess([sys.executable, "-c", code])
    process.check()
    process.start()
    process._process.wait()
    with pytest.raises(ProcessError, match="ended with 3;"):
        process.check()
    process.stop()


def test_the_package_is_of_python_3_10_and_takes_no_numpy():
    for path in HERE.parent.rglob("*.py"):
        if path.parent != HERE:
            tree = ast.parse(path.read_text(), feature_version=(3, 10))
            names = [
                alias.name
                for node in ast.walk(tree)
                if isinstance(node, ast.Import)
                for alias in node.names
            ]
            assert not {"numpy", "palpate"} & {*names}


@pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds")
def test_an_answer_to_another_command_is_not_waited_for(ros, monkeypatch):
    for name, value in variables().items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(StandIn, "parameters", PARAMETERS)
    monkeypatch.setattr(PalpateProcess, "start", lambda process: None)
    node = ros.PalpateNode()
    texts = ["refused: Too little to learn.", "#7 done: of another.", "#1 done: Begun."]

    def answer(message):
        assert message.data == "#1 start"
        for text in texts:
            node._take_answer(Answer(data=text))

    monkeypatch.setattr(node._commands, "publish", answer)
    assert node.ask("start") == (True, "Begun.")
    node.ended.set()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("colcon") is None, reason="no colcon")
def test_colcon_builds_it(tmp_path):
    shutil.copytree(HERE.parent, tmp_path / "src" / "palpate_ros")
    command = ["colcon", "build", "--merge-install"]
    completed = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert completed.returncode == 0, completed.stderr
    for place in (
        "lib/palpate_ros/palpate_node",
        "share/ament_index/resource_index/packages/palpate_ros",
        "share/palpate_ros/package.xml",
        "share/palpate_ros/launch/palpate.launch.py",
    ):
        assert (tmp_path / "install" / place).is_file()


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    return learn(tmp_path_factory.mktemp("model") / "two.palpate")


@pytest.fixture
def palpate(tmp_path):
    """The command of this source, as another environment would have it."""
    root = HERE.parents[2] / "src"
    path = tmp_path / "palpate"
    path.write_text(
        f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {str(root)!r})\n"
        "from palpate.cli import main\nmain()\n"
    )
    path.chmod(0o755)
    return path


@pytest.mark.slow
@pytest.mark.skipif(find_spec("cyclonedds") is None, reason="no cyclonedds")
def test_a_robot_hears_the_node_and_the_services_teach(
    ros, learnt, palpate, tmp_path, monkeypatch
):
    for name, value in variables().items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)
    lab = tmp_path / "lab"
    StandIn.parameters = {
        "model": str(learnt),
        "topic": "/pad",
        "palpate": str(palpate),
        "library": str(lab),
        "object": "knob",
    }
    with robot(domain=DOMAIN, kinds=["rows"] * 3, commands=["start"]) as process:
        node = ros.PalpateNode()
        try:
            log = heard_by(process)
            node.timer()  # the process still runs
            answers = [node.call("teach", data=True), node.call("teach", data=False)]
            refusal = node.call("confirm")
        finally:
            node.process.stop()
            node.ended.set()
    assert len(log["belief"]) == 3
    best = [belief["results"][0][0] for belief in log["belief"]]
    assert best.count("rows") >= 2
    assert all(belief["stamp"] in log["sent"] for belief in log["belief"])
    assert [answer.success for answer in answers] == [True, True]
    assert answers[0].message == "Touches teach knob."
    assert not refusal.success
    assert refusal.message == "confirm must come after touches, got none."
    assert lab.is_dir()


@pytest.mark.skipif(find_spec("cyclonedds") is None, reason="no cyclonedds")
def test_silence_is_an_answer_too(ros, learnt, monkeypatch):
    for name, value in variables().items():
        monkeypatch.setenv(name, value)
    StandIn.parameters = {"model": str(learnt), "palpate": sys.executable}
    monkeypatch.setattr(ros, "_ANSWER_S", 0.1)
    monkeypatch.setattr(PalpateProcess, "start", lambda self: None)
    node = ros.PalpateNode()
    silent = node.call("start")
    node.ended.set()
    assert not silent.success
    assert "does not answer" in silent.message
