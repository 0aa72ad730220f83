"""A package of ROS 2 (ament_python): `colcon build` installs it, and so does pip."""

from setuptools import setup

NAME = "palpate_ros"

setup(
    name=NAME,
    version="0.2.0",
    description="A ROS 2 node that recognises what a tactile sensor touches.",
    license="BSD-3-Clause",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/palpate.launch.py"]),
    ],
    # palpate itself may live in another Python; rclpy comes with ROS.
    install_requires=["setuptools"],
    python_requires=">=3.10",
    zip_safe=True,
    entry_points={"console_scripts": ["palpate_node = palpate_ros.node:main"]},
)
