"""The node imports rclpy, which comes with ROS; tests bring a stand-in."""

from importlib.util import find_spec

collect_ignore = ["launch", "setup.py"]
if not find_spec("rclpy"):
    collect_ignore += ["palpate_ros/node.py"]
