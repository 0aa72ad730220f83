"""A pressure array on a serial line: what its bytes are, and frames as lines or bytes.

**Lines**, which any microcontroller can print and people can read. One frame is one
line: all taxels row after row, separated by commas, spaces or tabs; numbers as
Python reads them, `nan` for a dead taxel. With a checksum the values stand between
`$` and `*`, and after `*` come two hexadecimal digits: the exclusive or of all bytes
between them (as in NMEA 0183)::

    $0,0,12,255*1D

**Bytes**, about a quarter as long and numbered: docs/reference/live.md has the layout.

Whatever is no frame is skipped: after garbage, or a frame that was cut or changed on
the way, the next whole frame is read.
"""

import binascii
import errno
import re
import struct
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, isqrt
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .._checks import check_count, check_option
from .._extras import needed
from .._types import Array
from ._contract import LiveSensor, SensorError

FRAMINGS = ("line", "binary")
_WAIT_S = 0.1  # for bytes, before looking whether to stop
# Without a frame for so long, so many bytes tell why; so long an array that is found by
# itself may take to write (many start again when their port is opened).
_SILENT_S, _MOST_UNREAD, _LISTEN_S = 1.0, 2**16, 5.0
_FIXES = {
    errno.EACCES: "You may not use it: join the group that owns it (often dialout).",
    errno.EBUSY: "Another program uses it; close that.",
    errno.EAGAIN: "Another program uses it; close that.",
}
SYNC = b"\xa5\x5a"
_HEAD = struct.Struct("<BBBH")
# Of each type of taxel its code in a frame, and how its bytes lie.
_TYPES = {"uint8": (1, "<u1"), "uint16": (2, "<u2")}
_TYPES |= {"int16": (3, "<i2"), "float32": (4, "<f4")}
_LONGEST_NUMBER = 32
_MANY_MISSED = 1000
_LARGEST_WHOLE = 2**53
_CODES = {code: name for name, (code, _) in _TYPES.items()}
_TEXT = re.compile(rb"[\t\r -~]*")
_CHECKED = re.compile(rb"\$[^$*\n]+\*[0-9A-Fa-f]{2}\s")
_BEGUN = re.compile(re.escape(SYNC) + rb"[\x01-\x04][^\0]{2}")
_LINES, _SHOWN = 2, 40


class SerialArraySensor(LiveSensor):
    """Frames of a pressure array that writes on a serial port.

    Parameters
    ----------
    port : str
        Such as `/dev/serial/by-id/...`, `/dev/ttyUSB0` or `COM3`.
    image_shape : (int, int)
        (n_rows, n_cols) of the array.
    framing : {"line", "binary"}, default="line"
        How frames are written; see `LineFraming` and `BinaryFraming`.
    baud : int, default=115200
        Bits per second. 16 x 16 taxels of 16 bits at 100 Hz need 521,000 (binary).
    checksum : bool, optional
        With lines: whether to refuse lines without a checksum; see `LineFraming`.
    dtype : dtype, default=uint16
        With bytes: the type of a taxel. Lines are read as float32.
    unit : str, default="count"
        What the numbers count.

    Attributes
    ----------
    step : float
        1 for whole numbers; of lines, what their decimals can show: see
        `LineFraming`.

    Notes
    -----
    While bytes come that are no frames, `lost` says why. Of lines without a checksum
    the first is left out: it may have been cut.
    No frame is dropped on this side while fewer than 1000 wait to be read.
    """

    queue_length = 1000
    image_shape: tuple[int, int]

    def __init__(
        self,
        port: str,
        image_shape: tuple[int, int],
        *,
        framing: str = "line",
        baud: int = 115200,
        checksum: bool | None = None,
        dtype: DTypeLike = np.uint16,
        unit: str = "count",
    ) -> None:
        check_option("framing", framing, FRAMINGS)
        kind = np.dtype(np.float32 if framing == "line" else dtype)
        super().__init__(f"array on {port}", unit, image_shape, kind, "array")
        self.port, self.framing = port, framing
        self.baud = check_count("baud", baud)
        self.checksum = checksum
        self._framing = self._new_framing()
        self._serial: Any = None
        self._unread, self._read_s, self._fresh = b"", 0.0, True

    def _new_framing(self) -> "LineFraming | BinaryFraming":
        if self.framing == "line":
            return LineFraming(self.image_shape, self.checksum)
        return BinaryFraming(self.image_shape, self.dtype)

    @property
    def step(self) -> float:
        """The smallest difference that its numbers can show; 0 where not known."""
        if isinstance(self._framing, LineFraming):
            return self._framing.step
        return 1.0 if self.dtype.kind in "iu" else 0.0

    def _open(self) -> None:
        self._serial = _open_port(self.port, self.baud)
        self._framing = self._new_framing()
        self._unread, self._read_s, self._fresh = b"", time.monotonic(), True

    def _grab(self) -> Sequence[Array]:
        data = _read(self._serial, self.port)
        before = self._framing.n_damaged + self._framing.n_missed
        frames = self._framing.feed(self._whole(data))
        after = self._framing.n_damaged + self._framing.n_missed
        self._count_missed(after - before)
        self._explain(data, bool(frames))
        return frames

    def _whole(self, data: bytes) -> bytes:
        """Return what came without a first line that may be cut."""
        if not self._fresh or self.framing != "line":
            return data
        first, ended, rest = data.partition(b"\n")
        self._fresh = not ended and b"$" not in first
        return data if b"$" in first else rest

    def _explain(self, data: bytes, good: bool) -> None:
        """Say in `lost` why no frames come though bytes do."""
        now_s = time.monotonic()
        if good:
            self._unread, self._read_s, self.lost = b"", now_s, ""
            return
        self._unread = (self._unread + data)[-_MOST_UNREAD:]
        if data and now_s - self._read_s > _SILENT_S:
            self._read_s, self.lost = now_s, self._why_no_frame(self._unread)

    def _why_no_frame(self, data: bytes) -> str:
        """Return why bytes are no frames as they are read, and the fix; or nothing."""
        seen, shape, dtype = layout_of(data), self.image_shape, self.dtype.name
        if seen is None:
            return ""
        if not seen.framing:
            return _why_neither(data)
        if seen.framing != self.framing:
            looks = "binary" if seen.framing == "binary" else "lines"
            return f"The bytes look like {looks}: `framing={seen.framing}`."
        expected = shape[0] * shape[1]
        if self.framing == "line" and seen.n_values == shape[1] < expected:
            return f"A line holds {shape[1]} values, as one row: write all rows in one."
        other = self.framing == "binary" and seen.shape != shape  # lines name no shape
        if seen.n_values != expected or other:
            return f"{seen.n_values} values, expected {expected}: {seen.shapes}."
        if self.framing == "binary":
            return f"Taxels are {seen.dtype}, expected {dtype}: `dtype={seen.dtype}`."
        if not seen.checksum and self.checksum is not False:
            return "The lines have no checksum: `checksum=no`."
        return ""

    def _close(self) -> None:
        if self._serial is not None:
            self._serial.close()
        self._serial = None


