"""What kernel densities share: whitening, and sums of Gaussians in logarithms.

With all vectors whitened, the exponent of a Gaussian around a stored touch y of an
object with mean m and precisions P splits into a part that the whole object shares
and one product:

    -(x - y)' P (x - y) / 2 = -(x - m)' P (x - m) / 2 + x' p + b,
    p = P (y - m),  b = -(y - m)' p / 2 - m' p.

The shared part is computed in float64. The products are one small matrix product
per tile of `TILE` stored touches, mostly in float32: nothing large is ever cancelled
there, however far the touch x is from everything. Every tile is a product of its
own, so what one object answers never depends on which others are stored.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from sklearn.utils import gen_batches

from .._numbers import exp
from .._types import Array, Bools, Floats, Indices

Tiles = NDArray[np.floating]

TILE = 32
# Largest error (nats) that rounding may ever cause before a pair of touch and object
# is computed exactly instead.
MAX_ERROR = 1e-3

_QUERIES = 64  # touches recognised at once
_BLOCK = 2**20  # exponents in memory at once
_ROWS = 2**16  # touches whose variance is in memory at once
# From this many touches on, long columns of touches are quicker than rows of tiles.
_COLUMNS_FROM = 32
_EMPTY = -1e30  # exponent of a place in a tile that holds no touch
_LARGEST = 1e15  # beyond it a pair is computed exactly whatever the tile says
# Whitened coordinates end here, so that their squares are finite numbers.
FARTHEST = 1e100
# A feature with less spread than this share of its size is constant up to rounding.
ROUNDING = 1e-12


def make_tiles(
    points: Floats, precisions: Floats | None, dtype: str
) -> tuple[Tiles, Floats]:
    """Pack whitened touches (n_touches, n_directions) of one object, rows of p and b.

    Returns tiles (n_tiles, TILE, n_directions + 1) and the largest |p| and |b|;
    `precisions` (n_directions,) weigh the squared differences, None is all ones.
    """
    mean = points.mean(axis=0, dtype=np.float64)
    from_mean = points - mean
    weighted = from_mean if precisions is None else from_mean * precisions
    bias = -(from_mean * weighted).sum(axis=1) / 2 - weighted @ mean
    lengths = np.sqrt((weighted**2).sum(axis=1))
    n_tiles = -(-len(points) // TILE)
    rows = np.zeros((n_tiles * TILE, points.shape[1] + 1))
    rows[:, -1] = _EMPTY
    rows[: len(points)] = np.clip(np.c_[weighted, bias], -_LARGEST, _LARGEST)
    tiles = rows.reshape(n_tiles, TILE, -1).astype(dtype)
    return tiles, np.array([lengths.max(), np.abs(bias).max()])


def count_tiles(counts: Indices) -> Indices:
    return -(-counts // TILE)


def tile_log_sums(x: Floats, tiles: Tiles, tile_counts: Indices) -> Floats:
    """Return log of the sum of exp(x'p + b) per object, (n_touches, n_objects).

    Objects have `tile_counts` (n_objects,) tiles each, one object after the other.
    """
    extended = np.ones((len(x), x.shape[1] + 1), dtype=tiles.dtype)
    extended[:, :-1] = np.clip(x, -_LARGEST, _LARGEST)
    starts = np.cumsum(tile_counts) - tile_counts
    owner = np.repeat(np.arange(len(tile_counts)), tile_counts)
    rows_per_block = max(1, _BLOCK // (TILE * len(x)))
    blocks = [
        _sums_of_tiles(extended, tiles[first : first + rows_per_block])
        for first in range(0, len(tiles), rows_per_block)
    ]
    largest, sums = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    top = np.maximum.reduceat(largest, starts, axis=0)
    sums *= exp(largest - top[owner])
    totals = np.add.reduceat(sums, starts, axis=0, dtype=np.float64)
    return np.asarray((top + np.log(totals)).T)


def squared_distances(x: Floats, means: Floats, precisions: Floats | None) -> Floats:
    """Return (x - m)' P (x - m) in float64, shape (n_touches, n_objects)."""
    if precisions is None:
        return np.asarray(cdist(x, means, "sqeuclidean"))
    squared = (x - means[:, np.newaxis]) ** 2
    return (squared @ precisions[:, :, np.newaxis])[..., 0].T


def is_precise(
    x: Floats, reaches: Floats, dtype: str, max_error: float = MAX_ERROR
) -> Bools:
    """Return which pairs the tiles answer within `max_error`, (n_touches, n_objects).

    A product of n numbers rounds by at most (n + 2) units of the last place of the
    product of the lengths; rounding its input adds two more.
    """
    unit = np.finfo(dtype).eps / 2
    lengths = np.sqrt((x**2).sum(axis=1, keepdims=True))
    bound = lengths * reaches[:, 0] + reaches[:, 1]
    return np.asarray((x.shape[1] + 5) * unit * bound < max_error)


def exact_log_sums(
    x: Floats,
    points: Floats,
    precisions: Floats | None,
    groups: tuple[Array, Array] | None = None,
) -> Floats:
    """Return log of the sum of Gaussians around `points`, in float64, (len(x),).

    Pairs within one of the `groups` (of `x`, of `points`) do not count; none left is
    -inf.
    """
    if precisions is not None:
        weights = np.sqrt(precisions)
        x, points = x * weights, points * weights
    result = np.full(len(x), -np.inf)
    for rows in blocks_of(len(x)):
        for first in range(0, len(points), _BLOCK // _QUERIES):
            columns = slice(first, first + _BLOCK // _QUERIES)
            exponents = cdist(x[rows], points[columns], "sqeuclidean") / -2
            if groups is not None:
                same_group = groups[0][rows, np.newaxis] == groups[1][columns]
                exponents[same_group] = -np.inf
            part = np.logaddexp.reduce(exponents, axis=1)
            result[rows] = np.logaddexp(result[rows], part)
    return result


def blocks_of(n_touches: int) -> list[slice]:
    """Return slices that cut `n_touches` into blocks of at most 64."""
    return [slice(i, i + _QUERIES) for i in range(0, n_touches, _QUERIES)]


def _sums_of_tiles(extended: Tiles, tiles: Tiles) -> tuple[Tiles, Tiles]:
    """Return each tile's largest exponent, and sum over it, (n_tiles, n_touches).

    At most `TILE` terms: float32 costs a sum less than 2e-6 nats.
    """
    # Sums are products with ones: BLAS adds up several times faster than numpy.
    ones = np.ones(TILE, dtype=tiles.dtype)
    if len(extended) < _COLUMNS_FROM:
        exponents: Tiles = extended @ tiles.transpose(0, 2, 1)
        largest = exponents.max(axis=2)
        exponents -= largest[:, :, np.newaxis]
        exp(exponents, out=exponents)
        return largest, exponents @ ones
    exponents = tiles @ np.ascontiguousarray(extended.T)
    # One half against the other runs over long rows, which numpy does faster.
    halves = np.maximum(exponents[:, : TILE // 2], exponents[:, TILE // 2 :])
    largest = halves.max(axis=1)
    exponents -= largest[:, np.newaxis]
    exp(exponents, out=exponents)
    return largest, ones @ exponents


# Centre and spread (n_features,): mean and standard deviation of the training touches;
# which vary by more than rounding; the rotation (n_varying, n_directions) to unit
# variance; and the log volume of the unit cell, in units of the features.
Whitening = tuple[Floats, Floats, Bools, Floats | None, float]


def learn_whitening(touches: Floats, *, full: bool) -> Whitening:
    """Learn from `touches`, with unbiased variances (n - 1); refuse infinite ones.

    With `full`, correlations go too, and directions without variance up to rounding.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        centre = touches.mean(axis=0)
        squared = sum(
            ((touches[rows] - centre) ** 2).sum(axis=0)
            for rows in gen_batches(len(touches), _ROWS)
        )
        spread = np.sqrt(squared / max(1, len(touches) - 1))
    if not np.isfinite(spread).all():
        raise ValueError(
            "X must have variances below 1e308, got larger ones. Rescale the features."
        )
    largest = np.maximum(touches.max(axis=0), -touches.min(axis=0))
    varies = spread > ROUNDING * largest
    log_volume = float(np.log(spread[varies]).sum())
    if not (full and varies.any()):
        return centre, spread, varies, None, log_volume
    standardised = (touches[:, varies] - centre[varies]) / spread[varies]
    correlation = standardised.T @ standardised / max(1, len(standardised) - 1)
    variances, directions = np.linalg.eigh(correlation)
    least = len(variances) * np.finfo(np.float64).eps * variances[-1]
    # Products of rounded touches leave more rounding than the matrix itself.
    kept = variances > max(least, ROUNDING)
    rotation = directions[:, kept] / np.sqrt(variances[kept])
    log_rest = float(np.log(variances[kept]).sum() / 2)
    return centre, spread, varies, rotation, log_volume + log_rest


def whiten(
    touches: Floats,
    centre: Floats,
    spread: Floats,
    varies: Bools,
    rotation: Floats | None,
) -> Floats:
    """Return whitened touches, shape (n_touches, n_directions), always finite."""
    with np.errstate(over="ignore"):
        standardised = (touches[:, varies] - centre[varies]) / spread[varies]
    finite = np.clip(standardised, -FARTHEST, FARTHEST)
    return finite if rotation is None else finite @ rotation
