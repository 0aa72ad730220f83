"""Sets of simulated touches: objects under a dome, flat parts on a pressure array.

How presses on an array differ is fixed by what a plain press rig and machined parts
are like, and stated with `simulate_presses`; nothing here knows what recognises them.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence

from .._checks import check_count, check_number, check_option, check_positive
from .._parallel import in_parallel, on_one_thread
from .._types import Indices
from ..touches import Touches
from ._array import Press, PressureArray
from ._dome import DomeCamera, DomePress, Frame
from ._gel_and_pins import GelCamera, TacTipPins
from ._objects import find_objects
from ._parts import Part, find_parts
from ._solids import PlacedObject, SensorPose, SimObject

_PER_TASK = 25, 50  # touches, presses
_ATTEMPTS = 50


@dataclass(frozen=True)
class Scene:
    """How simulated objects lie, and from where and how hard they are touched.

    Parameters
    ----------
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
    keep_misses : bool, default=False
        Whether approaches that meet nothing count as touches (without contact); by
        default another is drawn.

    Raises
    ------
    TypeError, ValueError
        A number out of its range.

    Examples
    --------
    >>> from palpate.simulation import Scene, simulate_touches
    >>> steady = Scene(aim_sd_mm=0, max_roll_deg=0)
    >>> len(simulate_touches("ball", 2, scene=steady, random_state=0))
    2
    """

    pose: str = "usual"
    hemisphere_mm: float = 300.0
    max_tilt_deg: float | None = None
    aim_sd_mm: float = 5.0
    max_roll_deg: float = 180.0
    force_sd: float = 0.05
    keep_misses: bool = False

    def __post_init__(self) -> None:
        check_option("pose", self.pose, ("usual", "any"))
        check_positive("hemisphere_mm", self.hemisphere_mm)
        if self.max_tilt_deg is not None:
            check_number("max_tilt_deg", self.max_tilt_deg, low=0.0, high=90.0)
        check_number("aim_sd_mm", self.aim_sd_mm, low=0.0)
        check_number("max_roll_deg", self.max_roll_deg, low=0.0, high=180.0)
        check_number("force_sd", self.force_sd, low=0.0, high=2.0)

    def placed(self, thing: SimObject, rng: Generator, *, above: bool) -> PlacedObject:
        """Put an object down for one session; `above` as it is built."""
        yaw = float(rng.uniform(0, 2 * np.pi))
        number = int(rng.integers(len(thing.resting_rotations)))
        if above:
            return PlacedObject(thing, yaw_rad=yaw)
        return PlacedObject.resting(thing, number if self.pose == "any" else 0, yaw)

    def start(self, placed: PlacedObject, rng: Generator, *, above: bool) -> SensorPose:
        """Draw where a touch comes from, facing the middle or, `above`, the origin."""
        usual_deg = 10.0 if above else 80.0
        tilt_deg = usual_deg if self.max_tilt_deg is None else self.max_tilt_deg
        around = rng.uniform(0, 2 * np.pi)
        up = rng.uniform(np.cos(np.deg2rad(tilt_deg)), 1.0)
        flat = np.sqrt(1 - up**2)
        outward = np.array([flat * np.cos(around), flat * np.sin(around), up])
        goal = np.asarray(placed.position_mm) if above else placed.centre_mm
        goal = goal + rng.normal(0, 1, 3) * self.aim_sd_mm
        roll = np.deg2rad(rng.uniform(-self.max_roll_deg, self.max_roll_deg))
        corners = placed.vertices_mm - goal
        reach = np.sqrt((corners**2).sum(axis=1).max(initial=0.0)) + 50.0
        away = max(self.hemisphere_mm, float(reach))
        return SensorPose(goal + away * outward, -outward, float(roll))


def simulate_touches(
    objects: Iterable[SimObject | str] | SimObject | str | None = None,
    n_touches: int = 60,
    camera: DomeCamera | TacTipPins | GelCamera | None = None,
    strategy: str = "hemisphere",
    *,
    n_sessions: int = 1,
    drift: bool = True,
    mountings: bool = False,
    scene: Scene | None = None,
    random_state: int | None = None,
    n_jobs: int | None = None,
    progress: bool | None = False,
    **of_scene: Any,
) -> Touches:
    """Touch objects with a dome camera, each time from elsewhere.

    Parameters
    ----------
    objects : SimObject, str, or an iterable of them, optional
        What to touch; a text names a built-in object, or a set of them: "household"
        (the default), "unseen", "unlike others" or "shapes".
    n_touches : int, default=60
        Touches of each object.
    camera : DomeCamera, TacTipPins or GelCamera, optional
        The sensor, by default `DomeCamera(image_shape=(120, 120))`.
    strategy : {"hemisphere", "above"}, default="hemisphere"
        "hemisphere": from points evenly spread on a hemisphere about the middle of
        the object, facing it. "above": from above the object's own origin, as built,
        for the basic shapes.
    n_sessions : int, default=1
        Recordings that an object's touches are split into. In each the object is
        turned anew about the vertical and the camera drifts.
    drift : bool, default=True
        Whether exposure and place of the picture change between sessions.
    mountings : bool, default=False
        Whether every session is another mounting of the sensor, the same for all
        objects (see `DomeCamera.remounted`), instead of a drift that each object's
        recording has of its own.
    scene : Scene, optional
        How objects lie and how they are approached; by default `Scene()`.
    random_state : int, optional
        Same number, same touches, whatever `n_jobs`.
    n_jobs : int, optional
        Processes, as in joblib.
    progress : bool, optional
        Show a bar on standard error; None where that is a terminal.
    **of_scene
        Fields of `Scene` by their names, such as ``aim_sd_mm=2``, in place of those
        of `scene`.

    Returns
    -------
    touches : Touches
        uint8 images, object after object, with `no_contact`; geometry "dome", or
        "plane" and channels of a gel.
        Columns: `object`, `category`, `session`, `order` (within the object),
        `position_mm` (the tip at the end), `direction` (unit vector of approach),
        `roll_rad`, `force_n`, `depth_mm`, `area_mm2`, `contact` (whether the dome
        itself was pressed: a sleeve that is met first leaves it as it was).

    Raises
    ------
    TypeError
        `camera` is no sensor, or a name in `of_scene` no field of `Scene`.
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
    things = find_objects(objects)
    sensor: Any = DomeCamera(image_shape=(120, 120)) if camera is None else camera
    if not isinstance(sensor, DomeCamera | TacTipPins | GelCamera):
        what = "a DomeCamera, TacTipPins or GelCamera"
        raise TypeError(f"camera must be {what}, got {type(camera).__name__}.")
    check_option("strategy", strategy, ("hemisphere", "above"))
    touch = partial(
        _touch_object,
        scene=_with_fields(Scene() if scene is None else scene, of_scene),
        above=strategy == "above",
        drift=drift and not mountings,
    )
    count = check_count("n_touches", n_touches)
    n_parts = min(check_count("n_sessions", n_sessions), count)
    parts = np.array_split(np.arange(count), n_parts)
    root = _root(random_state)
    seeds = zip(things, root.spawn(len(things)), strict=True)
    sensors = [sensor] * n_parts
    if mountings:
        rngs = map(np.random.default_rng, root.spawn(n_parts))
        sensors = [sensor.remounted(rng) for rng in rngs]
    tasks = [
        (sensors[number], *task)
        for seeded in seeds
        for number, *task in _sessions_of(*seeded, parts)
    ]
    done = _all_of(touch, tasks, "Touching", n_jobs, progress)
    images, presses, ends = zip(*done, strict=True)
    session = np.repeat(np.arange(n_parts), [len(part) for part in parts])
    repeated = [thing for thing in things for _ in range(count)]
    return Touches(
        np.stack(images),
        object=np.array([thing.name for thing in repeated]),
        category=np.array([thing.category for thing in repeated]),
        no_contact=sensor.no_contact(),
        geometry=getattr(sensor, "geometry", "dome"),
        channels=getattr(sensor, "channels", None),
        session=np.tile(session, len(things)),
        order=np.tile(np.arange(count), len(things)),
        position_mm=np.stack([np.asarray(end.position_mm) for end in ends]),
        direction=np.stack([np.asarray(end.direction) for end in ends]),
        roll_rad=np.array([end.roll_rad for end in ends]),
        force_n=np.array([press.force_n for press in presses]),
        depth_mm=np.array([press.depth_mm for press in presses]),
        area_mm2=np.array([press.area_mm2 for press in presses]),
        contact=np.array([press.area_mm2 > 0 for press in presses]),
    )


