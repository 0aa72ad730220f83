"""Where to touch next: where the answer is expected to tell most.

For a candidate place and every object and turn that is still possible, the training
touches near that place, on that object turned so, are what may be read there. Each
would change the belief; the expected gain of the candidate is how much more probable
(in nats) the truth becomes, averaged over what may be true and what may be read:

    I(c) = sum_(o, a) b(o, a) sum_i K_i(c turned back by a) [log b'(o | f_i) - log b(o)]

the mutual information of the object and the touch, under the map. Training touches
are weighed by what they would say had their block of the recording never been
learnt, so a place where the recogniser errs is worth little, or less than nothing. A
place near one that was touched before reads the same again: its gain is scaled by
1 - exp(-d^2 / 2 w^2). Where nothing promises anything, the freshest place is next.
"""

from __future__ import annotations

from operator import is_not
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from .._checks import check_count
from .._types import Floats
from ..simulation import SensorPose
from ._place_geometry import freshness
from ._record import History, TouchRecord, as_touches
from ._strategies import Hemisphere, outward
from ._touch_map import PlacedBelief, TouchMap

if TYPE_CHECKING:
    from ..recognition import Belief

Floats32 = NDArray[np.floating[Any]]
_LEAST_PROMISE = 1e-3
_LEAST = np.float32(1e-30)


class Stations:
    """Rings of places round the objects, and the touches that may come of each.

    Turning an object by a step moves a candidate one station back along its ring.
    `places` are the stations, (n_rings, `touch_map.n_turns`, n_dimensions).
    """

    def __init__(self, touch_map: TouchMap, places: Floats) -> None:
        self._map = touch_map
        n_rings, n_turns, _ = places.shape
        closeness = touch_map.closeness(places.reshape(n_rings * n_turns, -1))
        ratio = touch_map.station_ratio(*touch_map.left_out(), closeness)
        by_touch = touch_map.touch_weight_ * touch_map.left_out_.T
        evidence = by_touch + touch_map.placed_weight_ * ratio
        shape = (n_rings, n_turns, touch_map.n_objects, len(touch_map.codes_))
        by_object = evidence.astype(np.float32).reshape(shape).transpose(2, 0, 1, 3)
        self._evidence = self._floored(by_object)
        self._closeness = closeness.astype(np.float32).reshape(n_rings, n_turns, -1)
        turn = np.arange(n_turns)
        self._back = (turn[:, None] - turn) % n_turns

    def expected_gain(self, log_joint: Floats, n_touches: int) -> Floats:
        """Return gains (nats), (n_rings * n_turns,), by belief (n_objects, n_turns)."""
        joint = np.exp(log_joint).astype(np.float32)
        turned = joint[:, self._back]
        weight = np.float32(self._map.sequence_calibration.weight(n_touches + 1))
        given = turned[:, np.newaxis] @ np.exp(weight * self._evidence)
        everything = np.maximum(given.sum(axis=0), _LEAST)
        total = np.zeros(everything.shape[:2])
        for code, rows in enumerate(self._map.rows_of_object):
            chance = turned[code] @ self._closeness[..., rows]
            after = given[code][..., rows] / everything[..., rows]
            before = np.maximum(joint[code].sum(), _LEAST)
            gain = np.log(np.maximum(after, _LEAST)) - np.log(before)
            total += (chance * gain).sum(axis=-1)
        return total.ravel()

    def _floored(self, evidence: Floats32) -> Floats32:
        """Apply the floor that a touch keeps for each object and turn."""
        # On an object turned every way a candidate meets every station of its ring.
        relative = evidence - logsumexp(evidence, axis=(0, 2), keepdims=True)
        floor = self._map.recogniser.floor_
        if floor == 0:
            return relative
        least = np.float32(np.log(floor / (self._map.n_objects * self._map.n_turns)))
        kept = np.float32(np.log1p(-floor)) + relative
        return np.asarray(np.logaddexp(kept, least))


