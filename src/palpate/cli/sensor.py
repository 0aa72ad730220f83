"""`palpate sensor`, and what the verbs with a live sensor share: options, baseline."""

import re
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._options import (
    AsJson,
    Calibration,
    MaxModelMb,
    ModelOutput,
    ModelPath,
    NamePattern,
    NoContact,
    Page,
    Reading,
    TouchesPath,
    flag,
    grouped,
    option,
)
from ._output import answer, printable, say, stages

if TYPE_CHECKING:
    from ..sensors import Frame, LiveSensor
    from ..web import LiveSession

_MOST_SIDE = 160
sensor = typer.Typer(no_args_is_help=True, help="What a sensor does to touches.")
ADDRESS = (
    "camera:NAME, serial:PORT, ros:TOPIC, replay:PATH or sim:OBJECT, with options as "
    "in 'camera:USB Camera?shape=480x640&rate=30'."
)
SensorAddress = Annotated[str, option("--sensor", ADDRESS)]
Summary = Annotated[
    str,
    option(
        "--summary",
        'What stands for a touch: "peak", the frame of greatest change, or '
        '"mean" over the hold.',
    ),
]
_LONGEST_S = 1e9  # threads cannot wait for ever; 30 years can be asked for


def _checked_patience(seconds: float) -> float:
    from .._checks import check_number

    return check_number("timeout", seconds, low=0.0, high=_LONGEST_S)


Patience = Annotated[
    float,
    option(
        "--timeout",
        "Give up after so long without a touch.",
        callback=_checked_patience,
    ),
]
LogFile = Annotated[
    str | None,
    option(
        "--log",
        "Write frames, touches, beliefs to a file (.rrd, .mcap), or show them to a "
        "running Foxglove: ws://127.0.0.1:8766 (plugs/look).",
    ),
]
Publish = Annotated[
    str | None,
    option(
        "--publish",
        "Publish beliefs on ROS 2 and take commands there: "
        "'ros:/palpate?domain=0&via=dds'.",
    ),
]


@dataclass(frozen=True)
class SensorOptions:
    """Options of a sensor beside its address, named as the sensor names them."""

    image_shape: Annotated[
        str | None,
        option("--shape", "Rows x columns: 480x640, 16x16; of an array auto."),
    ] = None
    rate_hz: Annotated[float | None, option("--rate", "Frames per second.")] = None
    colour: Annotated[
        bool | None, flag("--colour", "Read a camera in red, green and blue.")
    ] = None
    baud: Annotated[int | None, option("Bits per second of a serial port.")] = None
    framing: Annotated[str | None, option('An array: "line" or "binary".')] = None
    checksum: Annotated[
        bool | None,
        flag("--checksum/--no-checksum", "Refuse serial lines without a checksum."),
    ] = None
    hold: Annotated[int | None, option("Frames a played touch is held.")] = None
    gap: Annotated[int | None, option("Frames of nothing between two such.")] = None
    place: Annotated[str | None, option("What lies there to be played first.")] = None
    name_pattern: NamePattern = None
    no_contact: NoContact = None
    calibration: Calibration = None

    def open(self, address: str) -> "LiveSensor":
        """Return the sensor at an address; it is not connected yet."""
        from ..sensors import AddressError, SensorError, open_sensor
        from ..touches import TouchesError

        settings = {**vars(self)}
        if self.calibration is not None:
            from ..images import TaxelCalibration

            settings["calibration"] = TaxelCalibration.load(self.calibration)
        try:
            return open_sensor(address, **settings)
        except AddressError as error:
            raise typer.BadParameter(str(error)) from error
        except SensorError as error:
            folder = address.partition(":")[2].partition("?")[0].replace("%3F", "?")
            # Of a replay that can be read nothing is wrong with the pictures.
            is_read = not isinstance(error.__cause__, TouchesError)
            if is_read or not (address.startswith("replay:") and Path(folder).is_dir()):
                raise
            raise SensorError(
                f"{error} `palpate check {quote(folder)}` lists all that is wrong."
            ) from error


def need_baseline(session: "LiveSession") -> None:
    """Take the frame of no contact where the sensor does not know it."""
    from ..sensors import ContactError

    if session.watch is not None and session.watch.sensor.unfixed:
        say(session.watch.sensor.unfixed, file=sys.stderr)
    if session.baseline is None:
        say("Leave the sensor alone: taking its baseline.", file=sys.stderr)
        try:
            session.take_baseline()
        except ContactError as error:
            question = printable(f"{error} Does nothing touch it?")
            if not sys.stdin.isatty() or not typer.confirm(question, err=True):
                raise
            session.take_baseline(force=True)


