"""A set of touches: what it takes, gives back and refuses; sets joined."""

import pickle
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import ObjectRecogniser, Touches
from palpate.images import ChannelMean
from palpate.touches import TouchesError

from .conftest import assert_same


@pytest.fixture
def six(rng):
    """Six touches of two objects in two sessions, interleaved."""
    return Touches(
        rng.integers(0, 255, size=(6, 4, 5), dtype=np.uint8),
        object=["cup", "ball", "cup", "cup", "ball", "cup"],
        category=["mug", "toy", "mug", "mug", "toy", "mug"],
        session=[1, 1, 1, 2, 1, 2],
        order=np.arange(6, dtype=np.int16),
        position_mm=rng.normal(size=(6, 3)),
        no_contact=np.full((4, 5), 100, dtype=np.uint8),
        geometry="dome",
        set_sensor="BathTip",
        calibration=np.arange(9.0),
    )


def test_columns_and_whole_set_are_told_apart(six):
    assert list(six.columns) == [
        "object", "category", "session", "order", "position_mm",
    ]  # fmt: skip
    assert set(six.whole) == {"no_contact", "geometry", "set_sensor", "calibration"}
    assert len(six) == 6
    assert six.geometry == "dome"
    assert six.order.dtype == np.int16


def test_absent_things_are_none():
    bare = Touches(np.zeros((1, 2, 2)), object=None, session=None)
    assert (bare.object, bare.category, bare.order, bare.session) == (None,) * 4
    assert (bare.no_contact, bare.geometry) == (None, None)
    assert not bare.columns


@pytest.mark.parametrize(
    "dtype", ["u1", "i2", ">u2", "i8", "u8", "f2", "f4", "f8", ">f4"]
)
def test_any_integer_or_float_is_kept_as_it_is(dtype):
    images = np.array([[[0, 1], [100, 2]]]).astype(dtype)
    kept = Touches(images).images
    assert kept.dtype == images.dtype
    assert kept.tobytes() == images.tobytes()


def test_integer_labels_become_text():
    touches = Touches(np.zeros((3, 2, 2)), object=[7, 7, 12], category=[b"a"] * 3)
    assert touches.object.tolist() == ["7", "7", "12"]
    assert touches.category.tolist() == ["a"] * 3


@pytest.mark.parametrize("kind", [np.dtypes.StringDType(), object])  # of pandas
def test_variable_width_text_becomes_plain_text(kind):
    names = np.array(["cup", "a long name"], dtype=kind)
    touches = Touches(np.zeros((2, 2, 2)), object=names)
    assert touches.object.dtype == np.dtype("<U11")


def test_arrays_are_read_only_and_the_callers_own_is_left_alone():
    images = np.zeros((2, 3, 3))
    touches = Touches(images, force_n=[1.0, 2.0])
    sent = pickle.loads(pickle.dumps(touches))
    for part in (touches, touches[:1], touches[[1, 0]], sent):
        for array in (part.images, part.columns["force_n"]):
            with pytest.raises(ValueError, match="read-only"):
                array[:] = 1
        with pytest.raises(TypeError):
            part.columns["force_n"] = 0
    assert images.flags.writeable
    with pytest.raises(AttributeError):
        touches.images = images


@pytest.mark.parametrize(
    ("images", "message"),
    [
        (np.zeros((0, 3, 3)), "at least one touch of at least one taxel"),
        (np.zeros((2, 0, 3)), "at least one touch of at least one taxel"),
        (np.zeros((3, 3)), r"\(3, 3\)\. For one touch .*\[np.newaxis\]; for vectors"),
        (np.zeros((1, 3, 3, 3, 3)), r"shape \(n_touches, n_rows, n_cols\)"),
        (np.zeros((1, 2, 2), dtype=complex), "integers or floats, got complex128"),
        (np.full((1, 2, 2), "x"), "integers or floats, got <U1"),
        (np.full((1, 2, 2), None), "plain numbers or text, got an array of object"),
        ([[[1, 2], [3]]], "one array, got rows of unequal length"),
        (np.array([[[0.0]], [[np.inf]]]), "infinity in touch 1"),
        (np.array([[[0.0]], [[1]], [[-np.inf]]], dtype="f2"), "infinity in touch 2"),
    ],
)
def test_bad_images_are_refused(images, message):
    with pytest.raises(TouchesError, match=message):
        Touches(images)


