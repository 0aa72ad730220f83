"""What touches of every known object are like from every side.

The recogniser knows what touches of an object are like somewhere; a `TouchMap` knows
where. A place is a point in the object's own frame: for touches from a hemisphere the
unit vector from the centre towards the sensor. How the object is turned about the
vertical is unknown, so a hypothesis is an object AND one of `n_turns` turns. Among
recorded touches a place may be anything that is known beforehand, such as a height and
a radius. Places of the object's own frame are called stations.

For a touch with features f at a place u, under object o turned by a,

    log p(f | o, a, u) = c (t log p(f | o) + p log r),
    r = sum_j K(j) N(f; f_j, h) / mean_j N(f; f_j, h),

over the training touches j of o, with K(j) falling with the distance of j's place from
the place that u is on the object, and adding up to 1. So r says how much better the
place explains the touch than any place does, and is 1 where the map knows nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.special import logsumexp
from sklearn.exceptions import NotFittedError

from .._checks import STRANGERS, check_count
from .._numbers import exp, log_softmax, with_floor
from .._types import Array, Floats, Indices
from ..recognition import (
    Belief,
    Evidence,
    ObjectRecogniser,
    SequenceCalibration,
)
from ..touches import Touches
from ._record import places_of

Weights = tuple[float, float, float]
Episodes = list[Indices]
# Widths in units of the places (radians, on a hemisphere), bandwidths as shares of
# the mean squared distance between features.
WIDTHS = (0.08, 0.15, 0.3, 0.6)
BANDWIDTHS = (0.03, 0.1, 0.3)
LENGTHS = (1, 2, 3, 5, 8)
EPISODES_PER_OBJECT = 30
_FIRST_WEIGHTS = (1.0, 1.0, 0.2)
_ELSEWHERE = 1e-3
_TINY = 1e-6


class TouchMap:
    """Which touches are met where on each object.

    Parameters
    ----------
    n_turns : int, default=24
        Turns about the vertical that are distinguished; 1 where the object's own frame
        is known, or where places do not turn (heights and radii).
    random_state : int, default=0
        Seed of the drawn episodes that choose widths and weights.

    Attributes
    ----------
    places_ : ndarray of shape (n_touches, n_dimensions)
        Places of the training touches.
    features_ : ndarray of shape (n_touches, n_features)
        Their features.
    codes_, group_ : ndarray of shape (n_touches,)
        Number of the object of each, and of what is left out with it.
    left_out_ : ndarray of shape (n_touches, n_objects)
        log p(f | o) of each by what was learnt without its group.
    width_, bandwidth_ : float
        Standard deviations of the kernels over places and over features.
    touch_weight_, placed_weight_, correlation_ : float
        t and p above, and c = 1 / (1 + (k - 1) correlation) after k touches.
    log_loss_ : dict of str to float
        Mean log loss (nats) of left-out episodes: "touch" by the touches alone,
        "placed" with their places.
    """

    def __init__(self, *, n_turns: int = 24, random_state: int = 0) -> None:
        self.n_turns = n_turns
        self.random_state = random_state

    def fit(
        self,
        recogniser: ObjectRecogniser,
        touches: Touches,
        places: ArrayLike | None = None,
    ) -> Self:
        """Learn where the touches that `recogniser` learnt were made.

        Parameters
        ----------
        recogniser : ObjectRecogniser
            Fitted on these touches.
        touches : Touches
            The same, in the same order.
        places : array-like of shape (n_touches, n_dimensions), optional
            By default from the column `direction` (unit vectors of the approach, in
            the object's frame): the way back from the object.

        Raises
        ------
        ValueError
            The touches are not those, or they have no places.
        """
        check_count("n_turns", self.n_turns)
        vars(self).pop("classes_", None)
        memory = recogniser.learnt().memory
        labels = getattr(touches, recogniser.label, None)
        if labels is None or not np.array_equal(labels, memory.labels):
            raise ValueError(
                "touches must be those that the recogniser learnt, in the same order, "
                f"got {touches!r}. Fit both on the same touches."
            )
        self.recogniser = recogniser
        self.places_ = places_of(touches, places, self.n_turns)
        self.features_ = memory.features
        self.codes_ = np.searchsorted(recogniser.classes_, memory.labels)
        self.group_ = memory.blocks
        codes = range(len(recogniser.classes_))
        self.rows_of_object = [np.flatnonzero(self.codes_ == code) for code in codes]
        self._squared = squared_distances(self.features_, self.features_)
        self.left_out_ = log_softmax(recogniser.left_out_log_likelihood(), axis=1)
        self._choose()
        self.classes_ = recogniser.classes_  # from here on it is fitted
        return self

    def _choose(self) -> None:
        """Set the kernels, then the weights, with the least log loss of episodes."""
        # Each touch of theirs is judged by a map without its block (or session). How
        # the object is turned is unknown in them as it is in real ones.
        rng, episodes = np.random.default_rng(self.random_state), []
        for length in LENGTHS:
            rows = [
                rng.permutation(touches)[:length]
                for touches in self.rows_of_object
                for _ in range(EPISODES_PER_OBJECT)
                if len(touches) >= length
            ]
            episodes += [np.stack(rows)] if rows else []
        losses = {}
        for width, share in product(WIDTHS, BANDWIDTHS):
            self.set_kernels(width, share)
            ratio = self._left_out_ratio()
            losses[width, share] = self._loss(ratio, episodes, _FIRST_WEIGHTS)
        self.set_kernels(*min(losses, key=lambda pair: losses[pair]))
        ratio = self._left_out_ratio()
        by_touch, _ = self._best_weights(0 * ratio, episodes)
        by_place, weights = self._best_weights(ratio, episodes)
        self.touch_weight_, self.placed_weight_, self.correlation_ = weights
        self.log_loss_ = {"touch": by_touch, "placed": by_place}

    def _left_out_ratio(self) -> Floats:
        """Return log r of training touches at their places, turned every way."""
        left_out, ratios = self.left_out(), []
        for stations in turned_back(self.places_, self.n_turns).swapaxes(0, 1):
            close = self.closeness(stations)
            ratios.append(self.station_ratio(*left_out, close, row_by_row=True))
        return np.stack(ratios, axis=-1)

    def _best_weights(self, ratio: Floats, episodes: Episodes) -> tuple[float, Weights]:
        """Return the least log loss and the weights that have it."""

        def weights(raw: Array) -> Weights:
            touch, placed = np.exp(np.clip(raw[:2], -4, 1))
            return float(touch), float(placed), float(1 / (1 + np.exp(-raw[2])))

        def loss(raw: Array) -> float:
            return self._loss(ratio, episodes, weights(raw))

        simplex = np.array([-0.3, -1.0, -1.0]) + np.eye(4, 3, -1)
        options: Any = {"initial_simplex": simplex, "maxfev": 60, "xatol": 0.02}
        best = minimize(loss, simplex[0], method="Nelder-Mead", options=options)
        return float(best.fun), weights(best.x)

    def _loss(self, ratio: Floats, episodes: Episodes, weights: Weights) -> float:
        """Return the mean log loss (nats) of the object after drawn episodes."""
        flat = self.weighed(self.left_out_, ratio, weights[:2]).reshape(len(ratio), -1)
        prior, losses = np.repeat(self._log_prior(), self.n_turns), []
        for rows in episodes:
            discount = SequenceCalibration(1.0, weights[2]).weight(rows.shape[1])
            posterior = self._summed(flat[rows].sum(axis=1) * discount + prior)
            true = self.codes_[rows[:, 0]]
            losses.append(-posterior[np.arange(len(rows)), true].mean())
        return float(np.mean(losses))

    def _log_prior(self) -> Floats:
        """Return the log prior of what `rows_of_object` tells apart, (n_objects,)."""
        return self.recogniser.log_prior()

    def _summed(self, joint: Floats) -> Floats:
        """Return log posteriors of labels by log p of objects and turns (n, ...)."""
        joint = joint.reshape(-1, self.n_objects, self.n_turns)
        # Summed over turns; scipy's `logsumexp` takes six times as long.
        return log_softmax(joint[..., 0] - log_softmax(joint)[..., 0])

    @property
    def n_objects(self) -> int:
        """Number of known objects."""
        return len(self.rows_of_object)

    def start(
        self,
        prior: Mapping[str, float] | None = None,
        strangers: float = STRANGERS,
    ) -> PlacedBelief:
        """Return the belief before the first touch of an episode.

        Parameters
        ----------
        prior, strangers : optional
            As in `ObjectRecogniser.start`.
        """
        check_learnt(self)
        return PlacedBelief(self, prior, strangers)

    @property
    def sequence_calibration(self) -> SequenceCalibration:
        """How touches of one episode and their places add up."""
        return SequenceCalibration(1.0, self.correlation_)

    def set_kernels(self, width: float, bandwidth_share: float) -> None:
        """Set the width, and the bandwidth by its share of the features' spread."""
        spread = float(self._squared.mean())
        self.width_, self.bandwidth_ = width, float(np.sqrt(bandwidth_share * spread))

    def placed_ratio(self, features: Floats, places: Floats) -> Floats:
        """Return log r of touches at places, (n_touches, n_objects, n_turns)."""
        nearness = self._nearness(squared_distances(features, self.features_))
        stations = turned_back(places, self.n_turns)
        free = np.ones((1, len(self.places_)))
        ratios = [
            self.station_ratio(row[None], free, self.closeness(station))[..., 0].T
            for row, station in zip(nearness, stations, strict=True)
        ]
        return np.stack(ratios)

    def closeness(self, stations: Floats) -> Floats:
        """Return K of training touches about stations, (n_stations, n_touches)."""
        squared = squared_distances(stations, self.places_)
        kernel = exp(squared / (-2 * self.width_**2)) + _ELSEWHERE
        for rows in self.rows_of_object:
            kernel[:, rows] /= kernel[:, rows].sum(axis=1, keepdims=True)
        return kernel

    def left_out(self) -> tuple[Floats, Floats]:
        """Return N of training touches, and 0 for those of one group, (n, n) each."""
        allowed = (self.group_[:, None] != self.group_).astype(np.float64)
        return self._nearness(self._squared), allowed

    def station_ratio(
        self,
        nearness: Floats,
        allowed: Floats,
        closeness: Floats,
        row_by_row: bool = False,
    ) -> Floats:
        """Return log r of touches at stations, (n_stations, n_objects, n_touches).

        `nearness` holds N of the touches and `allowed` 0 where a training touch does
        not count for one, (n_touches, n_training); `closeness` is from `closeness`.
        r is the weighted mean over the plain mean, 1 where nothing counts. `row_by_row`
        asks of station i for touch i alone.
        """
        near, ratios = nearness * allowed, []
        for rows in self.rows_of_object:
            close, free = closeness[:, rows], allowed[:, rows]
            if row_by_row:
                sums = [
                    (close * weights).sum(axis=1) for weights in (free, near[:, rows])
                ]
            else:
                sums = [close @ weights.T for weights in (free, near[:, rows])]
            placed = sums[1] / np.maximum(sums[0], _TINY)
            n_free = np.maximum(free.sum(axis=1), 1)
            anywhere = near[:, rows].sum(axis=1) / n_free
            ratios.append(np.log((placed + _TINY) / (anywhere + _TINY)))
        return np.stack(ratios, axis=1)

    def weighed(
        self, touch: Floats, placed: Floats, weights: Sequence[float] | None = None
    ) -> Floats:
        """Return the floored evidence of touches, (..., n_objects, n_turns).

        `touch` is log p(f | o), (..., n_objects), and `placed` log r; other weights
        than `touch_weight_` and `placed_weight_` may be given.
        """
        by_touch, by_place = weights or (self.touch_weight_, self.placed_weight_)
        evidence = by_touch * touch[..., None] + by_place * placed
        flat = evidence.reshape(*evidence.shape[:-2], -1)
        floored = with_floor(flat, self.recogniser.floor_)
        return floored.reshape(evidence.shape)

    def _nearness(self, squared: Floats) -> Floats:
        """N of features but for a factor per touch, at most 1."""
        least = squared.min(axis=1, keepdims=True)
        return np.asarray(np.exp((squared - least) / (-2 * self.bandwidth_**2)))


def check_learnt(touch_map: Any) -> None:
    """Refuse a map that was not fitted, or of other objects than are known now."""
    if not hasattr(touch_map, "classes_"):
        name = type(touch_map).__name__
        raise NotFittedError(f"{name} has learnt nothing yet; call fit first.")
    if not np.array_equal(touch_map.classes_, touch_map.recogniser.classes_):
        raise ValueError(
            "The map must be of the objects that its recogniser knows, got "
            f"{', '.join(map(str, touch_map.classes_[:5]))}. Fit the map again."
        )


class BeliefOfPlaces(Belief):
    """What beliefs share that also know from where touches were made."""

    def __init__(
        self,
        recogniser: ObjectRecogniser,
        prior: Mapping[str, float] | None,
        strangers: float,
    ) -> None:
        model, evidence_of = recogniser.belief_model(), recogniser.evidence
        super().__init__(model, evidence_of, prior, strangers)

    def is_stuck(self, *args: Any, **kwargs: Any) -> bool:
        """Return False: touches at other places may always tell."""
        return False

    @property
    def best_without_places(self) -> str:
        """The object that is most probable by the pictures alone."""
        return str(self._model.classes[self._touch_log_posterior.argmax()])

    def _track_strangers(self, log_posterior: Floats, by_encoding: Floats) -> None:
        placed = self._joined()
        by_place = placed - log_posterior
        super()._track_strangers(placed, log_softmax(by_encoding + by_place, axis=-1))

    def _joined(self) -> Floats:
        """Believe pictures and places together; return log p of objects."""
        raise NotImplementedError


class PlacedBelief(BeliefOfPlaces):
    """A posterior over objects that also knows from where each touch was made.

    Made by `TouchMap.start`, and used as a `Belief` is. How the object is turned is
    believed along with what it is, and summed out. A touch without contact moves
    nothing, nor does its place.

    Attributes
    ----------
    log_joint : ndarray of shape (n_objects, n_turns)
        Log posterior of each object and turn (nats).
    """

    def __init__(
        self, touch_map: TouchMap, prior: Mapping[str, float] | None, strangers: float
    ) -> None:
        super().__init__(touch_map.recogniser, prior, strangers)
        self._map = touch_map
        self._placed = np.zeros((touch_map.n_objects, touch_map.n_turns))
        self._weigh()

    def update(
        self, touch: Touches | Array | Evidence, places: ArrayLike | None = None
    ) -> Self:
        """Take in touches, in order, and return this belief.

        Parameters
        ----------
        touch : Touches
            With the column `direction`, unless `places` are given.
        places : array-like of shape (n_touches, n_dimensions), optional
            Where they were made, as in `TouchMap.fit`.

        Raises
        ------
        ValueError
            The touches have no places, or the recogniser cannot take their images;
            the belief is then unchanged.
        TypeError
            They are no `Touches`.
        """
        where = places_of(touch, places, self._map.n_turns)
        assert isinstance(touch, Touches)
        evidence = self._evidence_of(touch)
        ratio = self._map.placed_ratio(evidence.features, where)
        # Places of touches that say nothing say nothing either.
        ratio[~evidence.log_likelihood.any(axis=1)] = 0.0
        log_pictures = log_softmax(evidence.log_likelihood, axis=1)
        for number, placed in enumerate(self._map.weighed(log_pictures, ratio)):
            self._placed = self._placed + placed
            super().update(evidence.of_touch(number))
        return self

    @property
    def log_posterior(self) -> Floats:
        """Log probability of each object, were it one of them (nats), (n_objects,)."""
        return np.asarray(logsumexp(self.log_joint, axis=1))

    def _joined(self) -> Floats:
        prior = log_softmax(self._prior_and_senses()) - np.log(self._map.n_turns)
        weight = self._map.sequence_calibration.weight(self._n_informative)
        joint = self._placed * weight + prior[:, np.newaxis]
        self.log_joint: Floats = joint - logsumexp(joint)
        return self.log_posterior


def turned_back(places: Floats, n_turns: int) -> Floats:
    """Return stations of places on an object turned about z, (n_places, n_turns, p)."""
    if n_turns == 1:
        return places[:, None]
    poses = np.zeros((n_turns, 4))
    poses[:, 0] = np.arange(n_turns) * (2 * np.pi / n_turns)
    return in_frames(places[:, None], poses)


def in_frames(points_mm: Floats, poses: Floats) -> Floats:
    """Return points (..., 3) of the hemisphere in the frames of poses (..., 4)."""
    from_it = points_mm - poses[..., 1:]
    cos, sin = np.cos(poses[..., 0]), np.sin(poses[..., 0])
    x, y, z = np.moveaxis(from_it, -1, 0)
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-1)


def squared_distances(left: Floats, right: Floats) -> Floats:
    """Return squared distances, (n_one, n_other)."""
    squared = (
        (left**2).sum(axis=1)[:, None] + (right**2).sum(axis=1) - 2 * left @ right.T
    )
    return np.asarray(np.maximum(squared, 0.0))


def freshness(candidates: Floats, touched: Floats, width: float) -> Floats:
    """Return the product over places touched of 1 - exp(-d^2 / 2 width^2)."""
    if not len(touched):
        return np.ones(len(candidates))
    squared = squared_distances(candidates, touched)
    return np.asarray((1 - exp(squared / (-2 * width**2))).prod(axis=1))