class InformativeTouch:
    """Touches where most is expected to be learnt, given the belief.

    Parameters
    ----------
    touch_map : TouchMap
        What touches of every object are like from every side.
    hemisphere : Hemisphere, optional
        Where the poses lie.
    n_rings : int, default=6
        Rings of candidates, of equal height; `touch_map.n_turns` on each.

    Notes
    -----
    With a `PlacedBelief` the belief over turns is used as it is. With a `Belief`, by
    images alone, the objects are as probable as it says, and the turns of each as
    the attempts so far make them. Without a belief the objects are equally probable.
    """

    def __init__(
        self,
        touch_map: TouchMap,
        hemisphere: Hemisphere | None = None,
        *,
        n_rings: int = 6,
    ) -> None:
        self.touch_map = touch_map
        self.hemisphere = Hemisphere() if hemisphere is None else hemisphere
        self.n_rings = check_count("n_rings", n_rings)
        grid = self._grid()
        self._candidates = grid.reshape(-1, 3)
        self._stations = Stations(touch_map, grid)
        self._seen: list[TouchRecord] = []
        self._placed = touch_map.start()

    def next_pose(self, belief: Belief | None, history: History) -> SensorPose:
        """Return the pose of the candidate with the largest expected gain."""
        touched = -np.array([record.direction for record in history]).reshape(-1, 3)
        fresh = freshness(self._candidates, touched, self.touch_map.width_)
        best = most_promising(self.expected_gain(belief, history), fresh)
        return self.hemisphere.pose_towards(self._candidates[best])

    def expected_gain(self, belief: Belief | None, history: History) -> Floats:
        """Return the expected gain of each candidate (nats), (n_candidates,).

        As if nothing near it had been touched; what was is `next_pose`'s business.
        """
        log_joint, n_touches = self._joint(belief, history)
        return self._stations.expected_gain(log_joint, n_touches)

    def __repr__(self) -> str:
        return (
            f"InformativeTouch(hemisphere={self.hemisphere!r}, n_rings={self.n_rings}, "
            f"n_turns={self.touch_map.n_turns})"
        )

    def _grid(self) -> Floats:
        """Directions of the candidates, (n_rings, n_turns, 3), outward."""
        lowest = np.sin(self.hemisphere.lowest_rad)
        heights = lowest + (1 - lowest) * (np.arange(self.n_rings) + 0.5) / self.n_rings
        n_turns = self.touch_map.n_turns
        turns = np.arange(n_turns) * (2 * np.pi / n_turns)
        return np.array([[outward(a, np.arcsin(h)) for a in turns] for h in heights])

    def _joint(self, belief: Belief | None, history: History) -> tuple[Floats, int]:
        if isinstance(belief, PlacedBelief):
            return belief.log_joint, belief.touches_used
        placed = self._follow(history)
        if belief is None:
            return placed.log_joint, placed.touches_used
        turns = placed.log_joint - placed.log_posterior[:, None]
        shares = np.array(list(belief.posterior.values()))
        objects = np.log(np.maximum(shares, np.finfo(float).tiny))
        return turns + objects[:, None], belief.touches_used

    def _follow(self, history: History) -> PlacedBelief:
        """Return the placed belief after `history`; what was encoded stays so."""
        touched = [record for record in history if record.touched]
        n_seen = len(self._seen)
        if n_seen > len(touched) or any(map(is_not, self._seen, touched)):
            self._seen, self._placed, n_seen = [], self.touch_map.start(), 0
        if len(touched) > n_seen:
            self._placed.update(as_touches(touched[n_seen:]))
            self._seen = touched
        return self._placed


def most_promising(gain: Floats, fresh: Floats) -> int:
    """Return the candidate with the largest gain that is still to be had."""
    # Gains below zero are not made better by having been there.
    promise = np.where(gain > 0, gain * fresh, gain)
    if promise.max() < _LEAST_PROMISE:
        return int(fresh.argmax())
    return int(promise.argmax())
