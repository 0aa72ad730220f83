"""The protocol that a belief needs of every classifier, and what each refuses."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.naive_bayes import GaussianNB
from sklearn.neighbors import KNeighborsClassifier
from sklearn.svm import LinearSVC
from sklearn.utils.estimator_checks import parametrize_with_checks

from palpate.classifiers import (
    MKLSVC,
    EncodingPool,
    FromProbabilities,
    GaussianKernel,
    KernelDensityBayes,
    KernelDensityNaiveBayes,
    KernelRidgeClassifier,
    OnePerLabelSVC,
    TouchClassifier,
)

from .conftest import BANK

_, NearbyTouches, _ = EncodingPool.MACHINES
CLASSIFIERS = [
    KernelRidgeClassifier(),
    KernelDensityBayes(),
    NearbyTouches(),
    FromProbabilities(GaussianNB()),
]
each_classifier = pytest.mark.parametrize("classifier", CLASSIFIERS, ids=repr)


@pytest.fixture
def two_labels(rng):
    X = rng.normal(size=(20, 2)) + np.repeat([[0, 0], [4, 0]], 10, axis=0)
    return X, np.repeat(["a", "b"], 10)


@pytest.fixture
def separate(rng):
    labels = np.repeat(["a", "b", "c"], 20)
    features = rng.normal(size=(60, 5)) + 3 * np.repeat(np.eye(3, 5), 20, axis=0)
    return features, labels, np.arange(60) // 4


@parametrize_with_checks(
    [
        FromProbabilities(GaussianNB()),
        KernelDensityBayes(),
        KernelDensityBayes("per-object", prior="counts"),
        KernelDensityBayes("full", scale=0.5, precision="double"),
        KernelDensityNaiveBayes(),
        KernelDensityNaiveBayes(0.3, prior="counts"),
        KernelRidgeClassifier(),
        OnePerLabelSVC(),
        OnePerLabelSVC(kernel="linear"),
        MKLSVC(kernels=BANK, normalize="variance", norm=2, C=1),
    ]
)
def test_scikit_learn_contract(estimator, check):
    check(estimator)


@pytest.mark.slow
@parametrize_with_checks([MKLSVC(), NearbyTouches()])
def test_scikit_learn_contract_of_slow_ones(estimator, check):
    check(estimator)


@each_classifier
def test_every_classifier_keeps_the_protocol(classifier, separate):
    features, labels, groups = separate
    model = classifier.fit(features, labels, groups=groups)
    assert isinstance(model, TouchClassifier)
    left_out = model.left_out_log_likelihood()
    assert left_out.shape == model.log_likelihood(features).shape == (60, 3)
    right = model.classes_[left_out.argmax(axis=1)] == labels
    assert right.mean() > 0.8


@each_classifier
def test_learning_again_takes_other_touches(classifier, separate):
    features, labels, groups = separate
    model = classifier.fit(features, labels, groups=groups)
    others = labels != "b"
    model.refit(features[others], labels[others], groups=groups[others])
    assert model.classes_.tolist() == ["a", "c"]
    assert model.left_out_log_likelihood().shape == (40, 2)
    assert_array_equal(model.predict(features[others][[0, -1]]), ["a", "c"])


@each_classifier
def test_a_session_of_several_labels_is_left_out_of_all_of_them(classifier, rng):
    """What names the session alone must not name what else was met in it."""
    labels, sessions = np.repeat(["a", "b"], 20), np.repeat([0, 1, 1, 2], 10)
    features = np.tile(rng.normal(0, 0.1, (10, 2)), (4, 1))
    features[:, 0] += labels == "b"
    features[:, 1] += 2 * (sessions == 1)
    model = classifier.fit(features, labels, groups=sessions)
    best = model.classes_[model.left_out_log_likelihood().argmax(axis=1)]
    assert (best == labels)[sessions == 1].mean() > 0.8


@pytest.mark.parametrize("n_neighbors", [1, 3])
def test_left_out_touches_have_not_met_themselves(separate, n_neighbors):
    _, labels, groups = separate
    # Had a touch met itself, its nearest neighbour would always be right.
    noise = np.random.default_rng(1).normal(size=(60, 5))
    machine = FromProbabilities(KNeighborsClassifier(n_neighbors))
    left_out = machine.fit(noise, labels, groups=groups).left_out_log_likelihood()
    assert np.isfinite(left_out).all()
    right = machine.classes_[left_out.argmax(axis=1)] == labels
    assert right.mean() < 0.7


def test_two_labels_are_left_out_too(separate):
    features, labels, groups = (part[:40] for part in separate)
    machine = FromProbabilities(GaussianNB()).fit(features, labels, groups=groups)
    left_out = machine.left_out_log_likelihood()
    assert np.isfinite(left_out).all()
    assert (machine.classes_[left_out.argmax(axis=1)] == labels).mean() > 0.9


@each_classifier
def test_touches_to_tell_are_checked_as_those_to_learn(classifier, separate):
    features, labels, _ = separate
    model = classifier.fit(features, labels)
    for bad, message in ((np.nan, "NaN"), (np.inf, "infinity"), (-np.inf, "infinity")):
        with pytest.raises(ValueError, match=message):
            model.log_likelihood(np.full((1, 5), bad))
    with pytest.raises(ValueError, match="5 features"):
        model.log_likelihood(features[:, :4])
    pandas = pytest.importorskip("pandas")
    model.fit(pandas.DataFrame(features, columns=list("vwxyz")), labels)
    with pytest.warns(UserWarning, match="valid feature names"):
        model.log_likelihood(features)


@pytest.mark.parametrize("kind", [KernelDensityBayes, KernelDensityNaiveBayes])
def test_prior_by_counts_shifts_the_posterior_only(kind, separate):
    features, labels, _ = (part[:45] for part in separate)
    flat, counted = (kind(prior=p).fit(features, labels) for p in ("uniform", "counts"))
    new = features + 1
    assert_array_equal(flat.log_likelihood(new), counted.log_likelihood(new))
    joint = flat.predict_proba(new) * [20, 20, 5]
    expected = joint / joint.sum(axis=1, keepdims=True)
    # Where a posterior is almost 1 its logarithm carries the rounding of the joint.
    assert_allclose(counted.predict_proba(new), expected, rtol=1e-9)


def test_probabilities_are_logarithms_above_a_floor(separate):
    features, labels, _ = separate
    model = FromProbabilities(GaussianNB()).fit(features, labels)
    posteriors = GaussianNB().fit(features, labels).predict_proba(features)
    assert_allclose(
        model.log_likelihood(features), np.log(np.maximum(posteriors, 1e-12))
    )


def test_a_label_of_one_group_is_impossible_where_that_is_left_out():
    X = np.arange(12.0)[:, np.newaxis]
    labels, groups = ["a"] * 6 + ["b"] * 3 + ["c"] * 3, [0, 0, 0, 1, 1, 1] + [2] * 6
    left_out = FromProbabilities(GaussianNB()).fit(X, labels, groups)
    missing = np.isneginf(left_out.left_out_log_likelihood())
    assert missing[:3, 1:].all()
    assert not missing[3:6].any()


def test_classifiers_without_probabilities_are_refused():
    with pytest.raises(TypeError, match="predict_proba, got LinearSVC"):
        FromProbabilities(LinearSVC()).fit([[0.0], [1.0]], ["a", "b"])


@each_classifier
def test_groups_of_other_touches_are_refused(classifier, separate):
    with pytest.raises(ValueError, match="one entry for each of 60 touches"):
        classifier.fit(*separate[:2], groups=[1, 2])
    with pytest.raises(TypeError, match="groups must hold labels of one kind, got Non"):
        classifier.fit(*separate[:2], groups=[None, *["monday"] * 59])


@pytest.mark.parametrize(
    ("kind", "name", "value", "error", "message"),
    [
        (KernelDensityBayes, "bandwidth", "silverman", ValueError, "one of 'pooled'"),
        (KernelDensityBayes, "scale", 0.0, ValueError, "positive"),
        (KernelDensityBayes, "prior", "flat", ValueError, "one of 'uniform', 'counts'"),
        (KernelDensityBayes, "min_variance", 0.0, ValueError, "finite and between"),
        (KernelDensityBayes, "precision", "half", ValueError, "one of 'auto'"),
        (KernelDensityNaiveBayes, "bandwidth", "botev", ValueError, "one .*silverman"),
        (KernelDensityNaiveBayes, "bandwidth", -1.0, ValueError, "positive"),
        (KernelDensityNaiveBayes, "bandwidth", None, TypeError, "a number"),
        (KernelDensityNaiveBayes, "prior", "flat", ValueError, "one of"),
        (KernelDensityNaiveBayes, "min_bandwidth", 0.0, ValueError, "positive"),
        (KernelRidgeClassifier, "widths", [0.0], ValueError, "positive"),
        (KernelRidgeClassifier, "ridges", ["a"], TypeError, "a number"),
        (OnePerLabelSVC, "C", 0.0, ValueError, "positive"),
        (OnePerLabelSVC, "C", "big", TypeError, "a number"),
        (OnePerLabelSVC, "kernel", "precomputed", ValueError, "one of 'linear'"),
        (OnePerLabelSVC, "gamma", "wide", ValueError, "one of 'scale', 'auto'"),
        (OnePerLabelSVC, "gamma", -1.0, ValueError, "positive"),
        (MKLSVC, "C", 0, ValueError, "positive"),
        (MKLSVC, "norm", 0.5, ValueError, "finite and between 1"),
        (MKLSVC, "solver", "smo", ValueError, "one of 'interior', 'simplemkl'"),
        (MKLSVC, "normalize", "unit", ValueError, "one of 'trace'"),
        (MKLSVC, "approximation", True, ValueError, "one of 'auto'"),
        (MKLSVC, "tol", -1, ValueError, "positive"),
        (MKLSVC, "probability", "no", ValueError, "one of True, False"),
        (MKLSVC, "max_iter", 0, ValueError, "at least 1"),
        (MKLSVC, "n_landmarks", 0, ValueError, "at least 1"),
    ],
)
def test_bad_parameters_are_refused_at_fit(kind, name, value, error, message, separate):
    with pytest.raises(error, match=f"{name} must be {message}"):
        kind(**{name: value}).fit(*separate[:2])


PUBLIC_CLASSIFIERS = [
    KernelDensityBayes,
    KernelDensityNaiveBayes,
    KernelRidgeClassifier,
    MKLSVC,
    OnePerLabelSVC,
]
each_public_classifier = pytest.mark.parametrize("classifier", PUBLIC_CLASSIFIERS)


@each_public_classifier
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


@each_public_classifier
def test_labels_of_one_kind_may_be_objects(classifier, two_labels):
    X, labels = two_labels
    names = labels.astype(object)
    assert set(classifier().fit(X, names).predict(X)) == {"a", "b"}


@each_public_classifier
def test_features_whose_squares_leave_the_range_are_refused(classifier, two_labels):
    X, labels = two_labels
    with pytest.raises(ValueError, match=r"X must .*[Ss]cale the features"):
        classifier().fit(1e200 * X, labels)


@pytest.mark.parametrize("classifier", [MKLSVC, KernelRidgeClassifier])
def test_immense_touches_are_refused_by_a_learnt_machine(classifier, two_labels):
    machine = classifier().fit(*two_labels)
    with pytest.raises(ValueError, match=r"X must be at most 1e\+150 .*e\+200"):
        machine.predict(1e200 * two_labels[0])


@pytest.mark.parametrize("sigma", [1e150, 1e-150])
def test_widths_at_the_ends_of_the_range_have_a_defined_answer(sigma, two_labels):
    machine = MKLSVC(kernels=[GaussianKernel(sigma), GaussianKernel(1.0)])
    machine.fit(*two_labels)
    assert np.isfinite(machine.decision_function(two_labels[0])).all()


@pytest.mark.parametrize("kind", [KernelRidgeClassifier, MKLSVC, OnePerLabelSVC])
def test_a_fit_of_one_label_leaves_a_classifier_as_it_was(kind, rng):
    touches, labels = rng.normal(size=(12, 3)), ["mug", "pen"] * 6
    learnt = kind().fit(touches, labels)
    before = learnt.predict(touches).tolist()
    with pytest.raises(ValueError, match="at least two labels, got 1 class: mug"):
        learnt.fit(touches, ["mug"] * 12)
    assert learnt.predict(touches).tolist() == before
