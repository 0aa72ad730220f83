"""Gradients on rings about the disc's centre: edges and ridges, whatever the angle.

At every place of a polar grid the image is described by its gradient along and
across the radius, by how strongly and in which direction its surroundings change,
and by its curvature. Turning the image shifts each ring of such values along itself,
so the sizes of their Fourier coefficients along the ring stay as they are.
"""

from functools import lru_cache
from itertools import repeat

import cv2
import numpy as np

from .._checks import check_count, check_number
from .._image_estimator import ImageEstimator
from .._types import Array, Complexes, Floats, Singles
from ._canvas import lengths

# Rings between these shares of the radius: nearer the centre a ring has no angles,
# nearer the edge the smoothing reaches what lies outside.
_INNER, _OUTER = 0.06, 0.93
_SURROUNDINGS = 1.5
_LEAST_STRENGTH = 1e-2
_PLACES, _N_CHANNELS = 48, 6
# Images and what is made of them stay in the cache.
_AT_ONCE = 16
_ANGLES = 2 * np.pi * np.arange(_PLACES) / _PLACES
_COS, _SIN = np.cos(_ANGLES), np.sin(_ANGLES)
Grid = tuple[Singles, Singles]


class PolarGradients(ImageEstimator):
    """Encode images by sizes of the harmonics of their gradients along rings.

    Parameters
    ----------
    n_rings : int, default=14
        Rings about the centre of the image.
    n_harmonics : int, default=16
        Harmonics per ring, besides the mean; at most 23 (48 places on a ring).
    smoothing : float, default=0.025
        Standard deviation of the smoothing before gradients are taken, as a share
        of the disc's radius. At least 0.5 taxels are taken.

    Attributes
    ----------
    scale_ : ndarray of shape (6,)
        Root mean power of each channel over the training touches, by which it is
        divided; 1 for a channel that is always zero.

    Notes
    -----
    Channels: the gradient's components along and across the radius, each gradient
    shortened to the square root of its length, so that one strong edge does not
    drown the others; the structure tensor of these [1]_ as its strength and the two
    components of its doubled direction, relative to the radius; and the signed root
    of the Laplacian. Rings count by the root of their radius, so that distances between
    vectors are distances over the disc. Rotation invariance is that of the sampling:
    a turned image of 97 x 97 taxels moves by a few per cent of its distance to others.

    References
    ----------
    .. [1] J. Bigun, G. H. Granlund, "Optimal orientation detection of linear symmetry",
       ICCV 1987, 433-438.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import PolarGradients
    >>> touches = np.random.default_rng(0).random((2, 40, 40))
    >>> PolarGradients(n_rings=5, n_harmonics=3).fit_transform(touches).shape
    (2, 120)
    """

    blind_to = frozenset({"turns"})
    _bounded = True

    def __init__(
        self, n_rings: int = 14, n_harmonics: int = 16, smoothing: float = 0.025
    ) -> None:
        self.n_rings = n_rings
        self.n_harmonics = n_harmonics
        self.smoothing = smoothing

    def _learn(self, images: Array) -> Floats:
        check_count("n_rings", self.n_rings)
        check_count("n_harmonics", self.n_harmonics)
        check_number("n_harmonics", self.n_harmonics, high=_PLACES // 2 - 1)
        check_number("smoothing", self.smoothing, low=1e-3, high=0.5)
        raw = self._harmonics(images)
        means, power = raw[..., 0].mean(axis=0), np.zeros(raw.shape[1])
        for start in range(0, len(raw), _AT_ONCE):
            spread = raw[start : start + _AT_ONCE].copy()
            spread[..., 0] -= means
            power += (np.abs(spread) ** 2).sum(axis=(0, 2, 3)) / len(raw)
        self.scale_ = np.where(power > 1e-24, np.sqrt(power), 1.0)
        return self._sizes(raw)

    def transform_checked(self, images: Array) -> Floats:
        """Return the sizes, (n_touches, 6 * n_rings * (n_harmonics + 1))."""
        return self._sizes(self._harmonics(images))

    def _sizes(self, harmonics: Complexes) -> Floats:
        sizes = np.abs(harmonics)
        sizes /= self.scale_[:, np.newaxis, np.newaxis]
        return sizes.reshape(len(harmonics), -1)

    def _harmonics(self, images: Array) -> Complexes:
        """Fourier coefficients, (n_touches, 6, n_rings, n_harmonics + 1)."""
        size = images.shape[1:]
        rings = np.linspace(_INNER, _OUTER, self.n_rings)
        grid = _grid(self.n_rings, size)
        sigma = max(self.smoothing * min(size) / 2, 0.5)
        shape = len(images), _N_CHANNELS, self.n_rings, self.n_harmonics + 1
        coefficients = np.empty(shape, dtype=np.complex128)
        for start in range(0, len(images), _AT_ONCE):
            into = coefficients[start : start + _AT_ONCE]
            part = images[start : start + _AT_ONCE]
            values = np.stack([*map(_channels, part, repeat(sigma), repeat(grid))])
            into[:] = np.fft.rfft(values, axis=-1)[..., : shape[-1]]
            into /= _PLACES
        coefficients *= np.sqrt(rings)[:, np.newaxis]
        # A coefficient stands for itself and its conjugate; the mean has none.
        coefficients[..., 0] /= np.sqrt(2)
        return coefficients


@lru_cache(maxsize=16)
def _grid(n_rings: int, shape: tuple[int, ...]) -> Grid:
    """Columns and rows of the places on all rings, (n_rings, 48) each."""
    radii = np.linspace(_INNER, _OUTER, n_rings)[:, np.newaxis] * (min(shape) / 2)
    cols = (shape[1] - 1) / 2 + radii * _COS
    rows = (shape[0] - 1) / 2 + radii * _SIN
    return cols.astype(np.float32), rows.astype(np.float32)


def _channels(image: Array, sigma: float, grid: Grid) -> Singles:
    """Values of the six channels on the rings, (6, n_rings, 48)."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    curvature = cv2.Laplacian(smooth, cv2.CV_32F, ksize=3)
    root = np.sqrt(lengths(across, down)) + 1e-6
    across, down = across / root, down / root
    curvature = np.copysign(cv2.sqrt(np.abs(curvature)), curvature)
    planes = [across, down, curvature]
    for product in (across * across, down * down, across * down):
        planes.append(cv2.GaussianBlur(product, (0, 0), _SURROUNDINGS * sigma))
    for number, plane in enumerate(planes):
        planes[number] = cv2.remap(plane, *grid, cv2.INTER_LINEAR)
    x, y, bend, xx, yy, xy = planes
    strength = np.sqrt(np.maximum(xx + yy, 0))
    along, oblique = _turned(xx - yy, 2 * xy, np.cos(2 * _ANGLES), np.sin(2 * _ANGLES))
    weight = 1 / np.maximum(strength, _LEAST_STRENGTH)
    radial, tangential = _turned(x, y, _COS, _SIN)
    return np.stack(
        [radial, tangential, strength, along * weight, oblique * weight, bend]
    )


def _turned(x: Array, y: Array, cos: Floats, sin: Floats) -> tuple[Array, Array]:
    """Components relative to the direction with this cosine and sine."""
    return x * cos + y * sin, y * cos - x * sin