def find_array(port: str, baud: int = 115200) -> dict[str, Any]:
    """Return how an array writes, as arguments of `SerialArraySensor`, by listening."""
    looks, data, opened = None, b"", _open_port(port, baud)
    try:
        end_s = time.monotonic() + _LISTEN_S
        while (looks is None or not looks.framing) and time.monotonic() < end_s:
            data += _read(opened, port)
            looks = layout_of(data[-_MOST_UNREAD:])
    finally:
        opened.close()
    if looks is not None and looks.shape is not None:
        arguments = {"image_shape": looks.shape, "framing": looks.framing}
        line = looks.framing == "line"
        checked = {"checksum": looks.checksum}
        return arguments | (checked if line else {"dtype": looks.dtype})
    if looks is None:
        unclear = "Nothing whole came: check its cable, or give `shape`."
    elif not looks.framing:
        unclear = _why_neither(data[-_MOST_UNREAD:])
    else:
        unclear = f"Its lines have {looks.n_values} values: {looks.shapes}."
    raise SensorError(f"shape=auto did not find what {port} writes. {unclear}")


def _read(opened: Any, port: str) -> bytes:
    """Return the bytes that have come, waiting a moment for the first."""
    try:
        return bytes(opened.read(max(1, opened.in_waiting)))
    except (OSError, TypeError) as error:  # TypeError: closed while it waited
        gone = f"{port} went away. Plug the array in again."
        raise SensorError(gone) from error


def _open_port(port: str, baud: int) -> Any:
    serial = needed("serial", "serial", "A sensor on a serial port")
    try:
        return serial.Serial(port, baud, timeout=_WAIT_S, exclusive=True)
    except (serial.SerialException, ValueError, OSError) as error:
        fix = _FIXES.get(getattr(error, "errno", None) or 0)
        if fix is None:
            from serial.tools.list_ports import comports

            there = ", ".join(port_info.device for port_info in comports())
            fix = f"There are: {there}." if there else "No serial port is plugged in."
        raise SensorError(f"The serial port {port} cannot be opened. {fix}") from error


@dataclass(frozen=True)
class BytesLayout:
    """The writing of frames: `framing` "line" or "binary", "" where bytes are neither.

    Of lines `n_values` and whether they have a `checksum`, of binary frames `dtype`;
    `shape` (n_rows, n_cols) is None where a line may be of several.
    """

    framing: str
    n_values: int = 0
    checksum: bool = False
    dtype: str = "uint16"
    shape: tuple[int, int] | None = None

    @property
    def shapes(self) -> str:
        """Return what to write for the shape: the squarest that fits, and its turn."""
        if self.shape is not None:
            return f"`shape={self.shape[0]}x{self.shape[1]}`"
        n = self.n_values
        short = next(s for s in range(isqrt(n), 0, -1) if n % s == 0)
        both = dict.fromkeys((f"{short}x{n // short}", f"{n // short}x{short}"))
        return " or ".join(f"`shape={sides}`" for sides in both)


