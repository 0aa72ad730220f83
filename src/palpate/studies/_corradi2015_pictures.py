"""Pictures of the Corradi 2015 study: accuracy, confusion, objects never learnt.

matplotlib is the extra `plot`, imported where it is used.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..evaluation import plots
from ._corradi2015_plan import LATER_CATEGORY, LATER_OBJECTS, PAPER
from ._corradi2015_tables import DATA_NAMES
from ._corradi2015_tasks import CLUSTERS, DEFAULT, FLOORED, MAIN

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PURPLE, _GREY, _BROWN, _OLIVE = (plots.CONTROLS[i] for i in (2, 3, 0, 1))
# Recogniser -> colour and line; mixtures share one colour.
_STYLES: dict[str, tuple[str, str, float]] = {
    DEFAULT: (plots.OURS, "-", 2.2),
    MAIN: (plots.INK, "-", 2.2),
    FLOORED: (plots.INK, "--", 1.2),
    CLUSTERS: (_PURPLE, "-", 1.2),
    "mixtures of 1": (_OLIVE, "-", 1.2),
    "mixtures of 2": (_OLIVE, "--", 1.2),
    "mixtures of 4": (_OLIVE, ":", 1.2),
    "bag, Fourier": (_GREY, "-", 1.2),
    "bag, moments": (_GREY, "--", 1.2),
    "disc centre": (_BROWN, ":", 1.2),
    "brightness": (_BROWN, "--", 1.2),
}
_SPREAD = (MAIN, DEFAULT)


def draw_pictures(folder: str | Path, result: dict[str, Any]) -> list[Path]:
    """Write the pictures as `corradi2015-<name>.png` into an existing folder."""
    plots.require_matplotlib()
    written = []
    for name, figure in pictures(result).items():
        path = Path(folder) / f"corradi2015-{name}.png"
        figure.savefig(path, dpi=100)
        written.append(path)
    return written


def pictures(result: dict[str, Any]) -> dict[str, "Figure"]:
    """Return the figures "accuracy", "confusion", "unseen" and, if run, "later"."""
    drawn = {
        "accuracy": accuracy_figure(result["rows"]),
        "confusion": confusion_figure(result["confusion"]),
        "unseen": unseen_figure(result),
    }
    if any(row["table"] == "category" for row in result["rows"]):
        drawn["later"] = later_figure(result["rows"])
    return drawn


def accuracy_figure(rows: Sequence[dict[str, Any]]) -> "Figure":
    """Draw accuracy against touches of the ten objects, one panel per data."""
    held = [row for row in rows if row["table"] == "ten objects"]
    names = list(dict.fromkeys(row["data"] for row in held))
    figure, axes = _panels(1, len(names), 4.4, 4.6)
    for place, data in zip(axes[0], names, strict=True):
        _curves(place, [row for row in held if row["data"] == data], PAPER)
        place.set_title(f"{DATA_NAMES[data]} touches", fontsize=9)
    axes[0, 0].set_ylabel("right, %")
    _legend(figure, axes[0, -1])
    return figure


def later_figure(rows: Sequence[dict[str, Any]]) -> "Figure":
    """Draw all objects, and categories of unseen ones, beside the author's figures."""
    figure, axes = _panels(1, 2, 4.4, 4.2)
    panels = (
        ("all objects", LATER_OBJECTS, "all recorded objects"),
        ("category", LATER_CATEGORY, "category of objects never touched"),
    )
    for place, (experiment, figures, title) in zip(axes[0], panels, strict=True):
        _curves(place, [row for row in rows if row["table"] == experiment], figures)
        place.set_title(title, fontsize=9)
    axes[0, 0].set_ylabel("right, %")
    _legend(figure, axes[0, 0])
    return figure


