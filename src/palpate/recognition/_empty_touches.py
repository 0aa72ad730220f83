"""Touches that hold no number at all, told by their ids where they have some."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ..images import NoLivingTaxelError
from ..touches import Touches, TouchSource

_SAID = 3


class EmptyTouchError(ValueError):
    """Touches hold nothing but NaN; `touch_ids` are their ids."""

    def __init__(self, touch_ids: list[str]) -> None:
        self.touch_ids = touch_ids
        more = " and more" * (len(touch_ids) > _SAID)
        super().__init__(
            "Touches must have at least one living taxel, got only NaN in touch "
            f"{', '.join(touch_ids[:_SAID])}{more}. Leave it out: retract it, or "
            f"choose others (id != {touch_ids[0]!r})."
        )


@contextmanager
def naming_empty(touches: Touches | TouchSource) -> Iterator[None]:
    """Name all the touches that hold no number, where learning stumbles over one."""
    try:
        yield
    except NoLivingTaxelError:
        ids = touches.touch_id
        if ids is None:
            raise
        empty = [row for row in range(len(ids)) if _is_empty(touches, row)]
        raise EmptyTouchError(ids[empty].tolist()) from None


def _is_empty(touches: Touches | TouchSource, row: int) -> bool:
    rows = np.array([row])
    touch = touches[rows] if isinstance(touches, Touches) else touches.touches(rows)
    return bool(np.isnan(touch.images.astype(np.float64)).all())
