"""What so few objects can show about an error, whatever the arithmetic says."""

from math import ceil, log, log1p
from typing import NamedTuple

from scipy.stats import beta

from ._sentences import OTHER_SESSION

CONFIDENCE = 0.95


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
        Whether the recogniser serves in another session without confirmed touches: no
        touches of such a session were left out.
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
