"""Ordinary support vector machines for summed kernels, many at once, again and again.

SimpleMKL asks for the machines of slightly different weights hundreds of times. Which
multipliers are free (neither 0 nor C) hardly changes, and given that set a machine is
one linear system. So the last set is tried first, corrected a few times where the
answer contradicts it, and only then is the interior point asked. Every machine is
accepted by its duality gap alone.
"""

import numpy as np
from numpy.typing import NDArray

from ._mkl_gap import relative_gap
from ._mkl_interior import solve_interior
from ._mkl_problem import Floats, Point, Solution, Task, View
from ._mkl_systems import DenseKernels

# Relative gap at which a machine counts as exact.
_EXACT = 1e-9
# Corrections of the set of free multipliers.
_CORRECTIONS = 6
# Multipliers closer to a bound than this share of C are on it.
_ON_BOUND = 1e-7


class SingleKernelMachines:
    """Machines of a batch of problems, for weights that change little by little.

    Parameters
    ----------
    system : DenseKernels
        Kernels and labels of the batch.
    C : float
    """

    def __init__(self, system: DenseKernels, C: float) -> None:
        self._whole = self._system = system
        self._C = C
        n_problems, n = system.labels.shape
        self._rows = np.arange(n_problems)
        self._alpha = np.zeros((n_problems, n))
        self._bias = np.zeros(n_problems)
        self._state = np.zeros((n_problems, n), dtype=np.int8)

    def evaluate(self, rows: NDArray, weights: Floats) -> tuple[Floats, Floats]:
        """Return J (n_rows,) and the energies (n_rows, n_kernels) at `weights`."""
        self._follow(rows)
        here = np.isin(self._rows, rows)
        full = np.full((len(self._rows), weights.shape[1]), 1 / weights.shape[1])
        full[here] = weights
        self._solve(_summed(self._system, full))
        alpha = self._alpha[self._rows]
        energies = _view(self._system, alpha, self._bias[self._rows], full)[2].energies
        values = alpha.sum(axis=1) - (full * energies).sum(axis=1)
        return values[here], energies[here]

    def _follow(self, rows: NDArray) -> None:
        """Drop problems that nobody asks about any more."""
        if 2 * len(rows) <= len(self._rows):
            keep = np.isin(self._rows, rows)
            self._rows, self._system = self._rows[keep], self._system.take(keep)

    def _solve(self, summed: DenseKernels) -> None:
        """Bring multipliers and biases of the current problems up to date."""
        rows = self._rows
        state = self._state[rows]
        left = np.arange(len(rows))
        for _ in range(_CORRECTIONS if state.any() else 0):
            part = summed if len(left) == len(rows) else summed.take(left)
            alpha, bias, wrong = _guess(part, state[left], self._C)
            fine = _gap(part, alpha, bias, self._C) <= _EXACT
            self._keep(rows[left[fine]], alpha[fine], bias[fine], state[left[fine]])
            state[left] = wrong
            left = left[~fine]
            if not len(left):
                return
        part = summed.take(left)
        exact = solve_interior(part, self._C, tol=_EXACT)
        self._keep(rows[left], exact.alpha, exact.bias, _state(part, exact, self._C))

    def _keep(self, rows: NDArray, alpha: Floats, bias: Floats, state: NDArray) -> None:
        self._alpha[rows], self._bias[rows], self._state[rows] = alpha, bias, state

    def solution(self, weights: Floats, n_iter: NDArray) -> Solution:
        """Return the machines at the final `weights`, with the gap of the whole."""
        self._system = self._whole
        self._rows = np.arange(len(weights))
        values, _ = self.evaluate(self._rows, weights)
        gap = _gap(self._whole, self._alpha, self._bias, self._C, weights)
        normal = self._whole.pulls(self._alpha)
        return Solution(self._alpha, self._bias, weights, normal, values, gap, n_iter)


def _summed(system: DenseKernels, weights: Floats) -> DenseKernels:
    """The summed kernel as the only one."""
    n_problems, n_kernels, n, _ = system.kernels.shape
    flat = system.kernels.reshape(n_problems, n_kernels, n * n)
    summed = (weights[:, None, :] @ flat).reshape(n_problems, 1, n, n)
    return DenseKernels(summed, system.labels)


def _guess(
    system: DenseKernels, state: NDArray, C: float
) -> tuple[Floats, Floats, NDArray]:
    """Solve for the free multipliers (state 1) with the others at 0 or C (2).

    Also returns the state that the answer speaks for.
    """
    labels = system.labels
    n_problems, n = labels.shape
    free = state == 1
    bound = np.where(state == 2, C, 0.0)
    signed = system.kernels[:, 0] * labels[:, :, None] * labels[:, None, :]
    matrix = np.zeros((n_problems, n + 1, n + 1))
    both = free[:, :, None] & free[:, None, :]
    matrix[:, :n, :n] = np.where(both, signed, 0)
    matrix[:, np.arange(n), np.arange(n)] += ~free
    matrix[:, n, :n] = matrix[:, :n, n] = np.where(free, labels, 0)
    matrix[:, n, n] = np.where(free.any(axis=1), 0, 1)
    missing = np.abs(labels) - (signed @ bound[:, :, None])[:, :, 0]
    right = np.zeros((n_problems, n + 1, 1))
    right[:, :n, 0] = np.where(free, missing, bound)
    right[:, n, 0] = -(labels * bound).sum(axis=1)
    try:
        solved = np.linalg.solve(matrix, right)[:, :, 0]
    except np.linalg.LinAlgError:
        solved = np.full((n_problems, n + 1), np.nan)
    alpha, bias = solved[:, :n], solved[:, n]
    gain = np.abs(labels) - (signed @ alpha[:, :, None])[:, :, 0]
    gain -= labels * bias[:, None]
    wrong = np.where(free, 1 + (alpha > C) - (alpha < 0), state)
    wrong[(state == 0) & (gain > 0) & (labels != 0)] = 1
    wrong[(state == 2) & (gain < 0)] = 1
    return alpha, bias, wrong.astype(np.int8)


def _state(system: DenseKernels, solution: Solution, C: float) -> NDArray:
    """0 where a multiplier is zero, 2 where it is C, 1 between."""
    state = np.ones(solution.alpha.shape, dtype=np.int8)
    state[solution.alpha <= _ON_BOUND * C] = 0
    state[solution.alpha >= (1 - _ON_BOUND) * C] = 2
    state[system.labels == 0] = 0
    return state


def _gap(
    system: DenseKernels,
    alpha: Floats,
    bias: Floats,
    C: float,
    weights: Floats | None = None,
) -> Floats:
    """Relative duality gap of the machines; infinite outside the bounds."""
    weights = np.ones((len(alpha), 1)) if weights is None else weights
    outside = ~((alpha >= -1e-9 * C) & (alpha <= C * (1 + 1e-9))).all(axis=1)
    with np.errstate(all="ignore"):
        task, point, view = _view(system, alpha, bias, weights, C)
        point.errors[...] = np.maximum(view.missing, 0)
        gap = relative_gap(task, point, view)
    return np.where(outside, np.inf, gap)


def _view(
    system: DenseKernels,
    alpha: Floats,
    bias: Floats,
    weights: Floats,
    C: float = 1.0,
) -> tuple[Task, Point, View]:
    left = np.concatenate([alpha, C - alpha, weights], axis=1)
    free = np.stack([bias, np.zeros(len(bias))], axis=1)
    point = Point(left, np.zeros_like(left), free, alpha.shape[1])
    task = Task(system, C, norm=1.0)
    return task, point, system.view(task, point)
