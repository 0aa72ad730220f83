"""`palpate record`: touches of one object, from a live sensor, to a file."""

import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._options import AsJson, argument, grouped, option, written_file
from ._output import answer, counted, say
from .sensor import (
    Patience,
    SensorAddress,
    SensorOptions,
    Summary,
    give_up,
    has_trouble,
    need_baseline,
)

if TYPE_CHECKING:
    from ..web import LiveSession


@grouped
def record(
    name: Annotated[str, argument("OBJECT", "What is touched.")],
    sensor: SensorAddress,
    library: Annotated[Path, option("Folder that keeps the touches; made if missing.")],
    *,
    touches: Annotated[int, option("-n", "--touches", "How many.")] = 12,
    output: Annotated[
        Path | None,
        written_file(
            "-o", "--output", ending=".npz", text="An .npz too, of all its touches."
        ),
    ] = None,
    sessions: Annotated[
        int,
        option(
            "Mountings: between them lift the sensor, place it again, and press Enter; "
            "the baseline is taken anew. Two or more teach what another day changes."
        ),
    ] = 1,
    changed: Annotated[
        str, option("What is new about this session, in words; kept with its name.")
    ] = "",
    session_name: Annotated[
        str | None,
        option(
            "--session",
            "Name of this session; where the library has it, its touches go on. "
            "Default: a new one.",
        ),
    ] = None,
    timeout: Patience = 120.0,
    summary: Summary = "peak",
    options: SensorOptions,
    as_json: AsJson = False,
) -> None:
    """Record touches of one object; each is on the disk as soon as it is counted."""
    from .._checks import check_count
    from ..web import LiveSession

    check_count("sessions", sessions)
    _check_touches(touches, sessions)
    name = LiveSession.check_name(name)  # as it is kept
    if session_name is not None and (sessions > 1 or changed):
        raise typer.BadParameter(
            "--session names one session: leave --sessions and --changed out."
        )
    chosen = options.open(sensor)
    with LiveSession(chosen, library=library, summary=summary) as session:
        need_baseline(session)
        assert session.teacher is not None
        session.teacher.begin_session(changed, session_name)
        n_taken = 0
        for number in range(sessions):
            share = touches // sessions + (number < touches % sessions)
            if number:
                _place_again(session)
            taken = _lesson(session, name, share, timeout)
            n_taken += taken
            if taken < share:
                break
        if output is not None and n_taken:
            session.teacher.touches(name).save(output)
    written = str(output) if output is not None and n_taken else None
    kept = {"library": str(library), "output": written}
    answer(
        as_json,
        {"object": name, "touches": n_taken, **kept},
        f"{counted(n_taken)} of {name} in {library}.",
    )
    if n_taken < touches:
        raise typer.Exit(1)


def record_touches(
    address: str,
    library: Path,
    name: str,
    touches: int,
    session_name: str | None,
) -> int:
    """Record touches of one object from a sensor; return how many there were."""
    from ..web import LiveSession

    _check_touches(touches)
    with LiveSession(SensorOptions().open(address), library=library) as session:
        need_baseline(session)
        assert session.teacher is not None
        session.teacher.begin_session("", session_name)
        return _lesson(session, " ".join(name.split()), touches, 120.0)


def _check_touches(touches: int, sessions: int = 1) -> None:
    """Refuse too few touches, or too many, before a library is made."""
    from .._checks import check_count
    from ..web import LiveSession

    check_count("touches", touches, at_most=LiveSession.most_per_lesson)
    if touches < sessions:
        raise ValueError(
            f"--touches must be at least one for each of {sessions} --sessions, got "
            f"{touches}. Ask for more."
        )


def _place_again(session: "LiveSession") -> None:
    from ..sensors import ContactError, SensorError

    say(
        "Lift the sensor and place it again: light first, let the camera settle, "
        "touch nothing. Then press Enter: the baseline is taken.",
        file=sys.stderr,
    )
    while sys.stdin.readline():
        try:
            session.take_baseline(changed="placed again")
        except (ContactError, SensorError) as error:
            say(f"{error} Then press Enter.", file=sys.stderr)
        else:
            return
    raise SensorError(
        "The sensor was not placed again: there is nobody to press Enter."
    )


def _lesson(session: "LiveSession", name: str, wanted: int, timeout_s: float) -> int:
    """Take touches until there are enough, none come, or Ctrl-C; return how many."""
    changed = threading.Event()
    session.listeners.add(
        lambda event: changed.set() if event.kind == "state" else None
    )
    session.teach(name, wanted)
    assert session.teacher is not None
    lesson = session.teacher.lesson
    shown = n_stored = 0
    say(f"Touch {name} {wanted} times.", file=sys.stderr)
    try:
        while lesson is not None and lesson.done < wanted:
            if not changed.wait(timeout_s):
                give_up(session, timeout_s)
                break
            changed.clear()  # before looking: what comes from now on is told again
            if has_trouble(session):
                break
            before, shown = shown, lesson.done
            if shown != before:
                say(f"  touch {shown} of {wanted}", file=sys.stderr)
            elif len(lesson.ids) > n_stored:
                say("  a touch without contact: it does not count", file=sys.stderr)
            n_stored = len(lesson.ids)
            if session.teacher.lesson is not lesson and lesson.done < wanted:
                say(session.to_dict()["message"], file=sys.stderr)  # why it is over
                break
    except KeyboardInterrupt:
        say("Ended; what was counted is kept.", file=sys.stderr)
    return 0 if lesson is None else lesson.done
