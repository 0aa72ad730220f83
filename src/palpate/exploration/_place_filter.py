"""A filter over object, face, turn and place, and what the next touch would tell.

Many small Kalman filters, one evidence. Each hypothesis is a state (an object on one of
its faces), a turn about the vertical from a grid of `n_turns`, and a normal density
over how far the pose is from there: turn (radians), x, y and z (mm). A touch says where
the middle of the tip's ball was stopped: that point must lie on the surface of the
object as it stands. A density is moved and narrowed by an unscented update of that
condition, which finds slopes and edges of the surface by looking at eight poses about
the middle one; the hypothesis gains the logarithm of the density of what was met. The
way up to a contact, and a line along which nothing was met, are free space: what
reaches into it loses.

    log p(met | hypothesis) = log[(1 - e) N(outside; 0, S) + e / L],

with `outside` the distance of the point from the surface, S the sum of its variances
(pose, surface, sensor's pose) and a share e of touches that nothing explains, over
L mm. A contact may shift the object: every one widens the densities a little.

For a candidate of the next touch, hypotheses drawn from the belief take turns in being
true: each says where the tip would be stopped, with its spread, and one of the training
touches near that station of its object stands for the picture. Both change the
probabilities of all hypotheses; how much more probable (nats) the true object becomes,
on average, is the expected gain: the mutual information of the object and the touch,

    I(c) = mean over h of log p(object of h | depth and picture that h predicts at c)
           - log p(object of h).

A line on which nothing would be met is a depth like any other: that of the centre.
A person with a sensor in the hand is told the place in a sentence (`advice`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy.special import ndtr, ndtri

from .._checks import check_number, check_positive
from .._numbers import exp
from .._types import Floats, Indices, Singles
from ..simulation import SensorPose
from ._surface import SurfaceTable, last_log_density, met_along
from ._touch_map import in_frames

if TYPE_CHECKING:
    from ._place_belief import PlaceBelief
    from ._surface_map import SurfaceMap

N_POSE = 4
_UNEXPLAINED, _OVER_MM = 0.03, 150.0
_MISS_STEPS = 16
_CUBATURE = np.sqrt(N_POSE) * np.concatenate([np.eye(N_POSE), -np.eye(N_POSE)])
N_DRAWN = 96
_FAR_MM = 200.0
_LEAST_DENSITY = -12.0
_STEEP, _FLAT = np.deg2rad(70), np.deg2rad(20)
# Steps that spread hypotheses evenly: of depths the golden ratio, of pictures one that
# does not go with it.
_GOLDEN, _OTHER_STEP = 0.618034, 7.3
# For words alone: shares of the height and the width from where on a touch is high, and
# near the rim; of the height about the middle; how much longer an oblong thing is.
_HIGH, _WIDE, _LEVEL, _OBLONG = 0.6, 0.5, 0.3, 1.3


@dataclass(frozen=True)
class Looseness:
    """How far things may be from where they should be (standard deviations).

    Parameters
    ----------
    placement_mm : float, default=6.0
        Of the object from the centre of the hemisphere, along x and y each.
    height_mm : float, default=3.0
        The same along z.
    sensor_mm : float, default=1.5
        Of the tip from where the arm says it is, each time.
    shift_share : float, default=0.05
        How far contacts may shift the object, as a share of its size; each contact
        slides it by a sixth of that and turns it by a quarter of that in radians.
    """

    placement_mm: float = 6.0
    height_mm: float = 3.0
    sensor_mm: float = 1.5
    shift_share: float = 0.05

    def __post_init__(self) -> None:
        check_positive("placement_mm", self.placement_mm)
        check_positive("height_mm", self.height_mm)
        check_number("sensor_mm", self.sensor_mm, low=0.0)
        check_number("shift_share", self.shift_share, low=0.0, high=1.0)


@dataclass(frozen=True, eq=False)
class PlaceFilter:
    """What is believed of states and poses; updates return another one.

    Of each hypothesis its state; the mean (n_hypotheses, 4) and covariance
    (n_hypotheses, 4, 4) of turn (radians), x, y, z (mm) of the object; and the log
    evidence of all that was met so far (nats).
    """

    table: SurfaceTable
    looseness: Looseness
    states: Indices
    mean: Floats
    covariance: Floats
    log_evidence: Floats

    @classmethod
    def before(cls, table: SurfaceTable, n_turns: int, looseness: Looseness) -> Self:
        """Return the filter before the first touch, `n_turns` a state in order."""
        n_states = len(table.mean_mm)
        states = np.repeat(np.arange(n_states), n_turns)
        turn = np.tile(np.arange(n_turns) * (2 * np.pi / n_turns), n_states)
        mean = np.zeros((len(states), N_POSE))
        mean[:, 0] = turn
        # A step of the grid, spread evenly.
        turn_sd = 2 * np.pi / n_turns / np.sqrt(12)
        aside, height = looseness.placement_mm, looseness.height_mm
        spread = np.diag(np.square([turn_sd, aside, aside, height]))
        covariance = np.repeat(spread[None], len(states), axis=0)
        nothing = np.zeros(len(states))
        return cls(table, looseness, states, mean, covariance, nothing)

    def met(self, middle_mm: Floats) -> PlaceFilter:
        """Return the filter after a contact with the ball's middle there, (3,)."""
        factor = np.linalg.cholesky(self.covariance)
        off = np.einsum("hij,kj->hki", factor, _CUBATURE)
        poses = self.mean[:, None] + off
        local = in_frames(middle_mm, poses)
        outside, variance = self.table.look_up(self.states[:, None], local)
        middle = outside.mean(axis=1)
        spread = outside - middle[:, None]
        touch_variance = variance.mean(axis=1) + self.looseness.sensor_mm**2
        total = (spread**2).mean(axis=1) + touch_variance
        normal = -(middle**2 / total + np.log(2 * np.pi * total)) / 2
        density = np.exp(with_unexplained(normal))
        explained = density - _UNEXPLAINED / _OVER_MM
        gain = np.einsum("hki,hk->hi", off, spread) / len(_CUBATURE)
        step = gain / total[:, None] * (explained / density)[:, None]
        mean = self.mean - step * middle[:, None]
        covariance = self.covariance - step[:, :, None] * gain[:, None]
        return replace(
            self,
            mean=mean,
            covariance=covariance + self._shift(),
            log_evidence=self.log_evidence + np.log(density),
        )

    def met_nothing(self, from_mm: Floats, to_mm: Floats) -> PlaceFilter:
        """Return the filter after the ball's middle went freely between two points."""
        share = np.linspace(0, 1, _MISS_STEPS)[:, None]
        points = from_mm + (to_mm - from_mm) * share
        local = in_frames(points, self.mean[:, None])
        outside, variance = self.table.look_up(self.states[:, None], local)
        nearest = outside.argmin(axis=1)[:, None]
        least = np.take_along_axis(outside, nearest, axis=1)[:, 0]
        pose = np.trace(self.covariance[:, 1:, 1:], axis1=1, axis2=2) / 3
        touch_variance = np.take_along_axis(variance, nearest, axis=1)[:, 0]
        chance = ndtr(
            least / np.sqrt(touch_variance + pose + self.looseness.sensor_mm**2)
        )
        chance = _UNEXPLAINED + (1 - 2 * _UNEXPLAINED) * chance
        return replace(self, log_evidence=self.log_evidence + np.log(chance))

    def _shift(self) -> Floats:
        share = self.looseness.shift_share
        slide = (share / 6 * self.table.size_mm[self.states]) ** 2
        added = np.zeros((len(self.states), N_POSE, N_POSE))
        added[:, 0, 0] = (share / 4) ** 2
        added[:, 1, 1] = added[:, 2, 2] = slide
        return added


