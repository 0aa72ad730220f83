"""The contract of a robot arm that carries the sensor, a check of it, a simulated arm.

The contract is `Robot`, all of it on this screen. World: millimetres, z up. A pose
(`SensorPose`) is the place of the sensor's tip, the way it looks and its roll about
that way. Forces are newtons along that way, positive when something pushes back.
"""

import math
from collections.abc import Callable, Container, Mapping
from contextlib import suppress
from numbers import Real
from types import MappingProxyType
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_count, check_number, check_option, check_positive
from ..sensors import SimulatedBench
from ..simulation import SensorPose

FAULTS = (
    "stuck force",
    "stuck force in contact",
    "no force",
    "overshoot",
    "driver error",
    "slow",
    "retract error",
    "arm stuck",
    "no frame",
    "out of reach",
)
_N_READINGS = 24
_FEWEST_LEVELS = 2
_OVERSHOOT_MM = 14.0
_SLOW_S = 1e4
_AWAY_MM = 1e5
# An arm looks the way that it was sent where it is off by less than this (rad).
LEAST_COSINE = math.cos(0.05)


class RobotError(RuntimeError):
    """The arm did not do what it was asked to, or cannot read its force."""


@runtime_checkable
class Robot(Protocol):
    """An arm that can be driven by `guarded_touch` and `explore`.

    Each call returns when it is done, or raises within a time limit of the
    driver's own: nothing here can wake a call that never returns.
    """

    def move_to(self, pose: SensorPose) -> None:
        """Move the tip to `pose` in a straight line, and wait until it is there."""

    def read_pose(self) -> SensorPose:
        """Return where the tip is now, as measured and not as it was sent.

        A touch, or a step on the way to one, ends as a fault where the two differ: by
        more than `Guard.max_miss_mm`, or a touch by 0.05 rad in the way it looks.
        """

    def read_force(self) -> float:
        """Return a fresh reading of the force sensor (N), its offset included.

        Positive when something pushes back.
        """

    def retract(self, way_mm: float) -> None:
        """Pull the tip straight back, against the way it looks, and wait.

        Must work while in contact and after any error.
        """

    def stop(self) -> None:
        """Halt at once and stay; the last resort, allowed at any time."""


def distance_mm(one_mm: ArrayLike, other_mm: ArrayLike) -> float:
    """Return how far apart two places are."""
    return float(np.linalg.norm(np.subtract(one_mm, other_mm)))


def stop_arm(robot: Robot) -> str:
    """Stop the arm, in a second attempt if need be; return whether it was stopped.

    In words for a message. An interrupt meanwhile goes on afterwards.
    """
    end, interrupt = "", None
    for _ in range(2):
        try:
            robot.stop()
            end = "was stopped"
            break
        except BaseException as error:
            end = f"could not be stopped ({type(error).__name__}: {error})"
            if not isinstance(error, Exception):
                interrupt = error
    if interrupt is not None:
        raise interrupt
    return end


