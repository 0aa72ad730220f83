"""Zernike moments of many images at once, from small tables.

To order 20 every Zernike polynomial is an exact sum of Legendre products, so two
short matrix products for each image and one small one for all replace a basis as
large as the images (2 MB of tables instead of 77 MB at 300 x 300 and order 15).
Taxels that the rim cuts have no product form: they get rows of their own.
Above order 20 the sums would lose digits, and the basis itself is used: a quarter of
it where the disc sits in the middle of the frame, else in blocks.

Coordinates are in radii from the disc's centre: x along the columns, y along the rows
(downwards), so that the angle turns from the columns towards the rows. Taxel centres
are at integers, so the frame reaches half a taxel further on every side.
"""

from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import lru_cache
from itertools import product
from math import lcm
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss, legmulx, legvander
from numpy.typing import DTypeLike

from .._types import Array, Bools, Complexes, Floats, Indices

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

    def times(a: Array, sign: int) -> Array:
        product = np.zeros_like(a)
        product[1:] += a[:-1]
        product[:, 1:] += sign * 1j * a[:, :-1]
        return product

    # Weights of x^a y^b at [a, b] of each V(n, m): whole, exact to order 20.
    unit = np.zeros((order + 1, order + 1), dtype=complex)
    unit[0, 0] = 1
    ways = (lambda a: times(a, 1)), (lambda a: times(a, -1))
    monomials = np.stack([*_recurrence(order, unit, *ways)])
    to_legendre, scale = _powers_as_legendre(order)
    parts = []
    for part in (monomials.real, monomials.imag):
        whole = part.astype(np.int64).astype(object)
        both = np.matmul(to_legendre.T, np.matmul(whole, to_legendre))
        parts.append((both / scale**2).astype(np.float64))
    return np.asarray(parts[0] + 1j * parts[1])


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
    powers = [np.array([Fraction(1)])]
    for _ in range(order):
        powers.append(legmulx(powers[-1]))
    scale = lcm(*(weight.denominator for weight in np.concatenate(powers)))
    whole = np.zeros((order + 1, order + 1), dtype=object)
    for row, weights in zip(whole, powers, strict=True):
        row[: len(weights)] = [int(weight * scale) for weight in weights]
    return whole, scale


Nodes = tuple[Floats, Floats, Floats]
HIGHEST_SEPARABLE_ORDER = 20  # up to it weights of monomials are exact
# Taxels per pass over the images: what fits in a processor's second-level cache.
_TAXELS_IN_CACHE = 2**17
# Numbers in one buffer of features, and in one block of a dense basis: 8 and 16 MB.
_FEATURES_AT_ONCE = 2**20
_BASIS_AT_ONCE = 2**21
# Numbers in the folded tables of one grid: 256 MB.
_MOST_FOLDED = 2**25
_IMAGES_AT_ONCE = 64


class Disc(NamedTuple):
    """A disc in a frame of taxels; lengths in taxels."""

    n_rows: int
    n_cols: int
    row: float
    col: float
    radius: float

    @property
    def step(self) -> float:
        """Side of one taxel, in radii."""
        return 1 / self.radius

    @property
    def x(self) -> Floats:
        """Taxel centres along the columns, in radii."""
        return (np.arange(self.n_cols, dtype=np.float64) - self.col) / self.radius

    @property
    def y(self) -> Floats:
        """Taxel centres along the rows, in radii."""
        return (np.arange(self.n_rows, dtype=np.float64) - self.row) / self.radius

    def holds_centre(self) -> Bools:
        """Taxels whose centre is inside, (n_rows, n_cols)."""
        return np.hypot(self.y[:, None], self.x) <= 1

    def holds_whole(self) -> Bools:
        """Taxels that are inside with all four corners, (n_rows, n_cols)."""
        x, y = np.abs(self.x) + self.step / 2, np.abs(self.y) + self.step / 2
        return np.hypot(y[:, None], x) <= 1

    def touches(self) -> Bools:
        """Taxels of which any part is inside, (n_rows, n_cols)."""
        x = np.maximum(np.abs(self.x) - self.step / 2, 0)
        y = np.maximum(np.abs(self.y) - self.step / 2, 0)
        return np.hypot(y[:, None], x) < 1

    def is_cut(self) -> Bools:
        return self.touches() & ~self.holds_whole()


def whole_nodes(disc: Disc, taxels: Indices, n_nodes: int) -> Nodes:
    """Points and weights over whole taxels (flat indices), (n_taxels, n_nodes**2)."""
    node, weight = leggauss(n_nodes)
    half = disc.step / 2
    row, col = np.divmod(taxels, disc.n_cols)
    x = disc.x[col, None] + half * np.tile(node, n_nodes)
    y = disc.y[row, None] + half * np.repeat(node, n_nodes)
    area = half**2 * np.outer(weight, weight).ravel()
    return x, y, np.broadcast_to(area, x.shape)


Chords = tuple[Floats, Floats, Floats, Floats]


def cut_chords(disc: Disc, taxels: Indices, order: int) -> Chords:
    """Chords that integrate polynomials of degree `order` to rounding error.

    They are lines along x that fill the parts inside the disc of taxels that its rim
    cuts: y, left and right end and weight, (n_taxels, n_lines) each; sums with the
    weight over lines integrate.
    Each taxel is split where the rim crosses its edges; between, y = sin(t) makes the
    chords' ends analytic in t, so that Gauss-Legendre points converge at once.
    """
    row, col = np.divmod(taxels, disc.n_cols)
    half = disc.step / 2
    left, right = disc.x[col] - half, disc.x[col] + half
    low = np.clip(disc.y[row] - half, -1, 1)
    high = np.clip(disc.y[row] + half, -1, 1)
    crossings = np.sqrt(np.clip(1 - np.square([left, right]), 0, None))
    ends = np.clip(np.stack([low, high, *crossings, *-crossings]), low, high)
    t = np.sort(np.arcsin(ends), axis=0).T
    # Half of the widest angle that one taxel can span, in periods of the integrand.
    span = (order + 2) * np.arccos(max(1 - disc.step, -1)) / 2
    node, weight = leggauss(8 + int(np.ceil(span)))
    middle, reach = (t[:, 1:] + t[:, :-1]) / 2, (t[:, 1:] - t[:, :-1]) / 2
    shape = len(taxels), reach.shape[1] * len(node)
    angle = (middle[..., None] + reach[..., None] * node).reshape(shape)
    rim = np.cos(angle)
    start = np.maximum(left[:, None], -rim)
    stop = np.maximum(np.minimum(right[:, None], rim), start)
    weights = (reach[..., None] * weight).reshape(shape) * rim
    return np.sin(angle), start, stop, weights


def cut_nodes(disc: Disc, taxels: Indices, order: int, n_nodes: int) -> Nodes:
    """Points and weights that integrate over the parts of cut taxels inside."""
    chords = cut_chords(disc, taxels, order)
    y, left, right, along = (part[..., None] for part in chords)
    node, weight = leggauss(n_nodes)
    half = (right - left) / 2
    x = (left + half) + half * node
    weights = along * half * weight
    y = np.broadcast_to(y, x.shape)
    shape = len(taxels), x.shape[1] * n_nodes
    return x.reshape(shape), y.reshape(shape), weights.reshape(shape)


class Grid(NamedTuple):
    """The disc, order and precision that tables depend on."""

    disc: Disc
    order: int
    exact: bool
    single: bool = False


def zernike_moments(images: Array, grid: Grid) -> Complexes:
    """Integrate images times conj(V(n, m)) over the disc, (n_touches, n_degrees).

    Degrees are `zernike_degrees`, lengths radii: an image of 1 has the moment pi at (0,
    0).
    """
    method = dense_moments
    if grid.order <= HIGHEST_SEPARABLE_ORDER:
        method = separable_moments
    elif _can_fold(grid.disc, grid.order):
        method = quartered_moments
    with np.errstate(invalid="ignore", over="ignore"):
        parts = method(images, grid)
    n_degrees = parts.shape[1] // 2
    moments = np.empty((len(images), n_degrees), dtype=np.complex128)
    moments.real = parts[:, :n_degrees]
    np.negative(parts[:, n_degrees:], out=moments.imag)
    return moments


def separable_moments(images: Array, grid: Grid) -> Floats:
    """Cosine then sine parts of all moments, through Legendre products."""
    table = _table(grid)
    n_features = len(table.weights)
    parts = np.empty((len(images), table.weights.shape[1]))
    step = max(1, _FEATURES_AT_ONCE // n_features)
    for start in range(0, len(images), step):
        block = images[start : start + step]
        features = np.empty((len(block), n_features))
        _fill_features(block, table, grid, features)
        np.matmul(features, table.weights, out=parts[start : start + step])
    return parts


def dense_moments(images: Array, grid: Grid) -> Floats:
    """Cosine then sine parts of all moments, through the basis itself."""
    taxels, flat = _dense_taxels(grid), images.reshape(len(images), -1)
    n_parts = 2 * len(zernike_degrees(grid.order))
    parts = np.zeros((len(images), n_parts))
    step = max(1, _BASIS_AT_ONCE // n_parts)
    for start in range(0, len(taxels), step):
        basis = _dense_basis(grid, start, start + step)
        for i in range(0, len(images), _IMAGES_AT_ONCE):
            rows = slice(i, i + _IMAGES_AT_ONCE)
            levels = flat[rows, taxels[start : start + step]].astype(np.float64)
            parts[rows] += levels @ basis
    return parts


def quartered_moments(images: Array, grid: Grid) -> Floats:
    """Cosine then sine parts of all moments, through a quarter of the basis.

    Each part is even or odd across and down, so it meets one of four folded images.
    """
    quarters, taxels, n_parts = _quarters(grid)
    parts = np.empty((len(images), n_parts))
    middle, centre = grid.disc.n_rows // 2, grid.disc.n_cols // 2
    for start in range(0, len(images), _IMAGES_AT_ONCE):
        block = images[start : start + _IMAGES_AT_ONCE]
        block = block.astype(quarters[0].basis.dtype)
        upper, lower = block[:, ::-1][:, middle:], block[:, middle:]
        halves = {1: lower + upper, -1: lower - upper}
        for quarter in quarters:
            half = halves[quarter.down]
            left, right = half[:, :, ::-1][:, :, centre:], half[:, :, centre:]
            folded = right + left if quarter.across > 0 else right - left
            levels = folded.reshape(len(block), -1)[:, taxels]
            rows = slice(start, start + len(block))
            parts[rows, quarter.columns] = levels @ quarter.basis
    return parts


class _Table(NamedTuple):
    """Tables of the separable method; `down` holds its polynomials in two halves."""

    down: Floats
    across: Floats
    products: Indices
    cut: Indices
    weights: Floats


def _fill_features(images: Array, table: _Table, grid: Grid, features: Floats) -> None:
    """Sums of image times P_i(x) P_j(y), then the levels of the cut taxels."""
    n_products = len(table.products)
    mask = _mask(grid, np.dtype(np.float64))
    step = max(1, min(len(images), _TAXELS_IN_CACHE // mask.size))
    masked = np.empty((step, *mask.shape))
    for start in range(0, len(images), step):
        block = images[start : start + step]
        inside = masked[: len(block)]
        if block.dtype == np.float64:
            np.multiply(block, mask, out=inside)
        else:
            np.copyto(inside, block * _mask(grid, block.dtype))
        halves = np.matmul(table.down, inside[:, None])
        sums = halves.reshape(len(block), -1, mask.shape[1]) @ table.across
        sums = sums.reshape(len(block), -1)
        out = features[start : start + step]
        np.take(sums, table.products, axis=1, out=out[:, :n_products], mode="clip")
        if len(table.cut):
            out[:, n_products:] = block.reshape(len(block), -1).take(table.cut, axis=1)


@lru_cache(maxsize=64)
def _mask(grid: Grid, dtype: DTypeLike) -> Array:
    """1 at the taxels that are summed as they are, 0 elsewhere, in the image's type."""
    disc = grid.disc
    inside = disc.holds_whole() if grid.exact else disc.holds_centre()
    mask = inside.astype(dtype)
    mask.flags.writeable = False
    return mask


@lru_cache(maxsize=16)
def _table(grid: Grid) -> _Table:
    disc, order = grid.disc, grid.order
    down = _legendre_sums(disc.y, disc.step, order, grid.exact)
    across = _legendre_sums(disc.x, disc.step, order, grid.exact)
    # Two short products are faster than one: OpenBLAS has kernels for small ones.
    # With an even order the last polynomial is one of zeros.
    padded = np.pad(down, ((0, 0), (0, (order + 1) % 2)))
    halves = np.ascontiguousarray(padded.T).reshape(2, -1, disc.n_rows)
    j, i = np.nonzero(np.add.outer(np.arange(order + 1), np.arange(order + 1)) <= order)
    weights = legendre_weights(order)[:, i, j].T
    cut = np.flatnonzero(disc.is_cut()) if grid.exact else np.empty(0, dtype=np.intp)
    # P_i(x) P_j(y) over the parts inside, (n_taxels, order + 1, order + 1).
    y, left, right, weight = cut_chords(disc, cut, order)
    along = _legendre_antiderivatives(right, order)
    along -= _legendre_antiderivatives(left, order)
    along *= weight[..., None]
    integrals = along.transpose(0, 2, 1) @ legvander(y, order)
    rows = integrals[:, i, j] @ _parts(weights)
    both = np.vstack([_parts(weights), rows])
    return _Table(halves, across, j * (order + 1) + i, cut, both)


def _parts(values: Complexes) -> Floats:
    return np.concatenate([values.real, values.imag], axis=1)


def _legendre_sums(centres: Floats, step: float, order: int, exact: bool) -> Floats:
    """P_i integrated over each taxel's side, or at its centre times the side."""
    node, weight = leggauss(order // 2 + 1) if exact else (np.zeros(1), np.full(1, 2.0))
    points = np.clip(centres[:, None] + step / 2 * node, -1, 1)
    sums: Floats = np.einsum("tgi,g->ti", legvander(points, order), weight * step / 2)
    return sums


def _legendre_antiderivatives(x: Floats, order: int) -> Floats:
    values = legvander(x, order + 1)
    primitives = np.empty((*x.shape, order + 1))
    primitives[..., 0] = x
    odd = 2 * np.arange(1, order + 1) + 1
    primitives[..., 1:] = (values[..., 2:] - values[..., :-2]) / odd
    return primitives


@lru_cache(maxsize=16)
def _dense_taxels(grid: Grid) -> Indices:
    disc = grid.disc
    return np.flatnonzero(disc.touches() if grid.exact else disc.holds_centre())


@lru_cache(maxsize=16)
def _dense_basis(grid: Grid, start: int, stop: int) -> Floats:
    """Parts over taxels `start` to `stop`, (n_taxels, 2 * n_degrees)."""
    return _basis_of(grid, _dense_taxels(grid)[start:stop])


def _basis_of(grid: Grid, taxels: Indices) -> Floats:
    disc, order = grid.disc, grid.order
    if not grid.exact:
        row, col = np.divmod(taxels, disc.n_cols)
        values = np.stack(list(zernike_values(order, disc.x[col], disc.y[row])))
        return _parts(values.T * disc.step**2)
    # Few points are enough, as a taxel holds few of the polynomial's waves.
    n_nodes = min(order // 2 + 1, 5 + int(np.ceil(order * disc.step)))
    cut = disc.is_cut().ravel()[taxels]
    basis = np.empty((len(taxels), 2 * len(zernike_degrees(order))))
    whole = whole_nodes(disc, taxels[~cut], n_nodes)
    basis[~cut] = _integrate(order, *whole)
    basis[cut] = _integrate(order, *cut_nodes(disc, taxels[cut], order, n_nodes))
    return basis


def _integrate(order: int, x: Floats, y: Floats, weight: Floats) -> Floats:
    """Weighted sums of V(n, m) over each row of points, (n_rows, 2 * n_degrees)."""
    sums = [np.einsum("tk,tk->t", weight, v) for v in zernike_values(order, x, y)]
    return _parts(np.stack(sums, axis=1))


class _Quarter(NamedTuple):
    """One kind of symmetry: signs of the fold, columns of the basis, and its values."""

    down: int
    across: int
    columns: Indices
    basis: Array


@lru_cache(maxsize=64)
def _can_fold(disc: Disc, order: int) -> bool:
    """Whether the disc sits in the middle of the frame, and the tables are small."""
    in_middle = (disc.row, disc.col) == ((disc.n_rows - 1) / 2, (disc.n_cols - 1) / 2)
    n_parts = 2 * len(zernike_degrees(order))
    return in_middle and disc.n_rows * disc.n_cols // 4 * n_parts <= _MOST_FOLDED


@lru_cache(maxsize=4)
def _quarters(grid: Grid) -> tuple[list[_Quarter], Indices, int]:
    """The four parts of the basis, the taxels of a quarter that count, n_parts."""
    disc, taxels = grid.disc, _dense_taxels(grid)
    # Single precision halves the time: reading the basis is what takes it.
    dtype = np.float32 if grid.single else np.float64
    row, col = np.divmod(taxels, disc.n_cols)
    top, left = disc.n_rows // 2, disc.n_cols // 2
    in_quarter = (row >= top) & (col >= left)
    row, col = row[in_quarter], col[in_quarter]
    # A row or column in the very middle is folded onto itself and counts twice.
    twice = (disc.n_rows % 2) * (row == top), (disc.n_cols % 2) * (col == left)
    share = 0.5 ** (twice[0].astype(float) + twice[1])
    basis = _basis_of(grid, taxels[in_quarter]) * share[:, np.newaxis]
    m = np.array([m for _, m in zernike_degrees(grid.order)])
    sign = np.where(m % 2 == 0, 1, -1)
    # cos(m phi) keeps its sign from top to bottom, sin(m phi) changes it.
    down = np.concatenate([np.ones_like(m), -np.ones_like(m)])
    across = np.concatenate([sign, -sign])
    quarters = []
    for vertical, horizontal in product((1, -1), repeat=2):
        columns = np.flatnonzero((down == vertical) & (across == horizontal))
        part = np.ascontiguousarray(basis[:, columns], dtype)
        quarters.append(_Quarter(vertical, horizontal, columns, part))
    width = disc.n_cols - left
    return quarters, (row - top) * width + (col - left), len(down)
