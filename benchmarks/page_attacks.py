"""What an owner's page is refused while others use the server up.

`python benchmarks/page_attacks.py [--seconds 20] [--only NAME]`; needs the extra `web`.
A server in a process of its own, which may open 1,024 files, listens on 127.0.0.1. Its
owner opens the page's websocket, teaches two drawn objects, learns, and recognises,
while one of these goes on, then all of them:

- `idle`: 1,300 connections that say nothing, opened anew where they are closed;
- `scans`: eight progressive JPEGs of 20,000 scans, sent with the token;
- `racing`: sixteen threads with the token that read, teach, undo and learn;
- `refused`: four threads that ask without the token, as fast as they are answered.

Printed as JSON: for each how many of the owner's requests were refused (answered with
400 or more, or not within 20 s), their median and longest seconds (of the clock: they
say whether something hangs, no more), what the server wrote to its log, its CPU
seconds, and its largest memory. With another `PYTHONPATH` it measures another revision.
"""

import argparse
import json
import resource
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import httpx
import numpy as np
from websockets.sync.client import connect

FILES, N_IDLE, N_BOMBS, N_RACING, N_REFUSED, N_SCANS = 1024, 1300, 8, 16, 4, 20_000
SIDE, PATIENCE_S = 12, 20.0
WORDS = ["-m", "palpate", "serve", "--port", "0", "--json"]
STARTED = f"""
import resource, runpy
resource.setrlimit(resource.RLIMIT_NOFILE, ({FILES}, {FILES}))
runpy.run_module("palpate", run_name="__main__")
"""


