"""SimpleMKL: multiple kernel learning by reduced gradient, as published.

The weights walk on the simplex: each step moves along the reduced gradient of
J(d), the objective of the ordinary machine of the summed kernel, until a weight
reaches zero or J rises, then searches the last stretch by golden section. It is
here to reproduce the literature; `solve_interior` reaches the same optimum sooner.

Each problem is a coroutine that asks for J at some weights. The problems of a batch
ask together, and their machines are solved together, each from the set of free
multipliers that its last one had.
"""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from ._mkl_machines import SingleKernelMachines
from ._mkl_problem import Floats, Solution
from ._mkl_systems import DenseKernels

_GOLDEN = (5**0.5 - 1) / 2
# The longest first move along a direction.
_FIRST_MOVE = 0.1


@dataclass
class Answer:
    """J at some weights, and the energies S_k, which are minus its gradient."""

    value: float
    energies: Floats


Walk = Generator[Floats, Answer, tuple[Floats, int]]


def solve_simplemkl(
    system: DenseKernels, C: float, *, tol: float = 1e-2, max_iter: int = 500
) -> Solution:
    """Solve multiple kernel learning for a batch of two-class problems.

    Parameters
    ----------
    system : DenseKernels
        Kernels and labels (+1, -1, or 0 for padding).
    C : float
        Price of a margin error.
    tol : float, default=1e-2
        Relative duality gap (J + max_k S_k - 1'a) / J at which a problem is done;
        the published value.
    max_iter : int, default=500
        Most directions taken.

    References
    ----------
    .. [1] A. Rakotomamonjy, F. R. Bach, S. Canu and Y. Grandvalet, "SimpleMKL",
       J. Mach. Learn. Res. 9, 2008.
    """
    machines = SingleKernelMachines(system, C)
    walks = [
        reduced_gradient_walk(system.n_kernels, tol, max_iter) for _ in system.labels
    ]
    asked = np.array([next(walk) for walk in walks])
    n_iter = np.ones(len(walks), dtype=np.int64)
    found = asked.copy()
    rows = np.arange(len(walks))
    while len(rows):
        values, energies = machines.evaluate(rows, asked[rows])
        going = []
        for row, value, energy in zip(rows, values, energies, strict=True):
            try:
                asked[row] = walks[row].send(Answer(float(value), energy))
                going.append(row)
            except StopIteration as stop:
                found[row], n_iter[row] = stop.value
        rows = np.array(going, dtype=np.int64)
    return machines.solution(found, n_iter)


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
    found = yield from _golden(weights, here, direction, move, precision)
    return found


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
    return moved / moved.sum()
