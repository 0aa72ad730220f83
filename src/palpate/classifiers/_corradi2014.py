"""Two classifiers of Corradi et al. 2014: naive Bayes, and a binary machine per label.

In naive Bayes each feature is a witness of its own: the likelihood of a touch is the
product, over features, of how probable that feature's value is among the label's
training touches. Cruder than one density over all features, and in need of far fewer
touches. Each machine answers "mine" or "not mine" without knowing of the others, so a
touch may be claimed by several labels or by none; both cases need a rule.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.metrics.pairwise import pairwise_kernels
from sklearn.svm import SVC

from .._checks import check_option, check_positive, check_squarable
from .._numbers import exp
from .._types import Array, Floats
from ._kernel_density import blocks_of, learn_whitening, whiten
from ._touch_classifier import BayesRule, as_touches, classes_of, labelled_touches

# Interquartile range of a Gaussian, in standard deviations.
GAUSSIAN_IQR = 1.349
KERNELS = ("linear", "poly", "rbf", "sigmoid")


class KernelDensityNaiveBayes(BayesRule):
    """Naive Bayes classifier with Gaussian kernel densities per feature.

    Parameters
    ----------
    bandwidth : {"scott", "silverman"} or float, default="scott"
        Standard deviation of the Gaussians around the n values that a feature takes
        in a label's touches. "scott": (4/3)^(1/5) s n^(-1/5), best when the values
        are Gaussian with standard deviation s [2]_. "silverman": 0.9 a n^(-1/5), a
        being the smaller of s and interquartile range / 1.349 [3]_. A number: that
        share of the feature's standard deviation over all training touches.
    prior : {"uniform", "counts"}, default="uniform"
        Labels are equally probable before the touch, or in proportion to their
        number of training touches.
    min_bandwidth : float, default=1e-2
        Least bandwidth of a rule, as a share of the feature's standard deviation
        over all training touches.

    Attributes
    ----------
    classes_ : ndarray of shape (n_labels,)
        The labels, sorted.
    counts_ : ndarray of int, shape (n_labels,)
        Training touches of each label.
    centre_, spread_, varies_ : ndarray of shape (n_features,)
        Mean and standard deviation of the training touches, and whether the feature
        varied at all among them.
    log_volume_ : float
        Sum of the logarithms of the standard deviations.
    points_ : ndarray of shape (n_touches, n_varying)
        Standardised training touches, label by label.
    bandwidths_ : ndarray of shape (n_labels, n_varying)
        Bandwidths in those standard deviations.

    Notes
    -----
    The paper [1]_ names kernel density estimation and no rule for its bandwidth.
    Features that are constant up to rounding over all training touches are left out.
    A label with a single touch has no spread of its own: s is then that of all
    training touches. Everything is exact, in float64 and in natural logarithms.

    References
    ----------
    .. [1] T. Corradi, P. Hall and P. Iravani, "Tactile features: recognising touch
       sensations with a novel and inexpensive tactile sensor", TAROS 2014,
       LNCS 8717. doi:10.1007/978-3-319-10401-0
    .. [2] D. W. Scott, "Multivariate Density Estimation", Wiley, 1992.
       doi:10.1002/9780470316849
    .. [3] B. W. Silverman, "Density Estimation for Statistics and Data Analysis",
       Chapman and Hall, 1986, eq. 3.31. doi:10.1201/9781315140919

    Examples
    --------
    >>> from palpate.classifiers import KernelDensityNaiveBayes
    >>> touches = [[0.0, 0.1], [0.1, 0.0], [1.0, 0.9], [0.9, 1.0]]
    >>> model = KernelDensityNaiveBayes().fit(touches, ["edge", "edge", "flat", "flat"])
    >>> model.predict([[0.2, 0.2], [0.7, 0.8]])
    array(['edge', 'flat'], dtype='<U4')
    """

    def __init__(
        self,
        bandwidth: str | float = "scott",
        prior: str = "uniform",
        min_bandwidth: float = 1e-2,
    ) -> None:
        self.bandwidth = bandwidth
        self.prior = prior
        self.min_bandwidth = min_bandwidth

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Store touches `X` (n_touches, n_features) with labels `y`, set bandwidths.

        Raises
        ------
        ValueError
            For NaN, infinity, variances that overflow, or unequal lengths.
        """
        if isinstance(self.bandwidth, str):
            check_option("bandwidth", self.bandwidth, RULES)
        else:
            check_positive("bandwidth", self.bandwidth)
        check_option("prior", self.prior, ("uniform", "counts"))
        check_positive("min_bandwidth", self.min_bandwidth)
        touches, labels = labelled_touches(self, X, y)
        self.classes_, codes = np.unique(labels, return_inverse=True)
        self.counts_ = np.bincount(codes)
        learnt = learn_whitening(touches, full=False)
        self.centre_, self.spread_, self.varies_, _, self.log_volume_ = learnt
        self.points_ = self._standardise(touches[np.argsort(codes, kind="stable")])
        parts = np.split(self.points_, np.cumsum(self.counts_)[:-1])
        if isinstance(self.bandwidth, str):
            widths = np.array([RULES[self.bandwidth](part) for part in parts])
            self.bandwidths_ = np.maximum(widths, self.min_bandwidth)
        else:
            shape = len(parts), self.points_.shape[1]
            self.bandwidths_ = np.full(shape, float(self.bandwidth))
        return self

    def log_likelihood(self, X: ArrayLike) -> Floats:
        """Return log p(touch | label) in nats, shape (n_touches, n_labels)."""
        x = self._standardise(as_touches(self, X))
        constant = -self.log_volume_ - x.shape[1] * np.log(2 * np.pi) / 2
        widths = np.log(self.bandwidths_).sum(axis=1)
        constants = constant - widths - x.shape[1] * np.log(self.counts_)
        sums = np.zeros((len(x), len(self.classes_)))
        for rows in blocks_of(len(x)):
            for feature in range(x.shape[1]):
                sums[rows] += self._log_sums(x[rows, feature], feature)
        return np.asarray(sums + constants)

    def _standardise(self, touches: Floats) -> Floats:
        return whiten(touches, self.centre_, self.spread_, self.varies_, None)

    def _log_sums(self, x: Floats, feature: int) -> Floats:
        """Return logs of the sums of Gaussians, (len(x), n_labels), for one feature."""
        starts = np.cumsum(self.counts_) - self.counts_
        widths = np.repeat(self.bandwidths_[:, feature], self.counts_)
        exponents = np.subtract.outer(self.points_[:, feature], x)
        exponents /= widths[:, np.newaxis]
        exponents *= exponents
        exponents /= -2
        largest = np.maximum.reduceat(exponents, starts, axis=0)
        exponents -= np.repeat(largest, self.counts_, axis=0)
        exp(exponents, out=exponents)
        sums: Floats = np.add.reduceat(exponents, starts, axis=0)
        return (largest + np.log(sums)).T


