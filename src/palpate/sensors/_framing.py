"""Frames of a pressure array on a serial line: written as lines, or as bytes.

**Lines**, which any microcontroller can print and people can read. One frame is one
line: all taxels row after row, separated by commas, spaces or tabs; numbers as
Python reads them, `nan` for a dead taxel. With a checksum the values stand between
`$` and `*`, and after `*` come two hexadecimal digits: the exclusive or of all bytes
between them (as in NMEA 0183)::

    $0,0,12,255*1E

**Bytes**, about a quarter as long and numbered: docs/reference/live.md has the layout.

Whatever is no frame is skipped: after garbage, or a frame that was cut or changed on
the way, the next whole frame is read.
"""

import binascii
import struct
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from .._checks import check_option
from .._types import Array

SYNC = b"\xa5\x5a"
_HEAD = struct.Struct("<BBBH")
# Of each type of taxel its code in a frame, and how its bytes lie.
_TYPES = {"uint8": (1, "<u1"), "uint16": (2, "<u2")}
_TYPES |= {"int16": (3, "<i2"), "float32": (4, "<f4")}
_LONGEST_NUMBER = 32
_MANY_MISSED = 1000
_LARGEST_WHOLE = 2**53


class LineFraming:
    """Frames as lines of text.

    Bytes go in, frames come out; what is not whole yet is remembered.

    Parameters
    ----------
    image_shape : (int, int)
        (n_rows, n_cols).
    checksum : bool, optional
        Whether to refuse lines that carry no checksum; wrong ones are always refused.
        By default they are refused once a line with a right one has come.

    Attributes
    ----------
    n_damaged : int
        Frames that came but were no good: at least so many. Of one that was cut and
        its line's end lost the next stands in the same line.
    n_missed : int
        Frames that never came, known only where they carry numbers: always 0.
    step : float
        The smallest difference that the numbers seen so far could show: 1, or 0.01
        once one had two decimals; 0 for numbers written with an exponent.
    """

    def __init__(
        self, image_shape: tuple[int, int], checksum: bool | None = None
    ) -> None:
        self.image_shape = image_shape
        self.checksum = checksum
        self.n_damaged = self.n_missed = 0
        self.step = 1.0
        self._begun = b""
        self._longest = _LONGEST_NUMBER * image_shape[0] * image_shape[1] + 8

    def feed(self, data: bytes) -> list[NDArray[np.float32]]:
        """Take in what arrived; return the frames that are whole now."""
        *lines, self._begun = (self._begun + data).split(b"\n")
        if len(self._begun) > self._longest:
            self._begun = b""
            self.n_damaged += 1
        frames = [self._frame(line.strip()) for line in lines if line.strip()]
        return [frame for frame in frames if frame is not None]

    def _frame(self, line: bytes) -> NDArray[np.float32] | None:
        """Return the frame at the end of a line; count those it has the rest of."""
        cut, _, last = line.rpartition(b"$")
        frame = self._whole(last, line[len(cut) : len(cut) + 1] == b"$")
        rest = line if frame is None else cut
        self.n_damaged += sum(bool(piece.strip()) for piece in rest.split(b"$"))
        return frame

    def _whole(self, line: bytes, begun: bool) -> NDArray[np.float32] | None:
        """Return what a line is, `begun` where it stood behind a `$`."""
        if begun:
            line, star, check = line.partition(b"*")
            if not star or not _is_check(check, line):
                return None
            if self.checksum is None:
                self.checksum = True
        elif self.checksum:
            return None
        try:
            values = [float(v) for v in line.replace(b",", b" ").split()]
            frame = np.array(values).reshape(self.image_shape)
        except ValueError:
            return None
        if np.isinf(frame).any() or np.nanmax(np.abs(frame), initial=0) > 3e38:
            return None
        if b"." in line or b"e" in line.lower():
            self.step = min(self.step, _step(line))
        return frame.astype(np.float32)


