"""Place and angle of parts from presses, after learning the parts.

A robot that assembles a part needs its place and angle. `PressPose` builds a template
of each part from presses in unknown poses, finds out how symmetric it is, and registers
new presses on it.

Positions are in mm from the middle of the array, x along columns and y along rows
(downwards); angles turn x towards y, clockwise as displayed.

While templates are learnt and registered, a pose is (angle, x, y): radians from the
column axis towards the row axis, and the template's origin in taxels from the middle of
the image, x along columns and y along rows. Templates are square, `_OVERSAMPLING`
pixels per taxel, origin in the middle.

A press is modelled as its template times a plane, since a hand presses unevenly.
The plane is solved for in closed form, so only the pose is searched. Where the
presses' poses are unknown, template and poses are improved in turn; how many turns
look the same is settled on presses that the template has not seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt
from sklearn.base import BaseEstimator
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted

from .._checks import (
    check_count,
    check_images,
    check_label_kinds,
    check_positive,
    one_each,
)
from .._types import Floats, Indices
from ._array import binarise, correct_gamma, fill_dead_taxels, resize
from ._orientation import interpolate, per_touch, repose

_PIXELS_PER_TAXEL, _GAMMA = 3, 0.8  # of the outline that registration starts from
# With fewer presses no half can teach a template, and symmetry cannot be tested.
_LEAST_FOR_SYMMETRY = 6
# A template of n presses makes the angle's variance 1 + 3 / n times what registration
# alone would have: its own angle is only as good as theirs, and it bears their noise.
# Measured on simulated parts; the tests use another draw.
_OF_TEMPLATE = 3.0
_OVERSAMPLING = 2  # pixels per taxel: linear interpolation blurs less
# Penalty on the plane's rise over `_PLANE_TAXELS`, so that tilt is not unlimited.
_PLANE_PRECISION, _PLANE_TAXELS = 0.3, 3.0
_SEARCH_DEG = 10.0
_FEWEST_STEPS, _MOST_STEPS, _SMALL_GAIN = 2, 8, 1e-4
_DIFFERENCE = np.array([0.02, 0.05, 0.05])  # for derivatives: radians, taxels
_LONGEST_STEP = 0.3
_LEAST_NOISE = 1e-4
_SYMMETRIES = (0, 8, 6, 5, 4, 3, 2, 1)
_N_ROUNDS = 4
# How much worse than others, on unseen presses, a symmetry may fit and still be
# taken. Fewer turns have more freedom to fit noise, so the fit without symmetry and
# the round one are compared with more patience. Square grids of taxels look the same
# in 1, 2 and 4 turns, and lend even a disc something of that. Set on two draws of
# simulated parts; the tests use another.
_TOLERANCE, _TOLERANCE_NONE, _TOLERANCE_ROUND = 1.05, 1.075, 1.078
_OF_THE_GRID, _TOLERANCE_GRID = (1, 2, 4), 1.3
# Symmetries that spoil the template itself more than this are not tried.
_LEAST_LIKENESS = 0.8
_ROUND_COPIES = 36

_Pair = tuple[Floats, Floats]


@dataclass(frozen=True, eq=False)
class Poses:
    """Places and angles of parts, one entry per press.

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
    symmetry: Indices

    def __len__(self) -> int:
        return len(self.x_mm)


