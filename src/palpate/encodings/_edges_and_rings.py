"""Encoders that bring every image to about the same number of pixels first.

`EdgeHistograms` counts directions of edges cell by cell. `RingPatterns` and
`RingQuantiles` say what is found in rings about the disc's centre, wherever along a
ring it is: turning an image moves what is seen along its ring, so that counts and
quantiles of a ring stay as they are.
"""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from .._checks import check_count, check_number
from .._image_estimator import ImageEstimator
from .._numbers import evenly_spaced
from .._types import Array, Floats, Indices

_CLIP = 0.2  # as SIFT does, doi:10.1023/B:VISI.0000029664.99615.94
# Below this share of the strongest cell, a block is not brought to length 1.
_FAINT = 1e-3
# The canvas' shorter side has 32 pixels at least: each ring has some.
_MOST_RINGS = 16
_CANVAS = 101
# So many training images are moved by these fractions of a pixel (rows, columns).
_MOVED = 150
_STEPS = ((0.35, 0.15), (-0.2, 0.45))


class CanvasEncoder(ImageEstimator):
    """An encoder of images whose shorter side has from 32 to `_most` pixels.

    Smaller images are enlarged bilinearly, larger ones reduced by area means; rows and
    columns become multiples of `_multiple`. A subclass encodes one such image, in
    single precision, by `_vector`.
    """

    _most, _multiple = 64, 1
    _takes = "bounded"

    def transform_checked(self, images: Array) -> Floats:
        """Return the features, shape (n_touches, n_features)."""
        shape = images.shape[1:]
        short = min(shape)
        scale = min(max(short, 32), self._most) / short / self._multiple
        rows = self._multiple * round(shape[0] * scale)
        cols = self._multiple * round(shape[1] * scale)
        smaller = rows <= shape[0] and cols <= shape[1]
        how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        vectors = []
        for image in images.astype(np.float32, copy=False):
            resized = cv2.resize(image, (cols, rows), interpolation=how)
            vectors.append(self._vector(resized))
        return np.stack(vectors).astype(np.float64, copy=False)

    def _vector(self, image: Array) -> Array:
        raise NotImplementedError


class EdgeHistograms(CanvasEncoder):
    """Encode images by histograms of the directions of their gradients, cell by cell.

    Parameters
    ----------
    n_orientations : int, default=9
        Directions from 0 to 180 degrees: dark to bright and bright to dark are one.
    cell : int, default=8
        Pixels along each side of a cell, of an image whose shorter side has 32 to 64
        pixels: smaller ones are enlarged, larger ones reduced.

    Notes
    -----
    Each pixel votes by the length of its gradient for the two nearest directions.
    Blocks of 2 x 2 cells, which overlap, are divided by their length, cut at 0.2 and
    divided by their length again [1]_. It is blind to gain, not to turns and shifts.

    References
    ----------
    .. [1] N. Dalal, B. Triggs, "Histograms of oriented gradients for human detection",
       CVPR 2005. doi:10.1109/CVPR.2005.177

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import EdgeHistograms
    >>> EdgeHistograms().fit_transform(np.ones((2, 64, 32))).shape
    (2, 756)
    """

    blind_to = frozenset({"gain"})

    def __init__(self, n_orientations: int = 9, cell: int = 8) -> None:
        self.n_orientations, self.cell = n_orientations, cell

    @property
    def _multiple(self) -> int:  # type: ignore[override]
        return self.cell

    def _learn(self, images: Array) -> None:
        check_count("n_orientations", self.n_orientations)
        check_count("cell", self.cell, at_most=16)

    def _vector(self, image: Array) -> Array:
        across, down = np.zeros_like(image), np.zeros_like(image)
        across[:, 1:-1] = image[:, 2:] - image[:, :-2]
        down[1:-1] = image[2:] - image[:-2]
        length, angle = lengths(across, down), cv2.phase(across, down)
        # Votes, (n_cell_rows, n_cell_cols, n_orientations).
        n, cell = self.n_orientations, self.cell
        rows, cols = length.shape[0] // cell, length.shape[1] // cell
        place = angle * (n / np.pi) - 0.5
        lower = np.floor(place)
        share = (place - lower) * length
        row, col = np.arange(rows * cell) // cell, np.arange(cols * cell) // cell
        start = n * (row[:, np.newaxis] * cols + col)
        lower = lower.astype(np.intp)
        votes = np.bincount(
            np.concatenate([start + lower % n, start + (lower + 1) % n], axis=None),
            np.concatenate([length - share, share], axis=None),
            minlength=n * rows * cols,
        )
        histograms = votes.reshape(rows, cols, n).astype(np.float64, copy=False)
        return _blocks(histograms).ravel()


