"""What users bring of their own: encodings, and other senses of the same objects.

An encoding is any transformer of images, checked at every step out. Another sense
(photographs, weights, where it was touched) has its own training examples and its own
classifier, and what it says enters the same belief, weighted as its left-out examples
say that it adds up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils import check_array, get_tags

from .._checks import check_label_kinds, check_number, one_each
from .._numbers import with_floor
from .._types import Array, Floats
from ..classifiers import FromProbabilities, KernelRidgeClassifier
from ._calibration import (
    draw_episodes,
    fit_sequence_calibration,
    left_out_log_likelihood,
)

# What a user may give as one encoding: a transformer, or several, one after the other.
Encoding = Any
MAX_FEATURES = 100_000
# A model that is read must encode its first touch as it did, but for rounding.
_ROUNDING = 1e-3


class UserEncoding(TransformerMixin, BaseEstimator):
    """Transformers of the user's own, one after the other, checked at every step out.

    Parameters
    ----------
    name : str
        What the user calls the encoding.
    steps : sequence of transformers
        The first takes images, the others what the one before makes of them.

    Attributes
    ----------
    steps_ : list of transformers
        As learnt.
    width_ : int
        Number of features.
    first_image_, first_features_ : ndarray
        The first image seen by `fit`, and what becomes of it: with foreign code that is
        given again, a model must still make that of it.
    """

    def __init__(self, name: str, steps: Sequence[Any]) -> None:
        self.name = name
        self.steps = steps

    @property
    def blind_to(self) -> frozenset[str]:
        """What the features do not change under, as far as steps say it."""
        return frozenset().union(*(getattr(s, "blind_to", ()) for s in self.steps))

    def fit(self, X: Array, y: object = None) -> Self:
        """Learn each step from images."""
        self.fit_transform(X)
        return self

    def fit_transform(self, X: Array, y: object = None, **fit_params: Any) -> Floats:
        """Learn each step from images (n_touches, ...), and return the features."""
        values, self.steps_ = X, []
        for recipe in self.steps:
            step = clone(recipe, safe=False)
            step.fit(values)
            self.steps_.append(step)
            values = step.transform(values)
        features = self._checked(values, len(X))
        self.width_ = features.shape[1]
        self.first_image_, self.first_features_ = X[0].copy(), features[0].copy()
        # An encoding that learns of the touches it is asked about is found out here.
        self._compare("alone, as it did among others", features)
        return features

    def transform(self, X: Array) -> Floats:
        """Return the features, shape (n_touches, width_), or say what is wrong."""
        values = X
        for step in self.steps_:
            values = step.transform(values)
        features = self._checked(values, len(X))
        if features.shape[1] != self.width_:
            raise ValueError(
                f"encodings[{self.name!r}] must give {self.width_} features, as when "
                f"it was learnt, got {features.shape[1]}."
            )
        return features

    def check_again(self) -> None:
        """Refuse steps that do not make of the first touch what the learnt ones did."""
        self._compare(
            "as it did when it was learnt; give the same parameters, or itself as it "
            "was fitted",
            self.first_features_[np.newaxis],
        )

    def stored(self) -> Self:
        """Return this as a model file keeps it, its recipe as it was learnt."""
        other = copy(self)
        if hasattr(self, "steps_"):
            other.steps = self.steps_
        return other

    def _compare(self, how: str, features: Floats) -> None:
        again = self.transform(self.first_image_[np.newaxis])[0]
        reach = max(1e-12, float(np.abs(features).max()))
        if not np.allclose(again, features[0], rtol=_ROUNDING, atol=_ROUNDING * reach):
            raise ValueError(
                f"encodings[{self.name!r}] must encode a touch {how}, got other "
                "features."
            )

    def _checked(self, values: Any, n_touches: int) -> Floats:
        """Return what the last step made as features, or explain."""
        dense = values.toarray() if hasattr(values, "toarray") else np.asarray(values)
        if dense.ndim != 2 or dense.dtype.kind not in "biuf" or not dense.shape[1]:
            raise ValueError(
                f"encodings[{self.name!r}] must give numbers (n_touches, n_features), "
                f"got {dense.dtype} of shape {dense.shape}. Its last step must give "
                "one vector for each touch."
            )
        if len(dense) != n_touches or dense.shape[1] > MAX_FEATURES:
            raise ValueError(
                f"encodings[{self.name!r}] must give {n_touches} rows, one for each "
                f"touch, of at most {MAX_FEATURES} features, got shape {dense.shape}."
            )
        features = np.asarray(dense, dtype=np.float64)
        if not np.isfinite(features).all():
            row = int(np.flatnonzero(~np.isfinite(features).all(axis=1))[0])
            raise ValueError(
                f"encodings[{self.name!r}] must give finite features, got NaN or "
                f"infinity for touch {row}."
            )
        return features


def user_encodings(encodings: Mapping[str, Encoding] | None) -> dict[str, UserEncoding]:
    """Return encodings of the user's own by their names, not learnt, or explain."""
    if encodings is None:
        return {}
    if not isinstance(encodings, Mapping):
        raise TypeError(
            "encodings must map names to transformers of images, got "
            f"{type(encodings).__name__}. Write encodings={{'mine': ...}}."
        )
    checked = {}
    for name, recipe in encodings.items():
        steps = list(recipe) if isinstance(recipe, list | tuple) else [recipe]
        # A file keeps what steps have learnt, of a pipeline nothing.
        steps = [part for step in steps for part in _parts_of(step)]
        if not isinstance(name, str) or not name or not steps:
            raise ValueError(
                "encodings must have texts as names and a transformer each, got "
                f"{name!r}: {recipe!r}."
            )
        for step in steps:
            if isinstance(step, type) or not (
                hasattr(step, "fit") and hasattr(step, "transform")
            ):
                raise TypeError(
                    f"encodings[{name!r}] must be a transformer with fit and "
                    f"transform, or a list of them, got {step!r}."
                )
            has_tags = hasattr(step, "__sklearn_tags__")
            if has_tags and get_tags(step).target_tags.required:
                raise TypeError(
                    f"encodings[{name!r}] must learn without labels, got {step!r}. Put "
                    "it before a classifier: classifier=make_pipeline(...)."
                )
        already = len(steps) == 1 and isinstance(steps[0], UserEncoding)
        checked[name] = UserEncoding(name, steps[0].steps if already else steps)
    return checked