def has_trouble(session: "LiveSession") -> bool:
    """Say what was wrong with the last touch; tell whether there is no use in more."""
    from ..web import LiveSession

    if session.trouble:
        say(f"palpate: {session.trouble}", file=sys.stderr)
    return session.trouble not in ("", LiveSession.began_before)


def give_up(session: "LiveSession", timeout_s: float) -> None:
    """Say that no touch came, and what hinders the sensor, if it is known."""
    state = {} if session.watch is None else session.watch.to_dict()
    if lost := state.get("lost"):
        say(f"No touch in {timeout_s:g} s: ended. {lost}", file=sys.stderr)
        return
    why = state.get("offer", "")
    if state.get("touching") and not why:  # as while it drifts on
        why = (
            "A touch has not ended: if nothing touches the sensor, its rest has moved."
        )
    more = f" {why} Starting again takes the baseline." if why else ""
    say(f"No touch in {timeout_s:g} s: ended.{more}", file=sys.stderr)


@contextmanager
def published(session: "LiveSession", address: str | None) -> Iterator[None]:
    """Publish the beliefs of a session, and let it be told what to do, on ROS 2."""
    if address is None:
        yield
        return
    with closing(session.publish(address)):
        yield


def check_publish(address: str | None) -> None:
    """Refuse an address of --publish that is none, before anything is started."""
    from ..sensors import AddressError, ros_place

    try:
        _ = address and ros_place(address)
    except AddressError as error:
        raise typer.BadParameter(f"--publish: {error}") from error


@contextmanager
def logged(
    session: "LiveSession", place: str | Path | None, number: int = 0
) -> Iterator[None]:
    """Let what a package has for the file's ending take the events of a session.

    Entry points of the group `palpate.logs`, such as `rrd`, are called with the path,
    `ws` with an address; what they return has `take(event)` and `close()`. Of several
    sensors each has a `number`, and a file that ends in it, or the next port.
    """
    from importlib.metadata import entry_points

    if place is None:
        yield
        return
    path, served = Path(place), re.fullmatch(r"(ws://.*:)(\d+)", str(place))
    name = "ws" if served else path.suffix[1:].lower()
    plugged = [*entry_points(group="palpate.logs", name=name)]
    if not plugged:
        raise typer.BadParameter(
            "--log must end in .rrd or .mcap or be ws://HOST:PORT, and what writes "
            f"these be installed (plugs/look), got {path.name!r}."
        )
    path = path.with_stem(f"{path.stem}-{number}") if number else path
    port = served and f"{served[1]}{int(served[2]) + max(0, number - 1)}"
    with closing(plugged[0].load()(port or path)) as log:
        session.listeners.add(log.take)
        yield


