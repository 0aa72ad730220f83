"""The study of sessions: taught on some days or mountings, asked on another.

Simulated domes and arrays that are mounted anew, and every archive of the folder of
recorded touches in which objects were met in several sessions. Each session in turn is
asked and the others teach, with what `remount` does beside nothing done, what nuisance
values alone achieve, and the last quarter of the same sessions as a ceiling.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ... import studies as shared
from ..._page import CONTROL_COLOURS, OURS, panels
from ..._types import Label
from ...datasets import where
from ...evaluation import Plan as EvaluationPlan
from ...evaluation import evaluate, roc_area, split_by_count, split_touches
from ...recognition import ObjectRecogniser
from ...simulation import simulate_presses, simulate_touches
from ...touches import Touches, TouchesError
from .. import Figures, Plan, Row, Table, Work, coded
from ..corradi2015.beside import lacks_move, moved

WAYS = {
    "none": "as it is",
    "recentre": "its touches without labels",
    "recentre:20": "its first 20 without labels",
    "confirm:1": "one confirmed touch an object",
    "confirm:3": "three confirmed",
}
CEILING = "the last quarter of the same sessions"
ALARM = "alarm"
PAIRS, MOVED = "pairs of others known", "after the camera jumped"
N_ALARM_TOUCHES = 10  # a first handful of a session
TITLE = "Taught in some sessions, asked in another"
CAPTIONS = {"sessions": "Right after one touch, each session left out, in per cent"}


@dataclass(frozen=True)
class SessionsPlan(Plan):
    """Sizes of the study of sessions."""

    sessions: int = 4
    touches_each: int = 20
    touches: tuple[int, ...] = (1, 5, 10)
    orders: int = 20
    draws: int = 100
    ways: tuple[str, ...] = tuple(WAYS)
    objects: tuple[str, ...] | None = None
    recorded: bool = True
    first_look: ClassVar[dict[str, Any]] = {
        "sessions": 2,
        "touches_each": 10,
        "touches": (1, 5),
        "orders": 5,
        "draws": 20,
        "recorded": False,
        "ways": ("none", "recentre", "confirm:1"),
        "objects": ("mug", "ball", "stapler", "box", "pen"),
    }

    def __post_init__(self) -> None:
        self.check_counts("touches", "orders", "draws")
        self.check_counts("sessions", "touches_each", at_least=2)


PLAN = SessionsPlan


def measure(plan: SessionsPlan, data: str | Path | None, work: Work) -> dict[str, Any]:
    n_touches = plan.sessions * plan.touches_each
    sizes: dict[str, Any] = {"n_sessions": plan.sessions, "random_state": plan.seed}
    mounted = {**sizes, "mountings": True, "n_jobs": work.workers}
    parts = None if plan.objects is None else range(1, len(plan.objects) + 1)
    sources = {
        "simulated dome": simulate_touches(plan.objects, n_touches, **mounted),
        "simulated array": simulate_presses(parts, n_touches, **sizes),
    }
    ways = dict.fromkeys(sources, (*plan.ways, CEILING, ALARM))
    folder, skipped = where(data), []
    if folder.is_dir() and plan.recorded:
        for name, touches, its_ways in _recorded(plan, folder):
            sources[name], ways[name] = touches, its_ways
    else:
        why = f"no {folder}; see `data`" if plan.recorded else "a first look"
        skipped = [f"Recorded touches are left out: {why}."]
    tasks = [
        (plan, name, touches, way)
        for name, touches in sources.items()
        for way in ways[name]
    ]
    rows_of_tasks = work.done(_rows_of, tasks, "Sessions")
    return {"rows": [row for rows in rows_of_tasks for row in rows], "skipped": skipped}


def _recorded(
    plan: SessionsPlan, folder: Path
) -> Iterator[tuple[str, Touches, tuple[str, ...]]]:
    """Yield archives, and what can be asked of them.

    All in which at least two objects were met in several sessions, and those objects
    whose camera jumped within their recording.
    """
    for path in sorted(folder.rglob("*.npz")):
        try:
            touches = Touches.load(path)
        except TouchesError:
            continue
        objects, sessions = touches.object, touches.session
        if not lacks_move(touches):
            yield path.stem, touches, (MOVED,)
        if objects is None or sessions is None:
            continue
        met = np.unique(np.stack([objects, sessions.astype(str)]), axis=1)[0]
        names, n_sessions = np.unique(met, return_counts=True)
        several = np.isin(objects, names[n_sessions > 1])
        if len(np.unique(objects[several])) > 1:
            people = () if touches.subject is None else (PAIRS,)
            ways = *plan.ways, *people, CEILING, ALARM
            yield path.stem, touches[several], ways


def _rows_of(plan: SessionsPlan, data: str, touches: Touches, way: str) -> list[Row]:
    if way == ALARM:
        return _alarm(plan, data, touches)
    protocol = EvaluationPlan(touches=plan.touches, orders=plan.orders, seed=plan.seed)
    beside = {CEILING: _ceiling, PAIRS: _pairs_known, MOVED: _moved}
    if way in beside:
        return beside[way](protocol, data, touches)
    protocol = replace(protocol, remount=way)
    figures, trials = evaluate(touches, split="session", plan=protocol)
    rows = []
    for k in plan.touches:
        scores = [t.episodes.scores(k) for t in trials]
        shares = [score.accuracy.mean() for score in scores if score is not None]
        if shares:
            losses = {"log_loss": figures["log_loss"][str(k)]}
            rows.append({**_row(data, WAYS.get(way, way), k, shares), **losses})
    if way == "none":
        for name, curve in figures["controls"].items():
            for k, share in (curve or {}).items():
                rows.append(_row(data, f"{name} alone", int(k), [share]))
    return rows


def _ceiling(protocol: EvaluationPlan, data: str, touches: Touches) -> list[Row]:
    """Ask the last quarter of each session; where it is too short, person by person."""
    assert touches.session is not None
    each = [touches[touches.session == name] for name in np.unique(touches.session)]
    fewest = min(int(np.bincount(coded(session)).min()) for session in each)
    if fewest < 4 and touches.subject is None:
        return []
    split = "last" if fewest > 3 else "subject"
    after = [evaluate(s, split=split, plan=protocol)[0]["accuracy"] for s in each]
    return [
        _row(data, CEILING, k, [accuracy[str(k)] for accuracy in after])
        for k in protocol.touches
        if all(str(k) in accuracy for accuracy in after)
    ]


def _pairs_known(protocol: EvaluationPlan, data: str, touches: Touches) -> list[Row]:
    """Ask half of the people in one session, of the others all sessions are known."""
    people = np.unique(np.asarray(touches.subject), return_inverse=True)[1]
    names: Any = touches.session
    tests = [
        (names == name) & (people % 2 == half)
        for name in np.unique(names)
        for half in range(2)
    ]
    rows = []
    for way in ("none", "recentre"):
        plan = replace(protocol, remount=way)
        figures = [evaluate(touches[~t], touches[t], plan=plan)[0] for t in tests]
        rows += _rows_after(data, f"{PAIRS}, {WAYS[way]}", figures, protocol)
    return rows


def _moved(protocol: EvaluationPlan, data: str, touches: Touches) -> list[Row]:
    """Ask about objects on the other side of the jump, among all the others."""
    rows = []
    label_and_remount: list[tuple[Label, str]]
    label_and_remount = [
        ("object", "none"),
        ("object", "recentre"),
        ("category", "none"),
    ]
    for label, way in label_and_remount:
        results = moved(touches, replace(protocol, remount=way, label=label)).values()
        rows += _rows_after(data, f"{label} {MOVED}, {WAYS[way]}", results, protocol)
    return rows


def _alarm(plan: SessionsPlan, data: str, touches: Touches) -> list[Row]:
    """Ask about ten touches of the session left out, and of those that were taught."""
    rates: dict[str, list[float]] = {"area": [], "false alarms": [], "caught": []}
    for fold in split_touches(touches, "session"):
        n_taught = 3 * int(np.bincount(coded(fold.train)).min()) // 4
        if n_taught < 2:
            return []
        rng = np.random.default_rng(plan.seed)
        taught, same = split_by_count(fold.train, n_taught, plan.seed)
        recogniser = ObjectRecogniser(random_state=plan.seed).fit(taught)
        checks = [
            [
                recogniser.check_mounting(
                    side[rng.permutation(len(side))[:N_ALARM_TOUCHES]]
                )
                for _ in range(plan.draws)
            ]
            for side in (same, fold.test)
        ]
        rates["area"].append(roc_area(*([c.distance for c in side] for side in checks)))
        for name, of_side in zip(("false alarms", "caught"), checks, strict=True):
            rates[name].append(float(np.mean([check.changed for check in of_side])))
    return [
        _row(data, f"{ALARM}: {name}", N_ALARM_TOUCHES, shares)
        for name, shares in rates.items()
    ]


def _rows_after(
    data: str, way: str, figures: Iterable[dict[str, Any]], protocol: EvaluationPlan
) -> list[Row]:
    """Return a row after each number of touches that some of the figures go to."""
    curves = [figure["accuracy"] for figure in figures]
    shares = {k: [c[str(k)] for c in curves if str(k) in c] for k in protocol.touches}
    return [_row(data, way, k, right) for k, right in shares.items() if right]


def _row(data: str, way: str, k: int, shares: list[float]) -> Row:
    shown = shared.mean_row(f"{data}, {way}, after {k}", 100 * np.array(shares))
    return {**shown, "data": data, "way": way, "touches": k}


def tables(result: dict[str, Any]) -> list[Table]:
    """Return a table for each source of touches, figures in per cent."""
    shown = []
    for data in shared.unique(row["data"] for row in result["rows"]):
        of_data = shared.held(result["rows"], data=data)
        counts = sorted({row["touches"] for row in of_data})
        after = [{"touches": k} for k in counts]
        lines = shared.pivot(of_data, ["way"], after, shared.cell)
        shown.append((data, ["what is done", *(f"after {k}" for k in counts)], lines))
    return shown


def pictures(result: dict[str, Any]) -> Figures:
    """Return bars of the accuracy after one touch."""
    ways = [*WAYS.values(), CEILING]
    shown = [r for r in shared.held(result["rows"], touches=1) if r["way"] in ways]
    names = shared.unique(row["data"] for row in shown)
    figure, axes = panels(1, 1, (7, 1 + 1.1 * len(names)))
    place = axes[0, 0]
    for row in shown:
        number = ways.index(row["way"])
        at = names.index(row["data"]) + 0.13 * (number - len(ways) / 2)
        colour = CONTROL_COLOURS[0] if row["way"] == CEILING else OURS
        alpha = 0.35 + 0.65 * number / len(ways)
        place.barh(at, row["ours"], 0.12, color=colour, alpha=alpha)
        place.text(row["ours"] + 1, at, row["way"], fontsize=7, va="center")
    place.set(yticks=range(len(names)), yticklabels=names, xlim=(0, 130))
    place.set(xticks=range(0, 101, 20), xlabel="right after one touch, %")
    place.invert_yaxis()
    return {"sessions": figure}


def introduction(result: dict[str, Any]) -> str:
    return str(__doc__).partition("\n\n")[2]
