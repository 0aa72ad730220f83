"""A better start for very many touches: first learn from some of them.

A machine of a thousand touches, each standing for many, already knows about where
the hyperplane and the weights of all of them will be. Multipliers on the central path
of that hyperplane halve the iterations of the whole problem.
"""

import numpy as np

from ._mkl_interior import solve_interior
from ._mkl_nystroem import LowRankKernels
from ._mkl_problem import Floats, Point, Solution, Task, View, norms

_N_PILOT = 1000
_WORTHWHILE = 3 * _N_PILOT
_PILOT_TOL = 1e-3
# Where on the central path to start: the gap there, relative to the objective.
_START_GAP = 0.1
# No kernel starts with less than this share of the largest weight.
_LEAST_WEIGHT = 0.01


def solve_with_pilot(
    system: LowRankKernels, C: float, *, norm: float, tol: float, max_iter: int
) -> Solution:
    """Solve as `solve_interior` does, from the machine of some of the touches."""
    n = int(np.abs(system.labels).sum())
    start = _pilot_start(system, C, norm) if n > _WORTHWHILE else None
    return solve_interior(
        system, C, norm=norm, tol=tol, max_iter=max_iter, start=start
    )


def _pilot_start(system: LowRankKernels, C: float, norm: float) -> Point | None:
    some = _evenly(system.labels[0])
    part = system.part(some)
    each_stands_for = np.abs(system.labels).sum() / len(some)
    pilot = solve_interior(
        part, C * each_stands_for, norm=norm, tol=_PILOT_TOL, max_iter=50
    )
    normal = part.normal(pilot.alpha, pilot.weights)
    decisions = system.along(normal) + pilot.bias[:, None]
    gap = _START_GAP * float(pilot.objective[0])
    return _on_path(Task(system, C, norm), pilot, decisions, gap)


def _evenly(labels: Floats) -> Floats:
    """Positions of about a thousand touches, the same share of either label."""
    step = max(1, int(np.abs(labels).sum()) // _N_PILOT)
    chosen = [np.flatnonzero(labels == side)[::step] for side in (-1, 1)]
    return np.sort(np.concatenate(chosen))


def _on_path(task: Task, pilot: Solution, decisions: Floats, gap: float) -> Point:
    """The point of the central path, if the hyperplane were to stay where it is."""
    labels, C = task.labels, task.C
    n = labels.shape[1]
    centre = gap / (2 * n)
    short = task.real - labels * decisions
    high, low = _path(short, centre, C), _path(-short, centre, C)
    alpha = np.where(short > 0, C - low, high)
    plus = np.where(labels > 0, alpha, 0).sum()
    minus = np.where(labels < 0, alpha, 0).sum()
    least = min(plus, minus)
    sides = np.where(labels > 0, least / plus, least / minus)
    alpha = np.where(labels == 0, C / 2, alpha * sides)
    weights = np.maximum(pilot.weights, _LEAST_WEIGHT * pilot.weights.max())
    weights /= norms(weights, task.norm)[:, None]
    left = np.concatenate([alpha, C - alpha, weights], axis=1)
    free = np.stack([pilot.bias, np.zeros(1)], axis=1)
    point = Point(left, centre / left, free, n)
    energy = View(task, point).energies
    slope = weights ** (task.norm - 1)
    free[:, 1] = 1.05 * (energy / slope).max(axis=1)
    point.slack[...] = np.maximum(free[:, 1:] * slope - energy, centre / weights)
    return point


def _path(short: Floats, centre: float, C: float) -> Floats:
    """Solve centre / (C - a) - centre / a = short for a, exact where short < 0."""
    root = np.sqrt((short * C) ** 2 + 4 * centre**2)
    return 2 * centre * C / (2 * centre - short * C + root)
