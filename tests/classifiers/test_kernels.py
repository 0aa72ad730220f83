"""Kernels and banks of them against scikit-learn's and against closed forms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.metrics.pairwise import polynomial_kernel, rbf_kernel

from palpate.classifiers import GaussianKernel, LinearKernel, PolynomialKernel
from palpate.classifiers._kernels import (
    check_kernels,
    kernel_diagonals,
    kernel_stack,
    paper_kernels,
)
from palpate.classifiers._mkl_banks import FeatureBank, GivenBank, kernel_scales


def reference(kernel, left, right):
    if isinstance(kernel, GaussianKernel):
        return rbf_kernel(left, right, gamma=1 / (2 * kernel.sigma**2))
    if isinstance(kernel, PolynomialKernel):
        return polynomial_kernel(
            left, right, degree=kernel.degree, gamma=1, coef0=kernel.offset
        )
    return left @ right.T


@pytest.fixture
def touches(rng):
    return rng.normal(size=(15, 4)) + np.array([3, 0, -1, 0])


def stack_of(kernels, left, right=None):
    mean = left.mean(axis=0)
    centred = left - mean
    other = centred if right is None else right - mean
    return kernel_stack(kernels, centred, other, mean)


def test_the_bank_of_the_paper_has_16_gaussians_and_6_polynomials():
    kernels = paper_kernels()
    assert [k.sigma for k in kernels[:16]] == [2.0**p for p in range(-5, 11)]
    assert kernels[16:] == [PolynomialKernel(p, 1.0) for p in range(1, 7)]


def test_every_kernel_agrees_with_scikit_learn(touches, rng):
    others = rng.normal(size=(7, 4))
    kernels = [*paper_kernels(), LinearKernel(), PolynomialKernel(3, 0.5)]
    stack = stack_of(kernels, touches, others)
    assert stack.shape == (24, 15, 7)
    for kernel, ours in zip(kernels, stack, strict=True):
        theirs = reference(kernel, touches, others)
        # Two fourth powers in a row multiply the rounding of exp by 16, and narrow
        # Gaussians multiply that of distances by up to 2^10 d^2 / 2.
        assert_allclose(ours, theirs, rtol=1e-9, atol=1e-200)


def test_a_batch_of_sets_is_each_set(touches):
    kernels = paper_kernels()
    mean = touches.mean(axis=0)
    index = np.array([[0, 3, 4], [7, 8, 2]])
    batch = (touches - mean)[index]
    stacks = kernel_stack(kernels, batch, batch, mean)
    whole = stack_of(kernels, touches)
    for row, stack in zip(index, stacks, strict=True):
        # Products of small and of whole matrices round differently.
        assert_allclose(stack, whole[:, row[:, None], row], rtol=1e-9, atol=1e-200)


def test_distances_far_from_the_origin_keep_their_digits():
    near = np.array([[0.0], [1e-3], [3e-3]])
    (there,) = stack_of([GaussianKernel(1e-3)], near + 1e6)
    (here,) = stack_of([GaussianKernel(1e-3)], near)
    # 1e6 + 1e-3 itself is rounded to 1e-10, a ten-millionth of the distance.
    assert_allclose(there, here, rtol=1e-5)


def test_diagonals_are_those_of_the_matrices(touches):
    kernels = [*paper_kernels(), LinearKernel()]
    mean = touches.mean(axis=0)
    diagonals = kernel_diagonals(kernels, touches - mean, mean)
    whole = np.einsum("kii->ki", stack_of(kernels, touches))
    assert_allclose(diagonals, whole, rtol=1e-12)


@pytest.mark.parametrize("bank_of", ["features", "matrices"])
def test_trace_and_variance_become_one(touches, bank_of):
    kernels = paper_kernels()
    for normalize in ("trace", "variance"):
        if bank_of == "features":
            bank = FeatureBank(kernels, touches, normalize)
        else:
            given = stack_of(kernels, touches).transpose(1, 2, 0)
            bank = GivenBank(given, normalize)
        blocks = bank.blocks(np.arange(15)[None])[0]
        amount = np.einsum("kii->k", blocks)
        if normalize == "variance":
            amount = amount / 15 - blocks.mean(axis=(1, 2))
        # The widest Gaussian differs from 1 by 1e-6: ten digits of its variance.
        assert_allclose(amount, 1, rtol=1e-8)


def test_a_kernel_that_tells_nothing_apart_gets_no_weight():
    diagonals = np.array([[0.0, 0.0], [2.0, 2.0], [1.0, 1.0]])
    assert_array_equal(kernel_scales(diagonals, None, "trace"), [0, 1 / 4, 1 / 2])
    mean = np.array([0.0, 2.0, 0.5])
    assert_array_equal(kernel_scales(diagonals, mean, "variance"), [0, 0, 2])
    assert_array_equal(kernel_scales(diagonals, None, None), [1, 1, 1])


def test_kernels_between_test_and_training_touches_are_scaled_by_training(touches):
    bank = FeatureBank([LinearKernel()], touches, "trace")
    assert_allclose(bank.scales, 1 / (touches**2).sum(), rtol=1e-12)


@pytest.mark.parametrize(
    ("kernels", "error", "message"),
    [
        ("rbf", ValueError, "'paper', 'precomputed' or a list, got 'rbf'"),
        (7, ValueError, "or a list, got 7"),
        ([], ValueError, "at least one kernel, got an empty list"),
        (["gaussian"], TypeError, "got 'gaussian'.*'precomputed'"),
    ],
)
def test_kernels_that_are_none_are_refused(kernels, error, message):
    with pytest.raises(error, match=message):
        check_kernels(kernels)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: GaussianKernel(0), ValueError, "sigma must be positive"),
        (lambda: GaussianKernel("wide"), TypeError, "sigma must be a number"),
        (lambda: PolynomialKernel(0), ValueError, "degree must be at least 1"),
        (lambda: PolynomialKernel(1.5), TypeError, "degree must be an integer"),
        (lambda: PolynomialKernel(2, -1), ValueError, "offset must be"),
    ],
)
def test_bad_parameters_of_a_kernel_are_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_overflow_is_refused_with_the_kernel_that_did():
    huge = np.array([[1e60], [2e60]])
    with pytest.raises(ValueError, match=r"PolynomialKernel\(degree=6.*Scale"):
        FeatureBank([GaussianKernel(1), PolynomialKernel(6)], huge, "trace")


def given(matrix):
    return np.stack([np.eye(len(matrix)), matrix], axis=2)


def test_a_skew_matrix_is_refused():
    with pytest.raises(ValueError, match=r"symmetric, got a difference of 0\.2"):
        GivenBank(given(np.array([[1, 0.3], [0.1, 1]])), None)


def test_an_indefinite_matrix_is_refused_with_its_eigenvalue():
    # Eigenvalues of [[0, 1], [1, 0]] are 1 and -1.
    with pytest.raises(ValueError, match=r"semi-definite, got an eigenvalue of -1 "):
        GivenBank(given(np.array([[0.0, 1.0], [1.0, 0.0]])), None)


@pytest.mark.parametrize("matrix", [np.ones((3, 3)), np.zeros((3, 3))])
def test_singular_matrices_are_kernels(matrix):
    assert GivenBank(given(matrix), None).blocks(np.arange(3)[None]).shape[1] == 2


def test_rounding_of_single_precision_is_forgiven(rng):
    points = rng.normal(size=(40, 3)).astype(np.float32)
    gram = (points @ points.T).astype(np.float32)
    # Rank 3 of 40: single precision leaves eigenvalues around -1e-6.
    assert np.linalg.eigvalsh(gram.astype(float))[0] < -1e-8
    assert GivenBank(gram[:, :, None], "trace").n_touches == 40
