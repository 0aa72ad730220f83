"""Speed and memory beside peers, measured in one run: `palpate bench NAME`.

What measures lies in `benchmarks/speed` of a checkout: a file per subject. Nothing that
recognises needs it, so an installed wheel has this table alone.
"""

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from .._checks import check_option

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
        There is no such benchmark; the message lists them. Or palpate is not used from
        a checkout, nor called in one; the message says how to get one.
    """
    file, _ = BENCHES[check_option("name", name, BENCHES)]
    roots = Path(__file__).parents[3], Path.cwd()
    places = [r / "benchmarks" for r in roots if (r / "benchmarks" / "speed").is_dir()]
    if not places:
        raise ValueError(
            "Benchmarks must be run in a checkout of palpate, got an installed one "
            f"without them in {Path.cwd()}. Clone its repository, and call it there."
        )
    if str(places[0]) not in sys.path:
        sys.path.append(str(places[0]))
    measure = getattr(import_module(f"speed.{file}"), f"bench_{name.replace('-', '_')}")
    return list(measure(**options))


__all__ = ["run_bench"]
