"""Two more questions to the released recordings: sight beside touch, a moved camera.

The first author's own experiments joined touches with a photograph of the object. And
in some recordings the camera moved: what was learnt before must do after. `sight` and
`moved` ask it of any touches; the study's rows are made of what they answer.
"""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._types import Bools, Floats, Label
from ...datasets import where
from ...evaluation import Plan, evaluate, split_touches
from ...recognition import ObjectRecogniser
from ...touches import Touches
from .. import Row, labels, row, spread
from .episodes import DEFAULT, after_touches
from .plan import LATER_SIGHT, Corradi2015Plan

RIM = "rim_circle_row_col_radius_px"
# By 24, 14, 12, 9, 8 and 7 pixels of the camera, once each.
MOVED = (
    "bowl_whitebig",
    "bowl_darkblue",
    "bowl_blackstripes",
    "bottlefull_gingerale",
    "mug_blacksquared",
    "softtoy_pinkrabbit",
)
SENSES = ("touch", "sight", "both")
WAYS = ("before -> after", "after -> before")
SPLIT_FOR = {"object": "last", "category": "unseen-objects"}
WORDS = Path("bathtip") / "visual_words50.npz"
# Labels and ways as tables of rows.
SIGHT = {label: f"sight, {label}" for label in SPLIT_FOR}
MOVES = {way: f"moved, {way}" for way in WAYS}


class Photographs(NamedTuple):
    """Roots of the shares of visual words (n_photographs, n_words); what they show."""

    words: Floats
    object: NDArray[np.str_]


def read_photographs(path: str | Path) -> Photographs:
    """Read an archive of `counts` (n_photographs, n_words) and `object`."""
    with np.load(path) as archive:
        counts, names = archive["counts"].astype(np.float64), archive["object"]
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    return Photographs(np.sqrt(share), names)


def sight(
    touches: Touches, photographs: Photographs, protocol: Plan
) -> dict[str, dict[int, Floats]]:
    """Recognise by touch, by one photograph and by both: `right[sense][k]`, by object.

    The label "object" tests the last touches of each recording and learns every other
    photograph, "category" tests objects neither touched nor seen before. Each order
    comes with a random photograph; sight alone is k = 0.
    """
    both = touches[np.isin(labels(touches), photographs.object)]
    shown = np.isin(photographs.object, labels(both))
    seen = Photographs(photographs.words[shown], photographs.object[shown])
    rng = np.random.default_rng(protocol.seed)
    right: dict[str, dict[int, list[float]]] = {sense: {} for sense in SENSES}
    for fold in split_touches(both, SPLIT_FOR[protocol.label]):
        for sense, k, hits in _fused(fold.train, fold.test, seen, protocol, rng):
            right[sense].setdefault(k, []).append(float(np.mean(hits)))
    return {
        sense: {k: np.array(shares) for k, shares in curve.items()}
        for sense, curve in right.items()
    }


def moved(touches: Touches, protocol: Plan) -> dict[str, dict[str, Any]]:
    """Learn all objects, and the moved ones on one side of their move alone.

    The rim's column only says when the camera moved. Returns, for each of `WAYS`, what
    `evaluate` says of the moved objects' touches on the other side.
    """
    early = before_the_move(touches)
    jumped = np.isin(labels(touches), MOVED)
    return {
        way: evaluate(touches[~jumped | side], touches[jumped & ~side], plan=protocol)[
            0
        ]
        for way, side in zip(WAYS, (early, ~early), strict=True)
    }


def lacks_move(touches: Touches) -> str:
    """Return what touches lack for `moved`, "" for nothing."""
    if touches.object is None or not np.isin(touches.object, MOVED).any():
        return f"object among {', '.join(MOVED)}"
    if touches.order is None or RIM not in touches.columns:
        return f"columns 'order' and {RIM!r}"
    return ""


def before_the_move(touches: Touches) -> Bools:
    """Mark touches before the camera moved; all of the objects where it did not."""
    assert touches.order is not None
    centres = touches.columns[RIM][:, :2]
    early = np.ones(len(touches), dtype=bool)
    for name in MOVED:
        rows = np.flatnonzero(labels(touches) == name)
        if len(rows):
            rows = rows[np.argsort(touches.order[rows])]
            early[rows[jump_of(centres[rows]) :]] = False
    return early


def jump_of(centres: NDArray[Any]) -> int:
    """Return where centres break into two levels, nearest to their medians."""
    n = len(centres)
    at = range(n // 8, n - n // 8)
    return at[int(np.argmin([_spread(centres[:k]) + _spread(centres[k:]) for k in at]))]


def _spread(centres: NDArray[Any]) -> float:
    return float(np.linalg.norm(centres - np.median(centres, axis=0), axis=1).sum())


def beside_tasks(
    plan: Corradi2015Plan, touches: Touches, data: str | Path | None
) -> tuple[list[Callable[[], list[Row]]], list[str]]:
    """Return what is to be run, and a sentence for each kind of rows left out."""
    tasks: list[Callable[[], list[Row]]] = []
    labels: tuple[Label, ...] = "object", "category"
    skipped = []
    words = where(data) / WORDS
    if words.is_file():
        seen = read_photographs(words)
        tasks += [partial(sight_rows, plan, touches, seen, label) for label in labels]
    else:
        skipped.append(
            "The rows of sight beside touch are left out: the folder of recorded "
            f"touches has no {WORDS}."
        )
    if lacking := lacks_move(touches):
        skipped.append(
            "The rows of objects whose camera moved are left out: the recorded touches "
            f"have no {lacking}."
        )
    else:
        tasks.append(partial(moved_rows, plan, touches))
    return tasks, skipped


def sight_rows(
    plan: Corradi2015Plan, touches: Touches, photographs: Photographs, label: Label
) -> list[Row]:
    """Return rows of touch, a photograph and both, beside the first author's."""
    rows = []
    for sense, curve in sight(touches, photographs, _protocol(plan, label)).items():
        for k, shares in curve.items():
            facts = {"recogniser": sense, "touches": k, "objects": len(shares)}
            paper = LATER_SIGHT[label, sense].get(k)
            mean, sd = shares.mean(), spread(shares)
            rows.append(_row(SIGHT[label], facts, paper, mean, sd))
    return rows


def moved_rows(plan: Corradi2015Plan, touches: Touches) -> list[Row]:
    """Return rows of `default`, and of the controls, on the move's other side."""
    rows = []
    for way, figures in moved(touches, _protocol(plan)).items():
        curves = {DEFAULT: figures["accuracy"], **figures["controls"]}
        for name, curve in curves.items():
            for k, share in (curve or {}).items():
                n_objects = figures["n_objects"][k]
                facts = {"recogniser": name, "touches": int(k), "objects": n_objects}
                sd = figures["accuracy_sd"][k] if name == DEFAULT else None
                rows.append(_row(MOVES[way], facts, None, share, sd))
    return rows


def _protocol(plan: Corradi2015Plan, label: Label = "object") -> Plan:
    return Plan(label=label, touches=plan.touches, orders=plan.orders, seed=plan.seed)


def _row(
    table: str, kept: Row, paper: float | None, share: float, sd: float | None
) -> Row:
    """Return a row in per cent; the deviation is that of objects."""
    shown = after_touches(table, kept["recogniser"], kept["touches"])
    deviation = None if sd is None else float(100 * sd)
    facts = {"data": "bathtip", "table": table, **kept}
    return row(shown, 100 * share, deviation, paper, **facts)


def _fused(
    train: Touches,
    test: Touches,
    seen: Photographs,
    protocol: Plan,
    rng: np.random.Generator,
) -> Iterator[tuple[str, int, list[bool]]]:
    """Yield sense, number of touches and what was right, object by object."""
    kinds = {
        name: kind
        for part in (train, test)
        for name, kind in zip(labels(part), labels(part, protocol.label), strict=True)
    }
    kind_of = np.array([kinds[name] for name in seen.object])
    # Objects: half of the photographs; categories: those of the known objects.
    learnt = np.isin(seen.object, labels(train))
    if protocol.label == "object":
        learnt = np.arange(len(kind_of)) % 2 == 0
    recogniser = ObjectRecogniser(label=protocol.label).fit(train)
    recogniser.learn_modality("sight", seen.words[learnt], kind_of[learnt])
    rows = recogniser.log_likelihood(test)
    for name in np.unique(labels(test)):
        members = np.flatnonzero(test.object == name)
        pool = np.flatnonzero((seen.object == name) & ~learnt)
        hits: dict[tuple[str, int], list[bool]] = {}
        for _ in range(protocol.orders):
            order, photograph = rng.permutation(members), seen.words[rng.choice(pool)]
            alone = recogniser.start().update_sense("sight", photograph).best
            hits.setdefault(("sight", 0), []).append(alone == kinds[name])
            for k in (k for k in protocol.touches if k <= len(members)):
                belief = recogniser.start()
                belief.update_from_log_likelihood(rows[order[:k]])
                hits.setdefault(("touch", k), []).append(belief.best == kinds[name])
                both = belief.update_sense("sight", photograph).best
                hits.setdefault(("both", k), []).append(both == kinds[name])
        for (sense, k), rights in hits.items():
            yield sense, k, rights
