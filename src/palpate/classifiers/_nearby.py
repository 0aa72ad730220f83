"""Very many labels of few touches each: only what lies near a touch tells.

Landmarks cannot tell more labels than there are landmarks, and a kernel matrix of all
touches does not fit in memory. A density of each label's own touches needs neither.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from sklearn.utils.validation import check_is_fitted

from .._checks import check_squarable
from .._numbers import exp, log_softmax
from .._types import Array, Floats, Indices, Singles
from ._touch_classifier import (
    BayesRule,
    Groups,
    as_groups,
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
# How much less than one of as many equal ones a label is at least (nats); tried.
_FLOORS = (1.0, 2.0, 3.0, 4.0, 6.0, 20.0)

# Of touches to be left out, and of those that are stored.
_Groups = tuple[Indices, Indices]


class NearbyTouches(BayesRule):
    """Gaussian densities of each label's own touches, with one calibrated width.

    For very many labels: learning is storing, in single precision, and the width and
    the temperature of the posterior are those of least log loss of touches left out.

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
    left_out_scores_ : ndarray of shape (n_left_out, n_classes)
        Log densities at training touches, each with its group left out.
    left_out_rows_ : ndarray of shape (n_left_out,)
        Which training touches these are, as given to `fit`.

    Examples
    --------
    >>> from palpate.classifiers import NearbyTouches
    >>> X, y = [[0.0], [0.1], [1.0], [1.1]], ["pen", "pen", "mug", "mug"]
    >>> NearbyTouches().fit(X, y).predict([[0.9]])
    array(['mug'], dtype='<U3')
    """

    width_: float
    temperature_: float
    floor_: float

    def fit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Store touches, and choose width and temperature on left-out groups.

        Parameters and errors as of `TouchClassifier.fit`.
        """
        asked, group, codes = self._stored(X, y, groups)
        nearest = [
            np.where(out, np.inf, squared).min(axis=1)
            for squared, out in self._pairs(asked, group)
        ]
        every = np.concatenate(nearest)
        unit = float(np.sqrt(np.median(every[np.isfinite(every)]))) or 1.0
        best = np.inf
        for width in _WIDTHS:
            scores = self._left_out_scores(asked, group, width * unit)
            loss, *shape = _best_shape(scores, codes)
            if loss < best:
                best, self.width_, self.left_out_scores_ = loss, width * unit, scores
                self.temperature_, self.floor_ = shape
        return self

    def refit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Store other touches, with the width and temperature already chosen."""
        check_is_fitted(self)
        asked, group, _ = self._stored(X, y, groups, reset=False)
        self.left_out_scores_ = self._left_out_scores(asked, group, self.width_)
        return self

    def _stored(
        self, X: ArrayLike, y: ArrayLike, groups: Groups, reset: bool = True
    ) -> tuple[Singles, _Groups, Indices]:
        """Store touches; return those to be left out, groups, and label's columns."""
        touches, labels = labelled_touches(self, X, y, reset=reset)
        check_squarable("X", touches)
        self.classes_, codes = np.unique(labels, return_inverse=True)
        group = as_groups(groups, len(touches))
        order = np.argsort(codes, kind="stable")
        if reset:
            self.mean_ = touches.mean(axis=0)
        self.touches_ = (touches[order] - self.mean_).astype(np.float32)
        self.squares_ = np.einsum("ij,ij->i", self.touches_, self.touches_)
        self.starts_ = np.searchsorted(codes[order], np.arange(len(self.classes_)))
        self.left_out_rows_ = rows = rows_left_out(codes, group)
        asked = (touches[rows] - self.mean_).astype(np.float32)
        return asked, (group[rows], group[order]), codes[rows]

    def _pairs(
        self, asked: Singles, group: _Groups
    ) -> Iterator[tuple[Singles, NDArray[np.bool_]]]:
        """Yield squared distances to the stored touches, and which are left out."""
        at_once = max(1, _PAIRS_AT_ONCE // len(self.touches_))
        for k in range(0, len(asked), at_once):
            some = slice(k, k + at_once)
            out = group[0][some, np.newaxis] == group[1]
            yield self._squared(asked[some]), out

    def _left_out_scores(self, asked: Singles, group: _Groups, width: float) -> Floats:
        pairs = self._pairs(asked, group)
        parts = [self._log_densities(squared, width, out) for squared, out in pairs]
        return np.concatenate(parts)

    def _squared(self, centred: Singles) -> Singles:
        squared: Singles = centred @ (-2 * self.touches_.T)
        squared += np.einsum("ij,ij->i", centred, centred)[:, np.newaxis]
        squared += self.squares_
        return np.maximum(squared, 0, out=squared)

    def _log_densities(
        self, squared: Singles, width: float, left_out: Array | None = None
    ) -> Floats:
        """Return log densities of labels but for a constant of each touch (nats).

        Of squared distances (n_touches, n_stored); some may be left out.
        """
        exponent = squared / np.float32(-2 * width**2)
        counts = np.diff(self.starts_, append=squared.shape[1])
        n_told = counts
        if left_out is not None:
            exponent[left_out] = -np.inf
            n_told = counts - np.add.reduceat(left_out, self.starts_, axis=1, dtype=int)
        # About the nearest touch of each label, so that none is too far away.
        most = np.maximum.reduceat(exponent, self.starts_, axis=1)
        exponent -= np.repeat(np.where(np.isfinite(most), most, 0), counts, axis=1)
        sums = np.add.reduceat(exp(exponent), self.starts_, axis=1, dtype=np.float64)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(sums) + most - np.log(np.maximum(n_told, 1)))

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats).

        Shape (n_touches, n_classes).
        """
        if not hasattr(self, "touches_"):
            check_is_fitted(self)
        centred = check_squarable("X", as_touches(self, X)) - self.mean_
        at_once = max(1, _PAIRS_AT_ONCE // len(self.touches_))
        parts = [
            self._log_densities(
                self._squared(centred[k : k + at_once].astype(np.float32)), self.width_
            )
            for k in range(0, len(centred), at_once)
        ]
        return self._log_posterior(np.concatenate(parts))

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of touches left out with their groups."""
        check_is_fitted(self)
        log_posterior = self._log_posterior(self.left_out_scores_)
        nothing_left = np.isneginf(self.left_out_scores_)
        return np.where(nothing_left, -np.inf, log_posterior)

    def _log_posterior(self, scores: Floats) -> Floats:
        below = scores - scores.max(axis=1, keepdims=True)
        return log_softmax(np.maximum(self.temperature_ * below, -self.floor_))

    @property
    def left_out_rows(self) -> Indices:
        """Which training touches these are, (n_left_out,)."""
        return self.left_out_rows_


def _best_shape(scores: Floats, codes: Indices) -> tuple[float, float, float]:
    """Return the least log loss (nats), and the temperature and floor that have it.

    Of log densities (n_touches, n_labels). Touches of labels with nothing left say
    nothing of it.
    """
    own = scores[np.arange(len(codes)), codes]
    below = scores - scores.max(axis=1, keepdims=True)
    below, codes = below[np.isfinite(own)], codes[np.isfinite(own)]
    if not len(codes):
        return 0.0, 1.0, float(np.log(scores.shape[1]))
    at = np.arange(len(codes)), codes

    def loss(raw: float, floor: float) -> float:
        shaped = np.maximum(np.exp(raw) * below, -floor)
        return float(-log_softmax(shaped)[at].mean())

    best = np.inf, 1.0, 0.0
    for less in _FLOORS:
        floor = float(np.log(scores.shape[1]) + less)
        found = minimize_scalar(
            loss, bounds=_TEMPERATURES, args=(floor,), method="bounded"
        )
        best = min(best, (float(found.fun), float(np.exp(found.x)), floor))
    return best
