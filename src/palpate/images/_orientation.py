"""The direction in which an image is elongated, and images turned to one direction.

An angle is in degrees from the columns towards the rows: clockwise as displayed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_images, check_number
from .._image_estimator import ImageEstimator
from .._types import Array, Floats
from ._central_moments import above_least, central_moments, inscribed_mask
from ._repose import repose

MIN_ANISOTROPY = 0.02
# Rounding of the second moments, as a share of their sum.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Orientations:
    """Direction of the long axis, -180 to 180, and anisotropy of images, (n_touches,).

    The long tail points to `angle_deg`; the anisotropy (a - b) / (a + b) of the largest
    and least second moments is 1 for a line, 0 for what looks alike at right angles.
    """

    angle_deg: Floats
    anisotropy: Floats


class OrientationRegulariser(ImageEstimator):
    """Turn each image so that its long axis lies along the columns.

    Encodings that depend on the angle of the sensor (pixels, their principal
    components) then no longer do, as far as the direction can be told.

    Parameters
    ----------
    min_anisotropy : float, default=0.02
        Images less elongated than this have no direction but noise: they stay.

    Notes
    -----
    Images are turned about the middle of the frame, linearly interpolated; only the
    inscribed disc is looked at and kept. See `orientations` for the angle.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.images import OrientationRegulariser
    >>> bar = np.zeros((1, 5, 5))
    >>> bar[0, 1:4, 2] = 1
    >>> OrientationRegulariser().fit_transform(bar)[0, 2].round(6)
    array([0., 1., 1., 1., 0.])
    """

    def __init__(self, min_anisotropy: float = MIN_ANISOTROPY) -> None:
        self.min_anisotropy = min_anisotropy

    def _learn(self, images: Array) -> None:
        check_number("min_anisotropy", self.min_anisotropy, low=0, high=1)

    def transform_checked(self, images: Array) -> Floats:
        """Return the turned images, shape (n_touches, n_rows, n_cols)."""
        found = orientations(images)
        angle = np.where(found.anisotropy >= self.min_anisotropy, found.angle_deg, 0.0)
        turned = repose(images, -angle, edges="nearest")
        turned *= inscribed_mask(*images.shape[1:])
        return turned


def orientations(images: ArrayLike) -> Orientations:
    """Return direction and anisotropy of each image, from its central moments.

    Levels count from the least one in the inscribed disc. The third moment along the
    axis of the second ones tells its ends apart. Without a direction, both are 0.
    """
    checked = check_images(images)
    mask = inscribed_mask(*checked.shape[1:])
    moments = central_moments(above_least(checked, mask))
    mu = moments.mu
    both = mu[:, 0, 2] + mu[:, 2, 0]
    difference, mixed = mu[:, 0, 2] - mu[:, 2, 0], 2 * mu[:, 1, 1]
    size = np.hypot(difference, mixed)
    flat = size <= _ROUNDING * both
    angle = np.where(flat, 0.0, np.arctan2(mixed, difference) / 2)
    cos, sin = np.cos(angle), np.sin(angle)
    along = cos**3 * mu[:, 0, 3] + 3 * cos**2 * sin * mu[:, 1, 2]
    along += 3 * cos * sin**2 * mu[:, 2, 1] + sin**3 * mu[:, 3, 0]
    backwards = ~flat & (along < 0)
    degrees = np.rad2deg(angle)
    opposite = np.where(degrees > 0, degrees - 180, degrees + 180)
    degrees = np.where(backwards, opposite, degrees)
    share = np.where(flat, 0.0, size / np.where(both > 0, both, 1.0))
    return Orientations(degrees, share)
