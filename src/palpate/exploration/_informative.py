"""Where to touch next: where the answer is expected to tell most.

For a candidate place and every object and turn that is still possible, the training
touches near that place, on that object turned so, are what may be felt there. Each
would change the belief; the expected gain of the candidate is how much more probable
(in nats) the truth becomes, averaged over what may be true and what may be felt:

    I(c) = sum_(o, a) b(o, a) sum_i K_i(c turned back by a) [log b'(o | f_i) - log b(o)]

the mutual information of the object and the touch, under the map. Training touches
are weighed by what they would say had their stretch of the recording never been
learnt, so a place where the recogniser errs is worth little. A place near one that
was touched before feels the same again: its gain is scaled by 1 - exp(-d^2 / 2 w^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from .._checks import check_count
from ..simulation import SensorPose
from ._hemisphere import Hemisphere, outward
from ._placed_belief import PlacedBelief
from ._record import TouchRecord, as_touches
from ._touch_map import Floats, TouchMap, squared_distances

if TYPE_CHECKING:
    from ..recognition import Belief

_LEAST = np.float32(1e-30)


class Stations:
    """Places in the objects' own frame, and what may be felt at each.

    Parameters
    ----------
    touch_map : TouchMap
        What is known.
    places : ndarray of shape (n_stations, n_dimensions)
        The stations.
    station_of : ndarray of shape (n_candidates, n_turns)
        Which station a candidate is on an object that is turned so. Each candidate
        has another station for each turn, and two candidates share all or none.
    """

    def __init__(
        self, touch_map: TouchMap, places: Floats, station_of: NDArray[np.intp]
    ) -> None:
        self._map = touch_map
        self._station_of = station_of
        closeness = touch_map.closeness(places)
        ratio = touch_map.station_ratio(*touch_map.left_out(), closeness)
        felt = touch_map.touch_weight_ * touch_map.left_out_.T
        evidence = felt + touch_map.placed_weight_ * ratio
        self._closeness = closeness.astype(np.float32)
        self._evidence = self._floored(evidence.astype(np.float32))

    def expected_gain(self, log_joint: Floats, n_touches: int) -> Floats:
        """Return the expected gain (nats) of each candidate, (n_candidates,).

        Parameters
        ----------
        log_joint : ndarray of shape (n_objects, n_turns)
            The belief.
        n_touches : int
            How many touches it rests on.
        """
        joint = np.exp(log_joint).astype(np.float32)
        shape = (len(joint), len(self._station_of), len(self._closeness))
        turned = np.zeros(shape, np.float32)
        candidates = np.arange(len(self._station_of))[:, None]
        turned[:, candidates, self._station_of] = joint[:, None]
        felt = np.empty((shape[1], len(self._map.codes_)), np.float32)
        for code, rows in enumerate(self._map.rows_of_object):
            felt[:, rows] = turned[code] @ self._closeness[:, rows]
        after = self._after(turned, n_touches)
        before = joint.sum(axis=1)[self._map.codes_]
        gain = np.log(np.maximum(after, _LEAST)) - np.log(np.maximum(before, _LEAST))
        return np.asarray((felt * gain).sum(axis=1), dtype=np.float64)

    def _after(self, turned: Floats, n_touches: int) -> Floats:
        """Posterior of the true object after each touch, (n_candidates, n_touches)."""
        discount = np.float32(self._map.discount(n_touches + 1))
        likelihood = np.exp(discount * self._evidence)
        own = np.empty((turned.shape[1], likelihood.shape[2]), np.float32)
        everything = np.zeros_like(own)
        for code, rows in enumerate(self._map.rows_of_object):
            told = turned[code] @ likelihood[:, code]
            own[:, rows] = told[:, rows]
            everything += told
        after: Floats = own / np.maximum(everything, _LEAST)
        return after

    def _floored(self, evidence: Floats) -> Floats:
        """Apply the floor that a touch keeps for each object and turn."""
        total = logsumexp(evidence, axis=1)
        for stations in np.unique(np.sort(self._station_of, axis=1), axis=0):
            total[stations] = logsumexp(total[stations], axis=0)
        relative = evidence - total[:, None]
        floor = self._map.recogniser.floor_
        if floor == 0:
            return relative
        least = np.float32(np.log(floor / (self._map.n_objects * self._map.n_turns)))
        floored: Floats = np.logaddexp(np.float32(np.log1p(-floor)) + relative, least)
        return floored


class InformativeTouch:
    """Touches where most is expected to be learnt, given the belief.

    Parameters
    ----------
    touch_map : TouchMap
        What every object feels like from every side.
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
        self._candidates = self._grid()
        self._stations = Stations(touch_map, self._candidates, self._station_of())
        self._seen: list[TouchRecord] = []
        self._placed = touch_map.start()

    def next_pose(
        self, belief: Belief | PlacedBelief | None, history: Sequence[TouchRecord]
    ) -> SensorPose:
        """Return the pose of the candidate with the largest expected gain."""
        gain = self.expected_gain(belief, history)
        return self.hemisphere.pose_towards(self._candidates[int(gain.argmax())])

    def expected_gain(
        self, belief: Belief | PlacedBelief | None, history: Sequence[TouchRecord]
    ) -> Floats:
        """Return the expected gain of each candidate (nats), (n_candidates,)."""
        log_joint, n_touches = self._joint(belief, history)
        gain = self._stations.expected_gain(log_joint, n_touches)
        touched = -np.array([record.direction for record in history]).reshape(-1, 3)
        return gain * freshness(self._candidates, touched, self.touch_map.width_)

    def __repr__(self) -> str:
        return (
            f"InformativeTouch(hemisphere={self.hemisphere!r}, n_rings={self.n_rings}, "
            f"n_turns={self.touch_map.n_turns})"
        )

    def _grid(self) -> Floats:
        """Candidates ring after ring, (n_rings * n_turns, 3), outward."""
        lowest = np.sin(self.hemisphere.lowest_rad)
        heights = lowest + (1 - lowest) * (np.arange(self.n_rings) + 0.5) / self.n_rings
        turns = np.arange(self.touch_map.n_turns) * (2 * np.pi / self.touch_map.n_turns)
        return np.array([outward(a, np.arcsin(h)) for h in heights for a in turns])

    def _station_of(self) -> NDArray[np.intp]:
        """Turning an object by a step moves candidates one back along their ring."""
        n_turns = self.touch_map.n_turns
        ring, turn = np.divmod(np.arange(self.n_rings * n_turns), n_turns)
        back = (turn[:, None] - np.arange(n_turns)) % n_turns
        return ring[:, None] * n_turns + back

    def _joint(
        self, belief: Belief | PlacedBelief | None, history: Sequence[TouchRecord]
    ) -> tuple[Floats, int]:
        if isinstance(belief, PlacedBelief):
            return belief.log_joint, belief.touches_used
        placed = self._follow(history)
        if belief is None:
            return placed.log_joint, placed.touches_used
        turns = placed.log_joint - placed.log_posterior[:, None]
        shares = np.array(list(belief.posterior.values()))
        objects = np.log(np.maximum(shares, np.finfo(float).tiny))
        return turns + objects[:, None], belief.touches_used

    def _follow(self, history: Sequence[TouchRecord]) -> PlacedBelief:
        """Return the placed belief after `history`; what was encoded stays so."""
        felt = [record for record in history if record.touched]
        n_seen = len(self._seen)
        if n_seen > len(felt) or any(map(_differ, self._seen, felt)):
            self._seen, self._placed, n_seen = [], self.touch_map.start(), 0
        if len(felt) > n_seen:
            self._placed.update(as_touches(felt[n_seen:]))
            self._seen = felt
        return self._placed


def freshness(candidates: Floats, touched: Floats, width: float) -> Floats:
    """Return how much of a candidate's gain the places touched leave, (n,)."""
    if not len(touched):
        return np.ones(len(candidates))
    squared = squared_distances(candidates, touched)
    fresh: Floats = (1 - np.exp(squared / (-2 * width**2))).prod(axis=1)
    return fresh


def _differ(one: TouchRecord, other: TouchRecord) -> bool:
    return one is not other
