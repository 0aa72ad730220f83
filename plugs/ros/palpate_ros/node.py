"""The node `palpate`: what recognises runs beside it and speaks the wire of ROS itself.

| topic or service | type | what |
|---|---|---|
| parameter `topic` (in) | `Image`, `CompressedImage`, `PointCloud2`, arrays | frames |
| `~/belief` | `vision_msgs/Classification` | after each touch, with its header |
| `~/decision` | `std_msgs/String` | name, "unknown", or empty while undecided |
| `~/command`, `~/answer` | `std_msgs/String` | what the services do, in words |
| `~/start`, `~/stop`, `~/confirm`, `~/learn`, `~/session` | `std_srvs/Trigger` | |
| `~/teach` | `std_srvs/SetBool` | true: touches teach the parameter `object` |

`palpate.web` says what each of them means. Parameters: `model` (a file), `topic`,
`library` (a folder, for what is taught), `object`, `error`, and `palpate`, the command.
"""

import os
import sys
import threading
from typing import Any

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from .process import PalpateProcess, ProcessError, command_line

PARAMETERS = {
    "model": "",
    "topic": "/tactile",
    "library": "",
    "object": "",
    "error": 0.01,
    "palpate": "palpate",
}
_WAITING, _LOOK_S, _ANSWER_S = 10, 0.5, 20.0


class PalpateNode(Node):  # type: ignore[misc]
    """Runs `palpate live`, and passes on what is asked of the services."""

    def __init__(self) -> None:
        super().__init__("palpate")
        parameters = {
            n: self.declare_parameter(n, v).value for n, v in PARAMETERS.items()
        }
        prefix = self.get_fully_qualified_name()
        self.process = PalpateProcess(command_line(parameters, os.environ, prefix))
        together = ReentrantCallbackGroup()  # an answer comes while a service waits
        self._ask = threading.Lock()
        self._answered, self._answer, self._number = threading.Event(), "", 0
        self._commands = self.create_publisher(String, "~/command", _WAITING)
        options = {"callback_group": together}
        self.create_subscription(
            String, "~/answer", self._take_answer, _WAITING, **options
        )
        for name in ("start", "stop", "confirm", "learn", "session"):
            self.create_service(Trigger, f"~/{name}", self._trigger(name), **options)
        self.create_service(SetBool, "~/teach", self._teach, **options)
        self.create_timer(_LOOK_S, self.process.check, **options)
        self.process.start()

    def ask(self, command: str) -> tuple[bool, str]:
        """Give the process a command; return whether it was done, and its answer."""
        with self._ask:
            self._answered.clear()
            self._number += 1
            self._commands.publish(String(data=f"#{self._number} {command}"))
            if not self._answered.wait(_ANSWER_S):
                return False, "palpate does not answer: it may still be starting."
            outcome, _, sentence = self._answer.partition(": ")
        return outcome == "done", sentence

    def _take_answer(self, message: Any) -> None:
        # Answers to others, late ones, and the second of "learn" are not waited for.
        number, _, answer = str(message.data).partition(" ")
        if number == f"#{self._number}":
            self._answer = answer
            self._answered.set()

    def _trigger(self, command: str) -> Any:
        def answer(request: Any, response: Any) -> Any:
            words = f"confirm {self._object()}" if command == "confirm" else command
            response.success, response.message = self.ask(words.strip())
            return response

        return answer

    def _teach(self, request: Any, response: Any) -> Any:
        words = f"teach {self._object()}".strip() if request.data else "stop"
        response.success, response.message = self.ask(words)
        return response

    def _object(self) -> str:
        return str(self.get_parameter("object").value).strip()


def main() -> None:
    """Run the node until it is told to stop."""
    rclpy.init(args=sys.argv)
    node = None
    executor = MultiThreadedExecutor()
    try:
        node = PalpateNode()
        executor.add_node(node)
        executor.spin()
    except KeyboardInterrupt:
        pass
    except ProcessError as error:
        raise SystemExit(f"palpate_node: {error}") from error
    finally:
        if node is not None:
            node.process.stop()
            node.destroy_node()
        rclpy.try_shutdown()
