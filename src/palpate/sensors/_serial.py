"""A pressure array on a serial line."""

import errno
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from .._checks import check_count, check_option
from .._extras import needed
from .._types import Array
from ._bytes_told import BytesTold, told_by, why_no_frame
from ._contract import LiveSensor, SensorError
from ._framing import BinaryFraming, LineFraming

FRAMINGS = ("line", "binary")
_WAIT_S = 0.1
# Without a frame for so long, so many bytes tell why; so long an array that is found by
# itself may take to write (many start again when their port is opened).
_SILENT_S, _MOST_TOLD, _LISTEN_S = 1.0, 2**16, 5.0
_FIXES = {
    errno.EACCES: "You may not use it: join the group that owns it (often dialout).",
    errno.EBUSY: "Another program uses it; close that.",
    errno.EAGAIN: "Another program uses it; close that.",
}


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
        self._told, self._read_s, self._fresh = b"", 0.0, True

    def _new_framing(self) -> LineFraming | BinaryFraming:
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
        self._told, self._read_s, self._fresh = b"", time.monotonic(), True

    def _grab(self) -> Sequence[Array]:
        try:
            data = self._serial.read(max(1, self._serial.in_waiting))
        except (OSError, TypeError) as error:  # TypeError: closed while it waited
            raise SensorError(
                f"{self.port} went away. Plug the array in again."
            ) from error
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
            self._told, self._read_s, self.lost = b"", now_s, ""
            return
        self._told = (self._told + data)[-_MOST_TOLD:]
        if data and now_s - self._read_s > _SILENT_S:
            self._read_s = now_s
            self.lost = why_no_frame(
                self._told,
                self.framing,
                self.image_shape,
                self.dtype.name,
                self.checksum,
            )

    def _close(self) -> None:
        if self._serial is not None:
            self._serial.close()
        self._serial = None


def find_array(port: str, baud: int = 115200) -> dict[str, Any]:
    """Return how an array writes, as arguments of `SerialArraySensor`, by listening.

    Raises
    ------
    SensorError
        Nothing comes, or it does not tell the shape; says what to give.
    """
    told, data, opened = None, b"", _open_port(port, baud)
    try:
        end_s = time.monotonic() + _LISTEN_S
        while (told is None or not told.framing) and time.monotonic() < end_s:
            data += opened.read(max(1, opened.in_waiting))
            told = told_by(data[-_MOST_TOLD:])
    finally:
        opened.close()
    if told is not None and told.shape is not None:
        found = {"image_shape": told.shape, "framing": told.framing}
        line = told.framing == "line"
        return found | ({"checksum": told.checksum} if line else {"dtype": told.dtype})
    raise SensorError(f"shape=auto did not find what {port} writes. {_unclear(told)}")


def _unclear(told: BytesTold | None) -> str:
    if told is None:
        return "Nothing whole came: check its cable, or give --shape."
    if not told.framing:
        return "Its bytes are neither lines nor frames: check --baud."
    return f"Its lines have {told.n_values} values: {told.shapes}."


def _open_port(port: str, baud: int) -> Any:
    serial = needed("serial", "serial", "A sensor on a serial port")
    try:
        return serial.Serial(port, baud, timeout=_WAIT_S, exclusive=True)
    except (serial.SerialException, ValueError, OSError) as error:
        raise SensorError(_cannot_open(port, error)) from error


def _cannot_open(port: str, error: Exception) -> str:
    fix = _FIXES.get(getattr(error, "errno", None) or 0)
    if fix is None:
        from serial.tools.list_ports import comports

        there = ", ".join(found.device for found in comports())
        fix = f"There are: {there}." if there else "No serial port is plugged in."
    return f"The serial port {port} cannot be opened. {fix}"
