"""How fast the live loop is: frames to a page, a touch to its belief, an array.

Everything runs in this process: a replayed sensor, the server, and a client that
reads its websocket as a page does. Wall time counts here, since a stream is paced by
its sensor; the CPU time of the whole process stands beside it.
"""

import json
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..touches import Touches
from ._timing import one_thread, row

_N_ROWS, _N_COLS = 480, 640
_OBJECTS = ("ball", "edge")
_N_TOUCHES = 12
_OFFERED_HZ = 30.0
_NO_PEER = "no other tool shows a belief over objects live"


def bench_live(seconds: float = 8.0) -> list[dict[str, Any]]:
    """Measure the live loop at 640 x 480, 30 frames offered a second.

    Parameters
    ----------
    seconds : float, default=8
        How long each stream is watched.

    Returns
    -------
    list of dict
        Rows without a peer: milliseconds per frame that reached the client (33.3 is
        all of 30 a second), from a touch's last frame to its belief at the client
        (median and greatest), and per frame of a 16 x 16 array at 100 Hz, with
        `n_lost`.
    """
    with one_thread():
        watched = _watched(seconds)
        rows = _page_rows(watched)
        rows.append(_array_row(seconds))
    return rows


def _watched(seconds: float) -> dict[str, Any]:
    """Serve a replayed camera that recognises, and read its websocket."""
    from ..recognition import ObjectRecogniser
    from ..sensors import ReplaySensor
    from ..web import LiveSession

    touches = _drawn()
    with tempfile.TemporaryDirectory() as folder:
        model = ObjectRecogniser().fit(touches).save(Path(folder) / "m.palpate")
        sensor = ReplaySensor(touches, rate_hz=_OFFERED_HZ, hold=4, gap=4)
        session = LiveSession(sensor, model=model)
        return _read_page(session, seconds)


def _read_page(session: Any, seconds: float) -> dict[str, Any]:
    import uvicorn
    from websockets.sync.client import connect

    from ..web import create_app, open_socket

    opened = open_socket("127.0.0.1", 0)
    config = uvicorn.Config(
        create_app(session, "bench"), log_level="error", ws="websockets-sansio"
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, args=([opened],), daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    port = opened.getsockname()[1]
    try:
        with connect(f"ws://127.0.0.1:{port}/ws?token=bench", max_size=None) as page:
            page.recv()
            return _counted(page, seconds)
    finally:
        server.should_exit = True
        thread.join(10)
        opened.close()


def _counted(page: Any, seconds: float) -> dict[str, Any]:
    """Count frames, bytes and touches that reach a client in some seconds."""
    n_frames, n_bytes = 0, 0
    to_belief_ms: list[float] = []
    began_s, began_cpu_s = time.monotonic(), time.process_time()
    while (left_s := began_s + seconds - time.monotonic()) > 0:
        try:
            message = page.recv(timeout=left_s)
        except TimeoutError:
            break
        if isinstance(message, bytes):
            n_frames, n_bytes = n_frames + 1, n_bytes + len(message)
            continue
        event = json.loads(message)
        if event["kind"] == "touch":
            touch = event["episode"]["touches"][-1]
            way_ms = 1e3 * (time.time() - touch["time_s"])
            to_belief_ms.append(touch["latency_ms"] + way_ms)
    return {
        "seconds": time.monotonic() - began_s,
        "cpu_s": time.process_time() - began_cpu_s,
        "n_frames": n_frames,
        "n_bytes": n_bytes,
        "to_belief_ms": to_belief_ms,
    }


def _page_rows(watched: dict[str, Any]) -> list[dict[str, Any]]:
    n_frames = max(1, watched["n_frames"])
    size = f"{_N_COLS} x {_N_ROWS} uint8 replay"
    to_belief_ms = watched["to_belief_ms"] or [float("nan")]
    per_s = watched["n_frames"] / watched["seconds"]
    return [
        _alone(
            f"{size} frame to page wall",
            1e3 * watched["seconds"] / n_frames,
            frames_per_s=per_s,
            kib_per_frame=watched["n_bytes"] / n_frames / 1024,
        ),
        _alone(f"{size} frame to page cpu", 1e3 * watched["cpu_s"] / n_frames),
        _alone(
            f"{size} touch to belief at page median",
            float(np.median(to_belief_ms)),
            n_touches=len(watched["to_belief_ms"]),
        ),
        _alone(f"{size} touch to belief at page greatest", float(max(to_belief_ms))),
    ]


def _array_row(seconds: float) -> dict[str, Any]:
    """Follow a 16 x 16 array at 100 Hz and count what is lost."""
    from ..sensors import ReplaySensor, TouchDetector

    images = np.random.default_rng(0).integers(0, 255, (20, 16, 16)).astype(np.uint8)
    sensor = ReplaySensor(Touches(images), rate_hz=100, hold=5, gap=5)
    detector = TouchDetector(sensor.no_contact())
    n_frames = n_touches = 0
    with sensor:
        began_s, began_cpu_s = time.monotonic(), time.process_time()
        while time.monotonic() - began_s < seconds:
            n_touches += detector.update(sensor.read_next()) is not None
            n_frames += 1
        cpu_s = time.process_time() - began_cpu_s
        return _alone(
            "16 x 16 uint8 array 100 Hz frame cpu",
            1e3 * cpu_s / n_frames,
            frames_per_s=n_frames / (time.monotonic() - began_s),
            n_lost=sensor.n_dropped,
            n_touches=n_touches,
        )


def _alone(name: str, ours_ms: float, **extra: object) -> dict[str, Any]:
    return row(name, ours_ms, "", None, reason=_NO_PEER, **extra)


def _drawn() -> Touches:
    """Draw touches of a dome by a round and a long thing, (n, 480, 640)."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:_N_ROWS, :_N_COLS].astype(np.float32)
    dome = np.where(np.hypot(y - 240, x - 320) < 220, 110, 20).astype(np.float32)

    def press(long: bool) -> NDArray[np.uint8]:
        row_at, col_at = rng.uniform(180, 300), rng.uniform(260, 380)
        widths = (24.0, 110.0) if long else (55.0, 55.0)
        turn = rng.uniform(0, np.pi)
        along = (y - row_at) * np.sin(turn) + (x - col_at) * np.cos(turn)
        across = (y - row_at) * np.cos(turn) - (x - col_at) * np.sin(turn)
        bump = np.exp(-((across / widths[0]) ** 2) - (along / widths[1]) ** 2)
        noise = rng.normal(scale=2, size=dome.shape)
        return (dome + 90 * bump + noise).clip(0, 255).astype(np.uint8)

    images = np.stack(
        [press(long) for long in (False, True) for _ in range(_N_TOUCHES)]
    )
    labels = np.repeat(_OBJECTS, _N_TOUCHES)
    return Touches(
        images, object=labels, no_contact=dome.astype(np.uint8), geometry="dome"
    )
