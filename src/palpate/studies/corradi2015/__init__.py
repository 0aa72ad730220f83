"""The Corradi 2015 study: which of ten objects, touch by touch.

Random partitions into training and test touches, as in section V of the paper, of
simulated touches and of recorded ones where they are at hand; the recognisers that
it is compared with; objects that were never learnt; the first author's later
experiments on the released recordings; timings.
"""

from operator import call
from pathlib import Path
from typing import Any

from .._study import Experiment, Work, on_one_thread
from .._touches import BATHTIP, recorded_touches
from ._beside import MOVED as MOVED
from ._beside import RIM as RIM
from ._beside import SPLIT_FOR as SPLIT_FOR
from ._beside import WAYS as WAYS
from ._beside import Photographs as Photographs
from ._beside import before_the_move as before_the_move
from ._beside import beside_tasks
from ._beside import jump_of as jump_of
from ._beside import moved as moved
from ._beside import moved_rows as moved_rows
from ._beside import read_photographs as read_photographs
from ._beside import sight as sight
from ._beside import sight_rows as sight_rows
from ._episodes import DEFAULT, MAIN, known_tasks, later_tasks, unseen_beliefs
from ._episodes import Answered as Answered
from ._episodes import Partition as Partition
from ._episodes import category_folds as category_folds
from ._episodes import draw_orders as draw_orders
from ._episodes import draw_partition as draw_partition
from ._episodes import only_idle as only_idle
from ._plan import Corradi2015Plan
from ._recognisers import BagOfTouches as BagOfTouches
from ._recognisers import ClusterBayes as ClusterBayes
from ._recognisers import Densities as Densities
from ._recognisers import Mixtures as Mixtures
from ._recognisers import Nuisance as Nuisance
from ._report import CAPTIONS, TITLE, introduction, pictures, tables
from ._rows import accuracy as accuracy
from ._rows import confusion as confusion
from ._rows import confusions, experiment_rows, timing_rows, unseen_rows
from ._rows import worst_pairs as worst_pairs
from ._touches import N_FREQUENCIES as N_FREQUENCIES
from ._touches import N_RINGS as N_RINGS
from ._touches import Encoded as Encoded
from ._touches import Encoder as Encoder
from ._touches import Objects as Objects
from ._touches import moment_normalised as moment_normalised
from ._touches import polar_fourier as polar_fourier
from ._touches import recorded_objects, simulated_objects


def _measure(
    plan: Corradi2015Plan, data: str | Path | None, work: Work
) -> dict[str, Any]:
    recorded = recorded_touches(data, BATHTIP)
    sets, skipped = [simulated_objects(plan, work.workers)], []
    if isinstance(recorded, str):
        skipped.append(recorded)
    else:
        sets.append(recorded_objects(recorded))
    tasks = [task for objects in sets for task in known_tasks(plan, objects)]
    if plan.later and not isinstance(recorded, str):
        tasks += later_tasks(plan, recorded)
    done = work.done(call, [(one,) for one in tasks], "learning and recognising")
    answered = [one for some in done for one in some]
    presets = (MAIN, DEFAULT) if plan.later else (MAIN,)
    unseen = {
        one.data: {p: unseen_beliefs(plan, one, p, plan.n_test) for p in presets}
        for one in sets
    }
    rows = experiment_rows(answered, plan)
    rows += [row for one in sets for row in unseen_rows(unseen[one.data], one)]
    if plan.later and not isinstance(recorded, str):
        beside, skipped = beside_tasks(plan, recorded, data)
        found = work.done(call, [(one,) for one in beside], "sight beside touch")
        rows += [row for some in found for row in some]
    every, last = sets[-1].every or sets[0].known, sets[-1].data
    return {
        "rows": rows + on_one_thread(timing_rows, every, last, plan.timed),
        "confusion": {one.data: confusions(answered, one, plan) for one in sets},
        "unseen": {
            data: {
                p: {name: curve.round(4).tolist() for name, curve in curves.items()}
                for p, curves in found.items()
            }
            for data, found in unseen.items()
        },
        "skipped": skipped,
    }


EXPERIMENT = Experiment(
    Corradi2015Plan, _measure, tables, pictures, introduction, TITLE, CAPTIONS
)

__all__ = ["EXPERIMENT", "Corradi2015Plan"]
