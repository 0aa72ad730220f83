"""Multiple kernel learning for very many touches: kernels through landmarks.

Each kernel is replaced by its Nystroem approximation from the same few landmarks:
features whose inner products are the kernel as the landmarks see it. The problem
and its interior point stay the same; only Newton's system is solved in the space of
the features, so time and memory grow linearly with the touches. With every touch a
landmark, the machine is the exact one.
"""

from collections.abc import Iterator, Sequence
from typing import Self

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray
from scipy.linalg import eigh

from ._kernels import Kernel, kernel_diagonals, kernel_stack
from ._mkl_banks import kernel_scales, refuse_overflow
from ._mkl_problem import Floats, Pull, Solution, Solver, row_blocks
from ._mkl_systems import cholesky_solver

# Directions of a kernel below this share of its largest are rounding.
_RANK_TOLERANCE = 1e-10
# Features of up to this size are kept; larger ones are computed again block by block.
_KEPT_BYTES = 2**30
# Touches per dimension from which on margins cannot all be met.
_CROWD = 3
# Corrections of a solution by what it misses, and the share it may miss.
_REFINEMENTS, _EXACT = 3, 1e-11


class LandmarkFeatures:
    """Nystroem features of several kernels, from one matrix of distances.

    Parameters
    ----------
    kernels : sequence of kernels
    landmarks : ndarray of shape (n_landmarks, n_features)
        Less `mean`.
    mean : ndarray of shape (n_features,)
    maps : list of ndarray of shape (n_landmarks, rank)
        From kernel values at the landmarks to features, one per kernel.
    """

    def __init__(
        self,
        kernels: Sequence[Kernel],
        landmarks: Floats,
        mean: Floats,
        maps: list[Floats],
    ) -> None:
        self.kernels, self.landmarks, self.mean, self.maps = (
            kernels,
            landmarks,
            mean,
            maps,
        )
        self.ranks = np.array([one.shape[1] for one in maps])

    def __call__(self, centred: Floats) -> Floats:
        """Return features, shape (n_touches, sum of ranks), kernel by kernel."""
        stack = kernel_stack(self.kernels, centred, self.landmarks, self.mean)
        both = zip(stack, self.maps, strict=True)
        return np.concatenate([kernel @ one for kernel, one in both], axis=1)

    def values_per_touch(self) -> int:
        """How many numbers one touch needs while its features are made."""
        n_landmarks = len(self.landmarks)
        return int(n_landmarks * (len(self.kernels) + 2) + 2 * self.ranks.sum())


class NystroemBank:
    """A bank of approximate kernels over training touches.

    Parameters
    ----------
    kernels : sequence of kernels
    touches : ndarray of shape (n_touches, n_features)
    normalize : {"trace", "variance", None}
    n_landmarks : int
        Landmarks, drawn from the touches without replacement.
    random : RandomState
    """

    n_folds = 1

    def __init__(
        self,
        kernels: Sequence[Kernel],
        touches: Floats,
        normalize: str | None,
        n_landmarks: int,
        random: RandomState,
    ) -> None:
        self.kernels, self.n_touches = kernels, len(touches)
        self.mean = touches.mean(axis=0)
        self.centred = touches - self.mean
        diagonals = kernel_diagonals(kernels, self.centred, self.mean)
        refuse_overflow(kernels, diagonals)
        drawn = random.permutation(self.n_touches)[:n_landmarks]
        landmarks = self.centred[np.sort(drawn)]
        stack = kernel_stack(kernels, landmarks, landmarks, self.mean)
        maps = [_whitening(kernel) for kernel in stack]
        self.features = LandmarkFeatures(kernels, landmarks, self.mean, maps)
        mean = self._mean_kernel() if normalize == "variance" else None
        self.scales = kernel_scales(diagonals, mean, normalize)
        for one, scale in zip(maps, self.scales, strict=True):
            one *= np.sqrt(scale)

    @property
    def n_columns(self) -> int:
        """Coefficients of a machine: one per feature."""
        return int(self.features.ranks.sum())

    def batch_size(self, n_touches: int) -> int:
        """One problem at a time."""
        return 1

    def system(self, index: NDArray, labels: Floats) -> "LowRankKernels":
        return LowRankKernels(self.features, self.centred[index[0]], labels)

    def coefficients(
        self, system: "LowRankKernels", index: NDArray, solution: Solution
    ) -> Floats:
        """Return the normal vector of the machine, shape (1, n_columns)."""
        return system.normal(solution.alpha, solution.weights)[None]

    def _mean_kernel(self) -> Floats:
        """Mean of each approximate kernel matrix: the squared mean feature."""
        total = np.zeros(self.n_columns)
        for rows in row_blocks(self.n_touches, self.features.values_per_touch()):
            total += self.features(self.centred[rows]).sum(axis=0)
        starts = np.cumsum(self.features.ranks) - self.features.ranks
        squared: Floats = np.add.reduceat((total / self.n_touches) ** 2, starts)
        return squared


