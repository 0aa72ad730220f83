"""The memory of training touches: ids and blocks stay with them in every change."""

import json
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.recognition import (
    EmptyTouchError,
    Memory,
    ObjectRecogniser,
    SequenceCalibration,
)

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


def test_replacing_forgets_the_objects_named_and_learns_the_others(learnt):
    learnt.replace_objects(drawn(1, ("pen",)), forget=["mug", "nobody knows it"])
    assert learnt.classes_.tolist() == ["ball", "pen"]
    with pytest.raises(ValueError, match="At least two objects must remain"):
        learnt.replace_objects(None, forget="ball")
    with pytest.raises(ValueError, match="must have a column 'object' to learn from"):
        learnt.replace_objects(np.ones((4, 3, 24)))
    assert learnt.classes_.tolist() == ["ball", "pen"]


def test_the_sensor_is_kept_where_all_touches_are_replaced(learnt):
    learnt.replace_objects(drawn(1), forget=NAMES)
    assert learnt.memory_.sensor == SENSOR
    none_left = learnt.memory_.without(NAMES)
    assert learnt.learn_beside(none_left, drawn(2)).memory_.sensor == SENSOR


def test_extending_and_replacing_learn_the_same_of_the_same_touches():
    first, later = drawn(0), drawn(1, ("pen",), 7)
    extended = ObjectRecogniser().fit(first).extend_object("pen", later)
    pens = first.object == "pen"
    both = Touches.concatenate([first[pens], later])
    replaced = ObjectRecogniser().fit(first).replace_objects(both)
    test = drawn(2)
    # The same rows are in another order and in other blocks.
    assert_array_equal(extended.predict(test), replaced.predict(test))


def test_blocks_of_later_touches_are_their_own(learnt):
    before = set(learnt.memory_.blocks)
    learnt.extend_object("pen", drawn(1, ("pen",), 7))
    assert not before & set(learnt.memory_.blocks[36:])
    learnt.add_object("cup", drawn(3, ("ball",), 7))
    assert len(set(learnt.memory_.blocks)) == len(before) + 10


def test_later_touches_are_of_the_object_that_is_named_whatever_their_own_labels(
    learnt,
):
    """As those of a working name, or of another object that is known."""
    cups = drawn(3, ("ball",), 7)
    learnt.add_object("cup", cups).extend_object("pen", drawn(4, ("mug",), 2))
    assert_array_equal(learnt.memory_.objects, learnt.memory_.labels)
    (step,) = learnt.start().update(cups[:1]).explain(n_nearest=1)
    # The very touch was learnt, so it is its own nearest neighbour.
    assert step["nearest"] == [{"object": "cup", "row": 36, "distance": 0.0}]


def test_a_belief_goes_on_by_what_was_learnt_when_it_began(learnt):
    """Columns of another object would be taken for those of the one forgotten."""
    ball, belief = drawn(2)[:2], learnt.start()
    expected = learnt.start().update(ball[0]).update(ball[1]).posterior
    learnt.forget_object("mug").add_object("cup", drawn(3, ("mug",)))
    assert learnt.classes_.tolist() == ["ball", "cup", "pen"]
    assert belief.update(ball[0]).update(ball[1]).posterior == expected
    assert [*learnt.start().update(ball).posterior] == ["ball", "cup", "pen"]


ASKED = {
    "start": lambda model, touches: [*model.start().update(touches).posterior],
    "predict": lambda model, touches: model.predict(touches).tolist(),
    "predict_proba": lambda model, touches: model.predict_proba(touches).shape,
    "object_quality": lambda model, _: [row["name"] for row in model.object_quality()],
}


@pytest.mark.parametrize("ask", ASKED.values(), ids=ASKED)
def test_what_another_thread_learns_meanwhile_is_not_mixed_in(learnt, monkeypatch, ask):
    balls = drawn(2)[:2]
    expected = ask(learnt, balls)
    later = deepcopy(learnt).add_object("cup", drawn(3, ("mug",)))

    def while_another_learns(method):
        def answer(self):
            vars(learnt).update(vars(later))
            return method(self)

        return answer

    for name in ("log_prior", "left_out_log_likelihood"):
        method = while_another_learns(getattr(ObjectRecogniser, name))
        monkeypatch.setattr(ObjectRecogniser, name, method)
    assert ask(learnt, balls) == expected
    assert "cup" in learnt.classes_


