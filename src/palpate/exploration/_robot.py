"""The contract of a robot arm that carries the sensor: all of it on this screen.

World: millimetres, z up. A pose (`SensorPose`) is the place of the sensor's tip, the
way it looks and its roll about that way. Forces are newtons along that way, positive
when something pushes back.
"""

from typing import Protocol, runtime_checkable

from ..simulation import SensorPose


class RobotError(RuntimeError):
    """The arm did not do what it was asked to, or cannot say what it feels."""


@runtime_checkable
class Robot(Protocol):
    """An arm that can be driven by `guarded_touch` and `explore`.

    Each call returns when it is done, or raises within a time limit of the
    driver's own: nothing here can wake a call that never returns.
    """

    def move_to(self, pose: SensorPose) -> None:
        """Move the tip to `pose` in a straight line, and wait until it is there."""
        ...

    def read_pose(self) -> SensorPose:
        """Return where the tip is now."""
        ...

    def read_force(self) -> float:
        """Return a fresh reading of the force sensor (N), its offset included."""
        ...

    def retract(self, way_mm: float) -> None:
        """Pull the tip straight back, against the way it looks, and wait.

        Must work while in contact and after any error.
        """
        ...

    def stop(self) -> None:
        """Halt at once and stay; the last resort, allowed at any time."""
        ...
