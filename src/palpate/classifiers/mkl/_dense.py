"""Kernel matrices held whole: a batch of problems in one array, and Newton's step.

The unknowns besides the multipliers a are eliminated by hand: bounds are diagonal,
shares and their level leave a matrix of rank below the number of kernels.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import repeat
from typing import Self, cast

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from ..._types import Array, Floats
from . import _problem
from ._problem import Point, Solution, Step, Task, View, balanced, weighted

# From this size on one matrix at a time is as fast as all at once.
_LARGE = 50

# What `dpotrs` is told each time.
_UPPER, _IN_PLACE = repeat(0), repeat(1)

Solver = Callable[[Floats], Floats]


class DenseKernels:
    """Kernels (n_problems, n_kernels, n_touches, n_touches) of a batch, contiguous.

    `labels` (n_problems, n_touches) are +1, -1, or 0 for no part; `means` (n_problems,
    n_kernels, n_touches) are those of the rows that `centred` took out.
    """

    crowded = False

    def __init__(
        self, kernels: Floats, labels: Floats, means: Floats | None = None
    ) -> None:
        self.kernels, self.labels, self.means = kernels, labels, means
        self.n_kernels = int(kernels.shape[1])

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

    def pulls(self, alpha: Floats) -> Floats:
        return np.zeros((len(alpha), 0))

    def normal(self, task: Task, point: Point) -> Floats:
        return np.zeros((len(point.alpha), 0))

    def view(self, task: Task, point: Point) -> View:
        forces = self._times(point.alpha)
        forces *= self.labels[:, None, :]
        energies = 0.5 * (forces @ point.alpha[:, :, None])[:, :, 0]
        weights = task.weights(point)
        square = np.vecdot(weights, energies)
        missing = task.real - weighted(weights, forces) - task.labels * point.bias
        return View(energies, missing, square, forces)

    def newton(self, task: Task, point: Point, view: View) -> Step:
        return DualNewton(self, task, point, view).direction

    def settled(self, task: Task, point: Point, share: float) -> Point:
        n, left = point.n_touches, point.left.copy()
        left[:, :n] = balanced(self.labels, point.alpha)
        left[:, 2 * n :] = _problem.without_small(point.shares, share**task.norm)
        return Point(left, point.right, point.free, n)

    def decisions(self, solution: Solution) -> Floats:
        """Return the decisions about all touches, also where the label is 0."""
        pulled = self._times(solution.alpha)
        return weighted(solution.weights, pulled) + solution.bias[:, None]

    def true_bias(self, solution: Solution) -> Floats:
        """Return the bias that belongs to the kernels as they were."""
        if self.means is None:
            return solution.bias
        signed = self.labels * solution.alpha
        taken = (self.means @ signed[:, :, None])[:, :, 0]
        return np.asarray(solution.bias - (solution.weights * taken).sum(axis=1))

    def with_labels(self, labels: Floats) -> Self:
        """Return the same kernels with some labels set to 0."""
        return type(self)(self.kernels, labels, self.means)

    def take(self, keep: Array) -> Self:
        means = None if self.means is None else self.means[keep]
        return type(self)(self.kernels[keep], self.labels[keep], means)

    def _times(self, alpha: Floats) -> Floats:
        """Return K_k Y a, (n_problems, n_kernels, n_touches)."""
        signed = self.labels * alpha
        n_problems, n_kernels, n, _ = self.kernels.shape
        stacked = self.kernels.reshape(n_problems, n_kernels * n, n)
        return (stacked @ signed[:, :, None]).reshape(n_problems, n_kernels, n)

    def factorise(self, diagonal: Floats, weights: Floats, root: Floats) -> Solver:
        """Return a solver of diagonal + sum_k d_k Y K_k Y + root' root.

        It overwrites what it is given, contiguous, (n_problems, n_right_sides, n).
        """
        n_problems, n_kernels, n, _ = self.kernels.shape
        flat = self.kernels.reshape(n_problems, n_kernels, n * n)
        matrix = (weights[:, None, :] @ flat).reshape(n_problems, n, n)
        matrix *= self.labels[:, :, None] * self.labels[:, None, :]
        matrix += root.transpose(0, 2, 1) @ root
        matrix.reshape(n_problems, -1)[:, :: n + 1] += diagonal
        factors = _factors(matrix)

        def solve(right: Floats) -> Floats:
            # With few touches named options and a loop take as long as the solution.
            for _ in map(dpotrs, factors, right.transpose(0, 2, 1), _UPPER, _IN_PLACE):
                pass
            return right

        return solve


def cholesky_solver(matrix: Floats) -> Solver:
    """Factorise one symmetric matrix, its diagonal raised where rounding spoils it."""
    factor = _factor(matrix)
    return lambda right: cast(Floats, dpotrs(factor, right, lower=0)[0])


def _factors(matrices: Floats) -> Iterable[Floats]:
    if matrices.shape[1] < _LARGE:
        with suppress(np.linalg.LinAlgError):
            return [*np.linalg.cholesky(matrices).transpose(0, 2, 1)]
    return [_factor(matrix) for matrix in matrices]


def _factor(matrix: Floats) -> Floats:
    """Return the Cholesky factor in the upper half, all NaN where there is none."""
    factor, failed = dpotrf(matrix.T, lower=0, clean=0)
    for share in (1e-15, 1e-13, 1e-11):
        if not failed:
            return cast(Floats, factor)
        raised = matrix + np.diag(share * matrix.diagonal())
        factor, failed = dpotrf(raised.T, lower=0, clean=0)
    return np.full_like(factor, np.nan) if failed else cast(Floats, factor)


class DualNewton:
    """The optimality conditions at one point, linearised and factorised once."""

    def __init__(
        self, system: DenseKernels, task: Task, point: Point, view: View
    ) -> None:
        n, self._labels = point.n_touches, task.labels
        self._ratio = point.right / point.left
        self._forces, pulls = view.pull, view.energies
        stiffness = self._ratio[:, 2 * n :]
        if task.norm > 1:
            slope, bend = task.slopes(point)
            self._forces, pulls = slope[:, :, None] * view.pull, slope * view.energies
            stiffness = stiffness - bend * view.energies
        self._gain = 1 / stiffness
        self._total = self._gain.sum(axis=1, keepdims=True)
        lean = weighted(self._gain / self._total, self._forces)
        # What the optimality conditions lack, besides the products.
        self._imbalance = np.vecdot(self._labels, point.alpha)[:, None]
        self._excess = point.level - pulls - point.slack
        self._surplus = point.shares.sum(axis=1, keepdims=True) - 1
        self._missing = view.missing - point.errors + point.right[:, :n]
        self._missing += lean * self._surplus
        diagonal = self._ratio[:, :n] + self._ratio[:, n : 2 * n]
        # Moving shares adds F' W F - F' W 1 1' W F / 1' W 1: W gain, F forces.
        self._pace = np.sqrt(self._gain)
        self._root = self._forces - lean[:, None, :]
        self._root *= self._pace[:, :, None]
        self._solve = system.factorise(diagonal, task.weights(point), self._root)
        self._towards_bias: Floats | None = None

    def direction(self, wanted: Floats) -> Point:
        """Return the step by which left * right changes by left * `wanted`."""
        forces, labels, n = self._forces, self._labels, self._labels.shape[1]
        push = wanted[:, 2 * n :] - self._excess
        right = self._missing + wanted[:, :n] - wanted[:, n : 2 * n]
        right -= weighted(self._pace * push, self._root)
        # The multipliers, and the bias that keeps them in balance.
        if self._towards_bias is None:
            both = np.empty((len(right), 2, n))
            both[:, 0], both[:, 1] = right, labels
            alpha, self._towards_bias = self._solve(both).transpose(1, 0, 2)
            self._stiff = np.vecdot(labels, self._towards_bias)[:, None]
        else:
            alpha = self._solve(right[:, None])[:, 0]
        bias = (np.vecdot(labels, alpha)[:, None] + self._imbalance) / self._stiff
        alpha = alpha - bias * self._towards_bias
        push += (forces @ alpha[:, :, None])[:, :, 0]
        level = np.vecdot(self._gain, push)[:, None] + self._surplus
        level /= self._total
        left = np.empty_like(wanted)
        left[:, :n] = alpha
        np.negative(alpha, out=left[:, n : 2 * n])
        np.multiply(self._gain, push - level, out=left[:, 2 * n :])
        free = np.concatenate([bias, level], axis=1)
        return Point(left, wanted - self._ratio * left, free, n)
