"""The shape of a press, apart from place and angle: moments, pads, size and outline.

Patterns of `CentroidMoments` are Gauss-Laguerre functions, waves around the centroid
under a Gaussian window whose width is tied to the array. They are orthonormal on the
plane; turning a press only turns the phase of its complex moments, so their magnitudes
stay.

`ShapeGeometry` and `FourierDescriptors` of binary images are those of Liu et al. 2014
(doi:10.1155/2014/497275). None changes when the shape is moved, turned by quarter turns
or mirrored, nor do Fourier descriptors with where the walk along the outline begins.
Nonzero is foreground.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from math import comb, factorial, sqrt

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import binary_erosion, binary_fill_holes
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_option, check_positive
from .._image_estimator import ImageEstimator, central_moments, inscribed_mask
from .._types import Array, Bools, Complexes, Floats, Indices

# Powers of the coordinates lose all digits to cancellation beyond this order.
_HIGHEST_ORDER = 20
N_MOMENTS = 7
# The powers of a gain by which Hu's moments grow less, and gains that do no harm.
_DEGREE = np.array([1.0, 2, 3, 3, 6, 4, 6])
_USUAL = 1e-9, 1e9
# Sizes at which the logarithm starts: below lies rounding error.
_SMALLEST = 1e-12
# Taxels above these shares of the touch's largest level, and of the pad's, are counted.
_OF_TOUCH = 0.05
_OF_PAD = (0.25, 0.5)
# Load, centroid and spreads stand first: pads differ in these.
_COMPARED = 5
# Up, down, left and right within an image; never from one image to the next.
_CROSS = np.array([[[0, 1, 0], [1, 1, 1], [0, 1, 0]]], dtype=bool)
_FLOOD = np.concatenate([np.zeros_like(_CROSS), _CROSS, np.zeros_like(_CROSS)])


class CentroidMoments(ImageEstimator):
    """Encode presses by moments that do not depend on place, angle and gain.

    Parameters
    ----------
    order : int, default=8
        Highest order of the patterns, at most 20; order 8 has 25 moments.
    width : float, default=0.35
        Standard deviation of the Gaussian window, as a share of half the shorter
        side of the image. Smaller looks nearer to the centroid.
    normalise : {"energy", "total", None}, default="energy"
        What each press is divided by: the root of the sum of its squared levels,
        the sum of their sizes, or nothing (then gain, and force, count).
    centre_power : float, default=2.0
        The centroid weighs taxels by this power of their level. 1 is the centre of
        pressure; 2 is moved less by a faint background over part of the array.

    Attributes
    ----------
    degrees_ : ndarray of int of shape (n_moments, 2)
        Order n and number of waves m around the centroid of each moment.
    patterns_ : ndarray of complex of shape (n_moments, order + 1, order + 1)
        Weight of x^i y^j in each pattern, coordinates in window widths.

    Notes
    -----
    With u = (x + iy) / s about the centroid, s the window's width in taxels, the
    pattern of order n with m waves is exp(-|u|^2 / 2) u^m L_k(|u|^2), where k =
    (n - m) / 2 and L_k is the generalised Laguerre polynomial of index m,
    normalised on the plane. The encoding is the magnitude of each moment; moments
    without waves (m = 0) keep their sign. An image of zeros is encoded by zeros.

    References
    ----------
    .. [1] R. Massey and A. Refregier, "Polar shapelets", Mon. Not. R. Astron. Soc.
       363(1), 2005. doi:10.1111/j.1365-2966.2005.09453.x

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import CentroidMoments
    >>> CentroidMoments(order=2).fit_transform(np.eye(10)[np.newaxis]).shape
    (1, 4)
    """

    def __init__(
        self,
        order: int = 8,
        *,
        width: float = 0.35,
        normalise: str | None = "energy",
        centre_power: float = 2.0,
    ) -> None:
        self.order, self.width = order, width
        self.normalise, self.centre_power = normalise, centre_power

    @property
    def blind_to(self) -> frozenset[str]:
        """Shifts and turns, and gain where presses are normalised."""
        both = frozenset({"shifts", "turns"})
        return both if self.normalise is None else both | {"gain"}

    def _learn(self, images: Array) -> None:
        check_count("order", self.order, at_least=0, at_most=_HIGHEST_ORDER)
        order = int(self.order)
        check_positive("width", self.width)
        check_option("normalise", self.normalise, ("energy", "total", None))
        check_positive("centre_power", self.centre_power)
        degrees = [(n, m) for n in range(order + 1) for m in range(n % 2, n + 1, 2)]
        self.degrees_ = np.array(degrees)
        self.patterns_ = np.stack([_pattern(n, m, order) for n, m in degrees])

    def transform_checked(self, images: Array) -> Floats:
        """Return the invariant moments, shape (n_touches, n_moments)."""
        images = images.astype(np.float64, copy=False)
        scale = self.width * min(images.shape[1:]) / 2
        levels = images / size_of(images, self.normalise)[:, None, None]
        # Each image's centroid; the middle of an empty image.
        top = np.abs(levels).max(axis=(1, 2), keepdims=True)
        weight = np.abs(levels / np.where(top > 0, top, 1.0)) ** self.centre_power
        weight[top[:, 0, 0] == 0] = 1.0
        total = weight.sum(axis=(1, 2))
        row = weight.sum(axis=2) @ np.arange(images.shape[1]) / total
        col = weight.sum(axis=1) @ np.arange(images.shape[2]) / total
        power = np.arange(self.patterns_.shape[1])
        down = _windowed_powers(images.shape[1], row, scale, power)
        across = _windowed_powers(images.shape[2], col, scale, power)
        products = across @ levels.transpose(0, 2, 1) @ down.transpose(0, 2, 1)
        flat = products.reshape(len(images), -1) / scale
        # Conjugated, as moments are integrals against the pattern's conjugate.
        moments: Complexes
        moments = flat @ self.patterns_.conj().reshape(len(self.patterns_), -1).T
        waves = self.degrees_[:, 1] > 0
        return np.where(waves, np.abs(moments), moments.real)

    def get_feature_names_out(self, input_features: object = None) -> Array:
        """Return "moment<n>,<m>" for each moment."""
        check_is_fitted(self)
        return self._columns_named(f"moment{n},{m}" for n, m in self.degrees_)


def size_of(images: Floats, normalise: str | None) -> Floats:
    """Return the divisor of each image, 1 where that would be 0."""
    if normalise is None:
        return np.ones(len(images))
    # By the largest level first, so that no square over- or underflows.
    top = np.abs(images).max(axis=(1, 2))
    top = np.where(top > 0, top, 1.0)
    relative = np.abs(images / top[:, None, None])
    if normalise == "total":
        size = relative.sum(axis=(1, 2))
    else:
        size = np.sqrt((relative**2).sum(axis=(1, 2)))
    return top * np.where(size > 0, size, 1.0)


def _windowed_powers(n: int, centre: Floats, scale: float, power: Indices) -> Floats:
    """exp(-x^2 / 2) x^power along one side, (n_touches, n_powers, n)."""
    x = (np.arange(n) - centre[:, None]) / scale
    return np.exp(-(x**2) / 2)[:, None] * x[:, None] ** power[:, None]


def _pattern(n: int, m: int, order: int) -> Complexes:
    """Weights of x^i y^j in the normalised u^m L_k(|u|^2) of order n."""
    k = (n - m) // 2
    weights = np.zeros((order + 1, order + 1), dtype=complex)
    norm = sqrt(factorial(k) / (np.pi * factorial(k + m)))
    for j in range(k + 1):
        laguerre = (-1) ** j * comb(k + m, k - j) / factorial(j)
        for a in range(j + 1):
            for b in range(m + 1):
                i_x, i_y = 2 * a + m - b, 2 * (j - a) + b
                weights[i_x, i_y] += laguerre * comb(j, a) * comb(m, b) * 1j**b
    weights *= norm
    return weights


class HuMoments(ImageEstimator):
    """Encode tactile images by Hu's moment invariants.

    Parameters
    ----------
    n_components : int, default=7
        How many of the seven to keep, from the first.
    region : {"disc", "frame"}, default="disc"
        Whether only the inscribed disc is looked at. In a square frame the corners
        turn with the image, and nothing is invariant.
    levels : {"above-least", "raw"}, default="above-least"
        "above-least" counts levels from the least one in the region and divides
        them by their mean, so that brightness and contrast do not matter and
        standardised images have moments at all. "raw" takes levels as they are.
    log : bool, default=False
        Replace h by sign(h) log10(1 + |h| / 1e-12): the seven differ by many orders
        of magnitude.

    Notes
    -----
    From normalised central moments eta[p, q] = mu[p, q] / mu[0, 0]^(1 + (p + q) / 2).
    The seventh changes its sign in a mirror; of the two signs in use, ours is
    OpenCV's. A blank image, or raw levels without a positive sum, gives zeros.

    References
    ----------
    .. [1] M.-K. Hu, "Visual pattern recognition by moment invariants", IRE Trans.
       Inf. Theory 8(2), 1962. doi:10.1109/TIT.1962.1057692

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import HuMoments
    >>> image = np.zeros((1, 20, 20))
    >>> image[0, 13:17, 13:17], image[0, 10:12, 10:12] = 0.5, 1
    >>> HuMoments(2, levels="raw").fit_transform(image).round(6)
    array([[0.74537 , 0.351166]])
    """

    def __init__(
        self,
        n_components: int = N_MOMENTS,
        *,
        region: str = "disc",
        levels: str = "above-least",
        log: bool = False,
    ) -> None:
        self.n_components = n_components
        self.region, self.levels = region, levels
        self.log = log

    @property
    def blind_to(self) -> frozenset[str]:
        """Shifts; turns on the disc; gain where levels are divided by their mean."""
        turns = {"turns"} if self.region == "disc" else set()
        gain = {"gain"} if self.levels == "above-least" else set()
        return frozenset({"shifts"} | turns | gain)

    def _learn(self, images: Array) -> None:
        check_count("n_components", self.n_components, at_most=N_MOMENTS)
        check_option("region", self.region, ("disc", "frame"))
        check_option("levels", self.levels, ("above-least", "raw"))

    def transform_checked(self, images: Array) -> Floats:
        """Return the moments, shape (n_touches, n_components)."""
        kind = images.dtype if images.dtype in (np.uint8, np.float32) else np.float64
        rows, cols, inside = _looked_at(*images.shape[1:], self.region == "disc")
        planes = images[:, rows, cols].astype(kind, copy=False)
        relative = self.levels == "above-least"
        each = [_hu(np.ascontiguousarray(plane), inside, relative) for plane in planes]
        invariants = np.stack(each)[:, : self.n_components]
        if not self.log:
            return invariants
        return np.sign(invariants) * np.log10(1 + np.abs(invariants) / _SMALLEST)

    def get_feature_names_out(self, input_features: object = None) -> Array:
        """Return "hu1" to "hu7"."""
        return self._columns_named(f"hu{i + 1}" for i in range(self.n_components))


@lru_cache(maxsize=16)
def _looked_at(n_rows: int, n_cols: int, disc: bool) -> tuple[slice, slice, Array]:
    """Rows, columns and, of these, what counts (uint8)."""
    if not disc:
        return slice(None), slice(None), np.ones((n_rows, n_cols), np.uint8)
    mask = inscribed_mask(n_rows, n_cols)
    row, col = (int(mask.any(axis=axis).argmax()) for axis in (1, 0))
    rows, cols = slice(row, n_rows - row), slice(col, n_cols - col)
    return rows, cols, np.ascontiguousarray(mask[rows, cols].view(np.uint8))


def _hu(levels: Array, inside: Array, relative: bool) -> Floats:
    """Return the seven invariants of one image, zeros where there is no mass."""
    least, largest, *_ = cv2.minMaxLoc(levels, inside)
    size = max(abs(least), abs(largest))
    if relative:
        levels = levels - levels.dtype.type(least)
        largest -= least
    unit = 1.0
    if not _USUAL[0] < largest < _USUAL[1]:
        # OpenCV takes a very small mass for none.
        unit = largest if largest > 0 else 1.0
        levels = levels / unit
    moments = cv2.moments(cv2.copyTo(levels, inside))
    mass = moments["m00"]
    mean = mass / cv2.countNonZero(inside)
    if mass <= 0 or (relative and unit * mean <= 1e-9 * size):
        return np.zeros(N_MOMENTS)
    # What each changes by when levels are multiplied is a power of that.
    gain = mean if relative else 1 / unit
    return np.asarray(cv2.HuMoments(moments).ravel() * gain**_DEGREE)


class PadShapes(ImageEstimator):
    """Encode touches by shape numbers of each pad, and by how pads differ.

    Parameters
    ----------
    pads : array-like of int of shape (n_pads, 4), optional
        First row, first column, rows and columns of each pad in the image. By default
        the whole image is one pad.

    Attributes
    ----------
    pads_ : ndarray of int of shape (n_pads, 4)
        The pads.

    Notes
    -----
    Of each pad 17 numbers: load, centroid (row, column), spreads, areas above 5 % of
    the touch's largest level and above 25 and 50 % of the pad's own, largest and mean
    level, covariance, spreads along and across the long axis, four third moments. Then
    each pad's share of the whole load and, for each pair of pads, the differences of
    load, centroid and spreads. Loads and levels are roots; lengths count in halves of
    the pad's longer side; moments and covariance are of the pad's own load, as signed
    roots where they are squares. Levels count by their size, NaN as 0; a pad without
    load has zeros. It is blind to nothing, but sees no more than shape.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import PadShapes
    >>> hand = np.ones((2, 4, 9))
    >>> PadShapes().fit_transform(hand).shape
    (2, 17)
    >>> PadShapes([[0, 0, 4, 4], [0, 5, 4, 4]]).fit_transform(hand).shape
    (2, 41)
    """

    _takes = "nan"

    def __init__(self, pads: ArrayLike | None = None) -> None:
        self.pads = pads

    def _learn(self, images: Array) -> None:
        self.pads_ = boxes_of(self.pads, images.shape[1:3])

    def transform_checked(self, images: Array) -> Floats:
        """Return the numbers, shape (n_touches, n_features)."""
        levels = np.abs(np.nan_to_num(images.astype(np.float64, copy=False)))
        boxes = [cut_out(levels, box) for box in self.pads_]
        top = np.max([box.max(axis=(1, 2)) for box in boxes], axis=0)
        pads = np.stack([_numbers(box, top) for box in boxes])
        if len(pads) == 1:
            return np.asarray(pads[0])
        load = pads[:, :, 0] ** 2
        share = load / np.where(top > 0, load.sum(axis=0), 1)
        differences = [a - b for a, b in combinations(pads[:, :, :_COMPARED], 2)]
        return np.hstack([*pads, share.T, *differences])


def boxes_of(pads: ArrayLike | None, shape: tuple[int, ...]) -> Indices:
    """Return pads as boxes (n_pads, 4) within `shape`; the whole of it if None."""
    boxes = np.asarray([[0, 0, *shape]] if pads is None else pads)
    if boxes.ndim != 2 or boxes.shape[1] != 4 or boxes.dtype.kind not in "iu":
        raise ValueError(
            "pads must be integers of shape (n_pads, 4): first row, first column, "
            f"rows and columns of each, got {boxes.dtype} of shape {boxes.shape}."
        )
    boxes = boxes.astype(np.intp)  # sums of small integers would go round
    start, size = boxes[:, :2], boxes[:, 2:]
    out = (start < 0) | (size < 1) | (start + size > np.array(shape))
    if out.any() or not len(boxes):
        bad = boxes[out.any(axis=1)].tolist()
        raise ValueError(
            f"pads must be boxes within the {shape[0]} x {shape[1]} taxels, got "
            f"{bad[0] if bad else 'none'}. Each is first row and column, rows, "
            "columns."
        )
    return boxes


def cut_out(images: Array, box: Indices) -> Array:
    """Return what images show in a box: first row, first column, rows, columns."""
    row, col, n_rows, n_cols = box
    return images[:, row : row + n_rows, col : col + n_cols]


def _numbers(box: Floats, top: Floats) -> Floats:
    """Numbers of one pad, (n_touches, 17); `top` is each touch's largest level."""
    largest = box.max(axis=(1, 2))
    relative = box / np.where(largest > 0, largest, 1.0)[:, None, None]
    moments = central_moments(relative)
    half = max(box.shape[1:]) / 2
    # Spreads, covariance, axes (all as lengths), and third moments, per load.
    mass = np.where(moments.mass > 0, moments.mass, 1.0)[:, None, None]
    mu = moments.mu / mass
    down, across, mixed = (mu[:, q, p] / half**2 for q, p in [(2, 0), (0, 2), (1, 1)])
    middle, gap = (down + across) / 2, np.hypot((down - across) / 2, mixed)
    squares = [down, across, middle + gap, middle - gap]
    lengths = np.sqrt(np.maximum(squares, 0))
    covariance = np.sign(mixed) * np.sqrt(np.abs(mixed))
    third = [mu[:, q, 3 - q] / half**3 for q in range(4)]
    area = [
        ((box > share * of[:, None, None]).mean(axis=(1, 2)))
        for share, of in [(_OF_TOUCH, top), *((share, largest) for share in _OF_PAD)]
    ]
    mean = largest * moments.mass / np.maximum((relative > 0).sum(axis=(1, 2)), 1)
    root = np.sqrt([largest * moments.mass, largest, mean])
    centroid = [moments.y / half, moments.x / half]
    second = [covariance, *lengths[2:]]
    return np.stack(
        [root[0], *centroid, *lengths[:2], *area, *root[1:], *second, *third], axis=1
    )


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
