"""Simulated sensors and things to touch, so that nothing waits for hardware.

`PressureArray` presses flat parts on an array of pressure sensors; each parameter
is published, from a handbook, or marked as a guess. `DomeCamera` presses a rubber
dome with a camera in it on solid objects, `TacTipPins` one with pins; both take the
objects built in here and mesh files (`pip install palpate[sim]`).
"""

from ._array import Press, PressureArray
from ._dome import DomeCamera, DomePress
from ._exploring import simulate_touches
from ._membrane import Contact, Membrane, solve_contact
from ._mesh import MESH_SUFFIXES, MeshError, load_mesh
from ._objects import (
    BASIC_SHAPES,
    HOUSEHOLD,
    STRANGE,
    UNSEEN,
    SimObject,
    find_object,
    refuse_same_names,
)
from ._parts import PARTS, Part, find_parts
from ._pins import TacTipPins
from ._placed import PlacedObject, SensorPose, gap_map, sleeve_gap
from ._presses import simulate_presses
from ._shading import Lighting, shade

__all__ = [
    "BASIC_SHAPES",
    "HOUSEHOLD",
    "MESH_SUFFIXES",
    "PARTS",
    "STRANGE",
    "UNSEEN",
    "Contact",
    "DomeCamera",
    "DomePress",
    "Lighting",
    "Membrane",
    "MeshError",
    "Part",
    "PlacedObject",
    "Press",
    "PressureArray",
    "SensorPose",
    "SimObject",
    "TacTipPins",
    "find_object",
    "find_parts",
    "gap_map",
    "load_mesh",
    "refuse_same_names",
    "shade",
    "simulate_presses",
    "simulate_touches",
    "sleeve_gap",
    "solve_contact",
]
