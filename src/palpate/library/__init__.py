"""Touches on disk: durable, searchable, growing.

`TouchLibrary` keeps touches in a folder: a SQLite database for what is known of them,
plain `.npy` files for their images.
"""

from ._adding import SensorDescription, TouchRow
from ._bags import frame_of_message as frame_of_message
from ._bags import is_recording as is_recording
from ._bags import read_bag
from ._checking import CheckReport, check_library
from ._library import TouchLibrary
from ._reading import Selection
from ._repairing import RepairReport, repair_library
from ._store import LibraryError
from ._where import quoted as quoted

__all__ = [
    "CheckReport",
    "LibraryError",
    "RepairReport",
    "Selection",
    "SensorDescription",
    "TouchLibrary",
    "TouchRow",
    "check_library",
    "read_bag",
    "repair_library",
]