class PressPose(BaseEstimator):
    """Place and angle of known parts, with uncertainty, from single presses.

    Parameters
    ----------
    pitch_mm : float, default=2.0
        Distance of neighbouring taxels, in mm.
    symmetry : int or dict of label to int, optional
        In how many turns each part looks the same; 0 when every turn does. Labels
        without an entry are found out, from six presses upwards; with fewer, it is
        unknown: 1 is reported, with angles of infinite standard deviation.
    max_presses : int, default=40
        Presses of each part to learn from, evenly spaced among those given.

    Attributes
    ----------
    labels_ : ndarray of shape (n_labels,)
        The parts, sorted.
    symmetry_ : ndarray of int of shape (n_labels,)
    templates_ : ndarray of shape (n_labels, size, size)
        Roots of pressures in the part's own frame, two pixels per taxel.
    centroids_ : ndarray of shape (n_labels, 2)
        (x, y) of the outline's centroid in that frame, in taxels.
    zeros_deg_ : ndarray of shape (n_labels,)
        Angle of registration that is reported as 0.
    inflation_ : ndarray of shape (n_labels,)
        By which the angle's variance grows since the template has errors too;
        infinite where the symmetry is unknown.
    image_shape_ : tuple of int

    Notes
    -----
    A press is modelled as a template, turned and moved, times a plane that stands
    for uneven pressing. A symmetry is accepted when it fits unseen presses about as
    well as the best. The variance of the place is that of the registration plus its
    squared distance from the outline's own centroid, which sees what tilt hides.
    A blank press lies in the middle of the array with infinite uncertainty.
    A part longer than the array cannot be placed along its length.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import PressPose
    >>> bar = np.zeros((1, 10, 10))
    >>> bar[0, 4:6, 2:8] = 100
    >>> pose = PressPose(symmetry=2).fit(bar, ["bar"])
    >>> moved = pose.estimate(np.roll(bar, 1, axis=2), ["bar"])
    >>> moved.x_mm.round(1), moved.angle_deg.round(1) % 180
    (array([2.]), array([0.]))
    """

    def __init__(
        self,
        pitch_mm: float = 2.0,
        *,
        symmetry: int | Mapping[object, int] | None = None,
        max_presses: int = 40,
    ) -> None:
        self.pitch_mm = pitch_mm
        self.symmetry = symmetry
        self.max_presses = max_presses

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        tags.input_tags.allow_nan = True
        tags.target_tags.required = True
        return tags

    def fit(
        self, X: ArrayLike, y: ArrayLike, angle_deg: ArrayLike | None = None
    ) -> Self:
        """Learn the parts.

        Parameters
        ----------
        X : array-like of shape (n_touches, n_rows, n_cols)
            Presses in any poses; NaN marks a dead taxel.
        y : array-like of shape (n_touches,)
            The part pressed.
        angle_deg : array-like of shape (n_touches,), optional
            True angles; they fix what is reported as 0. Otherwise 0 is where the
            part reaches farthest along the columns: a bar at 0 lies along x, a
            square at 0 stands on a corner.
        """
        images = check_images(X, allow_nan=True)
        check_label_kinds(y)
        labels = one_each("y", y, len(images))
        angles = None
        if angle_deg is not None:
            each = one_each("angle_deg", angle_deg, len(images))
            angles = per_touch("angle_deg", each, labels.shape)
        check_positive("pitch_mm", self.pitch_mm)
        most = check_count("max_presses", self.max_presses)
        self.image_shape_ = (images.shape[1], images.shape[2])
        self.labels_ = np.unique(labels)
        learnt = []
        for label in self.labels_.tolist():
            chosen = np.flatnonzero(labels == label)
            if len(chosen) > most:
                chosen = chosen[np.arange(most) * len(chosen) // most]
            part_angles = None if angles is None else angles[chosen]
            learnt.append(self._learn(images[chosen], label, part_angles))
        templates, symmetry, centroids, zeros, inflation = zip(*learnt, strict=True)
        self.templates_, self.symmetry_ = np.stack(templates), np.array(symmetry)
        self.centroids_, self.zeros_deg_ = np.stack(centroids), np.array(zeros)
        self.inflation_ = np.array(inflation)
        return self

    def estimate(self, X: ArrayLike, y: ArrayLike) -> Poses:
        """Estimate the pose of each press `X` of the parts `y`."""
        check_is_fitted(self)
        images = check_images(X, shape=self.image_shape_, allow_nan=True)
        check_label_kinds(y)
        labels = one_each("y", y, len(images))
        unknown = np.setdiff1d(labels, self.labels_)
        if len(unknown):
            raise ValueError(
                f"y must hold labels seen by fit, got {unknown.tolist()[0]!r}. Fit "
                "with presses of that part."
            )
        which = np.searchsorted(self.labels_, labels)
        poses = np.empty((len(images), 5))
        for index in np.unique(which):
            poses[which == index] = self._place(images[which == index], int(index))
        x, y_down, angle, sd, sd_deg = poses.T
        x_mm, y_mm, sd_mm = (taxels * self.pitch_mm for taxels in (x, y_down, sd))
        return Poses(x_mm, y_mm, angle, sd_mm, sd_deg, self.symmetry_[which])

    def _learn(
        self, images: Floats, label: object, angles: Floats | None
    ) -> tuple[Floats, int, Floats, float, float]:
        """Template, symmetry, centroid, zero and inflation of one part."""
        levels, outline = _prepare(images)
        pressed = np.isfinite(outline[:, 0])
        if not pressed.any():
            raise ValueError(
                f"X must hold presses of {label!r} that show it, got only constant "
                "images. Leave that part out."
            )
        levels, outline = levels[pressed], outline[pressed]
        symmetry = self.symmetry
        if isinstance(symmetry, Mapping):
            symmetry = symmetry.get(label)
        inflation = 1 + _OF_TEMPLATE / len(levels)
        if symmetry is not None:
            symmetry = check_count("symmetry", symmetry, at_least=0)
        elif len(levels) >= _LEAST_FOR_SYMMETRY:
            symmetry = _find_symmetry(levels, outline)
        else:
            symmetry, inflation = 1, np.inf
        template, poses = _learn_template(levels, outline, symmetry)
        centroid = np.zeros(2)
        if symmetry == 1:
            centroid = _turn(outline - poses[:, 1:], -poses[:, 0]).mean(axis=0)
        if angles is None or symmetry == 0:
            zero = -_template_angle(template, centroid, symmetry)
        else:
            # The circular mean of angles that repeat every 360 / symmetry.
            lag = np.deg2rad(np.rad2deg(poses[:, 0]) - angles[pressed])
            mean = np.exp(1j * lag * symmetry).mean()
            zero = float(np.rad2deg(np.angle(mean)) / symmetry)
        return template, symmetry, centroid, zero, inflation

    def _place(self, images: Floats, index: int) -> Floats:
        """(x, y, angle, sd of place, sd of angle) in taxels and degrees."""
        symmetry, template = int(self.symmetry_[index]), self.templates_[index]
        levels, outline = _prepare(images)
        empty = np.isnan(outline[:, 0])
        poses, _ = _register(levels, template, np.nan_to_num(outline), symmetry)
        variance = _pose_variances(levels, template, poses, symmetry)
        centroid = np.broadcast_to(self.centroids_[index], (len(poses), 2))
        place = poses[:, 1:] + _turn(centroid, poses[:, 0])
        offset = ((place - outline) ** 2).sum(axis=1)
        sd = np.sqrt(variance[:, 1] + variance[:, 2] + offset)
        angle, sd_deg = np.zeros(len(poses)), np.full(len(poses), np.inf)
        if symmetry:
            period, inflation = 360 / symmetry, self.inflation_[index]
            angle = (np.rad2deg(poses[:, 0]) - self.zeros_deg_[index]) % period
            angle[angle >= period] = 0.0  # where rounding reaches the period
            if np.isfinite(inflation):
                sd_deg = np.rad2deg(np.sqrt(variance[:, 0] * inflation))
                # As much as an angle drawn at random has.
                sd_deg[~(sd_deg < period / np.sqrt(12))] = np.inf
        rows = np.column_stack([place, angle, sd, sd_deg])
        rows[empty] = [0, 0, 0, np.inf, np.inf]
        return rows


def _prepare(images: Floats) -> tuple[Floats, Floats]:
    """Roots of pressures with unit energy, and the outlines' centroids (x, y).

    These are in taxels from the middle, NaN where nothing is pressed.
    """
    filled = fill_dead_taxels(images)
    root = np.sqrt(np.maximum(filled, 0))
    size = np.sqrt((root**2).sum(axis=(1, 2), keepdims=True))
    # Binary, by one threshold, which a background over all of it does not disturb.
    shape = tuple(n * _PIXELS_PER_TAXEL for n in images.shape[1:])
    enlarged = correct_gamma(resize(filled, (shape[0], shape[1])), _GAMMA)
    outlines = binarise(enlarged, n_partitions=1)
    count = outlines.sum(axis=(1, 2))
    count = np.where(count > 0, count, np.nan)
    y, x = ((np.arange(n) - (n - 1) / 2) / _PIXELS_PER_TAXEL for n in shape)
    by_col, by_row = outlines.sum(axis=1), outlines.sum(axis=2)
    centres = np.column_stack([by_col @ x / count, by_row @ y / count])
    return root / np.where(size > 0, size, 1.0), centres


def _turn(points: Floats, angles: Floats) -> Floats:
    cos, sin = np.cos(angles), np.sin(angles)
    x, y = points.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])


