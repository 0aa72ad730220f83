"""An index over very many stored touches: rough far away, exact where it matters.

The touches of each object are cut into cells. For a new touch, every cell answers in
closed form as if its touches were normally distributed about their mean. Of the
objects that come out most probable, the cells that contribute most are then summed
touch by touch. Worth while from some 10^5 stored touches on; below, the exact sum is
as fast.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import softmax
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count
from .._extras import needed
from .._numbers import exp
from .._types import Array, Floats, Indices, Singles
from ._kernel_density import (
    KernelDensityBayes,
    blocks_of,
    exact_log_sums,
    is_precise,
    make_tiles,
    squared_distances,
)
from ._touch_classifier import as_touches

TOUCHES_PER_CELL = 8
MOST_CELLS = 256
# Largest error (nats) that rounding may cause before a pair is computed exactly.
MAX_ERROR = 0.05
_ROUNDS = 8
_TAUGHT_PER_CELL = 64


class IndexQuality(NamedTuple):
    """How an index compares with the exact sums, measured on some touches.

    Attributes
    ----------
    n_touches : int
        On how many.
    equal_decisions : float
        Share of touches whose most probable object is the same.
    error_of_best_nats : float
        Largest error in the log-likelihood of the object that is truly most probable.
    error_nats : float
        Error in the log-likelihoods of all objects that 99 % of them stay below.
    error_of_posterior : float
        Largest error in any posterior probability (equal priors).
    """

    n_touches: int
    equal_decisions: float
    error_of_best_nats: float
    error_nats: float
    error_of_posterior: float


class KernelDensityIndex:
    """Log-likelihoods of `KernelDensityBayes` at a fraction of the cost.

    Needs faiss: `pip install palpate[index]`.

    Parameters
    ----------
    model : KernelDensityBayes
        Fitted; when it learns or forgets an object, make a new index.
    n_exact : int, default=3
        How many of the most probable objects are summed touch by touch...
    n_near : int, default=16
        ...in so many of their cells, those that contribute most.
    n_cells : int, optional
        Cells per object; by default one for 8 touches, at most 256.
    random_state : int, default=0
        Seed of the cells.

    Attributes
    ----------
    classes_ : ndarray of shape (n_objects,)
        The labels, as in `model`.
    weights_ : ndarray of shape (2 * n_directions + 1, n_cells in all)
        Cell by cell, what [x^2, x, 1] is multiplied by.
    starts_ : ndarray of int, shape (n_objects,)
        First cell of each object.
    packed_ : ndarray of float32, shape (n_touches, n_directions + 1)
        The stored touches, object by object and cell by cell, see `make_tiles`.
    ends_ : ndarray of int, shape (n_cells in all,)
        Where each cell ends in `packed_`.

    Notes
    -----
    A cell of n touches with mean m and variances v adds up, as a normal density would,
    to n prod (1 + P v)^(-1/2) exp(-(x - m)^2 P / (1 + P v) / 2) per direction, P being
    the model's precision (1 unless "per-object"). That error has no useful bound in
    advance; `quality` measures it.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> touches = rng.normal(size=(400, 3)) + 4 * np.repeat([[0], [1]], 200, axis=0)
    >>> model = KernelDensityBayes().fit(touches, ["pen"] * 200 + ["mug"] * 200)
    >>> index = KernelDensityIndex(model)  # doctest: +SKIP
    >>> index.quality(touches).equal_decisions  # doctest: +SKIP
    1.0
    """

    def __init__(
        self,
        model: KernelDensityBayes,
        *,
        n_exact: int = 3,
        n_near: int = 16,
        n_cells: int | None = None,
        random_state: int = 0,
    ) -> None:
        check_is_fitted(model)
        self.model = model
        self.n_exact = min(check_count("n_exact", n_exact), len(model.classes_))
        most = MOST_CELLS if n_cells is None else check_count("n_cells", n_cells)
        self.classes_ = model.classes_
        self.n_near = check_count("n_near", n_near)
        seed = check_count("random_state", random_state, at_least=0, at_most=2**31 - 1)
        faiss = needed("faiss", "index", "KernelDensityIndex")
        weights, packed, sizes = [], [], []
        for place, rows in enumerate(self.model._rows()):
            points, precision = model.points_[rows], model._precision(place)
            count = most if n_cells is not None else -(-len(points) // TOUCHES_PER_CELL)
            cell = _cells(faiss, points, min(count, most, len(points)), seed)
            weights.append(_weights(points, cell, precision))
            tiles = make_tiles(points, precision, "float32")[0]
            flat = tiles.reshape(-1, tiles.shape[2])[: len(points)]
            packed.append(flat[np.argsort(cell, kind="stable")])
            sizes.append(np.bincount(cell))
        self.weights_ = np.concatenate(weights, axis=1)
        self.packed_ = np.concatenate(packed)
        self.starts_ = np.cumsum([0, *map(len, sizes[:-1])])
        self.ends_ = np.cumsum(np.concatenate(sizes))

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) in nats, shape (n_touches, n_objects).

        Most exact for the `n_exact` most probable objects of each touch.
        """
        model, touches = self.model, as_touches(self.model, X)
        result = np.empty((len(touches), len(self.classes_)))
        for rows in blocks_of(len(touches)):
            x = model._whiten(touches[rows])
            ones = np.ones((len(x), 1))
            cells = np.hstack([x**2, x, ones]).astype(np.float32) @ self.weights_
            # The log of the sum over the cells of each object.
            top = np.maximum.reduceat(cells, self.starts_, axis=1)
            counts = np.diff(np.append(self.starts_, cells.shape[1]))
            relative = exp(cells - np.repeat(top, counts, axis=1))
            totals = np.add.reduceat(relative, self.starts_, axis=1)
            sums = top.astype(np.float64) + np.log(totals) + model.log_norms_
            kept = np.argpartition(-sums, self.n_exact - 1, axis=1)[:, : self.n_exact]
            shared = squared_distances(x, model.means_, model.precisions_) / 2
            precise = is_precise(x, model.reaches_, "float32", MAX_ERROR)
            extended = np.hstack([x, ones]).astype(np.float32)
            for row, place in (
                (r, p) for r, places in enumerate(kept.tolist()) for p in places
            ):
                if precise[row, place]:
                    log_sum = self._refined(
                        extended[row], place, cells[row], shared[row]
                    )
                else:
                    points = model.points_[model._rows()[place]]
                    precision = model._precision(place)
                    log_sum = exact_log_sums(x[row : row + 1], points, precision)[0]
                sums[row, place] = log_sum + model.log_norms_[place]
            result[rows] = sums
        return result

    def quality(self, X: ArrayLike) -> IndexQuality:
        """Compare with the exact sums on touches that were not learnt."""
        exact, rough = self.model.log_likelihood(X), self.log_likelihood(X)
        best = exact.argmax(axis=1)
        row = np.arange(len(best))
        error = np.abs(rough - exact)
        off = np.abs(softmax(rough, axis=1) - softmax(exact, axis=1))
        return IndexQuality(
            len(best),
            float((rough.argmax(axis=1) == best).mean()),
            float(error[row, best].max()),
            float(np.quantile(error, 0.99)),
            float(off.max()),
        )

    def _refined(self, x: Singles, place: int, cells: Array, shared: Floats) -> float:
        """Return the log sum of one object: near cells by touch, far ones rough."""
        first = self.starts_[place]
        of_object = cells[first : np.append(self.starts_, len(cells))[place + 1]]
        n_near = min(self.n_near, len(of_object))
        order = np.argpartition(-of_object, n_near - 1)
        nearest = first + order[:n_near]
        ends = self.ends_[nearest]
        begins = np.where(nearest > 0, self.ends_[nearest - 1], 0)
        near = np.concatenate(
            [self.packed_[b:e] @ x for b, e in zip(begins, ends, strict=True)]
        )
        total = np.logaddexp.reduce(near) - shared[place]
        if n_near < len(of_object):
            total = np.logaddexp(total, np.logaddexp.reduce(of_object[order[n_near:]]))
        return float(total)


