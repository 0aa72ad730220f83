"""Kernels through landmarks, for very many touches.

Each kernel is replaced by its Nystroem approximation from the same few landmarks:
features whose inner products are the kernel as the landmarks see it. The problem
stays the same, and time and memory grow linearly with the touches. With every touch a
landmark, the machine is the exact one.

The hyperplane is its normal vector in the space of the features, so Newton's step has
one row per feature and not one per touch; touches are only gone through, in blocks.
Conjugate gradients solve for the step; its matrix made of some of the touches leads.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.random import RandomState
from scipy.linalg import eigh

from ..._types import Array, Floats
from . import _problem
from ._kernels import (
    DenseKernels,
    Kernel,
    centre,
    cholesky_solver,
    kernel_scales,
    kernel_stack,
)
from ._problem import Point, Solution, Step, Task, View, balanced, norms, row_blocks

# Directions of a kernel below this share of its largest are rounding.
_RANK_TOLERANCE = 1e-10
# Features of up to this size are kept; larger ones are computed again block by block.
_KEPT_BYTES = 2**30
# Touches per feature from which on margins cannot all be met.
_CROWD = 3

# Touches per column that lead the gradients; steps; errors predicted, corrected.
_DRAWN, _MOST_STEPS, _LEFT = 6, 30, (0.1, 0.003)

Blocks = Callable[[], Iterator[tuple[slice, Floats]]]


@dataclass
class LandmarkFeatures:
    """Nystroem features of several kernels, from one matrix of distances.

    `landmarks` (n_landmarks, n_features) come less `mean`; `maps` (n_landmarks, rank)
    go from kernel values at the landmarks to features, one per kernel.
    """

    kernels: Sequence[Kernel]
    landmarks: Floats
    mean: Floats
    maps: list[Floats]

    def __post_init__(self) -> None:
        self.ranks = [kernel_map.shape[1] for kernel_map in self.maps]

    def __call__(self, centred: Floats) -> Floats:
        """Return features, shape (n_touches, sum of ranks), kernel by kernel."""
        stack = kernel_stack(self.kernels, centred, self.landmarks, self.mean)
        both = zip(stack, self.maps, strict=True)
        return np.concatenate(
            [kernel @ kernel_map for kernel, kernel_map in both], axis=1
        )

    def blocks(self, centred: Floats) -> Iterator[tuple[slice, Floats]]:
        """Yield slices of touches and their features, a few at a time."""
        per_kernel = len(self.landmarks) * (len(self.kernels) + 2)
        for rows in row_blocks(len(centred), per_kernel + 2 * sum(self.ranks)):
            yield rows, self(centred[rows])

    def sums(self, centred: Floats) -> Floats:
        total = np.zeros(sum(self.ranks))
        for _, part in self.blocks(centred):
            total += part.sum(axis=0)
        return total


class NystroemBank:
    """Approximate kernels among training touches, through landmarks drawn from them."""

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
        self.centred, self.mean, diagonals = centre(kernels, touches)
        drawn = random.permutation(self.n_touches)[:n_landmarks]
        landmarks = self.centred[np.sort(drawn)]
        stack = kernel_stack(kernels, landmarks, landmarks, self.mean)
        maps = [_whitening(kernel) for kernel in stack]
        self.features = LandmarkFeatures(kernels, landmarks, self.mean, maps)
        mean = None
        if normalize == "variance":
            # Of each approximate kernel matrix: the squared mean feature.
            ranks = self.features.ranks
            squared = (self.features.sums(self.centred) / self.n_touches) ** 2
            mean = np.add.reduceat(squared, np.cumsum(ranks) - ranks)
        self.scales = kernel_scales(diagonals, mean, normalize)
        for kernel_map, scale in zip(maps, self.scales, strict=True):
            kernel_map *= np.sqrt(scale)

        self.n_columns = sum(self.features.ranks)

    def batch_size(self, n_touches: int) -> int:
        return 1

    def system(self, index: Array, labels: Floats) -> "LowRankKernels | DenseKernels":
        """Return one problem, by features or, where it is small, by matrices."""
        centred, ranks = self.centred[index[0]], self.features.ranks
        n_bytes = 8 * len(centred) * self.n_columns
        if n_bytes > _KEPT_BYTES:
            # Features are computed whenever they are asked for.
            mean = self.features.sums(centred) / len(centred)

            def again() -> Iterator[tuple[slice, Floats]]:
                for rows, part in self.features.blocks(centred):
                    yield rows, part - mean

            return LowRankKernels(again, mean, ranks, labels)
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
            # So few touches that they are at hand for a second product.
            for rows in row_blocks(len(features), 32 * len(mean)):
                yield rows, features[rows]

        return LowRankKernels(blocks, mean, ranks, labels)

    def machines(
        self, system: "LowRankKernels | DenseKernels", index: Array, solution: Solution
    ) -> tuple[Floats, Floats]:
        """Return the normal vector (1, n_columns) and the bias (1,)."""
        if isinstance(system, LowRankKernels):
            return solution.normal, system.true_bias(solution)
        signed = (system.labels * solution.alpha)[0]
        features = self.features(self.centred[index[0]])
        weights = np.repeat(solution.weights[0], self.features.ranks)
        normal = (weights * (signed @ features))[None]
        return normal, solution.bias - normal @ features.mean(axis=0)


def _whitening(kernel: Floats) -> Floats:
    """Return W with W W' the inverse of the kernel on its own directions."""
    values, vectors = eigh(kernel)
    real = values > _RANK_TOLERANCE * max(values[-1], np.finfo(float).tiny)
    if not real.any():
        return np.zeros((len(kernel), 1))
    return np.asarray(vectors[:, real] / np.sqrt(values[real]))


