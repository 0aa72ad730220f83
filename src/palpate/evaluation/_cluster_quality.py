"""How distinct the labels' clusters of touches are: the Davies-Bouldin index."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import check_X_y

from .._checks import check_number

Floats = NDArray[np.float64]

# Distances of centroids below this share of the touches' extent are rounding.
_ROUNDING = 1e-14


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
    touches = _about_one(touches)
    members = [touches[codes == kind] for kind in range(len(kinds))]
    centres = np.array([part.mean(axis=0) for part in members])
    away = [
        np.linalg.norm(p - c, axis=1) for p, c in zip(members, centres, strict=True)
    ]
    radius = np.array([_power_mean(d, power) for d in away])
    distance = np.sqrt(((centres[:, None] - centres) ** 2).sum(axis=2))
    extent = np.linalg.norm(touches, axis=1).max()
    distance[distance <= _ROUNDING * extent] = 0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.add.outer(radius, radius) / distance
    ratio[distance == 0] = np.inf
    np.fill_diagonal(ratio, -np.inf)
    return float(ratio.max(axis=1).mean())


def _about_one(touches: Floats) -> Floats:
    """Shift and scale touches, exactly where they are close, to sizes of at most 1.

    The index does not notice, and no square of a coordinate leaves the range.
    """
    halved = _scaled(touches) / 2
    return _scaled(halved - halved[0])


def _scaled(values: Floats) -> Floats:
    """Multiply by the power of two that brings the largest to between 0.5 and 1."""
    _, exponent = np.frexp(np.abs(values).max())
    scaled: Floats = np.ldexp(values, -exponent)
    return scaled


def _power_mean(distances: Floats, power: float) -> float:
    """Return the mean of powers of distances, to one over the power."""
    largest = distances.max() or 1.0
    mean = np.mean((distances / largest) ** power)
    return float(largest * mean ** (1 / power))
