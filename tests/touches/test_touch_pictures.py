"""Single pictures: headers, kinds, cuts and damage."""

import io
import zlib
from itertools import pairwise

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image, ImageOps, PngImagePlugin

from palpate import Touches
from palpate.touches import TouchesError, decode_bytes, png_bytes


def coded(image, kind="PNG", **options):
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


@pytest.fixture
def grey(rng):
    """A smooth picture of 24 rows and 32 columns with a little noise."""
    row, col = np.mgrid[:24, :32]
    smooth = 120 + 60 * np.sin(row / 5) * np.cos(col / 7)
    return (smooth + rng.normal(scale=5, size=smooth.shape)).astype(np.uint8)


@pytest.fixture
def colour(rng):
    return rng.integers(0, 256, size=(24, 32, 3), dtype=np.uint8)


def luma(colour):
    """Return the grey level of each colour by ITU-R BT.601."""
    return colour @ np.array([0.299, 0.587, 0.114])


def test_grey_png_is_exact(grey):
    """16 bits stay 16 bits, one bit is spread to 255, opaque alpha is dropped."""
    deep = grey.astype(np.uint16) * 251 + 3
    spread = np.where(grey > 120, 255, 0)
    opaque = np.dstack([grey, np.full_like(grey, 255)])
    cases = ((grey, grey), (deep, deep), (grey > 120, spread), (opaque, grey))
    for stored, expected in cases:
        decoded = decode_bytes(coded(Image.fromarray(stored)))
        assert_array_equal(decoded, expected)
        assert decoded.dtype == (np.uint16 if stored is deep else np.uint8)


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("factor", [np.uint8(1), np.uint16(257)])
def test_colour_png_becomes_luma(colour, factor, alpha):
    """16 bits stay 16 bits; an opaque alpha channel is dropped."""
    opaque = [np.full((24, 32), 255, np.uint8)] if alpha else []
    blue_first = np.dstack([colour[..., ::-1], *opaque]) * factor
    decoded = decode_bytes(cv2.imencode(".png", blue_first)[1].tobytes())
    assert decoded.dtype == factor.dtype
    # Half a level of rounding and one of libpng's 15-bit weights.
    atol = 1.1 if factor == 1 else 4
    assert_allclose(decoded, float(factor) * luma(colour), atol=atol)


def test_palette_png_becomes_the_luma_of_its_colours(colour):
    image = Image.fromarray(colour).quantize(16)
    expected = luma(np.asarray(image.convert("RGB")))
    assert_allclose(decode_bytes(coded(image)), expected, atol=1.1)


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"quality": 40}])
@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_jpeg_equals_the_luma_that_pillow_decodes(grey, colour, mode, options):
    image = Image.fromarray(grey if mode == "L" else colour)
    data = coded(image, "JPEG", **options)
    reference = Image.open(io.BytesIO(data))
    reference.draft("L", reference.size)
    # Two builds of one codec; rounding of the inverse transform may differ by one.
    assert_allclose(decode_bytes(data), np.asarray(reference), atol=1)


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
@pytest.mark.parametrize("orientation", range(10))
def test_pictures_are_upright_as_pillow_turns_them(grey, kind, orientation, tmp_path):
    exif = Image.Exif()
    exif[0x0112] = orientation  # Exif knows no 0 and no 9
    data = coded(Image.fromarray(grey), kind, exif=exif)
    stored = Image.open(io.BytesIO(data))
    upright = np.asarray(ImageOps.exif_transpose(stored))
    # Two builds of one JPEG codec; rounding may differ by one.
    assert_allclose(decode_bytes(data).astype(float), upright, atol=1)
    (tmp_path / "a.png").write_bytes(coded(Image.fromarray(decode_bytes(data))))
    (tmp_path / f"b.{kind.lower()}").write_bytes(data)
    if kind == "PNG":  # one set, one size: that of the upright picture
        first, second = Touches.load(tmp_path).images
        assert_array_equal(first, second)


@pytest.mark.parametrize("chunk", [b"gAMA", b"sBIT"])
def test_hints_on_display_change_no_level(grey, chunk):
    info = PngImagePlugin.PngInfo()
    info.add(chunk, (100_000).to_bytes(4, "big") if chunk == b"gAMA" else b"\x05")
    assert_array_equal(decode_bytes(coded(Image.fromarray(grey), pnginfo=info)), grey)


