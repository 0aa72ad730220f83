"""`palpate record`: touches of one object, from a live sensor, to a file."""

import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._live_options import (
    Baud,
    Checksum,
    FramingName,
    Gap,
    Hold,
    Place,
    RateHz,
    SensorSpec,
    Shape,
    Summary,
    chosen_sensor,
)
from ._options import AsJson, NamePattern, NoContact
from ._output import print_json

if TYPE_CHECKING:
    from ..web import LiveSession


def record(
    name: Annotated[str, typer.Argument(metavar="OBJECT", help="What is touched.")],
    sensor: SensorSpec,
    library: Annotated[
        Path,
        typer.Option(
            "--library", help="Folder that keeps the touches; made if missing."
        ),
    ],
    touches: Annotated[
        int, typer.Option("-n", "--touches", help="How many touches to take.")
    ] = 12,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Write the object's touches to an archive too."
        ),
    ] = None,
    timeout: Annotated[
        float, typer.Option("--timeout", help="Give up after so long without a touch.")
    ] = 120.0,
    summary: Summary = "peak",
    shape: Shape = None,
    rate: RateHz = None,
    baud: Baud = None,
    framing: FramingName = None,
    checksum: Checksum = True,
    hold: Hold = None,
    gap: Gap = None,
    place: Place = None,
    name_pattern: NamePattern = None,
    no_contact: NoContact = None,
    as_json: AsJson = False,
) -> None:
    """Record touches of one object; each is on the disk as soon as it is counted."""
    from ..web import LiveSession

    if output is not None and output.suffix != ".npz":
        raise typer.BadParameter(f"--output must end in .npz, got {output.name!r}.")
    chosen = chosen_sensor(
        sensor,
        shape=shape,
        rate=rate,
        baud=baud,
        framing=framing,
        checksum=checksum,
        hold=hold,
        gap=gap,
        no_contact=no_contact,
        name_pattern=name_pattern,
        place=place,
    )
    name = " ".join(name.split())  # as it is kept
    with LiveSession(chosen, library=library, summary=summary) as session:
        _need_zero(session)
        n_taken = _lesson(session, name, touches, timeout)
        assert session.teacher is not None
        if output is not None and n_taken:
            session.teacher.touches(name).save(output)
    if as_json:
        told: dict[str, Any] = {"object": name, "touches": n_taken}
        where = None if output is None else str(output)
        print_json({**told, "library": str(library), "output": where})
    else:
        print(f"{n_taken} touches of {name} are in {library}.")
    if n_taken < touches:
        raise typer.Exit(1)


def _need_zero(session: "LiveSession") -> None:
    """Take the frame of no contact where the sensor does not know it."""
    if session.baseline is None:
        print("Leave the sensor alone: taking its baseline.", file=sys.stderr)
        session.take_baseline()


def _lesson(session: "LiveSession", name: str, wanted: int, timeout_s: float) -> int:
    """Take touches until there are enough, none come, or Ctrl-C; return how many."""
    changed = threading.Event()
    session.listeners.add(
        lambda event: changed.set() if event.kind == "state" else None
    )
    session.teach(name, wanted)
    assert session.teacher is not None
    lesson = session.teacher.lesson
    shown = 0
    print(f"Touch {name} {wanted} times.", file=sys.stderr)
    try:
        while lesson is not None and len(lesson.ids) < wanted:
            changed.clear()
            if not changed.wait(timeout_s):
                print(f"No touch in {timeout_s:g} s: ended.", file=sys.stderr)
                break
            if session.trouble:
                print(f"palpate: {session.trouble}", file=sys.stderr)
                break
            if len(lesson.ids) != shown:
                shown = len(lesson.ids)
                print(f"  touch {shown} of {wanted}", file=sys.stderr)
    except KeyboardInterrupt:
        print("Ended; what was counted is kept.", file=sys.stderr)
    return 0 if lesson is None else len(lesson.ids)
