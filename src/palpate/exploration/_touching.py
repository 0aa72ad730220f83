"""Touches of one episode: the way there, the touch, and how late the force is.

A force sensor that is filtered, or read through a slow bus, follows the contact late.
Nothing in the air shows that, so the first touches of an episode wait for
`Guard.lag_readings` at every step; where the force then changes, it is known by how
many readings it lags. Later touches wait for so many, if it is more than those that a
step takes anyway.
"""

import time
from dataclasses import dataclass
from typing import Any

from ..sensors import TouchSensor
from ..simulation import SensorPose
from ._guarded import Clock, Guard, approach_once
from ._record import TouchRecord, tip_mm
from ._robot import Robot
from ._strategies import Hemisphere
from ._ways import DeadForceError, LoadOnWayError, follow, is_out

ON_THE_WAY = "On the way to the start"


@dataclass
class Toucher:
    """What touches: arm, sensor, guard and clock, and the lag of the force if known."""

    robot: Robot
    sensor: TouchSensor
    guard: Guard
    clock: Clock = time.monotonic
    lag: int | None = None

    @property
    def wait_readings(self) -> int:
        """Readings to wait for after each step."""
        return self.guard.lag_readings if self.lag is None else self.lag

    def touch(self, start: SensorPose) -> TouchRecord:
        """Touch once from a pose that is clear of everything; see `guarded_touch`."""
        record, lag = approach_once(
            self.robot, self.sensor, start, self.guard, self.clock, self.wait_readings
        )
        if self.lag is None and lag is not None:
            # With room for a filter, which only comes near to the force in its time.
            self.lag = 2 * lag if lag >= self.guard.n_readings else 0
        return record


def touch_from_hemisphere(
    toucher: Toucher, hemisphere: Hemisphere, pose: SensorPose
) -> TouchRecord:
    """Go to a pose on the hemisphere and touch; what goes wrong is in the record."""
    how: dict[str, Any]
    try:
        follow(toucher.robot, hemisphere, pose, toucher.guard, toucher.wait_readings)
    except LoadOnWayError as error:
        return TouchRecord(
            "limit exceeded",
            pose,
            tip_mm(pose),
            peak_force_n=error.force_n,
            message=str(error),
            retracted=error.retracted,
        )
    except DeadForceError as error:
        how = {"message": str(error), "retracted": error.retracted}
        return TouchRecord("force sensor", pose, tip_mm(pose), **how)
    except Exception as error:
        message = f"{ON_THE_WAY}: {type(error).__name__}: {error}"
        how = {"message": message, "retracted": is_out(toucher.robot, hemisphere)}
        return TouchRecord("robot error", pose, tip_mm(pose), **how)
    return toucher.touch(pose)
