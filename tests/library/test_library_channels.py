"""Touches with channels and pads in a library: kept, told apart, never mixed."""

import json

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import (
    LibraryError,
    SensorDescription,
    TouchLibrary,
    check_library,
    repair_library,
)

COLOUR = ["r", "g", "b"]


def colour(rng, n_touches=3, **more):
    images = rng.integers(0, 256, (n_touches, 5, 6, 3), dtype=np.uint8)
    about = {"object": ["mug"] * n_touches, "channels": COLOUR, **more}
    return Touches(images, **about)


def grey(rng, **more):
    images = rng.integers(0, 256, (2, 5, 6), dtype=np.uint8)
    return Touches(images, object=["pen"] * 2, **more)


def test_channels_pads_and_frames_come_back(library, rng):
    hand = colour(
        rng,
        pads=[[0, 0, 5, 2], [0, 3, 5, 3]],
        pad_names=["thumb", "index"],
        no_contact=np.zeros((5, 6, 3), np.uint8),
        press_frames=np.ones((3, 4, 5, 6, 3), np.uint8),
    )
    ids = library.add(hand)
    back = library.touches()
    assert back.images.dtype == np.uint8
    assert_array_equal(back.images, hand.images)
    assert_array_equal(back.columns["press_frames"], hand.columns["press_frames"])
    assert_array_equal(back.no_contact, hand.no_contact)
    assert_array_equal(back.pads, hand.pads)
    assert (back.channels, back.pad_names) == (hand.channels, hand.pad_names)
    assert_array_equal(library.image(ids[1]), hand.images[1])
    row = library.list()[0]
    assert (row.n_rows, row.n_cols, row.n_channels, row.dtype) == (5, 6, 3, "|u1")
    assert library.add(hand) == ids
    assert len(library) == 3
    mapped = library.touches(in_memory=0)
    assert_array_equal(mapped.images, hand.images)


def test_one_channel_is_not_none(library, rng):
    image = rng.normal(size=(1, 5, 6, 1))
    library.add(Touches(image, channels=["z"]))
    assert_array_equal(library.touches().images, image)
    assert library.count("n_channels = 1") == 1


def test_grey_and_colour_are_never_read_together(library, rng):
    library.add(grey(rng))
    library.add(colour(rng))
    message = "got 5 x 6 |u1; 5 x 6 x 3 |u1. Choose .*n_channels is null"
    for read in (library.touches, library.select):
        with pytest.raises(LibraryError, match=message.replace("|", r"\|")):
            read()
    assert len(library.touches("n_channels is null")) == 2
    assert library.touches("n_channels = 3").channels == ("r", "g", "b")


def test_one_sensor_gives_one_kind(library, rng):
    camera = SensorDescription("camera 0")
    library.add(grey(rng), sensor=camera)
    with pytest.raises(LibraryError, match=r"'camera 0' must have no channels .*got 3"):
        library.add(colour(rng), sensor=camera)
    assert len(library) == 2
    library.add(colour(rng), sensor=SensorDescription("camera 1"))
    with pytest.raises(LibraryError, match=r"'camera 1' must have 3 channels .*got no"):
        library.add(grey(rng), sensor=SensorDescription("camera 1"))
    assert len(library.touches("sensor = 'camera 1'")) == 3


def test_unlike_channels_or_pads_are_refused(library, rng):
    library.add(colour(rng))
    library.add(colour(rng, channels=["x", "y", "z"], session=["a"] * 3))
    with pytest.raises(LibraryError, match="the same channels, got several"):
        library.touches()
    assert library.touches("session = a").channels == ("x", "y", "z")
    library.add(grey(rng, pads=[[0, 0, 5, 6]]))
    library.add(grey(rng))
    with pytest.raises(LibraryError, match="the same pads, got several"):
        library.select("object = pen")


def test_pads_of_former_names_are_the_same(library, rng):
    library.add(grey(rng, set_pads=np.array([[0, 0, 5, 6]])))
    library.add(grey(rng, pads=np.array([[0, 0, 5, 6]])))
    assert library.touches().pads.tolist() == [[0, 0, 5, 6]]


def test_features_are_made_of_touches_with_channels(library, rng):
    touches = colour(rng, pads=[[0, 0, 5, 6]])
    library.add(touches)

    def encode(some):
        assert some.channels == ("r", "g", "b")
        assert len(some.pads) == 1
        return some.images.mean(axis=(1, 2))

    means = library.select().features("means", encode)
    np.testing.assert_allclose(means, touches.images.mean(axis=(1, 2)))


def test_check_and_repair_know_channels(library, rng, alter):
    touches = colour(rng, pads=[[0, 0, 5, 6]])
    library.add(touches)
    assert check_library(library.folder).ok
    library.close()
    alter(library.folder, "UPDATE touches SET force_n = 5 WHERE number = 2")
    assert repair_library(library.folder).n_touches == 2
    with TouchLibrary.open(library.folder) as again:
        assert_array_equal(again.touches().images, touches.images[::2])
        assert again.touches().channels == ("r", "g", "b")
        assert again.touches().pads.tolist() == [[0, 0, 5, 6]]


def test_exports_keep_channels(library, rng, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    touches = colour(rng, pads=[[0, 0, 5, 6]])
    library.add(touches)
    library.export(tmp_path / "t.npz")
    again = Touches.load(tmp_path / "t.npz")
    assert_array_equal(again.images, touches.images)
    assert (again.channels, len(again.pads)) == (touches.channels, 1)
    library.export(tmp_path / "robot")
    info = json.loads((tmp_path / "robot/meta/info.json").read_text())
    assert info["features"]["observation.tactile"]["shape"] == [5, 6, 3]
    data = pq.read_table(tmp_path / "robot/data/chunk-000/file-000.parquet")
    seen = np.array(data["observation.tactile"].to_pylist())
    assert_array_equal(seen, touches.images)


def test_grey_touches_have_the_ids_that_they_ever_had(library):
    images = np.arange(24, dtype=np.uint16).reshape(2, 3, 4)
    touches = Touches(images, object=["cup", "pen"], no_contact=images[0])
    # As palpate gave them before images could have channels.
    assert library.add(touches) == [
        "f467699079c60b0d00ce6a14a4bcf3a8",
        "9fde34d0b464f2dcbe07ab4ee842b06c",
    ]
