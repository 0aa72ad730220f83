"""Splits: which touches train and which test."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.evaluation import draw_touches, split_by_count, split_touches


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


@pytest.mark.parametrize("name", ["order", "time_s"])
def test_touches_are_split_in_the_order_in_which_they_were_made(name):
    images = np.arange(8.0).reshape(8, 1, 1)
    places = np.array([4, 5, 6, 7, 0, 1, 2, 3])
    touches = Touches(images, object=["mug"] * 8, **{name: places})
    (fold,) = split_touches(touches, "last")
    assert sorted(fold.test.columns[name]) == [6, 7]
