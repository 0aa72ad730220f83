"""The Corradi 2015 study: which of ten objects, touch by touch.

Random partitions into training and test touches, as in section V of the paper, of
simulated touches and of recorded ones where they are at hand; the recognisers that
it is compared with; objects that were never learnt; the first author's later
experiments on the released recordings; timings.
"""

from collections.abc import Sequence
from operator import call
from pathlib import Path
from typing import Any

import numpy as np

from ... import studies as shared
from ..._page import CONTROL_COLOURS, INK, OURS, draw_confusion, panels
from .. import BATHTIP, Figures, Row, Table, Work, recorded_touches
from . import episodes
from . import plan as stated
from .beside import MOVES, SIGHT, beside_tasks
from .episodes import CLUSTERS, DEFAULT, FLOORED, MAIN
from .plan import LATER_CATEGORY, LATER_OBJECTS, LATER_SIGHT, PAPER, Corradi2015Plan

PLAN = Corradi2015Plan
TITLE = "Ten objects, touch by touch: Corradi et al. (2015) beside ours"
CAPTIONS = {
    "accuracy": "Fig. 7: right answers against the number of touches\n"
    "Hollow marks are the paper's. Bands are one standard deviation over partitions.",
    "confusion": "Fig. 6: answers (columns) for each object touched (rows), %\n"
    "After 15 touches the paper takes toothbrush and pen for each other most (19 %).",
    "unseen": "Fig. 8: mean belief while an object is touched that was never learnt\n"
    "In the paper a new mug, ball and book come to the known one of their kind, a new "
    "pen at first, a plastic card never.",
    "later": "The first author's later experiments on these recordings\n"
    "Hollow marks are his figures.",
}
DATA_NAMES = {"simulated": "simulated", "bathtip": "recorded"}
_FIRST = {MAIN: 0, DEFAULT: 1}
_TITLES = {
    "ten objects": "Ten objects",
    "all objects": "All recorded objects",
    "category": "Category of objects never touched",
    SIGHT["object"]: "Objects, with a photograph",
    SIGHT["category"]: "Category of objects never touched, with a photograph",
    MOVES["before -> after"]: "Learnt before the camera moved and recognised after",
    MOVES["after -> before"]: "Learnt after the camera moved and recognised before",
}
_PAPER_LINES: dict[str, list[tuple[str, dict[int, float]]]] = {
    "ten objects": [("the paper", PAPER), ("its k-means", stated.PAPER_CLUSTERS)],
    "all objects": [("first author", LATER_OBJECTS)],
    "category": [("first author", LATER_CATEGORY)],
    **{
        table: [
            (f"first author, {sense}", figures)
            for (of_label, sense), figures in LATER_SIGHT.items()
            if of_label == label
        ]
        for label, table in SIGHT.items()
    },
}
_PURPLE, _GREY, _BROWN, _OLIVE = (CONTROL_COLOURS[i] for i in (2, 3, 0, 1))
# Recogniser -> colour and line; mixtures share one colour.
_STYLES: dict[str, tuple[str, str, float]] = {
    DEFAULT: (OURS, "-", 2.2),
    MAIN: (INK, "-", 2.2),
    FLOORED: (INK, "--", 1.2),
    CLUSTERS: (_PURPLE, "-", 1.2),
    "mixtures of 1": (_OLIVE, "-", 1.2),
    "mixtures of 2": (_OLIVE, "--", 1.2),
    "mixtures of 4": (_OLIVE, ":", 1.2),
    "bag, Fourier": (_GREY, "-", 1.2),
    "bag, moments": (_GREY, "--", 1.2),
    "disc centre": (_BROWN, ":", 1.2),
    "brightness": (_BROWN, "--", 1.2),
}


def measure(
    plan: Corradi2015Plan, data: str | Path | None, work: Work
) -> dict[str, Any]:
    recorded = recorded_touches(data, BATHTIP)
    sets, skipped = [stated.simulated_objects(plan, work.workers)], []
    if isinstance(recorded, str):
        skipped.append(recorded)
    else:
        sets.append(stated.recorded_objects(recorded))
    tasks = [task for objects in sets for task in episodes.learnt_tasks(plan, objects)]
    if plan.later and not isinstance(recorded, str):
        tasks += episodes.later_tasks(plan, recorded)
    done = work.done(call, [(task,) for task in tasks], "learning and recognising")
    answered = [answer for answers in done for answer in answers]
    presets = (MAIN, DEFAULT) if plan.later else (MAIN,)
    rows, unseen = episodes.experiment_rows(answered, plan), {}
    for objects in sets:
        beliefs = {p: episodes.unseen_beliefs(plan, objects, p) for p in presets}
        rows += episodes.unseen_rows(beliefs, objects)
        unseen[objects.data] = {
            p: {name: curve.round(4).tolist() for name, curve in curves.items()}
            for p, curves in beliefs.items()
        }
    if plan.later and not isinstance(recorded, str):
        beside, skipped = beside_tasks(plan, recorded, data)
        done = work.done(call, [(task,) for task in beside], "sight beside touch")
        rows += [row for beside_rows in done for row in beside_rows]
    timed = sets[0].learnt if isinstance(recorded, str) else recorded
    how = timed, sets[-1].data, plan.timed
    rows += shared.on_one_thread(episodes.timing_rows, *how)
    confusion = {o.data: episodes.confusions(answered, o, plan) for o in sets}
    return {"rows": rows, "confusion": confusion, "unseen": unseen, "skipped": skipped}


