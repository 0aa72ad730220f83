"""A guarded touch: inward in steps until the force, and out again whatever happens.

The arm starts clear of everything, learns what its force sensor reads in the air,
and moves in along a straight line. It ends with a touch, with nothing at the end of
the line, or with a fault; in each case the arm is pulled back and a record returned.

What bounds the true force: before every step inward all readings were taken after the
last step, each of them was within the limit by its magnitude, and once one of them had
reached the force to stop at, a second set was read before it was decided. So a sensor
that reads s times the force, with an offset that moves by at most D during the touch,
allows (force_n + D) / s and what one further step adds; a sensor that sticks is found
by repeating itself, by not changing over `flat_mm` of contact, or by the pictures.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np

from .._checks import ARRAY_SIDE, check_count, check_number, check_positive
from .._types import Array, Floats
from ..sensors import SensorError, TouchSensor
from ..simulation import SensorPose
from ._record import TouchRecord, tip_mm
from ._robot import LEAST_COSINE, Robot, distance_mm, stop_arm

Clock = Callable[[], float]
_LEAST_COUNTS = {"n_readings": 1, "n_tare": 1, "stuck_after": 3, "lag_readings": 0}
_OPTIONAL = "stuck_after", "frame_change", "expected_n_mm"
# A force sensor in contact that changes by less than this, over `flat_mm`, does not
# follow the contact; nor one that changes by less than six times its noise.
_FLAT_N, _FLAT_NOISES = 0.01, 6.0


@dataclass(frozen=True)
class Guard:
    """How far and how hard a guarded touch may go.

    Parameters
    ----------
    force_n : float, default=0.735
        Force at which the frame is taken: 75 gf, as in Corradi 2015.
    limit_n : float, default=3.0
        A single reading beyond it, of either sign, with or without its offset, ends
        the touch as a fault before any further step.
    air_step_mm, contact_step_mm : float, default=1.0, 0.25
        Steps before and after `contact_n` is read. A step in the air that lands
        beyond `force_n` is taken back and made again in small ones. The force may pass
        `limit_n` by what one step adds: choose steps below `limit_n` divided by the
        stiffness (N/mm) of the stiffest thing that may be met.
    contact_n : float, default=0.1
        Force that counts as contact, until it falls below half of it; above the noise
        of the force sensor. The mean of a step's readings below minus this is a force
        of the wrong sign, a fault.
    max_travel_mm : float, default=315.0
        Length of the approach after which there is nothing: from a hemisphere of
        300 mm to its centre, and the depth of a dome. For another radius give that and
        15: beyond the centre it meets what the object stands on, and believes that.
    max_press_mm : float, default=20.0
        Way from the first contact after which something must be wrong.
    timeout_s : float, default=60.0
        Longest approach, of a force sensor that does not lag; waiting for one that
        does takes longer, and so does the limit.
    n_readings : int, default=4
        Readings per step, averaged against noise. Must be more than the readings by
        which the force sensor lags behind the arm.
    n_tare : int, default=12
        Readings in the air, whose mean is the offset; read again afterwards.
    max_offset_n : float, default=1.0
        Largest offset of a force sensor that touches nothing.
    stuck_after : int or None, default=12
        So many equal readings in a row mean that the force sensor is stuck; None
        for one so coarse or so quiet that it repeats itself. 12 readings are three
        steps, 0.75 mm in contact; on ways 12 steps at most, of `way_step_mm`.
    flat_mm : float, default=2.0
        Way into contact over which the force must change, by more than its noise.
    max_miss_mm : float, default=0.5
        How far from where it was sent the arm may say that it is.
    way_step_mm : float, default=2.5
        Longest step on ways between touches, after each of which the force is read:
        what is met there may press by `limit_n` and what one such step adds.
    lag_readings : int, default=64
        Readings by which a late or filtered force sensor may lag. The first touches of
        an episode, and the ways to them, wait for so many at every step, until the
        force has changed once and its lag is known; later ones wait for that lag. 0 for
        a sensor that is known not to lag. One that lags by more is outside what is
        promised.
    expected_n_mm : float or None, default=None
        Stiffness of the softest part between arm and object (N/mm), the rubber of the
        sensor: by half of it at least the force must rise over `flat_mm` of contact. A
        force sensor that reads a tenth of the force is outside what is promised
        without it.
    frame_change : float or None, default=None
        Change of the tactile image, root mean square in the sensor's unit, that is a
        contact: found while the force reads as in the air, it is a fault. Without it a
        force sensor that is dead but noisy reads as in the air, and the arm moves on
        to `max_travel_mm`. Half of what a light touch changes is a good choice.
    frame_every_mm : float, default=2.0
        How often that is looked at, on the way.
    """

    force_n: float = 0.735
    limit_n: float = 3.0
    air_step_mm: float = 1.0
    contact_step_mm: float = 0.25
    contact_n: float = 0.1
    max_travel_mm: float = 315.0
    max_press_mm: float = 20.0
    timeout_s: float = 60.0
    n_readings: int = 4
    n_tare: int = 12
    max_offset_n: float = 1.0
    stuck_after: int | None = 12
    flat_mm: float = 2.0
    max_miss_mm: float = 0.5
    way_step_mm: float = 2.5
    lag_readings: int = 64
    expected_n_mm: float | None = None
    frame_change: float | None = None
    frame_every_mm: float = 2.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is None and name in _OPTIONAL:
                continue
            if name in _LEAST_COUNTS:
                check_count(name, value, at_least=_LEAST_COUNTS[name])
            else:
                check_positive(name, value)
        check_number("contact_n", self.contact_n, high=self.force_n)
        if not self.limit_n > self.force_n:
            raise ValueError(
                f"limit_n must be above force_n ({self.force_n}), got {self.limit_n}. "
                "The limit is for what should never happen."
            )
        if self.contact_step_mm > self.air_step_mm:
            raise ValueError(
                f"contact_step_mm must be at most air_step_mm ({self.air_step_mm}), "
                f"got {self.contact_step_mm}. Contact needs the smaller steps."
            )
        if self.flat_mm < self.contact_step_mm:
            raise ValueError(
                f"flat_mm must be at least contact_step_mm ({self.contact_step_mm}), "
                f"got {self.flat_mm}. Two steps are compared."
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
        The arm, and the tactile sensor that it carries.
    start : SensorPose
        Where the approach begins; the arm moves there in a straight line, by steps of
        `guard.way_step_mm`, and back again where something stands there. `explore`
        goes round the object.
    guard : Guard, optional
        Forces, steps and limits.
    clock : callable, default=time.monotonic
        Seconds, for the time-out.

    Returns
    -------
    TouchRecord
        Whatever happened, the arm was pulled back by as much as it had moved in;
        where even that failed it was stopped, and `retracted` is False. "nothing"
        says that no contact was read on the whole way, and that the offset was the
        same afterwards.

    Raises
    ------
    TypeError
        Something is no arm, sensor, pose or guard; nothing was moved.
    BaseException
        Only what ends a program (KeyboardInterrupt, SystemExit), after the arm
        was pulled back. SIGTERM raises nothing, and leaves the arm where it is, unless
        the program turns it into an exit.
    """
    toucher = Toucher(robot, sensor, guard or Guard(), clock, lag=0)
    if not isinstance(start, SensorPose):
        raise TypeError(
            f"start must be a SensorPose, got {type(start).__name__}. Write "
            "SensorPose(position_mm, direction)."
        )
    return toucher.touch(start)


