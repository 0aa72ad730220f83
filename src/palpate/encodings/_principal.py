"""Principal components shared by the encodings that end in them."""

from numbers import Integral
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.decomposition import PCA
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_images, check_number

Components = int | float | None


class PrincipalEncoder(TransformerMixin, BaseEstimator):
    """An encoder of images, then the principal components of what it gives.

    Subclasses have a parameter `n_components` and say in `_first` which encoder.
    """

    n_components: Components

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Learn the principal components of the touches `X`; `y` is ignored."""
        images = check_images(X)
        self.first_ = self._first()
        features = self.first_.fit_transform(images)
        found = principal_components(features, self.n_components)
        self.components_, self.mean_ = found.components_, found.mean_
        self.explained_variance_ratio_ = found.explained_variance_ratio_
        self.n_components_ = len(self.components_)
        self.image_shape_ = (images.shape[1], images.shape[2])
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the scores, shape (n_touches, n_components_)."""
        check_is_fitted(self)
        features = self.first_.transform(X) - self.mean_
        scores: NDArray[np.float64] = features @ self.components_.T
        return scores

    def _first(self) -> Any:
        raise NotImplementedError

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags


def principal_components(
    features: NDArray[np.float64], n_components: Components
) -> PCA:
    """Return a PCA of that many components, or as many as there are.

    Its `components_`, `mean_` and shares of the variance are those of `features`.

    Parameters
    ----------
    features : ndarray of shape (n_touches, n_features)
    n_components : int, float or None
        A count; a share of the variance between 0 and 1; None for all.
    """
    wanted = check_components(n_components)
    if len(features) < 2 or not (features != features[0]).any():
        raise ValueError(
            "X must hold touches that differ, got "
            f"{len(features)} with the same features. Learn from more touches."
        )
    most = min(features.shape)
    kept = min(wanted, most) if isinstance(wanted, int) else wanted
    # More touches than features: their covariance is smaller than they are.
    solver = "full" if features.shape[0] <= features.shape[1] else "covariance_eigh"
    # Exactly, to sizes around 1: squares of very small or large ones leave the range.
    _, exponent = np.frexp(np.abs(features).max())
    found = PCA(kept, svd_solver=solver).fit(np.ldexp(features, -exponent))
    found.mean_ = np.ldexp(found.mean_, exponent)
    return found


def check_components(value: object) -> Components:
    """Return a valid number of components, or explain."""
    if value is None:
        return None
    if isinstance(value, Integral):
        return check_count("n_components", value)
    share = check_number("n_components", value, low=0, high=1)
    if not 0 < share < 1:
        raise ValueError(
            "n_components must be a count, or a share of the variance above 0 and "
            f"below 1, got {share}. Pass an integer for a count."
        )
    return share
