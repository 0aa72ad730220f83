"""Touches -> features: one clean-up and a chain of encodings, learnt together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import deepcopy
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from sklearn.base import BaseEstimator, clone

from .._image_estimator import ImageEstimator
from .._types import Array, Floats
from ..images import fill_dead_taxels, typical_rim
from ..touches import Touches

# So many touches pass through all steps at a time, so that memory stays bounded.
BATCH = 256
# Geometry of a sensor that says nothing of itself; see `find_geometry`.
SMALL_SIDE = 8
ARRAY_SIDE = 48
LOOK_AT = 50


@runtime_checkable
class LeavesOut(Protocol):
    """A step that can say how much of a touch it leaves unexplained."""

    def unexplained(self, X: Floats, scores: Floats) -> Floats:
        """Return it for touches `X` and what `transform` made of them."""
        ...

    def left_out_unexplained(self, X: Floats, groups: Array) -> Floats:
        """Return it for training touches, their groups left out."""
        ...


class TouchEncoder(BaseEstimator):
    """A clean-up of the images, then encoders one after the other.

    Dead taxels (NaN) are filled from their neighbours before anything else.

    Parameters
    ----------
    clean_up : transformer of images or None
        Image -> cleaner image, such as `DomeCrop`; None leaves images alone. Its `fit`
        takes the frame of no contact as `no_contact`.
    steps : sequence of transformers
        The first takes images, the others feature vectors.

    Attributes
    ----------
    clean_up_, steps_ : fitted copies
        What `fit` learnt.
    image_shape_ : tuple of int
        (n_rows, n_cols) of the touches seen by `fit`.
    """

    image_shape_: tuple[int, int]

    def __init__(self, clean_up: Any, steps: Sequence[Any]) -> None:
        self.clean_up = clean_up
        self.steps = steps

    def fit(self, touches: Touches) -> Self:
        """Learn every step from `touches`."""
        self.fit_transform(touches)
        return self

    def fit_transform(self, touches: Touches) -> Floats:
        """Learn every step and return the features, (n_touches, n_features)."""
        return self.fit_encode(self.fit_clean(touches))[0]

    def fit_clean(self, touches: Touches) -> Array:
        """Learn the clean-up and return the cleaned images."""
        self.image_shape_ = touches.images.shape[1:]
        self.clean_up_ = None
        if self.clean_up is not None:
            self.clean_up_ = clone(self.clean_up).fit(
                _living(touches.images), no_contact=_idle(touches)
            )
        return self.clean(touches)

    def fit_encode(
        self, cleaned: Array, groups: Array | None = None
    ) -> tuple[Floats, Floats]:
        """Learn the encodings of cleaned images; return features and `unexplained`.

        What is unexplained is so with the touches of the same group left out of the
        components (NaN without groups): new touches are never as close to them as
        those they were learnt from.
        """
        self.steps_ = [clone(step) for step in self.steps]
        values, left = cleaned, np.full(len(cleaned), np.nan)
        for step in self.steps_:
            if isinstance(step, LeavesOut) and groups is not None:
                left = step.left_out_unexplained(values, groups)
            values = _transformed(step.fit(values), values, checked=True)
        return np.asarray(values, dtype=np.float64), left

    def clean(self, touches: Touches) -> Array:
        """Return the images after the clean-up alone."""
        images = touches.images
        if images.shape[1:] != tuple(self.image_shape_):
            known, got = self.image_shape_, images.shape[1:]
            raise ValueError(
                f"touches must have {known[0]} x {known[1]} taxels like the training "
                f"touches, got {got[0]} x {got[1]}. Use the same sensor and "
                "resolution, or learn again."
            )
        cleaned = _living(images)
        if self.clean_up_ is not None:
            cleaned = _transformed(self.clean_up_, cleaned)
        return cleaned

    def encode(self, cleaned: Array) -> Floats:
        """Return the features of images that were cleaned already."""
        return self.encode_fully(cleaned)[0]

    def encode_fully(self, cleaned: Array) -> tuple[Floats, Floats]:
        """Return features, and how much of each touch principal components leave out.

        The latter (n_touches,) in units of the training touches' variance; NaN where
        no step says it.
        """
        values, left = cleaned, np.full(len(cleaned), np.nan)
        # Without a clean-up nothing but the first step has checked the images.
        checked = isinstance(self.clean_up_, ImageEstimator)
        for step in self.steps_:
            before, values = values, _transformed(step, values, checked=checked)
            if isinstance(step, LeavesOut):
                left = step.unexplained(before, values)
        return np.asarray(values, dtype=np.float64), left

    def transform(self, touches: Touches) -> Floats:
        """Return the features, shape (n_touches, n_features)."""
        return np.concatenate(
            [self.encode(self.clean(some)) for some in in_batches(touches)]
        )

    def moved(self, touches: Touches) -> Self:
        """Return this encoder for images of another camera before the same sensor."""
        other = deepcopy(self)
        other.image_shape_ = touches.images.shape[1:]
        if self.clean_up_ is not None:
            images = _living(touches.images)
            other.clean_up_ = self.clean_up_.moved(images, _idle(touches))
        return other


def find_geometry(touches: Touches) -> str:
    """Return "dome", "array", "plane" or "none" for a set of touches.

    What the touches say of themselves holds; else a side below 8 taxels means
    that places mean nothing ("none"), a rim that most of 50 touches spread over the
    set have in common a "dome", a side of at most 48 taxels an "array", and anything
    else a "plane".
    """
    n_rows, n_cols = touches.images.shape[1:]
    if touches.geometry == "none" or min(n_rows, n_cols) < SMALL_SIDE:
        return "none"
    if touches.geometry is not None:
        return touches.geometry
    spread = np.unique(np.linspace(0, len(touches) - 1, LOOK_AT).astype(int))
    some = np.nan_to_num(touches.images[spread])
    if min(n_rows, n_cols) > ARRAY_SIDE and typical_rim(some) is not None:
        return "dome"
    return "array" if max(n_rows, n_cols) <= ARRAY_SIDE else "plane"


def _idle(touches: Touches) -> Array | None:
    """Return the frame of no contact without dead taxels, None where there is none."""
    frame = touches.no_contact
    return None if frame is None else _living(frame[np.newaxis])[0]


def _living(images: Array) -> Array:
    dead = images.dtype.kind == "f" and np.isnan(images).any()
    return fill_dead_taxels(images) if dead else images


def in_batches(values: Any) -> Iterator[Any]:
    """Yield so many touches, images or vectors at a time that memory stays bounded."""
    if len(values) <= BATCH:
        yield values
        return
    for start in range(0, len(values), BATCH):
        yield values[start : start + BATCH]


def _transformed(step: Any, values: Array, *, checked: bool = False) -> Array:
    """Return what a step makes of values, which it does not check again."""
    unchecked = checked and isinstance(step, ImageEstimator)
    transform = step.transform_checked if unchecked else step.transform
    if len(values) <= BATCH:
        return np.asarray(transform(values))
    return np.concatenate([transform(some) for some in in_batches(values)])
