"""Touches on disk: durable, searchable, growing.

`TouchLibrary` keeps touches in a folder, in one SQLite database.
"""

from ._adding import SensorDescription, TouchRow
from ._bags import frame_of_message as frame_of_message
from ._bags import is_recording as is_recording
from ._bags import read_bag
from ._changes import Change as Change
from ._checking import CheckReport as CheckReport
from ._checking import check_library
from ._library import TouchLibrary
from ._migrating import MigrationReport as MigrationReport
from ._migrating import migrate_library as migrate_library
from ._reading import Selection
from ._repairing import RepairReport as RepairReport
from ._repairing import repair_library as repair_library
from ._store import LibraryError
from ._where import quoted as quoted

__all__ = [
    "LibraryError",
    "Selection",
    "SensorDescription",
    "TouchLibrary",
    "TouchRow",
    "check_library",
    "read_bag",
]
