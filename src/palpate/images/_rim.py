"""Find the visible circle of a camera dome to a fraction of a pixel.

The dome ends in a rim: a sharp, round edge towards a surround that is brighter or
darker. The camera shifts between touches and within a recording, so the centre is
found anew in every image; the radius is a constant of the device and is held near
a known one where there is one. Nothing holds the centre: a shifted image gives a
shifted rim. The frame may cut the circle, as long as a fifth of it is seen; what is
seen on one side alone must be nearly free of gaps.

Rows grow downwards; pixel centres are at whole numbers, so that an image of n rows
reaches from -0.5 to n - 0.5.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import repeat
from operator import attrgetter
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_finite, check_image_shape, check_levels, check_positive
from .._numbers import evenly_rounded
from .._parallel import opencv_on_one_thread
from .._types import Array, Bools, Floats
from . import _rim_fit
from ._rim_fit import Fit

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
        again = best and _rim_fit.refine(grey, best.circle, best.sign)
        best = again if again and _is_rim(again, shape, near) else best
    return Circle(*best.circle, True, best.support) if best else missing


def _candidates(grey: Array, near: Circle | None) -> Iterator[Fit]:
    """Fit a circle near a known one, then those that the most edge points agree on."""
    if near is not None:
        # The camera rarely moves far: looked for first where the rim was.
        usual = (near.row, near.col, near.radius)
        sign = _rim_fit.sign_at(grey, usual)
        here = _rim_fit.refine(grey, usual, sign, near.radius, widths=(0.4, 0.2))
        if here is not None:
            away = np.hypot(here.circle[0] - near.row, here.circle[1] - near.col)
            if away <= FEW_STEPS * near.radius:
                yield here
    small, block = _rim_fit.reduce(grey)
    centre = (block - 1) / 2
    side = min(small.shape)
    radii = np.arange(RADII[0] * side, RADII[1] * side, 3)
    search = None
    if near is not None:
        row, col = (near.row - centre) / block, (near.col - centre) / block
        radii = np.array([near.radius / block])
        search = (row, col, FREE_CENTRE * near.radius / block)
    circles = _rim_fit.vote(
        small, radii.astype(np.float32), n_best=3 if near is None else 2, near=search
    )
    for (row, col, radius), sign in circles:
        start = (row * block + centre, col * block + centre, radius * block)
        hold = None if near is None else near.radius
        fit = _rim_fit.refine(grey, start, sign, hold)
        if fit is not None:
            yield fit


def _is_rim(fit: Fit, shape: tuple[int, int], near: Circle | None) -> bool:
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
