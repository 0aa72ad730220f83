"""`palpate sensor check`: a page of health of a sensor that nothing touches."""

import time
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._options import AsJson, MaxModelMb, Report, grouped, option
from ._output import answer
from ._sensor import SensorAddress, SensorOptions

if TYPE_CHECKING:
    from ..sensors import Frame, LiveSensor

_MOST_SIDE = 160


@grouped
def sensor_check(
    sensor: SensorAddress,
    *,
    seconds: Annotated[float, option("How long; drift asks for minutes.")] = 60.0,
    model: Annotated[Path | None, option("A model that remembers its rest.")] = None,
    report: Report = None,
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
        step = -(-max(live.image_shape[:2]) // _MOST_SIDE)
        if memory is not None:
            memory = replace(memory, no_contact=memory.no_contact[::step, ::step])
        health = sensor_health(_frames(live, seconds, step), live.step, memory)
        health |= {"sensor": live.name, "unit": live.unit, "seconds": seconds}
    maps = {name: health.pop(name) for name in ("rest", "noise")}
    if report is not None:
        write_text(report, _page(health, maps))
    findings = health["findings"] or ["Nothing is wrong."]
    figures = (f"{name:20s} {value}" for name, value in _figures(health))
    answer(as_json, health, *findings, "", *figures)
    if not health["ok"]:
        raise typer.Exit(1)


def _frames(sensor: "LiveSensor", seconds: float, step: int) -> list["Frame"]:
    end_s, frames = time.monotonic() + seconds, []
    while time.monotonic() < end_s:
        frame = sensor.read_next()
        frames.append(replace(frame, image=frame.image[::step, ::step].copy()))
    return frames


def _page(health: dict[str, Any], maps: dict[str, Any]) -> str:
    from ..evaluation import html_table, report_page
    from ..touches import as_shown, png_address

    findings = health["findings"] or ["Nothing is wrong."]
    lines = "".join(
        f"<p style='font-size:1.15rem'>{escape(line)}</p>" for line in findings
    )
    pictures = ""
    for name, image in maps.items():
        shown = as_shown(image[None], ("r", "g", "b") if image.ndim == 3 else None)[0]
        pictures += (
            f"<figure style='margin:0'><img alt='{name} of each taxel' width=240 "
            f"style='image-rendering:pixelated' src='{png_address(shown, 240)}'>"
            f"<figcaption class=note>{name}, {image.min():.3g} (dark) to "
            f"{image.max():.3g}</figcaption></figure>"
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
    shown = {n: "-" if v is None else f"{v:.4g}" for n, v in health["figures"].items()}
    return [[name.replace("_", " "), text] for name, text in shown.items()]


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
