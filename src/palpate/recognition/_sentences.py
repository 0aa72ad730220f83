"""What a belief comes to in one sentence, and what it can promise: the same everywhere.

The terminal, the page, reports and Python all show these sentences; numbers behind them
(evidence in nats, bounds, encodings) are told where someone asks why.
"""

from collections.abc import Mapping
from math import ceil, floor, log, log1p
from typing import NamedTuple

from scipy.stats import beta

CONFIDENCE = 0.95
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


def figure_of(share: float) -> str:
    """Return a share for a table: rounded down, so that none sum to more than 100 %."""
    if 0.999 < share < 1:
        return ">99.9 %"
    if 0 < share < 0.001:
        return "<0.1 %"
    steps = 1 if 0.1 <= share < 0.99 else 10
    digits = int(steps > 1 and 0 < share < 1)
    return f"{floor(100 * steps * share + 1e-9) / steps:.{digits}f} %"


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


def counts(flag: str) -> bool:
    """Whether a touch with this flag counts: it shows contact."""
    return "no contact" not in flag


def touch_note(number: int, flag: str) -> str:
    """Return the sentence about a touch that is not as it should be, "" for most."""
    if not flag:
        return ""
    counted = "" if counts(flag) else ", not counted"
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
        objects = f"{self.n_units} object{'s' * (self.n_units != 1)}"
        if self.bound <= self.level:
            return f"{objects} left out can show an error of {self.level:g}."
        return (
            f"{objects} cannot prove an error of {100 * self.level:g} %, "
            f"about {about(self.n_needed)} would."
        )


def promise_of(n_units: int, population: str, error: float) -> Promise:
    """Return what so many units of a population can show at an accepted error."""
    n_needed = ceil(log(1 - CONFIDENCE) / log1p(-error))
    return Promise(error, upper_bound(0.0, n_units), n_needed, population, n_units)


def about(number: int) -> int:
    """Return a number rounded to two figures, for people."""
    return round(number, 2 - len(str(number)))


def upper_bound(n_wrong: float, n_units: int) -> float:
    """Return the bound at 95 % on a share, of units that were wrong among others."""
    if n_wrong >= n_units:
        return 1.0
    return float(beta.ppf(CONFIDENCE, n_wrong + 1, n_units - n_wrong))
