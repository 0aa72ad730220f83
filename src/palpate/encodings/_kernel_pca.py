"""Principal components by a kernel: features fused as touches differ most.

A Gaussian kernel measures how alike two touches are, and the scores are projections on
the leading principal directions of its feature space. New touches are centred by the
training touches, never by each other.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.spatial.distance import pdist
from sklearn.base import (
    BaseEstimator,
    ClassNamePrefixFeaturesOutMixin,
    TransformerMixin,
)
from sklearn.utils.validation import check_is_fitted, validate_data

from .._checks import check_option, check_squarable, check_width
from .._types import Floats
from ._principal import Components, check_components

# Eigenvalues below this share of the largest are rounding noise.
_RANK_TOLERANCE = 1e-12
# Squared distances below this share of the squared lengths are rounding noise.
_ROUNDING = 1e-14


class KernelPCA(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):
    """Kernel PCA with the Gaussian kernel exp(-|x - y|^2 / (2 sigma^2)).

    Parameters
    ----------
    n_components : int or float, optional
        An integer keeps that many components, or as many as there are; a number
        between 0 and 1 keeps as few as hold that share of the variance. By default
        all are kept. Components whose variance is below 1e-12 of the largest do
        not exist.
    sigma : float, optional
        Width of the kernel, in the unit of the features; by default the median
        distance between two training touches. Between 1e-150 and 1e150.
    scaling : {"unit", "paper"}, default="unit"
        "unit" projects on directions of length 1 in the feature space. "paper"
        takes the normalisation of Liu et al. literally, which makes the scores of M
        training touches sqrt(M) times larger; kernels of fixed widths after it
        notice.

    Attributes
    ----------
    sigma_ : float
        The kernel's width.
    eigenvalues_ : ndarray of shape (n_components_,)
        Eigenvalues of the centred kernel matrix, falling: M times the variances.
    explained_variance_ratio_ : ndarray of shape (n_components_,)
        Share of the variance in the feature space.
    touches_ : ndarray of shape (n_touches, n_features)
        The training touches, less `mean_`.
    mean_ : ndarray of shape (n_features,)
        Mean of the training touches.
    coefficients_ : ndarray of shape (n_touches, n_components_)
        Weights of the training touches in each direction. Of each column the entry
        that is largest in size is positive.
    offset_ : ndarray of shape (n_components_,)
        What centring subtracts from every score.
    n_components_ : int

    References
    ----------
    .. [1] B. Schoelkopf, A. Smola and K.-R. Mueller, "Nonlinear component analysis
       as a kernel eigenvalue problem", Neural Comput. 10(5), 1998.
       doi:10.1162/089976698300017467
    .. [2] Y.-H. Liu et al., "Low-resolution tactile image recognition for automated
       robotic assembly using kernel PCA-based feature fusion and multiple kernel
       learning-based support vector machine", Math. Probl. Eng., 2014.
       doi:10.1155/2014/497275

    Examples
    --------
    >>> from palpate.encodings import KernelPCA
    >>> KernelPCA(sigma=1.0).fit_transform([[0.0], [2.0]]).round(3)
    array([[ 0.658],
           [-0.658]])
    """

    def __init__(
        self,
        n_components: Components = None,
        *,
        sigma: float | None = None,
        scaling: str = "unit",
    ) -> None:
        self.n_components, self.sigma, self.scaling = n_components, sigma, scaling

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Learn the principal directions of `X`; `y` is ignored."""
        self._fit(X)
        return self

    def fit_transform(self, X: ArrayLike, y: object = None, **params: object) -> Floats:
        """Learn the directions of `X` and return its scores."""
        return self._scores(self._fit(X))

    def transform(self, X: ArrayLike) -> Floats:
        """Return the scores of `X`, shape (n_touches, n_components_)."""
        check_is_fitted(self)
        touches = validate_data(self, X, dtype=np.float64, reset=False)
        check_squarable(touches)
        kernel = _kernel(touches - self.mean_, self.touches_, self.sigma_)
        return self._scores(kernel)

    @property
    def _n_features_out(self) -> int:
        return self.n_components_

    def _fit(self, X: ArrayLike) -> Floats:
        """Fit, and return the kernel of the training touches."""
        touches = validate_data(self, X, dtype=np.float64, ensure_min_samples=2)
        check_squarable(touches)
        check_option("scaling", self.scaling, ("unit", "paper"))
        wanted = check_components(self.n_components, whole=True)
        self.mean_ = touches.mean(axis=0)
        self.touches_ = touches - self.mean_
        if self.sigma is None:
            distance = pdist(self.touches_)
            if not distance.any():
                raise ValueError(
                    "X must hold touches that differ, got the same features "
                    f"{len(touches)} times. Check the encoding before this step."
                )
            self.sigma_ = float(np.median(distance[distance > 0]))
        else:
            self.sigma_ = check_width(self.sigma)
        kernel = _kernel(self.touches_, self.touches_, self.sigma_)
        column_mean = kernel.mean(axis=0)
        centred = kernel - column_mean
        centred -= centred.mean(axis=1, keepdims=True)
        total = float(np.trace(centred))
        if not total > 0:
            raise ValueError(
                "X must hold touches that the kernel tells apart, got touches that "
                f"are all alike at sigma = {self.sigma_}. Choose another sigma."
            )
        values, vectors = _leading(centred, wanted)
        n_kept = len(values)
        if isinstance(wanted, float):
            share = np.cumsum(values) / total
            n_kept = min(int(np.searchsorted(share, wanted - 1e-12)) + 1, n_kept)
        elif wanted is not None:
            n_kept = min(wanted, n_kept)
        self.eigenvalues_ = values[:n_kept]
        self.explained_variance_ratio_ = self.eigenvalues_ / total
        self.n_components_ = n_kept
        scale = np.sqrt(self.eigenvalues_)
        if self.scaling == "paper":
            scale = scale / np.sqrt(len(kernel))
        # Scores are (k(x) - column mean) times centred weights: the weights of a
        # direction sum to zero, so the other two terms of centring drop out.
        weights = vectors[:, :n_kept] / scale
        self.coefficients_ = weights - weights.mean(axis=0)
        self.offset_ = column_mean @ self.coefficients_
        return kernel

    def _scores(self, kernel: Floats) -> Floats:
        return np.asarray(kernel @ self.coefficients_ - self.offset_)