def test_touches_along_the_last_axis_are_told():
    with pytest.raises(TouchesError, match=r"np\.moveaxis\(images, -1, 0\)"):
        Touches(np.zeros((8, 6, 3)), object=["mug", "pen", "cup"])


def test_frames_of_presses_are_no_channels():
    with pytest.raises(TouchesError, match="give one of each press, and all as `press"):
        Touches(np.zeros((2, 20, 8, 6)))


def test_infinity_is_found_beyond_the_first_block():
    images = np.zeros((5, 1500, 1500), dtype=np.float16)
    images[4, 3, 3] = np.inf
    with pytest.raises(TouchesError, match="infinity in touch 4"):
        Touches(images)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"object": ["a"]}, "object must have one row per touch, got 1 rows for 2"),
        ({"order": [1, 2, 3]}, "order must have one row per touch, got 3 rows for 2"),
        ({"force_n": 1.0}, "force_n must have one row per touch, got a single value"),
        ({"object": ["a", ""]}, "empty label at touch 1"),
        ({"object": [" ", "b"]}, "empty label at touch 0"),
        ({"category": ["a", ""]}, "Column category must not be empty"),
        ({"object": [1.0, np.nan]}, "got an array of float64, NaN at touch 1. Fill in"),
        ({"object": ["a", np.nan]}, "object must be .* got NaN among texts at 1"),
        ({"category": (float("nan"), "a")}, "category must be .*NaN among texts at 0"),
        ({"session": ["a", np.nan]}, "session must be text or numbers, got NaN among"),
        ({"object": [1.0, 2.0]}, "text or integers, got an array of float64"),
        ({"object": [True, False]}, "text or integers, got an array of bool"),
        ({"object": [["a"], ["b"]]}, "one value per touch, got shape"),
        ({"object": [[0, 1], [1, 0]]}, r"zeros give object\.argmax\(axis=1\)"),
        ({"object": ["a", None]}, "object must hold plain numbers or text.* Fill in"),
        ({"object": [b"a", b"\xff"]}, "object must be UTF-8 text"),
        ({"object": ["a", "b\n"]}, "Leave out line breaks"),
        ({"object": ["a", "\udcd6se"]}, "no UTF-8, .*rename it, or.* PYTHONUTF8=1"),
        ({"session": [[1, 2], [3, 4]]}, r"session\[:, 0\]"),
        ({"time_s": np.zeros(2, "M8[ns]")}, "time_s must be numbers.* Write seconds"),
        ({"position_mm": [["a"], ["b"]]}, "position_mm must be numbers, got .*<U1"),
        ({"mine": [{}, {}]}, "mine must hold plain numbers or text"),
        ({"geometry": "sphere"}, "geometry must be one of 'dome', 'array', 'plane'"),
        ({"geometry": ["dome", "dome"]}, "geometry must be one of"),
        ({"no_contact": np.zeros((3, 2))}, "one image of 2 x 2 taxels"),
        ({"no_contact": np.zeros((2, 2, 2))}, r"got shape \(2, 2, 2\)"),
        ({"no_contact": [[np.inf, 0], [0, 0]]}, "no_contact must not be infinite"),
        ({"no_contact": [["a", "b"], ["c", "d"]]}, "no_contact must be integers or"),
    ],
)
def test_bad_columns_are_refused(columns, message):
    with pytest.raises(TouchesError, match=message):
        Touches(np.zeros((2, 2, 2)), **columns)


def test_a_name_of_the_whole_set_stays_there_even_if_as_long_as_the_set():
    touches = Touches(np.zeros((2, 2, 2)), frame_index=[300, 320], set_gain=[1, 2])
    assert set(touches.whole) == {"frame_index", "set_gain"}
    assert not touches.columns


def test_a_column_may_have_any_name():
    names = {"self": [1, 2], "a/b": [3, 4], "..": [5, 6], "cls": [7, 8]}
    assert dict(Touches(np.zeros((2, 2, 2)), **names).columns).keys() == names.keys()


@pytest.mark.parametrize(
    ("index", "rows"),
    [
        (0, [0]),
        (-1, [5]),
        (np.int8(2), [2]),
        (slice(1, 4), [1, 2, 3]),
        (slice(None, None, -2), [5, 3, 1]),
        ([3, 0, 3], [3, 0, 3]),
        ([-1], [5]),
        (np.array([True, False, False, True, False, False]), [0, 3]),
    ],
)
def test_picking_keeps_rows_together(six, index, rows):
    picked = six[index]
    assert picked.order.tolist() == rows
    assert_array_equal(picked.images, six.images[rows])
    assert picked.object.tolist() == six.object[rows].tolist()
    assert picked.whole.keys() == six.whole.keys()


