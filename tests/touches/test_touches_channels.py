"""Images with channels, pads side by side in one picture, and frames of a press."""

import hashlib
import zipfile

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from palpate import Touches
from palpate.touches import TouchesError, decode_bytes

from .conftest import assert_same

COLOUR = ["r", "g", "b"]


def coloured(n_touches=2, **more):
    images = np.arange(n_touches * 4 * 6 * 3, dtype=np.uint8)
    return Touches(images.reshape(-1, 4, 6, 3), channels=COLOUR, **more)


def pressed(frames, **more):
    """Return one touch of one or two taxels with these frames."""
    frames = np.array(frames, dtype=float).reshape(1, len(frames), 1, -1)
    return Touches(frames.max(axis=1), press_frames=frames, **more)


def test_channels_and_pads_are_named():
    hand = coloured(pads=[[0, 0, 4, 2], [0, 3, 4, 3]], pad_names=["thumb", "index"])
    assert hand.channels == ("r", "g", "b")
    assert hand.pad_names == ("thumb", "index")
    assert_array_equal(hand.pads, [[0, 0, 4, 2], [0, 3, 4, 3]])
    assert repr(hand).startswith("<Touches: 2 of 4 x 6 x 3 uint8; no labels; ")
    grey = Touches(np.zeros((1, 2, 2)))
    assert (grey.channels, grey.pads, grey.pad_names) == (None, None, None)
    assert Touches(np.zeros((2, 3, 3, 1)), channels=["z"]).images.shape == (2, 3, 3, 1)


@pytest.mark.parametrize(
    ("shape", "columns", "message"),
    [
        ((1, 4, 6, 3), {}, "none. List .* `channels`, .* its array .* x,y,z"),
        ((1, 4, 6, 3), {"channels": ["r", "g"]}, "each of the 3 channels .*'g'"),
        ((1, 4, 6, 3), {"channels": ["r", "r", "b"]}, "different texts"),
        ((1, 4, 6, 3), {"channels": ["r", " ", "b"]}, "none of them empty"),
        ((1, 4, 6, 3), {"channels": [1, 2, 3]}, r"texts .*got \[1, 2, 3\]"),
        ((1, 4, 6, 3), {"channels": [["r", "g", "b"]]}, "texts in a list"),
        ((1, 4, 6), {"channels": ["r"]}, "0 channels .* leave them out"),
        ((1, 4, 6, 1, 1), {"channels": ["r"]}, r"got \(1, 4, 6, 1, 1\)"),
        ((1, 4, 6), {"pads": [[0, 0, 4, 3], [3, 2, 1, 1]]}, "pad 1.* overlaps"),
        ((1, 4, 6), {"pads": [[0, 4, 4, 3]]}, "leaves the picture of 4 x 6 taxels"),
        ((1, 4, 6), {"pads": [[-1, 0, 2, 2]]}, "leaves the picture"),
        ((1, 4, 6), {"pads": [[2**62, 0, 2**62, 2]]}, "leaves the picture"),
        ((1, 4, 6), {"pads": [[0, 0, 0, 2]]}, "has no taxel"),
        ((1, 4, 6), {"pads": [[0, 0, 2, 2, 2]]}, r"\(n_pads, 4\).*got shape \(1, 5\)"),
        ((1, 4, 6), {"pads": [0, 0, 2, 2]}, r"got shape \(4,\)"),
        ((1, 4, 6), {"pads": [[0.0, 0, 2, 2]]}, "must be integers"),
        ((1, 4, 6), {"pads": np.zeros((0, 4), int)}, "at least one pad"),
        ((1, 4, 6), {"pad_names": ["thumb"]}, "'thumb'.* for no pads"),
        (
            (1, 4, 6),
            {"pads": [[0, 0, 2, 2]], "pad_names": ["thumb", "index"]},
            "for 1 pads. Give as many names",
        ),
        ((1, 4, 6), {"pads": [[0, 0, 2, 2]], "set_pads": [[0, 0, 1, 1]]}, "given once"),
        ((1, 4, 6), {"press_frames": np.zeros((1, 5, 4, 5))}, "4 x 6 taxels like"),
        ((1, 4, 6), {"press_frames": np.zeros((1, 4, 6))}, r"got shape \(1, 4, 6\)"),
        ((1, 4, 6), {"press_frames": np.zeros((2, 5, 4, 6))}, "one row per touch"),
        ((1, 4, 6), {"press_frames": np.zeros((1, 0, 4, 6))}, "at least one frame"),
        ((1, 4, 6), {"press_frames": np.full((1, 2, 4, 6), np.inf)}, "infinity in"),
        ((1, 4, 6, 3), {"channels": COLOUR, "no_contact": np.zeros((4, 6))}, "6 x 3"),
    ],
)
def test_what_does_not_fit_the_images_is_refused(shape, columns, message):
    with pytest.raises(TouchesError, match=message):
        Touches(np.zeros(shape), **columns)


