"""Central moments: mass, middle and shape of what an image shows, to order 3.

x points along the columns, y along the rows (downwards); lengths are in pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import pascal

from .._checks import check_images
from .._types import Floats

ORDER = 3


@dataclass(frozen=True)
class CentralMoments:
    """Moments of images about each image's own centroid (`x`, `y`).

    The centroid is in pixels from the middle of the frame, 0 where the `mass` (sum of
    levels) is; `mu[:, q, p]` sums level * (x - centroid)^p * (y - centroid)^q.
    """

    mass: Floats
    x: Floats
    y: Floats
    mu: Floats


def central_moments(images: ArrayLike) -> CentralMoments:
    """Return the central moments of images to order 3 along x and y."""
    checked = check_images(images)
    _, n_rows, n_cols = checked.shape
    down, across = _powers(n_rows), _powers(n_cols)
    raw = down.T @ checked @ across
    mass = raw[:, 0, 0]
    safe = np.where(mass == 0, 1.0, mass)
    x = np.where(mass == 0, 0.0, raw[:, 0, 1] / safe)
    y = np.where(mass == 0, 0.0, raw[:, 1, 0] / safe)
    mu = _shift(y) @ raw @ _shift(x).transpose(0, 2, 1)
    return CentralMoments(mass, x, y, mu)


@lru_cache(maxsize=16)
def inscribed_mask(n_rows: int, n_cols: int) -> NDArray[np.bool_]:
    """Which pixel centres lie in the frame's inscribed disc; shared, so read-only."""
    row = np.arange(n_rows) - (n_rows - 1) / 2
    col = np.arange(n_cols) - (n_cols - 1) / 2
    squared = row[:, np.newaxis] ** 2 + col**2
    inside: NDArray[np.bool_] = squared <= (min(n_rows, n_cols) / 2) ** 2
    inside.flags.writeable = False
    return inside


def above_least(images: ArrayLike, mask: NDArray[np.bool_]) -> Floats:
    """Return levels above each image's least level in the mask, zero outside it."""
    checked = check_images(images)
    least = np.where(mask, checked, np.inf).min(axis=(1, 2), keepdims=True)
    levels: Floats = (checked - least) * mask
    return levels


def _powers(n: int) -> Floats:
    """Return 1, x, x^2, x^3 of pixel centres from the middle, (n, 4)."""
    from_middle = np.arange(n) - (n - 1) / 2
    return (from_middle[:, None] ** np.arange(ORDER + 1)).astype(np.float64)


def _shift(centre: Floats) -> Floats:
    """Matrices that turn moments about the middle into moments about `centre`."""
    order = np.arange(ORDER + 1)
    gap = order[:, None] - order
    binomial = pascal(ORDER + 1, kind="lower").astype(float)
    powers = (-centre[:, None, None]) ** np.maximum(gap, 0)
    return np.where(gap >= 0, binomial * powers, 0.0)
