"""Kernel ridge classification with everything a belief needs in closed form.

Least squares on one-hot labels in the space of a Gaussian kernel. What makes it
worth having: the answer the machine WOULD give to a touch, had a whole group of
touches (a block of a recording, an object) never been learnt, follows from the
inverse that training computes anyway. So the kernel width, the ridge and the
temperature of the posterior are all chosen on touches left out with their group,
without a single further fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.optimize import minimize
from sklearn.metrics.pairwise import euclidean_distances
from sklearn.utils.validation import check_is_fitted

from .._checks import check_count, check_positive, check_squarable
from .._numbers import exp, log_loss, log_softmax
from .._types import Array, Floats, Indices
from ._growing_inverse import GrowingInverse
from ._touch_classifier import (
    BayesRule,
    Groups,
    as_groups,
    as_touches,
    labelled_touches,
)

# Temperature and bend of the posterior are fitted to at most so many touches, and so
# many of their answers, one for each label.
_SHAPED_BY, _SHAPED_ANSWERS = 2000, 500_000
# Touches that shape it at once: their answers stay in a processor's cache.
_SHAPED_AT_ONCE = 256
# Touches whose kernel with the landmarks is in memory at once.
_TOUCHES_AT_ONCE = 2000
# From so many touches to so many, learning a few more costs a few columns; in memory 4
# bytes for each pair. As many more as this share of them are learnt so.
_GROWS_FROM, _GROWS_TO, _GROWTH = 500, 5000, 1 / 8
# Keeps the landmarks' own kernel positive definite, where two of them are the same.
_JITTER = 1e-8

# Where the search for a temperature begins, and where it stays.
_USUAL_TEMPERATURE = 8.0
_TEMPERATURES = float(np.exp(-3)), float(np.exp(6))
# Temperature, bend and lean of a posterior, and from where the best ones are sought.
Shape = tuple[float, float, float]
_USUAL_SHAPE = _USUAL_TEMPERATURE, 0.5, 1.0

# Rows of touches, some of them -> their kernel with the landmarks.
KernelOf = Callable[[Indices], Floats]
# Rows of groups of one size, (n_groups, size), and the inverse's blocks of them.
Blocks = Iterable[tuple[Indices, Floats]]


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
        Of more, some are landmarks for all (Nystroem features).
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
        How much the scores lean towards labels of many training touches.
    log_counts_ : ndarray of shape (n_classes,)
        Logarithms of the numbers of training touches, times `lean_`; subtracted, so
        that posteriors are those under equal priors.
    left_out_scores_ : ndarray of shape (n_touches, n_classes)
        Regression scores of each training touch with its group left out.
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
    temperature_: float
    bend_: float
    lean_: float

    def __init__(
        self,
        widths: Iterable[float] = (0.5, 1.0, 2.0, 4.0),
        ridges: Iterable[float] = (0.003, 0.01, 0.03, 0.1, 0.3),
        max_choice_touches: int = 1500,
        max_touches: int = 10_000,
        n_landmarks: int = 2000,
    ) -> None:
        self.widths = widths
        self.ridges = ridges
        self.max_choice_touches = max_choice_touches
        self.max_touches = max_touches
        self.n_landmarks = n_landmarks

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
        touches, codes, group = self._taken(X, y, groups)
        if len(self.classes_) < 2:
            raise ValueError(
                f"y must hold at least two labels, got 1 class: {self.classes_[0]}."
            )
        self._choose(touches, codes, group)
        self._inverse: GrowingInverse | None = None
        self._learn(touches, codes, group)
        return self

    def _taken(
        self, X: ArrayLike, y: ArrayLike, groups: Groups, reset: bool = True
    ) -> tuple[Floats, Array, Array]:
        touches, labels = labelled_touches(self, X, y, reset=reset)
        check_squarable("X", touches)
        self.classes_, codes = np.unique(labels, return_inverse=True)
        return touches, codes, as_groups(groups, len(touches))

    def _choose(self, touches: Floats, codes: Array, group: Array) -> None:
        """Set `unit_`, `width_` and `ridge_` by the log loss of left-out groups."""
        widths = [check_positive("widths", w) for w in self.widths]
        ridges = sorted(check_positive("ridges", r) for r in self.ridges)
        if not widths or not ridges:
            raise ValueError("widths and ridges must hold at least one value each.")
        at_most = check_count("max_choice_touches", self.max_choice_touches, at_least=2)
        # Touches of all labels, or of every k-th where fewer than 4 of each fit.
        step = -(-4 * (int(codes.max()) + 1) // at_most)
        if len(codes) <= at_most or step == 1:
            some = _thin(codes, at_most)
        else:
            mine = np.flatnonzero(codes % step == 0)
            some = mine[_thin(codes[mine], at_most)]
        codes = np.unique(codes[some], return_inverse=True)[1]
        chosen = touches[some]
        squared = _squared_distances(chosen - chosen.mean(axis=0))
        self.unit_ = float(np.median(squared)) or 1.0
        target, by_size = _one_hot(codes, codes.max() + 1), _by_size(group[some])
        best, at, temperature = np.inf, len(ridges) // 2, _USUAL_TEMPERATURE
        for width in widths:
            kernel = -width / self.unit_ * squared
            exp(kernel, out=kernel)

            @cache
            def loss(k: int, kernel: Floats = kernel) -> float:
                nonlocal temperature  # near that of the last ridge
                root, found = _solve(kernel.copy(), target, ridges[k])
                scores = _left_out(_own_blocks(root, by_size), found, target)
                value, temperature = _smoothed_loss(scores, codes, temperature)
                return value

            # From the ridge that was best for the width before, as long as it falls.
            for way in (1, -1):
                while 0 <= at + way < len(ridges) and loss(at + way) < loss(at):
                    at += way
            if loss(at) < best:
                best, self.width_, self.ridge_ = loss(at), width, ridges[at]

    def _learn(self, touches: Floats, codes: Array, group: Array) -> None:
        target = _one_hot(codes, len(self.classes_))
        n_touches = check_count("max_touches", self.max_touches, at_least=2)
        grown = self._grown(touches, codes) if len(touches) <= n_touches else None
        if grown is None:
            self.mean_ = touches.mean(axis=0)
        centred = touches - self.mean_ if grown is None else grown.touches
        self._inverse = grown
        blocks: Blocks
        if grown is not None:
            self.coefficients_ = grown.coefficients(target, self.classes_)
            blocks = grown.blocks(_by_size(group))
            left_out = _left_out(blocks, self.coefficients_, target)
            self.touches_ = centred
        elif len(centred) <= n_touches:
            kernel = self._kernel(_squared_distances(centred))
            # The columns of the labels as they are, of which later classes need others.
            root, columns = _solve(kernel, target + 1 / len(self.classes_), self.ridge_)
            share = columns.mean(axis=1, keepdims=True)
            self.coefficients_ = columns - share
            blocks = _own_blocks(root, _by_size(group))
            if _GROWS_FROM <= len(centred) <= _GROWS_TO:
                blocks = list(blocks)
                self._inverse = GrowingInverse(
                    root, centred, self.classes_[codes], self.classes_, columns, blocks
                )
            left_out = _left_out(blocks, self.coefficients_, target)
            self.touches_ = centred
        else:
            n_landmarks = check_count("n_landmarks", self.n_landmarks, at_least=2)
            marks = centred[_thin(codes, min(n_landmarks, len(codes)))]
            self.coefficients_, left_out = _learn_from_landmarks(
                lambda rows: self._kernel(
                    euclidean_distances(centred[rows], marks, squared=True)
                ),
                self._kernel(euclidean_distances(marks, squared=True)),
                target,
                group,
                self.ridge_,
            )
            left_out += 1 / len(self.classes_)
            self.touches_ = marks
        self.squared_norms_ = np.einsum("ij,ij->i", self.touches_, self.touches_)
        self.left_out_scores_ = left_out
        some = _thin(codes, min(_SHAPED_BY, _SHAPED_ANSWERS // target.shape[1] + 1))
        start = _USUAL_SHAPE
        if grown is not None:
            start = self.temperature_, self.bend_, self.lean_
        shape, self.log_loss_ = _best_shape(left_out[some], codes[some], start)
        self.temperature_, self.bend_, self.lean_ = shape
        self.log_counts_ = self.lean_ * _log_counts(codes, target.shape[1])

    def _grown(self, touches: Floats, codes: Array) -> GrowingInverse | None:
        """Return the inverse with a few touches more than it has, None of others."""
        inverse: GrowingInverse | None = self.__dict__.get("_inverse")
        if inverse is None or len(touches) > (1 + _GROWTH) * inverse.n_first:
            return None
        centred, labels = touches - self.mean_, self.classes_[codes]
        if not inverse.begins(centred, labels):
            return None
        new = centred[len(inverse.touches) :]
        squared = euclidean_distances(new, centred, squared=True)
        kernel = self._kernel(squared)
        try:
            return inverse.plus(centred, labels, kernel, self.ridge_)
        except LinAlgError:
            return None

    def _kernel(self, squared: Floats) -> Floats:
        """Turn squared distances into the kernel, in place."""
        squared *= -self.width_ / self.unit_
        return exp(squared, out=squared)

    def scores(self, X: ArrayLike) -> Floats:
        """Return the regression scores, shape (n_touches, n_classes); 1 is sure."""
        if not hasattr(self, "coefficients_"):  # the check itself takes a while
            check_is_fitted(self)
        centred = check_squarable("X", as_touches(self, X)) - self.mean_
        # One pass over the training touches: their own norms are known.
        squared = (-2 * centred) @ self.touches_.T
        squared += (centred**2).sum(axis=1)[:, np.newaxis]
        squared += self.squared_norms_
        kernel = self._kernel(np.maximum(squared, 0, out=squared))
        return np.asarray(kernel @ self.coefficients_ + 1 / len(self.classes_))

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats).

        Shape (n_touches, n_classes). The posterior under equal priors, so each
        row is a likelihood but for a factor that no belief depends on.
        """
        return self._log_posterior(self.scores(X))

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of training touches with their groups left out."""
        check_is_fitted(self)
        return self._log_posterior(self.left_out_scores_)

    def _log_posterior(self, scores: Floats) -> Floats:
        shape = (self.temperature_, self.bend_, 1.0)
        return _log_posterior(shape, scores, self.log_counts_)

    def refit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Learn other touches with the width and ridge already chosen."""
        check_is_fitted(self)
        self._learn(*self._taken(X, y, groups, reset=False))
        return self

    def __copy__(self) -> Self:
        again = type(self).__new__(type(self))
        again.__dict__.update(self.__dict__)
        return again

    def __getstate__(self) -> dict[str, Any]:
        # What makes learning more of it quick is larger than all the rest.
        return {k: v for k, v in super().__getstate__().items() if k != "_inverse"}


