"""How learning grows with touches and labels: see docs/explanation/recognition.md."""

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import ObjectRecogniser, Touches
from palpate.classifiers import KernelDensityBayes, KernelRidgeClassifier
from palpate.classifiers._kernel_ridge import _log_posterior

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


def test_large_scores_are_bent_and_frequent_labels_leant_against():
    scores, log_counts = np.array([[0.8, -0.2]]), np.log([4.0, 2.0])
    found = _log_posterior((10.0, 0.5, 1.0), scores, log_counts)
    odds = 10 * 0.8 / 1.4 + 10 * 0.2 / 1.1 - np.log(2)
    assert found[0, 0] - found[0, 1] == pytest.approx(odds)


def test_very_many_touches_are_stored_in_single_precision(rng):
    labels = np.tile(["mug", "pen"], 50_001)
    X = rng.normal(size=(len(labels), 2)) + (labels == "pen")[:, None]
    asked = np.r_[X[:20], [[40.0, -40.0], [300.0, 300.0]]]
    many = KernelDensityBayes().fit(X, labels)
    exact = KernelDensityBayes(precision="double").fit(X, labels)
    assert (many.points_.dtype, exact.points_.dtype) == (np.float32, np.float64)
    wanted = exact.log_likelihood(asked)
    # The error that is promised where tiles answer; far away the rounded touches are
    # answered exactly, of which 300 bandwidths make the largest difference.
    assert_allclose(many.log_likelihood(asked)[:-1], wanted[:-1], atol=1e-3)
    assert_allclose(many.log_likelihood(asked)[-1], wanted[-1], rtol=1e-6)
