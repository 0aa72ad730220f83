"""Newton's step of the interior point for kernels that are products of features.

The hyperplane is its normal vector in the space of the features, so the system to
solve has one row per feature and not one per touch; touches are only gone through,
in blocks.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ._mkl_problem import (
    Floats,
    Point,
    Solution,
    Task,
    View,
    balanced,
    norms,
    without_small,
)
from ._mkl_systems import cholesky_solver

# Touches per feature from which on margins cannot all be met.
_CROWD = 3

Blocks = Callable[[], Iterator[tuple[slice, Floats]]]


class LowRankKernels:
    """Kernels of one problem as inner products of features.

    Parameters
    ----------
    blocks : callable
        Goes through the touches once: pairs of a slice and the features of those
        touches, of shape (n_in_slice, n_columns), less `mean`.
    mean : ndarray of shape (n_columns,)
        Mean feature, taken out because it only adds to the bias.
    ranks : sequence of int
        Columns of each kernel, in order.
    labels : ndarray of shape (1, n_touches)
        +1, -1, or 0 for touches that take no part.
    """

    def __init__(
        self, blocks: Blocks, mean: Floats, ranks: Sequence[int], labels: Floats
    ) -> None:
        self._blocks, self._mean, self.labels = blocks, mean, labels
        self.ranks = np.asarray(ranks)
        ends = np.cumsum(self.ranks)
        self.slices = [slice(e - r, e) for e, r in zip(ends, self.ranks, strict=True)]
        self.crowded = labels.shape[1] > _CROWD * len(mean)

    @property
    def n_kernels(self) -> int:
        return len(self.slices)

    def pulls(self, alpha: Floats) -> Floats:
        return self.gather((self.labels * alpha)[0])[None]

    def normal(self, task: Task, point: Point) -> Floats:
        weights = np.repeat(task.weights(point), self.ranks, axis=1)
        normal: Floats = weights * point.pulls
        return normal

    def view(self, task: Task, point: Point) -> View:
        pull = self.gather((self.labels * point.alpha)[0])
        normal = self.normal(task, point)[0]
        missing = task.real - self.labels * (self.spread(normal) + point.bias[0])
        lengths = self.lengths(normal)
        square = 0.5 * norms(lengths[None], 2 * task.norm / (task.norm + 1)) ** 2
        energies = 0.5 * self.lengths(pull)[None] ** 2
        return View(energies, missing, square, pull[None])

    def newton(self, task: Task, point: Point, view: View) -> "PrimalNewton":
        return PrimalNewton(self, task, point, view)

    def settled(self, task: Task, point: Point, share: float) -> Point:
        """Take the shares that suit the normal vector best."""
        n, left, free = point.n_touches, point.left.copy(), point.free.copy()
        left[:, :n] = balanced(self.labels, point.alpha)
        normal, power = self.normal(task, point), 2 * task.norm / (task.norm + 1)
        shares = self.lengths(normal[0])[None] ** power
        shares[shares.sum(axis=1) == 0] = 1
        left[:, 2 * n :] = without_small(shares, share**task.norm)
        settled = Point(left, point.right, free, n)
        weights = task.weights(settled)
        inverse = np.where(weights > 0, 1 / np.where(weights > 0, weights, 1), 0)
        free[:, 2:] = normal * np.repeat(inverse, self.ranks, axis=1)
        return settled

    def decisions(self, solution: Solution) -> Floats:
        """Return the decisions about all touches, also where the label is 0."""
        return self.spread(solution.normal[0])[None] + solution.bias[:, None]

    def true_bias(self, solution: Solution) -> Floats:
        """Return the bias that belongs to the features as they were."""
        bias: Floats = solution.bias - solution.normal @ self._mean
        return bias

    def with_labels(self, labels: Floats) -> Self:
        """Return the same kernels with some labels set to 0."""
        return type(self)(self._blocks, self._mean, self.ranks.tolist(), labels)

    def take(self, keep: NDArray) -> Self:
        if len(keep) != 1 or not np.asarray(keep).all():
            raise IndexError("A low-rank system holds one problem.")
        return self

    def lengths(self, columns: Floats) -> Floats:
        """Return the length of each kernel's part of a vector over the columns."""
        return np.array([np.linalg.norm(columns[part]) for part in self.slices])

    def gather(self, values: Floats) -> Floats:
        """Return features' times one value per touch."""
        total = np.zeros(len(self._mean))
        for rows, block in self._blocks():
            total += block.T @ values[rows]
        return total

    def spread(self, columns: Floats) -> Floats:
        """Return features times one value per column."""
        return np.concatenate([block @ columns for _, block in self._blocks()])

    def gram(self, ease: Floats) -> Floats:
        """Return [features, 1]' diag(ease) [features, 1]."""
        n_columns = len(self._mean)
        gram = np.zeros((n_columns + 1, n_columns + 1))
        for rows, block in self._blocks():
            root = np.sqrt(ease[rows])[:, None]
            scaled = np.concatenate([block * root, root], axis=1)
            gram += scaled.T @ scaled
        return gram


