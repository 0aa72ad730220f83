"""`ros2 launch palpate_ros palpate.launch.py model:=desk.palpate topic:=/pad`."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

ARGUMENTS = {
    "model": "model file, such as desk.palpate",
    "topic": "topic of images, clouds or arrays",
    "library": "folder for what is taught; empty: nothing can be",
    "object": "what ~/teach and ~/confirm mean",
    "error": "accepted share of wrong names",
    "palpate": "the command palpate, where it is not on the path",
}


def _value_of(name):
    """Return a parameter as text, so that an object may be called 7, or as a number."""
    kind = float if name == "error" else str
    return ParameterValue(LaunchConfiguration(name), value_type=kind)


def generate_launch_description():
    """Start the node `palpate`, again where it ends."""
    defaults = {"model": None, "topic": "/tactile", "library": "", "palpate": "palpate"}
    defaults |= {"object": "", "error": "0.01"}
    declared = [
        DeclareLaunchArgument(name, default_value=defaults[name], description=text)
        for name, text in ARGUMENTS.items()
    ]
    node = Node(
        package="palpate_ros",
        executable="palpate_node",
        name="palpate",
        output="screen",
        respawn=True,
        respawn_delay=2.0,
        parameters=[{name: _value_of(name) for name in ARGUMENTS}],
    )
    return LaunchDescription([*declared, node])