def _silverman(values: Floats) -> Floats:
    """Return the bandwidth that also suits skewed and two-peaked values."""
    spread = _deviations(values)
    low, high = np.quantile(values, [0.25, 0.75], axis=0)
    robust = (high - low) / GAUSSIAN_IQR
    # Half of the values may be equal; the deviation alone is left to go by.
    spread = np.where(robust > 0, np.minimum(spread, robust), spread)
    return np.asarray(0.9 * spread * len(values) ** -0.2)


def _deviations(values: Floats) -> Floats:
    if len(values) == 1:
        return np.ones(values.shape[1])
    return np.asarray(values.std(axis=0, ddof=1))


RULES: dict[str, Callable[[Floats], Floats]] = {
    "scott": lambda v: np.asarray((4 / 3) ** 0.2 * _deviations(v) * len(v) ** -0.2),
    "silverman": _silverman,
}


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
        """Train one machine per label `y`, at least two, against all others.

        `X` (n_touches, n_features) are feature vectors, roughly of equal scale.

        Raises
        ------
        ValueError
            For fewer than two labels, NaN, infinity, or unequal lengths.
        """
        check_positive("C", self.C)
        check_option("kernel", self.kernel, KERNELS)
        if isinstance(self.gamma, str):
            check_option("gamma", self.gamma, ("scale", "auto"))
        else:
            check_positive("gamma", self.gamma)
        touches, labels = labelled_touches(self, X, y)
        check_squarable(touches)
        self.classes_, codes = classes_of(labels)
        n_labels = len(self.classes_)
        if isinstance(self.gamma, str):
            variance = float(touches.var()) if self.gamma == "scale" else 1.0
            unit = touches.shape[1] * variance if variance > 0 else 1.0
            self.gamma_ = 1 / unit
        else:
            self.gamma_ = float(self.gamma)
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
        values = self.decision_values(X)
        claims = values > 0
        last_claim = claims.shape[1] - 1 - claims[:, ::-1].argmax(axis=1)
        best = values.argmax(axis=1)
        winners = np.where(claims.any(axis=1), last_claim, best)
        return np.asarray(self.classes_[winners])
