"""Choosing among touches that were recorded already, by their places alone.

No robot: an object was touched at many places, and the question is in which order
its touches are best looked at. A chooser knows the places of all of them and the
belief after those it has seen, never the images of the others.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from palpate import Touches
from palpate.exploration import TouchMap
from palpate.exploration._strategies import Stations, most_promising
from palpate.exploration._touch_map import freshness
from palpate.recognition import Belief


class _Ordered:
    """Looks at recorded touches in an order that is fixed beforehand."""

    _order: np.ndarray

    def next_touch(self, belief: Any, used: Sequence[int]) -> int:
        """Return the next touch of the order."""
        return int(self._order[len(used)])


class RandomRecorded(_Ordered):
    """Looks at recorded touches in a random order."""

    def __init__(self, n_touches: int, random_state: int = 0) -> None:
        rng = np.random.default_rng(random_state)
        self._order = rng.permutation(n_touches)


class RasterRecorded(_Ordered):
    """Looks at recorded touches row after row, from the lowest place up.

    Parameters
    ----------
    places : array-like of shape (n_touches, n_dimensions)
        Height first; the last number runs along a row.
    row_height : float, default=0.2
        Heights that are rounded to the same multiple of this are one row.
    """

    def __init__(self, places: ArrayLike, row_height: float = 0.2) -> None:
        array = np.asarray(places, dtype=np.float64)
        row = np.round(array[:, 0] / row_height)
        along = np.where(row % 2 == 0, array[:, -1], -array[:, -1])
        self._order = np.lexsort((along, row))


class InformativeRecorded:
    """Looks first where most is expected to be learnt, as `InformativeTouch`.

    Parameters
    ----------
    touch_map : TouchMap
        With `n_turns=1`: the places are in a frame that is known.
    places : array-like of shape (n_touches, n_dimensions)
        Places of the recorded touches, in the units of the map's.
    """

    def __init__(self, touch_map: TouchMap, places: ArrayLike) -> None:
        if touch_map.n_turns != 1:
            raise ValueError(
                f"touch_map must have n_turns=1, got {touch_map.n_turns}. Recorded "
                "places are in a frame that is known."
            )
        self._map = touch_map
        self._places = np.asarray(places, dtype=np.float64)
        self._stations = Stations(touch_map, self._places[:, np.newaxis])

    def next_touch(self, belief: Belief, used: Sequence[int]) -> int:
        """Return the touch with the largest expected gain."""
        left = np.setdiff1d(np.arange(len(self._places)), list(used))
        gain = self.expected_gain(belief)[left]
        touched = self._places[list(used)]
        fresh = freshness(self._places[left], touched, self._map.width_)
        return int(left[most_promising(gain, fresh)])

    def expected_gain(self, belief: Belief) -> np.ndarray:
        """Return the expected gain of each touch (nats), (n_touches,)."""
        shares = np.exp(belief.log_posterior)
        log_joint = np.log(np.maximum(shares, np.finfo(float).tiny))[:, None]
        return self._stations.expected_gain(log_joint, belief.touches_used)


def look_at_recorded(
    touch_map: TouchMap,
    touches: Touches,
    places: ArrayLike,
    chooser: Any,
    n_touches: int | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Look at recorded touches of one object in the order that is chosen.

    Returns
    -------
    order : ndarray of shape (n_touches,)
        The touches in the order chosen.
    by_touch, by_place : ndarray of str, shape (n_touches,)
        The most probable object after each, by the images alone and with places.
    """
    where = np.asarray(places, dtype=np.float64)
    n_most = len(touches) if n_touches is None else n_touches
    belief = touch_map.start()
    used: list[int] = []
    named: list[tuple[str, str]] = []
    for _ in range(min(n_most, len(touches))):
        number = chooser.next_touch(belief, used)
        used.append(number)
        belief.update(touches[[number]], where[[number]])
        named.append((belief.best_without_places, belief.best))
    by_touch, by_place = np.array(named).reshape(-1, 2).T
    return np.array(used, dtype=np.intp), by_touch, by_place
