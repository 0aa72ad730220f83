"""Tactile sensors behind one contract: ask for a frame, get one or an error.

`TouchSensor` is what touching needs; `LiveSensor` adds what a sensor on a desk does:
it is connected, streams frames, counts what is lost, is disconnected. `check_sensor`
drives a driver through the contract. `TouchDetector` finds touches in the stream.
"""

from ._bench import SimulatedBench
from ._camera import CameraSensor, camera_names
from ._check import check_sensor
from ._contract import Frame, LiveSensor, SensorError, TouchSensor
from ._detector import ContactError, DetectedTouch, TouchDetector
from ._drift import SensorMemory, gain_warning, zero_warning
from ._framing import BinaryFraming, LineFraming, write_binary, write_line
from ._open import desk_of, open_sensor
from ._played import PlayedSensor
from ._replay import ReplaySensor
from ._serial import SerialArraySensor
from ._simulated import SimulatedSensor
from ._simulated_stream import SimulatedStream
from ._streaming import StreamingSensor

__all__ = [
    "BinaryFraming",
    "CameraSensor",
    "ContactError",
    "DetectedTouch",
    "Frame",
    "LineFraming",
    "LiveSensor",
    "PlayedSensor",
    "ReplaySensor",
    "SensorError",
    "SensorMemory",
    "SerialArraySensor",
    "SimulatedBench",
    "SimulatedSensor",
    "SimulatedStream",
    "StreamingSensor",
    "TouchDetector",
    "TouchSensor",
    "camera_names",
    "check_sensor",
    "desk_of",
    "gain_warning",
    "open_sensor",
    "write_binary",
    "write_line",
    "zero_warning",
]
