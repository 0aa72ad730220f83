"""Features of a binary image: size, how far the edge wanders, and its outline as waves.

They are those of Liu et al. 2014 (doi:10.1155/2014/497275). None changes when the shape
is moved, turned by quarter turns or mirrored, nor do Fourier descriptors with where the
walk along the outline begins. Nonzero is foreground.
"""

import cv2
import numpy as np
from scipy.ndimage import binary_erosion, binary_fill_holes

from .._checks import check_count, check_option
from .._image_estimator import ImageEstimator
from .._types import Array, Bools, Floats

# Up, down, left and right within an image; never from one image to the next.
_CROSS = np.array([[[0, 1, 0], [1, 1, 1], [0, 1, 0]]], dtype=bool)
_FLOOD = np.concatenate([np.zeros_like(_CROSS), _CROSS, np.zeros_like(_CROSS)])


class ShapeGeometry(ImageEstimator):
    """Encode binary images by area and by the variance of the edge's distance.

    Parameters
    ----------
    edges : {"all", "outer"}, default="all"
        Which edge points count: those of holes too, as in the paper, or the outer
        edge alone.

    Notes
    -----
    An edge point is a foreground pixel with background, or the end of the image,
    above, below, left or right of it. Distances are taken to the centroid of all
    foreground pixels, and their variance (in squared pixels) divides by the number
    of edge points. An empty image has area 0 and variance 0.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import ShapeGeometry
    >>> ShapeGeometry().fit_transform(np.ones((1, 2, 2)))
    array([[4., 0.]])
    """

    blind_to = frozenset({"shifts", "turns", "gain"})

    def __init__(self, edges: str = "all") -> None:
        self.edges = edges

    def _learn(self, images: Array) -> None:
        check_option("edges", self.edges, ("all", "outer"))

    def transform_checked(self, images: Array) -> Floats:
        """Return area and variance, shape (n_touches, 2); nonzero is foreground."""
        shapes = images != 0
        area = shapes.sum(axis=(1, 2))
        solid = shapes if self.edges == "all" else binary_fill_holes(shapes, _FLOOD)
        edge = solid & ~binary_erosion(solid, _CROSS)
        row, col = np.indices(shapes.shape[1:])
        distance = np.hypot(
            row - _mean(row, shapes)[:, None, None],
            col - _mean(col, shapes)[:, None, None],
        )
        spread = distance - _mean(distance, edge)[:, None, None]
        return np.column_stack([area, _mean(spread**2, edge)])

    def get_feature_names_out(self, input_features: object = None) -> Array:
        """Return "area" and "edge_variance"."""
        return self._columns_named(["area", "edge_variance"])


class FourierDescriptors(ImageEstimator):
    """Encode binary images by the Fourier descriptors of their outline.

    Parameters
    ----------
    n : int, default=40
        Number of descriptors, s[1] to s[n]. s[1] is 1 for every shape.
    resample : int, optional
        Number of points, equally spaced along the outline, that take the place of
        the boundary pixels. By default the pixels themselves are used, as in the
        paper.

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

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import FourierDescriptors
    >>> square = np.pad(np.ones((1, 3, 3)), [(0, 0), (1, 1), (1, 1)])
    >>> FourierDescriptors(n=9).fit_transform(square).round(2)
    array([[1.  , 0.  , 0.17, 0.  , 0.17, 0.  , 1.  , 0.  , 0.  ]])
    """

    blind_to = frozenset({"shifts", "turns", "gain"})

    def __init__(self, n: int = 40, resample: int | None = None) -> None:
        self.n = n
        self.resample = resample

    def _learn(self, images: Array) -> None:
        check_count("n", self.n)
        if self.resample is not None:
            check_count("resample", self.resample, at_least=3)

    def transform_checked(self, images: Array) -> Floats:
        """Return the descriptors, shape (n_touches, n); nonzero is foreground."""
        shapes = images != 0
        descriptors = np.zeros((len(shapes), self.n))
        for row, shape in zip(descriptors, shapes, strict=True):
            outline = self.outline(shape)
            if self.resample is not None and len(outline) > 2:
                # Points equally spaced along the closed outline.
                n_points = self.resample
                closed = np.vstack([outline, outline[:1]])
                steps = np.hypot(*np.diff(closed, axis=0).T)
                along = np.concatenate([[0.0], np.cumsum(steps)])
                wanted = np.arange(n_points) * (along[-1] / n_points)
                outline = np.column_stack(
                    [np.interp(wanted, along, side) for side in closed.T]
                )
            if len(outline) < 3:
                continue
            size = np.linalg.norm(np.fft.fft(outline, axis=0), axis=1)[1:]
            # An outline whose first wave vanishes has no size to divide by.
            if size[0] > 1e-9 * size.max():
                relative = (size / size[0])[: self.n]
                row[: len(relative)] = relative
        return descriptors

    @staticmethod
    def outline(shape: Bools) -> Floats:
        """Return the largest component's outer boundary as a closed walk, (n, 2).

        Of a binary image (n_rows, n_cols); points are (column, row).
        """
        pixels = shape.astype(np.uint8)
        n_labels, labels, stats, _ = cv2.connectedComponentsWithStats(pixels)
        if n_labels == 1:
            return np.empty((0, 2))
        area = stats[:, cv2.CC_STAT_AREA]
        area[0] = 0  # the background
        # OpenCV numbers components by blocks of pixels, not row by row.
        first_of_largest = labels[area[labels] == area.max()][0]
        mask = (labels == first_of_largest).astype(np.uint8)
        walks, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        return np.asarray(walks[0].reshape(-1, 2).astype(np.float64))

    def get_feature_names_out(self, input_features: object = None) -> Array:
        """Return "fourier1" to "fourier<n>"."""
        return self._columns_named(f"fourier{i + 1}" for i in range(self.n))


def _mean(values: Array, inside: Bools) -> Floats:
    """Mean of `values` over the True pixels of each image, 0 where there is none."""
    count = np.maximum(inside.sum(axis=(1, 2)), 1)
    return np.asarray(np.where(inside, values, 0.0).sum(axis=(1, 2)) / count)
