"""What is said of pictures that are refused: the value found, and what to do."""

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from palpate.touches import TouchesError, decode_bytes, read_folder


def jpeg(image, **options):
    stream = io.BytesIO()
    image.save(stream, "JPEG", **options)
    return stream.getvalue()


def chunk(kind, body):
    """Return a chunk of a PNG with its checksum."""
    check = zlib.crc32(kind + body).to_bytes(4, "big")
    return len(body).to_bytes(4, "big") + kind + body + check


def png(*chunks):
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.fixture
def plain(rng):
    return rng.integers(0, 255, (24, 32), dtype=np.uint8)


def test_ink_is_no_light(plain):
    ink = Image.fromarray(plain).convert("CMYK")
    with pytest.raises(TouchesError, match=r"got a JPEG of 4 channels \(CMYK\)"):
        decode_bytes(jpeg(ink))


def test_pixels_before_their_size(plain):
    """The frame's segment is taken out: its first scan comes at once."""
    whole = jpeg(Image.fromarray(plain))
    at = whole.index(b"\xff\xc0")
    length = int.from_bytes(whole[at + 2 : at + 4], "big")
    headless = whole[:at] + whole[at + 2 + length :]
    with pytest.raises(TouchesError, match="its pixels come before its size"):
        decode_bytes(headless)


@pytest.mark.parametrize(
    ("n_bits", "size", "told"),
    [
        (12, (24, 32), "a 12-bit JPEG"),
        (8, (0, 32), "a JPEG of 32 x 0 pixels"),
        (8, (24, 0), "a JPEG of 0 x 24 pixels"),
    ],
)
def test_a_jpeg_of_another_depth_or_of_no_pixels(plain, n_bits, size, told):
    whole = bytearray(jpeg(Image.fromarray(plain)))
    at = whole.index(b"\xff\xc0") + 4
    whole[at : at + 5] = struct.pack(">BHH", n_bits, *size)
    with pytest.raises(TouchesError, match=told):
        decode_bytes(bytes(whole))


def test_a_png_begins_with_its_size():
    odd = png(chunk(b"tEXt", b"a\0b"), chunk(b"IDAT", b""))
    with pytest.raises(TouchesError, match="it must begin with its size"):
        decode_bytes(odd)


def test_too_many_pixels_are_counted_before_they_are_decoded(plain):
    whole = jpeg(Image.fromarray(plain))
    assert decode_bytes(whole, max_pixels=24 * 32).shape == (24, 32)
    with pytest.raises(
        TouchesError,
        match=r"at most 767 pixels, got 32 x 24 8-bit JPEG\..*raise max_pixels",
    ):
        decode_bytes(whole, max_pixels=767)


def test_the_odd_one_of_a_folder_is_named_with_what_the_others_are(plain, tmp_path):
    folder = tmp_path / "mug"
    folder.mkdir()
    for number in range(3):
        (folder / f"{number}.jpg").write_bytes(jpeg(Image.fromarray(plain)))
    (folder / "3.jpg").write_bytes(jpeg(Image.fromarray(plain[:, :16])))
    with pytest.raises(
        TouchesError,
        match=r"got 16 x 24 8-bit JPEG in .*3\.jpg \(3 of 4 are 32 x 24 8-bit JPEG\)",
    ):
        read_folder(tmp_path)


def test_grey_where_colour_is_asked_for(plain):
    with pytest.raises(TouchesError, match="32 x 24 8-bit JPEG in grey where colour"):
        decode_bytes(jpeg(Image.fromarray(plain)), colour=True)
    colours = np.dstack([plain] * 3)
    assert decode_bytes(jpeg(Image.fromarray(colours)), colour=True).shape == (
        24,
        32,
        3,
    )


def test_a_folder_that_takes_too_many_bytes_is_refused(plain, tmp_path):
    folder = tmp_path / "mug"
    folder.mkdir()
    for number in range(4):
        (folder / f"{number}.jpg").write_bytes(jpeg(Image.fromarray(plain)))
    read_folder(tmp_path, max_bytes=4 * 24 * 32)
    with pytest.raises(TouchesError, match=r"at most 3071 bytes, got 3072\."):
        read_folder(tmp_path, max_bytes=3071)
