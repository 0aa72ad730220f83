"""Simulated sensors and things to touch, so that nothing waits for hardware.

`PressureArray` presses flat parts on an array of pressure sensors; each parameter
is published, from a handbook, or marked as a guess. `DomeCamera` presses a rubber
dome with a camera in it on solid objects, `TacTipPins` one with pins, `GelCamera` a
gel lit in three colours; all take the objects built in here and mesh files (`pip
install "palpate[sim]"`).
"""

from ._array import Press as Press
from ._array import PressureArray
from ._dome import DomeCamera
from ._dome import DomePress as DomePress
from ._gel_and_pins import GelCamera, TacTipPins
from ._membrane import Membrane
from ._objects import HOUSEHOLD as HOUSEHOLD
from ._objects import find_object
from ._objects import find_objects as find_objects
from ._optics import Lighting
from ._parts import Part
from ._parts import find_parts as find_parts
from ._simulate import Scene, simulate_presses, simulate_touches
from ._solids import MESH_SUFFIXES as MESH_SUFFIXES
from ._solids import PlacedObject, SensorPose, SimObject, load_mesh

__all__ = [
    "DomeCamera",
    "GelCamera",
    "Lighting",
    "Membrane",
    "Part",
    "PlacedObject",
    "PressureArray",
    "Scene",
    "SensorPose",
    "SimObject",
    "TacTipPins",
    "find_object",
    "load_mesh",
    "simulate_presses",
    "simulate_touches",
]