def layout_of(data: bytes) -> BytesLayout | None:
    """Return what bytes tell, None while there are too few."""
    return _binary(data) or _lines(data)


def _why_neither(data: bytes) -> str:
    """Return why bytes are neither lines nor frames, and the fix."""
    if len(_BEGUN.findall(data)) > 1:
        return (
            "The checksum of frames is wrong: after the taxels, the low byte first, "
            "CRC-16/CCITT-FALSE of all after A5 5A."
        )
    if _CHECKED.search(data):
        return (
            "The checksum of lines is wrong: after `*`, in two hexadecimal digits, the "
            "exclusive or of all bytes between `$` and `*`."
        )
    pieces = data.split(b"\n")
    line = pieces[-min(2, len(pieces))].strip()[:_SHOWN]  # the last one may be cut
    if line and _TEXT.fullmatch(line):
        return (
            f"Lines must be numbers with commas or blanks between, ended by a newline, "
            f"got {line.decode()!r}. Change what the array prints, or check `baud`."
        )
    return (
        "The bytes look neither like lines nor like frames: check `baud`, or say "
        "`framing=binary`."
    )


def _binary(data: bytes) -> BytesLayout | None:
    """Return what the first frame in bytes says whose checksum is right."""
    start = data.find(SYNC)
    while 0 <= start <= len(data) - len(SYNC) - _HEAD.size:
        code, n_rows, n_cols, _ = _HEAD.unpack_from(data, start + len(SYNC))
        if code in _CODES and n_rows and n_cols:
            shape = n_rows, n_cols
            if BinaryFraming(shape, _CODES[code]).feed(data[start:]):
                n_values = n_rows * n_cols
                return BytesLayout("binary", n_values, True, _CODES[code], shape)
        start = data.find(SYNC, start + 1)
    return None


def _lines(data: bytes) -> BytesLayout | None:
    """Return what whole lines say: the first and the last piece may be cut."""
    if len(data) > 64 and not _TEXT.fullmatch(data.replace(b"\n", b"")[-64:]):
        return BytesLayout("")
    lines = [line.strip() for line in data.split(b"\n")[1:-1] if line.strip()]
    if len(lines) < _LINES:
        return None if len(data) < _MOST_UNREAD else BytesLayout("")
    counts = Counter(map(_values, lines))
    (n_values, checksum), _ = counts.most_common(1)[0]
    if not n_values:
        return BytesLayout("")
    side = isqrt(n_values)
    shape = (side, side) if side**2 == n_values else None
    return BytesLayout("line", n_values, checksum, shape=shape)


def _values(line: bytes) -> tuple[int, bool]:
    """Return how many numbers a line holds, 0 for none, and whether it is checked."""
    text = line.rpartition(b"$")[2].partition(b"*")[0]
    n_values = len(text.replace(b",", b" ").split())
    for checked in (True, False):
        if LineFraming((1, max(1, n_values)), checked).feed(line + b"\n"):
            return n_values, checked
    return 0, False


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
            line, _, check = line.partition(b"*")
            if check.upper() != b"%02X" % _exclusive_or(line):
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

    @staticmethod
    def write(image: Array) -> bytes:
        """Return a frame as one line with its checksum."""
        values = ",".join(map(_digits, np.asarray(image).ravel().tolist())).encode()
        return b"$" + values + f"*{_exclusive_or(values):02X}\n".encode()


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

    @staticmethod
    def write(image: Array, number: int = 0) -> bytes:
        """Return a frame as bytes; `number` counts frames."""
        image = np.asarray(image)
        code, kind = _TYPES[check_option("image.dtype", image.dtype.name, _TYPES)]
        body = _HEAD.pack(code, *image.shape, number % 65536)
        body += image.astype(kind).tobytes()
        return SYNC + body + binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")


def _digits(value: float) -> str:
    """Return a number with all the digits that a taxel read as float32 can hold."""
    whole = isfinite(value) and value == int(value) and abs(value) < _LARGEST_WHOLE
    return str(int(value)) if whole else f"{value:.9g}"


def _step(line: bytes) -> float:
    """Return the place value of the last decimal in a line of numbers."""
    if b"e" in line.lower():
        return 0.0
    numbers = line.replace(b",", b" ").split()
    return 10.0 ** -max(len(number.partition(b".")[2]) for number in numbers)


def _exclusive_or(values: bytes) -> int:
    return int(np.bitwise_xor.reduce(np.frombuffer(values, np.uint8), initial=0))
