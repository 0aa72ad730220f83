"""`palpate live`: recognise what a live sensor touches, in the terminal."""

import queue
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._options import (
    AsJson,
    Deciding,
    MaxModelMb,
    ModelPath,
    grouped,
    model_file,
    option,
)
from ._output import answer, belief_line, say
from .sensor import (
    LogFile,
    Patience,
    Publish,
    SensorAddress,
    SensorOptions,
    Summary,
    check_publish,
    give_up,
    has_trouble,
    logged,
    need_baseline,
    published,
)

if TYPE_CHECKING:
    from ..web import LiveSession

Episode = dict[str, Any]


@grouped
def live(
    model: ModelPath,
    sensor: SensorAddress,
    *,
    touches: Annotated[int, option("-n", "--touches", "Most of an episode.")] = 30,
    episodes: Annotated[int, option("How many episodes; 0 goes on until Ctrl-C.")] = 1,
    timeout: Patience = 120.0,
    deciding: Deciding,
    summary: Summary = "peak",
    log: LogFile = None,
    publish: Publish = None,
    library: Annotated[
        Path | None,
        option("Folder for what --publish is told to teach; made if missing."),
    ] = None,
    options: SensorOptions,
    max_model_mb: MaxModelMb = 2000,
    as_json: AsJson = False,
) -> None:
    """Recognise touch by touch, live: an episode ends when the object is decided."""
    from .._checks import check_count
    from ..web import LiveSession

    check_count("touches", touches, at_most=LiveSession.longest_episode)
    check_count("episodes", episodes, at_least=0)
    done: list[Episode] = []  # filled for --json alone: without an end it would grow
    n_done = ended = 0
    check_publish(publish)
    chosen = options.open(sensor)
    session = LiveSession(
        chosen,
        model=model_file(model, library),
        library=library,
        summary=summary,
        **vars(deciding),
    )
    events: queue.Queue[dict[str, Any]] = queue.Queue()

    def listen(event: Any) -> None:
        if event.kind in ("touch", "state"):
            events.put(event.values)

    session.listeners.add(listen, frames=False)
    with logged(session, log), session, ExitStack() as stack:
        need_baseline(session)
        stack.enter_context(published(session, publish))
        try:
            while episodes == 0 or n_done < episodes:
                episode = _episode(
                    session, events, touches, timeout, ended, quiet=as_json
                )
                if episode is None:
                    break
                if as_json:
                    done.append(episode)
                if episode.get("open"):  # no more touches came
                    break
                n_done, ended = n_done + 1, episode["number"]
        except KeyboardInterrupt:
            say("Ended.", file=sys.stderr)
    answer(as_json, {"episodes": done})
    if n_done < max(episodes, 1) or session.trouble:
        raise typer.Exit(1)


def _episode(
    session: "LiveSession",
    events: "queue.Queue[dict[str, Any]]",
    most: int,
    timeout_s: float,
    ended: int,
    *,
    quiet: bool,
) -> Episode | None:
    """Follow the episode after number `ended` to its decision; None without a touch.

    It is still open where no more touches came.
    """
    if not quiet:
        say("Touch an object.")
    while (episode := _next_touch(session, events, timeout_s)) is not None:
        if episode["number"] <= ended:  # a touch that was on its way when it ended
            continue
        touch = episode["touches"][-1]
        if not quiet:
            about = (touch[n] for n in ("number", "posterior", "unknown", "note"))
            say(belief_line(*about), flush=True)
        if episode["decision"] is not None or touch["number"] >= most:
            if session.alarm:
                say(session.alarm, file=sys.stderr)
            if not quiet:
                say(f"  {episode['reason']}\n", flush=True)
            return session.end_episode()
    begun = session.episode
    if not begun.touches or begun.number <= ended:
        return None
    if not quiet:
        say(f"  {begun.sentence}\n", flush=True)
    return begun.to_dict()


def _next_touch(
    session: "LiveSession", events: "queue.Queue[dict[str, Any]]", timeout_s: float
) -> Episode | None:
    """Wait for a touch and return the episode; None, and why, where none is taken."""
    end_s = time.monotonic() + timeout_s
    while True:
        try:
            event = events.get(timeout=max(0.0, end_s - time.monotonic()))
        except queue.Empty:
            give_up(session, timeout_s)
            return None
        if "lesson" not in event:
            episode: Episode = event["episode"]
            return episode
        if has_trouble(session):
            return None
        if event["lesson"] or event.get("learning"):  # as a robot says over --publish
            end_s = time.monotonic() + timeout_s
