"""Place and angle of parts from presses, after learning the parts.

A robot that assembles a part needs its place and angle. `PressPose` builds a template
of each part from presses in unknown poses, finds out how symmetric it is, and registers
new presses on it.

Positions are in mm from the middle of the array, x along columns and y along rows
(downwards); angles turn x towards y, clockwise as displayed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
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
from . import _pose_template
from ._array import binarise, correct_gamma, fill_dead_taxels, resize
from ._orientation import per_touch
from ._pose_template import find_symmetry, learn_template, pose_variances, register

_PIXELS_PER_TAXEL, _GAMMA = 3, 0.8  # of the outline that registration starts from
# With fewer presses no half can teach a template, and symmetry cannot be tested.
_LEAST_FOR_SYMMETRY = 6
# A template of n presses makes the angle's variance 1 + 3 / n times what registration
# alone would have: its own angle is only as good as theirs, and it bears their noise.
# Measured on simulated parts; the tests use another draw.
_OF_TEMPLATE = 3.0


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
            symmetry = find_symmetry(levels, outline)
        else:
            symmetry, inflation = 1, np.inf
        template, poses = learn_template(levels, outline, symmetry)
        centroid = np.zeros(2)
        if symmetry == 1:
            centroid = _turn(outline - poses[:, 1:], -poses[:, 0]).mean(axis=0)
        if angles is None or symmetry == 0:
            zero = -_pose_template.template_angle(template, centroid, symmetry)
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
        poses, _ = register(levels, template, np.nan_to_num(outline), symmetry)
        variance = pose_variances(levels, template, poses, symmetry)
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
