"""Kernel ridge regression on labels through landmarks, in one pass over the touches.

With more touches than a kernel matrix is for, some of them are landmarks for all
(Nystroem features [1]_). What is learnt follows from sums over touches: of products of
their kernels with the landmarks, and of these kernels for each label. So touches pass
in blocks, in any order and wherever a block lies. No array has a row for each touch and
a column for each label, and a few touches more or fewer change what was learnt by their
residuals alone [2]_.

References
----------
.. [1] C. K. I. Williams, M. Seeger, "Using the Nystroem method to speed up kernel
   machines", NIPS 13, 2001.
.. [2] W. W. Hager, "Updating the inverse of a matrix", SIAM Review 31(2), 1989.
   doi:10.1137/1031049
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.linalg.blas import dsyrk

from .._numbers import exp
from .._parallel import results_of
from .._types import Array, Bools, Floats, Indices

# Touches whose kernel with the landmarks is in memory at once, and in one task.
TOUCHES_AT_ONCE, TOUCHES_A_TASK = 2000, 20_000
# Keeps the landmarks' own kernel positive definite, where two of them are the same.
_JITTER = 1e-8
# What is less adds nothing, and products of it would be slow (subnormal numbers).
_LEAST_EXPONENT = -100.0
# Single precision is taken where scores of so many touches change by less than this:
# posteriors by a thousandth of a nat at a temperature of 100.
N_COMPARED, SAME_SCORE = 500, 1e-5


@dataclass(frozen=True)
class Landmarks:
    """Some training touches, less the mean, that stand for all; and the kernel.

    `marks` (n_marks, n_features), their `squares` (n_marks,), and the factor `rate` on
    squared distances in the exponent.
    """

    marks: Floats
    squares: Floats
    rate: float

    def kernel(self, centred: Floats) -> Floats:
        """Return the kernel (n_touches, n_marks) of touches (n_touches, n_features)."""
        squared = centred @ (-2 * self.marks.T)
        squared += np.einsum("ij,ij->i", centred, centred)[:, np.newaxis]
        squared += self.squares
        np.maximum(squared, 0, out=squared)
        squared *= -self.rate
        np.maximum(squared, _LEAST_EXPONENT, out=squared)
        return exp(squared, out=squared)

    def root(self) -> Floats:
        """Return the lower triangular root of the landmarks' own kernel."""
        own = self.kernel(self.marks)
        own.flat[:: len(own) + 1] += _JITTER
        return np.asarray(cholesky(own, lower=True))


