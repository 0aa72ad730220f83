"""Fewer features that tell nearly the same distances between touches."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import (
    BaseEstimator,
    ClassNamePrefixFeaturesOutMixin,
    TransformerMixin,
)
from sklearn.decomposition import PCA
from sklearn.utils.validation import check_is_fitted, validate_data

from .._checks import are_plain_vectors, check_number

_FOLDS = 5
_LEARNT_FROM = 600


class PrincipalShare(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """Keep the principal components that hold a share of the variance.

    Unlike `sklearn.decomposition.PCA` it takes touches that are all alike, of which
    it makes one feature that is always 0.

    Parameters
    ----------
    share : float, default=0.9
        Share of the variance, above 0 and below 1.

    Attributes
    ----------
    mean_ : ndarray of shape (n_features,)
        Mean of the training touches.
    components_ : ndarray of shape (n_kept, n_features)
        Orthonormal directions, by falling variance.
    variance_ : float
        Variance of the training touches, summed over features; 1 if it is 0.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import PrincipalShare
    >>> X = np.array([[0.0, 0.0], [2.0, 0.1], [4.0, 0.0]])
    >>> PrincipalShare().fit_transform(X).shape
    (3, 1)
    """

    def __init__(self, share: float = 0.9) -> None:
        self.share = share

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Learn mean and directions; `y` is ignored."""
        share = check_number("share", self.share, low=1e-6, high=1 - 1e-6)
        features = validate_data(self, X, dtype=np.float64)
        self.mean_ = features.mean(axis=0)
        self.variance_ = float(features.var(axis=0).sum()) or 1.0
        if len(features) < 2 or (features == features[0]).all():
            self.components_ = np.zeros((1, features.shape[1]))
        else:
            # The covariance is never larger than the touches it stands for.
            few = features.shape[0] <= features.shape[1]
            solver = "full" if few else "covariance_eigh"
            found = PCA(n_components=share, svd_solver=solver).fit(features)
            self.components_ = found.components_
        self._n_features_out = len(self.components_)
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the scores, shape (n_touches, n_kept)."""
        check_is_fitted(self)
        if are_plain_vectors(X, len(self.mean_)):
            features = np.asarray(X)
        else:
            features = validate_data(self, X, dtype=np.float64, reset=False)
        scores: NDArray[np.float64] = (features - self.mean_) @ self.components_.T
        return scores

    def unexplained(
        self, X: NDArray[np.float64], scores: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how much of each touch the kept components leave out.

        Parameters
        ----------
        X : ndarray of shape (n_touches, n_features)
        scores : ndarray of shape (n_touches, n_kept)
            What `transform` made of them.

        Returns
        -------
        ndarray of shape (n_touches,)
            Squared length of what is left out, over the training touches' variance.
        """
        whole = ((X - self.mean_) ** 2).sum(axis=1)
        left = np.maximum(whole - (scores**2).sum(axis=1), 0)
        return np.asarray(left / self.variance_)

    def left_out_unexplained(
        self, X: NDArray[np.float64], groups: NDArray
    ) -> NDArray[np.float64]:
        """Return `unexplained` of touches whose group was left out of the components.

        Five folds of groups; of many touches an evenly spaced part is learnt from.

        Parameters
        ----------
        X : ndarray of shape (n_touches, n_features)
        groups : ndarray of int, shape (n_touches,)
        """
        result = np.zeros(len(X))
        fold = np.unique(groups, return_inverse=True)[1] % _FOLDS
        for k in np.unique(fold):
            others, mine = np.flatnonzero(fold != k), fold == k
            if len(others):
                n = min(len(others), _LEARNT_FROM)
                some = others[np.linspace(0, len(others) - 1, n).astype(int)]
                part = PrincipalShare(self.share).fit(X[some])
                result[mine] = part.unexplained(X[mine], part.transform(X[mine]))
        return result
