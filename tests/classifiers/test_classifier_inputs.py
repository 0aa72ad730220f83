"""What every classifier refuses with a sentence: mixed labels, immense features."""

import numpy as np
import pytest

from palpate.classifiers import (
    MKLSVC,
    GaussianKernel,
    KernelDensityBayes,
    KernelDensityNaiveBayes,
    KernelRidgeClassifier,
    OnePerLabelSVC,
)

CLASSIFIERS = [
    KernelDensityBayes,
    KernelDensityNaiveBayes,
    KernelRidgeClassifier,
    MKLSVC,
    OnePerLabelSVC,
]
every = pytest.mark.parametrize("classifier", CLASSIFIERS)


@every
@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ([1, "b", None], "got numbers and text and NoneType: 1, 'b', None. Make all"),
        (np.array(["a", 2.5, "a"], dtype=object), "got text and numbers: 'a', 2.5"),
        (["a", "b", None], "got text and NoneType: 'a', None.*leave out touches"),
    ],
)
def test_labels_of_several_kinds_are_refused(classifier, labels, message):
    with pytest.raises(TypeError, match=f"y must hold labels of one kind, {message}"):
        classifier().fit(np.eye(3), labels)


@every
def test_labels_of_one_kind_may_be_objects(classifier, rng):
    X = rng.normal(size=(20, 2)) + np.repeat([[0, 0], [4, 0]], 10, axis=0)
    names = np.repeat(["a", "b"], 10).astype(object)
    assert set(classifier().fit(X, names).predict(X)) == {"a", "b"}


@every
def test_features_whose_squares_leave_the_range_are_refused(classifier, rng):
    X, labels = 1e200 * rng.normal(size=(20, 2)), np.repeat(["a", "b"], 10)
    with pytest.raises(ValueError, match=r"X must .*[Ss]cale the features"):
        classifier().fit(X, labels)


def test_immense_touches_are_refused_by_a_learnt_machine(rng):
    X = rng.normal(size=(20, 2)) + np.repeat([[0, 0], [4, 0]], 10, axis=0)
    machine = MKLSVC().fit(X, np.repeat(["a", "b"], 10))
    with pytest.raises(ValueError, match=r"X must be at most 1e\+150 in size"):
        machine.predict(1e200 * X)


@pytest.mark.parametrize("sigma", [1e200, 1e-200])
def test_widths_whose_squares_leave_the_range_are_refused(sigma):
    with pytest.raises(
        ValueError, match=r"sigma must be between 1e-150 .*got 1e[+-]200"
    ):
        GaussianKernel(sigma)


@pytest.mark.parametrize("sigma", [1e150, 1e-150])
def test_widths_at_the_ends_of_the_range_have_a_defined_answer(sigma, rng):
    X = rng.normal(size=(20, 2)) + np.repeat([[0, 0], [4, 0]], 10, axis=0)
    machine = MKLSVC(kernels=[GaussianKernel(sigma), GaussianKernel(1.0)])
    machine.fit(X, np.repeat(["a", "b"], 10))
    assert np.isfinite(machine.decision_function(X)).all()
