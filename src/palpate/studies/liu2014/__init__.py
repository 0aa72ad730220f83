"""The Liu 2014 study: from one press of a pressure array to one of twelve parts.

Ten runs of twofold cross-validation, as in section 4 of the paper; the class sets
of Figs 12 to 14, the rows of Table 2, load and cover as in Figs 5 and 6; simulated
presses, and real presses of another array where they are at hand.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ... import studies as shared
from ..._page import COLOURS, CONTROL_COLOURS, INK, OURS, panels
from ..._types import Floats
from ...encodings import FourierDescriptors
from ...images import ArrayCleanUp
from ...simulation import find_parts
from ...touches import Touches
from .. import Figures, Row, Table, Work, labels, recorded_touches
from .methods import condition_jobs, run_jobs, study_jobs
from .plan import (
    CLASS_SETS,
    PAPER_LOAD_KGF,
    REAL,
    Liu2014Plan,
    reposed_presses,
    simulated_presses,
)

PLAN = Liu2014Plan
TITLE = "One press of a pressure array: Liu et al. (2014) beside ours"
CAPTIONS = {
    "load-cover": "Figs 5 and 6: a bar under loads and through covers\n"
    "In the paper light loads leave the image incomplete, heavy ones distort it, thin "
    "covers break it up and thick ones blur it. Ours: a press of each bar, "
    "always at the same place; lines are what the clean-up takes for the bar.",
    "conditions": "Figs 5 and 6 as scores: against load (0.9 mm) and cover (4 kgf)\n"
    "The paper has none. Ours, of all parts: above, right answers; below, presses that "
    "fall into several pieces, and the overlap of binary image and true face.",
    "parts": "Fig. 9: a press of every part\n"
    "The paper's are real. Ours are simulated, with the part's edges where it lay.",
    "stages": "Fig. 10, (a) to (h): a part, its image, and each step of the clean-up\n"
    "The paper shows one part. The last three are thresholded as a whole, and on 2 x 2 "
    "and 3 x 3 partitions; the paper found 2 x 2 best.",
    "boundaries": "Fig. 11: the boundaries of the same presses\n"
    "The paper shows boundaries alone. Ours with their lengths in pixels; thin lines "
    "are their first three frequencies.",
    "features": "Figs 12 to 14: 3-NN on descriptors, on geometry and on both\n"
    "Simulated presses, mean and standard deviation over runs, for the paper's class "
    "sets. Hollow marks are the paper's, where its text gives them.",
}
DATA_NAMES = {"simulated": "simulated", "taxel10x10": "real"}
STAGES_SHOWN, WAVES_KEPT = 3, 3  # what a picture has room for
LEVELS, LINE = "cividis", COLOURS[1]
# Encoding, scaling, name, colour and line of the curves over load and cover.
CURVES = (
    ("FD+GE", "z-scored", "FD+GE, z-scored", OURS, "o-"),
    ("FD+GE", "raw", "FD+GE, raw", OURS, "o--"),
    ("sorted pixels", "z-scored", "sorted pixels", CONTROL_COLOURS[0], "s:"),
    ("raw pixels", "z-scored", "raw pixels", CONTROL_COLOURS[3], "s:"),
)
_OVERLAP = (
    ("in_pieces", "presses in several pieces", CONTROL_COLOURS[0]),
    ("overlap", "overlap with the true face", OURS),
)
_FEATURES = {"Fig. 12": "descriptors", "Fig. 13": "geometry", "Fig. 14": "both"}
_MARKS = "os^D"
_STAGES: dict[str, dict[str, Any]] = {
    **{stage: {"output": stage} for stage in ("resized", "gamma", "filtered")},
    **{f"binary {n} x {n}": {"n_partitions": n} for n in (1, 2, 3)},
}


def measure(plan: Liu2014Plan, data: str | Path | None, work: Work) -> dict[str, Any]:
    real = recorded_touches(data, REAL)
    jobs = study_jobs(plan, simulated_presses(plan), "simulated")
    if not isinstance(real, str):
        jobs += study_jobs(plan, reposed_presses(real, plan.seed), "taxel10x10")
    jobs += condition_jobs(plan)
    rows = run_jobs(jobs, plan, work)
    return {"rows": rows, "skipped": [real] if isinstance(real, str) else []}


def tables(result: dict[str, Any]) -> list[Table]:
    rows = result["rows"]
    return [
        _methods("Table 2", shared.held(rows, table="Table 2")),
        _methods("Equal grids", shared.held(rows, table="equal grids")),
        _methods("Controls, and our moments", shared.held(rows, table="controls")),
        _class_sets(rows),
        _counts(rows),
        _conditions("Load, cover 0.9 mm", "load, kgf", "load_kgf", rows, "Fig. 5"),
        _conditions("Cover, 4 kgf", "cover, mm", "cover_mm", rows, "Fig. 6"),
    ]


def _methods(title: str, rows: Sequence[Row]) -> Table:
    """One line per method and scaling; a column per data and protocol."""
    columns = shared.different(rows, "data", "protocol")
    lines = []
    for name, scaling in shared.different(rows, "name", "features"):
        of_method = shared.held(rows, name=name, features=scaling)
        # Where nothing is chosen there is one row, which stands for both protocols.
        shown = [
            shared.pick(of_method, data=data, protocol=protocol)
            or shared.pick(of_method, data=data)
            for data, protocol in columns
        ]
        lines.append(
            [name, scaling, shared.paper(of_method[0]) or "-", *map(shared.cell, shown)]
        )
    heads = [f"{DATA_NAMES[data]}, {protocol}" for data, protocol in columns]
    return title, ["method", "features", "paper", *heads], lines


def _class_sets(rows: Sequence[Row]) -> Table:
    figs = [r for r in rows if r["table"].startswith("Fig") and "condition" not in r]
    most = max((row["n"] for row in figs if row.get("n")), default=0)
    encodings = ("FD", "GE", "FD+GE", "sorted pixels", "raw pixels")
    columns = [{"encoding": e, "n": most if "FD" in e else None} for e in encodings]
    keys = ["data", "classes", "features"]
    lines = shared.pivot(figs, keys, columns, _beside_paper, DATA_NAMES)
    title = f"Figs 12-14: 3-NN, n = {most} (paper in brackets)"
    return title, [*keys, *encodings], lines


def _beside_paper(row: Row | None) -> str:
    real = row is not None and row["data"] != "simulated"
    return shared.cell(row) if real else shared.with_paper(row)


def _counts(rows: Sequence[Row]) -> Table:
    of_counts = [row for row in rows if row["table"] in ("Fig. 12", "Fig. 14")]
    counts = shared.unique(row["n"] for row in of_counts)
    keys = ["data", "classes", "encoding", "features"]
    mean = partial(shared.cell, between="")
    lines = shared.pivot(of_counts, keys, [{"n": n} for n in counts], mean, DATA_NAMES)
    heads = [*keys, *(f"n = {n}" for n in counts)]
    return "Figs 12 and 14: 3-NN against the number of descriptors", heads, lines


def _conditions(
    title: str, head: str, key: str, rows: Sequence[Row], table: str
) -> Table:
    of_table = shared.held(rows, table=table)
    lines = []
    for value in shared.unique(row[key] for row in of_table):
        here = shared.held(of_table, **{key: value})
        cells = [
            shared.cell(shared.pick(here, encoding=encoding, features=scaling))
            for encoding, scaling, *_ in CURVES
        ]
        first = here[0]
        cells += [f"{first['pieces']:.2f}", f"{first['in_pieces']:.0f}"]
        cells += [f"{first['overlap']:.0f}", f"{first['pieces_2x2']:.2f}"]
        lines.append([f"{value:g}", *cells, f"{first['overlap_2x2']:.0f}"])
    heads = [name for _, _, name, *_ in CURVES]
    heads += ["pieces", "in pieces, %", "overlap, %", "pieces 2 x 2", "overlap 2 x 2"]
    return f"{title}: 3-NN, and the binary images", [head, *heads], lines


def pictures(result: dict[str, Any]) -> Figures:
    plan, rows = Liu2014Plan(**result["plan"]), result["rows"]
    touches = simulated_presses(plan)
    return {
        "load-cover": draw_load_and_cover(plan),
        "conditions": draw_conditions(rows),
        "parts": draw_parts(touches),
        "stages": draw_stages(touches),
        "boundaries": draw_boundaries(touches),
        "features": draw_class_sets(rows),
    }


def draw_load_and_cover(plan: Liu2014Plan) -> Any:
    """Draw Figs 5 and 6: both bars under every load and cover, levels alike by line."""
    bars, covers = replace(plan, parts=(1, 2)), Liu2014Plan.covers_mm
    loads = {f"{load:g} kgf": (load,) for load in Liu2014Plan.loads_kgf}
    sides = loads, {f"{mm:g} mm": (PAPER_LOAD_KGF, mm) for mm in covers}
    figure, axes = _images(4, len(covers), 0.8)
    for number, line in enumerate(axes):
        side, bar = sides[number // 2], number % 2
        line[0].set_ylabel(("bar10", "bar35")[bar], fontsize=9)
        touches = [simulated_presses(bars, *how) for how in side.values()]
        presses = [pressed.images[[bar * plan.n_presses]] for pressed in touches]
        look = {"cmap": LEVELS, "vmin": 0, "vmax": max(map(np.max, presses))}
        for place, title, press in zip(line, side, presses, strict=False):
            place.imshow(press[0], extent=(0, 1, 1, 0), **look)
            binary = ArrayCleanUp().fit_transform(press)[0]
            middles = (np.arange(len(binary)) + 0.5) / len(binary)
            place.contour(middles, middles, binary, [0.5], colors=LINE)
            place.set_title("" if bar else title, fontsize=9)
    return figure


def draw_parts(touches: Touches) -> Any:
    """Draw Fig. 9: every part's first press, with its edges where it really lay."""
    figure, axes = _images(-(-len(_firsts(touches)) // 3), 3, 1.5)
    for place, (row, name) in zip(axes.ravel(), _firsts(touches), strict=False):
        place.set_title(name, fontsize=9)
        place.imshow(touches.images[row], cmap=LEVELS)
        for edge in _edges(touches, row):
            place.plot(*edge, color="white", lw=1, scalex=False, scaley=False)
    return figure


def draw_stages(touches: Touches) -> Any:
    """Draw Fig. 10, (a) to (h): a part, its image, and each step of the clean-up."""
    firsts = _firsts(touches)
    spaced = np.linspace(0, len(firsts) - 1, min(STAGES_SHOWN, len(firsts))).round()
    figure, axes = _images(8, len(spaced), 1.1)
    for line, at in zip(axes.T, spaced.astype(int), strict=True):
        row, name = firsts[at]
        press = touches.images[[row]]
        chain = {"raw": press[0]}
        for stage, how in _STAGES.items():
            (chain[stage],) = ArrayCleanUp(**how).fit_transform(press)
        line[0].imshow(touches.images[row], alpha=0)
        line[0].autoscale(False)
        line[0].set_title(name, fontsize=9)
        for number, edge in enumerate(_edges(touches, row)):
            line[0].fill(*edge, color="white" if number else CONTROL_COLOURS[3])
        for place, (stage, image) in zip(line[1:], chain.items(), strict=True):
            place.imshow(image, cmap="gray" if "binary" in stage else LEVELS)
    for number, stage in enumerate(("part", *chain)):
        axes[number, 0].set_ylabel(f"({'abcdefgh'[number]}) {stage}", fontsize=9)
    return figure


def draw_boundaries(touches: Touches) -> Any:
    """Draw Fig. 11: the outline of every part's first press, and its slow waves."""
    figure, axes = _images(-(-len(_firsts(touches)) // 3), 3, 1.5)
    for place, (row, name) in zip(axes.ravel(), _firsts(touches), strict=False):
        (binary,) = ArrayCleanUp().fit_transform(touches.images[[row]])
        points = FourierDescriptors.outline(binary)
        waves = np.fft.fft(points, axis=0)
        waves[np.abs(np.fft.fftfreq(len(points), 1 / len(points))) > WAVES_KEPT] = 0
        place.imshow(binary, cmap="gray", vmin=-3, vmax=1)
        place.autoscale(False)
        place.fill(*points.T, fill=False, ec=OURS, lw=2)
        place.fill(*np.fft.ifft(waves, axis=0).real.T, fill=False, ec=LINE, lw=1.2)
        place.set_title(f"{name}: {len(points)}", fontsize=9)
    return figure


def draw_class_sets(rows: Sequence[Row]) -> Any:
    """Draw Figs 12 to 14 of rows of simulated presses, the paper's figures hollow."""
    simulated = shared.held(rows, data="simulated")
    scalings = shared.unique(row["features"] for row in simulated)
    figure, axes = panels(3, len(scalings), (4.9, 7.2), sharey=True)
    for line, (table, what) in zip(axes, _FEATURES.items(), strict=True):
        for place, scaling in zip(line, scalings, strict=True):
            place.set_title(f"{table}: {what}, {scaling}", fontsize=9)
            place.set(ylim=(0, 104), xlabel="descriptors")
            of_table = shared.held(simulated, table=table, features=scaling)
            for at, name in enumerate(CLASS_SETS):
                of_class_set = shared.held(of_table, classes=name)
                at_counts = [{**row, "n": row["n"] or at} for row in of_class_set]
                look = {"color": COLOURS[at], "marker": _MARKS[at], "lw": 1.3}
                _curve(place, at_counts, "n", label=name, **look)
                beside = [(r["n"], r["paper"]) for r in at_counts if r["paper"]]
                place.plot(*zip(*beside, strict=True), mfc="none", ms=9, ls="", **look)
        line[0].set_ylabel("3-NN right, %")
    for place in axes[1]:
        place.set(xticks=[], xlabel="")
    axes[0, 0].plot([], "o", mfc="none", mec=INK, ms=9, label="the paper's")
    look = {"loc": "outside lower center", "ncols": 2, "fontsize": 9, "frameon": False}
    figure.legend(*axes[0, 0].get_legend_handles_labels(), **look)
    return figure


def draw_conditions(rows: Sequence[Row]) -> Any:
    """Draw the scores, and how images fall apart, that belong to Figs 5 and 6."""
    figure, axes = panels(2, 2, (4.9, 5.2), sharex="col", sharey="row")
    sides = (("Fig. 5", "load_kgf", "load, kgf"), ("Fig. 6", "cover_mm", "cover, mm"))
    for (above, below), (table, key, label) in zip(axes.T, sides, strict=True):
        of_table = shared.held(rows, table=table)
        for encoding, scaling, name, colour, style in CURVES:
            curve = shared.held(of_table, encoding=encoding, features=scaling)
            _curve(above, curve, key, label=name, color=colour, fmt=style, lw=1.3)
        ours = shared.held(of_table, encoding="FD+GE")
        for entry, name, colour in _OVERLAP:
            points = np.array(shared.different(ours, key, entry)).reshape(-1, 2).T
            below.plot(*points, "o-", ms=4, lw=1.3, color=colour, label=name)
        below.set_xlabel(label)
    axes[0, 0].set(ylabel="3-NN right, %", ylim=(0, 101))
    axes[1, 0].set(ylabel="presses or pixels, %", ylim=(0, 101))
    for place in axes[:, 1]:
        place.legend(frameon=False, fontsize=8, loc="best")
    return figure


def _curve(place: Any, rows: Sequence[Row], key: str, **look: Any) -> None:
    x, y = [row[key] for row in rows], [row["ours"] for row in rows]
    place.errorbar(x, y, [r["sd"] or 0.0 for r in rows], ms=4, capsize=2, **look)


def _firsts(touches: Touches) -> list[tuple[int, str]]:
    """Return the first row of every part, and its name."""
    names = labels(touches).tolist()
    return [(names.index(name), name) for name in shared.unique(names)]


def _edges(touches: Touches, row: int) -> list[Floats]:
    """Return the closed edges of a touch's part in taxels, each (column, row)."""
    n_rows, n_cols = touches.images.shape[1:]
    (part,) = find_parts(int(touches.columns["part"][row]))
    x, y = touches.columns["position_mm"][row].tolist()
    loops = part.placed(x, y, float(touches.columns["angle_deg"][row]))
    pitch, middle = float(touches.whole["set_pitch_mm"]), [[n_cols - 1], [n_rows - 1]]
    return [np.vstack([o, o[:1]]).T / pitch + np.array(middle) / 2 for o in loops]


def _images(n_rows: int, n_columns: int, side: float) -> tuple[Any, Any]:
    size = (side * n_columns, side * n_rows + 0.3)
    return panels(n_rows, n_columns, size, pictures=True)


def introduction(result: dict[str, Any]) -> str:
    plan = result["plan"]
    real = " ".join(result["skipped"]) or (
        "Real presses are those of 17 objects on another 10 x 10 array, each object in "
        "one pose; in software they are turned by any angle, shifted by up to 2 "
        "taxels, their total made 1 and their gain varied by 20 %. The paper's parts "
        "they are not."
    )
    return (
        f"{len(plan['parts'])} simulated parts, {plan['n_presses']} presses each; "
        f"{plan['runs']} runs of twofold cross-validation, seed {plan['seed']}; mean ± "
        "standard deviation over runs, in per cent. nested: parameters chosen inside "
        f"the training half; paper: on the runs reported, as the paper did. {real}"
    )
