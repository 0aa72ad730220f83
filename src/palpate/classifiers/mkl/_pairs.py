"""One machine for each pair of classes, learnt in batches; votes and probabilities.

A positive decision of a pair speaks for its second class. Votes decide the label; for
probabilities each pair gets a sigmoid, fitted to decisions about touches that were
left out, and the pairs are coupled into one distribution.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import expit, log_softmax, softmax

from ..._types import Array, Floats
from ._kernels import DenseBank
from ._landmarks import NystroemBank
from ._problem import Solution, row_blocks, solve_interior
from ._simplemkl import solve_simplemkl

# Pairs smaller than this share of the largest of their batch wait for the next one.
_ALIKE = 0.8
Bank = DenseBank | NystroemBank
# Relative gap of the machines that only serve to calibrate probabilities.
_CALIBRATION_TOL = 1e-4
_N_PARTS = 5
_NEWTON_STEPS = 50
# No pair is surer than this.
_SUREST = 1e-7


@dataclass(frozen=True)
class Settings:
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
    for rows, index, labels in _batches(bank, codes, machines.pairs):
        system: Any = bank.system(index, labels)
        solution = settings.solve(system)
        learnt = bank.machines(system, index, solution)
        machines.coefficients[rows], machines.bias[rows] = learnt
        machines.weights[rows] = solution.weights
        machines.gap[rows], machines.objective[rows] = solution.gap, solution.objective
        machines.n_iter[rows] = solution.n_iter
        if settings.calibrate:
            folds = folds_of(codes)[index]
            scores, left_out_labels = _left_out_scores(
                system, solution, folds, bank.n_folds, settings
            )
            machines.sigmoids[rows] = fit_sigmoids(scores, left_out_labels)
            row, place = np.nonzero(left_out_labels)
            other = np.where(left_out_labels[row, place] > 0, 0, 1)
            columns = machines.pairs[rows[row], other]
            machines.left_out[index[row, place], columns] = scores[row, place]
    return machines


def folds_of(codes: Array) -> Array:
    """Cut each class into five blocks, since neighbours are alike.

    The only touch of a class is in none: -1.
    """
    by_class, counts, starts = _classes(codes)
    place = np.empty(len(codes), dtype=np.int64)
    place[by_class] = np.arange(len(codes)) - starts[codes[by_class]]
    return np.where(counts[codes] == 1, -1, _N_PARTS * place // counts[codes])


def _classes(codes: Array) -> tuple[Array, Array, Array]:
    """Return touches class by class, how many each has, and where it begins."""
    counts = np.bincount(codes)
    return np.argsort(codes, kind="stable"), counts, np.cumsum(counts) - counts


def _batches(
    bank: Bank, codes: Array, pairs: Array
) -> Iterator[tuple[Array, Array, Floats]]:
    """Yield rows of `pairs`, touches of each row, and their labels (0 pads)."""
    by_class, counts, starts = _classes(codes)
    sizes = counts[pairs].sum(axis=1)
    order = np.argsort(-sizes, kind="stable")
    start = 0
    while start < len(order):
        largest = int(sizes[order[start]])
        rows = order[start : start + bank.batch_size(largest)]
        rows = rows[sizes[rows] >= _ALIKE * largest]
        start += len(rows)
        first, second = pairs[rows].T[:, :, None]
        place = np.arange(largest)
        n_first, real = counts[first], place < sizes[rows, None]
        offset = np.where(place < n_first, starts[first], starts[second] - n_first)
        index = np.where(real, by_class[np.where(real, offset + place, 0)], 0)
        yield rows, index, np.where(place < n_first, -1.0, real)


def _left_out_scores(
    system: Any, solution: Solution, folds: Array, n_folds: int, settings: Settings
) -> tuple[Floats, Floats]:
    """Return decisions of machines that did not learn the touch, and labels, or 0.

    For the only touch of a class the machine that learnt it must do.
    """
    labels = system.labels
    lone = (folds == -1) & (labels != 0)
    scores = np.where(lone, system.decisions(solution), 0)
    left_out_labels = np.where(lone, labels, 0)
    for fold in range(n_folds):
        out = (folds == fold) & (labels != 0)
        part = system.with_labels(np.where(out, 0, labels))
        rest = settings.solve(part, roughly=True)
        scores = np.where(out, part.decisions(rest), scores)
        left_out_labels = np.where(out, labels, left_out_labels)
    return scores, left_out_labels


def all_pairs(n_classes: int) -> Array:
    """Return the pairs of classes (first, second), shape (n_pairs, 2)."""
    return np.array([*combinations(range(n_classes), 2)])


def vote(decisions: Floats, pairs: Array, n_classes: int) -> Floats:
    """Return votes (n_touches, n_classes) of decisions (n_touches, n_pairs).

    Zero gives each class half a vote; sums of decisions, below half a vote, break ties.
    """
    signed = np.zeros((len(pairs), n_classes))
    signed[np.arange(len(pairs)), pairs[:, 0]] = -1
    signed[np.arange(len(pairs)), pairs[:, 1]] = 1
    votes = (np.sign(decisions) @ signed + n_classes - 1) / 2
    clear = decisions @ signed
    return np.asarray(votes + clear / (3 * (np.abs(clear) + 1)))


def fit_sigmoids(scores: Floats, labels: Floats) -> Floats:
    """Fit P(label +1) = 1 / (1 + exp(-(slope * score + offset))) per row, (n_pairs, 2).

    Labels (n_pairs, n_touches) are +1, -1, or 0 for padding; slopes never negative.
    H.-T. Lin et al., "A note on Platt's probabilistic outputs for support vector
    machines", Mach. Learn. 68, 2007, doi:10.1007/s10994-007-5018-6.
    """
    counted = np.abs(labels)
    n_plus = (labels > 0).sum(axis=1, keepdims=True)
    n_minus = (labels < 0).sum(axis=1, keepdims=True)
    target = np.where(labels > 0, (n_plus + 1) / (n_plus + 2), 1 / (n_minus + 2))
    unit = np.sqrt((counted * scores**2).sum(axis=1) / counted.sum(axis=1))
    unit = np.where(unit > 0, unit, 1)[:, None]
    inputs = np.stack([scores / unit, np.ones_like(scores)], axis=2)
    prior = np.log((n_plus + 1) / (n_minus + 1))
    start: Floats = np.concatenate([np.zeros_like(prior), prior], axis=1)
    sigmoid = start
    for _ in range(_NEWTON_STEPS):
        chance = expit((inputs @ sigmoid[:, :, None])[:, :, 0])
        gradient = (counted * (chance - target))[:, None, :] @ inputs
        curvature = (counted * chance * (1 - chance))[:, :, None] * inputs
        hessian = inputs.transpose(0, 2, 1) @ curvature + 1e-10 * np.eye(2)
        step = np.linalg.solve(hessian, -gradient.transpose(0, 2, 1))[:, :, 0]
        sigmoid = _shortened(sigmoid, step, inputs, target, counted)
        if np.abs(step).max() < 1e-9:
            break
    sigmoid = np.where(sigmoid[:, :1] > 0, sigmoid, start)
    sigmoid[:, 0] /= unit[:, 0]
    return sigmoid


def _shortened(
    sigmoid: Floats, step: Floats, inputs: Floats, target: Floats, counted: Floats
) -> Floats:
    """Halve the step of each row until the loss no longer rises."""

    def loss(at: Floats) -> Floats:
        z = (inputs @ at[:, :, None])[:, :, 0]
        return np.asarray((counted * (np.logaddexp(0, z) - target * z)).sum(axis=1))

    before = loss(sigmoid)
    length = np.ones((len(sigmoid), 1))
    for _ in range(20):
        worse = loss(sigmoid + length * step) > before + 1e-12 * np.abs(before)
        if not worse.any():
            break
        length[worse] *= 0.5
    return sigmoid + length * step


def couple(decisions: Floats, sigmoids: Floats, pairs: Array) -> Floats:
    """Return p (n_touches, n_classes) of least sum of (r_ji p_i - r_ij p_j)^2.

    r_ij is what the sigmoid says for class i. T.-F. Wu et al., "Probability estimates
    for multi-class classification by pairwise coupling", JMLR 5, 2004.
    """
    n_classes = int(pairs.max()) + 1
    second = expit(decisions * sigmoids[:, 0] + sigmoids[:, 1])
    second = second.clip(_SUREST, 1 - _SUREST)
    if n_classes == 2:
        return np.concatenate([1 - second, second], axis=1)
    chances = np.empty((len(second), n_classes))
    for rows in row_blocks(len(second), 3 * (n_classes + 1) ** 2):
        chances[rows] = _couple(second[rows], pairs, n_classes)
    return chances


def _couple(second: Floats, pairs: Array, n_classes: int) -> Floats:
    """Couple a block of touches; `second` is the chance of each second class."""
    n_touches, (i, j) = len(second), pairs.T
    system = np.zeros((n_touches, n_classes + 1, n_classes + 1))
    system[:, i, j] = system[:, j, i] = -second * (1 - second)
    against = np.zeros((n_touches, n_classes, n_classes))
    against[:, i, j], against[:, j, i] = second, 1 - second
    each = np.arange(n_classes)
    system[:, each, each] = (against**2).sum(axis=2)
    system[:, n_classes, :n_classes] = system[:, :n_classes, n_classes] = 1
    right = np.zeros((n_classes + 1, 1))
    right[n_classes] = 1
    solved = np.linalg.solve(system, right)[:, :n_classes, 0]
    solved = np.maximum(solved, 0)
    return np.asarray(solved / solved.sum(axis=1, keepdims=True))


def put_left_out(
    decisions: Floats, left_out: Floats, codes: Array, pairs: Array
) -> None:
    """Replace decisions (n_touches, n_pairs) of own pairs by those `left_out`."""
    for number, (first, second) in enumerate(pairs):
        for label, other in ((first, second), (second, first)):
            rows = codes == label
            decisions[rows, number] = left_out[rows, other]


def fit_temperature(chances: Floats, codes: Array) -> float:
    """Return the power of coupled probabilities with the least log loss.

    Coupled pairs are too cautious. One touch in n + 2 counts as another class's, so
    that no power is infinite.
    """
    if not len(chances):
        return 1.0
    logs = np.log(np.maximum(chances, np.finfo(float).tiny))
    target = np.zeros_like(logs)
    target[np.arange(len(codes)), codes] = 1
    doubt = 1 / (len(codes) + 2)
    target = (1 - doubt) * target + doubt * (1 - target) / (logs.shape[1] - 1)

    def loss(log_power: float) -> float:
        return float(-(target * log_softmax(np.exp(log_power) * logs, axis=1)).sum())

    return float(np.exp(minimize_scalar(loss, bounds=(-3, 3), method="bounded").x))


def sharpen(chances: Floats, power: float) -> Floats:
    """Raise probabilities to a power and let them sum to one again."""
    logs = np.log(np.maximum(chances, np.finfo(float).tiny))
    return np.asarray(softmax(power * logs, axis=1))


def side_with_votes(probabilities: Floats, winners: Array) -> Floats:
    """Return the nearest distribution, by squares, whose largest is the winner."""
    rows = np.arange(len(winners))
    chance = probabilities.copy()
    order = np.argsort(-chance, axis=1)
    falling = np.take_along_axis(chance, order, axis=1)
    winner_chance = chance[rows, winners]
    counts = np.arange(1, chance.shape[1] + 1)
    shared = (np.cumsum(falling, axis=1) + winner_chance[:, None]) / (counts + 1)
    above = falling > winner_chance[:, None]
    # Classes join the winner from the top while they are above the mean so far.
    before = np.concatenate([winner_chance[:, None], shared[:, :-1]], axis=1)
    joins = np.logical_and.accumulate(above & (falling > before), axis=1)
    n_joined = joins.sum(axis=1)
    changed = n_joined > 0
    level = shared[rows, np.maximum(n_joined - 1, 0)]
    joined = np.zeros_like(joins)
    np.put_along_axis(joined, order, joins, axis=1)
    chance = np.where(joined, level[:, None], chance)
    # A hair more, so that the winner is the largest for whoever looks.
    chance[rows[changed], winners[changed]] = level[changed] * (1 + 1e-9)
    return np.asarray(chance / chance.sum(axis=1, keepdims=True))
