"""Simulated objects before the simulated arm: put down, touched, and learnt.

To learn, as in Corradi 2015, each object is put down on its usual face, several
times, and touched from random points of the hemisphere each time. How it is turned is
known to the teacher, so the places and directions of touches are in the object's own
frame, as a `TouchMap` wants them.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from .._checks import check_count, check_number, check_option
from .._parallel import in_parallel, on_one_thread
from ..sensors import SimulatedBench, SimulatedSensor
from ..simulation import (
    DomeCamera,
    PlacedObject,
    SensorPose,
    SimObject,
    find_objects,
)
from ..touches import Touches
from ._episode import gather, gather_by
from ._guarded import Guard, Toucher
from ._record import EpisodeLog, TouchRecord, as_touches, make_folder, tip_mm
from ._robot import SimulatedRobot
from ._strategies import Hemisphere, RandomHemisphere
from ._ways import touch_from_hemisphere

# Twice the default step in the air: half the time to simulate. The rigid edge met
# after such a step answers with 4 N (`housing_n_mm`), so the limit is above that.
QUICK_GUARD = Guard(air_step_mm=2.0, limit_n=5.0, lag_readings=0)
# How high above the ground an arm aims that does not know how high the object is.
_AIM_MM = 10.0


@dataclass(frozen=True, eq=False)
class Stand:
    """A simulated object, the hemisphere about its middle, arm, dome and bench.

    `quick_guard` has twice the default step in the air: half the time to simulate.
    """

    thing: SimObject
    hemisphere: Hemisphere
    robot: SimulatedRobot
    sensor: SimulatedSensor
    bench: SimulatedBench
    quick_guard: Guard = QUICK_GUARD

    def touch(self, start: SensorPose, guard: Guard | None = None) -> TouchRecord:
        """Go round the object to a pose on the hemisphere and touch from there.

        An arm that was stopped, since it did not come out, is not moved again.
        """
        if self.robot.stopped:
            message = "The arm was stopped before. Put the object down anew."
            how: dict[str, Any] = {"message": message, "retracted": False}
            return TouchRecord("robot error", start, tip_mm(start), **how)
        arm = self.robot, self.sensor, guard or Guard(), self.robot.clock
        # The simulated force sensor is known not to lag.
        return touch_from_hemisphere(Toucher(*arm, lag=0), self.hemisphere, start)

    def touch_at_once(
        self, start: SensorPose, guard: Guard | None = None
    ) -> TouchRecord:
        """Touch from a pose on the hemisphere as `touch` does, in one step.

        The same contact by less work (a third of that of a quick guard), to train on:
        nothing guards it, and of
        the arm's faults there are none. Its force is exactly that of the guard.
        """
        how = guard or Guard()
        way_mm = self.bench.approach(start, how.force_n, how.max_travel_mm)
        travel_mm = how.max_travel_mm if way_mm is None else way_mm
        position_mm = tip_mm(start.advanced(travel_mm))
        if way_mm is None:
            return TouchRecord("nothing", start, position_mm, travel_mm=travel_mm)
        return TouchRecord(
            "touched",
            start,
            position_mm,
            force_n=how.force_n,
            peak_force_n=how.force_n,
            travel_mm=travel_mm,
            image=self.sensor.read(),
        )


def put_down(
    thing: SimObject,
    camera: DomeCamera | None = None,
    *,
    face: int = 0,
    yaw_rad: float = 0.0,
    placement_sd_mm: float = 5.0,
    known_height: bool = True,
    random_state: int = 0,
    faults: Mapping[int, str] = MappingProxyType({}),
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
    known_height : bool, default=True
        Whether the centre of the hemisphere is at the height of the object's middle, as
        somebody who puts it down, or a camera beside the arm, may tell. Else it is 10
        mm above the ground, low enough for what is flat.
    random_state : int, default=0
        Same number, same place and noise.
    faults : mapping of int to str, default={}
        What fails, see `SimulatedRobot`.

    Raises
    ------
    ValueError
        `face` is none of its faces, or it does not fit into the hemisphere.
    """
    if not isinstance(thing, SimObject):
        raise TypeError(
            f"thing must be a SimObject, got {type(thing).__name__}. Built-in ones are "
            "had by their names with find_object."
        )
    n_faces = len(thing.resting_rotations)
    if check_count("face", face, at_least=0) >= n_faces:
        raise ValueError(
            f"face must be below {n_faces}, the poses in which {thing.name!r} rests, "
            f"got {face}."
        )
    check_number("placement_sd_mm", placement_sd_mm, low=0.0)
    rng = np.random.default_rng(random_state)
    placed = PlacedObject.resting(thing, face, yaw_rad)
    x, y, middle_mm = map(float, placed.centre_mm)
    aside = np.array([*rng.normal(0, placement_sd_mm, 2), 0.0])
    place = np.asarray(placed.position_mm) + aside
    moved = PlacedObject(thing, placed.rotation, yaw_rad, place)
    seeds = [int(seed) for seed in rng.integers(2**31, size=3)]
    bench = SimulatedBench(moved, camera, random_state=seeds[0])
    height_mm = middle_mm if known_height else _AIM_MM
    hemisphere = Hemisphere((x, y, height_mm))
    from_centre = np.abs(placed.bounds_mm - np.asarray(hemisphere.centre_mm))
    reach = float(np.linalg.norm(from_centre.max(axis=0)))  # of a corner of its box
    shift = float(np.linalg.norm(aside))
    if reach + shift >= hemisphere.radius_mm:  # the arm would begin inside it
        raise ValueError(
            f"thing must fit into a hemisphere of {hemisphere.radius_mm:g} mm, got "
            f"{thing.name!r}, which reaches {reach:.0f} mm from its centre and was put "
            f"{shift:.0f} mm aside. Is its unit right, or placement_sd_mm too large?"
        )
    home = hemisphere.pose(0.0, np.pi / 2)
    robot = SimulatedRobot(bench, home, random_state=seeds[1], faults=faults)
    sensor = SimulatedSensor(bench, random_state=seeds[2], missing=robot.missing_frames)
    return Stand(thing, hemisphere, robot, sensor, bench)


