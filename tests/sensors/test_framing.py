"""Frames on a serial line: what was written comes back, whatever lies between."""

import binascii
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from palpate.sensors import BinaryFraming, LineFraming

ROOT = Path(__file__).parents[2]
SHAPE = (3, 4)
garbage = st.binary(max_size=40)
numbers = st.lists(st.integers(0, 2**24).map(float), min_size=12, max_size=12)


def chunks(data, sizes):
    """Cut data into pieces of the given sizes, over and over."""
    start = 0
    while start < len(data):
        for size in sizes:
            yield data[start : start + size]
            start += size


def test_the_documented_line_is_read():
    # 0x30 ^ ',' ^ ... worked out by hand for "0,12": 30^2C^31^32 = 1F.
    assert_array_equal(LineFraming((1, 2)).feed(b"$0,12*1F\n"), [[[0, 12]]])
    for page in ("docs/reference/live.md", "src/palpate/sensors/_serial.py"):
        text = (ROOT / page).read_text("utf-8")
        (line,) = re.findall(r"^ *(\$0,.*\*..)$", text, re.MULTILINE)
        decoded = LineFraming((2, 2)).feed(f"{line}\n".encode())
        assert_array_equal(decoded, [[[0, 0], [12, 255]]])


def test_every_digit_that_float32_holds_is_written():
    largest = np.array([[16777215.0, 16777216.0, -65535.0]])
    assert LineFraming.write(largest).startswith(b"$16777215,16777216,-65535*")
    image = np.float32([[0.1, 1 / 3, 1e-20], [np.nan, 123.456, -7.0]])
    (decoded,) = LineFraming((2, 3)).feed(LineFraming.write(image))
    assert_array_equal(decoded, image)


def test_lines_tell_the_smallest_step_they_can_show():
    framing = LineFraming((1, 2), checksum=False)
    steps = []
    for line in (b"1,20\n", b"1.5,2\n", b"1.25,2.5\n", b"3,4\n", b"1e-3,2\n"):
        framing.feed(line)
        steps.append(framing.step)
    assert_array_equal(steps, [1, 0.1, 0.01, 0.01, 0])


def test_the_checksum_of_bytes_is_ccitt_false():
    # The catalogue's check value of CRC-16/CCITT-FALSE for "123456789".
    assert binascii.crc_hqx(b"123456789", 0xFFFF) == 0x29B1
    packet = BinaryFraming.write(np.zeros((1, 1), np.uint8), number=7)
    assert packet[:7] == bytes((0xA5, 0x5A, 1, 1, 1, 7, 0))


@settings(max_examples=60, deadline=None)
@given(
    frames=st.lists(numbers, min_size=1, max_size=4),
    noise=garbage.filter(lambda noise: b"\n" not in noise),
    sizes=st.lists(st.integers(1, 50), min_size=1, max_size=4),
)
def test_lines_survive_garbage_before_them(frames, noise, sizes):
    images = [np.reshape(values, SHAPE) for values in frames]
    written = (
        noise.replace(b"*", b"") + b"\n" + b"".join(map(LineFraming.write, images))
    )
    framing = LineFraming(SHAPE)
    decoded = [f for piece in chunks(written, sizes) for f in framing.feed(piece)]
    assert_array_equal(decoded, np.array(images, np.float32))


@settings(max_examples=60, deadline=None)
@given(
    frames=st.lists(numbers, min_size=1, max_size=4),
    noise=garbage,
    sizes=st.lists(st.integers(1, 50), min_size=1, max_size=4),
)
def test_bytes_survive_garbage_between_them(frames, noise, sizes):
    images = [(np.reshape(v, SHAPE) % 65536).astype(np.uint16) for v in frames]
    framing = BinaryFraming(SHAPE)
    written = b"".join(noise + BinaryFraming.write(i, n) for n, i in enumerate(images))
    # A frame's length of zeros ends whatever the garbage may have begun.
    written += bytes(64)
    decoded = [f for piece in chunks(written, sizes) for f in framing.feed(piece)]
    assert_array_equal(decoded, images)
    assert framing.n_missed == 0


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int16, np.float32])
def test_every_type_of_taxel_comes_back(kind, rng):
    image = rng.uniform(0, 200, size=SHAPE).astype(kind)
    (decoded,) = BinaryFraming(SHAPE, kind).feed(BinaryFraming.write(image))
    assert decoded.dtype == kind
    assert_array_equal(decoded, image)


