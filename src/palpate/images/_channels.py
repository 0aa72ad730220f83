"""Images of several channels brought to grey."""

from __future__ import annotations

import numpy as np

from .._image_estimator import ImageEstimator
from .._types import Array, Floats


class ChannelMean(ImageEstimator, by_channel=False):
    """Bring images of several channels to grey, their mean; grey ones stay.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import ChannelMean
    >>> colour = np.zeros((2, 10, 10, 3), np.uint8)
    >>> ChannelMean().fit_transform(colour).shape
    (2, 10, 10)
    """

    def transform_checked(self, images: Array) -> Array:
        """Return images of shape (n_touches, n_rows, n_cols)."""
        return grey(images)


def grey(images: Array) -> Array:
    """Return the mean over channels (n_touches, n_rows, n_cols), of any images."""
    if images.ndim == 3:
        return images
    mean: Floats = images.mean(axis=3, dtype=np.result_type(images.dtype, np.float32))
    return mean
