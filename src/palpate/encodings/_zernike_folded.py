"""Zernike moments through a quarter of the basis.

About the centre of a frame every cosine or sine part of a polynomial is even or odd
from left to right and from top to bottom. So an image is folded into four quarters,
one for each kind of symmetry, and a part of the basis is multiplied with one of them.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ._zernike_disc import Disc
from ._zernike_polynomials import zernike_degrees

# Numbers in the tables of one grid: 256 MB.
MOST_NUMBERS = 2**25
_IMAGES_AT_ONCE = 64

# Basis of some taxels, (n_taxels, 2 * n_degrees): cosine parts, then sine parts.
Basis = Callable[[NDArray[np.intp]], NDArray[np.float64]]


class Quarter(NamedTuple):
    """One kind of symmetry: signs of the fold, columns of the basis, and its values."""

    down: int
    across: int
    columns: NDArray[np.intp]
    basis: NDArray[np.floating]


def can_fold(disc: Disc, order: int) -> bool:
    """Whether the disc sits in the middle of the frame, and the tables are small."""
    in_middle = (disc.row, disc.col) == ((disc.n_rows - 1) / 2, (disc.n_cols - 1) / 2)
    n_parts = 2 * len(zernike_degrees(order))
    return in_middle and disc.n_rows * disc.n_cols // 4 * n_parts <= MOST_NUMBERS


def folded_moments(
    images: NDArray, quarters: list[Quarter], taxels: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Cosine then sine parts of all moments, (n_touches, 2 * n_degrees)."""
    n_parts = sum(len(quarter.columns) for quarter in quarters)
    parts = np.empty((len(images), n_parts))
    for start in range(0, len(images), _IMAGES_AT_ONCE):
        block = images[start : start + _IMAGES_AT_ONCE]
        block = block.astype(quarters[0].basis.dtype)
        for quarter in quarters:
            folded = _fold(_fold(block, 1, quarter.down), 2, quarter.across)
            levels = folded.reshape(len(block), -1)[:, taxels]
            rows = slice(start, start + len(block))
            parts[rows, quarter.columns] = levels @ quarter.basis
    finite = [bool(np.isfinite(image).all()) for image in images]
    parts[np.logical_not(finite)] = np.nan
    return parts


def fold_basis(
    disc: Disc,
    order: int,
    taxels: NDArray[np.intp],
    basis_of: Basis,
    dtype: DTypeLike = np.float64,
) -> tuple[list[Quarter], NDArray[np.intp]]:
    """Return the four parts of a basis, and the taxels of a quarter that count.

    Parameters
    ----------
    disc : Disc
    order : int
    taxels : ndarray
        Taxels of the whole frame that the disc touches (flat indices).
    basis_of : callable
        Gives the basis of taxels.
    dtype : dtype
        Precision of the sums. Single is enough for images that are no better, and
        halves the time: reading the basis is what takes it.
    """
    row, col = np.divmod(taxels, disc.n_cols)
    top, left = disc.n_rows // 2, disc.n_cols // 2
    mine = (row >= top) & (col >= left)
    row, col = row[mine], col[mine]
    # A row or column in the very middle is folded onto itself and counts twice.
    twice = (disc.n_rows % 2) * (row == top), (disc.n_cols % 2) * (col == left)
    share = 0.5 ** (twice[0].astype(float) + twice[1])
    basis = basis_of(taxels[mine]) * share[:, np.newaxis]
    m = np.array([m for _, m in zernike_degrees(order)])
    sign = np.where(m % 2 == 0, 1, -1)
    # cos(m phi) keeps its sign from top to bottom, sin(m phi) changes it.
    down = np.concatenate([np.ones_like(m), -np.ones_like(m)])
    across = np.concatenate([sign, -sign])
    quarters = []
    for vertical in (1, -1):
        for horizontal in (1, -1):
            columns = np.flatnonzero((down == vertical) & (across == horizontal))
            part = np.ascontiguousarray(basis[:, columns], dtype)
            quarters.append(Quarter(vertical, horizontal, columns, part))
    width = disc.n_cols - left
    return quarters, (row - top) * width + (col - left)


def _fold(images: NDArray, axis: int, sign: int) -> NDArray:
    """Add the mirrored first half of an axis, times `sign`, to its second half."""
    n = images.shape[axis]
    turned = np.flip(images, axis)
    second = [slice(None)] * 3
    second[axis] = slice(n // 2, n)
    kept, mirrored = images[tuple(second)], turned[tuple(second)]
    return kept + mirrored if sign > 0 else kept - mirrored
