"""Touches and kernels for the tests of classifiers."""

import numpy as np
import pytest
from sklearn.metrics.pairwise import polynomial_kernel, rbf_kernel

from palpate.classifiers import MKLSVC, GaussianKernel, LinearKernel, PolynomialKernel

BANK = [GaussianKernel(0.5), GaussianKernel(2.0), PolynomialKernel(2), LinearKernel()]


def platt_loss(sigmoid, scores, labels):
    n_plus, n_minus = (labels > 0).sum(), (labels < 0).sum()
    target = np.where(labels > 0, (n_plus + 1) / (n_plus + 2), 1 / (n_minus + 2))
    z = sigmoid[0] * scores + sigmoid[1]
    return (np.logaddexp(0, z) - target * z).sum()


@pytest.fixture
def vectors(rng):
    """Fifteen touches of four features, away from the origin."""
    return rng.normal(size=(15, 4)) + np.array([3, 0, -1, 0])


@pytest.fixture
def draw():
    """Return n touches of some classes that overlap, and their classes."""

    def make(n, n_classes=2, seed=0):
        rng = np.random.default_rng(seed)
        codes = rng.integers(n_classes, size=n)
        codes[:n_classes] = range(n_classes)
        return rng.normal(size=(n, 6)) + np.eye(n_classes, 6)[codes], codes

    return make


@pytest.fixture
def landmarks():
    """Return an unfitted machine of four kernels through n landmarks."""

    def make(n, **options):
        through = {"approximation": "nystroem", "n_landmarks": n, "random_state": 0}
        return MKLSVC(kernels=BANK, **through, **options)

    return make


@pytest.fixture
def exact():
    """Return an unfitted machine of the same kernels, without landmarks."""
    return lambda **options: MKLSVC(kernels=BANK, approximation="none", **options)


@pytest.fixture
def reference():
    """Return a kernel's matrix as scikit-learn computes it."""

    def matrix(kernel, left, right):
        if isinstance(kernel, GaussianKernel):
            return rbf_kernel(left, right, gamma=1 / (2 * kernel.sigma**2))
        if isinstance(kernel, PolynomialKernel):
            degree, offset = kernel.degree, kernel.offset
            return polynomial_kernel(left, right, degree=degree, gamma=1, coef0=offset)
        return left @ right.T

    return matrix
