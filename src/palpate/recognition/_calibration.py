"""What the training touches tell about episodes to come.

Every training touch is recognised by a model that never met its block of the
recording; episodes drawn from those answers show how a sum of log-likelihoods adds up
and how uncertain the belief about a KNOWN object ever gets. Nothing
here looks at a test touch.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax

from .._types import Array, Floats
from ..classifiers import TouchClassifier
from ._evidence import SequenceCalibration, n_informative
from ._unknown import MOST_ASKED

EPISODES_PER_OBJECT = 40
# Long episodes in all, of all objects together.
IN_ALL = 1000
LENGTHS = (1, 2, 3, 5, 8, 12, 20, 30)


def left_out_log_likelihood(classifier: TouchClassifier) -> Floats:
    """Return log-likelihoods of training touches, each with its group left out.

    Shape (n_touches, n_classes). A label whose touches are all left out at once gets
    the least likelihood that any label got for the touch.
    """
    log_likelihood = classifier.left_out_log_likelihood()
    known = np.isfinite(log_likelihood)
    worst = np.where(known, log_likelihood, np.inf).min(axis=1, keepdims=True)
    return np.where(known, log_likelihood, worst)


def draw_episodes(
    episode_of: Array, group: Array, n_touches: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Draw episodes as rows of touch numbers, shape (n_episodes, n_touches).

    The touches of an episode come from one block, or from as few neighbouring
    ones as hold them: a visit to an object is rarely spread over a whole
    recording. Objects with fewer touches are left out.
    """
    of_each = (np.flatnonzero(episode_of == name) for name in np.unique(episode_of))
    episodes = [
        _episodes_of(rows, group, n_touches, EPISODES_PER_OBJECT, rng)
        for rows in of_each
        if len(rows) >= n_touches
    ]
    return np.concatenate([np.empty((0, n_touches), dtype=np.intp), *episodes])


def _episodes_of(
    rows: Array, group: Array, n_touches: int, n_episodes: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Draw episodes of one object, whose touches are `rows`."""
    rows = rows[np.argsort(group[rows], kind="stable")]
    parts = np.split(rows, np.flatnonzero(np.diff(group[rows])) + 1)
    episodes = np.empty((n_episodes, n_touches), dtype=np.intp)
    for episode in episodes:
        start = rng.integers(len(parts))
        pool = np.concatenate(parts[start:] + parts[:start])
        enough = -(-n_touches // len(parts[start])) * len(parts[start])
        episode[:] = rng.permutation(pool[:enough])[:n_touches]
    return episodes


def draw_all(objects: Array, group: Array, seed: int) -> dict[int, Array]:
    """Draw episodes of all lengths for which some object has the touches."""
    rng = np.random.default_rng(seed)
    drawn = {k: draw_episodes(objects, group, k, rng) for k in LENGTHS}
    return {k: rows for k, rows in drawn.items() if len(rows)}


def draw_asked(objects: Array, group: Array, seed: int) -> list[NDArray[np.intp]]:
    """Draw long episodes of each object, (n_episodes, n_touches), -1 after their end.

    Like those of `draw_episodes`, each as long as its object has touches, up to
    `MOST_ASKED`; of very many objects, of some.
    """
    rng = np.random.default_rng(seed)
    names, counts = np.unique(objects, return_counts=True)
    some = np.unique(np.linspace(0, len(names) - 1, IN_ALL).astype(int))
    longest = min(MOST_ASKED, int(counts[some].max()))
    n_each = min(EPISODES_PER_OBJECT, max(1, IN_ALL // len(some)))
    drawn = []
    for k in some:
        n_touches = min(longest, int(counts[k]))
        mine = np.flatnonzero(objects == names[k])
        rows = _episodes_of(mine, group, n_touches, n_each, rng)
        over = ((0, 0), (0, longest - n_touches))
        drawn.append(np.pad(rows, over, constant_values=-1))
    return drawn


def fit_sequence_calibration(
    floored: Floats, codes: Array, episodes: dict[int, Array], log_prior: Floats
) -> SequenceCalibration:
    """Return the calibration of least log loss over episodes of all lengths."""
    sums = [floored[rows].sum(axis=1) for rows in episodes.values()]
    counts = [n_informative(floored[rows])[:, -1:] for rows in episodes.values()]
    truths = [codes[rows[:, 0]] for rows in episodes.values()]

    def loss(raw: Array) -> float:
        calibration = _calibration(raw)
        losses = []
        for count, total, truth in zip(counts, sums, truths, strict=True):
            last = log_softmax(total * calibration.weight(count) + log_prior, axis=1)
            losses.append(-last[np.arange(len(truth)), truth].mean())
        return float(np.mean(losses))

    found = minimize(loss, x0=[-0.1, -2.0], method="Nelder-Mead")
    return _calibration(found.x)


def _calibration(raw: Array) -> SequenceCalibration:
    """Map two free numbers to a strength in [0.05, 1] and a correlation in (0, 1).

    Posteriors of single touches are calibrated already, and no strength above 1 may
    undo their floor: training touches that are all told apart would ask for any.
    """
    strength = float(np.exp(np.clip(raw[0], np.log(0.05), 0)))
    return SequenceCalibration(
        strength, float(1 / (1 + np.exp(-np.clip(raw[1], -12, 12))))
    )
