"""The longest gap between frames of a page, beside nineteen other clients.

`python benchmarks/page_clients.py [--seconds 10]`; needs the extra `web`. A server in a
process of its own shows a replayed camera, 480 x 640 at 30 frames a second. Of twenty
clients eighteen read, one has stopped reading, and one does nothing for the first half
and then sends 16 MB of JSON, over and over. Printed as JSON: for each half the longest
gap between two frames that reached any of the eighteen, the median over the eighteen
of their longest gaps, and the load of the machine.
"""

import argparse
import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from websockets.asyncio.client import connect

from palpate import Touches

N_READING = 18
MOST_BYTES = 16 * 2**20


def recording(place: Path) -> Path:
    """Write drawn touches to be replayed."""
    rng = np.random.default_rng(0)
    rows, cols = np.mgrid[:480, :640]
    centres = rng.uniform([150, 200], [330, 440], (12, 2))
    spots = [np.hypot(rows - row, cols - col) < 60 for row, col in centres]
    images = 90 + 80 * np.array(spots) + rng.integers(0, 8, (12, 480, 640))
    no_contact = np.full((480, 640), 90, np.uint8)
    touches = Touches(
        images.astype(np.uint8), object=["spot"] * 12, no_contact=no_contact
    )
    touches.save(place / "t.npz")
    return place / "t.npz"


def stopped(port: int, token: str) -> socket.socket:
    """Open a websocket by hand that is never read."""
    raw = socket.create_connection(("127.0.0.1", port))
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    raw.sendall(
        f"GET /ws?token={token} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
    )
    return raw


async def read(address: str, until_s: float) -> list[float]:
    """Return when each frame arrived."""
    times: list[float] = []
    async with connect(address, max_size=None) as page:
        while (left_s := until_s - time.monotonic()) > 0:
            try:
                message = await asyncio.wait_for(page.recv(), left_s)
            except TimeoutError:
                break
            if isinstance(message, bytes):
                times.append(time.monotonic())
    return times


def send(address: str, token: str, from_s: float, until_s: float) -> int:
    """Send JSON of nearly 16 MB again and again; return how often it was answered."""
    row = json.dumps([0.125] * 2000)
    count = MOST_BYTES // (len(row) + 2) - 1
    body = ('{"image": [' + ", ".join([row] * count) + "]}").encode()
    time.sleep(max(0.0, from_s - time.monotonic()))
    bearer, answered = {"Authorization": f"Bearer {token}"}, 0
    while time.monotonic() < until_s:
        answer = httpx.post(address, content=body, headers=bearer, timeout=60)
        assert answer.status_code == 422, answer.text
        answered += 1
    return answered


async def watch(base: str, token: str, seconds: float) -> dict[str, Any]:
    """Let all clients work, and measure the gaps of the reading ones."""
    began_s = time.monotonic() + 3.0  # by then all are connected
    middle_s, end_s = began_s + seconds, began_s + 2 * seconds
    page = base.replace("http", "ws") + f"/ws?token={token}"
    reading = [read(page, end_s) for _ in range(N_READING)]
    loop = asyncio.get_running_loop()
    with ProcessPoolExecutor(1) as other:  # its work must not hold up the readers
        arguments = f"{base}/api/touch", token, middle_s, end_s
        sending = loop.run_in_executor(other, send, *arguments)
        *times, answered = await asyncio.gather(*reading, sending)
    figures: dict[str, Any] = {
        "n_bodies_answered": answered,
        "load": os.getloadavg()[0],
    }
    for name, start, end in (("alone", began_s, middle_s), ("json", middle_s, end_s)):
        of_all = [
            np.array([t for t in arrivals if start <= t <= end]) for arrivals in times
        ]
        gaps_ms = [float(1e3 * np.diff(arrivals).max()) for arrivals in of_all]
        figures[name] = {
            "longest_gap_ms": max(gaps_ms),
            "median_of_longest_ms": float(np.median(gaps_ms)),
            "frames_per_s": float(
                np.mean([len(arrivals) / seconds for arrivals in of_all])
            ),
        }
    return figures


def main() -> None:
    """Start the server, measure, stop it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        sensor = f"replay:{recording(Path(place))}?rate=30"
        words = ["-m", "palpate", "serve", "--sensor", sensor, "--port", "0", "--json"]
        server = subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE)
        try:
            assert server.stdout is not None
            answer = json.loads(server.stdout.readline())
            base, token = answer["address"].rstrip("/"), answer["token"]
            slow = stopped(int(base.rsplit(":", 1)[1]), token)
            print(
                json.dumps(asyncio.run(watch(base, token, options.seconds)), indent=1)
            )
            slow.close()
        finally:
            server.terminate()
            server.wait(10)


if __name__ == "__main__":
    main()
