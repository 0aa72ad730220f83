"""Levels and how they change: taxels, means over a grid, gradients.

`PhotometricGradients` are the slopes of a gel that is lit from sides. `PolarGradients`
describe every place of a polar grid by the gradient along and across the radius, by
how strongly and in which direction its surroundings change, and by its curvature.
Turning the image shifts each ring of such values along itself, so the sizes of their
Fourier coefficients along the ring stay as they are.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import repeat

import cv2
import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_count, check_finite, check_number, check_option
from .._image_estimator import ImageEstimator, by_channel
from .._numbers import evenly_spaced
from .._types import Array, Complexes, Floats, Indices, Singles
from ..images import OrientationRegulariser
from ._edges_and_rings import lengths
from ._shape import boxes_of, cut_out, size_of

PAPER_SIDE = 13  # 169 values, as in the paper
# The median of so many training images is a baseline.
_LOOKED_AT = 200
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


class ScaledPixels(ImageEstimator):
    """Encode an image by the means of a few by a few cells.

    Parameters
    ----------
    side : int, default=13
        Cells along each side, or as many as there are pixels. Corradi et al. 2014
        (doi:10.1007/978-3-319-10401-0) use up to 13.
    min_anisotropy : float or None, default=0.02
        The image is first turned so that its long axis lies along the columns,
        unless it is less elongated than this; see
        `palpate.images.OrientationRegulariser`. None turns nothing.

    Attributes
    ----------
    regulariser_ : OrientationRegulariser or None
        What turns the images.
    down_, across_ : ndarray of shape (n_cells, n_rows or n_cols)
        Share of each pixel in each cell, along both sides.

    Notes
    -----
    Each cell is the mean over exactly the area that it covers, also where it cuts
    pixels. When images are turned, what lies outside the inscribed disc is zero.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import ScaledPixels
    >>> image = np.arange(16.0).reshape(1, 4, 4)
    >>> ScaledPixels(2, min_anisotropy=None).fit_transform(image)
    array([[ 2.5,  4.5, 10.5, 12.5]])
    """

    def __init__(
        self, side: int = PAPER_SIDE, *, min_anisotropy: float | None = 0.02
    ) -> None:
        self.side = side
        self.min_anisotropy = min_anisotropy

    @property
    def blind_to(self) -> frozenset[str]:
        """Turns, where images are turned."""
        return frozenset() if self.min_anisotropy is None else frozenset({"turns"})

    def _learn(self, images: Array) -> None:
        side = check_count("side", self.side)
        self.regulariser_ = None
        if self.min_anisotropy is not None:
            check_number("min_anisotropy", self.min_anisotropy, low=0, high=1)
            self.regulariser_ = OrientationRegulariser(self.min_anisotropy).fit(images)
        self.down_, self.across_ = (
            _averages(n, min(side, n)) for n in images.shape[1:]
        )

    def transform_checked(self, images: Array) -> Floats:
        """Return the means, row by row, shape (n_touches, n_cells**2)."""
        images = images.astype(np.float64, copy=False)
        if self.regulariser_ is not None:
            images = self.regulariser_.transform_checked(images)
        means: Floats = self.down_ @ images @ self.across_.T
        return means.reshape(len(images), -1)


class GridLevels(ImageEstimator, by_channel=False):
    """Encode an image as it is, or apart from place: mean levels over a grid, roots.

    Parameters
    ----------
    cells : int, default=32
        Most cells along the longer side; cells are nearly square. Images that have no
        more taxels are left as they are.
    blur : float, default=0.0
        Standard deviation, in cells, of the Gaussian that smooths what comes out.
    root : bool, default=True
        Take signed square roots, so that strong levels do not drown faint ones.
    unit : bool, default=False
        Divide each touch, all channels together, by its norm; zeros stay.
    baseline : {"median"}, image or None, default=None
        What is taken off each image before its roots: a frame of no contact as large as
        the images, or the median of the training images, pixel by pixel; None nothing.
    spectrum : bool, default=False
        Give the sizes of the Fourier coefficients of what comes out, channel by
        channel: levels apart from their place.
    pads : array-like of int of shape (n_pads, 4), optional
        First row, first column, rows and columns of each pad in the image: each has a
        grid, and a spectrum, of its own. By default the whole image is one pad.

    Attributes
    ----------
    pads_ : ndarray of int of shape (n_pads, 4)
        The pads, where they are given.
    grids_ : list of GridLevels
        One for each of them.
    down_, across_ : ndarray of shape (n_cells, n_rows or n_cols)
        Share of each pixel in each cell, along both sides.
    smooth_down_, smooth_across_ : ndarray of shape (n_cells, n_cells)
        Weights of the blur, along both sides.
    baseline_ : ndarray of shape (n_cells, n_cells) or (n_cells, n_cells, n_channels)
        Mean levels of the baseline; 0 without one.

    Notes
    -----
    It is blind to gain if `unit`, to shifts and half a turn if `spectrum`, else to
    nothing; what is finer than cells and `blur` it does not see. For a spectrum levels
    are padded by zeros to twice the sides, so that nothing comes in again at the other
    side: it tells as much as the autocorrelation. A baseline that is the median of
    touches would not move with them.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import GridLevels
    >>> GridLevels(2).fit_transform(np.arange(16.0).reshape(1, 4, 4) ** 2).round(2)
    array([[ 3.24,  4.95, 10.7 , 12.67]])
    >>> strips = np.array([[[4.0, 9, 0, 0]], [[0, 0, 4, 9]]])
    >>> GridLevels(spectrum=True).fit_transform(strips).round(2)
    array([[5.  , 4.64, 3.61, 2.12, 1.  ],
           [5.  , 4.64, 3.61, 2.12, 1.  ]])
    """

    def __init__(
        self,
        cells: int = 32,
        blur: float = 0.0,
        root: bool = True,
        unit: bool = False,
        baseline: str | ArrayLike | None = None,
        spectrum: bool = False,
        pads: ArrayLike | None = None,
    ) -> None:
        self.cells, self.blur = cells, blur
        self.root, self.unit = root, unit
        self.baseline, self.spectrum = baseline, spectrum
        self.pads = pads

    @property
    def blind_to(self) -> frozenset[str]:
        """Gain, where touches are divided by their norm; shifts, of a spectrum."""
        blind = {"gain": self.unit, "shifts": self.spectrum}
        return frozenset(change for change, is_blind in blind.items() if is_blind)

    def _learn(self, images: Array) -> None:
        sides = images.shape[1:3]
        cells = check_count("cells", self.cells)
        blur = check_number("blur", self.blur, low=0, high=cells)
        for name in ("root", "unit", "spectrum"):
            check_option(name, getattr(self, name), (False, True))
        size = max(max(sides) / cells, 1)
        self.down_, self.across_ = (
            _averages(n, max(round(n / size), 1)) for n in sides
        )
        self.smooth_down_, self.smooth_across_ = (
            _gaussian(len(cells), blur) for cells in (self.down_, self.across_)
        )
        self.baseline_ = np.zeros(1)
        if isinstance(self.baseline, str):
            check_option("baseline", self.baseline, ("median",))
            rows = evenly_spaced(len(images), _LOOKED_AT)
            self.baseline_ = np.median(by_channel(self._means, images[rows]), axis=0)
        elif self.baseline is not None:
            frame = _baseline_like(images, self.baseline)
            self.baseline_ = by_channel(self._means, frame[np.newaxis])[0]
        if self.pads is not None:
            self.pads_ = boxes_of(self.pads, sides)
            self.grids_ = [
                self._of_pad(box).fit(cut_out(images, box)) for box in self.pads_
            ]

    def _of_pad(self, box: Indices) -> GridLevels:
        baseline = self.baseline
        if baseline is not None and not isinstance(baseline, str):
            baseline = cut_out(np.asarray(baseline)[np.newaxis], box)[0]
        levels = self.cells, self.blur, self.root
        return GridLevels(*levels, baseline=baseline, spectrum=self.spectrum)

    def transform_checked(self, images: Array) -> Floats:
        """Return the levels, cell by cell, or their spectrum, (n_touches, n_cells)."""
        if self.pads is None:
            differences = by_channel(self._means, images) - self.baseline_
            levels = by_channel(self._levels, differences)
        else:
            # Channel by channel, as where there is one pad.
            shape = len(images), 1 if images.ndim == 3 else images.shape[3], -1
            parts = [
                grid.transform_checked(cut_out(images, box)).reshape(shape)
                for grid, box in zip(self.grids_, self.pads_, strict=True)
            ]
            levels = np.concatenate(parts, axis=2).reshape(len(images), -1)
        if self.unit:
            levels = levels / size_of(levels[:, np.newaxis], "energy")[:, np.newaxis]
        return levels

    def _means(self, images: Array) -> Floats:
        """Mean levels of the cells, (n_touches, n_cells, n_cells)."""
        levels: Floats = images.astype(np.float64, copy=False)
        if len(self.down_) < images.shape[1] or len(self.across_) < images.shape[2]:
            levels = self.down_ @ levels @ self.across_.T
        return levels

    def _levels(self, levels: Floats) -> Floats:
        if self.root:
            levels = np.sign(levels) * np.sqrt(np.abs(levels))
        if self.blur:
            levels = self.smooth_down_ @ levels @ self.smooth_across_.T
        if self.spectrum:
            padded = [side if side == 1 else 2 * side for side in levels.shape[1:]]
            levels = np.abs(np.fft.rfft2(levels, padded))
        return levels.reshape(len(levels), -1)


class TaxelVector(ImageEstimator):
    """Every taxel is a feature, row by row.

    For a hand's electrodes or any sensor whose taxels have no places: nothing is
    turned, centred or averaged.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import TaxelVector
    >>> TaxelVector().fit_transform(np.ones((2, 3, 24))).shape
    (2, 72)
    """

    def transform_checked(self, images: Array) -> Floats:
        """Return the taxels, shape (n_touches, n_rows * n_cols)."""
        return images.reshape(len(images), -1).astype(np.float64)


def _baseline_like(images: Array, baseline: ArrayLike) -> Array:
    """Return a finite frame of no contact, of the size of the images, or explain."""
    frame = np.asarray(baseline)
    if frame.shape != images.shape[1:]:
        raise ValueError(
            f"baseline must be 'median' or an image of shape {images.shape[1:]} like "
            f"the others, got one of shape {frame.shape}. Crop or resize it."
        )
    return np.asarray(check_finite(frame[np.newaxis])[0])


def _averages(n: int, n_cells: int) -> Floats:
    """Share of each of n pixels in each cell, (n_cells, n); rows sum to 1."""
    border = np.arange(n_cells + 1) * (n / n_cells)
    pixel = np.arange(n)
    low = np.maximum(border[:-1, None], pixel)
    high = np.minimum(border[1:, None], pixel + 1)
    return np.asarray(np.maximum(high - low, 0) * (n_cells / n))


def _gaussian(n_cells: int, std: float) -> Floats:
    """Weights of a blur along one side, (n_cells, n_cells); rows sum to 1."""
    lag = np.subtract.outer(np.arange(n_cells), np.arange(n_cells))
    weights: Floats = np.exp(-(lag**2) / (2 * max(std, 1e-3) ** 2))
    weights /= weights.sum(axis=1, keepdims=True)
    return weights


class PhotometricGradients(ImageEstimator, by_channel=False):
    """Encode a gel lit from several sides by the slopes of its surface.

    Parameters
    ----------
    lights : array-like of shape (n_channels, 2)
        Where the light of each channel comes from, seen from above: towards rows and
        towards columns, as long as the light is strong. Two directions at least.
    baseline : {"median"} or image, default="median"
        What the gel looks like untouched; see `GridLevels`.
    cells : int, default=32
        Most cells along the longer side.

    Attributes
    ----------
    slopes_ : ndarray of shape (2, n_channels)
        Slopes along rows and columns for each channel's change of level.
    grid_ : GridLevels
        What lays the slopes on a grid, as signed roots.

    Notes
    -----
    A surface that falls towards a light gets brighter in its channel by the slope times
    the light's strength (Lambert, slopes below about a third). The slopes are the least
    squares solution of that, pixel by pixel: photometric stereo [1]_, in units of a
    level over a light's strength. It is blind to nothing.

    References
    ----------
    .. [1] R. J. Woodham, "Photometric method for determining surface orientation from
       multiple images", Optical Engineering 19(1), 1980. doi:10.1117/12.7972479

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import PhotometricGradients
    >>> lights = [[-1, 0], [0.5, 0.87], [0.5, -0.87]]
    >>> touches = np.random.default_rng(0).random((3, 40, 40, 3))
    >>> PhotometricGradients(lights, cells=8).fit_transform(touches).shape
    (3, 128)
    """

    def __init__(
        self, lights: ArrayLike, baseline: str | ArrayLike = "median", cells: int = 32
    ) -> None:
        self.lights, self.baseline, self.cells = lights, baseline, cells

    def _learn(self, images: Array) -> None:
        lights = np.asarray(self.lights, dtype=np.float64)
        n_channels = images.shape[3] if images.ndim == 4 else 1
        if lights.shape != (n_channels, 2) or np.linalg.matrix_rank(lights) < 2:
            raise ValueError(
                f"lights must hold a direction (row, column) for each of {n_channels} "
                f"channels, two different ones at least, got {lights.tolist()}. Give "
                "where each channel's light comes from."
            )
        check_number("lights", float(np.abs(lights).max()), high=1e6)
        self.slopes_ = np.linalg.pinv(lights)
        baseline = self.baseline
        if not isinstance(baseline, str):
            baseline = self._slopes(_baseline_like(images, baseline))
        self.grid_ = GridLevels(self.cells, baseline=baseline)
        self.grid_.fit(self._slopes(images))

    def transform_checked(self, images: Array) -> Floats:
        """Return roots of the slopes, (n_touches, 2 * n_cells)."""
        return self.grid_.transform_checked(self._slopes(images))

    def _slopes(self, images: Array) -> Floats:
        """Slopes along rows and columns, (n_touches, n_rows, n_cols, 2)."""
        return images.astype(np.float64, copy=False) @ self.slopes_.T


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
    _takes = "bounded"

    def __init__(
        self, n_rings: int = 14, n_harmonics: int = 16, smoothing: float = 0.025
    ) -> None:
        self.n_rings = n_rings
        self.n_harmonics = n_harmonics
        self.smoothing = smoothing

    def _learn(self, images: Array) -> Floats:
        check_count("n_rings", self.n_rings)
        check_count("n_harmonics", self.n_harmonics, at_most=_PLACES // 2 - 1)
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
