"""Several encodings of the same image, side by side."""

from collections.abc import Iterable, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_image_shape, check_option
from ._first_features import check_encoder
from ._root import RootScaler


class EncodingUnion(TransformerMixin, BaseEstimator):
    """Encode images by several encoders and join the vectors.

    Parameters
    ----------
    encoders : sequence of estimators
        Encoders of images; their features, real numbers, follow each other in this
        order.
    balanced : bool, default=False
        Bring each encoder's features to signed roots of total variance 1
        (`RootScaler`), so that many features of one do not outweigh few of another.

    Attributes
    ----------
    encoders_ : list of fitted estimators
        One per encoder.
    scalers_ : list of RootScaler
        One per encoder where they are balanced, else none.
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

    def __init__(self, encoders: Sequence[Any], balanced: bool = False) -> None:
        self.encoders = encoders
        self.balanced = balanced

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Fit every encoder to the images; `y` is passed on."""
        images = check_image_shape(X)
        encoders = _check_encoders(self.encoders)
        self.image_shape_ = (images.shape[1], images.shape[2])
        check_option("balanced", self.balanced, (False, True))
        self.encoders_ = [clone(encoder).fit(images, y) for encoder in encoders]
        for encoder in self.encoders_:
            _refuse_complex(encoder, images[:1])
        self.scalers_ = []
        if self.balanced:
            parts = [encoder.transform(images) for encoder in self.encoders_]
            self.scalers_ = [RootScaler().fit(part) for part in parts]
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the joined vectors, shape (n_touches, n_features)."""
        check_is_fitted(self)
        images = check_image_shape(X, shape=self.image_shape_)
        parts = [encoder.transform(images) for encoder in self.encoders_]
        if self.scalers_:
            scaled = zip(self.scalers_, parts, strict=True)
            parts = [scaler.scale(part) for scaler, part in scaled]
        return np.hstack(parts)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags


def _check_encoders(encoders: object) -> list[Any]:
    if isinstance(encoders, str) or not isinstance(encoders, Iterable):
        raise TypeError(
            f"encoders must be a list of encoders, got {encoders!r}. For encodings by "
            "name use encoder_named('hu+zernike')."
        )
    listed = list(encoders)
    if not listed:
        raise ValueError("encoders must hold at least one encoder, got none.")
    for encoder in listed:
        check_encoder("encoders", encoder)
    return listed


def _refuse_complex(encoder: Any, images: NDArray) -> None:
    if np.iscomplexobj(encoder.transform(images)):
        raise ValueError(
            f"encoders must give real features, got complex ones of {encoder!r}. "
            "Choose a real output, such as 'abs' or 'noll'."
        )
