"""Recognising each object's touches in many orders: accuracy, stopping, its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .._checks import STRANGERS
from .._numbers import upper_bound, with_floor
from .._types import Array, Bools, Floats, Indices
from ..recognition import Belief, Evidence, ObjectRecogniser, SequenceCalibration


@dataclass(frozen=True)
class Episodes:
    """The beliefs of many episodes: of each object, all orders of its touches.

    `singles` has every touch by itself, once: what counts after one touch.
    """

    objects: list[str]
    truth: list[int]  # column of the true label; -1 for an unknown object
    rows: list[Array]  # (n_orders, n_touches): numbers of the touches
    beliefs: list[Floats]  # (n_orders, n_touches, n_labels): log posteriors
    unknown: list[Floats]  # (n_orders, n_touches): evidence for a stranger (nats)
    singles: Episodes | None = None

    def after(self, k: int) -> tuple[list[int], list[Floats]]:
        """Return true columns and log posteriors after `k` touches.

        One array (n_episodes, n_labels) per object with at least `k` touches.
        """
        if k == 1 and self.singles is not None:
            return self.singles.after(k)
        pairs = zip(self.truth, self.beliefs, strict=True)
        enough = [(t, b[:, k - 1]) for t, b in pairs if b.shape[1] >= k]
        return [t for t, _ in enough], [b for _, b in enough]

    def objects_after(self, k: int) -> set[str]:
        """Return the objects with at least `k` touches."""
        pairs = zip(self.objects, self.beliefs, strict=True)
        return {name for name, b in pairs if b.shape[1] >= k}

    def unknown_after(self, k: int) -> Floats:
        """Return the evidence for strangers after `k` touches, of all objects."""
        if k == 1 and self.singles is not None:
            return self.singles.unknown_after(k)
        scores = [u[:, k - 1] for u in self.unknown if u.shape[1] >= k]
        return np.concatenate(scores) if scores else np.empty(0)

    def scores(self, k: int) -> Scores | None:
        """Score the episodes after `k` touches; None where no object has so many."""
        truth, beliefs = self.after(k)
        if not truth:
            return None
        n_labels = beliefs[0].shape[-1]
        confusion = np.zeros((n_labels, n_labels))
        named = [log_posterior.argmax(axis=1) for log_posterior in beliefs]
        for column, answers, rows in zip(truth, named, beliefs, strict=True):
            # Of equal beliefs the first label is no answer.
            informative = rows.max(axis=1) > rows.min(axis=1)
            if column >= 0 and informative.any():
                counts = np.bincount(answers[informative], minlength=n_labels)
                confusion[column] += counts / informative.sum()
        column_of = np.repeat(truth, [len(b) for b in beliefs])
        everything, best = np.concatenate(beliefs), np.concatenate(named)
        true_log = everything[np.arange(len(best)), column_of]
        pairs = zip(truth, named, strict=True)
        answered = np.maximum(confusion.sum(axis=1, keepdims=True), 1e-12)
        return Scores(
            accuracy=np.array([(best == t).mean() for t, best in pairs]),
            confidence=np.exp(everything.max(axis=1)),
            hit=best == column_of,
            log_loss=np.where(column_of >= 0, -true_log, np.nan),
            confusion=confusion / answered,
        )

    def decide(
        self,
        error: float,
        refusal: float | None = None,
        strangers: float = STRANGERS,
    ) -> Decisions:
        """Return where each episode stops, as `Belief.decide` would have it."""
        parts = []
        refusal = error if refusal is None else refusal
        of_each = zip(self.objects, self.truth, self.beliefs, self.unknown, strict=True)
        for name, truth, log_posterior, evidence in of_each:
            n_orders, n_touches, _ = log_posterior.shape
            beliefs = log_posterior, evidence, strangers
            doubt, unknown = Belief.doubt_and_unknown(*beliefs)
            refuse = 1 - unknown <= refusal
            stop = refuse | (doubt <= error)
            decided = np.asarray(stop.any(axis=1))
            last = np.where(decided, stop.argmax(axis=1), n_touches - 1)
            rows = np.arange(n_orders)
            refused = decided & refuse[rows, last]
            right = log_posterior[rows, last].argmax(axis=1) == truth
            right &= decided & ~refused
            objects = np.full(n_orders, name)
            parts.append(Decisions(last + 1, decided, right, refused, objects))
        return Decisions.pooled(parts)


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
        Share of each answer (columns) per true label (rows), of episodes whose touches
        said anything.
    """

    accuracy: Floats
    confidence: Floats
    hit: Bools
    log_loss: Floats
    confusion: Floats


