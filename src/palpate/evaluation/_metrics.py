"""Figures of merit: of beliefs, of how results spread, of how distinct labels are."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import rankdata
from sklearn.utils import check_X_y

from .._checks import check_number
from .._types import Floats, Indices

# Distances of centroids below this share of the touches' extent are rounding.
_ROUNDING = 1e-14


def calibration_bins(
    confidence: ArrayLike, hit: ArrayLike, n_bins: int = 10
) -> tuple[Floats, Floats, Indices]:
    """Return mean confidence, share of hits and count of equal-mass bins.

    `confidence` holds the largest posterior of each episode, `hit` whether the most
    probable label was right; there are fewer bins for fewer episodes.
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
    `confidence` (n_episodes,) are beliefs in the best object, `hit` whether it was
    right; `n_bins` bins hold as many episodes each.

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
    `known` (n_known,) and `unknown` (n_unknown,) are the scores of both kinds.

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


def spread(values: ArrayLike) -> Floats:
    """Return the sample standard deviation (ddof 1) over the first axis.

    For results over objects, folds or draws; 0 where there are fewer than two.
    """
    numbers = np.asarray(values, dtype=np.float64)
    return np.asarray(numbers.std(axis=0, ddof=min(1, len(numbers) - 1)))


def davies_bouldin(X: ArrayLike, labels: ArrayLike, q: float = 2.0) -> float:
    """Return the Davies-Bouldin index of labelled touches; smaller is more distinct.

    Parameters
    ----------
    X : array-like of shape (n_touches, n_features)
        Feature vectors.
    labels : array-like of shape (n_touches,)
        At least two different ones.
    q : float, default=2
        A cluster's radius is the mean of the q-th powers of distances to its
        centroid, to the power 1 / q: 2 is eq. 9 of Corradi et al. 2014 [2]_, 1 what
        scikit-learn computes.

    Returns
    -------
    index : float
        Mean over clusters of the largest (radius + other radius) / distance of the
        centroids. Infinite where two clusters share a centroid.

    Raises
    ------
    ValueError
        Fewer than two different labels, or `q` below 1.

    References
    ----------
    .. [1] D. L. Davies, D. W. Bouldin, "A cluster separation measure", IEEE Trans.
       Pattern Anal. Mach. Intell. PAMI-1(2), 1979. doi:10.1109/TPAMI.1979.4766909
    .. [2] T. Corradi, P. Hall, P. Iravani, "Tactile features: recognising touch
       sensations with a novel and inexpensive tactile sensor", TAROS 2014,
       LNCS 8717. doi:10.1007/978-3-319-10401-0

    Examples
    --------
    >>> from palpate.evaluation import davies_bouldin
    >>> davies_bouldin([[0.0], [2.0], [10.0], [12.0]], ["a", "a", "b", "b"])
    0.2
    """
    touches, names = check_X_y(X, labels, dtype=np.float64)
    power = check_number("q", q, low=1)
    kinds, codes = np.unique(names, return_inverse=True)
    if len(kinds) < 2:
        raise ValueError(
            f"labels must hold at least two different ones, got {len(kinds)}. "
            "Clusters are compared with each other."
        )
    # Exact where touches are close; the index does not notice, and no square overflows.
    halved = _scaled(touches) / 2
    touches = _scaled(halved - halved[0])
    members = [touches[codes == kind] for kind in range(len(kinds))]
    centres = np.array([part.mean(axis=0) for part in members])
    pairs = zip(members, centres, strict=True)
    away = [np.linalg.norm(part - centre, axis=1) for part, centre in pairs]
    radius = np.array([_power_mean(distances, power) for distances in away])
    distance = np.sqrt(((centres[:, None] - centres) ** 2).sum(axis=2))
    extent = np.linalg.norm(touches, axis=1).max()
    distance[distance <= _ROUNDING * extent] = 0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.add.outer(radius, radius) / distance
    ratio[distance == 0] = np.inf
    np.fill_diagonal(ratio, -np.inf)
    return float(ratio.max(axis=1).mean())


def _scaled(values: Floats) -> Floats:
    """Multiply by the power of two that brings the largest to between 0.5 and 1."""
    _, exponent = np.frexp(np.abs(values).max())
    return np.asarray(np.ldexp(values, -exponent))


def _power_mean(distances: Floats, power: float) -> float:
    """Return the mean of powers of distances, to one over the power."""
    largest = distances.max() or 1.0
    mean = np.mean((distances / largest) ** power)
    return float(largest * mean ** (1 / power))
