"""Otsu's threshold, for a whole tactile image or for each of its partitions.

A hand presses unevenly, so one threshold for the whole image loses the lightly
pressed side. Liu et al. cut the image into n x n partitions and threshold each.
Foreground is strictly above the threshold.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_count, check_images, check_number
from .._types import Floats

# Interpolation leaves rounding of this relative size in what should be constant.
_ROUNDING = 1e-12


def otsu_threshold(images: ArrayLike) -> Floats:
    """Return the threshold of each image that splits its grey levels best.

    The split maximises the variance between the two classes, over every gap
    between neighbouring grey levels; no histogram is made, so any scale will do.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)

    Returns
    -------
    thresholds : ndarray of shape (n_touches,)
        The middle of the best gap (the lowest, where several are equally good);
        NaN where the image is constant and so has no threshold.

    References
    ----------
    .. [1] N. Otsu, "A threshold selection method from gray-level histograms", IEEE
       Trans. Syst. Man Cybern. 9(1), 1979. doi:10.1109/TSMC.1979.4310076

    Examples
    --------
    >>> from palpate.images import otsu_threshold
    >>> otsu_threshold([[[0, 0, 1], [0, 9, 9]]])
    array([5.])
    """
    checked = check_images(images)
    return _threshold_rows(checked.reshape(len(checked), -1))


def binarise(
    images: ArrayLike, n_partitions: int = 2, *, min_contrast: float = 0.0
) -> NDArray[np.bool_]:
    """Threshold each of n x n partitions of each image by its own Otsu threshold.

    A constant partition has no threshold: it is background, unless its level is
    above the threshold of the whole image. Without that rule a part that covers a
    whole partition would vanish there.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)
    n_partitions : int, default=2
        Partitions along each side. Where the side does not divide, the first
        partitions are one pixel longer: 33 pixels make 17 and 16.
    min_contrast : float, default=0.0
        Partitions whose grey levels span at most this share of the span of the
        whole image count as constant, at their mean level. With 0, as in the
        paper, half of a partition of noise alone becomes foreground.

    Returns
    -------
    binary : ndarray of bool of shape (n_touches, n_rows, n_cols)
    """
    checked = check_images(images)
    n_parts = check_count("n_partitions", n_partitions)
    contrast = check_number("min_contrast", min_contrast, low=0, high=1)
    if n_parts > min(checked.shape[1:]):
        raise ValueError(
            f"n_partitions must be at most {min(checked.shape[1:])}, the shorter side "
            f"of the images, got {n_parts}. Upsample the images first."
        )
    whole = otsu_threshold(checked)
    span = np.ptp(checked, axis=(1, 2))
    binary = np.empty(checked.shape, dtype=bool)
    for rows in np.array_split(np.arange(checked.shape[1]), n_parts):
        for cols in np.array_split(np.arange(checked.shape[2]), n_parts):
            block = np.s_[:, rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
            binary[block] = _binarise_block(checked[block], whole, contrast * span)
    return binary


def _binarise_block(
    block: Floats,
    whole: Floats,
    least_span: Floats,
) -> NDArray[np.bool_]:
    flat = block.reshape(len(block), -1)
    threshold = _threshold_rows(flat)
    constant = np.isnan(threshold) | (np.ptp(flat, axis=1) <= least_span)
    # Comparisons with NaN are false: an image without a threshold is background.
    level_is_high = flat.mean(axis=1) > whole
    foreground = np.where(
        constant[:, None], level_is_high[:, None], flat > threshold[:, None]
    )
    return foreground.reshape(block.shape)


def _threshold_rows(levels: Floats) -> Floats:
    """Otsu's threshold of each row of `levels`, NaN for constant rows."""
    ordered = np.sort(levels, axis=1)
    n_rows, n_levels = ordered.shape
    if n_levels < 2:
        return np.full(n_rows, np.nan)
    below = np.arange(1, n_levels)
    total = np.cumsum(ordered - ordered.mean(axis=1, keepdims=True), axis=1)[:, :-1]
    # Between-class variance, up to a factor, for a cut after each sorted level.
    between = total**2 / (below * (n_levels - below))
    gap = np.diff(ordered, axis=1)
    size = np.abs(ordered[:, [0, -1]]).max(axis=1, keepdims=True)
    between[gap <= _ROUNDING * size] = -1.0
    best = between.max(axis=1, keepdims=True)
    cut = (between >= best * (1 - _ROUNDING)).argmax(axis=1)
    row = np.arange(n_rows)
    threshold = (ordered[row, cut] + ordered[row, cut + 1]) / 2
    return np.where(best[:, 0] < 0, np.nan, threshold)
