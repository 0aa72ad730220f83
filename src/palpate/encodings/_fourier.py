"""Fourier descriptors: the outline of a shape as weights of waves along it.

The outline is the outer boundary of the largest 8-connected component, walked
pixel by pixel. The descriptors do not change when the shape is moved, turned or
mirrored, nor with where the walk begins.
"""

from typing import Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_images


class FourierDescriptors(TransformerMixin, BaseEstimator):
    """Encode binary images by the Fourier descriptors of their outline.

    Parameters
    ----------
    n : int, default=40
        Number of descriptors, s[1] to s[n]. s[1] is 1 for every shape.
    resample : int, optional
        Number of points, equally spaced along the outline, that take the place of
        the boundary pixels. By default the pixels themselves are used, as in the
        paper.

    Attributes
    ----------
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.

    Notes
    -----
    With boundary points (x[m], y[m]), m = 1..L, and their Fourier coefficients a[n]
    and b[n], s[n] = r[n] / r[1] where r[n]^2 = |a[n]|^2 + |b[n]|^2. n = L is the
    constant term and does not enter: s[n] is 0 for n >= L. On small images L is
    often below 40, and then the number of zeros tells the length of the outline;
    `resample` gives descriptors that are free of scale. As s[n] = s[L - n], half of
    the values repeat.

    An image that is empty, or whose largest component has fewer than three boundary
    points (one pixel or two), is encoded by zeros. Of components of equal size the
    one that comes first, row by row, counts; holes do not.

    References
    ----------
    .. [1] Y.-H. Liu et al., "Low-resolution tactile image recognition for automated
       robotic assembly using kernel PCA-based feature fusion and multiple kernel
       learning-based support vector machine", Math. Probl. Eng., 2014.
       doi:10.1155/2014/497275

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import FourierDescriptors
    >>> square = np.pad(np.ones((1, 3, 3)), [(0, 0), (1, 1), (1, 1)])
    >>> FourierDescriptors(n=9).fit_transform(square).round(2)
    array([[1.  , 0.  , 0.17, 0.  , 0.17, 0.  , 1.  , 0.  , 0.  ]])
    """

    def __init__(self, n: int = 40, resample: int | None = None) -> None:
        self.n = n
        self.resample = resample

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Check the parameters and note the size of the images; `y` is ignored."""
        images = check_images(X)
        check_count("n", self.n)
        if self.resample is not None:
            check_count("resample", self.resample, at_least=3)
        self.image_shape_ = (images.shape[1], images.shape[2])
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the descriptors, shape (n_touches, n); nonzero is foreground."""
        check_is_fitted(self)
        shapes = check_images(X, shape=self.image_shape_) != 0
        descriptors = np.zeros((len(shapes), self.n))
        for row, shape in zip(descriptors, shapes, strict=True):
            outline = outer_boundary(shape)
            if self.resample is not None and len(outline) > 2:
                outline = _resample(outline, self.resample)
            found = _descriptors(outline)[: self.n]
            row[: len(found)] = found
        return descriptors

    def get_feature_names_out(self, input_features: object = None) -> NDArray:
        """Return "fourier1" to "fourier<n>"."""
        return np.array([f"fourier{i + 1}" for i in range(self.n)], dtype=object)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags


def outer_boundary(shape: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the outer boundary of the largest component, as a closed walk.

    Parameters
    ----------
    shape : ndarray of bool of shape (n_rows, n_cols)

    Returns
    -------
    boundary : ndarray of shape (n_points, 2)
        (column, row) of each point, neighbours being 8-connected; a part that is
        one pixel thin is walked there and back. Empty for an empty image.
    """
    pixels = shape.astype(np.uint8)
    n_labels, labels, stats, _ = cv2.connectedComponentsWithStats(
        pixels, connectivity=8
    )
    if n_labels == 1:
        return np.empty((0, 2))
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    mask = (labels == largest).astype(np.uint8)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return outlines[0].reshape(-1, 2).astype(np.float64)


def _resample(outline: NDArray[np.float64], n_points: int) -> NDArray[np.float64]:
    """Points equally spaced along the closed polygon `outline`."""
    closed = np.vstack([outline, outline[:1]])
    steps = np.hypot(*np.diff(closed, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.arange(n_points) * (along[-1] / n_points)
    return np.column_stack([np.interp(wanted, along, side) for side in closed.T])


def _descriptors(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """s[1] to s[L - 1] of an outline of L points; empty for a line or a dot."""
    if len(outline) < 3:
        return np.empty(0)
    size = np.linalg.norm(np.fft.fft(outline, axis=0), axis=1)[1:]
    # An outline whose first wave vanishes has no size to divide by.
    return size / size[0] if size[0] > 1e-9 * size.max() else np.zeros_like(size)
