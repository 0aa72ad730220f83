"""Touches on disk: durable, searchable, growing.

`TouchLibrary` keeps touches in a folder, in one SQLite database.
"""

from ._adding import SensorDescription
from ._adding import TouchRow as TouchRow
from ._bags import is_recording as is_recording
from ._bags import read_bag
from ._library import TouchLibrary
from ._store import LibraryError
from ._upkeep import check_library
from ._where import quoted

__all__ = [
    "LibraryError",
    "SensorDescription",
    "TouchLibrary",
    "check_library",
    "quoted",
    "read_bag",
]