class SimulatedRobot:
    """An arm over a `SimulatedBench`, as a `Robot`.

    Parameters
    ----------
    bench : SimulatedBench
        Where it moves the dome.
    home : SensorPose
        Where the tip is at first, clear of the object.
    noise_n : float, default=0.01
        Standard deviation of one reading of the force sensor. Guess.
    offset_n : float, default=0.05
        What it reads in the air. Guess.
    speed_mm_s : float, default=100.0
        Speed of all moves, on the simulated clock alone.
    random_state : int, default=0
        Seed of the noise.
    faults : mapping of int to str, default={}
        Number of an attempt, which begins with the first move after a retract and
        is counted from 0, to what fails in it, one of `FAULTS`:

        - "stuck force": the force sensor repeats its last reading;
        - "stuck force in contact": the same, from the first contact on;
        - "no force": it reads NaN in contact;
        - "overshoot": one step in contact goes 14 mm too far;
        - "driver error": a move in contact raises after it was made;
        - "slow": a move in contact takes hours;
        - "retract error": the first retract raises before it moves;
        - "arm stuck": every retract raises, and the arm stays where it is;
        - "no frame": the frame does not arrive, where the sensor is asked through
          `missing_frames` as that of `put_down` is;
        - "out of reach": the object is out of reach, so that nothing is met.

    Attributes
    ----------
    n_retracts : int
        Retracts that were made.
    stopped : bool
        Whether `stop` was called; the arm then refuses to move.
    """

    def __init__(
        self,
        bench: SimulatedBench,
        home: SensorPose,
        *,
        noise_n: float = 0.01,
        offset_n: float = 0.05,
        speed_mm_s: float = 100.0,
        random_state: int = 0,
        faults: Mapping[int, str] = MappingProxyType({}),
    ) -> None:
        self._bench = bench
        self._noise_n = check_number("noise_n", noise_n, low=0.0)
        self._offset_n = check_number("offset_n", offset_n)
        self._speed = check_positive("speed_mm_s", speed_mm_s)
        self._rng = np.random.default_rng(random_state)
        for number, fault in faults.items():
            check_count("faults", number, at_least=0)
            check_option("faults", fault, FAULTS)
        self._faults = dict(faults)
        self._reading_n = self._offset_n
        self._seconds = 0.0
        self.n_retracts = self._attempt = 0
        self.stopped = False
        self._pose = home
        bench.move_to(home)

    def move_to(self, pose: SensorPose) -> None:
        """Move the tip to a pose in a straight line."""
        self._attempt = self.n_retracts
        self._move(pose)
        if self._bench.force_n == 0:
            return
        if self._fails_once("overshoot"):
            self._move(pose.advanced(_OVERSHOOT_MM))
        if self._fails_once("slow"):
            self._seconds += _SLOW_S
        if self._fails_once("driver error"):
            raise RobotError("The driver lost the arm.")

    def read_pose(self) -> SensorPose:
        """Return where the tip is."""
        return self._pose

    def read_force(self) -> float:
        """Return the force with offset and noise (N)."""
        self._seconds += 1e-3
        fault = self._faults.get(self._attempt)
        touching = self._bench.force_n > 0
        if fault == "stuck force" or (touching and fault == "stuck force in contact"):
            return self._reading_n
        if touching and fault == "no force":
            return float("nan")
        noise = self._noise_n * self._rng.standard_normal()
        self._reading_n = float(self._bench.force_n + self._offset_n + noise)
        return self._reading_n

    def retract(self, way_mm: float) -> None:
        """Pull the tip straight back."""
        check_number("way_mm", way_mm, low=0.0)
        if self._fails("arm stuck"):
            raise RobotError("The brakes do not open.")
        if self._fails_once("retract error"):
            raise RobotError("The command to retract was lost.")
        self._move(self.read_pose().advanced(-way_mm))
        self.n_retracts += 1

    def stop(self) -> None:
        """Halt for good."""
        self.stopped = True

    @property
    def missing_frames(self) -> Container[int]:
        """Numbers of frames that `SimulatedSensor(missing=)` is to lose."""
        return _MissingFrames(lambda: self._fails("no frame"))

    def clock(self) -> float:
        """Return the simulated time (s)."""
        return self._seconds

    def _move(self, pose: SensorPose) -> None:
        if self.stopped:
            raise RobotError("The arm was stopped.")
        way_mm = distance_mm(pose.position_mm, self._pose.position_mm)
        self._seconds += way_mm / self._speed
        self._pose = pose
        if self._fails("out of reach"):
            x, y, z = np.asarray(pose.position_mm)
            pose = SensorPose((x, y, z + _AWAY_MM), pose.direction, pose.roll_rad)
        self._bench.move_to(pose)

    def _fails(self, fault: str) -> bool:
        return self._faults.get(self._attempt) == fault

    def _fails_once(self, fault: str) -> bool:
        fails = self._fails(fault)
        if fails:
            del self._faults[self._attempt]
        return fails


class _MissingFrames(Container[int]):
    """All frames as long as the fault of the attempt is "no frame", else none."""

    def __init__(self, fails: Callable[[], bool]) -> None:
        self._fails = fails

    def __contains__(self, number: object) -> bool:
        return self._fails()