def _thin(codes: Array, at_most: int) -> Array:
    """Return every k-th touch of each label, for the least k that fits."""
    step = -(-len(codes) // at_most)
    return np.sort(np.argsort(codes, kind="stable")[::step])


def _one_hot(codes: Array, n_classes: int) -> Floats:
    """Targets minus their fixed mean of 1 / n_classes."""
    return np.eye(n_classes)[codes] - 1 / n_classes


def _squared_distances(touches: Floats) -> Floats:
    """Return those between touches, made in one piece of memory."""
    squared = touches @ touches.T
    norms = squared.diagonal().copy()
    squared *= -2
    squared += norms
    squared += norms[:, np.newaxis]
    np.maximum(squared, 0, out=squared)
    np.fill_diagonal(squared, 0)
    return np.asarray(squared)


def _solve(kernel: Floats, target: Floats, ridge: float) -> tuple[Floats, Floats]:
    """Return R with R^T R = inverse of (kernel + ridge), in place, and coefficients."""
    kernel.flat[:: len(kernel) + 1] += ridge
    factor, failed = dpotrf(kernel.T, lower=1, clean=1, overwrite_a=1)
    if failed:
        raise ValueError(
            "X must not hold touches so far from the others that distances among those "
            "are lost in rounding. Leave them out, or scale the features."
        )
    root = dtrtri(factor, lower=1, overwrite_c=1)[0]
    return root, root.T @ (root @ target)


def _by_size(group: Array) -> list[Indices]:
    """Return rows of groups of one size, (n_groups, size), so many at a time."""
    by_size: dict[int, list[Indices]] = {}
    for members in _members(group):
        by_size.setdefault(len(members), []).append(members)
    return [
        np.stack(groups[first : first + at_once])
        for size, groups in by_size.items()
        for at_once in [max(1, _TOUCHES_AT_ONCE // size)]
        for first in range(0, len(groups), at_once)
    ]


def _own_blocks(root: Floats, by_size: list[Indices]) -> Blocks:
    """Yield groups of one size, some at a time, and the inverse's block of each."""
    for rows in by_size:
        mine = root.T[rows]
        yield rows, mine @ mine.transpose(0, 2, 1)


def _left_out(blocks: Blocks, coefficients: Floats, target: Floats) -> Floats:
    """Scores of every touch had its group never been learnt."""
    scores: Floats = target + 1 / target.shape[1]
    for rows, inverse in blocks:
        scores[rows] -= np.linalg.solve(inverse, coefficients[rows])
    return scores


def _log_counts(codes: Array, n_classes: int) -> Floats:
    return np.asarray(np.log(np.maximum(np.bincount(codes, minlength=n_classes), 1)))


def _log_posterior(shape: Shape, scores: Floats, log_counts: Floats) -> Floats:
    """Log posterior under equal priors; `shape` is (temperature, bend, lean)."""
    temperature, bend, lean = shape
    bent = temperature * scores / (1 + bend * np.abs(scores))
    return log_softmax(bent - lean * log_counts)


def fair_shares(codes: Array) -> Floats:
    """Return the share of each touch in a mean to which all labels add the same."""
    counts = np.bincount(codes)
    return 1 / (counts[codes] * np.count_nonzero(counts))


def _smoothed_loss(
    scores: Floats, codes: Array, temperature: float
) -> tuple[float, float]:
    """Return the log loss of smoothed labels (nats) and its best temperature.

    But for a constant. `temperature` is where to begin. Of n touches each counts as
    (n + 1) / (n + 2) of its label and shares the rest among the others: none of n does
    not mean never (Laplace's rule of succession; Platt, "Probabilistic outputs for
    support vector machines", 1999).
    Where all touches are told apart, the plain loss falls with the temperature for
    ever, and what is left is rounding; this one asks for wide and even gaps. It is
    convex: Newton's method.
    """
    n_touches, n_classes = scores.shape
    log_counts, shares = _log_counts(codes, n_classes), fair_shares(codes)
    others = 1 / (n_touches + 2) / max(1, n_classes - 1)
    gaps = scores - scores[np.arange(n_touches), codes][:, np.newaxis]
    squares = gaps**2
    drift = -others * (shares @ gaps.sum(axis=1))
    low, high = _TEMPERATURES
    while True:
        loss, pull = log_loss(temperature * gaps - log_counts, codes, shares)
        slopes = np.einsum("ij,ij->i", pull, gaps)
        slope = slopes.sum() + drift
        curve = np.vdot(pull, squares) - slopes @ (slopes / shares)
        low, high = (low, temperature) if slope > 0 else (temperature, high)
        if slope**2 <= 1e-12 * curve or high < (1 + 1e-9) * low:
            return float(loss + temperature * drift), temperature
        temperature -= slope / curve if curve > 0 else np.inf
        if not low < temperature < high:
            temperature = float(np.sqrt(low * high))


def _best_shape(
    scores: Floats, codes: Array, start: Shape = _USUAL_SHAPE
) -> tuple[Shape, float]:
    """Return (temperature, bend, lean) with the least log loss, and that loss (nats).

    The lean counts where labels have unequal numbers of touches, and is 1 elsewhere.
    """
    log_counts = _log_counts(codes, scores.shape[1])
    shares, size = fair_shares(codes), np.abs(scores)
    n_free = 3 if np.ptp(log_counts) > 0 else 2

    def loss(raw: Floats) -> tuple[float, Floats]:
        temperature, bend = np.exp(raw[:2])
        lean = raw[2] if n_free > 2 else 1.0
        value, slopes = 0.0, np.zeros(3)
        for first in range(0, len(codes), _SHAPED_AT_ONCE):
            some = slice(first, first + _SHAPED_AT_ONCE)
            damping = 1 + bend * size[some]
            by_temperature = temperature * scores[some] / damping
            logits = by_temperature - lean * log_counts
            part, pull = log_loss(logits, codes[some], shares[some])
            value += part
            slopes[0] += np.vdot(pull, by_temperature)
            slopes[2] -= pull.sum(axis=0) @ log_counts
            by_temperature /= damping
            by_temperature *= size[some]
            slopes[1] -= bend * np.vdot(pull, by_temperature)
        return value, slopes[:n_free]

    found = minimize(
        loss,
        [*np.log(start[:2]), start[2]][:n_free],
        jac=True,
        bounds=[tuple(np.log(_TEMPERATURES)), (-8.0, 6.0), (0.0, 6.0)][:n_free],
        method="L-BFGS-B",
        options={"ftol": 1e-13, "gtol": 1e-9},
    )
    lean = float(found.x[2]) if n_free > 2 else 1.0
    return (*np.exp(found.x[:2]).tolist(), lean), float(found.fun)


def _learn_from_landmarks(
    kernel_of: KernelOf,
    own_kernel: Floats,
    target: Floats,
    group: Indices,
    ridge: float,
) -> tuple[Floats, Floats]:
    """Return coefficients (n_landmarks, n_outputs) and left-out answers to `target`.

    Nystroem features: Williams and Seeger, "Using the Nystroem method to speed up
    kernel machines", NIPS 13, 2001. With features F and residuals r of a group, Q =
    (F_all^T F_all + ridge I)^-1, its answer, never learnt, is target - (I - F Q F^T)^-1
    r.
    """
    n_landmarks = len(own_kernel)
    root = cholesky(own_kernel + _JITTER * np.eye(n_landmarks), lower=True)

    def features(rows: Indices) -> Floats:
        solved = solve_triangular(root, kernel_of(rows).T, lower=True)
        return np.ascontiguousarray(solved.T)

    inner = ridge * np.eye(n_landmarks)
    outer = np.zeros((n_landmarks, target.shape[1]))
    for start in range(0, len(target), _TOUCHES_AT_ONCE):
        rows = np.arange(start, min(len(target), start + _TOUCHES_AT_ONCE))
        some = features(rows)
        inner += some.T @ some
        outer += some.T @ target[rows]
    factor = cho_factor(inner)
    weights = cho_solve(factor, outer)
    left_out = target.copy()
    at_once = min(_TOUCHES_AT_ONCE, n_landmarks)
    for groups in _batches(_members(group), at_once):
        some = features(np.concatenate(groups))
        # Without its group, through the smaller of two matrices.
        through = None if len(some) > n_landmarks else cho_solve(factor, some.T)
        ends = np.cumsum([len(members) for members in groups])
        for members, end in zip(groups, ends, strict=True):
            here = slice(end - len(members), end)
            mine = some[here]
            residual = target[members] - mine @ weights
            if through is not None:
                hat = mine @ through[:, here]
                left_out[members] -= np.linalg.solve(np.eye(len(mine)) - hat, residual)
            else:
                others = cho_factor(inner - mine.T @ mine)
                answer = mine @ cho_solve(others, mine.T @ residual)
                left_out[members] -= residual + answer
    return solve_triangular(root, weights, lower=True, trans="T"), left_out


def _batches(groups: list[Indices], at_once: int) -> Iterator[list[Indices]]:
    """Yield groups so many touches at a time, one that is larger alone."""
    batch: list[Indices] = []
    for members in groups:
        if batch and sum(map(len, batch)) + len(members) > at_once:
            yield batch
            batch = []
        batch.append(members)
    yield batch


def _members(group: Indices) -> list[Indices]:
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
