"""Very many objects: files, sessions and changes where only a part is left out."""

import re
from copy import copy
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate import ObjectRecogniser, Touches
from palpate.classifiers import EncodingPool


def drawn(n_objects, n_each, seed=0, shift=0.0, session="monday"):
    """Touches of objects about a mean each; a session shifts all of them."""
    centres = np.random.default_rng(99).normal(size=(n_objects, 3, 8))
    rng = np.random.default_rng(seed)
    images = np.repeat(centres, n_each, axis=0)
    images = images + 0.3 * rng.normal(size=images.shape) + shift
    names = np.repeat([f"part {k:03d}" for k in range(n_objects)], n_each)
    sessions = np.full(len(names), session)
    return Touches(images, object=names, session=sessions, geometry="none")


@pytest.fixture(scope="module", autouse=True)
def very_many(lower):
    """Lower the limits to a thousand targets and two thousand answers."""
    with pytest.MonkeyPatch.context() as patch:
        lower(patch, targets=1000, answers_left_out=2000)
        yield


@cache
def fitted(n_objects, n_each):
    return ObjectRecogniser().fit(drawn(n_objects, n_each))


def learnt(n_objects, n_each):
    """Return a recogniser that may be changed."""
    return copy(fitted(n_objects, n_each))


KINDS = pytest.mark.parametrize(
    ("n_objects", "n_each"), [(12, 30), (501, 2)], ids=["landmarks", "nearby"]
)


def machine_of(recogniser):
    return next(iter(recogniser.classifier_.machines_.values()))


@KINDS
@pytest.mark.slow
def test_a_file_of_very_many_objects_answers_as_before_it_was_saved(
    tmp_path, n_objects, n_each
):
    model = learnt(n_objects, n_each)
    is_nearby = isinstance(machine_of(model), EncodingPool.MACHINES[1])
    assert is_nearby == (n_objects > 500)
    assert len(model.left_out_rows) < n_objects * n_each
    again = ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))
    test = drawn(n_objects, 1, seed=5)
    before, after = model.evidence(test), again.evidence(test)
    # The file keeps all that the classifier answers from to the bit.
    assert_array_equal(after.log_likelihood, before.log_likelihood)
    # Remembered features are in single precision: logarithms to 1e-3 nats.
    assert_allclose(after.log_distances, before.log_distances, atol=1e-3, rtol=0)
    assert_array_equal(again.memory_.labels, model.memory_.labels)
    assert again.memory_.features.dtype == np.float64
    beliefs = [recogniser.start().update(test[:1]) for recogniser in (model, again)]
    assert beliefs[1].unknown == pytest.approx(beliefs[0].unknown, abs=1e-3)


@pytest.mark.slow
@KINDS
def test_an_object_added_after_loading_is_recognised_as_if_before(
    tmp_path, n_objects, n_each
):
    images = 3 + np.random.default_rng(2).normal(0, 0.3, (n_each + 2, 3, 8))
    new, new_test = np.split(images, [n_each])
    new = Touches(new, geometry="none")
    model = learnt(n_objects, n_each)
    again = ObjectRecogniser.load(model.save(tmp_path / "m.palpate"))
    machine = machine_of(again)
    landmarks = getattr(machine, "touches_", None)
    for recogniser in (model, again):
        recogniser.add_object("part one more", new)
    test = drawn(n_objects, 1, seed=5)
    assert_allclose(
        again.log_likelihood(test), model.log_likelihood(test), atol=1e-3, rtol=0
    )
    if n_objects < 500:  # the sums of the file went on: the same landmarks
        assert_array_equal(machine_of(again).touches_, landmarks)
        assert machine_of(again)._summed is not None
    assert (again.predict(Touches(new_test, geometry="none")) == "part one more").all()


def test_sums_that_do_not_fit_are_refused(tmp_path, monkeypatch):
    model = learnt(12, 30)
    machine = machine_of(model)
    regression = copy(machine._summed)
    regression._by_label = regression._by_label[:, 1:]
    monkeypatch.setattr(machine, "_summed", regression)
    path = model.save(tmp_path / "m.palpate")
    with pytest.raises(ValueError, match="sums of labels have shape"):
        ObjectRecogniser.load(path)


@KINDS
@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.slow
def test_remounting_costs_nothing_where_a_part_is_left_out(n_objects, n_each, labelled):
    model = learnt(n_objects, n_each)
    other = drawn(n_objects, 2, seed=3, shift=0.6, session="tuesday")
    before = model.score(other)
    remount_touches = other if labelled else Touches(other.images, geometry="none")
    model.remount(remount_touches)
    record = model.chosen_["remount"]
    assert record["labelled"] == labelled
    assert model.score(drawn(n_objects, 1, seed=4, shift=0.6)) >= before


@KINDS
def test_nuisance_of_sessions_is_weighed_down_where_a_part_is_left_out(
    n_objects, n_each
):
    model = learnt(n_objects, n_each)
    days = [
        drawn(25, 1, seed=day, shift=0.8 * day, session=f"day {day}") for day in (1, 2)
    ]
    both = Touches.concatenate(days)
    assert model.learn_nuisance(both) >= 20
    assert model.score(drawn(n_objects, 1, seed=7)) > 0.5


def test_objects_beyond_the_memory_are_refused_and_the_remedies_fit(monkeypatch):
    """Learning takes 100 kB an object, 3 kB a touch, and 0.5 GB in any case."""

    def refusal(labels):
        with pytest.raises(ValueError, match="of memory") as refused:
            ObjectRecogniser().fit(np.zeros((len(labels), 1, 2)), labels)
        return str(refused.value)

    names = np.repeat(np.arange(100_000), 2)
    assert re.search(
        r"at most 8 GB of memory, got 100000 labels and 200000 touches, which take up "
        r"to some 11\.1 GB\. Learn categories first \(label='category'\) and the "
        r"objects of each by themselves, .* or raise ObjectRecogniser\.max_memory_gb",
        refusal(names),
    )
    monkeypatch.setattr(ObjectRecogniser, "max_memory_gb", 1e-3)
    for labels in (names // 10_000, names[:20_000]):
        assert float(re.search(r"some ([\d.]+) GB", refusal(labels))[1]) < 8


@pytest.mark.slow
def test_objects_that_alternate_are_all_among_the_touches_looked_at(
    rng, monkeypatch, lower
):
    lower(monkeypatch, touches_looked_at=150)
    # Every second touch is of the same object: an even stride would see that alone.
    images = rng.random((299, 8, 8))
    images[::2, 2:4] += 1
    names = np.resize(["bar", "none"], 299)
    touches = Touches(images, object=names, geometry="array")
    assert ObjectRecogniser().fit(touches).score(touches[:200]) > 0.95
