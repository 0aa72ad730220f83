"""`palpate simulate`: touches of a sensor that is not there, as a touch archive."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._options import (
    AsJson,
    Seed,
    argument,
    checked_workers,
    flag,
    grouped,
    option,
    written_file,
)
from ._output import answer

if TYPE_CHECKING:
    from ..simulation import DomeCamera, SimObject, TacTipPins
    from ..touches import Touches

# Share of the pitch that senses, where --sensing is not given (the paper's 1.3 / 2).
SENSING_SHARE = 0.65

simulate = typer.Typer(no_args_is_help=True, help="Make touches by simulation.")

Output = Annotated[
    Path,
    written_file(
        *("-o", "--output"), ending=".npz", text="The touch archive to write (.npz)."
    ),
]
Workers = Annotated[
    int, option("--workers", "Processes; -1 for all cores.", callback=checked_workers)
]
Objects = Annotated[
    list[str] | None,
    argument(
        "OBJECT",
        "Names (mug, 'porridge pot'...), the sets household, unseen, 'unlike "
        "others' or shapes, or mesh files (.stl .obj .ply). Default: household.",
    ),
]
Rows = Annotated[int, option("--rows", "Rows of the picture.")]
Cols = Annotated[int, option("--cols", "Columns of the picture.")]
Unit = Annotated[str, option("--unit", "Unit of mesh files: mm, cm, m or in.")]
Force = Annotated[float, option("--force", "A press ends at so many N.")]


@dataclass(frozen=True)
class DomeTouches:
    """How objects are touched by a dome, and where the touches go."""

    output: Output
    objects: Objects = None
    touches: Annotated[int, option("Touches of each object.")] = 60
    sessions: Annotated[
        int,
        option(
            "Mountings of the sensor, each with its own camera place, exposure, light "
            "and rubber; in each the object is turned anew."
        ),
    ] = 1
    any_pose: Annotated[bool, flag("--any-pose", "Rest on any of its faces.")] = False
    aim_sd: Annotated[float, option("Presses miss the centre by this sd, mm.")] = 5.0
    no_drift: Annotated[bool, flag("--no-drift", "Keep the sensor as it is.")] = False
    unit: Unit = "mm"
    workers: Workers = -1
    seed: Seed = 0
    as_json: AsJson = False

    def make(self, camera: "DomeCamera | TacTipPins") -> None:
        from .. import simulation

        things = find_objects(self.objects, self.unit)
        basic = simulation.find_objects("shapes")
        shapes = [thing in basic for thing in things]
        if any(shapes) and not all(shapes):
            raise ValueError(
                "The basic shapes are touched from above, other objects from all "
                "sides; simulate them into archives of their own."
            )
        touches = simulation.simulate_touches(
            things,
            self.touches,
            camera,
            "above" if all(shapes) else "hemisphere",
            scene=simulation.Scene(
                pose="any" if self.any_pose else "usual", aim_sd_mm=self.aim_sd
            ),
            drift=not self.no_drift,
            mountings=self.sessions > 1 and not self.no_drift,
            n_sessions=self.sessions,
            n_jobs=self.workers,
            random_state=self.seed,
            progress=None,
        )
        _write(touches, self.output, "Touched {} objects", self.as_json)


@simulate.command()
def array(
    output: Output,
    parts: Annotated[
        list[str] | None, argument("PART", "Names (bar10...) or 1 to 12. Default: all.")
    ] = None,
    presses: Annotated[int, option("Presses of each.")] = 20,
    sessions: Annotated[int, option("Mountings: gains and zero are new.")] = 1,
    rows: Annotated[int, option("Taxels down.")] = 10,
    cols: Annotated[int, option("Taxels across.")] = 10,
    pitch: Annotated[float, option("Distance of taxels, mm.")] = 2.0,
    sensing: Annotated[
        float | None, option("Side of a taxel, mm [0.65 pitch].")
    ] = None,
    load: Annotated[str, option("Load in kgf, or a range such as 1:5.")] = "4",
    cover: Annotated[float, option("Thickness of the cover, mm.")] = 0.9,
    shift: Annotated[float, option("Parts lie off the middle by up to, mm.")] = 1.0,
    turn: Annotated[float, option("Parts are turned by up to, degrees.")] = 180.0,
    tilt: Annotated[float, option("Standard deviation of tilt, degrees.")] = 0.1,
    roughness: Annotated[float, option("Unevenness of the faces, µm.")] = 10.0,
    gain_spread: Annotated[float, option("Spread of the taxels' gains.")] = 0.1,
    dead_zone: Annotated[float, option("Less than this reads 0, kPa.")] = 69.0,
    full_scale: Annotated[float, option("Stress that reads 255, kPa.")] = 4000.0,
    noise: Annotated[float, option("Standard deviation of a reading, kPa.")] = 8.0,
    device: Annotated[int, option("Which array: seed of its taxels' gains.")] = 0,
    workers: Workers = 1,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Press flat parts on a pressure array, each time laid down anew."""
    from ..simulation import PressureArray, simulate_presses

    touches = simulate_presses(
        [int(n) if n.isdecimal() else n for n in parts] if parts else None,
        presses,
        n_sessions=sessions,
        array=PressureArray(
            rows=rows,
            cols=cols,
            pitch_mm=pitch,
            sensing_mm=SENSING_SHARE * pitch if sensing is None else sensing,
            cover_mm=cover,
            gain_spread=gain_spread,
            dead_zone_kpa=dead_zone,
            full_scale_kpa=full_scale,
            noise_kpa=noise,
            random_state=device,
        ),
        load_kgf=_load(load),
        max_shift_mm=shift,
        max_turn_deg=turn,
        tilt_sd_deg=tilt,
        roughness_um=roughness,
        random_state=seed,
        n_jobs=workers,
    )
    _write(touches, output, "Pressed {} parts", as_json)


