"""Another sense of the same objects: photographs, weights, where it was touched.

It has its own training examples and its own classifier, and what it says enters the
same belief, weighted as its left-out examples say that it adds up.
"""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator
from sklearn.preprocessing import StandardScaler
from sklearn.utils import check_array

from .._checks import check_number
from .._types import Array, Floats
from ..classifiers import FromProbabilities, KernelRidgeClassifier
from ._calibration import (
    draw_episodes,
    fit_sequence_calibration,
    left_out_log_likelihood,
)
from ._evidence import with_floor


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
        self.sequence_calibration_ = fit_sequence_calibration(
            with_floor(left_out_log_likelihood(self.classifier_), self.floor),
            np.searchsorted(names, labels),
            draw_episodes(labels, self.random_state, blocks=group),
            np.full(len(names), -np.log(len(names))),
        )
        return self

    def log_likelihood(self, X: ArrayLike, classes: Array) -> Floats:
        """Return log p(example | object) up to a constant, a column for each class.

        With its floor. An object that it does not know gets the mean over those of
        `classes` that it knows, so that it is neither favoured nor ruled out.
        """
        examples = check_array(X, dtype=np.float64)
        of_examples = self.classifier_.log_likelihood(self.scaler_.transform(examples))
        floored = with_floor(of_examples, self.floor)
        is_asked = np.isin(self.classes_, classes)
        if not is_asked.any():
            return np.zeros((len(examples), len(classes)))
        mean = np.log(np.exp(floored[:, is_asked]).mean(axis=1, keepdims=True))
        result = np.repeat(mean, len(classes), axis=1)
        place = {str(name): k for k, name in enumerate(self.classes_)}
        for column, name in enumerate(classes):
            if str(name) in place:
                result[:, column] = floored[:, place[str(name)]]
        return result
