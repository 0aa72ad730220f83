"""The Corradi 2014 study: encodings and classifiers for one touch of a dome camera.

Seven shapes pressed by a simulated dome and by its variant with pins, four recorded
on a real dome with pins (upright, and with only the test touches turned), and the
categories of unseen objects before a real dome camera. Every encoding of the paper,
on images and on their derivatives, with each of its four classifiers.
"""

from pathlib import Path
from typing import Any

import numpy as np

from .._report import Row
from .._study import Experiment, Work
from .._touches import BATHTIP, recorded_touches
from ._judge import Judged, holm, judge
from ._judge import answers as answers
from ._judge import corrected_t_test as corrected_t_test
from ._judge import encode as encode
from ._plan import CLASSIFIERS, VARIANTS, Corradi2014Plan
from ._plan import COUNTS as COUNTS
from ._plan import TABLE_2 as TABLE_2
from ._report import CAPTIONS, TITLE, introduction, pictures, tables
from ._shapes import TACTIP, Shapes, near_duplicates, recorded_shapes, simulated_shapes
from ._shapes import variants as variants
from ._unseen import CANDIDATES as CANDIDATES
from ._unseen import (
    DATA,
    Recording,
    candidate_features,
    compare_fold,
    compared_rows,
    judge_unseen,
    recording,
)

# Of a larger set so many touches are looked at for repeated ones.
_MOST_ALIKE = 1000


def _measure(
    plan: Corradi2014Plan, data: str | Path | None, work: Work
) -> dict[str, Any]:
    pins, dome = (recorded_touches(data, archive) for archive in (TACTIP, BATHTIP))
    sets = list(simulated_shapes(plan))
    if not isinstance(pins, str):
        some, upright = pins[:: plan.recorded_step], plan.recorded_upright
        sets += recorded_shapes(some, plan.seed, upright=upright)
    rows, paired = _shapes_rows(sets, plan, work)
    duplicates = {one.data: near_duplicates(one.images["image"]) for one in sets}
    if not isinstance(dome, str):
        seen = recording(dome[:: plan.recorded_step])
        rows_at = np.linspace(0, len(seen.codes) - 1, _MOST_ALIKE).astype(int)
        duplicates[DATA] = near_duplicates(seen.images["image"][np.unique(rows_at)])
        rows += _unseen_rows(seen, plan, work)
    return {
        "rows": rows,
        "paired": paired,
        "duplicates": duplicates,
        "skipped": [one for one in (pins, dome) if isinstance(one, str)],
    }


def _shapes_rows(
    sets: list[Shapes], plan: Corradi2014Plan, work: Work
) -> tuple[list[Row], list[Row]]:
    """Return the rows, and where image and derivative differ on the same folds."""
    keys = [(s, e, v) for s in sets for e in plan.encodings for v in VARIANTS]
    tasks = [(s.only(v), v, e, plan) for s, e, v in keys]
    judged: list[Judged] = work.done(judge, tasks, "judging encodings")
    found = {(s.data, e, v): one for (s, e, v), one in zip(keys, judged, strict=True)}
    paired: list[Row] = []
    for data, encoding in dict.fromkeys(key[:2] for key in found):
        image, derivative = (found[data, encoding, v].folds for v in VARIANTS)
        for kind in CLASSIFIERS:
            known: Row = {"data": data, "encoding": encoding, "classifier": kind}
            test = corrected_t_test(image[kind] - derivative[kind])
            figures = zip(("difference", "error", "p"), test, strict=True)
            paired.append({**known, **dict(figures)})
    for row, p in zip(paired, holm([row["p"] for row in paired]), strict=True):
        row["p_together"] = p
    return [row for one in judged for row in one.rows], paired


def _unseen_rows(seen: Recording, plan: Corradi2014Plan, work: Work) -> list[Row]:
    tasks = [(seen.only(v), v, e, plan) for e in plan.encodings for v in VARIANTS]
    rows = work.done(judge_unseen, tasks, "judging unseen objects")
    names = [(seen, name) for name in plan.candidates]
    made = work.done(candidate_features, names, "encoding")
    features = dict(zip(plan.candidates, made, strict=True))
    folds = [(seen, features, k, plan) for k in range(plan.fold_limit)]
    results = work.done(compare_fold, folds, "choosing an encoding")
    return [row for some in rows for row in some] + compared_rows(results)


EXPERIMENT = Experiment(
    Corradi2014Plan, _measure, tables, pictures, introduction, TITLE, CAPTIONS
)

__all__ = ["EXPERIMENT", "Corradi2014Plan"]