def _cells(faiss: Any, points: Floats, n_cells: int, seed: int) -> Indices:
    """Return the cell of each point, by k-means on some of them."""
    single = np.ascontiguousarray(points, dtype=np.float32)
    means = faiss.Kmeans(
        single.shape[1],
        n_cells,
        niter=_ROUNDS,
        seed=seed,
        min_points_per_centroid=1,
        max_points_per_centroid=_TAUGHT_PER_CELL,
    )
    means.train(single)
    nearest: Indices = means.index.search(single, 1)[1][:, 0]
    return np.unique(nearest, return_inverse=True)[1]


def _weights(points: Floats, cell: Indices, precision: Floats | None) -> Singles:
    """Return what [x^2, x, 1] is multiplied by, (2 * n_directions + 1, n_cells)."""
    order = np.argsort(cell, kind="stable")
    counts = np.bincount(cell)
    starts = np.cumsum(counts) - counts
    means = np.add.reduceat(points[order], starts) / counts[:, np.newaxis]
    squares = np.add.reduceat((points - means[cell])[order] ** 2, starts)
    sharpness = np.ones(points.shape[1]) if precision is None else precision
    spread = 1 + sharpness * squares / counts[:, np.newaxis]
    sharp = sharpness / spread
    level = np.log(counts) - np.log(spread).sum(axis=1) / 2
    level -= (means**2 * sharp).sum(axis=1) / 2
    weights = np.vstack([-sharp.T / 2, (means * sharp).T, level])
    return weights.astype(np.float32)
