"""`MKLSVC` as a scikit-learn classifier: contract, facts, refusals."""

import pickle
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg.lapack import dpotrf
from scipy.optimize import minimize
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import cross_val_score
from sklearn.svm import SVC
from threadpoolctl import threadpool_info, threadpool_limits

from palpate.classifiers import MKLSVC, GaussianKernel, LinearKernel, PolynomialKernel

from .conftest import platt_loss

BANK = [GaussianKernel(1.0), GaussianKernel(4.0), PolynomialKernel(2), LinearKernel()]


@pytest.fixture
def problem(rng):
    """Four classes of 12 touches, not quite apart."""
    labels = np.repeat(["ball", "mug", "pen", "box"], 12)
    X = rng.normal(size=(48, 5)) + 2 * np.repeat(np.eye(4, 5), 12, axis=0)
    return X, labels


@pytest.fixture
def kernels_of(reference):
    """Return the kernels of the bank as precomputed ones are given."""
    return lambda *sides: np.stack([reference(k, *sides) for k in BANK], axis=2)


def test_pairs_of_whole_kernels_are_learnt_on_one_thread(rng, monkeypatch):
    thread_counts = []

    def threads():
        return {
            pool["num_threads"]
            for pool in threadpool_info()
            if pool["user_api"] == "blas"
        }

    def noted(*matrices, **options):
        thread_counts.append(threads())
        return dpotrf(*matrices, **options)

    monkeypatch.setattr("palpate.classifiers.mkl._kernels.dpotrf", noted)
    labels = np.arange(120) % 2
    touches = rng.normal(size=(120, 3)) + labels[:, np.newaxis]
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        MKLSVC(kernels=BANK, probability=False).fit(touches, labels)
        assert threads() == before
    assert 2 in before
    assert thread_counts
    assert all(number == {1} for number in thread_counts)


def test_each_pair_is_solved_to_its_gap_with_weights_that_sum_to_one(problem):
    machine = MKLSVC().fit(*problem)
    assert machine.pairs_.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert machine.weights_.shape == (6, 22)
    assert_allclose(machine.weights_.sum(axis=1), 1, rtol=1e-12)
    assert (machine.gap_ <= 1e-6).all()
    assert (machine.objective_ > 0).all()
    assert (machine.n_iter_ >= 1).all()


@pytest.mark.parametrize("C", [3, 100])
def test_one_kernel_is_scikit_learns_machine(problem, C):
    X, labels = problem
    ours = MKLSVC(C=C, kernels=[GaussianKernel(2.0)], normalize=None, tol=1e-10)
    theirs = SVC(C=C, gamma=1 / 8, tol=1e-10, decision_function_shape="ovo")
    others = X + 0.3
    decisions = ours.fit(X, labels).pair_decisions(others)
    # Scikit-learn's pairs speak for their first class when there are several.
    expected = -theirs.fit(X, labels).decision_function(others)
    # A gap of 1e-10 moves decisions by sqrt(2 gap J k(x, x)), about 5e-5.
    assert_allclose(decisions, expected, atol=2e-4)
    assert_array_equal(ours.predict(others), theirs.predict(others))


def test_weights_and_multipliers_give_the_decisions(problem, kernels_of):
    X, labels = problem
    machine = MKLSVC(kernels=BANK, C=50, probability=False).fit(X, labels)
    stack = kernels_of(X + 0.1, X) * machine.kernel_scales_
    full = np.zeros((6, 48))
    full[:, machine.support_] = machine.dual_coef_
    expected = np.einsum("xik,pk,pi->xp", stack, machine.weights_, full)
    decisions = machine.pair_decisions(X + 0.1)
    assert_allclose(decisions, expected + machine.intercept_, rtol=1e-9, atol=1e-9)


def test_precomputed_kernels_are_the_same_machine(problem, kernels_of):
    X, labels = problem
    others = X + 0.2
    by_features = MKLSVC(kernels=BANK).fit(X, labels)
    precomputed = MKLSVC(kernels="precomputed").fit(kernels_of(X, X), labels)
    # The same problem up to rounding of the kernels.
    assert_allclose(precomputed.objective_, by_features.objective_, rtol=1e-9)
    for method in ("predict_proba", "decision_function", "pair_decisions"):
        ours = getattr(precomputed, method)(kernels_of(others, X))
        assert_allclose(ours, getattr(by_features, method)(others), atol=1e-5)


