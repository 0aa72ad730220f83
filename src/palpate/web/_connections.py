"""How many connections may be open, how long a head may take, what the log repeats.

Nobody needs a token to connect. Of connections that have not shown it yet the oldest
gives way to the next, so that whoever has the token always comes in, and the files the
process may open are never used up. What goes wrong again and again is said once a
minute.
"""

import asyncio
import logging
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from uvicorn import Server
from uvicorn.protocols.http.h11_impl import H11Protocol

# A head that takes so long is given up.
_HEAD_S = 10.0
# Of the files that the process may open, this share may be connections without a token,
# and as much those with it; so many are accepted before any of them is looked at, and
# so many wait for that in the system.
_SHARE, _FILES, AT_ONCE, _QUEUE = 1 / 3, 1024, 32, 1024
_AGAIN_S, _MOST_SAID = 60.0, 1000
_LOGGERS = ("asyncio", "uvicorn.error")


class PatientProtocol(H11Protocol):
    """HTTP whose connections are bounded, as is the time that a head may take.

    uvicorn limits how long a connection may rest between two requests, not how long
    the first one, or one that was begun, may take. `RequestGuard` finds a connection
    in the state of its requests, and tells it by `signed_in` that the token was shown.
    """

    signed_in = False
    _ending: asyncio.TimerHandle | None = None

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.app_state = {**self.app_state, "connection": self}

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._made_s = self.loop.time()
        self._make_room()
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Go on waiting unless a request is whole, or a websocket by now."""
        super().data_received(data)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._wait(False)

    @property
    def _answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _make_room(self) -> None:
        """Close the oldest of the connections that wait, beyond what may be open."""
        waiting = [
            connection
            for connection in self.connections
            if isinstance(connection, PatientProtocol)
            and not connection._answering
            and not connection.transport.is_closing()
        ]
        for signed_in in (False, True):
            alike = [
                connection
                for connection in waiting
                if connection.signed_in == signed_in
            ]
            if len(alike) > most_waiting():
                min(alike, key=lambda connection: connection._made_s).transport.abort()

    def _wait(self, whether: bool = True) -> None:
        upgraded = self.transport.get_protocol() is not self
        if not whether or self._answering or upgraded:
            if self._ending is not None:
                self._ending.cancel()
            self._ending = None
        elif self._ending is None:
            self._ending = self.loop.call_later(_HEAD_S, self.transport.close)


def most_waiting() -> int:
    """Return how many connections of a kind may wait, by the limit of open files."""
    files = _FILES
    if sys.platform != "win32":
        import resource

        files = min(files, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    return int(files * _SHARE)


class PatientServer(Server):
    """A server that takes a few connections at a time from a long queue.

    asyncio has one number for both, and while it takes, nothing else goes on.
    """

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for listening in sockets or ():
            listening.listen(_QUEUE)


class SaidOnce(logging.Filter):
    """Lets a message through once a minute, by its first line."""

    def __init__(self) -> None:
        super().__init__()
        self._last_s: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the message was not said within the last minute."""
        message, now_s = record.getMessage().partition("\n")[0], time.monotonic()
        if now_s - self._last_s.get(message, -_AGAIN_S) < _AGAIN_S:
            return False
        if len(self._last_s) >= _MOST_SAID:
            self._last_s.clear()
        self._last_s[message] = now_s
        return True


@contextmanager
def saying_once() -> Iterator[None]:
    """Keep the log of a server from growing by one message again and again."""
    once = SaidOnce()
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    for logger in loggers:
        logger.addFilter(once)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(once)
