"""A simulated object put down once, with an arm and a dome camera before it."""

from collections.abc import Container, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from .._checks import check_count, check_number
from ..sensors import SimulatedBench, SimulatedSensor
from ..simulation import DomeCamera, PlacedObject, SensorPose, SimObject
from ._guarded import Guard, guarded_touch
from ._hemisphere import Hemisphere
from ._record import TouchRecord
from ._simulated_robot import MissingFrames, SimulatedRobot

# Twice the default step in the air: half the time to simulate. The rigid edge met
# after such a step answers with 4 N (`housing_n_mm`), so the limit is above that.
QUICK_GUARD = Guard(air_step_mm=2.0, limit_n=5.0)


@dataclass(frozen=True, eq=False)
class Stand:
    """What is needed to touch one simulated object.

    Attributes
    ----------
    thing : SimObject
        What stands there.
    hemisphere : Hemisphere
        About where its middle should be.
    robot, sensor : SimulatedRobot, SimulatedSensor
        The arm, above the object at first, and the dome it carries.
    """

    thing: SimObject
    hemisphere: Hemisphere
    robot: SimulatedRobot
    sensor: SimulatedSensor

    def touch(self, start: SensorPose, guard: Guard | None = None) -> TouchRecord:
        """Go round the object to a pose on the hemisphere and touch from there."""
        for waypoint in self.hemisphere.way(self.robot.read_pose(), start):
            self.robot.move_to(waypoint)
        clock = self.robot.clock
        return guarded_touch(self.robot, self.sensor, start, guard, clock=clock)


def put_down(
    thing: SimObject,
    camera: DomeCamera | None = None,
    *,
    face: int = 0,
    yaw_rad: float = 0.0,
    placement_sd_mm: float = 5.0,
    random_state: int = 0,
    faults: Mapping[int, str] = MappingProxyType({}),
    missing: Container[int] = (),
) -> Stand:
    """Put an object down before a simulated arm, not quite where it should be.

    Parameters
    ----------
    thing : SimObject
        What to put down; one with a surface.
    camera : DomeCamera, optional
        The dome, see `SimulatedBench`.
    face : int, default=0
        Which of its `resting_rotations` it rests in.
    yaw_rad : float, default=0.0
        How it is turned about the vertical.
    placement_sd_mm : float, default=5.0
        How far from the centre of the hemisphere it is put, along x and y each.
    random_state : int, default=0
        Same number, same place and noise.
    faults, missing
        What fails, see `SimulatedRobot` and `SimulatedSensor`.
    """
    n_faces = len(thing.resting_rotations)
    if check_count("face", face, at_least=0) >= n_faces:
        raise ValueError(
            f"face must be below {n_faces}, the poses in which {thing.name!r} rests, "
            f"got {face}."
        )
    check_number("placement_sd_mm", placement_sd_mm, low=0.0)
    rng = np.random.default_rng(random_state)
    placed = PlacedObject.resting(thing, face, yaw_rad)
    x, y, z = placed.centre_mm
    aside = np.array([*rng.normal(0, placement_sd_mm, 2), 0.0])
    place = np.asarray(placed.position_mm) + aside
    moved = PlacedObject(thing, placed.rotation, yaw_rad, place)
    seeds = [int(seed) for seed in rng.integers(2**31, size=3)]
    bench = SimulatedBench(moved, camera, random_state=seeds[0])
    hemisphere = Hemisphere((float(x), float(y), float(z)))
    home = hemisphere.pose(0.0, np.pi / 2)
    robot = SimulatedRobot(bench, home, random_state=seeds[1], faults=faults)
    lost = MissingFrames(robot, missing)
    sensor = SimulatedSensor(bench, random_state=seeds[2], missing=lost)
    return Stand(thing, hemisphere, robot, sensor)
