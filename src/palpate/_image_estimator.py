"""What every estimator of images shares: its tags, its image size, and its checks."""

from __future__ import annotations

from typing import Self

from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from ._checks import check_images
from ._types import Array


class ImageEstimator(TransformerMixin, BaseEstimator):
    """An estimator of images, fitted to images of one size.

    `transform` is the door: it checks the images, then calls `transform_checked`. A
    subclass says there what it makes of them, checks its parameters and learns in
    `_learn`, and says in `_checked` what images it takes if not finite ones.

    Attributes
    ----------
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.
    """

    image_shape_: tuple[int, int]

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Check the parameters, learn from images and note their size.

        Parameters
        ----------
        X : array-like of shape (n_touches, n_rows, n_cols)
        y : object, optional
            Ignored.

        Returns
        -------
        self
            With `image_shape_`, (n_rows, n_cols) of the images.

        Raises
        ------
        TypeError, ValueError
            If `X` are no images such as this takes, or a parameter is none of those
            listed.
        """
        images = self._checked(X)
        self._learn(images)
        self.image_shape_ = (images.shape[1], images.shape[2])
        return self

    def transform(self, X: ArrayLike) -> Array:
        """Check images `X` of the size that `fit` saw, and transform them.

        What is returned, and its shape, `transform_checked` says.

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
        images : ndarray of shape (n_touches, n_rows, n_cols)
            Finite, of any real type and of the size that `fit` saw.
        """
        raise NotImplementedError

    def _learn(self, images: Array) -> None:
        """Check the parameters and learn what there is to learn."""

    def _checked(self, X: ArrayLike, shape: tuple[int, int] | None = None) -> Array:
        """Return `X` as images that this takes, of `shape` if given, or explain."""
        return check_images(X, shape=shape)

    def _images(self, X: ArrayLike) -> Array:
        """Return `X` as images of the size that `fit` saw, or explain."""
        if not hasattr(self, "image_shape_"):
            check_is_fitted(self, "image_shape_")
        return self._checked(X, shape=self.image_shape_)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags
