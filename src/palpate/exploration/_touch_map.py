"""What every known object feels like from every side, learnt from its touches.

The recogniser knows what an object feels like somewhere; a `TouchMap` knows where. A
place is a point in the object's own frame: for touches from a hemisphere the unit
vector from the centre towards the sensor. How the object is turned about the vertical
is unknown, so a hypothesis is an object AND one of `n_turns` turns.

For a touch with features f at a place u, under object o turned by a,

    log p(f | o, a, u) = c (t log p(f | o) + p log r),
    r = sum_j K(j) N(f; f_j, h) / mean_j N(f; f_j, h),

over the training touches j of o, with K(j) falling with the distance of j's place from
the place that u is on the object, and adding up to 1. So r says how much better the
place explains the touch than any place does, and is 1 where the map knows nothing.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax, logsumexp

from .._checks import check_count
from ..recognition import ObjectRecogniser, with_floor
from ..recognition._calibration import left_out_log_likelihood
from ..touches import Touches

if TYPE_CHECKING:
    from ._placed_belief import PlacedBelief

Floats = NDArray[np.float64]
# Widths in units of the places (radians, on a hemisphere), bandwidths as shares of
# the mean squared distance between features.
WIDTHS = (0.08, 0.15, 0.3, 0.6)
BANDWIDTHS = (0.01, 0.03, 0.1, 0.3)
LENGTHS = (1, 2, 3, 5, 8)
EPISODES_PER_OBJECT = 30
_ELSEWHERE = 1e-3
_TINY = 1e-6


class TouchMap:
    """Where on each object which touches are felt.

    Parameters
    ----------
    n_turns : int, default=24
        Turns about the vertical that are told apart; 1 where the object's own frame
        is known, or where places do not turn (heights and radii).
    random_state : int, default=0
        Seed of the drawn episodes that choose widths and weights.

    Attributes
    ----------
    places_ : ndarray of shape (n_touches, n_dimensions)
        Places of the training touches.
    features_ : ndarray of shape (n_touches, n_features)
        Their features.
    codes_ : ndarray of shape (n_touches,)
        Number of the object of each.
    width_, bandwidth_ : float
        Standard deviations of the kernels over places and over features.
    touch_weight_, placed_weight_, correlation_ : float
        t and p above, and c = 1 / (1 + (k - 1) correlation) after k touches.
    log_loss_ : dict of str to float
        Mean log loss (nats) of left-out episodes: "touch" by the touches alone,
        "placed" with their places.

    Notes
    -----
    Widths and weights minimise the log loss of episodes drawn from the training
    touches, each touch with its stretch of the recording (or its session) left out.
    Places of touches that nothing is near to fall back on the whole object.
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
        _refuse_others(recogniser, touches)
        self.recogniser = recogniser
        self.places_ = places_of(touches, places, self.n_turns)
        self.features_ = np.asarray(recogniser.features_)
        self.codes_ = np.searchsorted(recogniser.classes_, recogniser.labels_)
        self.group_ = np.asarray(recogniser.stretches_)
        self.rows_of_object = [
            np.flatnonzero(self.codes_ == code) for code in range(self.n_objects)
        ]
        squared = squared_distances(self.features_, self.features_)
        self._unit = float(squared.mean())
        self.left_out_ = log_softmax(
            left_out_log_likelihood(
                recogniser.classifier_,
                self.features_,
                recogniser.labels_,
                recogniser.stretches_,
            ),
            axis=1,
        )
        self._choose(squared)
        return self

    @property
    def n_objects(self) -> int:
        """Number of known objects."""
        return len(self.recogniser.classes_)

    def start(self) -> PlacedBelief:
        """Return the belief before the first touch of an episode."""
        from ._placed_belief import PlacedBelief

        return PlacedBelief(self)

    def placed_ratio(self, features: Floats, places: Floats) -> Floats:
        """Return log r of touches at places, (n_touches, n_objects, n_turns)."""
        nearness = self._feature_nearness(squared_distances(features, self.features_))
        stations = turned_back(places, self.n_turns)
        return np.stack(
            [
                self.station_ratio(row[None], None, self.closeness(station))[..., 0].T
                for row, station in zip(nearness, stations, strict=True)
            ]
        )

    def closeness(self, stations: Floats) -> Floats:
        """Return K of training touches about stations, (n_stations, n_touches).

        Stations are places in the object's frame. Each object's touches sum to 1.
        """
        squared = squared_distances(stations, self.places_)
        kernel = np.exp(squared / (-2 * self.width_**2)) + _ELSEWHERE
        for rows in self.rows_of_object:
            kernel[:, rows] /= kernel[:, rows].sum(axis=1, keepdims=True)
        return kernel

    def station_ratio(
        self, nearness: Floats, allowed: Floats | None, closeness: Floats
    ) -> Floats:
        """Return log r of touches at stations, (n_stations, n_objects, n_touches).

        Parameters
        ----------
        nearness : ndarray of shape (n_touches, n_training)
            N of their features about those of the training touches.
        allowed : ndarray of shape (n_touches, n_training) or None
            0 where a training touch may not speak about a touch, else 1.
        closeness : ndarray of shape (n_stations, n_training)
            From `closeness`.
        """
        shape = (len(closeness), self.n_objects, len(nearness))
        result = np.empty(shape, dtype=closeness.dtype)
        for code, rows in enumerate(self.rows_of_object):
            free = (
                np.ones((len(nearness), len(rows)))
                if allowed is None
                else (allowed[:, rows])
            )
            near = nearness[:, rows] * free
            here = closeness[:, rows] @ near.T
            weight = closeness[:, rows] @ free.T
            result[:, code] = _log_ratio(
                here, weight, near.sum(axis=1), free.sum(axis=1)
            )
        return result

    def left_out(self) -> tuple[Floats, Floats]:
        """Return `nearness` and `allowed` of training touches, (n, n) each.

        A touch hears nothing from its own stretch of the recording.
        """
        squared = squared_distances(self.features_, self.features_)
        allowed = (self.group_[:, None] != self.group_).astype(np.float64)
        return self._feature_nearness(squared), allowed

    def weighed(self, touch: Floats, placed: Floats) -> Floats:
        """Return the floored evidence of touches, (..., n_objects, n_turns).

        Parameters
        ----------
        touch : ndarray of shape (..., n_objects)
            log p(f | o).
        placed : ndarray of shape (..., n_objects, n_turns)
            log r.
        """
        return self._weighed(touch, placed, self.touch_weight_, self.placed_weight_)

    def discount(self, n_touches: int) -> float:
        """Return c after so many touches."""
        return 1 / (1 + (max(n_touches, 1) - 1) * self.correlation_)

    def _feature_nearness(self, squared: Floats) -> Floats:
        """N of features but for a factor per touch, at most 1."""
        least = squared.min(axis=1, keepdims=True)
        result: Floats = np.exp((squared - least) / (-2 * self.bandwidth_**2))
        return result

    def _weighed(
        self, touch: Floats, placed: Floats, touch_weight: float, placed_weight: float
    ) -> Floats:
        evidence = touch_weight * touch[..., None] + placed_weight * placed
        flat = evidence.reshape(*evidence.shape[:-2], -1)
        floored = with_floor(flat, self.recogniser.floor_)
        return floored.reshape(evidence.shape)

    def _choose(self, squared: Floats) -> None:
        """Choose kernels, then weights, by left-out episodes of known objects."""
        episodes = self._episodes()
        losses = {}
        for width, bandwidth in product(WIDTHS, BANDWIDTHS):
            self._set_kernels(width, bandwidth)
            ratio = self._left_out_ratio(squared)
            losses[width, bandwidth] = self._loss(ratio, episodes, (1.0, 1.0, 0.2))
        best = min(losses, key=lambda pair: losses[pair])
        self._set_kernels(*best)
        ratio = self._left_out_ratio(squared)
        touch_alone, _ = self._best_weights(0 * ratio, episodes)
        loss, weights = self._best_weights(ratio, episodes)
        self.touch_weight_, self.placed_weight_, self.correlation_ = weights
        self.log_loss_ = {"touch": touch_alone, "placed": loss}

    def _set_kernels(self, width: float, bandwidth: float) -> None:
        self.width_, self.bandwidth_ = width, float(np.sqrt(bandwidth * self._unit))

    def _left_out_ratio(self, squared: Floats) -> Floats:
        """Return log r of training touches at their own places, turned every way.

        Shape (n_touches, n_objects, n_turns); the first turn is the true one.
        """
        nearness = self._feature_nearness(squared)
        allowed = (self.group_[:, None] != self.group_).astype(np.float64)
        stations = turned_back(self.places_, self.n_turns)
        result = np.empty((len(squared), self.n_objects, self.n_turns))
        for turn in range(self.n_turns):
            closeness = self.closeness(stations[:, turn]) * allowed
            for code, rows in enumerate(self.rows_of_object):
                near = nearness[:, rows] * allowed[:, rows]
                here = (closeness[:, rows] * near).sum(axis=1)
                weight = closeness[:, rows].sum(axis=1)
                n_free = allowed[:, rows].sum(axis=1)
                result[:, code, turn] = _log_ratio(
                    here, weight, near.sum(axis=1), n_free
                )
        return result

    def _best_weights(
        self, ratio: Floats, episodes: list[NDArray[np.intp]]
    ) -> tuple[float, tuple[float, float, float]]:
        def weights(raw: NDArray[Any]) -> tuple[float, float, float]:
            touch, placed = np.exp(np.clip(raw[:2], -4, 1))
            return float(touch), float(placed), float(1 / (1 + np.exp(-raw[2])))

        def loss(raw: NDArray[Any]) -> float:
            return self._loss(ratio, episodes, weights(raw))

        start = np.array([-0.3, -1.0, -1.0])
        options = {
            "initial_simplex": start + np.vstack([np.zeros(3), np.eye(3)]),
            "maxfev": 60,
            "xatol": 0.02,
        }
        found = minimize(loss, start, method="Nelder-Mead", options=options)
        return float(found.fun), weights(found.x)

    def _loss(
        self,
        ratio: Floats,
        episodes: list[NDArray[np.intp]],
        weights: tuple[float, float, float],
    ) -> float:
        """Mean log loss (nats) of the object after drawn episodes."""
        evidence = self._weighed(self.left_out_, ratio, *weights[:2])
        flat = evidence.reshape(len(evidence), -1)
        prior = np.repeat(self.recogniser.log_prior(), self.n_turns)
        losses = []
        for rows in episodes:
            discount = 1 / (1 + (rows.shape[1] - 1) * weights[2])
            joint = log_softmax(flat[rows].sum(axis=1) * discount + prior, axis=1)
            shape = (-1, self.n_objects, self.n_turns)
            posterior = logsumexp(joint.reshape(shape), axis=2)
            true = self.codes_[rows[:, 0]]
            losses.append(-posterior[np.arange(len(rows)), true].mean())
        return float(np.mean(losses))

    def _episodes(self) -> list[NDArray[np.intp]]:
        """Draw episodes of each length, (n_episodes, n_touches) training touches."""
        rng = np.random.default_rng(self.random_state)
        drawn = []
        for length in LENGTHS:
            rows = [
                rng.permutation(touches)[:length]
                for touches in self.rows_of_object
                for _ in range(EPISODES_PER_OBJECT)
                if len(touches) >= length
            ]
            if rows:
                drawn.append(np.stack(rows))
        return drawn


