"""Splits: which touches train and which test."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.evaluation import split_by_count, split_touches
from palpate.evaluation._splits import PROTOCOLS, protocol_folds


@pytest.fixture
def recordings():
    """Two categories of two objects, 8 touches each, stored in reverse order."""
    objects = np.repeat(["mug_a", "mug_b", "pen_a", "pen_b"], 8)
    return Touches(
        np.arange(32.0)[:, None, None] * np.ones((1, 3, 3)),
        object=objects,
        category=np.array([name[:3] for name in objects]),
        order=np.tile(np.arange(8)[::-1], 4),
    )


@pytest.mark.parametrize(("split", "places"), [("between", [3, 7]), ("last", [6, 7])])
@pytest.mark.parametrize("name", ["order", "time_s"])
def test_a_quarter_of_each_object_is_tested_in_order(recordings, split, places, name):
    touches = recordings.without("order").with_columns(**{name: recordings.order})
    (fold,) = split_touches(touches, split)
    assert sorted(fold.test.columns[name]) == np.repeat(places, 4).tolist()
    assert len(fold.train) == 24


def test_without_an_order_or_all_times_the_archive_order_counts(recordings):
    unordered = recordings.without("order")
    times = np.where(recordings.order < 7, recordings.order, np.nan)
    for touches in (unordered, unordered.with_columns(time_s=times)):
        (fold,) = split_touches(touches, "last")
        assert_array_equal(fold.test.images[:2, 0, 0], [6, 7])


def test_unseen_objects_leave_one_of_each_category_out(recordings):
    folds = split_touches(recordings, "unseen-objects")
    assert [sorted(set(f.test.object)) for f in folds] == [
        ["mug_a", "pen_a"],
        ["mug_b", "pen_b"],
    ]
    for fold in folds:
        assert not set(fold.test.object) & set(fold.train.object)
    # A category of one object only trains.
    fewer = recordings[recordings.object != "pen_b"]
    folds = split_touches(fewer, "unseen-objects")
    assert [sorted(set(f.test.object)) for f in folds] == [["mug_a"], ["mug_b"]]
    assert [fold.left_out for fold in folds] == [("pen_a",)] * 2


def test_as_many_touches_of_each_object_are_drawn_as_asked_for(recordings):
    train, test = split_by_count(recordings, 6, seed=0)
    assert np.unique(train.object, return_counts=True)[1].tolist() == [6] * 4
    together = np.r_[train.images[:, 0, 0], test.images[:, 0, 0]]
    assert sorted(together) == list(range(32))
    # Which ones depends on the seed; they keep their order.
    first, again, second = (
        split_by_count(recordings, 4, seed)[0].images[:, 0, 0] for seed in (0, 0, 1)
    )
    assert (np.diff(first) > 0).all()
    assert first.tolist() == again.tolist() != second.tolist()
    assert len(split_by_count(recordings, 2, seed=0)[0]) == 8
    for n_train, message in (
        (1, "train_touches must be at least 2, got 1"),
        (8, "must leave touches to test, got 8"),
    ):
        with pytest.raises(ValueError, match=message):
            split_by_count(recordings, n_train, seed=0)


@pytest.mark.parametrize(
    ("change", "split", "message"),
    [
        (lambda t: t, "half", "'unseen-objects', 'session', 'subject', got 'half'"),
        (lambda t: t.without("object", "category"), "last", "column 'object'"),
        (lambda t: t.without("category"), "unseen-objects", "column 'category'"),
        (lambda t: t[:3], "last", "at least 4 touches to be split, got 3"),
        (lambda t: t[:8], "unseen-objects", "at least two objects"),
        (
            lambda t: t.with_columns(object=[name[4:] for name in t.object]),
            "unseen-objects",
            "one category each, got 'a' of mug, pen",
        ),
        (lambda t: t, "subject", "must have a column 'subject'"),
    ],
)
def test_touches_that_cannot_be_split_are_refused(recordings, change, split, message):
    with pytest.raises(ValueError, match=message):
        split_touches(change(recordings), split)


@pytest.mark.parametrize(("n_people", "n_folds"), [(20, 20), (21, 20), (45, 20)])
def test_more_than_twenty_people_are_tested_several_at_a_time(n_people, n_folds):
    people = np.repeat([f"p{n:02d}" for n in range(n_people)], 2)
    touches = Touches(
        np.arange(2.0 * n_people)[:, None, None] * np.ones((1, 3, 3)),
        object=np.tile(["a", "b"], n_people),
        subject=people,
    )
    folds = split_touches(touches, "subject")
    assert len(folds) == n_folds
    tested = [set(fold.test.subject.tolist()) for fold in folds]
    assert sorted(name for group in tested for name in group) == sorted(
        {*people.tolist()}
    )
    for fold, group in zip(folds, tested, strict=True):
        assert not group & {*fold.train.subject.tolist()}
        assert len(group) in (n_people // n_folds, n_people // n_folds + 1)


def row_of(n_touches, **columns):
    """Touches that hold nothing but their columns."""
    return Touches(np.zeros((n_touches, 1, 1)), **columns)


def test_folds_are_named_by_number_session_or_split(recordings):
    folds = split_touches(recordings, "unseen-objects")
    assert [fold.name for fold in folds] == ["fold 1 of 2", "fold 2 of 2"]
    assert [name for name, _ in PROTOCOLS["blocks"](recordings, 1, 0)] == [
        f"run {number} of 5" for number in (1, 2, 3, 4, 5)
    ]
    drawn = [name for name, _ in PROTOCOLS["random"](recordings, 2, 0)]
    assert drawn == ["draw 1 of 2", "draw 2 of 2"]
    assert [name for name, _ in PROTOCOLS["halves"](recordings, 1, 0)] == [
        "second half"
    ]
    assert set(PROTOCOLS) >= {"subjects", "sessions", "categories"}
    visits = recordings.with_columns(session=np.tile(["mon", "tue"], 16))
    names = [fold.name for fold in split_touches(visits, "session")]
    assert names == ["session mon", "session tue"]
    assert [fold.name for fold in split_touches(recordings, "last")] == ["last"]


def test_blocks_and_halves_are_neighbours_in_each_recording():
    """Of ten touches in each of two recordings, two are in a run, five in a half."""
    order = np.tile(np.arange(10)[::-1], 2)
    for recordings in (
        {"object": ["a"] * 10 + ["b"] * 10},
        {"object": ["a"] * 20, "session": ["mon"] * 10 + ["tue"] * 10},
    ):
        touches = row_of(20, **recordings, order=order)
        tested = [
            sorted(order[is_test]) for _, is_test in PROTOCOLS["blocks"](touches, 1, 0)
        ]
        assert tested == [[k, k, k + 1, k + 1] for k in range(0, 10, 2)]
        ((_, half),) = PROTOCOLS["halves"](touches, 1, 0)
        assert half.tolist() == ([True] * 5 + [False] * 5) * 2
    odd = row_of(3, object=["a"] * 3)
    ((_, half),) = PROTOCOLS["halves"](odd, 1, 0)
    assert half.tolist() == [False, False, True]


@pytest.mark.parametrize(
    ("n_touches", "n_tested"),
    [(1, 0), (2, 1), (4, 1), (7, 1), (8, 2), (12, 2), (13, 3)],
)
def test_a_fifth_is_drawn_and_at_least_one_touch_of_two(n_touches, n_tested):
    touches = row_of(n_touches + 10, object=["a"] * n_touches + ["b"] * 10)
    drawn = [is_test for _, is_test in PROTOCOLS["random"](touches, 8, 0)]
    assert len(drawn) == 8
    for is_test in drawn:
        assert is_test[:n_touches].sum() == n_tested
        assert is_test[n_touches:].sum() == 2


@pytest.mark.parametrize("name", ["press", "episode", "squeeze", "idle_of"])
def test_touches_of_one_press_stay_on_one_side(name):
    presses = np.repeat(np.arange(10), 3)
    touches = row_of(30, object=["a"] * 30, **{name: presses})
    for protocol in ("blocks", "halves", "random"):
        for _, is_test in PROTOCOLS[protocol](touches, 3, 1):
            sides = [set(is_test[presses == press].tolist()) for press in range(10)]
            assert all(len(side) == 1 for side in sides)
            assert is_test.any()
    # What is of no press is taught or asked by itself.
    ((_, half),) = PROTOCOLS["halves"](row_of(4, press=[np.nan] * 4), 1, 0)
    assert half.tolist() == [False, False, True, True]


def test_the_same_seed_draws_the_same_folds():
    touches = row_of(60, object=["a"] * 20 + ["b"] * 20 + ["c"] * 20)
    first, again = (
        protocol_folds(touches, "random", "object", 2, 0)[0] for _ in range(2)
    )
    assert all((a.test == b.test).all() for a, b in zip(first, again, strict=True))
    assert len(first[0].test) == 12  # a fifth of each
    assert (first[0].test != first[1].test).any()


def test_two_touches_of_a_label_teach_it_and_one_does_not():
    touches = row_of(
        9,
        object=["a", "a", "b", "b", "c", "a", "b", "c", "c"],
        session=["mon"] * 5 + ["tue"] * 4,
    )
    (fold,) = split_touches(touches.with_columns(order=np.arange(9)), "session")
    # On Tuesday only c was taught twice: nothing to tell it from.
    assert fold.name == "session tue"
    assert fold.train.order.tolist() == [0, 1, 2, 3]
    assert fold.test.order.tolist() == [5, 6]
    assert fold.left_out == ("c",)


def test_sessions_that_share_no_two_labels_are_refused():
    touches = row_of(
        4, object=["a", "a", "b", "b"], session=["mon", "mon", "tue", "tue"]
    )
    with pytest.raises(ValueError, match="must find two object labels"):
        split_touches(touches, "session")
    with pytest.raises(ValueError, match=r"values of 'session', got 1\. .* split or"):
        split_touches(touches.with_columns(session=["mon"] * 4), "session")


@pytest.mark.parametrize(("n_touches", "n_tested"), [(4, 1), (7, 1), (8, 2)])
def test_a_quarter_is_tested_rounded_down(n_touches, n_tested):
    touches = row_of(n_touches, object=["a"] * n_touches)
    for split in ("last", "between"):
        (fold,) = split_touches(touches, split)
        assert len(fold.test) == n_tested


def test_touches_of_one_level_are_no_copies_of_each_other(rng):
    """Arrays that show zeros where nothing touches them: nothing was taught by that."""
    images = rng.normal(size=(10, 3, 3))
    images[[0, 4]], images[:, 0, 0] = 0, np.nan
    images[-1] = images[1]
    touches = Touches(images, object=["a"] * 5 + ["b"] * 5)
    (fold,) = split_touches(touches, "last")
    assert fold.n_taught == 1
