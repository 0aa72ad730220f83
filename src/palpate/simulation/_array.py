"""A pressure array under a soft cover, pressed by a rigid flat part.

One press, in five steps, each with its own physics:

1. The part's face meets the cover at the depths its tilt and unevenness allow; the
   cover resists like a bed of springs, so that low or oblique loads touch only in
   places.
2. The cover spreads the pressure: vertical stress at its depth in an elastic half
   space (Boussinesq).
3. A taxel reads the mean stress over its sensing window, not over its pitch.
4. Every taxel has its own gain, and reads nothing below a threshold.
5. Noise is added and the reading rounded to 0..255.

Positions are (x, y) in mm from the middle of the array, x along its columns and y
along its rows (downwards); angles turn x towards y, clockwise as displayed. Grids of
the contact have square cells; positions on them are in cells, (column, row) for corners
of loops and (row, column) for arrays. Pressures are in kPa.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_count, check_number, check_positive
from .._parallel import on_one_thread
from .._types import Bools, Floats
from ._parts import Part, find_parts

NEWTON_PER_KGF = 9.80665
_LOADS_KGF = (0.1, 10.0)
# Work and memory grow with the cube and the square of it: 2000 take some seconds.
_MOST_STEPS = 2000
# Length over which a machined face's unevenness stays alike; a guess: a quarter of
# the parts' size.
UNEVENNESS_LENGTH_MM = 3.0
# Products of profiles smaller than this share of the largest are left out: it is
# ten thousand times less than half a grey level.
_RANK_TOLERANCE = 1e-8


@dataclass(frozen=True)
class Press:
    """Where, how and how hard a part is pressed.

    Parameters
    ----------
    x_mm, y_mm : float, default=0
        Middle of the part from the middle of the array, along columns and rows.
    angle_deg : float, default=0
        Turn of the part, clockwise as displayed.
    load_kgf : float, default=4
        Load in kgf, 0.1 to 10 (Liu et al. pressed with 1 to 5 and chose 4).
    tilt_deg : (float, float), default=(0, 0)
        Rise of the face along x and along y: the side at larger x or y is lifted.
    roughness_um : float, default=0
        Standard deviation in µm of the face's unevenness, drawn anew every press.
    """

    x_mm: float = 0.0
    y_mm: float = 0.0
    angle_deg: float = 0.0
    load_kgf: float = 4.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    roughness_um: float = 0.0

    def __post_init__(self) -> None:
        for name in ("x_mm", "y_mm", "angle_deg"):
            check_number(name, getattr(self, name))
        low, high = _LOADS_KGF
        check_number("load_kgf", self.load_kgf, low=low, high=high)
        check_number("roughness_um", self.roughness_um, low=0, high=1000)
        if np.shape(self.tilt_deg) != (2,):
            raise ValueError(
                f"tilt_deg must be two angles, along x and y, got {self.tilt_deg!r}."
            )
        for tilt in self.tilt_deg:
            check_number("tilt_deg", tilt, low=-10, high=10)

    @property
    def force_n(self) -> float:
        """The load in newtons."""
        return self.load_kgf * NEWTON_PER_KGF


@dataclass(frozen=True)
class PressureArray:
    """A piezoresistive pressure array with a silicone cover.

    Defaults are the array of Liu et al. (2014) [1]_. Every value is either
    published, or taken from a handbook, or marked as a guess; none was chosen by
    looking at recognition results.

    Parameters
    ----------
    rows, cols : int, default=10
        Taxels. Published [1]_.
    pitch_mm : float, default=2.0
        Distance of neighbouring taxels. Published: 1.3 mm and a spacer of 0.7 mm.
    sensing_mm : float, default=1.3
        Side of a taxel's square sensing window. Published.
    cover_mm : float, default=0.9
        Thickness of the silicone sheet, and depth at which stress is read.
        Published.
    cover_modulus_mpa : float, default=5.0
        Pressure per relative compression of the cover. Guess: a sheet of Shore
        50 A has a Young's modulus of 2.5 to 3.4 MPa; friction, which keeps a thin
        sheet from spreading, is taken to add about two thirds.
    gain_spread : float, default=0.1
        Standard deviation of the logarithm of the taxels' gains. Guess: printed
        piezoresistive cells commonly differ by about 10 %.
    dead_zone_kpa : float, default=69.0
        Below this a taxel reads nothing. The published calibration starts here, at
        10 psi; that less is not read is a guess.
    full_scale_kpa : float, default=4000.0
        Stress that reads 255; more saturates. The published calibration ends here,
        at 580 psi; that it fills the scale is a guess.
    noise_kpa : float, default=8.0
        Standard deviation of a reading. Guess: half a grey level.
    grid_mm : float, default=0.1
        Largest step of the grid on which the contact is worked out; at most 2000 of
        them along the longer side.
    random_state : int, default=0
        The device: it fixes the gains, which stay the same over all presses.

    Notes
    -----
    The face's pressure is k max(0, d - gap) with k = modulus / thickness and the
    indentation d at which it sums to the load: a Winkler foundation, fair for a
    sheet much thinner than the part ([2]_, section 5.8). Stress under the cover
    is Boussinesq's for a half space ([2]_, section 3.2), 3 F z³ / (2 pi R⁵), its
    mean over a window in closed form [3]_. Not modelled: friction, the rigid base under
    the cover, rounded edges, hysteresis, and a cover that stiffens as it flattens.
    A part larger than the array is clipped: what overhangs carries no load.

    References
    ----------
    .. [1] Liu et al., "Low-resolution tactile image recognition for automated
       robotic assembly using kernel PCA-based feature fusion and multiple kernel
       learning-based support vector machine", 2014, section 2.
    .. [2] K. L. Johnson, "Contact Mechanics", Cambridge University Press, 1985.
       doi:10.1017/CBO9781139171731
    .. [3] A. E. H. Love, "The stress produced in a semi-infinite solid by pressure
       on part of the boundary", Phil. Trans. R. Soc. A 228, 1929.
       doi:10.1098/rsta.1929.0009

    Examples
    --------
    >>> from palpate.simulation import PressureArray
    >>> image = PressureArray().press("hexagon13-hole8", random_state=0)
    >>> image.shape, image.dtype
    ((10, 10), dtype('uint8'))
    """

    rows: int = 10
    cols: int = 10
    pitch_mm: float = 2.0
    sensing_mm: float = 1.3
    cover_mm: float = 0.9
    cover_modulus_mpa: float = 5.0
    gain_spread: float = 0.1
    dead_zone_kpa: float = 69.0
    full_scale_kpa: float = 4000.0
    noise_kpa: float = 8.0
    grid_mm: float = 0.1
    random_state: int = 0

    def __post_init__(self) -> None:
        check_count("rows", self.rows, at_least=2)
        check_count("cols", self.cols, at_least=2)
        positive = ("pitch_mm", "sensing_mm", "cover_mm", "cover_modulus_mpa")
        for name in (*positive, "full_scale_kpa", "grid_mm"):
            check_positive(name, getattr(self, name))
        check_number("gain_spread", self.gain_spread, low=0, high=1)
        check_number("noise_kpa", self.noise_kpa, low=0)
        check_number("dead_zone_kpa", self.dead_zone_kpa, low=0)
        check_count("random_state", self.random_state, at_least=0)
        if self.sensing_mm > self.pitch_mm:
            raise ValueError(
                f"sensing_mm must be at most pitch_mm ({self.pitch_mm}), got "
                f"{self.sensing_mm}. Windows of neighbouring taxels cannot overlap."
            )
        side = max(self.rows, self.cols)
        cells = self.pitch_mm / self.grid_mm  # maybe too many to be counted
        steps = side * (self.cells_per_pitch if cells < _MOST_STEPS else cells)
        if steps > _MOST_STEPS:
            raise ValueError(
                f"pitch_mm must make at most {_MOST_STEPS} steps of grid_mm "
                f"({self.grid_mm:g}) along the longer side, got {self.pitch_mm:g} for "
                f"{side} taxels: {steps:.0f} steps. Lower `pitch_mm` or the "
                "number of taxels (`rows`, `cols`), or raise `grid_mm`."
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """Extent of the array along x and y, in mm."""
        return self.cols * self.pitch_mm, self.rows * self.pitch_mm

    @property
    def cells_per_pitch(self) -> int:
        """Steps of the contact grid from one taxel to the next."""
        return max(2, ceil(self.pitch_mm / self.grid_mm - 1e-9))

    @cached_property
    def gains(self) -> Floats:
        """Gain of each taxel, shape (rows, cols), with mean 1 over devices."""
        rng = np.random.default_rng(self.random_state)
        normal = rng.standard_normal((self.rows, self.cols))
        return np.exp(self.gain_spread * normal - self.gain_spread**2 / 2)

    def press(
        self,
        part: Part | str | int,
        x_mm: float = 0.0,
        y_mm: float = 0.0,
        angle_deg: float = 0.0,
        load_kgf: float = 4.0,
        *,
        tilt_deg: tuple[float, float] = (0.0, 0.0),
        roughness_um: float = 0.0,
        random_state: Any = None,
    ) -> NDArray[np.uint8]:
        """Press a part once and return the image, shape (rows, cols), 0..255.

        `part` is a `Part`, or the name or number of one of the twelve; the other
        parameters are those of `Press`. `random_state` (an int, a generator or
        None) draws the unevenness and the noise.
        """
        press = Press(x_mm, y_mm, angle_deg, load_kgf, tilt_deg, roughness_um)
        rng = np.random.default_rng(random_state)
        return self.read(self.stress_kpa(part, press, rng), rng)

    def read(
        self, stress_kpa: ArrayLike, random_state: Any = None
    ) -> NDArray[np.uint8]:
        """Turn stresses at the taxels, (rows, cols) in kPa, into grey levels."""
        stress = np.asarray(stress_kpa, dtype=np.float64)
        if stress.shape != (self.rows, self.cols) or not np.isfinite(stress).all():
            raise ValueError(
                f"stress_kpa must be finite and of shape {(self.rows, self.cols)}, "
                f"got {stress.shape}. Make it with `stress_kpa`."
            )
        sensed = stress * self.gains
        sensed[sensed < self.dead_zone_kpa] = 0
        rng = np.random.default_rng(random_state)
        sensed += self.noise_kpa * rng.standard_normal(sensed.shape)
        levels = np.rint(sensed * (255 / self.full_scale_kpa))
        return np.clip(levels, 0, 255).astype(np.uint8)

    def stress_kpa(
        self,
        part: Part | str | int,
        press: Press | None = None,
        random_state: Any = None,
    ) -> Floats:
        """Return the mean stress in kPa over each sensing window, (rows, cols)."""
        pressure, row, col = self._contact(part, press or Press(), random_state)
        cells, side = self.cells_per_pitch, max(self.rows, self.cols)
        where = (self.pitch_mm, self.sensing_mm, self.cover_mm)
        # Scale (rank,) and factors (rank, n_taxels, n_cells).
        scale, factors = window_weights(side, cells, *where)
        n_rows, n_cols = pressure.shape
        half = factors[:, : self.rows, row : row + n_rows] @ pressure
        weighted = half * scale[:, np.newaxis, np.newaxis]
        by_col = factors[:, : self.cols, col : col + n_cols]
        return np.tensordot(weighted, by_col, axes=([0, 2], [0, 2]))

    def contact_kpa(
        self,
        part: Part | str | int,
        press: Press | None = None,
        random_state: Any = None,
    ) -> Floats:
        """Return the pressure in kPa on the cover's surface, on the contact grid.

        Its shape is (rows, cols) times `cells_per_pitch`.
        """
        pressure, row, col = self._contact(part, press or Press(), random_state)
        cells = self.cells_per_pitch
        whole = np.zeros((self.rows * cells, self.cols * cells))
        whole[row : row + pressure.shape[0], col : col + pressure.shape[1]] = pressure
        return whole

    def _contact(
        self, part: Part | str | int, press: Press, random_state: Any
    ) -> tuple[Floats, int, int]:
        """Return pressure about the part, and the row and column it starts at."""
        (whole,) = find_parts(part)
        cells, (width_mm, height_mm) = self.cells_per_pitch, self.size_mm
        step, middle = self.pitch_mm / cells, np.array(self.size_mm) / 2
        placed = whole.placed(press.x_mm, press.y_mm, press.angle_deg)
        loops = [(loop + middle) * (cells / self.pitch_mm) for loop in placed]
        inside, row, col = footprint(loops, self.rows * cells, self.cols * cells)
        if not inside.any():
            raise ValueError(
                f"The part must lie on the array, {width_mm:g} x {height_mm:g} mm, "
                f"and be wider than grid_mm ({self.grid_mm:g}), got {whole.name!r} at "
                f"({press.x_mm:g}, {press.y_mm:g}) mm. Move it nearer to (0, 0)."
            )
        x = step * (np.arange(inside.shape[1]) + col + 0.5) - width_mm / 2
        y = step * (np.arange(inside.shape[0]) + row + 0.5) - height_mm / 2
        slope_x, slope_y = np.tan(np.deg2rad(press.tilt_deg))
        gap = slope_y * (y - press.y_mm)[:, np.newaxis] + slope_x * (x - press.x_mm)
        if press.roughness_um:
            rng = np.random.default_rng(random_state)
            gap += 1e-3 * press.roughness_um * unevenness(inside.shape, step, rng)
        stiffness = 1e3 * self.cover_modulus_mpa / self.cover_mm
        total = 1e3 * press.force_n / step**2
        pressure = contact_pressure(inside, gap, stiffness, total)
        depth_mm = pressure.max() / stiffness
        if depth_mm >= self.cover_mm:
            raise ValueError(
                f"The cover must be thicker than the press is deep, got {depth_mm:.2f} "
                f"mm in {self.cover_mm:g} mm ({whole.name!r}, {press.load_kgf:g} kgf, "
                f"tilt {press.tilt_deg} degrees). Lower the load or the tilt."
            )
        return pressure, row, col


def footprint(loops: list[Floats], n_rows: int, n_cols: int) -> tuple[Bools, int, int]:
    """Tell which cells' centres lie inside an odd number of closed loops.

    Corners are (column, row) in cells from the outer corner of the first; returned is
    the smallest piece of the grid that holds them, with its first row and column.
    """
    limits = np.array([n_cols, n_rows])
    corners = np.concatenate(loops)
    low = np.clip(np.floor(corners.min(axis=0)), 0, limits).astype(int)
    high = np.clip(np.ceil(corners.max(axis=0)), low, limits).astype(int)
    (col, row), (n_cols_about, n_rows_about) = low, high - low
    first = corners - low
    last = np.concatenate([np.roll(loop, -1, axis=0) for loop in loops]) - low
    centres = np.arange(n_rows_about) + 0.5
    cut = (first[:, 1:] <= centres) != (last[:, 1:] <= centres)
    edge, line = np.nonzero(cut)
    start, along = first[edge], last[edge] - first[edge]
    crossing = start[:, 0] + (centres[line] - start[:, 1]) / along[:, 1] * along[:, 0]
    cell = np.clip(np.ceil(crossing - 0.5), 0, n_cols_about).astype(int)
    width = int(n_cols_about) + 1
    counts = np.bincount(line * width + cell, minlength=int(n_rows_about) * width)
    crossed = counts.reshape(-1, width)[:, :-1].cumsum(axis=1)
    return crossed % 2 == 1, int(row), int(col)


def unevenness(
    shape: tuple[int, int], step_mm: float, rng: np.random.Generator
) -> Floats:
    """Draw a smooth random surface of mean 0 and standard deviation 1.

    Its covariance is exp(-d² / (2 length²)), with `UNEVENNESS_LENGTH_MM`.
    """
    by_row, by_col = (_smoothing(n, step_mm) for n in shape)
    noise = rng.standard_normal((by_row.shape[1], by_col.shape[1]))
    return by_row @ noise @ by_col.T


def contact_pressure(
    inside: Bools, gap_mm: Floats, stiffness: float, total: float
) -> Floats:
    """Solve stiffness max(0, depth - gap) (kPa) of cells `inside`, to sum to `total`.

    The sum is convex in the depth, so Newton's steps from all touching go down to it.
    """
    gaps = gap_mm[inside]
    needed = total / stiffness
    touching = gaps
    while True:
        depth = (needed + touching.sum()) / len(touching)
        still = touching[touching < depth]
        if len(still) == len(touching):
            break
        touching = still
    pressure = np.zeros(gap_mm.shape)
    pressure[inside] = stiffness * np.maximum(depth - gaps, 0)
    return pressure


@lru_cache(maxsize=8)
def window_weights(
    n_taxels: int, cells: int, pitch_mm: float, sensing_mm: float, depth_mm: float
) -> tuple[Floats, Floats]:
    """Factor the map from pressure on a grid to mean stress over square windows.

    Taxel (t, u): sum over k, i, j of scale[k] factors[k, t, i] factors[k, u, j]
    pressure[i, j], with scale (rank,) and factors (rank, n_taxels, n_taxels * cells).
    """
    step = pitch_mm / cells
    # Distances of cell centres from taxel centres, in half cells.
    centres = cells * (2 * np.arange(n_taxels)[:, np.newaxis] + 1)
    halves = np.abs(2 * np.arange(n_taxels * cells) + 1 - centres)
    distinct, place = np.unique(halves, return_inverse=True)
    away = distinct * step / 2
    kernel = step**2 * window_influence(away[:, np.newaxis], away, sensing_mm, depth_mm)
    # One thread: the last digits, and so the touches, must not hang on the number.
    with on_one_thread():
        values, vectors = np.linalg.eigh(kernel)
    kept = np.abs(values) > _RANK_TOLERANCE * np.abs(values).max()
    factors = vectors[:, kept].T[:, place.reshape(halves.shape)]
    return values[kept], np.ascontiguousarray(factors)


def window_influence(
    x_mm: Floats, y_mm: Floats, sensing_mm: float, depth_mm: float
) -> Floats:
    """Return mean stress (1/mm²) in a window, due to a unit force at (x, y) above it.

    By reciprocity: the stress below a loaded rectangle's corner, over four corners
    (Love 1929, doi:10.1098/rsta.1929.0009).
    """
    half = sensing_mm / 2
    corners = (
        _below_corner(x_mm + half, y_mm + half, depth_mm)
        - _below_corner(x_mm - half, y_mm + half, depth_mm)
        - _below_corner(x_mm + half, y_mm - half, depth_mm)
        + _below_corner(x_mm - half, y_mm - half, depth_mm)
    )
    return corners / sensing_mm**2


def _below_corner(a: Floats, b: Floats, z: float) -> Floats:
    """Vertical stress at depth z below a corner of a x b under unit pressure."""
    to_a, to_b, to_far = a**2 + z**2, b**2 + z**2, np.sqrt(a**2 + b**2 + z**2)
    shear = a * b * z / to_far * (1 / to_a + 1 / to_b)
    return (np.arctan(a * b / (z * to_far)) + shear) / (2 * np.pi)


@lru_cache(maxsize=512)
def _smoothing(n_cells: int, step_mm: float) -> Floats:
    """Weights (n_cells, n_knots) of knots on cells, each row of unit length."""
    width = UNEVENNESS_LENGTH_MM / np.sqrt(2)
    where = step_mm * np.arange(n_cells)
    n_knots = int(np.ceil((where[-1] + 6 * width) / width)) + 1
    knots = width * (np.arange(n_knots) - 3)
    weights = np.exp(-((where[:, np.newaxis] - knots) ** 2) / (2 * width**2))
    lengths = np.sqrt((weights**2).sum(axis=1, keepdims=True))
    return np.asarray(weights / lengths)