@sensor.command("check")
@grouped
def check(
    sensor: SensorAddress,
    *,
    seconds: Annotated[float, option("How long; drift asks for minutes.")] = 60.0,
    model: Annotated[Path | None, option("A model that remembers its rest.")] = None,
    report: Page = None,
    options: SensorOptions,
    max_model_mb: MaxModelMb = 2000,
    as_json: AsJson = False,
) -> None:
    """Watch a sensor that nothing touches: noise, dead taxels, drift, frame rate.

    Exit code 1 where something is found.
    """
    from .._checks import check_positive, size_text
    from .._durable import write_text
    from ..recognition import ObjectRecogniser
    from ..sensors import SensorMemory, sensor_health

    check_positive("seconds", seconds)
    memory = None
    if model is not None:
        stored = ObjectRecogniser.load(model).memory_.sensor
        if stored is None:
            raise ValueError(
                f"{model} must remember its sensor's baseline, got a model without. "
                "Learn it from a library that was recorded with one."
            )
        memory = SensorMemory.from_dict(stored)
    with options.open(sensor) as live:
        step = -(-max(live.image_shape[:2]) // _MOST_SIDE)
        if memory is not None and memory.no_contact.shape != live.image_shape:
            raise ValueError(
                f"{model} must be of images of {size_text(live.image_shape)}, which "
                f"{live.name} gives, got one of {size_text(memory.no_contact.shape)}. "
                "Give the model of this sensor."
            )
        if memory is not None:
            memory = replace(memory, no_contact=memory.no_contact[::step, ::step])
        health = sensor_health(_frames(live, seconds, step), live.step, memory)
        health |= {"sensor": live.name, "unit": live.unit, "seconds": seconds}
        channels = live.channels
    maps = {name: health.pop(name) for name in ("rest", "noise")}
    if report is not None:
        write_text(report, _page(health, maps, channels))
    findings = health["findings"] or ["Nothing is wrong."]
    figures = (f"{name:20s} {value}" for name, value in _figures(health))
    answer(as_json, health, *findings, "", *figures)
    if not health["ok"]:
        raise typer.Exit(1)


@sensor.command("learn-nuisance")
@grouped
def learn_nuisance(
    model: ModelPath,
    touches: TouchesPath,
    output: ModelOutput,
    *,
    reading: Reading,
    max_model_mb: MaxModelMb = 2000,
    as_json: AsJson = False,
) -> None:
    """Learn from any objects met in several sessions what tells sessions apart.

    MODEL need not know the objects of TOUCHES, only the sensor: what differs between
    their sessions is weighed down in the model that is written.
    """
    with stages() as stage:
        recogniser, met = reading.with_model(model, touches, stage)
        stage(f"learning from {len(met)} touches")
        n_differences = recogniser.learn_nuisance(met)
        written = recogniser.save(output)
    values = {"model": str(written), "n_differences": n_differences}
    answer(as_json, values, f"{n_differences} differences are weighed down.", written)


def _frames(sensor: "LiveSensor", seconds: float, step: int) -> list["Frame"]:
    end_s, frames = time.monotonic() + seconds, []
    while time.monotonic() < end_s:
        frame = sensor.read_next()
        frames.append(replace(frame, image=frame.image[::step, ::step].copy()))
    return frames


def _page(
    health: dict[str, Any], maps: dict[str, Any], channels: Sequence[str] | None
) -> str:
    import numpy as np

    from .._page import as_shown, html_table, png_address, report_page, worded

    findings = health["findings"] or ["Nothing is wrong."]
    lines = "".join(
        f"<p style='font-size:1.15rem'>{worded(line)}</p>" for line in findings
    )
    pictures = ""
    for name, image in maps.items():
        shown = as_shown(image[None], channels)[0]
        levels = "nothing but NaN"
        if not np.isnan(image).all():
            levels = f"{np.nanmin(image):.3g} (dark) to {np.nanmax(image):.3g}"
        pictures += (
            f"<figure style='margin:0'><img alt='{name} of each taxel' width=240 "
            f"style='image-rendering:pixelated' src='{png_address(shown, 240)}'>"
            f"<figcaption class=note>{name}, {levels}</figcaption></figure>"
        )
    title = f"{health['sensor']}: {'well' if health['ok'] else 'look at it'}"
    colour = "#1d7a46" if health["ok"] else "#b3261e"
    watched = f"Watched for {health['seconds']:g} s; in {escape(health['unit'])}."
    head = (
        f"<h1 style='border-left:.5rem solid {colour};padding-left:.8rem'>"
        f"{escape(title)}</h1>{lines}<p class=note>{watched}</p>"
        f"<div class=row>{pictures}</div>"
        "<h2>Mean level over time, and the drift that does harm</h2>"
    )
    curve = _curve(health["levels"], health["figures"]["drift_limit"])
    figures = html_table("Figures", ["", ""], _figures(health))
    return report_page(title, [head, curve, figures])


def _figures(health: dict[str, Any]) -> list[list[str]]:
    rows = []
    for name, value in health["figures"].items():
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        rows.append([name.replace("_", " "), "-" if value is None else text])
    return rows


def _curve(levels: list[float], limit: float) -> str:
    """Draw levels over time, and the limits at a third of the height."""
    most = max(1.5 * limit, *(1.2 * abs(level) for level in levels))
    ys = [50 - 50 * level / most for level in (*levels, limit, -limit)]
    points = " ".join(f"{40 * i},{y:.1f}" for i, y in enumerate(ys[:-2]))
    limits = "".join(f"M0 {y:.1f}H480" for y in ys[-2:])
    return (
        "<svg viewBox='0 0 480 100' width=480 role=img aria-label='level over time'>"
        f"<path d='{limits}' stroke='#b3261e' stroke-dasharray=4 /><polyline "
        f"points='{points}' fill=none stroke='#1f4e79' stroke-width=2 /></svg>"
    )