def tables(result: dict[str, Any]) -> list[Table]:
    rows = result["rows"]
    shown = [
        _curves(experiment, data, shared.held(rows, table=experiment, data=data))
        for experiment in _TITLES
        for data in shared.unique(row["data"] for row in rows)
    ]
    shown += [_mixtures(rows), _pairs(result["confusion"])]
    shown.append(_unseen(shared.held(rows, table="unseen")))
    timed = []
    for row in shared.held(rows, table="timings"):
        what = row["name"].removesuffix(", ms")
        timed.append([what, shared.paper(row) or "-", f"{row['ours']:.3g}"])
    columns = ["what", "paper (MATLAB)", "ours"]
    return [*shown, ("Milliseconds, one thread", columns, timed)]


def _curves(experiment: str, data: str, rows: Sequence[Row]) -> Table:
    """One line per recogniser, the paper's first; a column per number of touches."""
    counts = sorted({row["touches"] for row in rows})
    lines = [
        [label, *(f"{figures[k]:g}" if k in figures else "-" for k in counts)]
        for label, figures in _PAPER_LINES.get(experiment, [])
    ]
    names = shared.unique(row["recogniser"] for row in rows)
    for name in sorted(names, key=lambda name: _FIRST.get(name, len(_FIRST))):
        curve = [shared.pick(rows, recogniser=name, touches=k) for k in counts]
        lines.append([name, *(shared.cell(row, 0, "±") for row in curve)])
    title = f"{_TITLES[experiment]}, {DATA_NAMES[data]}: right after so many touches, %"
    return title, ["recogniser", *map(str, counts)], lines if rows else []


def _mixtures(rows: Sequence[Row]) -> Table:
    mixtures = [row for row in rows if "singular" in row]
    lines = []
    for data, name in shared.different(mixtures, "data", "recogniser"):
        (row, *_) = shared.held(mixtures, data=data, recogniser=name)
        numbers = [f"{row[key]:.0f}" for key in ("n_features", "parameters")]
        lines.append([name, DATA_NAMES[data], *numbers, f"{row['singular']:.0f}"])
    columns = ["recogniser", "data", "features", "numbers to learn", "singular, %"]
    return "Mixtures without a lift of their covariances", columns, lines


def _pairs(confusion: dict[str, Any]) -> Table:
    lines = [
        [DATA_NAMES[data], k, *pair["objects"], f"{pair['share']:.1f}"]
        for data, by_touches in confusion.items()
        for k, pairs in by_touches["pairs"].items()
        for pair in pairs
    ]
    columns = ["data", "touches", "object", "object", "taken for each other, %"]
    return "Most confused pairs (corradi2015)", columns, lines


def _unseen(rows: Sequence[Row]) -> Table:
    counts = shared.unique(row["touches"] for row in rows)
    keys = ["unseen", "data", "recogniser"]
    after = [{"touches": k} for k in counts]
    lines = shared.pivot(rows, keys, after, _strongest, DATA_NAMES)
    columns = ["never learnt", "data", "recogniser", *map(str, counts)]
    return "Mean belief in known objects after so many touches, %", columns, lines


def _strongest(row: Row | None) -> str:
    best = [] if row is None else list(row["beliefs"].items())[:2]
    return ", ".join(f"{name} {share:.0f}" for name, share in best) or "-"


def pictures(result: dict[str, Any]) -> Figures:
    rows = result["rows"]
    ten_objects = shared.held(rows, table="ten objects")
    sides = [
        (shared.held(ten_objects, data=data), PAPER, f"{DATA_NAMES[data]} touches")
        for data in shared.unique(row["data"] for row in ten_objects)
    ]
    drawn = {
        "accuracy": _accuracy(sides, 4.6, legend_of=-1),
        "confusion": _confusion(result["confusion"]),
        "unseen": _beliefs(result),
    }
    category = shared.held(rows, table="category")
    if category:
        all_objects = shared.held(rows, table="all objects")
        later = (all_objects, LATER_OBJECTS, "all recorded objects")
        unseen = (category, LATER_CATEGORY, "category of objects never touched")
        drawn["later"] = _accuracy([later, unseen], 4.2, legend_of=0)
    return drawn


