"""What is kept of the training touches: it stays with its touches, whatever changes."""

import json
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.recognition import ObjectRecogniser, without_copies

NAMES = ("ball", "mug", "pen")
DATA = Path(__file__).parent / "data"
SENSOR = {"kind": "mat", "response": np.arange(3.0)}


def drawn(seed, names=NAMES, n_each=12):
    """Touches of objects that differ by one pattern each, with ids of their own."""
    patterns = np.random.default_rng(7).normal(size=(len(NAMES), 3, 24))
    labels = np.repeat(names, n_each)
    rows = [NAMES.index(name) for name in labels]
    noise = np.random.default_rng(seed).normal(size=(len(labels), 3, 24))
    ids = [f"{seed:016x}{row:016x}" for row in range(len(labels))]
    images = patterns[rows] + 0.6 * noise
    return Touches(images, object=labels, touch_id=ids, geometry="none")


@pytest.fixture(scope="module")
def model():
    return ObjectRecogniser().fit(drawn(0))


@pytest.fixture
def learnt(model):
    """Give a model that may be changed."""
    return deepcopy(model).remember_sensor(SENSOR)


def ids_of(recogniser):
    memory = recogniser.memory_
    return {
        str(name): set(memory.touch_ids[memory.labels == name])
        for name in recogniser.classes_
    }


def test_ids_and_sensor_are_kept_when_an_object_is_forgotten(learnt):
    before = ids_of(learnt)
    after = ids_of(learnt.forget_object("mug"))
    assert after == {name: before[name] for name in ("ball", "pen")}
    assert learnt.memory_.sensor == SENSOR


def test_ids_stay_with_their_object_when_more_is_learnt(learnt):
    before, new = ids_of(learnt), drawn(1, ("pen",), 5)
    after = ids_of(learnt.extend_object("pen", new))
    assert after["ball"] == before["ball"]
    assert after["pen"] == before["pen"] | set(new.touch_id)
    assert len(learnt.memory_) == 41


def test_ids_and_sensor_are_in_the_model_file(learnt, tmp_path):
    again = ObjectRecogniser.load(learnt.save(tmp_path / "m.palpate"))
    assert ids_of(again) == ids_of(learnt)
    assert again.memory_.sensor["kind"] == "mat"
    assert_array_equal(again.memory_.sensor["response"], SENSOR["response"])


def test_one_of_two_objects_is_learnt_anew():
    learnt = ObjectRecogniser().fit(drawn(0, ("ball", "pen")))
    new = drawn(1, ("pen",), 6)
    learnt.replace_objects(new)
    assert learnt.classes_.tolist() == ["ball", "pen"]
    assert ids_of(learnt)["pen"] == set(new.touch_id)
    assert learnt.start().update(drawn(2, ("pen",), 3)).best == "pen"


def test_replacing_forgets_what_is_named_and_learns_the_rest(learnt):
    learnt.replace_objects(drawn(1, ("pen",)), forget=["mug", "nobody knows it"])
    assert learnt.classes_.tolist() == ["ball", "pen"]
    with pytest.raises(ValueError, match="At least two objects must remain"):
        learnt.replace_objects(None, forget=["ball"])
    assert learnt.classes_.tolist() == ["ball", "pen"]


def test_all_ways_to_the_same_touches_learn_the_same():
    first, later = drawn(0), drawn(1, ("pen",), 7)
    extended = ObjectRecogniser().fit(first).extend_object("pen", later)
    pens = first.object == "pen"
    both = Touches.concatenate([first[pens], later])
    replaced = ObjectRecogniser().fit(first).replace_objects(both)
    test = drawn(2)
    # The rows are the same and in another order, the blocks others.
    assert_array_equal(extended.predict(test), replaced.predict(test))


def test_blocks_of_later_touches_are_their_own(learnt):
    before = set(learnt.memory_.blocks)
    learnt.extend_object("pen", drawn(1, ("pen",), 7))
    assert not before & set(learnt.memory_.blocks[36:])
    learnt.add_object("cup", drawn(3, ("ball",), 7))
    assert len(set(learnt.memory_.blocks)) == len(before) + 10