def _blocks(histograms: Floats) -> Floats:
    """Histograms of 2 x 2 cells side by side, of limited length."""
    h = histograms
    blocks = np.concatenate([h[:-1, :-1], h[:-1, 1:], h[1:, :-1], h[1:, 1:]], axis=2)
    faint = _FAINT * (np.abs(blocks).max() or 1.0)
    for most in (_CLIP, 1.0):
        blocks = blocks / np.sqrt((blocks**2).sum(axis=2, keepdims=True) + faint**2)
        blocks, faint = np.minimum(blocks, most), 1e-5
    return blocks


class RingPatterns(CanvasEncoder):
    """Encode images by how often which local pattern occurs in each ring.

    Parameters
    ----------
    n_rings : int, default=4
        Rings of equal width in the inscribed disc, at most 16.
    radii : sequence of float, default=(2, 5, 9)
        How far from a pixel its surroundings are looked at, in hundredths of the
        shorter side (at least one pixel); at most 25.
    n_points : int, default=16
        Places around a pixel, from 4 to 32.
    contrast : float, default=0.06
        A place counts as lower than the pixel if it is so by more than this share of
        the standard deviation of the disc's levels; what is less is noise.
    n_unsteady : int, default=5
        So many directions of the vector are taken out of it in which it changes most
        when training images move by a fraction of a pixel. Fine patterns tell much, but
        moving an image also smooths it.

    Attributes
    ----------
    unsteady_ : ndarray of shape (n_directions, n_features)
        Those directions, orthonormal.

    Notes
    -----
    Uniform local binary patterns [1]_: the places at least as high as the pixel are
    counted where they follow each other without a gap (0 to `n_points`); all other
    patterns count as one. The features are roots of the shares of these `n_points` + 2
    patterns, radius by radius, ring by ring. It is blind to turns and to gain, and
    nearly to slow changes of level. Images larger than 101 pixels across are reduced.

    References
    ----------
    .. [1] T. Ojala, M. Pietikainen, T. Maenpaa, "Multiresolution gray-scale and
       rotation invariant texture classification with local binary patterns", IEEE
       Trans. Pattern Anal. Mach. Intell. 24(7), 2002. doi:10.1109/TPAMI.2002.1017623

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import RingPatterns
    >>> RingPatterns().fit_transform(np.ones((2, 40, 40))).shape
    (2, 216)
    """

    blind_to = frozenset({"turns", "gain"})
    _most = _CANVAS

    def __init__(
        self,
        n_rings: int = 4,
        radii: tuple[float, ...] = (2, 5, 9),
        n_points: int = 16,
        contrast: float = 0.06,
        n_unsteady: int = 5,
    ) -> None:
        self.n_rings, self.radii, self.n_points = n_rings, radii, n_points
        self.contrast, self.n_unsteady = contrast, n_unsteady

    def _learn(self, images: Array) -> Floats:
        check_count("n_rings", self.n_rings, at_most=_MOST_RINGS)
        check_count("n_points", self.n_points, at_least=4, at_most=32)
        radii = np.atleast_1d(self.radii).tolist()
        if not radii:
            raise ValueError("radii must hold at least one radius, got none.")
        for radius in radii:
            check_number("radii", radius, low=0, high=25)
        check_number("contrast", self.contrast, low=0)
        n_unsteady = check_count("n_unsteady", self.n_unsteady, at_least=0)
        shares = super().transform_checked(images)
        rows = evenly_spaced(len(images), _MOVED)
        part, still = images[rows].astype(np.float32), shares[rows]
        moved = np.concatenate([_moved(part, *step) for step in _STEPS])
        changes = super().transform_checked(moved) - np.tile(still, (len(_STEPS), 1))
        # Flat images change nowhere; their directions would be chance.
        strong = np.linalg.svd(changes, full_matrices=False)[2] * changes.any()
        self.unsteady_ = strong[:n_unsteady]
        return self._steady(shares)

    def transform_checked(self, images: Array) -> Floats:
        """Return the features, shape (n_touches, n_features)."""
        return self._steady(super().transform_checked(images))

    def _steady(self, shares: Floats) -> Floats:
        return np.asarray(shares - shares @ self.unsteady_.T @ self.unsteady_)

    def _vector(self, image: Array) -> Array:
        """Roots of the shares of each pattern in each ring, (n_features,)."""
        # A flat disc has rounding alone, which is not to make patterns.
        image = image / (cv2.norm(image, cv2.NORM_INF) or 1)
        n_codes = self.n_points + 2
        inside, ring = _rings(image.shape, self.n_rings)
        first = n_codes * ring
        spread = cv2.meanStdDev(image.take(inside))[1].item()
        least = image - np.float32(max(self.contrast * spread, 1e-5))
        unit = min(image.shape) / _CANVAS
        radii = np.atleast_1d(self.radii).tolist()
        counts = np.empty((len(radii), self.n_rings, n_codes))
        for histogram, radius in zip(counts, radii, strict=True):
            code = _patterns(image, least, max(radius * unit, 1.0), self.n_points)
            binned = np.bincount(first + code.take(inside), minlength=histogram.size)
            histogram[:] = binned.reshape(histogram.shape)
        shares: Floats = counts / counts.sum(axis=2, keepdims=True)
        return np.sqrt(shares).ravel()


