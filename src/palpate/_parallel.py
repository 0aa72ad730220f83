"""Many tasks at once, with a bar on standard error when they take long."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from ._progress import Progress


def in_parallel(
    function: Callable[..., Any],
    tasks: Sequence[Iterable[Any]],
    what: str,
    *,
    n_jobs: int | None = None,
    show: bool | None = None,
    sizes: Sequence[int] | None = None,
) -> list[Any]:
    """Return `function(*task)` of every task, in their order.

    It runs in `n_jobs` other processes, -1 for one a core; None leaves it to
    `joblib.parallel_config`. `what` is what the bar is called; with `show` None it is
    drawn where standard error is a terminal. `sizes` is how much each task counts in
    it, 1 by default.
    """
    from joblib import Parallel, delayed

    counts = [1] * len(tasks) if sizes is None else list(sizes)
    run = Parallel(n_jobs=n_jobs, return_as="generator")
    done: list[Any] = []
    with Progress(sum(counts), what, show) as bar:
        for result in run(delayed(function)(*task) for task in tasks):
            bar.advance(counts[len(done)])
            done.append(result)
    return done
