"""Kernel ridge regression solved exactly: the inverse, its blocks, and how it grows.

Adding ten touches to thousands changes little of an exact solution: with G the
inverse of the first touches, B their kernel with the later ones, W = G B and S the
later ones' own matrix less B^T W, the inverse of all is G, framed with zeros, plus
Z S^-1 Z^T with Z = [W; -I]. So G stays as it is, and each touch added costs as much as
one column of it.
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

from .._types import Array, Floats, Indices

# The inverse's root is kept in so many strips, none longer than its last row: together
# little more than the half below its diagonal.
_N_STRIPS = 16
# Touches of groups of one size that are left out at once.
_TOUCHES_AT_ONCE = 2000

# Rows of groups of one size, (n_groups, size), and the inverse's blocks of them.
Blocks = Iterable[tuple[Indices, Floats]]


class GrowingInverse:
    """What it takes to learn more touches without those before them again.

    Attributes `n_first`, `touches`, `labels` and `ridges`: how many the first touches
    are, and all that it has.

    Parameters
    ----------
    root : ndarray of shape (n_first, n_first)
        R below its diagonal, with R^T R the inverse of the first touches' kernel and
        ridge.
    touches : ndarray of shape (n_first, n_features)
        The first touches, in the order of the kernel.
    labels, ridges : ndarray of shape (n_first,)
        Their labels, and what was added to the kernel's diagonal for each.
    classes, coefficients : ndarray of shape (n_classes,) and (n_first, n_classes)
        The sorted labels, and the inverse times their one-hot columns.
    blocks : iterable of (ndarray of shape (n_groups, size), ndarray)
        Rows of groups of touches, and the inverse at them (n_groups, size, size).
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
