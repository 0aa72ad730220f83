"""What a belief asks of a classifier: `TouchClassifier`, and a wrapper that any keeps.

Beside that, the checks that the classifiers of feature vectors share.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, Self, TypeGuard, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, ClassifierMixin, clone
from sklearn.utils.validation import check_is_fitted, validate_data

from .._checks import (
    PLAIN_LABELS,
    as_groups,
    check_label_kinds,
    check_targets,
    is_plain,
)
from .._numbers import evenly_spaced, log_softmax
from .._types import Array, Floats, Indices

# What each training touch is left out with: (n_touches,), by default itself alone.
Groups = ArrayLike | None
# What a classifier without parts calls itself among weights.
ONE_PART = "classifier"
_N_FOLDS = 5
_LEAST_PROBABILITY = 1e-12
# Of more left-out answers, one for each touch and label, only a part is kept: all or
# some touches of so many labels at least.
MOST_ANSWERS, LEAST_LABELS = 5_000_000, 25


@runtime_checkable
class TouchClassifier(Protocol):
    """A classifier of feature vectors that a belief can be built on.

    Attributes
    ----------
    classes_ : ndarray of shape (n_objects,)
        The labels, sorted; the columns of every log-likelihood.
    part_weights : mapping of str to float
        How much each part of the classifier weighs, at least 0. `BayesRule` brings
        this, and what is asked by part, for a classifier that has no parts.
    """

    classes_: Array

    @property
    def part_weights(self) -> Mapping[str, float]:
        """Weight of each part, by its name."""
        ...

    def fit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Learn touches; those of one group are left out together.

        Parameters
        ----------
        X : array-like of shape (n_touches, n_features)
            Feature vectors of the touches.
        y : array-like of shape (n_touches,)
            Their labels: one object each.
        groups : array-like of shape (n_touches,), optional
            Touches of one group (a block of a recording, an object) are left out
            together; by default every touch is a group of its own.

        Raises
        ------
        ValueError, TypeError
            For NaN, infinity, unequal lengths, or labels of several kinds.
        """
        ...

    def refit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Learn other touches with the widths and weights that `fit` chose."""
        ...

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats)."""
        ...

    def log_likelihood_checked(self, touches: Floats) -> Floats:
        """Do what `log_likelihood` does, for a caller that has checked the touches.

        They are finite, of float64, and have as many features as `fit` saw.
        """
        ...

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of the training touches, their groups left out.

        Shape (n_left_out, n_objects), of the touches `left_out_rows`; minus infinity
        where no touch of an object is left.
        """
        ...

    @property
    def left_out_rows(self) -> Indices:
        """Which training touches, as given to `fit`, are told of when left out.

        Shape (n_left_out,), rising; all of them, unless there are very many.
        """
        ...

    def log_likelihood_by_part(self, X: ArrayLike) -> Floats:
        """Return `log_likelihood` of each part alone, (n_parts, n_touches, n_objects).

        In the order of `part_weights`.
        """
        ...

    def left_out_by_part(self) -> Floats:
        """Return `left_out_log_likelihood` of each part alone, with parts as above."""
        ...

    def pooled(self, by_part: Floats) -> Floats:
        """Return `log_likelihood` from those of each part."""
        ...


class BayesRule(ClassifierMixin, BaseEstimator):
    """A classifier that has `classes_` and `log_likelihood`, and needs no more.

    It brings the predictions, and a `TouchClassifier` of one part: with `fit`, `refit`
    and `left_out_log_likelihood` a subclass is complete. With the parameter
    `prior="counts"` and `counts_` (n_objects,), objects are as probable before the
    touch as they were frequent in training; else equally probable.
    """

    classes_: Array
    counts_: Indices
    prior = "uniform"
    # Whether `refit` takes what each touch counts, `weights` (n_touches,).
    takes_weights = False

    @property
    def part_weights(self) -> Mapping[str, float]:
        """Weight of each part, by its name: of the one part there is, 1."""
        return {ONE_PART: 1.0}

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats)."""
        raise NotImplementedError

    def log_likelihood_checked(self, touches: Floats) -> Floats:
        """Do what `log_likelihood` does, for a caller that has checked the touches."""
        return self.log_likelihood(touches)

    def log_likelihood_by_part(self, X: ArrayLike) -> Floats:
        """Return `log_likelihood` as that of one part, (1, n_touches, n_objects)."""
        return self.log_likelihood(X)[np.newaxis]

    @property
    def left_out_rows(self) -> Indices:
        """Rows of the training touches left out: `left_out_rows_`, or all."""
        whole: Any = self
        if hasattr(whole, "left_out_rows_"):
            return np.array(whole.left_out_rows_)
        return np.arange(len(whole.left_out_log_likelihood()))

    def left_out_by_part(self) -> Floats:
        """Return `left_out_log_likelihood` as that of one part."""
        whole: Any = self
        return np.asarray(whole.left_out_log_likelihood())[np.newaxis]

    def pooled(self, by_part: Floats) -> Floats:
        """Return the log-likelihood of the one part."""
        return np.asarray(by_part[0])

    def predict_log_proba(self, X: ArrayLike) -> Floats:
        """Return the log posterior of the objects, (n_touches, n_objects)."""
        return np.asarray(log_softmax(self._log_joint(X), axis=1))

    def predict_proba(self, X: ArrayLike) -> Floats:
        """Return the posterior of the objects, (n_touches, n_objects)."""
        return np.exp(self.predict_log_proba(X))

    def predict(self, X: ArrayLike) -> Array:
        """Return the most probable object of each touch, the first of equals."""
        best = self._log_joint(X).argmax(axis=1)
        return np.asarray(self.classes_[best])

    def _log_joint(self, X: ArrayLike) -> Floats:
        log_likelihood = self.log_likelihood(X)
        if self.prior == "uniform":
            return log_likelihood
        return np.asarray(log_likelihood + np.log(self.counts_ / self.counts_.sum()))