class LowRankKernels:
    """Kernels of one problem as inner products of features; labels (1, n_touches).

    `blocks` yields slices of touches and their features (n_in_slice, n_columns) less
    `mean`; `ranks` are the columns of each kernel, in order.
    """

    def __init__(
        self, blocks: Blocks, mean: Floats, ranks: Sequence[int], labels: Floats
    ) -> None:
        self._blocks, self._mean, self.labels = blocks, mean, labels
        self.ranks = np.asarray(ranks)
        ends = np.cumsum(self.ranks)
        self.slices = [slice(e - r, e) for e, r in zip(ends, self.ranks, strict=True)]
        self.crowded = labels.shape[1] > _CROWD * len(mean)
        self.n_kernels = len(self.slices)

    def pulls(self, alpha: Floats) -> Floats:
        return self.gather((self.labels * alpha)[0])[None]

    def normal(self, task: Task, point: Point) -> Floats:
        weights = np.repeat(task.weights(point), self.ranks, axis=1)
        return np.asarray(weights * point.pulls)

    def view(self, task: Task, point: Point) -> View:
        normal, signed = self.normal(task, point)[0], (self.labels * point.alpha)[0]
        seen, pull = self.both(np.append(normal, point.bias), lambda r, _: signed[r])
        missing = task.real - self.labels * seen
        lengths = self.lengths(normal)
        square = 0.5 * norms(lengths[None], 2 * task.norm / (task.norm + 1)) ** 2
        energies = 0.5 * self.lengths(pull)[None] ** 2
        return View(energies, missing, square, pull[None, :-1])

    def newton(self, task: Task, point: Point, view: View) -> Step:
        return PrimalNewton(self, task, point, view).direction

    def settled(self, task: Task, point: Point, share: float) -> Point:
        """Take the shares that suit the normal vector best."""
        n, left, free = point.n_touches, point.left.copy(), point.free.copy()
        left[:, :n] = balanced(self.labels, point.alpha)
        normal, power = self.normal(task, point), 2 * task.norm / (task.norm + 1)
        shares = self.lengths(normal[0])[None] ** power
        shares[shares.sum(axis=1) == 0] = 1
        left[:, 2 * n :] = _problem.without_small(shares, share**task.norm)
        settled = Point(left, point.right, free, n)
        weights = task.weights(settled)
        inverse = np.where(weights > 0, 1 / np.where(weights > 0, weights, 1), 0)
        free[:, 2:] = normal * np.repeat(inverse, self.ranks, axis=1)
        return settled

    def decisions(self, solution: Solution) -> Floats:
        return self.spread(solution.normal[0])[None] + solution.bias[:, None]

    def true_bias(self, solution: Solution) -> Floats:
        """Return the bias that belongs to the features as they were."""
        return np.asarray(solution.bias - solution.normal @ self._mean)

    def with_labels(self, labels: Floats) -> Self:
        return type(self)(self._blocks, self._mean, self.ranks.tolist(), labels)

    def take(self, keep: Array) -> Self:
        return self  # there is one problem

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
        """Return [features, 1]' diag(ease) [features, 1]; ease 0 costs nothing."""
        parts = [block[ease[rows] > 0] for rows, block in self._blocks()]
        root = np.sqrt(ease[ease > 0])[:, None]
        scaled = np.concatenate([np.concatenate(parts) * root, root], axis=1)
        return np.asarray(scaled.T @ scaled)

    def both(
        self, columns: Floats, values: Callable[[slice, Floats], Floats]
    ) -> tuple[Floats, Floats]:
        """Return F `columns` and F' `values`(slice, F `columns`), F = [features, 1]."""
        seen, total = np.empty(self.labels.shape[1]), np.zeros(len(columns))
        for rows, block in self._blocks():
            seen[rows] = block @ columns[:-1] + columns[-1]
            value = values(rows, seen[rows])
            total[:-1] += block.T @ value
            total[-1] += value.sum()
        return seen, total


