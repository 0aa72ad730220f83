"""Very many touches and labels: landmarks, time and memory, adding and forgetting."""

import tracemalloc

import numpy as np
import pytest
from joblib import parallel_config
from numpy.testing import assert_allclose

from palpate import ObjectRecogniser, Touches
from palpate.classifiers import EncodingPool, KernelDensityBayes, KernelRidgeClassifier

SETTINGS = {"widths": [1.0], "ridges": [0.1], "max_touches": 50, "n_landmarks": 40}


def drawn(n_labels, n_each, seed=0):
    rng = np.random.default_rng(seed)
    centres = np.random.default_rng(99).normal(size=(n_labels, 4))
    X = np.repeat(centres, n_each, axis=0) + 0.2 * rng.normal(
        size=(n_labels * n_each, 4)
    )
    labels = np.repeat([f"object {k:02d}" for k in range(n_labels)], n_each)
    return X, labels, np.arange(len(X)) // 2


def refitted_from_scratch(machine, X, labels):
    """The same landmarks and mean, all sums made anew."""
    before, codes = machine._summed, np.searchsorted(machine.classes_, labels)
    regression = type(before)(before._landmarks, machine.mean_, machine.ridge_)
    return regression.learn((X, codes, machine.classes_))


@pytest.mark.parametrize("change", ["add", "extend", "forget", "both"])
def test_changes_are_learnt_by_what_they_add_to_the_sums(change):
    X, labels, groups = drawn(10, 12)
    first = labels != "object 04"
    if change == "extend":
        first = np.ones(len(labels), bool)
        first[-6:] = False
    if change == "forget":
        first[:] = True
    machine = KernelRidgeClassifier(**SETTINGS)
    machine.fit(X[first], labels[first], groups=groups[first])
    before = machine._summed
    rows = np.flatnonzero(first)
    if change in ("add", "extend", "both"):
        rows = np.concatenate([rows, np.flatnonzero(~first)])
    if change in ("forget", "both"):
        rows = rows[labels[rows] != "object 07"]
    machine.refit(X[rows], labels[rows], groups=groups[rows])
    again = machine._summed
    assert again._landmarks is before._landmarks
    slow = refitted_from_scratch(machine, X[rows], labels[rows])
    assert_allclose(again.coefficients(), slow.coefficients(), atol=2e-4)
    lower = np.tril(again._products)
    assert_allclose(lower, np.tril(slow._products), atol=1e-9)
    which = groups[rows], machine.left_out_rows
    left_out = slow.left_out(slow.coefficients(), *which)
    assert_allclose(machine.left_out_scores_, left_out, atol=1e-4)


def test_other_touches_are_learnt_from_the_beginning():
    X, labels, groups = drawn(10, 12)
    machine = KernelRidgeClassifier(**SETTINGS).fit(X, labels, groups=groups)
    before = machine._summed._landmarks
    machine.refit(X[::-1], labels[::-1], groups=groups)
    assert machine._summed._landmarks is not before
    many, names, others = drawn(14, 12)
    machine.refit(many, names, groups=others)
    assert len(machine.classes_) == 14


def test_sums_are_the_same_wherever_blocks_lie(monkeypatch, lower):
    X, labels, groups = drawn(10, 30)
    whole = KernelRidgeClassifier(**SETTINGS).fit(X, labels, groups=groups)
    lower(monkeypatch, touches_a_task=70, touches_at_once=16)
    with parallel_config("threading", n_jobs=2):
        in_blocks = KernelRidgeClassifier(**SETTINGS).fit(X, labels, groups=groups)
    assert_allclose(in_blocks.scores(X), whole.scores(X), atol=1e-5)
    assert_allclose(in_blocks.left_out_scores_, whole.left_out_scores_, atol=1e-5)


@pytest.mark.parametrize("n_landmarks", [20, 200])
def test_single_precision_is_taken_where_posteriors_stay_the_same(n_landmarks):
    """With 200 landmarks in four dimensions scores are differences of large numbers."""
    X, labels, groups = drawn(30, 20)
    machine = KernelRidgeClassifier(**SETTINGS | {"n_landmarks": n_landmarks})
    machine.fit(X, labels, groups=groups)
    single = machine.coefficients_.dtype == np.float32
    assert single == (n_landmarks == 20)
    regression = machine._summed
    codes = np.searchsorted(machine.classes_, labels)
    kernel = regression._landmarks.kernel(X - machine.mean_)
    features = np.linalg.solve(regression._root, kernel.T).T
    targets = np.eye(30)[codes] - 1 / 30
    inner = features.T @ features + 0.1 * np.eye(len(features.T))
    exact = features @ np.linalg.solve(inner, features.T @ targets) + 1 / 30
    machine.left_out_scores_ = exact
    wanted = machine.left_out_log_likelihood()
    assert_allclose(machine.log_likelihood(X), wanted, atol=1e-3, rtol=0)


