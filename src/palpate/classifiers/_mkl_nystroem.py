"""Kernels through landmarks, for very many touches.

Each kernel is replaced by its Nystroem approximation from the same few landmarks:
features whose inner products are the kernel as the landmarks see it. The problem
stays the same, and time and memory grow linearly with the touches. With every touch a
landmark, the machine is the exact one.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray
from scipy.linalg import eigh

from ._kernels import Kernel, kernel_diagonals, kernel_stack
from ._mkl_banks import kernel_scales, refuse_overflow
from ._mkl_primal import LowRankKernels
from ._mkl_problem import Floats, Solution, row_blocks
from ._mkl_systems import DenseKernels

# Directions of a kernel below this share of its largest are rounding.
_RANK_TOLERANCE = 1e-10
# Features of up to this size are kept; larger ones are computed again block by block.
_KEPT_BYTES = 2**30


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
        self.kernels, self.landmarks = kernels, landmarks
        self.mean, self.maps = mean, maps
        self.ranks = [one.shape[1] for one in maps]

    def __call__(self, centred: Floats) -> Floats:
        """Return features, shape (n_touches, sum of ranks), kernel by kernel."""
        stack = kernel_stack(self.kernels, centred, self.landmarks, self.mean)
        both = zip(stack, self.maps, strict=True)
        return np.concatenate([kernel @ one for kernel, one in both], axis=1)

    def blocks(self, centred: Floats) -> Iterator[tuple[slice, Floats]]:
        """Yield slices of touches and their features, a few at a time."""
        per_kernel = len(self.landmarks) * (len(self.kernels) + 2)
        for rows in row_blocks(len(centred), per_kernel + 2 * sum(self.ranks)):
            yield rows, self(centred[rows])


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
        return sum(self.features.ranks)

    def batch_size(self, n_touches: int) -> int:
        """One problem at a time."""
        return 1

    def system(self, index: NDArray, labels: Floats) -> LowRankKernels | DenseKernels:
        """Return one problem, by features or, where it is small, by matrices."""
        centred, ranks = self.centred[index[0]], self.features.ranks
        n_bytes = 8 * len(centred) * self.n_columns
        if n_bytes > _KEPT_BYTES:
            return self._again_and_again(centred, labels)
        features = np.empty((len(centred), self.n_columns))
        for rows, part in self.features.blocks(centred):
            features[rows] = part
        mean = features.mean(axis=0)
        features -= mean
        if len(centred) <= self.n_columns and len(ranks) * n_bytes <= _KEPT_BYTES:
            parts = np.split(features, np.cumsum(ranks)[:-1], axis=1)
            stack = np.stack([part @ part.T for part in parts])
            return DenseKernels(stack[None], labels)

        def blocks() -> Iterator[tuple[slice, Floats]]:
            for rows in row_blocks(len(features), 2 * len(mean)):
                yield rows, features[rows]

        return LowRankKernels(blocks, mean, ranks, labels)

    def _again_and_again(self, centred: Floats, labels: Floats) -> LowRankKernels:
        """A problem whose features are computed whenever they are asked for."""
        total = np.zeros(self.n_columns)
        for _, part in self.features.blocks(centred):
            total += part.sum(axis=0)
        mean = total / len(centred)

        def blocks() -> Iterator[tuple[slice, Floats]]:
            for rows, part in self.features.blocks(centred):
                yield rows, part - mean

        return LowRankKernels(blocks, mean, self.features.ranks, labels)

    def machines(
        self,
        system: LowRankKernels | DenseKernels,
        index: NDArray,
        solution: Solution,
    ) -> tuple[Floats, Floats]:
        """Return the normal vector (1, n_columns) and the bias (1,)."""
        if isinstance(system, LowRankKernels):
            return solution.normal, system.true_bias(solution)
        signed = (system.labels * solution.alpha)[0]
        features = self.features(self.centred[index[0]])
        weights = np.repeat(solution.weights[0], self.features.ranks)
        normal = (weights * (signed @ features))[None]
        return normal, solution.bias - normal @ features.mean(axis=0)

    def _mean_kernel(self) -> Floats:
        """Mean of each approximate kernel matrix: the squared mean feature."""
        total = np.zeros(self.n_columns)
        for _, part in self.features.blocks(self.centred):
            total += part.sum(axis=0)
        ends = np.cumsum(self.features.ranks)
        starts = ends - self.features.ranks
        squared: Floats = np.add.reduceat((total / self.n_touches) ** 2, starts)
        return squared


def _whitening(kernel: Floats) -> Floats:
    """Return W with W W' the inverse of the kernel on its own directions."""
    values, vectors = eigh(kernel)
    real = values > _RANK_TOLERANCE * max(values[-1], np.finfo(float).tiny)
    if not real.any():
        return np.zeros((len(kernel), 1))
    whitening: Floats = vectors[:, real] / np.sqrt(values[real])
    return whitening
