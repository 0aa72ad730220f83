"""Numbers as sentences for people have them, the same in terminal, page and reports."""

from math import floor


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


def about(number: int) -> int:
    """Return a number rounded to two figures."""
    return round(number, 2 - len(str(number)))


def n_touches_of(n_touches: int | str) -> str:
    """Return a number of touches in words: "1 touch", "5 touches"."""
    return f"{n_touches} touch{'es' * (str(n_touches) != '1')}"
