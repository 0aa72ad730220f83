"""What multiple kernel learning solves: problems in a batch, points, machines.

For labels y = +-1 the machine of several kernels is the saddle point

    J = min over weights d, max over multipliers a of  1'a - sum_k d_k S_k(a),
    S_k(a) = a'Y K_k Y a / 2,  0 <= a <= C,  y'a = 0,  d >= 0,  |d|_p <= 1.

A touch of label 0 is padding: it takes no part, so that problems of unequal size,
and problems with some touches left out, fit in one batch.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Solver = Callable[[Floats], Floats]

# Bytes of kernel values held at a time beside what the caller holds.
BLOCK_BYTES = 32 * 2**20


class KernelSystem(Protocol):
    """The kernel matrices of a batch of problems, however they are held."""

    labels: Floats
    crowded: bool  # more touches than dimensions by far

    @property
    def n_kernels(self) -> int:
        """Number of kernels."""

    def forces(self, alpha: Floats) -> Floats:
        """Return Y K_k Y a, shape (n_problems, n_kernels, n_touches)."""

    def factorise(self, diagonal: Floats, weights: Floats, pull: "Pull") -> Solver:
        """Return R -> M^-1 R for M = diagonal + Y sum_k d_k K_k Y + pull.

        `pull` belongs to the multipliers that `forces` was last asked about; R has
        the shape (n_problems, n_touches, n_columns).
        """

    def decisions(self, alpha: Floats, weights: Floats) -> Floats:
        """Return decision values less the bias, also where the label is 0."""

    def with_labels(self, labels: Floats) -> Self:
        """Return the same kernels with some labels set to 0."""

    def take(self, keep: NDArray) -> Self:
        """Return the system of some of the problems."""


@dataclass
class Pull:
    """The low-rank part of Newton's matrix: what moving the weights does.

    It is F' (W - W h h' W / h'Wh) F with W = diag(`gain`) and h = `slope`, of
    shape (n_problems, n_kernels), and F the `forces`.
    """

    forces: Floats
    gain: Floats
    slope: Floats

    def times_root(self, columns: Floats) -> Floats:
        """Return R' X, for R R' the matrix in brackets and X with a row per kernel."""
        root = np.sqrt(self.gain)
        unit = root * self.slope
        unit /= np.sqrt((unit * unit).sum(axis=1, keepdims=True))
        scaled = root[:, :, None] * columns
        scaled -= unit[:, :, None] * (unit[:, None, :] @ scaled)
        return scaled


@dataclass
class Solution:
    """Machines of a batch of problems.

    Attributes
    ----------
    alpha : ndarray of shape (n_problems, n_touches)
        Multipliers, in [0, C].
    bias : ndarray of shape (n_problems,)
    weights : ndarray of shape (n_problems, n_kernels)
        Of p-norm 1.
    objective : ndarray of shape (n_problems,)
        J = 1'a - sum_k d_k S_k(a), within `gap` of the optimum.
    gap : ndarray of shape (n_problems,)
        Relative duality gap, proven by a feasible point of either side.
    n_iter : ndarray of shape (n_problems,)
    """

    alpha: Floats
    bias: Floats
    weights: Floats
    objective: Floats
    gap: Floats
    n_iter: NDArray[np.int64]


@dataclass
class Task:
    """A batch of problems with the price of errors and the norm of the weights."""

    system: KernelSystem
    C: float
    norm: float

    def __post_init__(self) -> None:
        self.labels = self.system.labels
        self.real = np.abs(self.labels)  # 1 for touches, 0 for padding

    def take(self, keep: NDArray) -> "Task":
        return Task(self.system.take(keep), self.C, self.norm)


@dataclass
class Point:
    """A point of the iteration, or a direction in which to move it.

    Attributes
    ----------
    left : ndarray of shape (n_problems, 2 * n_touches + n_kernels)
        Multipliers a, their room C - a, and weights d: all positive.
    right : ndarray of the same shape
        The multipliers of those bounds: all positive, and each product of left and
        right is zero at the optimum. The middle ones are the margin errors.
    free : ndarray of shape (n_problems, 2)
        Bias, and multiplier of the norm of the weights.
    n_touches : int
    """

    left: Floats
    right: Floats
    free: Floats
    n_touches: int

    @property
    def alpha(self) -> Floats:
        return self.left[:, : self.n_touches]

    @property
    def weights(self) -> Floats:
        return self.left[:, 2 * self.n_touches :]

    @property
    def errors(self) -> Floats:
        return self.right[:, self.n_touches : 2 * self.n_touches]

    @property
    def slack(self) -> Floats:
        return self.right[:, 2 * self.n_touches :]

    @property
    def bias(self) -> Floats:
        return self.free[:, :1]

    @property
    def level(self) -> Floats:
        return self.free[:, 1:]

    def take(self, keep: NDArray) -> "Point":
        parts = self.left[keep], self.right[keep], self.free[keep]
        return Point(*parts, self.n_touches)

    def moved(self, step: Floats, by: "Point") -> "Point":
        return Point(
            self.left + step * by.left,
            self.right + step * by.right,
            self.free + step * by.free,
            self.n_touches,
        )


class View:
    """What one point sees: forces, energies, margins, each computed once."""

    def __init__(self, task: Task, point: Point) -> None:
        self.forces = task.system.forces(point.alpha)
        self.energies = 0.5 * (self.forces @ point.alpha[:, :, None])[:, :, 0]
        self.margins = weighted(point.weights, self.forces)
        self.margins += task.labels * point.bias
        self.missing = task.real - self.margins

    def take(self, keep: NDArray) -> "View":
        taken = object.__new__(View)
        for name, part in vars(self).items():
            setattr(taken, name, part[keep])
        return taken


def weighted(weights: Floats, forces: Floats) -> Floats:
    """The forces summed with the weights, shape (n_problems, n_touches)."""
    return (weights[:, None, :] @ forces)[:, 0]


def norms(values: Floats, power: float) -> Floats:
    """The p-norm of each row of non-negative values; `power` may be infinite."""
    if power == 1:
        return values.sum(axis=1)
    largest = values.max(axis=1)
    if np.isinf(power):
        return largest
    unit = values / np.where(largest > 0, largest, 1)[:, None]
    return largest * (unit**power).sum(axis=1) ** (1 / power)


def dual_norm(norm: float) -> float:
    """The q with 1/p + 1/q = 1."""
    return np.inf if norm == 1 else norm / (norm - 1)


def row_blocks(n_rows: int, values_per_row: int) -> Iterator[slice]:
    """Yield slices of rows that keep blocks of values small."""
    step = max(1, BLOCK_BYTES // (8 * max(values_per_row, 1)))
    for start in range(0, n_rows, step):
        yield slice(start, min(start + step, n_rows))