def scan_bomb(n_scans: int, side: int = 2000) -> bytes:
    """Return a small JPEG that takes its decoder long: empty scans of many blocks."""
    grey = np.full((side, side), 90, np.uint8)
    coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    n_blocks = (-(-side // 8)) ** 2
    end_of_bands, one_zero = bytes([0, 2, *[0] * 14, 0xE0, 0]), bytes([1, *[0] * 16])
    tables = b"\xff\xc4\x00\x15\x10" + end_of_bands + b"\xff\xc4\x00\x14\x00" + one_zero
    first = b"\xff\xda\x00\x08\x01\x01\x00\x00\x00\x00" + bytes(-(-n_blocks // 8))
    empty = bytes(2 * -(-n_blocks // 2**14))
    more = b"\xff\xda\x00\x08\x01\x01\x00\x01\x3f\x00" + empty
    head = coded[: coded.index(b"\xff\xda")]
    return head + tables + first + more * n_scans + b"\xff\xd9"


def drawn(name: str, rng: np.random.Generator) -> list[list[float]]:
    """Return one press of a disc or a bar."""
    row, col = np.mgrid[:SIDE, :SIDE]
    y, x = rng.uniform(4, 7, 2)
    disc, bar = np.hypot(row - y, col - x) < 3.2, abs(row - y) < 1.2
    image = 150 * (disc if name == "disc" else bar) + rng.normal(0, 3, (SIDE, SIDE))
    return np.round(image, 1).tolist()


class Attack:
    """Threads that work against a server until they are told to end."""

    def __init__(self, base: str, token: str) -> None:
        self.base, self.bearer = base, {"Authorization": f"Bearer {token}"}
        self.place = urlsplit(base).hostname, urlsplit(base).port
        self.over = threading.Event()
        self.threads: list[threading.Thread] = []

    def start(self, work: Callable[[int], None], count: int = 1) -> None:
        """Let some threads do a piece of work again and again."""

        def again(number: int) -> None:
            while not self.over.is_set():
                with suppress(httpx.HTTPError, OSError):
                    work(number)

        for number in range(count):
            thread = threading.Thread(target=again, args=(number,), daemon=True)
            thread.start()
            self.threads.append(thread)

    def end(self) -> None:
        """Stop all threads; those that hang go with the server."""
        self.over.set()
        for thread in self.threads:
            thread.join(1.0)


def idle(attack: Attack) -> None:
    """Hold connections that say nothing."""
    held: list[socket.socket] = []

    def hold(_: int) -> None:
        for connection in [*held]:
            with suppress(BlockingIOError):
                connection.setblocking(False)
                if not connection.recv(1):  # the server has closed it
                    connection.close()
                    held.remove(connection)
        while len(held) < N_IDLE and not attack.over.is_set():
            held.append(socket.create_connection(attack.place, timeout=1.0))
        attack.over.wait(0.5)

    attack.start(hold)


def scans(attack: Attack) -> None:
    """Send pictures of very many scans."""
    bomb, kind = scan_bomb(N_SCANS), {"Content-Type": "image/jpeg"}

    def send(_: int) -> None:
        where = f"{attack.base}/api/touch/picture"
        headers = {**attack.bearer, **kind}
        httpx.post(where, content=bomb, headers=headers, timeout=300)
        attack.over.wait(0.5)

    attack.start(send, N_BOMBS)


def racing(attack: Attack) -> None:
    """Read and change what the owner reads and changes, ten times a second each."""
    rng = np.random.default_rng(3)
    requests: list[tuple[str, str, Any]] = [
        ("GET", "/api/state", None),
        ("GET", "/api/episode", None),
        ("POST", "/api/teach/undo", {}),
        ("POST", "/api/learn", {}),
        ("GET", "/api/objects/touches?object=disc", None),
        ("POST", "/api/teach/touch", {"object": "other", "image": drawn("bar", rng)}),
    ]
    clients = [httpx.Client(base_url=attack.base, timeout=30) for _ in range(N_RACING)]

    def ask(number: int) -> None:
        method, path, body = requests[number % len(requests)]
        clients[number].request(method, path, json=body, headers=attack.bearer)
        attack.over.wait(0.1)

    attack.start(ask, N_RACING)


def refused(attack: Attack) -> None:
    """Ask without the token as fast as answers come."""
    attack.start(lambda _: _request(attack), N_REFUSED)


def _request(attack: Attack) -> None:
    with socket.create_connection(attack.place, timeout=5.0) as connection:
        connection.sendall(b"GET /api/state HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        connection.recv(65536)


ATTACKS = {"idle": idle, "scans": scans, "racing": racing, "refused": refused}


class Owner:
    """Teaches, learns and recognises; counts what is refused."""

    def __init__(self, base: str, token: str) -> None:
        headers = {"Authorization": f"Bearer {token}"}
        self.ask = httpx.Client(base_url=base, headers=headers, timeout=PATIENCE_S)
        self.page = f"{base.replace('http', 'ws')}/ws?token={token}"
        self.rng = np.random.default_rng(1)
        self.seconds: list[float] = []
        self.refusals: list[str] = []

    def post(self, path: str, body: dict[str, Any]) -> None:
        """Send one request, as an owner whose browser opens a connection for it."""
        began = time.monotonic()
        try:
            answer = self.ask.post(path, json=body, headers={"Connection": "close"})
            if answer.status_code >= 400:
                self.refusals.append(f"{answer.status_code} {answer.text[:80]}")
        except httpx.HTTPError as error:
            self.refusals.append(type(error).__name__)
        self.seconds.append(time.monotonic() - began)

    def open_page(self) -> None:
        """Open the page's websocket and wait for the state it begins with."""
        began = time.monotonic()
        try:
            with connect(self.page, open_timeout=PATIENCE_S) as page:
                page.recv(PATIENCE_S)
        except Exception as error:  # a dozen kinds, all of them a refusal
            self.refusals.append(f"websocket: {type(error).__name__}")
        self.seconds.append(time.monotonic() - began)

    def work(self, until_s: float) -> None:
        """Teach, look, recognise, at most until then."""
        while time.monotonic() < until_s:
            for name in ("disc", "bar"):
                image = drawn(name, self.rng)
                self.post("/api/teach/touch", {"object": name, "image": image})
            self.open_page()
            self.post("/api/touch", {"image": drawn("disc", self.rng)})


def measured(names: list[str], seconds: float) -> dict[str, Any]:
    """Return what the owner of a new server met under some attacks."""
    with tempfile.TemporaryDirectory() as place, ExitStack() as stack:
        log = stack.enter_context((Path(place) / "log").open("w+b"))
        words = [sys.executable, "-c", STARTED, *WORDS[2:]]
        words += ["--library", f"{place}/library"]
        server = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=log)
        try:
            assert server.stdout is not None
            answer = json.loads(server.stdout.readline())
            base, token = answer["address"].rstrip("/"), answer["token"]
            owner, attack = Owner(base, token), Attack(base, token)
            owner.work(time.monotonic() + 2.0)
            owner.post("/api/learn", {})
            time.sleep(8.0)  # it learns
            before = len(owner.refusals)
            for name in names:
                ATTACKS[name](attack)
            time.sleep(2.0)
            owner.seconds.clear()
            owner.work(time.monotonic() + seconds)
            figures = {
                "requests": len(owner.seconds),
                "refused": len(owner.refusals) - before,
                "kinds": sorted({*owner.refusals[before:]}),
                "median_s": round(float(np.median(owner.seconds)), 3),
                "longest_s": round(max(owner.seconds), 2),
                "log_kB": round(log.seek(0, 2) / 1000, 1),
                **used(server.pid),
            }
            attack.end()
            return figures
        finally:
            server.kill()
            server.wait(10)


def used(pid: int) -> dict[str, float]:
    """Return CPU seconds and the largest memory (MB) of a process, from Linux."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    ticks = sum(map(int, words[11:13]))
    status = Path(f"/proc/{pid}/status").read_text()
    peak = int(status.partition("VmHWM:")[2].split()[0])
    return {"cpu_s": round(ticks / 100, 1), "peak_MB": round(peak / 1000)}


def main() -> None:
    """Measure every attack, and all at once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--only", action="append", choices=[*ATTACKS, "none", "all"])
    options = parser.parse_args()
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, most), most))
    chosen = {"none": [], **{name: [name] for name in ATTACKS}, "all": [*ATTACKS]}
    for name, attacks in chosen.items():
        if not options.only or name in options.only:
            figures = measured(attacks, options.seconds)
            print(json.dumps({"attack": name, **figures}), flush=True)


if __name__ == "__main__":
    main()
