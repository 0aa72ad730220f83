"""Multiple kernel learning against independent optima and closed cases.

Then its parts: kernels against scikit-learn's, landmarks against whole matrices.

The weights of the optimum need not be unique, so J, the gap and decisions are
compared, never weights, unless the case says what they must be.
"""

import warnings
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.svm import SVC

from palpate.classifiers import (
    MKLSVC,
    GaussianKernel,
    LinearKernel,
    PolynomialKernel,
)
from palpate.classifiers.mkl import (
    _landmarks,
    _svc,
    kernel_diagonals,
    paper_kernels,
)
from palpate.classifiers.mkl._dense import DenseKernels
from palpate.classifiers.mkl._kernels import FeatureBank, kernel_stack
from palpate.classifiers.mkl._landmarks import LowRankKernels, NystroemBank
from palpate.classifiers.mkl._problem import Point, Task, solve_interior
from palpate.classifiers.mkl._simplemkl import solve_simplemkl

# Seed, touches, price of errors, and whether kernels are of trace 1 or n.
PROBLEMS = [
    pytest.param(0, 20, 1.0, False, id="n20-C1"),
    pytest.param(1, 30, 10.0, True, id="n30-C10"),
    pytest.param(2, 40, 100.0, False, id="n40-C100"),
    pytest.param(3, 50, 1000.0, True, id="n50-C1000"),
    pytest.param(4, 60, 1000.0, False, id="n60-C1000"),
    pytest.param(5, 60, 30.0, True, id="n60-C30"),
]
BANK = [GaussianKernel(0.5), GaussianKernel(2.0), PolynomialKernel(2), LinearKernel()]


def problem(seed, n, kernels=None, large=True):
    rng = np.random.default_rng(seed)
    labels = np.where(rng.random(n) < 0.5, 1.0, -1.0)
    labels[:2] = 1, -1
    touches = rng.normal(size=(n, 5))
    touches[:, :2] += 0.7 * labels[:, None]
    listed = paper_kernels() if kernels is None else kernels
    stack = kernel_stack(listed, touches, touches, np.zeros(5))
    stack /= np.einsum("kii->k", stack)[:, None, None]
    return SimpleNamespace(kernels=stack * n if large else stack, labels=labels)


def solve(kernels, labels, C, solver=solve_interior, **options):
    """One problem by itself, its row of the answer."""
    system = DenseKernels(np.array(kernels)[None], np.array(labels, float)[None])
    rows = solver(system, C, **options)
    return SimpleNamespace(**{name: row[0] for name, row in vars(rows).items()})


def root(kernel):
    values, vectors = np.linalg.eigh(kernel)
    kept = values > 1e-11 * values[-1]
    return vectors[:, kept] * np.sqrt(values[kept])


def solved(cp, task):
    # Clarabel doubts its last digits on some machines; the comparison of two forms
    # of the problem with each other and with ours is what counts.
    limits = {"tol_gap_rel": 1e-7, "tol_gap_abs": 1e-12, "tol_feas": 1e-7}
    # Clarabel fails now and then with one length of steps, and not with another.
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Solution may be inaccurate")
        for longest in (0.95, 0.9, 0.8):
            with suppress(cp.error.SolverError):
                return task.solve(cp.CLARABEL, max_step_fraction=longest, **limits)
        return task.solve(cp.CLARABEL, max_step_fraction=0.7, **limits)


def in_units_of_the_kernels(kernels, C):
    """Kernels of trace n, a price to match, and the unit of J."""
    unit = kernels[0].trace() / len(kernels[0])
    return [root(k / unit) for k in kernels], C * unit, 1 / unit


def optimum_of_the_qcqp(cp, kernels, labels, C):
    """Eq. 12 of Liu et al. 2014."""
    roots, C, unit = in_units_of_the_kernels(kernels, C)
    alpha, level = cp.Variable(len(labels)), cp.Variable()
    signed = cp.multiply(labels, alpha)
    inside = [alpha >= 0, alpha <= C, labels @ alpha == 0]
    inside += [0.5 * cp.sum_squares(r.T @ signed) <= level for r in roots]
    return unit * solved(cp, cp.Problem(cp.Maximize(cp.sum(alpha) - level), inside))


