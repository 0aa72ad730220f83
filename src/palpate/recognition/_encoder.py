"""Touches -> features: one clean-up, then one encoding or several side by side."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from math import prod
from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator, clone
from sklearn.preprocessing import StandardScaler

from .._checks import ARRAY_SIDE, check_levels, size_text
from .._image_estimator import ImageEstimator
from .._numbers import evenly_spaced
from .._types import Array, Bools, Floats
from ..encodings import EncodingUnion, PrincipalShare, RingPatterns
from ..images import ChannelMean, DomeCrop, fill_dead_taxels, typical_rim
from ..touches import Touches
from ._sessions import looks
from ._user_parts import UserEncoding

# So many touches pass through all steps at a time, so that memory stays bounded.
BATCH = 256
# With fewer on a side they may be electrodes, each with a level and a range of its own.
FEW_TAXELS = 8
# Touches that are looked at for a rim; see `find_geometry`.
LOOK_AT = 50
# A taxel that moved at least every other time and is still in so many touches is
# stuck: one time in 500 by chance.
STUCK_TOUCHES = 10
# Learning and encoding at once, they do nothing twice.
_ENCODE_AS_THEY_LEARN = EncodingUnion, RingPatterns, UserEncoding
_TAKES_CHECKED = ImageEstimator, PrincipalShare
grey = ChannelMean().transform_checked  # of images that were checked


class Encoder(ABC):
    """What makes features of touches: learnt, or as learnt in another session."""

    @abstractmethod
    def clean(self, touches: Touches) -> Array:
        """Return the images after the clean-up alone."""

    @abstractmethod
    def encode_fully(self, cleaned: Array) -> tuple[Floats, Floats]:
        """Return features, and how much of each touch principal components leave out.

        The latter (n_touches, n_encodings) in units of the training touches' variance;
        NaN where no step of an encoding says it.
        """

    @abstractmethod
    def look(self, touches: Touches) -> Floats:
        """Return what tells of light, rubber and gain, (n_touches, 7); see `looks`."""

    def transform(self, touches: Touches) -> Floats:
        """Return the features, shape (n_touches, n_features)."""
        cleaned = (self.clean(batch) for batch in in_batches(touches))
        return np.concatenate([self.encode_fully(batch)[0] for batch in cleaned])


class TouchEncoder(Encoder, BaseEstimator):
    """A clean-up of the images, then one encoding or several side by side.

    Taxels outside the pads of a hand count as 0, and dead taxels (NaN) are filled from
    their neighbours, before anything else.

    Parameters
    ----------
    clean_up : transformer of images or None
        Image -> cleaner image, such as `DomeCrop`; None leaves images alone. Its `fit`
        takes the frame of no contact as `no_contact`.
    encodings : mapping of str to sequence of transformers
        Of each the first step takes images, the others feature vectors.
    channels : bool, default=False
        Whether the clean-up cleans channels one by one (`DomeCrop.by_channel`); else
        their mean.
    as_changes : bool, default=False
        Whether images that are not cleaned up are less the frame of no contact, of
        theirs where they have one: of an array whose taxels rest at levels of their
        own.

    Attributes
    ----------
    clean_up_ : fitted copy
        The clean-up as learnt.
    encodings_ : dict of str to list of fitted steps
        The encodings as learnt.
    parts_ : dict of str to int
        Number of features of each encoding, in the order of the features.
    scales_ : dict of str to float
        What the features of each encoding are multiplied by: side by side all have
        total variance 1; one alone is as it is.
    image_shape_ : tuple of int
        (n_rows, n_cols) or (n_rows, n_cols, n_channels) of the touches it learnt.
    pads_ : ndarray of shape (n_pads, 4) or None
        Where the touches' pads lie.
    channels_ : tuple of str or None
        What the touches' channels are called.
    baseline_ : ndarray of the shape of a touch, or None
        The frame of no contact, where images are looked at as they are.
    rest_ : ndarray of shape (n_rows, n_cols), or None
        The frame of no contact in grey, where images are cleaned up.
    with_rest_ : bool
        Whether there was one; True in older model files, which do not tell.
    still_ : ndarray of the shape of a touch, or None
        The level of each taxel in half of the training touches, where images are
        looked at as they are; NaN where it changes from touch to touch of every object.
    reach_ : float
        How far the levels of training touches are apart.
    """

    image_shape_: tuple[int, ...]
    baseline_: Array | None = None
    rest_: Array | None = None
    with_rest_: bool = True
    still_: Array | None = None
    reach_: float = 0.0

    def __init__(
        self,
        clean_up: Any,
        encodings: Mapping[str, Sequence[Any]],
        channels: bool = False,
        as_changes: bool = False,
    ) -> None:
        self.clean_up, self.encodings = clean_up, encodings
        self.channels, self.as_changes = channels, as_changes

    def fit_clean(self, touches: Touches) -> Array:
        """Learn the clean-up and return the cleaned images."""
        self.image_shape_ = touches.images.shape[1:]
        self.pads_, self.channels_ = touches.pads, touches.channels
        self.clean_up_ = self.baseline_ = self.rest_ = self.still_ = None
        self.with_rest_ = touches.no_contact is not None
        if self.clean_up is None:
            self.still_ = _still(touches)
            self.reach_ = float(np.nanmax(touches.images)) - np.nanmin(touches.images)
            if touches.no_contact is not None:
                self.baseline_ = self.living(touches.no_contact[np.newaxis])[0]
        if self.clean_up is not None:
            images, idle = self.living(touches.images), self._idle(touches)
            self.rest_ = idle
            self.clean_up_ = clone(self.clean_up)
            if isinstance(self.clean_up_, DomeCrop) and not (
                self.channels and images.ndim == 4
            ):
                return self.clean_up_.fit_transform(grey(images), no_contact=idle)
            self.clean_up_.fit(grey(images), no_contact=idle)
        return self.clean(touches)

    def fit_encode(
        self,
        cleaned: Array,
        groups: Array | None = None,
        learnt_steps: dict[str, list[tuple[Any, Array]]] | None = None,
    ) -> tuple[Floats, Floats]:
        """Learn the encodings of cleaned images; return features and `unexplained`.

        What is unexplained (n_touches, n_encodings) is so with the touches of the same
        group left out of the components (NaN without groups): new touches are never as
        close to them as those they were learnt from. Steps that `learnt_steps` holds by
        the encoding's name, and what they make of these images, are not learnt again.
        """
        learnt_steps = {} if learnt_steps is None else learnt_steps
        self.encodings_, self.parts_, self.scales_ = {}, {}, {}
        parts, unexplained = [], np.full((len(cleaned), len(self.encodings)), np.nan)
        for column, (name, steps) in enumerate(self.encodings.items()):
            values, done = cleaned, learnt_steps.setdefault(name, [])
            for number, recipe in enumerate(steps):
                step = clone(recipe)
                if hasattr(step, "left_out_unexplained") and groups is not None:
                    unexplained[:, column] = step.left_out_unexplained(values, groups)
                if number == len(done):
                    # Of touches that are all alike shares of the variance are 0 / 0.
                    with np.errstate(invalid="ignore"):
                        if isinstance(step, _ENCODE_AS_THEY_LEARN):
                            after = step.fit_transform(values)
                        else:
                            step.fit(values)
                            after = _transformed(step, values)
                    done.append((step, after))
                values = done[number][1]
            self.encodings_[name] = [step for step, _ in done]
            part = np.asarray(values, dtype=np.float64)
            self.parts_[name], self.scales_[name] = part.shape[1], 1.0
            if len(self.encodings) > 1:
                spread = float(part.var(axis=0).sum())
                self.scales_[name] = spread**-0.5 if spread > 0 else 1.0
            parts.append(part)
        return self._side_by_side(parts), unexplained

    def only(self, names: Iterable[str]) -> Self:
        """Return this with some of its encodings, of which none is learnt."""
        other = copy(self)
        other.encodings = {name: self.encodings[name] for name in names}
        return other

    def clean(self, touches: Touches) -> Array:
        """Return the images after the clean-up alone; other sizes are refused."""
        images, idle = touches.images, touches.no_contact
        self.check_size(images, touches.channels, touches.pads)
        if not self.as_changes or idle is None or self.baseline_ is None:
            return self.cleaned(self.living(images))
        return _changes(self.living(images), self.living(idle[np.newaxis]))

    def check_size(
        self,
        images: Array,
        channels: tuple[str, ...] | None = None,
        pads: Array | None = None,
    ) -> None:
        """Refuse images of another size than those that were learnt.

        And `pads` that lie elsewhere in them.
        """
        self.check_channels(images, channels)
        taught, got = tuple(self.image_shape_), images.shape[1:]
        if got != taught:
            fix = "Use the same sensor and resolution, or learn again."
            if prod(got) == prod(taught):
                fix = (
                    "Turn pictures that lie on their side by 90 degrees; of a table or "
                    "bare frames say `shape` as when it was learnt."
                )
            raise ValueError(
                f"touches must have {size_text(taught)} like the training touches, got "
                f"{size_text(got)}. {fix}"
            )
        if pads is None or self.pads_ is None:
            return
        learnt, seen = sorted(self.pads_.tolist()), sorted(pads.tolist())
        if seen != learnt:
            raise ValueError(
                f"pads must be {learnt} like those of the training touches, got {seen}."
                " Bring the arrays to these places, or learn again."
            )

    def check_channels(self, images: Array, channels: tuple[str, ...] | None) -> None:
        """Refuse images in colour where grey ones were learnt, and the reverse.

        And the same `channels` in another order.
        """
        taught, got = tuple(self.image_shape_)[2:], images.shape[3:]
        if got == taught:
            names, seen_names = tuple(self.channels_ or ()), tuple(channels or ())
            if seen_names != names and sorted(seen_names) == sorted(names):
                raise ValueError(
                    f"channels must be {', '.join(names)} like those of the training "
                    f"touches, got {', '.join(seen_names)}. Bring them to this order."
                )
            return
        learnt = "one level" if self.channels_ is None else ", ".join(self.channels_)
        seen = f"{got[0]} numbers" if got else "one level"
        fix = "Use the same sensor"
        if "one level" in (learnt, seen):
            fix = "Read pictures with `colour`" if taught else "Leave `colour` out"
        raise ValueError(
            f"touches must have {learnt} a pixel like the training touches, got "
            f"{seen}. {fix}, or learn again."
        )

    def cleaned(self, images: Array) -> Array:
        """Return images that `living` has checked, after the clean-up."""
        if self.clean_up_ is None:
            if self.as_changes and self.baseline_ is not None:
                images = _changes(images, self.baseline_)
            return images
        if self.channels and images.ndim == 4:
            batches = in_batches(images)
            return np.concatenate([self.clean_up_.by_channel(s) for s in batches])
        return _transformed(self.clean_up_, grey(images))

    def encode_fully(self, cleaned: Array) -> tuple[Floats, Floats]:
        """Return features and what components leave out; see `Encoder`."""
        parts, unexplained = [], np.full((len(cleaned), len(self.encodings_)), np.nan)
        # Without a clean-up nothing but the first step has checked the images.
        checked = isinstance(self.clean_up_, ImageEstimator)
        for column, steps in enumerate(self.encodings_.values()):
            values = cleaned
            for number, step in enumerate(steps):
                before = values
                values = _transformed(step, before, checked=checked or number > 0)
                if isinstance(step, PrincipalShare):
                    unexplained[:, column] = step.unexplained(before, values)
            parts.append(np.asarray(values, dtype=np.float64))
        return self._side_by_side(parts), unexplained

    def look(self, touches: Touches, broken: Bools | None = None) -> Floats:
        """Return what tells of light, rubber and gain, `broken` taxels filled.

        Of an encoder of changes that of the changes: levels of rest are no matter.
        """
        if len(touches) > BATCH:
            parts = [self.look(batch, broken) for batch in in_batches(touches)]
            return np.concatenate(parts)
        if self.as_changes and (level := self.baseline_) is not None:
            if touches.no_contact is not None:
                level = self.living(touches.no_contact[np.newaxis], broken)[0]
            images = self.living(touches.images, broken)
            return looks(grey(_changes(images, level)), None)
        rest = self._idle(touches, broken)
        if not self.with_rest_ or (self.clean_up_ is None and self.baseline_ is None):
            rest = None  # as in what it learnt
        elif rest is None and self.baseline_ is not None:
            rest = grey(self.baseline_[np.newaxis])[0]
        elif rest is None:
            rest = self.rest_
        if rest is not None and rest.shape != touches.images.shape[1:3]:
            rest = None
        return looks(grey(self.living(touches.images, broken)), rest)

    def blank_touch(self) -> Touches:
        """Return one touch of zeros such as it learnt."""
        return Touches(
            np.zeros((1, *self.image_shape_)), channels=self.channels_, pads=self.pads_
        )

    def blind_to(self, name: str) -> frozenset[str]:
        """Return what an encoding does not change under: "shifts", "turns", "gain"."""
        steps = self.encodings[name]
        return frozenset().union(*(getattr(s, "blind_to", ()) for s in steps))

    def before_another_camera(self, touches: Touches) -> Self:
        """Return this encoder with its clean-up where other touches show the sensor."""
        other = copy(self)
        other.image_shape_ = touches.images.shape[1:]
        if self.clean_up_ is not None:
            images, idle = grey(self.living(touches.images)), self._idle(touches)
            other.clean_up_ = self.clean_up_.moved(images, idle)
            if idle is not None:
                other.rest_ = idle.copy()
            elif other.image_shape_ != tuple(self.image_shape_):
                other.with_rest_ = False  # there is none of that size
        return other

    def stuck(self, touches: Touches) -> Bools | None:
        """Return which taxels have broken since it was learnt, None where none has.

        They have one level in all touches, and not the one that they rest at.
        """
        if self.still_ is None or len(touches) < STUCK_TOUCHES:
            return None
        first = touches.images[0]
        usual = np.abs(first - self.still_) <= self.reach_ / 2
        broken = (touches.images == first).all(axis=0) & ~usual
        return np.asarray(broken) if broken.any() and not broken.all() else None

    def _side_by_side(self, parts: list[Floats]) -> Floats:
        features = parts[0]
        if len(parts) > 1:
            features = np.hstack([*map(np.multiply, parts, self.scales_.values())])
        return features

    def living(self, images: Array, broken: Bools | None = None) -> Array:
        """Return images without NaN, checked: 0 outside pads, dead taxels filled.

        Those that are `broken` (n_rows, n_cols) are filled too.
        """
        if broken is not None:
            images = np.where(broken, np.nan, images)
        elif images.dtype.kind != "f":
            return images
        return check_levels(living(images, self.pads_))

    def _idle(self, touches: Touches, broken: Bools | None = None) -> Array | None:
        """Return the frame of no contact without dead taxels, None where none is."""
        frame = touches.no_contact
        if frame is None:
            return None
        return np.asarray(grey(self.living(frame[np.newaxis], broken))[0])


def _still(touches: Touches) -> Array:
    """Return the median level of each taxel, NaN where it is never still.

    It is where some object's touches have one level more than half of the time.
    """
    still = np.zeros(touches.images.shape[1:], dtype=bool)
    objects = np.zeros(len(touches)) if touches.object is None else touches.object
    for name in np.unique(objects):
        images = touches.images[objects == name]
        still |= (images == np.median(images, axis=0)).mean(axis=0) > 0.5
    return np.where(still, np.median(touches.images, axis=0), np.nan)


def find_geometry(touches: Touches) -> str:
    """Return "dome", "array", "plane" or "none" for a set of touches.

    What `touches` say of themselves holds; else a single row or column means that
    places mean nothing ("none"), a rim that most of 50 touches spread over the set have
    in common a "dome", pads, at most 48 taxels along both sides or fewer than 8 along
    one an "array", and anything else a "plane".
    """
    if touches.geometry is not None:
        return touches.geometry
    n_rows, n_cols = touches.images.shape[1:3]
    if min(n_rows, n_cols) == 1:
        return "none"
    spread = evenly_spaced(len(touches), LOOK_AT)
    pictures = np.nan_to_num(grey(touches.images[spread]))
    if min(n_rows, n_cols) > ARRAY_SIDE and typical_rim(pictures) is not None:
        return "dome"
    is_small = max(n_rows, n_cols) <= ARRAY_SIDE or min(n_rows, n_cols) < FEW_TAXELS
    return "array" if is_small or touches.pads is not None else "plane"


def living(images: Array, pads: Array | None = None) -> Array:
    """Return images without NaN: 0 outside the pads, dead taxels filled."""
    if images.dtype.kind != "f" or not np.isnan(images).any():
        return images
    if pads is not None:
        gaps = np.ones(images.shape[1:], dtype=bool)
        for row, col, n_rows, n_cols in pads:
            gaps[row : row + n_rows, col : col + n_cols] = False
        images = np.where(gaps, 0, images)
    return fill_dead_taxels(images)


def _changes(images: Array, level: Array) -> Array:
    """Return images less a level; whole numbers stay such, which takes less memory."""
    kind = np.result_type(images.dtype, level.dtype)
    if kind.kind in "biu":  # twice as wide holds every difference, and its sign
        kind = np.dtype(f"i{min(2 * kind.itemsize, 8)}")
    return np.subtract(images, level, dtype=kind)


def in_batches(values: Any) -> Iterator[Any]:
    """Yield so many touches, images or vectors at a time that memory stays bounded."""
    if len(values) <= BATCH:
        yield values
        return
    for start in range(0, len(values), BATCH):
        yield values[start : start + BATCH]


def _transformed(step: Any, values: Array, *, checked: bool = True) -> Array:
    """Return what a step makes of values, which it does not check again if `checked`.

    A scaler never does: its own checks take as long as an encoding does.
    """
    if isinstance(step, StandardScaler):
        return np.asarray((values - step.mean_) / step.scale_)
    takes_checked = checked and isinstance(step, _TAKES_CHECKED)
    transform = step.transform_checked if takes_checked else step.transform
    if len(values) <= BATCH:
        return np.asarray(transform(values))
    return np.concatenate([transform(batch) for batch in in_batches(values)])
