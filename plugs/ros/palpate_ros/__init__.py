"""A ROS 2 node of palpate: tactile frames in, beliefs out.

`process` starts the command `palpate live`, which hears the frames and publishes the
beliefs over the same wire as ROS does; `node` shows it to ROS: parameters and services.
Neither needs numpy, or palpate in the Python of ROS.
"""
