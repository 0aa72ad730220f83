"""What a belief comes to in one sentence: the same words everywhere.

The terminal, the page, reports and Python all show these sentences; numbers behind them
(evidence in nats, bounds, encodings) are told where someone asks why.
"""

from collections.abc import Mapping
from math import floor

NOTHING = "nothing I know"
# Calibration is by touches left out of the training sessions.
OTHER_SESSION = (
    "In another session than those of training, names are wrong more often than "
    "probabilities say."
)
# Names that together have this probability are those that it may be, three at most.
_MOST_LIKELY, _MOST_NAMED = 0.9, 3


def share_of(probability: float) -> str:
    """Return a probability as people read it, rounded down.

    What has not reached a limit never reads as if it had, nor 100 % unless certain.
    """
    if probability > 0.999:
        return "over 99.9 %"
    if probability < 0.01:
        return "under 1 %"
    steps = 10 if probability >= 0.99 else 1
    # 0.29 is 29 %, though 100 times it is a little less.
    return f"{floor(100 * steps * probability + 1e-9) / steps:g} %"


def n_touches_of(n_touches: int) -> str:
    """Return a number of touches in words: "1 touch", "5 touches"."""
    return f"{n_touches} touch{'es' * (n_touches != 1)}"


def sentence_of(
    posterior: Mapping[str, float],
    unknown: float,
    n_touches: int,
    decision: tuple[str, str, float] | None,
) -> str:
    """Return what is decided, or what it may be.

    Of the probabilities of the learnt objects and of none of them, the number of
    touches, and level, name and probability of the decision, None where there is none.
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
    return f"{_candidates(posterior, unknown)}: touch again"


def touch_note(number: int, flag: str) -> str:
    """Return the sentence about a touch that is not as it should be, "" for most."""
    if not flag:
        return ""
    counted = ", not counted" if "no contact" in flag else ""
    return f"touch {number}: {flag}{counted}"


def _candidates(posterior: Mapping[str, float], unknown: float) -> str:
    """Return the most probable names, joined by "or"."""
    shares = {**posterior, NOTHING: unknown}
    ranked = sorted(shares, key=lambda name: -shares[name])
    names, total = [], 0.0
    for name in ranked[:_MOST_NAMED]:
        names.append(name)
        total += shares[name]
        if total >= _MOST_LIKELY:
            break
    if len(names) == 1:
        return f"probably {names[0]} ({share_of(total)})"
    if total < _MOST_LIKELY:
        return f"perhaps {names[0]} ({share_of(shares[names[0]])})"
    return f"{', '.join(names[:-1])} or {names[-1]}"
