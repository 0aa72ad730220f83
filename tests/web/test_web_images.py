"""Images going out as pictures and coming in, without a server."""

import io

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.touches import TouchesError
from palpate.web._images import (
    MAX_PIXELS,
    FramePainter,
    ImageKind,
    check_image,
    read_json,
    read_picture,
    thumbnail,
)

BYTES = ImageKind((2, 2), np.dtype(np.uint8), None)


def npy(array, **options):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, **options)
    return stream.getvalue()


def decoded(picture):
    return cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize("level", [0.0, 255.0])
def test_whole_numbers_within_a_type_are_taken_as_it(level):
    image = check_image(np.array([[1.0, 2.0], [3.0, level]], np.float32), BYTES)
    assert image.dtype == np.uint8
    assert_array_equal(image, [[1, 2], [3, level]])


@pytest.mark.parametrize("level", [-1.0, 256.0, 1.5, np.nan])
def test_numbers_outside_a_type_are_refused(level):
    with pytest.raises(ValueError, match="whole numbers from 0 to 255"):
        check_image(np.array([[1.0, 2.0], [3.0, level]], np.float32), BYTES)


def test_an_image_of_its_type_is_as_it_is_and_floats_take_anything():
    image = np.ones((2, 2), np.uint8)
    assert check_image(image, BYTES) is image
    single = ImageKind((2, 2), np.dtype(np.float32), None)
    assert check_image(np.full((2, 2), 0.5), single).dtype == np.float32
    assert check_image(np.full((2, 2), 0.5), ImageKind((2, 2), None, None)).max() == 0.5


@pytest.mark.parametrize(
    ("shape", "kind", "message"),
    [
        ((2, 3), BYTES, "must have 2 x 2.*, got 2 x 3"),
        ((2, 2, 3), BYTES, "must have 2 x 2 .*in grey, got 2 x 2 with 3 channels"),
        (
            (2, 2),
            ImageKind((2, 2, 2), None, ("a", "b")),
            "with channels a, b, got 2 x 2 in grey",
        ),
    ],
)
def test_an_image_of_another_size_is_refused_with_both(shape, kind, message):
    with pytest.raises(ValueError, match=message):
        check_image(np.zeros(shape, np.uint8), kind)


def test_arrays_come_in_as_they_were_saved():
    for image in (
        np.arange(12, dtype=">i4").reshape(3, 4),
        np.asfortranarray(np.arange(12.0).reshape(3, 4)),
        np.arange(24, dtype=np.float32).reshape(2, 3, 4),
    ):
        read = read_picture(npy(image), "application/x-npy", colour=False)
        assert_array_equal(read, image)
        assert read.dtype.isnative
        assert read.flags.c_contiguous


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"\x93NUMPY",
        npy(np.zeros(4)),
        npy(np.zeros((2, 2), complex)),
        npy(np.zeros((2, 2, 65), np.uint8)),
        npy(np.zeros((2, 2)), version=(2, 0)),
        npy(np.zeros((2, 2)))[:-1],
        npy(np.zeros((2, 2))) + b"x" * 8,
        npy(np.zeros((0, 2))),
        npy(np.zeros((2, 2))).replace(b"}", b" "),
        npy(np.zeros((2, 2))).replace(b"'descr': '<f8'", b"'descr': 3    "),
        npy(np.zeros((2, 2))).replace(b"(2, 2), }", b"(True,2)}"),
    ],
    ids=[
        "empty",
        "cut",
        "flat",
        "complex",
        "channels",
        "version",
        "short",
        "long",
        "none",
        "open",
        "kind",
        "side",
    ],
)
def test_arrays_that_are_no_image_are_refused(body):
    with pytest.raises(TouchesError, match=f"got {len(body)} other bytes"):
        read_picture(body, "application/x-npy", colour=False)


def test_infinity_is_refused_and_nan_is_a_dead_taxel():
    with pytest.raises(ValueError, match="must be finite"):
        read_picture(npy(np.array([[1.0, np.inf]])), "application/x-npy", colour=False)
    fields, image = read_json(b'{"object": "mug", "image": [[0, 1.5], [2, null]]}')
    assert fields == {"object": "mug"}
    assert image.dtype == np.float32
    assert_array_equal(image, [[0, 1.5], [2, np.nan]])


