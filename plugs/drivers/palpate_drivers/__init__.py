"""Drivers of tactile sensors, found by palpate through entry points.

`palpate record mug --sensor flexitac:/dev/ttyUSB0` works once this is installed.
What was tested on hardware (nothing yet) stands in docs/reference/plugs.md.
"""