def _parts_of(step: Any) -> list[Any]:
    """Return the transformers of a pipeline, those in it too, else the step."""
    if not isinstance(step, Pipeline):
        return [step]
    steps = [part for _, part in step.steps if part not in (None, "passthrough")]
    return [part for each in steps for part in _parts_of(each)]


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
        check_label_kinds(y)
        check_array(y, ensure_2d=False, dtype=None, input_name="y")
        labels = one_each("y", y, len(examples), "examples").astype(str)
        names, counts = np.unique(labels, return_counts=True)
        if len(names) < 2 or counts.min() < 2:
            raise ValueError(
                "y must hold at least two labels of two examples each, got "
                f"{dict(zip(names.tolist(), counts.tolist(), strict=True))}."
            )
        self.scaler_ = StandardScaler().fit(examples)
        scaled = self.scaler_.transform(examples)
        group = np.arange(len(labels)) if groups is None else np.asarray(groups)
        classifier: Any = KernelRidgeClassifier()
        if self.classifier is not None:
            classifier = FromProbabilities(self.classifier)
        self.classifier_ = classifier.fit(scaled, labels, groups=group)
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
        n_features = self.scaler_.n_features_in_
        if examples.shape[1] != n_features:
            raise ValueError(
                f"X must have {n_features} features, as the examples that were learnt, "
                f"got {examples.shape[1]}."
            )
        of_examples = self.classifier_.log_likelihood(self.scaler_.transform(examples))
        floored = with_floor(of_examples, self.floor)
        is_asked = np.isin(self.classes_, classes)
        if not is_asked.any():
            return np.zeros((len(examples), len(classes)))
        mean = np.log(np.exp(floored[:, is_asked]).mean(axis=1, keepdims=True))
        result = np.repeat(mean, len(classes), axis=1)
        is_known = np.isin(classes, self.classes_)
        columns = np.searchsorted(self.classes_, classes[is_known])
        result[:, is_known] = floored[:, columns]
        return result