class LandmarkRegression:
    """The regression of labels on the landmarks' kernels, of answers 1 and 0.

    Parameters
    ----------
    landmarks : Landmarks
        The touches that stand for all.
    ridge : float
        Added to the diagonal of the products of features.

    Attributes
    ----------
    n_first : int
        Touches that the landmarks were chosen of.
    """

    n_first: int

    def __init__(self, landmarks: Landmarks, ridge: float) -> None:
        self._landmarks, self._ridge = landmarks, ridge
        self._root = landmarks.root()

    def learn(self, centred: Floats, codes: Indices, n_labels: int) -> Self:
        """Learn touches (n_touches, n_features) less the mean, and their labels' codes.

        In tasks of blocks, wherever `joblib.parallel_config` says.
        """
        order = np.argsort(codes, kind="stable")  # few labels in each block
        tasks = [
            order[first : first + TOUCHES_A_TASK]
            for first in range(0, len(order), TOUCHES_A_TASK)
        ]
        parts = results_of(
            _sums,
            len(tasks),
            lambda n: (self._landmarks, centred[tasks[n]], codes[tasks[n]]),
        )
        n_marks = len(self._root)
        self._products = np.zeros((n_marks, n_marks))
        by_label = np.zeros((n_labels, n_marks))
        for products, present, own in parts:
            self._products += products
            by_label[present] += own
        self.n_first, self._total = len(centred), by_label.sum(axis=0)
        self._factorise()
        outer = solve_triangular(self._root, by_label.T, lower=True)
        weights = cho_solve(self._factor, outer, overwrite_b=True)
        self._plain = self._as_short_as_exact(self._of_kernels(weights), centred)
        return self

    def _as_short_as_exact(self, coefficients: Floats, centred: Floats) -> Array:
        """Return coefficients in single precision where scores stay the same."""
        kernel = self._landmarks.kernel(centred[:: -(-len(centred) // N_COMPARED)])
        single = coefficients.astype(np.float32)
        apart = kernel.astype(np.float32) @ single - kernel @ coefficients
        return single if np.abs(apart).max() < SAME_SCORE else coefficients

    def changed(
        self,
        gone: tuple[Floats, Indices],
        stay: Bools,
        places: Indices,
        new: tuple[Floats, Indices],
        n_labels: int,
    ) -> Self:
        """Return what is learnt without some touches and labels, and with others.

        Of `gone` touches and their codes; then which labels `stay`, at which `places`
        of `n_labels`; then `new` touches and their codes among these.
        """
        other = copy(self)
        other._take_in(*gone, -1.0)
        plain = np.zeros((len(self._root), n_labels), dtype=self._plain.dtype)
        plain[:, places] = other._plain[:, stay]
        other._plain = plain
        other._take_in(*new, 1.0)
        return other

    def _take_in(self, centred: Floats, codes: Indices, sign: float) -> None:
        """Take touches in (sign 1) or out (-1); both come to their residuals."""
        if not len(centred):
            return
        kernel = self._landmarks.kernel(centred)
        features = solve_triangular(self._root, kernel.T, lower=True)
        through = cho_solve(self._factor, features)
        inner = features.T @ through
        inner.flat[:: len(inner) + 1] += sign
        dtype = self._plain.dtype
        residual = -(kernel.astype(dtype) @ self._plain)
        residual[np.arange(len(codes)), codes] += 1
        change = np.linalg.solve(inner, residual)
        self._plain = self._plain + (self._of_kernels(through) @ change).astype(dtype)
        self._products = self._products + sign * (kernel.T @ kernel)
        self._total = self._total + sign * kernel.sum(axis=0)
        self._factorise()

    def _factorise(self) -> None:
        """Factorise the products of features, with the ridge."""
        products = np.tril(self._products)
        products += np.tril(products, -1).T
        half = solve_triangular(self._root, products, lower=True)
        inner: Floats = solve_triangular(self._root, half.T, lower=True)
        inner.flat[:: len(inner) + 1] += self._ridge
        self._inner, self._factor = inner, cho_factor(inner, lower=True)

    def _of_kernels(self, weights: Floats) -> Floats:
        """Return weights of features as coefficients of the landmarks' kernels."""
        return np.asarray(solve_triangular(self._root, weights, lower=True, trans="T"))

    def coefficients(self) -> Array:
        """Return those of the landmarks' kernels, (n_marks, n_labels).

        For answers less their mean, 1 / n_labels; in single precision where scores stay
        the same.
        """
        total = solve_triangular(self._root, self._total, lower=True)
        of_mean = self._of_kernels(cho_solve(self._factor, total))
        share = (of_mean / self._plain.shape[1]).astype(self._plain.dtype)
        return np.asarray(self._plain - share[:, np.newaxis])

    def left_out(
        self,
        coefficients: Array,
        centred: Floats,
        codes: Indices,
        group: Indices,
        rows: Indices,
    ) -> Array:
        """Return scores (n_rows, n_labels) of some touches, their groups never learnt.

        With features F and residuals r of a group, and Q = (F_all^T F_all + ridge
        I)^-1, its answer is target - (I - F Q F^T)^-1 r.
        """
        n_labels, dtype = coefficients.shape[1], coefficients.dtype
        place = np.full(len(codes), -1)
        place[rows] = np.arange(len(rows))
        scores = np.zeros((len(rows), n_labels), dtype=dtype)
        scores[np.arange(len(rows)), codes[rows]] = 1.0
        is_asked = np.isin(group, group[rows])
        groups = [touches for touches in group_members(group) if is_asked[touches[0]]]
        for batch in _batches(groups, min(TOUCHES_AT_ONCE, len(self._root))):
            every = np.concatenate(batch)
            kernel = self._landmarks.kernel(centred[every])
            residual = -1 / n_labels - kernel.astype(dtype) @ coefficients
            residual[np.arange(len(every)), codes[every]] += 1
            some = solve_triangular(self._root, kernel.T, lower=True).T
            ends = np.cumsum([len(touches) for touches in batch])
            through = None
            if len(some) <= len(self._root):
                through = cho_solve(self._factor, some.T)
            for touches, end in zip(batch, ends, strict=True):
                here = slice(end - len(touches), end)
                mine, own = some[here], residual[here]
                told = place[touches] >= 0
                if through is not None:
                    hat = np.eye(len(mine)) - mine @ through[:, here]
                    change = np.linalg.solve(hat, own)[told]
                else:
                    others = cho_factor(self._inner - mine.T @ mine)
                    change = own[told] + mine[told] @ cho_solve(others, mine.T @ own)
                scores[place[touches[told]]] -= change
        return scores


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
        own, at = np.unique(codes[rows], return_index=True)
        by_label[np.searchsorted(present, own)] += np.add.reduceat(kernel, at, axis=0)
    return products, present, by_label


def _batches(groups: list[Indices], at_once: int) -> Iterator[list[Indices]]:
    """Yield groups so many touches at a time, one that is larger alone."""
    batch: list[Indices] = []
    n_touches = 0
    for one in groups:
        if batch and n_touches + len(one) > at_once:
            yield batch
            batch, n_touches = [], 0
        batch.append(one)
        n_touches += len(one)
    yield batch


def group_members(group: Array) -> list[NDArray[np.intp]]:
    """Return the touches of each group."""
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
