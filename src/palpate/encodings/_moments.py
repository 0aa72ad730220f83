"""Moments about the centroid: a press described apart from its place and angle.

Patterns are Gauss-Laguerre functions, waves around the centroid under a Gaussian
window whose width is tied to the array. They are orthonormal on the plane; turning
a press only turns the phase of its complex moments, so their magnitudes stay.
`sorted_taxels` is the control: what can be told without any geometry.
"""

from __future__ import annotations

from math import comb, factorial, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_images, check_option, check_positive
from .._image_estimator import ImageEstimator, by_channel
from .._types import Array, Floats

# Powers of the coordinates lose all digits to cancellation beyond this order.
_HIGHEST_ORDER = 20


class CentroidMoments(ImageEstimator):
    """Encode presses by moments that do not depend on place, angle and gain.

    Parameters
    ----------
    order : int, default=8
        Highest order of the patterns, at most 20; order 8 has 25 moments.
    width : float, default=0.35
        Standard deviation of the Gaussian window, as a share of half the shorter
        side of the image. Smaller looks nearer to the centroid.
    normalise : {"energy", "total", None}, default="energy"
        What each press is divided by: the root of the sum of its squared levels,
        the sum of their sizes, or nothing (then gain, and force, count).
    centre_power : float, default=2.0
        The centroid weighs taxels by this power of their level. 1 is the centre of
        pressure; 2 is moved less by a faint background over part of the array.

    Attributes
    ----------
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.
    degrees_ : ndarray of int of shape (n_moments, 2)
        Order n and number of waves m around the centroid of each moment.
    patterns_ : ndarray of complex of shape (n_moments, order + 1, order + 1)
        Weight of x^i y^j in each pattern, coordinates in window widths.

    Notes
    -----
    With u = (x + iy) / s about the centroid, s the window's width in taxels, the
    pattern of order n with m waves is exp(-|u|^2 / 2) u^m L_k(|u|^2), where k =
    (n - m) / 2 and L_k is the generalised Laguerre polynomial of index m,
    normalised on the plane. The encoding is the magnitude of each moment; moments
    without waves (m = 0) keep their sign. An image of zeros is encoded by zeros.

    References
    ----------
    .. [1] R. Massey and A. Refregier, "Polar shapelets", Mon. Not. R. Astron. Soc.
       363(1), 2005. doi:10.1111/j.1365-2966.2005.09453.x

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import CentroidMoments
    >>> CentroidMoments(order=2).fit_transform(np.eye(10)[np.newaxis]).shape
    (1, 4)
    """

    def __init__(
        self,
        order: int = 8,
        *,
        width: float = 0.35,
        normalise: str | None = "energy",
        centre_power: float = 2.0,
    ) -> None:
        self.order, self.width = order, width
        self.normalise, self.centre_power = normalise, centre_power

    @property
    def blind_to(self) -> frozenset[str]:
        """Shifts and turns, and gain where presses are normalised."""
        both = frozenset({"shifts", "turns"})
        return both if self.normalise is None else both | {"gain"}

    def _learn(self, images: Array) -> None:
        order = check_count("order", self.order, at_least=0)
        if order > _HIGHEST_ORDER:
            raise ValueError(f"order must be at most {_HIGHEST_ORDER}, got {order}.")
        check_positive("width", self.width)
        check_option("normalise", self.normalise, ("energy", "total", None))
        check_positive("centre_power", self.centre_power)
        degrees = [(n, m) for n in range(order + 1) for m in range(n % 2, n + 1, 2)]
        self.degrees_ = np.array(degrees)
        self.patterns_ = np.stack([_pattern(n, m, order) for n, m in degrees])

    def transform_checked(self, images: Array) -> Floats:
        """Return the invariant moments, shape (n_touches, n_moments)."""
        moments = self._moments_of(images)
        waves = self.degrees_[:, 1] > 0
        return np.where(waves, np.abs(moments), moments.real)

    def complex_moments(self, X: ArrayLike) -> NDArray[np.complex128]:
        """Return the moments with their phases, shape (n_touches, n_moments).

        A press turned by an angle a from the column axis towards the row axis has
        its moments multiplied by exp(-i m a).
        """
        return by_channel(self._moments_of, self._images(X))

    def _moments_of(self, images: Array) -> NDArray[np.complex128]:
        images = images.astype(np.float64, copy=False)
        scale = self.width * min(images.shape[1:]) / 2
        levels = images / size_of(images, self.normalise)[:, None, None]
        row, col = _centroid(levels, self.centre_power)
        power = np.arange(self.patterns_.shape[1])
        down = _windowed_powers(images.shape[1], row, scale, power)
        across = _windowed_powers(images.shape[2], col, scale, power)
        products = across @ levels.transpose(0, 2, 1) @ down.transpose(0, 2, 1)
        flat = products.reshape(len(images), -1) / scale
        # Conjugated, as moments are integrals against the pattern's conjugate.
        moments: NDArray[np.complex128]
        moments = flat @ self.patterns_.conj().reshape(len(self.patterns_), -1).T
        return moments

    def get_feature_names_out(self, input_features: object = None) -> Array:
        """Return "moment<n>,<m>" for each moment."""
        check_is_fitted(self)
        return np.array([f"moment{n},{m}" for n, m in self.degrees_], dtype=object)


