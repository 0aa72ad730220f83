"""Whether what was taught will do: left-out touches asked again, and advice.

What was learnt is asked about every touch of it as if that, and its neighbours, had not
been taught. That says nothing of places that were never touched.
"""

from typing import Any

import numpy as np

from ..recognition import ObjectRecogniser, with_floor

# Touches of a draw, draws, shares that are enough of draws and touches, objects named.
_SOME, _DRAWN, _WELL, _HALF, _MOST_SAID = 8, 40, 0.9, 0.5, 4
# With so few objects 70 % of things never taught are named, and with so few touches of
# an object names are least sure: docs/reference/live.md.
_FEW_OBJECTS, _FEW_TOUCHES = 5, 10


def object_quality(recogniser: ObjectRecogniser) -> list[dict[str, Any]]:
    """Return how often left-out touches of each object are recognised.

    By `name`: `n_touches` with contact; `after_one` and `after_eight`, shares of right
    answers after one touch and after eight drawn ones, None where there are not so
    many; `taken_for`, the most frequent wrong answer to one touch, or None.
    """
    memory, names = recogniser.memory_, recogniser.classes_.astype(str).tolist()
    log_likelihood = with_floor(recogniser.left_out_log_likelihood(), recogniser.floor_)
    left_out = recogniser.left_out_rows
    felt = recogniser.uses_no_contact_ | ~memory.nothing[left_out]
    labels = memory.labels[left_out]
    rng, result = np.random.default_rng(0), []
    for code, name in enumerate(names):
        rows = np.flatnonzero((labels == recogniser.classes_[code]) & felt)
        answers = np.bincount(log_likelihood[rows].argmax(axis=1), minlength=len(names))
        right, answers[code] = answers[code], 0
        drawn = rng.permuted(np.tile(rows, (_DRAWN, 1)), axis=1)[:, :_SOME]
        best = log_likelihood[drawn].sum(axis=1).argmax(axis=1)
        after_eight = float(np.mean(best == code)) if len(rows) >= _SOME else None
        result.append(
            {
                "name": name,
                "n_touches": len(rows),
                "after_one": float(right / len(rows)) if len(rows) else None,
                "after_eight": after_eight,
                "taken_for": names[answers.argmax()] if answers.any() else None,
            }
        )
    return result


def limits(recogniser: ObjectRecogniser) -> str:
    """Return what a name is worth where few objects, or touches, were learnt, or ""."""
    names, counts = np.unique(recogniser.memory_.labels.astype(str), return_counts=True)
    sentences = []
    if len(names) <= _FEW_OBJECTS:
        sentences.append(
            f"It knows {len(names)} objects and nothing else: a thing that is none of "
            "them is often called by one of their names."
        )
    few = names[counts < _FEW_TOUCHES].tolist()
    if few:
        more = f" and {len(few) - 3} more" * (len(few) > 3)
        sentences.append(
            f"Of {', '.join(few[:3])}{more} it learnt fewer than {_FEW_TOUCHES} "
            "touches: a wrong name may look certain."
        )
    return " ".join(sentences)


def advice(qualities: list[dict[str, Any]]) -> list[str]:
    """Return what to teach next, in sentences, of what `object_quality` returned.

    Of objects that too few touches, one or eight, are right of, the worst first.
    """
    few = [quality["name"] for quality in qualities if quality["after_eight"] is None]
    judged = (quality for quality in qualities if quality["after_eight"] is not None)
    low = [x for x in judged if x["after_one"] < _HALF or x["after_eight"] < _WELL]
    low = sorted(low, key=lambda quality: quality["after_one"])[:_MOST_SAID]
    weak, sentences = {quality["name"]: quality["taken_for"] for quality in low}, []
    for name, other in weak.items():
        if other is None or weak.get(other) != name:
            what = f"is taken for {other}" if other else "is not sure"
            sentences.append(f"{name} {what}: ten more touches of {name}, elsewhere.")
        elif name < other:
            what = f"{name} and {other} are taken for each other"
            sentences.append(f"{what}: ten more touches of each, elsewhere.")
    if few:
        names = ", ".join(few[:_MOST_SAID])
        more = f" and {len(few) - _MOST_SAID} more" * (len(few) > _MOST_SAID)
        sentences.append(
            f"Fewer than {_SOME} touches with contact cannot be judged: {names}{more}."
        )
    return sentences
