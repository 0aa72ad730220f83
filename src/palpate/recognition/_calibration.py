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
from ._unknown import UnknownScale, fit_unknown_scale

EPISODES_PER_OBJECT = 40
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


def draw_all(objects: Array, group: Array, seed: int) -> dict[int, Array]:
    """Draw episodes of all lengths for which some object has the touches."""
    rng = np.random.default_rng(seed)
    drawn = {k: draw_episodes(objects, group, k, rng) for k in LENGTHS}
    return {k: rows for k, rows in drawn.items() if len(rows)}


def calibrate(
    floored: Floats,
    novelty: Floats,
    codes: Array,
    episodes: dict[int, Array],
    log_prior: Floats,
    *,
    calibrates_sequence: bool,
) -> tuple[SequenceCalibration, UnknownScale]:
    """Return how touches add up, and what known episodes look like."""
    calibration = (
        fit_sequence_calibration(floored, codes, episodes, log_prior)
        if calibrates_sequence
        else SequenceCalibration()
    )
    return calibration, fit_unknown_scale(
        floored, novelty, codes, episodes, log_prior, calibration
    )


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