@pytest.mark.parametrize(
    ("n_labels", "n_each", "n_groups"), [(40, 6, 3), (400, 5, 5), (4, 300, 5)]
)
def test_a_part_of_very_many_answers_is_left_out(
    monkeypatch, lower, n_labels, n_each, n_groups
):
    lower(monkeypatch, answers_left_out=2000)
    codes = np.repeat(np.arange(n_labels), n_each)
    groups = np.tile(np.arange(n_each) * n_groups // n_each, n_labels)
    groups = groups + n_groups * codes
    X = np.random.default_rng(0).normal(size=(len(codes), 2))
    machine = KernelRidgeClassifier(**SETTINGS).fit(X, codes, groups=groups)
    rows = machine.left_out_rows
    assert len(machine.left_out_scores_) == len(rows) < len(codes)
    assert (np.diff(rows) > 0).all()
    assert len(rows) * n_labels <= max(2000, 2 * 25 * n_labels)
    chosen = np.unique(codes[rows])
    assert len(chosen) >= min(n_labels, 25)
    # Whole groups first: of each label at most one is not whole.
    for code in chosen:
        of_label = rows[codes[rows] == code]
        counts = np.unique(groups[of_label], return_counts=True)[1]
        assert (counts < n_each // n_groups).sum() <= 1


def test_a_pool_of_a_part_left_out_is_nearly_that_of_all(monkeypatch, lower):
    X, labels, groups = drawn(30, 20)
    parts = {"first": 2, "second": 2}
    of_all = EncodingPool(parts).fit(X, labels, groups=groups)
    lower(monkeypatch, answers_left_out=9000)
    of_part = EncodingPool(parts).fit(X, labels, groups=groups)
    rows = of_part.left_out_rows
    assert len(rows) < len(of_all.left_out_rows) == 600
    assert of_part.left_out_log_likelihood().shape == (len(rows), 30)
    parts_alike = of_all.left_out_by_part()[:, rows].argmax(axis=2)
    assert (of_part.left_out_by_part().argmax(axis=2) == parts_alike).mean() > 0.97
    new, new_labels, _ = drawn(30, 5, seed=1)
    assert abs(of_part.score(new, new_labels) - of_all.score(new, new_labels)) < 0.03


def test_landmarks_are_for_many_touches_or_many_targets():
    learns_by_landmarks = KernelRidgeClassifier.learns_by_landmarks
    assert not learns_by_landmarks(10_000, 2000)
    assert learns_by_landmarks(10_001, 2)
    assert learns_by_landmarks(8000, 4000)
    assert learns_by_landmarks(60, 2, max_touches=50)


MB = 2**20


def learnt(machine, n_labels, n_each, n_features=64):
    rng = np.random.default_rng(0)
    centres = np.repeat(rng.random((n_labels, n_features)), n_each, axis=0)
    touches = centres + rng.normal(0, 0.1, centres.shape)
    labels = np.repeat([f"object {k}" for k in range(n_labels)], n_each)
    tracemalloc.start()
    machine.fit(touches, labels)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return machine, touches, labels, peak


def test_one_kernel_matrix_is_changed_in_place():
    n_touches = 1600
    machine, *_, peak = learnt(KernelRidgeClassifier(), 8, n_touches // 8)
    # The matrix, what squared distances take, and the choice on 1500 touches.
    assert peak < 4.5 * 8 * n_touches**2
    assert machine.coefficients_.shape == (n_touches, 8)


def test_memory_of_many_touches_does_not_grow_with_their_square():
    settings = SETTINGS | {"max_touches": 1000, "n_landmarks": 50}
    machine = KernelRidgeClassifier(max_choice_touches=100, **settings)
    machine, touches, labels, peak = learnt(machine, 2, 4000, n_features=3)
    # The kernel of all touches alone would take 512 MB.
    assert peak < 40 * MB
    assert machine.score(touches, labels) > 0.75


def test_many_labels_of_two_touches_are_learnt_from_some_of_them():
    machine = KernelRidgeClassifier(max_choice_touches=400)
    machine, touches, labels, peak = learnt(machine, 600, 2)
    assert (machine.predict(touches) == labels).mean() > 0.99
    # Matrices of touches by labels, 5.5 MB each, and of touches by touches, 11 MB.
    assert peak < 80 * MB


@pytest.mark.slow
def test_a_thousand_objects_of_two_touches_are_learnt():
    rng = np.random.default_rng(0)
    images = np.repeat(rng.random((1000, 8, 8)), 2, axis=0)
    images += rng.normal(0, 0.05, images.shape)
    labels = np.repeat([f"object {k}" for k in range(1000)], 2)
    touches = Touches(images, object=labels, geometry="none")
    tracemalloc.start()
    recogniser = ObjectRecogniser().fit(touches)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert recogniser.score(touches) > 0.9
    assert peak < 500 * MB


def test_large_scores_are_bent_and_frequent_labels_leant_against(rng):
    X, labels = rng.normal(size=(6, 2)), np.repeat(["mug", "pen"], [4, 2])
    machine = KernelRidgeClassifier(widths=[1.0], ridges=[0.1]).fit(X, labels)
    machine.temperature_, machine.bend_ = 10.0, 0.5
    for scores, log_likelihood in (
        (machine.scores(X), machine.log_likelihood(X)),
        (machine.left_out_scores_, machine.left_out_log_likelihood()),
    ):
        mug, pen = (10 * scores / (1 + 0.5 * np.abs(scores))).T
        assert_allclose(
            log_likelihood[:, 0] - log_likelihood[:, 1], mug - pen - np.log(4 / 2)
        )


def test_very_many_touches_are_stored_in_single_precision(rng):
    labels = np.tile(["mug", "pen"], 50_001)
    X = rng.normal(size=(len(labels), 2)) + (labels == "pen")[:, None]
    new_touches = np.r_[X[:20], [[40.0, -40.0], [300.0, 300.0]]]
    many = KernelDensityBayes().fit(X, labels)
    exact = KernelDensityBayes(precision="double").fit(X, labels)
    assert (many.points_.dtype, exact.points_.dtype) == (np.float32, np.float64)
    wanted = exact.log_likelihood(new_touches)
    # The error that is promised where tiles answer; far away the rounded touches are
    # answered exactly, of which 300 bandwidths make the largest difference.
    assert_allclose(many.log_likelihood(new_touches)[:-1], wanted[:-1], atol=1e-3)
    assert_allclose(many.log_likelihood(new_touches)[-1], wanted[-1], rtol=1e-6)
