"""Kernel matrices held whole: a batch of problems in one array."""

from typing import Self

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

    def take(self, keep: NDArray) -> Self:
        return type(self)(self.kernels[keep], self.labels[keep])


def _small_solver(matrix: Floats) -> Solver:
    def solve(right: Floats) -> Floats:
        try:
            return np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            return np.linalg.solve(_lifted(matrix), right)

    return solve


def _large_solver(matrix: Floats) -> Solver:
    factors = [_cholesky(one) for one in matrix]

    def solve(right: Floats) -> Floats:
        both = zip(factors, right, strict=True)
        return np.stack([cho_solve(f, r, check_finite=False) for f, r in both])

    return solve


def _cholesky(matrix: Floats) -> tuple[Floats, bool]:
    """Factorise, lifting the diagonal as far as rounding makes necessary."""
    lift = np.finfo(float).eps * np.abs(matrix.diagonal()).max()
    for _ in range(8):
        try:
            factor: tuple[Floats, bool] = cho_factor(matrix, check_finite=False)
            return factor
        except np.linalg.LinAlgError:
            matrix = matrix + lift * np.eye(len(matrix))
            lift *= 100
    return np.full_like(matrix, np.nan), False


def _lifted(matrix: Floats) -> Floats:
    n = matrix.shape[1]
    size = np.abs(matrix).max(axis=(1, 2))[:, None, None]
    return matrix + 1e-14 * np.maximum(size, 1e-300) * np.eye(n)
