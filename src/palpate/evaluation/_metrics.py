"""Figures of merit for beliefs: calibration error, log loss, ROC area."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

Floats = NDArray[np.float64]


def calibration_bins(
    confidence: ArrayLike, hit: ArrayLike, n_bins: int = 10
) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Return mean confidence, share of hits and count of equal-mass bins.

    Parameters
    ----------
    confidence : array-like of shape (n_episodes,)
        Largest posterior of each episode.
    hit : array-like of shape (n_episodes,)
        Whether the most probable label was right.
    n_bins : int, default=10
        Number of bins of nearly equal size; fewer for fewer episodes.
    """
    belief = np.asarray(confidence, dtype=np.float64)
    right = np.asarray(hit, dtype=np.float64)
    order = np.argsort(belief, kind="stable")
    parts = np.array_split(order, min(n_bins, len(order)))
    means = np.array([belief[part].mean() for part in parts])
    shares = np.array([right[part].mean() for part in parts])
    return means, shares, np.array([len(part) for part in parts])


def calibration_error(confidence: ArrayLike, hit: ArrayLike, n_bins: int = 10) -> float:
    """Return the expected calibration error over equal-mass bins.

    The mean distance between belief and share of hits, weighted by bin size;
    0 is perfect. With few episodes even a perfect recogniser scores above 0.

    Examples
    --------
    >>> from palpate.evaluation import calibration_error
    >>> calibration_error([0.75] * 4, [1, 1, 1, 0], n_bins=1)
    0.0
    """
    means, shares, counts = calibration_bins(confidence, hit, n_bins)
    return float(np.abs(means - shares) @ counts / counts.sum())


def roc_area(known: ArrayLike, unknown: ArrayLike) -> float:
    """Return the area under the ROC curve of a score that is higher for unknown.

    The chance that an unknown episode scores higher than a known one, ties half.

    Examples
    --------
    >>> from palpate.evaluation import roc_area
    >>> roc_area([0.1, 0.2], [0.2, 0.9])
    0.875
    """
    below, above = np.asarray(known, float), np.asarray(unknown, float)
    ranks = rankdata(np.concatenate([below, above]))[len(below) :]
    pairs = len(below) * len(above)
    return float((ranks.sum() - len(above) * (len(above) + 1) / 2) / pairs)