def _learn_template(images: Floats, centres: Floats, symmetry: int) -> _Pair:
    """Return a template (size, size) and poses (n, 3), from rough centres (x, y)."""
    first = np.array([[0.0, *centres[0]]])
    template = _symmetrise(_average(images[:1], first), symmetry)
    poses = first
    for _ in range(_N_ROUNDS):
        poses, _ = _register(images, template, centres, symmetry)
        template = _improve(images, poses, symmetry)
    return template, poses


def _find_symmetry(images: Floats, centres: Floats) -> int:
    """Return in how many turns the part looks the same, 0 for all.

    The highest symmetry that, imposed on a template of half the presses, fits the other
    half about as well as the best one.
    """
    halves = [np.arange(len(images)) % 2 == k for k in (0, 1)]
    learnt = [_learn_template(images[half], centres[half], 1) for half in halves]
    error = {}
    for symmetry in _SYMMETRIES:
        turned = [_symmetrise(template, symmetry) for template, _ in learnt]
        kept = [
            (mean**2).sum() / (template**2).sum()
            for mean, (template, _) in zip(turned, learnt, strict=True)
        ]
        if min(kept) < _LEAST_LIKENESS:
            continue
        error[symmetry] = 0.0
        for seen, template, (_, poses) in zip(halves, turned, learnt, strict=True):
            poses, _ = _refine(images[seen], template, poses, symmetry)
            template = _improve(images[seen], poses, symmetry)
            _, errors = _register(images[~seen], template, centres[~seen], symmetry)
            error[symmetry] += float(errors.sum())
    # The highest symmetry whose error on unseen presses is tolerable.
    grid = [error[s] for s in error if s in _OF_THE_GRID]
    finite = [error[s] for s in error if s and s not in _OF_THE_GRID]
    if 0 in error and finite:
        limit = min(_TOLERANCE_ROUND * min(finite), _TOLERANCE_GRID * min(grid))
        if error[0] <= limit:
            return 0
    best = min(value for s, value in error.items() if s)
    several = min((value for s, value in error.items() if s > 1), default=best)
    limit = min(_TOLERANCE * several, _TOLERANCE_NONE * best)
    return max((s for s in error if s and error[s] <= limit), default=1)