def test_a_flipped_bit_anywhere_loses_that_frame_and_no_other(rng):
    images = rng.integers(0, 60000, size=(3, *SHAPE)).astype(np.uint16)
    packets = [BinaryFraming.write(image, n) for n, image in enumerate(images)]
    for at in range(len(packets[1])):
        broken = bytearray(packets[1])
        broken[at] ^= 0x10
        framing = BinaryFraming(SHAPE)
        decoded = framing.feed(packets[0] + bytes(broken) + packets[2] + bytes(64))
        assert_array_equal(decoded, images[[0, 2]])
        assert framing.n_missed == 1
        assert framing.n_damaged >= 1


@pytest.mark.parametrize(
    ("numbers", "n_missed"),
    [
        ((65534, 65535, 0, 3), 2),
        ((7, 1007), 999),
        ((7, 1008), 0),  # a gap of a thousand is a new beginning
        ((7, 7), 0),
    ],
)
def test_numbers_tell_how_many_frames_are_missing(numbers, n_missed):
    framing = BinaryFraming((1, 1))
    for number in numbers:
        framing.feed(BinaryFraming.write(np.ones((1, 1), np.uint16), number))
    assert framing.n_missed == n_missed


@pytest.mark.parametrize(
    "line",
    [
        b"$1,2,3*00\n",
        b"$1,2*1D\n",
        b"1,2\n",
        b"$1,2\n",
        b"$1,inf*5C\n",
        b"$1,x*66\n",
        b"\xff\xfe\n",
    ],
)
def test_a_line_that_is_no_frame_is_counted_and_skipped(line):
    framing = LineFraming((1, 2), checksum=True)
    assert framing.feed(line) == []
    # Lines carry no numbers: none is known to be missing.
    assert (framing.n_damaged, framing.n_missed) == (1, 0)
    assert len(framing.feed(LineFraming.write(np.array([[4.0, 5.0]])))) == 1


def test_lines_without_checksum_are_read_where_asked_for():
    (frame,) = LineFraming((2, 2), checksum=False).feed(b"1 2\t3,nan\r\n")
    assert_array_equal(frame, [[1, 2], [3, np.nan]])


def test_lines_without_checksum_are_read_until_one_with_it_came():
    framing = LineFraming((1, 2))
    assert len(framing.feed(b"1,2\n3,4\n")) == 2
    assert len(framing.feed(b"$0,12*1F\n5,6\n")) == 1
    assert framing.n_damaged == 1


def test_endless_garbage_takes_no_memory():
    line, binary = LineFraming((2, 2)), BinaryFraming((2, 2))
    for _ in range(100):
        line.feed(b"7" * 1000)
        binary.feed(b"\xa5" * 1000)
    # What they hold is what a copy of them holds; 100,000 bytes came.
    assert len(pickle.dumps(line)) < 2000
    assert len(pickle.dumps(binary)) < 2000


def test_what_bytes_cannot_carry_is_refused():
    BinaryFraming((255, 1))
    with pytest.raises(ValueError, match="at most 255 x 255, got 256 x 2"):
        BinaryFraming((256, 2))
    with pytest.raises(ValueError, match="dtype must be one of 'uint8'"):
        BinaryFraming((2, 2), np.float64)


def test_lines_that_were_cut_are_counted(rng):
    """A cut that takes the line's end along leaves two frames in one line."""
    images = rng.integers(0, 4000, (300, *SHAPE)).astype(float)
    lines = list(map(LineFraming.write, images))
    cut = rng.random(300) < 0.4
    cut[-1] = False  # nothing ends what was begun
    sent = [
        line[: rng.integers(2, len(line) - 1)] if is_cut else line
        for line, is_cut in zip(lines, cut, strict=True)
    ]
    framing = LineFraming(SHAPE)
    decoded = framing.feed(b"".join(sent))
    assert_array_equal(decoded, images[~cut])
    assert framing.n_damaged == cut.sum()


def test_lines_without_end_or_of_endless_levels_are_given_up():
    """A line over 32 letters a taxel and 8 is a damaged frame; the next is read."""
    framing = LineFraming((1, 2), checksum=False)
    assert framing.feed(b"1" * 72) == []
    assert framing.n_damaged == 0
    assert framing.feed(b"1") == []
    assert framing.n_damaged == 1
    assert framing.feed(b"\n1,2\n")[0].tolist() == [[1, 2]]
    # Very large and infinite levels are no frames either.
    assert len(framing.feed(b"3e38,0\n-3e38,1\n")) == 2
    assert framing.feed(b"3.1e38,0\n-3.1e38,0\ninf,0\n") == []
    assert framing.n_damaged == 1 + 3