class LowRankKernels:
    """Kernels of one problem as inner products of features.

    Parameters
    ----------
    features : LandmarkFeatures
    centred : ndarray of shape (n_touches, n_features)
        Touches less the mean.
    labels : ndarray of shape (1, n_touches)
    kept : ndarray of shape (n_touches, n_columns), optional
        Features already computed.
    """

    def __init__(
        self,
        features: LandmarkFeatures,
        centred: Floats,
        labels: Floats,
        kept: Floats | None = None,
    ) -> None:
        self._features, self._centred, self.labels = features, centred, labels
        ends = np.cumsum(features.ranks)
        self._slices = [
            slice(end - rank, end)
            for end, rank in zip(ends, features.ranks, strict=True)
        ]
        self._kept = kept
        if kept is None and 8 * len(centred) * ends[-1] <= _KEPT_BYTES:
            self._kept = np.empty((len(centred), ends[-1]))
            for rows in self._rows():
                self._kept[rows] = features(centred[rows])
        self._pull = np.zeros(ends[-1])
        self.crowded = len(centred) > _CROWD * ends[-1]

    @property
    def n_kernels(self) -> int:
        return len(self._slices)

    def forces(self, alpha: Floats) -> Floats:
        self._pull = self._gather((self.labels * alpha)[0])
        forces = np.empty((1, self.n_kernels, len(self._centred)))
        for rows, block in self._blocks():
            for k, columns in enumerate(self._slices):
                forces[0, k, rows] = block[:, columns] @ self._pull[columns]
        forces *= self.labels[:, None, :]
        return forces

    def factorise(self, diagonal: Floats, weights: Floats, pull: Pull) -> Solver:
        ease = 1 / diagonal[0]
        matrix = self._inner(weights[0], pull)
        for rows, block in self._blocks():
            root = np.sqrt(ease[rows]) * np.abs(self.labels[0, rows])
            scaled = block * root[:, None]
            matrix += scaled.T @ scaled
        inner = cholesky_solver(matrix)

        def apply(columns: Floats) -> Floats:
            pulled = pull.times_root(pull.forces)[0]
            return self._times(columns, diagonal[0], weights[0], pulled)

        def roughly(right: Floats) -> Floats:
            eased = ease[:, None] * right
            moved = inner(self._gather(self.labels.T * eased))
            return eased - ease[:, None] * self.labels.T * self._spread(moved)

        def solve(right: Floats) -> Floats:
            solved = roughly(right[0])
            enough = _EXACT * np.abs(right[0]).max()
            for _ in range(_REFINEMENTS):
                missing = right[0] - apply(solved)
                if not np.abs(missing).max() > enough:
                    break
                solved += roughly(missing)
            return solved[None]

        return solve

    def _times(
        self, columns: Floats, diagonal: Floats, weights: Floats, pulled: Floats
    ) -> Floats:
        """Newton's matrix times `columns`."""
        stretched = np.repeat(weights, self._features.ranks)[:, None]
        inside = self._spread(stretched * self._gather(self.labels.T * columns))
        product: Floats = diagonal[:, None] * columns + self.labels.T * inside
        return product + pulled.T @ (pulled @ columns)

    def _inner(self, weights: Floats, pull: Pull) -> Floats:
        """Inverse of diag(d) + O R R' O', O holding each kernel's pull in a column.

        That matrix is Newton's without its diagonal, in the space of the features;
        its inverse follows from the few columns of O R.
        """
        ranks = self._features.ranks
        stretched = np.repeat(1 / weights, ranks)
        rows = np.zeros((1, self.n_kernels, len(self._pull)))
        lengths = np.empty(self.n_kernels)
        for k, columns in enumerate(self._slices):
            rows[0, k, columns] = self._pull[columns] / weights[k]
            lengths[k] = self._pull[columns] @ rows[0, k, columns]
        thin = pull.times_root(rows)[0]
        half = pull.times_root(np.diag(lengths)[None])
        small = pull.times_root(half.transpose(0, 2, 1))[0] + np.eye(self.n_kernels)
        matrix: Floats = -thin.T @ np.linalg.solve(small, thin)
        matrix[np.diag_indices_from(matrix)] += stretched
        return matrix

    def decisions(self, alpha: Floats, weights: Floats) -> Floats:
        return self._spread(self.normal(alpha, weights)[:, None]).T

    def normal(self, alpha: Floats, weights: Floats) -> Floats:
        """Return the normal vector of the hyperplane, shape (n_columns,)."""
        pulled = self._gather((self.labels * alpha)[0])
        normal: Floats = np.repeat(weights[0], self._features.ranks) * pulled
        return normal

    def with_labels(self, labels: Floats) -> Self:
        return type(self)(self._features, self._centred, labels, self._kept)

    def take(self, keep: NDArray) -> Self:
        if len(keep) != 1 or not np.asarray(keep).all():
            raise IndexError("A low-rank system holds one problem.")
        return self

    def _gather(self, columns: Floats) -> Floats:
        """Features' times `columns`, which have a row per touch."""
        total = np.zeros((len(self._pull), *columns.shape[1:]))
        for rows, block in self._blocks():
            total += block.T @ columns[rows]
        return total

    def _spread(self, columns: Floats) -> Floats:
        """Features times `columns`, which have a row per feature."""
        parts = [block @ columns for _, block in self._blocks()]
        return np.concatenate(parts)

    def _rows(self) -> Iterator[slice]:
        return row_blocks(len(self._centred), self._features.values_per_touch())

    def _blocks(self) -> Iterator[tuple[slice, Floats]]:
        for rows in self._rows():
            if self._kept is not None:
                yield rows, self._kept[rows]
            else:
                yield rows, self._features(self._centred[rows])


def _whitening(kernel: Floats) -> Floats:
    """Return W with W W' the inverse of the kernel on its own directions."""
    values, vectors = eigh(kernel)
    real = values > _RANK_TOLERANCE * max(values[-1], np.finfo(float).tiny)
    if not real.any():
        return np.zeros((len(kernel), 1))
    whitening: Floats = vectors[:, real] / np.sqrt(values[real])
    return whitening