def _accuracy(
    sides: Sequence[tuple[list[Row], dict[int, float], str]],
    height: float,
    legend_of: int,
) -> Any:
    figure, axes = panels(1, len(sides), (4.4 * len(sides), height))
    for place, (rows, figures, title) in zip(axes[0], sides, strict=True):
        for name, (colour, line, width) in _STYLES.items():
            curve = shared.held(rows, recogniser=name)
            if not curve:
                continue
            touches = [row["touches"] for row in curve]
            mean = np.array([row["ours"] for row in curve])
            place.plot(touches, mean, line, color=colour, lw=width, label=name)
            if name in _FIRST:
                sd = np.array([row["sd"] or 0.0 for row in curve])
                low, high = np.clip(mean - sd, 0, 100), np.clip(mean + sd, 0, 100)
                place.fill_between(touches, low, high, color=colour, alpha=0.12, lw=0)
        published = zip(*figures.items(), strict=True)
        place.plot(*published, "D", mec=INK, mfc="none", ms=7, label="published")
        most = max((row["touches"] for row in rows), default=1)
        ticks = [1, *range(5, most + 1, 5)]
        place.set(xlabel="touches", ylim=(0, 101), xticks=ticks)
        place.set_title(title, fontsize=9)
    axes[0, 0].set_ylabel("right, %")
    handles = axes[0, legend_of].get_legend_handles_labels()
    look = {"ncols": 3, "fontsize": 7, "frameon": False}
    figure.legend(*handles, loc="outside lower center", **look)
    return figure


def _confusion(confusion: dict[str, Any]) -> Any:
    n_columns = max(len(matrices["after"]) for matrices in confusion.values())
    size = (4.5 * n_columns, 4.2 * len(confusion))
    figure, axes = panels(len(confusion), n_columns, size)
    for line, (data, matrices) in zip(axes, confusion.items(), strict=True):
        names = [name.replace("_", " ") for name in matrices["names"]]
        for place, (k, matrix) in zip(line, matrices["after"].items(), strict=True):
            draw_confusion(place, np.array(matrix), names, 7)
            place.spines[["top", "right"]].set_visible(True)
            place.set_title(f"{DATA_NAMES[data]}, after {k} touches", fontsize=9)
    return figure


def _beliefs(result: dict[str, Any]) -> Any:
    beliefs_of = {data: by_preset[MAIN] for data, by_preset in result["unseen"].items()}
    n_columns = max(len(curves) for curves in beliefs_of.values())
    size = (2.5 * n_columns, 2.7 * len(beliefs_of))
    figure, axes = panels(len(beliefs_of), n_columns, size)
    for line, (data, curves) in zip(axes, beliefs_of.items(), strict=True):
        names = result["confusion"][data]["names"]
        for place, (thing, curve) in zip(line, curves.items(), strict=False):
            # The three strongest beliefs by name, the others thin.
            beliefs = 100 * np.array(curve)
            touches = np.arange(1, len(beliefs) + 1)
            order = np.argsort(-beliefs.mean(axis=0), kind="stable").tolist()
            for number in sorted(order[3:]):
                place.plot(touches, beliefs[:, number], color="#c8ced3", lw=0.7)
            colours = (OURS, _BROWN, _PURPLE)
            for number, colour in zip(order[:3], colours, strict=False):
                look = {"color": colour, "label": names[number].replace("_", " ")}
                place.plot(touches, beliefs[:, number], lw=1.6, **look)
            # Room for the names above the lines.
            place.set(ylim=(0, 140), yticks=range(0, 101, 20))
            place.legend(frameon=False, fontsize=6, loc="upper left")
            place.set_title(thing.replace("_", " "), fontsize=8)
        line[0].set_ylabel(f"{DATA_NAMES[data]}: belief, %")
    for place in axes[-1]:
        place.set_xlabel("touches")
    return figure


def introduction(result: dict[str, Any]) -> str:
    plan = result["plan"]
    recorded = " ".join(result["skipped"]) or (
        "Recorded touches are a later set than the paper's own: the first object of "
        "each of ten categories by name, and the second of five as unseen. Random "
        "partitions put test touches between training touches of the same recording, "
        "and the camera shifted between recordings: see what the controls reach."
    )
    return (
        f"{plan['partitions']} random partitions, {plan['n_train']} training and "
        f"{plan['n_test']} test touches of each object ({plan['few_train']} and "
        f"{plan['n_test']} where it has fewer), seed {plan['seed']}; mean ± standard "
        "deviation over partitions, in per cent. The preset default and the controls "
        f"(disc centre, brightness) answer {plan['default_partitions']} partitions; "
        "idle: test touches alone that look like the no-contact frame. With a "
        "photograph, and where the camera moved, the deviation is that of objects. "
        "Bags of touches reached 90 % after about 60 touches of five objects in "
        f"Pezzementi et al. (2011). {recorded}"
    )
