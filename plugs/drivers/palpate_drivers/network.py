"""Pressure arrays that send their frames over a network, as on a serial line.

Lines of numbers or binary frames (docs/reference/live.md has both) come in datagrams,
or in a stream to which palpate connects: `udp:0.0.0.0:9000?shape=16x16`,
`tcp:192.168.1.7:9000?shape=16x16&framing=binary`. Anybody in the network can send
datagrams: listen on an address of a network that you trust.
"""

import socket
from typing import Any

import numpy as np

from palpate.sensors import BinaryFraming, LineFraming, LiveSensor, SensorError

_WAIT_S, _CONNECT_S, _MOST = 0.2, 3.0, 65536


class NetworkArray(LiveSensor):
    """Frames from `place`, HOST:PORT, over UDP or TCP."""

    queue_length = 1000

    def __init__(
        self, kind: int, place: str, image_shape: tuple[int, int], framing: str
    ) -> None:
        host, _, port = place.rpartition(":")
        if not host or not port.isdigit() or int(port) > 65535:
            raise ValueError(f"place must be HOST:PORT, got {place!r}.")
        if framing not in ("line", "binary"):
            raise ValueError(f'framing must be "line" or "binary", got {framing!r}.')
        dtype = np.float32 if framing == "line" else np.uint16
        super().__init__(f"array at {place}", "count", image_shape, dtype, "array")
        self._kind, self._where = kind, (host, int(port))
        self._lines = framing == "line"
        self._socket: socket.socket | None = None
        self._framing: Any = None

    def _open(self) -> None:
        shape = self.image_shape[0], self.image_shape[1]
        self._framing = LineFraming(shape) if self._lines else BinaryFraming(shape)
        opened = socket.socket(socket.AF_INET, self._kind)
        try:
            if self._kind == socket.SOCK_DGRAM:
                opened.bind(self._where)
            else:
                opened.settimeout(_CONNECT_S)
                opened.connect(self._where)
        except OSError as error:
            opened.close()
            host, port = self._where
            raise SensorError(
                f"{self.name} cannot be reached: {error}. Check that {host} is right, "
                f"and that port {port} is free or served."
            ) from error
        opened.settimeout(_WAIT_S)
        self._socket = opened

    def _grab(self) -> list[np.ndarray]:
        assert self._socket is not None
        try:
            data = self._socket.recv(_MOST)
        except TimeoutError:
            return []
        except OSError as error:
            raise SensorError(f"{self.name} went away: {error}.") from error
        if not data and self._kind == socket.SOCK_STREAM:
            raise SensorError(f"{self.name} ended its stream. Start it again.")
        before = self._framing.n_damaged + self._framing.n_missed
        frames: list[np.ndarray] = self._framing.feed(data)
        self._count_missed(self._framing.n_damaged + self._framing.n_missed - before)
        return frames

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None


def udp(
    place: str, *, image_shape: tuple[int, int], framing: str = "line"
) -> NetworkArray:
    """Return an array that sends datagrams to this machine; `place` is what to bind."""
    return NetworkArray(socket.SOCK_DGRAM, place, image_shape, framing)


def tcp(
    place: str, *, image_shape: tuple[int, int], framing: str = "line"
) -> NetworkArray:
    """Return an array that serves a stream at `place`."""
    return NetworkArray(socket.SOCK_STREAM, place, image_shape, framing)
