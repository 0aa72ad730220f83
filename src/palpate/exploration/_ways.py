"""Touches of one episode and the ways between them: guarded, in short steps.

Between two touches nothing should be met. So the arm moves in steps of at most
`Guard.way_step_mm`, and after each the force is read. A reading beyond
`Guard.limit_n` ends the way, and so do readings that repeat themselves,
`Guard.stuck_after` of them: the arm goes back to where another one came last, and where
that does not help it is stopped. One step against something of k N/mm adds k x
`way_step_mm`: with the default of 2.5 mm it stays below 3 N up to 1.2 N/mm, and what is
stiffer passes the limit by what that step adds, and is told.

A force sensor that is filtered, or read through a slow bus, follows the contact late.
Nothing in the air shows that, so the first touches of an episode, and the ways to them,
wait for `Guard.lag_readings` at every step; where the force then changes, it is known
by how many readings it lags. Later ones wait for so many, touches only if it is more
than those that a step takes anyway.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from ..simulation import SensorPose
from ._guarded import Guard, Toucher, straight_steps
from ._record import TouchRecord, tip_mm
from ._robot import Robot, RobotError, distance_mm, stop_arm
from ._strategies import Hemisphere

# The way out must lead away from the centre: within 60 degrees of straight outward,
# and the arm must look within 60 degrees of the centre.
_LEAST_COSINE = 0.5
_OUTSIDE_MM = 1.0
ON_THE_WAY = "On the way to the start"


class WayError(RobotError):
    """A way ended: something was met, or the force sensor gave no number.

    `outcome` is that of the `TouchRecord`; where the arm is not known to be clear again
    (`retracted`) it was stopped. `force_n` is the reading that ended the way, if any.
    """

    def __init__(
        self, message: str, outcome: str, *, retracted: bool, force_n: float = 0.0
    ) -> None:
        super().__init__(message)
        self.outcome, self.retracted, self.force_n = outcome, retracted, force_n


def touch_from_hemisphere(
    toucher: Toucher, hemisphere: Hemisphere, pose: SensorPose
) -> TouchRecord:
    """Go to a pose on the hemisphere and touch; what goes wrong is in the record.

    TypeError or ValueError where it is no such pose: the arm is not moved then.
    """
    _check_on(hemisphere, pose)
    how: dict[str, Any]
    try:
        way = Way(toucher.robot, toucher.guard, toucher.wait_readings)
        way.follow(hemisphere, pose)
    except WayError as error:
        outcome, how = error.outcome, {"peak_force_n": error.force_n}
        how |= {"message": str(error), "retracted": error.retracted}
    except Exception as error:
        outcome, how = "robot error", {"retracted": is_out(toucher.robot, hemisphere)}
        how["message"] = f"{ON_THE_WAY}: {type(error).__name__}: {error}"
    else:
        return toucher.touch(pose)
    return TouchRecord(outcome, pose, tip_mm(pose), **how)


@dataclass
class Way:
    """A way between touches: the last `n_equal` readings of the force were `last_n`.

    `trail` are the poses from where another reading came last.
    """

    robot: Robot
    guard: Guard
    wait_readings: int = 0
    last_n: float = math.nan
    n_equal: int = 1
    trail: list[SensorPose] = field(default_factory=list)

    def follow(self, hemisphere: Hemisphere, end: SensorPose) -> None:
        """Move round the object to a pose on the hemisphere, in guarded steps.

        First, and after each step, `wait_readings` are waited for, which may still be
        of before. `WayError` says that one was beyond `guard.limit_n`, or no number,
        that they repeat themselves, or that the arm is not where it was sent.
        """
        self._set_out()
        here = self.robot.read_pose()
        self.trail = [here]
        for waypoint in hemisphere.way(here, end):
            for pose in straight_steps(here, waypoint, self.guard.way_step_mm):
                with _stopping_pressed(self.robot, self.guard):
                    self.robot.move_to(pose)
                    self._read_late()
                    place_mm = self.robot.read_pose().position_mm
                    missed_mm = distance_mm(place_mm, pose.position_mm)
                self._refuse(missed_mm)
                # A coarse sensor may repeat itself all along the way.
                if not self.guard.stuck_after or self.n_equal <= 1 + self.wait_readings:
                    self.trail.clear()
                self.trail.append(pose)
                here = pose

    def _set_out(self) -> None:
        """Refuse to set out with a load on: the last touch is not over."""
        for _ in range(self.wait_readings):
            self.robot.read_force()
        self.last_n = _reading(self.robot)
        if math.isnan(self.last_n):
            message = "The force sensor reads no number before the way."
            raise WayError(message, "force sensor", retracted=True)
        if abs(self.last_n) > self.guard.limit_n:
            raise WayError(
                f"{abs(self.last_n):.3f} N before the arm sets out, beyond the limit "
                f"of {self.guard.limit_n:g}: it has not come out, whatever it says of "
                f"its pose, and {stop_arm(self.robot)}. Free it by hand.",
                "limit exceeded",
                retracted=False,
                force_n=abs(self.last_n),
            )

    def _read_late(self) -> None:
        """Wait for the reading after a step, or the first that is beyond the limit."""
        for _ in range(1 + self.wait_readings):
            force_n = _reading(self.robot)
            self.n_equal = self.n_equal + 1 if force_n == self.last_n else 1
            self.last_n = force_n
            if not abs(force_n) <= self.guard.limit_n:
                break

    def _refuse(self, missed_mm: float) -> None:
        """End the way where a step must not be followed by another."""
        guard, force_n = self.guard, self.last_n
        if math.isnan(force_n):
            self._end("force sensor", "The force sensor reads no number on the way.")
        if abs(force_n) > guard.limit_n:
            self._end(
                "limit exceeded",
                f"{force_n:.3f} N on the way to the start, beyond the limit of "
                f"{guard.limit_n:g}: something stands where nothing should. Is the "
                "object where the hemisphere has its centre, and does it fit?",
            )
        if not missed_mm <= guard.max_miss_mm:  # the next step may lead anywhere
            self._end(
                "robot error",
                f"{ON_THE_WAY} the arm is {missed_mm:.2f} mm from where it was sent, "
                f"more than max_miss_mm = {guard.max_miss_mm:g}. Does it reach that "
                "far?",
            )
        if guard.stuck_after and self.n_equal >= guard.stuck_after:
            self._end(
                "force sensor",
                f"The force sensor is stuck at {force_n:.4f} N for {self.n_equal} "
                "readings on the way. If it is that coarse, set stuck_after.",
            )

    def _end(self, outcome: str, why: str) -> NoReturn:
        """Go back along the trail, stop the arm if it does not; say why."""
        clear, trouble, end = False, "", "went back to an earlier step"
        met_n = abs(self.last_n) if outcome == "limit exceeded" else 0.0
        try:
            # Not straight: the object may lie between.
            for pose in reversed(self.trail):
                self.robot.move_to(pose)
            self.robot.retract(0.0)  # as a touch ends that did not move in
            for _ in range(self.wait_readings):
                self.robot.read_force()
            place_mm = self.robot.read_pose().position_mm
            missed_mm = distance_mm(place_mm, self.trail[0].position_mm)
            is_back = missed_mm <= self.guard.max_miss_mm
            clear = is_back and abs(_reading(self.robot)) <= self.guard.limit_n
        except Exception as error:
            trouble = f" ({type(error).__name__}: {error})"
        finally:
            if not clear:
                end = f"did not come back{trouble} and {stop_arm(self.robot)}"
        message = f"{why} The arm {end}."
        raise WayError(message, outcome, retracted=clear, force_n=met_n)


def come_out(robot: Robot, hemisphere: Hemisphere, guard: Guard) -> None:
    """Pull an arm that stands inside the hemisphere straight out of it, and look.

    `RobotError` says that it does not look at the object, or that its way out does not
    lead outward, and nothing was moved; or that it did not come out, or met a load
    there, and was stopped.
    """
    pose = robot.read_pose()
    way_mm = hemisphere.way_out_mm(pose)
    if way_mm <= 0:
        return
    _refuse_way_inward(hemisphere, pose, way_mm)
    n_steps = math.ceil(way_mm / guard.way_step_mm)
    force_n = most_n = max(abs(_reading(robot)), guard.limit_n)
    try:
        for _ in range(n_steps):
            robot.retract(way_mm / n_steps)
            force_n = abs(_reading(robot))
            if not force_n <= most_n:  # a load may be on at first, and goes
                break
            most_n = max(force_n, guard.limit_n)
        left_mm = hemisphere.way_out_mm(robot.read_pose())
    except BaseException:  # an interrupt too: it may press
        stop_arm(robot)
        raise
    if left_mm <= _OUTSIDE_MM and force_n <= guard.limit_n:
        return
    raise RobotError(
        f"The arm was to be pulled out by {way_mm:.0f} mm and says that {left_mm:.0f} "
        f"mm are left, with {force_n:.3f} N: it {stop_arm(robot)}. Free it by hand and "
        "begin again."
    )


def is_out(robot: Robot, hemisphere: Hemisphere) -> bool:
    """Whether the arm says that it is on the hemisphere, on a way round it or outside.

    Where it cannot say, it is not known to be out.
    """
    try:
        pose = robot.read_pose()
    except Exception:
        return False
    arm = np.asarray(pose.position_mm) - np.asarray(hemisphere.centre_mm)
    least_mm = hemisphere.radius_mm * math.cos(hemisphere.arc_rad / 2) - _OUTSIDE_MM
    return float(np.linalg.norm(arm)) >= least_mm


@contextmanager
def _stopping_pressed(robot: Robot, guard: Guard) -> Iterator[None]:
    """Stop the arm where anything is raised and it is not known to be clear."""
    try:
        yield
    except BaseException as error:
        clear, force_n, end = False, math.nan, ""
        try:
            with suppress(Exception):
                force_n = abs(_reading(robot))
                clear = force_n <= guard.limit_n
        finally:  # interrupted again, too
            if not clear:
                end = stop_arm(robot)
        if clear or not isinstance(error, Exception):
            raise
        raise WayError(
            f"{ON_THE_WAY}: {type(error).__name__}: {error} The force "
            f"sensor reads {force_n:.3f} N, so the arm {end}. Free it by hand.",
            "force sensor" if math.isnan(force_n) else "limit exceeded",
            retracted=False,
            force_n=0.0 if math.isnan(force_n) else force_n,
        ) from error


def _check_on(hemisphere: Hemisphere, pose: object) -> None:
    """Refuse a start, of a strategy of one's own, that is not on the hemisphere."""
    if not isinstance(pose, SensorPose):
        raise TypeError(
            f"next_pose must return a SensorPose, got {type(pose).__name__}. Write "
            "hemisphere.pose(azimuth_rad, elevation_rad)."
        )
    up_mm = float(np.asarray(pose.position_mm)[2]) - hemisphere.centre_mm[2]
    least_mm = hemisphere.radius_mm * math.sin(hemisphere.lowest_rad) - _OUTSIDE_MM
    if hemisphere.way_out_mm(pose) > 0 or up_mm < least_mm:
        place = ", ".join(f"{v:.0f}" for v in np.asarray(pose.position_mm))
        raise ValueError(
            f"next_pose must return a pose on {hemisphere!r}, got one at ({place}) mm, "
            "inside or too low. Write hemisphere.pose(azimuth_rad, elevation_rad)."
        )