@pytest.mark.parametrize(
    ("image", "kind", "options"),
    [
        (Image.new("P", (640, 1)), "PNG", {}),
        (Image.new("L", (7, 5)), "JPEG", {}),
        (Image.new("RGB", (300, 2)), "JPEG", {"progressive": True}),
        (Image.new("L", (1, 65500)), "JPEG", {"icc_profile": bytes(200_000)}),
        (Image.new("L", (9, 9)), "JPEG", {"comment": "x" * 60_000}),
    ],
)
def test_odd_sizes_and_long_headers_are_read(image, kind, options):
    decoded = decode_bytes(coded(image, kind, **options))
    assert decoded.shape == image.size[::-1]
    assert decoded.dtype == np.uint8


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_a_large_picture_is_refused_without_its_pixels(grey, kind):
    data = coded(Image.fromarray(grey), kind)
    start = data.index(b"IDAT") + 4 if kind == "PNG" else 0
    if kind == "JPEG":
        scan = data.index(b"\xff\xda") + 2
        start = scan + int.from_bytes(data[scan : scan + 2], "big")
    with pytest.raises(TouchesError, match=r"32 x 24 .* most 767 pixels.*raise `max"):
        decode_bytes(data[:start], max_pixels=767)


def patched(data, at, value):
    return data[:at] + bytes([value]) + data[at + 1 :]


def refused_kinds():
    image = Image.new("L", (16, 8), 90)
    jpeg, png = coded(image, "JPEG"), coded(image)
    frame = jpeg.index(b"\xff\xc0")
    clear = Image.new("RGBA", (16, 8), (1, 2, 3, 254))
    other = Image.new("L", (16, 8), 91)
    return [
        (b"", "an empty file"),
        (b"not a picture", "neither JPEG nor PNG"),
        (coded(image, "BMP"), "neither JPEG nor PNG"),
        (coded(image, "GIF"), "neither JPEG nor PNG"),
        (coded(Image.new("CMYK", (9, 9)), "JPEG"), r"4 channels \(CMYK\)"),
        (patched(jpeg, frame + 4, 12), "a 12-bit JPEG"),
        (patched(jpeg, frame + 1, 0xC3), "lossless or arithmetic"),
        (patched(jpeg, frame + 1, 0xC9), "lossless or arithmetic"),
        (
            jpeg[:frame] + jpeg[jpeg.index(b"\xff\xda") :],
            "its pixels come before its size",
        ),
        (patched(jpeg, frame + 6, 0), "16 x 0 8-bit JPEG, not of 1 to"),
        (patched(jpeg, frame + 8, 0), "0 x 8 8-bit JPEG, not of 1 to"),
        (jpeg[:-2] + jpeg[frame : frame + 13] + b"\xff\xd9", r"a damaged or .*two SOF"),
        (jpeg[: jpeg.index(b"\xff\xda")] + b"\xff\xd9", "a damaged or unusual"),
        (
            jpeg[:frame] + jpeg[frame : frame + 13] + jpeg[frame:],
            "damaged or unusual JPEG",
        ),
        (jpeg[:frame] + b"\0" + jpeg[frame:], "a damaged or unusual JPEG .*extran"),
        (jpeg[:2] + b"\xff\xfe\0\0" + jpeg[2:], "a segment without a length"),
        (coded(image, save_all=True, append_images=[other]), "an animated PNG"),
        (coded(clear), "transparent parts"),
        (coded(clear.convert("LA")), "transparent parts"),
        (coded(image, transparency=3), "a transparent colour"),
        (coded(image.convert("P"), transparency=3), "a transparent colour"),
        (png[:8] + png[33:], "it must begin with its size"),
        (png.replace(b"\0\0\0\x10", bytes(4), 1), "a damaged PNG .*checksum"),
        (png[:8] + ihdr(0, 5) + png[33:], "0 x 5 8-bit PNG, not of 1 to"),
        (png[:8] + ihdr(17, 9) + png[33:], "cannot be decoded"),
    ]


def ihdr(n_cols, n_rows):
    content = b"IHDR" + n_cols.to_bytes(4, "big") + n_rows.to_bytes(4, "big")
    content += bytes([8, 0, 0, 0, 0])
    return b"\0\0\0\x0d" + content + zlib.crc32(content).to_bytes(4, "big")


@pytest.mark.parametrize(("data", "message"), refused_kinds())
def test_other_kinds_are_refused(data, message):
    with pytest.raises(TouchesError, match=message):
        decode_bytes(data)


CUTTABLE = {
    "grey jpeg": ("JPEG", {}),
    "progressive jpeg": ("JPEG", {"progressive": True}),
    "jpeg with restarts": ("JPEG", {"restart_marker_blocks": 2}),
    "jpeg with an end marker inside a comment": ("JPEG", {"comment": b"\xff\xd9" * 9}),
    "png": ("PNG", {}),
    "16-bit png": ("PNG", {}),
}


