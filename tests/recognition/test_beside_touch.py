"""Other senses, and priors, of a belief."""

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression, RidgeClassifier

from palpate import Touches
from palpate.recognition import ModelFileError, ObjectRecogniser

NAMES = ("ball", "mug", "pen")


def clouds(seed, n_each, spread=0.6):
    """Three clouds of vectors in a plane; the first two overlap."""
    rng = np.random.default_rng(seed)
    centres = np.array([[0.0, 0.0], [0.8, 0.0], [4.0, 4.0]])
    X = np.repeat(centres, n_each, axis=0) + spread * rng.normal(size=(3 * n_each, 2))
    return X, np.repeat(NAMES, n_each)


@pytest.fixture(scope="module")
def recogniser():
    rng = np.random.default_rng(0)
    images = rng.random((60, 3, 6))
    images[:20, 0] += 1.5
    images[20:40, 1] += 1.5
    images[40:, 2] += 1.5
    touches = Touches(images, object=np.repeat(NAMES, 20), geometry="none")
    learnt = ObjectRecogniser().fit(touches)
    return learnt.learn_modality("sight", *clouds(1, 30)), touches


def test_any_classifier_with_probabilities_can_be_a_sense(recogniser):
    model, _ = recogniser
    model.learn_modality("guess", *clouds(3, 30), classifier=LogisticRegression())
    assert model.start().update_sense("guess", [[4.0, 4.0]] * 2).best == "pen"


def test_unlearnt_senses_and_classifiers_without_probabilities_are_refused(recogniser):
    model, _ = recogniser
    with pytest.raises(ValueError, match="sight"):
        model.start().update_sense("smell", [1.0, 2.0])
    with pytest.raises(ValueError, match="Call learn_modality first"):
        ObjectRecogniser().fit(recogniser[1]).start().update_sense("sight", [1.0])
    with pytest.raises(TypeError, match="predict_proba"):
        model.learn_modality("x", *clouds(0, 5), classifier=RidgeClassifier())


def test_model_file_keeps_sight_and_refuses_foreign_classifiers(tmp_path, recogniser):
    touches = recogniser[1]
    model = ObjectRecogniser().fit(touches).learn_modality("sight", *clouds(1, 30))
    again = ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))
    example = [1.0, 1.0]
    assert again.start().update_sense("sight", example).posterior == pytest.approx(
        model.start().update_sense("sight", example).posterior, abs=1e-12
    )
    model.learn_modality("guess", *clouds(3, 9), classifier=LogisticRegression())
    with pytest.raises(ModelFileError, match="LogisticRegression"):
        model.save(tmp_path / "n.palpate")


def test_a_given_prior_is_where_the_belief_starts(recogniser):
    model, _ = recogniser
    prior = {"pen": 1.0, "ball": 2.0, "mug": 1.0}
    belief = model.start(prior, strangers=0)
    assert belief.posterior == pytest.approx({"ball": 0.5, "mug": 0.25, "pen": 0.25})
    shares = model.start(prior, strangers=0.2).posterior
    assert shares == pytest.approx({"ball": 0.4, "mug": 0.2, "pen": 0.2})
    huge = model.start(dict.fromkeys(NAMES, 1e308), strangers=0).posterior
    assert huge == pytest.approx(dict.fromkeys(NAMES, 1 / 3))
    least = model.start({"ball": 1e-12, "mug": 0.5, "pen": 0.5}, strangers=0)
    assert least.posterior["ball"] == pytest.approx(1e-12)


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
    recogniser, prior, error, message
):
    model, _ = recogniser
    with pytest.raises(error, match=message):
        model.start(prior)
