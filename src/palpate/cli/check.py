"""`palpate sensor check`: a page of health of a sensor that nothing touches."""

import time
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._options import AsJson, MaxModelMb, grouped, option
from ._output import answer
from ._sensor import SensorAddress, SensorOptions

if TYPE_CHECKING:
    from ..sensors import Frame, LiveSensor

_WIDTH, _HEIGHT, _MOST_SIDE = 480, 90, 160
_SAID = {
    "frames": "frames",
    "rate_hz": "frames a second",
    "interval_99_ms": "longest gap of 100 (ms)",
    "lost": "share of frames lost",
    "noise": "noise of a taxel (median)",
    "drift": "drift of rest",
    "drift_limit": "drift that does harm",
    "shared_by_rows": "noise shared by rows",
    "shared_by_columns": "noise shared by columns",
}


@grouped
def check(
    sensor: SensorAddress,
    *,
    seconds: Annotated[
        float, option("How long to watch; drift asks for minutes.")
    ] = 60.0,
    model: Annotated[
        Path | None, option("Compare rest with what this model remembers of it.")
    ] = None,
    report: Annotated[Path | None, option("Write one self-contained .html.")] = None,
    options: SensorOptions,
    max_model_mb: MaxModelMb = 2000,
    as_json: AsJson = False,
) -> None:
    """Watch a sensor that nothing touches: noise, dead taxels, drift, frame rate.

    Exit code 1 where something is found.
    """
    from .._checks import check_positive
    from .._durable import write_text
    from ..recognition import ObjectRecogniser
    from ..sensors import SensorMemory, sensor_health

    check_positive("seconds", seconds)
    if report is not None and report.suffix != ".html":
        raise typer.BadParameter(f"--report must end in .html, got {report.name!r}.")
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
        apart = -(-max(live.image_shape[:2]) // _MOST_SIDE)
        if memory is not None:
            memory = replace(memory, no_contact=memory.no_contact[::apart, ::apart])
        found = sensor_health(_frames(live, seconds, apart), live.step, memory)
        found |= {"sensor": live.name, "unit": live.unit, "seconds": seconds}
    maps = {name: found.pop(name) for name in ("rest", "noise")}
    if report is not None:
        write_text(report, _page(found, maps))
    said = found["findings"] or ["Nothing is wrong."]
    figures = [f"{_SAID[n]:26s} {_shown(v)}" for n, v in found["figures"].items()]
    answer(as_json, found, *said, "", *figures)
    if not found["ok"]:
        raise typer.Exit(1)


def _frames(sensor: "LiveSensor", seconds: float, apart: int) -> list["Frame"]:
    """Return the frames of some seconds, pixels so far apart."""
    end_s, frames = time.monotonic() + seconds, []
    while time.monotonic() < end_s:
        frame = sensor.read_next()
        frames.append(replace(frame, image=frame.image[::apart, ::apart].copy()))
    return frames


def _page(found: dict[str, Any], maps: dict[str, Any]) -> str:
    from ..evaluation import html_table, report_page
    from ..touches import as_shown, png_address

    colour = "#1d7a46" if found["ok"] else "#b3261e"
    said = found["findings"] or ["Nothing is wrong."]
    lines = "".join(f"<p style='font-size:1.15rem'>{escape(line)}</p>" for line in said)
    pictures = ""
    for name, image in maps.items():
        shown = as_shown(image[None], ("r", "g", "b") if image.ndim == 3 else None)[0]
        pictures += (
            f"<figure style='margin:0'><img alt='{name} of each taxel' width=240 "
            f"style='image-rendering:pixelated' src='{png_address(shown, 240)}'>"
            f"<figcaption class=note>{name}, {image.min():.3g} (dark) to "
            f"{image.max():.3g}</figcaption></figure>"
        )
    rows = [[_SAID[n], _shown(value)] for n, value in found["figures"].items()]
    title = f"{found['sensor']}: {'well' if found['ok'] else 'look at it'}"
    above = f"border-left:.5rem solid {colour};padding-left:.8rem"
    watched = f"Watched for {found['seconds']:g} s; in {escape(found['unit'])}."
    sections = [
        f"<h1 style='{above}'>{escape(title)}</h1>{lines}",
        f"<p class=note>{watched}</p>",
        f"<div class=row>{pictures}</div>",
        "<h2>Mean level over time, and the drift that does harm</h2>",
        _curve(found["levels"], found["figures"]["drift_limit"]),
        html_table("Figures", ["", ""], rows),
    ]
    return report_page(title, sections)


def _curve(levels: list[float], limit: float) -> str:
    """Draw levels over time between the limits."""
    most = 1.2 * max(limit, *map(abs, levels))

    def y(level: float) -> float:
        return _HEIGHT / 2 * (1 - level / most)

    across = _WIDTH / (len(levels) - 1)
    points = " ".join(f"{i * across:.1f},{y(v):.1f}" for i, v in enumerate(levels))
    lines = "".join(
        f"<line x1=0 x2={_WIDTH} y1={y(v):.1f} y2={y(v):.1f} stroke='#b3261e' "
        "stroke-dasharray=4 />"
        for v in (limit, -limit)
    )
    return (
        f"<svg viewBox='0 0 {_WIDTH} {_HEIGHT}' width={_WIDTH} role=img aria-label="
        f"'mean level over time'>{lines}<polyline points='{points}' fill=none "
        "stroke='#1f4e79' stroke-width=2 /></svg>"
    )


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}" if value < 1000 else f"{value:.0f}"
