"""One binary support vector machine per label, and a rule for who wins.

Each machine answers "mine" or "not mine" without knowing of the others, so a touch
may be claimed by several labels or by none; both cases need a rule.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.metrics.pairwise import pairwise_kernels
from sklearn.svm import SVC
from sklearn.utils.validation import check_is_fitted

from .._checks import check_option, check_positive, check_squarable
from .._types import Array, Floats
from ._touch_classifier import as_touches, labelled_touches

KERNELS = ("linear", "poly", "rbf", "sigmoid")


class OnePerLabelSVC(ClassifierMixin, BaseEstimator):
    """Binary support vector machines side by side; the largest claiming label wins.

    Parameters
    ----------
    C : float, default=1.0
        Penalty of a training touch on the wrong side of its margin.
    kernel : {"rbf", "linear", "poly", "sigmoid"}, default="rbf"
        Kernel of all machines; "poly" is cubic.
    gamma : {"scale", "auto"} or float, default="scale"
        Coefficient of the kernel: "scale" is 1 / (n_features * variance of all
        values of `X`), "auto" is 1 / n_features.

    Attributes
    ----------
    classes_ : ndarray of shape (n_labels,)
        The labels, sorted.
    gamma_ : float
        The coefficient in use.
    support_touches_ : ndarray of shape (n_support, n_features)
        Training touches on which any machine rests.
    coefficients_ : ndarray of shape (n_support, n_labels)
        Signed dual coefficients, a column per machine.
    intercepts_ : ndarray of shape (n_labels,)
        Offsets of the machines.

    Notes
    -----
    A machine claims a touch when its decision value is positive. Of the labels that
    claim it the largest in sorted order wins, which the paper [1]_ calls arbitrary.
    For touches that none claims the paper has no rule: here the label with the
    largest decision value wins, the first of equals.

    References
    ----------
    .. [1] T. Corradi, P. Hall and P. Iravani, "Tactile features: recognising touch
       sensations with a novel and inexpensive tactile sensor", TAROS 2014,
       LNCS 8717. doi:10.1007/978-3-319-10401-0

    Examples
    --------
    >>> from palpate.classifiers import OnePerLabelSVC
    >>> touches = [[0.0, 0.0], [0.1, 0.2], [1.0, 1.0], [0.9, 1.1]]
    >>> model = OnePerLabelSVC(C=10).fit(touches, ["edge", "edge", "flat", "flat"])
    >>> model.predict([[0.2, 0.1], [0.8, 0.9]])
    array(['edge', 'flat'], dtype='<U4')
    """

    def __init__(
        self, C: float = 1.0, kernel: str = "rbf", gamma: str | float = "scale"
    ) -> None:
        self.C = C
        self.kernel = kernel
        self.gamma = gamma

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Train one machine per label against all others.

        Parameters
        ----------
        X : array-like of shape (n_touches, n_features)
            Feature vectors, roughly of equal scale.
        y : array-like of shape (n_touches,)
            Their labels, at least two different ones.

        Raises
        ------
        ValueError
            For fewer than two labels, NaN, infinity, or unequal lengths.
        """
        self._check_parameters()
        touches, labels = labelled_touches(self, X, y)
        check_squarable("X", touches)
        self.classes_, codes = np.unique(labels, return_inverse=True)
        n_labels = len(self.classes_)
        if n_labels < 2:
            raise ValueError(
                f"y must have at least two labels, got {n_labels} class. "
                "Add touches of another label."
            )
        self.gamma_ = self._gamma_of(touches)
        coefficients = np.zeros((len(touches), n_labels))
        self.intercepts_ = np.zeros(n_labels)
        for place in range(n_labels):
            machine = SVC(C=self.C, kernel=self.kernel, gamma=self.gamma_)
            machine.fit(touches, codes == place)
            coefficients[machine.support_, place] = machine.dual_coef_[0]
            self.intercepts_[place] = machine.intercept_[0]
        supports = coefficients.any(axis=1)
        self.support_touches_ = touches[supports]
        self.coefficients_ = coefficients[supports]
        return self

    def decision_values(self, X: ArrayLike) -> Floats:
        """Return what each machine says, (n_touches, n_labels); positive is "mine"."""
        check_is_fitted(self)
        kernel = pairwise_kernels(
            as_touches(self, X),
            self.support_touches_,
            metric=self.kernel,
            filter_params=True,
            gamma=self.gamma_,
            degree=3,
            coef0=0,
        )
        return np.asarray(kernel @ self.coefficients_ + self.intercepts_)

    def predict(self, X: ArrayLike) -> Array:
        """Return the winning label of each touch."""
        winners = winning(self.decision_values(X))
        return self.classes_[winners]

    def _check_parameters(self) -> None:
        check_positive("C", self.C)
        check_option("kernel", self.kernel, KERNELS)
        if isinstance(self.gamma, str):
            check_option("gamma", self.gamma, ("scale", "auto"))
        else:
            check_positive("gamma", self.gamma)

    def _gamma_of(self, touches: Floats) -> float:
        if not isinstance(self.gamma, str):
            return float(self.gamma)
        variance = float(touches.var()) if self.gamma == "scale" else 1.0
        return 1 / (touches.shape[1] * variance) if variance > 0 else 1.0


def winning(values: Floats) -> NDArray[np.intp]:
    """Return the label that wins each touch, by decisions (n_touches, n_labels)."""
    claims = values > 0
    last_claim = claims.shape[1] - 1 - claims[:, ::-1].argmax(axis=1)
    winners: NDArray[np.intp] = np.where(
        claims.any(axis=1), last_claim, values.argmax(axis=1)
    )
    return winners