def _refuse_way_inward(hemisphere: Hemisphere, pose: SensorPose, way_mm: float) -> None:
    """Refuse a pose whose straight way back would lead through the object."""
    arm = np.asarray(pose.position_mm) - np.asarray(hemisphere.centre_mm)
    out = -np.asarray(pose.direction)
    distance = float(np.linalg.norm(arm))
    outward = distance < _OUTSIDE_MM or float(arm @ out) >= _LEAST_COSINE * distance
    end = arm + way_mm * out
    least_height = hemisphere.radius_mm * math.sin(hemisphere.lowest_rad)
    if outward and float(end[2]) >= least_height - _OUTSIDE_MM:
        return
    place = ", ".join(f"{v:.0f}" for v in np.asarray(pose.position_mm))
    look = ", ".join(f"{v:.2f}" for v in np.asarray(pose.direction))
    raise RobotError(
        f"The arm stands at ({place}) mm inside the hemisphere of "
        f"{hemisphere.radius_mm:g} mm and looks along ({look}): pulled straight back "
        "it would pass by the object or below it, so it is not moved. Take it by hand "
        "to a place outside the hemisphere, looking at its centre, and begin again."
    )


def _reading(robot: Robot) -> float:
    """Return one reading of the force (N), NaN where it is no number."""
    force_n = float(robot.read_force())
    return force_n if math.isfinite(force_n) else math.nan
