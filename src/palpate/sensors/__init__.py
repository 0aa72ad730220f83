"""Tactile sensors behind one contract: ask for a frame, get one or an error."""

from ._bench import SimulatedBench
from ._contract import SensorError, TouchSensor
from ._simulated import SimulatedSensor

__all__ = ["SensorError", "SimulatedBench", "SimulatedSensor", "TouchSensor"]
