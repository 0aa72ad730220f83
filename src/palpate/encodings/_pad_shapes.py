"""Shape numbers of pads: how much each pad of a hand feels, where, and how spread."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_images
from .._image_estimator import ImageEstimator
from .._types import Array, Floats
from ..images import CentralMoments, central_moments

# Taxels above these shares of the touch's largest level, and of the pad's, are counted.
_OF_TOUCH = 0.05
_OF_PAD = (0.25, 0.5)
# Load, centroid and spreads stand first: pads differ in these.
_COMPARED = 5


class PadShapes(ImageEstimator):
    """Encode touches by shape numbers of each pad, and by how pads differ.

    Parameters
    ----------
    pads : array-like of int of shape (n_pads, 4), optional
        First row, first column, rows and columns of each pad in the image. By default
        the whole image is one pad.

    Attributes
    ----------
    pads_ : ndarray of int of shape (n_pads, 4)
        The pads.

    Notes
    -----
    Of each pad 17 numbers: load, centroid (row, column), spreads, areas above 5 % of
    the touch's largest level and above 25 and 50 % of the pad's own, largest and mean
    level, covariance, spreads along and across the long axis, four third moments. Then
    each pad's share of the whole load and, for each pair of pads, the differences of
    load, centroid and spreads. Loads and levels are roots; lengths count in halves of
    the pad's longer side; moments and covariance are of the pad's own load, as signed
    roots where they are squares. Levels count by their size, NaN as 0; a pad without
    load has zeros. It is blind to nothing, but sees no more than shape.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import PadShapes
    >>> hand = np.ones((2, 4, 9))
    >>> PadShapes().fit_transform(hand).shape
    (2, 17)
    >>> PadShapes([[0, 0, 4, 4], [0, 5, 4, 4]]).fit_transform(hand).shape
    (2, 41)
    """

    def __init__(self, pads: ArrayLike | None = None) -> None:
        self.pads = pads

    def _learn(self, images: Array) -> None:
        shape = images.shape[1:]
        self.pads_ = np.array([[0, 0, *shape]])
        if self.pads is not None:
            self.pads_ = _check_pads(self.pads, shape)

    def transform_checked(self, images: Array) -> Floats:
        """Return the numbers, shape (n_touches, n_features)."""
        levels = np.abs(np.nan_to_num(images.astype(np.float64, copy=False)))
        boxes = [
            levels[:, row : row + rows, col : col + cols]
            for row, col, rows, cols in self.pads_
        ]
        top = np.max([box.max(axis=(1, 2)) for box in boxes], axis=0)
        pads = np.stack([_numbers(box, top) for box in boxes])
        if len(pads) == 1:
            return np.asarray(pads[0])
        load = pads[:, :, 0] ** 2
        share = load / np.where(top > 0, load.sum(axis=0), 1)
        differences = [a - b for a, b in combinations(pads[:, :, :_COMPARED], 2)]
        return np.hstack([*pads, share.T, *differences])

    def _checked(self, X: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
        return check_images(X, shape=shape, allow_nan=True, channels=True)


def _numbers(box: Floats, top: Floats) -> Floats:
    """Numbers of one pad, (n_touches, 17); `top` is each touch's largest level."""
    largest = box.max(axis=(1, 2))
    relative = box / np.where(largest > 0, largest, 1.0)[:, None, None]
    moments = central_moments(relative)
    half = max(box.shape[1:]) / 2
    second, third = _shape_of(moments, half)
    area = [
        ((box > share * of[:, None, None]).mean(axis=(1, 2)))
        for share, of in [(_OF_TOUCH, top), *((share, largest) for share in _OF_PAD)]
    ]
    mean = largest * moments.mass / np.maximum((relative > 0).sum(axis=(1, 2)), 1)
    root = np.sqrt([largest * moments.mass, largest, mean])
    centroid = [moments.y / half, moments.x / half]
    return np.stack(
        [root[0], *centroid, *second[:2], *area, *root[1:], *second[2:], *third], axis=1
    )


def _shape_of(
    moments: CentralMoments, half: float
) -> tuple[list[Floats], list[Floats]]:
    """Spreads, covariance, axes (all as lengths), and third moments, per load."""
    mass = np.where(moments.mass > 0, moments.mass, 1.0)[:, None, None]
    mu = moments.mu / mass
    down, across, mixed = (mu[:, q, p] / half**2 for q, p in [(2, 0), (0, 2), (1, 1)])
    middle, gap = (down + across) / 2, np.hypot((down - across) / 2, mixed)
    squares = [down, across, middle + gap, middle - gap]
    lengths = np.sqrt(np.maximum(squares, 0))
    covariance = np.sign(mixed) * np.sqrt(np.abs(mixed))
    third = [mu[:, q, 3 - q] / half**3 for q in range(4)]
    return [lengths[0], lengths[1], covariance, lengths[2], lengths[3]], third


def _check_pads(pads: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.intp]:
    boxes = np.asarray(pads)
    if boxes.ndim != 2 or boxes.shape[1] != 4 or boxes.dtype.kind not in "iu":
        raise ValueError(
            "pads must be integers of shape (n_pads, 4): first row, first column, rows "
            f"and columns of each, got {boxes.dtype} of shape {boxes.shape}."
        )
    start, size = boxes[:, :2], boxes[:, 2:]
    out = (start < 0) | (size < 1) | (start + size > np.array(shape))
    if out.any() or not len(boxes):
        bad = boxes[out.any(axis=1)].tolist()
        raise ValueError(
            f"pads must be boxes within the {shape[0]} x {shape[1]} taxels, got "
            f"{bad[0] if bad else 'none'}. Each is first row and column, rows, columns."
        )
    return boxes.astype(np.intp)
