"""The pictures of a report, as SVG text and PNG data.

matplotlib is the extra `plot`, imported where it is used.
"""

import io
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from .._types import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#1f2933"
# Apart for the colour-blind too, in this order; the site's pictures have the same.
COLOURS = ("#0b6e8a", "#d55e00", "#e0a100", "#6b4e9b", "#5a6572", "#7fb8a4")
OURS, CONTROLS = COLOURS[0], COLOURS[1:5]
# Inches: two beside each other in a window, and text of one size on a phone.
SIDE_BY_SIDE = 4.1, 3.7


def accuracy_curve(figures: dict[str, Any], curve: Array, spread: Array) -> str:
    """Return accuracy against touches with its spread, chance and the controls.

    `curve` and `spread` hold mean and standard deviation after 1, 2, 3... touches.
    """
    figure, ((axes,),) = panels(1, 1, SIDE_BY_SIDE)
    touches = np.arange(1, len(curve) + 1)
    low, high = np.clip(curve - spread, 0, 1), np.clip(curve + spread, 0, 1)
    axes.fill_between(touches, 100 * low, 100 * high, color=OURS, alpha=0.15, lw=0)
    axes.plot(touches, 100 * curve, color=OURS, lw=2.2, label=figures["preset"])
    for colour, (name, control) in zip(
        CONTROLS, figures["controls"].items(), strict=False
    ):
        if control:
            label = "without contact" if name == "no contact" else f"{name} alone"
            after, right = map(int, control), (100 * v for v in control.values())
            axes.plot([*after], [*right], "o--", color=colour, ms=4, lw=1, label=label)
    axes.axhline(100 * figures["chance"], color=INK, lw=0.8, ls=":", label="chance")
    axes.set(
        xlabel="touches", ylabel="right, %", ylim=(0, 101), xlim=(1, max(2, len(curve)))
    )
    axes.set_xticks(whole_ticks(max(2, len(curve))))
    # Beside the curves there is no place that is always free.
    figure.legend(frameon=False, loc="outside upper left", ncols=2, fontsize=8)
    return svg(figure, "Share right against touches")


def whole_ticks(last: int) -> list[int]:
    """Return at most eight numbers of touches from 1 to `last`, round ones."""
    steps = (factor * 10**power for power in range(9) for factor in (1, 2, 5))
    step = next(size for size in steps if last / size <= 7)
    return [1, *range(step, last + 1, step)] if step > 1 else [*range(1, last + 1)]


def calibration_plot(bins: dict[str, tuple[Array, Array, Array]]) -> str:
    """Return share right against belief, one line per number of touches."""
    figure, ((axes,),) = panels(1, 1, SIDE_BY_SIDE)
    axes.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=":")
    shades = np.linspace(0.35, 1.0, max(1, len(bins)))
    for shade, (name, (means, shares, _)) in zip(shades, bins.items(), strict=True):
        style = {"color": OURS, "alpha": float(shade), "ms": 4, "lw": 1.4}
        axes.plot(means, shares, "o-", label=f"after {name}", **style)
    axes.set(xlabel="belief in the best", xlim=(0, 1.01))
    axes.set(ylabel="share right", ylim=(0, 1.01))
    axes.legend(frameon=False, fontsize=8)
    return svg(figure, "Share right against belief")


def confusion_plot(confusion: Array, names: Sequence[str]) -> str:
    """Return the share of answers (columns) per true label (rows)."""
    size = min(11.0, 2.6 + 0.33 * len(names))
    figure, ((axes,),) = panels(1, 1, (size + 0.8, size))
    draw_confusion(axes, confusion, names, max(4.5, 9 - 0.08 * len(names)))
    axes.set(xlabel="recognised as", ylabel="touched")
    return svg(figure, "Share of answers for each label touched")


def draw_confusion(
    axes: Any, confusion: Array, names: Sequence[str], size: float
) -> None:
    """Draw shares as colours, those of at most 20 labels also as per cent."""
    shown = [name.replace("$", r"\$") for name in names]  # no formulas
    axes.imshow(confusion, cmap="GnBu", vmin=0, vmax=1)
    axes.set_xticks(range(len(names)), shown, rotation=60, ha="right", fontsize=size)
    axes.set_yticks(range(len(names)), shown, fontsize=size)
    if len(names) <= 20:
        for row, column in np.argwhere(confusion >= 0.005):
            share = confusion[row, column]
            style = {"fontsize": size - 1, "color": "white" if share > 0.6 else INK}
            text = f"{100 * share:.0f}"
            axes.text(column, row, text, ha="center", va="center", **style)


def panels(
    n_rows: int,
    n_columns: int,
    size: tuple[float, float],
    *,
    pictures: bool = False,
    **shared: Any,
) -> tuple["Figure", Any]:
    """Return a figure (size in inches) and its axes, shape (n_rows, n_columns)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(n_rows, n_columns, squeeze=False, **shared)
    for place in axes.ravel():
        if pictures:
            place.set(xticks=[], yticks=[])
        hidden = [*place.spines] if pictures else ["top", "right"]
        place.spines[hidden].set_visible(False)
    return figure, axes


def svg(figure: "Figure", alt: str) -> str:
    """Return a figure as SVG text that a page can hold, `alt` for who cannot see it."""
    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "palpate"}):
        figure.savefig(text, format="svg", metadata={"Date": None}, transparent=True)
    whole = text.getvalue()
    named = f'<svg role="img" aria-label="{escape(alt)}"'
    return named + whole[whole.index("<svg") + 4 :]
