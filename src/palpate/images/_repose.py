"""Re-posing: turning, shifting and re-scaling images in software.

Positions are in pixels from the image's centre, rows downwards. A positive angle
turns the image from the column axis towards the row axis: clockwise as displayed.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_count, check_images, check_option
from .._types import Floats

# Pixels of output worked on at a time; bounds the memory of the coordinates.
_BLOCK = 1 << 18


def repose(
    images: ArrayLike,
    angle_deg: ArrayLike = 0.0,
    shift_px: ArrayLike = (0.0, 0.0),
    gain: ArrayLike = 1.0,
    *,
    shape: tuple[int, int] | None = None,
    edges: str = "zero",
    interpolation: str = "linear",
) -> Floats:
    """Turn images about their centre, then shift them, then multiply them.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)
        Without NaN: fill dead taxels first.
    angle_deg : float or array-like of shape (n_touches,), default=0
        Angle in degrees, clockwise as displayed with rows downwards.
    shift_px : array-like of shape (2,) or (n_touches, 2), default=(0, 0)
        (rows, columns) by which the turned image moves.
    gain : float or array-like of shape (n_touches,), default=1
        Factor on the levels.
    shape : tuple of int, optional
        (n_rows, n_cols) of the result, which has the same centre; by default that
        of the images. A larger one keeps turned corners.
    edges : {"zero", "nearest"}, default="zero"
        What lies outside the image: nothing, or the nearest pixel.
    interpolation : {"linear", "cubic"}, default="linear"
        "cubic" (Keys, through the pixels) blurs less, but overshoots beside steps.

    Returns
    -------
    reposed : ndarray of shape (n_touches, *shape)

    References
    ----------
    .. [1] R. G. Keys, "Cubic convolution interpolation for digital image
       processing", IEEE Trans. Acoust. Speech Signal Process. 29(6), 1981.
       doi:10.1109/TASSP.1981.1163711

    Examples
    --------
    >>> from palpate.images import repose
    >>> repose([[[1.0, 2.0], [3.0, 4.0]]], 90).round(9)
    array([[[3., 1.],
            [4., 2.]]])
    """
    checked = check_images(images)
    check_option("edges", edges, ("zero", "nearest"))
    check_option("interpolation", interpolation, tuple(_TAPS))
    n_touches, n_rows, n_cols = checked.shape
    angle = np.deg2rad(_per_touch("angle_deg", angle_deg, (n_touches,)))
    shift = _per_touch("shift_px", shift_px, (n_touches, 2))
    factor = _per_touch("gain", gain, (n_touches,))
    rows, cols = (n_rows, n_cols) if shape is None else shape
    rows, cols = check_count("shape[0]", rows), check_count("shape[1]", cols)
    grid = np.indices((rows, cols), dtype=np.float64)
    grid -= [[[(rows - 1) / 2]], [[(cols - 1) / 2]]]
    reposed = np.empty((n_touches, *grid.shape[1:]))
    step = max(1, _BLOCK // grid[0].size)
    for start in range(0, n_touches, step):
        block = slice(start, start + step)
        # Where each pixel of the new image was in the old one.
        row, col = grid[:, None] - shift[block].T[:, :, None, None]
        turn = angle[block][:, None, None]
        old_row = np.cos(turn) * row - np.sin(turn) * col + (n_rows - 1) / 2
        old_col = np.sin(turn) * row + np.cos(turn) * col + (n_cols - 1) / 2
        where = np.stack([old_row, old_col])
        reposed[block] = interpolate(checked[block], where, edges, interpolation)
        reposed[block] *= factor[block, None, None]
    return reposed


def _per_touch(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Floats:
    given = np.asarray(value, dtype=np.float64)
    if given.shape not in (shape, shape[1:]):
        one = "a number" if len(shape) == 1 else f"of shape {shape[1:]}"
        raise ValueError(
            f"{name} must be {one} or of shape {shape}, got shape {given.shape}."
        )
    if not np.isfinite(given).all():
        raise ValueError(f"{name} must be finite, got NaN or infinity.")
    return np.broadcast_to(given, shape)


def interpolate(
    images: Floats, where: Floats, edges: str, interpolation: str
) -> Floats:
    """Return levels at positions `where`, (2, n_touches, ...), as (n_touches, ...).

    Positions are (row, column), pixel centres integers. One image may serve all
    touches.
    """
    # A turn by 90 degrees leaves rounding that would blur a pixel into the next.
    exact = where.round(12)
    base = np.floor(exact).astype(np.intp)
    first, weigh = _TAPS[interpolation]
    weights = weigh(exact - base)
    # Indices moved inside the image, and the weights of those that were outside.
    taps: list[list[tuple[NDArray[np.intp], Floats]]] = [[], []]
    for i, axis in product(range(len(weights)), (0, 1)):
        index, weight = base[axis] + first + i, weights[i, axis]
        inside = index.clip(0, images.shape[1 + axis] - 1)
        if edges == "zero":
            weight = np.where(inside == index, weight, 0.0)
        taps[axis].append((inside, weight))
    touch = np.arange(len(images)).reshape(-1, *[1] * (where.ndim - 2))
    starts = touch * images[0].size
    levels, result = images.ravel(), np.zeros(where.shape[1:])
    for row, row_weight in taps[0]:
        line = starts + row * images.shape[2]
        for col, col_weight in taps[1]:
            result += row_weight * col_weight * levels[line + col]
    return result


def _cubic(t: Floats) -> Floats:
    """Keys' weights, with a = -1/2, of the pixels at -1, 0, 1 and 2."""
    return np.stack(
        [
            ((2 - t) * t - 1) * t / 2,
            ((3 * t - 5) * t * t + 2) / 2,
            ((4 - 3 * t) * t + 1) * t / 2,
            (t - 1) * t * t / 2,
        ]
    )


# Name: (offset of the first pixel, weights of the pixels at a fraction of a step).
_TAPS: dict[str, tuple[int, Callable[[Floats], Floats]]] = {
    "linear": (0, lambda t: np.stack([1 - t, t])),
    "cubic": (-1, _cubic),
}
