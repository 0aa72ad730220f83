"""Simulated sensors and things to touch, so that nothing waits for hardware.

`PressureArray` presses flat parts on an array of pressure sensors; each parameter
is published, from a handbook, or marked as a guess.
"""

from ._array import Press, PressureArray
from ._parts import PARTS, Part, find_parts
from ._presses import simulate_presses

__all__ = [
    "PARTS",
    "Part",
    "Press",
    "PressureArray",
    "find_parts",
    "simulate_presses",
]
