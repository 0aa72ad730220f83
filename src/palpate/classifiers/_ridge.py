"""Kernel ridge regression solved exactly, and its scores made posteriors.

Adding ten touches to thousands changes little of an exact solution: with G the
inverse of the first touches, B their kernel with the later ones, W = G B and S the
later ones' own matrix less B^T W, the inverse of all is G, framed with zeros, plus
Z S^-1 Z^T with Z = [W; -I]. So G stays as it is, and each touch added costs as much as
one column of it. Scores become posteriors by the temperature, bend and lean of least
log loss.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from copy import copy
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.optimize import minimize

from .._numbers import log_loss
from .._types import Array, Floats, Indices

# As many touches more as this share of the first ones are learnt by what they add.
GROWTH = 1 / 8
# The inverse's root is kept in so many strips, none longer than its last row: together
# little more than the half below its diagonal.
_N_STRIPS = 16
# Touches of groups of one size that are left out at once.
_TOUCHES_AT_ONCE = 2000
# Rows of groups of one size, (n_groups, size), and the inverse's blocks of them.
Blocks = Iterable[tuple[Indices, Floats]]
# Touches that shape it at once: their answers stay in a processor's cache.
_SHAPED_AT_ONCE = 256
# Where the search for a temperature begins, and where it stays.
USUAL_TEMPERATURE = 8.0
_TEMPERATURES = float(np.exp(-3)), float(np.exp(6))
# Temperature, bend and lean of a posterior, and from where the best ones are sought.
Shape = tuple[float, float, float]
USUAL_SHAPE = USUAL_TEMPERATURE, 0.5, 1.0


class GrowingInverse:
    """What it takes to learn more touches without those before them again.

    It is made of the `n_first` first touches (n_first, n_features), their `labels`, and
    the `ridges` that were added to the kernel's diagonal. `root` (n_first, n_first) is
    R below its diagonal, with R^T R the inverse of kernel and ridges; `coefficients`
    (n_first, n_classes) are that inverse times the one-hot columns of the sorted
    `classes`; `blocks` yield groups as `inverse_blocks` does.
    """

    def __init__(
        self,
        root: Floats,
        touches: Floats,
        labels: Array,
        ridges: Floats,
        classes: Array,
        coefficients: Floats,
        blocks: Iterable[tuple[Indices, Floats]],
    ) -> None:
        ends = np.linspace(0, len(root), _N_STRIPS + 1).astype(int)
        self._strips = [np.array(root[a:b, :b], order="C") for a, b in pairwise(ends)]
        self.touches = touches
        self.labels = labels
        self.ridges = ridges
        self._classes, self._coefficients = classes, coefficients
        self._blocks = {
            members.tobytes(): block
            for rows, inverses in blocks
            for members, block in zip(rows, inverses, strict=True)
        }
        self.n_first = len(touches)
        none = np.empty((len(touches), 0))
        self._between, self._solved, self._of_later = none, none, none[:0]
        self._factor: Any = None

    def begins(self, touches: Floats, labels: Array, ridges: Floats) -> bool:
        """Whether touches go on after those it has, with their labels and ridges."""
        n_known = len(self.touches)
        return (
            len(touches) > n_known
            and np.array_equal(touches[:n_known], self.touches)
            and np.array_equal(labels[:n_known], self.labels)
            and np.array_equal(ridges[:n_known], self.ridges)
        )

    def plus(
        self, touches: Floats, labels: Array, ridges: Floats, kernel: Floats
    ) -> Self:
        """Return this with the touches that come after those it has.

        Of all `touches` (n_touches, n_features), their `labels` and `ridges`, and the
        `kernel` of the new ones with all (n_new, n_touches).

        Raises
        ------
        LinAlgError
            If rounding hides the difference between two of them.
        """
        n_first, n_known = self.n_first, len(self.touches) - self.n_first
        n_added = len(touches) - n_first
        more = copy(self)
        more.touches, more.labels, more.ridges = touches, labels, ridges
        between = kernel[:, :n_first].T
        more._between = np.hstack([self._between, between])
        more._solved = np.hstack([self._solved, self._times_first(between)])
        later = np.empty((n_added, n_added))
        later[:n_known, :n_known] = self._of_later
        later[n_known:] = kernel[:, n_first:]
        later[:, n_known:] = kernel[:, n_first:].T
        more._of_later = later
        schur = later + np.diag(ridges[n_first:]) - more._between.T @ more._solved
        more._factor = cho_factor(schur)
        return more

    def coefficients(self, target: Floats, classes: Array) -> Floats:
        """Return the inverse times the labels' one-hot columns less 1 / n_classes."""
        n_classes = len(classes)
        first = np.zeros((self.n_first, n_classes))
        first[:, np.searchsorted(classes, self._classes)] = self._coefficients
        first -= first.sum(axis=1, keepdims=True) / n_classes
        frame = self._frame()
        result: Floats = frame @ cho_solve(self._factor, frame.T @ target)
        result[: self.n_first] += first
        return result

    def blocks(self, by_size: Iterable[Indices]) -> Iterator[tuple[Indices, Floats]]:
        """Yield rows of groups of one size, each sorted, and the inverse at them."""
        frame = self._frame()
        through = np.ascontiguousarray(cho_solve(self._factor, frame.T).T)
        for rows in by_size:
            blocks = frame[rows] @ through[rows].transpose(0, 2, 1)
            for members, block in zip(rows, blocks, strict=True):
                first = members[: np.searchsorted(members, self.n_first)]
                block[: len(first), : len(first)] += self._first_block(first)
            yield rows, blocks

    def _frame(self) -> Floats:
        """Return Z."""
        return np.vstack([self._solved, -np.eye(self._solved.shape[1])])

    def _first_block(self, rows: Indices) -> Floats:
        block = self._blocks.get(rows.tobytes())
        if block is None:
            block = np.zeros((len(rows), len(rows)))
            for strip in self._strips:
                n_here = np.searchsorted(rows, strip.shape[1])
                columns = strip[:, rows[:n_here]]
                block[:n_here, :n_here] += columns.T @ columns
            self._blocks[rows.tobytes()] = block
        return block

    def _times_first(self, values: Floats) -> Floats:
        result = np.zeros_like(values, order="C")
        for strip in self._strips:
            width = strip.shape[1]
            result[:width] += strip.T @ (strip @ values[:width])
        return result