@simulate.command()
@grouped
def dome(
    *,
    rows: Rows = 120,
    cols: Cols = 120,
    force: Force = 0.735,
    youngs: Annotated[float, option("Young's modulus of the rubber, MPa.")] = 0.11,
    thickness: Annotated[float, option("Thickness of the rubber, mm.")] = 1.5,
    leds: Annotated[int, option("Number of LEDs.")] = 8,
    gain: Annotated[float, option("Exposure.")] = 1.0,
    noise: Annotated[float, option("Noise of a picture, grey levels.")] = 3.6,
    way: DomeTouches,
) -> None:
    """Touch objects with a rubber dome and the camera behind it."""
    from ..simulation import DomeCamera

    way.make(
        DomeCamera(
            image_shape=(rows, cols),
            force_n=force,
            youngs_mpa=youngs,
            thickness_mm=thickness,
            n_leds=leds,
            gain=gain,
            noise_sd=noise,
        )
    )


@simulate.command()
@grouped
def pins(
    *,
    rows: Rows = 300,
    cols: Cols = 300,
    force: Force = 0.735,
    rings: Annotated[int, option("Rings of pins.")] = 6,
    way: DomeTouches,
) -> None:
    """Touch objects with a dome whose inside carries pins, as a TacTip's does."""
    from ..simulation import TacTipPins

    usual = TacTipPins()
    seen = replace(usual.dome, image_shape=(rows, cols), force_n=force)
    way.make(replace(usual, dome=seen, n_rings=rings))


def _write(touches: "Touches", output: Path, done: str, as_json: bool) -> None:
    touches.save(output)
    names = (
        [] if touches.object is None else list(dict.fromkeys(touches.object.tolist()))
    )
    values = {"touches": str(output), "n_touches": len(touches), "objects": names}
    line = f"{done.format(len(names))}, {len(touches)} touches."
    answer(as_json, values, line, output)


def _load(text: str) -> float | tuple[float, float]:
    try:
        loads = [float(part) for part in text.split(":")]
    except ValueError:
        loads = []
    if len(loads) not in (1, 2):
        raise ValueError(
            f"--load must be kgf or a range, got {text!r}; "
            "write --load 4 or --load 1:5."
        )
    return loads[0] if len(loads) == 1 else (loads[0], loads[1])


def find_objects(names: list[str] | None, unit: str) -> "list[SimObject]":
    """Return the objects that names, sets and mesh files stand for, each once."""
    from .. import simulation

    given_as: dict[str, str] = {}
    objects: list[SimObject] = []
    for name in names or ["household"]:
        if Path(name).suffix.lower() in simulation.MESH_SUFFIXES:
            things = [simulation.load_mesh(name, unit=unit)]
        else:
            things = simulation.find_objects(name)
        for thing in things:
            if thing.name in given_as:
                raise ValueError(
                    f"OBJECT must name each object once, got {thing.name!r} as "
                    f"{given_as[thing.name]!r} and {name!r}. Leave one out; a mesh "
                    "file is called as its object, so rename it."
                )
            given_as[thing.name] = name
        objects += things
    return objects
