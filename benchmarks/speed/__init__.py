"""What `palpate bench NAME` measures: speed and memory beside peers, in one run.

A file per subject; each benchmark returns rows of plain values. Here stands what they
share: CPU time, equal total durations, one thread, and their data.

Wall time on a busy machine flatters short calls, so calls are timed by the CPU time
of the process, and each is repeated until about the same total time is spent.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from time import process_time
from timeit import timeit
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from palpate._checks import check_option

# The file of each, whose function `bench_<name>` it is, and what it measures.
BENCHES: dict[str, tuple[str, str]] = {
    "decode": ("encodings", "reading a folder of pictures, peak memory"),
    "library": ("library", "10^4 and 10^5 touches: adding, opening, likelihoods"),
    "library-large": ("library", "the same with 10^6"),
    "library-sizes": ("library", "what recorded touches take on the disk"),
    "encodings": ("encodings", "from a picture to a vector, by stage"),
    "latency": ("live", "from a JPEG to the new belief over 50 objects, by stage"),
    "learning": ("live", "learning, adding, and the page's next lesson"),
    "likelihood": ("library", "kernel densities per touch"),
    "live": ("live", "frames to a page, touches to a belief"),
    "mkl": ("mkl", "multiple kernel learning beside MKLpy and SVC"),
    "simulate": ("simulate", "touches of a simulated dome camera, by stage"),
    "simulate-array": ("simulate", "presses on a simulated pressure array"),
    "zernike": ("encodings", "Zernike moments beside three peers"),
}

Row = dict[str, Any]
Picture = NDArray[np.uint8]
N_ROWS, N_COLS = 480, 640  # of a camera's picture
# BLAS and OpenMP on one thread inside a `with` block.
one_thread = partial(threadpool_limits, limits=1)
# The kernel's high-water mark of a process: allocations of OpenCV are invisible to
# `tracemalloc`, and `ru_maxrss` starts from the parent's value.
_PEAK = """
import json, sys, time
def peak_mib():
    try:
        with open("/proc/self/status") as lines:
            return next(int(l.split()[1]) for l in lines if "VmHWM" in l) / 1024
    except OSError:
        import resource
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (2**20 if sys.platform == "darwin" else 2**10)
"""


def run_bench(name: str, **options: Any) -> list[Row]:
    """Run the benchmark called `name` and return its rows.

    Parameters
    ----------
    name : str
        One of `BENCHES`.
    **options
        What the benchmark offers: mostly `seconds` of CPU time to spend on each
        figure and `random_state`, what is drawn; `data`, the folder of real touches,
        by default the one that PALPATE_DATA names (drawn ones without any).

    Returns
    -------
    list of dict
        Each row has `name`, `ours_ms`, `peer`, `peer_ms` and `ratio` = peer_ms /
        ours_ms, in milliseconds of CPU time unless the name says otherwise; `ratio`
        is None, with a `reason`, where the peer is absent.

    Raises
    ------
    ValueError
        There is no such benchmark; the message lists them.
    """
    file, _ = BENCHES[check_option("name", name, BENCHES)]
    measure = getattr(import_module(f"speed.{file}"), f"bench_{name.replace('-', '_')}")
    return list(measure(**options))


def cpu_ms(function: Callable[[], object], seconds: float = 0.5) -> float:
    """Return the CPU milliseconds of a call, the median of up to ten runs.

    After an unmeasured call runs repeat it until `seconds` are spent, at least once.
    """

    def run(repeats: int) -> float:
        return timeit(function, timer=process_time, number=repeats) / repeats

    function()
    repeats = max(1, round(seconds / 10 / max(run(1), 1e-7)))
    runs = [run(repeats)]
    while sum(runs) * repeats < seconds and len(runs) < 10:
        runs.append(run(repeats))
    return 1e3 * sorted(runs)[len(runs) // 2]


def wall_ms(function: Callable[[], object]) -> float:
    """Return the time of one call by the clock, in milliseconds."""
    return 1e3 * timeit(function, number=1)


def measured_apart(code: str, *arguments: object) -> dict[str, Any]:
    """Run code after `_PEAK` in a process of its own; return the JSON it prints."""
    command = [sys.executable, "-c", _PEAK + code, *map(str, arguments)]
    completed = subprocess.run(command, check=True, capture_output=True, text=True)
    return dict(json.loads(completed.stdout))


def real_touches(data: str | Path | None) -> Path | None:
    """Return the folder of real touches: `data`, or what PALPATE_DATA names, if any."""
    named = data if data is not None else os.environ.get("PALPATE_DATA")
    return Path(named) if named else None


def drawn_dome(
    rng: np.random.Generator | None, widths_px: tuple[float, float] = (70.0, 70.0)
) -> Picture:
    """Draw a dome with a random dent (across, along), or untouched without `rng`."""
    rows, cols = np.mgrid[:N_ROWS, :N_COLS].astype(np.float32)
    levels = np.where(np.hypot(rows - 240, cols - 320) < 220, 60, 245)
    if rng is not None:
        y, x = rows - rng.uniform(180, 300), cols - rng.uniform(260, 380)
        turn = rng.uniform(0, np.pi)
        across = x * np.sin(turn) - y * np.cos(turn)
        along = x * np.cos(turn) + y * np.sin(turn)
        dent = np.exp(-((across / widths_px[0]) ** 2) - (along / widths_px[1]) ** 2)
        inside = np.where(levels == 60, 90 * dent, 0)
        levels = levels + inside + rng.normal(scale=1.7, size=levels.shape)
    return levels.clip(0, 255).astype(np.uint8)


def coded(picture: Picture) -> bytes:
    import cv2

    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1])


def row(
    name: str,
    ours_ms: float,
    peer: str = "",
    peer_ms: float | None = None,
    **extra: Any,
) -> Row:
    """Return a row, its `ratio` how much faster ours is; `extra` become columns."""
    if peer_ms is None and "reason" not in extra:
        raise ValueError(f"reason must be given for {name!r}: {peer} was not timed.")
    return {
        "name": name,
        "ours_ms": ours_ms,
        "peer": peer,
        "peer_ms": peer_ms,
        "ratio": None if peer_ms is None else peer_ms / ours_ms,
        **extra,
    }
