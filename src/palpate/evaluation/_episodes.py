"""Recognising each object's touches in many orders: accuracy, stopping, its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from .._types import Array, Floats
from ..recognition import (
    ObjectRecogniser,
    doubts,
    log_posteriors,
    n_informative,
    with_floor,
)

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Episodes:
    """The beliefs of many episodes, all orders of all objects.

    Attributes
    ----------
    objects : list of str
        One entry per object.
    truth : list of int
        Column of the true label per object; -1 for an unknown one.
    beliefs : list of ndarray of shape (n_orders, n_touches, n_labels)
        Log posterior after each touch of each order, per object.
    n_informative : list of ndarray of int, shape (n_orders, n_touches)
        How many of the touches so far said anything: not those without contact.
    unknown : list of ndarray of shape (n_orders, n_touches)
        Unknown score after each touch.
    """

    objects: list[str]
    truth: list[int]
    beliefs: list[Floats]
    n_informative: list[Array]
    unknown: list[Floats]

    def after(self, k: int) -> tuple[list[int], list[Floats]]:
        """Return true columns and log posteriors after `k` touches.

        One array (n_episodes, n_labels) per object with at least `k` touches.
        """
        enough = [i for i, b in enumerate(self.beliefs) if b.shape[1] >= k]
        return [self.truth[i] for i in enough], [
            self.beliefs[i][:, k - 1] for i in enough
        ]

    def unknown_after(self, k: int) -> Floats:
        """Return the unknown scores after `k` touches, of all objects together."""
        scores = [u[:, k - 1] for u in self.unknown if u.shape[1] >= k]
        return np.concatenate(scores) if scores else np.empty(0)


def run_episodes(
    recogniser: ObjectRecogniser,
    log_likelihood: Floats,
    objects: Array,
    labels: Array | None,
    n_orders: int,
    seed: int,
    novelty: Floats | None = None,
) -> Episodes:
    """Recognise each object's touches in `n_orders` random orders.

    For the figures after one touch see `single_touches`, which uses each once.
    """
    rng = np.random.default_rng(seed)
    floored = with_floor(log_likelihood, recogniser.floor_)
    names = np.unique(objects)
    classes = recogniser.classes_.tolist()
    truth, after = [], []
    for name in names:
        rows = np.flatnonzero(objects == name)
        orders = np.stack([rng.permutation(rows) for _ in range(n_orders)])
        new = None if novelty is None else novelty[orders]
        after.append(_after_each(recogniser, floored[orders], new))
        label = None if labels is None else str(labels[rows[0]])
        truth.append(classes.index(label) if label in classes else -1)
    beliefs, counts, unknown = map(list, zip(*after, strict=True))
    return Episodes([str(name) for name in names], truth, beliefs, counts, unknown)


def single_touches(
    recogniser: ObjectRecogniser,
    log_likelihood: Floats,
    episodes: Episodes,
    objects: Array,
    novelty: Floats | None = None,
) -> Episodes:
    """Return one episode of one touch for every touch."""
    floored = with_floor(log_likelihood, recogniser.floor_)[:, np.newaxis]
    new = None if novelty is None else novelty[:, np.newaxis]
    after_one = _after_each(recogniser, floored, new)
    rows = [objects == name for name in episodes.objects]
    parts = ([values[mine] for mine in rows] for values in after_one)
    return Episodes(episodes.objects, episodes.truth, *parts)


def _after_each(
    recogniser: ObjectRecogniser, floored: Floats, novelty: Floats | None
) -> tuple[Floats, Array, Floats]:
    """Return beliefs, informative touches and unknown scores after each touch."""
    prior, calibration = recogniser.log_prior(), recogniser.sequence_calibration_
    beliefs = log_posteriors(floored, prior, calibration)
    unknown = recogniser.unknown_scale_.scores(beliefs, floored, novelty)
    return beliefs, n_informative(floored), unknown


@dataclass(frozen=True)
class Scores:
    """What happened in the episodes of one length.

    Attributes
    ----------
    accuracy : ndarray of shape (n_objects,)
        Share of episodes whose most probable label was right, per object.
    confidence, hit, log_loss : ndarray of shape (n_episodes,)
        Largest posterior, whether it was right, and negative log posterior of the
        truth (nats), over all episodes of all objects.
    confusion : ndarray of shape (n_labels, n_labels)
        Share of each answer (columns) per true label (rows).
    """

    accuracy: Floats
    confidence: Floats
    hit: NDArray[np.bool_]
    log_loss: Floats
    confusion: Floats


def scores(truth: Sequence[int], beliefs: Sequence[Floats]) -> Scores:
    """Score the episodes of one length; see `Episodes.after`."""
    n_labels = beliefs[0].shape[-1]
    confusion = np.zeros((n_labels, n_labels))
    for column, log_posterior in zip(truth, beliefs, strict=True):
        answers = np.bincount(log_posterior.argmax(axis=1), minlength=n_labels)
        if column >= 0:
            confusion[column] += answers / len(log_posterior)
    column_of = np.repeat(truth, [len(b) for b in beliefs])
    everything = np.concatenate(beliefs)
    best = everything.argmax(axis=1)
    true_log = everything[np.arange(len(best)), column_of]
    pairs = zip(truth, beliefs, strict=True)
    return Scores(
        accuracy=np.array([(b.argmax(axis=1) == t).mean() for t, b in pairs]),
        confidence=np.exp(everything.max(axis=1)),
        hit=best == column_of,
        log_loss=np.where(column_of >= 0, -true_log, np.nan),
        confusion=confusion / np.maximum(confusion.sum(axis=1, keepdims=True), 1e-12),
    )


@dataclass(frozen=True)
class Decisions:
    """How the episodes of known objects ended.

    Attributes
    ----------
    touches : ndarray of int, shape (n_episodes,)
        Touches used; the full length where no decision was reached.
    decided, right, refused : ndarray of bool, shape (n_episodes,)
        Whether an object was named or "unknown" was said; whether the right
        object was named; whether "unknown" was said.
    objects : ndarray of str, shape (n_episodes,)
        Whose touches they were: episodes of one object are not independent.
    """

    touches: NDArray[np.intp]
    decided: NDArray[np.bool_]
    right: NDArray[np.bool_]
    refused: NDArray[np.bool_]
    objects: NDArray[np.str_]

    @classmethod
    def pooled(cls, parts: Sequence[Self]) -> Self:
        """Return the decisions of several folds together."""
        names = ("touches", "decided", "right", "refused", "objects")
        return cls(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))

    def to_dict(self, error: float) -> dict[str, Any]:
        """Return plain values; `accuracy` is over decided episodes.

        `error_at_most` is an upper bound, at 95 % confidence, on the error of decided
        episodes of new objects: each object counts once, as wrong as its episodes
        were (Clopper and Pearson 1934, doi:10.1093/biomet/26.4.404). `verified` says
        whether it is within `error`; with n objects it cannot be below
        1 - 0.05^(1/n), whatever happens.
        """
        decided = self.decided
        n_objects, bound = self._bound()
        least = 1 - (1 - CONFIDENCE) ** (1 / max(n_objects, 1))
        return {
            "error": error,
            "accuracy": float(self.right[decided].mean()) if decided.any() else None,
            "mean_touches": float(self.touches.mean()),
            "undecided": float((~decided).mean()),
            "refused_as_unknown": float(self.refused.mean()),
            "wrong": int((decided & ~self.right).sum()),
            "n_episodes": len(decided),
            "n_objects": n_objects,
            "error_at_most": bound,
            "verified": bound <= error,
            "can_be_verified": least <= error,
        }

    def _bound(self) -> tuple[int, float]:
        """Return the number of objects with decided episodes, and the bound."""
        shares = []
        for name in np.unique(self.objects):
            rows = (self.objects == name) & self.decided
            if rows.any():
                shares.append(1 - self.right[rows].mean())
        n_objects, wrong = len(shares), float(np.sum(shares))
        if n_objects == 0 or wrong >= n_objects:
            return n_objects, 1.0
        return n_objects, float(beta.ppf(CONFIDENCE, wrong + 1, n_objects - wrong))


def decide_episodes(
    recogniser: ObjectRecogniser, episodes: Episodes, error: float
) -> Decisions:
    """Stop each episode where `Belief.decide(error)` would."""
    parts = []
    longest = max(int(counts.max()) for counts in episodes.n_informative)
    scale = recogniser.unknown_scale_
    limits = np.array(
        [scale.refusal_threshold(k, error) for k in range(1, longest + 1)]
    )
    # Before any touch said something there is no limit to exceed.
    limits = np.concatenate([[np.inf], limits])
    naming = np.array([scale.naming_threshold(k) for k in range(longest + 1)])
    for i, name in enumerate(episodes.objects):
        log_posterior, unknown = episodes.beliefs[i], episodes.unknown[i]
        counts = episodes.n_informative[i]
        n_orders, n_touches, _ = log_posterior.shape
        refuse = unknown > limits[counts]
        fits = unknown <= naming[counts]
        stop = refuse | (fits & (doubts(log_posterior) <= error))
        decided = np.asarray(stop.any(axis=1))
        last = np.where(decided, stop.argmax(axis=1), n_touches - 1)
        rows = np.arange(n_orders)
        refused = decided & refuse[rows, last]
        right = log_posterior[rows, last].argmax(axis=1) == episodes.truth[i]
        whose = np.full(n_orders, name)
        ended = (last + 1, decided, right & decided & ~refused, refused, whose)
        parts.append(Decisions(*ended))
    return Decisions.pooled(parts)
