"""What encoders share that look at images of about the same number of pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_images, check_levels
from .._image_estimator import ImageEstimator
from .._types import Array, Floats


class CanvasEncoder(ImageEstimator):
    """An encoder of images whose shorter side has from 32 to `_most` pixels.

    Smaller images are enlarged bilinearly, larger ones reduced by area means; rows and
    columns become multiples of `_multiple`. A subclass encodes one such image, in
    single precision, by `_vector`.
    """

    _most, _multiple = 64, 1

    def transform_checked(self, images: Array) -> Floats:
        """Return the features, shape (n_touches, n_features)."""
        rows, cols = self._canvas(images.shape[1:])
        smaller = rows <= images.shape[1] and cols <= images.shape[2]
        how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        vectors = [
            self._vector(cv2.resize(image, (cols, rows), interpolation=how))
            for image in images.astype(np.float32, copy=False)
        ]
        return np.stack(vectors).astype(np.float64, copy=False)

    def _vector(self, image: Array) -> Array:
        raise NotImplementedError

    def _canvas(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Return rows and columns of what images of `shape` become."""
        short = min(shape)
        scale = min(max(short, 32), self._most) / short / self._multiple
        rows, cols = (self._multiple * round(n * scale) for n in shape)
        return rows, cols

    def _checked(self, X: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
        return check_levels(check_images(X, shape=shape, channels=True))
