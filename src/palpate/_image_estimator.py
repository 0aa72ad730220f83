"""Base of every estimator of images: its tags, its image size, and its checks.

And what several of them look at: the disc inscribed in a frame, and central moments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache, partial, wraps
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import pascal
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from ._checks import check_finite, check_image_shape, check_images, check_levels
from ._types import Array, Bools, Floats

_ORDER = 3  # third moments tell one end of an axis from the other
_BINOMIAL = pascal(_ORDER + 1, kind="lower").astype(float)


class ImageEstimator(TransformerMixin, BaseEstimator):
    """An estimator of images, fitted to images of one size.

    An image of several channels is transformed channel by channel, by what was learnt
    from all channels together: so `_learn` and `transform_checked` of a subclass know
    grey images alone, unless it is declared with `by_channel=False`.

    `transform` is the door: it checks the images, then calls `transform_checked`. A
    subclass says there what it makes of them, checks its parameters and learns in
    `_learn`, and says in `_takes` which levels it takes if not finite ones.

    Attributes
    ----------
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`, or (n_rows, n_cols, n_channels).
    """

    image_shape_: tuple[int, ...]
    _by_channel = True  # whether channels are transformed one by one
    # Which levels are taken: "any", "nan" beside finite ones (a dead taxel), "finite",
    # or "bounded": those whose sums stay finite in single precision.
    _takes = "finite"

    def __init_subclass__(cls, by_channel: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls._by_channel = by_channel
        if by_channel and "transform_checked" in vars(cls):
            cls.transform_checked = _by_channel(cls.transform_checked)  # type: ignore[method-assign]

    @property
    def blind_to(self) -> frozenset[str]:
        """The changes that leave the result alike: "shifts", "turns", "gain"."""
        return frozenset()

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Check the parameters, learn from images and note their size.

        Parameters
        ----------
        X : array-like of shape (n_touches, n_rows, n_cols) or (..., n_channels)
        y : object, optional
            Ignored.

        Returns
        -------
        self
            With `image_shape_`, the size of the images.

        Raises
        ------
        TypeError, ValueError
            If `X` are no images such as this takes, or a parameter is none of those
            listed.
        """
        self._fitted(self._checked(X))
        return self

    def fit_transform(self, X: ArrayLike, y: object = None, **fixed: Any) -> Array:
        """Do what `fit` and then `transform` do, without doing anything twice."""
        if type(self).fit is not ImageEstimator.fit:
            return np.asarray(super().fit_transform(X, y, **fixed))
        images = self._checked(X)
        features = self._fitted(images)
        if features is None:
            return self.transform_checked(images)
        return by_channel(lambda _: features, images)

    def _fitted(self, images: Array) -> Array | None:
        features = self._learn(planes_of(images) if self._by_channel else images)
        self.image_shape_ = images.shape[1:]
        return features

    def transform(self, X: ArrayLike) -> Array:
        """Check images `X` of the size that `fit` saw, and transform them.

        What is returned, and its shape, `transform_checked` says; of several channels,
        their vectors side by side, or images with a last axis of channels.

        Raises
        ------
        TypeError, ValueError
            If `X` are no images such as `fit` saw.
        """
        return self.transform_checked(self._images(X))

    def transform_checked(self, images: Array) -> Array:
        """Do what `transform` does, for a caller that has checked the images.

        Parameters
        ----------
        images : ndarray of shape (n_touches, n_rows, n_cols) or (..., n_channels)
            Finite, of any real type and of the size that `fit` saw.
        """
        raise NotImplementedError

    def _learn(self, images: Array) -> Array | None:
        """Check the parameters and learn what there is to learn.

        May return what `transform_checked` would then make of the images.
        """
        return None

    def _checked(self, X: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
        """Return `X` as images that this takes, of `shape` if given, or explain."""
        images = check_image_shape(X, shape=shape, channels=True)
        if self._takes != "any":
            check_finite(images, allow_nan=self._takes == "nan")
        return check_levels(images) if self._takes == "bounded" else images

    def _images(self, X: ArrayLike) -> Array:
        """Return `X` as images of the size that `fit` saw, or explain."""
        if not hasattr(self, "image_shape_"):
            check_is_fitted(self, "image_shape_")
        return self._checked(X, shape=self.image_shape_)

    def _columns_named(self, names: Iterable[str]) -> Array:
        """Return the names of columns, of several channels with that of the channel."""
        check_is_fitted(self, "image_shape_")
        names = list(names)
        if len(self.image_shape_) == 3:
            channels = range(self.image_shape_[2])
            names = [f"{name}_channel{k}" for k in channels for name in names]
        return np.array(names, dtype=object)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags


def planes_of(images: Array) -> Array:
    """Return channels as touches of their own, (n_touches * n_channels, rows, cols)."""
    if images.ndim == 3:
        return images
    return np.moveaxis(images, 3, 1).reshape(-1, *images.shape[1:3])


def by_channel(transform: Callable[[Array], Array], images: Array) -> Array:
    """Return what `transform` makes of grey images, also of images with channels."""
    features = transform(planes_of(images))
    if images.ndim == 3:
        return features
    by_plane = features.reshape(len(images), images.shape[3], *features.shape[1:])
    if features.ndim == 2:
        return by_plane.reshape(len(images), -1)
    return np.moveaxis(by_plane, 1, 3)


def _by_channel(transform: Callable[[Any, Array], Array]) -> Any:
    """Return the method `transform` for images of any number of channels."""

    @wraps(transform)
    def transform_checked(self: Any, images: Array) -> Array:
        if images.ndim == 3:
            return transform(self, images)
        return by_channel(partial(transform, self), images)

    return transform_checked


@dataclass(frozen=True)
class CentralMoments:
    """Moments of images about each image's own centroid (`x`, `y`).

    The centroid is in pixels from the middle of the frame, 0 where the `mass` (sum of
    levels) is; `mu[:, q, p]` sums level * (x - centroid)^p * (y - centroid)^q.
    """

    mass: Floats
    x: Floats
    y: Floats
    mu: Floats


def central_moments(images: ArrayLike) -> CentralMoments:
    """Return the central moments of images to order 3 along x and y."""
    checked = check_images(images)
    n_rows, n_cols = checked.shape[1:]
    raw = _powers(n_rows).T @ checked @ _powers(n_cols)  # about the frame's middle
    mass = raw[:, 0, 0]
    safe = np.where(mass == 0, 1.0, mass)
    x = np.where(mass == 0, 0.0, raw[:, 0, 1] / safe)
    y = np.where(mass == 0, 0.0, raw[:, 1, 0] / safe)
    mu = _shift(y) @ raw @ _shift(x).transpose(0, 2, 1)
    return CentralMoments(mass, x, y, mu)


@lru_cache(maxsize=16)
def inscribed_mask(n_rows: int, n_cols: int) -> Bools:
    """Return a mask of the frame's inscribed disc; it is shared, so read-only."""
    row = np.arange(n_rows) - (n_rows - 1) / 2
    col = np.arange(n_cols) - (n_cols - 1) / 2
    squared = row[:, np.newaxis] ** 2 + col**2
    inside: Bools = squared <= (min(n_rows, n_cols) / 2) ** 2
    inside.flags.writeable = False
    return inside


@lru_cache(maxsize=16)
def _powers(n: int) -> Floats:
    """Return 1, x, x^2, x^3 of pixel centres from the middle, (n, 4)."""
    from_middle = np.arange(n) - (n - 1) / 2
    return (from_middle[:, None] ** np.arange(_ORDER + 1)).astype(np.float64)


def _shift(centre: Floats) -> Floats:
    """Matrices that turn moments about the middle into moments about `centre`."""
    order = np.arange(_ORDER + 1)
    gap = order[:, None] - order
    powers = (-centre[:, None, None]) ** np.maximum(gap, 0)
    return np.where(gap >= 0, _BINOMIAL * powers, 0.0)