def test_a_failed_change_leaves_the_recogniser_as_it_was(learnt):
    test, before = drawn(2), learnt.memory_
    likelihood = learnt.log_likelihood(test)
    with pytest.raises(ValueError, match="3 x 24 taxels"):
        learnt.extend_object("pen", np.zeros((4, 5, 5)))
    with pytest.raises(ValueError, match="must be one of 'ball', 'mug', 'pen'"):
        learnt.extend_object("cup", test)
    with pytest.raises(ValueError, match=r"known already\. Add touches"):
        learnt.add_object("pen", test)
    with pytest.raises(ValueError, match="at least 2 touches, got 1"):
        learnt.add_object("cup", test[0])
    assert learnt.memory_ is before
    assert_array_equal(learnt.log_likelihood(test), likelihood)


def test_a_change_that_runs_out_of_memory_leaves_the_recogniser_as_it_was(
    learnt, monkeypatch
):
    test, before = drawn(2), dict(vars(learnt))
    posterior = learnt.start().update(test[0]).posterior
    with monkeypatch.context() as patch:
        patch.setattr(SequenceCalibration, "weight", Mock(side_effect=MemoryError))
        with pytest.raises(MemoryError):
            learnt.add_object("cup", drawn(3, ("ball",), 7))
    assert vars(learnt).keys() == before.keys()
    assert all(value is before[name] for name, value in vars(learnt).items())
    assert learnt.start().update(test[0]).posterior == posterior


def test_learning_anew_that_fails_leaves_what_was_learnt(learnt, monkeypatch):
    """Interrupted, it had named the old objects by a classifier of the new ones."""
    test, before = drawn(2), dict(vars(learnt))
    with monkeypatch.context() as patch:
        interrupt = Mock(side_effect=KeyboardInterrupt)
        patch.setattr(SequenceCalibration, "weight", interrupt)
        with pytest.raises(KeyboardInterrupt):
            learnt.fit(drawn(3, NAMES[::-1]))
    with pytest.raises(ValueError, match="at least 2 touches, got 1 of 'cup'"):
        learnt.fit(np.ones((5, 4)), ["ball", "ball", "mug", "mug", "cup"])
    assert vars(learnt).keys() == before.keys()
    assert all(value is before[name] for name, value in vars(learnt).items())
    assert learnt.score(test) > 0.9
    # What is learnt anew is nothing but that.
    learnt.learn_modality("sight", np.arange(8.0)[:, None], ["ball", "mug"] * 4)
    assert learnt.fit(drawn(3)).modalities_ == {}


def test_a_session_that_is_not_a_number_is_not_known():
    days = np.tile([1.0, 2.0, np.nan], 12)  # a data frame's
    memory = ObjectRecogniser().fit(drawn(0).with_columns(session=days)).memory_
    assert set(memory.sessions) == {"1.0", "2.0", ""}


@pytest.mark.parametrize(
    "preset", ["default", pytest.param("liu2014", marks=pytest.mark.slow)]
)
def test_models_of_format_4_are_read_and_answer_the_same(preset, tmp_path):
    model = ObjectRecogniser.load(DATA / f"format4_{preset}.palpate")
    expected = json.loads((DATA / "format4_expected.json").read_text())[preset]
    test = Touches.load(DATA / "format4_test.npz")
    # Written on another day, maybe by another BLAS: rounding, not more.
    for touch, (posterior, _) in zip(test, expected["each"], strict=True):
        belief = model.start(strangers=0).update(touch)
        assert belief.posterior == pytest.approx(posterior, abs=1e-9)
        assert 0 < model.start().update(touch).unknown < 1
    # The stranger model was learnt anew, from the touches in memory.
    assert model.strangers_.promise(0.01).n_units == 3
    again = ObjectRecogniser.load(model.save(tmp_path / "again.palpate"))
    assert_array_equal(again.log_likelihood(test), model.log_likelihood(test))
    cups = test[:4].without("object")
    again.add_object("cup", cups)
    assert again.classes_.tolist() == ["cup", "nut", "pin", "ring"]
    if preset == "default":
        assert model.pose_ is not None
        sight = model.start().update_sense("sight", [3.0, 0.0])
        assert sight.best == "pin"


