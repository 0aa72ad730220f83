"""From the answers of all partitions to the rows of the Corradi 2015 study."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ._corradi2015_encodings import Floats
from ._corradi2015_plan import (
    LATER_CATEGORY,
    LATER_OBJECTS,
    PAPER,
    PAPER_CLUSTERS,
    Corradi2015Plan,
)
from ._corradi2015_runs import Outcome
from ._corradi2015_tasks import CLUSTERS, IDLE, MAIN, Answered
from ._corradi2015_touches import Objects
from ._recorded import labels

CONFUSED_AFTER = (5, 15)
UNSEEN_AFTER = (1, 5, 10, 30)
_FIGURES: dict[tuple[str, str], dict[int, float]] = {
    ("ten objects", MAIN): PAPER,
    ("ten objects", CLUSTERS): PAPER_CLUSTERS,
    ("all objects", MAIN): LATER_OBJECTS,
    ("category", MAIN): LATER_CATEGORY,
}
Key = tuple[str, str, str]


def collect(answered: Iterable[Answered]) -> dict[Key, Outcome]:
    """Put the answers of a recogniser together: (experiment, data, recogniser)."""
    found: dict[Key, Outcome] = {}
    for one in answered:
        for name, answers in one.answers.items():
            outcome = found.setdefault((one.experiment, one.data, name), Outcome())
            outcome.answers.append(answers)
            outcome.truth.append(one.truth[name])
            outcome.facts.append(one.facts.get(name, {}))
    return found


def experiment_rows(
    answered: Iterable[Answered], plan: Corradi2015Plan
) -> list[dict[str, Any]]:
    """Return the rows of every experiment, data, recogniser and number of touches."""
    rows = []
    for (experiment, data, name), outcome in collect(answered).items():
        known = {
            "data": data,
            "table": experiment,
            "recogniser": name,
            "partitions": len(outcome.answers),
            **_facts(outcome),
        }
        curve = _idle_curve(outcome) if name in IDLE.values() else outcome.accuracy()
        for k in plan.touches:
            if k <= curve.shape[1]:
                rows.append({**_row(experiment, name, k, curve), **known})
    return rows


def confusions(
    answered: Iterable[Answered], objects: Objects, plan: Corradi2015Plan
) -> dict[str, Any]:
    """Return the confusion matrices of the paper's recogniser, and its worst pairs.

    Rows are the objects touched, columns the answers, both as `names`; shares of
    1. A pair's share is that of both mistakes among both objects' episodes.
    """
    outcome = collect(answered)["ten objects", objects.data, MAIN]
    names = np.unique(labels(objects.known)).tolist()
    after = sorted({min(k, plan.n_test) for k in CONFUSED_AFTER})
    matrices = {str(k): outcome.confusion(k, len(names)) for k in after}
    return {
        "names": names,
        "after": {k: matrix.round(4).tolist() for k, matrix in matrices.items()},
        "pairs": {k: worst_pairs(matrix, names) for k, matrix in matrices.items()},
    }


def worst_pairs(
    confusion: Floats, names: list[str], most: int = 3
) -> list[dict[str, Any]]:
    """Return the pairs that are taken for each other most often, worst first."""
    both = (confusion + confusion.T) / 2
    above = np.triu_indices(len(names), 1)
    order = np.argsort(-both[above], kind="stable")[:most]
    return [
        {
            "objects": [names[above[0][i]], names[above[1][i]]],
            "share": float(100 * both[above][i]),
        }
        for i in order.tolist()
    ]


def unseen_rows(
    beliefs: dict[str, dict[str, Floats]], objects: Objects
) -> list[dict[str, Any]]:
    """Return which known object each unseen one is taken for, after some touches."""
    known = np.unique(labels(objects.known)).tolist()
    rows = []
    for preset, curves in beliefs.items():
        for name, curve in curves.items():
            for k in UNSEEN_AFTER:
                if k <= len(curve):
                    order = np.argsort(-curve[k - 1], kind="stable")[:3].tolist()
                    share = {known[i]: float(100 * curve[k - 1, i]) for i in order}
                    best = known[order[0]]
                    rows.append(
                        {
                            "name": f"{name} taken for {best}, {preset}, {k} touches",
                            "paper": None,
                            "ours": share[best],
                            "sd": None,
                            "data": objects.data,
                            "table": "unseen",
                            "recogniser": preset,
                            "unseen": name,
                            "touches": k,
                            "beliefs": share,
                        }
                    )
    return rows


def _row(experiment: str, name: str, k: int, curve: Floats) -> dict[str, Any]:
    per_cent = 100 * curve[:, k - 1]
    paper = _FIGURES.get((experiment, name), {}).get(k)
    spread = float(per_cent.std(ddof=1)) if len(per_cent) > 1 else None
    return {
        "name": f"{experiment}, {name}, {k} touch{'es' if k > 1 else ''}",
        "paper": paper,
        "ours": float(per_cent.mean()),
        "sd": spread,
        "touches": k,
    }


def _idle_curve(outcome: Outcome) -> Floats:
    """Return the share right of all touches without contact, however they fell."""
    pairs = zip(outcome.answers, outcome.truth, strict=True)
    right = np.concatenate([a[:, 0] == t for a, t in pairs])
    return np.array([[right.mean()]])


def _facts(outcome: Outcome) -> dict[str, float]:
    """Return the mean over partitions of what there is to say besides answers."""
    names = outcome.facts[0]
    return {name: float(np.mean([f[name] for f in outcome.facts])) for name in names}
