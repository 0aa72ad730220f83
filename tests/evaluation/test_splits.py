"""Splits: which touches train and which test."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.evaluation import draw_touches, split_by_count, split_touches
from palpate.evaluation._splits import PROTOCOLS


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


def test_between_tests_every_fourth_in_order(recordings):
    (fold,) = split_touches(recordings, "between")
    assert sorted(fold.test.order.tolist()) == [3] * 4 + [7] * 4
    assert len(fold.train) == 24


def test_last_tests_the_last_quarter_in_order(recordings):
    (fold,) = split_touches(recordings, "last")
    assert sorted(fold.test.order.tolist()) == [6] * 4 + [7] * 4


def test_without_an_order_the_archive_order_counts(recordings):
    (fold,) = split_touches(recordings.without("order"), "last")
    assert_array_equal(fold.test.images[:2, 0, 0], [6, 7])


def test_unseen_objects_leave_one_of_each_category_out(recordings):
    folds = split_touches(recordings, "unseen-objects")
    assert [sorted(set(f.test.object)) for f in folds] == [
        ["mug_a", "pen_a"],
        ["mug_b", "pen_b"],
    ]
    for fold in folds:
        assert not set(fold.test.object) & set(fold.train.object)


def test_a_category_of_one_object_only_trains(recordings):
    fewer = recordings[recordings.object != "pen_b"]
    folds = split_touches(fewer, "unseen-objects")
    assert [sorted(set(f.test.object)) for f in folds] == [["mug_a"], ["mug_b"]]


def test_drawn_touches(recordings):
    few = draw_touches(recordings, 3, seed=1)
    assert np.unique(few.object, return_counts=True)[1].tolist() == [3] * 4
    assert_array_equal(few.images, draw_touches(recordings, 3, seed=1).images)
    train, test = split_by_count(recordings, 6, seed=0)
    together = np.r_[train.images[:, 0, 0], test.images[:, 0, 0]]
    assert sorted(together) == list(range(32))


@pytest.mark.parametrize(
    ("change", "split", "message"),
    [
        (lambda t: t, "half", "'unseen-objects', 'session', 'subject', got 'half'"),
        (lambda t: t.without("object", "category"), "last", "column 'object'"),
        (lambda t: t.without("category"), "unseen-objects", "column 'category'"),
        (lambda t: t[:3], "last", "at least 4 touches to be split, got 3"),
        (lambda t: t[:8], "unseen-objects", "at least two objects"),
    ],
)
def test_what_cannot_be_split_is_refused(recordings, change, split, message):
    with pytest.raises(ValueError, match=message):
        split_touches(change(recordings), split)


@pytest.mark.parametrize(("n_people", "n_folds"), [(20, 20), (21, 20), (45, 20)])
def test_more_than_twenty_people_are_asked_several_at_a_time(n_people, n_folds):
    people = np.repeat([f"p{n:02d}" for n in range(n_people)], 2)
    touches = Touches(
        np.arange(2.0 * n_people)[:, None, None] * np.ones((1, 3, 3)),
        object=np.tile(["a", "b"], n_people),
        subject=people,
    )
    folds = split_touches(touches, "subject")
    assert len(folds) == n_folds
    asked = [set(fold.test.subject.tolist()) for fold in folds]
    assert sorted(name for some in asked for name in some) == sorted({*people.tolist()})
    for fold, some in zip(folds, asked, strict=True):
        assert not some & {*fold.train.subject.tolist()}
        assert len(some) in (n_people // n_folds, n_people // n_folds + 1)


def test_two_touches_of_each_may_be_drawn_and_one_may_not(recordings):
    assert len(draw_touches(recordings, 2, seed=0)) == 8
    with pytest.raises(ValueError, match="train_touches must be at least 2, got 1"):
        draw_touches(recordings, 1, seed=0)
    with pytest.raises(ValueError, match="must leave touches to test, got 8"):
        split_by_count(recordings, 8, seed=0)


def test_what_one_session_has_once_or_not_is_left_out_of_that_split():
    touches = Touches(
        np.arange(12.0)[:, None, None] * np.ones((1, 3, 3)),
        object=["a", "a", "b", "b", "c", "e", "a", "a", "b", "b", "d", "e"],
        session=["mon"] * 6 + ["tue"] * 6,
    )
    folds = split_touches(touches, "session")
    assert len(folds) == 2
    for fold in folds:
        assert sorted({*fold.test.object.tolist()}) == ["a", "b"]
        assert set(fold.left_out) == {"c", "d", "e"}


def test_a_recording_of_one_press_teaches_and_is_never_drawn():
    touches = Touches(
        np.arange(21.0)[:, None, None] * np.ones((1, 3, 3)),
        object=["a"] * 10 + ["b"] * 10 + ["c"],
    )
    drawn = [asked for _, asked in PROTOCOLS["random"](touches, 8, 0)]
    assert len(drawn) == 8
    for asked in drawn:
        assert not asked[-1]
        # A fifth of ten presses of each.
        assert (asked[:10].sum(), asked[10:20].sum()) == (2, 2)


def test_a_session_that_teaches_one_object_alone_asks_nobody():
    touches = Touches(
        np.arange(6.0)[:, None, None] * np.ones((1, 3, 3)),
        object=["a", "a", "a", "a", "b", "b"],
        session=["mon", "mon", "tue", "tue", "tue", "tue"],
    )
    (fold,) = split_touches(touches, "session")
    assert {*fold.test.session.tolist()} == {"mon"}


@pytest.mark.parametrize("name", ["order", "time_s"])
def test_touches_are_split_in_the_order_in_which_they_were_made(name):
    images = np.arange(8.0).reshape(8, 1, 1)
    places = np.array([4, 5, 6, 7, 0, 1, 2, 3])
    touches = Touches(images, object=["mug"] * 8, **{name: places})
    (fold,) = split_touches(touches, "last")
    assert sorted(fold.test.columns[name]) == [6, 7]