@pytest.mark.parametrize(
    ("index", "error", "message"),
    [
        ("object", TypeError, r"columns\[name\]"),
        ((1, 2), TypeError, "picked by number, slice, mask"),
        (True, TypeError, "picked by number"),
        (1.0, TypeError, "picked by number"),
        ([[0, 1]], TypeError, "picked by number"),
        (6, IndexError, "touch 6 is out of range: there are 6"),
        (-7, IndexError, "touch -7 is out of range"),
        ([0, 6], IndexError, "out of bounds"),
        ([True, False], IndexError, "one value per touch"),
        (slice(4, 4), TouchesError, "at least one of 6 touches"),
        ([], TouchesError, "at least one of 6 touches"),
        (np.zeros(6, dtype=bool), TouchesError, "at least one of 6 touches"),
    ],
)
def test_bad_picks_are_refused(six, index, error, message):
    with pytest.raises(error, match=message):
        six[index]


def test_iteration_gives_one_touch_at_a_time(six):
    assert [touch.order[0] for touch in six] == list(range(6))
    assert [len(touch) for touch in six] == [1] * 6


@pytest.mark.parametrize(
    ("dtype", "expected"),
    [("u1", "f4"), ("u2", "f4"), ("i4", "f8"), ("f4", "f4"), ("f8", "f8")],
)
def test_differences_are_signed_floats_that_hold_the_images(dtype, expected):
    images, no_contact = np.array([[[90, 255]]], dtype), np.array([[100, 0]], dtype)
    differences = Touches(images, no_contact=no_contact).differences()
    assert differences.dtype == np.dtype(expected)
    assert differences.tolist() == [[[-10.0, 255.0]]]


def test_dead_taxels_stay_dead_in_differences():
    touches = Touches([[[np.nan, 2.0]]], no_contact=[[1.0, np.nan]])
    assert np.isnan(touches.differences()).all()


def test_differences_without_no_contact_say_how_to_give_it():
    with pytest.raises(TouchesError, match=r"with_columns\(no_contact=image\)"):
        Touches(np.zeros((1, 2, 2))).differences()


@pytest.mark.parametrize(
    ("labels", "episodes"),
    [
        (
            {"object": ["cup", "ball", "cup", "cup"], "session": [1, 1, 1, 2]},
            [("cup", 1, [0, 2]), ("ball", 1, [1]), ("cup", 2, [3])],
        ),
        (
            {"object": [*"abc"] * 2, "session": [1, 1, 1, 2, 2, 2]},
            [(n, s, [row]) for row, (s, n) in enumerate(product((1, 2), "abc"))],
        ),
        (
            {"object": np.repeat([*"abc"], 3), "session": [1, 2, 3] * 3},
            [(n, s, [row]) for row, (n, s) in enumerate(product("abc", (1, 2, 3)))],
        ),
        ({"press": [0, 1, 2]}, [(None, None, [0, 1, 2])]),
        ({"session": ["b", "a", "b"]}, [(None, "b", [0, 2]), (None, "a", [1])]),
    ],
    ids=["interleaved", "more objects", "all pairs", "no labels", "sessions alone"],
)
def test_episodes_are_one_per_object_and_session_in_their_order(labels, episodes):
    n_touches = sum(len(rows) for *_, rows in episodes)
    touches = Touches(np.zeros((n_touches, 2, 2)), **labels)
    result = [(e.object, e.session, e.rows.tolist()) for e in touches.episodes()]
    assert result == episodes


def test_with_columns_adds_replaces_and_moves(six):
    more = six.with_columns(force_n=np.ones(6), object=["x"] * 6, geometry="array")
    assert set(more.object) == {"x"}
    assert more.geometry == "array"
    assert six.geometry == "dome"
    assert "force_n" not in six.columns
    moved = six.with_columns(calibration=np.arange(6))
    assert "calibration" in moved.columns
    assert "calibration" not in moved.whole


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"mine": [1, 2]}, "mine must have one row per touch, got 2 rows for 6"),
        ({"images": np.zeros((6, 2, 2))}, "Build Touches"),
        ({"object": None}, "object must hold plain numbers or text"),
    ],
)
def test_bad_added_columns_are_refused(six, columns, message):
    with pytest.raises(TouchesError, match=message):
        six.with_columns(**columns)


