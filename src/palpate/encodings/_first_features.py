"""The first few features of another encoder."""

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_images


class FirstFeatures(TransformerMixin, BaseEstimator):
    """Keep the first features of an encoder of images.

    For encoders whose features stand in order, such as moments by rising order, so
    that their number can be chosen as a number of components is.

    Parameters
    ----------
    encoder : estimator
        An encoder of images.
    n_components : int, optional
        How many features to keep, or as many as there are; by default all.

    Attributes
    ----------
    encoder_ : fitted estimator
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import FirstFeatures, ZernikeMoments
    >>> four = FirstFeatures(ZernikeMoments(order=3), 4)
    >>> four.fit_transform(np.ones((2, 10, 10))).shape
    (2, 4)
    """

    def __init__(self, encoder: Any, n_components: int | None = None) -> None:
        self.encoder = encoder
        self.n_components = n_components

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Fit the encoder; `y` is passed on."""
        images = check_images(X)
        if self.n_components is not None:
            check_count("n_components", self.n_components)
        self.encoder_ = clone(check_encoder("encoder", self.encoder)).fit(images, y)
        self.image_shape_ = (images.shape[1], images.shape[2])
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the first features, shape (n_touches, n_components)."""
        check_is_fitted(self)
        features: NDArray[np.float64] = self.encoder_.transform(X)
        return features[:, : self.n_components]

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags


def check_encoder(name: str, encoder: Any) -> Any:
    """Return `encoder` if it is one, not a class or a name of one, or explain."""
    methods = ("fit", "transform", "get_params")
    if isinstance(encoder, type) or not all(hasattr(encoder, m) for m in methods):
        raise TypeError(
            f"{name} must be made of encoders of images, got {encoder!r}. Pass one "
            "such as HuMoments(), or make it by encoder_named('hu')."
        )
    return encoder
