"""A guarded touch: inward in steps until the force, and out again whatever happens.

The arm starts clear of everything, learns what its force sensor reads in the air,
and moves in along a straight line. It ends with a touch, with nothing at the end of
the line, or with a fault; in each case the arm is pulled back and a record returned.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import check_count, check_number, check_positive
from ..sensors import SensorError, TouchSensor
from ..simulation import SensorPose
from ._record import TouchRecord, tip_mm
from ._robot import Robot

Clock = Callable[[], float]


@dataclass(frozen=True)
class Guard:
    """How far and how hard a guarded touch may go.

    Parameters
    ----------
    force_n : float, default=0.735
        Force at which the frame is taken: 75 gf, as in Corradi 2015.
    limit_n : float, default=3.0
        A single reading above it ends the touch as a fault.
    air_step_mm, contact_step_mm : float, default=1.0, 0.25
        Steps before and after `contact_n` is felt. A step in the air that lands
        beyond `force_n` is taken back and made again in small ones.
    contact_n : float, default=0.1
        Force that counts as contact; above the noise of the force sensor.
    max_travel_mm : float, default=315.0
        Length of the approach after which there is nothing: from a hemisphere of
        300 mm to its centre, and the depth of a dome.
    max_press_mm : float, default=20.0
        Way from the first contact after which something must be wrong.
    timeout_s : float, default=60.0
        Longest approach.
    n_readings : int, default=3
        Readings per step, averaged against noise.
    n_tare : int, default=12
        Readings in the air, whose mean is the offset.
    max_offset_n : float, default=1.0
        Largest offset of a force sensor that touches nothing.
    stuck_after : int or None, default=12
        So many equal readings in a row mean that the force sensor is stuck; None
        for one so coarse or so quiet that it repeats itself. 12 readings are four
        steps, 1 mm in contact.
    """

    force_n: float = 0.735
    limit_n: float = 3.0
    air_step_mm: float = 1.0
    contact_step_mm: float = 0.25
    contact_n: float = 0.1
    max_travel_mm: float = 315.0
    max_press_mm: float = 20.0
    timeout_s: float = 60.0
    n_readings: int = 3
    n_tare: int = 12
    max_offset_n: float = 1.0
    stuck_after: int | None = 12

    def __post_init__(self) -> None:
        for name in ("force_n", "air_step_mm", "contact_step_mm", "contact_n"):
            check_positive(name, getattr(self, name))
        for name in ("max_travel_mm", "max_press_mm", "timeout_s", "max_offset_n"):
            check_positive(name, getattr(self, name))
        check_count("n_readings", self.n_readings)
        check_count("n_tare", self.n_tare)
        if self.stuck_after is not None:
            check_count("stuck_after", self.stuck_after, at_least=3)
        check_number("contact_n", self.contact_n, high=self.force_n)
        if not self.limit_n > self.force_n:
            raise ValueError(
                f"limit_n must be above force_n ({self.force_n}), got {self.limit_n}. "
                "The limit is for what should never happen."
            )


def guarded_touch(
    robot: Robot,
    sensor: TouchSensor,
    start: SensorPose,
    guard: Guard | None = None,
    *,
    clock: Clock = time.monotonic,
) -> TouchRecord:
    """Touch once, along a line from a pose that is clear of everything.

    Parameters
    ----------
    robot, sensor : Robot, TouchSensor
        What moves and what feels.
    start : SensorPose
        Where the approach begins; the arm moves there in a straight line.
    guard : Guard, optional
        Forces, steps and limits.
    clock : callable, default=time.monotonic
        Seconds, for the time-out.

    Returns
    -------
    TouchRecord
        Whatever happened, the arm was pulled back by as much as it had moved in;
        where even that failed it was stopped, and `retracted` is False.

    Raises
    ------
    BaseException
        Only what ends a program (KeyboardInterrupt, SystemExit), after the arm
        was pulled back.
    """
    approach = _Approach(robot, sensor, start, guard or Guard(), clock)
    try:
        approach.run()
    except _Fault as fault:
        approach.outcome, approach.message = fault.outcome, str(fault)
    except Exception as error:
        approach.outcome = "robot error"
        approach.message = f"{type(error).__name__}: {error}"
    finally:
        approach.pull_back()
    return approach.record()


class _Fault(Exception):
    """The end of an approach that should not have ended so."""

    def __init__(self, outcome: str, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome


class _Approach:
    """One approach: its progress, its readings, its end."""

    def __init__(
        self,
        robot: Robot,
        sensor: TouchSensor,
        start: SensorPose,
        guard: Guard,
        clock: Clock,
    ) -> None:
        self.robot, self.sensor, self.start = robot, sensor, start
        self.guard, self.clock = guard, clock
        self.outcome, self.message = "nothing", ""
        self.travel_mm = self.farthest_mm = 0.0
        self.force_n = self.peak_force_n = 0.0
        self.image: NDArray[Any] | None = None
        self.retracted = True
        self._offset_n = 0.0
        self._contact_mm: float | None = None
        self._fine_until_mm = 0.0
        self._last, self._n_equal = math.nan, 0
        self._began = clock()

    def run(self) -> None:
        """Move in until the force, the end of the line, or a fault."""
        self.robot.move_to(self.start)
        self._tare()
        while self.travel_mm < self.guard.max_travel_mm:
            fine = self._contact_mm is not None or self.travel_mm < self._fine_until_mm
            step = self.guard.contact_step_mm if fine else self.guard.air_step_mm
            self._advance(min(self.travel_mm + step, self.guard.max_travel_mm))
            if self.force_n < self.guard.force_n:
                self._watch_contact()
            elif fine:
                self._take_frame()
                return
            else:
                self._fine_until_mm = self.travel_mm
                self._advance(self.travel_mm - step)

    def pull_back(self) -> None:
        """Retract as far as the arm may have come; if it will not, stop it."""
        for attempt in (1, 2):
            try:
                self.robot.retract(self.farthest_mm)
                return
            except Exception as error:
                self._note(f"Retracting failed ({attempt}): {error}")
        self.retracted = False
        if self.outcome == "nothing":
            self.outcome = "robot error"
        try:
            self.robot.stop()
        except Exception as error:
            self._note(f"Stopping failed: {error}")

    def record(self) -> TouchRecord:
        """Return what is kept of this approach."""
        return TouchRecord(
            outcome=self.outcome,
            start=self.start,
            position_mm=tip_mm(self.start.advanced(self.travel_mm)),
            force_n=self.force_n,
            peak_force_n=self.peak_force_n,
            travel_mm=self.travel_mm,
            duration_s=self.clock() - self._began,
            image=self.image,
            message=self.message,
            retracted=self.retracted,
        )

    def _tare(self) -> None:
        """Learn the offset of the force sensor in the air; refuse a bad one."""
        readings = [self._read() for _ in range(self.guard.n_tare)]
        offset = float(np.mean(readings))
        if abs(offset) > self.guard.max_offset_n:
            raise _Fault(
                "force sensor",
                f"{offset:.3f} N in the air, more than {self.guard.max_offset_n:g}: "
                "the sensor touches something or has drifted.",
            )
        self._offset_n = offset

    def _advance(self, travel_mm: float) -> None:
        # The arm may have moved although the driver raises: pull back that far too.
        self.farthest_mm = max(self.farthest_mm, travel_mm)
        self.robot.move_to(self.start.advanced(travel_mm))
        self.travel_mm = travel_mm
        forces = []
        for _ in range(self.guard.n_readings):
            forces.append(self._read() - self._offset_n)
            self.peak_force_n = max(self.peak_force_n, forces[-1])
            self.force_n = sum(forces) / len(forces)
            self._refuse_too_hard(forces[-1])
        if self.clock() - self._began > self.guard.timeout_s:
            raise _Fault("timed out", f"No end after {self.guard.timeout_s:g} s.")

    def _watch_contact(self) -> None:
        """Note where contact began; refuse to go on pushing without a force."""
        if self.force_n < self.guard.contact_n:
            self._contact_mm = None
        elif self._contact_mm is None:
            self._contact_mm = self.travel_mm
        elif self.travel_mm - self._contact_mm > self.guard.max_press_mm:
            raise _Fault(
                "force sensor",
                f"Still {self.force_n:.3f} N {self.guard.max_press_mm:g} mm "
                "beyond the first contact.",
            )

    def _read(self) -> float:
        force = float(self.robot.read_force())
        if not math.isfinite(force):
            raise _Fault("force sensor", f"The force sensor reads {force}.")
        self._n_equal = self._n_equal + 1 if force == self._last else 1
        self._last = force
        if self.guard.stuck_after and self._n_equal >= self.guard.stuck_after:
            raise _Fault(
                "force sensor",
                f"The force sensor is stuck at {force:.4f} N for {self._n_equal} "
                "readings. If it is that coarse, set stuck_after.",
            )
        return force

    def _refuse_too_hard(self, force_n: float) -> None:
        if force_n > self.guard.limit_n:
            raise _Fault(
                "limit exceeded",
                f"{force_n:.3f} N, above the limit of {self.guard.limit_n:g}.",
            )

    def _take_frame(self) -> None:
        try:
            frame = np.asarray(self.sensor.read())
        except SensorError as error:
            raise _Fault("no frame", str(error)) from error
        if (
            frame.shape != tuple(self.sensor.image_shape)
            or frame.dtype.kind not in "biuf"
        ):
            raise _Fault(
                "no frame",
                f"A frame of shape {frame.shape} and type {frame.dtype} arrived, not "
                f"{self.sensor.image_shape}.",
            )
        if np.isinf(frame).any() or np.isnan(frame).all():
            raise _Fault(
                "no frame",
                "A frame must be finite but for dead taxels (NaN), got one with "
                "infinity or of NaN alone. Look at the sensor.",
            )
        self.image, self.outcome = frame.copy(), "touched"

    def _note(self, text: str) -> None:
        self.message = f"{self.message} {text}".strip()
