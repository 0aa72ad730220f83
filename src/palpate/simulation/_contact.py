"""A flat face on a thin soft sheet: where it touches, and the stress below.

Grids have square cells; positions on them are in cells, (column, row) for corners
of loops and (row, column) for arrays. Pressures are in kPa.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from .._types import Floats

# Length over which a machined face's unevenness stays alike; a guess: a quarter of
# the parts' size.
UNEVENNESS_LENGTH_MM = 3.0
# Products of profiles smaller than this share of the largest are left out: it is
# ten thousand times less than half a grey level.
_RANK_TOLERANCE = 1e-8


def footprint(
    loops: list[Floats], n_rows: int, n_cols: int
) -> tuple[NDArray[np.bool_], int, int]:
    """Tell which cells' centres lie inside an odd number of closed loops.

    Corners are (column, row) in cells from the outer corner of the first; returned is
    the smallest piece of the grid that holds them, with its first row and column.
    """
    limits = np.array([n_cols, n_rows])
    corners = np.concatenate(loops)
    low = np.clip(np.floor(corners.min(axis=0)), 0, limits).astype(int)
    high = np.clip(np.ceil(corners.max(axis=0)), low, limits).astype(int)
    (col, row), (n_cols_about, n_rows_about) = low, high - low
    first = corners - low
    last = np.concatenate([np.roll(loop, -1, axis=0) for loop in loops]) - low
    centres = np.arange(n_rows_about) + 0.5
    cut = (first[:, 1:] <= centres) != (last[:, 1:] <= centres)
    edge, line = np.nonzero(cut)
    start, along = first[edge], last[edge] - first[edge]
    crossing = start[:, 0] + (centres[line] - start[:, 1]) / along[:, 1] * along[:, 0]
    cell = np.clip(np.ceil(crossing - 0.5), 0, n_cols_about).astype(int)
    width = int(n_cols_about) + 1
    counts = np.bincount(line * width + cell, minlength=int(n_rows_about) * width)
    crossed = counts.reshape(-1, width)[:, :-1].cumsum(axis=1)
    return crossed % 2 == 1, int(row), int(col)


def unevenness(
    shape: tuple[int, int], step_mm: float, rng: np.random.Generator
) -> Floats:
    """Draw a smooth random surface of mean 0 and standard deviation 1.

    Its covariance is exp(-d² / (2 length²)), with `UNEVENNESS_LENGTH_MM`.
    """
    by_row, by_col = (_smoothing(n, step_mm) for n in shape)
    noise = rng.standard_normal((by_row.shape[1], by_col.shape[1]))
    return by_row @ noise @ by_col.T


def contact_pressure(
    inside: NDArray[np.bool_], gap_mm: Floats, stiffness: float, total: float
) -> Floats:
    """Solve stiffness max(0, depth - gap) (kPa) of cells `inside`, to sum to `total`.

    The sum is convex in the depth, so Newton's steps from all touching go down to it.
    """
    gaps = gap_mm[inside]
    needed = total / stiffness
    touching = gaps
    while True:
        depth = (needed + touching.sum()) / len(touching)
        still = touching[touching < depth]
        if len(still) == len(touching):
            break
        touching = still
    pressure = np.zeros(gap_mm.shape)
    pressure[inside] = stiffness * np.maximum(depth - gaps, 0)
    return pressure


@lru_cache(maxsize=8)
def window_weights(
    n_taxels: int, cells: int, pitch_mm: float, sensing_mm: float, depth_mm: float
) -> tuple[Floats, Floats]:
    """Factor the map from pressure on a grid to mean stress over square windows.

    Taxel (t, u): sum over k, i, j of scale[k] factors[k, t, i] factors[k, u, j]
    pressure[i, j], with scale (rank,) and factors (rank, n_taxels, n_taxels * cells).
    """
    step = pitch_mm / cells
    # Distances of cell centres from taxel centres, in half cells.
    centres = cells * (2 * np.arange(n_taxels)[:, np.newaxis] + 1)
    halves = np.abs(2 * np.arange(n_taxels * cells) + 1 - centres)
    distinct, place = np.unique(halves, return_inverse=True)
    away = distinct * step / 2
    kernel = step**2 * window_influence(away[:, np.newaxis], away, sensing_mm, depth_mm)
    # One thread: the last digits, and so the touches, must not hang on the number.
    with threadpool_limits(limits=1, user_api="blas"):
        values, vectors = np.linalg.eigh(kernel)
    kept = np.abs(values) > _RANK_TOLERANCE * np.abs(values).max()
    factors = vectors[:, kept].T[:, place.reshape(halves.shape)]
    return values[kept], np.ascontiguousarray(factors)


def window_influence(
    x_mm: Floats, y_mm: Floats, sensing_mm: float, depth_mm: float
) -> Floats:
    """Return mean stress (1/mm²) in a window, due to a unit force at (x, y) above it.

    By reciprocity: the stress below a loaded rectangle's corner, over four corners
    (Love 1929, doi:10.1098/rsta.1929.0009).
    """
    half = sensing_mm / 2
    corners = (
        _below_corner(x_mm + half, y_mm + half, depth_mm)
        - _below_corner(x_mm - half, y_mm + half, depth_mm)
        - _below_corner(x_mm + half, y_mm - half, depth_mm)
        + _below_corner(x_mm - half, y_mm - half, depth_mm)
    )
    return corners / sensing_mm**2


def _below_corner(a: Floats, b: Floats, z: float) -> Floats:
    """Vertical stress at depth z below a corner of a x b under unit pressure."""
    to_a, to_b, to_far = a**2 + z**2, b**2 + z**2, np.sqrt(a**2 + b**2 + z**2)
    shear = a * b * z / to_far * (1 / to_a + 1 / to_b)
    return (np.arctan(a * b / (z * to_far)) + shear) / (2 * np.pi)


@lru_cache(maxsize=512)
def _smoothing(n_cells: int, step_mm: float) -> Floats:
    """Weights (n_cells, n_knots) of knots on cells, each row of unit length."""
    width = UNEVENNESS_LENGTH_MM / np.sqrt(2)
    where = step_mm * np.arange(n_cells)
    n_knots = int(np.ceil((where[-1] + 6 * width) / width)) + 1
    knots = width * (np.arange(n_knots) - 3)
    weights = np.exp(-((where[:, np.newaxis] - knots) ** 2) / (2 * width**2))
    lengths = np.sqrt((weights**2).sum(axis=1, keepdims=True))
    return np.asarray(weights / lengths)
