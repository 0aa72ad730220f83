"""A pressure array over a pseudo-terminal: the port is real, the array is not."""

import os
import threading
import time
import tty

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate.sensors import (
    AddressError,
    BinaryFraming,
    LineFraming,
    SensorError,
    SerialArraySensor,
    check_sensor,
    open_sensor,
)

serial = pytest.importorskip("serial", reason="pyserial is not installed")


class Terminal:
    """A pseudo-terminal; what is written to it arrives at its port."""

    def __init__(self):
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.port = os.ttyname(self.slave)
        self.stop = threading.Event()
        self.thread = None

    def play(self, packets, rate_hz):
        """Write packets at a rate, over and over if they are a function."""

        def run():
            due = time.monotonic()
            for packet in packets:
                if self.stop.wait(max(0.0, due - time.monotonic())):
                    return
                os.write(self.master, packet)
                due += 1 / rate_hz

        self.thread = threading.Thread(target=run, daemon=True)
        self.thread.start()

    def close(self):
        self.stop.set()
        if self.thread:
            self.thread.join(5)
        for end in (self.master, self.slave):
            os.close(end)


@pytest.fixture
def terminal():
    pseudo_terminal = Terminal()
    yield pseudo_terminal
    pseudo_terminal.close()


def endless(shape, write):
    number = 0
    while True:
        yield write(np.full(shape, number % 200, np.uint16), number)
        number += 1


def as_line(image, number):
    return LineFraming.write(image)


@pytest.mark.parametrize(
    ("framing", "write"), [("line", as_line), ("binary", BinaryFraming.write)]
)
def test_an_array_keeps_the_contract(terminal, framing, write):
    terminal.play(endless((3, 4), write), 200)
    check_sensor(SerialArraySensor(terminal.port, (3, 4), framing=framing))


@pytest.mark.slow
def test_16_x_16_at_100_hz_arrive_without_loss(terminal):
    n_frames = 150
    images = np.arange(n_frames * 256, dtype=np.uint16).reshape(n_frames, 16, 16)
    sensor = SerialArraySensor(terminal.port, (16, 16), framing="binary", baud=921600)
    with sensor:
        terminal.play([BinaryFraming.write(im, n) for n, im in enumerate(images)], 100)
        frames = [sensor.read_next() for _ in range(n_frames)]
    assert_array_equal([frame.image for frame in frames], images)
    assert sensor.n_dropped == 0


def test_garbage_and_cut_frames_are_counted_and_left_behind(terminal):
    good = [BinaryFraming.write(np.full((2, 2), n, np.uint16), n) for n in range(4)]
    with SerialArraySensor(terminal.port, (2, 2), framing="binary") as sensor:
        os.write(terminal.master, b"booting...\r\n" + good[0] + good[1][:7])
        os.write(terminal.master, good[2] + b"\xa5\x5a\x02" + good[3])
        levels = [int(sensor.read_next().image[0, 0]) for _ in range(3)]
        assert levels == [0, 2, 3]
        n_dropped = sensor.n_dropped
        assert n_dropped >= 3
        later = BinaryFraming.write(np.full((2, 2), 9, np.uint16), 9)
        os.write(terminal.master, later)
        assert int(sensor.read_next().image[0, 0]) == 9
        assert sensor.n_dropped == n_dropped + 5  # those between, by their numbers


def test_a_pulled_plug_is_noticed_and_the_array_found_again(tmp_path):
    first, second = Terminal(), Terminal()
    port = tmp_path / "array"  # as /dev/serial/by-id does, this name stays
    port.symlink_to(first.port)
    sensor = SerialArraySensor(str(port), (2, 2), framing="binary")
    sensor.retry_s = 0.02
    packet = BinaryFraming.write(np.ones((2, 2), np.uint16))
    with sensor:
        os.write(first.master, packet)
        sensor.read_next()
        port.unlink()
        first.close()
        with pytest.raises(SensorError, match=r"is lost: The serial port .* cannot be"):
            sensor.read_next(0.5)
        port.symlink_to(second.port)
        deadline = time.monotonic() + 5
        while sensor.lost and time.monotonic() < deadline:
            time.sleep(0.01)
        os.write(second.master, packet)
        assert_array_equal(sensor.read_next().image, np.ones((2, 2)))
    second.close()


def test_a_port_that_is_not_there_or_busy_is_refused(terminal):
    with pytest.raises(SensorError, match="/dev/nowhere cannot be opened"):
        SerialArraySensor("/dev/nowhere", (2, 2)).connect()
    with (
        SerialArraySensor(terminal.port, (2, 2)),
        pytest.raises(SensorError, match="Another program uses it"),
    ):
        SerialArraySensor(terminal.port, (2, 2)).connect()


def test_an_array_tells_the_step_of_its_numbers(terminal):
    with SerialArraySensor(terminal.port, (4, 4)) as array:
        assert array.step == 1
        os.write(terminal.master, LineFraming.write(np.full((4, 4), 0.5)))
        array.read_next()
        assert array.step == 0.1
    assert SerialArraySensor("/dev/nowhere", (4, 4), framing="binary").step == 1
    pressed = {"framing": "binary", "dtype": np.float32}
    assert SerialArraySensor("/dev/nowhere", (4, 4), **pressed).step == 0