class RingQuantiles(CanvasEncoder):
    """Encode images by quantiles of level and of gradient in each ring.

    Parameters
    ----------
    n_rings : int, default=8
        Rings of equal width in the inscribed disc, at most 16.
    n_quantiles : int, default=9
        Quantiles (k + 1/2) / n_quantiles, of the levels and of the gradients' lengths.

    Notes
    -----
    It is blind to turns, not to gain and shifts. Gradients are in levels per pixel of
    an image that was enlarged to 32 pixels across or reduced to 101.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.encodings import RingQuantiles
    >>> RingQuantiles(2, 1).fit_transform(np.full((1, 40, 40), 3.0))
    array([[3., 3., 0., 0.]])
    """

    blind_to = frozenset({"turns"})
    _most = _CANVAS

    def __init__(self, n_rings: int = 8, n_quantiles: int = 9) -> None:
        self.n_rings, self.n_quantiles = n_rings, n_quantiles

    def _learn(self, images: Array) -> None:
        check_count("n_rings", self.n_rings, at_most=_MOST_RINGS)
        check_count("n_quantiles", self.n_quantiles)

    def _vector(self, image: Array) -> Array:
        across = cv2.Sobel(image, cv2.CV_32F, 1, 0, scale=1 / 8)
        down = cv2.Sobel(image, cv2.CV_32F, 0, 1, scale=1 / 8)
        both = np.stack([image.ravel(), lengths(across, down).ravel()])
        share = (np.arange(self.n_quantiles) + 0.5) / self.n_quantiles
        rings = []
        for places in _places(image.shape, self.n_rings):
            ordered = np.sort(both.take(places, axis=1), axis=1)
            place = share * (len(places) - 1)
            lower = place.astype(np.intp)
            upper = np.minimum(lower + 1, len(places) - 1)
            part = place - lower
            rings.append(ordered[:, lower] * (1 - part) + ordered[:, upper] * part)
        return np.stack(rings, axis=1).ravel()


