"""Touches on disk: durable, searchable, growing.

`TouchLibrary` keeps touches in a folder: a SQLite database for what is known of them,
plain `.npy` files for their images.
"""

from ._bags import read_bag
from ._checking import CheckReport, Problem, check_library
from ._errors import LibraryError
from ._lerobot import lerobot_frames
from ._library import TouchLibrary
from ._parquet import parquet_table
from ._records import ObjectRow, SensorDescription, Stats, TouchRow
from ._repairing import RepairReport, repair_library
from ._selection import Selection
from ._where import quoted

__all__ = [
    "CheckReport",
    "LibraryError",
    "ObjectRow",
    "Problem",
    "RepairReport",
    "Selection",
    "SensorDescription",
    "Stats",
    "TouchLibrary",
    "TouchRow",
    "check_library",
    "lerobot_frames",
    "parquet_table",
    "quoted",
    "read_bag",
    "repair_library",
]
