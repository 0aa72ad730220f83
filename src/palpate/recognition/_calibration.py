"""What the training touches tell about how evidence adds up in episodes to come.

Every training touch is recognised by a model that never met its block of the recording
(a session, where there are several). Episodes drawn from those answers show how a sum
of log-likelihoods adds up. Nothing here looks at a test touch.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from .._numbers import log_loss
from .._types import Array, Floats, Indices
from ..classifiers import TouchClassifier
from ._evidence import SequenceCalibration, is_informative
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
    is_finite = np.isfinite(log_likelihood)
    worst = np.where(is_finite, log_likelihood, np.inf).min(axis=-1, keepdims=True)
    return np.where(is_finite, log_likelihood, worst)


def draw_episodes(
    objects: Array, seed: int, n_known: int = 1, blocks: Indices | None = None
) -> list[Indices]:
    """Draw episodes of each object, (n_episodes, n_touches), -1 after their end.

    As many touches as the object has, up to `LONGEST`, in random order; with `blocks`
    those of one block come first, then those of its neighbours, as in a visit to the
    object. `IN_ALL` episodes of all objects together, fewer where very many are known
    (`n_known`); of very many objects, of some.
    """
    rng, each = np.random.default_rng(seed), rows_of_each(objects)
    in_all = min(IN_ALL, ANSWERS // n_known)
    spread = np.unique(np.linspace(0, len(each) - 1, in_all).astype(int))
    each = [each[k] for k in spread]
    longest = min(LONGEST, max(map(len, each)))
    drawn = []
    for rows in each:
        place = rng.random((in_all // len(each), len(rows)))
        if blocks is not None:
            of = np.unique(blocks[rows], return_inverse=True)[1]
            n_blocks = of.max() + 1
            place += (of - rng.integers(n_blocks, size=(len(place), 1))) % n_blocks
        order = rows[np.argsort(place, axis=1)[:, :longest]]
        over = ((0, 0), (0, longest - order.shape[1]))
        drawn.append(np.pad(order, over, constant_values=-1))
    return drawn


def fit_sequence_calibration(
    floored: Floats, codes: Indices, episodes: list[Indices], log_prior: Floats
) -> SequenceCalibration:
    """Return the calibration of least log loss over episodes of all lengths.

    Of log-likelihoods of touches left out, with their floor (n_touches, n_objects),
    and the column of each touch's own label (n_touches,).
    """
    drawn, used = np.concatenate(episodes), is_informative(floored)
    total, count = np.zeros((len(drawn), floored.shape[1])), np.zeros(len(drawn))
    ends = []
    for n_touches, rows in enumerate(drawn.T, start=1):
        there = rows >= 0
        tells = there & used[rows]
        total[tells] += floored[rows[tells]]
        count += tells
        if n_touches in LENGTHS:
            ends.append((total[there], count[there], codes[drawn[there, 0]]))
    totals, counts, truth = (np.concatenate(v) for v in zip(*ends, strict=True))
    # Every length counts the same.
    each = np.array([len(counts) for _, counts, _ in ends])
    share = np.repeat(1 / each / len(each), each)
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
    fit = minimize(
        loss,
        [-0.1, 0.1],
        jac=True,
        bounds=bounds,
        options={"ftol": 1e-13, "gtol": 1e-9},
    )
    return SequenceCalibration(float(np.exp(fit.x[0])), float(fit.x[1]))