def _kernel(left: Floats, right: Floats, sigma: float) -> Floats:
    """Gaussian kernel less 1, which centring removes: wide kernels keep digits."""
    norms = (left**2).sum(axis=1)[:, None] + (right**2).sum(axis=1)
    squared = norms - 2 * left @ right.T
    # Narrow kernels would magnify the rounding of a touch's distance to itself.
    squared[squared <= _ROUNDING * norms] = 0
    # Touches many widths apart are infinitely so: their kernel is 0.
    with np.errstate(over="ignore"):
        exponent = squared / (-2 * sigma**2)
    return np.asarray(np.expm1(exponent))


def _leading(centred: Floats, wanted: Components) -> tuple[Floats, Floats]:
    """Eigenvalues (falling, above rounding) and eigenvectors with fixed signs."""
    n = len(centred)
    subset = None
    if isinstance(wanted, int) and wanted < n:
        subset = (n - wanted, n - 1)
    values, vectors = eigh(centred, subset_by_index=subset)
    if isinstance(wanted, int) and not len(values):
        # Of many equal eigenvalues LAPACK gives all or none.
        values, vectors = eigh(centred)
        values, vectors = values[-wanted:], vectors[:, -wanted:]
    values, vectors = values[::-1], vectors[:, ::-1]
    real = values > _RANK_TOLERANCE * max(values[0], np.finfo(float).tiny)
    values, vectors = values[real], vectors[:, real]
    size = np.abs(vectors)
    # The first of nearly equal entries decides, so that rounding does not.
    pivot = (size >= size.max(axis=0, initial=0) * (1 - 1e-6)).argmax(axis=0)
    return values, vectors * np.sign(vectors[pivot, np.arange(len(values))])
