"""`palpate live`: recognise what a live sensor touches, in the terminal."""

import queue
import sys
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._live_options import (
    Baud,
    Checksum,
    ErrorRate,
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
from ._options import AsJson, ModelPath, NamePattern, NoContact
from ._output import belief_line, print_json

if TYPE_CHECKING:
    from ..web import LiveSession


def live(
    model: ModelPath,
    sensor: SensorSpec,
    touches: Annotated[
        int, typer.Option("-n", "--touches", help="Most touches of an episode.")
    ] = 30,
    episodes: Annotated[
        int,
        typer.Option("--episodes", help="How many episodes; 0 goes on until Ctrl-C."),
    ] = 1,
    timeout: Annotated[
        float, typer.Option("--timeout", help="Give up after so long without a touch.")
    ] = 120.0,
    error: ErrorRate = 0.01,
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
    """Recognise touch by touch, live: an episode ends when the object is decided."""
    from ..web import LiveSession

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
    done: list[dict[str, Any]] = []
    session = LiveSession(chosen, model=model, error=error, summary=summary)
    found: queue.Queue[dict[str, Any]] = queue.Queue()
    session.listeners.add(
        lambda event: (
            found.put(event.values) if event.kind in ("touch", "state") else None
        )
    )
    with session:
        if session.baseline is None:
            print("Leave the sensor alone: taking its baseline.", file=sys.stderr)
            session.take_baseline()
        try:
            while episodes == 0 or len(done) < episodes:
                told = _episode(session, found, touches, timeout, quiet=as_json)
                if told is None:
                    break
                done.append(told)
        except KeyboardInterrupt:
            print("Ended.", file=sys.stderr)
    if as_json:
        print_json({"episodes": done})
    if not done or session.trouble:
        raise typer.Exit(1)


def _episode(
    session: "LiveSession",
    found: "queue.Queue[dict[str, Any]]",
    most: int,
    timeout_s: float,
    *,
    quiet: bool,
) -> dict[str, Any] | None:
    """Follow one episode to its decision; None where no touch comes."""
    if not quiet:
        print("Touch an object.")
    while True:
        told = _next_touch(session, found, timeout_s)
        if told is None:
            return None
        touch = told["touches"][-1]
        if not quiet:
            print(belief_line(touch["number"], touch["posterior"]), flush=True)
        if told["decision"] is not None or touch["number"] >= most:
            if not quiet:
                print(f"  {told['reason']}\n", flush=True)
            return session.end_episode()


def _next_touch(
    session: "LiveSession", found: "queue.Queue[dict[str, Any]]", timeout_s: float
) -> dict[str, Any] | None:
    """Wait for a touch and return the episode; None, and why, where none is taken."""
    end_s = time.monotonic() + timeout_s
    while True:
        try:
            told = found.get(timeout=max(0.0, end_s - time.monotonic()))
        except queue.Empty:
            print(f"No touch in {timeout_s:g} s: ended.", file=sys.stderr)
            return None
        if "lesson" not in told:
            episode: dict[str, Any] = told["episode"]
            return episode
        if session.trouble:
            print(f"palpate: {session.trouble}", file=sys.stderr)
            return None