def test_precomputed_kernels_are_cut_along_touches_by_cross_validation(
    problem, kernels_of
):
    X, labels = problem
    features = cross_val_score(MKLSVC(kernels=BANK, probability=False), X, labels)
    precomputed = MKLSVC(kernels="precomputed", probability=False)
    assert_array_equal(cross_val_score(precomputed, kernels_of(X, X), labels), features)


def test_a_single_precomputed_kernel_may_be_a_matrix(problem):
    X, labels = problem
    gram = X @ X.T
    machine = MKLSVC(kernels="precomputed").fit(gram, labels)
    assert machine.weights_.tolist() == [[1.0]] * 6
    assert machine.score(gram, labels) > 0.8


@pytest.mark.parametrize("normalize", ["trace", "variance", None])
@pytest.mark.parametrize("norm", [1, 1.5, 4])
def test_every_normalisation_and_norm_learns(problem, normalize, norm):
    X, labels = problem
    C = 1000 if normalize == "trace" else 1
    machine = MKLSVC(C=C, kernels=BANK, normalize=normalize, norm=norm).fit(X, labels)
    assert machine.score(X, labels) > 0.8
    assert_allclose((machine.weights_**norm).sum(axis=1), 1, rtol=1e-9)


@pytest.mark.parametrize("C", [10, 100, 1000])
def test_simplemkl_is_the_same_machine(problem, C):
    X, labels = problem
    interior = MKLSVC(C, kernels=BANK, probability=False).fit(X, labels)
    walk = clone(interior).set_params(solver="simplemkl", tol=1e-6).fit(X, labels)
    assert (walk.gap_ <= 1e-6).all()
    # Either is within its gap of 1e-6.
    assert_allclose(walk.objective_, interior.objective_, rtol=2e-6)
    assert_array_equal(walk.predict(X + 0.2), interior.predict(X + 0.2))


@pytest.mark.parametrize(
    "labels",
    [
        pytest.param(np.repeat([7, -3], 10), id="ints"),
        pytest.param(np.repeat([True, False], 10), id="bools"),
        pytest.param(np.repeat(["pen", "a long name"], 10), id="text"),
        pytest.param(np.repeat([0.0, 2.0], 10), id="floats"),
    ],
)
def test_labels_of_any_kind_are_learnt(rng, labels):
    X = rng.normal(size=(20, 3)) + 3 * np.repeat([[1], [0]], 10, axis=0)
    machine = MKLSVC().fit(X, labels)
    predicted = machine.predict(X)
    assert predicted.dtype == machine.classes_.dtype
    assert (predicted == labels).mean() > 0.9
    # A positive decision is the second class.
    positive = machine.decision_function(X) > 0
    assert_array_equal(predicted == machine.classes_[1], positive)


# Pairs of the latter are solved together, padded.
@pytest.mark.parametrize("counts", [[3, 17, 40], [10, 12, 11]])
@pytest.mark.parametrize("solver", ["interior", "simplemkl"])
def test_pairs_of_unequal_classes_are_solved_as_if_alone(
    rng, counts, solver, kernels_of
):
    labels = rng.permutation(np.repeat([0, 1, 2], counts))
    X = rng.normal(size=(len(labels), 4)) + 3 * np.eye(3, 4)[labels]
    together = MKLSVC(kernels=BANK, solver=solver, tol=1e-6, probability=False)
    together.fit(X, labels)
    scales = together.kernel_scales_
    for (first, second), objective in zip(
        together.pairs_, together.objective_, strict=True
    ):
        chosen = (labels == first) | (labels == second)
        stack = kernels_of(X[chosen], X[chosen]) * scales
        alone = MKLSVC(kernels="precomputed", normalize=None, probability=False)
        alone.fit(stack, labels[chosen])
        # Either is within its gap of 1e-6.
        assert_allclose(objective, alone.objective_[0], rtol=2e-6)


