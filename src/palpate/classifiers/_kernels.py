"""Kernels, and banks of them that share distances and inner products.

A bank of Gaussians of many widths needs one matrix of squared distances, polynomials
of many degrees one matrix of inner products, and both come from one product of the
touches. Powers grow by repeated multiplication.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .._checks import check_count, check_number, check_width
from ._mkl_problem import Floats

# Fourth powers in a row by which narrower Gaussians come from a wider one.
_MOST_STEPS = 3


@dataclass(frozen=True)
class GaussianKernel:
    """exp(-|x - y|^2 / (2 sigma^2)); `sigma` has the unit of the features.

    It lies between 1e-150 and 1e150, so that its square is an ordinary number.
    """

    sigma: float = 1.0

    def __post_init__(self) -> None:
        check_width("sigma", self.sigma)


@dataclass(frozen=True)
class PolynomialKernel:
    """(offset + x'y)^degree, with an offset of at least 0."""

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
    """Return the list that `kernels` names or is, or explain."""
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
    """Return all kernels between two sets of touches, or batches of such sets.

    Parameters
    ----------
    kernels : sequence of kernels
    left : ndarray of shape (..., n_left, n_features)
        Touches less `mean`, which saves the digits of distances between touches
        far from the origin.
    right : ndarray of shape (..., n_right, n_features)
        Others, less `mean` too; distances within `left` come out exactly 0 on the
        diagonal if it is the same array.
    mean : ndarray of shape (n_features,)

    Returns
    -------
    ndarray of shape (..., n_kernels, n_left, n_right)
    """
    product = left @ right.swapaxes(-1, -2)
    stack = np.empty((*product.shape[:-2], len(kernels), *product.shape[-2:]))
    squared = _squared_distances(left, right, product)
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
    """Return k(x, x) of each touch, shape (n_kernels, n_touches).

    `touches` come less `mean`, as in `kernel_stack`.
    """
    square = ((touches + mean) ** 2).sum(axis=1)
    diagonals = np.empty((len(kernels), 1, len(touches)))
    with np.errstate(over="ignore"):
        _fill(diagonals, kernels, np.zeros((1, len(touches))), square[None])
    return diagonals[:, 0]


def _squared_distances(left: Floats, right: Floats, product: Floats) -> Floats:
    squared = -2 * product
    squared += np.square(left).sum(axis=-1)[..., :, None]
    squared += np.square(right).sum(axis=-1)[..., None, :]
    return np.maximum(squared, 0, out=squared)


def _fill(
    stack: Floats, kernels: Sequence[Kernel], squared: Floats, product: Floats
) -> None:
    """Write each kernel to its place in `stack`, shape (..., n_kernels, n, m)."""
    places = [stack[..., k, :, :] for k in range(len(kernels))]
    _fill_gaussians(places, kernels, squared)
    powers: dict[tuple[float, int], Floats] = {}
    for place, kernel in zip(places, kernels, strict=True):
        if isinstance(kernel, PolynomialKernel):
            place[...] = _power(kernel.offset, kernel.degree, product, powers)
        elif isinstance(kernel, LinearKernel):
            place[...] = product


def _fill_gaussians(
    places: list[Floats], kernels: Sequence[Kernel], squared: Floats
) -> None:
    """Widest first: half the width is the fourth power, cheaper than exponentials.

    A few in a row at most, since each time the rounding grows fourfold.
    """
    known: dict[float, tuple[Floats, int]] = {}
    gaussians = [
        (kernel.sigma, place)
        for kernel, place in zip(kernels, places, strict=True)
        if isinstance(kernel, GaussianKernel)
    ]
    for sigma, place in sorted(gaussians, key=lambda pair: -pair[0]):
        wider, steps = known.get(2 * sigma, (None, _MOST_STEPS))
        if wider is not None and steps < _MOST_STEPS:
            np.multiply(wider, wider, out=place)
            np.multiply(place, place, out=place)
            known[sigma] = place, steps + 1
        else:
            np.multiply(squared, -0.5 / sigma**2, out=place)
            np.exp(place, out=place)
            known[sigma] = place, 0


def _power(
    offset: float, degree: int, product: Floats, known: dict[tuple[float, int], Floats]
) -> Floats:
    """(offset + product)^degree from the highest power already known."""
    below = max((p for o, p in known if o == offset and p <= degree), default=0)
    if below == 0:
        known[offset, 1] = offset + product
        below = 1
    power, base = known[offset, below], known[offset, 1]
    for _ in range(degree - below):
        power = power * base
    known[offset, degree] = power
    return power
