"""Kernel ridge regression of very many touches: some of them are landmarks for all.

With more touches than a kernel matrix is for, some of them are landmarks for all
(Nystroem features [1]_). What is learnt follows from sums over touches: of products of
their kernels with the landmarks, and of these kernels for each label. So touches pass
in blocks, in any order and wherever a block lies. No array has a row for each touch and
a column for each label, and a few touches more or fewer change what was learnt by what
they add to the sums.

References
----------
.. [1] C. K. I. Williams, M. Seeger, "Using the Nystroem method to speed up kernel
   machines", NIPS 13, 2001.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.linalg.blas import dsyrk

from .._numbers import exp
from .._parallel import results_of
from .._types import Array, Floats, Indices
from ._ridge import GROWTH, group_members, squared_distances_to

# Touches whose kernel with the landmarks is in memory at once, and in one task.
TOUCHES_AT_ONCE, TOUCHES_A_TASK = 2000, 20_000
# Tasks that fewer touches are cut into, so that few workers share them evenly.
_LEAST_TASKS = 8
# Keeps the landmarks' own kernel positive definite, where two of them are the same.
_JITTER = 1e-8
# What is less adds nothing, and products of it would be slow (subnormal numbers).
_LEAST_EXPONENT = -100.0
# Single precision is taken where scores of so many touches change by less than this:
# posteriors by a thousandth of a nat at a temperature of 100.
N_COMPARED, SAME_SCORE = 500, 1e-5

# Touches at first; products of their kernels with the landmarks, row by row up to the
# diagonal, (n_marks * (n_marks + 1) / 2,); and sums of kernels, (n_labels, n_marks).
Sums = tuple[int, Floats, Floats]
# Touches (n_touches, n_features), the column of each one's label, and all labels.
Taught = tuple[Floats, Indices, Array]


@dataclass(frozen=True)
class Landmarks:
    """Some training touches, less the mean, that stand for all; and the kernel.

    `marks` (n_marks, n_features), and the factor `rate` on squared distances in the
    exponent.
    """

    marks: Floats
    rate: float

    def kernel(self, centred: Floats) -> Floats:
        """Return the kernel (n_touches, n_marks) of touches (n_touches, n_features)."""
        squares = np.einsum("ij,ij->i", self.marks, self.marks)
        squared = squared_distances_to(self.marks, squares, centred)
        squared *= -self.rate
        np.maximum(squared, _LEAST_EXPONENT, out=squared)
        return exp(squared, out=squared)


class LandmarkRegression:
    """The regression of labels on the landmarks' kernels, of answers 1 and 0.

    The landmarks are touches less their `mean`; `ridge` is added to the diagonal of the
    products of features.
    """

    _n_first: int  # touches that the landmarks were chosen of
    _taught: Taught

    def __init__(self, landmarks: Landmarks, mean: Floats, ridge: float) -> None:
        self._landmarks, self._mean, self._ridge = landmarks, mean, ridge
        gram = landmarks.kernel(landmarks.marks)
        gram.flat[:: len(gram) + 1] += _JITTER
        self._root = cholesky(gram, lower=True)

    def learn(self, taught: Taught) -> Self:
        """Learn touches in tasks of blocks, wherever `joblib.parallel_config` says."""
        touches, codes, classes = self._taught = taught
        n_marks = len(self._root)
        self._products = np.zeros((n_marks, n_marks))
        self._by_label = np.zeros((len(classes), n_marks))
        self._n_first = len(touches)
        self._take_in(touches, codes, 1.0)
        self._plain = self._as_short_as_exact(self._solved())
        return self

    def _take_in(self, touches: Floats, codes: Indices, sign: float) -> None:
        """Take touches into the sums (sign 1), or out of them (-1)."""
        order = np.argsort(codes, kind="stable")  # few labels in each block
        share = max(-(-len(order) // _LEAST_TASKS), TOUCHES_AT_ONCE)
        size = min(share, TOUCHES_A_TASK)
        tasks = [order[k : k + size] for k in range(0, len(order), size)]
        parts = results_of(
            partial(_sums, self._landmarks),
            len(tasks),
            lambda n: (touches[tasks[n]] - self._mean, codes[tasks[n]]),
        )
        for products, present, by_label in parts:
            self._products += sign * products
            self._by_label[present] += sign * by_label

    def _solved(self) -> Floats:
        """Return the coefficients (n_marks, n_labels) that follow from the sums."""
        products = np.tril(self._products)
        products += np.tril(products, -1).T
        half = solve_triangular(self._root, products, lower=True)
        inner: Floats = solve_triangular(self._root, half.T, lower=True)
        inner.flat[:: len(inner) + 1] += self._ridge
        self._inner, self._factor = inner, cho_factor(inner, lower=True)
        outer = solve_triangular(self._root, self._by_label.T, lower=True)
        return self._of_kernels(cho_solve(self._factor, outer, overwrite_b=True))

    def sums(self) -> Sums:
        """Return what later touches join, for a model file."""
        n_marks = len(self._root)
        lower = self._products[np.tril_indices(n_marks)]
        return self._n_first, lower, self._by_label

    def resumed(self, sums: Sums, dtype: np.dtype[Any], taught: Taught) -> Self:
        """Take up sums of a model file, or raise ValueError where they do not fit.

        Coefficients follow with the next touches.
        """
        self._n_first, lower, self._by_label = sums
        self._taught = taught
        n_marks = len(self._root)
        if lower.size != n_marks * (n_marks + 1) // 2 or not np.isfinite(lower).all():
            raise ValueError(f"sums of {lower.size} products are not of {n_marks}")
        if self._by_label.shape[1:] != (n_marks,):
            raise ValueError(f"sums of labels have shape {self._by_label.shape}")
        self._products = np.zeros((n_marks, n_marks))
        self._products[np.tril_indices(n_marks)] = lower
        self._plain = np.empty((n_marks, 0), dtype=dtype)
        return self

    def _as_short_as_exact(self, coefficients: Floats) -> Array:
        """Return coefficients in single precision where scores stay the same."""
        touches = self._taught[0]
        compared = touches[:: -(-len(touches) // N_COMPARED)] - self._mean
        kernel = self._landmarks.kernel(compared)
        single = coefficients.astype(np.float32)
        differences = kernel.astype(np.float32) @ single - kernel @ coefficients
        return single if np.abs(differences).max() < SAME_SCORE else coefficients

    def again(self, taught: Taught) -> Self | None:
        """Return what is learnt with some labels gone and other touches at the end.

        None where they are other touches, or landmarks would have to change.
        """
        touches, codes, classes = taught
        before, before_codes, before_classes = self._taught
        labels = before_classes[before_codes]
        kept = np.isin(labels, classes)
        n_kept, most = int(kept.sum()), GROWTH * self._n_first
        if not 0 <= len(touches) - n_kept <= most or len(kept) - n_kept > most:
            return None
        if not (
            np.array_equal(classes[codes[:n_kept]], labels[kept])
            and np.array_equal(touches[:n_kept], before[kept])
        ):
            return None
        other = copy(self)
        other._taught = taught
        other._products = self._products.copy()
        other._by_label = self._by_label.copy()
        other._take_in(before[~kept], before_codes[~kept], -1.0)
        stay = np.isin(before_classes, classes)
        by_label = np.zeros((len(classes), len(self._root)))
        by_label[np.searchsorted(classes, before_classes[stay])] = other._by_label[stay]
        other._by_label = by_label
        other._take_in(touches[n_kept:], codes[n_kept:], 1.0)
        other._plain = other._solved().astype(self._plain.dtype)
        return other

    def _of_kernels(self, weights: Floats) -> Floats:
        """Return weights of features as coefficients of the landmarks' kernels."""
        return np.asarray(solve_triangular(self._root, weights, lower=True, trans="T"))

    def coefficients(self) -> Array:
        """Return those of the landmarks' kernels, (n_marks, n_labels).

        For answers less their mean, 1 / n_labels; in single precision where scores stay
        the same.
        """
        total = solve_triangular(self._root, self._by_label.sum(axis=0), lower=True)
        of_mean = self._of_kernels(cho_solve(self._factor, total))
        share = (of_mean / self._plain.shape[1]).astype(self._plain.dtype)
        return np.asarray(self._plain - share[:, np.newaxis])

    def left_out(self, coefficients: Array, group: Indices, rows: Indices) -> Array:
        """Return scores (n_rows, n_labels) of some touches, their groups never learnt.

        With features F and residuals r of a group, and Q = (F_all^T F_all + ridge
        I)^-1, its answer is target - (I - F Q F^T)^-1 r.
        """
        learnt, codes, classes = self._taught
        n_labels, dtype = len(classes), coefficients.dtype
        place = np.full(len(codes), -1)
        place[rows] = np.arange(len(rows))
        scores = np.zeros((len(rows), n_labels), dtype=dtype)
        scores[np.arange(len(rows)), codes[rows]] = 1.0
        is_asked = np.isin(group, group[rows])
        groups = [touches for touches in group_members(group) if is_asked[touches[0]]]
        groups.sort(key=len)
        for batch in _batches(groups, min(TOUCHES_AT_ONCE, len(self._root))):
            touches = np.concatenate(batch)
            kernel = self._landmarks.kernel(learnt[touches] - self._mean)
            residual = -1 / n_labels - kernel.astype(dtype) @ coefficients
            residual[np.arange(len(touches)), codes[touches]] += 1
            features = solve_triangular(self._root, kernel.T, lower=True).T
            changes = self._without(features, residual, [*map(len, batch)])
            counted = place[touches] >= 0
            scores[place[touches[counted]]] -= changes[counted]
        return scores

    def _without(self, features: Floats, residual: Array, sizes: list[int]) -> Floats:
        """Return residuals (n_touches, n_labels) with each group left out in turn.

        Of groups of rising `sizes`, one after another.
        """
        changes, end = np.empty(residual.shape), 0
        through = None
        # Of larger groups factorising the others' products takes less.
        if 4 * sizes[-1] <= len(self._root):
            through = cho_solve(self._factor, features.T)
        for size in sizes:
            rows = slice(end, end + size)
            end += size
            group, target = features[rows], residual[rows]
            if through is not None:
                hat = np.eye(size) - group @ through[:, rows]
                changes[rows] = np.linalg.solve(hat, target)
                continue
            rest = dsyrk(-1.0, group.T, 1.0, self._inner, lower=1)
            others = cho_factor(rest, lower=True, overwrite_a=True)
            changes[rows] = target + group @ cho_solve(others, group.T @ target)
        return changes


