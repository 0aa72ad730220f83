"""The Corradi 2015 study: which of ten objects, touch by touch.

Random partitions into training and test touches, as in section V of the paper, of
simulated touches and of recorded ones where they are at hand; the recognisers that
it is compared with; objects that were never learnt; the first author's later
experiments on the released recordings; timings.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .._checks import check_count
from .._progress import Progress
from ._corradi2015_beside import beside_tasks
from ._corradi2015_plan import Corradi2015Plan
from ._corradi2015_report import write_report
from ._corradi2015_rows import confusions, experiment_rows, unseen_rows
from ._corradi2015_tables import tables
from ._corradi2015_tasks import (
    DEFAULT,
    MAIN,
    Compared,
    known_tasks,
    later_tasks,
    unseen_beliefs,
)
from ._corradi2015_timings import timing_rows
from ._corradi2015_touches import (
    Objects,
    real_touches,
    recorded_objects,
    simulated_objects,
)

__all__ = ["run", "tables", "write_report"]

Done = TypeVar("Done")


def run(
    *,
    data: str | Path | None = None,
    quick: bool = False,
    workers: int = -1,
    seed: int = 0,
    progress: bool | None = None,
    plan: Corradi2015Plan | None = None,
) -> dict[str, Any]:
    """Run the study.

    Parameters
    ----------
    data : path, optional
        Folder of recorded touches, which holds `bathtip/bathtip50.npz` and, for
        sight beside touch, `bathtip/visual_words50.npz`; by default the one that
        PALPATE_DATA names.
    quick : bool, default=False
        Few partitions, and ten objects alone.
    workers : int, default=-1
        Processes, as joblib counts them; but for the timings the figures do not
        depend on it.
    seed : int, default=0
        Of the simulated touches and the partitions.
    progress : bool, optional
        Show a bar on standard error; by default where it is a terminal.
    plan : Corradi2015Plan, optional
        Every size; takes the place of `quick` and `seed`.

    Returns
    -------
    result : dict
        `study`; `rows`, each with `name`, `paper` (or None), `ours`, `sd`, `data`,
        `table` and what else tells it from the others, in per cent unless `unit`
        says milliseconds; `confusion` after 5 and 15 touches; `unseen`, mean
        posteriors after each touch; `skipped`; `plan`; `seconds`.
    """
    settled = (Corradi2015Plan.quick if quick else Corradi2015Plan)(seed=seed)
    settled = settled if plan is None else plan
    if workers != -1:
        check_count("workers", workers)
    started = time.perf_counter()
    recorded = real_touches(data)
    sets = [simulated_objects(settled, workers)]
    if not isinstance(recorded, str):
        sets.append(recorded_objects(recorded))
    answered = _run(
        _tasks(settled, sets), "learning and recognising", workers, progress
    )
    unseen = {one.data: _unseen(settled, one) for one in sets}
    rows = experiment_rows(answered, settled)
    rows += [row for one in sets for row in unseen_rows(unseen[one.data], one)]
    skipped = [recorded] if isinstance(recorded, str) else []
    if settled.later and not isinstance(recorded, str):
        tasks, skipped = beside_tasks(settled, recorded, data)
        found = _run(tasks, "sight beside touch", workers, progress)
        rows += [row for some in found for row in some]
    return {
        "study": "corradi2015",
        "rows": rows + timing_rows(sets[-1].every or sets[0].known, sets[-1].data),
        "confusion": {one.data: confusions(answered, one, settled) for one in sets},
        "unseen": {name: _as_lists(curves) for name, curves in unseen.items()},
        "skipped": skipped,
        "plan": asdict(settled),
        "seconds": time.perf_counter() - started,
    }


def _tasks(plan: Corradi2015Plan, sets: list[Objects]) -> list[Compared]:
    tasks = [task for objects in sets for task in known_tasks(plan, objects)]
    for objects in sets:
        if plan.later and objects.every is not None:
            tasks += later_tasks(plan, objects.every)
    return tasks


def _run(
    tasks: Sequence[Callable[[], Done]], what: str, workers: int, progress: bool | None
) -> list[Done]:
    from joblib import Parallel, delayed

    done = Parallel(n_jobs=workers, return_as="generator")(
        delayed(task)() for task in tasks
    )
    found = []
    with Progress(len(tasks), what, progress) as bar:
        for one in done:
            found.append(one)
            bar.advance(1)
    return found


def _unseen(
    plan: Corradi2015Plan, objects: Objects
) -> dict[str, dict[str, np.ndarray]]:
    presets = (MAIN, DEFAULT) if plan.later else (MAIN,)
    return {
        preset: unseen_beliefs(plan, objects, preset, plan.n_test) for preset in presets
    }


def _as_lists(found: dict[str, dict[str, np.ndarray]]) -> dict[str, Any]:
    return {
        preset: {name: curve.round(4).tolist() for name, curve in curves.items()}
        for preset, curves in found.items()
    }
