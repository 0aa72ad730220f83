"""`palpate simulate`: touches of a sensor that is not there, as a touch archive."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import AsJson, Seed
from ._output import print_json
from ._workers import checked_workers

# Share of the pitch that senses, where --sensing is not given (the paper's 1.3 / 2).
SENSING_SHARE = 0.65

simulate = typer.Typer(
    no_args_is_help=True, help="Make touches with a simulated sensor."
)

Output = Annotated[
    Path, typer.Option("-o", "--output", help="The touch archive to write (.npz).")
]


Workers = Annotated[
    int,
    typer.Option(
        "--workers", help="Processes; -1 for all cores.", callback=checked_workers
    ),
]


@simulate.command()
def array(
    output: Output,
    parts: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[PART]...",
            help="Names (bar10, disc13-hole8...) or numbers, 1 to 12. Default: all.",
        ),
    ] = None,
    presses: Annotated[int, typer.Option("--presses", help="Presses of each.")] = 20,
    rows: Annotated[int, typer.Option("--rows", help="Taxels down.")] = 10,
    cols: Annotated[int, typer.Option("--cols", help="Taxels across.")] = 10,
    pitch: Annotated[
        float, typer.Option("--pitch", help="Distance of taxels, mm.")
    ] = 2.0,
    sensing: Annotated[
        float | None,
        typer.Option("--sensing", help="Side of what a taxel senses, mm. [0.65 pitch]"),
    ] = None,
    load: Annotated[
        str, typer.Option("--load", help="Load in kgf, or a range such as 1:5.")
    ] = "4",
    cover: Annotated[
        float, typer.Option("--cover", help="Thickness of the cover, mm.")
    ] = 0.9,
    shift: Annotated[
        float, typer.Option("--shift", help="Parts lie off the middle by up to, mm.")
    ] = 1.0,
    turn: Annotated[
        float, typer.Option("--turn", help="Parts are turned by up to, degrees.")
    ] = 180.0,
    tilt: Annotated[
        float, typer.Option("--tilt", help="Standard deviation of tilt, degrees.")
    ] = 0.1,
    roughness: Annotated[
        float, typer.Option("--roughness", help="Unevenness of the faces, µm.")
    ] = 10.0,
    gain_spread: Annotated[
        float, typer.Option("--gain-spread", help="Spread of the taxels' gains.")
    ] = 0.1,
    dead_zone: Annotated[
        float, typer.Option("--dead-zone", help="Less than this is not felt, kPa.")
    ] = 69.0,
    full_scale: Annotated[
        float, typer.Option("--full-scale", help="Stress that reads 255, kPa.")
    ] = 4000.0,
    noise: Annotated[
        float, typer.Option("--noise", help="Standard deviation of a reading, kPa.")
    ] = 8.0,
    device: Annotated[
        int, typer.Option("--device", help="Which array: seed of its taxels' gains.")
    ] = 0,
    workers: Workers = 1,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Press flat parts on a pressure array, each time laid down anew."""
    from ..simulation import PressureArray, simulate_presses

    check_output(output)
    made = simulate_presses(
        _parts(parts),
        presses,
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
    made.save(output)
    names = list(dict.fromkeys(map(str, made.object)))  # type: ignore[arg-type]
    if as_json:
        print_json({"touches": str(output), "n_touches": len(made), "objects": names})
        return
    print(f"Pressed {len(names)} parts, {len(made)} touches.")
    print(output)


def _parts(names: list[str] | None) -> list[str | int]:
    from ..simulation import PARTS

    if not names:
        return [part.name for part in PARTS]
    return [int(name) if name.isdecimal() else name for name in names]


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


def check_output(path: Path) -> None:
    """Refuse before pressing, not after."""
    if path.suffix.lower() != ".npz":
        raise ValueError(f"--output must end in .npz, got {path.name!r}.")
    if not path.parent.is_dir():
        raise ValueError(f"There is no folder {path.parent} to write to; make it.")
