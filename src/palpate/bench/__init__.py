"""Speed and memory beside peers, measured in one run: `palpate bench NAME`.

One file per benchmark; each returns rows of plain values. `_timing` holds what
they share: CPU time, equal total durations, one thread.
"""

from importlib import import_module
from typing import Any

from .._checks import check_option

BENCHES: dict[str, tuple[str, str, str]] = {
    "decode": (
        "_decode",
        "bench_decode_here",
        "reading a folder of pictures, peak memory",
    ),
    "library": (
        "_library",
        "bench_library",
        "a library of 10^4 and 10^5 touches: adding, opening, likelihoods",
    ),
    "library-large": ("_library", "bench_library_large", "the same with 10^6"),
    "encodings": (
        "_encodings",
        "bench_encodings_here",
        "from a picture to a vector, by stage",
    ),
    "latency": (
        "_latency",
        "bench_latency",
        "from a JPEG in memory to the new belief over 50 objects, by stage",
    ),
    "likelihood": ("_likelihood", "bench_likelihood", "kernel densities per touch"),
    "live": ("_live", "bench_live", "frames to a page, touches to a belief"),
    "mkl": ("_mkl", "bench_mkl", "multiple kernel learning beside MKLpy and SVC"),
    "simulate": (
        "_simulate",
        "bench_simulate",
        "touches of a simulated dome camera, by stage",
    ),
    "simulate-array": (
        "_simulate_array",
        "bench_simulate_array",
        "presses on a simulated pressure array",
    ),
    "zernike": ("_zernike", "bench_zernike", "Zernike moments beside three peers"),
}


def run_bench(name: str) -> list[dict[str, Any]]:
    """Run the benchmark called `name` and return its rows.

    Each row has `name`, `ours_ms`, `peer`, `peer_ms` and `ratio` = peer_ms /
    ours_ms; `ratio` is None, with a `reason`, where the peer is absent.
    """
    check_option("name", name, BENCHES)
    module, function, _ = BENCHES[name]
    measure = getattr(import_module(f"{__name__}.{module}"), function)
    rows: list[dict[str, Any]] = measure()
    return rows


__all__ = ["BENCHES", "run_bench"]
