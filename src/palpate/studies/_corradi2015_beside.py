"""Rows of the Corradi 2015 study: sight beside touch, and a camera that moved."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ..touches import Touches
from . import released
from ._corradi2015_plan import LATER_SIGHT, Corradi2015Plan
from ._corradi2015_tasks import DEFAULT
from ._recorded import labels

Rows = list[dict[str, Any]]
WORDS = Path("bathtip") / "visual_words50.npz"
# Labels and ways as tables of rows.
SIGHT = {label: f"sight, {label}" for label in released.SPLIT_FOR}
MOVED = {way: f"moved, {way}" for way in released.WAYS}


def beside_tasks(
    plan: Corradi2015Plan, touches: Touches, data: str | Path | None
) -> tuple[list[Callable[[], Rows]], list[str]]:
    """Return what is to be run, and a sentence for each kind of rows left out."""
    tasks: list[Callable[[], Rows]] = []
    skipped = []
    words = Path(data if data is not None else os.environ["PALPATE_DATA"]) / WORDS
    if words.is_file():
        seen = released.read_photographs(words)
        tasks += [partial(sight_rows, plan, touches, seen, label) for label in SIGHT]
    else:
        skipped.append(
            "The rows of sight beside touch are left out: the folder of recorded "
            f"touches has no {WORDS}."
        )
    lacking = _lacking(touches)
    if lacking:
        skipped.append(
            "The rows of objects whose camera moved are left out: the recorded touches "
            f"have no {lacking}."
        )
    else:
        tasks.append(partial(moved_rows, plan, touches))
    return tasks, skipped


def sight_rows(
    plan: Corradi2015Plan,
    touches: Touches,
    photographs: released.Photographs,
    label: str,
) -> Rows:
    """Return rows of touch, a photograph and both, beside the first author's."""
    with threadpool_limits(limits=1):
        right = released.sight(
            touches,
            photographs,
            label,
            lengths=plan.touches,
            orders=plan.orders,
            seed=plan.seed,
        )
    rows = []
    for sense, curve in right.items():
        for k, shares in curve.items():
            known = {"recogniser": sense, "touches": k, "objects": len(shares)}
            paper = LATER_SIGHT[label, sense].get(k)
            spread = shares.std(ddof=1) if len(shares) > 1 else None
            rows.append(_row(SIGHT[label], known, paper, shares.mean(), spread))
    return rows


def moved_rows(plan: Corradi2015Plan, touches: Touches) -> Rows:
    """Return rows of `default`, and of the controls, on the move's other side."""
    with threadpool_limits(limits=1):
        found = released.moved(
            touches, lengths=plan.touches, orders=plan.orders, seed=plan.seed
        )
    rows = []
    for way, figures in found.items():
        curves = {DEFAULT: figures["accuracy"], **figures["controls"]}
        for name, curve in curves.items():
            for k, share in (curve or {}).items():
                n_objects = figures["n_objects"][k]
                known = {"recogniser": name, "touches": int(k), "objects": n_objects}
                spread = figures["accuracy_sd"][k] if name == DEFAULT else None
                rows.append(_row(MOVED[way], known, None, share, spread))
    return rows


def _lacking(touches: Touches) -> str:
    """Return what a study of moved cameras does not find, "" if nothing."""
    if not np.isin(labels(touches), released.MOVED).any():
        return f"object among {', '.join(released.MOVED)}"
    if touches.order is None or released.RIM not in touches.columns:
        return f"columns 'order' and {released.RIM!r}"
    return ""


def _row(
    table: str,
    known: dict[str, Any],
    paper: float | None,
    share: float,
    spread: float | None,
) -> dict[str, Any]:
    """Return a row in per cent; the spread is that of objects."""
    k = known["touches"]
    return {
        "name": f"{table}, {known['recogniser']}, {k} touch{'es' if k != 1 else ''}",
        "paper": paper,
        "ours": float(100 * share),
        "sd": None if spread is None else float(100 * spread),
        "data": "bathtip",
        "table": table,
        **known,
    }
