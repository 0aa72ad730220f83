"""Skins on a serial port: AnySkin and ReSkin (magnetometers), FlexiTac (an array).

Written from the public descriptions of what their boards send:

- **AnySkin, ReSkin**: of each magnetometer temperature, x, y and z, little-endian
  float32, then a carriage return and a line feed; 115,200 bits a second.
- **FlexiTac**: AA 55, then 12 rows of 32 taxels, one byte each; 2,000,000 bits/s.

Neither has a checksum. A frame counts only when what must follow it follows: the
line's end, the next frame's beginning; what does not fit is skipped and counted.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np

from palpate.sensors import LiveSensor, SensorError

_WAIT_S = 0.1
OpenPort = Callable[[str, int], Any]


class SerialStream(LiveSensor):
    """Base of sensors that write bytes on a serial port.

    `open_port` returns an object like `serial.Serial`, for tests.
    """

    queue_length = 1000

    def __init__(
        self, place: str, *described: Any, baud: int, open_port: OpenPort | None
    ) -> None:
        super().__init__(*described)
        self.port, self.baud = place, baud
        self._open_port = open_port or _opened
        self._serial: Any = None
        self._begun = b""

    @abstractmethod
    def _cut(self) -> list[np.ndarray]:
        """Take whole frames from what has begun to come, `_begun`."""

    def _open(self) -> None:
        self._serial, self._begun = self._open_port(self.port, self.baud), b""

    def _grab(self) -> list[np.ndarray]:
        try:
            data = self._serial.read(max(1, self._serial.in_waiting))
        except (OSError, TypeError) as error:
            raise SensorError(f"{self.port} went away. Plug it in again.") from error
        self._begun += data
        return self._cut()

    def _close(self) -> None:
        if self._serial is not None:
            self._serial.close()
        self._serial = None


class Skin(SerialStream):
    """Base of those whose frames have one length."""

    _n_bytes: int  # of a frame, with what marks it

    @abstractmethod
    def _frame(self, data: bytes) -> np.ndarray | None:
        """Return the frame in so many bytes, None where they are none."""

    def _cut(self) -> list[np.ndarray]:
        frames, at, skipped = [], 0, 0
        while len(self._begun) - at >= self._n_bytes:
            frame = self._frame(self._begun[at : at + self._n_bytes])
            if frame is None:
                at, skipped = at + 1, skipped + 1
                continue
            frames.append(frame)
            at += self._step
        self._begun = self._begun[at:]
        self._count_missed(-(-skipped // self._n_bytes))
        return frames

    @property
    def _step(self) -> int:
        """How far the next frame begins after one."""
        return self._n_bytes


class MagneticSkin(Skin):
    """AnySkin or ReSkin: `n_magnets` magnetometers in a row, channels x, y and z."""

    def __init__(
        self,
        place: str,
        *,
        n_magnets: int = 5,
        baud: int = 115200,
        open_port: OpenPort | None = None,
    ) -> None:
        shape = (1, n_magnets, 3)
        described = (f"magnetic skin on {place}", "microtesla", shape, "f4", "none")
        super().__init__(place, *described, baud=baud, open_port=open_port)
        self.channels = ("x", "y", "z")
        self._n_bytes = 16 * n_magnets + 2

    def _frame(self, data: bytes) -> np.ndarray | None:
        values = np.frombuffer(data[:-2], "<f4").reshape(1, -1, 4)
        # Bytes that are read from the wrong place are huge, tiny or no numbers; flux
        # beyond 0.1 T saturates the chips, and their temperature is what skin bears.
        good = np.isfinite(values).all() and np.abs(values).max() < 1e5
        return values[..., 1:].astype("f4") if data[-2:] == b"\r\n" and good else None


class FlexiTac(Skin):
    """FlexiTac: an array of 12 x 32 taxels, or as many as its firmware was made for."""

    def __init__(
        self,
        place: str,
        *,
        image_shape: tuple[int, int] = (12, 32),
        baud: int = 2_000_000,
        open_port: OpenPort | None = None,
    ) -> None:
        described = (f"FlexiTac on {place}", "count", image_shape, "u1", "array")
        super().__init__(place, *described, baud=baud, open_port=open_port)
        self._n_bytes = image_shape[0] * image_shape[1] + 4

    def _frame(self, data: bytes) -> np.ndarray | None:
        if data[:2] != b"\xaa\x55" or data[-2:] != b"\xaa\x55":
            return None
        return np.frombuffer(data[2:-2], "u1").reshape(self.image_shape)

    @property
    def _step(self) -> int:
        return self._n_bytes - 2  # the next one begins with the mark that ends this


def _opened(port: str, baud: int) -> Any:
    try:
        import serial
    except ImportError as error:
        raise SensorError(
            'A skin on a serial port needs pyserial: pip install "palpate[serial]"'
        ) from error
    try:
        return serial.Serial(port, baud, timeout=_WAIT_S, exclusive=True)
    except (serial.SerialException, ValueError, OSError) as error:
        raise SensorError(
            f"The serial port {port} cannot be opened: {error}. Check that it is "
            "plugged in, that you may use it, and that no other program does."
        ) from error
