"""Kernel ridge regression through landmarks, for touches too many for their own kernel.

The kernel is replaced by that of its projection onto some of the touches (Nystroem
features, C. K. I. Williams and M. Seeger, "Using the Nystroem method to speed up kernel
machines", NIPS 13, 2001). Memory grows with the touches, not with their square.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

Floats = NDArray[np.float64]
# Rows of touches, some of them -> their kernel with the landmarks.
KernelOf = Callable[[NDArray[np.intp]], Floats]

_TOUCHES_AT_ONCE = 2000
# Keeps the landmarks' own kernel positive definite, where two of them are the same.
_JITTER = 1e-8


def learn_from_landmarks(
    kernel_of: KernelOf,
    own_kernel: Floats,
    target: Floats,
    group: NDArray[np.intp],
    ridge: float,
) -> tuple[Floats, Floats]:
    """Solve the ridge regression of `target` on the landmarks' kernel.

    Parameters
    ----------
    kernel_of : callable
        Returns the kernel of touches (rows) with the landmarks, (n_rows, n_landmarks).
    own_kernel : ndarray of shape (n_landmarks, n_landmarks)
    target : ndarray of shape (n_touches, n_outputs)
    group : ndarray of int, shape (n_touches,)
        Touches of one group are left out together.
    ridge : float

    Returns
    -------
    coefficients : ndarray of shape (n_landmarks, n_outputs)
        Scores of a touch are its kernel with the landmarks times these.
    left_out : ndarray of shape (n_touches, n_outputs)
        What every touch would be given, had its group never been learnt: with
        features F of the group, Q = (F_all^T F_all + ridge I)^-1 and residuals r it
        is target - (I - F Q F^T)^-1 r.
    """
    n_landmarks = len(own_kernel)
    root = cholesky(own_kernel + _JITTER * np.eye(n_landmarks), lower=True)

    def features(rows: NDArray[np.intp]) -> Floats:
        solved = solve_triangular(root, kernel_of(rows).T, lower=True)
        return np.ascontiguousarray(solved.T)

    inner = ridge * np.eye(n_landmarks)
    outer = np.zeros((n_landmarks, target.shape[1]))
    for rows in _blocks(len(target)):
        some = features(rows)
        inner += some.T @ some
        outer += some.T @ target[rows]
    factor = cho_factor(inner)
    weights = cho_solve(factor, outer)
    left_out = target.copy()
    for members in _members(group):
        some = features(members)
        residual = target[members] - some @ weights
        left_out[members] -= _residual_without(some, residual, inner, factor)
    return solve_triangular(root, weights, lower=True, trans="T"), left_out


def _residual_without(
    some: Floats, residual: Floats, inner: Floats, factor: tuple[Floats, bool]
) -> Floats:
    """Residuals of a group that was left out, through the smaller of two matrices."""
    if len(some) <= len(inner):
        hat = some @ cho_solve(factor, some.T)
        return np.asarray(np.linalg.solve(np.eye(len(some)) - hat, residual))
    others = cho_factor(inner - some.T @ some)
    return np.asarray(residual + some @ cho_solve(others, some.T @ residual))


def _blocks(n: int) -> Iterator[NDArray[np.intp]]:
    for start in range(0, n, _TOUCHES_AT_ONCE):
        yield np.arange(start, min(n, start + _TOUCHES_AT_ONCE))


def _members(group: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