class BinaryFraming:
    """Frames as bytes, numbered, with a cyclic checksum.

    Parameters
    ----------
    image_shape : (int, int)
        (n_rows, n_cols), at most 255 each.
    dtype : dtype, default=uint16
        uint8, uint16, int16 or float32.

    Attributes
    ----------
    n_damaged, n_missed : int
        Frames that came but were no good, and frames that never came.
    """

    def __init__(
        self, image_shape: tuple[int, int], dtype: np.typing.DTypeLike = np.uint16
    ) -> None:
        code, kind = _TYPES[check_option("dtype", np.dtype(dtype).name, _TYPES)]
        n_rows, n_cols = image_shape
        if max(image_shape) > 255:
            raise ValueError(
                f"image_shape must be at most 255 x 255, got {n_rows} x {n_cols}. "
                "Send it as lines."
            )
        self.image_shape = image_shape
        self.n_damaged = self.n_missed = 0
        self._type = np.dtype(kind)
        self._expected = bytes((code, n_rows, n_cols))
        n_bytes = n_rows * n_cols * self._type.itemsize
        self._length = len(SYNC) + _HEAD.size + n_bytes + 2
        self._buffer = bytearray()
        self._last: int | None = None
        self._astray = False

    def feed(self, data: bytes) -> list[Array]:
        """Take in what arrived; return the frames that are whole now."""
        self._buffer += data
        frames: list[Array] = []
        while (start := self._buffer.find(SYNC)) >= 0:
            if start:
                self._skip(start)
            if not self._expected.startswith(bytes(self._buffer[2:5])):
                self._skip(1)
            elif len(self._buffer) < self._length:
                return frames
            elif (frame := self._frame(bytes(self._buffer[: self._length]))) is None:
                self._skip(1)
            else:
                self._astray = False
                frames.append(frame)
                del self._buffer[: self._length]
        self._skip(len(self._buffer) - self._buffer.endswith(SYNC[:1]))
        return frames

    def _skip(self, n_bytes: int) -> None:
        """Drop bytes that begin no frame; a run of them counts as one frame."""
        if n_bytes <= 0:
            return
        del self._buffer[:n_bytes]
        self.n_damaged += not self._astray
        self._astray = True

    def _frame(self, packet: bytes) -> Array | None:
        body, check = packet[2:-2], packet[-2:]
        if binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little") != check:
            return None
        taxels = np.frombuffer(body, self._type, offset=_HEAD.size)
        if self._type.kind == "f" and np.isinf(taxels).any():
            return None
        number = _HEAD.unpack_from(body)[3]
        gap = 0 if self._last is None else (number - self._last - 1) % 65536
        self.n_missed += gap if gap < _MANY_MISSED else 0
        self._last = number
        return taxels.reshape(self.image_shape)


def write_line(image: Array) -> bytes:
    """Return a frame as one line with its checksum."""
    values = ",".join(map(_digits, np.asarray(image).ravel().tolist())).encode()
    return b"$" + values + f"*{_exclusive_or(values):02X}\n".encode()


def _digits(value: float) -> str:
    """Return a number with all the digits that a taxel read as float32 can hold."""
    whole = isfinite(value) and value == int(value) and abs(value) < _LARGEST_WHOLE
    return str(int(value)) if whole else f"{value:.9g}"


def write_binary(image: Array, number: int = 0) -> bytes:
    """Return a frame as bytes; `number` counts frames."""
    image = np.asarray(image)
    code, kind = _TYPES[check_option("image.dtype", image.dtype.name, _TYPES)]
    body = _HEAD.pack(code, *image.shape, number % 65536)
    body += image.astype(kind).tobytes()
    return SYNC + body + binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")


def _step(line: bytes) -> float:
    """Return the place value of the last decimal in a line of numbers."""
    if b"e" in line.lower():
        return 0.0
    numbers = line.replace(b",", b" ").split()
    return 10.0 ** -max(len(number.partition(b".")[2]) for number in numbers)


def _is_check(written: bytes, values: bytes) -> bool:
    try:
        return len(written) == 2 and int(written, 16) == _exclusive_or(values)
    except ValueError:
        return False


def _exclusive_or(values: bytes) -> int:
    return int(np.bitwise_xor.reduce(np.frombuffer(values, np.uint8), initial=0))
