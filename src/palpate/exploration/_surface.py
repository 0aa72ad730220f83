"""Where a round tip meets an object from every side: a radius for every direction.

A dome of radius R whose tip stops at p, pushed along d, has the middle of its ball at
p - R d. Where the ball touches something, that middle lies on the object's surface
pushed out by R, whichever way it came. So an object on one of its faces is a function
of directions: the radius at which the middle of the ball is met, in the frame of the
object (z up). It is learnt from the object's own touches as a Gaussian process over
directions, with the unknown place of each recording as a part of it,

    k(u, v) = m^2 + r^2 exp(-(u_z - v_z)^2 / 2 w^2) + s^2 exp(-|u - v|^2 / 2 w^2)
              + [same recording] a^2 (u_x v_x + u_y v_y) + [same touch] n^2,

averaged over w, s and n as the touches say, whose second term forgets the turn about
the vertical, as round things do; or it is found by pressing a simulated dome on a mesh.
Either way it is kept as a table of means and variances, and looked up between nodes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

from .._types import Floats, Indices
from ..simulation import DomeCamera, PlacedObject, SensorPose, SimObject
from ..touches import Touches
from ._record import places_of

N_AROUND = 72
_STEP = 2 * np.pi / N_AROUND
# Heights of the table: from 30 degrees below the horizontal, where an object that lies
# aside is met, to the top.
_LOWEST = -6
N_HEIGHTS = 1 - _LOWEST + N_AROUND // 4 - 1
HEIGHTS = _STEP * (np.arange(N_HEIGHTS) + _LOWEST)
AZIMUTHS = _STEP * np.arange(N_AROUND)
MEAN_SD_MM, _ROUND_SD_MM = 60.0, 30.0
_WIDTHS, _LOCAL_MM, _NOISES_MM = (0.2, 0.35, 0.6), (4.0, 10.0, 25.0), (1.0, 2.0, 4.0)
_ROUGHNESSES = tuple(product(_WIDTHS, _LOCAL_MM, _NOISES_MM))
_MESH_SD_MM, _PRESSES_AROUND = 1.5, 36
_START_MM = 300.0
# By how much a press goes in, and how far off the hull is that stands for an object.
_PRESS_MM, _TURNED_SD_MM = 5.0, 5.0
# Radii that differ by less look alike.
_ALIKE_MM = 2.0
# Approaches aim at one height where these differ by less, and at middles where the
# ground is as far below as tops are above, to so much.
_SAME_AIM_MM, _MIDDLE_MM = 2.0, 10.0
# How high above the ground approaches aim (mm), and the middles of the tip's ball
# about that point, (n_touches, 3).
Body = tuple[float, Floats]
# Lines of approach that pass within this (mm) of one point aim at it.
_AIM_MM = 10.0


@dataclass(frozen=True, eq=False)
class RadialSurface:
    """Radii at which the middle of the tip's ball is met, (n_heights, n_around).

    `mean_mm` and `variance_mm2` hold what is known of the surface; a touch differs
    from it by `noise_mm` (standard deviation). `size_mm` is twice the middling radius.
    """

    mean_mm: Floats
    variance_mm2: Floats
    noise_mm: float

    @property
    def size_mm(self) -> float:
        """Twice the mean radius."""
        return 2 * float(self.mean_mm.mean())

    def symmetry(self) -> int:
        """Return how many turns look alike: 1 for none, 72 for something round.

        The most turns that change the radii by less than what is known of them, over
        the part that can be reached.
        """
        reached = self.mean_mm[-_LOWEST:]
        weight = np.cos(HEIGHTS[-_LOWEST:])[:, None]
        variance = self.variance_mm2[-_LOWEST:].mean() + self.noise_mm**2
        limit = np.sqrt(variance + _ALIKE_MM**2)
        for order in (N_AROUND, 12, 8, 6, 4, 3, 2):
            steps = range(N_AROUND // order, N_AROUND // 2 + 1, N_AROUND // order)
            turned = np.stack([np.roll(reached, k, axis=1) for k in steps])
            squares = ((turned - reached) ** 2 * weight).mean(axis=(1, 2))
            if np.sqrt(squares.max()) < limit:
                return order
        return 1


def faces_of(touches: Touches) -> Indices:
    """Return the number of the face that the object stood on, 0 unless told."""
    faces = np.asarray(touches.columns.get("face", np.zeros(len(touches), int)))
    if faces.dtype.kind in "iu":
        return faces.astype(int)
    return np.unique(faces, return_inverse=True)[1]


def contacts_of(touches: Touches) -> tuple[Floats, Floats]:
    """Return tips at the contacts and ways of approach, (n_touches, 3) each."""
    ways = -places_of(touches, None, 4)
    column = touches.columns.get("position_mm")
    if column is None:
        raise ValueError(
            "touches must have a column 'position_mm' (the tip at the contact, in mm), "
            f"got {', '.join(touches.columns) or 'none'}. Add it, or use TouchMap."
        )
    tips = np.asarray(column, dtype=np.float64)
    if tips.shape != (len(touches), 3):
        raise ValueError(
            f"position_mm must have shape ({len(touches)}, 3), got {tips.shape}."
        )
    unplaced = np.flatnonzero(~np.isfinite(tips).all(axis=1))
    if len(unplaced):
        raise ValueError(
            f"position_mm must be finite, got {tips[unplaced[0]].tolist()} in touch "
            f"{unplaced[0]}, and no place in {len(unplaced)} of {len(touches)} "
            "touches. Leave those touches out."
        )
    return tips, ways


def middle_of(tips_mm: Floats, ways: Floats) -> Floats:
    """Return the point that the approaches aim at, else the middle of the contacts."""
    across = np.eye(3) - ways[:, :, None] * ways[:, None]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] > 0.1 * len(tips_mm):
        point = np.linalg.solve(total, np.einsum("nij,nj->i", across, tips_mm))
        off = np.einsum("nij,nj->ni", across, tips_mm - point)
        if np.linalg.norm(off, axis=1).max() < _AIM_MM:
            return np.asarray(point)
    return np.asarray((tips_mm.min(axis=0) + tips_mm.max(axis=0)) / 2)


def learnt_surface(
    middles_mm: Floats, recording: Indices, placement_mm: float
) -> RadialSurface:
    """Return the surface that touches have met, from the middles of the tip's ball.

    These, (n_touches, 3), are in the frame of the object. Touches of one `recording`,
    (n_touches,), share the error of its place, `placement_mm` (standard deviation).
    """
    radius = np.linalg.norm(middles_mm, axis=1)
    towards = middles_mm / np.maximum(radius, 1e-9)[:, None]
    together = recording[:, None] == recording
    shared = placement_mm**2 * together * (towards[:, :2] @ towards[:, :2].T)
    mean = float(np.median(radius))
    nodes = directions().reshape(-1, 3)
    evidence, parts = [], []
    for width, local, noise in _ROUGHNESSES:
        covariance = _kernel(towards, towards, width, local) + shared
        covariance += noise**2 * np.eye(len(radius))
        factor = np.linalg.cholesky(covariance)
        cross = _kernel(towards, nodes, width, local)
        right_sides = np.concatenate([(radius - mean)[:, None], cross], axis=1)
        solved = solve_triangular(factor, right_sides, lower=True)
        whitened, cross = solved[:, 0], solved[:, 1:]
        evidence.append(-0.5 * whitened @ whitened - np.log(np.diag(factor)).sum())
        prior = MEAN_SD_MM**2 + _ROUND_SD_MM**2 + local**2
        variance = np.maximum(prior - (cross**2).sum(axis=0), 0.01)
        parts.append((mean + whitened @ cross, variance, noise**2))
    # Few touches do not tell how smooth a thing is: all that may be is averaged.
    weight = np.exp(np.array(evidence) - max(evidence))
    weight /= weight.sum()
    means, variances, noises = map(np.array, zip(*parts, strict=True))
    together, shape = weight @ means, (N_HEIGHTS, N_AROUND)
    variance = weight @ (variances + (means - together) ** 2)
    noise_mm = float(np.sqrt(weight @ noises))
    return RadialSurface(together.reshape(shape), variance.reshape(shape), noise_mm)


def last_log_density(
    middles_mm: Floats,
    means_mm: Floats,
    mean_sd_mm: float,
    placement_mm2: Floats,
    sensor_mm: float,
) -> Floats:
    """Return the log density (nats, per mm) of the last contact after those before it.

    With surfaces that were never learnt, (n_surfaces,): by the process of
    `learnt_surface` before any training touch, so that what was met on one side says
    what is met beside it. Of middles of the tip's ball (n_contacts, 3), mean radii
    (n_surfaces,) known to `mean_sd_mm`, the variance of the place (3,), and the
    standard deviation of where the arm says that the tip is.
    """
    radius = np.linalg.norm(middles_mm, axis=1)
    towards = middles_mm / np.maximum(radius, 1e-9)[:, None]
    shared = (towards * placement_mm2) @ towards.T + sensor_mm**2 * np.eye(len(radius))
    kernels = [
        _kernel(towards, towards, width, local, mean_sd_mm)
        + noise**2 * np.eye(len(radius))
        for width, local, noise in _ROUGHNESSES
    ]
    factors = np.linalg.cholesky(np.stack(kernels) + shared)
    whitened = np.linalg.solve(factors, radius[:, None] - means_mm)
    scale = np.log(np.diagonal(factors, axis1=1, axis2=2))[..., None]
    each = -0.5 * (whitened**2 + np.log(2 * np.pi)) - scale
    before = logsumexp(each[:, :-1].sum(axis=1), axis=0)
    return np.asarray(logsumexp(each.sum(axis=1), axis=0) - before)


def mesh_surface(
    thing: SimObject, face: int, camera: DomeCamera, aim_mm: float | None = None
) -> RadialSurface:
    """Return the surface of a mesh on one of its faces, by pressing a simulated dome.

    Lines aim at `aim_mm` above the ground, by default at the middle of its box; the
    radius of one that meets nothing is 0.
    """
    placed = PlacedObject.resting(thing, face)
    step = N_AROUND // _PRESSES_AROUND
    nodes = directions()[-_LOWEST::step, ::step]
    x, y, middle_mm = placed.centre_mm
    aim = np.array([x, y, middle_mm if aim_mm is None else aim_mm])
    radii = np.array(
        [[_met_mm(placed, aim, out, camera) for out in row] for row in nodes]
    )
    heights = HEIGHTS[-_LOWEST::step]
    around = np.append(AZIMUTHS[::step], 2 * np.pi)
    closed = np.concatenate([radii, radii[:, :1]], axis=1)
    wide = np.array([np.interp(AZIMUTHS, around, row) for row in closed])
    mean = np.array([np.interp(HEIGHTS, heights, column) for column in wide.T]).T
    return RadialSurface(mean, _of_edges_mm2(mean) + 0.25, _MESH_SD_MM)


def one_aim(bodies: Iterable[Body]) -> float | None:
    """Return the height above the ground that all approaches aim at, if there is."""
    aims_mm = [aim_mm for aim_mm, _ in bodies]
    low, high = min(aims_mm, default=0.0), max(aims_mm, default=0.0)
    return (low + high) / 2 if low > _SAME_AIM_MM > high - low else None


def aims_at_middles(bodies: Iterable[Body], tip_mm: float) -> bool:
    """Whether tops are as far above the point aimed at as the ground is below."""
    tops = [
        middles[:, 2].max() - tip_mm + _PRESS_MM - aim_mm for aim_mm, middles in bodies
    ]
    return bool(np.median(np.abs(tops or [np.inf])) < _MIDDLE_MM)


def turned_surfaces(
    body: Body, aim_mm: float | None, tip_mm: float
) -> list[RadialSurface]:
    """Return how the surface of an object would be on other faces than this one.

    As if it were its convex hull, down to the ground under what is met low: the
    middles of the tip's ball lie on the hull grown by the ball, which turns with the
    object. Lines aim at `aim_mm` above the ground then, or at the middle of the hull.
    Empty where they span no body.
    """
    height_mm, middles = body
    grown_mm, points = tip_mm - _PRESS_MM, middles + np.array([0, 0, height_mm])
    low = points[points[:, 2] < 2 * tip_mm] * [1, 1, 0]
    narrower = np.maximum(1 - grown_mm / np.maximum(np.hypot(*low[:, :2].T), 1e-9), 0)
    below = low * narrower[:, None] - [0, 0, grown_mm]
    try:
        corners = np.concatenate([points, low, below])
        corners = corners[ConvexHull(corners).vertices]
        downs = _downs(corners)
        return [_resting_hull(corners, down, aim_mm, grown_mm) for down in downs]
    except QhullError:
        return []


def _downs(corners: Floats) -> list[Floats]:
    """Return the ways in its own frame that point down where it rests otherwise.

    On the top, or on a side of its narrowest upright box.
    """
    angles = np.linspace(0, np.pi / 2, 18, endpoint=False)
    sides = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    across = np.stack([-sides[:, 1], sides[:, 0], 0 * angles], axis=1)
    areas = np.ptp(corners @ sides.T, axis=0) * np.ptp(corners @ across.T, axis=0)
    best = int(areas.argmin())
    return [np.array([0.0, 0.0, 1.0]), sides[best], across[best]]


def _resting_hull(
    corners: Floats, down: Floats, aim_mm: float | None, grown_mm: float
) -> RadialSurface:
    """Return the surface of a grown hull that is turned until `down` points down."""
    turn, _ = Rotation.align_vectors([[0, 0, -1]], [down])
    turned = turn.apply(corners)
    low, high = turned.min(axis=0), turned.max(axis=0)
    x, y, _ = (low + high) / 2
    hull = ConvexHull(turned - [x, y, low[2] + grown_mm])
    aim = (high[2] - low[2]) / 2 - grown_mm if aim_mm is None else aim_mm
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    inside = np.maximum(-(offsets + normals @ [0, 0, aim]), 0.0)
    rising = np.maximum(directions().reshape(-1, 3) @ normals.T, 1e-9)
    mean = (inside / rising).min(axis=1).reshape(N_HEIGHTS, N_AROUND)
    return RadialSurface(mean, _of_edges_mm2(mean) + _TURNED_SD_MM**2, _MESH_SD_MM)


def _of_edges_mm2(mean_mm: Floats) -> Floats:
    """Return the variance that edges between nodes add: of half of the step there."""
    slope = np.abs(mean_mm - np.roll(mean_mm, 1, axis=1)) + np.abs(
        np.diff(mean_mm, axis=0, append=mean_mm[-1:])
    )
    return np.asarray((slope / 2) ** 2)


def directions() -> Floats:
    """Return the unit vectors of the table's nodes, (n_heights, n_around, 3)."""
    flat, height = np.cos(HEIGHTS)[:, None], np.sin(HEIGHTS)[:, None]
    parts = flat * np.cos(AZIMUTHS), flat * np.sin(AZIMUTHS), height + 0 * AZIMUTHS
    return np.stack(parts, axis=-1)


