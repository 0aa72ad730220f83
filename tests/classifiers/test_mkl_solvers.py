"""Multiple kernel learning against independent optima and closed cases.

Then its kernels against scikit-learn's, and landmarks: exact at the limit, linear in
touches.

The weights of the optimum need not be unique, so J, the gap and decisions are
compared, never weights, unless the case says what they must be.
"""

import subprocess
import sys
import warnings
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.classifiers import MKLSVC, LinearKernel, PolynomialKernel
from palpate.classifiers.mkl import _landmarks, _svc, paper_kernels
from palpate.classifiers.mkl._kernels import DenseKernels, kernel_stack
from palpate.classifiers.mkl._landmarks import LowRankKernels, NystroemBank
from palpate.classifiers.mkl._problem import Point, Task, solve_interior
from palpate.classifiers.mkl._simplemkl import solve_simplemkl

from .conftest import BANK

# Seed, touches, price of errors, and whether kernels are of trace 1 or n.
PROBLEMS = [
    pytest.param(0, 20, 1.0, False, id="n20-C1"),
    pytest.param(1, 30, 10.0, True, id="n30-C10"),
    pytest.param(2, 40, 100.0, False, id="n40-C100"),
    pytest.param(3, 50, 1000.0, True, id="n50-C1000"),
    pytest.param(4, 60, 1000.0, False, id="n60-C1000"),
    pytest.param(5, 60, 30.0, True, id="n60-C30"),
]


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
    # Clarabel doubts its last digits on some machines; the comparison with ours is
    # what counts.
    limits = {"tol_gap_rel": 1e-7, "tol_gap_abs": 1e-12, "tol_feas": 1e-7}
    # Clarabel fails now and then with one length of steps, and not with another.
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Solution may be inaccurate")
        for longest in (0.95, 0.9, 0.8):
            with suppress(cp.error.SolverError):
                return task.solve(cp.CLARABEL, max_step_fraction=longest, **limits)
        return task.solve(cp.CLARABEL, max_step_fraction=0.7, **limits)


def optimum_of_the_socp(cp, kernels, labels, C, norm):
    """Eq. 11 of Liu et al. 2014, weights minimised out: a mixed norm of the normals.

    Solved for kernels of trace n and a price to match.
    """
    unit = kernels[0].trace() / len(kernels[0])
    roots = [root(k / unit) for k in kernels]
    normals = [cp.Variable(r.shape[1]) for r in roots]
    bias, errors = cp.Variable(), cp.Variable(len(labels))
    decisions = sum(r @ w for r, w in zip(roots, normals, strict=True)) + bias
    lengths = cp.hstack([cp.norm(w) for w in normals])
    power = 2 * norm / (norm + 1)
    mixed = cp.sum(lengths) if norm == 1 else cp.pnorm(lengths, power)
    cost = 0.5 * cp.square(mixed) + C * unit * cp.sum(errors)
    inside = [errors >= 0, cp.multiply(labels, decisions) >= 1 - errors]
    return solved(cp, cp.Problem(cp.Minimize(cost), inside)) / unit


@pytest.mark.parametrize("norm", [1, 2, 3])
@pytest.mark.parametrize(("seed", "n", "C", "large"), PROBLEMS)
def test_j_is_the_optimum_of_the_socp(seed, n, C, large, norm):
    cp = pytest.importorskip("cvxpy")
    task = problem(seed, n, large=large)
    ours = solve(task.kernels, task.labels, C, norm=norm)
    # The tolerance asked for; the reference itself stops at 1e-7.
    socp = optimum_of_the_socp(cp, task.kernels, task.labels, C, norm)
    assert_allclose(ours.objective, socp, rtol=1e-6)
    assert_allclose((ours.weights**norm).sum(), 1, rtol=1e-12)


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


def test_scaling_kernels_and_price_against_each_other_changes_nothing():
    task = problem(4, 30, BANK)
    unscaled = solve(task.kernels, task.labels, 10, tol=1e-9)
    for scale in (1e-6, 1e6):
        scaled = solve(scale * task.kernels, task.labels, 10 / scale, tol=1e-9)
        assert_allclose(scale * scaled.objective, unscaled.objective, rtol=1e-8)
        assert_allclose(scale * scaled.alpha, unscaled.alpha, atol=1e-3)


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


@pytest.mark.parametrize(
    ("C", "norm"), [(1e-6, 1), (1e8, 1), *((10, norm) for norm in (1.05, 1.5, 8, 64))]
)
def test_extreme_prices_and_any_norm_close_the_gap(C, norm):
    task = problem(3, 50)
    assert solve(task.kernels, task.labels, C, norm=norm).gap <= 1e-6


