"""Kernel density per object: how probable a touch is where touches were stored.

Learning is storing. The likelihood of a touch given an object is the mean of one
Gaussian around each of the object's training touches, so objects can be learnt and
forgotten one by one. Everything is in natural logarithms and exact: no touch is left
out of a sum because it is far away, since an object at minus infinity could not be
brought back by any later touch.

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

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist
from sklearn.utils import gen_batches
from sklearn.utils.validation import check_is_fitted

from .._checks import as_groups, check_number, check_option, check_positive
from .._numbers import exp
from .._types import Array, Bools, Floats, Indices
from ._touch_classifier import BayesRule, Groups, as_touches, labelled_touches

Tiles = NDArray[np.floating]

# With precision="auto" a model computes in float64 when it has at most this many
# touches, or when float32 is good enough for less than this share of its pairs.
SMALL = 256
MOSTLY = 0.9
# More touches than this are stored in single precision, unless "double" was asked for.
MANY = 100_000
# Touches looked at at once, so that memory stays bounded.
_AT_ONCE = 65_536
# Stored touches of one matrix product.
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


class KernelDensityBayes(BayesRule):
    """Bayes classifier with a Gaussian kernel density for every object.

    Parameters
    ----------
    bandwidth : {"pooled", "per-object", "full"}, default="pooled"
        Covariance of the Gaussians: the diagonal of the variances of all training
        touches together; the diagonal of the object's own variances; or the full
        covariance of all training touches together.
    scale : float, default=1.0
        Factor on the standard deviations: the covariance is multiplied by scale^2.
    prior : {"uniform", "counts"}, default="uniform"
        Objects are equally probable before the touch, or in proportion to their
        number of training touches.
    min_variance : float, default=1e-3
        With "per-object", an object's variance of a feature is at least this share
        of the pooled one. An object that was touched once takes the pooled ones.
    precision : {"auto", "single", "double"}, default="auto"
        Precision of the matrix products; "auto" is single, but double for at most
        256 touches and for bandwidths so narrow that single rarely suffices. It is
        decided in `fit`. Sums and densities are always float64.

    Attributes
    ----------
    classes_ : ndarray of shape (n_objects,)
        The labels, sorted; the columns of `log_likelihood`.
    counts_ : ndarray of int, shape (n_objects,)
        Training touches of each object.
    centre_, spread_, varies_ : ndarray of shape (n_features,)
        Mean and standard deviation of the training touches, and whether the feature
        varied at all among them.
    rotation_ : ndarray of shape (n_varying, n_directions) or None
        With "full", turns standardised features into uncorrelated directions.
    log_volume_ : float
        Logarithm of the volume of a cell with one standard deviation a side.
    points_ : ndarray of shape (n_touches, n_directions)
        Training touches in bandwidths, object by object.
    order_, groups_ : ndarray of int, shape (n_touches,)
        Which of the touches given to `fit` each of them is; and of those the groups.
    means_ : ndarray of shape (n_objects, n_directions)
        Mean of each object's `points_`.
    precisions_ : ndarray of shape (n_objects, n_directions) or None
        With "per-object", the pooled variance over the object's own.
    log_norms_ : ndarray of shape (n_objects,)
        Logarithm of what each sum of exponentials is multiplied by.
    dtype_ : {"float32", "float64"}
        Type of the matrix products.
    tiles_, reaches_ : ndarray
        The same touches packed for matrix products, and how far they reach.

    Notes
    -----
    log p(x | object) = log mean_i N(x; y_i, W), y_i the object's training touches.
    The paper [1]_ calls W "the covariance of X_C" in one place and "the covariance
    matrix of all training points" in another; the first is `"per-object"`, the second
    the default. Variances are unbiased (n - 1).

    What does not vary says nothing: features (with "full", also directions) that are
    constant up to rounding over all training touches are left out of the density. If
    no feature varies, every log-likelihood is 0.

    `refit` leaves `centre_`, `spread_` and `rotation_` as `fit` learnt them, so the
    likelihoods of objects whose touches stay are the same to the bit.

    In single precision the error of a log-likelihood is at most 1e-3 nats: pairs of
    touch and object for which rounding could do worse, because they are far apart or
    the bandwidth is narrow, are computed by float64 differences. (Beyond 1e9 nats
    the float64 result itself ends.) On 1,453 real touches with scale 1 it was at most
    6e-5 nats. A touch recognised alone and in a batch may differ by as much.

    References
    ----------
    .. [1] T. Corradi, P. Hall and P. Iravani, "Bayesian tactile object recognition:
       learning and recognising objects using a new inexpensive tactile sensor",
       ICRA 2015. doi:10.1109/ICRA.2015.7139744

    Examples
    --------
    >>> from palpate.classifiers import KernelDensityBayes
    >>> touches = [[0.0, 0.1], [0.1, 0.0], [1.0, 0.9], [0.9, 1.0]]
    >>> model = KernelDensityBayes().fit(touches, ["pen", "pen", "mug", "mug"])
    >>> model.predict([[4, 0], [0, 0]])
    array(['mug', 'pen'], dtype='<U3')
    """

    classes_: Array
    counts_: Indices
    points_: Floats
    log_norms_: Floats

    def __init__(
        self,
        bandwidth: str = "pooled",
        scale: float = 1.0,
        prior: str = "uniform",
        min_variance: float = 1e-3,
        precision: str = "auto",
    ) -> None:
        self.bandwidth = bandwidth
        self.scale = scale
        self.prior = prior
        self.min_variance = min_variance
        self.precision = precision

    def fit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Store touches `X` (n_touches, n_features) of every object in `y`.

        Parameters are those of `TouchClassifier.fit`.

        Raises
        ------
        ValueError
            For NaN, infinity, variances that overflow, or unequal lengths.
        """
        check_option("bandwidth", self.bandwidth, ("pooled", "per-object", "full"))
        check_positive("scale", self.scale)
        check_option("prior", self.prior, ("uniform", "counts"))
        check_number("min_variance", self.min_variance, low=1e-12)
        check_option("precision", self.precision, ("auto", "single", "double"))
        touches, labels = labelled_touches(self, X, y)
        self.centre_, self.spread_, self.varies_, self.rotation_, self.log_volume_ = (
            learn_whitening(touches, full=self.bandwidth == "full")
        )
        self.dtype_ = "float64" if self.precision == "double" else "float32"
        self._learn(touches, labels, groups)
        if self.precision == "auto":
            n_precise = sum(
                is_precise(self.points_[rows], self.reaches_, self.dtype_).sum()
                for rows in gen_batches(len(self.points_), _AT_ONCE)
            )
            n_pairs = len(self.points_) * len(self.counts_)
            if len(self.points_) <= SMALL or n_precise < MOSTLY * n_pairs:
                self.dtype_ = "float64"
                self._store(self.points_, self.counts_)
        return self

    def refit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Store other touches in the bandwidth and precision that `fit` chose.

        The likelihoods of objects whose touches are as before stay the same to the bit,
        so objects are learnt and forgotten one by one. Parameters and errors as of
        `fit`.
        """
        touches, labels = labelled_touches(self, X, y, reset=False)
        self._learn(touches, labels, groups)
        return self

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) in nats, shape (n_touches, n_objects)."""
        x = self._whiten(as_touches(self, X))
        return np.vstack([self._log_densities(x[rows]) for rows in blocks_of(len(x))])

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of the training touches, each without its group.

        Returns
        -------
        ndarray of shape (n_training_touches, n_objects)
            Rows as they were given to `fit`. Bandwidths stay as learnt from all
            touches. An object with no touch left gets minus infinity.
        """
        check_is_fitted(self)
        group = self.groups_[self.order_]
        blocks = blocks_of(len(group))
        result = np.vstack([self._log_densities(self.points_[b]) for b in blocks])
        for place, rows in enumerate(self._rows()):
            met = np.isin(group, group[rows])
            # One object's densities at touches `met`, without their groups.
            groups, points = (group[met], group[rows]), self.points_[rows]
            precision = self._precision(place)
            sums = exact_log_sums(self.points_[met], points, precision, groups)
            n_left_out = np.bincount(group[rows], minlength=group.max() + 1)[groups[0]]
            share = (self.counts_[place] - n_left_out) / self.counts_[place]
            densities = sums + self.log_norms_[place]
            densities[share > 0] -= np.log(share[share > 0])
            result[met, place] = densities
        in_order = np.empty_like(result)
        in_order[self.order_] = result
        return in_order

    def _whiten(self, touches: Floats) -> Floats:
        """Return touches in bandwidths from the centre of all training touches."""
        bandwidth = self.spread_ * self.scale
        return whiten(touches, self.centre_, bandwidth, self.varies_, self.rotation_)

    def _learn(self, touches: Floats, labels: Array, groups: Groups) -> None:
        """Store touches object by object, each object whitened by itself."""
        self.groups_ = as_groups(groups, len(touches))
        self.classes_, codes = np.unique(labels, return_inverse=True)
        self.order_ = np.argsort(codes, kind="stable")
        counts = np.bincount(codes)
        parts = np.split(self.order_, np.cumsum(counts)[:-1])
        few = len(touches) <= MANY or self.precision == "double"
        dtype = "float64" if few else "float32"
        whitened = (self._whiten(touches[rows]).astype(dtype) for rows in parts)
        self._store(np.concatenate([*whitened]), counts)

    def _rows(self) -> list[slice]:
        """Return where each object's touches stand in `points_`."""
        ends = np.cumsum(self.counts_)
        return [slice(e - n, e) for e, n in zip(ends, self.counts_, strict=True)]

    def _store(self, points: Floats, counts: Indices) -> None:
        self.points_, self.counts_ = points, counts
        parts = [points[rows] for rows in self._rows()]
        self.means_ = np.array([part.mean(axis=0, dtype=np.float64) for part in parts])
        self.precisions_ = None
        log_shape = np.zeros(len(parts))
        if self.bandwidth == "per-object":
            self.precisions_ = np.array([self._own_precision(p) for p in parts])
            log_shape = np.log(self.precisions_).sum(axis=1) / 2
        log_unit = np.log(self.scale) + np.log(2 * np.pi) / 2
        log_cell = self.log_volume_ + points.shape[1] * log_unit
        self.log_norms_ = log_shape - log_cell - np.log(counts)
        ends = np.cumsum(count_tiles(counts))
        self.tiles_ = np.empty((ends[-1], TILE, points.shape[1] + 1), self.dtype_)
        self.reaches_ = np.empty((len(parts), 2))
        for place, part in enumerate(parts):
            tiles, reach = make_tiles(part, self._precision(place), self.dtype_)
            self.tiles_[ends[place] - len(tiles) : ends[place]] = tiles
            self.reaches_[place] = reach

    def _own_precision(self, points: Floats) -> Floats:
        """Return pooled over own variances of one object, (n_directions,)."""
        if len(points) == 1:
            return np.ones(points.shape[1])
        variances = points.var(axis=0, ddof=1) * self.scale**2
        return np.asarray(1 / np.maximum(variances, self.min_variance))

    def _precision(self, place: int) -> Floats | None:
        return None if self.precisions_ is None else self.precisions_[place]

    def _log_densities(self, x: Floats) -> Floats:
        """Return log p(touch | object) of at most 64 whitened touches."""
        sums = tile_log_sums(x, self.tiles_, count_tiles(self.counts_))
        sums -= squared_distances(x, self.means_, self.precisions_) / 2
        rough = ~is_precise(x, self.reaches_, self.dtype_)
        for place in np.flatnonzero(rough.any(axis=0)).tolist():
            pairs, points = rough[:, place], self.points_[self._rows()[place]]
            precision = self._precision(place)
            sums[pairs, place] = exact_log_sums(x[pairs], points, precision)
        return sums + self.log_norms_


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