def lengths(across: Array, down: Array) -> Array:
    """Return the lengths of gradients in single precision, however large or small."""
    # OpenCV's own function rounds by where an image lies in memory.
    with np.errstate(over="ignore", under="ignore"):
        distances: Array = np.sqrt(across * across + down * down)
    # Of what squares leave too large or too small, ten times slower.
    return distances if 1e-12 < distances.max() < np.inf else np.hypot(across, down)


@lru_cache(maxsize=16)
def _places(shape: tuple[int, int], n_rings: int) -> list[Indices]:
    """Return the pixels, counted row by row, in each ring of the inscribed disc."""
    row, col = (np.arange(n) - (n - 1) / 2 for n in shape)
    radius = np.hypot(row[:, np.newaxis], col) / (min(shape) / 2)
    return [np.flatnonzero(np.floor(radius * n_rings) == k) for k in range(n_rings)]


@lru_cache(maxsize=16)
def _rings(shape: tuple[int, int], n_rings: int) -> tuple[Indices, Indices]:
    """Return the pixels of the inscribed disc, ring by ring, and the ring of each."""
    places = _places(shape, n_rings)
    ring = np.repeat(np.arange(n_rings), [len(ring) for ring in places])
    return np.concatenate(places), ring


def _patterns(
    image: Array, least: Array, radius: float, n_points: int
) -> NDArray[np.uint8]:
    """The pattern of places of at least a level: 0 to `n_points`, or `n_points` + 1."""
    rows, cols = image.shape
    margin = int(np.ceil(radius)) + 1
    wide = cv2.copyMakeBorder(
        image, margin, margin, margin, margin, cv2.BORDER_REPLICATE
    )
    columns, places = _circle(radius, n_points, margin)
    blended = []
    for left, share in columns:
        here, right = wide[:, left : left + cols], wide[:, left + 1 : left + 1 + cols]
        both = cv2.addWeighted(here, 1 - share, right, share, 0) if share else here
        blended.append(both)
    high = np.empty((n_points, rows, cols), dtype=bool)
    for bits, (column, top, share) in zip(high, places, strict=True):
        here = blended[column][top : top + rows]
        below = blended[column][top + 1 : top + 1 + rows]
        both = cv2.addWeighted(here, 1 - share, below, share, 0) if share else here
        np.greater_equal(both, least, out=bits)
    bits = high.view(np.uint8)
    ones = np.add.reduce(bits, axis=0, dtype=np.uint8)
    turns = np.add.reduce(bits[1:] ^ bits[:-1], axis=0, dtype=np.uint8)
    turns += bits[0] ^ bits[-1]
    # No pattern has as many ones as stand for all that turn more than twice.
    pattern: NDArray[np.uint8] = np.maximum(ones, (turns > 2) * np.uint8(n_points + 1))
    return pattern


@lru_cache(maxsize=64)
def _circle(
    radius: float, n_points: int, margin: int
) -> tuple[list[tuple[int, float]], list[tuple[int, int, float]]]:
    """Return the pixels around places on a circle, in an image with a margin.

    Of each column between pixels the left one and the share of the right one; of each
    place which of these, the upper row and the share of the lower one.
    """
    angle = 2 * np.pi * np.arange(n_points) / n_points
    row, col = ((radius * f(angle)).round(6) for f in (np.sin, np.cos))
    columns, which = np.unique(col, return_inverse=True)
    tops, lefts = (np.floor(v).astype(int) for v in (row, columns))
    between = zip((lefts + margin).tolist(), (columns - lefts).tolist(), strict=True)
    down = zip((tops + margin).tolist(), (row - tops).tolist(), strict=True)
    return list(between), [
        (k, *weights) for k, weights in zip(which.tolist(), down, strict=True)
    ]


def _moved(images: Array, row: float, col: float) -> Array:
    """Move images by a part of a pixel, bilinearly, edges replicated."""
    size, edge = images.shape[:0:-1], cv2.BORDER_REPLICATE
    way = np.array([[1, 0, col], [0, 1, row]], np.float32)
    return np.stack([cv2.warpAffine(o, way, size, borderMode=edge) for o in images])