def _improve(images: Floats, poses: Floats, symmetry: int) -> Floats:
    """Return the template of presses at known poses: an average, sharpened twice."""
    template = _symmetrise(_average(images, poses), symmetry)
    for _ in range(2):
        drawn = _render(template, poses, images.shape[1:])
        plane = _plane(_solve_planes(images, drawn, poses)[0], poses, images.shape[1:])
        plane = np.maximum(plane, 0.3 * np.median(plane, axis=(1, 2), keepdims=True))
        rest = _pull(plane * (images - plane * drawn), poses).sum(axis=0)
        weight = _pull(plane**2, poses).sum(axis=0)
        rest /= np.maximum(weight, 1e-3 * weight.max())
        template = template + _symmetrise(rest, symmetry)
    return template


def _symmetrise(template: Floats, symmetry: int) -> Floats:
    """Return the mean of the template's copies in all turns that look the same."""
    n_copies = symmetry or _ROUND_COPIES
    if n_copies == 1:
        return template
    copies = np.repeat(template[np.newaxis], n_copies, axis=0)
    angles = np.arange(n_copies) * (360 / n_copies)
    return np.asarray(repose(copies, angles, interpolation="cubic").mean(axis=0))


def _template_angle(template: Floats, centroid: Floats, symmetry: int) -> float:
    """Direction in degrees in which the template reaches farthest, 0 for a disc."""
    if symmetry == 0:
        return 0.0
    half = (len(template) - 1) / 2
    grid = (np.arange(len(template)) - half) / _OVERSAMPLING
    u = (grid - centroid[0]) + 1j * (grid - centroid[1])[:, None]
    shape = template > template.max() / 2
    wave = np.abs(u) ** 2 * np.exp(1j * symmetry * np.angle(u))
    return float(np.rad2deg(np.angle(wave[shape].sum())) / symmetry)


def _average(images: Floats, poses: Floats) -> Floats:
    """Mean of the presses, turned back; places none has reached copy the nearest.

    Were they empty, a bar longer than the array would seem to end there.
    """
    weight = _pull(np.ones_like(images), poses).sum(axis=0)
    total = _pull(images, poses).sum(axis=0)
    reached = weight > 0.02 * len(images)
    nearest = distance_transform_edt(~reached, return_indices=True)[1]
    return np.asarray((total / np.maximum(weight, 1e-9))[tuple(nearest)])