def _log_ratio(here: Floats, weight: Floats, total: Floats, n_free: Floats) -> Floats:
    """Log of the weighted mean over the plain mean; 0 where nothing may speak."""
    placed = here / np.maximum(weight, _TINY)
    anywhere = total / np.maximum(n_free, 1)
    ratio: Floats = np.log((placed + _TINY) / (anywhere + _TINY))
    return ratio


def places_of(touches: Touches, places: ArrayLike | None, n_turns: int) -> Floats:
    """Return the places of touches, (n_touches, n_dimensions), or explain."""
    if places is None:
        directions = touches.columns.get("direction")
        if directions is None:
            raise ValueError(
                "touches must have a column 'direction' (unit vectors of approach), "
                f"got {', '.join(touches.columns) or 'none'}. Add it, or give places."
            )
        places = -np.asarray(directions)
    array = np.asarray(places, dtype=np.float64)
    if array.ndim != 2 or len(array) != len(touches) or not np.isfinite(array).all():
        raise ValueError(
            f"places must be finite, one row for each of {len(touches)} touches, got "
            f"shape {array.shape}."
        )
    if n_turns > 1 and array.shape[1] != 3:
        raise ValueError(
            f"places must be x, y, z to be turned, got {array.shape[1]} numbers each. "
            "Use TouchMap(n_turns=1) for places that do not turn."
        )
    return array


def turned_back(places: Floats, n_turns: int) -> Floats:
    """Return where places are on an object that is turned, (n_places, n_turns, p)."""
    if n_turns == 1:
        return places[:, None]
    angle = np.arange(n_turns) * (2 * np.pi / n_turns)
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = places.T[:, :, None]
    return np.stack(
        [cos * x + sin * y, cos * y - sin * x, np.repeat(z, n_turns, axis=1)], axis=-1
    )


def squared_distances(one: Floats, other: Floats) -> Floats:
    """Squared distances, (n_one, n_other)."""
    squared = (one**2).sum(axis=1)[:, None] + (other**2).sum(axis=1) - 2 * one @ other.T
    return np.maximum(squared, 0.0)


def _refuse_others(recogniser: ObjectRecogniser, touches: Touches) -> None:
    labels = touches.object if recogniser.label == "object" else touches.category
    if labels is None or not np.array_equal(labels, recogniser.labels_):
        raise ValueError(
            "touches must be those that the recogniser learnt, in the same order, got "
            f"{touches!r}. Fit both on the same touches."
        )
