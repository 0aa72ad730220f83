"""Where to touch next without thinking: at random, or along a raster.

A strategy answers from the belief and the attempts so far, and from nothing else:
given the same history it answers the same, so that an episode that was interrupted
goes on as it would have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from .._checks import check_count
from ..simulation import SensorPose
from ._hemisphere import Hemisphere
from ._record import TouchRecord

if TYPE_CHECKING:
    from ..recognition import Belief
    from ._placed_belief import PlacedBelief


class Strategy(Protocol):
    """Chooses where to touch next.

    `hemisphere` is where all its poses lie.
    """

    @property
    def hemisphere(self) -> Hemisphere: ...

    def next_pose(
        self, belief: Belief | PlacedBelief | None, history: Sequence[TouchRecord]
    ) -> SensorPose:
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

    def next_pose(self, belief: Any, history: Sequence[TouchRecord]) -> SensorPose:
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

    def next_pose(self, belief: Any, history: Sequence[TouchRecord]) -> SensorPose:
        """Return the pose that follows `history`; after the last comes the first."""
        ring, place = divmod(len(history), self.n_around)
        ring %= self.n_rings
        lowest = np.sin(self.hemisphere.lowest_rad)
        height = lowest + (1 - lowest) * (ring + 0.5) / self.n_rings
        turns = (place + 0.5 * (ring % 2)) / self.n_around
        way = -1 if ring % 2 else 1
        return self.hemisphere.pose(2 * np.pi * way * turns, np.arcsin(height))