def confusion_figure(confusion: dict[str, Any]) -> "Figure":
    """Draw the confusion matrices of each data after a few and after more touches."""
    after = max((list(found["after"]) for found in confusion.values()), key=len)
    figure, axes = _panels(len(confusion), len(after), 4.5, 4.2)
    for line, (data, found) in zip(axes, confusion.items(), strict=True):
        names = [name.replace("_", " ") for name in found["names"]]
        for place, (k, matrix) in zip(line, found["after"].items(), strict=True):
            _matrix(place, 100 * np.array(matrix), names)
            place.set_title(f"{DATA_NAMES[data]}, after {k} touches", fontsize=9)
    return figure


def unseen_figure(result: dict[str, Any]) -> "Figure":
    """Draw the mean belief in the known objects against touches of unseen ones."""
    found = {data: one[MAIN] for data, one in result["unseen"].items()}
    columns = max(len(curves) for curves in found.values())
    figure, axes = _panels(len(found), columns, 2.5, 2.7)
    for line, (data, curves) in zip(axes, found.items(), strict=True):
        names = result["confusion"][data]["names"]
        for place, (thing, curve) in zip(line, curves.items(), strict=False):
            _beliefs(place, 100 * np.array(curve), names)
            place.set_title(thing.replace("_", " "), fontsize=8)
        line[0].set_ylabel(f"{DATA_NAMES[data]}: belief, %")
    for place in axes[-1]:
        place.set_xlabel("touches")
    return figure


def _curves(
    place: Any, held: Sequence[dict[str, Any]], figures: dict[int, float]
) -> None:
    for name, (colour, line, width) in _STYLES.items():
        found = [row for row in held if row["recogniser"] == name]
        if not found:
            continue
        touches = [row["touches"] for row in found]
        mean = np.array([row["ours"] for row in found])
        place.plot(touches, mean, line, color=colour, lw=width, label=name)
        if name in _SPREAD:
            sd = np.array([row["sd"] or 0.0 for row in found])
            low, high = np.clip(mean - sd, 0, 100), np.clip(mean + sd, 0, 100)
            place.fill_between(touches, low, high, color=colour, alpha=0.12, lw=0)
    known = dict(figures)
    place.plot(
        list(known), list(known.values()), "D", color="#c0392b", ms=6, label="published"
    )
    most = max((row["touches"] for row in held), default=1)
    ticks = [1, *range(5, most + 1, 5)]
    place.set(xlabel="touches", ylim=(0, 101), xticks=ticks)


def _matrix(place: Any, shares: np.ndarray, names: Sequence[str]) -> None:
    place.imshow(shares, cmap="GnBu", vmin=0, vmax=100)
    place.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    place.set_yticks(range(len(names)), names, fontsize=7)
    for row, column in np.argwhere(shares >= 0.5):
        share = shares[row, column]
        colour = "white" if share > 60 else plots.INK
        place.text(
            column,
            row,
            f"{share:.0f}",
            ha="center",
            va="center",
            fontsize=6.5,
            color=colour,
        )
    place.spines[["top", "right"]].set_visible(True)


def _beliefs(place: Any, curve: np.ndarray, names: Sequence[str]) -> None:
    """Draw the three strongest beliefs by name, the others thin."""
    touches = np.arange(1, len(curve) + 1)
    strongest = np.argsort(-curve.mean(axis=0), kind="stable")[:3].tolist()
    for number in range(curve.shape[1]):
        if number not in strongest:
            place.plot(touches, curve[:, number], color="#c8ced3", lw=0.7)
    colours = (plots.OURS, _BROWN, _PURPLE)
    for number, colour in zip(strongest, colours, strict=False):
        label = names[number].replace("_", " ")
        place.plot(touches, curve[:, number], color=colour, lw=1.6, label=label)
    # Room for the names above the lines.
    place.set(ylim=(0, 140), yticks=range(0, 101, 20))
    place.legend(frameon=False, fontsize=6, loc="upper left")


def _panels(
    n_rows: int, n_columns: int, width: float, height: float
) -> tuple["Figure", Any]:
    from matplotlib.figure import Figure

    size = (width * n_columns, height * n_rows)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(n_rows, n_columns, squeeze=False)
    for place in axes.ravel():
        place.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _legend(figure: "Figure", place: Any) -> None:
    handles, labels = place.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=3,
        fontsize=7,
        frameon=False,
    )
