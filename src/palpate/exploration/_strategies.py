"""Where to touch next: the safe hemisphere, ways along it, and strategies on it.

Corradi et al. 2015 (doi:10.1109/ICRA.2015.7139744, V.A): 30 cm about the assumed
centre of the object, in the space above it; the sensor stands on it, faces the
centre, moves in, and comes back to it. Azimuth is about the vertical from x towards
y, elevation above the horizontal; both in radians.

A strategy answers from the belief and the attempts so far, and from nothing else:
given the same history it answers the same, so that an episode that was interrupted
goes on as it would have.

`InformativeTouch` goes where the answer is expected to tell most. For a candidate place
and every object and turn that is still possible, the training touches near that place,
on that object turned so, are what may be read there. Each would change the belief; the
expected gain of the candidate is how much more probable (in nats) the truth becomes,
averaged over what may be true and what may be read:

    I(c) = sum_(o, a) b(o, a) sum_i K_i(c turned back by a) [log b'(o | f_i) - log b(o)]

the mutual information of the object and the touch, under the map. Training touches
are weighed by what they would say had their block of the recording never been
learnt, so a place where the recogniser errs is worth little, or less than nothing. A
place near one that was touched before reads the same again: its gain is scaled by
1 - exp(-d^2 / 2 w^2). Where nothing promises anything, the freshest place is next.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from operator import is_not
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp

from .._checks import check_count, check_number, check_positive
from .._numbers import exp
from .._types import Floats
from ..simulation import SensorPose
from ._place_belief import PlaceBelief
from ._place_filter import PlaceGain
from ._record import History, as_touches
from ._surface_map import SurfaceMap
from ._touch_map import PlacedBelief, TouchMap, check_learnt, freshness

if TYPE_CHECKING:
    from ..recognition import Belief

Floats32 = NDArray[np.floating[Any]]
_CLEAR_MM = 1.0
_LEAST_RADIUS_MM = 5.0  # less is in metres: the arm would go to the object's middle
_N_AROUND = 16
_LEAST_PROMISE = 1e-3
_LEAST = np.float32(1e-30)


@dataclass(frozen=True)
class Hemisphere:
    """A hemisphere on which the sensor stands between touches.

    Parameters
    ----------
    centre_mm : tuple of float, default=(0, 0, 0)
        Assumed centre of the object.
    radius_mm : float, default=300.0
        Radius, larger than the object with all its possible shifts.
    lowest_rad : float, default=0.0
        Least elevation: what is lower cannot be reached or is not safe.
    arc_rad : float, default=0.2
        Longest piece of a way along the hemisphere that is moved in a straight
        line; it passes inside by at most radius (1 - cos(arc / 2)): 1.5 mm of 300.
    """

    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius_mm: float = 300.0
    lowest_rad: float = 0.0
    arc_rad: float = 0.2

    def __post_init__(self) -> None:
        centre = tuple(check_number("centre_mm", float(c)) for c in self.centre_mm)
        if len(centre) != 3:
            raise ValueError(f"centre_mm must be x, y, z, got {self.centre_mm!r}.")
        object.__setattr__(self, "centre_mm", centre)
        if check_positive("radius_mm", self.radius_mm) < _LEAST_RADIUS_MM:
            raise ValueError(
                f"radius_mm must be at least {_LEAST_RADIUS_MM:g}, got "
                f"{self.radius_mm:g}. Give millimetres, and more than the object has."
            )
        check_number("lowest_rad", self.lowest_rad, low=0.0, high=1.5)
        check_number("arc_rad", self.arc_rad, low=0.01, high=0.5)

    def pose(
        self, azimuth_rad: float, elevation_rad: float, roll_rad: float = 0.0
    ) -> SensorPose:
        """Return the pose on the hemisphere there, facing the centre."""
        return self.pose_towards(outward(azimuth_rad, elevation_rad), roll_rad)

    def pose_towards(self, out: ArrayLike, roll_rad: float = 0.0) -> SensorPose:
        """Return the pose in the direction `out` from the centre, facing it."""
        way = np.asarray(out, dtype=np.float64)
        way = way / np.linalg.norm(way)
        place = np.asarray(self.centre_mm) + self.radius_mm * way
        return SensorPose(place, -way, roll_rad)

    def way_out_mm(self, pose: SensorPose) -> float:
        """How far a pose must be pulled back until it is on the hemisphere.

        0 for one that is outside already.
        """
        arm = np.asarray(pose.position_mm) - np.asarray(self.centre_mm)
        outside = float(arm @ arm) - self.radius_mm**2
        if outside >= -2 * self.radius_mm * _CLEAR_MM:
            return 0.0
        along = float(arm @ -np.asarray(pose.direction))
        return -along + float(np.sqrt(along**2 - outside))

    def way(self, start: SensorPose, end: SensorPose) -> Iterator[SensorPose]:
        """Yield poses from one outside the hemisphere to one on it, round the object.

        The last is `end`; all face the centre and are outside or on the hemisphere.
        Where the shortest way would pass underneath the object, or all ways are as
        long, it leads over the top.
        """
        centre = np.asarray(self.centre_mm)
        arm, goal = (np.asarray(p.position_mm) - centre for p in (start, end))
        distance = np.linalg.norm(arm), np.linalg.norm(goal)
        first, last = arm / distance[0], goal / distance[1]
        angle = float(np.arccos(np.clip(first @ last, -1, 1)))
        n_pieces = max(1, int(np.ceil(angle / self.arc_rad)))
        shares = np.arange(1, n_pieces)[:, np.newaxis] / n_pieces
        outs = np.sin((1 - shares) * angle) * first + np.sin(shares * angle) * last
        is_opposite = angle > np.pi - 1e-6
        if not is_opposite:
            outs /= np.linalg.norm(outs, axis=1, keepdims=True)
        least = min(first[2], last[2]) - _CLEAR_MM / self.radius_mm
        if is_opposite or outs[:, 2].min(initial=1.0) < least:
            over = (0.0, 0.0, 1.0) if last[2] < 1 - 1e-9 else (1.0, 0.0, 0.0)
            between = self.pose_towards(over, end.roll_rad)
            yield from self.way(start, between)
            yield from self.way(between, end)
            return
        for share, out in zip(shares[:, 0], outs, strict=True):
            reach = (1 - share) * distance[0] + share * distance[1]
            yield SensorPose(centre + reach * out, -out, end.roll_rad)
        yield end


class Strategy(Protocol):
    """Chooses where to touch next.

    `hemisphere` is where all its poses lie.
    """

    @property
    def hemisphere(self) -> Hemisphere: ...

    def next_pose(self, belief: Belief | None, history: History) -> SensorPose:
        """Return a pose on the hemisphere from which to move in.

        `belief` is None while an object is taught: there is none to hold yet. `history`
        has attempts that met nothing, too: one that counts touches alone would go
        where nothing is for ever.
        """


@dataclass(frozen=True)
class RandomHemisphere:
    """Points drawn evenly from the surface of the hemisphere, as in Corradi 2015.

    Parameters
    ----------
    hemisphere : Hemisphere
        Where the poses lie.
    random_state : int, default=0
        Same number, same poses.

    Examples
    --------
    >>> from palpate.exploration import Hemisphere, RandomHemisphere
    >>> pose = RandomHemisphere(Hemisphere(radius_mm=300)).next_pose(None, [])
    >>> round(float((pose.position_mm**2).sum() ** 0.5))
    300
    """

    hemisphere: Hemisphere = field(default_factory=Hemisphere)
    random_state: int = 0

    def __post_init__(self) -> None:
        check_count("random_state", self.random_state, at_least=0)

    def next_pose(self, belief: Any, history: History) -> SensorPose:
        """Return the pose that follows `history`; the belief does not matter."""
        rng = np.random.default_rng([self.random_state, len(history)])
        lowest = np.sin(self.hemisphere.lowest_rad)
        height = rng.uniform(lowest, 1)
        return self.hemisphere.pose(rng.uniform(0, 2 * np.pi), np.arcsin(height))


@dataclass(frozen=True)
class Raster:
    """A fixed raster over the hemisphere, ring after ring from the lowest up.

    Parameters
    ----------
    hemisphere : Hemisphere
        Where the poses lie.
    n_rings : int, default=4
        Rings of equal height, so that each stands for the same area.
    n_around : int, default=8
        Poses on each ring; every other ring is turned by half a step and goes the
        other way round, so that the arm never has far to go.
    """

    hemisphere: Hemisphere = field(default_factory=Hemisphere)
    n_rings: int = 4
    n_around: int = 8

    def __post_init__(self) -> None:
        check_count("n_rings", self.n_rings)
        check_count("n_around", self.n_around)

    def next_pose(self, belief: Any, history: History) -> SensorPose:
        """Return the pose that follows `history`; after the last comes the first."""
        ring, place = divmod(len(history), self.n_around)
        ring %= self.n_rings
        lowest = np.sin(self.hemisphere.lowest_rad)
        height = lowest + (1 - lowest) * (ring + 0.5) / self.n_rings
        turns = (place + 0.5 * (ring % 2)) / self.n_around
        way = -1 if ring % 2 else 1
        return self.hemisphere.pose(2 * np.pi * way * turns, np.arcsin(height))


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
        joint = exp(log_joint).astype(np.float32)
        turned = joint[:, self._back]
        weight = np.float32(self._map.sequence_calibration.weight(n_touches + 1))
        by_object = turned[:, np.newaxis] @ exp(weight * self._evidence)
        total_share = np.maximum(by_object.sum(axis=0), _LEAST)
        total = np.zeros(total_share.shape[:2])
        for code, rows in enumerate(self._map.rows_of_object):
            chance = turned[code] @ self._closeness[..., rows]
            after = by_object[code][..., rows] / total_share[..., rows]
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
        weighted = np.float32(np.log1p(-floor)) + relative
        return np.asarray(np.logaddexp(weighted, least))


class InformativeTouch:
    """Touches where most is expected to be learnt, given the belief.

    Parameters
    ----------
    touch_map : TouchMap or SurfaceMap
        What touches of every object are like from every side, and perhaps where its
        surface is.
    hemisphere : Hemisphere, optional
        Where the poses lie.
    n_rings : int, default=6
        Rings of candidates, of equal height; `touch_map.n_turns` on each, 16 with a
        `SurfaceMap`.
    nats_per_second : float, default=0.005
        What a second of the way along the hemisphere must bring, with a `SurfaceMap`.
    speed_mm_s : float, default=100.0
        How fast the arm goes there.

    Notes
    -----
    With a `PlacedBelief` the belief over turns is used as it is. With a `Belief`, by
    images alone, the objects are as probable as it says, and the turns of each as
    the attempts so far make them. Without a belief the objects are equally probable.
    """

    def __init__(
        self,
        touch_map: TouchMap | SurfaceMap,
        hemisphere: Hemisphere | None = None,
        *,
        n_rings: int = 6,
        nats_per_second: float = 0.005,
        speed_mm_s: float = 100.0,
    ) -> None:
        if not isinstance(touch_map, TouchMap | SurfaceMap):
            raise TypeError(
                "touch_map must be a TouchMap or a SurfaceMap, got "
                f"{type(touch_map).__name__}. Fit one: TouchMap().fit(recogniser, ...)."
            )
        check_learnt(touch_map)
        self.touch_map = touch_map
        self.hemisphere = Hemisphere() if hemisphere is None else hemisphere
        self.n_rings = check_count("n_rings", n_rings)
        self.nats_per_second = check_number("nats_per_second", nats_per_second, low=0)
        self.speed_mm_s = check_positive("speed_mm_s", speed_mm_s)
        # Directions of the candidates, (n_rings, n_turns, 3), outward.
        lowest = np.sin(self.hemisphere.lowest_rad)
        heights = lowest + (1 - lowest) * (np.arange(n_rings) + 0.5) / n_rings
        by_surface = isinstance(touch_map, SurfaceMap)
        n_around = _N_AROUND if by_surface else touch_map.n_turns
        turns = np.arange(n_around) * (2 * np.pi / n_around)
        rings = [[outward(a, np.arcsin(h)) for a in turns] for h in heights]
        grid = np.array(rings)
        self._candidates = grid.reshape(-1, 3)
        self._gain: PlaceGain | Stations
        if isinstance(touch_map, SurfaceMap):
            self._gain = PlaceGain(touch_map, grid)
            self._width = touch_map.pictures_.width_
        elif (n_numbers := touch_map.places_.shape[1]) != 3:
            raise ValueError(
                f"touch_map must have places of x, y, z, got {n_numbers} numbers each. "
                "Fit it with the directions of touches."
            )
        else:
            self._gain, self._width = Stations(touch_map, grid), touch_map.width_
        # What was taken in of the attempts stays so.
        self._seen: History = ()
        self._placed = self._begun()

    def next_pose(self, belief: Belief | None, history: History) -> SensorPose:
        """Return the pose of the candidate with the largest expected gain."""
        touched = -np.array([record.direction for record in history]).reshape(-1, 3)
        fresh = freshness(self._candidates, touched, self._width)
        gain, cost = self.expected_gain(belief, history), np.zeros(len(fresh))
        if isinstance(self.touch_map, SurfaceMap):
            last = touched[-1] if len(touched) else np.array([0.0, 0.0, 1.0])
            way_rad = np.arccos(np.clip(self._candidates @ last, -1, 1))
            seconds = way_rad * self.hemisphere.radius_mm / self.speed_mm_s
            cost = self.nats_per_second * seconds
        best = most_promising(gain, fresh, cost)
        return self.hemisphere.pose_towards(self._candidates[best])

    def expected_gain(self, belief: Belief | None, history: History) -> Floats:
        """Return the expected gain of each candidate (nats), (n_candidates,).

        As if nothing near it had been touched; what was is `next_pose`'s business.
        """
        kind = type(self._placed)
        placed = belief if isinstance(belief, kind) else self._after(history)
        if isinstance(self._gain, PlaceGain):
            return self._gain.expected_gain(cast(PlaceBelief, placed))
        log_joint = placed.log_joint
        if belief is not None and belief is not placed:
            turns = log_joint - placed.log_posterior[:, None]
            shares = np.exp(belief.log_posterior)
            objects = np.log(np.maximum(shares, np.finfo(float).tiny))
            log_joint = turns + objects[:, None]
        n_touches = (placed if belief is None else belief).touches_used
        return self._gain.expected_gain(log_joint, n_touches)

    def _begun(self) -> PlaceBelief | PlacedBelief:
        if isinstance(self.touch_map, SurfaceMap):
            return self.touch_map.start_before(self.hemisphere)
        return self.touch_map.start()

    def _after(self, history: History) -> PlaceBelief | PlacedBelief:
        """Return the belief over places after `history`."""
        n_seen = len(self._seen)
        if n_seen > len(history) or any(map(is_not, self._seen, history)):
            self._placed, self._seen, n_seen = self._begun(), (), 0
        records = history[n_seen:]
        if isinstance(self._placed, PlaceBelief):
            for record in records:
                # What is far from all that is known tells nothing here.
                with suppress(ValueError):
                    self._placed.update_from_record(record)
        elif any(record.touched for record in records):
            self._placed.update(as_touches(records))
        self._seen = [*history]
        return self._placed

    def __repr__(self) -> str:
        return (
            f"InformativeTouch(hemisphere={self.hemisphere!r}, n_rings={self.n_rings}, "
            f"n_turns={self.touch_map.n_turns}, nats_per_second="
            f"{self.nats_per_second}, speed_mm_s={self.speed_mm_s})"
        )


def most_promising(gain: Floats, fresh: Floats, cost: Floats | float = 0.0) -> int:
    """Return the candidate with the largest gain that is still to be had, less cost.

    One that promises nothing is not taken while another does, however near it is.
    """
    for promise in (gain * fresh, fresh):
        worth = np.where(promise < _LEAST_PROMISE, -np.inf, promise - cost)
        if worth.max() > -np.inf:
            return int(worth.argmax())
    return int((fresh - cost).argmax())


def outward(azimuth_rad: float, elevation_rad: float) -> Floats:
    """Return the unit vector at an azimuth and an elevation, (3,)."""
    flat, height = np.cos(elevation_rad), np.sin(elevation_rad)
    return np.array([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), height])
