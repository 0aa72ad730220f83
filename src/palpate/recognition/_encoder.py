"""Touches -> features: one clean-up and a chain of encodings, learnt together."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, clone

from ..encodings import PrincipalShare
from ..images import DomeCrop, fill_dead_taxels
from ..touches import Touches

Floats = NDArray[np.float64]
BATCH = 256


class TouchEncoder(BaseEstimator):
    """A clean-up of the images, then encoders one after the other.

    Dead taxels (NaN) are filled from their neighbours before anything else.

    Parameters
    ----------
    clean_up : transformer of images or None
        Image -> cleaner image, such as `DomeCrop`; None leaves images alone.
    steps : sequence of transformers
        The first takes images, the others feature vectors.

    Attributes
    ----------
    clean_up_, steps_ : fitted copies
        What `fit` learnt.
    image_shape_ : tuple of int
        (n_rows, n_cols) of the touches seen by `fit`.
    """

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

    def fit_clean(self, touches: Touches) -> NDArray:
        """Learn the clean-up and return the cleaned images."""
        self.image_shape_ = touches.images.shape[1:]
        self.clean_up_ = None if self.clean_up is None else clone(self.clean_up)
        images = _living(touches.images)
        if isinstance(self.clean_up_, DomeCrop):
            frame = touches.no_contact
            idle = None if frame is None else _living(frame[np.newaxis])[0]
            self.clean_up_.fit(images, no_contact=idle)
        elif self.clean_up_ is not None:
            self.clean_up_.fit(images)
        return self.clean(touches)

    def fit_encode(
        self, cleaned: NDArray, group: NDArray | None = None
    ) -> tuple[Floats, Floats]:
        """Learn the encodings of cleaned images; return features and `unexplained`.

        What is unexplained is so with the touches of the same `group` left out of the
        components (NaN without groups): new touches are never as close to them as
        those they were learnt from.
        """
        self.steps_ = [clone(step) for step in self.steps]
        values, left = cleaned, np.full(len(cleaned), np.nan)
        for step in self.steps_:
            if isinstance(step, PrincipalShare) and group is not None:
                left = step.left_out_unexplained(values, group)
            values = _in_batches(step.fit(values), values)
        return np.asarray(values, dtype=np.float64), left

    def clean(self, touches: Touches) -> NDArray:
        """Return the images after the clean-up alone."""
        self._check_size(touches)
        return self._clean(touches.images)

    def encode(self, cleaned: NDArray) -> Floats:
        """Return the features of images that were cleaned already."""
        return self.encode_fully(cleaned)[0]

    def encode_fully(self, cleaned: NDArray) -> tuple[Floats, Floats]:
        """Return features, and how much of each touch principal components leave out.

        The latter (n_touches,) in units of the training touches' variance; NaN where
        no step is a `PrincipalShare`.
        """
        values, left = cleaned, np.full(len(cleaned), np.nan)
        for step in self.steps_:
            before, values = values, _in_batches(step, values)
            if isinstance(step, PrincipalShare):
                left = step.unexplained(before, values)
        return np.asarray(values, dtype=np.float64), left

    def transform(self, touches: Touches) -> Floats:
        """Return the features, shape (n_touches, n_features).

        So many touches at a time pass through all steps that memory stays bounded,
        however many there are.
        """
        self._check_size(touches)
        starts = range(0, len(touches), BATCH)
        return np.concatenate(
            [self.encode(self._clean(touches.images[s : s + BATCH])) for s in starts]
        )

    def _clean(self, raw: NDArray) -> NDArray:
        images = _living(raw)
        return images if self.clean_up_ is None else _in_batches(self.clean_up_, images)

    def _check_size(self, touches: Touches) -> None:
        got = touches.images.shape[1:]
        if tuple(got) != tuple(self.image_shape_):
            raise ValueError(
                f"touches must have {self.image_shape_[0]} x {self.image_shape_[1]} "
                f"taxels like the training touches, got {got[0]} x {got[1]}. "
                "Use the same sensor and resolution, or learn again."
            )


def _living(images: NDArray) -> NDArray:
    dead = images.dtype.kind == "f" and np.isnan(images).any()
    return fill_dead_taxels(images) if dead else images


def _in_batches(step: Any, values: NDArray) -> NDArray:
    """Transform so many touches at a time that memory stays bounded."""
    starts = range(0, len(values), BATCH)
    return np.concatenate([step.transform(values[s : s + BATCH]) for s in starts])
