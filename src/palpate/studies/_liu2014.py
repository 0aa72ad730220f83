"""The Liu 2014 study: from one press of a pressure array to one of twelve parts.

Ten runs of twofold cross-validation, as in section 4 of the paper; the class sets
of Figs 12 to 14, the rows of Table 2, load and cover as in Figs 5 and 6; simulated
presses, and real presses of another array where they are at hand.
"""

import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from .._checks import check_count
from .._progress import Progress
from ._liu2014_curves import condition_jobs
from ._liu2014_jobs import Job, study_jobs
from ._liu2014_plan import Liu2014Plan
from ._liu2014_report import write_report
from ._liu2014_tables import tables
from ._liu2014_touches import real_presses, reposed_presses, simulated_presses
from ._twofold import Half, judge_run, nested_figure, paper_figure

__all__ = ["run", "tables", "write_report"]

Runs = list[list[Half]]


def run(
    *,
    data: str | Path | None = None,
    quick: bool = False,
    protocol: str = "both",
    workers: int = -1,
    seed: int = 0,
    progress: bool | None = None,
    plan: Liu2014Plan | None = None,
) -> dict[str, Any]:
    """Run the study.

    Parameters
    ----------
    data : path, optional
        Folder of recorded touches, which holds `taxel10x10/taxel10x10.npz`; by
        default the one that PALPATE_DATA names.
    quick : bool, default=False
        Two runs and small grids.
    protocol : {"both", "nested", "paper"}, default="both"
        "nested" chooses parameters inside the training half, "paper" on the runs
        that are reported.
    workers : int, default=-1
        Processes, as joblib counts them; the figures do not depend on it.
    seed : int, default=0
        Of the presses, the poses and the halves.
    progress : bool, optional
        Show a bar on standard error; by default where it is a terminal.
    plan : Liu2014Plan, optional
        Every size and grid; takes the place of `quick`, `protocol` and `seed`.

    Returns
    -------
    result : dict
        `study`; `rows`, each with `name`, `paper` (or None), `ours`, `sd` (in per
        cent, over runs), `data`, `protocol`, `features`, `chosen` and what else
        tells it from the others; `skipped`, one sentence for each kind of data
        that is missing; `plan`; `seconds`.
    """
    make = Liu2014Plan.quick if quick else Liu2014Plan
    settled = make(protocol=protocol, seed=seed) if plan is None else plan
    if workers != -1:
        check_count("workers", workers)
    started = time.perf_counter()
    real = real_presses(data)
    jobs = study_jobs(settled, simulated_presses(settled), "simulated")
    if not isinstance(real, str):
        jobs += study_jobs(settled, reposed_presses(real, settled.seed), "taxel10x10")
    jobs += condition_jobs(settled)
    judged = _judge(jobs, settled, workers, progress)
    rows = [
        row
        for job, runs in zip(jobs, judged, strict=True)
        for row in _rows(job, runs, settled)
    ]
    return {
        "study": "liu2014",
        "rows": rows,
        "skipped": [real] if isinstance(real, str) else [],
        "plan": asdict(settled),
        "seconds": time.perf_counter() - started,
    }


def _judge(
    jobs: list[Job], plan: Liu2014Plan, workers: int, progress: bool | None
) -> list[Runs]:
    """Return the runs of each job; jobs of one group share their tasks."""
    from joblib import Parallel, delayed

    groups = _groups(jobs)
    tasks = [(group, number) for group in groups for number in range(plan.runs)]
    parallel = Parallel(n_jobs=workers, return_as="generator")
    done = parallel(
        delayed(_judge_group)([jobs[j] for j in group], plan, number)
        for group, number in tasks
    )
    runs: list[Runs] = [[] for _ in jobs]
    with Progress(len(tasks), "cross-validating", progress) as bar:
        for (group, _), halves in zip(tasks, done, strict=True):
            for j, one in zip(group, halves, strict=True):
                runs[j].append(one)
            bar.advance(1)
    return runs


def _groups(jobs: list[Job]) -> list[list[int]]:
    """Put jobs that take milliseconds together; the long ones stand alone."""
    shared: dict[str, list[int]] = {}
    for number, job in enumerate(jobs):
        shared.setdefault(job.group or f"alone {number}", []).append(number)
    # The longest first, so that no worker is left with one at the end.
    return sorted(
        shared.values(), key=lambda group: -sum(_work(jobs[j]) for j in group)
    )


def _work(job: Job) -> float:
    return len(job.method.settings) * job.row["n_classes"] ** 2


def _judge_group(jobs: Iterable[Job], plan: Liu2014Plan, number: int) -> Runs:
    """Do one run of every job, on one thread so that sums round alike everywhere."""
    with threadpool_limits(limits=1):
        return [
            judge_run(
                job.method,
                job.features,
                job.codes,
                scaled=job.scaled,
                inner_folds=plan.inner_folds,
                seed=(plan.seed, number),
            )
            for job in jobs
        ]


def _rows(job: Job, runs: Runs, plan: Liu2014Plan) -> list[dict[str, Any]]:
    """One row per protocol; where nothing is chosen, one outside Table 2."""
    summaries = {"nested": nested_figure, "paper": paper_figure}
    settings = job.method.settings
    same = len(settings) == 1 and job.row["table"] != "Table 2"
    rows = []
    for protocol in plan.protocols[:1] if same else plan.protocols:
        figure = summaries[protocol](settings, runs)
        rows.append(
            {
                "name": job.row["name"],
                "paper": job.row["paper"],
                "ours": figure.mean,
                "sd": figure.sd,
                "data": job.row["data"],
                "protocol": protocol,
                **job.row,
                "chosen": figure.setting,
                "chosen_share": figure.share,
            }
        )
    return rows
