"""Does a driver keep the contract of `Robot`? Asked of the arm itself, in the air."""

import math

import numpy as np

from .._checks import check_positive
from ..simulation import SensorPose
from ._robot import Robot

_N_READINGS = 24
_FEWEST_LEVELS = 2


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
    back to where it was. It is never moved further in than it stood.

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
    _say(isinstance(robot, Robot), "it must have all methods of palpate's Robot")
    start = _pose(robot)
    _check_force(robot, max_offset_n)
    robot.retract(way_mm)
    try:
        back = start.advanced(-way_mm)
        _check_place(robot, back, max_miss_mm, f"retract({way_mm:g})")
        half = start.advanced(-way_mm / 2)
        robot.move_to(half)
        _check_place(robot, half, max_miss_mm, "move_to")
        robot.retract(0.0)
        _check_place(robot, half, max_miss_mm, "retract(0)")
        _check_force(robot, max_offset_n)
    finally:
        robot.move_to(start)
    _check_place(robot, start, max_miss_mm, "move_to, back to where it stood,")
    if stop:
        _check_stop(robot, start, way_mm, max_miss_mm)


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
    missed = np.asarray(pose.position_mm) - np.asarray(wanted.position_mm)
    missed_mm = float(np.linalg.norm(missed))
    _say(
        missed_mm <= max_miss_mm,
        f"after {after} read_pose() must be where it was sent, within {max_miss_mm:g} "
        f"mm, got {missed_mm:.2f} mm from there",
    )
    cosine = float(np.asarray(pose.direction) @ np.asarray(wanted.direction))
    _say(cosine > math.cos(0.05), f"after {after} it must look the same way")


def _check_force(robot: Robot, max_offset_n: float) -> None:
    forces = [robot.read_force() for _ in range(_N_READINGS)]
    numbers = all(isinstance(force, float | int) for force in forces)
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


def _check_stop(
    robot: Robot, start: SensorPose, way_mm: float, max_miss_mm: float
) -> None:
    robot.stop()
    _check_place(robot, start, max_miss_mm, "stop()")
    try:
        robot.move_to(start.advanced(-way_mm))
    except Exception:
        return
    _check_place(robot, start, max_miss_mm, "stop() and move_to, which must not move,")


def _say(kept: bool, rule: str) -> None:
    if not kept:
        raise AssertionError(f"This arm does not keep the contract: {rule}.")
