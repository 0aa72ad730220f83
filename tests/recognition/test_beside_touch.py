"""Other senses, and priors, of a belief."""

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression, RidgeClassifier

from palpate import Touches
from palpate.recognition import Modality, ModelFileError, ObjectRecogniser

NAMES = ("ball", "mug", "pen")


def examples(seed=0, n_each=10, spread=1.0):
    """Examples of three things in a plane, and their names."""
    noise = np.random.default_rng(seed).normal(size=(3 * n_each, 2))
    centres = np.array([[0.0, 50.0], [3.0, 50.0], [0.0, 90.0]])
    X = np.repeat(centres, n_each, axis=0) + [spread, 10 * spread] * noise
    return X, np.repeat(NAMES, n_each)


@pytest.fixture(scope="module")
def touches():
    images = np.random.default_rng(0).random((60, 3, 6))
    images += 1.5 * np.repeat(np.eye(3), 20, axis=0)[:, :, np.newaxis]
    return Touches(images, object=np.repeat(NAMES, 20), geometry="none")


@pytest.fixture(scope="module")
def model(touches):
    return ObjectRecogniser().fit(touches).learn_modality("sight", *examples())


def test_any_classifier_with_probabilities_can_be_a_sense(model):
    model.learn_modality("guess", *examples(3), classifier=LogisticRegression())
    assert model.start().update_sense("guess", [[0.0, 90.0]] * 2).best == "pen"


def test_unlearnt_senses_and_classifiers_without_probabilities_are_refused(
    model, touches
):
    with pytest.raises(ValueError, match="sight"):
        model.start().update_sense("smell", [1.0, 2.0])
    with pytest.raises(ValueError, match="Call learn_modality first"):
        ObjectRecogniser().fit(touches).start().update_sense("sight", [1.0])
    with pytest.raises(TypeError, match="predict_proba"):
        model.learn_modality("x", *examples(), classifier=RidgeClassifier())


def test_model_file_keeps_sight_and_refuses_foreign_classifiers(tmp_path, touches):
    model = ObjectRecogniser().fit(touches).learn_modality("sight", *examples())
    again = ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))
    example = [1.5, 60.0]
    assert again.start().update_sense("sight", example).posterior == pytest.approx(
        model.start().update_sense("sight", example).posterior, abs=1e-12
    )
    model.learn_modality("guess", *examples(3), classifier=LogisticRegression())
    with pytest.raises(ModelFileError, match="LogisticRegression"):
        model.save(tmp_path / "n.palpate")


def test_a_given_prior_is_where_the_belief_starts(model):
    prior = {"pen": 1.0, "ball": 2.0, "mug": 1.0}
    belief = model.start(prior, strangers=0)
    assert belief.posterior == pytest.approx({"ball": 0.5, "mug": 0.25, "pen": 0.25})
    shares = model.start(prior, strangers=0.2).posterior
    assert shares == pytest.approx({"ball": 0.4, "mug": 0.2, "pen": 0.2})
    huge = model.start(dict.fromkeys(NAMES, 1e308), strangers=0).posterior
    assert huge == pytest.approx(dict.fromkeys(NAMES, 1 / 3))
    least = model.start({"ball": 1e-12, "mug": 0.5, "pen": 0.5}, strangers=0)
    assert least.posterior["ball"] == pytest.approx(1e-12, rel=1e-9, abs=0)


@pytest.mark.parametrize(
    ("prior", "error", "message"),
    [
        ([0.5] * 3, TypeError, "prior must map objects to probabilities, got list"),
        ({"ball": 1.0, "pen": 1.0}, ValueError, "in 'mug'. The objects are ball, mug"),
        (dict.fromkeys((*NAMES, "rod"), 1.0), ValueError, "a difference in 'rod'"),
        ({"ball": 1.0, "mug": 0.0, "pen": 1.0}, ValueError, "prior must be positive"),
        (
            {"ball": 0.9e-12, "mug": 0.5, "pen": 0.5},
            ValueError,
            "prior must not .* got 9e-13 for 'ball'. Give it at least",
        ),
    ],
)
def test_a_prior_without_a_positive_number_for_each_object_is_refused(
    model, prior, error, message
):
    with pytest.raises(error, match=message):
        model.start(prior)