def drawn(ease: Floats, n_drawn: int) -> Floats:
    """Return the ease of about `n_drawn` touches, raised to stand for all of them."""
    if len(ease) <= n_drawn:
        return ease
    share = ease
    for _ in range(8):  # what is certain to be drawn leaves the more for the others
        share = np.minimum(1, n_drawn / share.sum() * share)
    # All that are certain, and whoever takes the running sum past a whole number.
    chosen = (np.diff(np.floor(np.cumsum(share)), prepend=0) > 0) | (share == 1)
    return np.where(chosen, ease / np.where(chosen, share, 1), 0)


class PrimalNewton:
    """The optimality conditions at one point, linearised.

    Only the normal vector and the bias are left to solve for. The vector is weights
    times pulls: of its steps weights take what is along their pull.
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
        self._lean = pulls * self._per_column(slope / self._weights)
        energies = 0.5 * system.lengths(pulls) ** 2
        stiffness = self._ratio[0, 2 * n :] - bend * energies
        self._gain = 1 / (stiffness + 2 * slope**2 * energies / self._weights)
        # What the optimality conditions lack, besides the products.
        self._missing = (view.missing - point.errors + point.right[:, :n])[0]
        self._imbalance = self._labels @ point.alpha[0]
        self._excess = point.level[0] - slope * energies - point.slack[0]
        self._surplus = point.shares.sum() - 1
        self._residual = view.pull[0] - pulls
        diagonal = np.arange(len(self._lean))
        matrix = np.zeros((len(diagonal) + 1, len(diagonal) + 1))
        matrix[diagonal, diagonal] = self._per_column(1 / self._weights)
        for gain, part in zip(self._gain, system.slices, strict=True):
            lean = self._lean[part]
            matrix[part, part] -= np.outer(gain * lean, lean)
        tilt = self._per_column(self._gain) * self._lean
        matrix[:-1, :-1] += np.outer(tilt / self._gain.sum(), tilt)
        self._alike, self._eased = matrix, self._ease * np.abs(self._labels)
        few = drawn(self._eased, _DRAWN * len(matrix))
        self._near = cholesky_solver(matrix + system.gram(few))
        self._exact = few is self._eased
        self._right, self._solved, self._left = np.zeros((3, len(matrix)))
        self._seen = np.zeros_like(self._ease)

    def _solve(self, right: Floats) -> tuple[Floats, Floats]:
        """Solve nearly, from the solution before; return also what touches see."""
        if self._exact:
            solved = self._near(right[:, None])[:, 0]
            return solved, self._system.spread(solved[:-1]) + solved[-1]
        solved, left, seen = self._solved, self._left + right - self._right, self._seen
        share = _LEFT[int(self._right.any())]
        most = share**2 * (right @ self._near(right[:, None])[:, 0])
        search, before = np.zeros_like(right), np.inf
        for _ in range(_MOST_STEPS):
            ahead = self._near(left[:, None])[:, 0]
            size = float(left @ ahead)
            if size <= most:
                break
            search = ahead + size / before * search
            look, pulled = self._system.both(search, lambda r, s: self._eased[r] * s)
            pulled += self._alike @ search
            step, before = size / (search @ pulled), size
            solved, left = solved + step * search, left - step * pulled
            seen = seen + step * look
        self._right, self._solved, self._left, self._seen = right, solved, left, seen
        return solved, seen

    def _per_column(self, per_kernel: Floats) -> Floats:
        return np.repeat(per_kernel, self._system.ranks)

    def direction(self, wanted: Floats) -> Point:
        """Return the step by which left * right changes by left * `wanted`."""
        n, system = self._point.n_touches, self._system
        push = wanted[0, 2 * n :] - self._excess
        short = self._missing + wanted[0, :n] - wanted[0, n : 2 * n]
        eased = self._labels * self._ease * short
        right = np.empty(len(self._lean) + 1)
        right[:-1] = self._residual + self._lean * self._per_column(
            self._yield(push)[0]
        )
        right[:-1] += system.gather(eased)
        right[-1] = eased.sum() + self._imbalance
        solved, seen = self._solve(right)
        normal, bias = solved[:-1], solved[-1]
        alpha = self._ease * (short - self._labels * seen)
        push += np.array([self._lean[p] @ normal[p] for p in system.slices])
        shares, level = self._yield(push)
        pulls = normal / self._per_column(self._weights)
        pulls -= self._lean * self._per_column(shares)
        left = np.concatenate([alpha, -alpha, shares])[None]
        free = np.concatenate([[bias, level], pulls])[None]
        return Point(left, wanted - self._ratio * left, free, n)

    def _yield(self, push: Floats) -> tuple[Floats, float]:
        """Return the step of the shares, and of their level, that `push` brings."""
        level = (self._gain @ push + self._surplus) / self._gain.sum()
        return self._gain * (push - level), float(level)
