"""What multiple kernel learning solves, and an interior point that solves many at once.

For labels y = +-1 the machine of several kernels is the saddle point

    J = min over weights d, max over multipliers a of  1'a - sum_k d_k S_k(a),
    S_k(a) = a'Y K_k Y a / 2,  0 <= a <= C,  y'a = 0,  d >= 0,  |d|_p <= 1.

A touch of label 0 is padding: it takes no part, so that problems of unequal size,
and problems with some touches left out, fit in one batch.

Newton's method with a predictor and a corrector follows the central path of the
optimality conditions. The problems of one batch advance together, each by its own
step; those that are done leave the batch. How far a machine is from the best is a
proof, not an estimate: any multipliers within bounds and in balance bound the optimum
from below (eq. 12 of Liu et al. 2014), any hyperplane from above (eq. 11), whoever
made them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ..._types import Array, Bools, Floats

# Bytes of kernel values held at a time beside what the caller holds.
BLOCK_BYTES = 32 * 2**20
# A step goes this share of the way to the boundary.
_SHARE_OF_WAY = 0.99
# Products at the start, relative to the objective there per touch, and how much
# larger those of margin errors may be: measured to need the fewest iterations.
# Where touches outnumber dimensions many margins cannot be met, and errors start as
# large as they are.
_START, _CROWDED_START = (0.1, 30.0), (0.03, np.inf)
# Less than the tolerance is aimed at, so that there is room for setting small things to
# zero: one problem in eight needs an iteration more than if all of it were.
_AIM = 0.7
# Products larger than this share of what they should be need no proof of the gap.
_NEAR = 30
# Iterations without a better gap after which a problem has reached its rounding:
# above the tolerance, and below it.
_PATIENCE, _SHORT_PATIENCE = 12, 1
# Weights and multipliers below these shares of the largest become zero where the
# gap stays within the tolerance.
_SMALL = ((1e-3, 1e-6), (1e-5, 1e-7), (0.0, 0.0))


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

    def __post_init__(self) -> None:
        n, free = self.n_touches, self.free
        # Views, through which the arrays are also written to.
        self.alpha, self.shares = self.left[:, :n], self.left[:, 2 * n :]
        self.errors, self.slack = self.right[:, n : 2 * n], self.right[:, 2 * n :]
        self.bias, self.level, self.pulls = free[:, :1], free[:, 1:2], free[:, 2:]

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


# From w to the step by which left * right changes by left * w, to first order.
Step = Callable[[Floats], Point]


class KernelSystem(Protocol):
    """The kernel matrices of a batch of problems, however they are held."""

    labels: Floats
    crowded: bool  # more touches than dimensions by far

    n_kernels: int

    def pulls(self, alpha: Floats) -> Floats:
        """Return the unknowns besides multipliers, (n_problems, n_columns)."""

    def normal(self, task: "Task", point: Point) -> Floats:
        """Return the normal vectors in the space of features, if there are any."""

    def view(self, task: "Task", point: Point) -> View:
        """Return what `point` sees."""

    def newton(self, task: "Task", point: Point, view: View) -> Step:
        """Linearise at `point`; see `Step`."""

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


def solve_interior(
    system: KernelSystem,
    C: float,
    *,
    norm: float = 1.0,
    tol: float = 1e-6,
    max_iter: int = 100,
) -> Solution:
    """Solve a batch of two-class problems, both labels in each; return the best met.

    `norm` is the p >= 1 of |d|_p <= 1, `tol` the relative duality gap. From F. R. Bach
    et al., ICML 2004, doi:10.1145/1015330.1015424; M. Kloft et al., "lp-norm multiple
    kernel learning", JMLR 12, 2011; S. Mehrotra, SIAM J. Optim. 2(4), 1992,
    doi:10.1137/0802028.
    """
    whole = task = Task(system, C, norm)
    # Where rounding ends the path some quotients are 0 / 0; such steps are not
    # taken, and the best machine before them counts.
    with np.errstate(all="ignore"):
        point, view = _start(task)
        best = Best(point, tol)
        for remaining in range(max_iter, -1, -1):
            going = best.improve(task, point, view, last=not remaining)
            n_going = np.count_nonzero(going)
            if not (remaining and n_going):
                break
            if 2 * n_going <= len(going):
                best.rows = best.rows[going]
                task, point = task.take(going), point.take(going)
                view = view.take(going)
                going = going[going]
            point = _advanced(task, point, view, going)
            view = task.system.view(task, point)
        best.n_iter = np.minimum(best.n_iter, max_iter)
        return best.solution(whole)


def _start(task: Task) -> tuple[Point, View]:
    """Equal weights; multipliers in balance, as large as pays along their ray."""
    labels, system = task.labels, task.system
    (n_problems, n), n_kernels = labels.shape, system.n_kernels
    shares = np.full((n_problems, n_kernels), 1 / n_kernels)
    # Multipliers in balance, at most 1/2, equal within each label.
    plus, minus = labels > 0, labels < 0
    n_plus = plus.sum(axis=1, keepdims=True)
    n_minus = minus.sum(axis=1, keepdims=True)
    half = 0.5 * np.minimum(n_plus, n_minus)
    ray = np.where(plus, half / n_plus, np.where(minus, half / n_minus, 0))
    pulls = system.pulls(ray)
    free = np.concatenate([np.zeros((n_problems, 2)), pulls], axis=1)
    left = np.concatenate([ray, task.C - ray, shares], axis=1)
    point = Point(left, np.zeros_like(left), free, n)
    view, slope = system.view(task, point), task.slopes(point)[0]
    total = ray.sum(axis=1, keepdims=True)
    energy = np.maximum(2 * view.energies.max(axis=1, keepdims=True), 1e-300)
    length = np.minimum(total / energy, task.C)
    # All that was seen along the ray grows with its length.
    free[:, 2:] *= length
    left[:, :n] = np.where(task.real > 0, length * ray, task.C / 2)
    left[:, n : 2 * n] = task.C - left[:, :n]
    missing = task.real - length * (task.real - view.missing)
    seen = View(
        length**2 * view.energies,
        missing,
        length[:, 0] ** 2 * view.square,
        length.reshape(-1, *[1] * (view.pull.ndim - 1)) * view.pull,
    )
    pull = slope * seen.energies
    least = 1e-3 * length * total
    free[:, 1:2] = 1.5 * np.maximum(pull.max(axis=1, keepdims=True), least)
    centre, most = _CROWDED_START if system.crowded else _START
    floor = centre * length * total / n / left
    right = np.concatenate([-missing, missing, point.level - pull], axis=1)
    point.right[...] = np.maximum(right, floor)
    np.minimum(point.errors, most * floor[:, n : 2 * n], out=point.errors)
    return point, seen


def _advanced(task: Task, point: Point, view: View, going: Array) -> Point:
    """Return the next point: predictor, then corrector, for problems in `going`."""
    step_to = task.system.newton(task, point, view)
    products = point.left * point.right
    total = products.sum(axis=1, keepdims=True)
    # All products to 0: left changes by this part of itself, right by -1 minus it.
    change = step_to(-point.right).left / point.left
    lowest = np.minimum(change.min(axis=1), -1 - change.max(axis=1))[:, None]
    reach = 1 / np.maximum(-lowest, 1)
    bent = change * (1 + change)
    products *= bent
    remains = 1 - reach - reach**2 * products.sum(axis=1, keepdims=True) / total
    centre = total / products.shape[1] * np.minimum(np.maximum(remains, 0), 1) ** 3
    bent -= 1
    move = step_to(centre / point.left + bent * point.right)
    # The longest step that keeps everything positive, (n_problems, 1).
    nearest = np.minimum(
        (move.left / point.left).min(axis=1), (move.right / point.right).min(axis=1)
    )
    reach = 1 / np.maximum(-nearest, 1e-12)[:, None]
    step = np.minimum(1, _SHARE_OF_WAY * reach)
    moved = point.moved(step, move)
    # What is not finite shows in the step, or in the bias and the level.
    usable = going & np.isfinite(step[:, 0] + moved.free.sum(axis=1))
    if not usable.all():
        moved.overwrite(~usable, point.take(~usable))
    return moved


def relative_gap(task: Task, point: Point, view: View) -> Floats:
    """Return (upper - lower) / upper for each problem, shape (n_problems,)."""
    # Hinges as errors, or the point's errors and a hyperplane widened to meet margins.
    square, missing = view.square, view.missing
    as_it_is = square + task.C * np.maximum(missing, 0).sum(axis=1)
    short = np.maximum((missing - point.errors).max(axis=1), 0)
    wider = 1 / (1 - np.minimum(short, 0.5))
    errors = np.vecdot(task.real, point.errors)
    widened = square * wider**2 + task.C * errors * wider
    upper = np.asarray(np.where(short < 0.5, np.minimum(as_it_is, widened), as_it_is))
    # The dual value, of the dual norm (1/p + 1/q = 1); multipliers out of balance by
    # rounding pay for it.
    power = np.inf if task.norm == 1 else task.norm / (task.norm - 1)
    imbalance = np.abs(np.vecdot(task.labels, point.alpha))
    total = np.vecdot(task.real, point.alpha)
    lower = total - norms(view.energies, power) - np.abs(point.free[:, 0]) * imbalance
    gap = (upper - lower) / upper
    gap[~np.isfinite(gap)] = np.inf
    return np.asarray(np.maximum(gap, 0))


class Best:
    """The point with the smallest gap met so far of each problem.

    Points that have been met are its own: it may write to all but the latest.
    """

    def __init__(self, point: Point, tol: float) -> None:
        n_problems = len(point.free)
        self.point = point
        self.gap = np.full(n_problems, np.inf)
        self.n_iter = np.zeros(n_problems, dtype=np.int64)
        self._tol = tol
        self._found_at = np.zeros(n_problems, dtype=np.int64)
        self.rows = np.arange(n_problems)  # of the problems that are not done

    def improve(self, task: Task, point: Point, view: View, *, last: bool) -> Bools:
        """Note what is better; return which problems should go on.

        No proof, but for the `last` point, while the products alone say all are far.
        """
        rows = self.rows
        # Whether the products of any problem are about as small as its gap should be.
        products = np.vecdot(point.left, point.right)
        scale = np.vecdot(task.real, point.alpha) - point.free[:, 1]
        if not last and (products > _NEAR * self._tol * scale).all():
            self.n_iter[rows] += 1
            self._found_at[rows] = self.n_iter[rows]
            return np.ones(len(rows), dtype=bool)
        gap = relative_gap(task, point, view)
        better = gap < self.gap[rows]
        if np.count_nonzero(better) == len(self.gap):
            self.point = point
        else:
            self.point.overwrite(rows[better], point.take(better))
        self.gap[rows[better]] = gap[better]
        self._found_at[rows[better]] = self.n_iter[rows[better]]
        waited = self.n_iter[rows] - self._found_at[rows]
        patience = np.where(self.gap[rows] > self._tol, _PATIENCE, _SHORT_PATIENCE)
        going = (self.gap[rows] > _AIM * self._tol) & (waited <= patience)
        self.n_iter[rows[going]] += 1
        return going

    def solution(self, task: Task) -> Solution:
        """Return the machines, with tiny weights and multipliers set to zero."""
        point, gap = self.point, self.gap
        energies = np.zeros_like(point.shares)
        rows = np.arange(len(gap))
        for share_of_weight, share_of_alpha in _SMALL:
            part = task if len(rows) == len(gap) else task.take(rows)
            sparse = self.point.take(rows)
            alpha = sparse.alpha
            alpha[alpha < share_of_alpha * alpha.max(axis=1, keepdims=True)] = 0
            sparse = part.system.settled(part, sparse, share_of_weight)
            view = part.system.view(part, sparse)
            sparse_gap = relative_gap(part, sparse, view)
            fine = sparse_gap <= np.maximum(self._tol, gap[rows])
            # Nothing is left out in the last round: that is how it must be.
            fine |= share_of_weight == share_of_alpha == 0
            done = rows[fine]
            point.overwrite(done, sparse.take(fine))
            gap[done], energies[done] = sparse_gap[fine], view.energies[fine]
            rows = rows[~fine]
            if not len(rows):
                break
        weights = task.weights(point)
        return Solution(
            alpha=point.alpha,
            bias=point.free[:, 0],
            weights=weights,
            normal=task.system.normal(task, point),
            objective=point.alpha.sum(axis=1) - np.vecdot(weights, energies),
            gap=gap,
            n_iter=np.maximum(self.n_iter, 1),
        )