def simulate_presses(
    parts: Iterable[Part | str | int] | Part | str | int | None = None,
    n_presses: int = 20,
    *,
    n_sessions: int = 1,
    array: PressureArray | None = None,
    load_kgf: float | tuple[float, float] = 4.0,
    max_shift_mm: float = 1.0,
    max_turn_deg: float = 180.0,
    tilt_sd_deg: float = 0.1,
    roughness_um: float = 10.0,
    random_state: int | None = None,
    n_jobs: int | None = None,
    progress: bool = False,
) -> Touches:
    """Press parts on a pressure array, each time laid down anew.

    Parameters
    ----------
    parts : Part, str, int, or a list of them, optional
        Parts, or names or numbers of the twelve, which are the default.
    n_presses : int, default=20
        Presses of each part (20 in Liu et al. 2014).
    n_sessions : int, default=1
        Mountings that the presses of each part are split into. In each the array's
        gain (4 %), its taxels' (14 %) and its zero (1 level) are drawn anew, as a mat's
        on two mattresses; 1 % of a press is left in the next, as on a 10 x 10 array
        (standard deviations; docs/explanation/how-real.md).
    array : PressureArray, optional
        The device; by default that of Liu et al. One device keeps its gains.
    load_kgf : float or (float, float), default=4
        Load in kgf, or a range to draw it from evenly.
    max_shift_mm : float, default=1
        The part's middle lies evenly within so much of the array's, along x and y.
        Guess: half a pitch, so that every place relative to the taxels occurs.
    max_turn_deg : float, default=180
        The part is turned evenly by up to so much, either way; 180 is any angle
        (the paper says "slightly different"; any angle is harder).
    tilt_sd_deg : float, default=0.1
        Standard deviation of the face's tilt along x and along y. Guess: parts held
        to ISO 2768-2 class H (0.2 mm out of square on 100 mm, 0.11 degrees) in a
        fixture without a ball joint.
    roughness_um : float, default=10
        Standard deviation of the face's unevenness in µm, drawn anew every press,
        so that no single specimen's marks can be learnt. ISO 2768-2 class H allows
        a flatness of 50 µm from 10 to 30 mm, taken as five standard deviations.
    random_state : int, optional
        Same number, same touches, whatever `n_jobs`.
    n_jobs : int, optional
        Processes, as in joblib; worth while from some ten thousand presses.
    progress : bool, default=False
        Show a bar on standard error.

    Returns
    -------
    touches : Touches
        uint8 images (n_parts * n_presses, rows, cols), part after part, geometry
        "array". Columns: `object` (the part's name), `category`, `session`, `part` (its
        number), `press` (from 0), `position_mm` (x, y), `angle_deg` (0 to 360),
        `symmetry` (turns that look the same, 0 for all), `force_n`, `tilt_deg`
        (along x, y). For the set: `set_pitch_mm`.

    Raises
    ------
    TypeError, ValueError
        No such part, no `PressureArray`, or a number out of its range.

    Examples
    --------
    >>> from palpate.simulation import simulate_presses
    >>> simulate_presses(["bar10", "disc13"], 3, random_state=0).images.shape
    (6, 10, 10)
    """
    resolved = find_parts(parts)
    device: Any = PressureArray() if array is None else array
    if not isinstance(device, PressureArray):
        kind = type(array).__name__
        raise TypeError(f"array must be a PressureArray, got {kind}.")
    draw = (
        _loads(load_kgf),
        check_number("max_shift_mm", max_shift_mm, low=0),
        check_number("max_turn_deg", max_turn_deg, low=0, high=180),
        check_number("tilt_sd_deg", tilt_sd_deg, low=0, high=2),
        check_number("roughness_um", roughness_um, low=0, high=1000),
    )
    count = check_count("n_presses", n_presses)
    repeated = [part for part in resolved for _ in range(count)]
    root = _root(random_state)
    seeds = root.spawn(len(repeated))
    batches = [slice(i, i + _PER_TASK[1]) for i in range(0, len(seeds), _PER_TASK[1])]
    tasks = [(device, draw, repeated[rows], seeds[rows]) for rows in batches]
    pressed = _all_of(_press_all, tasks, "Pressing", n_jobs, progress)
    images, presses = zip(*pressed, strict=True)
    n_parts = min(check_count("n_sessions", n_sessions), count)
    session = np.tile(np.sort(np.arange(count) % n_parts), len(resolved))
    levels = np.stack(images)
    if n_parts > 1:
        levels = _in_sessions(levels, session, root.spawn(n_parts))
    return Touches(
        levels,
        session=session,
        object=np.array([part.name for part in repeated]),
        category=np.array([part.category for part in repeated]),
        geometry="array",
        part=np.array([part.number for part in repeated]),
        press=np.tile(np.arange(count), len(resolved)),
        position_mm=np.array([(press.x_mm, press.y_mm) for press in presses]),
        angle_deg=np.array([press.angle_deg for press in presses]),
        symmetry=np.array([part.symmetry for part in repeated]),
        force_n=np.array([press.force_n for press in presses]),
        tilt_deg=np.array([press.tilt_deg for press in presses]),
        set_pitch_mm=np.array(device.pitch_mm),
    )


