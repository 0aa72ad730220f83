"""`palpate explore`: a simulated arm touches objects, to learn or to recognise them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from .._extras import needed
from . import _options
from ._options import option
from ._output import answer, belief_line, say, stages
from .simulate import Objects, Rows, Unit, Workers, find_objects

if TYPE_CHECKING:
    from ..exploration import (
        Hemisphere,
        Strategy,
        SurfaceMap,
        TouchMap,
        TouchRecord,
    )
    from ..recognition import ObjectRecogniser
    from ..simulation import SensorPose, SimObject

STRATEGIES = ("informative", "random", "raster")
_LEAST_SIDE = 16

explore = typer.Typer(
    no_args_is_help=True, help="Let a simulated arm touch objects: learn, recognise."
)
Folder = Annotated[
    Path | None,
    option(
        "--folder",
        "Keep every attempt here as it is made; the same command goes on there.",
    ),
]


@explore.command()
def learn(
    output: _options.ModelOutput,
    objects: Objects = None,
    touches: Annotated[int, option("Touches of each object.")] = 60,
    sessions: Annotated[int, option("How often each object is put down anew.")] = 3,
    faces: Annotated[str, option("usual, or all on which objects rest.")] = "usual",
    preset: _options.Preset = "default",
    rows: Rows = 120,
    folder: Folder = None,
    unit: Unit = "mm",
    workers: Workers = -1,
    seed: _options.Seed = 0,
    as_json: _options.AsJson = False,
) -> None:
    """Touch objects from random points of a hemisphere and learn them.

    Writes the model, and beside it (.npz) its touches with the directions that
    choosing touches needs.
    """
    from ..exploration import explore_to_learn
    from ..recognition import ObjectRecogniser
    from ..simulation import DomeCamera

    things = find_objects(objects, unit)
    if len(things) < 2:
        raise ValueError("OBJECT must name at least 2 objects to learn. Add another.")
    taught = explore_to_learn(
        things,
        touches,
        DomeCamera(image_shape=(rows, rows)),
        n_sessions=sessions,
        faces=faces,
        folder=folder,
        random_state=seed,
        n_jobs=workers,
        progress=None,
    )
    with stages() as stage:
        stage(f"learning from {len(taught)} touches")
        recogniser = ObjectRecogniser(cast(Any, preset), random_state=seed).fit(taught)
    archive = output.with_suffix(".npz")
    taught.save(archive)
    written = recogniser.save(output)
    learnt = recogniser.summary()
    answer(
        as_json,
        {"model": str(written), "touches": str(archive), **learnt},
        f"Explored {len(things)} objects with {len(taught)} touches.",
        archive,
        written,
    )


@explore.command()
@_options.grouped
def recognise(
    model: _options.ModelPath,
    thing: Annotated[
        str, _options.argument("OBJECT", "A built-in object or a mesh file.")
    ],
    *,
    strategy: Annotated[
        str,
        option(
            "informative, random or raster.",
            callback=_options.one_of("--strategy", lambda: STRATEGIES),
        ),
    ] = "informative",
    taught: Annotated[
        Path | None,
        option(
            "The touches MODEL learnt, with their directions. Default: the .npz "
            "of MODEL's name, where there is one."
        ),
    ] = None,
    most: Annotated[int, option("--max-touches", "Budget of attempts.")] = 30,
    deciding: _options.Deciding,
    folder: Folder = None,
    yaw: Annotated[float | None, option("Turn, degrees. Default: drawn.")] = None,
    face: Annotated[int, option("Which face it rests on; 0 is the usual one.")] = 0,
    fault: Annotated[
        list[str] | None,
        option(
            "Let something fail, as '2=no force': in attempt 2, counted from 0. "
            "Repeatable. stuck force, stuck force in contact, no force, overshoot, "
            "driver error, slow, retract error, arm stuck, no frame, out of reach."
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        _options.written_file(
            "--picture",
            ending=".png",
            text="Draw what is believed, from above, and the next touch, as this PNG.",
        ),
    ] = None,
    unit: Unit = "mm",
    seed: _options.Seed = 0,
    max_model_mb: _options.MaxModelMb = 2000,
    as_json: _options.AsJson = False,
) -> None:
    """Touch one object until it is recognised, or found to be unknown."""
    import numpy as np

    from .. import exploration
    from .._checks import check_number
    from ..recognition import ObjectRecogniser

    if picture is not None:
        needed("matplotlib", "plot", "--picture")
    target = _one_object(thing, unit)
    recogniser = ObjectRecogniser.load(_options.model_file(model))
    drawn = np.random.default_rng([seed, 1]).uniform(0, 2 * np.pi)
    yaw_rad = float(drawn if yaw is None else np.deg2rad(check_number("yaw", yaw)))
    stand = exploration.put_down(
        target,
        _camera(recogniser),
        face=face,
        yaw_rad=yaw_rad,
        random_state=seed,
        faults=_faults(fault),
    )
    touch_map = _touch_map(recogniser, model, taught, strategy, seed)
    if picture is not None and not isinstance(touch_map, exploration.SurfaceMap):
        raise ValueError(
            "--picture needs to know where touches were made, got a model without "
            "places. Learn it with palpate explore learn, or give --taught."
        )
    way = _way(strategy, stand.hemisphere, touch_map, seed)
    knower = recogniser if touch_map is None else touch_map
    if folder is not None and (folder / "episode.json").exists() and not as_json:
        say(f"Goes on after {len(exploration.read_episode(folder))} attempts.")
    end = exploration.explore(
        stand.robot,
        stand.sensor,
        knower,
        _Standing(way, target.name, yaw_rad, face, seed, target.surface),
        folder,
        guard=stand.quick_guard,
        max_attempts=most,
        **vars(deciding),
        clock=stand.robot.clock,
        on_attempt=None if as_json else print_attempt,
    )
    about = {"object": target.name, "strategy": strategy}
    standing = []
    if isinstance(end.belief, exploration.PlaceBelief):
        if picture is not None:
            # The next touch too, if one is needed.
            more = end.decision is None
            start = way.next_pose(end.belief, end.history) if more else None
            axes = end.belief.plot_surface(end.history, start=start)
            cast(Any, axes.figure).savefig(picture, dpi=100, bbox_inches="tight")
        if end.decision not in (None, "unknown"):
            standing = [f"  {end.belief.pose()}"]
    answer(
        as_json,
        {
            **about,
            **end.to_dict(knower, stand.hemisphere),
        },
        f"  {end.reason}",
        *standing,
    )


@dataclass(frozen=True)
class _Standing:
    """A strategy before an object that stands so: an episode goes on only if it is."""

    way: "Strategy"
    object: str
    yaw_rad: float
    face: int
    seed: int
    surface: str

    @property
    def hemisphere(self) -> "Hemisphere":
        return self.way.hemisphere

    def next_pose(self, belief: Any, history: "Sequence[TouchRecord]") -> "SensorPose":
        return self.way.next_pose(belief, history)


def _way(
    strategy: str,
    hemisphere: "Hemisphere",
    touch_map: "TouchMap | SurfaceMap | None",
    seed: int,
) -> "Strategy":
    """Return where to touch next, by the strategy's name."""
    from .. import exploration

    if strategy == "random":
        return exploration.RandomHemisphere(hemisphere, seed)
    if strategy == "raster":
        return exploration.Raster(hemisphere)
    assert touch_map is not None
    return exploration.InformativeTouch(touch_map, hemisphere)