def run_episodes(
    recogniser: ObjectRecogniser,
    log_likelihood: Floats,
    objects: Array,
    labels: Array | None,
    n_orders: int,
    seed: int,
    evidence: Evidence | None = None,
    *,
    calibrated: bool = True,
) -> Episodes:
    """Recognise each object's touches in `n_orders` random orders, and singly.

    Of `evidence` comes what tells strangers; without it all encodings agree. Unless
    `calibrated`, touches of one episode add up in full.
    """
    rng, model = np.random.default_rng(seed), recogniser.belief_model()
    if not calibrated:
        model = replace(model, sequence_calibration=SequenceCalibration())
    floored, classes = with_floor(log_likelihood, model.floor), model.classes.tolist()
    n_encodings = len(model.strangers.weights)
    each = log_likelihood[:, np.newaxis].repeat(n_encodings, axis=1)
    distances = np.full(log_likelihood.shape, np.nan)
    if evidence is not None:
        each, distances = evidence.by_encoding, evidence.log_distances
    each = with_floor(each, model.floor)

    def after_each(rows: Array) -> tuple[Floats, Floats]:
        return model.after_each(floored[rows], each[rows], distances[rows])

    of_each = [np.flatnonzero(objects == name) for name in np.unique(objects)]
    first = [rows[0] for rows in of_each]
    names = [str(objects[row]) for row in first]
    of_labels = [None if labels is None else str(labels[row]) for row in first]
    truth = [classes.index(label) if label in classes else -1 for label in of_labels]
    orders = [
        np.stack([rng.permutation(rows) for _ in range(n_orders)]) for rows in of_each
    ]
    alone = after_each(np.arange(len(objects))[:, np.newaxis])
    beliefs, unknown = ([v[rows] for rows in of_each] for v in alone)
    rows = [rows[:, np.newaxis] for rows in of_each]
    singles = Episodes(names, truth, rows, beliefs, unknown)
    beliefs, unknown = map(list, zip(*map(after_each, orders), strict=True))
    return Episodes(names, truth, orders, beliefs, unknown, singles)


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

    touches: Indices
    decided: Bools
    right: Bools
    refused: Bools
    objects: NDArray[np.str_]

    @classmethod
    def pooled(cls, parts: Sequence[Self]) -> Self:
        """Return the decisions of several folds together."""
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(*map(np.concatenate, columns))

    def to_dict(self, error: float, refusal: float, strangers: float) -> dict[str, Any]:
        """Return plain values; `accuracy` is over decided episodes.

        `wrong` counts episodes in which another object was named, `refused` those that
        were called unknown. `bound` is an upper bound, at 95 % confidence, on the share
        wrong among episodes of new objects in which one was named: each object counts
        once, as wrong as its episodes were (Clopper and Pearson 1934,
        doi:10.1093/biomet/26.4.404). `verified` says whether it is within `error`; with
        n objects it cannot be below 1 - 0.05^(1/n), whatever happens.
        """
        decided, shares = self.decided, []
        named = decided & ~self.refused
        for name in np.unique(self.objects):
            rows = (self.objects == name) & named
            if rows.any():
                shares.append(1 - self.right[rows].mean())
        n_objects, wrong = len(shares), float(np.sum(shares))
        bound = upper_bound(wrong, n_objects)
        return {
            "error": error,
            "refusal": refusal,
            "strangers": strangers,
            "accuracy": float(self.right[decided].mean()) if decided.any() else None,
            "mean_touches": float(self.touches.mean()),
            "undecided": float((~decided).mean()),
            "right": int(self.right.sum()),
            "wrong": int((named & ~self.right).sum()),
            "refused": int(self.refused.sum()),
            "n_episodes": len(decided),
            "n_objects": n_objects,
            "bound": bound,
            "verified": bound <= error,
            "can_be_verified": upper_bound(0, n_objects) <= error,
        }


def answers_of(episodes: Episodes, ends: Decisions, classes: Array) -> NDArray[np.str_]:
    """Return each episode's answer: a name, "unknown" or "undecided"."""
    answers = []
    for name, log_posterior in zip(episodes.objects, episodes.beliefs, strict=True):
        rows = ends.objects == name
        orders = np.arange(len(log_posterior))
        best = log_posterior[orders, ends.touches[rows] - 1].argmax(axis=1)
        named = np.where(ends.refused[rows], "unknown", classes[best].astype(str))
        answers.append(np.where(ends.decided[rows], named, "undecided"))
    return np.concatenate(answers)