def explore_to_learn(
    things: Iterable[SimObject | str] | SimObject | str | None = None,
    n_touches: int = 60,
    camera: DomeCamera | None = None,
    *,
    n_sessions: int = 3,
    turned: bool = False,
    faces: str = "usual",
    drift: bool = False,
    placement_sd_mm: float = 5.0,
    known_height: bool = True,
    guarded: bool = True,
    folder: str | Path | None = None,
    random_state: int = 0,
    n_jobs: int | None = None,
    progress: bool | None = False,
) -> Touches:
    """Touch simulated objects with the simulated arm, to learn them.

    Parameters
    ----------
    things : SimObject, str, or an iterable of them, optional
        What to touch, as in `simulate_touches`; by default the ten household objects.
    n_touches : int, default=60
        Touches of each object; approaches that find nothing are not counted.
    camera : DomeCamera, optional
        The dome, see `SimulatedBench`.
    n_sessions : int, default=3
        How often each object is put down anew.
    turned : bool, default=False
        Whether it is turned anew about the vertical each time.
    faces : {"usual", "all"}, default="usual"
        "all" puts it down on each of its `resting_rotations` in turn, session after
        session, and numbers them in the column `face`; at least as many sessions as
        faces are needed for all to be met.
    drift : bool, default=False
        Whether exposure and place of the picture change between sessions, see
        `DomeCamera.drifted`.
    placement_sd_mm, known_height : float and bool, default=5.0 and True
        See `put_down`; both are to be as where the objects will be met.
    guarded : bool, default=True
        Whether the arm feels its way, step by step. Else each touch is made in one
        step (`Stand.touch_at_once`): the same contacts by less work.
    folder : path, optional
        Where to keep the attempts, an episode for each time an object is put down:
        what was begun there goes on. Of one that holds more touches, the first are
        taken.
    random_state : int, default=0
        Same number, same touches, whatever `n_jobs`.
    n_jobs, progress : int and bool, optional
        Processes, and whether to show a bar; see `simulate_touches`.

    Returns
    -------
    Touches
        Object after object, with the columns of `as_touches`, `category` and
        `session`, and the frame of no contact.

    Raises
    ------
    RobotError
        Touches of an object do not come.
    EpisodeError
        `folder` is none, or holds other episodes than these.
    ValueError
        `folder` is to keep touches that are not `guarded`.
    """
    if folder is not None and not guarded:
        raise ValueError(
            "folder must be None where guarded is False, got "
            f"{str(folder)!r}. Only guarded attempts are kept."
        )
    objects = find_objects(things)
    check_count("random_state", random_state, at_least=0)
    count = check_count("n_touches", n_touches)
    sessions = min(check_count("n_sessions", n_sessions), count)
    shares = [len(part) for part in np.array_split(range(count), sessions)]
    seen_by = DomeCamera(image_shape=(120, 120)) if camera is None else camera
    home = None if folder is None else Path(folder)
    check_option("faces", faces, ("usual", "all"))
    if home is not None:
        outside = [o.name for o in objects if {"..", os.sep} & {*Path(o.name).parts}]
        if outside:
            raise ValueError(
                f"things must have names of folders within `folder`, got {outside[0]!r}"
                ". Give a mesh another name: load_mesh(path, name=...)."
            )
        make_folder(home)
    turns = turned, faces == "all"
    where = {"placement_sd_mm": placement_sd_mm, "known_height": known_height}
    how = (seen_by, turns, drift, where, guarded, home, random_state)
    parts = in_parallel(
        partial(_session, *how),
        [(*thing, *part) for thing in enumerate(objects) for part in enumerate(shares)],
        "Exploring",
        n_jobs=n_jobs,
        show=progress,
        sizes=shares * len(objects),
    )
    return Touches.concatenate(parts).with_columns(no_contact=seen_by.no_contact())


