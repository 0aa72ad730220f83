"""From the session's threads to the websockets of pages, none waiting for another.

Every client has a place for one frame, the newest, and a short queue for all else.
One that stops reading misses frames; when its queue is full it is let go.
"""

import asyncio
from collections import deque
from contextlib import suppress

from starlette.websockets import WebSocket, WebSocketDisconnect

from ._events import Event
from ._session import LiveSession

_LONGEST_QUEUE = 200
_PATIENCE_S = 10.0
MOST_CLIENTS = 64


class Hub:
    """Hands events of a session to all its websockets."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self._clients: set[_Client] = set()

    async def serve(self, socket: WebSocket) -> None:
        """Send one client everything until it goes."""
        if len(self._clients) >= MOST_CLIENTS:
            await socket.close(code=1013, reason="Too many pages are open.")
            return
        await socket.accept()
        client = _Client(socket, asyncio.get_running_loop())
        self._clients.add(client)
        self._session.listeners.add(client.receive)
        state = await asyncio.to_thread(self._session.to_dict)
        await asyncio.to_thread(client.receive, Event("state", state))
        listening = asyncio.create_task(client.listen())
        sending = asyncio.create_task(client.send())
        try:
            await asyncio.wait(
                (listening, sending), return_when=asyncio.FIRST_COMPLETED
            )
        finally:
            self._session.listeners.discard(client.receive)
            self._clients.discard(client)
            for task in (listening, sending):
                task.cancel()
            await asyncio.gather(listening, sending, return_exceptions=True)
            with suppress(RuntimeError, TimeoutError, WebSocketDisconnect):
                async with asyncio.timeout(1.0):
                    await socket.close()


class _Client:
    def __init__(self, socket: WebSocket, loop: asyncio.AbstractEventLoop) -> None:
        self._socket, self._loop = socket, loop
        self._frame: Event | None = None
        self._waiting: deque[Event] = deque()
        self._some = asyncio.Event()
        self._full = False

    def receive(self, event: Event) -> None:
        """Take an event from another thread, where its text is written too."""
        _ = event.text
        self._loop.call_soon_threadsafe(self.put, event)

    def put(self, event: Event) -> None:
        """Keep an event until it is sent; a newer frame takes the place of one."""
        if event.kind == "frame":
            self._frame = event
        elif len(self._waiting) < _LONGEST_QUEUE:
            self._waiting.append(event)
        else:
            self._full = True
        self._some.set()

    async def send(self) -> None:
        """Send what there is, as it comes; end where the client is too slow."""
        while not self._full:
            await self._some.wait()
            self._some.clear()
            while self._waiting:
                await self._send_one(self._waiting.popleft())
            frame, self._frame = self._frame, None
            if frame is not None:
                await self._send_one(frame)

    async def listen(self) -> None:
        """Read until the client goes; "ping" is answered, all else ignored."""
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if message.get("text") == "ping":
                self.put(Event("pong"))

    async def _send_one(self, event: Event) -> None:
        async with asyncio.timeout(_PATIENCE_S):
            if not event.picture:
                await self._socket.send_text(event.text)
                return
            text = event.text.encode()
            length = len(text).to_bytes(4, "big")
            await self._socket.send_bytes(length + text + event.picture)
