"""Many pages at once: where one stops reading, the others get all their frames."""

import json
import socket
import threading
import time
from contextlib import suppress

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from palpate.library import LibraryError

from .conftest import Event, waited

N_CLIENTS = 20


def opened(address, token):
    """Open a websocket as the page does."""
    return connect(address.replace("http", "ws") + f"/ws?token={token}", max_size=None)


def frame_headers(address, token, seconds):
    """Read a websocket for some seconds; return the headers of its frames."""
    headers = []
    with opened(address, token) as page:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                message = page.recv(timeout=left)
            except TimeoutError:
                break
            if isinstance(message, bytes):
                length = int.from_bytes(message[:4], "big")
                headers.append(json.loads(message[4 : 4 + length]))
    return headers


def stopped_reader(address, token):
    """Open a websocket by hand and never read from it."""
    host, port = address.removeprefix("http://").split(":")
    raw = socket.create_connection((host, int(port)))
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    raw.sendall(
        f"GET /ws?token={token} HTTP/1.1\r\nHost: {host}:{port}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
    )
    return raw


@pytest.mark.slow
def test_twenty_pages_one_that_stops_reading_and_one_that_sends_much(
    make_session, serving
):
    session, refused = make_session(rate_hz=60.0), []
    rows = [[0.25] * 2000] * 1300  # 15 MB of JSON, of a size that is refused at last
    much = json.dumps({"image": rows}).encode()
    with serving(session) as (address, token):
        slow = stopped_reader(address, token)
        bearer = {"Authorization": f"Bearer {token}"}
        posting = threading.Thread(
            target=lambda: refused.append(
                httpx.post(
                    f"{address}/api/touch", content=much, headers=bearer, timeout=60
                )
            )
        )
        posting.start()
        pages = []
        readers = [
            threading.Thread(
                target=lambda: pages.append(frame_headers(address, token, 3.0))
            )
            for _ in range(N_CLIENTS)
        ]
        for reader in readers:
            reader.start()
        for reader in readers:
            reader.join(20)
        posting.join(60)
        slow.close()
    assert "must have 12 x 12 taxels, got 1300 x 2000" in refused[0].text
    assert len(pages) == N_CLIENTS
    for headers in pages:
        numbers = [frame["number"] for frame in headers]
        assert numbers == sorted(set(numbers))  # no frame twice or out of order
        # 30 a second are offered for up to 3 s; a busy machine opens sockets slowly.
        assert len(headers) >= 15
    assert session.watch.sensor.n_dropped == 0


def test_a_client_that_never_reads_is_let_go(make_session, serving, monkeypatch, lower):
    lower(monkeypatch, browser_patience_s=0.3)
    session = make_session()
    with serving(session) as (address, token):
        slow = stopped_reader(address, token)
        assert waited(lambda: len(session.listeners) == 1)
        for _ in range(400):  # states of some kilobytes fill every buffer there is
            session.listeners.notify(Event("state", {"message": "x" * 40_000}))
            time.sleep(0.002)
        assert waited(lambda: not len(session.listeners))
        slow.close()


def test_a_page_that_leaves_is_forgotten(make_session, serving):
    session = make_session()
    with serving(session) as (address, token):
        assert frame_headers(address, token, 0.5)
        assert waited(lambda: not len(session.listeners))


def test_a_page_that_cannot_be_told_the_state_is_forgotten(
    make_session, serving, monkeypatch, lower
):
    lower(monkeypatch, browsers=1)
    session, library = make_session(sensor=False), []

    def damaged():
        library.append("read")
        raise LibraryError("The library is damaged.")

    with serving(session) as (address, token):
        with monkeypatch.context() as patched:
            patched.setattr(session.teacher.library, "objects", damaged)
            for _ in range(2):
                with suppress(ConnectionClosed), opened(address, token) as page:
                    page.recv(timeout=5)
                assert waited(lambda: not len(session.listeners))
        assert len(library) == 2
        with opened(address, token) as page:
            assert json.loads(page.recv(timeout=5))["kind"] == "state"


@pytest.mark.parametrize("message", ["ping", "{}", "x" * 1000])
def test_a_message_of_a_page_does_no_harm(make_session, serving, message):
    with serving(make_session(sensor=False)) as server, opened(*server) as page:
        assert json.loads(page.recv())["kind"] == "state"
        page.send(message)
        page.send("ping")
        assert json.loads(page.recv(timeout=5))["kind"] == "pong"
