"""Categories of unseen objects, object by object, beside what the disc's place says.

The objects were recorded one by one and the camera shifted in between, so that the
place of the disc in the picture tells much. This groups the objects of the split
"unseen-objects" by how often the nuisance control "disc centre" alone is right after
one touch, and tells how often `default` is right in each group.

    PALPATE_DATA=... python benchmarks/place_control.py
"""

import argparse
import json
import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate import Touches
from palpate.evaluation import Plan, control_log_likelihood, evaluate
from palpate.evaluation._comparisons import disc_centres
from palpate.evaluation._episodes import Episodes, run_episodes
from palpate.evaluation._trial import Trial

AFTER = (1, 5)
# Shares of touches of one object that the control names; the last includes 1.
BOUNDS = (0.0, 0.1, 0.5, 0.9, 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", default=os.environ.get("PALPATE_DATA"))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if not options.data:
        parser.error("name the folder of real touches with --data or PALPATE_DATA")
    touches = Touches.load(Path(options.data) / "bathtip" / "bathtip50.npz")
    plan = Plan(label="category", touches=AFTER, seed=options.seed)
    figures, trials = evaluate(touches, split="unseen-objects", plan=plan)
    objects = [row for trial in trials for row in _objects(trial, plan)]
    result = {
        "accuracy": figures["accuracy"],
        "disc centre": figures["controls"]["disc centre"],
        "groups": [_group(objects, *bounds) for bounds in pairwise(BOUNDS)],
        "objects": objects,
    }
    print(json.dumps(result, indent=1))


def _objects(trial: Trial, plan: Plan) -> list[dict[str, Any]]:
    """Return how often `default` and the disc's place are right, by test object."""
    right = {str(k): _accuracy(trial.episodes, k) for k in AFTER}
    place = _place_accuracy(trial, plan)
    return [
        {
            "object": name,
            "disc centre": float(place[number]),
            "default": {k: float(shares[number]) for k, shares in right.items()},
        }
        for number, name in enumerate(trial.episodes.objects)
    ]


def _place_accuracy(trial: Trial, plan: Plan) -> NDArray[np.float64]:
    """Return the share of single touches that the disc's place names, by object."""
    train, test = trial.fold.train, trial.fold.test
    recogniser, memory = trial.recogniser, trial.recogniser.memory_
    groups = recogniser.left_out_groups(train)
    of_train, of_test = disc_centres(train), disc_centres(test)
    assert of_train is not None
    assert of_test is not None
    values = control_log_likelihood(of_train, memory.labels, groups, of_test)
    arguments = (test.object, test.category, plan.orders, plan.seed)
    return _accuracy(run_episodes(recogniser, values, *arguments), 1)


def _accuracy(episodes: Episodes, k: int) -> NDArray[np.float64]:
    scored = episodes.scores(k)
    assert scored is not None
    return scored.accuracy


def _group(objects: list[dict[str, Any]], low: float, high: float) -> dict[str, Any]:
    def held(share: float) -> bool:
        return low <= share < high or share == high == BOUNDS[-1]

    rows = [row for row in objects if held(row["disc centre"])]
    shares = {
        k: np.array([100 * row["default"][str(k)] for row in rows]) for k in AFTER
    }
    return {
        "disc centre right": [low, high],
        "n_objects": len(rows),
        "default": {str(k): round(float(s.mean()), 1) for k, s in shares.items()},
        "sd": {str(k): round(float(s.std(ddof=1)), 1) for k, s in shares.items()},
    }


if __name__ == "__main__":
    main()
