"""Tactile sensors behind one contract: ask for a frame, get one or an error.

`TouchSensor` is what touching needs; `LiveSensor` adds what a sensor on a desk does:
it is connected, streams frames, counts what is lost, is disconnected. `check_sensor`
drives a driver through the contract. `TouchDetector` finds touches in the stream.
`open_sensor` opens any of them by a text. `palpate.sensors.ros` has the messages of
ROS 2 that a node writes and reads.
"""

from ._address import AddressError as AddressError
from ._address import is_address as is_address
from ._address import open_sensor
from ._address import ros_place as ros_place
from ._bench import SimulatedBench, SimulatedSensor
from ._camera import CameraSensor
from ._contract import Frame as Frame
from ._contract import LiveSensor, Reading, SensorError, TouchSensor, check_sensor
from ._contract import channels_of as channels_of
from ._detector import ContactError as ContactError
from ._detector import DetectedTouch as DetectedTouch
from ._detector import TouchDetector
from ._health import SensorMemory as SensorMemory
from ._health import sensor_health as sensor_health
from ._played import ReplaySensor
from ._serial import BinaryFraming, LineFraming, SerialArraySensor

__all__ = [
    "BinaryFraming",
    "CameraSensor",
    "LineFraming",
    "LiveSensor",
    "Reading",
    "ReplaySensor",
    "SensorError",
    "SerialArraySensor",
    "SimulatedBench",
    "SimulatedSensor",
    "TouchDetector",
    "TouchSensor",
    "check_sensor",
    "open_sensor",
]