class PrimalNewton:
    """The optimality conditions at one point, linearised and factorised once.

    Multipliers, pulls, shares and their level are eliminated by hand, which leaves
    the normal vector and the bias. The normal vector is weights times pulls, so a
    step of it is divided between the two: weights take what is along their pull.
    """

    def __init__(
        self, system: LowRankKernels, task: Task, point: Point, view: View
    ) -> None:
        self._system, self._point, self._labels = system, point, task.labels[0]
        n, pulls = point.n_touches, point.pulls[0]
        self._weights = task.weights(point)[0]
        slope, bend = (part[0] for part in task.slopes(point))
        self._ratio = point.right / point.left
        self._ease = 1 / (self._ratio[0, :n] + self._ratio[0, n : 2 * n])
        self._lean = pulls * self._stretched(slope / self._weights)
        energies = 0.5 * system.lengths(pulls) ** 2
        stiffness = self._ratio[0, 2 * n :] - bend * energies
        self._gain = 1 / (stiffness + 2 * slope**2 * energies / self._weights)
        # What the optimality conditions lack, besides the products.
        self._missing = (view.missing - point.errors + point.right[:, :n])[0]
        self._imbalance = self._labels @ point.alpha[0]
        self._excess = point.level[0] - slope * energies - point.slack[0]
        self._surplus = point.shares.sum() - 1
        self._apart = view.pull[0] - pulls
        self._solve = cholesky_solver(self._matrix())

    def _stretched(self, per_kernel: Floats) -> Floats:
        return np.repeat(per_kernel, self._system.ranks)

    def _matrix(self) -> Floats:
        matrix = self._system.gram(self._ease * np.abs(self._labels))
        diagonal = np.arange(len(self._lean))
        matrix[diagonal, diagonal] += self._stretched(1 / self._weights)
        for gain, part in zip(self._gain, self._system.slices, strict=True):
            lean = self._lean[part]
            matrix[part, part] -= np.outer(gain * lean, lean)
        tilt = self._stretched(self._gain) * self._lean
        matrix[:-1, :-1] += np.outer(tilt / self._gain.sum(), tilt)
        return matrix

    def direction(self, target: Floats) -> Point:
        """Return the step that changes the products of left and right by `target`."""
        point, n, system = self._point, self._point.n_touches, self._system
        wanted = target / point.left
        push = wanted[0, 2 * n :] - self._excess
        short = self._missing + wanted[0, :n] - wanted[0, n : 2 * n]
        eased = self._labels * self._ease * short
        right = np.empty(len(self._lean) + 1)
        right[:-1] = self._apart + self._lean * self._stretched(self._yield(push)[0])
        right[:-1] += system.gather(eased)
        right[-1] = eased.sum() + self._imbalance
        solved = self._solve(right[:, None])[:, 0]
        normal, bias = solved[:-1], solved[-1]
        moved = self._labels * (system.spread(normal) + bias)
        alpha = self._ease * (short - moved)
        push += np.array([self._lean[p] @ normal[p] for p in system.slices])
        shares, level = self._yield(push)
        pulls = normal / self._stretched(self._weights)
        pulls -= self._lean * self._stretched(shares)
        left = np.concatenate([alpha, -alpha, shares])[None]
        free = np.concatenate([[bias, level], pulls])[None]
        return Point(left, wanted - self._ratio * left, free, n)

    def _yield(self, push: Floats) -> tuple[Floats, float]:
        """Return the step of the shares, and of their level, that `push` brings."""
        level = (self._gain @ push + self._surplus) / self._gain.sum()
        return self._gain * (push - level), float(level)