def _in_sessions(levels: Frame, session: Indices, seeds: list[SeedSequence]) -> Frame:
    """Return what an array would read in each session, mounted and zeroed anew."""
    result = np.empty_like(levels)
    for number, seed in enumerate(seeds):
        rng, rows = np.random.default_rng(seed), np.flatnonzero(session == number)
        gains = np.exp(rng.normal(0, 0.14, levels.shape[1:]) + rng.normal(0, 0.04))
        pressed = gains * levels[rows].astype(np.float64)
        pressed[1:] += 0.01 * pressed[:-1]
        zeroed = pressed + rng.normal(0, 1, levels.shape[1:])
        result[rows] = np.clip(np.rint(zeroed), 0, 255).astype(levels.dtype)
    return result


def _root(random_state: int | None) -> SeedSequence:
    if random_state is not None:
        check_count("random_state", random_state, at_least=0)
    return SeedSequence(random_state)


def _all_of(
    function: Callable[..., list[Any]],
    tasks: list[tuple[Any, ...]],
    what: str,
    n_jobs: int | None,
    show: bool | None,
) -> list[Any]:
    """Return what all tasks make, which end in the seeds of what they make."""
    sizes = [len(task[-1]) for task in tasks]
    batches = in_parallel(function, tasks, what, n_jobs=n_jobs, show=show, sizes=sizes)
    return list(chain.from_iterable(batches))


