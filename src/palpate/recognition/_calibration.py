"""What the training touches tell about episodes to come.

Every training touch is recognised by a model that never met its stretch of the
recording; episodes drawn from those answers show how far a sum of log-likelihoods
may be trusted and how uncertain the belief about a KNOWN object ever gets. Nothing
here looks at a test touch.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax
from sklearn.base import clone

from ._sequence import Floats, SequenceCalibration, n_informative
from ._training import N_BLOCKS
from ._unknown import UnknownScale, fit_unknown_scale

EPISODES_PER_OBJECT = 40
LENGTHS = (1, 2, 3, 5, 8, 12, 20, 30)


def left_out_log_likelihood(
    classifier: Any, features: Floats, labels: NDArray, group: NDArray
) -> Floats:
    """Return log-likelihoods of training touches, each with its group left out.

    Shape (n_touches, n_classes). A classifier that knows them in closed form
    (`left_out_log_likelihood`, `leave_one_out_log_likelihood`) is asked; any other
    is fitted again on folds.
    A label whose touches are all left out at once gets the least likelihood
    that any label got for the touch.
    """
    if hasattr(classifier, "left_out_log_likelihood"):
        known: Floats = classifier.left_out_log_likelihood()
        return known
    if hasattr(classifier, "leave_one_out_log_likelihood"):
        return _worst_for_none(classifier.leave_one_out_log_likelihood(groups=group))
    result = np.full((len(features), len(classifier.classes_)), -np.inf)
    # Stretch k of every object goes into fold k, so each fold keeps all objects.
    fold_of = _rank_within(labels, group) % N_BLOCKS
    for fold in np.unique(fold_of):
        train, test = np.flatnonzero(fold_of != fold), np.flatnonzero(fold_of == fold)
        if len(np.unique(labels[train])) < 2:
            continue
        again = clone(classifier).fit(features[train], labels[train])
        columns = np.searchsorted(classifier.classes_, again.classes_)
        result[np.ix_(test, columns)] = touch_log_likelihood(again, features[test])
    return _worst_for_none(result)


def touch_log_likelihood(classifier: Any, features: Floats) -> Floats:
    """Return log p(touch | label) up to a constant per touch, for any classifier.

    From `log_likelihood` where there is one, else from `predict_proba`, taken as
    the posterior under equal priors and kept above 1e-12.
    """
    if hasattr(classifier, "log_likelihood"):
        known: Floats = classifier.log_likelihood(features)
        return known
    probability = np.clip(classifier.predict_proba(features), 1e-12, None)
    result: Floats = np.log(probability)
    return result


def draw_episodes(
    episode_of: NDArray, group: NDArray, n_touches: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Draw episodes as rows of touch numbers, shape (n_episodes, n_touches).

    The touches of an episode come from one stretch, or from as few neighbouring
    ones as hold them: a visit to an object is rarely spread over a whole
    recording. Objects with fewer touches are left out.
    """
    episodes = []
    for name in np.unique(episode_of):
        rows = np.flatnonzero(episode_of == name)
        if len(rows) < n_touches:
            continue
        rows = rows[np.argsort(group[rows], kind="stable")]
        parts = np.split(rows, np.flatnonzero(np.diff(group[rows])) + 1)
        for _ in range(EPISODES_PER_OBJECT):
            start = rng.integers(len(parts))
            pool = np.concatenate(parts[start:] + parts[:start])
            enough = -(-n_touches // len(parts[start])) * len(parts[start])
            episodes.append(rng.permutation(pool[:enough])[:n_touches])
    return np.array(episodes, dtype=np.intp).reshape(-1, n_touches)


def draw_all(objects: NDArray, group: NDArray, seed: int) -> dict[int, NDArray]:
    """Draw episodes of all lengths for which some object has the touches."""
    rng = np.random.default_rng(seed)
    drawn = {k: draw_episodes(objects, group, k, rng) for k in LENGTHS}
    return {k: rows for k, rows in drawn.items() if len(rows)}


def calibrate(
    floored: Floats,
    novelty: Floats,
    codes: NDArray,
    episodes: dict[int, NDArray],
    log_prior: Floats,
    *,
    calibrates_sequence: bool,
) -> tuple[SequenceCalibration, UnknownScale]:
    """Return how touches add up, and what known episodes look like."""
    trust = (
        fit_sequence_calibration(floored, codes, episodes, log_prior)
        if calibrates_sequence
        else SequenceCalibration()
    )
    return trust, fit_unknown_scale(floored, novelty, codes, episodes, log_prior, trust)


def fit_sequence_calibration(
    floored: Floats, codes: NDArray, episodes: dict[int, NDArray], log_prior: Floats
) -> SequenceCalibration:
    """Return the trust with the least log loss over episodes of all lengths."""
    sums = [floored[rows].sum(axis=1) for rows in episodes.values()]
    counts = [n_informative(floored[rows])[:, -1:] for rows in episodes.values()]
    truths = [codes[rows[:, 0]] for rows in episodes.values()]

    def loss(raw: NDArray) -> float:
        trust = _trust(raw)
        losses = []
        for count, total, truth in zip(counts, sums, truths, strict=True):
            last = log_softmax(total * trust.weight(count) + log_prior, axis=1)
            losses.append(-last[np.arange(len(truth)), truth].mean())
        return float(np.mean(losses))

    found = minimize(loss, x0=[-0.1, -2.0], method="Nelder-Mead")
    return _trust(found.x)


def _worst_for_none(log_likelihood: Floats) -> Floats:
    """Give labels without a density the least likelihood that the touch has."""
    known = np.isfinite(log_likelihood)
    worst = np.where(known, log_likelihood, np.inf).min(axis=1, keepdims=True)
    return np.where(known, log_likelihood, worst)


def _trust(raw: NDArray) -> SequenceCalibration:
    """Map two free numbers to a strength in [0.05, 1] and a correlation in (0, 1).

    Posteriors of single touches are calibrated already, and no strength above 1 may
    undo their floor: training touches that are all told apart would ask for any.
    """
    strength = float(np.exp(np.clip(raw[0], np.log(0.05), 0)))
    return SequenceCalibration(
        strength, float(1 / (1 + np.exp(-np.clip(raw[1], -12, 12))))
    )


def _rank_within(labels: NDArray, group: NDArray) -> NDArray[np.intp]:
    """Number the groups of each label 0, 1, 2..., per touch."""
    rank = np.empty(len(labels), dtype=np.intp)
    for label in np.unique(labels):
        rows = labels == label
        rank[rows] = np.unique(group[rows], return_inverse=True)[1]
    return rank
