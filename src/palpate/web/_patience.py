"""HTTP that hangs up on clients that begin a request and never end its head.

uvicorn limits how long a connection may rest between two requests, not how long the
first one, or one that was begun, may take.
"""

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_S = 10.0


class PatientProtocol(H11Protocol):
    """Waits `HEAD_S` seconds for the head of a request."""

    _ending: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait."""
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Go on waiting unless a request is whole, or a websocket by now."""
        super().data_received(data)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        super().connection_lost(exc)
        self._wait(False)

    def _wait(self, whether: bool = True) -> None:
        asked = self.cycle is not None and not self.cycle.response_complete
        if not whether or asked or self.transport.get_protocol() is not self:
            if self._ending is not None:
                self._ending.cancel()
            self._ending = None
        elif self._ending is None:
            self._ending = self.loop.call_later(HEAD_S, self.transport.close)
