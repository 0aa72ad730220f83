"""What a touch is expected to tell of the object, and where to touch next in words.

For a candidate place, hypotheses drawn from the belief take turns in being true: each
says where the tip would be stopped, with its spread, and one of the training touches
near that station of its object stands for the picture. Both change the probabilities
of all hypotheses; how much more probable (nats) the true object becomes, on average,
is the expected gain of the candidate: the mutual information of the object and the
touch,

    I(c) = mean over h of log p(object of h | depth and picture that h predicts at c)
           - log p(object of h).

A line on which nothing would be met is a depth like any other: that of the centre.
A person with a sensor in the hand is told the place in a sentence (`advice`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from .._numbers import exp
from .._types import Floats, Indices, Singles
from ..simulation import SensorPose
from ._place_filter import in_frames
from ._surface import met_along

if TYPE_CHECKING:
    from ._place_belief import PlaceBelief
    from ._surface_map import SurfaceMap

N_DRAWN = 96
_FAR_MM = 200.0
_LEAST_DENSITY = -12.0
_STEEP, _FLAT = np.deg2rad(70), np.deg2rad(20)


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


def advice(belief: PlaceBelief, pose: SensorPose) -> str:
    """Return one sentence: which part to touch, from where, and what it would tell.

    Parameters
    ----------
    belief : PlaceBelief
        What the touches so far say.
    pose : SensorPose
        Where to begin, as a strategy chooses it.

    Returns
    -------
    str
        As "Touch the rim, from 2 o'clock and above, to tell the mug from the porridge
        pot." Hours are seen from above, 12 away along y.
    """
    out = -np.asarray(pose.direction)
    height = float(np.arcsin(np.clip(out[2], -1, 1)))
    hour = round(float(np.degrees(np.arctan2(out[0], out[1]))) / 30) % 12 or 12
    side = f"from {hour} o'clock"
    if height > _STEEP:
        where = "from straight above"
    else:
        where = side if height < _FLAT else f"{side} and above"
    names = belief.map.recogniser.classes_[np.argsort(-belief.log_posterior)[:2]]
    purpose = ""
    if len(names) > 1:
        purpose = f", to tell the {names[0]} from the {names[1]}"
    return f"Touch the {_part(belief, out)}, {where}{purpose}."


def _part(belief: PlaceBelief, out: np.ndarray) -> str:
    """Return the part of the most probable object that is met from a direction."""
    pose, table = belief.pose(), belief.map.table_
    state = belief.map.states_.index((pose.object, pose.face))
    standing = np.array([pose.turn_rad, *pose.offset_mm])
    far = in_frames(_FAR_MM * out, standing)
    way = in_frames(standing[1:] - out, standing)
    radius, _ = met_along(table, np.array([state]), far[None], way[None])
    points, _ = belief.surface()
    points = points - belief.centre_mm - pose.offset_mm
    met = out * max(float(radius[0]) - belief.map.tip_radius_mm, 0.0)
    high = met[2] / max(float(points[:, 2].max()), 1e-6)
    wide = np.hypot(*met[:2]) / max(float(np.hypot(*points[:, :2].T).max()), 1e-6)
    if high > 0.6:
        return "rim" if wide > 0.5 else "top"
    level = points[np.abs(points[:, 2]) < 0.3 * max(float(points[:, 2].max()), 1e-6)]
    reach = np.hypot(*level[:, :2].T) if len(level) else np.ones(1)
    if reach.max() > 1.3 * reach.min():
        longer = np.hypot(*met[:2]) > (reach.max() + reach.min()) / 2
        return "far end" if longer else "long side"
    return "side"