def _sums(
    landmarks: Landmarks, centred: Floats, codes: Indices
) -> tuple[Floats, Indices, Floats]:
    """Return products of kernels, labels that occur, and sums of kernels for each.

    Of touches whose labels are sorted; of products, those on and below the diagonal.
    """
    n_marks = len(landmarks.marks)
    products = np.zeros((n_marks, n_marks), order="F")
    present = np.unique(codes)
    by_label = np.zeros((len(present), n_marks))
    for start in range(0, len(codes), TOUCHES_AT_ONCE):
        rows = slice(start, start + TOUCHES_AT_ONCE)
        kernel = landmarks.kernel(centred[rows])
        dsyrk(1.0, kernel.T, beta=1.0, c=products, lower=1, overwrite_c=1)
        labels, at = np.unique(codes[rows], return_index=True)
        by_label[np.searchsorted(present, labels)] += np.add.reduceat(
            kernel, at, axis=0
        )
    return products, present, by_label


def _batches(groups: list[Indices], at_once: int) -> Iterator[list[Indices]]:
    """Yield groups so many touches at a time, one that is larger alone."""
    batch: list[Indices] = []
    n_touches = 0
    for members in groups:
        if batch and n_touches + len(members) > at_once:
            yield batch
            batch, n_touches = [], 0
        batch.append(members)
        n_touches += len(members)
    yield batch
