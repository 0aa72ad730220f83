"""One machine for each pair of classes, learnt in batches."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._types import Array, Floats
from ._interior import solve_interior
from ._kernels import Bank
from ._posterior import all_pairs, fit_sigmoids
from ._problem import Solution
from ._simplemkl import solve_simplemkl

# Pairs smaller than this share of the largest of their batch wait for the next one.
_ALIKE = 0.8
# Relative gap of the machines that only serve to calibrate probabilities.
_CALIBRATION_TOL = 1e-4
_N_PARTS = 5


@dataclass(frozen=True)
class Settings:
    """How to learn a pair."""

    C: float
    norm: float
    solver: str
    tol: float
    max_iter: int
    calibrate: bool

    def solve(self, system: Any, *, roughly: bool = False) -> Solution:
        """Solve by the solver asked for, or well enough to calibrate by."""
        limits: dict[str, Any] = {"tol": self.tol, "max_iter": self.max_iter}
        if roughly:
            limits["tol"] = max(self.tol, _CALIBRATION_TOL)
        elif self.solver == "simplemkl":
            return solve_simplemkl(system, self.C, **limits)
        return solve_interior(system, self.C, norm=self.norm, **limits)


class PairMachines:
    """The machines of all pairs, a row per pair.

    `sigmoids` (n_pairs, 2) are slope and offset for the second class, zero if
    uncalibrated; `left_out` (n_touches, n_classes) decisions of machines that did not
    learn the touch.
    """

    def __init__(
        self, n_classes: int, n_kernels: int, n_columns: int, n_touches: int
    ) -> None:
        self.pairs = all_pairs(n_classes)
        n_pairs = len(self.pairs)
        self.coefficients = np.zeros((n_pairs, n_columns))
        self.weights = np.zeros((n_pairs, n_kernels))
        self.bias, self.objective, self.gap = np.zeros((3, n_pairs))
        self.n_iter = np.zeros(n_pairs, dtype=np.int64)
        self.sigmoids = np.zeros((n_pairs, 2))
        self.left_out = np.full((n_touches, n_classes), np.nan)


def learn_pairs(bank: Bank, codes: Array, settings: Settings) -> PairMachines:
    """Learn a machine for each pair of the classes `codes`, each of which occurs."""
    n_classes = int(codes.max()) + 1
    n_kernels, n_touches = len(bank.scales), len(codes)
    machines = PairMachines(n_classes, n_kernels, bank.n_columns, n_touches)
    folds = _folds(codes)
    for rows, index, labels in _batches(bank, codes, machines.pairs):
        system = bank.system(index, labels)
        solution = settings.solve(system)
        made = bank.machines(system, index, solution)
        machines.coefficients[rows], machines.bias[rows] = made
        machines.weights[rows] = solution.weights
        machines.gap[rows], machines.objective[rows] = solution.gap, solution.objective
        machines.n_iter[rows] = solution.n_iter
        if settings.calibrate:
            scores, known = _left_out_scores(
                system, solution, folds[index], bank.n_folds, settings
            )
            machines.sigmoids[rows] = fit_sigmoids(scores, known)
            row, place = np.nonzero(known)
            other = np.where(known[row, place] > 0, 0, 1)
            columns = machines.pairs[rows[row], other]
            machines.left_out[index[row, place], columns] = scores[row, place]
    return machines


def _batches(
    bank: Bank, codes: Array, pairs: Array
) -> Iterator[tuple[Array, Array, Floats]]:
    """Yield rows of `pairs`, touches of each row, and their labels (0 pads)."""
    members = [np.flatnonzero(codes == c) for c in range(pairs.max() + 1)]
    counts = np.array([len(m) for m in members])
    sizes = counts[pairs].sum(axis=1)
    order = np.argsort(-sizes, kind="stable")
    start = 0
    while start < len(order):
        largest = int(sizes[order[start]])
        rows = order[start : start + bank.batch_size(largest)]
        rows = rows[sizes[rows] >= _ALIKE * largest]
        start += len(rows)
        index = np.zeros((len(rows), largest), dtype=np.int64)
        labels = np.zeros((len(rows), largest))
        for row, (first, second) in enumerate(pairs[rows]):
            n_first, n_both = counts[first], counts[first] + counts[second]
            index[row, :n_first] = members[first]
            index[row, n_first:n_both] = members[second]
            labels[row, :n_first], labels[row, n_first:n_both] = -1, 1
        yield rows, index, labels


def _folds(codes: Array) -> NDArray[np.int64]:
    """Part of each touch: each class cut into five blocks, since neighbours are alike.

    The only touch of a class is in no part: -1.
    """
    folds = np.empty(len(codes), dtype=np.int64)
    for code in np.unique(codes):
        members = np.flatnonzero(codes == code)
        folds[members] = _N_PARTS * np.arange(len(members)) // len(members)
        if len(members) == 1:
            folds[members] = -1
    return folds


def _left_out_scores(
    system: Any, solution: Solution, folds: Array, n_folds: int, settings: Settings
) -> tuple[Floats, Floats]:
    """Return decisions of machines that did not learn the touch, and labels, or 0.

    For the only touch of a class the machine that learnt it must do.
    """
    labels = system.labels
    lone = (folds == -1) & (labels != 0)
    scores = np.where(lone, system.decisions(solution), 0)
    known = np.where(lone, labels, 0)
    for fold in range(n_folds):
        out = (folds == fold) & (labels != 0)
        part = system.with_labels(np.where(out, 0, labels))
        rest = settings.solve(part, roughly=True)
        scores = np.where(out, part.decisions(rest), scores)
        known = np.where(out, labels, known)
    return scores, known