def sorted_taxels(images: ArrayLike, *, normalise: bool = False) -> Floats:
    """Return each image's levels, largest first, (n_touches, n_rows * n_cols)."""
    checked = check_images(images)
    if normalise:
        checked = checked / size_of(checked, "total")[:, None, None]
    return np.sort(checked.reshape(len(checked), -1), axis=1)[:, ::-1]


def size_of(images: Floats, normalise: str | None) -> Floats:
    """What each image is divided by, 1 where that would be 0."""
    if normalise is None:
        return np.ones(len(images))
    # By the largest level first, so that no square over- or underflows.
    top = np.abs(images).max(axis=(1, 2))
    top = np.where(top > 0, top, 1.0)
    relative = np.abs(images / top[:, None, None])
    if normalise == "total":
        size = relative.sum(axis=(1, 2))
    else:
        size = np.sqrt((relative**2).sum(axis=(1, 2)))
    return top * np.where(size > 0, size, 1.0)


def _centroid(images: Floats, power: float) -> tuple[Floats, Floats]:
    """Row and column of each image's centroid; the middle of an empty image."""
    _, n_rows, n_cols = images.shape
    top = np.abs(images).max(axis=(1, 2), keepdims=True)
    weight = np.abs(images / np.where(top > 0, top, 1.0)) ** power
    weight[top[:, 0, 0] == 0] = 1.0
    total = weight.sum(axis=(1, 2))
    row = weight.sum(axis=2) @ np.arange(n_rows) / total
    col = weight.sum(axis=1) @ np.arange(n_cols) / total
    return row, col


def _windowed_powers(
    n: int, centre: Floats, scale: float, power: NDArray[np.intp]
) -> Floats:
    """exp(-x^2 / 2) x^power along one side, (n_touches, n_powers, n)."""
    x = (np.arange(n) - centre[:, None]) / scale
    return np.exp(-(x**2) / 2)[:, None] * x[:, None] ** power[:, None]


def _pattern(n: int, m: int, order: int) -> NDArray[np.complex128]:
    """Weights of x^i y^j in the normalised u^m L_k(|u|^2) of order n."""
    k = (n - m) // 2
    weights = np.zeros((order + 1, order + 1), dtype=complex)
    norm = sqrt(factorial(k) / (np.pi * factorial(k + m)))
    for j in range(k + 1):
        laguerre = (-1) ** j * comb(k + m, k - j) / factorial(j)
        for a in range(j + 1):
            for b in range(m + 1):
                i_x, i_y = 2 * a + m - b, 2 * (j - a) + b
                weights[i_x, i_y] += laguerre * comb(j, a) * comb(m, b) * 1j**b
    weights *= norm
    return weights
