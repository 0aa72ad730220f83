"""Sets of simulated touches: objects, a dome, and the ways to come at them."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence
from numpy.typing import NDArray

from .._checks import check_count, check_number, check_option, check_positive
from .._progress import Progress
from ..touches import Touches
from ._dome import DomeCamera, DomePress, Frame
from ._objects import HOUSEHOLD, SimObject, find_object, refuse_same_names
from ._pins import TacTipPins
from ._placed import PlacedObject, SensorPose

STRATEGIES = ("hemisphere", "above")
_TOUCHES_PER_TASK = 25
_ATTEMPTS = 50


def simulate_touches(
    objects: Iterable[SimObject | str] | SimObject | str = HOUSEHOLD,
    n_touches: int = 60,
    camera: DomeCamera | TacTipPins | None = None,
    strategy: str = "hemisphere",
    *,
    n_sessions: int = 1,
    pose: str = "usual",
    hemisphere_mm: float = 300.0,
    max_tilt_deg: float | None = None,
    aim_sd_mm: float = 5.0,
    max_roll_deg: float = 180.0,
    force_sd: float = 0.05,
    drift: bool = True,
    keep_misses: bool = False,
    random_state: int | None = None,
    n_jobs: int | None = None,
    progress: bool | None = False,
) -> Touches:
    """Touch objects with a dome camera, each time from elsewhere.

    Parameters
    ----------
    objects : SimObject, str, or an iterable of them, default=HOUSEHOLD
        What to touch; a text names a built-in object.
    n_touches : int, default=60
        Touches of each object.
    camera : DomeCamera or TacTipPins, optional
        The sensor, by default `DomeCamera(image_shape=(120, 120))`.
    strategy : {"hemisphere", "above"}, default="hemisphere"
        "hemisphere": from points evenly spread on a hemisphere about the middle of
        the object, facing it. "above": from above the object's own origin, as built,
        for `BASIC_SHAPES`.
    n_sessions : int, default=1
        Recordings that an object's touches are split into. In each the object is
        turned anew about the vertical and the camera drifts.
    pose : {"usual", "any"}, default="usual"
        Whether an object always rests as built, or in any of its resting poses,
        drawn per session; for the hemisphere only.
    hemisphere_mm : float, default=300.0
        Radius of the hemisphere, more where the object is larger.
    max_tilt_deg : float, optional
        Largest angle between approach and vertical; by default 80 from the
        hemisphere, 10 from above.
    aim_sd_mm : float, default=5.0
        Standard deviation along x, y and z of the point that is faced.
    max_roll_deg : float, default=180.0
        The sensor is turned about its axis by up to so much, either way.
    force_sd : float, default=0.05
        Standard deviation of the logarithm of the force at which presses end.
    drift : bool, default=True
        Whether exposure and place of the picture change between sessions.
    keep_misses : bool, default=False
        Whether approaches that meet nothing count as touches (without contact); by
        default another is drawn.
    random_state : int, optional
        Same number, same touches, whatever `n_jobs`.
    n_jobs : int, optional
        Processes, as in joblib.
    progress : bool, optional
        Show a bar on standard error; None where that is a terminal.

    Returns
    -------
    touches : Touches
        uint8 images, object after object, geometry "dome", with `no_contact`.
        Columns: `object`, `category`, `session`, `order` (within the object),
        `position_mm` (the tip at the end), `direction` (unit vector of approach),
        `roll_rad`, `force_n`, `depth_mm`, `area_mm2`, `contact` (whether the dome
        itself was pressed: a sleeve that is met first leaves it as it was).

    Raises
    ------
    ValueError
        Two objects have one name, or one that should be touched cannot be met after
        50 approaches.

    Notes
    -----
    There is no table: approaches below the horizon are left out by `max_tilt_deg`,
    but a low one may pass where the ground would be. `no_contact` is the picture
    of the sensor before any drift, without noise.

    References
    ----------
    .. [1] T. Corradi, P. Hall, P. Iravani, "Bayesian tactile object recognition",
       ICRA 2015. doi:10.1109/ICRA.2015.7139744

    Examples
    --------
    >>> from palpate.simulation import simulate_touches
    >>> simulate_touches(["mug", "pen"], 2, random_state=0).images.shape
    (4, 120, 120)
    """
    from joblib import Parallel, delayed

    things = _found(objects)
    sensor = DomeCamera(image_shape=(120, 120)) if camera is None else camera
    way = _Way(
        strategy=check_option("strategy", strategy, STRATEGIES),
        hemisphere_mm=check_positive("hemisphere_mm", hemisphere_mm),
        max_tilt_deg=_tilt(max_tilt_deg, strategy),
        aim_sd_mm=check_number("aim_sd_mm", aim_sd_mm, low=0.0),
        max_roll_deg=check_number("max_roll_deg", max_roll_deg, low=0.0, high=180.0),
        force_sd=check_number("force_sd", force_sd, low=0.0, high=2.0),
        any_pose=check_option("pose", pose, ("usual", "any")) == "any",
        drift=bool(drift),
        keep_misses=bool(keep_misses),
    )
    count = check_count("n_touches", n_touches)
    sessions = min(check_count("n_sessions", n_sessions), count)
    tasks = list(_tasks(things, count, sessions, _root(random_state)))
    run = Parallel(n_jobs=n_jobs, return_as="generator")
    batches = run(delayed(_touch_some)(sensor, way, *task[:3]) for task in tasks)
    done: list[_Touch] = []
    with Progress(len(things) * count, "Touching", progress) as bar:
        for batch in batches:
            done += batch
            bar.advance(len(batch))
    return _as_touches(things, count, tasks, done, sensor)


@dataclass(frozen=True)
class _Way:
    """How objects are come at."""

    strategy: str
    hemisphere_mm: float
    max_tilt_deg: float
    aim_sd_mm: float
    max_roll_deg: float
    force_sd: float
    any_pose: bool
    drift: bool
    keep_misses: bool

    def placed(self, thing: SimObject, rng: Generator) -> PlacedObject:
        """Put an object down for one session."""
        yaw = float(rng.uniform(0, 2 * np.pi))
        number = int(rng.integers(len(thing.resting_rotations)))
        if self.strategy == "above":
            return PlacedObject(thing, yaw_rad=yaw)
        return PlacedObject.resting(thing, number if self.any_pose else 0, yaw)

    def start(self, placed: PlacedObject, rng: Generator) -> SensorPose:
        """Draw where a touch comes from."""
        around = rng.uniform(0, 2 * np.pi)
        least = np.cos(np.deg2rad(self.max_tilt_deg))
        up = rng.uniform(least, 1.0)
        flat = np.sqrt(1 - up**2)
        outward = np.array([flat * np.cos(around), flat * np.sin(around), up])
        above = self.strategy == "above"
        goal = np.asarray(placed.position_mm) if above else placed.centre_mm
        goal = goal + rng.normal(0, 1, 3) * self.aim_sd_mm
        roll = np.deg2rad(rng.uniform(-self.max_roll_deg, self.max_roll_deg))
        corners = placed.vertices_mm - goal
        reach = np.sqrt((corners**2).sum(axis=1).max(initial=0.0)) + 50.0
        away = max(self.hemisphere_mm, float(reach))
        return SensorPose(goal + away * outward, -outward, float(roll))


@dataclass(frozen=True, eq=False)
class _Touch:
    image: Frame
    press: DomePress
    end: SensorPose


def _touch_some(
    sensor: DomeCamera | TacTipPins,
    way: _Way,
    thing: SimObject,
    session: SeedSequence,
    seeds: list[SeedSequence],
) -> list[_Touch]:
    """Make some touches of one session."""
    rng = np.random.default_rng(session)
    placed = way.placed(thing, rng)
    now = sensor.drifted(rng) if way.drift else sensor
    return [_one(now, way, placed, np.random.default_rng(seed)) for seed in seeds]


def _one(
    sensor: DomeCamera | TacTipPins, way: _Way, placed: PlacedObject, rng: Generator
) -> _Touch:
    dome = sensor.dome if isinstance(sensor, TacTipPins) else sensor
    force = dome.force_n * float(np.exp(rng.normal(0, way.force_sd)))
    solid = len(placed.thing.mesh.faces) > 0
    for _ in range(_ATTEMPTS):
        pose = way.start(placed, rng)
        press = sensor.press(placed, pose, force_n=force)
        if press.touched or way.keep_misses or not solid:
            end = pose.advanced(press.travel_mm)
            return _Touch(sensor.image(press, rng), press, end)
    raise ValueError(
        f"objects must be where the sensor goes, but {placed.thing.name!r} was missed "
        f"{_ATTEMPTS} times. Lower aim_sd_mm or pass keep_misses=True."
    )


Task = tuple[SimObject, SeedSequence, list[SeedSequence], int]


def _tasks(
    things: list[SimObject], n_touches: int, n_sessions: int, root: SeedSequence
) -> Iterable[Task]:
    """Split the work; seeds hang on the object's place and the touch's, not on this."""
    for thing, seed in zip(things, root.spawn(len(things)), strict=True):
        of_sessions, of_touches = seed.spawn(2)
        sessions = of_sessions.spawn(n_sessions)
        touches = of_touches.spawn(n_touches)
        for number, numbers in enumerate(np.array_split(range(n_touches), n_sessions)):
            for start in range(0, len(numbers), _TOUCHES_PER_TASK):
                some = numbers[start : start + _TOUCHES_PER_TASK]
                seeds = [touches[touch] for touch in some]
                yield thing, sessions[number], seeds, number


def _as_touches(
    things: list[SimObject],
    n_touches: int,
    tasks: list[Task],
    done: list[_Touch],
    sensor: DomeCamera | TacTipPins,
) -> Touches:
    repeated = [thing for thing in things for _ in range(n_touches)]
    presses = [touch.press for touch in done]
    return Touches(
        np.stack([touch.image for touch in done]),
        object=np.array([thing.name for thing in repeated]),
        category=np.array([thing.category for thing in repeated]),
        no_contact=sensor.no_contact(),
        geometry="dome",
        session=np.concatenate([np.full(len(task[2]), task[3]) for task in tasks]),
        order=np.tile(np.arange(n_touches), len(things)),
        position_mm=_stacked([touch.end.position_mm for touch in done]),
        direction=_stacked([touch.end.direction for touch in done]),
        roll_rad=np.array([touch.end.roll_rad for touch in done]),
        force_n=np.array([press.force_n for press in presses]),
        depth_mm=np.array([press.depth_mm for press in presses]),
        area_mm2=np.array([press.area_mm2 for press in presses]),
        contact=np.array([press.area_mm2 > 0 for press in presses]),
    )


def _stacked(vectors: list[Any]) -> NDArray[np.float64]:
    return np.stack([np.asarray(vector, dtype=np.float64) for vector in vectors])


def _found(objects: Iterable[SimObject | str] | SimObject | str) -> list[SimObject]:
    given = [objects] if isinstance(objects, SimObject | str) else list(objects)
    if not given:
        raise ValueError("objects must name at least one object, got none.")
    things = []
    for one in given:
        if not isinstance(one, SimObject | str):
            raise TypeError(
                f"objects must be SimObject or names, got {type(one).__name__}. "
                "Read a mesh file with load_mesh(path)."
            )
        things.append(find_object(one) if isinstance(one, str) else one)
    refuse_same_names(things)
    return things


def _tilt(max_tilt_deg: float | None, strategy: str) -> float:
    if max_tilt_deg is None:
        return 10.0 if strategy == "above" else 80.0
    return check_number("max_tilt_deg", max_tilt_deg, low=0.0, high=90.0)


def _root(random_state: int | None) -> SeedSequence:
    if random_state is None:
        return SeedSequence()
    return SeedSequence(check_count("random_state", random_state, at_least=0))
