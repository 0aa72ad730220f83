"""Patterns for names of files: matched in bounded time, whatever they are."""

import re

import pytest

from palpate.touches import TouchesError, png_bytes, read_folder
from palpate.touches._layout import matched


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


def test_names_are_matched_as_they_are():
    """The file name before the path; letters of any kind; none where none."""
    names = ["a/b_1.png", "x_2/c.png", "é\udce9_3.png", "none"]
    found = matched(re.compile(r"(?P<what>[^/]+)_(?P<n>\d)(?P<more>x)?"), names)
    assert found == [
        {"what": "b", "n": "1", "more": None},
        {"what": "x", "n": "2", "more": None},
        {"what": "é\udce9", "n": "3", "more": None},
        None,
    ]


def test_very_many_names_are_matched():
    names = [f"mug_{n}.png" for n in range(20_000)]
    found = matched(re.compile(r"(?P<object>\w+)_(?P<n>\d+)"), names)
    assert found[-1] == {"object": "mug", "n": "19999"}
    assert len(found) == 20_000
