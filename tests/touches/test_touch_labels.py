"""Labels of pictures, by folders and by a pattern for their names."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.touches import TouchesError, png_bytes

from .conftest import first_levels


@pytest.mark.parametrize(
    ("names", "pattern", "columns"),
    [
        pytest.param(
            ["cup/a.png", "ball/a.png", "cup/b.png"],
            None,
            {
                "object": ["ball", "cup", "cup"],
                "source_path": ["ball/a.png", "cup/a.png", "cup/b.png"],
            },
            id="one level of folders is the object",
        ),
        pytest.param(
            ["01_stapler/01/a.png", "01_stapler/02/x/a.png", "02_mug/01/a.png"],
            None,
            {
                "object": ["01_stapler/01", "01_stapler/02/x", "02_mug/01"],
                "category": ["01_stapler", "01_stapler", "02_mug"],
            },
            id="more levels are category and object",
        ),
        pytest.param(["b.png", "a.png"], None, {}, id="no folder is no label"),
        pytest.param(
            ["1_2.png"],
            r"(?P<x>\d)_(?P<y>\d)",
            {"x": [1], "y": [2]},
            id="x and y alone are columns of their own",
        ),
        pytest.param(
            ["cup/7.png", "deep/ball/8.png"],
            r"(?P<object>[a-z]+)/(?P<n>\d+)",
            {"object": ["cup", "ball"], "order": [7, 8]},
            id="the path is searched where the name does not match",
        ),
        pytest.param(
            ["cup/7.png", "ball/8.png"],
            r"(?P<n>\d)\.",
            {"object": ["ball", "cup"], "order": [8, 7]},
            id="folders label what the pattern does not",
        ),
        pytest.param(
            ["1_f2.5_left.png", "2.png"],
            r"(?P<n>\d)(_f(?P<force_n>[\d.]+))?(_(?P<hand>\w+))?\.png",
            {"order": [1, 2], "force_n": [2.5, np.nan], "hand": ["left", ""]},
            id="groups that match sometimes leave gaps",
        ),
        pytest.param(
            ["a/b_1.png", "x_2/c.png", "a/\udce9_3.png"],
            r"(?P<what>[^/]+)_(?P<n>\d)(?P<more>x)?",
            {
                "what": ["b", "\udce9", "x"],
                "order": [1, 3, 2],
                "more": ["", "", ""],
                "object": ["a", "a", "x_2"],
            },
            id="names are matched as they are",
        ),
    ],
)
def test_folders_and_patterns_give_columns(put, names, pattern, columns):
    touches = Touches.load(put(*names), name_pattern=pattern)
    assert {*touches.columns} == {*columns, "source_path"}
    for name, values in columns.items():
        assert_array_equal(touches.columns[name], values)
    paths = touches.columns["source_path"].tolist()
    assert first_levels(touches) == [names.index(path) for path in paths]


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


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("(?P<object>", r"regular expression, got '\(\?P<object>': .*An example"),
        (r"cup_\d", "must have named groups"),
        (r"(?P<images>\d)", "in use, got images"),
        (r"(?P<set_x>\d)", "in use, got set_x"),
        (r"(?P<position_mm>\d)", "in use, got position_mm"),
        (r"(?P<n>\d)(?P<order>\d?)", "both n and order"),
        (r"(?P<object>ball)_", r"in: .* name_pattern .*ball.*cup_1.png, not named"),
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
        (
            ["a/1.png", "b/2.png", "odd.png"],
            "got odd.png, in no folder, unlike the others",
        ),
        (
            ["a/b/1.png", "a/b/2.png", "c/3.png"],
            "got c/3.png, in one folder, where the others",
        ),
        (
            ["1.png", "2.png", "c/d/3.png"],
            "got c/d/3.png, in folders of folders, unlike",
        ),
    ],
)
def test_folders_that_label_only_some_pictures_are_refused(put, names, message):
    with pytest.raises(TouchesError, match=message):
        Touches.load(put(*names))


def test_a_pattern_that_takes_for_ever_is_given_up(rng, tmp_path, monkeypatch, lower):
    """Each of the thirty letters of a name doubles the time that the pattern takes."""
    lower(monkeypatch, pattern_s=1.0)
    image = png_bytes(rng.integers(0, 255, (8, 8), dtype="uint8"))
    for name in ("mug_1.png", "a" * 30 + "!.png"):
        (tmp_path / name).write_bytes(image)
    with pytest.raises(TouchesError, match=r"within 1 s, got .*at 'a{30}!.png'.*\\w\+"):
        Touches.load(tmp_path, name_pattern=r"^(?P<object>(\w+)+)_\d\.png$")


def test_more_names_are_matched_than_a_pipe_holds(put):
    folder = put("mug_0.png")
    for n in range(1, 2500):
        (folder / f"mug_{n}.png").hardlink_to(folder / "mug_0.png")
    pattern = r"(?P<object>\w+)_(?P<n>\d+)"
    touches = Touches.load(folder, name_pattern=pattern, progress=False)
    assert touches.order.tolist() == list(range(2500))
    assert set(touches.object) == {"mug"}