class FromProbabilities(BayesRule):
    """Any classifier with `predict_proba` as a `TouchClassifier`.

    Its posterior is taken as the one under equal priors, and kept above 1e-12. Left-out
    touches are recognised by classifiers that learnt the other folds of each label.

    Parameters
    ----------
    classifier : classifier
        With `fit` and `predict_proba`, for feature vectors.

    Attributes
    ----------
    classes_ : ndarray of shape (n_objects,)
        The labels, sorted.
    classifier_ : classifier
        Learnt from all touches.
    touches_, labels_, groups_ : ndarray of n_touches rows
        The training touches, kept for `left_out_log_likelihood`.

    Examples
    --------
    >>> from sklearn.naive_bayes import GaussianNB
    >>> from palpate.classifiers import FromProbabilities
    >>> model = FromProbabilities(GaussianNB())
    >>> model.fit([[0], [1], [5], [6]], ["pen", "pen", "mug", "mug"]).predict([[4]])
    array(['mug'], dtype='<U3')
    """

    def __init__(self, classifier: Any) -> None:
        self.classifier = classifier

    def fit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Learn touches (n_touches, n_features); see `TouchClassifier.fit`.

        Raises
        ------
        TypeError
            The classifier has no `predict_proba`.
        """
        if not hasattr(self.classifier, "predict_proba"):
            raise TypeError(
                "classifier must have predict_proba, got "
                f"{type(self.classifier).__name__}. Wrap it in CalibratedClassifierCV."
            )
        self.touches_, self.labels_ = map(np.array, labelled_touches(self, X, y))
        self.groups_ = as_groups(groups, len(self.touches_))
        self.classifier_ = clone(self.classifier).fit(self.touches_, self.labels_)
        self.classes_ = np.asarray(self.classifier_.classes_)
        return self

    def refit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Learn other touches; what the classifier chooses it chooses again."""
        return self.fit(X, y, groups)

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return the logarithm of `predict_proba`, (n_touches, n_objects)."""
        touches = as_touches(self, X)
        return _log_probability(self.classifier_, touches)

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of training touches with their folds left out."""
        check_is_fitted(self)
        result = np.full((len(self.touches_), len(self.classes_)), -np.inf)
        met = np.zeros((self.groups_.max() + 1, len(self.classes_)), dtype=np.intp)
        met[self.groups_, np.searchsorted(self.classes_, self.labels_)] = 1
        # Each group goes where its labels have fewest, so each fold keeps all labels.
        in_folds = np.zeros((_N_FOLDS, len(self.classes_)), dtype=np.intp)
        of_group = np.zeros(len(met), dtype=np.intp)
        for group, labels in enumerate(met):
            of_group[group] = (in_folds @ labels).argmin()
            in_folds[of_group[group]] += labels
        fold_of = of_group[self.groups_]
        for fold in np.unique(fold_of):
            train = np.flatnonzero(fold_of != fold)
            test = np.flatnonzero(fold_of == fold)
            if len(np.unique(self.labels_[train])) < 2:
                continue
            refitted = clone(self.classifier).fit(
                self.touches_[train], self.labels_[train]
            )
            columns = np.searchsorted(self.classes_, refitted.classes_)
            log_probability = _log_probability(refitted, self.touches_[test])
            result[np.ix_(test, columns)] = log_probability
        return result


