"""`ros2 launch palpate_ros palpate.launch.py model:=desk.palpate topic:=/pad`."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

ARGUMENTS = {
    "model": "model file, such as desk.palpate",
    "topic": "topic of images, clouds or arrays",
    "library": "folder for what is taught; empty: nothing can be",
    "palpate": "the command palpate, where it is not on the path",
}


def generate_launch_description():
    """Start the node `palpate`, again where it ends."""
    defaults = {"model": None, "topic": "/tactile", "library": "", "palpate": "palpate"}
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
        parameters=[{name: LaunchConfiguration(name) for name in ARGUMENTS}],
    )
    return LaunchDescription([*declared, node])
