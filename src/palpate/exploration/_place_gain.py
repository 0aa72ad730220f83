"""What a touch is expected to tell of the object, by the filter over places.

For a candidate place, hypotheses drawn from the belief take turns in being true: each
says where the tip would be stopped, with its spread, and one of the training touches
near that station of its object stands for the picture. Both change the probabilities
of all hypotheses; how much more probable (nats) the true object becomes, on average,
is the expected gain of the candidate: the mutual information of the object and the
touch,

    I(c) = mean over h of log p(object of h | depth and picture that h predicts at c)
           - log p(object of h).

A line on which nothing would be met is a depth like any other: that of the centre.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from .._numbers import exp
from .._types import Floats, Indices, Singles
from ._place_filter import in_frames
from ._surface import met_along

if TYPE_CHECKING:
    from ._place_belief import PlaceBelief
    from ._surface_map import SurfaceMap

N_DRAWN = 96
_FAR_MM = 200.0
_LEAST_DENSITY = -12.0


class PlaceGain:
    """Expected gains of candidate places on rings round the object.

    Parameters
    ----------
    surface_map : SurfaceMap
        Fitted.
    candidates : ndarray of shape (n_rings, n_around, 3)
        Unit vectors outward, each ring at one height.
    """

    def __init__(self, surface_map: SurfaceMap, candidates: Floats) -> None:
        self._map = surface_map
        self._outs = candidates.reshape(-1, 3)
        n_rings, n_around, _ = candidates.shape
        self._ring = np.repeat(np.arange(n_rings), n_around)
        self._azimuth = np.arctan2(self._outs[:, 1], self._outs[:, 0])
        self._step = 2 * np.pi / surface_map.n_turns
        if surface_map.use_pictures:
            self._pictures, self._closeness = self._at_stations(candidates[:, 0])

    def _at_stations(self, first: Floats) -> tuple[Singles, Floats]:
        """Return the evidence of training touches, and K, at stations of the rings.

        (n_rings, n_turns, n_states, n_touches) and (n_rings, n_turns, n_touches).
        """
        pictures, n_turns = self._map.pictures_, self._map.n_turns
        turn = np.arange(n_turns) * self._step
        flat = np.hypot(first[:, 0], first[:, 1])[:, None]
        height = np.repeat(first[:, 2:], n_turns, axis=1)
        stations = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=-1)
        closeness = pictures.closeness(stations.reshape(-1, 3))
        ratio = pictures.station_ratio(*pictures.left_out(), closeness)
        # As if each station of a ring were a turn.
        n_rings, n_touches = len(first), ratio.shape[-1]
        turns = ratio.reshape(n_rings, n_turns, -1, n_touches).transpose(0, 3, 2, 1)
        of_states = self._map.of_states(turns.reshape(-1, *turns.shape[2:]))
        by_ring = of_states.reshape(n_rings, n_touches, -1, n_turns)
        ratio = by_ring.transpose(0, 3, 2, 1).reshape(len(ratio), -1, n_touches)
        by_state = self._map.by_state(pictures.left_out_by_object).T
        evidence = pictures.touch_weight_ * by_state + pictures.placed_weight_ * ratio
        shape = n_rings, n_turns, len(by_state), -1
        return (
            evidence.astype(np.float32).reshape(shape),
            closeness.reshape(len(first), n_turns, -1),
        )

    def expected_gain(self, belief: PlaceBelief) -> Floats:
        """Return the expected gain of each candidate (nats), (n_candidates,)."""
        drawn = self._drawn(belief)
        states, poses = belief.filter.states[drawn], belief.filter.mean[drawn]
        radius, variance = self._met(belief, drawn)
        # What h predicts, (n_candidates, n_drawn), spread over nine tenths.
        count = len(drawn)
        quantile = np.asarray((np.arange(count) * 0.618034 + 0.309017) % 1, float)
        depth = radius + np.sqrt(variance) * ndtri(0.05 + 0.9 * quantile)
        off = (depth[:, :, None] - radius[:, None]).astype(np.float32)
        inverse = (-0.5 / variance).astype(np.float32)[:, None]
        scale = (-0.5 * np.log(variance)).astype(np.float32)[:, None]
        logs = np.maximum(off * off * inverse, np.float32(_LEAST_DENSITY)) + scale
        if self._map.use_pictures:
            logs += self._shown(belief, states, poses, quantile)
        logs -= logs.max(axis=2, keepdims=True)
        shares = exp(np.ascontiguousarray(logs))
        objects = self._map.object_of_state_[states]
        belongs = np.eye(int(objects.max()) + 1, dtype=np.float32)[objects]
        by_object = shares @ belongs
        share_of_truth = np.take_along_axis(by_object, objects[None, :, None], axis=2)[
            ..., 0
        ]
        after = np.log(np.maximum(share_of_truth, 1e-12) / by_object.sum(axis=2))
        before = np.log(belongs.mean(axis=0)[objects])
        return np.asarray((after - before).mean(axis=1), dtype=np.float64)

    def _drawn(self, belief: PlaceBelief) -> Indices:
        """Draw hypotheses evenly from the belief, the same for the same belief."""
        total = np.cumsum(np.exp(belief.log_joint))
        levels = (np.arange(N_DRAWN) + 0.5) / N_DRAWN * total[-1]
        rows = np.searchsorted(total, levels)
        return np.asarray(np.minimum(rows, len(total) - 1))

    def _met(self, belief: PlaceBelief, drawn: Indices) -> tuple[Floats, Floats]:
        """Return where the ball's middle stops and its variance, (n_candidates, n)."""
        beliefs = belief.filter
        states, poses = beliefs.states[drawn], beliefs.mean[drawn]
        outs = self._outs[:, None]
        far = in_frames(_FAR_MM * outs, poses)
        way = in_frames(-outs + poses[:, 1:], poses)
        radius, variance = met_along(self._map.choice_table_, states, far, way)
        # From the point nearest the object's origin to the one nearest the centre.
        along = np.einsum("ci,hi->ch", self._outs, poses[:, 1:])
        loose = beliefs.covariance[drawn][:, 1:, 1:]
        pose = np.einsum("ci,hij,cj->ch", self._outs, loose, self._outs)
        return radius + along, variance + pose + beliefs.looseness.sensor_mm**2

    def _shown(
        self, belief: PlaceBelief, states: Indices, poses: Floats, quantile: Floats
    ) -> Singles:
        """Return what the picture that h stands for says, (n_candidates, n, n)."""
        steps = (self._azimuth[:, None] - poses[:, 0]) / self._step
        turn = np.round(steps).astype(np.intp) % self._map.n_turns
        ring = self._ring[:, None]
        # One training touch near the station of h, of its own state.
        pictures = self._map.pictures_
        example = np.zeros(turn.shape, np.intp)
        for state in np.unique(states):
            of_picture = self._map.picture_of_state_[state]
            code = self._map.object_of_state_[state]
            rows = np.flatnonzero(pictures.codes_ == code)
            if of_picture >= 0:
                rows = pictures.rows_of_object[of_picture]
            of_state = np.flatnonzero(states == state)
            near = self._closeness[ring, turn[:, of_state]][..., rows]
            total = np.cumsum(near, axis=-1)
            share = ((quantile[of_state] * 7.3) % 1)[None, :, None]
            place = (total < share * total[..., -1:]).sum(axis=-1)
            example[:, of_state] = rows[np.minimum(place, len(rows) - 1)]
        count = pictures.sequence_calibration.weight(belief.touches_used + 1)
        evidence = self._pictures[
            ring[:, :, None], turn[:, None], states[None, None], example[:, :, None]
        ]
        return np.asarray(np.float32(count) * evidence)
