"""Pictures of a belief, an episode and of what is taken for what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import floor
from typing import TYPE_CHECKING

import numpy as np

from .._extras import needed
from .._types import Indices

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Of more objects a picture has no names.
MOST_LABELLED = 30
# What stands for a stranger.
_NOTHING, _GREY = "nothing learnt", "#888888"


def draw_belief(
    shares: Mapping[str, float], unknown: float, title: str, ax: Axes | None
) -> Axes:
    """Draw a bar for each object's probability, the first one on top, and for none."""
    pyplot = needed("matplotlib.pyplot", "plot", "A picture of a belief")
    axes = ax
    if axes is None:
        axes = pyplot.subplots(figsize=(5, 3), layout="constrained")[1]
    bars = {**shares, _NOTHING: unknown}
    names = [*bars][::-1]
    colours = [_GREY, *["#4c78a8"] * len(shares)]
    axes.barh(names, [bars[name] for name in names], color=colours)
    axes.set(xlim=(0, 1), xlabel="probability", title=title)
    return axes


def belief_in_html(
    shares: Mapping[str, float], unknown: float, n_more: int, title: str
) -> str:
    """Return bars of objects' probabilities and of none; `n_more` are only counted."""
    bars = [_bar(name, share) for name, share in shares.items()]
    if n_more:
        bars.append(f"<tr><td colspan=2>and {n_more} more</td></tr>")
    bars.append(_bar(_NOTHING, unknown))
    return f"<table><caption>{escape(title)}</caption>{''.join(bars)}</table>"


def _bar(name: str, share: float) -> str:
    shown = floor(1000 * share + 1e-9) / 1000  # so that none sum to more than 1
    style = f"background:#4c78a8;height:0.8em;width:{max(share, 0.002) * 12:.2f}em"
    bar = f'<div style="{style};display:inline-block"></div> {shown:.3f}'
    return f'<tr><td>{escape(name)}</td><td style="text-align:left">{bar}</td></tr>'


def draw_episode(
    shares: Mapping[str, Sequence[float]],
    unknown: Sequence[float],
    limit: float,
    title: str,
    ax: Axes | None,
) -> Axes:
    """Draw probabilities touch by touch, and the limit from which one is named."""
    pyplot = needed("matplotlib.pyplot", "plot", "A picture of an episode")
    axes = ax
    if axes is None:
        axes = pyplot.subplots(figsize=(6, 3), layout="constrained")[1]
    numbers = range(1, len(unknown) + 1)
    for name, of_object in shares.items():
        axes.plot(numbers, of_object, marker="o", label=name)
    axes.plot(numbers, unknown, "--", color=_GREY, label=_NOTHING)
    axes.axhline(limit, color="#cccccc", linewidth=1)
    axes.set(ylim=(0, 1.02), xlabel="touch", ylabel="probability", title=title)
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    return axes


def draw_confusion(counts: Indices, names: Sequence[str], ax: Axes | None) -> Axes:
    """Draw what touches are taken for, in per cent of each object's (a row each).

    Of the numbers of touches `counts` (n_objects, n_objects).
    """
    pyplot = needed("matplotlib.pyplot", "plot", "A picture of confusions")
    shares = 100 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes = ax
    if axes is None:
        side = float(np.clip(1.5 + 0.3 * len(shares), 3.5, 9))
        axes = pyplot.subplots(figsize=(side, side), layout="constrained")[1]
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    right = np.trace(counts) / max(counts.sum(), 1)
    title = f"Touches left out, one at a time: {right:.0%} right"
    axes.set(xlabel="taken for", ylabel="object", title=title)
    labels = names if len(names) <= MOST_LABELLED else []
    axes.set_xticks(range(len(labels)), labels, rotation=90)
    axes.set_yticks(range(len(labels)), labels)
    for row, col in np.argwhere(shares >= 1) if labels else ():
        colour = "white" if shares[row, col] > 50 else "black"
        label = f"{shares[row, col]:.0f}"
        axes.text(col, row, label, ha="center", va="center", color=colour, size=7)
    return axes
