"""Banks of kernels: their scales, and what is refused as a kernel."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.classifiers import MKLSVC, GaussianKernel, PolynomialKernel
from palpate.classifiers.mkl import paper_kernels


def fitted(vectors, **options):
    labels = np.arange(len(vectors)) % 2
    return MKLSVC(probability=False, **options).fit(vectors, labels)


def stacked(*matrices):
    return np.stack(matrices, axis=2)


def test_the_bank_of_the_paper_has_16_gaussians_and_6_polynomials():
    kernels = paper_kernels()
    assert [k.sigma for k in kernels[:16]] == [2.0**p for p in range(-5, 11)]
    assert kernels[16:] == [PolynomialKernel(p, 1.0) for p in range(1, 7)]


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: GaussianKernel(0), ValueError, "sigma must be positive"),
        (lambda: GaussianKernel("wide"), TypeError, "sigma must be a number"),
        (lambda: GaussianKernel(1e200), ValueError, r"between 1e-150 .*got 1e\+200"),
        (lambda: GaussianKernel(1e-200), ValueError, "between 1e-150 .*got 1e-200"),
        (lambda: PolynomialKernel(0), ValueError, "degree must be at least 1"),
        (lambda: PolynomialKernel(1.5), TypeError, "degree must be an integer"),
        (lambda: PolynomialKernel(2, -1), ValueError, "offset must be"),
    ],
)
def test_bad_parameters_of_a_kernel_are_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize("kind", ["features", "matrices"])
def test_trace_and_variance_become_one(vectors, kind, reference):
    kernels = paper_kernels()
    matrices = [reference(kernel, vectors, vectors) for kernel in kernels]
    amounts = {
        "trace": [m.trace() for m in matrices],
        "variance": [m.trace() / len(m) - m.mean() for m in matrices],
    }
    for normalize, amount in amounts.items():
        options = {"normalize": normalize, "C": 1.0, "kernels": kernels}
        if kind == "features":
            machine = fitted(vectors, **options)
        else:
            machine = fitted(stacked(*matrices), **options | {"kernels": "precomputed"})
        # The widest Gaussian differs from 1 by 1e-6: ten digits of its variance.
        assert_allclose(machine.kernel_scales_ * amount, 1, rtol=1e-8)


def test_a_kernel_that_tells_nothing_apart_gets_no_weight():
    stack = stacked(np.zeros((2, 2)), np.full((2, 2), 2.0), np.eye(2))
    for normalize, scales in (
        ("trace", [0, 1 / 4, 1 / 2]),
        ("variance", [0, 0, 2]),
        (None, [1, 1, 1]),
    ):
        machine = fitted(stack, kernels="precomputed", normalize=normalize)
        assert_array_equal(machine.kernel_scales_, scales)


@pytest.mark.parametrize(
    ("kernels", "error", "message"),
    [
        ("rbf", ValueError, "'paper', 'precomputed' or a list, got 'rbf'"),
        (7, ValueError, "or a list, got 7"),
        ([], ValueError, "at least one kernel, got an empty list"),
        (["gaussian"], TypeError, "got 'gaussian'.*'precomputed'"),
    ],
)
def test_kernels_that_are_none_are_refused(kernels, error, message, vectors):
    with pytest.raises(error, match=message):
        fitted(vectors, kernels=kernels)


def test_distances_far_from_the_origin_keep_their_digits(vectors):
    near, far = 1e-3 * vectors, 1e-3 * vectors + 1e6
    here, there = (
        fitted(X, kernels=[GaussianKernel(1e-3)]).decision_function(X)
        for X in (near, far)
    )
    # 1e6 + 1e-3 itself is rounded to 1e-10, a ten-millionth of the distance.
    assert_allclose(there, here, atol=1e-5)


def test_overflow_is_refused_with_the_kernel_that_did():
    huge = np.array([[1e60], [2e60]])
    with pytest.raises(
        ValueError, match=r"must be finite, got infinity from Poly.*\(degree=6.*Scale"
    ):
        fitted(huge, kernels=[GaussianKernel(1), PolynomialKernel(6)])


def test_rounding_of_single_precision_is_forgiven(rng):
    points = rng.normal(size=(40, 3)).astype(np.float32)
    gram = (points @ points.T).astype(np.float32)
    # Rank 3 of 40: single precision leaves eigenvalues around -1e-6.
    assert np.linalg.eigvalsh(gram.astype(float))[0] < -1e-8
    assert fitted(stacked(gram), kernels="precomputed", C=1.0).n_features_in_ == 40