def squared_distances_to(touches: Array, squares: Array, centred: Array) -> Array:
    """Return those to touches of known squared length, (n_centred, n_touches)."""
    squared: Array = (-2 * centred) @ touches.T
    squared += np.einsum("ij,ij->i", centred, centred)[:, np.newaxis]
    squared += squares
    np.maximum(squared, 0, out=squared)
    return squared


def squared_distances(touches: Floats) -> Floats:
    """Return those between touches, made in one piece of memory."""
    squared = touches @ touches.T
    norms = squared.diagonal().copy()
    squared *= -2
    squared += norms
    squared += norms[:, np.newaxis]
    np.maximum(squared, 0, out=squared)
    np.fill_diagonal(squared, 0)
    return np.asarray(squared)


def solve_ridge(
    kernel: Floats, target: Floats, ridges: Floats | float
) -> tuple[Floats, Floats]:
    """Return R with R^T R = inverse of (kernel + ridges), in place, and coefficients.

    The ridges, one for each touch or one for all, are added to the diagonal.
    """
    kernel.flat[:: len(kernel) + 1] += ridges
    factor, failed = dpotrf(kernel.T, lower=1, clean=1, overwrite_a=1)
    if failed:
        raise ValueError(
            "X must not hold touches so far from the others that distances among those "
            "are lost in rounding. Leave them out, or scale the features."
        )
    root = dtrtri(factor, lower=1, overwrite_c=1)[0]
    return root, root.T @ (root @ target)


