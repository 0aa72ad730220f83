"""How a set of touches shows itself: on one line, and in a notebook."""

import base64
import re
import sys

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches


def pictures(touches):
    """Decode the PNG pictures in the HTML of touches, in colour."""
    coded = re.findall(r"src='data:image/png;base64,([^']+)'", touches._repr_html_())
    as_bytes = [np.frombuffer(base64.b64decode(text), np.uint8) for text in coded]
    return [cv2.imdecode(data, cv2.IMREAD_COLOR) for data in as_bytes]


@pytest.fixture
def many(rng):
    """2,000 touches of as many objects with long names, and a lot of columns."""
    return Touches(
        rng.integers(0, 256, (2000, 4, 5), dtype=np.uint8),
        object=[f"{'a very long name of an object ' * 20}{i}" for i in range(2000)],
        session=np.arange(2000),
        no_contact=np.zeros((4, 5)),
        **{f"column_{i}_{'x' * 30}": np.zeros(2000) for i in range(50)},
    )


def test_repr_fits_a_line(many):
    assert repr(many) == (
        "<Touches: 2000 of 4 x 5 uint8; 2000 objects, 2000 sessions; columns: 52; "
        "whole set: 1>"
    )
    few = many.without(*[name for name in many.columns if name[-1] == "x"])
    assert repr(few) == (
        "<Touches: 2000 of 4 x 5 uint8; 2000 objects, 2000 sessions; "
        "columns: 2; whole set: 1>"
    )
    bare = Touches(np.zeros((2, 3, 3)), **{f"about_{i}": [1, 2] for i in range(9)})
    assert repr(bare) == ("<Touches: 2 of 3 x 3 float64; no labels; columns: 9>")
    assert "\n" not in repr(Touches(np.zeros((1, 2, 2)), **{"a\nb": [1]}))
    kinds = Touches(np.zeros((3, 2, 2)), object=[*"aaa"], category=[*"xyy"])
    assert repr(kinds) == (
        "<Touches: 3 of 2 x 2 float64; 1 object, 2 categories; "
        "columns: object, category>"
    )


def test_html_tells_what_is_in_the_set():
    touches = Touches(
        np.zeros((3, 4, 5), np.int16),
        object=["cup", "pen", "cup"],
        category=["vessel", "tool", "vessel"],
        position_mm=np.zeros((3, 2)),
        geometry="array",
    )
    html = re.sub("<[^>]*>", " ", touches._repr_html_())
    for text in ("3", "4 x 5 int16", "2 objects", "cup (2), pen (1)", "2 categories"):
        assert text in html
    assert "position_mm (3 x 2 float64)" in html
    assert "geometry (one text)" in html
    assert "none" in re.sub("<[^>]*>", " ", Touches(np.zeros((1, 2, 2)))._repr_html_())


def test_html_of_many_touches_is_small(many):
    html = many._repr_html_()
    assert len(html) < 20_000
    assert "and 1988 more" in html
    assert len(pictures(many)) == 8


def test_hostile_names_are_escaped():
    name = "</td><script>alert('x')</script>\"&'"
    touches = Touches(
        np.zeros((2, 3, 3)), object=[name, "b"], category=[name, name], **{name: [1, 2]}
    )
    html = touches._repr_html_()
    assert "<script" not in html
    assert "&lt;script&gt;" in html
    plain = {"div", "table", "tr", "th", "td", "img", "br", "small"}
    assert set(re.findall(r"<([a-z]+)", html)) <= plain


def test_pictures_keep_shape_and_contrast():
    ramp = np.arange(200.0).reshape(1, 10, 20)
    (drawn,) = pictures(Touches(ramp))
    assert drawn.shape == (48, 96, 3)
    assert (drawn[0, 0] == 0).all()
    assert (drawn[-1, -1] == 255).all()
    (small,) = pictures(Touches(np.zeros((1, 480, 640), np.uint8)))
    assert small.shape == (72, 96, 3)


@pytest.mark.parametrize("side", [8, 240])
def test_dead_taxels_are_drawn(side):
    images = np.tile(np.linspace(0, 1, side), (2, side, 1))
    images[0, : side // 4, : side // 4] = np.nan
    dead, whole = pictures(Touches(images))
    assert_array_equal(dead[4, 4], [60, 60, 220])
    assert (np.ptp(whole, axis=2) == 0).all()
    assert (np.ptp(dead[40:, 40:], axis=2) == 0).all()


@pytest.mark.parametrize(
    "image",
    [
        np.full((1, 3, 4), np.nan),
        np.full((1, 3, 4), 7.0),
        np.array([[[-1e308, 1e308, 0.0]]]),
        np.array([[[True, False]]]),
        np.zeros((1, 1, 3000), np.uint16),
        np.full((1, 2, 2), 2**63, np.uint64),
    ],
)
def test_every_image_can_be_shown(image):
    (drawn,) = pictures(Touches(image))
    assert max(drawn.shape[:2]) == 96


def test_a_repr_needs_no_opencv(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    bare = Touches(np.zeros((1, 2, 2)))
    assert repr(bare) == "<Touches: 1 of 2 x 2 float64; no labels>"


def test_colour_is_shown_in_colour_and_other_channels_as_their_mean():
    image = np.zeros((1, 4, 4, 3), np.uint8)
    image[..., :2, 0] = image[..., 2:, 2] = 200
    (picture,) = pictures(Touches(image, channels=["r", "g", "b"]))
    assert picture[48, 10].tolist() == [0, 0, 255]
    assert picture[48, 85].tolist() == [255, 0, 0]
    (mean,) = pictures(Touches(image, channels=["x", "y", "z"]))
    assert len(np.unique(mean)) == 1
    html = Touches(image, channels=["r", "g", "b"])._repr_html_()
    assert "4 x 4 x 3 uint8" in html
    assert "channels (3 text)" in html
    dead = np.where(image > 0, image, np.nan)
    (marked,) = pictures(Touches(dead, channels=["r", "g", "b"]))
    assert (marked == [60, 60, 220]).all()
