"""Place and angle of a part from the outline of one press, without training.

Positions are in mm from the middle of the array, x along columns and y along rows
(downwards); angles turn x towards y, clockwise as displayed.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_erosion, generate_binary_structure

from .._checks import check_count, check_images, check_positive
from .._types import Array, Floats
from ._array import binarise, correct_gamma, otsu_threshold, resize
from ._dead_taxels import fill_dead_taxels

Waves = NDArray[np.complex128]

# The first of each is the answer; the others tell how much hangs on the choice.
_PARTITIONS, _GAMMAS = (2, 1, 3), (0.65, 0.3, 1.0)
# Partitions that show only background have low thresholds: no lower than this share
# of the whole image's, or their noise would count as pressed.
_LEAST_THRESHOLD = 0.8
_PIXELS_PER_TAXEL = 3
_COVERAGE_VARIANCE = 1 / 12  # of a number between 0 and 1 drawn at random


@dataclass(frozen=True, eq=False)
class Poses:
    """Where parts lie and how they are turned, one entry per press.

    Parameters
    ----------
    x_mm, y_mm : ndarray of shape (n_touches,)
        Centroid of the part's outline from the middle of the array, along columns
        and along rows (downwards), in mm; 0 where nothing is pressed.
    angle_deg : ndarray of shape (n_touches,)
        From 0 to 360 / symmetry, from columns towards rows; 0 for symmetry 0.
    sd_mm : ndarray of shape (n_touches,)
        Root-mean-square distance expected from the true place, in mm; infinite where
        nothing is pressed.
    sd_deg : ndarray of shape (n_touches,)
        Standard deviation of the angle in degrees. Infinite where the angle says
        nothing: for symmetry 0, an unknown symmetry, an empty press, and where it
        would be that of an angle drawn at random.
    symmetry : ndarray of int of shape (n_touches,)
        In how many turns the part looks the same; 0 when every turn does.
    """

    x_mm: Floats
    y_mm: Floats
    angle_deg: Floats
    sd_mm: Floats
    sd_deg: Floats
    symmetry: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.x_mm)


def press_pose(images: ArrayLike, pitch_mm: float, symmetry: int = 1) -> Poses:
    """Estimate poses of a part of known symmetry from presses (n_touches, rows, cols).

    Place is the centroid of the outline, much as of `ArrayCleanUp`; the angle is that
    of the wave with `symmetry` crests around it (symmetry 0: none), 0 when the part
    reaches farthest along the columns: a bar at 0 lies along x, a square at 0 stands on
    a corner. A part longer than the array is placed where its visible piece is. NaN is
    a dead taxel.

    The variances are those over nine outlines (1, 2 and 3 partitions, three gammas),
    and what pixels at the edge may each be wrong by, as if independent.
    """
    filled = fill_dead_taxels(check_images(images, allow_nan=True))
    pitch = check_positive("pitch_mm", pitch_mm)
    order = check_count("symmetry", symmetry, at_least=0)
    shapes = [outlines(filled, n, g) for n, g in product(_PARTITIONS, _GAMMAS)]
    places = np.stack([outline_centres(shape) for shape in shapes])
    pairs = zip(shapes, places, strict=True)
    waves = np.stack([outline_wave(*pair, max(order, 1)) for pair in pairs])
    of_place, of_wave = _pixel_variances(shapes[0], places[0])
    sd = np.sqrt(places.var(axis=0).sum(axis=1) + of_place)
    angle, sd_deg = _angle(waves, of_wave, order)
    empty = np.isnan(places[0, :, 0])
    return Poses(
        x_mm=np.where(empty, 0.0, places[0, :, 0] * pitch),
        y_mm=np.where(empty, 0.0, places[0, :, 1] * pitch),
        angle_deg=np.where(empty, 0.0, angle),
        sd_mm=np.where(np.isnan(sd), np.inf, sd * pitch),
        sd_deg=np.where(empty, np.inf, sd_deg),
        symmetry=np.full(len(filled), order),
    )


def outlines(images: Floats, n_partitions: int, gamma: float) -> NDArray[np.bool_]:
    """Make presses binary, three pixels per taxel."""
    shape = (images.shape[1] * _PIXELS_PER_TAXEL, images.shape[2] * _PIXELS_PER_TAXEL)
    enlarged = correct_gamma(resize(images, shape), gamma)
    floor = _LEAST_THRESHOLD * otsu_threshold(enlarged)
    above_floor = enlarged > floor[:, np.newaxis, np.newaxis]
    return binarise(enlarged, n_partitions) & above_floor


def outline_centres(shapes: NDArray[np.bool_]) -> Floats:
    """Centroids (x, y) of `outlines` in taxels from the middle, NaN where empty."""
    count = shapes.sum(axis=(1, 2))
    count = np.where(count > 0, count, np.nan)
    y, x = _grid(shapes.shape[1:])
    by_col, by_row = shapes.sum(axis=1), shapes.sum(axis=2)
    return np.column_stack([by_col @ x / count, by_row @ y / count])


def outline_wave(shapes: Array, centres: Floats, order: int) -> Waves:
    """Sum of r^2 exp(i order phi) over each shape, about its centre."""
    y, x = _grid(shapes.shape[1:])
    u = (x - centres[:, [0]])[:, None, :] + 1j * (y - centres[:, [1]])[:, :, None]
    radius = np.abs(u)
    unit = np.divide(u, radius, out=np.ones_like(u), where=radius > 0)
    return np.asarray((shapes * radius**2 * unit**order).sum(axis=(1, 2)))


def doubt_of_angle(variance: Floats, symmetry: int) -> Floats:
    """Standard deviations in degrees of variances in square radians.

    Infinite from 360 / symmetry / sqrt(12) degrees, those of an angle drawn at random.
    """
    if symmetry == 0:
        return np.full(len(variance), np.inf)
    sd: Floats = np.rad2deg(np.sqrt(variance))
    return np.where(sd < 360 / symmetry / np.sqrt(12), sd, np.inf)


def within_period(angle: Floats, period: float) -> Floats:
    """Return angles from 0 to below the period, also where rounding reaches it."""
    rest = angle % period
    return np.where(rest < period, rest, 0.0)


def _pixel_variances(
    shapes: NDArray[np.bool_], centres: Floats
) -> tuple[Floats, Floats]:
    """Variances of place (square taxels) and wave, as edge pixels may count or not."""
    cross = generate_binary_structure(2, 1)[np.newaxis]
    edge = (shapes & ~binary_erosion(shapes, cross)) * _COVERAGE_VARIANCE
    y, x = _grid(shapes.shape[1:])
    across, down = (x - centres[:, [0]]) ** 2, (y - centres[:, [1]]) ** 2
    squared = across[:, np.newaxis, :] + down[:, :, np.newaxis]
    count = np.maximum(shapes.sum(axis=(1, 2)), 1)
    of_place = (edge * squared).sum(axis=(1, 2)) / count**2
    return of_place, (edge * squared**2).sum(axis=(1, 2))


def _angle(waves: Waves, of_wave: Floats, order: int) -> tuple[Floats, Floats]:
    """Angle of the first clean-up and its standard deviation, in degrees."""
    n_touches = waves.shape[1]
    if order == 0:
        return np.zeros(n_touches), np.full(n_touches, np.inf)
    period = 360 / order
    angle = within_period(np.rad2deg(np.angle(waves[0])) / order, period)
    size = np.abs(waves)
    unit = np.divide(waves, size, out=np.zeros_like(waves), where=size > 0)
    agreement = np.abs(unit.mean(axis=0)).clip(1e-300, 1)
    # Half of the wave's variance lies across it, where it turns the wave.
    across = of_wave / 2 / np.maximum(size[0], 1e-150) ** 2
    return angle, doubt_of_angle((across - 2 * np.log(agreement)) / order**2, order)


def _grid(shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Y of the rows and x of the columns of `outlines`, in taxels."""
    y, x = ((np.arange(n) - (n - 1) / 2) / _PIXELS_PER_TAXEL for n in shape)
    return y, x
