"""What a belief comes to in one sentence, and what it can promise: the same everywhere.

The terminal, the page, reports and Python all show these sentences; numbers behind them
(evidence in nats, bounds, encodings) are told where someone asks why. Pictures of
beliefs, episodes and confusions stand beside them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import floor
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._checks import listed
from .._extras import needed
from .._numbers import about, n_touches_of, share_of
from .._types import Indices

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NOTHING = "nothing I know"
# Calibration is by touches left out of the training sessions.
OTHER_SESSION = (
    "In another session than those of training, names are wrong more often than "
    "probabilities say."
)
# Names that together have this probability are those that it may be, three at most.
_MOST_LIKELY, _MOST_NAMED = 0.9, 3
# What was left out where an object counts once in each session.
IN_SESSIONS = "these objects in other sessions"
# Of more objects a picture has no names.
MOST_LABELLED = 30
# Touches of a draw, objects that an advice names at most.
N_JUDGED, _N_NAMED = 8, 4
# An object that is right after one touch, or eight, less often than this wants more.
_RIGHT_AFTER_ONE, _RIGHT_AFTER_EIGHT = 0.5, 0.9
# What stands for a stranger in pictures.
_STRANGER_BAR, _GREY = "nothing learnt", "#888888"


def sentence_of(
    posterior: Mapping[str, float],
    unknown: float,
    n_touches: int,
    decision: tuple[str, str, float] | None,
    *,
    is_stuck: bool = False,
) -> str:
    """Return what is decided, or what it may be, and what to do then.

    Of the probabilities of the learnt objects and of none of them, the number of
    touches, and level, name and probability of the decision, None where there is none;
    `is_stuck` where more touches would not decide either.
    """
    after = f"after {n_touches_of(n_touches)}"
    if decision is not None:
        level, name, probability = decision
        share = share_of(probability)
        if level == "unknown":
            return f"{NOTHING} ({share}), {after}"
        if level == "category":
            article = "an" if name[0].lower() in "aeiou" else "a"
            return f"{article} {name}, {share} {after}; which one I cannot tell"
        return f"{name}, {share} {after}"
    if not n_touches:
        return "no touch yet: touch it"
    names, words = _candidates(posterior, unknown)
    return f"{words}: {_teach_again(names) if is_stuck else 'touch again'}"


def _teach_again(names: Sequence[str]) -> str:
    """Return what to teach so that touches tell which of these names it is."""
    learnt = [name for name in names if name != NOTHING]
    last = learnt[-1:] if len(learnt) < 2 else [f"{learnt[-2]} and {learnt[-1]}"]
    objects = ", ".join([*learnt[:-2], *last])
    ways = [f"{objects} again, at other places"] * bool(learnt)
    ways += ["this, if it is new"] * (len(learnt) < len(names))
    return f"more touches will not tell; teach {', or '.join(ways)}"


def is_counted(flag: str) -> bool:
    """Whether a touch with this flag counts: it shows contact."""
    return "no contact" not in flag


def touch_note(number: int, flag: str) -> str:
    """Return the sentence about a touch that is not as it should be, "" for most."""
    if not flag:
        return ""
    counted = "" if is_counted(flag) else ", not counted"
    return f"touch {number}: {flag}{counted}"


def _candidates(
    posterior: Mapping[str, float], unknown: float
) -> tuple[list[str], str]:
    """Return the most probable names, and these joined by "or"."""
    shares = {**posterior, NOTHING: unknown}
    ranked = sorted(shares, key=lambda name: -shares[name])
    names, total = [], 0.0
    for name in ranked[:_MOST_NAMED]:
        names.append(name)
        total += shares[name]
        if total >= _MOST_LIKELY:
            break
    if len(names) == 1:
        return names, f"probably {names[0]} ({share_of(total)})"
    if total < _MOST_LIKELY:
        return names, f"perhaps {names[0]} ({share_of(shares[names[0]])})"
    return names, f"{', '.join(names[:-1])} or {names[-1]}"


class Promise(NamedTuple):
    """What so few objects can show about an error.

    Attributes
    ----------
    level : float
        The error that was asked for.
    bound : float
        What could be shown at 95 % confidence if none were wrong: 1 - 0.05^(1/n) for n
        objects or sessions, each counted once (Clopper and Pearson 1934,
        doi:10.1093/biomet/26.4.404).
    n_needed : int
        How many would be needed to show `level`.
    population : str
        What was left out to learn from.
    n_units : int
        How many objects, or objects in a session, that were.
    other_session : bool
        Whether the recogniser serves in another session without a confirmed touch of
        each object: of the others none of such a session were left out.
    """

    level: float
    bound: float
    n_needed: int
    population: str
    n_units: int
    other_session: bool = False

    def __str__(self) -> str:
        if self.other_session:
            return f"{self._replace(other_session=False)!s} {OTHER_SESSION}"
        units = f"{self.n_units} object{'s' * (self.n_units != 1)}"
        if self.population == IN_SESSIONS:
            units = f"{self.n_units} pairs of object and session"
        if self.bound <= self.level:
            return f"{units} left out can show an error of {self.level:g}."
        return (
            f"{units} cannot prove an error of {100 * self.level:g} %, "
            f"about {about(self.n_needed)} would."
        )


def draw_belief(
    shares: Mapping[str, float], unknown: float, title: str, ax: Axes | None
) -> Axes:
    """Draw a bar for each object's probability, the first one on top, and for none."""
    axes = _axes("A picture of a belief", ax, (5, 3))
    bars = {**shares, _STRANGER_BAR: unknown}
    names = [*bars][::-1]
    colours = [_GREY, *["#4c78a8"] * len(shares)]
    widths = [bars[name] for name in names]
    axes.barh([*map(_plain, names)], widths, color=colours)
    axes.set(xlim=(0, 1), xlabel="probability", title=_plain(title))
    return axes