def optimum_of_the_socp(cp, kernels, labels, C, norm=1):
    """Eq. 11 with the weights minimised out: a mixed norm of the normals."""
    roots, C, unit = in_units_of_the_kernels(kernels, C)
    normals = [cp.Variable(r.shape[1]) for r in roots]
    bias, errors = cp.Variable(), cp.Variable(len(labels))
    decisions = sum(r @ w for r, w in zip(roots, normals, strict=True)) + bias
    lengths = cp.hstack([cp.norm(w) for w in normals])
    power = 2 * norm / (norm + 1)
    mixed = cp.sum(lengths) if norm == 1 else cp.pnorm(lengths, power)
    cost = 0.5 * cp.square(mixed) + C * cp.sum(errors)
    inside = [errors >= 0, cp.multiply(labels, decisions) >= 1 - errors]
    return unit * solved(cp, cp.Problem(cp.Minimize(cost), inside))


@pytest.mark.parametrize(("seed", "n", "C", "large"), PROBLEMS)
def test_j_is_the_optimum_of_the_qcqp_and_of_the_socp(seed, n, C, large):
    cp = pytest.importorskip("cvxpy")
    task = problem(seed, n, large=large)
    ours = solve(task.kernels, task.labels, C)
    assert ours.gap <= 1e-6
    # The tolerance asked for; the reference itself stops at 1e-7.
    qcqp = optimum_of_the_qcqp(cp, task.kernels, task.labels, C)
    assert_allclose(ours.objective, qcqp, rtol=1e-6)
    socp = optimum_of_the_socp(cp, task.kernels, task.labels, C)
    assert_allclose(ours.objective, socp, rtol=1e-6)


@pytest.mark.parametrize("norm", [2, 3])
@pytest.mark.parametrize(("seed", "n", "C", "large"), PROBLEMS[1:4:2])
def test_other_norms_reach_the_optimum_of_their_socp(seed, n, C, large, norm):
    cp = pytest.importorskip("cvxpy")
    task = problem(seed, n, large=large)
    ours = solve(task.kernels, task.labels, C, norm=norm)
    socp = optimum_of_the_socp(cp, task.kernels, task.labels, C, norm)
    assert_allclose(ours.objective, socp, rtol=1e-6)
    assert_allclose((ours.weights**norm).sum(), 1, rtol=1e-12)


@pytest.mark.parametrize("norm", [1, 1.05, 1.5, 8, 64])
def test_any_norm_closes_its_gap(norm):
    task = problem(3, 50)
    assert solve(task.kernels, task.labels, 10, norm=norm).gap <= 1e-6


def test_j_falls_as_the_norm_lets_more_weight_in():
    task = problem(5, 40)
    objectives = [
        solve(task.kernels, task.labels, 10, norm=p).objective for p in (1, 2, 5)
    ]
    assert objectives[0] > objectives[1] > objectives[2]


def test_simplemkl_stops_at_the_gap_of_the_paper():
    task = problem(1, 30)
    loose = solve(task.kernels, task.labels, 10, solve_simplemkl)
    exact = solve(task.kernels, task.labels, 10)
    assert loose.gap <= 1e-2
    # J(d) at any weights is above the optimum, and here by at most the gap.
    assert exact.objective < loose.objective <= exact.objective * (1 + 1e-2)
    assert loose.n_iter >= 1


@pytest.mark.parametrize("n_iter", [1, 3, 5])
def test_the_gap_is_a_bound_wherever_the_iteration_stops(n_iter):
    task = problem(2, 40)
    optimum = solve(task.kernels, task.labels, 5, tol=1e-9).objective
    early = solve(task.kernels, task.labels, 5, max_iter=n_iter)
    assert early.n_iter == n_iter
    assert early.gap > 1e-6
    # Both J and the optimum lie between the two bounds that make the gap.
    assert abs(early.objective - optimum) <= early.gap / (1 - early.gap) * optimum


