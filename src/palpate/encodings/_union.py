"""Several encodings of the same image side by side, and the scale they share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, OneToOneFeatureMixin, TransformerMixin, clone
from sklearn.utils.validation import check_is_fitted, validate_data

from .._checks import check_image_shape, check_option
from .._image_estimator import ImageEstimator
from .._types import Array, Floats


class EncodingUnion(ImageEstimator, by_channel=False):
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

    @property
    def blind_to(self) -> frozenset[str]:
        """What all of its encoders are blind to."""
        nothing: frozenset[str] = frozenset()
        each = [getattr(part, "blind_to", nothing) for part in self.encoders]
        return frozenset.intersection(*each) if each else nothing

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Fit every encoder to the images; `y` is passed on."""
        images = self._checked(X)
        encoders = _check_encoders(self.encoders)
        check_option("balanced", self.balanced, (False, True))
        self.encoders_ = [clone(encoder).fit(images, y) for encoder in encoders]
        for encoder in self.encoders_:
            if np.iscomplexobj(encoder.transform(images[:1])):
                raise ValueError(
                    "encoders must give real features, got complex ones of "
                    f"{encoder!r}. Choose a real output, such as 'abs' or 'noll'."
                )
        self.scalers_ = []
        if self.balanced:
            self.scalers_ = [RootScaler().fit(part) for part in self._parts(images)]
        self.image_shape_ = images.shape[1:]
        return self

    def transform_checked(self, images: Array) -> Floats:
        """Return the joined vectors, shape (n_touches, n_features)."""
        parts = self._parts(images)
        if self.scalers_:
            scaled = zip(self.scalers_, parts, strict=True)
            parts = [scaler.scale(part) for scaler, part in scaled]
        return np.hstack(parts)

    def _parts(self, images: Array) -> list[Array]:
        return [
            encoder.transform_checked(images)
            if isinstance(encoder, ImageEstimator)
            else encoder.transform(images)
            for encoder in self.encoders_
        ]

    def _checked(self, X: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
        # Which levels are too large, each encoder says itself.
        return check_image_shape(X, shape=shape, channels=True)

    def _images(self, X: ArrayLike) -> Array:
        images = super()._images(X)
        for encoder in self.encoders_:
            if isinstance(encoder, ImageEstimator):
                encoder._images(images)
        return images


def _check_encoders(encoders: object) -> list[Any]:
    if isinstance(encoders, str) or not isinstance(encoders, Iterable):
        raise TypeError(
            f"encoders must be a list of encoders, got {encoders!r}. For encodings by "
            "name use encoder_named('hu+zernike')."
        )
    listed = list(encoders)
    if not listed:
        raise ValueError("encoders must hold at least one encoder, got none.")
    methods = ("fit", "transform", "get_params")
    for encoder in listed:
        if isinstance(encoder, type) or not all(hasattr(encoder, m) for m in methods):
            raise TypeError(
                f"encoders must be made of encoders of images, got {encoder!r}. Pass "
                "one such as HuMoments(), or make it by encoder_named('hu')."
            )
    return listed


class RootScaler(OneToOneFeatureMixin, TransformerMixin, BaseEstimator):
    """Signed square root of each feature, then mean 0 and total variance 1.

    Moments of a press differ by orders of magnitude between faint and strong
    contacts; the root brings them closer before a distance is taken. All
    features have equal variance afterwards, and the sum over features is one, so
    that blocks of features of different length weigh the same side by side.
    Features that never change in training become 0.

    Attributes
    ----------
    mean_, scale_ : ndarray of shape (n_features,)
        Mean and divisor of each feature's root.

    Examples
    --------
    >>> from palpate.encodings import RootScaler
    >>> RootScaler().fit_transform([[0.0, 1.0], [4.0, 1.0]])
    array([[-0.70710678,  0.        ],
           [ 0.70710678,  0.        ]])
    """

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Learn mean and spread of the roots; `y` is ignored."""
        roots = _root(validate_data(self, X, dtype=np.float64))
        self.mean_ = roots.mean(axis=0)
        spread = roots.std(axis=0)
        constant = spread <= 1e-9 * np.abs(roots).max(axis=0)
        root_of_count = np.sqrt(roots.shape[1])
        self.scale_ = np.where(constant, np.inf, spread * root_of_count)
        return self

    def transform(self, X: ArrayLike) -> Floats:
        """Return the scaled roots, shape (n_touches, n_features)."""
        check_is_fitted(self)
        features = validate_data(self, X, dtype=np.float64, reset=False)
        return self.scale(features)

    def scale(self, features: Floats) -> Floats:
        """Do what `transform` does, without its checks."""
        scaled: Floats = (_root(features) - self.mean_) / self.scale_
        return scaled


def _root(features: Floats) -> Floats:
    return np.sign(features) * np.sqrt(np.abs(features))
