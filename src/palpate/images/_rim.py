"""Find the visible circle of a camera dome to a fraction of a pixel.

The dome ends in a rim: a sharp, round edge towards a surround that is brighter or
darker. The camera shifts between touches and within a recording, so the centre is
found anew in every image; the radius is a constant of the device and is held near
a known one where there is one. Nothing holds the centre: a shifted image gives a
shifted rim. The frame may cut the circle, as long as a fifth of it is seen; what is
seen on one side alone must be nearly free of gaps.

Rows grow downwards; pixel centres are at whole numbers, so that an image of n rows
reaches from -0.5 to n - 0.5.

A circle is fitted in two steps. Edge points of a reduced image vote along their
gradient for the centres of circles through them [1]_, which needs no starting point.
Then the grey levels along rays across the best circles give one edge a ray, to a
fraction of a pixel, and a circle is fitted to these edges by Tukey's biweight [2]_, so
that contacts, highlights and dirt that cross the rim count little. In these steps it is
a triple (row, col, radius) in pixels; `sign` is +1 where the surround is brighter than
the dome, -1 where it is darker.

References
----------
.. [1] C. Kimme, D. Ballard, J. Sklansky, "Finding circles by an array of
   accumulators", Commun. ACM 18(2), 1975. doi:10.1145/360666.360677
.. [2] P. W. Holland, R. E. Welsch, "Robust regression using iteratively reweighted
   least-squares", Commun. Stat. Theory Methods 6(9), 1977.
   doi:10.1080/03610927708827533
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import repeat
from math import hypot
from operator import attrgetter
from typing import Any, NamedTuple, overload

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_finite, check_image_shape, check_levels, check_positive
from .._numbers import evenly_rounded
from .._parallel import opencv_on_one_thread
from .._types import Array, Bools, Floats, Singles

SMALLEST_SIDE = 40  # pixels; below, an image is of an array
RADII = (0.25, 0.8)  # that are looked for, of the shorter side
# Shares of the circle: with a sharp edge, in the frame, and on the lesser side.
MIN_SUPPORT, MIN_ARC, MIN_BALANCE = 0.65, 0.2, 0.12
# With less on one side, so much of what is in the frame must show an edge.
ONE_SIDED, ONE_SIDED_SUPPORT = 0.2, 0.9
# How far a rim may be from a known one, of its radius.
FREE_RADIUS, FREE_CENTRE = 0.03, 0.5
# A rim found from where it was is trusted no further off than this share of its radius.
FEW_STEPS = 0.05
N_TYPICAL = 64
_REDUCED_SIDE = 120  # pixels, for the search alone; the fit takes all
_MAX_EDGE_POINTS = 500  # the steepest vote: time grows with them
_N_RAYS = 192  # across the rim, one every 1.9 degrees
_HALF_WIDTH = 0.1  # of the radius, that a ray reaches to either side
_BIWEIGHT = 4.685  # 95 % efficient for normal noise (Tukey)
_MIN_EDGES = 12  # four for each of the circle's three numbers
_HOLD = 0.003  # of the radius: how far the known one may be off
_TOLERANCE, _SHARP = 0.012, 1.8  # of the radius off the circle; times the typical slope
_EDGE = cv2.BORDER_REPLICATE

_ANGLE = 2 * np.pi * np.arange(_N_RAYS) / _N_RAYS
_SIN, _COS = np.sin(_ANGLE).astype(np.float32), np.cos(_ANGLE).astype(np.float32)

_Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Circle:
    """A circle in an image: centre (`row`, `col`) and `radius`, in pixels.

    `visible` tells whether a rim was seen there; `score`, from 0 to 1, which share of
    the circle inside the frame shows a sharp edge.
    """

    row: float
    col: float
    radius: float
    visible: bool = True
    score: float = 1.0

    @classmethod
    def inscribed(cls, shape: tuple[int, int]) -> Circle:
        """The largest disc in a frame of `shape`; not a visible rim."""
        rows, cols = shape
        return cls((rows - 1) / 2, (cols - 1) / 2, min(rows, cols) / 2, False, 0.0)


@dataclass(frozen=True)
class Rims:
    """The circles of a set of touches, one value a touch in every array.

    Attributes
    ----------
    row, col, radius : ndarray of shape (n_touches,)
        Centre and radius, in pixels.
    visible : ndarray of bool, shape (n_touches,)
        False where no rim was seen; the circle is then a stand-in.
    score : ndarray of shape (n_touches,)
        Share of the circle inside the frame that shows a sharp edge, 0 to 1.
    """

    row: Floats
    col: Floats
    radius: Floats
    visible: Bools
    score: Floats

    @classmethod
    def of(cls, circles: Iterable[Circle]) -> Rims:
        """Gather circles, one a touch."""
        row, col, radius, visible, score = np.array([*map(_IN_ORDER, circles)], float).T
        return cls(row, col, radius, visible > 0, score)

    def __len__(self) -> int:
        return len(self.row)

    @overload
    def __getitem__(self, key: int | np.integer) -> Circle: ...
    @overload
    def __getitem__(self, key: slice | NDArray[Any]) -> Rims: ...
    def __getitem__(self, key: Any) -> Circle | Rims:
        picked = {f.name: getattr(self, f.name)[key] for f in fields(self)}
        if np.ndim(picked["row"]):
            return Rims(**picked)
        return Circle(**{name: value.item() for name, value in picked.items()})


_IN_ORDER = attrgetter(*(field.name for field in fields(Circle)))


def find_rims(
    images: ArrayLike,
    *,
    near: Circle | None = None,
    no_contact: ArrayLike | None = None,
) -> Rims:
    """Find the rim of every touch.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)
        Grey levels of any integer or float type, without NaN.
    near : Circle, optional
        One found in another image, such as `find_rims(frames)[0]`. Radii are held
        within about a per cent of its own, centres anywhere within half a radius; a
        touch's rim does not depend on the others then.
    no_contact : array-like of shape (n_rows, n_cols), optional
        The no-contact frame, to learn `near` from. With neither, `near` is the
        `typical_rim` of the touches, so the radius comes from all of them.

    Returns
    -------
    Rims
        Where none is visible: `near` or the inscribed disc, marked as such.

    Raises
    ------
    TypeError, ValueError
        If `images` are no finite images.
    """
    checked = as_images(images)
    if near is not None:
        check_positive("near.radius", near.radius)
    near = near or typical_rim(checked, no_contact=no_contact)
    return rims_near(checked, near)


def rims_near(images: Array, near: Circle | None) -> Rims:
    """Find the rim of every image, near one of the same device; without checks."""
    with opencv_on_one_thread():
        return Rims.of(map(_find, images, repeat(near)))


def typical_rim(
    images: ArrayLike, *, no_contact: ArrayLike | None = None
) -> Circle | None:
    """Return the rim that a set of touches has in common, or None where it has none.

    As large as in the no-contact frame if it is visible there, in the middle of where
    touches show it, which may be elsewhere; else the median over at most 64 touches,
    half of which must show rims of one size (median deviation below 2 %) and place
    (below 15 % of the radius): so a device's rim differs from round edges of what
    touches it.
    """
    checked = as_images(images)
    idle = None
    if no_contact is not None:
        alone = _find(as_images(np.asarray(no_contact)[np.newaxis])[0], None)
        idle = alone if alone.visible else None
    rims = rims_near(checked[evenly_rounded(len(checked), N_TYPICAL)], idle)
    seen = rims[rims.visible]
    if idle is not None:
        if not len(seen):
            return idle
        row, col = float(np.median(seen.row)), float(np.median(seen.col))
        return replace(idle, row=row, col=col)
    if 2 * len(seen) < len(rims):
        return None
    row, col, radius = (float(np.median(v)) for v in (seen.row, seen.col, seen.radius))
    stray = np.median(np.hypot(seen.row - row, seen.col - col))
    uneven = np.median(np.abs(seen.radius - radius))
    if stray > 0.15 * radius or uneven > 0.02 * radius:
        return None
    return Circle(row, col, radius, True, float(np.median(seen.score)))


def as_images(X: ArrayLike, *, shape: tuple[int, ...] | None = None) -> Array:
    """Return `X` as finite images; 8-bit ones stay so, to save memory and time."""
    images = check_image_shape(X, shape=shape)
    if images.dtype == np.uint8:
        return images
    return check_levels(check_finite(images.astype(np.float64, copy=False)))


def _find(image: Array, near: Circle | None) -> Circle:
    shape = image.shape
    missing = replace(near or Circle.inscribed(shape), visible=False, score=0.0)
    if min(shape) < SMALLEST_SIDE:
        return missing
    # 8-bit as it is, anything else stretched to 0..1 in single precision.
    if image.dtype == np.uint8:
        grey = np.ascontiguousarray(image)
    else:
        low, high = image.min(), image.max()
        if low == high:
            return missing
        grey = ((image / 2 - low / 2) / (high / 2 - low / 2)).astype(np.float32)
    rims = (fit for fit in _candidates(grey, near) if _is_rim(fit, shape, near))
    if near is not None:
        best = next(rims, None)
    else:
        best = max(rims, key=attrgetter("evidence"), default=None)
        # The votes may be further off than one search of the edges reaches.
        again = best and _refine(grey, best.circle, best.sign)
        best = again if again and _is_rim(again, shape, near) else best
    return Circle(*best.circle, True, best.support) if best else missing


def _candidates(grey: Array, near: Circle | None) -> Iterator[_Fit]:
    """Fit a circle near a known one, then those that the most edge points agree on."""
    if near is not None:
        # The camera rarely moves far: looked for first where the rim was.
        usual = (near.row, near.col, near.radius)
        sign = _sign_at(grey, usual)
        here = _refine(grey, usual, sign, near.radius, widths=(0.4, 0.2))
        if here is not None:
            away = np.hypot(here.circle[0] - near.row, here.circle[1] - near.col)
            if away <= FEW_STEPS * near.radius:
                yield here
    small, block = _reduce(grey)
    centre = (block - 1) / 2
    side = min(small.shape)
    radii = np.arange(RADII[0] * side, RADII[1] * side, 3)
    search = None
    if near is not None:
        row, col = (near.row - centre) / block, (near.col - centre) / block
        radii = np.array([near.radius / block])
        search = (row, col, FREE_CENTRE * near.radius / block)
    circles = _vote(
        small, radii.astype(np.float32), n_best=3 if near is None else 2, near=search
    )
    for (row, col, radius), sign in circles:
        start = (row * block + centre, col * block + centre, radius * block)
        hold = None if near is None else near.radius
        fit = _refine(grey, start, sign, hold)
        if fit is not None:
            yield fit


def _is_rim(fit: _Fit, shape: tuple[int, int], near: Circle | None) -> bool:
    row, col, radius = fit.circle
    if near is not None:
        strays = np.hypot(row - near.row, col - near.col) > FREE_CENTRE * near.radius
        if strays or abs(radius - near.radius) > FREE_RADIUS * near.radius:
            return False
    elif not 0.9 * RADII[0] < radius / min(shape) < 1.1 * RADII[1]:
        return False
    needed = ONE_SIDED_SUPPORT if fit.balance < ONE_SIDED else MIN_SUPPORT
    in_frame = 0 <= row <= shape[0] - 1 and 0 <= col <= shape[1] - 1
    seen = fit.support >= needed and fit.arc >= MIN_ARC
    return in_frame and seen and fit.balance >= MIN_BALANCE


class _Fit(NamedTuple):
    """A fitted circle and the evidence for it.

    `support` is the share of the rays inside the frame with a sharp edge on the circle,
    `arc` the share of a full turn that these rays cover, and `balance` from 0 (edges on
    one line through the centre) to 1/2 (evenly around it).
    """

    circle: _Triple
    sign: int
    support: float
    arc: float
    balance: float

    @property
    def evidence(self) -> float:
        """Score of a circle to choose by: the rim encloses all that touches it."""
        return float(self.support * self.arc**0.5 * self.circle[2])


def _reduce(image: Array) -> tuple[NDArray[np.uint8], int]:
    """Average whole blocks of pixels and stretch to 0..255; also the block's side."""
    rows, cols = image.shape
    block = max(1, min(rows, cols) // _REDUCED_SIDE)
    if block > 1:
        size = (cols // block, rows // block)
        whole = image[: size[1] * block, : size[0] * block]
        image = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    low, high = float(image.min()), float(image.max())
    scale = 255 / (high - low) if high > low else 0.0
    stretched = cv2.convertScaleAbs(image, alpha=scale, beta=-low * scale)
    return np.asarray(stretched, np.uint8), block


def _vote(
    small: NDArray[np.uint8],
    radii: Singles,
    *,
    n_best: int,
    near: _Triple | None = None,
) -> Iterator[tuple[_Triple, int]]:
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


def _sign_at(image: Array, circle: _Triple) -> int:
    """Return +1 where the surround of `circle` is brighter than its inside, else -1."""
    maps = _layout(circle, image.shape).sides
    inner, outer = cv2.remap(image, *maps, cv2.INTER_NEAREST, borderMode=_EDGE)
    brighter = outer.astype(np.float32) - inner
    brighter.partition((_N_RAYS // 2 - 1, _N_RAYS // 2))
    return 1 if brighter[_N_RAYS // 2 - 1] + brighter[_N_RAYS // 2] > 0 else -1


def _refine(
    image: Array,
    start: _Triple,
    sign: int,
    radius: float | None = None,
    widths: tuple[float, ...] = (1.0, 0.4, 0.2),
) -> _Fit | None:
    """Fit the circle near `start` to sub-pixel edges; None where there are too few.

    With `radius`, it is held as if known to 0.3 %, against errors all of one cause.
    Edges are sought within these `widths` in turn, as shares of how far the rays reach.
    """
    rays = _Rays(image, start, sign)
    if len(rays.sin) < _MIN_EDGES:
        return None
    circle = np.array(start)
    if radius is not None:
        circle[2] = radius
    for width in widths:
        edges = rays.edges(circle, width)
        if edges.shape[1] < _MIN_EDGES:
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
    if len(places) < _MIN_EDGES:
        return None
    gradient = np.stack([dy.ravel()[places], dx.ravel()[places]]).astype(np.float32)
    size = np.sqrt((gradient * gradient).sum(axis=0))
    if len(places) > _MAX_EDGE_POINTS:
        keep = np.argpartition(size, -_MAX_EDGE_POINTS)[-_MAX_EDGE_POINTS:]
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
def _layout(circle: _Triple, shape: tuple[int, int]) -> _Layout:
    row, col, radius = circle
    half = max(_HALF_WIDTH * radius, 5.0)
    cell = max(half / 22, 0.5)
    n = int(np.ceil(half / cell))
    offset = cell * np.arange(-n, n + 1, dtype=np.float32)
    reach = np.float32(radius) + offset
    y = np.float32(row) + _SIN[:, None] * reach
    x = np.float32(col) + _COS[:, None] * reach
    inside = (y >= 0) & (y <= shape[0] - 1) & (x >= 0) & (x <= shape[1] - 1)
    which = np.flatnonzero(np.count_nonzero(inside, axis=1) > len(reach) / 4)
    inside = inside[which]
    sides = radius * np.array(
        [[1 - _HALF_WIDTH / 2], [1 + _HALF_WIDTH / 2]], np.float32
    )
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

    def __init__(self, image: Array, start: _Triple, sign: int) -> None:
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

    def judge(self, circle: Array, edges: Array) -> _Fit:
        offset = self.predict(circle)
        y = self.row + self.sin * (self.radius + offset)
        x = self.col + self.cos * (self.radius + offset)
        seen = (np.abs(offset) < 0.95 * self.half) & (y >= 1) & (x >= 1)
        seen &= (y <= self.bottom - 1) & (x <= self.right - 1)
        n_seen = max(int(np.count_nonzero(seen)), 1)
        residual, outward = _residuals(circle, edges)
        tolerance = max(_TOLERANCE * circle[2], 0.5)
        good = (np.abs(residual) < tolerance) & (edges[2] > _SHARP * edges[3])
        good &= seen[edges[4].astype(np.intp)]
        on_circle = outward[:2, good]
        spread = on_circle @ on_circle.T / max(on_circle.shape[1], 1)
        (down, mixed), (_, across) = spread.tolist()
        balance = (down + across) / 2 - hypot((down - across) / 2, mixed)
        row, col, radius = circle.tolist()
        support, arc = on_circle.shape[1] / n_seen, n_seen / _N_RAYS
        return _Fit((row, col, radius), self.sign, support, arc, balance)


def _improved(circle: Array, edges: Array, radius: float | None) -> Array:
    """Take two reweighted Gauss-Newton steps of (row, col, radius)."""
    strength = np.minimum(edges[2] * (edges.shape[1] / edges[3].sum()), 4.0)
    middle = edges.shape[1] // 2
    for _ in range(2):
        residual, outward = _residuals(circle, edges)
        size = np.abs(residual)
        size.partition(middle)
        scale = max(1.4826 * float(size[middle]), 0.15)
        inner = residual / (_BIWEIGHT * scale)
        inner = np.maximum(1 - inner * inner, 0)
        # Tukey's biweight times the edge's strength.
        weight = inner * inner * strength
        total = float(weight.sum())
        weighted = outward * weight
        normal, pull = weighted @ outward.T, weighted @ residual
        if radius is not None:
            hold = total * (scale / (_HOLD * radius)) ** 2
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
