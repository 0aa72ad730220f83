"""A pressure array on a serial line."""

import errno
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from .._checks import check_count, check_option
from .._extras import needed
from .._types import Array
from ._contract import LiveSensor, SensorError
from ._framing import BinaryFraming, LineFraming

FRAMINGS = ("line", "binary")
_WAIT_S = 0.1
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
    checksum : bool, default=True
        With lines: whether to refuse lines without a checksum.
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
    No frame is dropped on this side while fewer than 1000 wait to be read.
    """

    queue_length = 1000

    def __init__(
        self,
        port: str,
        image_shape: tuple[int, int],
        *,
        framing: str = "line",
        baud: int = 115200,
        checksum: bool = True,
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
        serial = needed("serial", "serial", "A sensor on a serial port")
        try:
            self._serial = serial.Serial(
                self.port, self.baud, timeout=_WAIT_S, exclusive=True
            )
        except (serial.SerialException, ValueError, OSError) as error:
            raise SensorError(_cannot_open(self.port, error)) from error
        self._framing = self._new_framing()

    def _grab(self) -> Sequence[Array]:
        try:
            data = self._serial.read(max(1, self._serial.in_waiting))
        except (OSError, TypeError) as error:  # TypeError: closed while it waited
            raise SensorError(
                f"{self.port} went away. Plug the array in again."
            ) from error
        before = self._framing.n_damaged + self._framing.n_missed
        frames = self._framing.feed(data)
        after = self._framing.n_damaged + self._framing.n_missed
        self._count_missed(after - before)
        return frames

    def _close(self) -> None:
        if self._serial is not None:
            self._serial.close()
        self._serial = None


def _cannot_open(port: str, error: Exception) -> str:
    fix = _FIXES.get(getattr(error, "errno", None) or 0)
    if fix is None:
        from serial.tools.list_ports import comports

        there = ", ".join(found.device for found in comports())
        fix = f"There are: {there}." if there else "No serial port is plugged in."
    return f"The serial port {port} cannot be opened. {fix}"
