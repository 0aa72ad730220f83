"""Kernel ridge classification with everything a belief needs in closed form.

Least squares on one-hot labels in the space of a Gaussian kernel. What makes it
worth having: the answer the machine WOULD give to a touch, had a whole group of
touches (a block of a recording, an object) never been learnt, follows from the
inverse that training computes anyway. So the kernel width, the ridge and the
temperature of the posterior are all chosen on touches left out with their group,
without a single further fit.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import ArrayLike
from sklearn.metrics.pairwise import euclidean_distances
from sklearn.utils.validation import check_is_fitted

from .._checks import as_groups, check_count, check_positive, check_squarable
from .._numbers import exp, log_softmax
from .._types import Array, Floats
from ._landmarks import LandmarkRegression, Landmarks, Sums
from ._ridge import (
    GROWTH,
    USUAL_SHAPE,
    USUAL_TEMPERATURE,
    GrowingInverse,
    best_shape,
    inverse_blocks,
    left_out_scores,
    log_counts_of,
    rows_by_size,
    smoothed_loss,
    solve_ridge,
    squared_distances,
)
from ._touch_classifier import (
    BayesRule,
    Groups,
    as_touches,
    classes_of,
    labelled_touches,
    rows_left_out,
)

# Temperature and bend of the posterior are fitted to at most so many touches, and so
# many of their answers, one for each label.
_SHAPED_BY, _SHAPED_ANSWERS = 2000, 500_000
# More touches than this, or more targets (one for each touch and label), are learnt by
# landmarks.
MAX_TOUCHES, _MOST_TARGETS = 10_000, 20_000_000
# From so many touches to so many, learning a few more costs a few columns; in memory 4
# bytes for each pair.
_GROWS_FROM, _GROWS_TO = 500, 5000


class KernelRidgeClassifier(BayesRule):
    """Gaussian-kernel ridge regression on labels, with a calibrated posterior.

    Parameters
    ----------
    widths : sequence of float, default=(0.5, 1.0, 2.0, 4.0)
        Candidate kernel widths g of exp(-g d^2 / m), with m the median squared
        distance between training touches.
    ridges : sequence of float, default=(0.003, 0.01, 0.03, 0.1, 0.3)
        Candidate ridges, added to the diagonal of the kernel matrix; tried upwards and
        downwards from the best of the width before, as long as the loss falls.
    max_choice_touches : int, default=1500
        With more training touches than this, width and ridge are chosen on an
        evenly spaced part of them; the final machine learns from all.
    max_touches : int, default=10000
        Up to this many training touches every one has a kernel function of its own;
        memory grows with the square of their number (8 bytes n^2, twice over).
        Of more, or of as many labels as make 20 million targets, some are landmarks
        for all (Nystroem features).
    n_landmarks : int, default=2000
        How many, evenly spaced over each label.

    Attributes
    ----------
    classes_ : ndarray of shape (n_classes,)
        The labels, sorted.
    width_, ridge_ : float
        The chosen pair.
    log_loss_ : float
        Mean negative log posterior of the true label (nats) of the touches left
        out with their group, at the chosen pair.
    temperature_, bend_ : float
        Scores s enter the softmax as temperature s / (1 + bend |s|): regression
        scores of sure touches are too large for a factor alone.
    lean_ : float
        How much the scores lean towards labels of many training touches: at least 1,
        as probabilities do.
    log_counts_ : ndarray of shape (n_classes,)
        Logarithms of the numbers of training touches, times `lean_`; subtracted, so
        that posteriors are those under equal priors.
    left_out_scores_ : ndarray of shape (n_left_out, n_classes)
        Regression scores of training touches, each with its group left out.
    left_out_rows_ : ndarray of shape (n_left_out,)
        Which training touches these are: all, unless there are very many.
    mean_ : ndarray of shape (n_features,)
        Mean of the training touches.
    touches_, squared_norms_, coefficients_ : ndarray
        Training touches or landmarks less the mean (n_kept, n_features), their squared
        lengths (n_kept,) and coefficients (n_kept, n_classes).

    Notes
    -----
    With G = (K + ridge I)^-1, targets T and coefficients A = G T, the residuals
    of a group g that was left out are inv(G[g, g]) A[g]: the block form of the
    leave-one-out identity of ridge regression [1]_. The mean target is fixed at
    1 / n_classes, so the identity is exact.

    References
    ----------
    .. [1] G. C. Cawley and N. L. C. Talbot, "Fast exact leave-one-out
       cross-validation of sparse least-squares support vector machines",
       Neural Networks 17(10), 2004. doi:10.1016/j.neunet.2004.07.002

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.classifiers import KernelRidgeClassifier
    >>> X = np.r_[np.zeros((5, 2)), np.ones((5, 2))] + 0.1 * np.eye(10, 2)
    >>> KernelRidgeClassifier().fit(X, ["pen"] * 5 + ["mug"] * 5).predict([[1, 1]])
    array(['mug'], dtype='<U3')
    """

    classes_: Array
    coefficients_: Array
    temperature_: float
    bend_: float
    lean_: float
    sums_: Sums
    takes_weights = True
    # What makes learning more of it quick: of all touches, or of landmarks.
    _inverse: GrowingInverse | None = None
    _summed: LandmarkRegression | None = None

    def __init__(
        self,
        widths: Iterable[float] = (0.5, 1.0, 2.0, 4.0),
        ridges: Iterable[float] = (0.003, 0.01, 0.03, 0.1, 0.3),
        max_choice_touches: int = 1500,
        max_touches: int = MAX_TOUCHES,
        n_landmarks: int = 2000,
    ) -> None:
        self.widths = widths
        self.ridges = ridges
        self.max_choice_touches = max_choice_touches
        self.max_touches = max_touches
        self.n_landmarks = n_landmarks

    @staticmethod
    def learns_by_landmarks(
        n_touches: int, n_labels: int, max_touches: int = MAX_TOUCHES
    ) -> bool:
        """Return whether some of so many touches stand for all."""
        return n_touches > max_touches or n_touches * n_labels > _MOST_TARGETS

    def fit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Choose width, ridge and temperature on left-out groups; learn from all.

        Parameters are those of `TouchClassifier.fit`; features of `X` (n_touches,
        n_features) are roughly of unit scale, labels `y` at least two different ones.

        Raises
        ------
        ValueError
            For fewer than two labels, NaN, features above 1e150 in size, or arrays
            of unequal length.
        TypeError
            For labels that are partly text, partly something else.
        """
        touches, codes, group = self._validated_input(X, y, groups)
        self._choose(touches, codes, group)
        self._inverse = self._summed = None
        self._learn(touches, codes, group, np.ones(len(touches)))
        return self

    def _validated_input(
        self, X: ArrayLike, y: ArrayLike, groups: Groups, reset: bool = True
    ) -> tuple[Floats, Array, Array]:
        touches, labels = labelled_touches(self, X, y, reset=reset)
        check_squarable(touches)
        classes, codes = classes_of(labels, least=2 if reset else 1)
        group = as_groups(groups, len(touches))
        self.classes_ = classes
        return touches, codes, group

    def _choose(self, touches: Floats, codes: Array, group: Array) -> None:
        """Set `unit_`, `width_` and `ridge_` by the log loss of left-out groups."""
        widths = [check_positive("widths", w) for w in self.widths]
        ridges = sorted(check_positive("ridges", r) for r in self.ridges)
        if not widths or not ridges:
            raise ValueError("widths and ridges must hold at least one value each.")
        at_most = check_count("max_choice_touches", self.max_choice_touches, at_least=2)
        # Touches of all labels, or of every k-th where fewer than 4 of each fit.
        many = len(codes) > at_most
        step = -(-4 * (int(codes.max()) + 1) // at_most) if many else 1
        of_these_labels = np.flatnonzero(codes % step == 0)
        sampled = of_these_labels[_thin(codes[of_these_labels], at_most)]
        codes = np.unique(codes[sampled], return_inverse=True)[1]
        chosen = touches[sampled]
        squared = squared_distances(chosen - chosen.mean(axis=0))
        self.unit_ = float(np.median(squared)) or 1.0
        target = _one_hot(codes, codes.max() + 1)
        by_size = rows_by_size(group[sampled])
        best, at, temperature = np.inf, len(ridges) // 2, USUAL_TEMPERATURE
        for width in widths:
            kernel = -width / self.unit_ * squared
            exp(kernel, out=kernel)

            @cache
            def loss(k: int, kernel: Floats = kernel) -> float:
                nonlocal temperature  # near that of the last ridge
                root, coefficients = solve_ridge(kernel.copy(), target, ridges[k])
                blocks = inverse_blocks(root, by_size)
                scores = left_out_scores(blocks, coefficients, target)
                value, temperature = smoothed_loss(scores, codes, temperature)
                return value

            # From the ridge that was best for the width before, as long as it falls.
            for way in (1, -1):
                while 0 <= at + way < len(ridges) and loss(at + way) < loss(at):
                    at += way
            if loss(at) < best:
                best, self.width_, self.ridge_ = loss(at), width, ridges[at]

    def _learn(
        self,
        touches: Floats,
        codes: Array,
        group: Array,
        weights: Floats,
        keep_shape: bool = False,
    ) -> None:
        n_labels = len(self.classes_)
        at_most = check_count("max_touches", self.max_touches, at_least=2)
        self.left_out_rows_ = rows = rows_left_out(codes, group)
        start = USUAL_SHAPE
        if self.learns_by_landmarks(len(touches), n_labels, at_most):
            left_out = self._learn_by_landmarks(touches, codes, group)
        else:
            self._summed = None
            ridges = self.ridge_ / weights
            grown = self._grown(touches, codes, ridges)
            left_out = self._learn_from_all(touches, codes, group, ridges, grown)
            left_out = left_out[rows]
            if grown is not None:
                start = self.temperature_, self.bend_, self.lean_
        self.squared_norms_ = np.einsum("ij,ij->i", self.touches_, self.touches_)
        self.left_out_scores_, own_codes = left_out, codes[rows]
        sampled = _thin(own_codes, min(_SHAPED_BY, _SHAPED_ANSWERS // n_labels + 1))
        counts = np.bincount(codes, minlength=n_labels)
        if not keep_shape:
            shape, self.log_loss_ = best_shape(
                left_out[sampled], own_codes[sampled], counts, start
            )
            self.temperature_, self.bend_, self.lean_ = shape
        self.log_counts_ = self.lean_ * log_counts_of(counts)

    def _learn_from_all(
        self,
        touches: Floats,
        codes: Array,
        group: Array,
        ridges: Floats,
        grown: GrowingInverse | None,
    ) -> Floats:
        """Give every touch a kernel function; return left-out scores of all.

        With what is known of those before the last ones, if it has `grown` by these.
        """
        target, by_size = _one_hot(codes, len(self.classes_)), rows_by_size(group)
        self._inverse = grown
        if grown is not None:
            self.touches_ = grown.touches
            self.coefficients_ = grown.coefficients(target, self.classes_)
            return left_out_scores(grown.blocks(by_size), self.coefficients_, target)
        self.mean_ = touches.mean(axis=0)
        self.touches_ = touches - self.mean_
        kernel = self._kernel(squared_distances(self.touches_))
        # The columns of the labels as they are, of which later classes need others.
        root, columns = solve_ridge(kernel, target + 1 / len(self.classes_), ridges)
        self.coefficients_ = columns - columns.mean(axis=1, keepdims=True)
        blocks = inverse_blocks(root, by_size)
        if _GROWS_FROM <= len(touches) <= _GROWS_TO:
            blocks, labels = list(blocks), self.classes_[codes]
            self._inverse = GrowingInverse(
                root, self.touches_, labels, ridges, self.classes_, columns, blocks
            )
        return left_out_scores(blocks, self.coefficients_, target)

    def _learn_by_landmarks(self, touches: Floats, codes: Array, group: Array) -> Array:
        """Let some touches stand for all; return left-out scores of some."""
        self._inverse = None
        taught = touches, codes, self.classes_
        summed = self._summed and self._summed.again(taught)
        if summed is None:
            n_landmarks = check_count("n_landmarks", self.n_landmarks, at_least=2)
            self.mean_ = touches.mean(axis=0)
            chosen = _thin(codes, min(n_landmarks, len(codes)))
            self.touches_ = touches[chosen] - self.mean_
            summed = self._regression().learn(taught)
        self._summed = summed
        self.coefficients_ = summed.coefficients()
        return summed.left_out(self.coefficients_, group, self.left_out_rows_)

    def _grown(
        self, touches: Floats, codes: Array, ridges: Floats
    ) -> GrowingInverse | None:
        """Return the inverse with a few touches more than it has, None of others."""
        inverse = self._inverse
        if inverse is None or len(touches) > (1 + GROWTH) * inverse.n_first:
            return None
        centred, labels = touches - self.mean_, self.classes_[codes]
        if not inverse.begins(centred, labels, ridges):
            return None
        new = centred[len(inverse.touches) :]
        squared = euclidean_distances(new, centred, squared=True)
        kernel = self._kernel(squared)
        try:
            return inverse.plus(centred, labels, ridges, kernel)
        except LinAlgError:
            return None

    def _kernel(self, squared: Floats) -> Floats:
        """Turn squared distances into the kernel, in place."""
        squared *= -self.width_ / self.unit_
        return exp(squared, out=squared)

    def scores(self, X: ArrayLike) -> Floats:
        """Return the regression scores, shape (n_touches, n_classes); 1 is sure."""
        straight = copy(self)
        straight.temperature_, straight.bend_ = 1.0, 0.0
        straight.log_counts_ = np.zeros(())
        return straight._bent_scores(X)

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats).

        Shape (n_touches, n_classes). The posterior under equal priors, so each
        row is a likelihood but for a factor that no belief depends on.
        """
        return log_softmax(self._bent_scores(X))

    def _bent_scores(self, X: ArrayLike) -> Floats:
        return self.log_likelihood_checked(check_squarable(as_touches(self, X)))

    def log_likelihood_checked(self, touches: Floats) -> Floats:
        """Do what `log_likelihood` does, but for a constant of each touch."""
        centred = touches - self.mean_
        # One pass over the training touches: their own norms are known.
        squared = (-2 * centred) @ self.touches_.T
        squared += (centred**2).sum(axis=1)[:, np.newaxis]
        squared += self.squared_norms_
        np.maximum(squared, 0, out=squared)
        squared *= -self.width_ / self.unit_
        kernel = exp(squared, out=squared).astype(self.coefficients_.dtype, copy=False)
        scores = (kernel @ self.coefficients_).astype(np.float64, copy=False)
        scores = scores + 1 / len(self.classes_)
        bent = self.temperature_ * scores / (1 + self.bend_ * np.abs(scores))
        return np.asarray(bent - self.log_counts_)

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of training touches with their groups left out."""
        check_is_fitted(self)
        scores = self.left_out_scores_
        bent = self.temperature_ * scores / (1 + self.bend_ * np.abs(scores))
        return log_softmax(bent - self.log_counts_)

    def stored(self) -> Self:
        """Return what a model file holds: of landmarks, also sums that touches join."""
        if self._summed is None:
            return self
        other = copy(self)
        other.left_out_scores_ = self.left_out_scores_.astype(np.float32)
        other.sums_ = self._summed.sums()
        return other

    def resume(self, X: ArrayLike, y: ArrayLike) -> None:
        """Go on from the touches that were learnt before a model file was written.

        Raises
        ------
        ValueError
            The file's sums do not fit to its landmarks.
        """
        sums: Sums | None = self.__dict__.pop("sums_", None)
        if sums is None:
            return
        taught = np.asarray(X), np.searchsorted(self.classes_, y), self.classes_
        dtype = self.coefficients_.dtype
        self._summed = self._regression().resumed(sums, dtype, taught)

    def _regression(self) -> LandmarkRegression:
        landmarks = Landmarks(self.touches_, self.width_ / self.unit_)
        return LandmarkRegression(landmarks, self.mean_, self.ridge_)

    def refit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        groups: Groups = None,
        weights: Floats | None = None,
        keep_shape: bool = False,
    ) -> Self:
        """Learn other touches with the width and ridge already chosen.

        What each touch counts (`weights`, (n_touches,), above 0, by default 1) divides
        its ridge; touches that are learnt by landmarks all count 1. With `keep_shape`
        temperature, bend and lean of the posterior stay too: quicker, for a few more.
        """
        touches, codes, group = self._validated_input(X, y, groups, reset=False)
        each = np.ones(len(touches)) if weights is None else weights
        self._learn(touches, codes, group, each, keep_shape)
        return self

    def __copy__(self) -> Self:
        again = type(self).__new__(type(self))
        again.__dict__.update(self.__dict__)
        return again

    def __getstate__(self) -> dict[str, Any]:
        # These are larger than all the rest.
        state = super().__getstate__().items()
        return {k: v for k, v in state if k not in ("_inverse", "_summed")}


def _thin(codes: Array, at_most: int) -> Array:
    """Return every k-th touch of each label, for the least k that fits."""
    step = -(-len(codes) // at_most)
    return np.sort(np.argsort(codes, kind="stable")[::step])


def _one_hot(codes: Array, n_classes: int) -> Floats:
    """Targets minus their fixed mean of 1 / n_classes."""
    return np.eye(n_classes)[codes] - 1 / n_classes
