"""Pictures of the Corradi 2014 study: what touches look like, Table 2 and Fig. 3.

matplotlib is the extra `plot`, imported where it is used.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..evaluation import plots
from ._corradi2014_plan import CLASSIFIERS, VARIANTS, Corradi2014Plan
from ._corradi2014_touches import simulated_shapes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = dict[str, Any]
_TICKS = (1, 2, 5, 10, 30, 100, 1000)
COLOURS = ("#1b6ca8", "#d1730c", "#3f8f4f", "#8a5aa8")
SHAPES = ("corner", "cylinder", "edge", "flat", "flat-to-edge", "nothing", "point")


def draw_pictures(folder: str | Path, result: dict[str, Any]) -> list[Path]:
    """Write the pictures as `corradi2014-<name>.png` into an existing folder.

    Parameters
    ----------
    folder : path
    result : dict
        From `palpate.studies.run_study("corradi2014")`.
    """
    plots.require_matplotlib()
    written = []
    for name, figure in pictures(result).items():
        path = Path(folder) / f"corradi2014-{name}.png"
        figure.savefig(path, dpi=100)
        written.append(path)
    return written


def pictures(result: dict[str, Any]) -> dict[str, "Figure"]:
    """Return the figures "shapes", "table2" and "fig3"."""
    return {
        "shapes": shapes_figure(result["plan"]["seed"]),
        "table2": table_2_figure(result["rows"]),
        "fig3": fig_3_figure(result["rows"]),
    }


def shapes_figure(seed: int) -> "Figure":
    """Draw one touch of each shape and its derivative, by dome and by pins (Fig. 2)."""
    from matplotlib.figure import Figure

    sets = list(simulated_shapes(Corradi2014Plan(n_touches=10, seed=seed)))
    figure = Figure(figsize=(8.4, 5.0), layout="constrained")
    axes = figure.subplots(4, len(SHAPES))
    for number, (shapes, variant) in enumerate((s, v) for s in sets for v in VARIANTS):
        for code, name in enumerate(SHAPES):
            place = axes[number, code]
            row = int(np.flatnonzero(shapes.codes == code)[0])
            place.imshow(shapes.images[variant][row], cmap="gray")
            place.set_xticks([])
            place.set_yticks([])
            if number == 0:
                place.set_title(name, fontsize=8)
        kind = "pins" if shapes.data.endswith("pins") else "dome"
        axes[number, 0].set_ylabel(f"{kind}, {variant}", fontsize=8)
    return figure


def table_2_figure(rows: Sequence[Row]) -> "Figure":
    """Draw the Davies-Bouldin indices, the paper's as hollow marks."""
    from matplotlib.figure import Figure

    held = [row for row in rows if row["table"] == "Table 2" and row["q"] == 2]
    sets = _unique(row["data"] for row in held)
    figure = Figure(figsize=(3.2 * len(sets) + 1, 3.4), layout="constrained")
    axes = figure.subplots(1, len(sets), sharey=True, squeeze=False)[0]
    encodings = _unique(row["encoding"] for row in held)[::-1]
    for place, data in zip(axes, sets, strict=True):
        for variant, colour, lift in zip(
            VARIANTS, COLOURS, (0.12, -0.12), strict=False
        ):
            some = [r for r in held if (r["data"], r["variant"]) == (data, variant)]
            y = np.array([encodings.index(r["encoding"]) for r in some]) + lift
            place.plot([r["ours"] for r in some], y, "o", color=colour, label=variant)
            known = [
                (r["paper"], h) for r, h in zip(some, y, strict=True) if r["paper"]
            ]
            if known:
                label = f"{variant}, paper"
                place.plot(
                    *zip(*known, strict=True), "o", mec=colour, mfc="none", label=label
                )
        place.set_xscale("log")
        place.set_xticks(_TICKS, [f"{tick:g}" for tick in _TICKS])
        place.set_xticks([], minor=True)
        reach = [r["ours"] for r in held] + [r["paper"] for r in held if r["paper"]]
        place.set_xlim(0.8 * min(reach), 1.3 * max(reach))
        place.set_yticks(range(len(encodings)), encodings)
        place.set_title(data, fontsize=9)
        place.set_xlabel("Davies-Bouldin index")
        place.grid(axis="x", alpha=0.3)
        place.spines[["top", "right"]].set_visible(False)
    axes[0].legend(fontsize=7, frameon=False)
    return figure


def fig_3_figure(rows: Sequence[Row]) -> "Figure":
    """Draw accuracy of encodings and classifiers, one panel per data and variant."""
    from matplotlib.figure import Figure

    held = [row for row in rows if row["table"] == "Fig. 3"]
    sets = _unique(row["data"] for row in held)
    figure = Figure(figsize=(9.2, 2.5 * len(sets)), layout="constrained")
    axes = figure.subplots(len(sets), 2, sharex=True, sharey=True, squeeze=False)
    encodings = _unique(row["encoding"] for row in held)
    for line, data in zip(axes, sets, strict=True):
        for place, variant in zip(line, VARIANTS, strict=True):
            some = [r for r in held if (r["data"], r["variant"]) == (data, variant)]
            _bars(place, some, encodings)
            place.set_title(f"{data}, {variant}", fontsize=9)
        line[0].set_ylabel("right, %")
    axes[-1, 0].set_xticks(range(len(encodings)), encodings, rotation=25, fontsize=7)
    axes[-1, 1].tick_params(axis="x", rotation=25, labelsize=7)
    axes[0, 1].legend(fontsize=7, frameon=True, loc="lower right", ncols=2)
    return figure


def _bars(place: Any, some: Sequence[Row], encodings: Sequence[str]) -> None:
    """Randomised folds as bars, grouped folds as points."""
    width = 0.8 / len(CLASSIFIERS)
    for number, (kind, colour) in enumerate(zip(CLASSIFIERS, COLOURS, strict=True)):
        for folds in ("randomised", "grouped"):
            found = [r for r in some if (r["classifier"], r["folds"]) == (kind, folds)]
            x = [
                encodings.index(r["encoding"]) - 0.4 + (number + 0.5) * width
                for r in found
            ]
            height = [r["ours"] for r in found]
            if folds == "randomised":
                spread = [r["sd"] or 0.0 for r in found]
                place.bar(x, height, width, yerr=spread, color=colour, label=kind)
            else:
                last = number == len(CLASSIFIERS) - 1
                label = "grouped folds" if last else None
                place.plot(x, height, "_", color="black", ms=6, label=label)
    best = [r["paper"] for r in some if r["paper"] is not None]
    if best:
        place.axhline(best[0], color="gray", lw=0.8, ls=":")
    place.set_ylim(0, 101)
    place.grid(axis="y", alpha=0.3)
    place.spines[["top", "right"]].set_visible(False)


def _unique(values: Any) -> list[Any]:
    return list(dict.fromkeys(values))
