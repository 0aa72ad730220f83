"""What multiple kernel learning solves: problems in a batch, points, machines.

For labels y = +-1 the machine of several kernels is the saddle point

    J = min over weights d, max over multipliers a of  1'a - sum_k d_k S_k(a),
    S_k(a) = a'Y K_k Y a / 2,  0 <= a <= C,  y'a = 0,  d >= 0,  |d|_p <= 1.

A touch of label 0 is padding: it takes no part, so that problems of unequal size,
and problems with some touches left out, fit in one batch.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ..._types import Array, Floats

# Bytes of kernel values held at a time beside what the caller holds.
BLOCK_BYTES = 32 * 2**20


@dataclass
class Point:
    """A point of the iteration, or a direction in which to move it.

    Where kernels are products of features the pulls are unknowns of their own, so that
    rounding of the multipliers does not reach the margins.
    """

    # Multipliers a, room C - a, shares e = d^p of sum 1; each (n_problems, ...) > 0.
    left: Floats
    # Multipliers of those bounds, > 0: in the middle margin errors; left * right -> 0.
    right: Floats
    free: Floats  # bias, multiplier of the sum of the shares, pulls features' Y a
    n_touches: int

    @property
    def alpha(self) -> Floats:
        return self.left[:, : self.n_touches]

    @property
    def shares(self) -> Floats:
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
        return self.free[:, 1:2]

    @property
    def pulls(self) -> Floats:
        return self.free[:, 2:]

    def take(self, keep: Array) -> "Point":
        parts = self.left[keep], self.right[keep], self.free[keep]
        return Point(*parts, self.n_touches)

    def overwrite(self, rows: Array, new: "Point") -> None:
        """Put `new` in the place of some problems."""
        self.left[rows], self.right[rows] = new.left, new.right
        self.free[rows] = new.free

    def moved(self, step: Floats, by: "Point") -> "Point":
        return Point(
            self.left + step * by.left,
            self.right + step * by.right,
            self.free + step * by.free,
            self.n_touches,
        )


@dataclass
class View:
    """What one point sees, each computed once."""

    energies: Floats  # S_k of the multipliers, (n_problems, n_kernels)
    missing: Floats  # what each margin lacks of 1, (n_problems, n_touches)
    square: Floats  # half the squared length of the normal vector over the weights
    pull: Floats  # Y K_k Y a (n_problems, n_kernels, n_touches), or features' Y a

    def take(self, keep: Array) -> "View":
        return View(*(part[keep] for part in vars(self).values()))


class Newton(Protocol):
    """The optimality conditions at one point, linearised and factorised once."""

    def direction(self, target: Floats) -> Point:
        """Return the step that changes the products by `target`, to first order."""


class KernelSystem(Protocol):
    """The kernel matrices of a batch of problems, however they are held."""

    labels: Floats
    crowded: bool  # more touches than dimensions by far

    @property
    def n_kernels(self) -> int:
        """Number of kernels."""

    def pulls(self, alpha: Floats) -> Floats:
        """Return the unknowns besides multipliers, (n_problems, n_columns)."""

    def normal(self, task: "Task", point: Point) -> Floats:
        """Return the normal vectors in the space of features, if there are any."""

    def view(self, task: "Task", point: Point) -> View:
        """Return what `point` sees."""

    def newton(self, task: "Task", point: Point, view: View) -> Newton:
        """Linearise at `point`."""

    def settled(self, task: "Task", point: Point, share: float) -> Point:
        """Return a feasible copy, without weights below `share` of the largest."""

    def take(self, keep: Array) -> Self:
        """Return the system of some of the problems."""


@dataclass
class Task:
    """A batch of problems with the price of errors and the norm of the weights."""

    system: KernelSystem
    C: float
    norm: float

    def __post_init__(self) -> None:
        self.labels = self.system.labels
        self.real = np.abs(self.labels)  # 1 for touches, 0 for padding

    def take(self, keep: Array) -> "Task":
        return Task(self.system.take(keep), self.C, self.norm)

    def view(self, point: Point) -> View:
        return self.system.view(self, point)

    def weights(self, point: Point) -> Floats:
        """The weights d that belong to the shares, of p-norm 1."""
        return point.shares if self.norm == 1 else point.shares ** (1 / self.norm)

    def slopes(self, point: Point) -> tuple[Floats, Floats]:
        """First and second derivative of the weights by the shares."""
        if self.norm == 1:
            return np.ones_like(point.shares), np.zeros_like(point.shares)
        power = 1 / self.norm
        first = power * point.shares ** (power - 1)
        return first, (power - 1) * first / point.shares


@dataclass
class Solution:
    """Machines of a batch: multipliers in [0, C], weights of p-norm 1."""

    alpha: Floats
    bias: Floats
    weights: Floats
    normal: Floats  # (n_problems, n_columns), none if made of the multipliers
    objective: Floats  # J = 1'a - sum_k d_k S_k(a), within the relative, proven `gap`
    gap: Floats
    n_iter: NDArray[np.int64]


def weighted(weights: Floats, forces: Floats) -> Floats:
    """The forces summed with the weights, shape (n_problems, n_touches)."""
    return (weights[:, None, :] @ forces)[:, 0]


def balanced(labels: Floats, alpha: Floats) -> Floats:
    """Take padding out and make both labels pull equally."""
    real = np.abs(labels) * alpha
    plus = np.where(labels > 0, real, 0).sum(axis=1, keepdims=True)
    minus = np.where(labels < 0, real, 0).sum(axis=1, keepdims=True)
    least = np.minimum(plus, minus)
    return np.asarray(real * np.where(labels > 0, least / plus, least / minus))


def without_small(shares: Floats, least: float) -> Floats:
    """Leave out shares below `least` of the largest; the others sum to 1."""
    largest = shares.max(axis=1, keepdims=True)
    kept = np.where(shares < least * largest, 0, shares)
    return np.asarray(kept / kept.sum(axis=1, keepdims=True))


def norms(values: Floats, power: float) -> Floats:
    """The p-norm of each row of non-negative values; `power` may be infinite."""
    if power == 1:
        return np.asarray(values.sum(axis=1))
    lengths: Floats = values.max(axis=1)
    if np.isfinite(power):
        unit = values / np.where(lengths > 0, lengths, 1)[:, None]
        lengths = lengths * (unit**power).sum(axis=1) ** (1 / power)
    return lengths


def row_blocks(n_rows: int, values_per_row: int) -> Iterator[slice]:
    """Yield slices of rows that keep blocks of values small."""
    step = max(1, BLOCK_BYTES // (8 * max(values_per_row, 1)))
    for start in range(0, n_rows, step):
        yield slice(start, min(start + step, n_rows))
