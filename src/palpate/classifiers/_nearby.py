"""Very many labels of few touches each: only what lies near a touch tells.

Landmarks cannot tell more labels than there are landmarks, and a kernel matrix of all
touches does not fit in memory. Densities of each label's own touches need neither; they
make a short list, within which a ridge regression learnt on the spot decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from copy import copy
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dposv
from scipy.optimize import minimize_scalar
from sklearn.utils.validation import check_is_fitted

from .._checks import as_groups, check_squarable
from .._numbers import exp, log_softmax
from .._types import Bools, Floats, Indices, Singles
from ._kernel_ridge import KernelRidgeClassifier
from ._ridge import USUAL_SHAPE, best_shape, squared_distances_to
from ._touch_classifier import (
    BayesRule,
    Groups,
    as_touches,
    labelled_touches,
    rows_left_out,
)

# Widths that are tried, times the median distance from a touch to its nearest other.
_WIDTHS = (0.06, 0.12, 0.25, 0.5, 1.0)
# Pairs of touches whose distances are in memory at once.
_PAIRS_AT_ONCE = 20_000_000
# Logarithms of the least and largest temperature.
_TEMPERATURES = (-10.0, 3.0)
# Labels of the short list, and touches of them, the nearest, that its regression
# learns.
LISTED, _MOST_NEAR = 20, 400
# Width and ridge are chosen on touches of so many labels, so many touches.
_CHOSEN_ON, _CHOSEN_BY = 200, 800
# How much less than one of as many equal ones a label is at least (nats); tried.
_FLOORS, _USUAL_FLOOR = (1.0, 2.0, 3.0, 4.0, 6.0, 20.0), 3.0
# Answers, one for each touch and label, that the shape of the posterior is fitted to.
_SHAPED_ANSWERS = 2_000_000

# Of touches to be left out, and of those that are stored.
_Groups = tuple[Indices, Indices]


class NearbyTouches(BayesRule):
    """A short list by densities of labels' own touches, then ridge regression in it.

    For very many labels: learning is storing, in single precision. The widths, the
    ridge and the shape of both posteriors are those of least log loss of touches left
    out. The densities say how probable the list is as a whole, and each label outside
    it; the regression on the list's touches, which is made for each touch anew, shares
    out the list's probability.

    Attributes
    ----------
    classes_ : ndarray of shape (n_classes,)
        The labels, sorted.
    mean_ : ndarray of shape (n_features,)
        Mean of the training touches.
    touches_, squares_ : ndarray of shape (n_touches, n_features) and (n_touches,)
        Training touches less the mean, label by label, and their squared lengths.
    starts_ : ndarray of shape (n_classes,)
        Where each label's touches begin.
    width_, temperature_, floor_ : float
        Width of the Gaussians, the factor on log densities, and how much less than the
        nearest label any other may be then (nats): a touch may be of a place that was
        not met.
    scale_, ridge_, bent_ : float, float and tuple of two floats
        Of the regression: the factor on squared distances, the ridge, and temperature
        and bend of its scores.
    left_out_ : ndarray of shape (n_left_out, n_classes)
        Log posterior of training touches, each with its group left out.
    left_out_rows_ : ndarray of shape (n_left_out,)
        Which training touches these are, as given to `fit`.
    """

    width_: float
    temperature_: float
    floor_: float

    def fit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Store touches, and choose width and temperature on left-out groups.

        Parameters and errors as of `TouchClassifier.fit`.
        """
        queries, group, codes = self._stored(X, y, groups)
        nearest = []
        for squared, left_out in self._pairs(queries, group):
            squared[left_out] = np.inf
            nearest.append(squared.min(axis=1))
        least_squared = np.concatenate(nearest)
        # Of a group that holds all touches none is left to be near.
        met = least_squared[np.isfinite(least_squared)]
        unit = float(np.sqrt(np.median(met))) if len(met) else 0.0
        unit = unit or 1.0
        best, densities = np.inf, np.empty(0)
        for width in _WIDTHS:
            scores = self._densities(queries, width * unit, group)
            loss = _best_shape(scores, codes, [_USUAL_FLOOR])[0]
            if loss < best:
                best, self.width_, densities = loss, width * unit, scores
        _, self.temperature_, self.floor_ = _best_shape(densities, codes)
        self._choose_ridge(X, y, groups)
        self._learn_list(queries, group, densities, codes)
        return self

    def _choose_ridge(self, X: ArrayLike, y: ArrayLike, groups: Groups) -> None:
        """Choose width and ridge of the regression, on touches of some labels."""
        touches, labels = np.asarray(X, dtype=np.float64), np.asarray(y)
        group = as_groups(groups, len(touches))
        codes = np.searchsorted(self.classes_, labels)
        rows = np.flatnonzero(codes % max(1, len(self.classes_) // _CHOSEN_ON) == 0)
        regression = KernelRidgeClassifier(max_choice_touches=_CHOSEN_BY)
        regression.fit(touches[rows], labels[rows], groups=group[rows])
        self.scale_ = regression.width_ / regression.unit_
        self.ridge_ = regression.ridge_

    def _learn_list(
        self,
        queries: Singles,
        group: _Groups,
        densities: Floats,
        codes: Indices | None = None,
    ) -> None:
        """Set `left_out_`, and with the `codes` of labels the shape of what is in it.

        Of touches to be left out, and their log densities (n_left_out, n_classes).
        """
        log_posterior, lists = self._log_posterior(densities), _best_of(densities)
        pairs = zip(queries, lists, group[0], strict=True)
        scores = np.stack(
            [self._scores(query, labels, group[1] != g) for query, labels, g in pairs]
        )
        if codes is not None:
            is_own = lists == codes[:, np.newaxis]
            is_listed = is_own.any(axis=1)
            self.bent_ = USUAL_SHAPE[:2]
            if is_listed.any():
                counts = np.ones(lists.shape[1], dtype=np.intp)
                at = is_own[is_listed].argmax(axis=1)
                self.bent_ = best_shape(scores[is_listed], at, counts)[0][:2]
        left_out = self._shared_out(log_posterior, lists, scores)
        self.left_out_ = np.where(np.isneginf(densities), -np.inf, left_out)

    def _scores(
        self, centred: Singles, labels: Indices, kept: Bools | None = None
    ) -> Floats:
        """Return regression scores of one touch among some labels, (n_labels,).

        Learnt from touches of these labels that are `kept` (n_stored,).
        """
        ends = np.append(self.starts_[1:], len(self.touches_))[labels]
        pairs = zip(self.starts_[labels], ends, strict=True)
        parts = [np.arange(start, end) for start, end in pairs]
        rows = np.concatenate(parts)
        owners = np.repeat(np.arange(len(labels)), [len(part) for part in parts])
        if kept is not None:
            rows, owners = rows[kept[rows]], owners[kept[rows]]
        if not len(rows):
            return np.full(len(labels), 1 / len(labels))
        near = self.touches_[rows].astype(np.float64) - centred
        squares = np.einsum("ij,ij->i", near, near)
        if len(rows) > _MOST_NEAR:
            nearest = np.argpartition(squares, _MOST_NEAR)[:_MOST_NEAR]
            near, squares, owners = near[nearest], squares[nearest], owners[nearest]
        squared = near @ (-2 * near.T)
        squared += squares
        squared += squares[:, np.newaxis]
        kernel = exp(-self.scale_ * np.maximum(squared, 0))
        kernel.flat[:: len(kernel) + 1] += self.ridge_
        # One solution for the touch, instead of one for each label.
        weights = dposv(kernel.T, exp(-self.scale_ * squares), overwrite_a=1)[1]
        sums = np.bincount(owners, weights, minlength=len(labels))
        return np.asarray(sums + (1 - weights.sum()) / len(labels))

    def _shared_out(
        self, log_posterior: Floats, lists: Indices, scores: Floats
    ) -> Floats:
        """Return log posteriors in which scores share out the lists' probability."""
        temperature, bend = self.bent_
        within = log_softmax(temperature * scores / (1 + bend * np.abs(scores)))
        log_listed = np.take_along_axis(log_posterior, lists, axis=1)
        most = log_listed.max(axis=1, keepdims=True)
        total = most + np.log(exp(log_listed - most).sum(axis=1, keepdims=True))
        result = log_posterior.copy()
        np.put_along_axis(result, lists, total + within, axis=1)
        return result

    def refit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Store other touches, with the width and temperature already chosen."""
        queries, group, _ = self._stored(X, y, groups, reset=False)
        densities = self._densities(queries, self.width_, group)
        self._learn_list(queries, group, densities)
        return self

    def _stored(
        self, X: ArrayLike, y: ArrayLike, groups: Groups, reset: bool = True
    ) -> tuple[Singles, _Groups, Indices]:
        """Store touches; return those to be left out, groups, and label's columns."""
        touches, labels = labelled_touches(self, X, y, reset=reset)
        check_squarable(touches)
        self.classes_, codes = np.unique(labels, return_inverse=True)
        group = as_groups(groups, len(touches))
        order = np.argsort(codes, kind="stable")
        if reset:
            self.mean_ = touches.mean(axis=0)
        self.touches_ = (touches[order] - self.mean_).astype(np.float32)
        self.squares_ = np.einsum("ij,ij->i", self.touches_, self.touches_)
        self.starts_ = np.searchsorted(codes[order], np.arange(len(self.classes_)))
        self.left_out_rows_ = rows = rows_left_out(codes, group)
        queries = (touches[rows] - self.mean_).astype(np.float32)
        return queries, (group[rows], group[order]), codes[rows]

    def _pairs(
        self, queries: Singles, group: _Groups | None
    ) -> Iterator[tuple[Singles, Bools | None]]:
        """Yield squared distances to the stored touches, and which are left out."""
        at_once = max(1, _PAIRS_AT_ONCE // len(self.touches_))
        for k in range(0, len(queries), at_once):
            rows = slice(k, k + at_once)
            centred = queries[rows]
            squared = squared_distances_to(self.touches_, self.squares_, centred)
            yield squared, group and group[0][rows, np.newaxis] == group[1]

    def _densities(
        self, queries: Singles, width: float, group: _Groups | None = None
    ) -> Floats:
        """Return log densities of labels but for a constant of each touch (nats).

        Of a `group`, stored touches of a touch's own are left out.
        """
        pairs = self._pairs(queries, group)
        parts = [self._log_densities(squared, width, out) for squared, out in pairs]
        return np.concatenate(parts)

    def _log_densities(
        self, squared: Singles, width: float, left_out: Bools | None
    ) -> Floats:
        exponent = squared / np.float32(-2 * width**2)
        counts = np.diff(self.starts_, append=squared.shape[1])
        n_stored = counts
        if left_out is not None:
            exponent[left_out] = -np.inf
            n_out = np.add.reduceat(left_out, self.starts_, axis=1, dtype=np.int32)
            n_stored = counts - n_out
        # About the nearest touch of each label, so that none is too far away.
        most = np.maximum.reduceat(exponent, self.starts_, axis=1)
        exponent -= np.repeat(np.where(np.isfinite(most), most, 0), counts, axis=1)
        sums = np.add.reduceat(exp(exponent), self.starts_, axis=1, dtype=np.float64)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(sums) + most - np.log(np.maximum(n_stored, 1)))

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats).

        Shape (n_touches, n_classes).
        """
        touches = check_squarable(as_touches(self, X)) - self.mean_
        centred = touches.astype(np.float32)
        densities = self._densities(centred, self.width_)
        log_posterior, lists = self._log_posterior(densities), _best_of(densities)
        pairs = zip(centred, lists, strict=True)
        scores = np.stack([self._scores(touch, labels) for touch, labels in pairs])
        return self._shared_out(log_posterior, lists, scores)

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of touches left out with their groups."""
        check_is_fitted(self)
        return np.asarray(self.left_out_, dtype=np.float64)

    def stored(self) -> Self:
        """Return what a model file holds: left-out answers in single precision."""
        other = copy(self)
        other.left_out_ = self.left_out_.astype(np.float32)
        return other

    def _log_posterior(self, scores: Floats) -> Floats:
        most = scores.max(axis=1, keepdims=True)
        below = scores - np.where(np.isfinite(most), most, 0)
        return log_softmax(np.maximum(self.temperature_ * below, -self.floor_))


def _best_of(densities: Floats) -> Indices:
    """Return the columns of the densest labels, (n_touches, n_listed), sorted."""
    n_listed = min(LISTED, densities.shape[1])
    best = np.argpartition(-densities, n_listed - 1, axis=1)[:, :n_listed]
    return np.sort(best, axis=1)


def _best_shape(
    scores: Floats, codes: Indices, floors: Iterable[float] = _FLOORS
) -> tuple[float, float, float]:
    """Return the least log loss (nats), and the temperature and floor that have it.

    Of log densities (n_touches, n_labels), of very many some. Touches of labels with
    nothing left say nothing of it.
    """
    step = -(-scores.size // _SHAPED_ANSWERS)
    scores, codes = scores[::step], codes[::step]
    met = np.isfinite(scores[np.arange(len(codes)), codes])
    scores, codes = scores[met], codes[met]
    if not len(codes):
        return 0.0, 1.0, float(np.log(scores.shape[1]))
    below = scores - scores.max(axis=1, keepdims=True)
    at = np.arange(len(codes)), codes

    def loss(raw: float, floor: float) -> float:
        shaped = np.maximum(np.exp(raw) * below, -floor)
        return float(-log_softmax(shaped)[at].mean())

    best = np.inf, 1.0, 0.0
    for margin in floors:
        floor = float(np.log(scores.shape[1]) + margin)
        optimum = minimize_scalar(
            loss, bounds=_TEMPERATURES, args=(floor,), method="bounded"
        )
        best = min(best, (float(optimum.fun), float(np.exp(optimum.x)), floor))
    return best
