"""Labels of pictures, by folders and by a pattern for their names."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.touches import TouchesError, png_bytes, read_folder

from .conftest import first_levels


def test_one_level_of_folders_is_the_object(put):
    touches = Touches.load(put("cup/a.png", "ball/a.png", "cup/b.png"))
    assert touches.object.tolist() == ["ball", "cup", "cup"]
    assert touches.category is None
    assert touches.columns["source_path"].tolist() == [
        "ball/a.png", "cup/a.png", "cup/b.png",
    ]  # fmt: skip
    assert first_levels(touches) == [1, 0, 2]
    assert touches.order is None


def test_more_levels_are_category_and_object(put):
    touches = Touches.load(
        put("01_stapler/01/a.png", "01_stapler/02/x/a.png", "02_mug/01/a.png")
    )
    assert touches.object.tolist() == ["01_stapler/01", "01_stapler/02/x", "02_mug/01"]
    assert touches.category.tolist() == ["01_stapler", "01_stapler", "02_mug"]


def test_pictures_in_no_folder_have_no_labels(put):
    touches = Touches.load(put("b.png", "a.png"))
    assert touches.object is None
    assert len(touches.episodes()) == 1


def test_every_name_group_becomes_its_column(put):
    pattern = (
        r"^(?P<session>\w+?)_(?P<object>(?P<category>[a-z]+)-\w+?)_n(?P<n>\d+)"
        r"_at_(?P<x>-?\d+)_(?P<y>-?\d+)_(?P<z>-?\d+)_mm_(?P<x_mm>[\d.]+)_(?P<y_mm>"
        r"[\d.]+)_(?P<z_mm>[-\d.]+)_f(?P<force_n>[\d.]+)_(?P<press>\d+)_(?P<hand>\w+)\."
    )
    touches = Touches.load(
        put(
            "01_mug-a_n2_at_1_-2_3_mm_0.5_1_2_f0.7_004_left.png",
            "01_mug-a_n10_at_4_5_6_mm_1.5_1_-2.25_f1_005_right.png",
        ),
        name_pattern=pattern,
    )
    assert touches.object.tolist() == ["mug-a", "mug-a"]
    assert touches.category.tolist() == ["mug", "mug"]
    assert touches.session.tolist() == ["01", "01"]
    assert touches.order.tolist() == [2, 10]
    assert touches.order.dtype.kind == "i"
    columns = touches.columns
    assert columns["position_raw"].tolist() == [[1.0, -2.0, 3.0], [4.0, 5.0, 6.0]]
    assert columns["position_mm"].tolist() == [[0.5, 1.0, 2.0], [1.5, 1.0, -2.25]]
    assert columns["force_n"].tolist() == [0.7, 1.0]
    assert columns["press"].tolist() == [4, 5]
    assert columns["press"].dtype.kind == "i"
    assert columns["hand"].tolist() == ["left", "right"]
    assert "x" not in columns


def test_x_and_y_alone_are_columns_of_their_own(put):
    touches = Touches.load(put("1_2.png"), name_pattern=r"(?P<x>\d)_(?P<y>\d)")
    assert touches.columns["x"].tolist() == [1]
    assert "position_raw" not in touches.columns


def test_the_path_is_searched_where_the_name_does_not_match(put):
    pattern = r"(?P<object>[a-z]+)/(?P<n>\d+)"
    touches = Touches.load(put("cup/7.png", "deep/ball/8.png"), name_pattern=pattern)
    assert touches.object.tolist() == ["cup", "ball"]
    assert touches.order.tolist() == [7, 8]


def test_folders_label_what_the_pattern_does_not(put):
    touches = Touches.load(put("cup/7.png", "ball/8.png"), name_pattern=r"(?P<n>\d)\.")
    assert touches.object.tolist() == ["ball", "cup"]
    assert touches.order.tolist() == [8, 7]


def test_groups_that_match_sometimes_leave_gaps(put):
    touches = Touches.load(
        put("1_f2.5_left.png", "2.png"),
        name_pattern=r"(?P<n>\d)(_f(?P<force_n>[\d.]+))?(_(?P<hand>\w+))?\.png",
    )
    assert_array_equal(touches.columns["force_n"], [2.5, np.nan])
    assert touches.columns["hand"].tolist() == ["left", ""]


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("(?P<object>", r"regular expression, got '\(\?P<object>': .*An example"),
        (r"cup_\d", "must have named groups"),
        (r"(?P<images>\d)", "in use, got images"),
        (r"(?P<set_x>\d)", "in use, got set_x"),
        (r"(?P<position_mm>\d)", "in use, got position_mm"),
        (r"(?P<n>\d)(?P<order>\d?)", "both n and order"),
        (r"(?P<object>ball)_", r"in: cup_1.png must match name_pattern .*ball"),
        (r"(?P<object>x?)", "cup_1.png: the group object .* got nothing"),
        (r"(?P<n>cup)", "cup_1.png: the group n .* a whole number, got 'cup'"),
        (r"(?P<x>c)(?P<y>u)(?P<z>p)", "the group x .* must match a number, got 'c'"),
        (r"cup_1\.(?P<object>(?P<category>q)?p)", "the group category .* got nothing"),
    ],
)
def test_bad_patterns_are_refused(put, pattern, message):
    with pytest.raises(TouchesError, match=message):
        Touches.load(put("cup_1.png"), name_pattern=pattern)


def test_a_pattern_is_text(put):
    with pytest.raises(TypeError, match="name_pattern must be a string, got int"):
        Touches.load(put("cup_1.png"), name_pattern=3)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["a/1.png", "b/2.png", "odd.png"], "odd.png lies in no folder and a/1.png"),
        (["a/b/1.png", "a/b/2.png", "c/3.png"], "c/3.png lies in one folder and a/b/1"),
        (["1.png", "2.png", "c/d/3.png"], "c/d/3.png lies in folders of folders"),
    ],
)
def test_folders_that_label_some_are_refused(put, names, message):
    with pytest.raises(TouchesError, match=message):
        Touches.load(put(*names))


@pytest.fixture
def short_patience(monkeypatch):
    monkeypatch.setattr("palpate.touches._layout._MOST_S", 1.0)


def test_a_pattern_that_takes_for_ever_is_given_up(rng, tmp_path, short_patience):
    """Names of thirty letters: each letter doubles what the pattern takes."""
    image = png_bytes(rng.integers(0, 255, (8, 8), dtype="uint8"))
    for name in ("mug_1.png", "a" * 30 + "!.png"):
        (tmp_path / name).write_bytes(image)
    with pytest.raises(TouchesError, match=r"within 1 s, got .*at 'a{30}!.png'.*\\w\+"):
        read_folder(tmp_path, name_pattern=r"^(?P<object>(\w+)+)_\d\.png$")


def test_names_are_matched_as_they_are(put):
    """The file name before the path; letters of any kind; nothing where none."""
    folder = put("a/b_1.png", "x_2/c.png", "a/\udce9_3.png")
    pattern = r"(?P<what>[^/]+)_(?P<n>\d)(?P<more>x)?"
    columns = read_folder(folder, name_pattern=pattern).columns
    assert columns["what"].tolist() == ["b", "\udce9", "x"]
    assert columns["order"].tolist() == [1, 3, 2]
    assert columns["more"].tolist() == ["", "", ""]


def test_more_names_are_matched_than_a_pipe_holds(put):
    folder = put("mug_0.png")
    for n in range(1, 2500):
        (folder / f"mug_{n}.png").hardlink_to(folder / "mug_0.png")
    pattern = r"(?P<object>\w+)_(?P<n>\d+)"
    touches = read_folder(folder, name_pattern=pattern, progress=False)
    assert touches.order.tolist() == list(range(2500))
    assert set(touches.object) == {"mug"}