def _pull(images: Floats, poses: Floats) -> Floats:
    """Turn images back onto the template, 0 where a press did not reach."""
    n_rows, n_cols = images.shape[1:]
    half = _OVERSAMPLING * max(n_rows, n_cols)
    v, u = np.mgrid[-half : half + 1, -half : half + 1] / _OVERSAMPLING
    cos, sin = np.cos(poses[:, 0])[:, None, None], np.sin(poses[:, 0])[:, None, None]
    row = sin * u + cos * v + poses[:, 2, None, None] + (n_rows - 1) / 2
    col = cos * u - sin * v + poses[:, 1, None, None] + (n_cols - 1) / 2
    return interpolate(images, np.stack([row, col]), "zero", "linear")


def _register(
    images: Floats, template: Floats, centres: Floats, symmetry: int
) -> _Pair:
    """Find poses (n, 3), from rough centres, and sums of squared residuals (n,)."""
    # The best of angles a few degrees apart, at the first guess of the place.
    n_angles = max(8, int(360 / _SEARCH_DEG / symmetry)) if symmetry else 1
    angles = np.arange(n_angles) * (2 * np.pi / max(symmetry, 1) / n_angles)
    poses = np.zeros((n_angles, len(images), 3))
    poses[:, :, 0], poses[:, :, 1:] = angles[:, None], centres
    residuals = _residuals_at(images, template, poses)
    best = (residuals**2).sum(axis=2).argmin(axis=0)
    return _refine(images, template, poses[best, np.arange(len(images))], symmetry)


def _refine(images: Floats, template: Floats, start: Floats, symmetry: int) -> _Pair:
    """Improve poses by damped Gauss-Newton steps; returns as `_register` does."""
    free = _free(symmetry)
    poses, damping = start.copy(), np.full((len(start), 1), 1e-3)
    residual = _residuals(images, template, poses)
    error = (residual**2).sum(axis=1)
    for done in range(1, _MOST_STEPS + 1):
        slopes = _slopes(images, template, poses, free)
        normal = slopes @ slopes.transpose(0, 2, 1)
        normal += _diagonal(damping * np.einsum("nii->ni", normal) + 1e-12)
        step = np.linalg.solve(normal, -slopes @ residual[:, :, None])[:, :, 0]
        trial = poses.copy()
        trial[:, free] += step.clip(-_LONGEST_STEP, _LONGEST_STEP)
        new = _residuals(images, template, trial)
        new_error = (new**2).sum(axis=1)
        better = new_error < error
        poses[better], residual[better] = trial[better], new[better]
        gain = (error - new_error)[better].sum()
        error = np.where(better, new_error, error)
        factor = np.where(better, 0.3, 10.0)[:, None]
        damping = (damping * factor).clip(1e-6, 1e6)
        if done >= _FEWEST_STEPS and gain < _SMALL_GAIN * error.sum():
            break
    return poses, error


def _pose_variances(
    images: Floats, template: Floats, poses: Floats, symmetry: int
) -> Floats:
    """Return the variances of angle, x and y, (n_touches, 3), infinite for a disc.

    A covariance that is robust to errors that hang together in blocks of 2 x 2 taxels;
    a ten-thousandth of a press's energy counts as noise in any case.
    """
    free = _free(symmetry)
    slopes = _slopes(images, template, poses, free)
    normal = slopes @ slopes.transpose(0, 2, 1)
    ridge = 1e-9 * normal.max(axis=(1, 2))[:, None] + 1e-12
    inverse = np.linalg.inv(normal + _diagonal(np.repeat(ridge, len(free), axis=1)))
    scores = slopes * _residuals(images, template, poses)[:, np.newaxis]
    # Taxels are summed over blocks; what follows them is kept as it is.
    shape = images.shape[1:]
    n, k, _ = scores.shape
    n_taxels = shape[0] * shape[1]
    taxels = scores[:, :, :n_taxels].reshape(n, k, *shape)
    padded = np.pad(taxels, ((0, 0), (0, 0), (0, shape[0] % 2), (0, shape[1] % 2)))
    rows, cols = padded.shape[2] // 2, padded.shape[3] // 2
    blocks = padded.reshape(n, k, rows, 2, cols, 2).sum(axis=(3, 5))
    rest = scores[:, :, n_taxels:]
    clustered = np.concatenate([blocks.reshape(n, k, -1), rest], axis=2)
    spread = inverse @ clustered @ clustered.transpose(0, 2, 1) @ inverse
    variances = np.full((len(poses), 3), np.inf)
    least = _LEAST_NOISE * (images**2).sum(axis=(1, 2)) / images[0].size
    spread += inverse * least[:, np.newaxis, np.newaxis]
    variances[:, free] = np.einsum("nii->ni", spread)
    return variances


