"""JPEGs of very many scans: small files that would keep a decoder busy for minutes."""

import cv2
import numpy as np
import pytest

from palpate.touches import TouchesError, decode_bytes, read_folder

SIDE = 1600


@pytest.fixture(scope="module")
def grey():
    ramp = np.add.outer(np.arange(SIDE), np.arange(SIDE)) // 8
    return ramp.astype(np.uint8)


def with_scans(image, n_scans, *, progressive=True):
    """Return a JPEG of an image that is followed by so many scans of nothing.

    Each says in a few bytes that all coefficients of all blocks are zero.
    """
    how = [cv2.IMWRITE_JPEG_PROGRESSIVE, int(progressive)]
    coded = cv2.imencode(".jpg", image, how)[1].tobytes()
    n_blocks = (SIDE // 8) ** 2
    # A table of two codes of two bits: the first ends the bands of 2**14 blocks.
    table = b"\xff\xc4\x00\x15\x10" + bytes([0, 2, *[0] * 14, 0xE0, 0])
    scan = b"\xff\xda\x00\x08\x01\x01\x00\x01\x3f\x00" + bytes(2 + n_blocks // 2**13)
    return coded[:-2] + table + scan * n_scans + b"\xff\xd9"


@pytest.mark.parametrize("n_scans", [101, 2000])
def test_very_many_scans_are_refused_before_they_are_decoded(grey, n_scans):
    with pytest.raises(TouchesError, match=r"a JPEG of more than 100 scans"):
        decode_bytes(with_scans(grey, n_scans))


def test_the_refusal_names_the_file(grey, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "1.jpg").write_bytes(with_scans(grey, 500))
    with pytest.raises(TouchesError, match=r"1\.jpg must be .* more than 100 scans"):
        read_folder(tmp_path)


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("progressive", [False, True])
def test_usual_jpegs_pass_at_every_size(colour, progressive):
    """Of a noisy picture many bytes are 0xFF or 0xDA, and none a scan too many."""
    shape = (1000, 1000, 3) if colour else (1000, 1000)
    noise = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    how = [cv2.IMWRITE_JPEG_PROGRESSIVE, int(progressive), 1, 98]
    coded = cv2.imencode(".jpg", noise, how)[1].tobytes()
    assert decode_bytes(coded, colour=colour).shape == shape


def test_what_lies_in_a_preview_or_behind_the_end_is_no_scan(grey):
    coded = cv2.imencode(".jpg", grey)[1].tobytes()
    alike = b"\xff\xda" * 300
    preview = b"\xff\xe1" + (len(alike) + 2).to_bytes(2, "big") + alike
    whole = coded[:2] + preview + coded[2:] + alike
    assert len(whole) > 10_000  # enough for the scans to be counted
    assert np.abs(decode_bytes(whole).astype(int) - grey).max() <= 4  # JPEG's rounding


def test_scans_that_follow_an_end_within_a_comment_are_counted(grey):
    """An end that a decoder passes over must not end the counting."""
    comment = b"\xff\xfe\x00\x04\xff\xd9"
    bomb = with_scans(grey, 300).replace(
        b"\xff\xc4\x00\x15", comment + b"\xff\xc4\x00\x15"
    )
    with pytest.raises(TouchesError, match="more than 100 scans"):
        decode_bytes(bomb)