def plain_line(image, number):
    """Write a line as `Serial.println` does of numbers with commas between."""
    return ",".join(map(str, image.ravel())).encode() + b"\r\n"


def one_byte(image, number):
    return BinaryFraming.write(image.astype(np.uint8), number)


def with_dollar(image, number):
    """A line whose checksum is of its `$` too."""
    values, _, check = as_line(image, number).partition(b"*")
    return values + f"*{int(check, 16) ^ ord('$'):02X}\n".encode()


def crc_swapped(image, number):
    """A frame whose checksum has its high byte first."""
    packet = BinaryFraming.write(image, number)
    return packet[:-2] + packet[:-3:-1]


def test_numbers_that_are_just_printed_are_read_but_for_a_cut_first_line(terminal):
    with SerialArraySensor(terminal.port, (2, 2)) as sensor:
        os.write(terminal.master, b"2,13,14,15\r\n11,12,13,14\r\n")  # was 12
        assert_array_equal(sensor.read_next().image, [[11, 12], [13, 14]])
        assert sensor.n_dropped == 0


@pytest.mark.parametrize(
    ("write", "options", "message"),
    [
        (
            plain_line,
            {"image_shape": (16, 16)},
            "128 values, expected 256: `shape=8x16`",
        ),
        (
            as_line,
            {"image_shape": (8, 8)},
            "128 values, expected 64: `shape=8x16` or `shape=16x8`",
        ),
        (plain_line, {"checksum": True}, "no checksum: `checksum=no`"),
        (BinaryFraming.write, {}, "look like binary: `framing=binary`"),
        (as_line, {"framing": "binary"}, "look like lines: `framing=line`"),
        (
            BinaryFraming.write,
            {"framing": "binary", "image_shape": (16, 8)},
            "128: `shape=8x16`.",
        ),
        (
            lambda image, number: plain_line(image[:4, :4], number),
            {"image_shape": (2, 8), "checksum": True},
            "The lines have no checksum: `checksum=no`.",
        ),
        (one_byte, {"framing": "binary"}, "uint8, expected uint16: `dtype=uint8`"),
        (lambda image, number: bytes(range(128, 250)) * 9, {}, "check `baud`"),
        (with_dollar, {}, "The checksum of lines is wrong: after `*`"),
        (crc_swapped, {"framing": "binary"}, "The checksum of frames is wrong"),
        (lambda image, number: b"S:" + b"1;" * 128 + b"\n", {}, "got 'S:1;1;1;1;"),
        (
            lambda image, number: b"1,2,3,4,5,6,7,8,9,1,2,3,4,5,6,7\n" * 8,
            {},
            "A line holds 16 values, as one row: write all rows in one.",
        ),
    ],
)
def test_bytes_that_are_no_frames_say_why(
    terminal, monkeypatch, lower, write, options, message
):
    lower(monkeypatch, serial_silent_s=0.1)
    terminal.play(endless((8, 16), write), 100)
    with SerialArraySensor(
        terminal.port, **{"image_shape": (8, 16), **options}
    ) as array:
        deadline = time.monotonic() + 10
        while not array.lost and time.monotonic() < deadline:
            time.sleep(0.02)
        assert message in array.lost
        assert array.n_frames == 0


@pytest.mark.parametrize(
    ("write", "shape", "framing", "checksum"),
    [
        (as_line, (4, 4), "line", True),
        (plain_line, (4, 4), "line", False),
        (BinaryFraming.write, (3, 5), "binary", None),
        (one_byte, (3, 5), "binary", None),
    ],
)
def test_an_array_is_found_by_what_it_writes(terminal, write, shape, framing, checksum):
    terminal.play(endless(shape, write), 100)
    with open_sensor(f"serial:{terminal.port}?shape=auto") as array:
        assert (array.image_shape, array.framing) == (shape, framing)
        assert array.checksum == checksum
        assert array.read_next().image.max() < 200
    with pytest.raises(AddressError, match=r"such as 16x16, or auto, got 'four'"):
        open_sensor(f"serial:{terminal.port}", image_shape="four")


@pytest.mark.parametrize(
    ("written", "message"),
    [
        (
            [plain_line(np.ones((3, 5), int), 0)] * 9,
            "15 values: `shape=3x5` or `shape=5x3`",
        ),
        ([bytes(range(128, 250))] * 9, "check `baud`"),
        ([], "check its cable"),
    ],
)
def test_an_array_that_cannot_be_found_is_refused_with_the_reason(
    terminal, monkeypatch, lower, written, message
):
    lower(monkeypatch, serial_listen_s=0.4)
    terminal.play(written, 100)
    with pytest.raises(SensorError, match=message):
        open_sensor(f"serial:{terminal.port}", image_shape="auto")


def test_an_array_that_goes_away_while_it_is_listened_to_is_said():
    pulled = Terminal()
    threading.Timer(0.3, pulled.close).start()
    with pytest.raises(SensorError, match=r"went away\. Plug the array in again"):
        open_sensor(f"serial:{pulled.port}", image_shape="auto")
