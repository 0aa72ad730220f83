"""Geometry of a binary image: how large the shape is, how far its edge wanders.

Both features stay the same when the shape is moved or turned by quarter turns;
neither is normalised for size.
"""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_erosion, binary_fill_holes
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import check_images, check_option

# Up, down, left and right within an image; never from one image to the next.
_CROSS = np.array([[[0, 1, 0], [1, 1, 1], [0, 1, 0]]], dtype=bool)
_FLOOD = np.concatenate([np.zeros_like(_CROSS), _CROSS, np.zeros_like(_CROSS)])


class ShapeGeometry(TransformerMixin, BaseEstimator):
    """Encode binary images by area and by the variance of the edge's distance.

    Parameters
    ----------
    edges : {"all", "outer"}, default="all"
        Which edge points count: those of holes too, as in the paper, or the outer
        edge alone.

    Attributes
    ----------
    image_shape_ : tuple of int
        (n_rows, n_cols) of the images seen by `fit`.

    Notes
    -----
    An edge point is a foreground pixel with background, or the end of the image,
    above, below, left or right of it. Distances are taken to the centroid of all
    foreground pixels, and their variance (in squared pixels) divides by the number
    of edge points. An empty image has area 0 and variance 0.

    References
    ----------
    .. [1] Y.-H. Liu et al., "Low-resolution tactile image recognition for automated
       robotic assembly using kernel PCA-based feature fusion and multiple kernel
       learning-based support vector machine", Math. Probl. Eng., 2014.
       doi:10.1155/2014/497275

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import ShapeGeometry
    >>> ShapeGeometry().fit_transform(np.ones((1, 2, 2)))
    array([[4., 0.]])
    """

    def __init__(self, edges: str = "all") -> None:
        self.edges = edges

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Note the size of the images; `y` is ignored."""
        images = check_images(X)
        check_option("edges", self.edges, ("all", "outer"))
        self.image_shape_ = (images.shape[1], images.shape[2])
        return self

    def transform(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return area and variance, shape (n_touches, 2); nonzero is foreground."""
        check_is_fitted(self)
        shapes = check_images(X, shape=self.image_shape_) != 0
        area = shapes.sum(axis=(1, 2))
        return np.column_stack([area, self._edge_variance(shapes)])

    def get_feature_names_out(self, input_features: object = None) -> NDArray:
        """Return "area" and "edge_variance"."""
        return np.array(["area", "edge_variance"], dtype=object)

    def _edge_variance(self, shapes: NDArray[np.bool_]) -> NDArray[np.float64]:
        solid = shapes if self.edges == "all" else binary_fill_holes(shapes, _FLOOD)
        edge = solid & ~binary_erosion(solid, _CROSS)
        row, col = np.indices(self.image_shape_)
        distance = np.hypot(
            row - _mean(row, shapes)[:, None, None],
            col - _mean(col, shapes)[:, None, None],
        )
        spread = distance - _mean(distance, edge)[:, None, None]
        return _mean(spread**2, edge)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags


def _mean(values: NDArray, inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Mean of `values` over the True pixels of each image, 0 where there is none."""
    count = np.maximum(inside.sum(axis=(1, 2)), 1)
    return np.where(inside, values, 0.0).sum(axis=(1, 2)) / count
