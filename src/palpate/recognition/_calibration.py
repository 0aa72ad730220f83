"""What the training touches tell about episodes to come.

Every training touch is recognised by a model that never met its block of the
recording; episodes drawn from those answers show how a sum of log-likelihoods adds up
and how uncertain the belief about a KNOWN object ever gets. Nothing
here looks at a test touch.

Another sense (photographs, where it was touched, anything with labels) is calibrated in
the same way: it has its own training examples and its own classifier, and what it says
enters the same belief, weighted as its left-out examples say that it adds up.
"""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.sparse import csr_array
from sklearn.base import BaseEstimator
from sklearn.preprocessing import StandardScaler
from sklearn.utils import check_array

from .._checks import check_number
from .._numbers import log_loss
from .._types import Array, Floats, Indices
from ..classifiers import FromProbabilities, KernelRidgeClassifier, TouchClassifier
from ._evidence import SequenceCalibration, is_informative, with_floor
from ._strangers import LONGEST

EPISODES_PER_OBJECT = 40
# Episodes of one length in all, of all objects together, and so many of their answers,
# one for each object that is known.
IN_ALL, ANSWERS = 1000, 2_000_000
LENGTHS = (1, 2, 3, 5, 8, 12, 20, 30)
_LEAST_CORRELATION = 6e-6
# Of each object the touches, block by block, and where blocks begin and the last ends.
InBlocks = list[tuple[Indices, Indices]]


class Modality(BaseEstimator):
    """A classifier of something else than touch, calibrated like touch.

    Parameters
    ----------
    classifier : classifier, optional
        Any scikit-learn classifier with `predict_proba`, for vectors that were brought
        to mean 0 and variance 1; by default a `KernelRidgeClassifier`. Only the
        default can be kept in a model file.
    floor : float, default=0.01
        Least probability that one example leaves to all objects together.
    random_state : int, default=0
        Seed of the episodes that calibrate it.

    Attributes
    ----------
    classes_ : ndarray of str
        Labels it knows; it says nothing about others.
    scaler_, classifier_ : fitted estimators
    sequence_calibration_ : SequenceCalibration
        How its examples add up.
    """

    def __init__(
        self, classifier: Any = None, floor: float = 0.01, random_state: int = 0
    ) -> None:
        self.classifier = classifier
        self.floor = floor
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike, groups: ArrayLike | None = None) -> Self:
        """Learn from examples (n_examples, n_features) and their labels.

        Parameters
        ----------
        X, y : array-like
            Examples and labels, at least two labels of two examples each.
        groups : array-like of shape (n_examples,), optional
            Examples that resemble each other (one session) are left out together.
        """
        check_number("floor", self.floor, low=0, high=0.5)
        examples = check_array(X, dtype=np.float64)
        labels = np.asarray(y).astype(str)
        if labels.shape != (len(examples),):
            raise ValueError(
                f"y must have one label for each of {len(examples)} examples, "
                f"got shape {labels.shape}."
            )
        names, counts = np.unique(labels, return_counts=True)
        if len(names) < 2 or counts.min() < 2:
            raise ValueError(
                "y must hold at least two labels of two examples each, got "
                f"{dict(zip(names.tolist(), counts.tolist(), strict=True))}."
            )
        self.scaler_ = StandardScaler().fit(examples)
        scaled = self.scaler_.transform(examples)
        group = np.arange(len(labels)) if groups is None else np.asarray(groups)
        machine: Any = KernelRidgeClassifier()
        if self.classifier is not None:
            machine = FromProbabilities(self.classifier)
        self.classifier_ = machine.fit(scaled, labels, groups=group)
        self.classes_ = names
        left_out = left_out_log_likelihood(self.classifier_)
        self.sequence_calibration_ = fit_sequence_calibration(
            with_floor(left_out, self.floor),
            np.searchsorted(names, labels),
            draw_all(labels, group, self.random_state),
            np.full(len(names), -np.log(len(names))),
        )
        return self

    def log_likelihood(self, X: ArrayLike, classes: Array) -> Floats:
        """Return log p(example | object) up to a constant, a column for each class.

        With its floor. An object that it does not know gets the mean over those of
        `classes` that it knows, so that it is neither favoured nor ruled out.
        """
        examples = check_array(X, dtype=np.float64)
        known = self.classifier_.log_likelihood(self.scaler_.transform(examples))
        floored = with_floor(known, self.floor)
        asked = np.isin(self.classes_, classes)
        if not asked.any():
            return np.zeros((len(examples), len(classes)))
        mean = np.log(np.exp(floored[:, asked]).mean(axis=1, keepdims=True))
        result = np.repeat(mean, len(classes), axis=1)
        place = {str(name): k for k, name in enumerate(self.classes_)}
        for column, name in enumerate(classes):
            if str(name) in place:
                result[:, column] = floored[:, place[str(name)]]
        return result


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


