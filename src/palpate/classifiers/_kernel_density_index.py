"""An index over very many stored touches: rough for all objects, exact for the likely.

The touches of each object are cut into cells. For a new touch, every cell answers in
closed form as if its touches were normally distributed about their mean; the objects
that come out most probable are then summed exactly. Worth while from some 10^5 stored
touches on; below, the exact sum is as fast.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count
from ._inputs import Floats, as_touches
from ._kernel_density import KernelDensityBayes
from ._kernel_sums import (
    blocks_of,
    count_tiles,
    exact_log_sums,
    is_precise,
    squared_distances,
    tile_log_sums,
)

TOUCHES_PER_CELL = 64
MOST_CELLS = 256
_ROUNDS = 8


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
        How many of the most probable objects are summed exactly.
    n_cells : int, optional
        Cells per object; by default one for 64 touches, at most 256.
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
        n_cells: int | None = None,
        random_state: int = 0,
    ) -> None:
        check_is_fitted(model)
        self.model = model
        self.n_exact = min(check_count("n_exact", n_exact), len(model.classes_))
        most = MOST_CELLS if n_cells is None else check_count("n_cells", n_cells)
        self.classes_ = model.classes_
        faiss = _faiss()
        parts: list[NDArray] = []
        starts = [0]
        for place, rows in enumerate(self.model._rows()):
            points = model.points_[rows]
            count = most if n_cells is not None else -(-len(points) // TOUCHES_PER_CELL)
            cell = _cells(faiss, points, min(count, most, len(points)), random_state)
            parts.append(_weights(points, cell, model._precision(place)))
            starts.append(starts[-1] + parts[-1].shape[1])
        self.weights_ = np.concatenate(parts, axis=1)
        self.starts_ = np.array(starts[:-1])

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) in nats, shape (n_touches, n_objects).

        Exact for the `n_exact` most probable objects of each touch.
        """
        touches = as_touches(self.model, X)
        result = np.empty((len(touches), len(self.classes_)))
        for rows in blocks_of(len(touches)):
            result[rows] = self._of_block(self.model._whiten(touches[rows]))
        return result

    def quality(self, X: ArrayLike) -> IndexQuality:
        """Compare with the exact sums on touches that were not learnt."""
        exact, rough = self.model.log_likelihood(X), self.log_likelihood(X)
        best = exact.argmax(axis=1)
        row = np.arange(len(best))
        error = np.abs(rough - exact)
        off = np.abs(_posterior(rough) - _posterior(exact))
        return IndexQuality(
            len(best),
            float((rough.argmax(axis=1) == best).mean()),
            float(error[row, best].max()),
            float(np.quantile(error, 0.99)),
            float(off.max()),
        )

    def _of_block(self, x: Floats) -> Floats:
        sums = self._rough(x) + self.model.log_norms_
        kept = np.argpartition(-sums, self.n_exact - 1, axis=1)[:, : self.n_exact]
        for place in np.unique(kept).tolist():
            rows = np.flatnonzero((kept == place).any(axis=1))
            sums[rows, place] = self._exact(x[rows], place)
        return sums

    def _rough(self, x: Floats) -> Floats:
        one = np.ones((len(x), 1))
        exponents = np.hstack([x**2, x, one]).astype(np.float32) @ self.weights_
        top = np.maximum.reduceat(exponents, self.starts_, axis=1)
        counts = np.diff(np.append(self.starts_, exponents.shape[1]))
        exponents -= np.repeat(top, counts, axis=1)
        np.exp(exponents, out=exponents)
        sums = np.add.reduceat(exponents, self.starts_, axis=1)
        result: Floats = top.astype(np.float64) + np.log(sums)
        return result

    def _exact(self, x: Floats, place: int) -> Floats:
        """Return log densities of one object, as the model itself computes them."""
        model, one = self.model, slice(place, place + 1)
        ends = np.cumsum(count_tiles(model.counts_))
        first = 0 if place == 0 else ends[place - 1]
        tiles = model.tiles_[first : ends[place]]
        precision = model._precision(place)
        shared = None if precision is None else precision[np.newaxis]
        sums = tile_log_sums(x, tiles, np.array([len(tiles)]))[:, 0]
        sums -= squared_distances(x, model.means_[one], shared)[:, 0] / 2
        rough = ~is_precise(x, model.reaches_[one], model.dtype_)[:, 0]
        if rough.any():
            points = model.points_[model._rows()[place]]
            sums[rough] = exact_log_sums(x[rough], points, precision)
        result: Floats = sums + model.log_norms_[place]
        return result


def _faiss() -> Any:
    try:
        import faiss
    except ImportError as error:
        raise ImportError(
            "KernelDensityIndex needs the package 'faiss', which is not installed: "
            "pip install palpate[index]"
        ) from error
    return faiss


def _cells(faiss: Any, points: Floats, n_cells: int, seed: int) -> NDArray[np.intp]:
    """Return the cell of each point, by k-means on some of them."""
    single = np.ascontiguousarray(points, dtype=np.float32)
    means = faiss.Kmeans(
        single.shape[1],
        n_cells,
        niter=_ROUNDS,
        seed=seed,
        min_points_per_centroid=1,
        max_points_per_centroid=TOUCHES_PER_CELL,
    )
    means.train(single)
    nearest: NDArray[np.intp] = means.index.search(single, 1)[1][:, 0]
    return np.unique(nearest, return_inverse=True)[1]


def _weights(
    points: Floats, cell: NDArray[np.intp], precision: Floats | None
) -> NDArray[np.float32]:
    """Return what [x^2, x, 1] is multiplied by, (2 * n_directions + 1, n_cells)."""
    order = np.argsort(cell, kind="stable")
    counts = np.bincount(cell)
    starts = np.cumsum(counts) - counts
    means = np.add.reduceat(points[order], starts) / counts[:, np.newaxis]
    squares = np.add.reduceat((points - means[cell])[order] ** 2, starts)
    own = np.ones(points.shape[1]) if precision is None else precision
    spread = 1 + own * squares / counts[:, np.newaxis]
    sharp = own / spread
    level = np.log(counts) - np.log(spread).sum(axis=1) / 2
    level -= (means**2 * sharp).sum(axis=1) / 2
    weights = np.vstack([-sharp.T / 2, (means * sharp).T, level])
    return weights.astype(np.float32)


def _posterior(log_likelihood: Floats) -> Floats:
    shifted = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    result: Floats = shifted / shifted.sum(axis=1, keepdims=True)
    return result
