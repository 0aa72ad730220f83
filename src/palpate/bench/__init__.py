"""Speed and memory beside peers, measured in one run: `palpate bench NAME`.

A file per subject; each benchmark returns rows of plain values. `_timing` holds what
they share: CPU time, equal total durations, one thread.
"""

from importlib import import_module
from typing import Any

from .._checks import check_option

# The file of each, whose function `bench_<name>` it is, and what it measures.
BENCHES: dict[str, tuple[str, str]] = {
    "decode": ("_encodings", "reading a folder of pictures, peak memory"),
    "library": ("_library", "10^4 and 10^5 touches: adding, opening, likelihoods"),
    "library-large": ("_library", "the same with 10^6"),
    "library-sizes": ("_library", "what recorded touches take on the disk"),
    "encodings": ("_encodings", "from a picture to a vector, by stage"),
    "latency": ("_live", "from a JPEG to the new belief over 50 objects, by stage"),
    "learning": ("_learning", "learning, adding, and the page's next lesson"),
    "likelihood": ("_library", "kernel densities per touch"),
    "live": ("_live", "frames to a page, touches to a belief"),
    "mkl": ("_mkl", "multiple kernel learning beside MKLpy and SVC"),
    "simulate": ("_simulate", "touches of a simulated dome camera, by stage"),
    "simulate-array": ("_simulate", "presses on a simulated pressure array"),
    "zernike": ("_encodings", "Zernike moments beside three peers"),
}


def run_bench(name: str, **options: Any) -> list[dict[str, Any]]:
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
    check_option("name", name, BENCHES)
    module = import_module(f"{__name__}.{BENCHES[name][0]}")
    measure = getattr(module, f"bench_{name.replace('-', '_')}")
    return list(measure(**options))


__all__ = ["BENCHES", "run_bench"]