@pytest.mark.parametrize("name", CUTTABLE)
def test_a_file_cut_at_any_length_is_refused(grey, name):
    kind, options = CUTTABLE[name]
    image = Image.fromarray(grey.astype(np.uint16) * 9 if "16" in name else grey)
    data = coded(image, kind, **options)
    for length in range(len(data)):
        with pytest.raises(TouchesError):
            decode_bytes(data[:length])
    assert decode_bytes(data).shape == grey.shape


def test_what_follows_the_end_is_ignored(grey):
    for kind in ("PNG", "JPEG"):
        data = coded(Image.fromarray(grey), kind)
        assert_array_equal(decode_bytes(data + bytes(99)), decode_bytes(data))


def test_any_flipped_bit_of_a_png_is_refused():
    data = coded(Image.fromarray(np.arange(12, dtype=np.uint8).reshape(3, 4)))
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(TouchesError):
            decode_bytes(bytes(damaged))


def test_a_hole_in_a_png_is_refused(grey):
    data = coded(Image.fromarray(grey))
    for start, stop in pairwise(range(0, len(data), 64)):
        with pytest.raises(TouchesError):
            decode_bytes(data[:start] + bytes(stop - start) + data[stop:])


def test_a_damaged_jpeg_is_refused_or_keeps_its_size(grey, tmp_path):
    """A JPEG has no checksum: some flips of a coefficient cannot be noticed."""
    data = coded(Image.fromarray(grey), "JPEG", quality=50)
    for name in ("1.jpg", "2.jpg"):
        (tmp_path / name).write_bytes(data)
    n_refused = 0
    for position in range(len(data)):
        damaged = patched(data, position, data[position] ^ (1 << position % 8))
        (tmp_path / "3.jpg").write_bytes(damaged)
        try:
            assert Touches.load(tmp_path).images.shape == (3, *grey.shape)
        except TouchesError:
            n_refused += 1
    assert 0 < n_refused < len(data)


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_a_jpeg_that_lacks_some_coefficients_is_refused(grey, mode):
    """OpenCV and Pillow fill what is missing with grey, without a word."""
    data = coded(Image.fromarray(grey).convert(mode), "JPEG")
    for lacking in (data[:-60] + data[-30:], data[:-2] + data[-40:]):
        with pytest.raises(TouchesError, match=r"a damaged or .*(premature|extran)"):
            decode_bytes(lacking, colour=mode == "RGB")


def test_a_jpeg_of_a_rare_subsampling_is_refused_by_name():
    """Each unit has four, two and one grey blocks: a difference of 0, then an end."""
    data = coded(Image.new("RGB", (32, 16), (128, 128, 128)), "JPEG")
    frame, scan = data.index(b"\xff\xc0"), data.index(b"\xff\xda")
    for component, factors in enumerate((0x22, 0x21, 0x11)):
        data = patched(data, frame + 11 + 3 * component, factors)
        data = patched(data, scan + 6 + 2 * component, 0)
    bits = "001010" * 7 * 2 + "1" * 4
    blocks = int(bits, 2).to_bytes(len(bits) // 8, "big")
    data = data[: scan + 14] + blocks + b"\xff\xd9"
    with pytest.raises(TouchesError, match=r"unusual JPEG .*subsampling"):
        decode_bytes(data)


def test_no_warning_of_pillow_comes_through(grey):
    """Pillow warns of bombs, and of Exif and animations that look damaged to it."""
    exif = (
        b"Exif\0\0II*\0\x08\0\0\0\x02\0\x1a\x01\x05\0\xff\xff\xff\xff\xff\xff\xff\xff"
    )
    plain = coded(Image.fromarray(grey), "JPEG")
    odd = coded(Image.fromarray(grey), "JPEG", exif=exif)
    assert_array_equal(decode_bytes(odd), decode_bytes(plain))
    png = coded(Image.fromarray(grey))
    bomb = png[:8] + ihdr(10_000, 10_000) + png[33:]
    with pytest.raises(TouchesError, match="at most 50000000 pixels"):
        decode_bytes(bomb)
    with pytest.raises(TouchesError, match="cannot be decoded"):
        decode_bytes(bomb, max_pixels=10**9)
    content = b"acTL" + bytes(8)
    chunk = b"\0\0\0\x08" + content + zlib.crc32(content).to_bytes(4, "big")
    with pytest.raises(TouchesError, match="an animated PNG"):
        decode_bytes(png[:33] + chunk + png[33:])


@pytest.mark.parametrize("n_bits", [1, 2, 4, 8])
def test_a_colour_that_the_palette_lacks_is_refused(grey, n_bits):
    indices = (np.arange(grey.size) % 2**n_bits).astype(np.uint8).reshape(grey.shape)
    picture = Image.frombytes("P", grey.shape[::-1], indices.tobytes())
    picture.putpalette([level for index in range(2**n_bits) for level in [index] * 3])
    whole = coded(picture, bits=n_bits)
    assert_array_equal(decode_bytes(whole), indices)
    start = whole.index(b"PLTE") - 4
    length = int.from_bytes(whole[start : start + 4])
    kept = whole[start + 8 : start + 5 + length]
    shorter = b"PLTE" + kept
    chunk = len(kept).to_bytes(4) + shorter + zlib.crc32(shorter).to_bytes(4)
    lacking = whole[:start] + chunk + whole[start + 12 + length :]
    with pytest.raises(TouchesError, match=f"of a palette of {2**n_bits - 1}"):
        decode_bytes(lacking)


@pytest.mark.parametrize("levels", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(3, 5), (3, 5, 3)])
def test_levels_written_as_a_png_come_back(levels, shape, rng):
    written = rng.integers(0, np.iinfo(levels).max, shape, levels, endpoint=True)
    read = decode_bytes(png_bytes(written), colour=len(shape) > 2)
    assert read.dtype == levels
    assert_array_equal(read, written)


