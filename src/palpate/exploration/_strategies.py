"""Where to touch next: the safe hemisphere, ways along it, and strategies on it.

Corradi et al. 2015 (doi:10.1109/ICRA.2015.7139744, V.A): 30 cm about the assumed
centre of the object, in the space above it; the sensor stands on it, faces the
centre, moves in, and comes back to it. Azimuth is about the vertical from x towards
y, elevation above the horizontal; both in radians.

A strategy answers from the belief and the attempts so far, and from nothing else:
given the same history it answers the same, so that an episode that was interrupted
goes on as it would have.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_count, check_number, check_positive
from .._types import Floats
from ..simulation import SensorPose
from ._record import History

if TYPE_CHECKING:
    from ..recognition import Belief

_CLEAR_MM = 1.0


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
        x, y, z = (check_number("centre_mm", float(c)) for c in self.centre_mm)
        object.__setattr__(self, "centre_mm", (x, y, z))
        check_positive("radius_mm", self.radius_mm)
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
        """
        centre = np.asarray(self.centre_mm)
        arm, goal = (np.asarray(p.position_mm) - centre for p in (start, end))
        distance = np.linalg.norm(arm), np.linalg.norm(goal)
        first, last = arm / distance[0], goal / distance[1]
        angle = float(np.arccos(np.clip(first @ last, -1, 1)))
        n_pieces = max(1, int(np.ceil(angle / self.arc_rad)))
        for share in np.arange(1, n_pieces) / n_pieces:
            out = _between(first, last, angle, share)
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

        `belief` is None while an object is taught: there is none to hold yet.
        """
        ...


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


def outward(azimuth_rad: float, elevation_rad: float) -> Floats:
    """Return the unit vector at an azimuth and an elevation, (3,)."""
    flat, height = np.cos(elevation_rad), np.sin(elevation_rad)
    return np.array([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), height])


def _between(first: Floats, last: Floats, angle: float, share: float) -> Floats:
    """Point at a share of the arc; over the top where the ends are opposite."""
    if np.sin(angle) < 1e-6 and angle > 1:
        top = np.array([0.0, 0.0, 1.0])
        if share < 0.5:
            return _between(first, top, float(np.arccos(first[2])), 2 * share)
        return _between(top, last, float(np.arccos(last[2])), 2 * share - 1)
    if angle < 1e-9:
        return first
    ends = np.sin((1 - share) * angle) * first + np.sin(share * angle) * last
    return np.asarray(ends / np.linalg.norm(ends))
