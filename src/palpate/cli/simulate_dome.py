"""`palpate simulate dome` and `pins`: objects touched by a simulated dome."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._options import AsJson, Seed
from ._output import print_json
from .simulate import Output, Workers, check_output, simulate

if TYPE_CHECKING:
    from ..simulation import DomeCamera, SimObject, TacTipPins

SETS = ("household", "unseen", "shapes")

Objects = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[OBJECT]...",
        help="Names (mug, 'porridge pot'...), the sets household, unseen or shapes, or "
        "mesh files (.stl .obj .ply). Default: household.",
    ),
]
TouchCount = Annotated[int, typer.Option("--touches", help="Touches of each object.")]
Sessions = Annotated[
    int,
    typer.Option(
        "--sessions",
        help="Recordings: in each the object is turned anew and the camera drifts.",
    ),
]
Rows = Annotated[int, typer.Option("--rows", help="Rows of the picture.")]
Cols = Annotated[int, typer.Option("--cols", help="Columns of the picture.")]
Force = Annotated[float, typer.Option("--force", help="A press ends at so many N.")]
AnyPose = Annotated[
    bool, typer.Option("--any-pose", help="Let objects rest on any of their faces.")
]
Unit = Annotated[
    str, typer.Option("--unit", help="Unit of mesh files: mm, cm, m or in.")
]
Aim = Annotated[
    float,
    typer.Option("--aim-sd", help="Presses face the centre to within this sd, mm."),
]
NoDrift = Annotated[
    bool, typer.Option("--no-drift", help="Keep exposure and place in all sessions.")
]


@simulate.command()
def dome(
    output: Output,
    objects: Objects = None,
    touches: TouchCount = 60,
    sessions: Sessions = 1,
    rows: Rows = 120,
    cols: Cols = 120,
    force: Force = 0.735,
    youngs: Annotated[
        float, typer.Option("--youngs", help="Young's modulus of the rubber, MPa.")
    ] = 0.11,
    thickness: Annotated[
        float, typer.Option("--thickness", help="Thickness of the rubber, mm.")
    ] = 1.5,
    leds: Annotated[int, typer.Option("--leds", help="Number of LEDs.")] = 8,
    gain: Annotated[float, typer.Option("--gain", help="Exposure.")] = 1.0,
    noise: Annotated[
        float, typer.Option("--noise", help="Noise of a picture, grey levels.")
    ] = 3.6,
    any_pose: AnyPose = False,
    aim_sd: Aim = 5.0,
    no_drift: NoDrift = False,
    unit: Unit = "mm",
    workers: Workers = -1,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Touch objects with a rubber dome and the camera behind it."""
    from ..simulation import DomeCamera

    camera = DomeCamera(
        image_shape=(rows, cols),
        force_n=force,
        youngs_mpa=youngs,
        thickness_mm=thickness,
        n_leds=leds,
        gain=gain,
        noise_sd=noise,
    )
    way = {"pose": "any" if any_pose else "usual", "aim_sd_mm": aim_sd}
    way |= {"drift": not no_drift, "n_sessions": sessions, "n_jobs": workers}
    _make(output, find_objects(objects, unit), touches, camera, way, seed, as_json)


@simulate.command()
def pins(
    output: Output,
    objects: Objects = None,
    touches: TouchCount = 60,
    sessions: Sessions = 1,
    rows: Rows = 300,
    cols: Cols = 300,
    force: Force = 0.735,
    rings: Annotated[int, typer.Option("--rings", help="Rings of pins.")] = 6,
    any_pose: AnyPose = False,
    aim_sd: Aim = 5.0,
    no_drift: NoDrift = False,
    unit: Unit = "mm",
    workers: Workers = -1,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Touch objects with a dome whose inside carries pins, as a TacTip's does."""
    from ..simulation import TacTipPins

    usual = TacTipPins()
    seen = replace(usual.dome, image_shape=(rows, cols), force_n=force)
    camera = replace(usual, dome=seen, n_rings=rings)
    way = {"pose": "any" if any_pose else "usual", "aim_sd_mm": aim_sd}
    way |= {"drift": not no_drift, "n_sessions": sessions, "n_jobs": workers}
    _make(output, find_objects(objects, unit), touches, camera, way, seed, as_json)


def _make(
    output: Path,
    things: "list[SimObject]",
    touches: int,
    camera: "DomeCamera | TacTipPins",
    way: dict[str, Any],
    seed: int,
    as_json: bool,
) -> None:
    from ..simulation import BASIC_SHAPES, simulate_touches

    check_output(output)
    shapes = [thing in BASIC_SHAPES for thing in things]
    if any(shapes) and not all(shapes):
        raise ValueError(
            "The basic shapes are touched from above, other objects from all sides; "
            "simulate them into archives of their own."
        )
    strategy = "above" if all(shapes) else "hemisphere"
    made = simulate_touches(
        things,
        touches,
        camera,
        strategy,
        random_state=seed,
        progress=None,
        **way,
    )
    made.save(output)
    names = [thing.name for thing in things]
    if as_json:
        print_json({"touches": str(output), "n_touches": len(made), "objects": names})
        return
    print(f"Touched {len(names)} objects, {len(made)} touches.")
    print(output)


def find_objects(names: list[str] | None, unit: str) -> "list[SimObject]":
    """Return the objects that names, sets and mesh files stand for.

    Raises
    ------
    ValueError
        There is no such object, or two of them have one name: their touches would
        be those of one.
    """
    from ..simulation import (
        BASIC_SHAPES,
        HOUSEHOLD,
        MESH_SUFFIXES,
        UNSEEN,
        find_object,
        load_mesh,
    )

    sets = dict(zip(SETS, (HOUSEHOLD, UNSEEN, BASIC_SHAPES), strict=True))
    given_as: dict[str, str] = {}
    found: list[SimObject] = []
    for name in names or ["household"]:
        if name in sets:
            things = sets[name]
        elif Path(name).suffix.lower() in MESH_SUFFIXES:
            things = (load_mesh(name, unit=unit),)
        else:
            things = (find_object(name),)
        for thing in things:
            if thing.name in given_as:
                raise ValueError(
                    f"OBJECT must name each object once, got {thing.name!r} as "
                    f"{given_as[thing.name]!r} and {name!r}. Leave one out; a mesh "
                    "file is called as its object, so rename it."
                )
            given_as[thing.name] = name
        found += things
    return found
