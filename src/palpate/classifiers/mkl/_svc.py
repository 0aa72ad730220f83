"""A support vector machine that learns its kernel from a bank of kernels."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import Tags, check_random_state
from sklearn.utils.metaestimators import available_if
from sklearn.utils.validation import (
    check_consistent_length,
    check_is_fitted,
    column_or_1d,
)

from ... import _checks
from ..._checks import (
    check_count,
    check_option,
    check_positive,
    check_squarable,
    check_targets,
)
from ..._parallel import on_one_thread
from ..._types import Array, Floats
from .._touch_classifier import as_touches, classes_of, labelled_touches
from . import _kernels, _pairs
from ._kernels import (
    DenseBank,
    FeatureBank,
    GivenBank,
    Kernel,
    check_given,
    check_kernels,
)
from ._landmarks import LandmarkFeatures, NystroemBank
from ._pairs import Bank, PairMachines, Settings, couple, fit_temperature, sharpen, vote
from ._problem import row_blocks

# Decisions this small tell nothing but the solver's rounding; the margin is 1.
_ROUNDING = 1e-9
# Pairs of more touches than this are learnt through landmarks by default.
_MOST_TOUCHES = 3000
# Steps of a pair so large would be shared among threads, which wait for each other.
_SHARED_FROM = 100
_TOLERANCES = {"interior": 1e-6, "simplemkl": 1e-2}


def _largest_pair(codes: Array) -> int:
    """Return how many touches the two classes have that have most."""
    return int(np.sort(np.bincount(codes))[-2:].sum())


def _has_probability(estimator: MKLSVC) -> bool:
    if not estimator.probability:
        raise AttributeError(
            "predict_proba needs MKLSVC(probability=True); fit again with it."
        )
    return True


class MKLSVC(ClassifierMixin, BaseEstimator):
    """Support vector machine over a weighted sum of kernels, weights learnt.

    One machine for each pair of classes; each pair has its own weights. All pairs
    are solved to proven optimality by an interior point, in batches.

    Parameters
    ----------
    C : float, default=1000
        Price of a margin error. Kernels of trace 1 are of the order of 1 / n, so a
        good C grows with the number n of training touches; with "variance", 1 to
        10 is usual.
    kernels : "paper", "precomputed" or list of kernels, default="paper"
        "paper" is the bank of Liu et al. [1]_: Gaussians of sigma = 2^-5 ... 2^10
        and polynomials (1 + x'y)^p, p = 1 ... 6. A list holds `GaussianKernel`,
        `PolynomialKernel` and `LinearKernel`. With "precomputed", `X` is an array
        of shape (n_touches, n_train_touches, n_kernels).
    normalize : {"trace", "variance", None}, default="trace"
        Divide each kernel by its trace over the training touches, as the
        literature does; by its variance in feature space, which makes kernels
        comparable; or not at all. A kernel without trace (or variance) gets 0.
    norm : float, default=1
        The p of the constraint |weights|_p = 1. At 1 few kernels are chosen, above
        all take part.
    solver : {"interior", "simplemkl"}, default="interior"
        "simplemkl" is the reduced gradient of Rakotomamonjy et al. [2]_, for
        reproduction; only for `norm=1` and without approximation.
    approximation : {"auto", "none", "nystroem"}, default="auto"
        "nystroem" replaces each kernel by what `n_landmarks` training touches see
        of it; memory and time then grow linearly with the touches. "auto" does so
        if a pair of classes has more than 3000 touches.
    n_landmarks : int, default=200
        Landmarks of the Nystroem approximation, shared by all kernels and pairs.
    probability : bool, default=True
        Calibrate probabilities while fitting, which costs five further fits to a
        gap of 1e-4 (one with landmarks). Without, there is no `predict_proba`.
    tol : float, optional
        Relative duality gap to reach; by default 1e-6, and 1e-2 for "simplemkl".
    max_iter : int, default=500
        Iterations of the solver, for each pair.
    random_state : int, RandomState or None, default=None
        Draws the landmarks; nothing else is random.

    Attributes
    ----------
    classes_ : ndarray of shape (n_classes,)
        The labels, sorted.
    pairs_ : ndarray of shape (n_pairs, 2)
        Positions in `classes_` of the two classes of each pair. A positive decision
        speaks for the second.
    weights_ : ndarray of shape (n_pairs, n_kernels)
        Weight of each (normalised) kernel, of p-norm 1 in each row.
    objective_ : ndarray of shape (n_pairs,)
        J, the optimum of eqs 11 and 12 of [1]_.
    gap_ : ndarray of shape (n_pairs,)
        Relative duality gap, between a feasible point of eq. 11 and one of eq. 12.
    n_iter_ : ndarray of int of shape (n_pairs,)
    intercept_ : ndarray of shape (n_pairs,)
    dual_coef_ : ndarray of shape (n_pairs, n_support) or (n_pairs, n_columns)
        Label times multiplier of each support touch; with landmarks, the normal
        vector in the space of the features.
    support_ : ndarray of int of shape (n_support,)
        Training touches that any pair rests on; with landmarks, empty.
    touches_ : ndarray of shape (n_support, n_features)
        Those touches, or the landmarks, less `mean_`; empty if precomputed.
    mean_ : ndarray of shape (n_features,)
    kernels_ : list of kernels
        Empty if precomputed.
    kernel_scales_ : ndarray of shape (n_kernels,)
        Factor that normalises each kernel.
    feature_maps_ : list of ndarray of shape (n_landmarks, rank)
        From kernel values at the landmarks to features; empty without landmarks.
    sigmoids_ : ndarray of shape (n_pairs, 2)
        Slope and offset of each pair's probability.
    temperature_ : float
        Power of the coupled probabilities.
    n_features_in_ : int
        With precomputed kernels, the number of training touches.

    Notes
    -----
    **Votes.** Each pair votes for one class; `predict` returns the class with most
    votes. Among equal votes the larger sum of decisions in favour counts, then the
    order of `classes_`. A decision below 1e-9 (times `C` where that is below 1)
    is rounding and counts as 0: half a vote for each, and with two classes the first.
    `decision_function` is the votes plus that sum squeezed below half a vote; with two
    classes it is the decision of the one pair.

    **Probabilities.** The touches of each class, in the order given, are cut into
    five blocks; each is judged by machines, kernel weights included, that learnt
    the other four (with landmarks, the first block alone). A sigmoid per pair is
    fitted to those decisions, the pairs are coupled, and with more than two classes
    one power for all is fitted to the coupled probabilities of the same touches.
    Where the result contradicts the votes, the voted class and those above it share
    their mean, so that the most probable class is the predicted one. A class of one
    touch cannot be left out: its pairs are calibrated on the touch learnt.

    **Size.** The interior point needs memory for n_kernels * n^2 numbers and time of
    the order of n_kernels * n^2 + n^3 per iteration, n the touches of one pair;
    with 22 kernels a pair of 1500 takes about a second on one core, to which it
    keeps. It is exact up to the 3000 of "auto"; how many touches there are in all
    matters little.

    References
    ----------
    .. [1] Y.-H. Liu et al., "Low-resolution tactile image recognition for automated
       robotic assembly using kernel PCA-based feature fusion and multiple kernel
       learning-based support vector machine", Math. Probl. Eng., 2014.
       doi:10.1155/2014/497275
    .. [2] A. Rakotomamonjy, F. R. Bach, S. Canu and Y. Grandvalet, "SimpleMKL",
       J. Mach. Learn. Res. 9, 2008.

    Examples
    --------
    >>> from palpate.classifiers import MKLSVC
    >>> X = [[0.0], [0.1], [0.2], [1.0], [1.1], [1.2]]
    >>> MKLSVC().fit(X, ["pen"] * 3 + ["mug"] * 3).predict([[0.05], [1.3]])
    array(['pen', 'mug'], dtype='<U3')
    """

    def __init__(
        self,
        C: float = 1000.0,
        *,
        kernels: str | Sequence[Kernel] = "paper",
        normalize: str | None = "trace",
        norm: float = 1.0,
        solver: str = "interior",
        approximation: str = "auto",
        n_landmarks: int = 200,
        probability: bool = True,
        tol: float | None = None,
        max_iter: int = 500,
        random_state: int | np.random.RandomState | None = None,
    ) -> None:
        self.C = C
        self.kernels, self.normalize = kernels, normalize
        self.norm, self.solver = norm, solver
        self.approximation, self.n_landmarks = approximation, n_landmarks
        self.probability = probability
        self.tol, self.max_iter = tol, max_iter
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Learn weights and machines of all pairs of classes.

        Parameters
        ----------
        X : array-like of shape (n_touches, n_features)
            Feature vectors, or precomputed kernels of shape (n_touches, n_touches,
            n_kernels).
        y : array-like of shape (n_touches,)
            Labels, at least two different ones.

        Warns
        -----
        ConvergenceWarning
            If a pair stayed above the duality gap asked for; it says the gap.
        """
        settings = self._settings()
        touches, labels = self._validated(X, y)
        self.classes_, codes = classes_of(labels)
        bank = self._make_bank(touches, codes)
        waits = isinstance(bank, DenseBank) and _largest_pair(codes) >= _SHARED_FROM
        with on_one_thread() if waits else nullcontext():
            machines = _pairs.learn_pairs(bank, codes, settings)
        self._store(bank, machines)
        self.temperature_ = 1.0
        if settings.calibrate and len(self.classes_) > 2:
            # Training touches are judged by machines that did not learn them.
            judged = (
                np.isfinite(machines.left_out).sum(axis=1) == len(self.classes_) - 1
            )
            decisions = self._decisions(touches[judged])
            _pairs.put_left_out(
                decisions, machines.left_out[judged], codes[judged], self.pairs_
            )
            chances = couple(decisions, self.sigmoids_, self.pairs_)
            self.temperature_ = fit_temperature(chances, codes[judged])
        self._warn(settings)
        return self

    def decision_function(self, X: ArrayLike) -> Floats:
        """Return (n_touches, n_classes) votes, or (n_touches,) for two classes."""
        decisions = self.pair_decisions(X)
        if len(self.classes_) == 2:
            return decisions[:, 0]
        return vote(decisions, self.pairs_, len(self.classes_))

    def pair_decisions(self, X: ArrayLike) -> Floats:
        """Return the decision of each pair's machine, shape (n_touches, n_pairs)."""
        check_is_fitted(self)
        if self._is_given():
            touches = check_given(X, (self.n_features_in_, self.weights_.shape[1]))
        else:
            touches = check_squarable(as_touches(self, X))
        return self._decisions(touches)

    def predict(self, X: ArrayLike) -> Array:
        """Return the label with most votes of each touch."""
        winners = self._winners(self.pair_decisions(X))
        return np.asarray(self.classes_[winners])

    @available_if(_has_probability)
    def predict_proba(self, X: ArrayLike) -> Floats:
        """Return calibrated probabilities, shape (n_touches, n_classes)."""
        decisions = self.pair_decisions(X)
        chances = couple(decisions, self.sigmoids_, self.pairs_)
        sharpened = sharpen(chances, self.temperature_)
        return _pairs.side_with_votes(sharpened, self._winners(decisions))

    @available_if(_has_probability)
    def predict_log_proba(self, X: ArrayLike) -> Floats:
        """Return the logarithm of `predict_proba`, in nats."""
        with np.errstate(divide="ignore"):
            logs: Floats = np.log(self.predict_proba(X))
        return logs

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.pairwise = self._is_given()
        tags.input_tags.three_d_array = self._is_given()
        return tags

    def _winners(self, decisions: Floats) -> Array:
        if len(self.classes_) == 2:
            return (decisions[:, 0] > 0).astype(int)
        votes = vote(decisions, self.pairs_, len(self.classes_))
        return np.asarray(votes.argmax(axis=1))

    def _is_given(self) -> bool:
        return isinstance(self.kernels, str) and self.kernels == "precomputed"

    def _settings(self) -> Settings:
        check_option("solver", self.solver, _TOLERANCES)
        check_option("approximation", self.approximation, ("auto", "none", "nystroem"))
        check_option("probability", self.probability, (True, False))
        norm = _checks.check_number("norm", self.norm, low=1)
        through_landmarks = self.approximation == "nystroem"
        if self.solver == "simplemkl" and (norm != 1 or through_landmarks):
            raise ValueError(
                "solver must be 'interior' for norm above 1 or approximation "
                "'nystroem', got 'simplemkl'. Leave solver at its default."
            )
        tol = _TOLERANCES[self.solver] if self.tol is None else self.tol
        return Settings(
            C=check_positive("C", self.C),
            norm=norm,
            solver=self.solver,
            tol=check_positive("tol", tol),
            max_iter=check_count("max_iter", self.max_iter),
            calibrate=bool(self.probability),
        )

    def _make_bank(self, touches: Floats, codes: Array) -> Bank:
        check_option("normalize", self.normalize, ("trace", "variance", None))
        n_landmarks = check_count("n_landmarks", self.n_landmarks)
        through_landmarks = self.approximation == "nystroem"
        if self._is_given():
            if through_landmarks:
                raise ValueError(
                    "approximation must be 'none' or 'auto' with precomputed kernels, "
                    "got 'nystroem'. Pass features and a list of kernels instead."
                )
            return GivenBank(touches, self.normalize)
        kernels = check_kernels(self.kernels)
        if self.approximation == "auto" and self.solver == "interior":
            through_landmarks = _largest_pair(codes) > _MOST_TOUCHES
        if through_landmarks:
            random = check_random_state(self.random_state)
            return NystroemBank(kernels, touches, self.normalize, n_landmarks, random)
        return FeatureBank(kernels, touches, self.normalize)

    def _validated(self, X: ArrayLike, y: ArrayLike) -> tuple[Floats, Array]:
        if not self._is_given():
            touches, labels = labelled_touches(self, X, y)
            return check_squarable(touches), labels
        _checks.check_label_kinds(y)
        touches, labels = check_given(X), np.asarray(column_or_1d(y, warn=True))
        check_consistent_length(touches, labels)
        check_targets(labels)
        self.n_features_in_ = len(touches)
        return touches, labels

    def _store(self, bank: Bank, machines: PairMachines) -> None:
        self.pairs_, self.weights_ = machines.pairs, machines.weights
        self.objective_, self.gap_ = machines.objective, machines.gap
        self.n_iter_, self.intercept_ = machines.n_iter, machines.bias
        self.sigmoids_, self.kernel_scales_ = machines.sigmoids, bank.scales
        self.support_ = np.flatnonzero(machines.coefficients.any(axis=0))
        self.dual_coef_ = machines.coefficients[:, self.support_]
        self.kernels_: list[Kernel] = []
        self.feature_maps_: list[Floats] = []
        self.mean_, self.touches_ = np.zeros(0), np.zeros((0, 0))
        if isinstance(bank, NystroemBank):
            self.support_, self.dual_coef_ = np.zeros(0, int), machines.coefficients
            self.feature_maps_ = bank.features.maps
            self.touches_ = bank.features.landmarks
        elif isinstance(bank, FeatureBank):
            self.touches_ = bank.centred[self.support_]
        if isinstance(bank, FeatureBank | NystroemBank):
            self.kernels_, self.mean_ = list(bank.kernels), bank.mean

    def _warn(self, settings: Settings) -> None:
        short = self.gap_ > settings.tol
        if short.any():
            warnings.warn(
                f"MKLSVC stopped at a relative duality gap of {self.gap_.max():.2g} "
                f"(tol is {settings.tol:.2g}) in {short.sum()} of {len(short)} pairs "
                f"of classes, after at most {self.n_iter_.max()} iterations. Raise "
                "max_iter or tol, lower C, or scale the features.",
                ConvergenceWarning,
                stacklevel=3,
            )

    def _decisions(self, touches: Floats) -> Floats:
        decisions = np.empty((len(touches), len(self.pairs_)))
        n_kernels, n_columns = self.weights_.shape[1], self.dual_coef_.shape[1]
        with np.errstate(over="ignore", invalid="ignore"):
            for rows in row_blocks(len(touches), n_columns * (n_kernels + 2)):
                decisions[rows] = self._decide(touches[rows])
        if not np.isfinite(decisions).all():
            raise ValueError(
                "X must lie where the kernels are finite, got touches too far from "
                "the training touches. Scale the features as in training."
            )
        decisions += self.intercept_
        decisions[np.abs(decisions) < _ROUNDING * min(1, self.C)] = 0
        return decisions

    def _decide(self, touches: Floats) -> Floats:
        """Decisions of all pairs less their bias, for a block of touches."""
        if self.feature_maps_:
            features = LandmarkFeatures(
                self.kernels_, self.touches_, self.mean_, self.feature_maps_
            )
            return features(touches - self.mean_) @ self.dual_coef_.T
        factors = self.weights_ * self.kernel_scales_
        used = np.flatnonzero(factors.any(axis=0))
        if self._is_given():
            stack = touches[:, self.support_][:, :, used].transpose(2, 0, 1)
        else:
            kernels = [self.kernels_[k] for k in used]
            centred = touches - self.mean_
            stack = _kernels.kernel_stack(kernels, centred, self.touches_, self.mean_)
        decisions = np.zeros((len(touches), len(self.pairs_)))
        for k, kernel in zip(used, stack, strict=True):
            rows = np.flatnonzero(factors[:, k])
            coefficients = factors[rows, k, None] * self.dual_coef_[rows]
            decisions[:, rows] += kernel @ coefficients.T
        return decisions
