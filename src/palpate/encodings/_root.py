"""Square-root scaling: feature magnitudes of very different size on one footing."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, OneToOneFeatureMixin, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data


class RootScaler(OneToOneFeatureMixin, TransformerMixin, BaseEstimator):
    """Signed square root of each feature, then mean 0 and total variance 1.

    Moments of a press differ by orders of magnitude between faint and strong
    contacts; the root brings them closer before a distance is taken. All
    features have equal variance afterwards, and the sum over features is one, so
    that blocks of features of different length weigh the same side by side.
    Features that never change in training become 0.

    Attributes
    ----------
    mean_, scale_ : ndarray of shape (n_features,)
        Mean and divisor of each feature's root.

    Examples
    --------
    >>> from palpate.encodings import RootScaler
    >>> RootScaler().fit_transform([[0.0, 1.0], [4.0, 1.0]])
    array([[-0.70710678,  0.        ],
           [ 0.70710678,  0.        ]])
    """

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Learn mean and spread of the roots; `y` is ignored."""
        roots = _root(validate_data(self, X, dtype=np.float64))
        self.mean_ = roots.mean(axis=0)
        spread = roots.std(axis=0)
        constant = spread <= 1e-9 * np.abs(roots).max(axis=0)
        root_of_count = np.sqrt(roots.shape[1])
        self.scale_ = np.where(constant, np.inf, spread * root_of_count)
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the scaled roots, shape (n_touches, n_features)."""
        check_is_fitted(self)
        features = validate_data(self, X, dtype=np.float64, reset=False)
        return self.scale(features)

    def scale(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """Do what `transform` does, without its checks."""
        scaled: NDArray[np.float64] = (_root(features) - self.mean_) / self.scale_
        return scaled


def _root(features: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sign(features) * np.sqrt(np.abs(features))