def _one_object(name: str, unit: str) -> "SimObject":
    things = find_objects([name], unit)
    if len(things) != 1:
        names = ", ".join(thing.name for thing in things)
        raise ValueError(
            f"OBJECT must be one object, got the set {name!r}. Name one of: {names}."
        )
    return things[0]


def print_attempt(record: "TouchRecord", belief: Any) -> None:
    from ..recognition import touch_note

    if record.touched:
        number = belief.touches_used
        note = touch_note(number, belief.flags[-1])
        say(belief_line(number, belief.posterior, belief.unknown, note))
    else:
        say(f"  {record.outcome}. {record.message}".rstrip())


def _touch_map(
    recogniser: "ObjectRecogniser",
    model: Path,
    taught: Path | None,
    strategy: str,
    seed: int,
) -> "TouchMap | SurfaceMap | None":
    """Learn where touches were made; None where that is neither known nor needed."""
    from ..exploration import SurfaceMap, TouchMap
    from ..touches import Touches

    archive = model.with_suffix(".npz") if taught is None else taught
    if taught is None and not archive.exists():
        if strategy != "informative":
            return None
        raise ValueError(
            f"strategy 'informative' needs the touches that {model} learnt, with their "
            f"directions, got no {archive}. Name them with --taught, or take "
            "--strategy random."
        )
    with stages() as stage:
        stage("learning where touches were made")
        touches = Touches.load(archive)
        if "position_mm" in touches.columns:
            return SurfaceMap(random_state=seed).fit(recogniser, touches)
        return TouchMap(random_state=seed).fit(recogniser, touches)


def _camera(recogniser: "ObjectRecogniser") -> Any:
    from .._checks import size_text
    from ..simulation import DomeCamera

    shape = recogniser.encoder_.image_shape_
    if len(shape) != 2 or min(shape) < _LEAST_SIDE:
        raise ValueError(
            f"MODEL must be of a dome camera, got one of {size_text(shape)}. Make one "
            "with: palpate explore learn."
        )
    return DomeCamera(image_shape=(shape[0], shape[1]))


def _faults(texts: Sequence[str] | None) -> dict[int, str]:
    """Read '2=no force' as {2: "no force"}."""
    faults = {}
    for text in texts or ():
        number, _, name = text.partition("=")
        if not number.strip().isdecimal():
            raise ValueError(
                f"--fault must be NUMBER=NAME, got {text!r}. Write '2=no force'."
            )
        faults[int(number)] = name.strip()
    return faults
