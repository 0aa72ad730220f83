"""Many tasks at once, and one thread where more only wait.

`Progress` draws a bar on standard error for work of more than two seconds.
"""

import pickle
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import lru_cache
from threading import Lock
from typing import Any, Self

from threadpoolctl import ThreadpoolController

from ._extras import needed
from ._version import __version__

_PATIENCE_S = 2.0  # what ends sooner needs no bar

# A Dask cluster is given up after so long without a worker or a scheduler, or when its
# scheduler was lost more often than this; how often it is asked.
LONGEST_ABSENCE_S, _MOST_LOSSES, _ASKED_EACH_S = 60.0, 3, 1.0
# Dask warns of larger tasks; ours hold the images they encode.
_LARGE_TASK = {"distributed.admin.large-graph-warning-threshold": "1GB"}
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

    Under `joblib.parallel_config("dask")` on its cluster, else in `n_jobs` processes.
    """
    from joblib import Parallel, delayed
    from joblib.parallel import get_active_backend

    client = getattr(get_active_backend()[0], "client", None)
    if client is not None:
        yield from _results_of_cluster(client, function, n_tasks, arguments)
        return
    run = Parallel(n_jobs=n_jobs, return_as="generator")
    yield from run(delayed(function)(*arguments(n)) for n in range(n_tasks))


def _results_of_cluster(
    client: Any,
    function: Callable[..., Any],
    n_tasks: int,
    arguments: Callable[[int], Iterable[Any]],
) -> Iterator[Any]:
    """Yield the results of tasks that Dask's scheduler holds until they are done.

    joblib would keep arguments of more than 1 kB on one worker alone, and cancel what
    needs them when that dies. Here Dask does the tasks of a dead worker again. They are
    sent again only where the scheduler itself was lost.
    """
    done = n_losses = 0
    while done < n_tasks:
        try:
            for result in _sent(client, function, range(done, n_tasks), arguments):
                done += 1
                yield result
        except CancelledError as error:
            n_losses += 1
            if n_losses > _MOST_LOSSES:
                raise _cluster_lost(client, "lost its scheduler again") from error


def _sent(
    client: Any,
    function: Callable[..., Any],
    numbers: Iterable[int],
    arguments: Callable[[int], Iterable[Any]],
) -> Iterator[Any]:
    """Send tasks, two for each thread of the workers at a time; yield their results."""
    dask: Any = needed("dask", "distributed", "A Dask cluster")
    dumps = needed("cloudpickle", "distributed", "A Dask cluster").dumps

    def submitted(task: Callable[..., Any], *task_arguments: Any) -> Any:
        with dask.config.set(_LARGE_TASK):
            return client.submit(task, *task_arguments, pure=False)

    at_once = 2 * _n_threads(client)
    # As a task it is sent once, and made again where the worker that has it dies.
    shared = submitted(_unpacked, dumps(function), __version__)
    waiting: deque[Any] = deque()
    for number in numbers:
        waiting.append(submitted(_called, shared, dumps(tuple(arguments(number)))))
        if len(waiting) == at_once:
            yield _result(client, waiting.popleft())
    while waiting:
        yield _result(client, waiting.popleft())


def _n_threads(client: Any) -> int:
    """Return how many threads the workers have; wait for the first one, or give up."""
    begun = time.monotonic()
    while time.monotonic() - begun < LONGEST_ABSENCE_S and client.status != "closed":
        with suppress(OSError):  # the scheduler is away
            running = client.status == "running"
            n_threads: int = sum(client.nthreads().values()) if running else 0
            if n_threads:
                return n_threads
        time.sleep(_ASKED_EACH_S)
    raise _cluster_lost(client, "has had no worker")


def _result(client: Any, future: Any) -> Any:
    """Return what a task returned; give up where nobody is left to do it."""
    distributed: Any = needed("distributed", "distributed", "A Dask cluster")
    while True:
        with suppress(TimeoutError):
            distributed.wait(future, timeout=_ASKED_EACH_S)
        if not future.done():
            _n_threads(client)
            continue
        try:
            return future.result()
        except distributed.KilledWorker as error:
            raise OSError(
                "A task must fit into the memory of one worker of the Dask cluster, "
                f"got workers that died of it: {error} Give workers more memory, or "
                "start fewer on each machine."
            ) from error


def _cluster_lost(client: Any, what: str) -> OSError:
    address = getattr(client.scheduler, "address", "")
    return OSError(
        f"The Dask cluster {address} must have a scheduler and workers until the end, "
        f"got one that {what} for {LONGEST_ABSENCE_S:g} s. Nothing was written. Start "
        "it again, and then this."
    )


def _unpacked(function: bytes, sender: str) -> Callable[..., Any]:
    """Return a function on a worker, which must have the sender's palpate."""
    if __version__ != sender:
        raise RuntimeError(
            f"All workers of the Dask cluster must have palpate {sender}, got one with "
            f"{__version__}. Install the same everywhere."
        )
    unpacked: Callable[..., Any] = pickle.loads(function)
    return unpacked


def _called(function: Callable[..., Any], arguments: bytes) -> Any:
    """Do a task on a worker, one of several on its machine."""
    with on_one_thread():
        return function(*pickle.loads(arguments))


class Progress:
    """Count work; draw a bar once it takes long.

    `show` is whether to draw at all; None means where standard error is a terminal.
    """

    def __init__(self, total: int, what: str, show: bool | None) -> None:
        self._total, self._what = total, what
        self._show = sys.stderr.isatty() if show is None else show
        self._start = time.monotonic()
        self._done = 0
        self._bar: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, n_done: int) -> None:
        """Count `n_done` more pieces."""
        self.reach(self._done + n_done)

    def reach(self, n_done: int) -> None:
        """Count `n_done` pieces in all."""
        self._done = n_done
        late = time.monotonic() - self._start > _PATIENCE_S
        if self._bar is None and self._show and late and self._done < self._total:
            from rich.console import Console
            from rich.progress import Progress as RichProgress

            self._bar = RichProgress(console=Console(stderr=True))
            self._bar.add_task(self._what, total=self._total)
            self._bar.start()
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=self._done)