def belief_in_html(
    shares: Mapping[str, float], unknown: float, n_more: int, title: str
) -> str:
    """Return bars of objects' probabilities and of none; `n_more` are only counted."""
    bars = [_bar(name, share) for name, share in shares.items()]
    if n_more:
        bars.append(f"<tr><td colspan=2>and {n_more} more</td></tr>")
    bars.append(_bar(_STRANGER_BAR, unknown))
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
    axes = _axes("A picture of an episode", ax, (6, 3))
    numbers = range(1, len(unknown) + 1)
    for name, of_object in shares.items():
        axes.plot(numbers, of_object, marker="o", label=_plain(name))
    axes.plot(numbers, unknown, "--", color=_GREY, label=_STRANGER_BAR)
    axes.axhline(limit, color="#cccccc", linewidth=1)
    axes.set(ylim=(0, 1.02), xlabel="touch", ylabel="probability", title=_plain(title))
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    return axes


def draw_confusion(counts: Indices, names: Sequence[str], ax: Axes | None) -> Axes:
    """Draw what touches are taken for, in per cent of each object's (a row each).

    Of the numbers of touches `counts` (n_objects, n_objects).
    """
    shares = 100 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    side = float(np.clip(1.5 + 0.3 * len(shares), 3.5, 9))
    axes = _axes("A picture of confusions", ax, (side, side))
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    right = np.trace(counts) / max(counts.sum(), 1)
    title = f"Touches left out, one at a time: {right:.0%} right"
    axes.set(xlabel="taken for", ylabel="object", title=title)
    labels = [*map(_plain, names)] if len(names) <= MOST_LABELLED else []
    axes.set_xticks(range(len(labels)), labels, rotation=90)
    axes.set_yticks(range(len(labels)), labels)
    for row, col in np.argwhere(shares >= 1) if labels else ():
        colour = "white" if shares[row, col] > 50 else "black"
        label = f"{shares[row, col]:.0f}"
        axes.text(col, row, label, ha="center", va="center", color=colour, size=7)
    return axes


def _plain(text: str) -> str:
    """Return a text in which matplotlib sees no formula."""
    return text.replace("$", r"\$")


def _axes(what: str, ax: Axes | None, size: tuple[float, float]) -> Axes:
    """Return `ax`, or new axes of a size in inches, for `what` needs matplotlib."""
    pyplot = needed("matplotlib.pyplot", "plot", what)
    return ax or pyplot.subplots(figsize=size, layout="constrained")[1]


def advice_of(qualities: list[dict[str, Any]]) -> list[str]:
    """Return what to teach next; see `ObjectRecogniser.teaching_advice`."""
    few = [quality["name"] for quality in qualities if quality["after_eight"] is None]
    judged = (quality for quality in qualities if quality["after_eight"] is not None)
    low = [
        x
        for x in judged
        if x["after_one"] < _RIGHT_AFTER_ONE or x["after_eight"] < _RIGHT_AFTER_EIGHT
    ]
    low = sorted(low, key=lambda quality: quality["after_one"])[:_N_NAMED]
    weak, sentences = {quality["name"]: quality["taken_for"] for quality in low}, []
    for name, other in weak.items():
        if other is None or weak.get(other) != name:
            what = f"is taken for {other}" if other else "is not sure"
            sentences.append(f"{name} {what}: ten more touches of {name}, elsewhere.")
        elif name < other:
            what = f"{name} and {other} are taken for each other"
            sentences.append(f"{what}: ten more touches of each, elsewhere.")
    if few:
        names = listed(few, _N_NAMED)
        sentences.append(
            f"Fewer than {N_JUDGED} touches with contact cannot be judged: {names}."
        )
    return sentences
