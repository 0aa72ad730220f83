"""Levels as features: taxels, means over a grid, slopes of a gel lit from sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_count, check_finite, check_number, check_option
from .._image_estimator import ImageEstimator, by_channel
from .._types import Array, Floats
from ..images import OrientationRegulariser
from ._moments import size_of

PAPER_SIDE = 13  # 169 values, as in the paper
# The median of so many training images is a baseline.
_LOOKED_AT = 200


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
    """Encode an image as it is: mean levels over a grid, roots, blurred or not.

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

    Attributes
    ----------
    down_, across_ : ndarray of shape (n_cells, n_rows or n_cols)
        Share of each pixel in each cell, along both sides.
    smooth_down_, smooth_across_ : ndarray of shape (n_cells, n_cells)
        Weights of the blur, along both sides.
    baseline_ : ndarray of shape (n_cells, n_cells) or (n_cells, n_cells, n_channels)
        Mean levels of the baseline; 0 without one.

    Notes
    -----
    It is blind to nothing, or to gain if `unit`; what is finer than cells and `blur`
    it does not see.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import GridLevels
    >>> GridLevels(2).fit_transform(np.arange(16.0).reshape(1, 4, 4) ** 2).round(2)
    array([[ 3.24,  4.95, 10.7 , 12.67]])
    """

    def __init__(
        self,
        cells: int = 32,
        blur: float = 0.0,
        root: bool = True,
        unit: bool = False,
        baseline: str | ArrayLike | None = None,
    ) -> None:
        self.cells, self.blur = cells, blur
        self.root, self.unit = root, unit
        self.baseline = baseline

    @property
    def blind_to(self) -> frozenset[str]:
        """Gain, where touches are divided by their norm."""
        return frozenset({"gain"}) if self.unit else frozenset()

    def _learn(self, images: Array) -> None:
        sides = images.shape[1:3]
        cells = check_count("cells", self.cells)
        blur = check_number("blur", self.blur, low=0, high=cells)
        check_option("root", self.root, (False, True))
        check_option("unit", self.unit, (False, True))
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
            spread = np.linspace(0, len(images) - 1, _LOOKED_AT).astype(int)
            means = by_channel(self._means, images[np.unique(spread)])
            self.baseline_ = np.median(means, axis=0)
        elif self.baseline is not None:
            frame = check_finite(np.asarray(self.baseline)[np.newaxis])
            if frame.shape[1:] != images.shape[1:]:
                raise ValueError(
                    f"baseline must be an image of shape {images.shape[1:]} like the "
                    f"others, got {frame.shape[1:]}. Crop or resize it."
                )
            self.baseline_ = by_channel(self._means, frame)[0]

    def transform_checked(self, images: Array) -> Floats:
        """Return the levels, cell by cell, (n_touches, n_cells)."""
        differences = by_channel(self._means, images) - self.baseline_
        levels = by_channel(self._levels, differences)
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
            baseline = self._slopes(np.asarray(baseline))
        self.grid_ = GridLevels(self.cells, baseline=baseline)
        self.grid_.fit(self._slopes(images))

    def transform_checked(self, images: Array) -> Floats:
        """Return roots of the slopes, (n_touches, 2 * n_cells)."""
        return self.grid_.transform_checked(self._slopes(images))

    def _slopes(self, images: Array) -> Floats:
        """Slopes along rows and columns, (n_touches, n_rows, n_cols, 2)."""
        return images.astype(np.float64, copy=False) @ self.slopes_.T