def test_a_failed_change_leaves_the_recogniser_as_it_was(learnt):
    test, before = drawn(2), learnt.memory_
    likelihood = learnt.log_likelihood(test)
    with pytest.raises(ValueError, match="3 x 24 taxels"):
        learnt.extend_object("pen", np.zeros((4, 5, 5)))
    with pytest.raises(ValueError, match="must be one of 'ball', 'mug', 'pen'"):
        learnt.extend_object("cup", test)
    with pytest.raises(ValueError, match="known already"):
        learnt.add_object("pen", test)
    with pytest.raises(ValueError, match="at least 2 touches, got 1"):
        learnt.add_object("cup", test[0])
    assert learnt.memory_ is before
    assert_array_equal(learnt.log_likelihood(test), likelihood)


def test_sessions_are_remembered():
    touches = drawn(0).with_columns(session=np.tile(["mon", "tue"], 18))
    memory = ObjectRecogniser().fit(touches).memory_
    assert set(memory.sessions) == {"mon", "tue"}
    assert len(set(memory.blocks)) == 2
    assert set(ObjectRecogniser().fit(drawn(0)).memory_.sessions) == {""}


@pytest.mark.parametrize("preset", ["default", "liu2014"])
def test_models_of_format_3_are_read_and_answer_the_same(preset, tmp_path):
    model = ObjectRecogniser.load(DATA / f"format3_{preset}.palpate")
    expected = json.loads((DATA / "format3_expected.json").read_text())[preset]
    test = Touches.load(DATA / "format3_test.npz")
    # Written on another day, maybe by another BLAS: rounding, not more.
    for touch, (posterior, _) in zip(test, expected["each"], strict=True):
        belief = model.start().update(touch)
        assert belief.posterior == pytest.approx(posterior, abs=1e-9)
        # One encoding: what it leaves to other names.
        assert belief.unknown == pytest.approx(belief.doubt, abs=1e-9)
    assert model.limits_.promise(0.01).n_units == 3
    again = ObjectRecogniser.load(model.save(tmp_path / "again.palpate"))
    assert_array_equal(again.log_likelihood(test), model.log_likelihood(test))
    cups = test[:4].without("object")
    again.add_object("cup", cups)
    assert again.classes_.tolist() == ["cup", "nut", "pin", "ring"]
    if preset == "default":
        assert model.pose_ is not None
        assert model.start().update_sense("sight", [3.0, 0.0]).best == "pin"


def test_copies_are_left_out_together():
    rng = np.random.default_rng(0)
    features = rng.normal(size=(20, 5))
    features[15:] = features[:5] + 1e-3 * rng.normal(size=(5, 5))
    objects = np.repeat(["cup"], 20)
    blocks = np.repeat(np.arange(5), 4)
    joined = without_copies(features, objects, blocks)
    # Touches 15 to 19 are those of 0 to 4, which lie in the first two blocks.
    assert joined.tolist() == [*blocks[:15], 0, 0, 0, 0, 1]


def test_touches_that_are_all_alike_keep_their_blocks():
    features, objects = np.zeros((10, 3)), np.repeat(["cup"], 10)
    blocks = np.repeat(np.arange(5), 2)
    assert without_copies(features, objects, blocks).tolist() == blocks.tolist()


WAYS = {
    "fit": lambda model, touches, odd: model.fit(touches.with_columns(object=odd)),
    "y": lambda model, touches, odd: model.fit(touches.images, odd),
    "add": lambda model, touches, odd: model.add_object("unknown", touches[:4]),
}


@pytest.mark.parametrize("way", WAYS)
def test_nothing_may_be_called_unknown(way):
    touches = drawn(0)
    odd = np.where(touches.object == touches.object[0], "unknown", touches.object)
    learnt = ObjectRecogniser().fit(touches)
    with pytest.raises(ValueError, match="name must not be 'unknown'"):
        WAYS[way](learnt, touches, odd)
