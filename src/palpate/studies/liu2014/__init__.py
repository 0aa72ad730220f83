"""The Liu 2014 study: from one press of a pressure array to one of twelve parts.

Ten runs of twofold cross-validation, as in section 4 of the paper; the class sets
of Figs 12 to 14, the rows of Table 2, load and cover as in Figs 5 and 6; simulated
presses, and real presses of another array where they are at hand.
"""

from pathlib import Path
from typing import Any

from .._study import Experiment, Work
from .._touches import recorded_touches
from ._jobs import condition_jobs, run_jobs, study_jobs
from ._methods import Fused as Fused
from ._methods import GaussianSVM as GaussianSVM
from ._methods import Half as Half
from ._methods import Neighbours as Neighbours
from ._methods import Twofold as Twofold
from ._methods import median_distance as median_distance
from ._methods import nested_figure as nested_figure
from ._methods import paper_figure as paper_figure
from ._plan import CLASS_SETS as CLASS_SETS
from ._plan import Liu2014Plan as Liu2014Plan
from ._presses import REAL, reposed_presses, simulated_presses
from ._presses import count_pieces as count_pieces
from ._presses import encode as encode
from ._presses import footprints as footprints
from ._presses import overlap as overlap
from ._report import CAPTIONS, TITLE, introduction, pictures, tables


def _measure(plan: Liu2014Plan, data: str | Path | None, work: Work) -> dict[str, Any]:
    real = recorded_touches(data, REAL)
    jobs = study_jobs(plan, simulated_presses(plan), "simulated")
    if not isinstance(real, str):
        jobs += study_jobs(plan, reposed_presses(real, plan.seed), "taxel10x10")
    jobs += condition_jobs(plan)
    rows = run_jobs(jobs, plan, work)
    return {"rows": rows, "skipped": [real] if isinstance(real, str) else []}


EXPERIMENT = Experiment(
    Liu2014Plan, _measure, tables, pictures, introduction, TITLE, CAPTIONS
)

__all__ = ["EXPERIMENT", "REAL", "Liu2014Plan", "reposed_presses", "simulated_presses"]