def test_one_kernel_is_a_support_vector_machine():
    task = problem(4, 50, [GaussianKernel(1.5)])
    (kernel,) = task.kernels
    for C in (0.1, 1, 100):
        ours = solve([kernel], task.labels, C, tol=1e-10)
        theirs = SVC(kernel="precomputed", C=C, tol=1e-10).fit(kernel, task.labels)
        alpha = np.zeros(50)
        alpha[theirs.support_] = theirs.dual_coef_[0] * task.labels[theirs.support_]
        signed = task.labels * alpha
        objective = alpha.sum() - signed @ kernel @ signed / 2
        assert_allclose(ours.objective, objective, rtol=1e-8)
        decisions = kernel @ (task.labels * ours.alpha) + ours.bias
        # A gap g of J moves decisions by up to sqrt(2 g J k(x, x)), here 1e-4.
        assert_allclose(decisions, theirs.decision_function(kernel), atol=5e-4)


def test_two_touches_have_a_closed_form():
    # K = I: J = max 2a - a^2, at a = min(1, C).
    for C, objective in ((10, 1), (1, 1), (0.3, 0.51)):
        ours = solve([np.eye(2)], [1, -1], C)
        assert_allclose(ours.objective, objective, rtol=1e-6)
        assert_allclose(ours.bias, 0, atol=1e-6)


@pytest.mark.parametrize("solver", [solve_interior, solve_simplemkl])
def test_the_larger_of_two_proportional_kernels_takes_all_weight(solver):
    task = problem(0, 30, BANK[:1])
    both = np.concatenate([task.kernels, 3 * task.kernels])
    ours = solve(both, task.labels, 10, solver, tol=1e-8)
    assert_allclose(ours.weights, [0, 1], atol=1e-4)
    larger = solve(both[1:], task.labels, 10, tol=1e-8)
    assert_allclose(ours.objective, larger.objective, rtol=1e-7)


def test_a_kernel_twice_changes_nothing():
    task = problem(1, 30, BANK)
    twice = np.concatenate([task.kernels, task.kernels[:2]])
    once = solve(task.kernels, task.labels, 10, tol=1e-8)
    assert_allclose(
        solve(twice, task.labels, 10, tol=1e-8).objective, once.objective, rtol=2e-8
    )


def test_opposite_labels_give_the_opposite_machine():
    task = problem(2, 30, BANK)
    here = solve(task.kernels, task.labels, 10, tol=1e-9)
    there = solve(task.kernels, -task.labels, 10, tol=1e-9)
    assert_allclose(there.objective, here.objective, rtol=1e-8)
    # The two paths mirror each other, up to the order of sums.
    assert_allclose(there.bias, -here.bias, atol=1e-5)


def test_j_falls_as_kernels_are_added():
    task = problem(3, 40)
    objectives = [
        solve(task.kernels[:m], task.labels, 10, tol=1e-8).objective
        for m in (1, 4, 8, 16, 22)
    ]
    # Never up by more than the gap.
    assert (np.diff(objectives) <= 2e-8 * objectives[0]).all()
    assert objectives[-1] < objectives[0]


def test_scaling_kernels_and_price_against_each_other_changes_nothing():
    task = problem(4, 30, BANK)
    unscaled = solve(task.kernels, task.labels, 10, tol=1e-9)
    for scale in (1e-6, 1e6):
        scaled = solve(scale * task.kernels, task.labels, 10 / scale, tol=1e-9)
        assert_allclose(scale * scaled.objective, unscaled.objective, rtol=1e-8)
        assert_allclose(scale * scaled.alpha, unscaled.alpha, atol=1e-3)


def test_a_batch_is_its_problems_and_padding_is_nothing():
    tasks = [problem(seed, n, BANK) for seed, n in ((0, 20), (1, 30), (2, 26))]
    kernels, labels = np.ones((3, 4, 30, 30)), np.zeros((3, 30))
    for row, task in enumerate(tasks):
        n = len(task.labels)
        kernels[row, :, :n, :n], labels[row, :n] = task.kernels, task.labels
    for solver in (solve_interior, solve_simplemkl):
        batch = solver(DenseKernels(kernels, labels), 10, tol=1e-6)
        alone = [solve(t.kernels, t.labels, 10, solver, tol=1e-6) for t in tasks]
        # Each is within its gap of its optimum.
        assert_allclose(batch.objective, [a.objective for a in alone], rtol=2e-6)
        assert_array_equal(batch.alpha[0, 20:], 0)


def test_multipliers_are_feasible():
    task = problem(5, 60)
    ours = solve(task.kernels, task.labels, 3)
    assert (ours.alpha >= 0).all()
    assert (ours.alpha <= 3).all()
    assert_allclose(task.labels @ ours.alpha, 0, atol=1e-12 * ours.alpha.sum())
    assert_allclose(ours.weights.sum(), 1, rtol=1e-12)
    assert (ours.weights >= 0).all()


