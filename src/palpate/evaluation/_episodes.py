"""Accuracy against the number of touches: many orders of each object's touches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..recognition import (
    ObjectRecogniser,
    log_posteriors,
    n_informative,
    with_floor,
)

Floats = NDArray[np.float64]


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
    n_told : list of ndarray of int, shape (n_orders, n_touches)
        How many of the touches so far said anything: not those without contact.
    unknown : list of ndarray of shape (n_orders, n_touches)
        Unknown score after each touch.
    """

    objects: list[str]
    truth: list[int]
    beliefs: list[Floats]
    n_told: list[NDArray]
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
    objects: NDArray,
    labels: NDArray | None,
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
    truth, beliefs, counts, unknown = [], [], [], []
    scale = recogniser.unknown_scale_
    classes = recogniser.classes_.tolist()
    for name in names:
        rows = np.flatnonzero(objects == name)
        orders = np.stack([rng.permutation(rows) for _ in range(n_orders)])
        beliefs.append(
            log_posteriors(
                floored[orders],
                recogniser.log_prior(),
                recogniser.sequence_calibration_,
            )
        )
        counts.append(n_informative(floored[orders]))
        new = None if novelty is None else novelty[orders]
        unknown.append(scale.scores(beliefs[-1], floored[orders], new))
        label = None if labels is None else str(labels[rows[0]])
        truth.append(classes.index(label) if label in classes else -1)
    return Episodes([str(name) for name in names], truth, beliefs, counts, unknown)


def single_touches(
    recogniser: ObjectRecogniser,
    log_likelihood: Floats,
    episodes: Episodes,
    objects: NDArray,
    novelty: Floats | None = None,
) -> Episodes:
    """Return one episode of one touch for every touch."""
    floored = with_floor(log_likelihood, recogniser.floor_)[:, np.newaxis]
    after_one = log_posteriors(
        floored, recogniser.log_prior(), recogniser.sequence_calibration_
    )
    new = None if novelty is None else novelty[:, np.newaxis]
    scores = recogniser.unknown_scale_.scores(after_one, floored, new)
    rows = [objects == name for name in episodes.objects]
    return Episodes(
        episodes.objects,
        episodes.truth,
        [after_one[mine] for mine in rows],
        [n_informative(floored[mine]) for mine in rows],
        [scores[mine] for mine in rows],
    )


@dataclass(frozen=True)
class Outcome:
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


def outcome(truth: Sequence[int], beliefs: Sequence[Floats]) -> Outcome:
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
    return Outcome(
        accuracy=np.array(
            [
                (b.argmax(axis=1) == t).mean()
                for t, b in zip(truth, beliefs, strict=True)
            ]
        ),
        confidence=np.exp(everything.max(axis=1)),
        hit=best == column_of,
        log_loss=np.where(column_of >= 0, -true_log, np.nan),
        confusion=confusion / np.maximum(confusion.sum(axis=1, keepdims=True), 1e-12),
    )
