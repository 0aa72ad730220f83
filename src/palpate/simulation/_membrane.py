"""Contact of a thin rubber dome with a rigid object, solved on a square grid.

The dome is a shallow spherical shell under a pressure p (N/mm2) that pushes it in
by w (mm): D lap^2 w + (E t / R^2) w = p with D = E t^3 / (12 (1 - nu^2)). Its
response to a force at one node is a multiplication in Fourier space; the contact is
the set of node forces, none negative, that makes the dome follow the object without
passing through it.

Grids are indexed [row, column] = [y, x], node (i, j) at the centre of its cell; the
apex is the middle. w is positive inwards, along the axis of the sensor. A gap is how
far (mm) the sensor moves on, after first touching, before that node is reached;
infinity is a node that nothing can reach.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from .._checks import check_count, check_number, check_positive
from .._types import Bools, Floats, Singles

Grid = Singles
# Nodes closer to the rim than this share of the radius carry no contact: there the
# dome stands along the axis and its height is no longer a function one can press.
_USED_RADIUS = 0.95
_NEVER_MM = np.float32(1e3)
_TINY = np.float32(1e-30)
_FLOAT = np.float32


@dataclass(frozen=True, eq=False)
class Contact:
    """The dome against an object."""

    depth_mm: float  # how far the sensor moved on after first touching
    force_n: float  # in all, along the axis
    node_force_n: Grid  # (n_nodes, n_nodes), none negative
    displacement_mm: Grid  # how far the shell is pushed in, (n_nodes, n_nodes)
    area_mm2: float  # of the nodes in contact, seen along the axis


@dataclass(frozen=True)
class Membrane:
    """A spherical rubber dome, clamped nowhere, and the grid it is solved on.

    Parameters
    ----------
    radius_mm, thickness_mm : float, default=20.0, 1.5
        Radius of the middle surface and thickness.
    youngs_mpa, poisson : float, default=0.11, 0.48
        Young's modulus (N/mm2) and Poisson's ratio, below 0.5.
    n_nodes : int, default=48
        Nodes along a side of the grid, which spans 0.95 of the diameter.

    Notes
    -----
    Linear, for small deflections of a shallow shell: no snap-through, no friction,
    and beyond 0.8 of the radius the equation no longer holds. The rubber is also
    squeezed through its thickness, free to spread sideways: a compliance t / E under
    the pressure, which matters under points and edges.

    References
    ----------
    .. [1] E. Reissner, "Stresses and small displacements of shallow spherical
       shells", J. Math. Phys. 25, 1946. doi:10.1002/sapm194625180
    """

    radius_mm: float = 20.0
    thickness_mm: float = 1.5
    youngs_mpa: float = 0.11
    poisson: float = 0.48
    n_nodes: int = 48

    def __post_init__(self) -> None:
        for name in ("radius_mm", "thickness_mm", "youngs_mpa"):
            check_positive(name, getattr(self, name))
        check_number("poisson", self.poisson, low=0.0, high=0.499)
        check_count("n_nodes", self.n_nodes, at_least=8)
        if self.thickness_mm > self.radius_mm / 4:
            raise ValueError(
                "thickness_mm must be at most a quarter of radius_mm, got "
                f"{self.thickness_mm}. A thin shell is what is solved."
            )

    @property
    def stiffness_n_mm3(self) -> float:
        """Force per displaced volume, E t / R^2 (N/mm3)."""
        return self.youngs_mpa * self.thickness_mm / self.radius_mm**2

    @property
    def bending_n_mm(self) -> float:
        """Bending stiffness D = E t^3 / (12 (1 - nu^2)) (N mm)."""
        return self.youngs_mpa * self.thickness_mm**3 / (12 * (1 - self.poisson**2))

    @property
    def reach_mm(self) -> float:
        """Length (D / (E t / R^2))^(1/4) over which a dent dies away (mm)."""
        return float((self.bending_n_mm / self.stiffness_n_mm3) ** 0.25)

    @property
    def pitch_mm(self) -> float:
        """Distance between nodes (mm)."""
        return 2 * _USED_RADIUS * self.radius_mm / self.n_nodes

    @cached_property
    def node_mm(self) -> Floats:
        """Places of the nodes along one side, (n_nodes,), 0 at the axis."""
        index = np.arange(self.n_nodes, dtype=np.float64)
        return (index + 0.5 - self.n_nodes / 2) * self.pitch_mm

    @cached_property
    def drop_mm(self) -> Floats:
        """How far each node lies behind the tip (mm); infinity beyond the dome."""
        squared = self.node_mm[:, None] ** 2 + self.node_mm**2
        inside = squared < (_USED_RADIUS * self.radius_mm) ** 2
        height = np.sqrt(np.maximum(self.radius_mm**2 - squared, 0))
        return np.where(inside, self.radius_mm - height, np.inf)

    @cached_property
    def used_mm(self) -> tuple[Floats, Floats, Floats]:
        """Places x and y, and drop, of the nodes within the dome, (n_used,) each."""
        inside = np.isfinite(self.drop_mm)
        x, y = np.meshgrid(self.node_mm, self.node_mm)
        return x[inside], y[inside], self.drop_mm[inside]

    def pressed(
        self,
        gap_mm: NDArray[Any],
        *,
        force_n: float | None = None,
        depth_mm: float | None = None,
        tolerance_mm: float = 0.01,
        max_steps: int = 200,
    ) -> Contact:
        """Press it on an object until a force or a depth, whichever is first.

        `gap_mm`, (n_nodes, n_nodes), is the way to go, infinity where there is none.
        Steps end at a root-mean-square misfit of `tolerance_mm`, whose default puts w
        within 0.06 mm under 75 gf. Conjugate gradients on the touching nodes, clipping
        forces at zero and taking in pierced nodes: I. A. Polonsky, L. M. Keer, "A
        numerical method for solving rough contact problems", Wear 231(2), 1999,
        doi:10.1016/S0043-1648(99)00113-1.
        """
        gap = np.asarray(gap_mm, dtype=np.float32)
        if gap.shape != (self.n_nodes, self.n_nodes):
            raise ValueError(
                f"gap_mm must be {self.n_nodes} x {self.n_nodes}, one a node, "
                f"got shape {gap.shape}."
            )
        if np.isnan(gap).any() or (gap < 0).any():
            raise ValueError(
                "gap_mm must be at least 0, without NaN. Subtract the least gap first."
            )
        reachable = gap < _NEVER_MM
        gap = np.where(reachable, gap, _NEVER_MM)
        if force_n is None and depth_mm is None:
            raise ValueError("Give force_n, depth_mm or both: the press must end.")
        most = np.inf
        if depth_mm is not None:
            most = check_number("depth_mm", depth_mm, low=0.0)
        force = None if force_n is None else check_positive("force_n", force_n)
        if not reachable.any() or most == 0:
            nothing = np.zeros(gap.shape, np.float32)
            return Contact(0.0, 0.0, nothing, nothing, 0.0)
        problem = _Problem(self, gap, reachable, tolerance_mm, max_steps)
        if force is None:
            return problem.at_depth(most, problem.springs(most))
        return problem.at_first(force, most)

    def displaced(self, node_force_n: Grid, *, whole: bool = False) -> Grid:
        """Return w (mm) of the shell under forces at the nodes (N).

        With `whole`, on the padded grid that the Fourier transform works on, whose
        total is the displaced volume over the square of the pitch.
        """
        return self._answer(node_force_n, self._shell, whole)

    def _indented(self, node_force_n: Grid) -> Grid:
        """How far (mm) the outside gives way: the shell and the squeezed rubber."""
        return self._answer(node_force_n, self._outside)

    def _answer(self, force: Grid, spectrum: Grid, whole: bool = False) -> Grid:
        # Products with the waves: on so few nodes they beat the fast transform.
        there = self._waves[: self.n_nodes]
        back = self._waves if whole else there
        answer = there.T.dot(force).dot(there) * spectrum
        return np.asarray(back.dot(answer).dot(back.T))

    @cached_property
    def _outside(self) -> Grid:
        squeeze = self.thickness_mm / self.youngs_mpa / self.pitch_mm**2
        return self._shell + np.float32(squeeze)

    @cached_property
    def _padded(self) -> int:
        """Side of the padded grid: dents die away before they come round again."""
        margin = max(self.n_nodes // 2, int(np.ceil(6 * self.reach_mm / self.pitch_mm)))
        return int(fft.next_fast_len(self.n_nodes + margin, real=True))

    @cached_property
    def _waves(self) -> Grid:
        """Cosines, then sines along the padded grid, a column each, of length 1."""
        number = np.arange(self._padded)
        angle = 2 * np.pi / self._padded * np.outer(number, number)
        waves = np.where(number <= self._padded // 2, np.cos(angle), np.sin(angle))
        return np.asarray(waves / np.linalg.norm(waves, axis=0), np.float32)

    @cached_property
    def _shell(self) -> Grid:
        squared = (2 * np.pi * fft.fftfreq(self._padded, self.pitch_mm)) ** 2
        fourth = (squared[:, None] + squared) ** 2
        answer = 1 / (self.bending_n_mm * fourth + self.stiffness_n_mm3)
        return (answer / self.pitch_mm**2).astype(np.float32)


@dataclass(frozen=True, eq=False)
class _Problem:
    membrane: Membrane
    gap: Grid
    reachable: Bools
    tolerance: float
    max_steps: int

    def at_depth(self, depth_mm: float, start: Grid) -> Contact:
        return self._described(self._relaxed(start, None, depth_mm), depth_mm)

    def at_first(self, force_n: float, depth_mm: float) -> Contact:
        # The depth at which such springs add up to the force.
        ordered = np.sort(self.gap, axis=None).astype(np.float64)
        filled = np.cumsum(ordered)
        count = np.arange(1, len(ordered) + 1)
        forces = (count * ordered - filled) * self._spring
        n_pressed = max(int(np.searchsorted(forces, force_n)), 1)
        even = float((force_n / self._spring + filled[n_pressed - 1]) / n_pressed)
        if depth_mm < 0.5 * even:
            shallow = self.at_depth(depth_mm, self.springs(depth_mm))
            if shallow.force_n <= force_n:
                return shallow
        force = self._relaxed(self.springs(even), force_n, None)
        contact = self._described(force, None)
        if contact.depth_mm <= depth_mm:
            return contact
        share = np.float32(depth_mm / contact.depth_mm)
        return self.at_depth(depth_mm, contact.node_force_n * share)

    @property
    def _spring(self) -> np.float32:
        """Force per depth (N/mm) if every node were a spring of its own."""
        pitch = self.membrane.pitch_mm
        return np.float32(self.membrane.stiffness_n_mm3 * pitch**2)

    def springs(self, depth_mm: float) -> Grid:
        """Node forces of such springs, where to start from."""
        return np.asarray(np.maximum(np.float32(depth_mm) - self.gap, 0) * self._spring)

    def _relaxed(
        self, start: Grid, total: float | None, depth_mm: float | None
    ) -> Grid:
        """Node forces at which dome and object agree; see `Membrane.pressed`."""
        membrane, tolerance = self.membrane, self.tolerance
        force = start if total is None else start * np.float32(total / start.sum())
        indented = membrane._indented(force)
        search, before, steady = np.zeros_like(force), np.float32(1), False
        for _ in range(self.max_steps):
            touching = force > 0
            misfit = indented + self.gap
            inside = touching.astype(_FLOAT)
            n_inside = _FLOAT(np.count_nonzero(touching))
            depth = depth_mm or np.vdot(misfit, inside) / n_inside
            misfit -= _FLOAT(depth)
            pierced = (misfit < -tolerance) & (self.reachable > touching)
            n_pierced = np.count_nonzero(pierced)
            if n_pierced:
                inside += pierced
                n_inside += n_pierced
            held = misfit * inside
            if total is not None and n_pierced:
                held -= inside * (held.sum() / n_inside)
            norm = np.vdot(held, held)
            if norm <= n_inside * tolerance**2 and not n_pierced:
                break
            steady = steady and not n_pierced
            search = held + (norm / before) * (search * inside) if steady else held
            before = norm
            answer = membrane._indented(search)
            step = np.vdot(held, search) / max(np.vdot(answer, search), _TINY)
            force = force - step * search
            steady = not np.count_nonzero(force < 0)
            if not steady:
                np.maximum(force, 0, out=force)
            scale = _FLOAT(1 if total is None else total / force.sum())
            force *= scale
            if steady:
                indented = (indented - step * answer) * scale
            else:
                indented = membrane._indented(force)
        return force

    def _described(self, force: Grid, depth_mm: float | None) -> Contact:
        membrane, inside, depth = self.membrane, force > 0, depth_mm
        if depth is None:
            depth = float((membrane._indented(force) + self.gap)[inside].mean())
        area = float(np.count_nonzero(inside) * membrane.pitch_mm**2)
        total = float(force.sum(dtype=np.float64))
        shell = np.ascontiguousarray(membrane.displaced(force))
        return Contact(max(float(depth), 0.0), total, force, shell, area)