def test_without_drops_columns_and_whole_entries(six):
    less = six.without("object", "calibration")
    assert less.object is None
    assert "calibration" not in less.whole
    with pytest.raises(TouchesError, match=r"category, session.*got 'colour'"):
        six.without("colour")


def test_the_same_set_with_other_images(six):
    halves = Touches(six.images / 2, **six.columns, **six.whole)
    assert halves.columns.keys() == six.columns.keys()
    assert halves.images.dtype == np.float64


def test_pickle_keeps_everything(six):
    assert_same(pickle.loads(pickle.dumps(six)), six)


def masked_images(dtype):
    """Four images of 3 x 3, two taxels of the second masked."""
    images = np.ma.masked_array(np.arange(36, dtype=dtype).reshape(4, 3, 3))
    images[1, 0, :2] = np.ma.masked
    return images


def test_what_is_masked_is_a_dead_taxel():
    touches = Touches(masked_images(float))
    assert np.isnan(touches.images).sum() == 2
    assert np.isnan(touches.images[1, 0, :2]).all()
    column = np.ma.masked_array([1.0, 2.0, 3.0, 4.0], [False, True, False, False])
    assert np.isnan(Touches(touches.images, force_n=column).columns["force_n"][1])


def test_masked_whole_numbers_are_refused_and_the_fix_is_named():
    with pytest.raises(TouchesError, match=r"images .*masked.*int64, got 2.*\.astype"):
        Touches(masked_images(np.int64))
    with pytest.raises(ValueError, match=r"images .*masked.*uint8, got 2.*\.filled"):
        ChannelMean().fit(masked_images(np.uint8))
    with pytest.raises(ValueError, match="X must have no masked"):
        ObjectRecogniser().fit(masked_images(int).reshape(4, 9), list("aabb"))
    whole = np.ma.masked_array(np.ones((2, 3, 3), int))
    assert Touches(whole).images.sum() == 18  # nothing is masked


def test_masked_images_are_recognised_as_images_with_nan(rng):
    images = rng.random((12, 4, 4))
    images[6:] += 3 * np.eye(4)
    recogniser = ObjectRecogniser("liu2014").fit(images, ["a"] * 6 + ["b"] * 6)
    hidden = images[:1].copy()
    hidden[0, 0, 0] = np.nan
    masked = np.ma.masked_array(images[:1], np.isnan(hidden))
    masked.data[0, 0, 0] = 1e6  # what lies behind a mask must not count
    assert_array_equal(
        recogniser.log_likelihood(masked), recogniser.log_likelihood(hidden)
    )


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
    assert_same(Touches.concatenate([whole[:3], whole[3:4], whole[4:]]), whole)


def test_longer_labels_are_not_cut():
    joined = Touches.concatenate([make(object=["a"] * 2), make(object=["longer"] * 2)])
    assert joined.object.tolist() == ["a", "a", "longer", "longer"]


def test_a_whole_set_entry_stays_one_where_it_is_as_long_as_the_set():
    parts = [make(1, calibration=[5, 6]), make(1, calibration=[5, 6])]
    joined = Touches.concatenate(parts)
    assert "calibration" in joined.whole
    assert "calibration" not in joined.columns


@pytest.mark.parametrize(
    ("first", "second", "message"),
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
            r"no_contact must be the same.*without\('no_contact'\).* join .*differ",
        ),
        ({"no_contact": np.zeros((3, 3))}, {}, "no_contact .* got none in set 1"),
        ({}, {"geometry": "dome"}, "geometry must be in every set, got none in set 0"),
        ({"geometry": "dome"}, {"geometry": "array"}, "got another one in set 1"),
        ({"set_x": 1}, {"set_x": "1"}, "set_x must be the same"),
    ],
)
def test_sets_that_do_not_fit_are_refused(first, second, message):
    with pytest.raises(TouchesError, match=message):
        Touches.concatenate([make(**first), make(**second)])


def test_nothing_and_no_touches_are_refused():
    with pytest.raises(TouchesError, match="got an empty list"):
        Touches.concatenate([])
    with pytest.raises(TypeError, match="must be given Touches, got ndarray"):
        Touches.concatenate([np.zeros((2, 3, 3))])
