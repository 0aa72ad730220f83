"""Fingertips: Robotiq TSF-85, Paxini on its control box, XELA uSkin behind its server.

Written from public descriptions; none has met its hardware:

- **TSF-85** (Robotiq's `tactile_sensors`): 9A, a byte that nobody checks, a command, a
  length of at most 60, then parts: kind in the high four bits, finger in bits 2 and 3,
  big-endian values. Kind 1 is 7 x 4 taxels in rows. Command 58 asks for frames.
- **Paxini** GEN2-IP-L5325 (programs that several laboratories published; they agree):
  55 AA 7B 7B, address, command, length, data, the complement of their sum, 55 AA 7D 7D.
  The box is asked for 120 taxels of signed x, signed y and unsigned z, a byte each.
- **uSkin** (XELA's node for ROS 2): a websocket sends JSON; a sensor's `data` are its
  taxels' x, y and z, hexadecimal with commas.
"""

import json
import time
from contextlib import ExitStack
from typing import Any

import numpy as np

from palpate.sensors import LiveSensor, SensorError

from .serials import OpenPort, SerialStream, Skin

_STATIC, _SIZES = 1, {1: 56, 2: 2, 3: 6, 4: 6, 5: 6, 6: 2, 7: 2}
_HEAD, _TAIL = b"\x55\xaa\x7b\x7b", b"\x55\xaa\x7d\x7d"
_WAIT_S, _SILENT_S = 0.2, 2.0


