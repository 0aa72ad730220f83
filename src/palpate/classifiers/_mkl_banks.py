"""Where the kernel matrices of a pair of classes come from: features, or given.

Kernels are scaled once, by the training touches of all classes, so that one price of
errors suits them all; touches to recognise get the same factors.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf
from sklearn.utils import check_array

from ._kernels import Kernel, kernel_diagonals, kernel_stack
from ._mkl_problem import BLOCK_BYTES, Floats, Solution, row_blocks
from ._mkl_systems import DenseKernels

# A kernel whose spread is below this share of its size is constant.
_CONSTANT = 1e-12
# Share of the trace by which eigenvalues may miss zero, and of the largest entry by
# which a matrix may miss symmetry, for rounding: of doubles, and of less.
_ROUNDING, _COARSE_ROUNDING = 1e-8, 1e-5


class DenseBank(ABC):
    """Kernels among training touches, as whole matrices."""

    n_folds = 5
    n_touches: int
    normalize: str | None
    scales: Floats

    @abstractmethod
    def blocks(self, index: NDArray) -> Floats:
        """Return the scaled kernels among the touches of each row of `index`.

        Shape (n_rows, n_kernels, n_index, n_index).
        """

    @property
    def n_columns(self) -> int:
        """Coefficients of a machine: one per training touch."""
        return self.n_touches

    def batch_size(self, n_touches: int) -> int:
        """How many problems of that size to hold at a time."""
        per_problem = 8 * len(self.scales) * n_touches**2
        return max(1, BLOCK_BYTES // per_problem)

    def system(self, index: NDArray, labels: Floats) -> DenseKernels:
        """Return the problems of the touches of each row of `index`."""
        blocks = self.blocks(index)
        if self.normalize == "trace":
            # No kernel has a large constant part.
            return DenseKernels(blocks, labels)
        return DenseKernels.centred(blocks, labels)

    def machines(
        self, system: DenseKernels, index: NDArray, solution: Solution
    ) -> tuple[Floats, Floats]:
        """Return y a of each machine at the place of its touches, and its bias."""
        placed = np.zeros((len(index), self.n_touches))
        rows = np.arange(len(index))[:, None]
        # Padding repeats a touch with nothing to add.
        np.add.at(placed, (rows, index), system.labels * solution.alpha)
        return placed, system.true_bias(solution)


class FeatureBank(DenseBank):
    """A bank of kernels over training touches.

    Parameters
    ----------
    kernels : sequence of kernels
    touches : ndarray of shape (n_touches, n_features)
    normalize : {"trace", "variance", None}

    Attributes
    ----------
    mean : ndarray of shape (n_features,)
    scales : ndarray of shape (n_kernels,)
        Factor on each kernel.
    """

    def __init__(
        self, kernels: Sequence[Kernel], touches: Floats, normalize: str | None
    ) -> None:
        self.kernels, self.normalize = kernels, normalize
        self.mean = touches.mean(axis=0)
        self.centred = touches - self.mean
        self.n_touches = len(touches)
        diagonals = kernel_diagonals(kernels, self.centred, self.mean)
        refuse_overflow(kernels, diagonals)
        mean = self._mean_kernel() if normalize == "variance" else None
        self.scales = kernel_scales(diagonals, mean, normalize)

    def blocks(self, index: NDArray) -> Floats:
        chosen = self.centred[index]
        stack = kernel_stack(self.kernels, chosen, chosen, self.mean)
        stack *= self.scales[:, None, None]
        return stack

    def _mean_kernel(self) -> Floats:
        """Mean of each kernel matrix, shape (n_kernels,)."""
        total = np.zeros(len(self.kernels))
        for rows in row_blocks(len(self.centred), len(self.centred) * len(total)):
            part = self.centred[rows]
            stack = kernel_stack(self.kernels, part, self.centred, self.mean)
            total += stack.sum(axis=(1, 2))
        return total / len(self.centred) ** 2


class GivenBank(DenseBank):
    """Kernel matrices computed by someone else.

    Parameters
    ----------
    stack : ndarray of shape (n_touches, n_touches, n_kernels)
    normalize : {"trace", "variance", None}

    Raises
    ------
    ValueError
        For a matrix that is not symmetric or not positive semi-definite.
    """

    def __init__(self, stack: Floats, normalize: str | None) -> None:
        self._values = np.ascontiguousarray(stack, dtype=np.float64)
        rounding = _ROUNDING if stack.dtype == np.float64 else _COARSE_ROUNDING
        # One at a time: copies of the whole stack would cost more than the checks.
        for k in range(stack.shape[2]):
            _refuse_not_a_kernel(self._values[:, :, k].copy("F"), k, rounding)
        self.n_touches, self.normalize = len(stack), normalize
        diagonals = np.einsum("iik->ki", self._values)
        mean = self._values.mean(axis=(0, 1)) if normalize == "variance" else None
        self.scales = kernel_scales(diagonals, mean, normalize)

    def blocks(self, index: NDArray) -> Floats:
        n_rows, n = index.shape
        blocks = np.empty((n_rows, len(self.scales), n, n))
        for block, row in zip(blocks, index, strict=True):
            chosen = self._values[row[:, None], row]
            np.multiply(chosen.transpose(2, 0, 1), self.scales[:, None, None], block)
        return blocks


def kernel_scales(
    diagonals: Floats, mean: Floats | None, normalize: str | None
) -> Floats:
    """Return the factor on each kernel.

    Parameters
    ----------
    diagonals : ndarray of shape (n_kernels, n_touches)
    mean : ndarray of shape (n_kernels,), optional
        Mean of each kernel matrix, for "variance".
    normalize : {"trace", "variance", None}
        One over the trace, one over the variance in feature space (mean of the
        diagonal less mean of the matrix), or 1. A kernel without trace, or for
        "variance" a constant one, tells no touches apart and gets 0.
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