def test_every_kernel_agrees_with_scikit_learn(vectors, rng, reference):
    others, mean = rng.normal(size=(7, 4)), vectors.mean(axis=0)
    kernels = [*paper_kernels(), LinearKernel(), PolynomialKernel(3, 0.5)]
    stack = kernel_stack(kernels, vectors - mean, others - mean, mean)
    assert stack.shape == (24, 15, 7)
    for kernel, ours in zip(kernels, stack, strict=True):
        theirs = reference(kernel, vectors, others)
        # Two fourth powers in a row multiply the rounding of exp by 16, and narrow
        # Gaussians multiply that of distances by up to 2^10 d^2 / 2.
        assert_allclose(ours, theirs, rtol=1e-9, atol=1e-200)


def bank_of(X, n_landmarks):
    return NystroemBank(BANK, X, "trace", n_landmarks, np.random.RandomState(0))


def same_problem_twice(draw):
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
    low, dense = same_problem_twice(draw)
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
def test_both_interior_points_reach_the_same_optimum(C, norm, draw):
    low, dense = same_problem_twice(draw)
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


def test_a_linear_kernel_needs_no_more_directions_than_features(draw, landmarks):
    X, y = draw(50)
    ranks = [
        feature_map.shape[1] for feature_map in landmarks(30).fit(X, y).feature_maps_
    ]
    # A polynomial of degree 2 in 6 features has 28 monomials.
    assert ranks[2:] == [28, 6]


@pytest.mark.parametrize("norm", [1, 2])
@pytest.mark.parametrize("normalize", ["trace", "variance", None])
def test_with_every_touch_a_landmark_the_machine_is_exact(
    norm, normalize, draw, exact, landmarks
):
    X, codes = draw(80)
    options = {"norm": norm, "normalize": normalize, "probability": False}
    options["C"] = 100 if normalize == "trace" else 1
    whole = exact(**options).fit(X, codes)
    through = landmarks(80, **options).fit(X, codes)
    assert through.gap_ <= 1e-6
    # Directions below 1e-10 of the largest are dropped.
    assert_allclose(through.kernel_scales_, whole.kernel_scales_, rtol=1e-6)
    # Either is within its gap of 1e-6.
    assert_allclose(through.objective_, whole.objective_, rtol=2e-6)
    # A gap g moves decisions by up to sqrt(2 g J k(x, x)), here 1e-2.
    assert_allclose(through.decision_function(X), whole.decision_function(X), atol=2e-2)


def test_j_rises_to_the_exact_one_from_above(draw, exact, landmarks):
    # Landmarks see less of a kernel, so each summed kernel is smaller and J larger.
    X, codes = draw(150)
    options = {"C": 100, "probability": False}
    machines = [landmarks(n, **options) for n in (5, 30)] + [exact(**options)]
    objectives = [machine.fit(X, codes).objective_[0] for machine in machines]
    assert objectives[0] > objectives[1] > objectives[2] * (1 - 1e-6)


def test_more_classes_votes_and_probabilities(draw, exact, landmarks):
    X, codes = draw(300, n_classes=4)
    whole = exact().fit(X, codes)
    through = landmarks(60).fit(X, codes)
    others, truth = draw(1000, n_classes=4, seed=1)
    assert through.dual_coef_.shape[0] == 6
    assert abs(through.score(others, truth) - whole.score(others, truth)) < 0.05
    best = through.predict_proba(others).argmax(axis=1)
    assert_array_equal(best, through.predict(others))


def test_the_seed_decides_the_landmarks(draw, landmarks):
    X, codes = draw(200)
    machine, same = landmarks(20).fit(X, codes), landmarks(20).fit(X, codes)
    assert_array_equal(machine.predict_proba(X), same.predict_proba(X))
    other = landmarks(20).set_params(random_state=1).fit(X, codes)
    assert np.abs(machine.touches_ - other.touches_).max() > 0


def test_more_landmarks_than_touches_are_all_touches(draw, landmarks):
    X, codes = draw(30)
    assert len(landmarks(200).fit(X, codes).touches_) == 30


_MEASURE = """
import sys
import numpy as np
from palpate.classifiers import MKLSVC, GaussianKernel
n = int(sys.argv[1])
rng = np.random.default_rng(0)
codes = rng.integers(2, size=n)
X = rng.normal(size=(n, 20)) + 0.5 * np.eye(2, 20)[codes]
kernels = [GaussianKernel(s) for s in (2.0, 4.0, 8.0, 16.0)]
machine = MKLSVC(C=n, kernels=kernels, probability=False, random_state=0).fit(X, codes)
peak = next(int(l.split()[1]) for l in open("/proc/self/status") if "VmHWM" in l)
print(peak / 2**20, machine.gap_[0])
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak from /proc")
def test_a_hundred_thousand_touches_need_less_than_four_gib():
    command = [sys.executable, "-c", _MEASURE, "100000"]
    result = subprocess.run(command, check=True, capture_output=True, text=True)
    peak_gib, gap = map(float, result.stdout.split())
    assert gap <= 1e-6
    # Four kernel matrices alone would be 298 GiB.
    assert peak_gib < 4
