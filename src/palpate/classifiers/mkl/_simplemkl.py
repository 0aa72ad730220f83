"""SimpleMKL: multiple kernel learning by reduced gradient, as published.

The weights walk on the simplex: each step moves along the reduced gradient of
J(d), the objective of the ordinary machine of the summed kernel, until a weight
reaches zero or J rises, then searches the last stretch by golden section. It is
here to reproduce the literature; `solve_interior` reaches the same optimum sooner.

Each problem is a coroutine that asks for J at some weights. The problems of a batch
ask together, and their machines are solved together, each from the set of free
multipliers that its last one had: which are free (neither 0 nor C) hardly changes, and
given that set a machine is one linear system. So the last set is tried first, corrected
a few times where the answer contradicts it, and only then is the interior point asked.
Every machine is accepted by its duality gap alone.
"""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from ..._types import Array, Floats
from ._kernels import DenseKernels
from ._problem import Point, Solution, Task, View, relative_gap, solve_interior

_GOLDEN = (5**0.5 - 1) / 2
# The longest first move along a direction.
_FIRST_MOVE = 0.1
# Relative gap at which a machine counts as exact.
_EXACT = 1e-9
# Corrections of the set of free multipliers.
_CORRECTIONS = 6
# Multipliers closer to a bound than this share of C are on it.
_ON_BOUND = 1e-7


@dataclass
class Answer:
    """J at some weights, and the energies S_k, which are minus its gradient."""

    value: float
    energies: Floats


Walk = Generator[Floats, Answer, tuple[Floats, int]]


def solve_simplemkl(
    system: DenseKernels, C: float, *, tol: float = 1e-2, max_iter: int = 500
) -> Solution:
    """Solve a batch of two-class problems in at most `max_iter` directions each.

    Done at the gap (J + max_k S_k - 1'a) / J `tol`, 0.01 as published: A. Rakotomamonjy
    et al., "SimpleMKL", J. Mach. Learn. Res. 9, 2008.
    """
    machines = SingleKernelMachines(system, C)
    walks = [
        reduced_gradient_walk(system.n_kernels, tol, max_iter) for _ in system.labels
    ]
    weights = np.array([next(walk) for walk in walks])
    n_iter = np.ones(len(walks), dtype=np.int64)
    solutions = weights.copy()
    rows = np.arange(len(walks))
    while len(rows):
        values, energies = machines.evaluate(rows, weights[rows])
        going = []
        for row, value, energy in zip(rows, values, energies, strict=True):
            try:
                weights[row] = walks[row].send(Answer(float(value), energy))
                going.append(row)
            except StopIteration as stop:
                solutions[row], n_iter[row] = stop.value
        rows = np.array(going, dtype=np.int64)
    return machines.solution(solutions, n_iter)


def reduced_gradient_walk(n_kernels: int, tol: float, max_iter: int) -> Walk:
    """Walk from equal weights to the optimum; return weights and directions taken."""
    weights = np.full(n_kernels, 1 / n_kernels)
    here = yield weights
    precision = 0.1
    for n_iter in range(1, max_iter + 1):
        gap = here.energies.max() - weights @ here.energies
        if gap <= tol * here.value:
            return weights, n_iter
        before = here.value
        weights, here = yield from _descend(weights, here, precision)
        if here.value >= before * (1 - 1e-12):
            # Nothing gained: search closer, until closer means rounding.
            if precision < 1e-9:
                return weights, n_iter
            precision *= 0.1
    return weights, max_iter


def _descend(
    weights: Floats, here: Answer, precision: float
) -> Generator[Floats, Answer, tuple[Floats, Answer]]:
    """Follow one reduced gradient: whole moves while J falls, then a search."""
    base = int(weights.argmax())
    slope = here.energies[base] - here.energies
    direction = np.where((weights <= 0) & (slope > 0), 0, -slope)
    direction[base] = 0
    direction[base] = -direction.sum()
    longest = _longest(weights, direction)
    move = min(longest, _FIRST_MOVE / max(np.abs(direction).max(), 1e-300))
    while np.isfinite(move) and move > 0:
        trial = _moved(weights, direction, move, move == longest)
        there = yield trial
        if there.value >= here.value:
            break
        weights, here = trial, there
        direction[(weights <= 0) & (direction < 0)] = 0
        direction[base] = 0
        direction[base] = -direction.sum()
        move = longest = _longest(weights, direction)
    else:
        return weights, here
    return (yield from _golden(weights, here, direction, move, precision))


