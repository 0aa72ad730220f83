"""Many tasks at once, with a bar on standard error; one thread where more only wait."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import lru_cache
from threading import Lock
from typing import Any

from threadpoolctl import ThreadpoolController

from ._progress import Progress

_MOST_LOSSES = 3  # of workers; more is no accident
_lock = Lock()
# How many now keep OpenCV on one thread, and how many threads it had before.
_keepers, _usual = 0, 1
# Finding the libraries that have threads takes 4 ms: again only after an import.
_libraries = lru_cache(maxsize=1)(lambda n_modules: ThreadpoolController())


@contextmanager
def opencv_on_one_thread() -> Iterator[None]:
    """Keep OpenCV, in the whole process, on one thread meanwhile.

    On pictures of a sensor's size two threads take as long, and twice the CPU time.
    """
    global _keepers, _usual
    import cv2

    with _lock:
        if not _keepers:
            _usual = cv2.getNumThreads()
            cv2.setNumThreads(1)
        _keepers += 1
    try:
        yield
    finally:
        with _lock:
            _keepers -= 1
            if not _keepers:
                cv2.setNumThreads(_usual)


@contextmanager
def on_one_thread() -> Iterator[None]:
    """Keep linear algebra and OpenCV on one thread: small fits wait for the others."""
    with _libraries(len(sys.modules)).limit(limits=1), opencv_on_one_thread():
        yield


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
    counts = [1] * len(tasks) if sizes is None else list(sizes)
    done: list[Any] = []
    with Progress(sum(counts), what, show) as bar:
        for result in results_of(function, len(tasks), tasks.__getitem__, n_jobs):
            bar.advance(counts[len(done)])
            done.append(result)
    return done


def results_of(
    function: Callable[..., Any],
    n_tasks: int,
    arguments: Callable[[int], Iterable[Any]],
    n_jobs: int | None = None,
) -> Iterator[Any]:
    """Yield `function(*arguments(number))` of every task, in their order.

    joblib keeps arguments of more than 1 kB on one worker of a Dask cluster alone, and
    when that dies all tasks that need them are cancelled: these are sent again, up to
    three times.
    """
    from joblib import Parallel, delayed

    done = 0
    for n_losses in range(_MOST_LOSSES + 1):
        run = Parallel(n_jobs=n_jobs, return_as="generator")
        rest = range(done, n_tasks)
        try:
            for result in run(delayed(function)(*arguments(n)) for n in rest):
                done += 1
                yield result
            return
        except CancelledError:
            if n_losses == _MOST_LOSSES:
                raise
