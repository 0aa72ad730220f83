"""Several encodings of the same image, side by side."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_images


class EncodingUnion(TransformerMixin, BaseEstimator):
    """Encode images by several encoders and join the vectors.

    Parameters
    ----------
    encoders : sequence of estimators
        Encoders of images; their features follow each other in this order.

    Attributes
    ----------
    encoders_ : list of fitted estimators
        One per encoder.
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import EncodingUnion, FourierDescriptors, ShapeGeometry
    >>> both = EncodingUnion([ShapeGeometry(), FourierDescriptors(n=5)])
    >>> square = np.pad(np.ones((4, 4)), 2)
    >>> both.fit_transform(square[np.newaxis]).shape
    (1, 7)
    """

    def __init__(self, encoders: Sequence[Any]) -> None:
        self.encoders = encoders

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Fit every encoder to the images; `y` is passed on."""
        images = check_images(X)
        if not len(self.encoders):
            raise ValueError("encoders must hold at least one encoder, got none.")
        self.image_shape_ = (images.shape[1], images.shape[2])
        self.encoders_ = [clone(encoder).fit(images, y) for encoder in self.encoders]
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the joined vectors, shape (n_touches, n_features)."""
        check_is_fitted(self)
        images = check_images(X, shape=self.image_shape_)
        return np.hstack([encoder.transform(images) for encoder in self.encoders_])

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags
