"""A disc on a grid of taxels: which taxels lie inside, which its rim cuts.

Coordinates are in radii from the centre: x along the columns, y along the rows
(downwards), so that the angle turns from the columns towards the rows. Taxel centres
are at integers, so the frame reaches half a taxel further on every side.
"""

from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from .._types import Floats

Nodes = tuple[Floats, Floats, Floats]


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

    def holds_centre(self) -> NDArray[np.bool_]:
        """Taxels whose centre is inside, (n_rows, n_cols)."""
        return np.hypot(self.y[:, None], self.x) <= 1

    def holds_whole(self) -> NDArray[np.bool_]:
        """Taxels that are inside with all four corners, (n_rows, n_cols)."""
        x, y = np.abs(self.x) + self.step / 2, np.abs(self.y) + self.step / 2
        return np.hypot(y[:, None], x) <= 1

    def touches(self) -> NDArray[np.bool_]:
        """Taxels of which any part is inside, (n_rows, n_cols)."""
        x = np.maximum(np.abs(self.x) - self.step / 2, 0)
        y = np.maximum(np.abs(self.y) - self.step / 2, 0)
        return np.hypot(y[:, None], x) < 1

    def is_cut(self) -> NDArray[np.bool_]:
        """Taxels that the rim cuts, (n_rows, n_cols)."""
        return self.touches() & ~self.holds_whole()


def whole_nodes(disc: Disc, taxels: NDArray[np.intp], n_nodes: int) -> Nodes:
    """Points and weights over whole taxels (flat indices), (n_taxels, n_nodes**2)."""
    node, weight = leggauss(n_nodes)
    half = disc.step / 2
    row, col = np.divmod(taxels, disc.n_cols)
    x = disc.x[col, None] + half * np.tile(node, n_nodes)
    y = disc.y[row, None] + half * np.repeat(node, n_nodes)
    area = half**2 * np.outer(weight, weight).ravel()
    return x, y, np.broadcast_to(area, x.shape)


class Chords(NamedTuple):
    """Lines along x that fill the parts inside the disc of taxels that its rim cuts.

    All arrays are (n_taxels, n_lines); sums with `weight` over lines integrate.
    """

    y: Floats
    left: Floats
    right: Floats
    weight: Floats


def cut_chords(disc: Disc, taxels: NDArray[np.intp], order: int) -> Chords:
    """Chords that integrate polynomials of degree `order` to rounding error.

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
    return Chords(np.sin(angle), start, stop, weights)


def cut_nodes(disc: Disc, taxels: NDArray[np.intp], order: int, n_nodes: int) -> Nodes:
    """Points and weights that integrate over the parts of cut taxels inside."""
    chords = cut_chords(disc, taxels, order)
    node, weight = leggauss(n_nodes)
    half = ((chords.right - chords.left) / 2)[..., None]
    x = (chords.left[..., None] + half) + half * node
    weights = chords.weight[..., None] * half * weight
    y = np.broadcast_to(chords.y[..., None], x.shape)
    shape = len(taxels), x.shape[1] * n_nodes
    return x.reshape(shape), y.reshape(shape), weights.reshape(shape)