class TSF85(SerialStream):
    """Robotiq TSF-85: arrays of 7 x 4 taxels side by side, a gap between fingers.

    `period_ms` is how often it sends, 1 to 255 ms.
    """

    def __init__(
        self,
        place: str,
        *,
        n_fingers: int = 2,
        period_ms: int = 1,
        baud: int = 115200,
        open_port: OpenPort | None = None,
    ) -> None:
        if not 1 <= n_fingers <= 4 or not 1 <= period_ms <= 255:
            raise ValueError(
                "n_fingers must be 1 to 4 and period_ms 1 to 255, got "
                f"{n_fingers} and {period_ms}."
            )
        described = (
            f"TSF-85 on {place}",
            "count",
            (7, 5 * n_fingers - 1),
            "f4",
            "array",
        )
        super().__init__(place, *described, baud=baud, open_port=open_port)
        self._period_ms = period_ms
        self._fingers: list[np.ndarray | None] = [None] * n_fingers

    def _open(self) -> None:
        super()._open()
        self._fingers = [None] * len(self._fingers)
        self._serial.write(bytes([0x9A, 0, 0x58, 1, self._period_ms]))

    def _cut(self) -> list[np.ndarray]:
        """Return a frame each time that the last finger has sent after the others."""
        frames, at, skipped = [], 0, 0
        while len(self._begun) - at >= 4:
            n_data = self._begun[at + 3]
            if self._begun[at] != 0x9A or n_data > 60:
                at, skipped = at + 1, skipped + 1
                continue
            if len(self._begun) - at < 4 + n_data:
                break
            parts = _parts(self._begun[at + 4 : at + 4 + n_data])
            if parts is None:
                at, skipped = at + 1, skipped + 1
                continue
            at += 4 + n_data
            for finger, taxels in parts:
                if finger < len(self._fingers):
                    self._fingers[finger] = taxels
            if self._fingers[-1] is not None:
                if all(taxels is not None for taxels in self._fingers):
                    frames.append(self._together())
                self._fingers = [None] * len(self._fingers)
        self._begun = self._begun[at:]
        self._count_missed(-(-skipped // 122))  # of two fingers
        return frames

    def _together(self) -> np.ndarray:
        frame = np.full(self.image_shape, np.nan, np.float32)
        for finger, taxels in enumerate(self._fingers):
            frame[:, 5 * finger : 5 * finger + 4] = taxels
        return frame


def _parts(data: bytes) -> list[tuple[int, np.ndarray]] | None:
    """Return fingers and their taxels in a packet; None for no packet."""
    parts, at = [], 0
    while at < len(data):
        kind, finger = data[at] >> 4, data[at] >> 2 & 3
        end = at + 1 + _SIZES.get(kind, len(data))
        if end > len(data):
            return None
        if kind == _STATIC:
            parts.append(
                (finger, np.frombuffer(data[at + 1 : end], ">u2").reshape(7, 4))
            )
        at = end
    return parts


class Paxini(Skin):
    """Paxini GEN2-IP-L5325: 120 taxels of a module, channels x, y and z.

    Where the taxels lie on its curved tip is not public: geometry "none". `module` is
    the number of its plug on the box; `mode` is what the box calls this kind of module.
    """

    def __init__(
        self,
        place: str,
        *,
        module: int = 1,
        mode: int = 5,
        baud: int = 460800,
        open_port: OpenPort | None = None,
    ) -> None:
        if not 1 <= module <= 85:
            raise ValueError(f"module must be 1 to 85, got {module}.")
        described = (f"Paxini on {place}", "count", (1, 120, 3), "i2", "none")
        super().__init__(place, *described, baud=baud, open_port=open_port)
        self.channels, self._module, self._mode = ("x", "y", "z"), module, mode
        self._n_bytes = 17 + 6 + 360
        self._asked_s = 0.0

    def _open(self) -> None:
        super()._open()
        plug = bytes([3 * (self._module - 1)])
        try:
            for high, low, data in (
                (0xC0, 0x0C, bytes([self._mode])),
                (0xB1, 0x0A, plug),
            ):
                self._serial.write(paxini_command(high, low, data))
                self._answered(17)
        except SensorError:
            self._close()
            raise
        self._asked_s = 0.0

    def _answered(self, n_bytes: int) -> None:
        answer = self._serial.read(n_bytes)
        if len(answer) < 10 or answer[:4] != _HEAD or answer[9]:
            raise SensorError(
                f"{self.name} must be a Paxini control box, got the answer "
                f"{answer.hex(' ') or 'none'}. Check port, baud, module and mode."
            )

    def _grab(self) -> list[np.ndarray]:
        now_s = time.monotonic()
        if not self._asked_s or now_s - self._asked_s > _SILENT_S:  # an answer was lost
            self._ask()
        frames = super()._grab()
        if frames:
            self._ask()
        return frames

    def _ask(self) -> None:
        """Ask for 360 bytes from address 1038 on."""
        self._asked_s = time.monotonic()
        self._serial.write(paxini_command(0xC0, 0x06, b"\x7b\x0e\x04\x68\x01"))

    def _frame(self, data: bytes) -> np.ndarray | None:
        if data[:4] != _HEAD or data[-4:] != _TAIL or data[9]:
            return None
        taxels = np.frombuffer(data[18:-5], "u1").reshape(1, 120, 3).astype(np.int16)
        taxels[..., :2] = taxels[..., :2].astype(np.uint8).view(np.int8)
        return taxels


def paxini_command(high: int, low: int, data: bytes) -> bytes:
    """Return the bytes of a command to a Paxini control box."""
    body = bytes([0x0E, 0, 0x70, high, low, len(data), 0]) + data
    return _HEAD + body + bytes([-sum(body) & 0xFF]) + _TAIL


class USkin(LiveSensor):
    """XELA uSkin: `image_shape` taxels in rows, channels x, y and z, of one sensor.

    `place` is HOST:PORT of XELA's server; `number` is the sensor's at that server. The
    order of taxels is taken to be row by row.
    """

    queue_length = 1000

    def __init__(
        self, place: str, *, image_shape: tuple[int, int] = (4, 4), number: int = 1
    ) -> None:
        described = (
            f"uSkin {number} at {place}",
            "count",
            (*image_shape, 3),
            "u2",
            "array",
        )
        super().__init__(*described)
        self.channels = ("x", "y", "z")
        self._where, self._key = f"ws://{place}", str(number)
        self._socket: Any = None
        self._opened = ExitStack()

    def _open(self) -> None:
        try:
            from websockets.exceptions import InvalidHandshake, InvalidURI
            from websockets.sync.client import connect
        except ImportError as error:
            raise SensorError(
                "uSkin needs websockets: pip install websockets"
            ) from error
        try:
            opened = connect(self._where, open_timeout=3, max_size=2**20)
            self._socket = self._opened.enter_context(opened)
        except (OSError, InvalidHandshake, InvalidURI) as error:
            raise SensorError(
                f"{self.name} cannot be reached: {error}. Start XELA's server there."
            ) from error

    def _grab(self) -> list[np.ndarray]:
        from websockets.exceptions import ConnectionClosed

        try:
            frame = self._frame(self._socket.recv(timeout=_WAIT_S))
        except TimeoutError:
            return []
        except ConnectionClosed as error:
            raise SensorError(
                f"{self.name} ended its stream. Start it again."
            ) from error
        if frame is None:
            self._count_missed(1)
            return []
        return frame

    def _frame(self, message: str | bytes) -> list[np.ndarray] | None:
        """Return the frame in a message, no frame in a greeting, None for none."""
        try:
            values = json.loads(message)
            if values["message"] == "Welcome":
                return []
            taxels = [int(word, 16) for word in values[self._key]["data"].split(",")]
            return [np.array(taxels, np.uint16).reshape(self.image_shape)]
        except (ValueError, TypeError, LookupError, AttributeError, OverflowError):
            return None

    def _close(self) -> None:
        self._opened.close()
