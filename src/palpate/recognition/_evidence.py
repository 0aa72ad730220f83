"""What touches tell, and how it adds up to a belief.

Plain functions on arrays, shared by `Belief` (one touch at a time) and by the
evaluation (thousands of episodes at once), so that both mean the same belief.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._checks import as_array, check_positive
from .._numbers import exp, log_softmax
from .._types import Array, Bools, Floats, Indices
from ..touches import Touches

NO_CONTACT = "no contact"
_LEAST_LOG_PRIOR = -27.7


class Evidence(NamedTuple):
    """What touches tell of the object, one row a touch.

    Attributes
    ----------
    features : ndarray of shape (n_touches, n_features)
        What the encoder made of them.
    log_likelihood : ndarray of shape (n_touches, n_objects)
        log p(touch | object) up to a constant per touch (nats).
    flags : list of str
        What is wrong with each touch, "" for most: "no contact", "saturated", "double
        contact".
    by_encoding : ndarray of shape (n_touches, n_encodings, n_objects)
        The log-likelihood of each encoding alone.
    log_distances : ndarray of shape (n_touches, n_objects)
        Logarithm of the distance to the nearest training touch of each object.
    looks : ndarray of shape (n_touches, 7)
        Spectrum and load, which tell of another mounting.
    """

    features: Floats
    log_likelihood: Floats
    flags: list[str]
    by_encoding: Floats
    log_distances: Floats
    looks: Floats

    @property
    def shows_contact(self) -> Bools:
        """Which touches show contact, shape (n_touches,)."""
        return np.array([flag != NO_CONTACT for flag in self.flags], dtype=bool)

    @classmethod
    def together(cls, parts: Sequence[Evidence]) -> Evidence:
        """Return the evidence of several sets of touches, one after the other."""
        columns = {
            name: [getattr(part, name) for part in parts] for name in cls._fields
        }
        flags = [*chain.from_iterable(columns.pop("flags"))]
        arrays = {name: np.concatenate(rows) for name, rows in columns.items()}
        return cls(**arrays, flags=flags)

    def of_touch(self, touch: int) -> Evidence:
        """Return the evidence of a single touch; -1 is the last one."""
        n_touches = len(self.flags)
        if not -n_touches <= touch < n_touches:
            raise IndexError(f"touch {touch} is out of range: there are {n_touches}.")
        parts: tuple[Any, ...] = self
        row = touch % n_touches
        return Evidence(*(part[row : row + 1] for part in parts))


@dataclass(frozen=True)
class SequenceCalibration:
    """How the evidence of the touches of one episode adds up.

    The log-likelihoods of k touches are summed and multiplied by
    strength / (1 + (k - 1) correlation): touches of one episode resemble each
    other, so k of them are worth fewer independent ones (the design effect of a
    sample of equally correlated readings). The most probable object under equal
    priors is the same for every calibration.

    Attributes
    ----------
    strength : float
        Weight of a single touch; 1 takes the likelihood at its word.
    correlation : float
        Between 0 (independent touches) and 1 (all touches are one).
    """

    strength: float = 1.0
    correlation: float = 0.0

    def weight(self, n_touches: Floats | int) -> Floats:
        """Return the factor on the sum of `n_touches` log-likelihoods."""
        others = np.maximum(np.asarray(n_touches) - 1, 0)
        return np.asarray(self.strength / (1 + others * self.correlation))


def as_touches(touch: Any, channels: Sequence[str] | None = None) -> Touches:
    """Return touches, lists of them, an image or images as `Touches`, or explain.

    An array whose last axis is as long as `channels` holds them there.
    """
    if isinstance(touch, Touches):
        return touch
    if isinstance(touch, list) and touch and isinstance(touch[0], Touches):
        return Touches.concatenate(touch)
    images = as_array("touch", touch)
    if channels and images.ndim in (3, 4) and images.shape[-1] == len(channels):
        if images.ndim == 3:
            images = images[np.newaxis]
        return Touches(images, channels=channels)
    if images.ndim not in (2, 3):
        named = 'Touches(images, channels=["r", "g", "b"])'
        hint = f" Name its channels: {named}." if images.ndim == 4 else ""
        raise ValueError(
            "touch must be Touches, one image (n_rows, n_cols) or images (n_touches, "
            f"n_rows, n_cols), got an array of shape {images.shape}.{hint}"
        )
    return Touches(images if images.ndim == 3 else images[np.newaxis])


def given_prior(prior: Mapping[str, float], classes: Array) -> Floats:
    """Return log probabilities in the order of `classes`, brought to sum 1."""
    names = [str(name) for name in classes]
    if not isinstance(prior, Mapping):
        raise TypeError(
            f"prior must map objects to probabilities, got {type(prior).__name__}."
        )
    by_name = {str(name): value for name, value in prior.items()}
    if different := sorted(by_name.keys() ^ set(names)):
        raise ValueError(
            f"prior must name every object and no other, got a difference in "
            f"{different[0]!r}. The objects are {', '.join(names)}."
        )
    logs = np.log([check_positive("prior", by_name[name]) for name in names])
    log_prior: Floats = log_softmax(logs)
    if log_prior.min() < _LEAST_LOG_PRIOR:
        least = names[int(log_prior.argmin())]
        raise ValueError(
            f"prior must not all but rule an object out, got {by_name[least]} for "
            f"{least!r}. Give it at least 1e-12 of the sum, or forget the object."
        )
    return log_prior


def beliefs_after(
    used: Bools, floored: Floats, log_prior: Floats, calibration: SequenceCalibration
) -> tuple[Floats, Indices]:
    """Return log posteriors after each touch, and the number of those that are `used`.

    In nats, of the touches of episodes in order: those that are `used` (...,
    n_touches), `floored` likelihoods from `with_floor` (..., n_touches, n_objects),
    perhaps encodings before the objects, and `log_prior` (n_objects,).
    """
    wide = used.reshape(used.shape + (1,) * (floored.ndim - used.ndim))
    total = summed_up(np.where(wide, floored, 0.0), used.ndim - 1)
    count = used.cumsum(axis=-1)
    total *= calibration.weight(count).reshape(wide.shape)
    total += log_prior
    return log_softmax(total, axis=-1), count


def summed_up(values: Floats, axis: int) -> Floats:
    """Write the sums so far over values, along an `axis` that others follow.

    Of many objects `np.cumsum` takes five times as long.
    """
    along = np.moveaxis(values, axis, 0)
    for before, now in pairwise(along):
        now += before
    return values


def is_informative(floored: Floats) -> Bools:
    """Return which touches tell objects apart, shape (..., n_touches).

    A touch without contact has one likelihood for all objects; it leaves the belief
    exactly where it was.
    """
    return np.asarray(floored.max(axis=-1) > floored.min(axis=-1))


def doubts(log_posterior: Floats) -> Floats:
    """Return the probability outside the most probable object, shape (...,).

    Summed over the other objects, so that it stays exact near 0.
    """
    shares = exp(log_posterior)
    best = shares.argmax(axis=-1)
    np.put_along_axis(shares, best[..., np.newaxis], 0, axis=-1)
    return np.asarray(shares.sum(axis=-1))


def checked_rows(log_likelihood: ArrayLike, n_objects: int) -> Floats:
    """Return log-likelihoods (n_touches, n_objects) less the row's greatest."""
    rows = np.atleast_2d(np.asarray(log_likelihood, dtype=np.float64))
    if rows.ndim != 2 or rows.shape[1] != n_objects:
        raise ValueError(
            f"log_likelihood must have shape (n_touches, {n_objects}), got "
            f"{rows.shape}. Its columns are the recogniser's classes_."
        )
    check_every_touch("log_likelihood", rows)
    with np.errstate(over="ignore"):  # what is less by more than 1e308 is ruled out
        less: Floats = rows - rows.max(axis=1, keepdims=True)
    return less


def check_every_touch(name: str, values: Floats) -> None:
    """Refuse log-likelihoods (n_touches, ..., n_objects) that are no numbers."""
    is_bad = ~np.isfinite(values.max(axis=-1))  # a row with NaN has it as its maximum
    if is_bad.any():
        bad = is_bad.reshape(len(values), -1).any(axis=1)
        raise ValueError(
            f"{name} must hold a finite number and no NaN for every touch, got "
            f"{values[bad][0]} for touch {np.flatnonzero(bad)[0]}. Leave that touch "
            "out."
        )


def checked_parts(**tables: tuple[ArrayLike | None, tuple[int, ...]]) -> list[Floats]:
    """Return parts of the evidence, given with their shapes, or explain.

    NaN where there is none.
    """
    parts = []
    for name, (part, shape) in tables.items():
        array = np.full(shape, np.nan)
        if part is not None:
            array = np.atleast_2d(np.asarray(part, dtype=np.float64))
        if array.shape != shape:
            raise ValueError(
                f"{name} must have shape {shape}, got {array.shape}. Take it from "
                "ObjectRecogniser.evidence, of the same touches."
            )
        parts.append(array)
    return parts
