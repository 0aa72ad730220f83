"""Putting sets of touches after one another."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.touches import TouchesError


def make(n=2, *, dtype=np.uint8, size=(3, 3), **columns):
    images = np.arange(n * size[0] * size[1]).reshape(n, *size).astype(dtype)
    return Touches(images, **columns)


def test_parts_of_a_set_make_the_set_again(rng):
    whole = Touches(
        rng.normal(size=(7, 3, 4)),
        object=list("aabbccc"),
        force_n=rng.normal(size=7),
        no_contact=np.array([[np.nan, 1, 2, 3]] * 3),
        geometry="plane",
        calibration=np.arange(3),
    )
    joined = Touches.concatenate([whole[:3], whole[3:4], whole[4:]])
    assert repr(joined) == repr(whole)
    assert_array_equal(joined.images, whole.images)
    assert_array_equal(joined.columns["force_n"], whole.columns["force_n"])
    assert_array_equal(joined.whole["calibration"], np.arange(3))


def test_longer_labels_are_not_cut():
    joined = Touches.concatenate([make(object=["a"] * 2), make(object=["longer"] * 2)])
    assert joined.object.tolist() == ["a", "a", "longer", "longer"]


def test_a_whole_set_entry_stays_one_where_it_is_as_long_as_the_set():
    parts = [make(1, calibration=[5, 6]), make(1, calibration=[5, 6])]
    joined = Touches.concatenate(parts)
    assert "calibration" in joined.whole
    assert "calibration" not in joined.columns


@pytest.mark.parametrize(
    ("one", "other", "message"),
    [
        ({}, {"size": (3, 4)}, "3 x 3 taxels like set 0, got 3 x 4 taxels in set 1"),
        ({}, {"dtype": np.uint16}, "uint8 like set 0, got uint16 in set 1"),
        (
            {"object": ["a", "b"]},
            {},
            r"column 'object' must be in every set.*none in set 1. Add it with touc",
        ),
        ({}, {"force_n": [1, 2]}, r"'force_n'.*none in set 0.*without\('force_n'\)"),
        (
            {"session": [1, 2]},
            {"session": ["a", "b"]},
            "column 'session' must be alike in every set, got <U1 in set 1 after int64",
        ),
        (
            {"position_mm": [[1, 2], [3, 4]]},
            {"position_mm": [[1, 2, 3], [4, 5, 6]]},
            "got 3 int64 a row in set 1 after 2 int64 a row",
        ),
        (
            {"no_contact": np.zeros((3, 3))},
            {"no_contact": np.ones((3, 3))},
            r"no_contact must be the same.*another one.*without\('no_contact'\)",
        ),
        ({"no_contact": np.zeros((3, 3))}, {}, "no_contact .* got none in set 1"),
        ({}, {"geometry": "dome"}, "geometry must be the same .* got none in set 0"),
        ({"geometry": "dome"}, {"geometry": "array"}, "got another one in set 1"),
        ({"set_x": 1}, {"set_x": "1"}, "set_x must be the same"),
    ],
)
def test_sets_that_do_not_fit_are_refused(one, other, message):
    with pytest.raises(TouchesError, match=message):
        Touches.concatenate([make(**one), make(**other)])


def test_nothing_and_no_touches_are_refused():
    with pytest.raises(TouchesError, match="got an empty list"):
        Touches.concatenate([])
    with pytest.raises(TypeError, match="must be given Touches, got ndarray"):
        Touches.concatenate([np.zeros((2, 3, 3))])