def check_parts(name: str, thing: object, *parts: str) -> None:
    """Refuse what lacks a part of its contract while nothing has moved yet."""
    missing = [part for part in parts if not hasattr(thing, part)]
    if missing:
        raise TypeError(
            f"{name} must have {', '.join(parts)}, got {type(thing).__name__} without "
            f"{', '.join(missing)}. Write what is missing, or look at the order."
        )


@dataclass
class Toucher:
    """What touches: arm, sensor, guard and clock; lag and last image, if known."""

    robot: Robot
    sensor: TouchSensor
    guard: Guard
    clock: Clock = time.monotonic
    lag: int | None = None
    last_image: Array | None = None

    def __post_init__(self) -> None:
        methods = "move_to", "read_pose", "read_force", "retract", "stop"
        check_parts("robot", self.robot, *methods)
        check_parts("sensor", self.sensor, "image_shape", "read")
        if not isinstance(self.guard, Guard):
            raise TypeError(
                f"guard must be a Guard, got {self.guard!r}. Write Guard(limit_n=5)."
            )

    @property
    def wait_readings(self) -> int:
        """Readings to wait for after each step of a way."""
        return self.guard.lag_readings if self.lag is None else self.lag

    def touch(self, start: SensorPose) -> TouchRecord:
        """Touch once from a pose that is clear of everything; see `guarded_touch`."""
        arm = self.robot, self.sensor
        # A step of a touch takes `n_readings` anyway.
        covered = self.lag is not None and self.lag < 2 * self.guard.n_readings
        n_waits = 0 if covered else self.wait_readings
        approach = _Approach(*arm, start, self.guard, self.clock, n_waits)
        try:
            approach.attempt(approach.run)
        finally:
            approach.pull_back()
        approach.attempt(approach.check_offset)
        lag = approach.lag_readings
        if self.lag is None and lag is not None:
            # With room for a filter, which only comes near to the force in its time.
            self.lag = 2 * lag
        if approach.outcome == "touched":
            approach.attempt(partial(approach.refuse_repeated, self.last_image))
            self.last_image = approach.image
        return approach.record()


