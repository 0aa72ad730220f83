"""Zernike polynomials: which there are, their values, and their Legendre products.

V(n, m) = R(n, m) exp(i m phi) on the unit disc, of order n with m waves around the
centre, n - m even. Only m >= 0 is computed: V(n, -m) is the conjugate. Radial
polynomials never appear by themselves; everything follows from the recurrence
V(n, m) = z V(n-1, m-1) + conj(z) V(n-1, m+1) - V(n-2, m) with z = x + iy, which
keeps all digits to order 100, where sums of factorials lose them by order 15.
"""

from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import lru_cache
from math import lcm

import numpy as np

from .._types import Array, Complexes, Floats

Times = Callable[[Array], Array]


def zernike_degrees(order: int) -> list[tuple[int, int]]:
    """(n, m) with 0 <= m <= n <= order, n - m even, by n and then m."""
    return [(n, m) for n in range(order + 1) for m in range(n % 2, n + 1, 2)]


def signed_degrees(order: int) -> list[tuple[int, int]]:
    """(n, m) with -n <= m <= n <= order, n - m even, by n and then m."""
    return [(n, m) for n in range(order + 1) for m in range(-n, n + 1, 2)]


def noll_degrees(order: int) -> list[tuple[int, int]]:
    """(n, m) in the order of Noll's index j = 1, 2, ...; m < 0 is a sine, of odd j."""
    degrees: list[tuple[int, int]] = []
    for n in range(order + 1):
        for m in range(n % 2, n + 1, 2):
            cosine_first = len(degrees) % 2 == 1
            signs = (1, -1) if cosine_first else (-1, 1)
            degrees += [(n, sign * m) for sign in signs] if m else [(n, 0)]
    return degrees


def zernike_values(order: int, x: Floats, y: Floats) -> Iterator[Complexes]:
    """Yield V(n, m) at the points (x, y), in the order of `zernike_degrees`."""
    z = x + 1j * y
    unit = np.ones_like(z)
    return _recurrence(order, unit, lambda v: z * v, lambda v: z.conj() * v)


@lru_cache(maxsize=32)
def legendre_weights(order: int) -> Complexes:
    """Weights of P_i(x) P_j(y) in V(n, m), at [degree, i, j]; none of i + j > order.

    Exact rationals, rounded once; beyond order 20 their sums lose digits.
    """
    monomials = np.stack(list(_monomial_weights(order)))
    to_legendre, scale = _powers_as_legendre(order)
    parts = []
    for part in (monomials.real, monomials.imag):
        whole = part.astype(np.int64).astype(object)
        both = np.matmul(to_legendre.T, np.matmul(whole, to_legendre))
        parts.append((both / scale**2).astype(np.float64))
    return np.asarray(parts[0] + 1j * parts[1])


def _monomial_weights(order: int) -> Iterator[Complexes]:
    """Yield weights of x^a y^b at [a, b] of each V(n, m): whole, exact to order 20."""

    def times(a: Array, sign: int) -> Array:
        product = np.zeros_like(a)
        product[1:] += a[:-1]
        product[:, 1:] += sign * 1j * a[:, :-1]
        return product

    unit = np.zeros((order + 1, order + 1), dtype=complex)
    unit[0, 0] = 1
    yield from _recurrence(order, unit, lambda a: times(a, 1), lambda a: times(a, -1))


def _recurrence(
    order: int, unit: Array, times_z: Times, times_conjugate: Times
) -> Iterator[Array]:
    """Yield V(0, 0), V(1, 1), V(2, 0), ... from the four-term recurrence."""
    before: dict[int, Array] = {}
    last = {0: unit}
    yield unit
    for n in range(1, order + 1):
        new = {}
        for m in range(n % 2, n + 1, 2):
            value = times_z(last[m - 1] if m else last[1].conj())
            if m + 1 in last:
                value += times_conjugate(last[m + 1])
            if m in before:
                value -= before[m]
            new[m] = value
            yield value
        before, last = last, new


def _powers_as_legendre(order: int) -> tuple[Array, int]:
    """Whole numbers w and a scale with x^a = sum over i of w[a, i] P_i(x) / scale."""
    rows = [[Fraction(1)] + [Fraction(0)] * order]
    for _ in range(order):
        row = [Fraction(0)] * (order + 2)
        for i, weight in enumerate(rows[-1]):
            row[i + 1] += weight * Fraction(i + 1, 2 * i + 1)
            if i:
                row[i - 1] += weight * Fraction(i, 2 * i + 1)
        rows.append(row[:-1])
    scale = lcm(*(weight.denominator for row in rows for weight in row))
    whole = [[int(weight * scale) for weight in row] for row in rows]
    return np.array(whole, dtype=object), scale