def test_a_session_that_is_there_twice_is_cut_into_blocks():
    features = np.tile(np.random.default_rng(0).normal(size=(10, 5)), (2, 1))
    objects, sessions = np.repeat(["cup"], 20), np.repeat([0, 1], 10)
    joined = memory_of(objects, sessions, features=features).with_copies_together()
    assert joined.blocks.tolist() == 2 * np.repeat(np.arange(2, 7), 2).tolist()


def test_touches_that_are_all_alike_keep_their_blocks():
    features, objects = np.zeros((10, 3)), np.repeat(["cup"], 10)
    blocks = np.repeat(np.arange(5), 2)
    memory = memory_of(objects, blocks, features=features)
    assert memory.with_copies_together().blocks.tolist() == blocks.tolist()


def test_nothing_may_be_called_unknown():
    touches = drawn(0, ("ball", "mug"))
    names = np.where(touches.object == "ball", "unknown", "mug")
    for given in ((touches.with_columns(object=names),), (touches.images, names)):
        with pytest.raises(ValueError, match="name must not be 'unknown'"):
            ObjectRecogniser().fit(*given)


def memory_of(labels, blocks=None, **columns):
    """Return a memory of touches in a row, each one unit apart from the next."""
    n = len(labels)
    features = np.arange(n, dtype=float)[:, np.newaxis] * [1.0, 0.0]
    defaults = {
        "features": features,
        "objects": np.array(labels),
        "sessions": np.full(n, ""),
        "subjects": np.full(n, ""),
        "nothing": np.zeros(n, dtype=bool),
        "touch_ids": np.array([f"{k}" for k in range(n)]),
        "categories": np.full(n, ""),
    }
    blocks = np.arange(n) if blocks is None else np.array(blocks)
    return Memory(labels=np.array(labels), blocks=blocks, **(defaults | columns))


def test_a_memory_gives_its_length_classes_categories_and_looks():
    names = ["b", "b", "a", "a", "c", "c", "d", "e", "e"]
    kinds = ["tool", "", "tool", "tool", "cup", "tool", "", "unknown", "unknown"]
    memory = memory_of(names, categories=np.array(kinds))
    assert len(memory) == 9
    assert memory.classes.tolist() == ["a", "b", "c", "d", "e"]
    # A touch of b has no category, those of c do not agree, none of d has one, and
    # that of e is no category.
    assert memory.category_of.tolist() == ["tool", "", "", "", ""]
    assert memory.looks.shape == (9, 7)
    assert np.isnan(memory.looks).all()
    looks = np.ones((8, 7))
    assert memory_of(["a"] * 8, looks=looks).looks is looks


@pytest.mark.parametrize(
    "learn",
    [
        lambda model, new: model.extend_object("ball", new[:4]),
        lambda model, new: model.remount(new),
        lambda model, new: model.learn_beside(model.memory_, new),
    ],
    ids=["extend", "remount", "beside"],
)
def test_later_touches_that_tell_no_category_leave_the_objects_theirs(learn):
    touches = drawn(0)
    kinds = np.where(touches.object == "pen", "tool", "vessel")
    learnt = ObjectRecogniser().fit(touches.with_columns(category=kinds))
    learn(learnt, drawn(1, n_each=4))
    assert learnt.memory_.category_of.tolist() == ["vessel", "vessel", "tool"]
    assert set(learnt.start().categories) == {"vessel", "tool"}
    learnt.add_object("cup", drawn(3, ("ball",), 4))
    assert learnt.memory_.category_of.tolist() == ["vessel", "", "vessel", "tool"]


