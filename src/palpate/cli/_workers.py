"""Where parallel work runs: this machine's processes or a Dask cluster."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

CONNECT_S = 20.0

Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        help="Processes on this machine; -1 is one per core. Results do not change.",
    ),
]
Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        help="Address of a Dask scheduler, such as tcp://lab:8786; needs "
        "palpate[distributed].",
    ),
]


def checked_workers(workers: int) -> int:
    """Return a number of processes, or say what --workers should be."""
    if workers < 1 and workers != -1:
        raise ValueError(
            f"--workers must be at least 1, or -1 for all cores, got {workers}."
        )
    return workers


@contextmanager
def working(workers: int | None, cluster: str | None) -> Iterator[int | None]:
    """Let joblib run its tasks where the options say.

    Yields the number of jobs to ask for: `workers`, or -1 (all) on a cluster.

    Raises
    ------
    ValueError
        Both are given, or `workers` is no number of processes.
    ImportError
        Dask is missing; the message names the extra.
    OSError
        No scheduler answers at the address.
    """
    from joblib import parallel_config

    if cluster is not None:
        if workers is not None:
            raise ValueError(
                "Give either --workers or --cluster, got both; a cluster has its own."
            )
        with _connected(cluster), parallel_config("dask"):
            yield -1
        return
    if workers is not None:
        checked_workers(workers)
    with parallel_config("loky", n_jobs=workers):
        yield workers


@contextmanager
def _connected(address: str) -> Iterator[None]:
    try:
        from distributed import Client
    except ImportError as error:
        raise ImportError(
            "--cluster needs the package 'distributed', which is not installed: "
            "pip install palpate[distributed]"
        ) from error
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise OSError(
            f"--cluster must be the address of a Dask scheduler, got {address}: "
            f"{error or 'no answer'}. Start one with `dask scheduler`, workers with "
            "`dask worker ADDRESS`."
        ) from error
    with client:
        if not client.scheduler_info()["workers"]:
            raise OSError(
                f"The scheduler at {address} must have workers, got none. Start some "
                f"with `dask worker {address}`."
            )
        yield
