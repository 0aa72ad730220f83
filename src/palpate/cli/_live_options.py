"""Options of the verbs that use a live sensor."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ..sensors import StreamingSensor

SensorSpec = Annotated[
    str,
    typer.Option(
        "--sensor",
        help="camera:NAME, serial:PORT, replay:PATH or sim:OBJECT.",
    ),
]
Shape = Annotated[
    str | None,
    typer.Option(
        "--shape", help="Rows x columns of an array (16x16) or a camera (480x640)."
    ),
]
RateHz = Annotated[
    float | None, typer.Option("--rate", help="Frames per second, where chosen.")
]
Baud = Annotated[
    int | None, typer.Option("--baud", help="Bits per second of a serial port.")
]
FramingName = Annotated[
    str | None,
    typer.Option("--framing", help='How a serial array writes: "line" or "binary".'),
]
Checksum = Annotated[
    bool,
    typer.Option(
        "--checksum/--no-checksum", help="Refuse serial lines without a checksum."
    ),
]
Hold = Annotated[
    int | None,
    typer.Option("--hold", help="Frames that a replayed or simulated touch is held."),
]
Gap = Annotated[
    int | None,
    typer.Option("--gap", help="Frames of nothing between two such touches."),
]
Summary = Annotated[
    str,
    typer.Option(
        "--summary",
        help='What stands for a touch: "peak", the frame of greatest change, or '
        '"mean" over the hold.',
    ),
]
ErrorRate = Annotated[
    float, typer.Option("--error", help="Accepted share of wrong decisions.")
]
Place = Annotated[
    str | None,
    typer.Option(
        "--place", help="What lies before a replayed or simulated sensor at first."
    ),
]


def chosen_sensor(
    spec: str,
    *,
    shape: str | None,
    rate: float | None,
    baud: int | None,
    framing: str | None,
    checksum: bool,
    hold: int | None,
    gap: int | None,
    no_contact: Path | None,
    name_pattern: str | None,
    place: str | None,
) -> "StreamingSensor":
    """Return the sensor that the options describe; it is not connected yet."""
    from ..sensors import desk_of, open_sensor

    kind = spec.partition(":")[0]
    given: dict[str, dict[str, Any]] = {
        "serial": {
            "baud": baud,
            "framing": framing,
            "checksum": None if checksum else False,
        },
        "replay": {
            "hold": hold,
            "gap": gap,
            "no_contact": no_contact,
            "name_pattern": name_pattern,
        },
        "sim": {"hold": hold, "gap": gap},
    }
    meant = given.get(kind, {})
    _refuse_strangers(kind, given, meant)
    if kind == "serial" and rate is not None:
        raise typer.BadParameter("--rate says nothing to a serial sensor.")
    sensor = open_sensor(spec, image_shape=_rows_cols(shape), rate_hz=rate, **meant)
    if place is not None:
        desk = desk_of(sensor)
        if desk is None:
            raise typer.BadParameter(f"What lies before {spec} cannot be chosen here.")
        desk.place(place)
    return sensor


def _refuse_strangers(
    kind: str, given: dict[str, dict[str, Any]], meant: dict[str, Any]
) -> None:
    """Say so where an option is given that this kind of sensor does not have."""
    for options in given.values():
        for name, value in options.items():
            if value is not None and name not in meant:
                raise typer.BadParameter(
                    f"--{name.replace('_', '-')} says nothing to a {kind} sensor."
                )


def _rows_cols(shape: str | None) -> tuple[int, int] | None:
    if shape is None:
        return None
    found = re.fullmatch(r"(\d{1,5})\s*[xX×]\s*(\d{1,5})", shape.strip())
    if found is None:
        raise typer.BadParameter(
            f"--shape must be rows x columns such as 16x16, got {shape!r}."
        )
    return int(found[1]), int(found[2])
