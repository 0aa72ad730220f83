"""Kernel matrices held whole: a batch of problems in one array."""

from typing import Self, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ._mkl_problem import Floats, Pull, Solver

# From this size on one matrix at a time is as fast as all at once.
_LARGE = 192


class DenseKernels:
    """Kernel matrices of a batch of problems.

    Parameters
    ----------
    kernels : ndarray of shape (n_problems, n_kernels, n_touches, n_touches)
        Symmetric, positive semi-definite, contiguous.
    labels : ndarray of shape (n_problems, n_touches)
        +1, -1, or 0 for touches that take no part.
    """

    crowded = False

    def __init__(self, kernels: Floats, labels: Floats) -> None:
        self.kernels = kernels
        self.labels = labels

    @property
    def n_kernels(self) -> int:
        return self.kernels.shape[1]

    def forces(self, alpha: Floats) -> Floats:
        n_problems, n_kernels, n, _ = self.kernels.shape
        stacked = self.kernels.reshape(n_problems, n_kernels * n, n)
        pulled = stacked @ (self.labels * alpha)[:, :, None]
        forces: Floats = pulled.reshape(n_problems, n_kernels, n)
        forces *= self.labels[:, None, :]
        return forces

    def factorise(self, diagonal: Floats, weights: Floats, pull: Pull) -> Solver:
        n_problems, n_kernels, n, _ = self.kernels.shape
        flat = self.kernels.reshape(n_problems, n_kernels, n * n)
        matrix = (weights[:, None, :] @ flat).reshape(n_problems, n, n)
        matrix *= self.labels[:, :, None]
        matrix *= self.labels[:, None, :]
        root = pull.times_root(pull.forces)
        matrix += root.transpose(0, 2, 1) @ root
        matrix[:, np.arange(n), np.arange(n)] += diagonal
        return _small_solver(matrix) if n < _LARGE else _large_solver(matrix)

    def decisions(self, alpha: Floats, weights: Floats) -> Floats:
        """Return decision values less the bias, also where the label is 0."""
        n_problems, n_kernels, n, _ = self.kernels.shape
        stacked = self.kernels.reshape(n_problems, n_kernels * n, n)
        pulled = stacked @ (self.labels * alpha)[:, :, None]
        decided: Floats = weights[:, None, :] @ pulled.reshape(n_problems, n_kernels, n)
        return decided[:, 0]

    def with_labels(self, labels: Floats) -> Self:
        return type(self)(self.kernels, labels)

    def take(self, keep: NDArray) -> Self:
        return type(self)(self.kernels[keep], self.labels[keep])


def _small_solver(matrix: Floats) -> Solver:
    def solve(right: Floats) -> Floats:
        try:
            return cast(Floats, np.linalg.solve(matrix, right))
        except np.linalg.LinAlgError:
            return cast(Floats, np.linalg.solve(_lifted(matrix), right))

    return solve


def _large_solver(matrix: Floats) -> Solver:
    solvers = [cholesky_solver(one) for one in matrix]

    def solve(right: Floats) -> Floats:
        return np.stack([one(r) for one, r in zip(solvers, right, strict=True)])

    return solve


def cholesky_solver(matrix: Floats) -> Solver:
    """Factorise one matrix, lifting its diagonal as far as rounding makes necessary.

    Scaled to a diagonal of ones first, so that the lift suits every row.
    """
    unit = np.sqrt(np.maximum(matrix.diagonal(), np.finfo(float).tiny))
    scaled = matrix / unit[:, None] / unit
    for lift in (0.0, 1e-15, 1e-13, 1e-11):
        try:
            lifted = scaled + lift * np.eye(len(matrix)) if lift else scaled
            factor = cho_factor(lifted, check_finite=False)
            break
        except np.linalg.LinAlgError:
            continue
    else:
        return lambda right: np.full_like(right, np.nan)

    def solve(right: Floats) -> Floats:
        solved = cho_solve(factor, right / unit[:, None], check_finite=False)
        return solved / unit[:, None]

    return solve


def _lifted(matrix: Floats) -> Floats:
    n = matrix.shape[1]
    size = np.abs(matrix).max(axis=(1, 2))[:, None, None]
    return matrix + 1e-14 * np.maximum(size, 1e-300) * np.eye(n)
