"""Kernel matrices held whole: a batch of problems in one array."""

from typing import Self, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ._mkl_newton import DualNewton, Pull, Solver
from ._mkl_problem import (
    Floats,
    Point,
    Solution,
    Task,
    View,
    balanced,
    weighted,
    without_small,
)

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
    means : ndarray of shape (n_problems, n_kernels, n_touches), optional
        Means of the rows that `centred` took out.
    """

    crowded = False

    def __init__(
        self, kernels: Floats, labels: Floats, means: Floats | None = None
    ) -> None:
        self.kernels, self.labels, self.means = kernels, labels, means

    @classmethod
    def centred(cls, kernels: Floats, labels: Floats) -> Self:
        """Take the part out of `kernels`, in place, that is equal for all touches.

        It adds nothing to any machine but its bias, and where it is large it hides
        the rest in its rounding.
        """
        means = kernels.mean(axis=3)
        kernels -= means[:, :, :, None]
        kernels -= kernels.mean(axis=2)[:, :, None, :]
        return cls(kernels, labels, means)

    @property
    def n_kernels(self) -> int:
        return self.kernels.shape[1]

    def pulls(self, alpha: Floats) -> Floats:
        return np.zeros((len(alpha), 0))

    def normal(self, task: Task, point: Point) -> Floats:
        return np.zeros((len(point.alpha), 0))

    def view(self, task: Task, point: Point) -> View:
        forces = self._times(self.labels * point.alpha)
        forces *= self.labels[:, None, :]
        energies = 0.5 * (forces @ point.alpha[:, :, None])[:, :, 0]
        weights = task.weights(point)
        square = (weights * energies).sum(axis=1)
        missing = task.real - weighted(weights, forces) - task.labels * point.bias
        return View(energies, missing, square, forces)

    def newton(self, task: Task, point: Point, view: View) -> DualNewton:
        return DualNewton(task, point, view, self._factorise)

    def settled(self, task: Task, point: Point, share: float) -> Point:
        n, left = point.n_touches, point.left.copy()
        left[:, :n] = balanced(self.labels, point.alpha)
        left[:, 2 * n :] = without_small(point.shares, share**task.norm)
        return Point(left, point.right, point.free, n)

    def decisions(self, solution: Solution) -> Floats:
        """Return the decisions about all touches, also where the label is 0."""
        pulled = self._times(self.labels * solution.alpha)
        return weighted(solution.weights, pulled) + solution.bias[:, None]

    def true_bias(self, solution: Solution) -> Floats:
        """Return the bias that belongs to the kernels as they were."""
        if self.means is None:
            return solution.bias
        signed = self.labels * solution.alpha
        taken = (self.means @ signed[:, :, None])[:, :, 0]
        bias: Floats = solution.bias - (solution.weights * taken).sum(axis=1)
        return bias

    def with_labels(self, labels: Floats) -> Self:
        """Return the same kernels with some labels set to 0."""
        return type(self)(self.kernels, labels, self.means)

    def take(self, keep: NDArray) -> Self:
        means = None if self.means is None else self.means[keep]
        return type(self)(self.kernels[keep], self.labels[keep], means)

    def _times(self, signed: Floats) -> Floats:
        """Return K_k v for each kernel, shape (n_problems, n_kernels, n_touches)."""
        n_problems, n_kernels, n, _ = self.kernels.shape
        stacked = self.kernels.reshape(n_problems, n_kernels * n, n)
        return (stacked @ signed[:, :, None]).reshape(n_problems, n_kernels, n)

    def _factorise(self, diagonal: Floats, weights: Floats, pull: Pull) -> Solver:
        n_problems, n_kernels, n, _ = self.kernels.shape
        flat = self.kernels.reshape(n_problems, n_kernels, n * n)
        matrix = (weights[:, None, :] @ flat).reshape(n_problems, n, n)
        matrix *= self.labels[:, :, None]
        matrix *= self.labels[:, None, :]
        root = pull.root()
        matrix += root.transpose(0, 2, 1) @ root
        matrix[:, np.arange(n), np.arange(n)] += diagonal
        return _small_solver(matrix) if n < _LARGE else _large_solver(matrix)


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