@pytest.mark.parametrize("solver", [solve_interior, solve_simplemkl])
@pytest.mark.parametrize(
    ("kernel", "labels", "objective"),
    [
        pytest.param(np.ones((2, 2)), [1, -1], 2, id="one-place-two-labels"),
        pytest.param(np.zeros((3, 3)), [1, 1, -1], 2, id="zeros"),
        pytest.param(np.ones((5, 5)), [1, 1, 1, -1, -1], 4, id="constant"),
    ],
)
def test_kernels_that_tell_nothing_apart_have_a_defined_machine(
    solver, kernel, labels, objective
):
    # No hyperplane: every touch of the rarer label, and as much of the other, is
    # an error of at most 2 C, and J = 2 C min(n+, n-).
    ours = solve([kernel, kernel], labels, 1.0, solver)
    # SimpleMKL stops at 1e-2, but its machines inside are exact.
    assert_allclose(ours.objective, objective, rtol=1e-6)
    assert np.isfinite(ours.alpha).all()
    assert np.isfinite(ours.bias)


@pytest.mark.parametrize("C", [1e-6, 1e8])
def test_extreme_prices_close_the_gap(C):
    task = problem(2, 40)
    assert solve(task.kernels, task.labels, C).gap <= 1e-6


def stack_of(kernels, left, right=None):
    mean = left.mean(axis=0)
    centred = left - mean
    other = centred if right is None else right - mean
    return kernel_stack(kernels, centred, other, mean)


def test_every_kernel_agrees_with_scikit_learn(vectors, rng, reference):
    others = rng.normal(size=(7, 4))
    kernels = [*paper_kernels(), LinearKernel(), PolynomialKernel(3, 0.5)]
    stack = stack_of(kernels, vectors, others)
    assert stack.shape == (24, 15, 7)
    for kernel, ours in zip(kernels, stack, strict=True):
        theirs = reference(kernel, vectors, others)
        # Two fourth powers in a row multiply the rounding of exp by 16, and narrow
        # Gaussians multiply that of distances by up to 2^10 d^2 / 2.
        assert_allclose(ours, theirs, rtol=1e-9, atol=1e-200)


def test_a_batch_of_sets_is_each_set(vectors):
    kernels = paper_kernels()
    mean = vectors.mean(axis=0)
    index = np.array([[0, 3, 4], [7, 8, 2]])
    batch = (vectors - mean)[index]
    stacks = kernel_stack(kernels, batch, batch, mean)
    whole = stack_of(kernels, vectors)
    for row, stack in zip(index, stacks, strict=True):
        # Products of small and of whole matrices round differently.
        assert_allclose(stack, whole[:, row[:, None], row], rtol=1e-9, atol=1e-200)


def test_distances_far_from_the_origin_keep_their_digits():
    near = np.array([[0.0], [1e-3], [3e-3]])
    (there,) = stack_of([GaussianKernel(1e-3)], near + 1e6)
    (here,) = stack_of([GaussianKernel(1e-3)], near)
    # 1e6 + 1e-3 itself is rounded to 1e-10, a ten-millionth of the distance.
    assert_allclose(there, here, rtol=1e-5)


def test_diagonals_are_those_of_the_matrices(vectors):
    kernels = [*paper_kernels(), LinearKernel()]
    mean = vectors.mean(axis=0)
    diagonals = kernel_diagonals(kernels, vectors - mean, mean)
    whole = np.einsum("kii->ki", stack_of(kernels, vectors))
    assert_allclose(diagonals, whole, rtol=1e-12)


def bank_of(X, n_landmarks, normalize="trace"):
    random = np.random.RandomState(0)
    return NystroemBank(BANK, X, normalize, n_landmarks, random)


def test_features_of_all_touches_are_the_kernels(draw):
    X, _ = draw(40)
    bank = bank_of(X, 40, normalize="variance")
    exact = FeatureBank(BANK, X, "variance")
    # Directions below 1e-10 of the largest are dropped.
    assert_allclose(bank.scales, exact.scales, rtol=1e-6)
    features = bank.features(bank.centred)
    blocks = exact.blocks(np.arange(40)[None])[0]
    ends = np.cumsum(bank.features.ranks)
    for kernel, part in zip(blocks, np.split(features, ends[:-1], axis=1), strict=True):
        assert_allclose(part @ part.T, kernel, atol=1e-8 * np.abs(kernel).max())