def _golden(
    weights: Floats, here: Answer, direction: Floats, end: float, precision: float
) -> Generator[Floats, Answer, tuple[Floats, Answer]]:
    """Search the stretch [0, `end`] for the least J; return the best point met."""
    best, answer = weights, here
    low, high = 0.0, end
    inner, outer = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_inner = yield _moved(weights, direction, inner, False)
    at_outer = yield _moved(weights, direction, outer, False)
    while high - low > precision * end:
        if at_inner.value < at_outer.value:
            high, outer, at_outer = outer, inner, at_inner
            inner = high - _GOLDEN * (high - low)
            at_inner = yield _moved(weights, direction, inner, False)
        else:
            low, inner, at_inner = inner, outer, at_outer
            outer = low + _GOLDEN * (high - low)
            at_outer = yield _moved(weights, direction, outer, False)
    for step, there in ((inner, at_inner), (outer, at_outer)):
        if there.value < answer.value:
            best, answer = _moved(weights, direction, step, False), there
    return best, answer


def _longest(weights: Floats, direction: Floats) -> float:
    """The step at which the first weight reaches zero."""
    falling = direction < 0
    if not falling.any():
        return np.inf
    return float((weights[falling] / -direction[falling]).min())


def _moved(weights: Floats, direction: Floats, step: float, to_end: bool) -> Floats:
    """Weights moved; at the longest step the first to reach zero is exactly zero."""
    moved = np.maximum(weights + step * direction, 0)
    if to_end:
        reached = (direction < 0) & (moved <= 1e-12)
        moved[reached] = 0
    return np.asarray(moved / moved.sum())


class SingleKernelMachines:
    """Machines of a batch of problems, for weights that change little by little."""

    def __init__(self, system: DenseKernels, C: float) -> None:
        self._whole = self._system = system
        self._C = C
        n_problems, n = system.labels.shape
        self._rows = np.arange(n_problems)
        self._alpha = np.zeros((n_problems, n))
        self._bias = np.zeros(n_problems)
        self._state = np.zeros((n_problems, n), dtype=np.int8)

    def evaluate(self, rows: Array, weights: Floats) -> tuple[Floats, Floats]:
        """Return J (n_rows,) and the energies (n_rows, n_kernels) at `weights`."""
        if 2 * len(rows) <= len(self._rows):
            # The others are done: nobody asks about them any more.
            keep = np.isin(self._rows, rows)
            self._rows, self._system = self._rows[keep], self._system.take(keep)
        here = np.isin(self._rows, rows)
        full = np.full((len(self._rows), weights.shape[1]), 1 / weights.shape[1])
        full[here] = weights
        n_problems, n_kernels, n, _ = self._system.kernels.shape
        flat = self._system.kernels.reshape(n_problems, n_kernels, n * n)
        summed = (full[:, None, :] @ flat).reshape(n_problems, 1, n, n)
        self._solve(DenseKernels(summed, self._system.labels))
        alpha = self._alpha[self._rows]
        energies = _view(self._system, alpha, self._bias[self._rows], full)[2].energies
        values = alpha.sum(axis=1) - (full * energies).sum(axis=1)
        return values[here], energies[here]

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

    def _keep(self, rows: Array, alpha: Floats, bias: Floats, state: Array) -> None:
        self._alpha[rows], self._bias[rows], self._state[rows] = alpha, bias, state

    def solution(self, weights: Floats, n_iter: Array) -> Solution:
        self._system = self._whole
        self._rows = np.arange(len(weights))
        values, _ = self.evaluate(self._rows, weights)
        gap = _gap(self._whole, self._alpha, self._bias, self._C, weights)
        normal = self._whole.pulls(self._alpha)
        return Solution(self._alpha, self._bias, weights, normal, values, gap, n_iter)


def _guess(
    system: DenseKernels, state: Array, C: float
) -> tuple[Floats, Floats, Array]:
    """Solve for free multipliers (state 1), others at 0 or C (2), and for states."""
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


def _state(system: DenseKernels, solution: Solution, C: float) -> Array:
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
    system: DenseKernels, alpha: Floats, bias: Floats, weights: Floats, C: float = 1.0
) -> tuple[Task, Point, View]:
    left = np.concatenate([alpha, C - alpha, weights], axis=1)
    free = np.stack([bias, np.zeros(len(bias))], axis=1)
    point = Point(left, np.zeros_like(left), free, alpha.shape[1])
    task = Task(system, C, norm=1.0)
    return task, point, system.view(task, point)