def _with_fields(scene: Scene, of_scene: dict[str, Any]) -> Scene:
    names = [field.name for field in fields(Scene)]
    for unknown in sorted(of_scene.keys() - {*names}):
        raise TypeError(
            f"simulate_touches has no parameter {unknown!r}. "
            f"Fields of Scene: {', '.join(names)}."
        )
    return replace(scene, **of_scene)


@on_one_thread()  # so that sums round alike everywhere
def _touch_object(
    sensor: DomeCamera | TacTipPins | GelCamera,
    thing: SimObject,
    session: SeedSequence,
    seeds: list[SeedSequence],
    *,
    scene: Scene,
    above: bool,
    drift: bool,
) -> list[tuple[Frame, DomePress, SensorPose]]:
    """Return pictures, presses and the poses at their ends, of one session."""
    rng = np.random.default_rng(session)
    placed = scene.placed(thing, rng, above=above)
    now = sensor.drifted(rng) if drift else sensor
    solid = len(thing.mesh.faces) > 0
    touches = []
    for rng in map(np.random.default_rng, seeds):
        force = now.dome.force_n * float(np.exp(rng.normal(0, scene.force_sd)))
        for _ in range(_ATTEMPTS):
            pose = scene.start(placed, rng, above=above)
            press = now.press(placed, pose, force_n=force)
            if press.touched or scene.keep_misses or not solid:
                break
        else:
            raise ValueError(
                f"objects must be where the sensor goes, but {thing.name!r} was missed "
                f"{_ATTEMPTS} times. Lower aim_sd_mm or pass keep_misses=True."
            )
        end = pose.advanced(press.travel_mm)
        touches.append((now.image(press, rng), press, end))
    return touches


def _sessions_of(
    thing: SimObject, seed: SeedSequence, parts: list[Indices]
) -> Iterator[tuple[int, SimObject, SeedSequence, list[SeedSequence]]]:
    """Split the work; seeds hang on the object's place and the touch's, not on this."""
    of_sessions, of_touches = seed.spawn(2)
    seeds = iter(of_touches.spawn(sum(map(len, parts))))
    sessions = zip(of_sessions.spawn(len(parts)), parts, strict=True)
    for number, (session, part) in enumerate(sessions):
        of_part = list(islice(seeds, len(part)))
        for start in range(0, len(of_part), _PER_TASK[0]):
            yield number, thing, session, of_part[start : start + _PER_TASK[0]]


@on_one_thread()  # so that sums round alike everywhere
def _press_all(
    array: PressureArray, draw: Any, parts: list[Part], seeds: list[SeedSequence]
) -> list[tuple[Frame, Press]]:
    """Press each part once."""
    loads, shift, turn, tilt_sd, roughness = draw
    pressed = []
    for part, seed in zip(parts, seeds, strict=True):
        rng = np.random.default_rng(seed)
        x, y = (shift * rng.uniform(-1, 1, size=2)).tolist()
        angle = float(turn * rng.uniform(-1, 1) % 360)
        load = rng.uniform(*loads)
        tilt = np.clip(tilt_sd * rng.standard_normal(2), -10, 10).tolist()
        press = Press(x, y, angle, load, tuple(tilt), roughness)
        stress = array.stress_kpa(part, press, rng)
        pressed.append((array.read(stress, rng), press))
    return pressed


def _loads(value: Any) -> tuple[float, float]:
    """Return (low, high) for a range or for one number, each a valid load."""
    limits = tuple(value) if isinstance(value, tuple | list) else (value, value)
    if len(limits) != 2:
        raise ValueError(f"load_kgf must be one load or (low, high), got {value}.")
    low, high = limits
    for load in limits:
        Press(load_kgf=load)
    if low > high:
        raise ValueError(f"load_kgf must go from low to high, got {value}.")
    return float(low), float(high)
