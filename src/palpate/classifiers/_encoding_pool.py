"""A pool of machines: each learns one encoding, and what they say is weighed.

No encoding is best on every sensor, and few touches do not tell which one is. So each
part of the feature vector has a machine of its own, one more learns all parts side by
side, and their log posteriors of touches left out with their group are added with the
weights of least log loss: a logarithmic opinion pool. Their sum is corrected where that
helps with touches left out (`_matrix_scaling.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from sklearn import config_context
from sklearn.base import clone
from sklearn.utils.validation import check_is_fitted

from .._checks import as_groups, check_count, check_squarable
from .._numbers import log_loss, log_softmax, without_gaps
from .._types import Array, Floats, Indices
from . import _touch_classifier
from ._kernel_ridge import KernelRidgeClassifier
from ._matrix_scaling import learn_scaling, scaled, scaling_with
from ._nearby import NearbyTouches
from ._ridge import fair_shares
from ._touch_classifier import BayesRule, Groups, TouchClassifier, labelled_touches

TOGETHER = "all together"
# No machine may say of a touch that an object is less probable than this (nats).
_LEAST = -30.0
# Weights follow from at most so many left-out answers, one for each touch and label;
# more are stored in single precision.
_MANY_ANSWERS = 1_000_000
# With fewer landmarks for each label, they cannot tell labels apart.
LANDMARKS_EACH = 4


class RehearsedMachine(BayesRule):
    """Two machines of the same features: of these as they are, and weighed down.

    Parameters
    ----------
    plain, rehearsed : TouchClassifier
        Machines that have learnt the same touches, the second one after `weighing`.
    weighing : ndarray of shape (n_features, n_features)
        What features are multiplied by, to weigh down how sessions differ.
    share : float
        What the second one's log posterior counts, above 0; the first one's counts the
        rest.
    """

    def __init__(
        self,
        plain: TouchClassifier,
        rehearsed: TouchClassifier,
        weighing: Floats,
        share: float = 0.5,
    ) -> None:
        self.plain = plain
        self.rehearsed = rehearsed
        self.weighing = weighing
        self.share = share

    @property
    def classes_(self) -> Array:  # type: ignore[override]
        """The labels, sorted, (n_classes,)."""
        return self.plain.classes_

    @property
    def takes_weights(self) -> bool:  # type: ignore[override]
        """Whether both machines take what each touch counts."""
        return _take_weights((self.plain, self.rehearsed))

    def refit(
        self, X: ArrayLike, y: ArrayLike, groups: Groups = None, **more: Any
    ) -> Self:
        """Let both machines learn other touches with the choices they made."""
        touches = np.asarray(X, dtype=np.float64)
        self.plain = copy(self.plain).refit(touches, y, groups, **more)
        weighed = touches @ self.weighing
        self.rehearsed = copy(self.rehearsed).refit(weighed, y, groups, **more)
        return self

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats)."""
        touches = np.asarray(X, dtype=np.float64)
        rehearsed = self.rehearsed.log_likelihood_checked(touches @ self.weighing)
        if self.share == 1:
            return rehearsed
        return self._both(self.plain.log_likelihood_checked(touches), rehearsed)

    log_likelihood_checked = log_likelihood  # type: ignore[assignment]

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of training touches, their groups left out."""
        machines = (
            (self.rehearsed,) if self.share == 1 else (self.plain, self.rehearsed)
        )
        # Of a group that is a whole class all is minus infinity: it tells nothing.
        rows = [
            log_softmax(without_gaps(m.left_out_log_likelihood())) for m in machines
        ]
        return rows[0] if self.share == 1 else self._both(*rows)

    @property
    def left_out_rows(self) -> Indices:
        """Which training touches these are, (n_left_out,)."""
        return self.plain.left_out_rows

    def _both(self, plain: Floats, rehearsed: Floats) -> Floats:
        return np.asarray((1 - self.share) * plain + self.share * rehearsed)


class EncodingPool(BayesRule):
    """Machines for parts of the feature vector, weighed by touches left out.

    Parameters
    ----------
    parts : mapping of str to int
        Name and number of features of each part, in the order of the features.
    machine : TouchClassifier, optional
        What learns each part; by default a `KernelRidgeClassifier` that chooses its
        width and ridge on at most 800 touches, or `NearbyTouches` of more labels than
        its landmarks can tell.
    together : bool, default=True
        Whether one more machine learns all parts side by side, where there are several.

    Attributes
    ----------
    classes_ : ndarray of shape (n_classes,)
        The labels, sorted.
    machines_ : dict of str to TouchClassifier
        One for each part, and perhaps one for all of them together.
    weights_ : dict of str to float
        Factor of each machine's log posterior, at least 0.
    scaling_ : ndarray of shape (n_classes + 1, n_classes) or None
        What the sum's log posteriors are corrected by: a matrix, and what every touch
        gets; None where it helps touches left out by no more than a standard error.
    penalty_ : float or None
        Its penalty, of least log loss; None where no matrix helped in `fit`.
    left_out_ : ndarray of shape (n_left_out, n_classes)
        Pooled log posterior of training touches, each with its group left out, and
        corrected by what touches of other groups tell.

    Notes
    -----
    The weights minimise the log loss of the touches left out. A priori each of n
    machines weighs 1 / n, with a standard deviation as large: where touches are so few
    that their loss says little, the pool stays near the mean of its machines.

    References
    ----------
    .. [1] G. E. Hinton, "Products of experts", ICANN 1999. doi:10.1049/cp:19991075

    Examples
    --------
    >>> import numpy as np
    >>> from palpate.classifiers import EncodingPool
    >>> X = np.r_[np.zeros((5, 3)), np.ones((5, 3))] + 0.1 * np.eye(10, 3)
    >>> pool = EncodingPool({"edges": 2, "load": 1})
    >>> pool.fit(X, ["pen"] * 5 + ["mug"] * 5).predict([[1, 1, 1]])
    array(['mug'], dtype='<U3')
    """

    # The kinds of machines that a pool has, unless the user gives one.
    MACHINES: ClassVar = (KernelRidgeClassifier, NearbyTouches, RehearsedMachine)
    classes_: Array
    # Models of earlier versions have none.
    scaling_: Floats | None = None
    penalty_: float | None = None

    def __init__(
        self,
        parts: Mapping[str, int],
        machine: TouchClassifier | None = None,
        *,
        together: bool = True,
    ) -> None:
        self.parts = parts
        self.machine = machine
        self.together = together

    def fit(self, X: ArrayLike, y: ArrayLike, groups: Groups = None) -> Self:
        """Let every machine learn its part, and weigh them by left-out groups.

        Parameters are those of `TouchClassifier.fit`, the parts side by side in `X`
        (n_touches, n_features).

        Raises
        ------
        ValueError
            If `parts` do not add up to the features, or as `KernelRidgeClassifier.fit`.
        """
        touches, labels = labelled_touches(self, X, y)
        check_squarable(touches)
        counts = [check_count(f"parts[{n!r}]", c) for n, c in self.parts.items()]
        if sum(counts) != touches.shape[1]:
            raise ValueError(
                f"parts must add up to the {touches.shape[1]} features of X, got "
                f"{sum(counts)}: {dict(self.parts)}."
            )
        group = as_groups(groups, len(touches))
        machine = self.machine
        if machine is None:
            machine = _machine_for(len(labels), len(np.unique(labels)))
        self.machines_ = {
            name: clone(machine).fit(part, labels, groups=group)
            for name, part in self._parts(touches).items()
        }
        self.classes_, codes = np.unique(labels, return_inverse=True)
        rows = self.left_out_rows
        return self.weighed_by(codes[rows], group[rows])

    def weighed_by(self, codes: Indices, groups: Array) -> Self:
        """Weigh the machines by left-out touches, and correct what they say together.

        `codes` are the columns of their labels, `groups` what they were left out with.
        """
        posteriors = self.left_out_posteriors()
        step = -(-codes.size * self.classes_.size // _MANY_ANSWERS)
        sampled = np.sort(np.argsort(codes, kind="stable")[::step])
        weights = self.best_weights(posteriors[:, sampled], codes[sampled])
        self.weights_ = dict(zip(self.machines_, weights.tolist(), strict=True))
        scaling = learn_scaling(self._summed(posteriors), codes, groups)
        self.scaling_, self.penalty_, self.left_out_ = scaling
        return self

    @staticmethod
    def best_weights(left_out: Floats, codes: Array) -> Floats:
        """Return the weights of least log loss, shape (n_machines,), at least 0.

        Of log posteriors (n_machines, n_touches, n_classes) of touches left out, and
        the column of each touch's own label (n_touches,). See `EncodingPool`.
        """
        n_machines, n_touches = left_out.shape[:2]
        usual = 1 / n_machines
        shares = n_touches * fair_shares(codes)

        def loss(weights: Floats) -> tuple[float, Floats]:
            value, pull = log_loss(np.tensordot(weights, left_out, 1), codes, shares)
            away = (weights - usual) / usual
            slope = np.tensordot(left_out, pull, 2)
            return value + (away**2).sum() / 2, slope + away / usual

        start, bounds = np.full(n_machines, usual), [(0, None)] * n_machines
        solution: Any = minimize(
            loss, start, jac=True, bounds=bounds, method="L-BFGS-B"
        )
        return np.asarray(solution.x)

    def beside(
        self,
        other: Self,
        weighing: Floats,
        share: float,
        codes: Indices,
        groups: Array,
    ) -> Self:
        """Return a pool whose machines answer together with those of another one.

        Of the other one, which learnt the same touches multiplied by `weighing`
        (n_features, n_features), answers count a share. `codes` and `groups` of touches
        left out are as in `weighed_by`, which weighs the machines anew.
        """
        both = copy(self)
        cuts = np.cumsum([0, *self.parts.values()])
        blocks = {
            name: np.ascontiguousarray(weighing[start:end, start:end])
            for name, start, end in zip(self.parts, cuts[:-1], cuts[1:], strict=True)
        } | {TOGETHER: weighing}
        both.machines_ = {
            name: RehearsedMachine(machine, other.machines_[name], blocks[name], share)
            for name, machine in self.machines_.items()
        }
        return both.weighed_by(codes, groups)

    @property
    def takes_weights(self) -> bool:  # type: ignore[override]
        """Whether every machine takes what each touch counts."""
        return _take_weights(self.machines_.values())

    def refit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        groups: Groups = None,
        weights: Floats | None = None,
        keep_shape: bool = False,
    ) -> Self:
        """Learn other touches with the widths, ridges and weights already chosen.

        Of machines that take it, what each touch counts (`weights`, (n_touches,)), and
        `keep_shape` of `KernelRidgeClassifier.refit`, which also keeps the scaling of
        the same labels.
        """
        touches, labels = labelled_touches(self, X, y, reset=False)
        check_squarable(touches)
        # Machines of the user's may take neither.
        more: dict[str, Any] = {}
        if weights is not None or keep_shape:
            more = {"weights": weights, "keep_shape": keep_shape}
        with config_context(assume_finite=True):  # as was just found
            self.machines_ = {
                name: copy(self.machines_[name]).refit(part, labels, groups, **more)
                for name, part in self._parts(touches).items()
            }
        before = self.classes_
        self.classes_, codes = np.unique(labels, return_inverse=True)
        posteriors = self.left_out_posteriors()
        if keep_shape and np.array_equal(before, self.classes_):
            self.left_out_ = self.pooled(posteriors)
            return self
        rows, group = self.left_out_rows, as_groups(groups, len(touches))
        taught = self._summed(posteriors), codes[rows], group[rows]
        scaling = scaling_with(self.penalty_, *taught, self.scaling_)
        self.scaling_, self.penalty_, self.left_out_ = scaling
        return self

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | object) up to a constant per touch (nats).

        Shape (n_touches, n_classes): the pooled posterior under equal priors.
        """
        return self.pooled(self.log_likelihood_by_part(X))

    def log_likelihood_by_part(self, X: ArrayLike) -> Floats:
        """Return what each machine says, (n_machines, n_touches, n_classes), in nats.

        In the order of `machines_`; zeros for those that weigh nothing.
        """
        touches = check_squarable(_touch_classifier.as_touches(self, X))
        shape = len(self.machines_), len(touches), len(self.classes_)
        log_likelihood, weighing = np.zeros(shape), []
        for row, (name, part) in enumerate(self._parts(touches).items()):
            if self.weights_[name]:
                log_likelihood[row] = self.machines_[name].log_likelihood_checked(part)
                weighing.append(row)
        log_likelihood[weighing] = np.maximum(
            log_softmax(log_likelihood[weighing]), _LEAST
        )
        return log_likelihood

    def left_out_log_likelihood(self) -> Floats:
        """Return `log_likelihood` of training touches with their groups left out."""
        check_is_fitted(self)
        return np.array(self.left_out_, dtype=np.float64)

    def stored(self) -> Self:
        """Return what a model file holds: of very many touches less precise answers."""
        if self.left_out_.size <= _MANY_ANSWERS:
            return self
        other = copy(self)
        other.left_out_ = self.left_out_.astype(np.float32)
        return other

    def resume(self, X: ArrayLike, y: ArrayLike) -> None:
        """Go on from the touches that were learnt before a model file was written."""
        for name, part in self._parts(np.asarray(X)).items():
            machine = self.machines_[name]
            if isinstance(machine, KernelRidgeClassifier):
                machine.resume(part, y)

    @property
    def left_out_rows(self) -> Indices:
        """Which training touches are told of when left out, (n_left_out,)."""
        return np.asarray(next(iter(self.machines_.values())).left_out_rows)

    def left_out_by_part(self) -> Floats:
        """Return what each machine alone says of touches left out, not bounded."""
        check_is_fitted(self)
        left_out = [m.left_out_log_likelihood() for m in self.machines_.values()]
        return np.stack(left_out)

    def left_out_posteriors(self) -> Floats:
        """Return the same as log posteriors, so bounded that none decides alone."""
        return np.maximum(log_softmax(without_gaps(self.left_out_by_part())), _LEAST)

    @property
    def part_weights(self) -> Mapping[str, float]:
        """Weight of each machine, by its name: `weights_`."""
        return self.weights_

    def _parts(self, touches: Floats) -> dict[str, Floats]:
        cuts = np.cumsum(list(self.parts.values()))[:-1]
        pieces = np.split(touches, cuts, axis=1)
        parts = dict(zip(self.parts, pieces, strict=True))
        if self.together and len(parts) > 1:
            parts[TOGETHER] = touches
        return parts

    def pooled(self, by_part: Floats) -> Floats:
        """Return the log posterior (n_touches, n_classes) of what each machine says."""
        return scaled(self._summed(by_part), self.scaling_)

    def corrected(self, log_likelihood: Floats, columns: Indices) -> Floats:
        """Return what the pool would say, had it learnt some of its labels alone.

        Of its machines' log posteriors of those `columns`, weighed and summed up
        (n_touches, n_columns).
        """
        bounded = np.maximum(log_softmax(log_likelihood), _LEAST)
        matrix = self.scaling_
        if matrix is not None:
            matrix = matrix[np.append(columns, -1)][:, columns]
        return scaled(bounded, matrix)

    def _summed(self, by_part: Floats) -> Floats:
        weights = np.array(list(self.weights_.values()))
        return np.tensordot(weights, by_part, 1)


def _machine_for(n_touches: int, n_labels: int) -> TouchClassifier:
    """Return what learns a part, unless the user says: ridge regression if it can."""
    machine = KernelRidgeClassifier(max_choice_touches=800)
    few = machine.n_landmarks < LANDMARKS_EACH * n_labels
    if few and machine.learns_by_landmarks(n_touches, n_labels):
        return NearbyTouches()
    return machine


def _take_weights(machines: Iterable[TouchClassifier]) -> bool:
    return all(getattr(machine, "takes_weights", False) for machine in machines)
