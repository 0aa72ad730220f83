"""A ROS 2 node of palpate: tactile frames in, beliefs out."""
