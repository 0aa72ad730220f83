"""The touches of the Corradi 2015 study: recorded and simulated, known and unseen."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..simulation import HOUSEHOLD, UNSEEN, simulate_touches
from ..touches import Touches
from ._corradi2015_plan import Corradi2015Plan
from ._recorded import labels, recorded_touches

ARCHIVE = Path("bathtip") / "bathtip50.npz"
SOURCE = "github.com/Exhor/deep_visuotactile_classification"
N_UNSEEN = 5
# Categories in which the paper had a second object too, or the nearest to them.
UNSEEN_CATEGORIES = ("ball", "box", "can", "mug", "stapler")


@dataclass(frozen=True)
class Objects:
    """Touches of ten objects to learn, and of others that are never learnt.

    `every` holds all recorded objects, for the first author's later experiments.
    """

    data: str
    known: Touches
    unseen: Touches
    every: Touches | None = None


def simulated_objects(plan: Corradi2015Plan, workers: int) -> Objects:
    """Touch the paper's ten objects and its five unseen ones in simulation.

    The camera stays as it is from object to object, so that its place and exposure
    tell nothing.
    """
    touches = simulate_touches(
        HOUSEHOLD + UNSEEN,
        plan.n_simulated,
        drift=False,
        random_state=plan.seed,
        n_jobs=workers,
    )
    known = np.isin(labels(touches), [thing.name for thing in HOUSEHOLD])
    return Objects("simulated", touches[known], touches[~known])


def recorded_objects(touches: Touches) -> Objects:
    """Take the first object of each category, and the second of five, by name."""
    names = _members(touches)
    known = [members[0] for members in names.values()]
    unseen = [names[category][1] for category in UNSEEN_CATEGORIES]
    chosen = [np.isin(labels(touches), some) for some in (known, unseen)]
    return Objects("bathtip", touches[chosen[0]], touches[chosen[1]], touches)


def real_touches(data: str | Path | None) -> Touches | str:
    """Return the recorded touches, or the sentence that says why there are none."""
    return recorded_touches(data, ARCHIVE, "recorded touches", SOURCE)


def _members(touches: Touches) -> dict[str, list[str]]:
    """Return the objects of each category, both sorted by name."""
    if touches.category is None:
        raise ValueError(
            f"The touches must have a column 'category', got {touches!r}. Label them."
        )
    objects = labels(touches)
    return {
        str(category): np.unique(objects[touches.category == category]).tolist()
        for category in np.unique(touches.category)
    }
