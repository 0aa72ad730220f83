"""A server killed while teaching has stored every touch that it acknowledged."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import httpx
import numpy as np
import pytest

from palpate.library import TouchLibrary


def killed_while_teaching(folder, after, seed):
    """Serve, teach from four threads, kill after so many touches; return those."""
    command = [sys.executable, "-m", "palpate", "serve", "--library", str(folder)]
    process = subprocess.Popen(
        [*command, "--port", "0", "--json"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    server = json.loads(process.stdout.readline())
    acknowledged = []

    def teach(number):
        rng = np.random.default_rng((seed, number))
        headers = {"Authorization": f"Bearer {server['token']}"}
        plain = {"headers": headers, "verify": False}  # nothing is encrypted
        with httpx.Client(base_url=server["address"], **plain) as client:
            while True:
                image = rng.integers(0, 255, size=(8, 8)).tolist()
                body = {"object": f"thing {number}", "image": image}
                try:
                    answer = client.post("api/teach/touch", json=body)
                except httpx.HTTPError:
                    return
                if answer.status_code == 200:
                    acknowledged.append((answer.json()["id"], image))

    teachers = [threading.Thread(target=teach, args=(n,)) for n in range(4)]
    for teacher in teachers:
        teacher.start()
    deadline = time.monotonic() + 60
    while len(acknowledged) < after and time.monotonic() < deadline:
        time.sleep(0.001)
    process.send_signal(signal.SIGKILL)
    process.wait(10)
    process.stdout.close()
    for teacher in teachers:
        teacher.join(10)
    return acknowledged


@pytest.mark.slow
def test_twenty_kills_lose_nothing_that_was_acknowledged(tmp_path):
    acknowledged = []
    for kill in range(20):
        acknowledged += killed_while_teaching(tmp_path, 5 + 3 * kill, kill)
        assert acknowledged
        with TouchLibrary.open(tmp_path) as library:
            stored = {row.id for row in library.list(limit=None)}
            assert {key for key, _ in acknowledged} <= stored
            for key, image in acknowledged:
                assert library.image(key).tolist() == image
            assert len(library.touches()) == len(stored)