def _render(template: Floats, poses: Floats, shape: tuple[int, ...]) -> Floats:
    """Draw the template at each pose, (n_poses, n_rows, n_cols)."""
    x, y = _offsets(poses, shape)
    cos, sin = np.cos(poses[:, 0])[:, None, None], np.sin(poses[:, 0])[:, None, None]
    where = np.stack([cos * y - sin * x, cos * x + sin * y])
    where = _OVERSAMPLING * where + (len(template) - 1) / 2
    return interpolate(template[np.newaxis], where, "zero", "cubic")


def _free(symmetry: int) -> Indices:
    """Return which of angle, x and y can be estimated."""
    return np.array([0, 1, 2] if symmetry else [1, 2])


def _slopes(images: Floats, template: Floats, poses: Floats, free: Indices) -> Floats:
    """Derivatives of the residuals, (n_touches, n_free, n_residuals)."""
    steps = np.diag(_DIFFERENCE)[free]
    ahead_and_behind = poses + np.concatenate([steps, -steps])[:, np.newaxis]
    residuals = _residuals_at(images, template, ahead_and_behind)
    ahead, behind = residuals[: len(free)], residuals[len(free) :]
    slopes: Floats = (ahead - behind) / (2 * _DIFFERENCE[free])[:, None, None]
    return slopes.transpose(1, 0, 2)


def _residuals_at(images: Floats, template: Floats, poses: Floats) -> Floats:
    """Residuals of every image at several poses each, (n_poses, n_touches, ...)."""
    n_poses, n_touches, _ = poses.shape
    many = np.tile(images, (n_poses, 1, 1))
    residuals = _residuals(many, template, poses.reshape(-1, 3))
    return residuals.reshape(n_poses, n_touches, -1)


def _residuals(images: Floats, template: Floats, poses: Floats) -> Floats:
    """Residuals of all taxels, then the penalties of the plane's two slopes."""
    drawn = _render(template, poses, images.shape[1:])
    weights, size = _solve_planes(images, drawn, poses)
    misfit = images - _plane(weights, poses, images.shape[1:]) * drawn
    penalty = np.sqrt(_PLANE_PRECISION * size)[:, None] * weights[:, 1:]
    return np.concatenate([misfit.reshape(len(images), -1), penalty], axis=1)


def _solve_planes(images: Floats, drawn: Floats, poses: Floats) -> _Pair:
    """Plane of each image by penalised least squares, and the template's square."""
    x, y = _offsets(poses, images.shape[1:])
    parts = np.stack([drawn, drawn * x / _PLANE_TAXELS, drawn * y / _PLANE_TAXELS])
    parts = parts.reshape(3, len(images), -1).transpose(1, 0, 2)
    normal = parts @ parts.transpose(0, 2, 1)
    size = normal[:, 0, 0].copy()
    precision = np.array([0, _PLANE_PRECISION, _PLANE_PRECISION])
    normal += _diagonal(precision * size[:, None] + 1e-9)
    target = parts @ images.reshape(len(images), -1, 1)
    return np.linalg.solve(normal, target)[:, :, 0], size


def _plane(weights: Floats, poses: Floats, shape: tuple[int, ...]) -> Floats:
    x, y = _offsets(poses, shape)
    level, along_x, along_y = weights.T[:, :, None, None]
    return np.asarray(level + (along_x * x + along_y * y) / _PLANE_TAXELS)


def _offsets(poses: Floats, shape: tuple[int, ...]) -> _Pair:
    """X and y of the taxels from each pose's origin, (n, 1, cols) and (n, rows, 1)."""
    rows = np.arange(shape[0]) - (shape[0] - 1) / 2
    cols = np.arange(shape[1]) - (shape[1] - 1) / 2
    x = cols[None, None, :] - poses[:, 1, None, None]
    y = rows[None, :, None] - poses[:, 2, None, None]
    return x, y


def _diagonal(values: Floats) -> Floats:
    return values[:, :, None] * np.eye(values.shape[1])