def test_units_are_objects_or_objects_in_a_session():
    labels = ["a"] * 4 + ["b"] * 4 + ["c"] * 4
    alone = memory_of(labels, np.arange(12) // 2)
    assert alone.units == (3, "these objects, recorded as when they were learnt")
    visits = memory_of(labels, [0, 0, 1, 1] * 2 + [1, 1, 2, 2])
    assert visits.units == (6, "these objects in other sessions")
    one_each = memory_of(labels, np.arange(12) // 4)
    assert one_each.units[0] == 3
    # "c" is of one recording, of which there are blocks.
    in_blocks = memory_of(labels, [0, 0, 1, 1] * 2 + [2, 3, 4, 5])
    assert in_blocks.units == (5, "these objects in other sessions")


def test_later_touches_come_last_with_blocks_of_their_own_and_copies_join():
    first = memory_of(
        ["a"] * 4 + ["b"] * 4, [0, 0, 1, 1, 2, 2, 3, 3], sensor={"kind": "mat"}
    )
    more = memory_of(["b"] * 3, [0, 1, 1], sensor={"kind": "pad"})
    far = np.array([[4.0, 0.0], [95.0, 0.0], [101.0, 0.0]])
    later = Memory(**{**vars(more), "features": far})
    both = first.plus(later)
    assert both.labels.tolist() == ["a"] * 4 + ["b"] * 7
    assert both.touch_ids.tolist() == [*"01234567", *"012"]
    assert_array_equal(both.features, np.concatenate([first.features, far]))
    # The first of them is the touch of block 2; blocks are numbered on from 4.
    assert both.blocks.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 2, 5, 5]
    assert both.sensor == {"kind": "mat"}
    other = memory_of(["c"] * 2, [0, 1], sensor={"kind": "pad"})
    bare = replace(first, sensor=None).plus(other)
    # Of another object even the same features are no copy.
    assert bare.blocks.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 5]
    assert bare.sensor == {"kind": "pad"}


def test_forgetting_and_replacing_keep_the_others():
    memory = memory_of([10, 10, 2, 2, 3], [0, 1, 2, 2, 3], sensor=SENSOR)
    assert memory.without([2, "3"]).touch_ids.tolist() == ["0", "1"]
    assert memory.without([2, "3"]).sensor == SENSOR
    assert memory.without([]).touch_ids.tolist() == list("01234")
    anew = memory_of([2, 2, 2], [0, 0, 1], touch_ids=np.array(["x", "y", "z"]))
    replaced = memory.without([2]).plus(anew)
    assert replaced.touch_ids.tolist() == ["0", "1", "4", "x", "y", "z"]
    assert replaced.blocks.tolist() == [0, 1, 3, 4, 4, 5]
    none_left = anew.without([2])
    assert none_left.plus(memory_of([2, 2], [0, 1])).touch_ids.tolist() == ["0", "1"]


@pytest.mark.parametrize("most", range(2, 10))
def test_the_newest_are_kept_in_turn_of_each_session(most):
    days = ["mon"] * 5 + ["tue"] * 2 + ["mon"] + ["wed"]
    labels = [7] * 9 + [8] * 3
    memory = memory_of(labels, sessions=np.array([*days, "mon", "mon", "mon"]))
    # One more of each session in turn is kept, its last touch first.
    piles = {"mon": [7, 4, 3, 2, 1, 0], "tue": [6, 5], "wed": [8]}
    turns = [[p[k] for p in piles.values() if k < len(p)] for k in range(6)]
    ids = memory.newest("7", most).touch_ids.astype(int).tolist()
    assert ids == sorted(ids)
    assert ids[-3:] == [9, 10, 11]
    assert len(ids) == 3 + min(most, 9)
    for turn in turns:
        # A turn begins only when all of the turn before it are kept.
        left = most - sum(len(t) for t in turns[: turns.index(turn)])
        assert len(set(turn) & set(ids)) == min(max(left, 0), len(turn))


def distances(memory, features, left_out=None):
    """Return log distances to the nearest touch of each object, pair by pair."""
    touch_distances = np.linalg.norm(features[:, None] - memory.features, axis=2)
    if left_out is not None:
        touch_distances[left_out[:, None] == memory.blocks] = np.nan
    of_each = [touch_distances[:, memory.labels == name] for name in memory.classes]
    with np.errstate(divide="ignore"):
        return np.log(
            [[np.nanmin(row) for row in of_object] for of_object in of_each]
        ).T


def test_distances_are_those_to_the_nearest_touch_of_each_object(model):
    evidence = model.evidence(drawn(4))
    assert_allclose(evidence.log_distances, distances(model.memory_, evidence.features))
    # A learnt touch is next to itself; how near is up to rounding.
    again = model.evidence(drawn(0)).log_distances
    own_distances = again[np.arange(36), np.repeat([0, 1, 2], 12)]
    assert np.isfinite(own_distances).all()
    assert (own_distances < again.max() + np.log(1e-5)).all()