def test_a_sense_gives_the_probabilities_of_its_classifier_with_the_floor():
    X, y = examples()
    sense = Modality(floor=0.2).fit(X, y)
    assert sense.classes_.tolist() == ["ball", "mug", "pen"]
    new_examples = examples(1, 2)[0]
    scaled = (new_examples - X.mean(axis=0)) / X.std(axis=0)
    shares = np.exp(sense.classifier_.log_likelihood(scaled))
    shares = 0.8 * shares / shares.sum(axis=1, keepdims=True) + 0.2 / 3
    probabilities = np.exp(
        sense.log_likelihood(new_examples, np.array(["pen", "ball", "mug"]))
    )
    assert probabilities == pytest.approx(shares[:, [2, 0, 1]])
    # A name that it never learnt gets the mean of the learnt ones among the names.
    with_box = np.exp(
        sense.log_likelihood(new_examples, np.array(["box", "mug", "pen"]))
    )
    middle = shares[:, 1:].mean(axis=1)
    assert with_box == pytest.approx(np.column_stack([middle, shares[:, 1:]]))
    unlearnt = sense.log_likelihood(new_examples, np.array(["box", "cup"]))
    assert unlearnt.tolist() == [[0.0, 0.0]] * 6


def test_examples_that_resemble_each_other_are_left_out_together():
    X, y = examples(spread=3.0)
    alone = Modality().fit(X, y).sequence_calibration_
    assert alone == Modality().fit(X, y, groups=np.arange(30)).sequence_calibration_
    # The seed changes no calibration at its bounds, but that of overlapping examples.
    overlap = examples(n_each=40, spread=4.0)
    drawn = [Modality(random_state=k).fit(*overlap) for k in (0, 1)]
    assert drawn[0].sequence_calibration_ != drawn[1].sequence_calibration_
    # A copy whose original is in training makes a sense look surer than it is.
    rng = np.random.default_rng(2)
    copies = np.repeat(X, 4, axis=0) + 1e-3 * rng.normal(size=(120, 2))
    names, visit = np.repeat(y, 4), np.repeat(np.arange(30), 4)
    grouped = Modality().fit(copies, names, groups=visit).sequence_calibration_
    ungrouped = Modality().fit(copies, names).sequence_calibration_
    assert grouped.strength < ungrouped.strength - 0.2


@pytest.mark.parametrize("floor", [0, 0.5])
def test_a_floor_of_a_sense_is_at_most_a_half(floor):
    assert Modality(floor=floor).fit(*examples()).floor == floor
    for beyond in (-0.01, 0.51):
        with pytest.raises(ValueError, match="floor must be"):
            Modality(floor=beyond).fit(*examples())


@pytest.mark.parametrize(
    ("y", "message"),
    [
        (["a"] * 4, "must hold at least two labels of two examples each"),
        (["a", "a", "a", "b"], "must hold at least two labels of two examples each"),
        (["a", "b"], "must have one entry for each of 4 examples"),
        ([1.0, 1.0, np.nan, np.nan], "contains NaN"),
        (["a", "a", None, None], "must hold labels of one kind"),
    ],
)
def test_a_sense_needs_two_labels_of_two_examples(y, message):
    with pytest.raises((TypeError, ValueError), match=f"y {message}"):
        Modality().fit(np.eye(4), y)
    Modality().fit(np.eye(4), ["a", "b", "b", "a"])


def test_labels_of_a_sense_are_spelt_as_those_of_touch():
    pandas = pytest.importorskip("pandas")
    numbers = pandas.Series([1, 1, 20, 20]).astype("Int64")
    assert Modality().fit(np.eye(4), numbers).classes_.tolist() == ["1", "20"]
