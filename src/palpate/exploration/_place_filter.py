"""A filter over object, face, turn and place: many small Kalman filters, one evidence.

Each hypothesis is a state (an object on one of its faces), a turn about the vertical
from a grid of `n_turns`, and a normal density over how far the pose is from there:
turn (radians), x, y and z (mm). A touch says where the middle of the tip's ball was
stopped: that point must lie on the surface of the object as it stands. A density is
moved and narrowed by an unscented update of that condition, which finds slopes and
edges of the surface by looking at eight poses about the middle one; the hypothesis
gains the logarithm of the density of what was met. The way up to a contact, and a line
along which nothing was met, are free space: what reaches into it loses.

    log p(met | hypothesis) = log[(1 - e) N(outside; 0, S) + e / L],

with `outside` the distance of the point from the surface, S the sum of its variances
(pose, surface, sensor's pose) and a share e of touches that nothing explains, over
L mm. A contact may shift the object: every one widens the densities a little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.special import ndtr

from .._types import Floats, Indices
from ._surface import SurfaceTable, last_log_density

N_POSE = 4
_UNEXPLAINED, _OVER_MM = 0.03, 150.0
_MISS_STEPS = 16
_CUBATURE = np.sqrt(N_POSE) * np.concatenate([np.eye(N_POSE), -np.eye(N_POSE)])


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


@dataclass(frozen=True, eq=False)
class PlaceFilter:
    """What is believed of states and poses; updates return another one.

    Attributes
    ----------
    states : ndarray of shape (n_hypotheses,)
        State of each hypothesis.
    mean : ndarray of shape (n_hypotheses, 4)
        Turn (radians), x, y, z (mm) of the object.
    covariance : ndarray of shape (n_hypotheses, 4, 4)
    log_evidence : ndarray of shape (n_hypotheses,)
        Of all that was met so far (nats).
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
        density = np.exp(_log_density(middle, total))
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


def _log_density(outside_mm: Floats, variance_mm2: Floats) -> Floats:
    """Return log p(met | hypothesis), above, of points so far outside."""
    normal = -(outside_mm**2 / variance_mm2 + np.log(2 * np.pi * variance_mm2)) / 2
    return with_unexplained(normal)


@dataclass(frozen=True, eq=False)
class UnlearntSurfaces:
    """What was met, were it of surfaces that were never learnt (immutable).

    Attributes
    ----------
    means_mm : ndarray of shape (n_surfaces,)
        Mean radius of each, known to `mean_sd_mm`.
    middles_mm : ndarray of shape (n_contacts, 3)
        Where the ball's middle was stopped.
    log_evidence : ndarray of shape (n_surfaces,)
        Of all that was met so far (nats).
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


def in_frames(points_mm: Floats, poses: Floats) -> Floats:
    """Return points (..., 3) of the hemisphere in the frames of poses (..., 4)."""
    from_it = points_mm - poses[..., 1:]
    cos, sin = np.cos(poses[..., 0]), np.sin(poses[..., 0])
    x, y, z = np.moveaxis(from_it, -1, 0)
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-1)


def out_of_frames(points_mm: Floats, poses: Floats) -> Floats:
    """Return what `in_frames` takes, of what it returns."""
    cos, sin = np.cos(poses[..., 0]), np.sin(poses[..., 0])
    x, y, z = np.moveaxis(points_mm, -1, 0)
    turned = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
    return np.asarray(turned + poses[..., 1:])
