"""Why the recogniser answered as it did: the part of a report that explains episodes.

Beside each touch that moved the belief stand the training touches that it resembles.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches, as_shown, png_address
from ._episodes import Decisions, decide_episodes
from ._trial import Trial

EPISODES = 6
WRONG = 4
MOVED, NEAREST = 3, 3
SIDE = 72


class Explained(NamedTuple):
    """One episode up to its end: the touches, and what was made of them."""

    trial: Trial
    name: str
    truth: str
    rows: NDArray[np.intp]
    said: str
    right: bool


def explanations(figures: dict[str, Any], trials: Sequence[Trial]) -> str:
    """Return the touches that moved some decisions most, as HTML.

    Wrong decisions come first, of as many objects as there are, then right ones.
    """
    ends = figures["decision"]
    shown = "".join(_episode(one, ends) for one in explained_episodes(figures, trials))
    if not shown:
        return ""
    return (
        "<h2>Why: the touches that moved the belief most</h2>"
        "<p class=note>Of some episodes, wrong decisions first. Left: a touch, and how "
        "far it moved the balance between the two most probable labels (nats; 2.3 are "
        "a factor of ten). Right of it: the training touches most like it, and how far "
        f"they are (1: as two middling training touches).</p>{shown}"
    )


def explained_episodes(
    figures: dict[str, Any], trials: Sequence[Trial]
) -> list[Explained]:
    """Return at most six decided episodes: up to four wrong, the others right."""
    accepted = figures["decision"]["error"], figures["decision"]["refusal"]
    ends = [decide_episodes(t.recogniser, t.episodes, *accepted) for t in trials]
    wrong = _one_each(ends, lambda end: end.decided & ~end.right)
    right = _one_each(ends, lambda end: end.right)
    few = wrong[: max(WRONG, EPISODES - len(right))][:EPISODES]
    n_right = min(EPISODES - len(few), len(right))
    places = np.unique(np.linspace(0, len(right) - 1, n_right).astype(int))
    chosen = few + [right[place] for place in places]
    return [_explained(trials[fold], ends[fold], number) for fold, number in chosen]


def _one_each(
    ends: Sequence[Decisions], which: Callable[[Decisions], NDArray[np.bool_]]
) -> list[tuple[int, int]]:
    """Return the first such episode of each object: fold, and number in it."""
    found: dict[str, tuple[int, int]] = {}
    for fold, end in enumerate(ends):
        for number in np.flatnonzero(which(end)).tolist():
            found.setdefault(str(end.objects[number]), (fold, number))
    return list(found.values())


def _explained(trial: Trial, end: Decisions, number: int) -> Explained:
    episodes, classes = trial.episodes, trial.recogniser.classes_
    name, used = str(end.objects[number]), int(end.touches[number])
    whose = episodes.objects.index(name)
    order = number % len(episodes.rows[whose])
    best = episodes.beliefs[whose][order, used - 1].argmax()
    return Explained(
        trial,
        name,
        str(classes[episodes.truth[whose]]),
        episodes.rows[whose][order, :used],
        "unknown" if end.refused[number] else str(classes[best]),
        bool(end.right[number]),
    )


def _episode(one: Explained, asked: dict[str, Any]) -> str:
    belief = one.trial.recogniser.start().update(one.trial.fold.test[one.rows])
    reason = belief.reason(asked["error"], refusal=asked["refusal"])
    of_label = "" if one.name == one.truth else f" ({escape(one.truth)})"
    moved = "".join(
        f"<div class=why>{''.join(_touch(one, step))}</div>"
        for step in belief.explain(MOVED, NEAREST)
    )
    return (
        f"<p><b>{escape(one.name)}</b>{of_label} taken for <b>{escape(one.said)}</b>: "
        f"{'right' if one.right else 'wrong'}.<br>"
        f"<span class=note>{escape(reason)}</span></p>{moved}"
    )


def _touch(one: Explained, step: dict[str, Any]) -> Iterator[str]:
    """Yield a touch that moved the belief, then its nearest training touches."""
    fold = one.trial.fold
    pair = step["best"], step["rival"]
    more, less = pair if step["nats"] > 0 else pair[::-1]
    said = [f"touch {step['touch']}:", f"{abs(step['nats']):.1f} nats for {more}"]
    said += [f"over {less}", *filter(None, [step["flag"]])]
    yield _cell(one.trial, fold.test[one.rows[[step["touch"] - 1]]], said)
    for near in step["nearest"]:
        train = fold.train[np.array([near["row"]])]
        yield _cell(one.trial, train, [near["object"], f"{near['distance']:.2f} away"])


def _cell(trial: Trial, touch: Touches, lines: Iterable[str]) -> str:
    """Return a touch as a small picture, where it has places, above its lines."""
    picture = ""
    if trial.recogniser.chosen_["geometry"] != "none":
        cleaned = as_shown(trial.recogniser.encoder_.clean(touch), touch.channels)[0]
        picture = f"<img src='{png_address(cleaned, SIDE)}' alt='touch'>"
    text = "<br>".join(escape(line) for line in lines)
    return f"<div>{picture}<span>{text}</span></div>"