def test_a_set_never_loses_what_its_images_need():
    touches = coloured(pads=[[0, 0, 4, 6]], pad_names=["palm"])
    with pytest.raises(TouchesError, match=r"channels must name.*got none"):
        touches.without("channels")
    with pytest.raises(TouchesError, match=r"transpose\(0, 2, 3, 1\)"):
        Touches(np.zeros((2, 3, 8, 9)), channels=["r", "g", "b"])
    with pytest.raises(TouchesError, match="for no pads"):
        touches.without("pads")
    assert touches.without("pads", "pad_names").pads is None
    with pytest.raises(TouchesError, match="leave them out"):
        Touches(np.zeros((1, 2, 2))).with_columns(channels=COLOUR)
    assert touches.with_columns(channels=["x", "y", "z"]).channels == ("x", "y", "z")
    assert touches[1].channels == ("r", "g", "b")


def test_archives_keep_channels_pads_and_frames(tmp_path):
    hand = coloured(
        pads=[[0, 0, 4, 2], [0, 3, 4, 3]],
        pad_names=["thumb", "index"],
        no_contact=np.zeros((4, 6, 3), np.uint8),
        press_frames=np.ones((2, 5, 4, 6, 3), np.uint8),
    )
    hand.save(tmp_path / "hand.npz")
    assert_same(Touches.load(tmp_path / "hand.npz"), hand)


def test_former_names_of_archives_are_read(tmp_path):
    path = tmp_path / "old.npz"
    np.savez(
        path,
        images=np.zeros((2, 4, 6, 3)),
        set_channels=COLOUR,
        set_pads=[[0, 0, 4, 6]],
        set_pad_names=[b"palm"],
    )
    old = Touches.load(path)
    assert set(old.whole) == {"channels", "pads", "pad_names"}
    assert (old.channels, old.pad_names) == (("r", "g", "b"), ("palm",))


def test_sets_of_unlike_channels_are_not_joined():
    colour, grey = coloured(), Touches(np.zeros((1, 4, 6), np.uint8))
    assert len(Touches.concatenate([colour, colour[:1]])) == 3
    with pytest.raises(
        TouchesError, match=r"all be 4 x 6 x 3 taxels .* 4 x 6 taxels in"
    ):
        Touches.concatenate([colour, grey])
    turned = colour.with_columns(channels=["b", "g", "r"])
    with pytest.raises(TouchesError, match=r"channels must be the same.*\. Keep the"):
        Touches.concatenate([colour, turned])


def test_summaries_of_a_press_follow_from_their_definitions():
    # Loads above the first frame: 0, 4, 10, 8, 2; 80 % of the peak's are 8.
    touches = pressed([1, 5, 11, 9, 3], object=["cup"], no_contact=[[1.0]])
    summed = touches.with_frame_summaries()
    assert summed.channels == ("peak", "hold", "loading")
    assert_array_equal(summed.images, [[[[11, 10, 5]]]])
    assert_array_equal(summed.no_contact, [[[1, 1, 0]]])
    assert list(summed.object) == ["cup"]
    assert "press_frames" not in summed.columns


def test_a_press_that_only_fades_has_no_loading():
    assert_array_equal(pressed([4, 3, 1]).with_frame_summaries().images[0, 0, 0, 2], 0)


def test_gaps_stay_gaps_in_summaries():
    frames = [[0, np.nan], [6, np.nan], [3, np.nan]]
    summed = pressed(frames).with_frame_summaries().images[0, 0]
    assert_array_equal(summed, [[6, 6, 6], [np.nan] * 3])


def test_channels_of_a_press_are_summarised_one_by_one():
    frames = np.array([[1, 2], [7, 4]], np.uint8).reshape(1, 2, 1, 1, 2)
    touches = Touches(frames[:, 1], channels=["x", "y"], press_frames=frames)
    summed = touches.with_frame_summaries()
    assert summed.channels == (
        *("peak x", "peak y", "hold x", "hold y", "loading x", "loading y"),
    )
    assert_array_equal(summed.images, [[[[7, 4, 7, 4, 6, 2]]]])
    assert summed.images.dtype == np.float32