def straight_steps(
    start: SensorPose, end: SensorPose, longest_mm: float
) -> Iterator[SensorPose]:
    """Yield poses on the straight line to `end`, which is the last of them."""
    first, last = (np.asarray(pose.position_mm) for pose in (start, end))
    n_steps = max(1, math.ceil(float(np.linalg.norm(last - first)) / longest_mm))
    for number in range(1, n_steps):
        place = first + (last - first) * (number / n_steps)
        yield SensorPose(place, end.direction, end.roll_rad)
    yield end


class _Fault(Exception):
    def __init__(self, message: str, outcome: str = "force sensor") -> None:
        super().__init__(message)
        self.outcome = outcome


@dataclass
class _Approach:
    """One approach: its progress, its readings, its end."""

    robot: Robot
    sensor: TouchSensor
    start: SensorPose
    guard: Guard
    clock: Clock
    wait_readings: int

    def __post_init__(self) -> None:
        self.lag_readings: int | None = None
        self.outcome, self.message, self.retracted = "nothing", "", True
        self.travel_mm = self.farthest_mm = self._missed_mm = 0.0
        self.force_n = self.peak_force_n = self._most_n = 0.0
        self.image: Array | None = None
        self._air_frame: Floats | None = None
        self._offset_n, self._flat_n = 0.0, _FLAT_N
        self._in_contact: list[tuple[float, float]] = []
        self._fine_until_mm = self._look_at_mm = 0.0
        self._last, self._n_equal = math.nan, 0
        self._was_at_start, self._cosine = False, 1.0
        self._began = self.clock()

    def attempt(self, part: Callable[[], None]) -> None:
        """Do a part of the touch; what goes wrong in it is the outcome."""
        try:
            part()
        except _Fault as fault:
            self.outcome = fault.outcome
            self._note(str(fault))
        except Exception as error:
            self.outcome = "robot error"
            self._note(f"{type(error).__name__}: {error}")

    def run(self) -> None:
        """Move in until the force, the end of the line, or a fault."""
        guard = self.guard
        self._come_near()
        self._began = self.clock()
        self._move(0.0)
        self._refuse_miss()
        self._was_at_start = True
        self._tare()
        if guard.frame_change is not None:
            self._air_frame = self._frame().astype(np.float64)
        while self.travel_mm < guard.max_travel_mm:
            before = self.travel_mm
            fine = bool(self._in_contact) or before < self._fine_until_mm
            step = guard.contact_step_mm if fine else guard.air_step_mm
            self._advance(min(before + step, guard.max_travel_mm))
            if before == 0 and self.force_n >= guard.contact_n:
                raise _Fault(
                    f"{self.force_n:.3f} N after the first {step:g} mm: the offset may "
                    "hold a load. Start further away, clear of everything."
                )
            if self.force_n < guard.force_n:
                self._watch_contact()
            elif fine:
                self.image, self.outcome = self._frame(), "touched"
                return
            else:
                self._take_back(before)
        self._refuse_load()

    def pull_back(self) -> None:
        """Retract as far as the arm may have come; if it will not, stop it.

        It is out where it says so itself. Whatever is raised meanwhile, an interrupt
        too, it is tried twice, and stopped then; an interrupt goes on afterwards.
        """
        interrupt: BaseException | None = None
        way_mm = self.farthest_mm
        for attempt in (1, 2):
            try:
                if attempt > 1 and self._missed_mm <= self.guard.max_miss_mm:
                    # What raised may have moved the arm all the same.
                    with suppress(Exception):
                        way_mm = min(way_mm, self._inward_mm(self._here()))
                self.robot.retract(way_mm)
                way_mm = self._inward_mm(self._here())
                if way_mm <= self.guard.max_miss_mm:
                    break
                self._note(
                    f"Retracting did not move the arm ({attempt}): it is {way_mm:.1f} "
                    "mm inward of where it began."
                )
            except BaseException as error:
                why = str(error) or type(error).__name__
                self._note(f"Retracting failed ({attempt}): {why}")
                if not isinstance(error, Exception):
                    interrupt = error
        else:
            self._stop()
        if interrupt is not None:
            raise interrupt

    def _here(self) -> Floats:
        pose = self.robot.read_pose()
        line = np.asarray(self.start.direction)
        self._cosine = float(np.asarray(pose.direction) @ line)
        here = np.asarray(pose.position_mm, dtype=np.float64)
        if not np.isfinite(here).all():  # of a pose that is no SensorPose
            raise _Fault(f"The arm says that it is at {here} mm.", "robot error")
        return here

    def _inward_mm(self, here: Floats) -> float:
        """Return how far inward of its start a place lies.

        0 beside the line for an arm that never was at the start: it did not move in.
        """
        way, line = here - np.asarray(self.start.position_mm), self.start.direction
        inward = max(float(way @ np.asarray(line)), 0.0)
        aside = float(np.linalg.norm(way - inward * np.asarray(line)))
        is_there = self._was_at_start or aside <= self.guard.max_miss_mm
        return inward if is_there else 0.0

    def _stop(self) -> None:
        """Stop an arm that does not come out."""
        self.retracted = False
        if self.outcome == "nothing":
            self.outcome = "robot error"
        self._note(f"The arm {stop_arm(self.robot)}.")

    def check_offset(self) -> None:
        """Read the air once more: an offset that moved hides a load, or feigns one."""
        if not self.retracted or self.outcome not in ("touched", "nothing"):
            return
        # The first may still be of the contact.
        n_stale = max(self.guard.n_readings, self.wait_readings)
        readings = [self._read() for _ in range(n_stale + self.guard.n_tare)]
        moved_n = float(np.mean(readings[n_stale:])) - self._offset_n
        pressed_n = max(self.guard.contact_n, self.force_n / 2)
        if self.outcome == "touched" and moved_n > pressed_n:
            self._stop()
            raise _Fault(
                f"{moved_n:.3f} N of {self.force_n:.3f} are still there after the arm "
                "was pulled back: it did not come out, whatever it says.",
                "robot error",
            )
        if abs(moved_n) > self.guard.contact_n:
            raise _Fault(
                f"The offset moved by {moved_n:.3f} N during the touch, more than "
                f"contact_n = {self.guard.contact_n:g}: what was pressed is not known."
            )

    def refuse_repeated(self, before: Array | None) -> None:
        """Refuse the frame of the touch before; a camera's noise is never the same.

        Frames of a small array may well be alike.
        """
        image = self.image
        if before is None or image is None or min(image.shape[:2]) <= ARRAY_SIDE:
            return
        if np.array_equal(image, before, equal_nan=True):
            raise _Fault(
                "The frame is that of the touch before, pixel for pixel: the sensor "
                "repeats itself. Look at it, or open it again.",
                "no frame",
            )

    def record(self) -> TouchRecord:
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
        """Learn the offset and the noise of the force sensor in the air."""
        readings = [self._read() for _ in range(self.guard.n_tare)]
        self._offset_n = offset = float(np.mean(readings))
        most = min(self.guard.max_offset_n, self.guard.limit_n - self.guard.force_n)
        if abs(offset) > most:
            raise _Fault(
                f"{offset:.3f} N in the air, more than {most:g}: the sensor touches "
                "something or has drifted. Clear it, or set it to zero."
            )
        noise = float(np.std(readings)) / math.sqrt(self.guard.n_readings)
        self._flat_n = max(_FLAT_N, _FLAT_NOISES * noise)

    def _come_near(self) -> None:
        """Come to a start that is over a step away; go back where there is no air."""
        guard = self.guard
        first, here, step_mm = self.robot.read_pose(), self._here(), guard.way_step_mm
        is_far = distance_mm(self.start.position_mm, here) > step_mm
        try:
            for pose in straight_steps(first, self.start, step_mm) if is_far else ():
                self.robot.move_to(pose)
                force = self._read()
                if abs(force) > guard.limit_n:
                    self.peak_force_n = abs(force)
                    raise _Fault(
                        f"{force:.3f} N on the straight way to the start, above the "
                        f"limit of {guard.limit_n:g}. Go round what stands there.",
                        "limit exceeded",
                    )
                self._missed_mm = distance_mm(self._here(), pose.position_mm)
                self._refuse_miss()
        except BaseException:
            back = False
            try:
                with suppress(Exception):
                    self.robot.move_to(first)
                with suppress(Exception):
                    back = distance_mm(self._here(), here) <= guard.max_miss_mm
            finally:  # interrupted again, too
                if not back:
                    self._stop()
            raise

    def _move(self, travel_mm: float) -> None:
        """Move along the line, and learn by how much the arm says that it missed."""
        # The arm may have moved although the driver raises: pull back that far too.
        self.farthest_mm = max(self.farthest_mm, travel_mm)
        pose = self.start.advanced(travel_mm) if travel_mm else self.start
        self.robot.move_to(pose)
        self.travel_mm = travel_mm
        here = self._here()
        self._missed_mm = distance_mm(here, pose.position_mm)
        if self._missed_mm > self.guard.max_miss_mm:
            reached = min(self._inward_mm(here), self.guard.max_travel_mm)
            self.farthest_mm = max(self.farthest_mm, reached)

    def _advance(self, travel_mm: float) -> None:
        """Move, then read the force there; refuse all that must not be moved on."""
        self._move(travel_mm)
        self._measure()
        self._refuse_miss()
        # Waiting for a late force sensor takes so many times as long.
        longer = 1 + self.wait_readings / self.guard.n_readings
        most_s = self.guard.timeout_s * longer
        if self.clock() - self._began > most_s:
            raise _Fault(
                f"No end after {most_s:g} s, {travel_mm:g} mm from the "
                "start. If the arm is that slow, raise timeout_s, or start nearer.",
                "timed out",
            )

    def _take_back(self, before_mm: float) -> None:
        """Undo a step that landed beyond the force, to make it again in small ones."""
        self._fine_until_mm = self.travel_mm
        self._advance(before_mm)
        if self.force_n >= self.guard.force_n:
            raise _Fault(
                f"Still {self.force_n:.3f} N where it was air before: the force sensor "
                "is stuck or lags, or something holds on to the sensor."
            )

    def _measure(self) -> None:
        """Read the force; once a reading has reached `force_n`, wait and read again."""
        self._wait()
        if max(map(abs, self._forces(self.guard.n_readings))) >= self.guard.force_n:
            self._forces(self.guard.n_readings)
        if self.force_n < -self.guard.contact_n:
            raise _Fault(
                f"{self.force_n:.3f} N: a force of the wrong sign. read_force must be "
                "positive when something pushes back; if it is, the offset drifts."
            )

    def _wait(self) -> None:
        """Wait for a force sensor that may lag, and learn by how much it does."""
        if not self.wait_readings:
            return
        before_n, forces = self.force_n, self._forces(self.wait_readings)
        rise_n, least_n = forces[-1] - before_n, 2 * self._flat_n
        if self.lag_readings is not None or rise_n < max(self.guard.contact_n, least_n):
            return
        # Standing still, a force that goes on rising is of steps made before.
        later_n = self._forces(self.wait_readings)[-1] - forces[-1]
        if later_n > max(least_n, rise_n / 2):
            raise _Fault(
                f"The force sensor lags by more than {self.wait_readings} readings "
                "behind the arm. Read it less filtered, or raise lag_readings."
            )
        half_n = before_n + rise_n / 2
        self.lag_readings = next(k for k, n in enumerate(forces) if n >= half_n)

    def _forces(self, n_readings: int) -> list[float]:
        """Read the force so often (N), each reading within the limit; keep the mean."""
        forces: list[float] = []
        for _ in range(n_readings):
            forces.append(self._read() - self._offset_n)
            self.force_n = sum(forces) / len(forces)
            self._refuse_above_limit(forces[-1])
        return forces

    def _refuse_above_limit(self, force: float) -> None:
        """Refuse a single reading beyond the limit, with or without its offset."""
        reading, limit = force + self._offset_n, self.guard.limit_n
        self.peak_force_n = max(self.peak_force_n, abs(force))
        if max(abs(reading), abs(force)) > limit:
            sign = " read_force must be positive when something pushes back."
            raise _Fault(
                f"{force:.3f} N ({reading:.3f} with its offset), above the limit "
                f"of {limit:g}.{sign if force < 0 else ''}",
                "limit exceeded",
            )

    def _watch_contact(self) -> None:
        """Note where contact began; refuse to go on pressing without a rising force."""
        guard, here = self.guard, self.travel_mm
        if self.force_n < guard.contact_n / (2 if self._in_contact else 1):
            self._in_contact.clear()
            self._look()
            return
        self._in_contact.append((here, self.force_n))
        self._most_n = max(self._most_n, self.force_n)
        pressed = here - self._in_contact[0][0]
        if pressed > guard.max_press_mm:
            raise _Fault(
                f"Still {self.force_n:.3f} N {guard.max_press_mm:g} mm "
                "beyond the first contact."
            )
        if pressed < guard.flat_mm - 1e-9:
            return
        recent = [n for mm, n in self._in_contact if mm >= here - guard.flat_mm - 1e-9]
        change_n = max(recent) - min(recent)
        self._refuse_soft(change_n)
        if change_n < self._flat_n:
            raise _Fault(
                f"{self.force_n:.3f} N for {guard.flat_mm:g} mm in contact, without "
                "a change: the force sensor is stuck. If the object is that soft or "
                "the sensor that coarse, raise flat_mm."
            )

    def _refuse_soft(self, change_n: float) -> None:
        """Refuse a force that rises by less than half of what the sensor's end does."""
        guard = self.guard
        if guard.expected_n_mm is None:
            return
        least_n = guard.expected_n_mm * guard.flat_mm / 2
        if change_n < least_n:
            raise _Fault(
                f"The force rose by {change_n:.3f} N over "
                f"{guard.flat_mm:g} mm of contact, less than {least_n:.3f}, half of "
                f"what expected_n_mm = {guard.expected_n_mm:g} gives: it reads too "
                "little."
            )

    def _look(self) -> None:
        """Refuse a tactile image of contact while the force reads as in the air."""
        limit, air = self.guard.frame_change, self._air_frame
        if limit is None or air is None or self.travel_mm < self._look_at_mm:
            return
        self._look_at_mm = self.travel_mm + self.guard.frame_every_mm
        change = np.sqrt(np.nanmean((self._frame() - air) ** 2))
        if not change < limit:
            raise _Fault(
                f"The tactile image changed by {change:.3g}, as in contact, but the "
                f"force sensor reads {self.force_n:.3f} N. Is it connected?"
            )

    def _refuse_load(self) -> None:
        """At the end of the line there is nothing only if nothing was met."""
        self._measure()  # The last readings may still be of the step before.
        self._look_at_mm = self.travel_mm
        self._watch_contact()
        if self._most_n:
            raise _Fault(
                f"{self._most_n:.3f} N at most on {self.travel_mm:g} mm, and no touch "
                f"of {self.guard.force_n:g}. Raise max_travel_mm, or start nearer.",
                "force not reached",
            )

    def _read(self) -> float:
        force = float(self.robot.read_force())
        if not math.isfinite(force):
            raise _Fault(f"The force sensor reads {force}.")
        self._n_equal = self._n_equal + 1 if force == self._last else 1
        self._last = force
        if self.guard.stuck_after and self._n_equal >= self.guard.stuck_after:
            raise _Fault(
                f"The force sensor is stuck at {force:.4f} N for {self._n_equal} "
                "readings. If it is that coarse, set stuck_after."
            )
        return force

    def _refuse_miss(self) -> None:
        if not self._missed_mm <= self.guard.max_miss_mm:
            raise _Fault(
                f"The arm is {self._missed_mm:.2f} mm from where it was sent, more "
                f"than max_miss_mm = {self.guard.max_miss_mm:g}.",
                "robot error",
            )
        if not self._cosine > LEAST_COSINE:
            raise _Fault(
                "The arm looks another way than it was sent, by "
                f"{math.degrees(math.acos(max(self._cosine, -1.0))):.0f} degrees: "
                "pulled back, it would go aside. Does its wrist reach that far?",
                "robot error",
            )

    def _frame(self) -> Array:
        try:
            frame = np.asarray(self.sensor.read())
        except SensorError as error:
            raise _Fault(str(error), "no frame") from error
        except Exception as error:  # a driver's own: not the arm is to be looked at
            raise _Fault(f"{type(error).__name__}: {error}", "no frame") from error
        shape = tuple(self.sensor.image_shape)
        if frame.shape != shape or frame.dtype.kind not in "biuf":
            kind = f"A frame of shape {frame.shape} and type {frame.dtype}"
            raise _Fault(f"{kind} arrived, not {shape}.", "no frame")
        if np.isinf(frame).any() or np.isnan(frame).all():
            raise _Fault(
                "A frame must be finite but for dead taxels (NaN), got one with "
                "infinity or of NaN alone. Look at the sensor.",
                "no frame",
            )
        return frame.copy()

    def _note(self, text: str) -> None:
        self.message = f"{self.message} {text}".strip()
