"""Principal components: of moments, of turned images, and of features.

`ZernikePCA` and `OrientedPCA` are encodings of Corradi et al. 2014 [1]_: an encoder of
images, then scikit-learn's principal components of what it gives. `PrincipalShare` and
`KernelPCA` take features of any kind. By a Gaussian kernel, which measures how alike
two touches are, scores are projections on the leading principal directions of its
feature space; new touches are centred by the training touches, never by each other.

References
----------
.. [1] T. Corradi, P. Hall, P. Iravani, "Tactile features: recognising touch
   sensations with a novel and inexpensive tactile sensor", TAROS 2014, LNCS 8717.
   doi:10.1007/978-3-319-10401-0
"""

from __future__ import annotations

from numbers import Integral
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
from sklearn.decomposition import PCA
from sklearn.utils.validation import check_is_fitted, validate_data

from .._checks import (
    check_count,
    check_number,
    check_option,
    check_squarable,
    check_width,
)
from .._image_estimator import ImageEstimator
from .._numbers import evenly_spaced
from .._types import Array, Floats
from ._pixels import ScaledPixels
from ._zernike import ZernikeMoments

Components = int | float | None
_FOLDS = 5  # groups are left out in so many parts
_LEARNT_FROM = 600  # as many as the encodings are chosen on
# Eigenvalues below this share of the largest are rounding noise.
_RANK_TOLERANCE = 1e-12
# Squared distances below this share of the squared lengths are rounding noise.
_ROUNDING = 1e-14


class PrincipalEncoder(ImageEstimator):
    """Encode images by the principal components of another encoding.

    Subclasses say in `_kind` which: it becomes `first_`. Of its features `mean_`,
    `components_` (n_components_, n_features) and `explained_variance_ratio_` are
    learnt.
    """

    n_components: Components
    _kind: type[ImageEstimator]

    @property
    def blind_to(self) -> frozenset[str]:
        """The changes that the encoding of these components is blind to."""
        return self._first().blind_to

    def transform_checked(self, images: Array) -> Floats:
        """Return the scores, shape (n_touches, n_components_)."""
        features = self.first_.transform_checked(images) - self.mean_
        return np.asarray(features @ self.components_.T)

    def _learn(self, images: Array) -> None:
        first = self._first()
        features = np.asarray(first.fit_transform(images))
        wanted = check_components(self.n_components)
        # Features of one image that comes several times may differ by rounding.
        if _are_alike(images) or _are_alike(features):
            raise ValueError(
                "X must hold touches that differ, got "
                f"{len(features)} with the same features. Learn from more touches."
            )
        if isinstance(wanted, int):
            wanted = min(wanted, *features.shape)
        # Exactly, to sizes around 1: squares of very small or large ones overflow.
        _, exponent = np.frexp(np.abs(features).max())
        few = features.shape[0] <= features.shape[1]
        solver = "full" if few else "covariance_eigh"  # the smaller of the two
        scaled = np.ldexp(features, -exponent)
        pca = PCA(wanted, svd_solver=solver).fit(scaled)
        self.first_, self.components_ = first, pca.components_
        self.mean_ = np.ldexp(pca.mean_, exponent)
        self.explained_variance_ratio_ = pca.explained_variance_ratio_
        self.n_components_ = len(self.components_)

    def _first(self) -> ImageEstimator:
        options = self.get_params(deep=False)
        del options["n_components"]
        return self._kind(**options)


class ZernikePCA(PrincipalEncoder):
    """Encode images by the principal components of their Zernike moments.

    What is learnt has the names of `PrincipalEncoder`: `first_`, `components_`,
    `mean_`, `explained_variance_ratio_`, `n_components_` and `image_shape_`.

    Parameters
    ----------
    n_components : int, float or None, default=0.95
        How many components: a count, the share of the training touches' variance
        that they hold, or None for all.
    order : int, default=15
        Highest order of the moments.
    output, weight, drop_constant, repeat_negative
        As in `ZernikeMoments`; `output` must be a real one. What the weights are
        decides which moments vary most and so what is kept.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import ZernikePCA
    >>> touches = np.random.default_rng(0).normal(size=(5, 10, 10))
    >>> ZernikePCA(2).fit_transform(touches).shape
    (5, 2)
    """

    _kind = ZernikeMoments

    def __init__(
        self,
        n_components: Components = 0.95,
        *,
        order: int = 15,
        output: str = "abs",
        weight: str = "n+1",
        drop_constant: bool = True,
        repeat_negative: bool = False,
    ) -> None:
        self.n_components, self.order = n_components, order
        self.output, self.weight = output, weight
        self.drop_constant, self.repeat_negative = drop_constant, repeat_negative

    def _first(self) -> ImageEstimator:
        check_option("output", self.output, ("abs", "noll", "noll_abs"))
        return super()._first()