def test_touches_without_frames_have_no_summaries():
    with pytest.raises(TouchesError, match="must have press_frames, got touches"):
        coloured().with_frame_summaries()


@pytest.fixture
def painted(tmp_path):
    """Write a picture of three bands: red, green and blue."""

    def write(name, mode="RGB"):
        bands = np.zeros((3, 8, 8, 3), np.uint8)
        bands[range(3), ..., range(3)] = [[[200]], [[100]], [[50]]]
        path = tmp_path / "in" / name
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(bands.reshape(24, 8, 3)).convert(mode).save(path, quality=100)
        return path

    return write


@pytest.mark.parametrize(
    ("name", "mode", "atol"),
    [
        ("a.png", "RGB", 0),
        ("a.png", "RGBA", 0),
        ("a.png", "P", 4),  # its palette has few colours
        ("a.jpg", "RGB", 3),  # even the best quality rounds colours
    ],
)
def test_colour_pictures_are_red_green_blue(painted, name, mode, atol):
    path = painted(name, mode)
    touches = Touches.load(path.parent, colour=True)
    assert touches.channels == ("r", "g", "b")
    bands = touches.images[0, 4::8, 4].astype(int)
    assert np.abs(bands - np.diag([200, 100, 50])).max() <= atol
    assert_array_equal(decode_bytes(path.read_bytes(), colour=True), touches.images[0])
    assert Touches.load(path.parent).images.shape == (1, 24, 8)


def test_a_grey_picture_among_colours_is_named(painted):
    for name in ("a.png", "b.png"):
        root = painted(name).parent
    painted("c.png", "L")
    assert len(Touches.load(root)) == 3
    with pytest.raises(TouchesError, match=r"c\.png .*got 8 x 24 8-bit PNG in grey"):
        Touches.load(root, colour=True)
    with pytest.raises(TouchesError, match="in grey where colour is asked for"):
        decode_bytes((root / "c.png").read_bytes(), colour=True)


def test_the_picture_of_no_contact_is_in_colour_too(painted, tmp_path):
    root = painted("a.png").parent
    empty = painted("empty.png")
    touches = Touches.load(root, colour=True, no_contact=empty)
    assert_array_equal(touches.no_contact, touches.images[0])
    touches.save(tmp_path / "t.npz")
    again = Touches.load(tmp_path / "t.npz", no_contact=empty)
    assert_array_equal(again.no_contact, touches.no_contact)
    touches.with_columns(channels=["x", "y", "z"]).save(tmp_path / "t.npz")
    with pytest.raises(TouchesError, match=r"a picture for images of uint8 and .*x, y"):
        Touches.load(tmp_path / "t.npz", no_contact=empty)


@pytest.mark.realdata
def test_recorded_hands_and_colours_are_read(data_folder):
    hand = Touches.load(data_folder / "sessions" / "sdh2_september.npz")
    assert hand.pads.shape == (6, 4)
    inside = np.zeros(hand.images.shape[1:], bool)
    for row, col, n_rows, n_cols in hand.pads:
        inside[row : row + n_rows, col : col + n_cols] = True
    assert np.isnan(hand.images[:, ~inside]).all()
    assert not np.isnan(hand.images[:, inside]).all(axis=0).all()
    summed = hand[:5].with_frame_summaries()
    assert_array_equal(np.isnan(summed.images[..., 2]), np.isnan(hand.images[:5]))
    digit = Touches.load(data_folder / "sessions" / "digit_survey.npz")
    assert digit.channels == ("r", "g", "b")


def test_grey_touches_are_stored_to_the_same_bytes_as_ever(tmp_path):
    touches = Touches(
        np.arange(24, dtype=np.uint16).reshape(2, 3, 4),
        object=["cup", "pen"],
        no_contact=np.zeros((3, 4), np.uint16),
        geometry="array",
        set_unit="counts",
        parts=np.array([1, 2, 3]),
    )
    touches.save(tmp_path / "grey.npz")
    digest = hashlib.sha256()
    with zipfile.ZipFile(tmp_path / "grey.npz") as archive:
        for name in archive.namelist():
            digest.update(name.encode() + archive.read(name))
    # As palpate wrote it before images could have channels.
    assert digest.hexdigest()[:32] == "3e99ddae2f062f0ed883f44895ba323d"