def test_usual_distances_leave_out_the_block_of_each_touch(model):
    memory = model.memory_
    far = distances(memory, memory.features, memory.blocks)
    usual = [
        far[memory.labels == name, k].mean() for k, name in enumerate(memory.classes)
    ]
    assert_allclose(model.strangers_.usual, usual)


@pytest.mark.parametrize(("n_each", "step"), [(666, 1), (667, 2)])
def test_distances_are_to_2000_touches_at_most(learnt, n_each, step):
    """Of more, every second touch of each object counts, from its first on."""
    touches = drawn(5, n_each=n_each)
    features = learnt.encoder_.transform(touches)
    memory = memory_of(touches.object.tolist(), features=features)
    learnt.memory_ = memory
    test = touches[::97]
    rows = np.concatenate([np.flatnonzero(memory.labels == n)[::step] for n in NAMES])
    assert len(rows) <= 2000
    part = memory_of(memory.labels[rows].tolist(), features=features[rows])
    expected = distances(part, learnt.encoder_.transform(test))
    log_distances = learnt.evidence(test).log_distances
    assert_allclose(np.maximum(log_distances, -5), np.maximum(expected, -5))


def test_distances_are_in_units_of_the_median_between_touches(learnt):
    """The median is over 300 touches at most; of 301 it is over every second one."""
    for n, step in ((300, 1), (301, 2)):
        features = np.zeros((n, learnt.memory_.features.shape[1]))
        features[:, 0] = np.random.default_rng(n).normal(size=n) * (
            1 + np.arange(n) % 2
        )
        learnt.memory_ = memory_of(
            ["ball", "mug", "pen"] * (n // 3) + ["ball"] * (n % 3), features=features
        )
        line = features[::step, 0]
        unit = np.median(abs(line[:, None] - line)[np.triu_indices(len(line), 1)])
        belief = learnt.start()
        belief.update_from_log_likelihood([0.0, -1.0, -2.0], features=features[:1] + 0)
        (explanation,) = belief.explain(n_nearest=n)
        neighbour_distances = [near["distance"] for near in explanation["nearest"]]
        assert_allclose(
            neighbour_distances, np.sort(abs(features[:, 0] - features[0, 0])) / unit
        )


def test_of_touches_that_are_all_alike_the_unit_is_one(learnt):
    features = np.ones((6, learnt.memory_.features.shape[1]))
    learnt.memory_ = memory_of([*NAMES, *NAMES], features=features)
    belief = learnt.start().update_from_log_likelihood(
        [0.0, -1.0, -2.0], features=features[:1] + 3.0 / np.sqrt(features.shape[1])
    )
    assert [n["distance"] for n in belief.explain()[0]["nearest"]] == [3.0] * 3


def test_where_most_pairs_are_alike_the_unit_is_told_by_the_others(tmp_path):
    """As of an array without noise, one object of which was touched oftener."""
    images = np.repeat([np.zeros((3, 24)), np.ones((3, 24))], [30, 10], axis=0)
    touches = Touches(images, object=["a"] * 30 + ["b"] * 10, geometry="none")
    learnt = ObjectRecogniser().fit(touches)
    (step,) = learnt.start().update(images[0]).explain(n_nearest=40)
    near = [touch["distance"] for touch in step["nearest"]]
    assert_allclose(near, [0.0] * 30 + [1.0] * 10, atol=1e-9)
    learnt.save(tmp_path / "alike.palpate")
    ObjectRecogniser.load(tmp_path / "alike.palpate")


def test_exact_copies_are_left_out_together_even_where_most_are_copies():
    features = np.array([[0.0]] * 6 + [[1.0], [2.0]])
    objects, blocks = np.repeat(["cup"], 8), np.repeat(np.arange(4), 2)
    # Of 28 pairs 15 are no distance apart, so that the median is none either.
    joined = memory_of(objects, blocks, features=features).with_copies_together()
    assert joined.blocks.tolist() == [0, 0, 0, 0, 0, 0, 3, 3]


@pytest.mark.parametrize(("share", "joined"), [(0.0099, True), (0.0101, False)])
def test_copies_are_nearer_than_a_hundredth_of_the_median_square(share, joined):
    # Pairs of 20 corners of a simplex are all at a squared distance of 2.
    features = np.vstack([np.eye(20), np.eye(20)[3]])
    features[20, 19] += np.sqrt(2 * share)
    blocks = np.arange(21) + 5
    objects = np.repeat(["cup"], 21)
    memory = memory_of(objects, blocks, features=features)
    new_blocks = memory.with_copies_together().blocks
    assert new_blocks.tolist() == [*blocks[:20], 8 if joined else 25]
    # Another object's touches are no copies; one touch alone has none.
    objects[20] = "mug"
    memory = memory_of(objects, blocks, features=features)
    assert memory.with_copies_together().blocks.tolist() == blocks.tolist()


def visits(label="object", **columns):
    """Return the groups in which twelve touches of four objects are left out."""
    objects = np.repeat(["a", "b", "c", "d"], 3)
    touches = Touches(np.zeros((12, 2, 2)), object=objects, **columns)
    return ObjectRecogniser(label=label).left_out_groups(touches).tolist()


def test_each_object_is_left_out_in_five_runs_of_its_recording_at_most():
    labels, order = np.repeat(["a", "b", "c"], [10, 10, 2]), np.arange(22)[::-1]
    touches = Touches(np.zeros((22, 2, 2)), object=labels, order=order)
    groups = ObjectRecogniser().left_out_groups(touches)
    runs = [4, 4, 3, 3, 2, 2, 1, 1, 0, 0]
    assert groups.tolist() == [*runs, *(5 + np.array(runs)), 11, 10]


def test_touches_of_a_person_or_else_a_session_are_left_out_together():
    persons = ["x", "y", "y"] * 4
    days = ["1", "2", "3"] * 4
    assert visits(subject=persons, session=days) == [0, 1, 1] * 4
    assert visits(session=days) == [0, 1, 2] * 4
    # Where one object was met by one person alone, days are left out.
    assert visits(subject=["x", "x", "x", *persons[3:]], session=days) == [0, 1, 2] * 4
    # Where it was met on one day as well, each recording is cut into runs.
    once = ["1", "1", "1", *days[3:]]
    assert visits(subject=["x"] * 12, session=once) == list(range(12))
    assert visits(session=["1"] * 3 + ["2"] * 9) == list(range(12))


def test_of_categories_whole_objects_are_left_out_where_there_are_several():
    kinds = np.repeat(["tool", "tool", "mug", "bowl"], 3)
    groups = visits("category", category=kinds)
    assert groups[:3] == [groups[0]] * 3
    assert groups[3:6] == [groups[3]] * 3
    # Mugs and bowls are one thing each, and left out in runs.
    assert len(set(groups)) == 2 + 3 + 3
    order = np.arange(12)[::-1]
    assert (
        visits("category", category=kinds, order=order)[6:]
        == groups[6:9][::-1] + (groups[9:][::-1])
    )


LATER = {
    "add": (["mug 0", "mug 1"], lambda model, new: model.add_object("mug", new)),
    "replace": (["mug 0", "mug 1"], lambda model, new: model.replace_objects(new)),
    "extend": (["mug 1"], lambda model, new: model.extend_object("mug", new)),
    "beside": (["mug 1"], lambda model, new: model.learn_beside(model.memory_, new)),
}


@pytest.mark.parametrize("change", LATER)
def test_objects_of_a_category_are_left_out_whole_whenever_they_are_learnt(change):
    """Of seven touches each, so that blocks of fourteen would hold some of both."""
    touches = drawn(0, n_each=14)
    objects = [f"{kind} {k // 7 % 2}" for k, kind in enumerate(touches.object)]
    touches = touches.with_columns(object=objects, category=touches.object)
    names, learn = LATER[change]
    is_later = np.isin(objects, names)
    recogniser = ObjectRecogniser(label="category").fit(touches[~is_later])
    memory = learn(recogniser, touches[is_later]).memory_
    blocks = [set(memory.blocks[memory.objects == n]) for n in ("mug 0", "mug 1")]
    assert [*map(len, blocks)] == [1, 1]
    assert blocks[0] != blocks[1]
    assert memory.units == (6, "these objects, recorded as when they were learnt")


@pytest.mark.parametrize(
    ("labels", "error", "message"),
    [
        (None, TypeError, "must be Touches, got ndarray without labels"),
        (["a", "b"], ValueError, "one entry for each of 3 touches, got shape"),
        (["a", "a", "a"], ValueError, "at least two object labels, got only 'a'"),
        (["a", "a", "b"], ValueError, "at least 2 touches, got 1 of 'b'"),
        (["b", "b", "a"], ValueError, "at least 2 touches, got 1 of 'a'"),
    ],
)
def test_labels_that_teach_nothing_are_refused(labels, error, message):
    with pytest.raises(error, match=message):
        ObjectRecogniser().fit(np.zeros((3, 2, 2)), labels)


def test_touches_without_labels_are_refused():
    with pytest.raises(ValueError, match="column 'object'"):
        ObjectRecogniser().fit(drawn(0).without("object"))


def test_a_touch_without_a_living_taxel_in_one_channel_is_named_by_its_id(rng):
    images, ids = rng.random((12, 9, 9, 2)), [f"{k:032x}" for k in range(12)]
    about = {"channels": ["x", "y"], "geometry": "array", "touch_id": ids}
    about["object"] = ["pen", "mug"] * 6
    dead = np.full((9, 9, 2), np.nan)
    with pytest.raises(ValueError, match="living taxel"):
        ObjectRecogniser().fit(Touches(images, **about, no_contact=dead))
    images[5, :, :, 1] = np.nan
    with pytest.raises(
        EmptyTouchError, match=f"only NaN in touch '?{ids[5]}"
    ) as refusal:
        ObjectRecogniser().fit(Touches(images, **about))
    assert refusal.value.touch_ids == [ids[5]]


def test_senses_and_objects_must_have_names(learnt):
    examples = np.eye(6), ["ball"] * 3 + ["mug"] * 3
    for name in ("", "  ", "a\nmug", None, 5, "unknown"):
        with pytest.raises(ValueError, match="name must"):
            learnt.learn_modality(name, *examples)
        with pytest.raises(ValueError, match="name must"):
            learnt.add_object(name, drawn(1)[:4])
    learnt.learn_modality("sight", *examples)
    assert list(learnt.modalities_) == ["sight"]


def test_both_spellings_of_a_letter_name_one_object():
    """A folder of macOS is spelt with accents of their own; `Touches` are not."""
    of_touches, of_folder = "caf\u00e9", "cafe\u0301"
    touches = drawn(0, n_each=5)
    names = np.where(touches.object == "mug", of_folder, touches.object)
    learnt = ObjectRecogniser().fit(touches.with_columns(object=names))
    with pytest.raises(ValueError, match="name must be new"):
        learnt.add_object(of_folder, touches[:4])
    learnt.extend_object(of_folder, touches[:4])
    assert learnt.memory_.labels[-4:].tolist() == [of_touches] * 4
    deepcopy(learnt).forget_object(of_folder)
    learnt.replace_objects(None, forget=[of_folder]).add_object(of_folder, touches[:4])
    assert learnt.classes_.tolist() == ["ball", of_touches, "pen"]


def test_labels_of_touches_or_beside_them_teach_the_same():
    touches = drawn(0, n_each=5)
    from_labels = ObjectRecogniser("corradi2015").fit(
        touches.without("object"), touches.object
    )
    from_touches = ObjectRecogniser("corradi2015").fit([touches[:8], touches[8:]])
    assert_array_equal(from_labels.predict(drawn(1)), from_touches.predict(drawn(1)))
    assert_array_equal(from_labels.memory_.objects, from_touches.memory_.objects)
    kinds = np.where(touches.object == "pen", "tool", "thing")
    labelled = touches.with_columns(category=kinds)
    learnt = ObjectRecogniser("corradi2015", label="category").fit(labelled)
    assert learnt.classes_.tolist() == ["thing", "tool"]
    assert_array_equal(learnt.memory_.objects, touches.object)
    from_kinds = ObjectRecogniser("corradi2015", label="category").fit(touches, kinds)
    assert from_kinds.classes_.tolist() == ["thing", "tool"]