def same_problem_twice(rng, draw):
    """Kernels of features, and the same kernels as matrices."""
    X, codes = draw(90)
    bank = bank_of(X, 12)
    labels = np.where(codes, 1.0, -1.0)[None]
    labels[0, ::7] = 0
    low = bank.system(np.arange(90)[None], labels)
    features = bank.features(bank.centred)
    features -= features.mean(axis=0)
    parts = np.split(features, np.cumsum(bank.features.ranks)[:-1], axis=1)
    stack = np.stack([part @ part.T for part in parts])
    assert isinstance(low, LowRankKernels)
    return low, DenseKernels(stack[None], labels)


@pytest.mark.parametrize("norm", [1.0, 2.5])
def test_newtons_step_is_that_of_the_whole_matrices(rng, norm, draw):
    low, dense = same_problem_twice(rng, draw)
    alpha, bound = rng.uniform(0.1, 0.9, (1, 90)), 1.0
    left = np.concatenate([alpha, bound - alpha, rng.uniform(0.1, 1, (1, 4))], axis=1)
    right, wanted = rng.uniform(0.1, 1, (2, 1, 184))
    free = rng.normal(size=(1, 2)) ** 2
    steps = []
    for system in (low, dense):
        pulls = system.pulls(alpha)
        point = Point(left, right, np.concatenate([free, pulls], axis=1), 90)
        task = Task(system, bound, norm)
        step_to = system.newton(task, point, system.view(task, point))
        steps.append(step_to(wanted))
        change = left * steps[-1].right + right * steps[-1].left
        assert_allclose(change, left * wanted, rtol=1e-8)
    # The same linear system, eliminated in two orders.
    for name in ("left", "right", "bias", "level"):
        ours, reference = (getattr(step, name) for step in steps)
        assert_allclose(ours, reference, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("norm", [1, 3])
@pytest.mark.parametrize("C", [0.1, 10, 1e5])
def test_both_interior_points_reach_the_same_optimum(rng, C, norm, draw):
    low, dense = same_problem_twice(rng, draw)
    ours = solve_interior(low, C, norm=norm)
    reference = solve_interior(dense, C, norm=norm)
    assert max(ours.gap[0], reference.gap[0]) <= 1e-6
    # Either is within its gap of 1e-6.
    assert_allclose(ours.objective, reference.objective, rtol=2e-6)
    # A gap g of J moves decisions by up to sqrt(2 g J k(x, x)).
    wide = np.sqrt(4e-6 * ours.objective[0] * dense.kernels.max())
    decisions = low.decisions(ours), dense.decisions(reference)
    assert_allclose(*decisions, atol=2 * wide)


def test_features_computed_again_are_those_kept(monkeypatch, draw, landmarks):
    X, codes = draw(300)
    kept = landmarks(30).fit(X, codes)
    monkeypatch.setattr(_landmarks, "_KEPT_BYTES", 0)
    again = landmarks(30).fit(X, codes)
    assert_allclose(again.predict_proba(X), kept.predict_proba(X), rtol=1e-9)


def test_auto_takes_landmarks_when_a_pair_is_too_large(monkeypatch, draw):
    monkeypatch.setattr(_svc, "_MOST_TOUCHES", 100)
    X, codes = draw(120)
    machine = MKLSVC(kernels=BANK, n_landmarks=20, random_state=0)
    assert len(machine.fit(X, codes).feature_maps_) == 4
    assert len(machine.fit(X[:90], codes[:90]).feature_maps_) == 0
    # Many touches, but no pair of classes has more than 100.
    assert len(machine.fit(X, np.arange(120) % 3).feature_maps_) == 0


def test_few_touches_of_many_landmarks_are_solved_by_their_matrices(draw):
    X, _ = draw(120)
    bank = bank_of(X, 100)
    pair = bank.system(np.arange(10)[None], np.ones((1, 10)))
    assert isinstance(pair, DenseKernels)
    assert pair.kernels.shape == (1, 4, 10, 10)
