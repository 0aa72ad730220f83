"""What the training touches tell about how evidence adds up in episodes to come.

Every training touch is recognised by a model that never met its block of the recording
(a session, where there are several). Episodes drawn from those answers show how a sum
of log-likelihoods adds up. Nothing here looks at a test touch.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from .._numbers import log_loss, log_softmax
from .._types import Array, Floats, Indices
from ..classifiers import TouchClassifier
from ._evidence import SequenceCalibration, is_informative, with_floor
from ._memory import rows_of_each

# Touches of an episode: who asks after every touch has stopped by then.
LONGEST = 20
# The numbers of touches after which it should be as sure as it is right.
LENGTHS = (1, 2, 3, 5, 8, 12, 20)
# Episodes of all objects together, and so many of their answers, one for each object
# that is known.
IN_ALL, ANSWERS = 1000, 2_000_000
_LEAST_CORRELATION = 6e-6


def left_out_log_likelihood(classifier: TouchClassifier) -> Floats:
    """Return log-likelihoods of training touches, each with its group left out.

    Shape (n_touches, n_classes). A label whose touches are all left out at once gets
    the least likelihood that any label got for the touch.
    """
    return without_gaps(classifier.left_out_log_likelihood())


def without_gaps(log_likelihood: Floats) -> Floats:
    """Return log-likelihoods (..., n_classes), the least in place of minus infinity."""
    known = np.isfinite(log_likelihood)
    worst = np.where(known, log_likelihood, np.inf).min(axis=-1, keepdims=True)
    return np.where(known, log_likelihood, worst)


def draw_episodes(objects: Array, seed: int, n_known: int = 1) -> list[Indices]:
    """Draw episodes of each object, (n_episodes, n_touches), -1 after their end.

    As many touches in random order as the object has, up to `LONGEST`; `IN_ALL`
    episodes of all objects together, fewer where very many are known (`n_known`); of
    very many objects, of some.
    """
    rng, each = np.random.default_rng(seed), rows_of_each(objects)
    in_all = min(IN_ALL, ANSWERS // n_known)
    spread = np.unique(np.linspace(0, len(each) - 1, in_all).astype(int))
    each = [each[k] for k in spread]
    longest = min(LONGEST, max(map(len, each)))
    drawn = []
    for rows in each:
        order = np.argsort(rng.random((in_all // len(each), len(rows))), axis=1)
        some = rows[order[:, :longest]]
        over = ((0, 0), (0, longest - some.shape[1]))
        drawn.append(np.pad(some, over, constant_values=-1))
    return drawn


def block_effects(said: Floats, objects: Array, blocks: Indices) -> Floats:
    """Return what each touch has in common with its block, (n_touches, n_values).

    By how much the mean of its block lies beside that of its object, less what chance
    would make of so few touches. 0 where no block tells it.
    """
    whose = np.unique(objects, return_inverse=True)[1]
    of, run = np.unique(np.stack([whose, blocks]), axis=1, return_inverse=True)
    run, n_each = run.ravel(), np.bincount(run.ravel())
    n_blocks, n_free = np.bincount(of[0])[of[0]], len(said) - len(n_each)
    middle = _means(said, run)
    away = middle - _means(said, whose)[of[0]]
    some = n_blocks > 1
    between = (away[some] ** 2).sum(axis=1) * n_blocks[some] / (n_blocks[some] - 1)
    if not (n_free and between.any()):
        return np.zeros_like(said)
    within = ((said - middle[run]) ** 2).sum() / n_free
    chance = within * (1 / n_each[some]).mean() / between.mean()
    return np.asarray(np.sqrt(max(0.0, 1 - chance)) * away[run])


def _means(values: Floats, codes: Indices) -> Floats:
    """Return the mean row of each code, all of which occur."""
    order = np.argsort(codes, kind="stable")
    counts = np.bincount(codes)
    sums = np.add.reduceat(values[order], np.cumsum(counts) - counts, axis=0)
    return np.asarray(sums / counts[:, np.newaxis])


def fit_sequence_calibration(
    left_out: Floats,
    codes: Indices,
    objects: Array,
    blocks: Indices,
    episodes: list[Indices],
    log_prior: Floats,
    floor: float,
) -> SequenceCalibration:
    """Return the calibration of least log loss over episodes of all lengths.

    Of log-likelihoods of touches left out (n_touches, n_objects), the column of each
    touch's own label, its object and its block. A new episode is of one session, whose
    touches have in common what it adds: so in every touch what its own block adds is
    exchanged for what that of the first one does.
    """
    said, used = log_softmax(left_out), is_informative(left_out)
    added = np.zeros_like(said)
    if used.any():
        added[used] = block_effects(said[used], objects[used], blocks[used])
    drawn = np.concatenate(episodes)
    total, count = np.zeros((len(drawn), said.shape[1])), np.zeros(len(drawn))
    first, ends = drawn[:, 0], []
    for n_touches, rows in enumerate(drawn.T, start=1):
        there = rows >= 0
        tells = there & used[rows]
        own, shared = rows[tells], first[tells]
        alike = said[own] - added[own] + added[shared]
        total[tells] += with_floor(alike, floor)
        count += tells
        if n_touches in LENGTHS:
            ends.append((total[there], count[there], codes[first[there]]))
    totals, counts, truth = (np.concatenate(v) for v in zip(*ends, strict=True))
    # Every length counts the same.
    share = np.concatenate(
        [np.full(len(e), 1 / len(e) / len(ends)) for _, e, _ in ends]
    )
    return _of_least_loss(totals, counts, truth, share, log_prior)


def _of_least_loss(
    total: Floats, count: Floats, truth: Indices, share: Floats, log_prior: Floats
) -> SequenceCalibration:
    """Return the calibration under which sums of `count` touches tell the truth best.

    `share` (n_episodes,) is that of each in the log loss.
    """
    others = np.maximum(count - 1, 0)

    def loss(raw: Floats) -> tuple[float, Floats]:
        calibration = SequenceCalibration(float(np.exp(raw[0])), float(raw[1]))
        weight = calibration.weight(count)
        logits = total * weight[:, np.newaxis] + log_prior
        value, pull = log_loss(logits, truth, share)
        by_strength = np.einsum("eo,eo->e", pull, total) * weight
        by_correlation = -by_strength * others / (1 + others * raw[1])
        return value, np.array([by_strength.sum(), by_correlation.sum()])

    # Posteriors of single touches are calibrated already, and no strength above 1 may
    # undo their floor: training touches that are all told apart would ask for any.
    bounds = [(np.log(0.05), 0.0), (_LEAST_CORRELATION, 1 - _LEAST_CORRELATION)]
    found = minimize(
        loss,
        [-0.1, 0.1],
        jac=True,
        bounds=bounds,
        options={"ftol": 1e-13, "gtol": 1e-9},
    )
    return SequenceCalibration(float(np.exp(found.x[0])), float(found.x[1]))