def test_a_file_may_hold_32_mib_beside_eight_bytes_a_pixel(grey, tmp_path):
    path = tmp_path / "1.jpg"
    path.write_bytes(coded(Image.fromarray(grey), "JPEG"))
    limit = 32 * 2**20 + 8 * grey.size
    with path.open("r+b") as file:
        file.truncate(limit)
        assert Touches.load(path).images.shape == (1, *grey.shape)
        file.truncate(limit + 1)
    with pytest.raises(TouchesError, match=f"a file of {limit + 1} bytes"):
        Touches.load(path, max_pixels=grey.size)


SIDE = 1600


@pytest.fixture(scope="module")
def large_grey():
    ramp = np.add.outer(np.arange(SIDE), np.arange(SIDE)) // 8
    return ramp.astype(np.uint8)


def with_scans(image, n_scans):
    """Return a JPEG of an image, followed by `n_scans` scans without content.

    Each scan says in a few bytes that all coefficients of all blocks are zero.
    """
    encoding = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    data = cv2.imencode(".jpg", image, encoding)[1].tobytes()
    n_blocks = (SIDE // 8) ** 2
    # A table of two codes of two bits: the first ends the bands of 2**14 blocks.
    table = b"\xff\xc4\x00\x15\x10" + bytes([0, 2, *[0] * 14, 0xE0, 0])
    scan = b"\xff\xda\x00\x08\x01\x01\x00\x01\x3f\x00" + bytes(2 + n_blocks // 2**13)
    return data[:-2] + table + scan * n_scans + b"\xff\xd9"


def test_very_many_scans_are_refused_before_they_are_decoded(large_grey):
    with pytest.raises(TouchesError, match=r"a JPEG of more than 100 scans"):
        decode_bytes(with_scans(large_grey, 101))


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("progressive", [False, True])
def test_usual_jpegs_pass_at_every_size(colour, progressive):
    """Many bytes of a noisy picture are 0xFF or 0xDA; none counts as a scan."""
    shape = (1000, 1000, 3) if colour else (1000, 1000)
    noise = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    encoding = [cv2.IMWRITE_JPEG_PROGRESSIVE, int(progressive), 1, 98]
    data = cv2.imencode(".jpg", noise, encoding)[1].tobytes()
    assert decode_bytes(data, colour=colour).shape == shape


def test_what_lies_in_a_preview_or_behind_the_end_is_no_scan(large_grey):
    data = cv2.imencode(".jpg", large_grey)[1].tobytes()
    markers = b"\xff\xda" * 300
    preview = b"\xff\xe1" + (len(markers) + 2).to_bytes(2, "big") + markers
    picture = data[:2] + preview + data[2:] + markers
    assert len(picture) > 10_000  # enough for the scans to be counted
    assert (
        np.abs(decode_bytes(picture).astype(int) - large_grey).max() <= 4
    )  # JPEG's rounding


def test_a_long_run_of_fill_bytes_behind_the_scans_takes_no_long_time(large_grey):
    """A search that begins anew at each of them would take minutes."""
    run, scans = b"\xff" * 2**22 + b"\0", b"\xff\xda" * 99
    data = with_scans(large_grey, 60)[:-2] + run + scans
    with pytest.raises(TouchesError, match="damaged or unusual JPEG"):
        decode_bytes(data)


def test_scans_that_follow_an_end_within_a_comment_are_counted(large_grey):
    """The end marker that a decoder passes over must not end the counting."""
    comment = b"\xff\xfe\x00\x04\xff\xd9"
    bomb = with_scans(large_grey, 300).replace(
        b"\xff\xc4\x00\x15", comment + b"\xff\xc4\x00\x15"
    )
    with pytest.raises(TouchesError, match="more than 100 scans"):
        decode_bytes(bomb)
