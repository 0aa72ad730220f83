"""Fit one circle to the edge where a camera's view of its dome ends.

Two steps. Edge points of a reduced image vote along their gradient for the centres
of circles through them [1]_, which needs no starting point. Then the grey levels
along rays across the best circles give one edge a ray, to a fraction of a pixel, and
a circle is fitted to these edges by Tukey's biweight [2]_, so that contacts,
highlights and dirt that cross the rim count little.

Rows grow downwards and pixel centres are at whole numbers. A circle is a triple
(row, col, radius) in pixels of the image; `sign` is +1 where the surround is brighter
than the dome, -1 where it is darker.

References
----------
.. [1] C. Kimme, D. Ballard, J. Sklansky, "Finding circles by an array of
   accumulators", Commun. ACM 18(2), 1975. doi:10.1145/360666.360677
.. [2] P. W. Holland, R. E. Welsch, "Robust regression using iteratively reweighted
   least-squares", Commun. Stat. Theory Methods 6(9), 1977.
   doi:10.1080/03610927708827533
"""

from collections.abc import Iterator
from functools import lru_cache
from math import hypot
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from .._types import Array, Singles

Triple = tuple[float, float, float]

REDUCED_SIDE = 120  # pixels, for the search alone; the fit takes all
MAX_EDGE_POINTS = 500  # the steepest vote: time grows with them
N_RAYS = 192  # across the rim, one every 1.9 degrees
HALF_WIDTH = 0.1  # of the radius, that a ray reaches to either side
BIWEIGHT = 4.685  # 95 % efficient for normal noise (Tukey)
MIN_EDGES = 12  # four for each of the circle's three numbers
HOLD = 0.003  # of the radius: how far the known one may be off
TOLERANCE, SHARP = 0.012, 1.8  # of the radius off the circle; times the typical slope
_EDGE = cv2.BORDER_REPLICATE

_ANGLE = 2 * np.pi * np.arange(N_RAYS) / N_RAYS
_SIN, _COS = np.sin(_ANGLE).astype(np.float32), np.cos(_ANGLE).astype(np.float32)


class Fit(NamedTuple):
    """A fitted circle and the evidence for it.

    `support` is the share of the rays inside the frame with a sharp edge on the circle,
    `arc` the share of a full turn that these rays cover, and `balance` from 0 (edges on
    one line through the centre) to 1/2 (evenly around it).
    """

    circle: Triple
    sign: int
    support: float
    arc: float
    balance: float

    @property
    def evidence(self) -> float:
        """Score of a circle to choose by: the rim encloses all that touches it."""
        return float(self.support * self.arc**0.5 * self.circle[2])


