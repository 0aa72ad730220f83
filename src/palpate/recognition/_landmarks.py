"""How far a touch is from all that was ever learnt."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from ._sequence import Floats

# More landmarks tell hardly more, and each touch is compared with all of them.
MOST_LANDMARKS = 1000
_TOUCHES_AT_ONCE = 2000


@dataclass(frozen=True)
class Landmarks:
    """Some training touches, to tell how new another touch is.

    Attributes
    ----------
    features : ndarray of shape (n_landmarks, n_features)
        Training touches in contact, evenly spaced, at most 1000.
    stretches : ndarray of int, shape (n_landmarks,)
        The stretch of the recording that each is from.
    unit : float
        Mean squared distance of the landmarks from their centre.
    """

    features: Floats
    stretches: NDArray
    unit: float

    @classmethod
    def among(cls, features: Floats, stretches: NDArray, nothing: NDArray) -> Self:
        """Choose landmarks among training touches; `nothing` marks no contact."""
        rows = np.flatnonzero(~nothing)
        rows = rows if len(rows) else np.arange(len(features))
        n = min(len(rows), MOST_LANDMARKS)
        rows = rows[np.linspace(0, len(rows) - 1, n).round().astype(int)]
        chosen = features[rows]
        unit = float(((chosen - chosen.mean(axis=0)) ** 2).sum(axis=1).mean())
        return cls(chosen, stretches[rows], unit or 1.0)

    def novelty(self, features: Floats, stretches: NDArray | None = None) -> Floats:
        """Return the squared distance to the nearest landmark, in units.

        Parameters
        ----------
        features : ndarray of shape (n_touches, n_features)
        stretches : ndarray of int, shape (n_touches,), optional
            Of training touches: landmarks of a touch's own stretch are left out. A
            touch that then has none left is not new at all.

        Returns
        -------
        ndarray of shape (n_touches,)
        """
        result = np.empty(len(features))
        for start in range(0, len(features), _TOUCHES_AT_ONCE):
            rows = slice(start, start + _TOUCHES_AT_ONCE)
            squared = cdist(features[rows], self.features, "sqeuclidean")
            if stretches is not None:
                own = stretches[rows, np.newaxis] == self.stretches
                squared[own] = np.inf
            nearest = squared.min(axis=1)
            result[rows] = np.where(np.isfinite(nearest), nearest, 0.0) / self.unit
        return result
