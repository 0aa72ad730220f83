"""Taxels as they are: for sensors whose taxels have no geometry."""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_images


class TaxelVector(TransformerMixin, BaseEstimator):
    """Every taxel is a feature, row by row.

    For a hand's electrodes or any sensor whose taxels have no places: nothing is
    turned, centred or averaged.

    Attributes
    ----------
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import TaxelVector
    >>> TaxelVector().fit_transform(np.ones((2, 3, 24))).shape
    (2, 72)
    """

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Learn the image size; `y` is ignored."""
        images = check_images(X)
        self.image_shape_ = (images.shape[1], images.shape[2])
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the taxels, shape (n_touches, n_rows * n_cols)."""
        check_is_fitted(self)
        images = check_images(X, shape=self.image_shape_)
        return images.reshape(len(images), -1).copy()

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags
