"""From answers and beliefs to the rows of the Corradi 2015 study; and its timings."""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from sklearn.decomposition import PCA

from ..._types import Floats
from ...classifiers import KernelDensityBayes
from ...touches import Touches
from .._report import Row, mean_row, row
from .._touches import labels
from ._episodes import CLUSTERS, IDLE, MAIN, Answered
from ._plan import (
    LATER_CATEGORY,
    LATER_OBJECTS,
    N_KNOWN,
    PAPER,
    PAPER_CLUSTERS,
    PAPER_MS,
    Corradi2015Plan,
)
from ._recognisers import principal_components
from ._touches import Encoder, Objects

CONFUSED_AFTER = (5, 15)
UNSEEN_AFTER = (1, 5, 10, 30)
_FIGURES: dict[tuple[str, str], dict[int, float]] = {
    ("ten objects", MAIN): PAPER,
    ("ten objects", CLUSTERS): PAPER_CLUSTERS,
    ("all objects", MAIN): LATER_OBJECTS,
    ("category", MAIN): LATER_CATEGORY,
}


def experiment_rows(answered: Iterable[Answered], plan: Corradi2015Plan) -> list[Row]:
    """Return the rows of every experiment, data, recogniser and number of touches."""
    together: dict[tuple[str, str, str], list[Answered]] = {}
    for one in answered:
        together.setdefault(one[:3], []).append(one)
    rows = []
    for (experiment, data, name), some in together.items():
        known = {"data": data, "table": experiment, "recogniser": name}
        facts = {
            fact: float(np.mean([one.facts[fact] for one in some]))
            for fact in some[0].facts
        }
        if name in IDLE.values():
            # Of all touches without contact, however they fell.
            right = np.concatenate([one.answers[:, 0] == one.truth for one in some])
            curve = np.array([[right.mean()]])
        else:
            curve = accuracy(some)
        for k in plan.touches:
            if k <= curve.shape[1]:
                paper = _FIGURES.get((experiment, name), {}).get(k)
                shown = after_touches(experiment, name, k)
                figures = mean_row(shown, 100 * curve[:, k - 1], paper)
                rows.append(
                    {**figures, "touches": k, **known, "partitions": len(some), **facts}
                )
    return rows


def after_touches(table: str, recogniser: str, k: int) -> str:
    """Return the name of a row."""
    return f"{table}, {recogniser}, {k} touch{'es' if k != 1 else ''}"


def accuracy(answered: Iterable[Answered]) -> Floats:
    """Return the share right, (n_partitions, n_touches)."""
    return np.array(
        [(one.answers == one.truth[:, np.newaxis]).mean(axis=0) for one in answered]
    )


def confusion(answered: Iterable[Answered], k: int, n_labels: int) -> Floats:
    """Return the share of each answer (columns) after k touches per label."""
    counts = np.zeros((n_labels, n_labels))
    for one in answered:
        np.add.at(counts, (one.truth, one.answers[:, k - 1]), 1)
    shares: Floats = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    return shares


def confusions(
    answered: Iterable[Answered], objects: Objects, plan: Corradi2015Plan
) -> dict[str, Any]:
    """Return shares of answers (columns) per object (rows), and the worst pairs."""
    mine = [a for a in answered if a[:3] == ("ten objects", objects.data, MAIN)]
    names = np.unique(labels(objects.known)).tolist()
    after = sorted({min(k, plan.n_test) for k in CONFUSED_AFTER})
    matrices = {str(k): confusion(mine, k, len(names)) for k in after}
    return {
        "names": names,
        "after": {k: matrix.round(4).tolist() for k, matrix in matrices.items()},
        "pairs": {k: worst_pairs(matrix, names) for k, matrix in matrices.items()},
    }


def worst_pairs(
    confusion: Floats, names: Sequence[str], most: int = 3
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


def unseen_rows(beliefs: dict[str, dict[str, Floats]], objects: Objects) -> list[Row]:
    """Return which known object each unseen one is taken for, after some touches."""
    known = np.unique(labels(objects.known)).tolist()
    asked = [
        (preset, name, k, curve[k - 1])
        for preset, curves in beliefs.items()
        for name, curve in curves.items()
        for k in UNSEEN_AFTER
        if k <= len(curve)
    ]
    rows = []
    for preset, name, k, belief in asked:
        order = np.argsort(-belief, kind="stable")[:3].tolist()
        share = {known[i]: float(100 * belief[i]) for i in order}
        best = known[order[0]]
        shown = f"{name} taken for {best}, {preset}, {k} touches"
        facts = {"data": objects.data, "table": "unseen", "recogniser": preset}
        what = {"unseen": name, "touches": k, "beliefs": share}
        rows.append({**row(shown, share[best]), **facts, **what})
    return rows


def timing_rows(touches: Touches, data: str, sizes: Sequence[int]) -> list[Row]:
    """Return CPU milliseconds, medians, one touch at a time."""
    some = touches[: min(len(touches), max(sizes))]
    encoder, images = Encoder(some, bags=False), some.images
    discs = encoder.crop.transform(images)
    moments = encoder.moments.fit(discs)
    values = moments.transform(discs)

    def whole(i: int) -> None:
        moments.transform(encoder.crop.transform(images[i : i + 1]))

    def alone(i: int) -> None:
        moments.transform(discs[i : i + 1])

    disc, frame = (" x ".join(map(str, one.shape[1:])) for one in (discs, images))
    rows = [
        _timed(f"Zernike moments of a disc, {disc}", PAPER_MS["encode", 0], alone),
        _timed(f"rim, disc and moments of an image, {frame}", None, whole),
    ]
    for size in sizes:
        if len(values) >= size:
            rows += _learning(values[:size])
    return [{**row, "data": data, "table": "timings", "unit": "ms"} for row in rows]


def _learning(values: Floats) -> list[Row]:
    size = len(values)
    codes = np.arange(size) % N_KNOWN

    def learn(_: int) -> tuple[PCA, KernelDensityBayes]:
        principal = principal_components(values)
        model = KernelDensityBayes().fit(principal.transform(values), codes)
        return principal, model

    principal, model = learn(0)

    def recognise(i: int) -> None:
        model.log_likelihood(principal.transform(values[i : i + 1]))

    learning, recognising = (PAPER_MS.get((w, size)) for w in ("learn", "recognise"))
    return [
        _timed(f"learn {size} touches", learning, learn, times=15),
        _timed(f"recognise a touch among {size}", recognising, recognise),
    ]


def _timed(
    name: str, paper: float | None, work: Callable[[int], object], times: int = 60
) -> Row:
    spent = []
    work(0)
    for i in range(times):
        start = time.process_time()
        work(i)
        spent.append(1e3 * (time.process_time() - start))
    sd = float(np.std(spent, ddof=1))
    return row(f"{name}, ms", float(np.median(spent)), sd, paper)