class OrientedPCA(PrincipalEncoder):
    """Encode images, turned along their long axis, by principal components.

    What is learnt has the names of `PrincipalEncoder`; each component is a small
    image, row by row.

    Parameters
    ----------
    n_components : int, float or None, default=0.95
        As in `ZernikePCA`.
    side : int, default=32
        The turned image is averaged to at most so many rows and columns first:
        the shading of a dome is smooth, and what is finer is noise.
    min_anisotropy : float or None, default=0.02
        As in `ScaledPixels`.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import OrientedPCA
    >>> touches = np.random.default_rng(0).normal(size=(5, 10, 10))
    >>> OrientedPCA(2).fit_transform(touches).shape
    (5, 2)
    """

    _kind = ScaledPixels

    def __init__(
        self,
        n_components: Components = 0.95,
        *,
        side: int = 32,
        min_anisotropy: float | None = 0.02,
    ) -> None:
        self.n_components, self.side = n_components, side
        self.min_anisotropy = min_anisotropy


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
        if _are_alike(features):
            self.components_ = np.zeros((1, features.shape[1]))
        else:
            self.components_ = _directions(features - self.mean_, share)
        return self

    def transform(self, X: ArrayLike) -> Floats:
        """Return the scores, shape (n_touches, n_kept)."""
        check_is_fitted(self)
        features = validate_data(self, X, dtype=np.float64, reset=False)
        return self.transform_checked(features)

    def transform_checked(self, features: Floats) -> Floats:
        """Do what `transform` does, for a caller that has checked the features."""
        return np.asarray((features - self.mean_) @ self.components_.T)

    @property
    def _n_features_out(self) -> int:
        return len(self.components_)

    def unexplained(self, X: Floats, scores: Floats) -> Floats:
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

    def left_out_unexplained(self, X: Floats, groups: Array) -> Floats:
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
            others, rows = np.flatnonzero(fold != k), fold == k
            if len(others):
                chosen = others[evenly_spaced(len(others), _LEARNT_FROM)]
                part = PrincipalShare(self.share).fit(X[chosen])
                result[rows] = part.unexplained(X[rows], part.transform(X[rows]))
        return result


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


def check_components(value: object, *, whole: bool = False) -> Components:
    """Return a valid number of components, or explain; 1.0 is valid if `whole`."""
    if value is None:
        return None
    if isinstance(value, Integral):
        return check_count("n_components", value)
    share = check_number("n_components", value, low=0, high=1)
    if share == 0 or (share == 1 and not whole):
        below = "" if whole else " and below 1"
        raise ValueError(
            f"n_components must be a count or a share of the variance above 0{below}, "
            f"got {share}. Pass an integer for a count."
        )
    return share


def _are_alike(rows: Array) -> bool:
    return len(rows) < 2 or bool((rows == rows[0]).all())


def _directions(centred: Floats, share: float) -> Floats:
    """Return the directions that hold a share of the variance, (n_kept, n_features).

    From the smaller of the matrices of products of touches and of features.
    """
    # Exactly, to sizes around 1: squares of very small or large ones overflow.
    centred = np.ldexp(centred, -np.frexp(np.abs(centred).max())[1])
    few = centred.shape[0] <= centred.shape[1]
    variance, vectors = np.linalg.eigh(
        centred @ centred.T if few else centred.T @ centred
    )
    held = np.cumsum(variance[::-1]) / variance.sum()
    n_kept = min(int(np.searchsorted(held, share, side="right")) + 1, len(held))
    vectors = vectors[:, ::-1][:, :n_kept]
    if few:
        vectors = centred.T @ vectors
        vectors /= np.sqrt((vectors**2).sum(axis=0))
    largest = np.abs(vectors).argmax(axis=0)
    vectors *= np.sign(vectors[largest, np.arange(n_kept)])
    return np.ascontiguousarray(vectors.T)


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
