"""Touches that cannot be trusted: nothing touched, levels at their limit, two things.

A touch that looks like the no-contact frame tells about the recording (exposure,
where the camera sat) and not about the object, so it is not used.
"""

from itertools import chain
from typing import Self

import cv2
import numpy as np
from sklearn.base import BaseEstimator

from .._numbers import correlation, evenly_spaced, otsu_thresholds
from .._types import LAYOUT, Array, Bools, Floats
from ..images import DomeCrop
from ..touches import Touches
from ._encoder import (
    BATCH,
    Encoder,
    TouchEncoder,
    find_geometry,
    grey,
    in_batches,
    living,
)
from ._evidence import NO_CONTACT

TURNED = "turned or shifted"

# Cameras: correlation with the no-contact frame, both cut about their rims. Of the
# recorded touches of 50 objects above it, most show no dent to the eye.
SAME = 0.985
# Arrays: size of the change, as a share of that of a middling training touch.
FAINT = 0.03
# Whole pictures: much of them never changes, so they must also be less unlike the
# no-contact frame than this share of what a middling training touch is.
QUIET = 0.25
# A label of which so many training touches show no contact consists of such touches.
CONSISTS = 0.5
# Share of taxels at a limit beyond that of nearly all training touches.
SATURATED = 0.05
SECOND_REGION = 0.25
# Share of left-out training touches that are no newer than what counts as turned.
REPOSED = 0.99
# Where more than this share of so many training touches are double, it is no sign.
RARE, LOOKED_AT = 0.2, 200
# Fewer taxels a side than this show no two things apart.
LEAST_SIDE = 8