def check_robot(
    robot: Robot,
    *,
    way_mm: float = 5.0,
    max_miss_mm: float = 0.5,
    max_offset_n: float = 1.0,
    stop: bool = True,
) -> None:
    """Drive an arm through the contract of `Robot` and say what it breaks.

    It must stand clear, with `way_mm` of free space behind it, against the way it
    looks: it is pulled back by that much, moved half of it forward again, and brought
    back to where it was. It is never moved further in than it stood. One that breaks
    the contract is not moved any more.

    Parameters
    ----------
    robot : Robot
        The arm, ready to move.
    way_mm : float, default=5.0
        How far it is pulled back.
    max_miss_mm : float, default=0.5
        How far from where it was sent it may say that it is.
    max_offset_n : float, default=1.0
        Largest reading of a force sensor that touches nothing.
    stop : bool, default=True
        Whether to call `stop` at the end and see that it moves no more. Some arms must
        be freed by hand then.

    Raises
    ------
    AssertionError
        The contract is broken; the message says which part.

    Examples
    --------
    >>> from palpate.exploration import check_robot, put_down
    >>> from palpate.simulation import find_object
    >>> check_robot(put_down(find_object("ball")).robot)
    """
    check_positive("way_mm", way_mm)
    check_positive("max_miss_mm", max_miss_mm)
    check_positive("max_offset_n", max_offset_n)
    _say(isinstance(robot, Robot), "it must have all methods of palpate's Robot")
    start = _pose(robot)
    _check_force(robot, max_offset_n)
    back = start.advanced(-way_mm)
    # Where it is not where it was sent, the next place may be anywhere: it stays.
    robot.retract(way_mm)
    _check_place(robot, back, max_miss_mm, f"retract({way_mm:g})")
    half = start.advanced(-way_mm / 2)
    robot.move_to(half)
    _check_place(robot, half, max_miss_mm, "move_to")
    robot.retract(0.0)
    _check_place(robot, half, max_miss_mm, "retract(0)")
    _check_force(robot, max_offset_n)
    robot.move_to(start)
    _check_place(robot, start, max_miss_mm, "move_to, back to where it stood,")
    if not stop:
        return
    robot.stop()
    _check_place(robot, start, max_miss_mm, "stop()")
    with suppress(Exception):  # to refuse is right
        robot.move_to(back)
    _check_place(robot, start, max_miss_mm, "stop() and move_to, which must not move,")


def _pose(robot: Robot) -> SensorPose:
    pose: object = robot.read_pose()
    _say(isinstance(pose, SensorPose), "read_pose() must return a SensorPose")
    assert isinstance(pose, SensorPose)
    numbers = [*np.asarray(pose.position_mm), *np.asarray(pose.direction)]
    _say(bool(np.isfinite(numbers).all()), "read_pose() must hold finite numbers")
    return pose


def _check_place(
    robot: Robot, wanted: SensorPose, max_miss_mm: float, after: str
) -> None:
    pose = _pose(robot)
    missed_mm = distance_mm(pose.position_mm, wanted.position_mm)
    _say(
        missed_mm <= max_miss_mm,
        f"after {after} read_pose() must be where it was sent, within {max_miss_mm:g} "
        f"mm, got {missed_mm:.2f} mm from there",
    )
    cosine = float(np.asarray(pose.direction) @ np.asarray(wanted.direction))
    _say(cosine > LEAST_COSINE, f"after {after} it must look the same way")


def _check_force(robot: Robot, max_offset_n: float) -> None:
    forces = [robot.read_force() for _ in range(_N_READINGS)]
    numbers = all(isinstance(force, Real) for force in forces)
    _say(numbers, "read_force() must return a number")
    _say(all(map(math.isfinite, forces)), "read_force() must be finite in the air")
    greatest = max(map(abs, forces))
    _say(
        greatest <= max_offset_n,
        f"read_force() must be within {max_offset_n:g} N of 0 in the air, got "
        f"{greatest:.3f}: clear it, or set it to zero",
    )
    _say(
        len({*forces}) >= _FEWEST_LEVELS,
        f"read_force() must be a fresh reading, got {forces[0]:.4f} "
        f"{_N_READINGS} times: it is stuck, or too coarse (Guard.stuck_after=None)",
    )


def _say(kept: bool, rule: str) -> None:
    if not kept:
        raise AssertionError(f"This arm does not keep the contract: {rule}.")