def draw_episodes(
    episode_of: Array, group: Array, n_touches: int, rng: np.random.Generator
) -> Indices:
    """Draw episodes as rows of touch numbers, shape (n_episodes, n_touches).

    The touches of an episode come from one block, or from as few neighbouring
    ones as hold them: a visit to an object is rarely spread over a whole
    recording. Objects with fewer touches are left out.
    """
    each = _in_order(episode_of, group)
    return _drawn(each, n_touches, _n_each(each), rng)


def _in_order(objects: Array, group: Array) -> InBlocks:
    """Return each object's touches block by block, and where blocks begin and end."""
    order = np.lexsort((group, np.unique(objects, return_inverse=True)[1]))
    ends = np.flatnonzero(objects[order][1:] != objects[order][:-1]) + 1
    return [
        (rows, np.array([0, *(np.flatnonzero(np.diff(group[rows])) + 1), len(rows)]))
        for rows in np.split(order, ends)
    ]


def _n_each(objects: InBlocks, n_known: int = 1) -> int:
    in_all = min(IN_ALL, ANSWERS // n_known)
    return min(EPISODES_PER_OBJECT, max(1, in_all // len(objects)))


def _drawn(
    objects: InBlocks, n_touches: int, n_each: int, rng: np.random.Generator
) -> Indices:
    episodes = [np.empty((0, n_touches), dtype=np.intp)]
    for rows, ends in objects:
        if len(rows) < n_touches:
            continue
        start = rng.integers(len(ends) - 1, size=n_each)
        n_own = np.diff(ends)[start]
        enough = np.minimum(-(-n_touches // n_own) * n_own, len(rows))
        # Touches of the blocks in the order of random numbers, those beyond them last.
        order = rng.random((n_each, enough.max()))
        order[np.arange(enough.max()) >= enough[:, np.newaxis]] = np.inf
        chosen = np.argsort(order, axis=1)[:, :n_touches]
        episodes.append(rows[(ends[start, np.newaxis] + chosen) % len(rows)])
    return np.concatenate(episodes)


def draw_all(
    objects: Array, group: Array, seed: int, n_known: int = 1
) -> dict[int, Array]:
    """Draw episodes of all lengths for which some object has the touches.

    Fewer where very many objects are known (`n_known`).
    """
    rng, each = np.random.default_rng(seed), _in_order(objects, group)
    drawn = {k: _drawn(each, k, _n_each(each, n_known), rng) for k in LENGTHS}
    return {k: rows for k, rows in drawn.items() if len(rows)}


def draw_asked(
    objects: Array, group: Array, seed: int, n_known: int = 1
) -> list[Indices]:
    """Draw long episodes of each object, (n_episodes, n_touches), -1 after their end.

    Like those of `draw_episodes`, each as long as its object has touches, up to
    `LONGEST`; `IN_ALL` of all objects together, and of very many objects, of some, as
    fewer where very many are known (`n_known`).
    """
    rng, blocks = np.random.default_rng(seed), _in_order(objects, group)
    in_all = min(IN_ALL, ANSWERS // n_known)
    spread = np.unique(np.linspace(0, len(blocks) - 1, in_all).astype(int))
    blocks = [blocks[k] for k in spread]
    longest = min(LONGEST, max(len(rows) for rows, _ in blocks))
    drawn = []
    for one_object in blocks:
        n_touches = min(longest, len(one_object[0]))
        rows = _drawn([one_object], n_touches, in_all // len(blocks), rng)
        over = ((0, 0), (0, longest - n_touches))
        drawn.append(np.pad(rows, over, constant_values=-1))
    return drawn


def fit_sequence_calibration(
    floored: Floats, codes: Array, episodes: dict[int, Array], log_prior: Floats
) -> SequenceCalibration:
    """Return the calibration of least log loss over episodes of all lengths."""
    drawn = episodes.values()
    used = is_informative(floored)
    # A row for each episode, with a one for each of its touches.
    touches = np.concatenate([rows.ravel() for rows in drawn])
    lengths = np.repeat([rows.shape[1] for rows in drawn], [len(r) for r in drawn])
    ends = np.concatenate([[0], np.cumsum(lengths)])
    sums = csr_array((np.ones(len(touches)), touches, ends), (len(ends) - 1, len(used)))
    total, count = sums @ floored, sums @ used.astype(float)
    others = np.maximum(count - 1, 0)
    truth = np.concatenate([codes[rows[:, 0]] for rows in drawn])
    # Every length counts the same.
    share = np.concatenate([np.full(len(e), 1 / len(e) / len(drawn)) for e in drawn])

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
