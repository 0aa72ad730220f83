"""The Corradi 2014 study: encodings and classifiers for one touch of a dome camera.

Seven shapes pressed by a simulated dome and by its variant with pins, four recorded
on a real dome with pins (upright, and with only the test touches turned), and the
categories of unseen objects before a real dome camera. Every encoding of the paper,
on images and on their derivatives, with each of its four classifiers.
"""

import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import check_count
from .._progress import Progress
from ._corradi2014_judge import Judged, corrected_t_test, holm, judge
from ._corradi2014_plan import CLASSIFIERS, VARIANTS, Corradi2014Plan
from ._corradi2014_report import write_report
from ._corradi2014_tables import tables
from ._corradi2014_touches import (
    BATHTIP,
    TACTIP,
    Shapes,
    near_duplicates,
    recorded_shapes,
    simulated_shapes,
)
from ._corradi2014_unseen import (
    DATA,
    candidate_features,
    compare_fold,
    compared_rows,
    judge_unseen,
    recording,
)
from ._recorded import recorded_touches

__all__ = ["run", "tables", "write_report"]

Row = dict[str, Any]
# Of a larger set so many touches are looked at for repeated ones.
_MOST_ALIKE = 1000


def run(
    *,
    data: str | Path | None = None,
    quick: bool = False,
    workers: int = -1,
    seed: int = 0,
    progress: bool | None = None,
    plan: Corradi2014Plan | None = None,
) -> dict[str, Any]:
    """Run the study.

    Parameters
    ----------
    data : path, optional
        Folder of recorded touches, which holds `tactip4/tactip4.npz` and
        `bathtip/bathtip50.npz`; by default the one that PALPATE_DATA names.
    quick : bool, default=False
        Few runs, few numbers of components.
    workers : int, default=-1
        Processes, as joblib counts them; the figures do not depend on it.
    seed : int, default=0
        Of simulated touches, turned touches and folds.
    progress : bool, optional
        Show a bar on standard error; by default where it is a terminal.
    plan : Corradi2014Plan, optional
        Every size; takes the place of `quick` and `seed`.

    Returns
    -------
    result : dict
        `study`; `rows`, each with `name`, `paper` (or None), `ours`, `sd`, `data`,
        `table`, `unit` ("per cent", or "index" for Davies-Bouldin) and what else
        tells it from the others; `paired`, tests of image against derivative;
        `duplicates`, the share of touches (per cent) that another nearly repeats;
        `skipped`, one sentence for each kind of data that is missing; `plan`;
        `seconds`.
    """
    make = Corradi2014Plan.quick if quick else Corradi2014Plan
    settled = make(seed=seed) if plan is None else plan
    if workers != -1:
        check_count("workers", workers)
    started = time.perf_counter()
    pins, dome = (
        recorded_touches(data, a, what, s) for a, what, s in (TACTIP, BATHTIP)
    )
    sets = list(simulated_shapes(settled))
    if not isinstance(pins, str):
        some = pins[:: settled.recorded_step]
        upright = settled.recorded_upright
        sets += recorded_shapes(some, settled.seed, upright=upright)
    rows, paired = _shapes_rows(sets, settled, workers, progress)
    duplicates = {one.data: near_duplicates(one.images["image"]) for one in sets}
    if not isinstance(dome, str):
        seen = recording(dome[:: settled.recorded_step])
        rows_at = np.linspace(0, len(seen.codes) - 1, _MOST_ALIKE).astype(int)
        duplicates[DATA] = near_duplicates(seen.images["image"][np.unique(rows_at)])
        rows += _unseen_rows(seen, settled, workers, progress)
    return {
        "study": "corradi2014",
        "rows": rows,
        "paired": paired,
        "duplicates": duplicates,
        "skipped": [one for one in (pins, dome) if isinstance(one, str)],
        "plan": asdict(settled),
        "seconds": time.perf_counter() - started,
    }


def _shapes_rows(
    sets: list[Shapes], plan: Corradi2014Plan, workers: int, progress: bool | None
) -> tuple[list[Row], list[Row]]:
    keys = [(s, v, e) for s in sets for e in plan.encodings for v in VARIANTS]
    tasks = [(judge, (s.only(v), v, e, plan)) for s, v, e in keys]
    judged: list[Judged] = _parallel(tasks, workers, "judging encodings", progress)
    rows = [row for one in judged for row in one.rows]
    found = {(s.data, v, e): one for (s, v, e), one in zip(keys, judged, strict=True)}
    paired = [
        _paired(
            s.data, e, kind, found[s.data, "image", e], found[s.data, "derivative", e]
        )
        for s in sets
        for e in plan.encodings
        for kind in CLASSIFIERS
    ]
    for row, p in zip(paired, holm([row["p"] for row in paired]), strict=True):
        row["p_together"] = p
    return rows, paired


def _paired(
    data: str, encoding: str, kind: str, image: Judged, derivative: Judged
) -> Row:
    """Test image against derivative on the same folds."""
    mean, error, p = corrected_t_test(image.folds[kind] - derivative.folds[kind])
    return {
        "data": data,
        "encoding": encoding,
        "classifier": kind,
        "difference": mean,
        "error": error,
        "p": p,
    }


def _unseen_rows(
    seen: Any, plan: Corradi2014Plan, workers: int, progress: bool | None
) -> list[Row]:
    tasks = [
        (judge_unseen, (seen.only(v), v, e, plan))
        for e in plan.encodings
        for v in VARIANTS
    ]
    rows = _parallel(tasks, workers, "judging unseen objects", progress)
    jobs = [(candidate_features, (seen, name)) for name in plan.candidates]
    made = _parallel(jobs, workers, "encoding", progress)
    features = dict(zip(plan.candidates, made, strict=True))
    folds = [(compare_fold, (seen, features, k, plan)) for k in range(plan.fold_limit)]
    results = _parallel(folds, workers, "choosing an encoding", progress)
    return [row for some in rows for row in some] + compared_rows(results)


def _parallel(
    tasks: list[tuple[Callable[..., Any], tuple[Any, ...]]],
    workers: int,
    what: str,
    progress: bool | None,
) -> list[Any]:
    from joblib import Parallel, delayed

    parallel = Parallel(n_jobs=workers, return_as="generator")
    done = parallel(delayed(function)(*arguments) for function, arguments in tasks)
    results = []
    with Progress(len(tasks), what, progress) as bar:
        for one in done:
            results.append(one)
            bar.advance(1)
    return results