def reduce(image: Array) -> tuple[NDArray[np.uint8], int]:
    """Average whole blocks of pixels and stretch to 0..255; also the block's side."""
    rows, cols = image.shape
    block = max(1, min(rows, cols) // REDUCED_SIDE)
    if block > 1:
        size = (cols // block, rows // block)
        whole = image[: size[1] * block, : size[0] * block]
        image = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    low, high = float(image.min()), float(image.max())
    scale = 255 / (high - low) if high > low else 0.0
    stretched = cv2.convertScaleAbs(image, alpha=scale, beta=-low * scale)
    return np.asarray(stretched, np.uint8), block


def vote(
    small: NDArray[np.uint8], radii: Singles, *, n_best: int, near: Triple | None = None
) -> Iterator[tuple[Triple, int]]:
    """Yield the likeliest (circle, sign), best first, in pixels of `small`.

    `near` is (row, col, distance): the centre is sought no further from there.
    """
    points = _edge_points(small)
    if points is None:
        return
    cell = 2.0 if len(radii) == 1 else 3.0
    votes = _accumulate(points, radii, small.shape, cell)
    if near is not None:
        down = cell * np.arange(votes.shape[0], dtype=np.float32) - near[0]
        right = cell * np.arange(votes.shape[1], dtype=np.float32) - near[1]
        close = down[:, np.newaxis] ** 2 + right**2 <= near[2] ** 2
        votes *= close[..., np.newaxis, np.newaxis]
    for _ in range(n_best):
        r, c, s, k = map(int, np.unravel_index(votes.argmax(), votes.shape))
        if votes[r, c, s, k] <= 0:
            return
        yield (r * cell, c * cell, float(radii[k])), 1 - 2 * s
        rows, cols = slice(max(0, r - 3), r + 4), slice(max(0, c - 3), c + 4)
        votes[rows, cols, :, max(0, k - 2) : k + 3] = 0


def sign_at(image: Array, circle: Triple) -> int:
    """Return +1 where the surround of `circle` is brighter than its inside, else -1."""
    maps = _layout(circle, image.shape).sides
    inner, outer = cv2.remap(image, *maps, cv2.INTER_NEAREST, borderMode=_EDGE)
    brighter = outer.astype(np.float32) - inner
    brighter.partition((N_RAYS // 2 - 1, N_RAYS // 2))
    return 1 if brighter[N_RAYS // 2 - 1] + brighter[N_RAYS // 2] > 0 else -1


def refine(
    image: Array,
    start: Triple,
    sign: int,
    radius: float | None = None,
    widths: tuple[float, ...] = (1.0, 0.4, 0.2),
) -> Fit | None:
    """Fit the circle near `start` to sub-pixel edges; None where there are too few.

    With `radius`, it is held as if known to 0.3 %, against errors all of one cause.
    Edges are sought within these `widths` in turn, as shares of how far the rays reach.
    """
    rays = _Rays(image, start, sign)
    if len(rays.sin) < MIN_EDGES:
        return None
    circle = np.array(start)
    if radius is not None:
        circle[2] = radius
    for width in widths:
        edges = rays.edges(circle, width)
        if edges.shape[1] < MIN_EDGES:
            return None
        circle = _improved(circle, edges, radius)
    return rays.judge(circle, edges)


def _edge_points(small: NDArray[np.uint8]) -> Singles | None:
    """Row, col and unit gradient of points steeper than thrice the median, or 1 %."""
    smooth = cv2.GaussianBlur(small, (5, 5), 1.0, borderType=_EDGE)
    dx, dy = cv2.spatialGradient(smooth)
    steepness = np.abs(dx[::3, ::3]) + np.abs(dy[::3, ::3])
    high = max(2.4 * float(np.median(steepness)), 0.01 * 255 * 8)
    edges = cv2.Canny(dx, dy, 0.7 * high, high, L2gradient=True)
    edges[0] = edges[-1] = edges[:, 0] = edges[:, -1] = 0
    places = np.flatnonzero(edges.view(np.bool_))
    if len(places) < MIN_EDGES:
        return None
    gradient = np.stack([dy.ravel()[places], dx.ravel()[places]]).astype(np.float32)
    size = np.sqrt((gradient * gradient).sum(axis=0))
    if len(places) > MAX_EDGE_POINTS:
        keep = np.argpartition(size, -MAX_EDGE_POINTS)[-MAX_EDGE_POINTS:]
        places, gradient, size = places[keep], gradient[:, keep], size[keep]
    row, col = np.divmod(places, small.shape[1])
    return np.stack([row, col, *(gradient / size)]).astype(np.float32)


def _accumulate(
    points: Singles, radii: Singles, shape: tuple[int, ...], cell: float
) -> Singles:
    """Count votes for (row, col, sign, radius), blurred over neighbouring cells."""
    rows, cols = int(shape[0] / cell) + 1, int(shape[1] / cell) + 1
    row, col, along_row, along_col = points
    reach = np.concatenate([radii, -radii])[:, None]
    r = np.rint((row - reach * along_row) / cell).astype(np.int32)
    c = np.rint((col - reach * along_col) / cell).astype(np.int32)
    n_kinds = len(reach)
    place = (r * cols + c) * n_kinds + np.arange(n_kinds, dtype=np.int32)[:, None]
    inside = (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
    count = np.bincount(place[inside], minlength=rows * cols * n_kinds)
    votes = count.astype(np.float32).reshape(rows, cols, n_kinds)
    smooth = np.asarray(cv2.GaussianBlur(votes, (5, 5), 1.0), np.float32)
    blurred = smooth.reshape(rows, cols, 2, len(radii))
    if len(radii) > 1:
        blurred[..., 1:-1] += 0.5 * (blurred[..., :-2] + blurred[..., 2:])
    return blurred


class _Layout(NamedTuple):
    """The pixels of rays across a circle: the same for all frames of a stream.

    `places` and `sides` are (col, row) of all points, and of two a ray, inside and
    outside the circle; `inside` says which points lie in the frame, None that all do;
    `firsts` is where each ray begins in the flattened points.
    """

    half: float
    cell: float
    offset: Singles
    sin: Array
    cos: Array
    places: tuple[Array, Array]
    sides: tuple[Array, Array]
    inside: Singles | None
    n_inside: Array
    firsts: Array


@lru_cache(maxsize=8)
def _layout(circle: Triple, shape: tuple[int, int]) -> _Layout:
    row, col, radius = circle
    half = max(HALF_WIDTH * radius, 5.0)
    cell = max(half / 22, 0.5)
    n = int(np.ceil(half / cell))
    offset = cell * np.arange(-n, n + 1, dtype=np.float32)
    reach = np.float32(radius) + offset
    y = np.float32(row) + _SIN[:, None] * reach
    x = np.float32(col) + _COS[:, None] * reach
    inside = (y >= 0) & (y <= shape[0] - 1) & (x >= 0) & (x <= shape[1] - 1)
    which = np.flatnonzero(np.count_nonzero(inside, axis=1) > len(reach) / 4)
    inside = inside[which]
    sides = radius * np.array([[1 - HALF_WIDTH / 2], [1 + HALF_WIDTH / 2]], np.float32)
    around = np.float32(col) + _COS * sides, np.float32(row) + _SIN * sides
    return _Layout(
        half,
        cell,
        offset,
        _SIN[which].astype(np.float64),
        _COS[which].astype(np.float64),
        (x[which], y[which]),
        around,
        None if inside.all() else inside.astype(np.float32),
        np.count_nonzero(inside, axis=1),
        len(offset) * np.arange(len(which)),
    )


class _Rays:
    """Slopes of the grey level along rays from the centre of a first circle."""

    def __init__(self, image: Array, start: Triple, sign: int) -> None:
        """Sample `image` on both sides of `start`, as far as it lies in the frame."""
        self.row, self.col, self.radius = start
        self.bottom, self.right = image.shape[0] - 1, image.shape[1] - 1
        self.sign = sign
        self.layout = layout = _layout(start, image.shape)
        self.half, self.cell, self.offset = layout.half, layout.cell, layout.offset
        self.sin, self.cos = layout.sin, layout.cos
        if len(self.sin):
            grey = cv2.remap(image, *layout.places, cv2.INTER_LINEAR, borderMode=_EDGE)
            kernel = sign * _slope_kernel(max(1.0, 1.2 / self.cell))
            self.slope = cv2.filter2D(grey, cv2.CV_32F, kernel, borderType=_EDGE)
            if layout.inside is not None:
                self.slope = self.slope * layout.inside
            self.typical = np.abs(self.slope).sum(axis=1) / layout.n_inside

    def predict(self, circle: Array) -> Array:
        """Return where each ray crosses `circle`, less the radius at the start."""
        down, right = circle[0] - self.row, circle[1] - self.col
        along = self.sin * down + self.cos * right
        inner = circle[2] ** 2 - (down * down + right * right) + along * along
        return np.asarray(along + np.sqrt(np.maximum(inner, 0)) - self.radius)

    def edges(self, circle: Array, width: float) -> Array:
        """Each ray's steepest edge near `circle`: row, col, slope, usual slope, ray."""
        reach = 2.5 * max(width * self.half, 0.03 * self.radius, 1.5)
        middle = self.predict(circle).astype(np.float32)
        # One more on either side, where nothing is likely any more.
        ends = float(middle.min()) - reach, float(middle.max()) + reach
        first, last = np.searchsorted(self.offset, ends)
        near = slice(max(first - 1, 0), last + 1)
        likely = self.offset[near] - middle[:, None]
        likely /= np.float32(reach)
        likely *= likely
        np.subtract(1, likely, out=likely)
        np.maximum(likely, 0, out=likely)
        likely *= self.slope[:, near]
        peak = likely.argmax(axis=1) + near.start
        slope, at = self.slope.ravel(), self.layout.firsts + peak
        top = slope[at]
        ray = np.flatnonzero(
            (peak > near.start) & (peak < len(self.offset) - 1) & (top > 0)
        )
        peak, at, top = peak[ray], at[ray], top[ray]
        before, after = slope[at - 1], slope[at + 1]
        bend = np.minimum(before - 2 * top + after, np.float32(-1e-30))
        part = (0.5 * (before - after) / bend).clip(-1, 1)
        reach = self.radius + self.offset[peak] + part * self.cell
        row, col = self.row + self.sin[ray] * reach, self.col + self.cos[ray] * reach
        return np.array([row, col, top, self.typical[ray], ray])

    def judge(self, circle: Array, edges: Array) -> Fit:
        offset = self.predict(circle)
        y = self.row + self.sin * (self.radius + offset)
        x = self.col + self.cos * (self.radius + offset)
        seen = (np.abs(offset) < 0.95 * self.half) & (y >= 1) & (x >= 1)
        seen &= (y <= self.bottom - 1) & (x <= self.right - 1)
        n_seen = max(int(np.count_nonzero(seen)), 1)
        residual, outward = _residuals(circle, edges)
        tolerance = max(TOLERANCE * circle[2], 0.5)
        good = (np.abs(residual) < tolerance) & (edges[2] > SHARP * edges[3])
        good &= seen[edges[4].astype(np.intp)]
        on_circle = outward[:2, good]
        spread = on_circle @ on_circle.T / max(on_circle.shape[1], 1)
        (down, mixed), (_, across) = spread.tolist()
        balance = (down + across) / 2 - hypot((down - across) / 2, mixed)
        row, col, radius = circle.tolist()
        support, arc = on_circle.shape[1] / n_seen, n_seen / N_RAYS
        return Fit((row, col, radius), self.sign, support, arc, balance)


def _improved(circle: Array, edges: Array, radius: float | None) -> Array:
    """Take two reweighted Gauss-Newton steps of (row, col, radius)."""
    strength = np.minimum(edges[2] * (edges.shape[1] / edges[3].sum()), 4.0)
    middle = edges.shape[1] // 2
    for _ in range(2):
        residual, outward = _residuals(circle, edges)
        size = np.abs(residual)
        size.partition(middle)
        scale = max(1.4826 * float(size[middle]), 0.15)
        inner = residual / (BIWEIGHT * scale)
        inner = np.maximum(1 - inner * inner, 0)
        # Tukey's biweight times the edge's strength.
        weight = inner * inner * strength
        total = float(weight.sum())
        weighted = outward * weight
        normal, pull = weighted @ outward.T, weighted @ residual
        if radius is not None:
            hold = total * (scale / (HOLD * radius)) ** 2
            normal[2, 2] += hold
            pull[2] -= hold * (circle[2] - radius)
        normal.flat[::4] += 1e-6 * total
        circle = circle + cv2.solve(normal, pull[:, np.newaxis])[1].ravel()
    return circle


def _residuals(circle: Array, edges: Array) -> tuple[Array, Array]:
    """Distance of each edge beyond `circle`, and its slopes by row, col, radius."""
    away = edges[:2] - circle[:2, np.newaxis]
    distance = np.hypot(away[0], away[1])
    distance += 1e-9
    outward = np.empty((3, len(distance)))
    np.divide(away, distance, out=outward[:2])
    outward[2] = 1
    return distance - circle[2], outward


@lru_cache(maxsize=64)
def _slope_kernel(spread: float) -> Singles:
    """Derivative of a Gaussian, as one row; `spread` in cells."""
    reach = int(np.ceil(2.5 * spread))
    t = np.arange(-reach, reach + 1, dtype=np.float32)
    kernel = t * np.exp(-(t**2) / (2 * spread**2))
    return np.asarray((kernel / np.abs(kernel).sum())[None])
