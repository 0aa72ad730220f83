"""Levels as features: every taxel, or the turned image averaged to a few cells."""

from __future__ import annotations

import numpy as np

from .._checks import check_count, check_number
from .._image_estimator import ImageEstimator
from .._types import Array, Floats
from ..images import OrientationRegulariser

PAPER_SIDE = 13


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
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.
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
    shares: Floats = np.maximum(high - low, 0) * (n_cells / n)
    return shares
