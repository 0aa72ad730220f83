"""The recogniser as scikit-learn's own functions use it: images in, labels out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer

from palpate import Touches
from palpate.recognition import ObjectRecogniser


@pytest.fixture(scope="module")
def images_and_labels():
    rng = np.random.default_rng(0)
    patterns = rng.normal(size=(3, 3, 24))
    labels = np.tile(["ball", "mug", "pen"], 16)
    codes = np.tile([0, 1, 2], 16)
    return patterns[codes] + 0.6 * rng.normal(size=(48, 3, 24)), labels


def test_predicted_probabilities_are_those_of_a_belief_after_one_touch(
    images_and_labels,
):
    images, labels = images_and_labels
    learnt = ObjectRecogniser().fit(images, labels)
    proba = learnt.predict_proba(images[:5])
    assert_allclose(proba.sum(axis=1), 1)
    for image, row in zip(images, proba, strict=False):
        posterior = learnt.start(strangers=0).update(image).posterior
        assert_allclose(row, list(posterior.values()), rtol=1e-9)
    assert_allclose(learnt.predict_log_proba(images[:5]), np.log(proba))
    assert learnt.score(images, labels) == (learnt.predict(images) == labels).mean()
    assert learnt.score(Touches(images, object=labels)) == learnt.score(images, labels)


def test_labels_keep_their_kind(images_and_labels):
    images, labels = images_and_labels
    numbers = np.unique(labels, return_inverse=True)[1] + 10
    learnt = ObjectRecogniser().fit(images, numbers)
    assert learnt.classes_.tolist() == [10, 11, 12]
    assert learnt.predict(images[:1]).dtype.kind == "i"
    assert learnt.start().update(images[0]).best in {"10", "11", "12"}
    counted = learnt.start({12: 2.0, 10: 1.0, 11: 1.0}, strangers=0).posterior
    assert counted == pytest.approx({"10": 0.25, "11": 0.25, "12": 0.5})
    assert learnt.forget_object("11").classes_.tolist() == [10, 12]
    assert learnt.add_object("7", images[:4]).classes_.tolist() == [7, 10, 12]
    with pytest.raises(ValueError, match="must be a number like the known labels"):
        learnt.add_object("cup", images[:4])


WRONG_NUMBERS = {"01": "as int8 is the known label 1", "200": "of int8, got '200'"}


def test_a_name_that_no_new_label_stands_for_is_refused(images_and_labels):
    images, labels = images_and_labels
    is_ball = labels == labels[0]
    learnt = ObjectRecogniser().fit(images, is_ball)
    assert learnt.extend_object("False", images[:4]).memory_.labels[-4:].sum() == 0
    learnt.fit(images, is_ball.astype(np.int8))
    for name, message in WRONG_NUMBERS.items():
        with pytest.raises(ValueError, match=message):
            learnt.add_object(name, images[:4])
    assert learnt.memory_.labels.tolist() == is_ball.tolist()


@pytest.mark.parametrize("label", ["object", "category"])
def test_touches_name_numbers_that_were_learnt_in_texts(images_and_labels, label):
    images, labels = images_and_labels
    numbers = np.unique(labels, return_inverse=True)[1] + 9  # "9" is after "10"
    learnt = ObjectRecogniser(label=label).fit(images, numbers)
    assert learnt.classes_.tolist() == [9, 10, 11]
    touches = Touches(images, **{label: numbers})
    assert learnt.score(touches) == learnt.score(images, numbers)
    learnt.remount(touches[::8])
    assert learnt.classes_.tolist() == [9, 10, 11]
    assert learnt.chosen_["remount"]["labelled"]
    assert learnt.memory_.labels[-6:].tolist() == numbers[::8].tolist()
    with pytest.raises(ValueError, match="known objects, got '7', which was not"):
        learnt.remount(Touches(images[:1], **{label: [7]}))


def test_cross_validation_scores_images_and_touches_alike(images_and_labels):
    images, labels = images_and_labels
    groups = np.arange(48) // 6
    scores = cross_val_score(
        ObjectRecogniser(), images, labels, cv=GroupKFold(2), groups=groups
    )
    assert scores.mean() > 0.8
    touches = Touches(images, object=labels)
    of_touches = cross_val_score(
        ObjectRecogniser(), touches, labels, cv=GroupKFold(2), groups=groups
    )
    assert_array_equal(of_touches, scores)


def test_grid_search_over_parameters(images_and_labels):
    search = GridSearchCV(
        ObjectRecogniser(), {"floor": [0.0, 0.2], "prior": ["counts"]}, cv=2
    )
    search.fit(*images_and_labels)
    assert search.best_score_ > 0.7


def test_a_recogniser_ends_a_pipeline(images_and_labels):
    images, labels = images_and_labels
    halved = FunctionTransformer(lambda X: X[:, :, ::2])
    chain = make_pipeline(halved, ObjectRecogniser()).fit(images, labels)
    assert chain.score(images, labels) > 0.8


def test_what_was_learnt_does_not_change_with_what_it_was_learnt_from(
    images_and_labels,
):
    images, labels = map(np.array, images_and_labels)
    rest, asked = images.min(axis=0), images[:5].copy()
    as_they_are = FunctionTransformer(lambda images: images.reshape(len(images), -1))
    learnt = ObjectRecogniser(None, encodings={"own": as_they_are})
    learnt.fit(Touches(images, no_contact=rest), labels)
    before = learnt.predict_proba(asked), learnt.evidence(asked).log_distances
    learnt.left_out_rows[:] = 0
    learnt.classifier_.left_out_log_likelihood()[:] = 0
    for array in (images, labels, rest):
        array[:] = array[0]
    assert_array_equal(learnt.predict_proba(asked), before[0])
    assert_array_equal(learnt.evidence(asked).log_distances, before[1])
    assert_array_equal(learnt.encoder_.baseline_, images_and_labels[0].min(axis=0))
    assert learnt.left_out_rows.max() == 47
    assert learnt.left_out_log_likelihood().any()


def test_clone_has_learnt_nothing(images_and_labels):
    learnt = ObjectRecogniser(floor=0.1, random_state=4).fit(*images_and_labels)
    fresh = clone(learnt)
    assert fresh.get_params() == learnt.get_params()
    for use in (
        fresh.start,
        lambda: fresh.predict(images_and_labels[0]),
        lambda: fresh.save("m.palpate"),
        lambda: fresh.add_object("cup", images_and_labels[0]),
        fresh.summary,
        fresh.limits_message,
    ):
        with pytest.raises(NotFittedError, match="learnt nothing yet; call fit"):
            use()


def test_groups_are_left_out_together(images_and_labels):
    images, labels = images_and_labels
    groups = np.arange(48) // 12
    learnt = ObjectRecogniser().fit(images, labels, groups=groups)
    assert_array_equal(learnt.memory_.blocks, groups)
    for groups in (["monday"] * 48, labels):
        with pytest.raises(ValueError, match=r"groups must be .* two.* got one of"):
            learnt.fit(images, labels, groups=groups)


def test_bad_input_is_refused(images_and_labels):
    images, labels = images_and_labels
    with pytest.raises(ValueError, match="one entry for each of"):
        ObjectRecogniser().fit(images, labels, groups=[1, 2])
    with pytest.raises(ValueError, match="y must have no masked labels, got 16"):
        ObjectRecogniser().fit(images, np.ma.masked_equal(labels, "mug"))
    with pytest.raises(TypeError, match="labels of one kind, got text and numbers"):
        ObjectRecogniser().fit(images, [*labels[:-1], 3])
    with pytest.raises(ValueError, match="got an array of shape"):
        ObjectRecogniser().fit(images.reshape(48, -1, 1, 1), labels)