def check_given(X: object, n_train: int | None = None) -> Floats:
    """Return precomputed kernels as (n_touches, n_train, n_kernels), or explain."""
    stack: Floats = check_array(
        X, dtype=[np.float64, np.float32], allow_nd=True, input_name="X"
    )
    if stack.ndim == 2:
        stack = stack[:, :, None]
    if stack.ndim != 3 or 0 in stack.shape:
        raise ValueError(
            "Precomputed kernels must have shape (n_touches, n_train_touches, "
            f"n_kernels), got {stack.shape}. Stack them with np.stack(..., axis=2)."
        )
    wanted = stack.shape[0] if n_train is None else n_train
    if stack.shape[1] != wanted:
        raise ValueError(
            f"X has {stack.shape[1]} features, but MKLSVC is expecting {wanted} "
            "features as input: precomputed kernels need a column per training touch."
        )
    return stack


def check_same_kernels(stack: Floats, n_kernels: int) -> Floats:
    """Return precomputed kernels if there are as many as were learnt."""
    if stack.shape[2] != n_kernels:
        raise ValueError(
            f"X must hold the {n_kernels} kernels of the training touches, got "
            f"{stack.shape[2]}. Stack the same kernels in the same order."
        )
    return stack


def refuse_overflow(kernels: Sequence[Kernel], diagonals: Floats) -> None:
    finite = np.isfinite(diagonals).all(axis=1)
    if not finite.all():
        raise ValueError(
            "Kernels must be finite, got infinity from "
            f"{kernels[int(finite.argmin())]}. Scale the features first, for example "
            "with StandardScaler."
        )


def _refuse_not_a_kernel(matrix: Floats, k: int, rounding: float) -> None:
    """Raise if kernel `k` is not symmetric or not positive semi-definite."""
    if not (matrix == matrix.T).all():
        skew = np.abs(matrix - matrix.T).max()
        if skew > rounding * np.abs(matrix).max():
            raise ValueError(
                "Precomputed kernels must be symmetric, got a difference of "
                f"{skew:.3g} across the diagonal of kernel {k}. Pass (K + K.T) / 2."
            )
    trace = np.abs(matrix.diagonal()).sum()
    lifted = matrix.copy("F")
    # A matrix of zeros has no trace, and is a kernel all the same.
    lifted.ravel("F")[:: len(matrix) + 1] += rounding * trace if trace else 1.0
    _, failed = dpotrf(lifted, lower=1, clean=0, overwrite_a=1)
    if failed:
        lowest = np.linalg.eigvalsh(matrix)[0]
        raise ValueError(
            "Precomputed kernels must be positive semi-definite, got an eigenvalue "
            f"of {lowest:.3g} in kernel {k}. Clip its eigenvalues at zero."
        )
