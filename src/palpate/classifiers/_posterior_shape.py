"""From regression scores to a posterior: temperature, bend and lean by the loss."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from .._numbers import log_loss, log_softmax
from .._types import Array, Floats, Indices

# Touches that shape it at once: their answers stay in a processor's cache.
_SHAPED_AT_ONCE = 256
# Where the search for a temperature begins, and where it stays.
USUAL_TEMPERATURE = 8.0
_TEMPERATURES = float(np.exp(-3)), float(np.exp(6))
# Temperature, bend and lean of a posterior, and from where the best ones are sought.
Shape = tuple[float, float, float]
USUAL_SHAPE = USUAL_TEMPERATURE, 0.5, 1.0


def best_shape(
    scores: Floats, codes: Array, counts: Indices, start: Shape = USUAL_SHAPE
) -> tuple[Shape, float]:
    """Return (temperature, bend, lean) with the least log loss, and that loss (nats).

    Of touches of labels of which so many were learnt (`counts`). The lean counts where
    these numbers are unequal, and is 1 elsewhere. What is divided by is at least the
    share of training touches, as Bayes' rule says: touches left out lie among those of
    their recording, and show less lean than others will.
    """
    log_counts = log_counts_of(counts)
    shares, size = fair_shares(codes), np.abs(scores)
    n_free = 3 if np.ptp(log_counts) > 0 else 2

    def loss(raw: Floats) -> tuple[float, Floats]:
        temperature, bend = np.exp(raw[:2])
        lean = raw[2] if n_free > 2 else 1.0
        value, slopes = 0.0, np.zeros(3)
        for first in range(0, len(codes), _SHAPED_AT_ONCE):
            rows = slice(first, first + _SHAPED_AT_ONCE)
            damping = 1 + bend * size[rows]
            by_temperature = temperature * scores[rows] / damping
            logits = by_temperature - lean * log_counts
            part, pull = log_loss(logits, codes[rows], shares[rows])
            value += part
            slopes[0] += np.vdot(pull, by_temperature)
            slopes[2] -= pull.sum(axis=0) @ log_counts
            by_temperature /= damping
            by_temperature *= size[rows]
            slopes[1] -= bend * np.vdot(pull, by_temperature)
        return value, slopes[:n_free]

    solution = minimize(
        loss,
        [*np.log(start[:2]), start[2]][:n_free],
        jac=True,
        bounds=[tuple(np.log(_TEMPERATURES)), (-8.0, 6.0), (1.0, 6.0)][:n_free],
        method="L-BFGS-B",
        options={"ftol": 1e-13, "gtol": 1e-9},
    )
    lean = float(solution.x[2]) if n_free > 2 else 1.0
    return (*np.exp(solution.x[:2]).tolist(), lean), float(solution.fun)


def smoothed_loss(
    scores: Floats, codes: Array, temperature: float
) -> tuple[float, float]:
    """Return the log loss of smoothed labels (nats) and its best temperature.

    But for a constant. `temperature` is where to begin. Of n touches each counts as
    (n + 1) / (n + 2) of its label and shares the rest among the others: none of n does
    not mean never (Laplace's rule of succession; Platt, "Probabilistic outputs for
    support vector machines", 1999).
    Where all touches are told apart, the plain loss falls with the temperature for
    ever, and what is left is rounding; this one asks for wide and even gaps. It is
    convex: Newton's method.
    """
    n_touches, n_classes = scores.shape
    log_counts = log_counts_of(np.bincount(codes, minlength=n_classes))
    shares = fair_shares(codes)
    others = 1 / (n_touches + 2) / max(1, n_classes - 1)
    gaps = scores - scores[np.arange(n_touches), codes][:, np.newaxis]
    squares = gaps**2
    drift = -others * (shares @ gaps.sum(axis=1))
    low, high = _TEMPERATURES
    while True:
        loss, pull = log_loss(temperature * gaps - log_counts, codes, shares)
        slopes = np.einsum("ij,ij->i", pull, gaps)
        slope = slopes.sum() + drift
        curve = np.vdot(pull, squares) - slopes @ (slopes / shares)
        low, high = (low, temperature) if slope > 0 else (temperature, high)
        if slope**2 <= 1e-12 * curve or high < (1 + 1e-9) * low:
            return float(loss + temperature * drift), temperature
        temperature -= slope / curve if curve > 0 else np.inf
        if not low < temperature < high:
            temperature = float(np.sqrt(low * high))


def log_posterior(shape: Shape, scores: Floats, log_counts: Floats) -> Floats:
    """Log posterior under equal priors; `shape` is (temperature, bend, lean)."""
    temperature, bend, lean = shape
    bent = temperature * scores / (1 + bend * np.abs(scores))
    return log_softmax(bent - lean * log_counts)


def fair_shares(codes: Array) -> Floats:
    """Return the share of each touch in a mean to which all labels add the same."""
    counts = np.bincount(codes)
    return 1 / (counts[codes] * np.count_nonzero(counts))


def log_counts_of(counts: Indices) -> Floats:
    return np.asarray(np.log(np.maximum(counts, 1)))