@pytest.mark.parametrize(
    "body",
    [
        b"{}",
        b'{"image": []}',
        b'{"image": [[]]}',
        b'{"image": [[1], [1, 2]]}',
        b'{"image": [[true]]}',
        b'{"image": [["1"]]}',
        b'{"image": [[1]',
        b'{"image": [[1]]',
        b'{"image": [[1]], "image": 2}',
        b'{"image": [[1e999]]}',
        b'[{"image": [[1]]}]',
        b'{"a": {"image": [[1]]}}',
    ],
)
def test_json_that_holds_no_image_is_refused(body):
    with pytest.raises(ValueError, match=r"body must be|must be finite"):
        read_json(body)


def test_the_row_of_another_length_is_named():
    with pytest.raises(ValueError, match="something else at row 2"):
        read_json(b'{"image": [[0, 1], [2], [3, 4]]}')


def test_an_unknown_content_type_is_named_beside_the_known_ones():
    with pytest.raises(TouchesError, match=r"image/png, image/jpeg or .*'text/html'"):
        read_picture(b"", "text/html", colour=False)


def test_pictures_have_at_most_four_megapixels():
    assert MAX_PIXELS == 4_000_000
    large = cv2.imencode(".png", np.zeros((2001, 2000), np.uint8))[1].tobytes()
    with pytest.raises(TouchesError, match="at most 4000000 pixels"):
        read_picture(large, "image/png", colour=False)


def test_colour_is_read_where_there_is_some():
    colours = np.zeros((4, 4, 3), np.uint8)
    colours[..., 0] = 200  # blue, as OpenCV has it
    coded = cv2.imencode(".png", colours)[1].tobytes()
    assert read_picture(coded, "image/png; q=1", colour=True)[0, 0].tolist() == [
        0,
        0,
        200,
    ]
    assert read_picture(coded, "image/png", colour=False).ndim == 2
    grey = cv2.imencode(".png", colours[..., 0])[1].tobytes()
    assert read_picture(grey, "image/png", colour=True).ndim == 2


def test_arrays_are_false_colours_over_the_widest_range_yet():
    painter = FramePainter((2, 2))
    assert painter.content_type == "image/png"
    first = painter.levels(np.array([[0.0, 10.0], [np.nan, 5.0]]))
    levels = np.arange(256, dtype=np.uint8)[:, np.newaxis]
    viridis = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
    assert_array_equal(first[0, 0], viridis[0, 0])
    assert_array_equal(first[0, 1], viridis[255, 0])
    assert_array_equal(first[1, 0], (16, 14, 11))  # a gap
    half = painter.levels(np.array([[0.0, 5.0], [0.0, 0.0]]))
    assert_array_equal(half[0, 1], viridis[127, 0])
    assert FramePainter((2, 2)).levels(np.full((2, 2), np.nan)).shape == (2, 2, 3)


@pytest.mark.parametrize(
    ("shape", "false_colour", "coloured"),
    [((48, 48), False, True), ((49, 48), False, False), ((49, 48), True, True)],
)
def test_pictures_of_cameras_are_grey(shape, false_colour, coloured):
    painter = FramePainter(shape, false_colour=false_colour)
    assert painter.coloured == coloured
    image = np.full(shape, 90, np.uint8)
    picture = decoded(painter.paint(image))
    assert (picture.ndim == 3) == coloured
    if not coloured:
        assert painter.content_type == "image/jpeg"
        assert_allclose(picture, 90, atol=1)


def test_a_thumbnail_is_96_pixels_at_its_longer_side():
    assert decoded(thumbnail(np.arange(8.0).reshape(2, 4))).shape == (48, 96, 3)
    assert decoded(thumbnail(np.zeros((480, 640), np.uint8))).shape == (72, 96)
    assert decoded(thumbnail(np.zeros((1, 400), np.uint8))).shape == (1, 96)


def test_taxels_stay_squares_and_pixels_are_averaged():
    """An array's taxels are enlarged as they are; a camera's pixels are means."""
    taxels = decoded(thumbnail(np.array([[0.0, 1.0], [2.0, 3.0]])))
    assert len(np.unique(taxels.reshape(-1, 3), axis=0)) == 4
    stripes = np.zeros((960, 960), np.uint8)
    stripes[::2] = 200
    assert_allclose(decoded(thumbnail(stripes)), 100, atol=1)


def test_cameras_pictures_are_of_quality_80():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (64, 64), dtype=np.uint8)
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
    assert FramePainter((64, 64)).paint(image) == coded
