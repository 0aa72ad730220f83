"""Place and angle of a part from the outline of one press, without training.

Positions are in mm from the middle of the array, x along columns and y along rows
(downwards); angles turn x towards y, clockwise as displayed.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_count, check_images, check_positive
from ._array import correct_gamma, resize
from ._dead_taxels import fill_dead_taxels
from ._otsu import binarise, otsu_threshold

Floats = NDArray[np.float64]
Waves = NDArray[np.complex128]

# The first of each is the answer; the others tell how much hangs on the choice.
_PARTITIONS, _GAMMAS = (2, 1, 3), (0.65, 0.3, 1.0)
# Partitions that show only background have low thresholds: no lower than this share
# of the whole image's, or their noise would count as pressed.
_LEAST_THRESHOLD = 0.8
_PIXELS_PER_TAXEL = 3


@dataclass(frozen=True, eq=False)
class Poses:
    """Where parts lie and how they are turned, one entry per press.

    Parameters
    ----------
    x_mm, y_mm : ndarray of shape (n_touches,)
        Centroid of the part's outline from the middle of the array, along columns
        and along rows (downwards), in mm; NaN where nothing is pressed.
    angle_deg : ndarray of shape (n_touches,)
        From 0 to 360 / symmetry, from columns towards rows; NaN for symmetry 0.
    sd_mm : ndarray of shape (n_touches,)
        Root-mean-square distance expected from the true place, in mm.
    sd_deg : ndarray of shape (n_touches,)
        Standard deviation of the angle in degrees, infinite for symmetry 0.
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
    """Estimate the pose of a part of known symmetry from single presses.

    The press is made binary by Otsu's thresholds, much as in `ArrayCleanUp`; place is
    the outline's centroid, and the angle is that of the wave with `symmetry` crests
    around it: 0 when the part reaches farthest along the columns. A bar at 0 lies
    along x; a square at 0 stands on a corner.

    Parameters
    ----------
    images : array-like of shape (n_touches, n_rows, n_cols)
        NaN marks a dead taxel.
    pitch_mm : float
        Distance of neighbouring taxels, in mm.
    symmetry : int, default=1
        In how many turns the part looks the same; 0 when every turn does.

    Returns
    -------
    poses : Poses

    Notes
    -----
    The standard deviations are the spread over nine outlines (1, 2 and 3 partitions,
    three gammas), so they show what the outline leaves open, not a miscalibration
    of the array. A part longer than the array is placed where its visible piece is.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import press_pose
    >>> bar = np.zeros((1, 10, 10))
    >>> bar[0, 2:4, 1:9] = 100
    >>> poses = press_pose(bar, pitch_mm=2.0, symmetry=2)
    >>> poses.x_mm.round(6) + 0, poses.y_mm.round(6), poses.angle_deg.round(6) + 0
    (array([0.]), array([-4.]), array([0.]))
    """
    filled = fill_dead_taxels(check_images(images, allow_nan=True))
    pitch = check_positive("pitch_mm", pitch_mm)
    order = check_count("symmetry", symmetry, at_least=0)
    places, waves = [], []
    for n_partitions, gamma in product(_PARTITIONS, _GAMMAS):
        shapes = outlines(filled, n_partitions, gamma)
        places.append(outline_centres(shapes))
        waves.append(outline_wave(shapes, places[-1], max(order, 1)))
    place = np.stack(places) * pitch
    angle, sd_deg = _angle(np.stack(waves), order)
    sd_mm = np.sqrt(place.var(axis=0).sum(axis=1))
    empty = np.isnan(place[0, :, 0])
    return Poses(
        x_mm=place[0, :, 0],
        y_mm=place[0, :, 1],
        angle_deg=np.where(empty, np.nan, angle),
        sd_mm=np.where(np.isnan(sd_mm), np.inf, sd_mm),
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


def outline_wave(shapes: NDArray, centres: Floats, order: int) -> Waves:
    """Sum of r^2 exp(i order phi) over each shape, about its centre."""
    y, x = _grid(shapes.shape[1:])
    u = (x - centres[:, [0]])[:, None, :] + 1j * (y - centres[:, [1]])[:, :, None]
    radius = np.abs(u)
    unit = np.divide(u, radius, out=np.ones_like(u), where=radius > 0)
    return np.asarray((shapes * radius**2 * unit**order).sum(axis=(1, 2)))


def _angle(waves: Waves, order: int) -> tuple[Floats, Floats]:
    """Angle of the first clean-up and spread over all, in degrees."""
    n_touches = waves.shape[1]
    if order == 0:
        return np.full(n_touches, np.nan), np.full(n_touches, np.inf)
    period = 360 / order
    angle = np.rad2deg(np.angle(waves[0])) / order % period
    size = np.abs(waves)
    unit = np.divide(waves, size, out=np.zeros_like(waves), where=size > 0)
    agreement = np.abs(unit.mean(axis=0)).clip(1e-300, 1)
    return angle, np.rad2deg(np.sqrt(-2 * np.log(agreement))) / order


def _grid(shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Y of the rows and x of the columns of `outlines`, in taxels."""
    y, x = ((np.arange(n) - (n - 1) / 2) / _PIXELS_PER_TAXEL for n in shape)
    return y, x