@dataclass(frozen=True)
class _PutDown(RandomHemisphere):
    """Poses round an object put down so: an episode goes on only if it is again."""

    yaw_rad: float = 0.0
    face: int = 0
    placement_sd_mm: float = 5.0
    drift: bool = False
    camera: DomeCamera | None = None
    surface: str = ""


@on_one_thread()  # so that sums round alike everywhere
def _session(
    camera: DomeCamera,
    turns: tuple[bool, bool],
    drift: bool,
    where: Mapping[str, Any],
    guarded: bool,
    home: Path | None,
    random_state: int,
    number: int,
    thing: SimObject,
    session: int,
    n_touches: int,
) -> Touches:
    seeds = np.random.SeedSequence((random_state, number, session))
    seed = int(seeds.generate_state(1)[0])
    rng = np.random.default_rng([seed, 1])
    turned, every_face = turns
    yaw = float(rng.uniform(0, 2 * np.pi)) if turned else 0.0
    face = session % len(thing.resting_rotations) if every_face else 0
    stand = put_down(
        thing,
        camera.drifted(rng) if drift else camera,
        face=face,
        yaw_rad=yaw,
        random_state=seed,
        **where,
    )
    placement_sd_mm = float(where["placement_sd_mm"])
    stood = yaw, face, placement_sd_mm, drift, camera, thing.surface
    strategy = _PutDown(stand.hemisphere, seed, *stood)
    if guarded:
        history = gather(
            stand.robot,
            stand.sensor,
            strategy,
            None if home is None else home / thing.name / str(session),
            n_touches=n_touches,
            guard=QUICK_GUARD,
            clock=stand.robot.clock,
        )
    else:
        touch = partial(stand.touch_at_once, guard=QUICK_GUARD)
        history = gather_by(touch, strategy, EpisodeLog(None), n_touches)
    named = {"object": thing.name, "category": thing.category}
    touches = as_touches(history, **named, geometry="dome")
    # In the object's own frame: turned back about the vertical.
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    vectors = ("position_mm", "direction")
    columns = {name: touches.columns[name] @ turn for name in vectors}
    columns["session"] = np.full(len(touches), session)
    if every_face:
        columns["face"] = np.full(len(touches), face)
    return touches.with_columns(**columns)
