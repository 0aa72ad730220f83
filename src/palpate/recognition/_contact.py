"""Touches that cannot be trusted: nothing touched, levels at their limit, two things.

A touch that looks like the no-contact frame tells about the recording (exposure,
where the camera sat) and not about the object, so it is not used.
"""

from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator

from .._types import Array, Floats
from ..images import fill_dead_taxels, otsu_threshold
from ..touches import Touches
from ._encoder import TouchEncoder, find_geometry, in_batches

NO_CONTACT = "no contact"

# Cameras: correlation with the no-contact frame, both cut about their rims. Of the
# recorded touches of 50 objects above it, most show no dent to the eye.
SAME = 0.985
# Arrays: size of the change, as a share of that of a middling training touch.
FAINT = 0.03
# A label of which so many training touches show no contact consists of such touches.
CONSISTS = 0.5
# Share of taxels at a limit beyond that of nearly all training touches.
SATURATED = 0.05
SECOND_REGION = 0.25


class ContactCheck(BaseEstimator):
    """Tells touches without contact, saturated and double ones.

    Attributes
    ----------
    kind_ : {"camera", "array", ""}
        How contact is told; "" where there is nothing to tell it by.
    idle_ : ndarray of shape (n_rows, n_cols)
        What touching nothing looks like, cleaned up for a camera.
    typical_ : float
        Median size of the change in training touches (array).
    limits_ : tuple of float
        Lowest and highest level a taxel can have; not finite where unknown.
    at_limit_ : float
        Share of taxels at a limit that 99 % of the training touches do not exceed.
    """

    def fit(self, touches: Touches, encoder: TouchEncoder) -> Self:
        """Learn from training touches and the encoder that was fitted to them."""
        frame, geometry = touches.no_contact, find_geometry(touches)
        self.idle_ = np.zeros(touches.images.shape[1:])
        self.kind_, self.typical_ = "", 1.0
        if geometry in ("dome", "plane"):
            if frame is not None:
                idle = Touches(np.asarray(frame)[np.newaxis])
                self.idle_, self.kind_ = encoder.clean(idle)[0], "camera"
        elif frame is not None or geometry == "array":
            self.kind_ = "array"
            if frame is not None:
                self.idle_ = fill_dead_taxels(np.asarray(frame)[np.newaxis])[0]
            self.typical_ = float(np.median(self._change(touches))) or 1.0
        low, high = _limits(touches.images.dtype)
        # An array at rest is full of taxels at the lowest level.
        self.limits_ = (low if self.kind_ == "camera" else np.nan, high)
        self.at_limit_ = float(np.quantile(self._share_at_limit(touches), 0.99))
        return self

    def no_contact(self, touches: Touches, cleaned: Array) -> NDArray[np.bool_]:
        """Return which touches look like touching nothing, shape (n_touches,).

        `cleaned` are the same touches after the encoder's clean-up.
        """
        if self.kind_ == "camera":
            return np.asarray(_correlation(cleaned, self.idle_) > SAME)
        if self.kind_ == "array":
            return np.asarray(self._change(touches) < FAINT * self.typical_)
        return np.zeros(len(cleaned), dtype=bool)

    def flags(self, touches: Touches, cleaned: Array) -> list[str]:
        """Return what is wrong with each touch: "" or the reason in two words.

        "no contact", "saturated" (more taxels at the limit of the sensor than in
        training), or "double contact" (two separate regions, on arrays).
        """
        nothing = self.no_contact(touches, cleaned)
        full = self._share_at_limit(touches) > self.at_limit_ + SATURATED
        double = np.zeros(len(cleaned), dtype=bool)
        if self.kind_ == "array" and min(self.idle_.shape) >= 8:
            living = fill_dead_taxels(touches.images)
            double = np.array([_is_double(abs(i - self.idle_)) for i in living])
        reasons = np.select(
            [nothing, full, double], [NO_CONTACT, "saturated", "double contact"], ""
        )
        return [str(reason) for reason in reasons]

    def _change(self, touches: Touches) -> Floats:
        change = fill_dead_taxels(touches.images) - self.idle_
        size: Floats = np.sqrt((change**2).mean(axis=(1, 2)))
        return size

    def _share_at_limit(self, touches: Touches) -> Floats:
        images = touches.images
        low, high = self.limits_
        if images.dtype.kind in "iu" and np.isfinite(self.limits_).all():
            # Compared as whole numbers: eight times faster than as floats.
            low, high = int(low), int(high)
        counts = [
            np.count_nonzero(image == low) + np.count_nonzero(image == high)
            for image in images
        ]
        shares: Floats = np.array(counts) / images[0].size
        return shares


def encoded_and_flagged(
    encoder: TouchEncoder, contact: ContactCheck, touches: Touches
) -> tuple[Floats, Floats, list[str]]:
    """Return features, `unexplained` and flags of touches.

    Cleaned once for all; so many at a time that memory stays bounded.
    """
    parts: list[tuple[Floats, Floats]] = []
    flags: list[str] = []
    for some in in_batches(touches):
        cleaned = encoder.clean(some)
        parts.append(encoder.encode_fully(cleaned))
        flags += contact.flags(some, cleaned)
    features, unexplained = zip(*parts, strict=True)
    return np.concatenate(features), np.concatenate(unexplained), flags


def consists_of_nothing(labels: Array, no_contact: Array) -> bool:
    """Whether some label's touches mostly show no contact, such as "Nothing"."""
    return any(no_contact[labels == n].mean() > CONSISTS for n in np.unique(labels))


def _limits(dtype: Any) -> tuple[float, float]:
    """Return the limits of a level; of floats nobody knows them."""
    if np.dtype(dtype).kind in "iu":
        info = np.iinfo(dtype)
        return float(info.min), float(info.max)
    return float("nan"), float("nan")


def _correlation(images: Array, idle: Array) -> Floats:
    flat = images.reshape(len(images), -1).astype(np.float64)
    one = idle.ravel().astype(np.float64)
    flat = flat - flat.mean(axis=1, keepdims=True)
    one = one - one.mean()
    norms = np.linalg.norm(flat, axis=1) * np.linalg.norm(one)
    result: Floats = flat @ one / np.where(norms > 0, norms, 1)
    return result


def _is_double(change: Floats) -> bool:
    """Whether the change has a second region, apart from the largest."""
    if not change.any():
        return False
    inside = (change > otsu_threshold(change[np.newaxis])[0]).astype(np.uint8)
    areas = cv2.connectedComponentsWithStats(inside, connectivity=8)[2][1:, -1]
    areas = np.sort(areas)[::-1]
    return len(areas) > 1 and bool(areas[1] >= SECOND_REGION * areas[0])
