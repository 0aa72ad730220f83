"""The Corradi 2014 study: encodings and classifiers for one touch of a dome camera.

Seven shapes pressed by a simulated dome and by its variant with pins, four recorded
on a real dome with pins (upright, and with only the test touches turned), and the
categories of unseen objects before a real dome camera. Every encoding of the paper,
on images and on their derivatives, with each of its four classifiers.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ... import studies as shared
from ..._page import COLOURS, panels
from .. import BATHTIP, Figures, Row, Table, Work, recorded_touches
from . import judging
from . import plan as stated
from .judging import DATA, Judged, candidate_features, compare_fold, compared_rows, holm
from .plan import CLASSIFIERS, TACTIP, VARIANTS, Corradi2014Plan, near_duplicates

PLAN = Corradi2014Plan
TITLE = "One touch of a dome camera: Corradi et al. (2014) beside ours"
CAPTIONS = {
    "shapes": "Fig. 2: one touch of each shape, and its derivative\n"
    "The paper shows the shapes beside them. Ours are simulated, by the dome and by "
    "its variant with pins, which the paper shows in its Fig. 1.",
    "table2": "Table 2: Davies-Bouldin index of the encodings, smaller is better\n"
    "On the second half, the number of components being the best on the first; hollow "
    "marks are the paper's.",
    "fig3": "Fig. 3: share of touches named right, by encoding and classifier\n"
    "On the second half: bars are randomised fivefold cross-validation, black lines "
    "folds that leave a whole recording out; dotted, the paper's best, 96.4 %.",
}
SIGNIFICANT = 0.05  # the usual level; beside it Holm's
SHAPES = ("corner", "cylinder", "edge", "flat", "flat-to-edge", "nothing", "point")
LIFTS = (0.12, -0.12)  # two variants side by side on one line
_TICKS = (1, 2, 5, 10, 30, 100, 1000)  # of an axis in logarithms
# Of a larger set so many touches are looked at for repeated ones.
_MOST_ALIKE = 1000


def measure(
    plan: Corradi2014Plan, data: str | Path | None, work: Work
) -> dict[str, Any]:
    pins, dome = (recorded_touches(data, archive) for archive in (TACTIP, BATHTIP))
    sets = list(stated.simulated_shapes(plan))
    if not isinstance(pins, str):
        thinned, upright = pins[:: plan.recorded_step], plan.recorded_upright
        sets += stated.recorded_shapes(thinned, plan.seed, upright=upright)
    rows, paired = _shapes_rows(sets, plan, work)
    duplicates = {s.data: near_duplicates(s.images["image"]) for s in sets}
    if not isinstance(dome, str):
        seen = judging.recording(dome[:: plan.recorded_step])
        rows_at = np.linspace(0, len(seen.codes) - 1, _MOST_ALIKE).astype(int)
        duplicates[DATA] = near_duplicates(seen.images["image"][np.unique(rows_at)])
        tasks = [(seen, v, e, plan) for e in plan.encodings for v in VARIANTS]
        for more in work.done(judging.judge_unseen, tasks, "judging unseen objects"):
            rows += more
        names = [(seen, name) for name in plan.candidates]
        encoded = work.done(candidate_features, names, "encoding")
        features = dict(zip(plan.candidates, encoded, strict=True))
        folds = [(seen, features, k, plan) for k in range(plan.fold_limit)]
        rows += compared_rows(work.done(compare_fold, folds, "choosing an encoding"))
    return {
        "rows": rows,
        "paired": paired,
        "duplicates": duplicates,
        "skipped": [reason for reason in (pins, dome) if isinstance(reason, str)],
    }


def _shapes_rows(
    sets: list[stated.Shapes], plan: Corradi2014Plan, work: Work
) -> tuple[list[Row], list[Row]]:
    """Return the rows, and where image and derivative differ on the same folds."""
    tasks = [(s, v, e, plan) for s in sets for e in plan.encodings for v in VARIANTS]
    judged: list[Judged] = work.done(judging.judge, tasks, "judging encodings")
    keys = [(shapes.data, e, v) for shapes, v, e, _ in tasks]
    judged_by = dict(zip(keys, judged, strict=True))
    paired: list[Row] = []
    for data, encoding in dict.fromkeys(key[:2] for key in judged_by):
        image, derivative = (judged_by[data, encoding, v].folds for v in VARIANTS)
        for kind in CLASSIFIERS:
            facts: Row = {"data": data, "encoding": encoding, "classifier": kind}
            test = judging.corrected_t_test(image[kind] - derivative[kind])
            figures = zip(("difference", "error", "p"), test, strict=True)
            paired.append({**facts, **dict(figures)})
    for row, p in zip(paired, holm([row["p"] for row in paired]), strict=True):
        row["p_together"] = p
    return [row for judgement in judged for row in judgement.rows], paired


def tables(result: dict[str, Any]) -> list[Table]:
    rows = result["rows"]
    shown = [_table_2(shared.held(rows, table="Table 2", q=2))]
    fig_3 = shared.held(rows, table="Fig. 3")
    for folds in ("randomised", "grouped"):
        for data in shared.unique(row["data"] for row in fig_3):
            title = f"Fig. 3: {data}, {folds} folds, per cent right"
            shown.append(_accuracies(title, shared.held(fig_3, data=data, folds=folds)))
    title = "Category of unseen objects, one touch, per cent right over folds"
    shown.append(_accuracies(title, shared.held(rows, table="unseen")))
    shown += [_best(shared.held(rows, table="best")), _paired(result["paired"])]
    shares = [[data, f"{share:.1f}"] for data, share in result["duplicates"].items()]
    title = "Touches that another one of the set nearly repeats (correlation > 0.99)"
    return [*shown, (title, ["data", "share, %"], shares)]


def _table_2(rows: Sequence[Row]) -> Table:
    sets = shared.different(rows, "data", "variant")
    columns = [{"data": data, "variant": variant} for data, variant in sets]
    heads = [f"{data}, {variant}" for data, variant in sets]
    title = (
        "Table 2: Davies-Bouldin index, q = 2, smaller is better (paper in brackets)"
    )
    index = partial(shared.with_paper, digits=2)
    lines = shared.pivot(rows, ["encoding"], columns, index)
    return title, ["encoding", *heads], lines


def _accuracies(title: str, rows: Sequence[Row]) -> Table:
    """One line per encoding and variant, a column per classifier."""
    kinds = shared.unique(row["classifier"] for row in rows)
    columns = [{"classifier": kind} for kind in kinds]
    lines = shared.pivot(rows, ["encoding", "variant"], columns, shared.with_paper)
    return title, ["encoding", "on", *kinds], lines


def _best(rows: Sequence[Row]) -> Table:
    lengths = shared.unique(row["after"] for row in rows)
    lines = []
    for encoding in shared.unique(row["encoding"] for row in rows):
        of_encoding = shared.held(rows, encoding=encoding)
        figures = [shared.pick(of_encoding, after=k) for k in lengths]
        folds = [f"{value:.0f}" for value in of_encoding[0]["folds_right"]]
        lines.append([encoding, *map(shared.cell, figures), " ".join(folds)])
    heads = [f"after {k}" for k in lengths] + ["each fold, after 1"]
    title = "Category of unseen objects, kernel ridge unless said, per cent right"
    return title, ["encoding", *heads], lines


def _paired(paired: Sequence[Row]) -> Table:
    """Return the differences between image and derivative, all tests together."""
    lines = []
    for data in shared.unique(row["data"] for row in paired):
        of_data = shared.held(paired, data=data)
        alone = sum(row["p"] < SIGNIFICANT for row in of_data)
        differ = [row for row in of_data if row["p_together"] < SIGNIFICANT]
        better = sum(row["difference"] > 0 for row in differ)
        mean = sum(row["difference"] for row in of_data) / len(of_data)
        counts = [len(of_data), alone, len(differ), better]
        lines.append([data, f"{mean:+.1f}", *map(str, counts)])
    heads = ["image less derivative, mean", "pairs", "p < 0.05", "after Holm"]
    heads.append("of these image better")
    return "Image against derivative, paired on the same folds", ["data", *heads], lines


def pictures(result: dict[str, Any]) -> Figures:
    rows = result["rows"]
    return {
        "shapes": _shapes(result["plan"]["seed"]),
        "table2": _indices(shared.held(rows, table="Table 2", q=2)),
        "fig3": _bars(shared.held(rows, table="Fig. 3")),
    }


def _shapes(seed: int) -> Any:
    sets = list(stated.simulated_shapes(Corradi2014Plan(n_touches=10, seed=seed)))
    figure, axes = panels(4, len(SHAPES), (8.4, 5.0), pictures=True)
    for number, (shapes, variant) in enumerate((s, v) for s in sets for v in VARIANTS):
        for code in range(len(SHAPES)):
            row = int(np.flatnonzero(shapes.codes == code)[0])
            axes[number, code].imshow(shapes.images[variant][row], cmap="gray")
        kind = "pins" if shapes.data.endswith("pins") else "dome"
        axes[number, 0].set_ylabel(f"{kind}, {variant}", fontsize=8)
    for place, name in zip(axes[0], SHAPES, strict=True):
        place.set_title(name, fontsize=8)
    return figure


def _indices(rows: Sequence[Row]) -> Any:
    sets = shared.unique(row["data"] for row in rows)
    size = (3.2 * len(sets) + 1, 3.4)
    figure, (axes,) = panels(1, len(sets), size, sharey=True)
    encodings = shared.unique(row["encoding"] for row in rows)[::-1]
    reach = [r["ours"] for r in rows] + [r["paper"] for r in rows if r["paper"]]
    for place, data in zip(axes, sets, strict=True):
        for variant, colour, lift in zip(VARIANTS, COLOURS, LIFTS, strict=False):
            of_variant = shared.held(rows, data=data, variant=variant)
            points = [(r, encodings.index(r["encoding"]) + lift) for r in of_variant]
            for key, face, label in (
                ("ours", colour, variant),
                ("paper", "none", f"{variant}, paper"),
            ):
                points_at = [(r[key], y) for r, y in points if r[key]]
                if points_at:
                    x, y = zip(*points_at, strict=True)
                    place.plot(x, y, "o", mec=colour, mfc=face, label=label)
        place.set_xscale("log")
        place.set_xticks(_TICKS, [f"{tick:g}" for tick in _TICKS])
        place.set_xticks([], minor=True)
        place.set_xlim(0.8 * min(reach), 1.3 * max(reach))
        place.set_yticks(range(len(encodings)), encodings)
        place.set_title(data, fontsize=9)
        place.set_xlabel("Davies-Bouldin index")
        place.grid(axis="x", alpha=0.3)
    axes[0].legend(fontsize=7, frameon=False)
    return figure


def _bars(rows: Sequence[Row]) -> Any:
    sets = shared.unique(row["data"] for row in rows)
    size = (9.2, 2.5 * len(sets))
    figure, axes = panels(len(sets), 2, size, sharex=True, sharey=True)
    encodings = shared.unique(row["encoding"] for row in rows)
    for line, data in zip(axes, sets, strict=True):
        for place, variant in zip(line, VARIANTS, strict=True):
            _panel(place, shared.held(rows, data=data, variant=variant), encodings)
            place.set_title(f"{data}, {variant}", fontsize=9)
        line[0].set_ylabel("right, %")
    axes[-1, 0].set_xticks(range(len(encodings)), encodings, rotation=25, fontsize=7)
    axes[-1, 1].tick_params(axis="x", rotation=25, labelsize=7)
    axes[0, 1].legend(fontsize=7, frameon=True, loc="lower right", ncols=2)
    return figure


def _panel(place: Any, rows: Sequence[Row], encodings: Sequence[str]) -> None:
    """Randomised folds as bars, grouped folds as points."""
    width = 0.8 / len(CLASSIFIERS)
    looks = zip(CLASSIFIERS, COLOURS, strict=False)
    for number, (kind, colour) in enumerate(looks):
        last = number == len(CLASSIFIERS) - 1
        for folds in ("randomised", "grouped"):
            panel = shared.held(rows, classifier=kind, folds=folds)
            at = np.array([encodings.index(r["encoding"]) for r in panel])
            x, y = at - 0.4 + (number + 0.5) * width, [r["ours"] for r in panel]
            if folds == "randomised":
                bars = [r["sd"] or 0.0 for r in panel]
                place.bar(x, y, width, yerr=bars, color=colour, label=kind)
            else:
                label = "grouped folds" if last else None
                place.plot(x, y, "_", color="black", ms=6, label=label)
    best = [r["paper"] for r in rows if r["paper"] is not None]
    if best:
        place.axhline(best[0], color="gray", lw=0.8, ls=":")
    place.set_ylim(0, 101)
    place.grid(axis="y", alpha=0.3)


def introduction(result: dict[str, Any]) -> str:
    plan = result["plan"]
    missing = " ".join(result["skipped"])
    return (
        f"Seven shapes, {plan['n_touches']} simulated touches each in ten recordings "
        "between which the camera drifts; half of them choose numbers of components, "
        f"the other half is reported, within itself: {plan['runs']} runs of "
        f"randomised fivefold cross-validation ({plan['slow_runs']} for the network "
        "and the support vector machines), mean ± standard deviation over runs, and "
        "folds that leave a recording out, ± over folds. Real touches where they are "
        "at hand; the real dome with pins also with only its test touches turned at "
        f"random. Seed {plan['seed']}. {missing}"
    )
