"""`palpate record`: touches of one object, from a live sensor, to a file."""

import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._options import AsJson, argument, grouped, option
from ._output import answer
from ._sensor import Patience, SensorAddress, SensorOptions, Summary, need_baseline

if TYPE_CHECKING:
    from ..web import LiveSession


@grouped
def record(
    name: Annotated[str, argument("OBJECT", "What is touched.")],
    sensor: SensorAddress,
    library: Annotated[Path, option("Folder that keeps the touches; made if missing.")],
    *,
    touches: Annotated[
        int, option("-n", "--touches", "How many touches to take.")
    ] = 12,
    output: Annotated[
        Path | None,
        option("-o", "--output", "Write the object's touches to an archive too."),
    ] = None,
    timeout: Patience = 120.0,
    summary: Summary = "peak",
    options: SensorOptions,
    as_json: AsJson = False,
) -> None:
    """Record touches of one object; each is on the disk as soon as it is counted."""
    from ..web import LiveSession

    if output is not None and output.suffix != ".npz":
        raise typer.BadParameter(f"--output must end in .npz, got {output.name!r}.")
    chosen = options.open(sensor)
    name = " ".join(name.split())  # as it is kept
    with LiveSession(chosen, library=library, summary=summary) as session:
        need_baseline(session)
        n_taken = _lesson(session, name, touches, timeout)
        assert session.teacher is not None
        if output is not None and n_taken:
            session.teacher.touches(name).save(output)
    written = None if output is None else str(output)
    kept = {"library": str(library), "output": written}
    answer(
        as_json,
        {"object": name, "touches": n_taken, **kept},
        f"{n_taken} touches of {name} are in {library}.",
    )
    if n_taken < touches:
        raise typer.Exit(1)


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