def labelled_touches(
    estimator: BaseEstimator, X: ArrayLike, y: ArrayLike, *, reset: bool = True
) -> tuple[Floats, Array]:
    """Return `X` as touches and `y` as labels, or raise as `validate_data` does.

    Not `reset`, the touches must be like those of `fit`, which was called.
    """
    if not reset:
        check_is_fitted(estimator)
    check_label_kinds(y)
    if (
        not reset
        and _is_as_in_fit(estimator, X)
        and type(y) is np.ndarray
        and y.dtype.kind in PLAIN_LABELS
        and y.shape == np.shape(X)[:1]
    ):
        return np.asarray(X), y
    touches, labels = validate_data(estimator, X, y, dtype=np.float64, reset=reset)
    check_targets(labels)
    return touches, labels


def classes_of(labels: Array, *, least: int = 2) -> tuple[Array, Indices]:
    """Return the labels that occur, sorted, and the place of each touch's among them.

    A label alone is refused, unless `least` is 1.
    """
    classes, codes = np.unique(labels, return_inverse=True)
    if len(classes) < least:
        raise ValueError(
            f"y must hold at least two labels, got 1 class: {classes[0]}. Add touches "
            "of another."
        )
    return classes, codes


def as_touches(estimator: BaseEstimator, X: ArrayLike) -> Floats:
    """Return `X` as in `fit`, which was called, or raise as `validate_data` does."""
    if _is_as_in_fit(estimator, X):
        return np.asarray(X)
    check_is_fitted(estimator)
    return np.asarray(validate_data(estimator, X, dtype=np.float64, reset=False))


def _is_as_in_fit(estimator: BaseEstimator, X: object) -> TypeGuard[Floats]:
    """Whether `X` is plain, of as many features as were learnt, which had no names."""
    n_features = getattr(estimator, "n_features_in_", -1)
    named = hasattr(estimator, "feature_names_in_")
    return not named and is_plain(X, n_axes=2) and X.shape[1] == n_features


def rows_left_out(codes: Array, groups: Indices) -> Indices:
    """Return which training touches to leave out in turn, shape (n_left_out,).

    All, but of so many touches and labels that their answers would fill memory, a part:
    of some labels, evenly spread, the touches of their first groups, whole groups where
    there is room. Of the column `codes` of each touch's label and its group.
    """
    n_touches, n_labels = len(codes), int(codes.max()) + 1
    if n_touches * n_labels <= MOST_ANSWERS:
        return np.arange(n_touches)
    most = max(MOST_ANSWERS // n_labels, 2)
    n_chosen = min(n_labels, max(LEAST_LABELS, most * n_labels // n_touches))
    chosen = evenly_spaced(n_labels, n_chosen)
    order = np.lexsort((groups, codes))
    starts = np.searchsorted(codes[order], chosen)
    ends = np.searchsorted(codes[order], chosen, side="right")
    quota = max(2, most // len(chosen))
    parts = [order[a : min(a + quota, b)] for a, b in zip(starts, ends, strict=True)]
    return np.sort(np.concatenate(parts))


def _log_probability(classifier: Any, touches: Floats) -> Floats:
    probability = np.clip(classifier.predict_proba(touches), _LEAST_PROBABILITY, None)
    return np.asarray(np.log(probability))
