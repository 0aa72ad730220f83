"""Any sensor of palpate as a camera of LeRobot: `--robot.cameras` of type `palpate`.

LeRobot finds this package by its name and imports it, which registers the type.
"""

from .camera import PalpateCamera
from .config import PalpateCameraConfig

__all__ = ["PalpateCamera", "PalpateCameraConfig"]