def test_sigmoids_are_fitted_to_five_blocks_of_each_class_left_out(rng):
    """One linear kernel is a plain SVM, to be left out by hand; a lone touch stays."""
    codes = rng.permutation(np.repeat([0, 1, 2, 3], [7, 1, 12, 6]))
    X = rng.normal(size=(len(codes), 3)) + 1.5 * np.eye(4, 3)[codes]
    blocks = np.empty(len(codes), dtype=int)
    for code in range(4):
        members = np.flatnonzero(codes == code)
        places = [5 * place // len(members) for place in range(len(members))]
        blocks[members] = places if len(members) > 1 else -1
    linear = {"kernels": [LinearKernel()], "normalize": None, "C": 10}
    machine = MKLSVC(**linear).fit(X, codes)
    for pair, sigmoid in zip(machine.pairs_, machine.sigmoids_, strict=True):
        rows = np.flatnonzero(np.isin(codes, pair))
        labels = np.where(codes[rows] == pair[1], 1.0, -1.0)
        scores = np.empty(len(rows))
        for block in np.unique(blocks[rows]):
            out = blocks[rows] == block
            learnt = ~out if block >= 0 else np.full(len(rows), fill_value=True)
            svm = SVC(kernel="linear", C=10, tol=1e-9)
            svm.fit(X[rows[learnt]], labels[learnt])
            scores[out] = svm.decision_function(X[rows[out]])
        bounds = [(0, None), (None, None)]
        best = minimize(platt_loss, [0, 0], (scores, labels), bounds=bounds, tol=1e-12)
        # Machines that leave out are solved to a gap of 1e-4 alone.
        assert_allclose(sigmoid, best.x, rtol=0.01, atol=0.003)


@pytest.mark.parametrize("approximation", ["none", "nystroem"])
def test_pickle_model_file_and_repetition_give_the_same_machine(
    problem, approximation, reread
):
    options = {"approximation": approximation, "random_state": 0}
    machine = MKLSVC(kernels=BANK, **options).fit(*problem)
    expected = machine.predict_proba(problem[0])
    pickled = pickle.loads(pickle.dumps(machine))
    for again in (pickled, reread(machine), clone(machine).fit(*problem)):
        assert_array_equal(again.predict_proba(problem[0]), expected)


def test_probabilities_sum_to_one_and_side_with_the_prediction(problem):
    X, labels = problem
    machine = MKLSVC().fit(X, labels)
    others = np.random.default_rng(1).normal(size=(200, 5)) * 2
    chances = machine.predict_proba(others)
    assert_allclose(chances.sum(axis=1), 1, rtol=1e-12)
    assert (chances > 0).all()
    assert_array_equal(
        machine.classes_[chances.argmax(axis=1)], machine.predict(others)
    )
    assert_allclose(machine.predict_log_proba(others), np.log(chances))


def test_probabilities_are_calibrated(rng):
    def draw(n):
        codes = rng.integers(5, size=n)
        return rng.normal(size=(n, 6)) + 1.5 * np.eye(5, 6)[codes], codes

    machine = MKLSVC(kernels=BANK, C=100).fit(*draw(150))
    X, codes = draw(4000)
    chances = machine.predict_proba(X)
    # Bayes' own log loss here, from the densities that made the touches.
    logits = 1.5 * X[:, :5]
    bayes = -(logits[np.arange(4000), codes] - np.logaddexp.reduce(logits, axis=1))
    loss = -np.log(chances[np.arange(4000), codes])
    # 30 touches a class cost some; knowing nothing costs log 5 = 1.6.
    assert loss.mean() < bayes.mean() + 0.25
    right = chances.argmax(axis=1) == codes
    # Confidence matches accuracy to a few points, at 4000 touches +- 0.8.
    assert abs(chances.max(axis=1).mean() - right.mean()) < 0.05


def test_without_probability_there_is_no_predict_proba(problem):
    machine = MKLSVC(probability=False).fit(*problem)
    assert not hasattr(machine, "predict_proba")
    with pytest.raises(AttributeError, match="predict_proba"):
        machine.predict_proba(problem[0])


def test_a_warning_says_the_gap_that_was_not_reached(problem):
    with pytest.warns(
        ConvergenceWarning, match=r"gap of .* \(tol is 1e-06\) in 6 of 6"
    ):
        machine = MKLSVC(max_iter=2).fit(*problem)
    assert (machine.n_iter_ == 2).all()
    assert np.isfinite(machine.predict_proba(problem[0])).all()


@pytest.mark.parametrize("value", [0.0, 3.5])
@pytest.mark.parametrize("approximation", ["none", "nystroem"])
@pytest.mark.parametrize("normalize", ["trace", "variance", None])
def test_touches_all_alike_go_to_the_class_of_most(value, approximation, normalize):
    X, labels = np.full((9, 4), value), np.repeat(["a", "b", "c"], [2, 4, 3])
    machine = MKLSVC(normalize=normalize, approximation=approximation).fit(X, labels)
    assert (machine.predict(X) == "b").all()
    chances = machine.predict_proba(X)
    assert_allclose(chances, chances[0] * np.ones((9, 1)))
    assert chances[0].argmax() == 1


def test_one_touch_in_a_class_is_enough(rng):
    X = rng.normal(size=(12, 3)) + 4 * np.repeat(np.eye(3), [1, 1, 10], axis=0)
    labels = np.repeat([0, 1, 2], [1, 1, 10])
    machine = MKLSVC().fit(X, labels)
    assert_array_equal(machine.predict(X), labels)
    assert np.isfinite(machine.predict_proba(X)).all()


def test_touches_learnt_twice_under_two_labels_have_finite_answers(rng):
    X = np.repeat(rng.normal(size=(6, 2)), 2, axis=0)
    machine = MKLSVC().fit(X, np.tile(["a", "b"], 6))
    assert (machine.gap_ <= 1e-6).all()
    assert np.isfinite(machine.predict_proba(X)).all()


def changed(place, value):
    stack = np.stack([np.eye(4), np.eye(4)], axis=2)
    stack[place] = value
    return stack


@pytest.mark.parametrize(
    ("stack", "message"),
    [
        (changed((0, 1, 1), np.nan), "contains NaN"),
        (changed((0, 1, 1), np.inf), "contains infinity"),
        (
            changed((0, 1, 1), 0.5),
            r"must be symmetric, got a difference of 0\.5 .*kernel 1",
        ),
        (
            changed((0, 0, 0), -1.0),
            "semi-definite, got an eigenvalue of -1 in kernel 0",
        ),
        (np.ones((4, 3, 2)), "X has 3 features, but MKLSVC is expecting 4"),
        (np.ones((4, 4, 2, 2)), r"shape \(n_touches, n_train_touches"),
        (np.ones((3, 3, 2)), "inconsistent numbers of samples"),
    ],
)
def test_precomputed_arrays_that_are_no_kernels_are_refused(stack, message):
    with pytest.raises(ValueError, match=message):
        MKLSVC(kernels="precomputed").fit(stack, ["a", "a", "b", "b"])


def test_many_precomputed_kernels_are_looked_at_a_few_at_a_time(monkeypatch, rng):
    block_bytes = "palpate.classifiers.mkl._problem.BLOCK_BYTES"
    monkeypatch.setattr(block_bytes, 2 * 8 * 30**2)
    roots = rng.normal(size=(7, 30, 40))
    stack = (roots @ roots.transpose(0, 2, 1)).transpose(1, 2, 0)
    codes = np.arange(30) % 2
    MKLSVC(kernels="precomputed", probability=False).fit(stack, codes)
    for number in range(7):
        indefinite, skew = stack.copy(), stack.copy()
        indefinite[..., number] -= 50 * np.eye(30)
        skew[3, 4, number] += 1
        for wrong, what in ((indefinite, "semi-definite"), (skew, "symmetric")):
            with pytest.raises(ValueError, match=f"{what}.* kernel {number}"):
                MKLSVC(kernels="precomputed").fit(wrong, codes)


def test_precomputed_kernels_are_those_of_training_touches_and_exact(
    problem, kernels_of
):
    X, labels = problem
    stack = kernels_of(X, X)
    machine = MKLSVC(kernels="precomputed", probability=False).fit(stack, labels)
    with pytest.raises(ValueError, match=r"X has 40 features.*column per training"):
        machine.predict(stack[:, :40])
    with pytest.raises(ValueError, match=f"must hold the {stack.shape[2]} kernels"):
        machine.predict(stack[:, :, :1])
    with pytest.raises(ValueError, match="with precomputed kernels, got 'nystroem'"):
        machine.set_params(approximation="nystroem").fit(stack, labels)


@pytest.mark.parametrize(
    "options",
    [{}, {"solver": "simplemkl"}, {"norm": 2}, {"approximation": "nystroem"}],
    ids=str,
)
@pytest.mark.parametrize("names", ["ab", "abc"])
def test_touches_that_are_all_alike_go_to_the_first_class(options, names):
    labels = np.repeat(list(names), 3)
    machine = MKLSVC(random_state=0, **options).fit(np.ones((len(labels), 3)), labels)
    assert (machine.decision_function(np.ones((2, 3))).ravel() >= 0).all()
    assert_array_equal(machine.predict(np.ones((2, 3))), ["a", "a"])
    # Sigmoids are fitted to a flat target: rounding of the fit alone remains.
    chances = machine.predict_proba(np.ones((1, 3)))
    assert_allclose(chances, 1 / len(names), atol=1e-6)


def test_other_norms_and_touches_out_of_range_are_refused(problem):
    X, labels = problem
    with pytest.raises(ValueError, match="solver must be 'interior'"):
        MKLSVC(solver="simplemkl", norm=2).fit(X, labels)
    machine = MKLSVC(kernels=[PolynomialKernel(6)], normalize=None, C=1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        machine.fit(X, labels)
    with pytest.raises(ValueError, match="too far from the training touches"):
        machine.predict(1e60 * X)
