"""Widths and weights of a touch map, chosen on left-out episodes.

Episodes are drawn from the training touches of each object; each touch is judged by
a map without its stretch of the recording (or its session). The kernels, then the
weights, with the least log loss of the object win. How the object is turned is unknown
in these episodes as it is in real ones.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax, logsumexp

from ._places import Floats, turned_back

if TYPE_CHECKING:
    from ._touch_map import TouchMap

Weights = tuple[float, float, float]
Choice = tuple[Weights, float, float]
Episodes = list[NDArray[np.intp]]
# Widths in units of the places (radians, on a hemisphere), bandwidths as shares of
# the mean squared distance between features.
WIDTHS = (0.08, 0.15, 0.3, 0.6)
BANDWIDTHS = (0.03, 0.1, 0.3)
LENGTHS = (1, 2, 3, 5, 8)
EPISODES_PER_OBJECT = 30
_FIRST_WEIGHTS = (1.0, 1.0, 0.2)


def choose_kernels(touch_map: TouchMap, random_state: int) -> Choice:
    """Set the kernels of a map; return weights and log losses (nats) with them.

    Returns
    -------
    weights : tuple of float
        Of touches and of their places, and the correlation of touches.
    by_touch, by_place : float
        Log loss by the touches alone, and with their places.
    """
    episodes = _episodes(touch_map, random_state)
    losses = {}
    for width, share in product(WIDTHS, BANDWIDTHS):
        touch_map.set_kernels(width, share)
        ratio = _left_out_ratio(touch_map)
        losses[width, share] = _loss(touch_map, ratio, episodes, _FIRST_WEIGHTS)
    touch_map.set_kernels(*min(losses, key=lambda pair: losses[pair]))
    ratio = _left_out_ratio(touch_map)
    by_touch, _ = _best_weights(touch_map, 0 * ratio, episodes)
    by_place, weights = _best_weights(touch_map, ratio, episodes)
    return weights, by_touch, by_place


def _episodes(touch_map: TouchMap, random_state: int) -> Episodes:
    """Draw episodes of each length, (n_episodes, n_touches) training touches."""
    rng = np.random.default_rng(random_state)
    drawn = []
    for length in LENGTHS:
        rows = [
            rng.permutation(touches)[:length]
            for touches in touch_map.rows_of_object
            for _ in range(EPISODES_PER_OBJECT)
            if len(touches) >= length
        ]
        if rows:
            drawn.append(np.stack(rows))
    return drawn


def _left_out_ratio(touch_map: TouchMap) -> Floats:
    """Return log r of training touches at their own places, turned every way.

    Shape (n_touches, n_objects, n_turns); the first turn is the true one.
    """
    nearness, allowed = touch_map.left_out()
    stations = turned_back(touch_map.places_, touch_map.n_turns)
    shape = (len(nearness), touch_map.n_objects, touch_map.n_turns)
    result = np.empty(shape)
    for turn in range(touch_map.n_turns):
        closeness = touch_map.closeness(stations[:, turn])
        result[:, :, turn] = touch_map.own_ratio(nearness, allowed, closeness)
    return result


def _best_weights(
    touch_map: TouchMap, ratio: Floats, episodes: Episodes
) -> tuple[float, Weights]:
    """Return the least log loss and the weights that have it."""

    def weights(raw: NDArray[Any]) -> Weights:
        touch, placed = np.exp(np.clip(raw[:2], -4, 1))
        return float(touch), float(placed), float(1 / (1 + np.exp(-raw[2])))

    def loss(raw: NDArray[Any]) -> float:
        return _loss(touch_map, ratio, episodes, weights(raw))

    start = np.array([-0.3, -1.0, -1.0])
    options = {
        "initial_simplex": start + np.vstack([np.zeros(3), np.eye(3)]),
        "maxfev": 60,
        "xatol": 0.02,
    }
    found = minimize(loss, start, method="Nelder-Mead", options=options)
    return float(found.fun), weights(found.x)


def _loss(
    touch_map: TouchMap, ratio: Floats, episodes: Episodes, weights: Weights
) -> float:
    """Return the mean log loss (nats) of the object after drawn episodes."""
    evidence = touch_map.weighed(touch_map.left_out_, ratio, weights[:2])
    flat = evidence.reshape(len(evidence), -1)
    prior = np.repeat(touch_map.recogniser.log_prior(), touch_map.n_turns)
    losses = []
    for rows in episodes:
        discount = 1 / (1 + (rows.shape[1] - 1) * weights[2])
        joint = log_softmax(flat[rows].sum(axis=1) * discount + prior, axis=1)
        shape = (-1, touch_map.n_objects, touch_map.n_turns)
        posterior = logsumexp(joint.reshape(shape), axis=2)
        true = touch_map.codes_[rows[:, 0]]
        losses.append(-posterior[np.arange(len(rows)), true].mean())
    return float(np.mean(losses))