class ContactCheck(BaseEstimator):
    """Tells touches without contact, saturated and double ones.

    Attributes
    ----------
    kind_ : {"camera", "array", "plane", ""}
        How contact is told; "" where there is nothing to tell it by.
    idle_ : ndarray of shape (n_rows, n_cols[, n_channels])
        What touching nothing looks like, cleaned up for a camera.
    typical_ : float
        Median size of the change in training touches (array), or of 1 - correlation
        with the no-contact frame (plane).
    limits_ : tuple of float
        Lowest and highest level a taxel can have; not finite where unknown.
    at_limit_ : float
        Share of taxels at a limit that 99 % of the training touches do not exceed.
    tells_double_ : bool
        Whether two regions are a sign: few of the training touches (array) have two.
    blind_ : ndarray of bool, shape (n_encodings,), or None
        Which encodings are blind to turns; None where it was not learnt.
    usual_ : ndarray of shape (2,) or None
        What 99 % of the training touches do not exceed in novelty to the encodings that
        are not blind, and to those that are; NaN where they do not tell it.
    pads_ : ndarray of shape (n_pads, 4) or None
        Boxes of the taxels that count (see `Touches`); None where all do.
    knows_rest_ : bool
        Whether sizes are of changes from a frame of no contact, so that touches may
        have another one; False in older model files.
    """

    knows_rest_: bool = False
    pads_: Array | None = None
    tells_double_: bool = True
    blind_: Bools | None = None
    usual_: Floats | None = None

    def fit(self, touches: Touches, encoder: Encoder) -> Self:
        """Learn from training touches and the encoder that was fitted to them."""
        frame, geometry = touches.no_contact, find_geometry(touches)
        if touches.pads is not None:
            self.pads_ = np.array(touches.pads)
        self.idle_ = np.zeros(touches.images.shape[1:])
        self.kind_, self.typical_ = "", 1.0
        if geometry == "dome":
            if frame is not None:
                whole = {n: a for n, a in touches.whole.items() if n in LAYOUT}
                idle = Touches(np.asarray(frame)[np.newaxis], **whole)
                self.idle_, self.kind_ = encoder.clean(idle)[0], "camera"
        elif frame is not None or geometry == "array":
            self.kind_ = "plane" if geometry == "plane" else "array"
            self.knows_rest_ = frame is not None
            if frame is not None:
                self.idle_ = living(np.asarray(frame)[np.newaxis], self.pads_)[0]
            measure = self._change if self.kind_ == "array" else self._unlikeness
            self.typical_ = float(np.median(measure(touches))) or 1.0
        low = high = np.nan  # of floats nobody knows them
        if touches.images.dtype.kind in "iu":
            info = np.iinfo(touches.images.dtype)
            low, high = float(info.min), float(info.max)
        # An array at rest is full of taxels at the lowest level.
        self.limits_ = (np.nan if self.kind_ == "array" else low, high)
        self.at_limit_ = float(np.quantile(self._share_at_limit(touches), 0.99))
        self.tells_double_ = False
        if geometry == "array" and min(self.idle_.shape[:2]) >= LEAST_SIDE:
            spread = evenly_spaced(len(touches), LOOKED_AT)
            self.tells_double_ = bool(self._double(touches[spread]).mean() < RARE)
        return self

    def no_contact(self, touches: Touches, cleaned: Array) -> Bools:
        """Return which touches look like touching nothing, shape (n_touches,).

        `cleaned` are the same touches after the encoder's clean-up.
        """
        if self.kind_ == "camera":
            return np.asarray(correlation(cleaned, self.idle_) > SAME)
        if self.kind_ == "array":
            return np.asarray(self._change(touches) < FAINT * self.typical_)
        if self.kind_ == "plane":
            unlike = self._unlikeness(touches)
            return np.asarray(unlike < min(1 - SAME, QUIET * self.typical_))
        return np.zeros(len(cleaned), dtype=bool)

    def learn_poses(self, encoder: TouchEncoder, left_out: Floats) -> None:
        """Learn how new left-out training touches (n_touches, n_encodings) are.

        To encodings that see turns, and to those that are blind to them: of ours these
        alone know a touch that is turned and shifted.
        """
        names = list(encoder.parts_)
        self.blind_ = np.array(["turns" in encoder.blind_to(name) for name in names])
        self.usual_ = np.array(
            [
                np.quantile(new, REPOSED) if np.isfinite(new).all() else np.nan
                for new in _by_sight(left_out, self.blind_)
            ]
        )

    def flags(
        self, touches: Touches, cleaned: Array, novelty: Floats | None = None
    ) -> list[str]:
        """Return what is wrong with each touch: "" or the reason in two words.

        "no contact", "saturated" (more taxels at the limit of the sensor than in
        training), "double contact" (two separate regions, on arrays; on pads, within
        the one that is pressed most), or "turned or shifted": known to the encodings
        that are blind to that, and new to the others. `novelty` (n_touches,
        n_encodings) is how much each encoding leaves unexplained.
        """
        nothing = self.no_contact(touches, cleaned)
        full = self._share_at_limit(touches) > self.at_limit_ + SATURATED
        double = turned = np.zeros(len(cleaned), dtype=bool)
        if self.tells_double_:
            double = self._double(touches)
        if novelty is not None and self.blind_ is not None and self.usual_ is not None:
            seeing, blind = _by_sight(novelty, self.blind_)
            turned = (seeing > self.usual_[0]) & (blind <= self.usual_[1])
        reasons = [NO_CONTACT, "saturated", TURNED, "double contact"]
        return list(map(str, np.select([nothing, full, turned, double], reasons, "")))

    def _double(self, touches: Touches) -> Bools:
        change = abs(self._difference(touches))
        on_pads = (
            _boxes(touch_change[np.newaxis], self.pads_)
            for touch_change in grey(change)
        )
        return np.array([_is_double(max(boxes, key=np.sum)[0]) for boxes in on_pads])

    def _change(self, touches: Touches) -> Floats:
        change = self._counted(self._difference(touches))
        return np.asarray(np.sqrt((change**2).mean(axis=tuple(range(1, change.ndim)))))

    def _difference(self, touches: Touches) -> Floats:
        # Whole numbers would go round.
        idle = self._rest(touches).astype(np.float64)
        return np.asarray(living(touches.images, self.pads_) - idle)

    def _unlikeness(self, touches: Touches) -> Floats:
        """Return 1 - correlation with the frame of no contact, shape (n_touches,)."""
        seen = self._counted(living(touches.images, self.pads_))
        return 1 - correlation(seen, self._counted(self._rest(touches)[np.newaxis]))

    def _rest(self, touches: Touches) -> Array:
        """Return what touching nothing looks like: the touches' own frame, or ours."""
        frame = touches.no_contact if self.knows_rest_ else None
        if frame is None or frame.shape != self.idle_.shape:
            return self.idle_
        return np.asarray(living(np.asarray(frame)[np.newaxis], self.pads_)[0])

    def _counted(self, images: Array) -> Array:
        """Return the taxels on pads, (n_touches, n_levels); without pads the images."""
        if self.pads_ is None:
            return images
        boxes = _boxes(images, self.pads_)
        return np.hstack([box.reshape(len(images), -1) for box in boxes])

    def _share_at_limit(self, touches: Touches) -> Floats:
        images = self._counted(touches.images)
        low, high = self.limits_
        if images.dtype.kind in "iu" and np.isfinite(self.limits_).all():
            # Compared as whole numbers: eight times faster than as floats.
            low, high = int(low), int(high)
        counts = np.empty(len(images))
        for number, image in enumerate(images):
            counts[number] = np.count_nonzero((image == low) | (image == high))
        return np.asarray(counts / images[0].size)


