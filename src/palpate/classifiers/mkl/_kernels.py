"""Kernels, and banks of them that share distances and inner products.

A bank of Gaussians of many widths needs one matrix of squared distances, polynomials
of many degrees one matrix of inner products, and both come from one product of the
touches. Powers grow by repeated multiplication.

The matrices of a pair of classes come from features, or are given. Kernels are scaled
once, by the training touches of all classes, so that one price of errors suits them
all; touches to recognise get the same factors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import repeat
from typing import Self, cast

import cv2
import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs
from sklearn.utils import check_array

from ..._checks import check_count, check_number, check_width, is_plain
from ..._numbers import exp
from ..._types import Array, Floats
from . import _problem
from ._problem import (
    BLOCK_BYTES,
    Point,
    Solution,
    Step,
    Task,
    View,
    balanced,
    row_blocks,
    weighted,
)

# Fourth powers in a row by which narrower Gaussians come from a wider one.
_MOST_STEPS = 3
# A kernel whose spread is below this share of its size is constant.
_CONSTANT = 1e-12
# Share of the trace by which eigenvalues may miss zero, and of the largest entry by
# which a matrix may miss symmetry, for rounding: of doubles, and of less.
_ROUNDING, _COARSE_ROUNDING = 1e-8, 1e-5
# From this size on one matrix at a time is as fast as all at once.
_LARGE = 50
# What `dpotrs` is told each time.
_UPPER, _IN_PLACE = repeat(0), repeat(1)

Solver = Callable[[Floats], Floats]


@dataclass(frozen=True)
class GaussianKernel:
    """exp(-|x - y|^2 / (2 sigma^2)); `sigma` has the unit of the features.

    It lies between 1e-150 and 1e150, so that its square is an ordinary number.
    """

    sigma: float = 1.0

    def __post_init__(self) -> None:
        check_width(self.sigma)


@dataclass(frozen=True)
class PolynomialKernel:
    """(offset + x'y)^degree.

    `degree` is at least 1; `offset`, at least 0, has the features' unit squared.
    """

    degree: int = 2
    offset: float = 1.0

    def __post_init__(self) -> None:
        check_count("degree", self.degree)
        check_number("offset", self.offset, low=0)


@dataclass(frozen=True)
class LinearKernel:
    """x'y."""


Kernel = GaussianKernel | PolynomialKernel | LinearKernel


def paper_kernels() -> list[Kernel]:
    """Return the 22 kernels of Liu et al. 2014.

    Gaussians of sigma = 2^-5, 2^-4, ..., 2^10 and polynomials (1 + x'y)^p of
    degree p = 1, ..., 6.
    """
    gaussians: list[Kernel] = [GaussianKernel(2.0**k) for k in range(-5, 11)]
    return gaussians + [PolynomialKernel(p) for p in range(1, 7)]


def check_kernels(kernels: object) -> list[Kernel]:
    if isinstance(kernels, str) and kernels == "paper":
        return paper_kernels()
    if isinstance(kernels, str) or not isinstance(kernels, Iterable):
        raise ValueError(
            f"kernels must be 'paper', 'precomputed' or a list, got {kernels!r}. "
            "Pass for example [GaussianKernel(1.0), PolynomialKernel(2)]."
        )
    listed = list(kernels)
    for kernel in listed:
        if not isinstance(kernel, Kernel):
            raise TypeError(
                "kernels must hold GaussianKernel, PolynomialKernel or LinearKernel, "
                f"got {kernel!r}. Compute other kernels first and pass 'precomputed'."
            )
    if not listed:
        raise ValueError("kernels must hold at least one kernel, got an empty list.")
    return listed


def kernel_stack(
    kernels: Sequence[Kernel], left: Floats, right: Floats, mean: Floats
) -> Floats:
    """Return all kernels between two sets, (..., n_kernels, n_left, n_right).

    Sets come less `mean`, to save digits; within one array the distance to itself is 0.
    """
    product = left @ right.swapaxes(-1, -2)
    stack = np.empty((*product.shape[:-2], len(kernels), *product.shape[-2:]))
    squared = -2 * product
    squared += np.square(left).sum(axis=-1)[..., :, None]
    squared += np.square(right).sum(axis=-1)[..., None, :]
    np.maximum(squared, 0, out=squared)
    if left is right:
        n = product.shape[-1]
        squared[..., np.arange(n), np.arange(n)] = 0
    product += (left @ mean)[..., :, None]
    product += (right @ mean)[..., None, :]
    product += mean @ mean
    with np.errstate(over="ignore", under="ignore"):
        _fill(stack, kernels, squared, product)
    return stack


def kernel_diagonals(
    kernels: Sequence[Kernel], touches: Floats, mean: Floats
) -> Floats:
    """Return k(x, x) of touches less `mean`, shape (n_kernels, n_touches)."""
    square = ((touches + mean) ** 2).sum(axis=1)
    diagonals = np.empty((len(kernels), 1, len(touches)))
    with np.errstate(over="ignore"):
        _fill(diagonals, kernels, np.zeros((1, len(touches))), square[None])
    return diagonals[:, 0]


def _fill(
    stack: Floats, kernels: Sequence[Kernel], squared: Floats, product: Floats
) -> None:
    """Write each kernel to its place in `stack`, shape (..., n_kernels, n, m)."""
    places = [stack[..., k, :, :] for k in range(len(kernels))]
    _fill_gaussians(places, kernels, squared)
    powers: dict[tuple[float, int], Floats] = {}
    for place, kernel in zip(places, kernels, strict=True):
        if isinstance(kernel, PolynomialKernel):
            offset, degree = kernel.offset, kernel.degree
            if (offset, 1) not in powers:
                powers[offset, 1] = offset + product
            # From the highest power already known.
            below = max(p for o, p in powers if o == offset and p <= degree)
            power = powers[offset, below]
            for _ in range(degree - below):
                power = power * powers[offset, 1]
            powers[offset, degree] = power
            place[...] = power
        elif isinstance(kernel, LinearKernel):
            place[...] = product


def _fill_gaussians(
    places: list[Floats], kernels: Sequence[Kernel], squared: Floats
) -> None:
    """Widest first: half the width is the fourth power, of fourfold rounding."""
    filled: dict[float, tuple[Floats, int]] = {}
    gaussians = [
        (kernel.sigma, place)
        for kernel, place in zip(kernels, places, strict=True)
        if isinstance(kernel, GaussianKernel)
    ]
    for sigma, place in sorted(gaussians, key=lambda pair: -pair[0]):
        wider, steps = filled.get(2 * sigma, (None, _MOST_STEPS))
        if wider is not None and steps < _MOST_STEPS:
            np.multiply(wider, wider, out=place)
            np.multiply(place, place, out=place)
            filled[sigma] = place, steps + 1
        else:
            power = squared * (-0.5 / sigma**2)
            place[...] = exp(power, out=power)
            filled[sigma] = place, 0


class DenseBank(ABC):
    """Kernels among training touches, as whole matrices."""

    n_folds = 5
    n_touches: int
    n_columns: int  # of coefficients of a machine
    scales: Floats
    normalize: str | None

    @abstractmethod
    def blocks(self, index: Array) -> Floats:
        """Return scaled kernels by rows of `index`, (n_rows, n_kernels, n, n)."""

    def batch_size(self, n_touches: int) -> int:
        """How many problems of that size to hold at a time."""
        per_problem = 8 * len(self.scales) * n_touches**2
        return max(1, BLOCK_BYTES // per_problem)

    def system(self, index: Array, labels: Floats) -> DenseKernels:
        """Return the kernels among the touches of each row of `index`."""
        if self.normalize != "trace":
            return DenseKernels.centred(self.blocks(index), labels)
        return DenseKernels(self.blocks(index), labels)  # no large constant part

    def machines(
        self, system: DenseKernels, index: Array, solution: Solution
    ) -> tuple[Floats, Floats]:
        """Return y a of each machine at the place of its touches, and its bias."""
        placed = np.zeros((len(index), self.n_touches))
        rows = np.arange(len(index))[:, None]
        # Padding repeats a touch with nothing to add.
        np.add.at(placed, (rows, index), system.labels * solution.alpha)
        return placed, system.true_bias(solution)


class FeatureBank(DenseBank):
    """Kernels among training touches (n_touches, n_features), with a factor on each."""

    def __init__(
        self, kernels: Sequence[Kernel], touches: Floats, normalize: str | None
    ) -> None:
        self.kernels, self.normalize = kernels, normalize
        self.n_touches = self.n_columns = len(touches)
        self.centred, self.mean, diagonals = centre(kernels, touches)
        mean = None
        if normalize == "variance":
            mean = np.zeros(len(kernels))
            for rows in row_blocks(len(touches), len(touches) * len(mean)):
                part = self.centred[rows]
                stack = kernel_stack(kernels, part, self.centred, self.mean)
                mean += stack.sum(axis=(1, 2))
            mean /= len(touches) ** 2
        self.scales = kernel_scales(diagonals, mean, normalize)

    def blocks(self, index: Array) -> Floats:
        chosen = self.centred[index]
        stack = kernel_stack(self.kernels, chosen, chosen, self.mean)
        stack *= self.scales[:, None, None]
        return stack


class GivenBank(DenseBank):
    """Kernels (n_touches, n_touches, n_kernels) given, refused if they are none."""

    def __init__(self, stack: Floats, normalize: str | None) -> None:
        self._values = np.ascontiguousarray(stack, dtype=np.float64)
        self.n_touches = self.n_columns = len(stack)
        diagonals = np.einsum("iik->ki", self._values)
        rounding = _ROUNDING if stack.dtype == np.float64 else _COARSE_ROUNDING
        self._refuse_no_kernels(rounding, np.abs(diagonals).sum(axis=1))
        self.normalize = normalize
        mean = self._values.mean(axis=(0, 1)) if normalize == "variance" else None
        self.scales = kernel_scales(diagonals, mean, normalize)

    def _refuse_no_kernels(self, rounding: float, traces: Floats) -> None:
        """Refuse matrices that are not symmetric or not positive semi-definite."""
        n = self.n_touches
        for rows in row_blocks(len(traces), n**2):
            turned = cv2.transpose(self._values.reshape(n**2, -1)[:, rows])
            matrices = np.asarray(turned, dtype=np.float64).reshape(-1, n, n)
            for k, matrix in enumerate(matrices, rows.start):
                skew = cv2.norm(matrix, cv2.transpose(matrix), cv2.NORM_INF)
                if skew and skew > rounding * cv2.norm(matrix, cv2.NORM_INF):
                    raise ValueError(
                        "Precomputed kernels must be symmetric, got a difference of "
                        f"{skew:.3g} across the diagonal of kernel {k}. Pass (K + K.T) "
                        "/ 2."
                    )
                # A matrix of zeros has no trace, and is a kernel all the same.
                matrix.ravel()[:: n + 1] += rounding * traces[k] if traces[k] else 1.0
                if dpotrf(matrix.T, 1, 0, 1)[1]:
                    lowest = np.linalg.eigvalsh(self._values[:, :, k])[0]
                    raise ValueError(
                        "Precomputed kernels must be positive semi-definite, got an "
                        f"eigenvalue of {lowest:.3g} in kernel {k}. Clip its "
                        "eigenvalues at zero."
                    )

    def blocks(self, index: Array) -> Floats:
        (n_rows, n), n_kernels = index.shape, len(self.scales)
        pairs = self._values.reshape(-1, n_kernels)
        blocks = np.empty((n_rows, n_kernels, n * n))
        places = (index[:, :, None] * self.n_touches + index[:, None, :]).reshape(
            n_rows, n * n
        )
        taken = np.empty((n * n, n_kernels))
        for block, there in zip(blocks, places, strict=True):
            # OpenCV takes a third of the time of numpy's copy.
            pairs.take(there, axis=0, out=taken, mode="clip")
            cv2.transpose(taken, dst=block)
            block *= self.scales[:, None]
        return blocks.reshape(n_rows, n_kernels, n, n)


def kernel_scales(
    diagonals: Floats, mean: Floats | None, normalize: str | None
) -> Floats:
    """Return the factor on each kernel of `diagonals` (n_kernels, n_touches).

    One over the trace, for "variance" over the mean of the diagonal less `mean` of the
    matrix, or 1; 0 for kernels that tell no touches apart.
    """
    if normalize is None:
        return np.ones(len(diagonals))
    size = diagonals.mean(axis=1)
    if mean is None:
        amount = diagonals.sum(axis=1)
        says = amount > 0
    else:
        amount = size - mean
        says = amount > _CONSTANT * np.abs(size)
    return np.where(says, 1 / np.where(says, amount, 1), 0)


def check_given(X: object, wanted: tuple[int, int] | None = None) -> Floats:
    """Return precomputed kernels as (n_touches, n_train, n_kernels), or explain.

    With `wanted`, the latter two are insisted on; without, a square of touches.
    """
    types = [np.float64, np.float32]
    stack: Floats = (
        X
        if is_plain(X, n_axes=3)
        else check_array(X, dtype=types, allow_nd=True, input_name="X")
    )
    if stack.ndim == 2:
        stack = stack[:, :, None]
    if stack.ndim != 3 or 0 in stack.shape:
        raise ValueError(
            "Precomputed kernels must have shape (n_touches, n_train_touches, "
            f"n_kernels), got {stack.shape}. Stack them with np.stack(..., axis=2)."
        )
    n_train, n_kernels = wanted or (stack.shape[0], stack.shape[2])
    if stack.shape[1] != n_train:
        raise ValueError(
            f"X has {stack.shape[1]} features, but MKLSVC is expecting {n_train} "
            "features as input: precomputed kernels need a column per training touch."
        )
    if stack.shape[2] != n_kernels:
        raise ValueError(
            f"X must hold the {n_kernels} kernels of the training touches, got "
            f"{stack.shape[2]}. Stack the same kernels in the same order."
        )
    return stack


def centre(kernels: Sequence[Kernel], touches: Floats) -> tuple[Floats, Floats, Floats]:
    """Return touches less their mean, the mean, and k(x, x) of all kernels, finite."""
    mean = touches.mean(axis=0)
    diagonals = kernel_diagonals(kernels, touches - mean, mean)
    finite = np.isfinite(diagonals).all(axis=1)
    if not finite.all():
        raise ValueError(
            "Kernels must be finite, got infinity from "
            f"{kernels[int(finite.argmin())]}. Scale the features first, for example "
            "with StandardScaler."
        )
    return touches - mean, mean, diagonals


class DenseKernels:
    """Kernels (n_problems, n_kernels, n_touches, n_touches) of a batch, contiguous.

    `labels` (n_problems, n_touches) are +1, -1, or 0 for no part; `means` (n_problems,
    n_kernels, n_touches) are those of the rows that `centred` took out.
    """

    crowded = False

    def __init__(
        self, kernels: Floats, labels: Floats, means: Floats | None = None
    ) -> None:
        self.kernels, self.labels, self.means = kernels, labels, means
        self.n_kernels = int(kernels.shape[1])

    @classmethod
    def centred(cls, kernels: Floats, labels: Floats) -> Self:
        """Take the part out of `kernels`, in place, that is equal for all touches.

        It adds nothing to any machine but its bias, and where it is large it hides
        the rest in its rounding.
        """
        means = kernels.mean(axis=3)
        kernels -= means[:, :, :, None]
        kernels -= kernels.mean(axis=2)[:, :, None, :]
        return cls(kernels, labels, means)

    def pulls(self, alpha: Floats) -> Floats:
        return np.zeros((len(alpha), 0))

    def normal(self, task: Task, point: Point) -> Floats:
        return np.zeros((len(point.alpha), 0))

    def view(self, task: Task, point: Point) -> View:
        forces = self._times(point.alpha)
        forces *= self.labels[:, None, :]
        energies = 0.5 * (forces @ point.alpha[:, :, None])[:, :, 0]
        weights = task.weights(point)
        square = np.vecdot(weights, energies)
        missing = task.real - weighted(weights, forces) - task.labels * point.bias
        return View(energies, missing, square, forces)

    def newton(self, task: Task, point: Point, view: View) -> Step:
        return DualNewton(self, task, point, view).direction

    def settled(self, task: Task, point: Point, share: float) -> Point:
        n, left = point.n_touches, point.left.copy()
        left[:, :n] = balanced(self.labels, point.alpha)
        left[:, 2 * n :] = _problem.without_small(point.shares, share**task.norm)
        return Point(left, point.right, point.free, n)

    def decisions(self, solution: Solution) -> Floats:
        """Return the decisions about all touches, also where the label is 0."""
        pulled = self._times(solution.alpha)
        return weighted(solution.weights, pulled) + solution.bias[:, None]

    def true_bias(self, solution: Solution) -> Floats:
        """Return the bias that belongs to the kernels as they were."""
        if self.means is None:
            return solution.bias
        signed = self.labels * solution.alpha
        taken = (self.means @ signed[:, :, None])[:, :, 0]
        return np.asarray(solution.bias - (solution.weights * taken).sum(axis=1))

    def with_labels(self, labels: Floats) -> Self:
        """Return the same kernels with some labels set to 0."""
        return type(self)(self.kernels, labels, self.means)

    def take(self, keep: Array) -> Self:
        means = None if self.means is None else self.means[keep]
        return type(self)(self.kernels[keep], self.labels[keep], means)

    def _times(self, alpha: Floats) -> Floats:
        """Return K_k Y a, (n_problems, n_kernels, n_touches)."""
        signed = self.labels * alpha
        n_problems, n_kernels, n, _ = self.kernels.shape
        stacked = self.kernels.reshape(n_problems, n_kernels * n, n)
        return (stacked @ signed[:, :, None]).reshape(n_problems, n_kernels, n)

    def factorise(self, diagonal: Floats, weights: Floats, root: Floats) -> Solver:
        """Return a solver of diagonal + sum_k d_k Y K_k Y + root' root.

        It overwrites what it is given, contiguous, (n_problems, n_right_sides, n).
        """
        n_problems, n_kernels, n, _ = self.kernels.shape
        flat = self.kernels.reshape(n_problems, n_kernels, n * n)
        matrix = (weights[:, None, :] @ flat).reshape(n_problems, n, n)
        matrix *= self.labels[:, :, None] * self.labels[:, None, :]
        matrix += root.transpose(0, 2, 1) @ root
        matrix.reshape(n_problems, -1)[:, :: n + 1] += diagonal
        factors = _factors(matrix)

        def solve(right: Floats) -> Floats:
            # With few touches named options and a loop take as long as the solution.
            for _ in map(dpotrs, factors, right.transpose(0, 2, 1), _UPPER, _IN_PLACE):
                pass
            return right

        return solve


def cholesky_solver(matrix: Floats) -> Solver:
    """Factorise one symmetric matrix, its diagonal raised where rounding spoils it."""
    factor = _factor(matrix)
    return lambda right: cast(Floats, dpotrs(factor, right, lower=0)[0])


def _factors(matrices: Floats) -> Iterable[Floats]:
    if matrices.shape[1] < _LARGE:
        with suppress(np.linalg.LinAlgError):
            return [*np.linalg.cholesky(matrices).transpose(0, 2, 1)]
    return [_factor(matrix) for matrix in matrices]


def _factor(matrix: Floats) -> Floats:
    """Return the Cholesky factor in the upper half, all NaN where there is none."""
    factor, failed = dpotrf(matrix.T, lower=0, clean=0)
    for share in (1e-15, 1e-13, 1e-11):
        if not failed:
            return cast(Floats, factor)
        raised = matrix + np.diag(share * matrix.diagonal())
        factor, failed = dpotrf(raised.T, lower=0, clean=0)
    return np.full_like(factor, np.nan) if failed else cast(Floats, factor)


class DualNewton:
    """The optimality conditions at one point, linearised and factorised once."""

    def __init__(
        self, system: DenseKernels, task: Task, point: Point, view: View
    ) -> None:
        n, self._labels = point.n_touches, task.labels
        self._ratio = point.right / point.left
        self._forces, pulls = view.pull, view.energies
        stiffness = self._ratio[:, 2 * n :]
        if task.norm > 1:
            slope, bend = task.slopes(point)
            self._forces, pulls = slope[:, :, None] * view.pull, slope * view.energies
            stiffness = stiffness - bend * view.energies
        self._gain = 1 / stiffness
        self._total = self._gain.sum(axis=1, keepdims=True)
        lean = weighted(self._gain / self._total, self._forces)
        # What the optimality conditions lack, besides the products.
        self._imbalance = np.vecdot(self._labels, point.alpha)[:, None]
        self._excess = point.level - pulls - point.slack
        self._surplus = point.shares.sum(axis=1, keepdims=True) - 1
        self._missing = view.missing - point.errors + point.right[:, :n]
        self._missing += lean * self._surplus
        diagonal = self._ratio[:, :n] + self._ratio[:, n : 2 * n]
        # Moving shares adds F' W F - F' W 1 1' W F / 1' W 1: W gain, F forces.
        self._pace = np.sqrt(self._gain)
        self._root = self._forces - lean[:, None, :]
        self._root *= self._pace[:, :, None]
        self._solve = system.factorise(diagonal, task.weights(point), self._root)
        self._towards_bias: Floats | None = None

    def direction(self, wanted: Floats) -> Point:
        """Return the step by which left * right changes by left * `wanted`."""
        forces, labels, n = self._forces, self._labels, self._labels.shape[1]
        push = wanted[:, 2 * n :] - self._excess
        right = self._missing + wanted[:, :n] - wanted[:, n : 2 * n]
        right -= weighted(self._pace * push, self._root)
        # The multipliers, and the bias that keeps them in balance.
        if self._towards_bias is None:
            both = np.empty((len(right), 2, n))
            both[:, 0], both[:, 1] = right, labels
            alpha, self._towards_bias = self._solve(both).transpose(1, 0, 2)
            self._stiff = np.vecdot(labels, self._towards_bias)[:, None]
        else:
            alpha = self._solve(right[:, None])[:, 0]
        bias = (np.vecdot(labels, alpha)[:, None] + self._imbalance) / self._stiff
        alpha = alpha - bias * self._towards_bias
        push += (forces @ alpha[:, :, None])[:, :, 0]
        level = np.vecdot(self._gain, push)[:, None] + self._surplus
        level /= self._total
        left = np.empty_like(wanted)
        left[:, :n] = alpha
        np.negative(alpha, out=left[:, n : 2 * n])
        np.multiply(self._gain, push - level, out=left[:, 2 * n :])
        free = np.concatenate([bias, level], axis=1)
        return Point(left, wanted - self._ratio * left, free, n)
