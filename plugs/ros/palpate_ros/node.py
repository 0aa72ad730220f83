"""The node `palpate`: a topic of images or arrays in, standard messages out.

| topic or service | type | what |
|---|---|---|
| `tactile` (in) | `sensor_msgs/Image` or `std_msgs/Float32MultiArray` | frames |
| `~/belief` | `std_msgs/Float64MultiArray` | posterior, a dimension an object |
| `~/evidence` | `std_msgs/Float64MultiArray` | log-likelihood of the last touch |
| `~/decision` | `std_msgs/String` | name, "unknown", or empty while undecided |
| `~/teach` | `std_srvs/SetBool` | true: touches teach the parameter `object` |
| `~/learn` | `std_srvs/Trigger` | learn what was taught, write the model |
| `~/start_episode` | `std_srvs/Trigger` | another object comes |
| `~/start_session` | `std_srvs/Trigger` | take the baseline anew |

Parameters: `model` (a file), `array` (frames are arrays, not images), `object` and
`error`.
"""

import sys
from typing import Any

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import (
    Float32MultiArray,
    Float64MultiArray,
    MultiArrayDimension,
    String,
)
from std_srvs.srv import SetBool, Trigger

from palpate.library import LibraryError, frame_of_message
from palpate.sensors import ContactError

from .touching import Said, Touching

_KINDS = {
    Image: "sensor_msgs/msg/Image",
    Float32MultiArray: "std_msgs/msg/Float32MultiArray",
}
_WAITING = 10


class PalpateNode(Node):  # type: ignore[misc]
    """Takes frames in, publishes belief, evidence and decision after each touch."""

    def __init__(self) -> None:
        super().__init__("palpate")
        told = {"model": "", "array": False, "object": "", "error": 0.01}
        given = {n: self.declare_parameter(n, value).value for n, value in told.items()}
        if not given["model"]:
            raise ValueError(
                "The parameter model must name a model file: --ros-args -p model:=FILE."
            )
        self.touching = Touching(str(given["model"]), float(given["error"]))
        kind = Float32MultiArray if given["array"] else Image
        self._kind = _KINDS[kind]
        self.create_subscription(kind, "tactile", self._frame, _WAITING)
        arrays = ("belief", "evidence")
        self._out = {
            name: self.create_publisher(Float64MultiArray, f"~/{name}", _WAITING)
            for name in arrays
        }
        self._decision = self.create_publisher(String, "~/decision", _WAITING)
        self.create_service(SetBool, "~/teach", self._teach)
        self.create_service(Trigger, "~/learn", self._learn)
        for name in ("start_episode", "start_session"):
            self.create_service(Trigger, f"~/{name}", self._started(name))

    def _frame(self, message: Any) -> None:
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        if stamp is None:
            time_s = self.get_clock().now().nanoseconds / 1e9
        else:
            time_s = stamp.sec + stamp.nanosec / 1e9
        try:
            said = self.touching.take(frame_of_message(message, self._kind), time_s)
        except (LibraryError, ContactError, ValueError) as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            return
        if said is not None:
            self._publish(said)

    def _publish(self, said: Said) -> None:
        for name, values in (("belief", said.posterior), ("evidence", said.evidence)):
            message = Float64MultiArray()
            # One dimension an object, so that each name stands beside its value.
            message.layout.dim = [
                MultiArrayDimension(label=one, size=1, stride=1) for one in said.objects
            ]
            message.data = values.tolist()
            self._out[name].publish(message)
        self._decision.publish(String(data=said.decision))

    def _teach(self, request: Any, response: Any) -> Any:
        name = str(self.get_parameter("object").value).strip()
        response.success = bool(name) or not request.data
        self.touching.teaching = name if request.data else ""
        wanted = "Set the parameter object to what is touched."
        now = f"Touches teach {name}." if request.data else "Touches are recognised."
        response.message = now if response.success else wanted
        return response

    def _learn(self, request: Any, response: Any) -> Any:
        try:
            response.message = self.touching.learn()
            response.success = True
        except (ValueError, OSError) as error:
            response.success, response.message = False, str(error)
        return response

    def _started(self, name: str) -> Any:
        def start(request: Any, response: Any) -> Any:
            getattr(self.touching, name)()
            response.success, response.message = True, ""
            return response

        return start


def main() -> None:
    """Run the node until it is told to stop."""
    rclpy.init(args=sys.argv)
    node = PalpateNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
