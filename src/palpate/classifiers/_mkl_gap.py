"""How far a machine of several kernels is from the best: a proof, not an estimate.

Any multipliers within bounds and in balance bound the optimum from below (eq. 12 of
Liu et al. 2014), any hyperplane from above (eq. 11); the gap between the two bounds
says how far either can be from the optimum, whoever made them.
"""

import numpy as np
from numpy.typing import NDArray

from ._mkl_problem import Floats, Point, Solution, Task, View, dual_norm, norms

# A fifth of the tolerance is aimed at: it costs about one iteration more and leaves
# room for setting small things to zero.
_AIM = 0.2
# Products larger than this share of what they should be need no proof of the gap.
_NEAR = 30
# Iterations without a better gap after which a problem has reached its rounding:
# above the tolerance, and below it.
_PATIENCE, _SHORT_PATIENCE = 12, 1
# Weights and multipliers below these shares of the largest become zero where the
# gap stays within the tolerance.
_SMALL = ((1e-3, 1e-6), (1e-5, 1e-7), (0.0, 0.0))


def relative_gap(task: Task, point: Point, view: View) -> Floats:
    """Return (upper - lower) / upper for each problem, shape (n_problems,)."""
    upper = _upper_bound(task, point, view)
    gap = (upper - _lower_bound(task, point, view)) / upper
    gap[~np.isfinite(gap)] = np.inf
    return np.maximum(gap, 0)


def _lower_bound(task: Task, point: Point, view: View) -> Floats:
    """The dual value; multipliers out of balance by rounding pay for it."""
    energy = norms(view.energies, dual_norm(task.norm))
    imbalance = np.abs((task.labels * point.alpha).sum(axis=1))
    total = (task.real * point.alpha).sum(axis=1)
    return total - energy - np.abs(point.free[:, 0]) * imbalance


def _upper_bound(task: Task, point: Point, view: View) -> Floats:
    """The least of two primal values.

    One takes the hyperplane as it is, with the hinge as margin error. The other
    takes the iteration's margin errors and widens the hyperplane until every
    margin is met, which a large C would make dear otherwise.
    """
    square, missing = view.square, view.missing
    as_it_is = square + task.C * np.maximum(missing, 0).sum(axis=1)
    short = np.maximum((missing - point.errors).max(axis=1), 0)
    wider = 1 / (1 - np.minimum(short, 0.5))
    errors = (task.real * point.errors).sum(axis=1)
    widened = square * wider**2 + task.C * errors * wider
    return np.where(short < 0.5, np.minimum(as_it_is, widened), as_it_is)


def _is_near(task: Task, point: Point, tol: float) -> bool:
    """Whether the products of any problem are about as small as its gap should be."""
    products = np.einsum("ij,ij->i", point.left, point.right)
    scale = np.einsum("ij,ij->i", task.real, point.alpha) - point.free[:, 1]
    return not bool((products > _NEAR * tol * scale).all())


class Best:
    """The point with the smallest gap met so far of each problem."""

    def __init__(self, point: Point, tol: float) -> None:
        n_problems = len(point.free)
        everywhere = np.arange(n_problems)
        self.point = point.take(everywhere)
        self.gap = np.full(n_problems, np.inf)
        self.n_iter = np.zeros(n_problems, dtype=np.int64)
        self._tol = tol
        self._found_at = np.zeros(n_problems, dtype=np.int64)
        self._rows = everywhere

    def improve(
        self, task: Task, point: Point, view: View, *, last: bool
    ) -> NDArray[np.bool_]:
        """Note what is better; return which problems should go on.

        The proof is left out, except for the `last` point, while all problems are
        far from their optimum by the sum of the products alone.
        """
        rows = self._rows
        if not (last or _is_near(task, point, self._tol)):
            self.n_iter[rows] += 1
            self._found_at[rows] = self.n_iter[rows]
            return np.ones(len(rows), dtype=bool)
        gap = relative_gap(task, point, view)
        better = gap < self.gap[rows]
        self.point.overwrite(rows[better], point.take(better))
        self.gap[rows[better]] = gap[better]
        self._found_at[rows[better]] = self.n_iter[rows[better]]
        waited = self.n_iter[rows] - self._found_at[rows]
        patience = np.where(self.gap[rows] > self._tol, _PATIENCE, _SHORT_PATIENCE)
        going = (self.gap[rows] > _AIM * self._tol) & (waited <= patience)
        self.n_iter[rows[going]] += 1
        return going

    def keep(self, going: NDArray) -> None:
        """Follow the batch as it drops the problems that are done."""
        self._rows = self._rows[going]

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
            view = part.view(sparse)
            found = relative_gap(part, sparse, view)
            fine = found <= np.maximum(self._tol, gap[rows])
            # Nothing is left out in the last round: that is how it must be.
            fine |= share_of_weight == share_of_alpha == 0
            done = rows[fine]
            point.overwrite(done, sparse.take(fine))
            gap[done], energies[done] = found[fine], view.energies[fine]
            rows = rows[~fine]
            if not len(rows):
                break
        weights = task.weights(point)
        return Solution(
            alpha=point.alpha,
            bias=point.free[:, 0],
            weights=weights,
            normal=task.system.normal(task, point),
            objective=point.alpha.sum(axis=1) - (weights * energies).sum(axis=1),
            gap=gap,
            n_iter=np.maximum(self.n_iter, 1),
        )
