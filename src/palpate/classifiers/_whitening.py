"""Whitening: touches in units of the spread of all training touches."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._types import Floats

# Whitened coordinates end here, so that their squares are finite numbers.
FARTHEST = 1e100
# A feature with less spread than this share of its size is constant up to rounding.
ROUNDING = 1e-12


class Whitening(NamedTuple):
    """Where touches are, how far they spread, and along which directions."""

    centre: Floats  # (n_features,), mean of the training touches
    spread: Floats  # (n_features,), their standard deviation
    varies: NDArray[np.bool_]  # (n_features,), by more than rounding
    rotation: Floats | None  # (n_varying, n_directions), to unit variance
    log_volume: float  # of the unit cell, in units of the features


def learn_whitening(touches: Floats, *, full: bool) -> Whitening:
    """Learn from `touches`, with unbiased variances (n - 1); refuse infinite ones.

    With `full`, correlations go too, and directions without variance up to rounding.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        centre = touches.mean(axis=0)
        squared = ((touches - centre) ** 2).sum(axis=0)
        spread = np.sqrt(squared / max(1, len(touches) - 1))
    if not np.isfinite(spread).all():
        raise ValueError(
            "X must have variances below 1e308, got larger ones. Rescale the features."
        )
    varies = spread > ROUNDING * np.abs(touches).max(axis=0)
    log_volume = float(np.log(spread[varies]).sum())
    if not (full and varies.any()):
        return Whitening(centre, spread, varies, None, log_volume)
    standardised = (touches[:, varies] - centre[varies]) / spread[varies]
    rotation, log_rest = _decorrelate(standardised)
    return Whitening(centre, spread, varies, rotation, log_volume + log_rest)


def whiten(
    touches: Floats,
    centre: Floats,
    spread: Floats,
    varies: NDArray[np.bool_],
    rotation: Floats | None,
) -> Floats:
    """Return whitened touches, shape (n_touches, n_directions), always finite."""
    with np.errstate(over="ignore"):
        standardised = (touches[:, varies] - centre[varies]) / spread[varies]
    finite = np.clip(standardised, -FARTHEST, FARTHEST)
    return finite if rotation is None else finite @ rotation


def _decorrelate(standardised: Floats) -> tuple[Floats, float]:
    """Return the rotation and the logarithm of the volume that it undoes."""
    correlation = standardised.T @ standardised / max(1, len(standardised) - 1)
    variances, directions = np.linalg.eigh(correlation)
    least = len(variances) * np.finfo(np.float64).eps * variances[-1]
    # Products of rounded touches leave more rounding than the matrix itself.
    kept = variances > max(least, ROUNDING)
    rotation = directions[:, kept] / np.sqrt(variances[kept])
    return rotation, float(np.log(variances[kept]).sum() / 2)