def rows_by_size(group: Array) -> list[Indices]:
    """Return rows of groups of one size, (n_groups, size), so many at a time."""
    by_size: dict[int, list[Indices]] = {}
    for members in group_members(group):
        by_size.setdefault(len(members), []).append(members)
    return [
        np.stack(groups[first : first + at_once])
        for size, groups in by_size.items()
        for at_once in [max(1, _TOUCHES_AT_ONCE // size)]
        for first in range(0, len(groups), at_once)
    ]


def inverse_blocks(root: Floats, by_size: list[Indices]) -> Blocks:
    """Yield groups of one size, some at a time, and the inverse's block of each."""
    for rows in by_size:
        columns = root.T[rows]
        yield rows, columns @ columns.transpose(0, 2, 1)


def left_out_scores(blocks: Blocks, coefficients: Floats, target: Floats) -> Floats:
    """Scores of every touch had its group never been learnt."""
    scores: Floats = target + 1 / target.shape[1]
    for rows, inverse in blocks:
        scores[rows] -= np.linalg.solve(inverse, coefficients[rows])
    return scores


def group_members(group: Array) -> list[NDArray[np.intp]]:
    """Return the touches of each group."""
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)


def best_shape(
    scores: Floats, codes: Array, counts: Indices, start: Shape = USUAL_SHAPE
) -> tuple[Shape, float]:
    """Return (temperature, bend, lean) with the least log loss, and that loss (nats).

    Of touches of labels of which so many were learnt (`counts`). The lean counts where
    these numbers are unequal, and is 1 elsewhere. What is divided by is at least the
    share of training touches, as Bayes' rule says: touches left out lie among those of
    their recording, and show less lean than others will.
    """
    log_counts = log_counts_of(counts)
    shares, size = fair_shares(codes), np.abs(scores)
    n_free = 3 if np.ptp(log_counts) > 0 else 2

    def loss(raw: Floats) -> tuple[float, Floats]:
        temperature, bend = np.exp(raw[:2])
        lean = raw[2] if n_free > 2 else 1.0
        value, slopes = 0.0, np.zeros(3)
        for first in range(0, len(codes), _SHAPED_AT_ONCE):
            rows = slice(first, first + _SHAPED_AT_ONCE)
            damping = 1 + bend * size[rows]
            by_temperature = temperature * scores[rows] / damping
            logits = by_temperature - lean * log_counts
            part, pull = log_loss(logits, codes[rows], shares[rows])
            value += part
            slopes[0] += np.vdot(pull, by_temperature)
            slopes[2] -= pull.sum(axis=0) @ log_counts
            by_temperature /= damping
            by_temperature *= size[rows]
            slopes[1] -= bend * np.vdot(pull, by_temperature)
        return value, slopes[:n_free]

    solution = minimize(
        loss,
        [*np.log(start[:2]), start[2]][:n_free],
        jac=True,
        bounds=[tuple(np.log(_TEMPERATURES)), (-8.0, 6.0), (1.0, 6.0)][:n_free],
        method="L-BFGS-B",
        options={"ftol": 1e-13, "gtol": 1e-9},
    )
    lean = float(solution.x[2]) if n_free > 2 else 1.0
    return (*np.exp(solution.x[:2]).tolist(), lean), float(solution.fun)


def smoothed_loss(
    scores: Floats, codes: Array, temperature: float
) -> tuple[float, float]:
    """Return the log loss of smoothed labels (nats) and its best temperature.

    But for a constant. `temperature` is where to begin. Of n touches each counts as
    (n + 1) / (n + 2) of its label and shares the rest among the others: none of n does
    not mean never (Laplace's rule of succession; Platt, "Probabilistic outputs for
    support vector machines", 1999).
    Where all touches are told apart, the plain loss falls with the temperature for
    ever, and what is left is rounding; this one asks for wide and even gaps. It is
    convex: Newton's method.
    """
    n_touches, n_classes = scores.shape
    log_counts = log_counts_of(np.bincount(codes, minlength=n_classes))
    shares = fair_shares(codes)
    others = 1 / (n_touches + 2) / max(1, n_classes - 1)
    gaps = scores - scores[np.arange(n_touches), codes][:, np.newaxis]
    squares = gaps**2
    drift = -others * (shares @ gaps.sum(axis=1))
    low, high = _TEMPERATURES
    while True:
        loss, pull = log_loss(temperature * gaps - log_counts, codes, shares)
        slopes = np.einsum("ij,ij->i", pull, gaps)
        slope = slopes.sum() + drift
        curve = np.vdot(pull, squares) - slopes @ (slopes / shares)
        low, high = (low, temperature) if slope > 0 else (temperature, high)
        if slope**2 <= 1e-12 * curve or high < (1 + 1e-9) * low:
            return float(loss + temperature * drift), temperature
        temperature -= slope / curve if curve > 0 else np.inf
        if not low < temperature < high:
            temperature = float(np.sqrt(low * high))


def fair_shares(codes: Array) -> Floats:
    """Return the share of each touch in a mean to which all labels add the same."""
    counts = np.bincount(codes)
    return 1 / (counts[codes] * np.count_nonzero(counts))


def log_counts_of(counts: Indices) -> Floats:
    return np.asarray(np.log(np.maximum(counts, 1)))
