"""Other senses, priors, costs and explanations of a belief."""

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


def test_sight_alone_moves_the_belief(recogniser):
    model, _ = recogniser
    belief = model.start().update_sense("sight", [4.0, 4.0])
    assert belief.best == "pen"
    assert belief.touches_used == 0
    assert belief.decide(error=0.1) == "pen"


def test_sight_and_touch_add_up_in_any_order(recogniser):
    model, touches = recogniser
    sight_first = model.start().update_sense("sight", [0.4, 0.0]).update(touches[:2])
    touch_first = model.start().update(touches[:2]).update_sense("sight", [0.4, 0.0])
    assert sight_first.posterior == pytest.approx(touch_first.posterior)
    touch_alone = model.start().update(touches[:2])
    assert sight_first.posterior["pen"] < touch_alone.posterior["pen"]


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
    prior = {"ball": 2.0, "mug": 1.0, "pen": 1.0}
    belief = model.start(prior, strangers=0)
    assert belief.posterior == pytest.approx({"ball": 0.5, "mug": 0.25, "pen": 0.25})
    shares = model.start(prior, strangers=0.2).posterior
    assert shares == pytest.approx({"ball": 0.4, "mug": 0.2, "pen": 0.2})
    with pytest.raises(ValueError, match=r"prior must not .* 1e-308 for 'pen'"):
        model.start({"ball": 1.0, "mug": 1.0, "pen": 1e-308})
    huge = model.start(dict.fromkeys(NAMES, 1e308), strangers=0).posterior
    assert huge == pytest.approx(dict.fromkeys(NAMES, 1 / 3))


def test_costs_choose_the_cheaper_mistake(recogniser):
    model, _ = recogniser
    belief = model.start({"ball": 0.9, "mug": 0.05, "pen": 0.05})
    belief.update_sense("sight", [0.4, 0.0])
    assert belief.best == "ball"
    assert belief.decide(error=0.3) == "ball"
    # To take a mug for a ball costs very much, to take a ball for a mug nothing.
    costs = {"mug": {"ball": 50.0}, "ball": {"mug": 0.0}, "pen": {"mug": 0.0}}
    assert belief.decide(error=0.3, costs=costs) == "mug"
    assert belief.reason(0.3).startswith("ball, ")
    assert belief.reason(0.3, costs).startswith("mug, ")
    dear = {a: {b: 9.0 for b in NAMES if b != a} for a in NAMES}
    assert belief.decide(0.01, dear) is None
    with pytest.raises(ValueError, match="costs"):
        belief.decide(costs={"mug": {"ball": -1.0}})
    with pytest.raises(ValueError, match="costs"):
        belief.decide(costs={"cup": {"ball": 1.0}})
    with pytest.raises(TypeError, match="costs must be a mapping"):
        belief.decide(costs=5)
    with pytest.raises(TypeError, match="costs of 'mug'"):
        belief.decide(costs={"mug": 5})
    with pytest.raises(ValueError, match="0 for the right name"):
        belief.decide(costs={"mug": {"mug": 1.0}})


def test_explanation_names_the_touch_that_decided(recogniser):
    model, touches = recogniser
    vague = touches.images.mean(axis=0)
    belief = model.start().update(vague).update(touches[45]).update(vague)
    first = belief.explain(n_touches=1, n_nearest=2)[0]
    assert first["touch"] == 2
    assert first["best"] == "pen"
    assert first["nats"] > 0
    # The very touch was learnt, so it is its own nearest neighbour.
    assert first["nearest"][0] == {"object": "pen", "row": 45, "distance": 0.0}
    assert next(e["touch"] for e in belief.explain(3)) == 2
    assert model.start().explain() == []
