"""Touches with channels on the page: colour in colour, others as their mean."""

import cv2
import numpy as np
import pytest

from palpate import Touches
from palpate.library import TouchLibrary
from palpate.web import learn_job


def red_left(side=60):
    """A picture that is red on its left half and blue on its right."""
    image = np.zeros((side, side, 3), np.uint8)
    image[:, : side // 2, 0] = image[:, side // 2 :, 2] = 200
    return image


@pytest.fixture
def shown(tmp_path, make_session, connected):
    """Return what the page shows of one touch: blue, green, red."""

    def show(image, channels):
        folder = tmp_path / "-".join(channels)
        with TouchLibrary.open(folder, create=True) as library:
            touches = Touches(image[np.newaxis], object=["cup"], channels=channels)
            (key,) = library.add(touches)
        with connected(make_session(sensor=False, library=folder)) as client:
            answer = client.get(f"/api/touches/{key}/picture")
            assert answer.status_code == 200, answer.text
            grey = cv2.imencode(".png", image[..., 0])[1].tobytes()
            kind = {"content-type": "image/png"}
            refused = client.post("/api/touch/picture", content=grey, headers=kind)
            assert "must have 60 x 60 x 3 taxels, got 60 x 60" in refused.text
        data = np.frombuffer(answer.content, np.uint8)
        return cv2.imdecode(data, cv2.IMREAD_COLOR)

    return show


def test_colour_is_shown_in_colour(shown):
    picture = shown(red_left(), ["r", "g", "b"])
    assert picture.shape == (96, 96, 3)
    assert picture[48, 10].tolist() == [0, 0, 200]
    assert picture[48, 85].tolist() == [200, 0, 0]
    turned = shown(red_left()[..., ::-1].copy(), ["b", "g", "r"])
    np.testing.assert_array_equal(turned, picture)


def test_other_channels_are_shown_as_their_mean(shown):
    picture = shown(red_left(), ["x", "y", "z"])
    assert len(np.unique(picture)) == 1


def test_touches_of_a_colour_are_learnt_apart_from_grey(tmp_path):
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        grey = np.zeros((4, 12, 12), np.uint8)
        library.add(Touches(grey, object=["cup", "cup", "pen", "pen"]))
        colour = np.zeros((1, 12, 12, 3), np.uint8)
        library.add(Touches(colour, object=["mug"], channels=["r", "g", "b"]))
    answer = learn_job(tmp_path / "library", tmp_path / "m.palpate")
    assert answer["objects"] == []
