"""Timing shared by the benchmarks: CPU time, equal total durations, one thread.

Wall time on a busy machine flatters short calls, so calls are timed by the CPU time
of the process, and each is repeated until about the same total time is spent.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import process_time

from threadpoolctl import threadpool_limits


def cpu_ms(function: Callable[[], object], seconds: float = 0.5) -> float:
    """Return the CPU time of one call of `function`, in milliseconds.

    The function is called once unmeasured (tables, caches), then repeated until
    about `seconds` of CPU time are spent, at least once. The repetitions are split
    into up to ten runs and the median run counts, so that one interruption does
    not.
    """
    function()
    once = _run(function, 1)
    repeats = max(1, round(seconds / 10 / max(once, 1e-7)))
    runs = [_run(function, repeats) / repeats]
    spent = runs[0] * repeats
    while spent < seconds and len(runs) < 10:
        runs.append(_run(function, repeats) / repeats)
        spent += runs[-1] * repeats
    return 1e3 * sorted(runs)[len(runs) // 2]


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS and OpenMP to one thread inside the `with` block."""
    with threadpool_limits(limits=1):
        yield


def row(
    name: str,
    ours_ms: float,
    peer: str,
    peer_ms: float | None,
    **extra: object,
) -> dict[str, object]:
    """Return one row of a benchmark; `ratio` is how much faster ours is.

    Pass `peer_ms=None` and `reason="..."` where the peer is absent: its ratio is
    None then. Further keywords (`reason`, `n_touches`, ...) become columns.
    """
    if peer_ms is None and "reason" not in extra:
        raise ValueError(f"reason must be given for {name!r}: {peer} was not timed.")
    ratio = None if peer_ms is None else peer_ms / ours_ms
    return {
        "name": name,
        "ours_ms": ours_ms,
        "peer": peer,
        "peer_ms": peer_ms,
        "ratio": ratio,
        **extra,
    }


def _run(function: Callable[[], object], repeats: int) -> float:
    """CPU seconds of `repeats` calls."""
    start = process_time()
    for _ in range(repeats):
        function()
    return process_time() - start