def _by_sight(novelty: Floats, blind: Bools) -> Floats:
    """Return novelty to encodings that see turns, and to the others.

    The mean of what they leave unexplained, NaN where none says it; (2, n_touches).
    """
    kinds, says = np.stack([~blind, blind]).astype(np.float64), ~np.isnan(novelty)
    count = kinds @ says.T
    total = kinds @ np.where(says, novelty, 0.0).T
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def encoded_and_flagged(
    encoder: Encoder, contact: ContactCheck, touches: Touches
) -> tuple[Floats, list[str]]:
    """Return features and flags of touches.

    Cleaned once for all; so many at a time that memory stays bounded.
    """
    if len(touches) > BATCH:
        each = [encoded_and_flagged(encoder, contact, s) for s in in_batches(touches)]
        parts, flags = zip(*each, strict=True)
        return np.concatenate(parts), [*chain.from_iterable(flags)]
    cleaned = encoder.clean(touches)
    features, novelty = encoder.encode_fully(cleaned)
    return features, contact.flags(touches, cleaned, novelty)


def no_contact_of(touches: Touches) -> Bools:
    """Return which touches show no contact, by themselves and their own frame of it.

    For those of an object that is being taught, before any model; (n_touches,).
    """
    dome = find_geometry(touches) == "dome"
    encoder = TouchEncoder(DomeCrop() if dome else None, {})
    cleaned = encoder.fit_clean(touches)
    return ContactCheck().fit(touches, encoder).no_contact(touches, cleaned)


def consists_of_nothing(labels: Array, no_contact: Array) -> bool:
    """Whether some label's touches mostly show no contact, such as "Nothing"."""
    codes, counts = np.unique(labels, return_inverse=True, return_counts=True)[1:]
    return bool((np.bincount(codes, no_contact) > CONSISTS * counts).any())


def _boxes(images: Array, pads: Array | None) -> list[Array]:
    """Return what images show on each pad; without pads the images alone."""
    if pads is None:
        return [images]
    return [images[:, r : r + h, c : c + w] for r, c, h, w in pads.tolist()]


def _is_double(change: Floats) -> bool:
    """Whether the change has a second region, apart from the largest."""
    if min(change.shape) < LEAST_SIDE or not change.any():
        return False
    inside = (change > otsu_thresholds(change.reshape(1, -1))).astype(np.uint8)
    areas = cv2.connectedComponentsWithStats(inside, connectivity=8)[2][1:, -1]
    areas = np.sort(areas)[::-1]
    return len(areas) > 1 and bool(areas[1] >= SECOND_REGION * areas[0])
