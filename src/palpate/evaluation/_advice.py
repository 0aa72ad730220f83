"""Whether an accuracy is good, in a sentence, and what to do: at most three more."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ._controls import as_good_alone
from ._trial import Trial

MOST = 3
# Right after the most touches that were asked for: good, and worth going on with.
GOOD, FAIR = 0.95, 0.8
# A share of touches without contact, an accuracy gained, a share of all mistakes, and a
# number of training touches, at which something is worth saying.
IDLE_SHARE, GAIN, SHARE_OF_MISTAKES, FEW_TOUCHES = 0.1, 0.05, 1 / 3, 20
ENOUGH_TOUCHES = 60


def verdict(figures: dict[str, Any]) -> str:
    """Return one sentence: whether this is good, and why."""
    accuracy = figures["accuracy"]
    if not accuracy:
        return "Nothing can be said: no object has as many test touches as asked for."
    *_, last = accuracy
    right, chance = accuracy[last], figures["chance"]
    after = f"{right:.0%} right after {last} touch{'es' * (last != '1')}"
    beside = f"chance is {chance:.0%}"
    alone = {k: v[last] for k, v in figures["controls"].items() if v and last in v}
    alone.pop("no contact", None)
    if alone:
        best = max(alone, key=lambda name: alone[name])
        beside += f", and {best} alone, which is no touch, {alone[best]:.0%}"
        if alone[best] >= right > 1.5 * chance:
            return (
                f"This does not show that touch works: {after}, but {best} alone, "
                f"which is no touch, names {alone[best]:.0%}."
            )
    if right <= 1.5 * chance:
        return f"Not better than guessing: {after}, where {beside}."
    if right >= GOOD:
        return f"Good: {after}, where {beside}."
    return f"{'Fair' if right >= FAIR else 'Not good yet'}: {after}, where {beside}."


def recommendations(figures: dict[str, Any], trials: Sequence[Trial]) -> list[str]:
    """Return at most three sentences that say what to do, what harms most first."""
    return [
        sentence
        for sentence, _ in zip(_all(figures, trials), range(MOST), strict=False)
    ]


def _all(figures: dict[str, Any], trials: Sequence[Trial]) -> Iterator[str]:
    accuracy = figures["accuracy"]
    if not accuracy:
        return
    *_, last = accuracy
    best = accuracy[last]
    idle = figures["flags"].get("no contact", 0.0)
    if idle >= IDLE_SHARE:
        yield (
            f"{idle:.0%} of the test touches are without contact, and not counted: "
            "press until the picture changes, or record with a higher --begin."
        )
    if best > 1.5 * figures["chance"] and as_good_alone(figures):
        yield (
            "What is no touch does as well as touch: record objects in turns, mount "
            "the sensor anew in between, and evaluate with --split session."
        )
    few = Counter(trials[0].recogniser.memory_.labels.tolist())
    name, least = min(few.items(), key=lambda item: item[1])
    if best < GOOD and least < FEW_TOUCHES:
        yield (
            f"{name} was taught with {least} touch{'es' * (least > 1)}: give every "
            f"{figures['label']} {ENOUGH_TOUCHES}, all over it."
        )
    elsewhere = figures["split"] in ("session", "subject")
    confirming = _confirming(figures, trials[0])
    if elsewhere and best < GOOD and figures["remount"] == "none":
        yield (
            "Another mounting costs accuracy: try --remount recentre:10, which gets "
            f"used to it without labels, or --remount confirm:3.{confirming}"
        )
    elif confirming and best < GOOD and not figures["remount"].startswith("confirm"):
        yield confirming.lstrip()
    if not elsewhere and not figures["sessions"]["asked"]:
        yield (
            "All was taught in one session: on another day expect less. Teach half "
            "of it after mounting the sensor anew."
        )
    if pair := _confused(int(last), trials):
        true, taken, share = pair
        yield (
            f"{share:.0%} of the mistakes are {true} taken for {taken}: touch them "
            "where they differ, or give both one name if nobody needs them apart."
        )
    if gained := _gained(accuracy):
        before, after = gained
        yield (
            f"More touches help: {accuracy[before]:.0%} right after {before}, "
            f"{accuracy[after]:.0%} after {after}. Let it touch until it decides."
        )


def _confirming(figures: dict[str, Any], trial: Trial) -> str:
    """Return what confirmed touches are expected to bring, and of which objects.

    "" where sessions were not rehearsed, or the middle of the range grows too little.
    """
    sessions = figures["sessions"]
    if "confirmed" not in sessions:
        return ""
    before, after = sessions["rehearsed"], sessions["confirmed"]
    if np.mean(after) - np.mean(before) < GAIN:
        return ""
    remount = getattr(trial.recogniser, "chosen_", {}).get("remount", {})
    left = remount.get("confirm") or trial.recogniser.classes_.tolist()
    more = f" and {len(left) - MOST} more" if len(left) > MOST else ""
    low, high, low_after, high_after = (f"{100 * x:.0f}" for x in (*before, *after))
    return (
        f" In another session confirm a touch of each {figures['label']} "
        f"({', '.join(left[:MOST])}{more}): expect about {low_after} to {high_after}% "
        f"right after one touch, not {low} to {high}%."
    )


def _confused(k: int, trials: Sequence[Trial]) -> tuple[str, str, float] | None:
    """Return the pair with a third of all mistakes after k touches, if there is one."""
    mistakes: Counter[tuple[str, str]] = Counter()
    ends = [(t, t.episodes.scores(k)) for t in trials]
    for trial, scores in ends:
        names = trial.recogniser.classes_.tolist()
        if scores is not None:
            shares = scores.confusion / len(names) / len(trials)
            mistakes.update(
                {
                    (names[i], names[j]): float(share)
                    for (i, j), share in np.ndenumerate(shares)
                    if i != j
                }
            )
    total = sum(mistakes.values())
    if len(trials[0].recogniser.classes_) < 3 or total < GAIN / 2:
        return None
    (true, taken), share = mistakes.most_common(1)[0]
    if share / total < SHARE_OF_MISTAKES:
        return None
    return true, taken, share / total


def _gained(accuracy: dict[str, float]) -> tuple[str, str] | None:
    """Return the last two numbers of touches, if the second is right more often."""
    if len(accuracy) < 2:
        return None
    *_, before, after = accuracy
    return (before, after) if accuracy[after] - accuracy[before] >= GAIN else None