class SurfaceTable:
    """Surfaces, one for each state, in one table that is looked up all together."""

    def __init__(self, surfaces: list[RadialSurface]) -> None:
        self.mean_mm = np.stack([surface.mean_mm for surface in surfaces])
        self.size_mm = np.array([surface.size_mm for surface in surfaces])
        self.symmetry = np.array([surface.symmetry() for surface in surfaces])
        variances = [surface.variance_mm2 + surface.noise_mm**2 for surface in surfaces]
        table = np.stack([self.mean_mm, np.stack(variances)], axis=-1)
        self._both = table.reshape(-1, 2)

    def look_up(self, states: Indices, middles_mm: Floats) -> tuple[Floats, Floats]:
        """Return how far outside surfaces points lie (mm), and its variance (mm2).

        Points (..., 3) in the frames of the `states`, which broadcast with them.
        The variance is that of the surface and of a touch of it.
        """
        x, y, z = np.moveaxis(middles_mm, -1, 0)
        radius = np.sqrt(x * x + y * y + z * z)
        height = np.arcsin(np.clip(z / np.maximum(radius, 1e-6), -1, 1)) / _STEP
        row = np.clip(height - _LOWEST, 0, N_HEIGHTS - 1.001)
        column = np.arctan2(y, x) / _STEP % N_AROUND
        low, left = row.astype(np.intp), column.astype(np.intp) % N_AROUND
        up, right = row - low, column - np.floor(column)
        first = (states * N_HEIGHTS + low) * N_AROUND
        beside = (left + 1) % N_AROUND
        lower = _between(self._both, first + left, first + beside, right)
        above = first + N_AROUND
        upper = _between(self._both, above + left, above + beside, right)
        radius_and_variance = lower + (upper - lower) * up[..., None]
        return radius - radius_and_variance[..., 0], radius_and_variance[..., 1]