def with_unexplained(log_density: Floats) -> Floats:
    """Return log densities of contacts, of which a share e is over L mm; see above."""
    log_rest = np.log(_UNEXPLAINED / _OVER_MM)
    return np.asarray(np.logaddexp(np.log1p(-_UNEXPLAINED) + log_density, log_rest))


@dataclass(frozen=True, eq=False)
class UnlearntSurfaces:
    """What was met, were it of surfaces that were never learnt (immutable).

    The mean radius of each, (n_surfaces,), is known to `mean_sd_mm`; `middles_mm`,
    (n_contacts, 3), are where the ball's middle was stopped, `log_evidence`,
    (n_surfaces,), is of all that was met so far (nats).
    """

    looseness: Looseness
    means_mm: Floats
    mean_sd_mm: float
    middles_mm: Floats
    log_evidence: Floats

    @classmethod
    def before(cls, means_mm: Floats, mean_sd_mm: float, looseness: Looseness) -> Self:
        """Return them before the first touch."""
        nothing = np.zeros((0, 3)), np.zeros(len(means_mm))
        return cls(looseness, means_mm, mean_sd_mm, *nothing)

    def met(self, middle_mm: Floats) -> UnlearntSurfaces:
        """Return them after a contact with the ball's middle there, (3,)."""
        middles = np.concatenate([self.middles_mm, middle_mm[None]])
        loose = self.looseness
        sds = [loose.placement_mm, loose.placement_mm, loose.height_mm]
        density = last_log_density(
            middles, self.means_mm, self.mean_sd_mm, np.square(sds), loose.sensor_mm
        )
        return replace(self, middles_mm=middles).weighed(with_unexplained(density))

    def weighed(self, log_likelihood: Floats) -> UnlearntSurfaces:
        """Return them with what something else says, (n_surfaces,), in nats."""
        return replace(self, log_evidence=self.log_evidence + log_likelihood)


def out_of_frames(points_mm: Floats, poses: Floats) -> Floats:
    """Return what `in_frames` takes, of what it returns."""
    cos, sin = np.cos(poses[..., 0]), np.sin(poses[..., 0])
    x, y, z = np.moveaxis(points_mm, -1, 0)
    turned = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
    return np.asarray(turned + poses[..., 1:])


class PlaceGain:
    """Expected gains of candidate places on rings round the object.

    `candidates` are unit vectors outward, (n_rings, n_around, 3).
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
        quantile = np.asarray((np.arange(count) * _GOLDEN + _GOLDEN / 2) % 1, float)
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
        of_truth = np.take_along_axis(by_object, objects[None, :, None], axis=2)[..., 0]
        after = np.log(np.maximum(of_truth, 1e-12) / by_object.sum(axis=2))
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
            share = ((quantile[of_state] * _OTHER_STEP) % 1)[None, :, None]
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

    Raises
    ------
    TypeError
        `belief` is another one.
    """
    if not hasattr(belief, "map"):
        raise TypeError(
            f"belief must be a PlaceBelief, got {type(belief).__name__}. "
            "`SurfaceMap.start` makes one."
        )
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
    if high > _HIGH:
        return "rim" if wide > _WIDE else "top"
    level = points[np.abs(points[:, 2]) < _LEVEL * max(float(points[:, 2].max()), 1e-6)]
    reach = np.hypot(*level[:, :2].T) if len(level) else np.ones(1)
    if reach.max() > _OBLONG * reach.min():
        longer = np.hypot(*met[:2]) > (reach.max() + reach.min()) / 2
        return "far end" if longer else "long side"
    return "side"
