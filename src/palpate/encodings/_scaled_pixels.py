"""Scaled pixels: the turned image averaged down to a few cells."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_images, check_number
from ..images import OrientationRegulariser

Floats = NDArray[np.float64]
PAPER_SIDE = 13


class ScaledPixels(TransformerMixin, BaseEstimator):
    """Encode an image by the means of a few by a few cells.

    Parameters
    ----------
    side : int, default=13
        Cells along each side, or as many as there are pixels. Corradi et al. 2014
        use up to 13.
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

    References
    ----------
    .. [1] T. Corradi, P. Hall, P. Iravani, "Tactile features: recognising touch
       sensations with a novel and inexpensive tactile sensor", TAROS 2014,
       LNCS 8717. doi:10.1007/978-3-319-10401-0

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

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Lay the cells over images of the size of `X`; `y` is ignored."""
        images = check_images(X)
        side = check_count("side", self.side)
        self.regulariser_ = None
        if self.min_anisotropy is not None:
            check_number("min_anisotropy", self.min_anisotropy, low=0, high=1)
            self.regulariser_ = OrientationRegulariser(self.min_anisotropy).fit(images)
        self.image_shape_ = (images.shape[1], images.shape[2])
        self.down_, self.across_ = (
            _averages(n, min(side, n)) for n in self.image_shape_
        )
        return self

    def transform(self, X: ArrayLike) -> Floats:
        """Return the means, row by row, shape (n_touches, n_cells**2)."""
        check_is_fitted(self)
        images = check_images(X, shape=self.image_shape_)
        if self.regulariser_ is not None:
            images = self.regulariser_.transform(images)
        means = self.down_ @ images @ self.across_.T
        return means.reshape(len(images), -1)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags


def _averages(n: int, n_cells: int) -> Floats:
    """Share of each of n pixels in each cell, (n_cells, n); rows sum to 1."""
    border = np.arange(n_cells + 1) * (n / n_cells)
    pixel = np.arange(n)
    low = np.maximum(border[:-1, None], pixel)
    high = np.minimum(border[1:, None], pixel + 1)
    shares: Floats = np.maximum(high - low, 0) * (n_cells / n)
    return shares