def met_along(
    table: SurfaceTable, states: Indices, far_mm: Floats, way: Floats
) -> tuple[Floats, Floats]:
    """Return the radius at which lines meet surfaces (mm), and its variance (mm2).

    The lines (..., 3) come in from `far_mm`, in the frames of the states, along the
    unit vectors `way`. Counted from the point of the line that is nearest the origin,
    outward; found by walking in by what is still left.
    """
    along = np.einsum("...i,...i->...", far_mm, -way)
    foot = far_mm + along[..., None] * way
    radius = np.full(along.shape, 80.0)
    for _ in range(4):
        left, variance = table.look_up(states, foot - radius[..., None] * way)
        radius = np.clip(radius - left, 0.0, None)
    return radius, variance


def _met_mm(
    placed: PlacedObject, aim: Floats, out: Floats, camera: DomeCamera
) -> float:
    start = SensorPose(aim + _START_MM * out, -out)
    reach = _START_MM + camera.membrane_radius_mm
    press = camera.press(placed, start, reach_mm=reach)
    if not press.touched:
        return 0.0
    return max(_START_MM - press.travel_mm + camera.membrane_radius_mm, 0.0)


def _kernel(
    left: Floats,
    right: Floats,
    width: float,
    local: float,
    mean_sd_mm: float = MEAN_SD_MM,
) -> Floats:
    heights = (left[:, 2][:, None] - right[:, 2]) ** 2
    squared = 2 - 2 * left @ right.T
    round_part = _ROUND_SD_MM**2 * np.exp(-heights / (2 * width**2))
    local_part = local**2 * np.exp(-squared / (2 * width**2))
    return np.asarray(mean_sd_mm**2 + round_part + local_part)


def _between(table: Floats, left: Indices, right: Indices, share: Floats) -> Floats:
    first = table[left]
    return np.asarray(first + (table[right] - first) * share[..., None])
