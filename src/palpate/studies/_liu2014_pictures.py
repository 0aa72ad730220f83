"""Pictures of the Liu 2014 study: clean-up, parts, and curves over load and cover.

matplotlib is the extra `plot`, imported where it is used.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..evaluation import plots
from ..images import stage_pictures
from ..simulation import find_parts
from ..touches import Touches
from ._liu2014_plan import Liu2014Plan
from ._liu2014_touches import simulated_presses
from ._recorded import labels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PRESSES_SHOWN = 5
STAGES_SHOWN = 3
LEVELS = "magma"
_CURVES = (
    ("FD+GE", "z-scored", "FD+GE, z-scored", plots.OURS, "o-"),
    ("FD+GE", "raw", "FD+GE, raw", plots.OURS, "o--"),
    ("sorted pixels", "z-scored", "sorted pixels", plots.CONTROLS[0], "s:"),
    ("raw pixels", "z-scored", "raw pixels", plots.CONTROLS[3], "s:"),
)


def draw_pictures(folder: str | Path, result: dict[str, Any]) -> list[Path]:
    """Write the pictures as `liu2014-<name>.png` into an existing folder.

    Parameters
    ----------
    folder : path
    result : dict
        From `palpate.studies.run_study("liu2014")`.
    """
    plots.require_matplotlib()
    written = []
    for name, figure in pictures(result).items():
        path = Path(folder) / f"liu2014-{name}.png"
        figure.savefig(path, dpi=100)
        written.append(path)
    return written


def pictures(result: dict[str, Any]) -> dict[str, "Figure"]:
    """Return the figures "stages", "parts" and "conditions"."""
    touches = simulated_presses(Liu2014Plan(**result["plan"]))
    return {
        "stages": stages_figure(touches),
        "parts": parts_figure(touches),
        "conditions": conditions_figure(result["rows"]),
    }


def stages_figure(touches: Touches) -> "Figure":
    """Draw every stage of the clean-up of one press of a few parts (Fig. 10)."""
    names = list(dict.fromkeys(labels(touches).tolist()))
    spaced = np.linspace(0, len(names) - 1, min(STAGES_SHOWN, len(names)))
    shown = [names[i] for i in spaced.round().astype(int)]
    rows = [int(np.flatnonzero(touches.object == name)[0]) for name in shown]
    chains = [stage_pictures(touches.images[row]) for row in rows]
    stages = [stage for stage in chains[0] if stage != "filled"]
    figure, axes = _grid(len(rows), len(stages), 1.15)
    for line, (name, chain) in enumerate(zip(shown, chains, strict=True)):
        axes[line, 0].set_ylabel(name, fontsize=7)
        for place, stage in zip(axes[line], stages, strict=True):
            colours = "gray" if stage.startswith("binary") else LEVELS
            place.imshow(chain[stage], cmap=colours, interpolation="nearest")
            if line == 0:
                place.set_title(stage, fontsize=8)
    return figure


def parts_figure(touches: Touches) -> "Figure":
    """Draw a few presses of every part, the part's outline over its taxels."""
    names = list(dict.fromkeys(labels(touches).tolist()))
    half = -(-len(names) // 2)
    figure, axes = _grid(half, 2 * PRESSES_SHOWN, 0.95)
    for place in axes.ravel():
        place.axis("off")
    for number, name in enumerate(names):
        rows = np.flatnonzero(touches.object == name)[:PRESSES_SHOWN]
        start = PRESSES_SHOWN * (number // half)
        for column, row in enumerate(rows):
            place = axes[number % half, start + column]
            place.imshow(touches.images[row], cmap=LEVELS, interpolation="nearest")
            _outline(place, touches, row)
            if column == 0:
                place.set_title(name, fontsize=8, loc="left")
    return figure


def conditions_figure(rows: Sequence[dict[str, Any]]) -> "Figure":
    """Draw accuracy, overlap and pieces against load and against cover."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 5.2), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    panels = (("Fig. 5", "load_kgf", "load, kgf"), ("Fig. 6", "cover_mm", "cover, mm"))
    for column, (table, key, label) in enumerate(panels):
        held = [row for row in rows if row["table"] == table]
        _accuracy(axes[0, column], held, key)
        _images(axes[1, column], held, key)
        axes[1, column].set_xlabel(label)
    axes[0, 0].set_ylabel("3-NN right, %")
    axes[1, 0].set_ylabel("presses or pixels, %")
    for place in axes.ravel():
        place.spines[["top", "right"]].set_visible(False)
        place.set_ylim(0, 101)
    for line in (0, 1):
        axes[line, 1].legend(frameon=False, fontsize=7, loc="best")
    return figure


def _accuracy(place: Any, held: Sequence[dict[str, Any]], key: str) -> None:
    for encoding, scaling, label, colour, style in _CURVES:
        found = [
            r for r in held if (r["encoding"], r["features"]) == (encoding, scaling)
        ]
        place.errorbar(
            [row[key] for row in found],
            [row["ours"] for row in found],
            yerr=[row["sd"] or 0.0 for row in found],
            fmt=style,
            color=colour,
            ms=4,
            lw=1.3,
            capsize=2,
            label=label,
        )


def _images(place: Any, held: Sequence[dict[str, Any]], key: str) -> None:
    some = [row for row in held if row["encoding"] == "FD+GE"]
    lines = (
        ("in_pieces", "presses in several pieces", plots.CONTROLS[0], "o-"),
        ("overlap", "overlap with the true face", plots.OURS, "o-"),
    )
    for entry, label, colour, style in lines:
        points = dict.fromkeys((row[key], row[entry]) for row in some)
        place.plot(
            *zip(*points, strict=True), style, color=colour, ms=4, lw=1.3, label=label
        )


def _outline(place: Any, touches: Touches, row: int) -> None:
    """Draw the part's edges where it really lay; clipped at the array's edge."""
    n_rows, n_cols = touches.images.shape[1:]
    pitch = float(touches.whole["set_pitch_mm"])
    (part,) = find_parts(int(touches.columns["part"][row]))
    x, y = touches.columns["position_mm"][row].tolist()
    for loop in part.placed(x, y, float(touches.columns["angle_deg"][row])):
        closed = np.vstack([loop, loop[:1]]) / pitch
        place.plot(
            closed[:, 0] + (n_cols - 1) / 2,
            closed[:, 1] + (n_rows - 1) / 2,
            color="white",
            lw=0.7,
        )
    place.set_xlim(-0.5, n_cols - 0.5)
    place.set_ylim(n_rows - 0.5, -0.5)


def _grid(n_rows: int, n_columns: int, side: float) -> tuple["Figure", Any]:
    from matplotlib.figure import Figure

    figure = Figure(
        figsize=(side * n_columns, side * n_rows + 0.3), layout="constrained"
    )
    axes = figure.subplots(n_rows, n_columns, squeeze=False)
    for place in axes.ravel():
        place.set_xticks([])
        place.set_yticks([])
    return figure, axes
