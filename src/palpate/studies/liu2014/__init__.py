"""The Liu 2014 study: from one press of a pressure array to one of twelve parts.

Ten runs of twofold cross-validation, as in section 4 of the paper; the class sets
of Figs 12 to 14, the rows of Table 2, load and cover as in Figs 5 and 6; simulated
presses, and real presses of another array where they are at hand.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ... import studies as shared
from .. import Figures, Row, Table, Work, recorded_touches
from . import drawing
from .drawing import CURVES
from .methods import condition_jobs, run_jobs, study_jobs
from .plan import REAL, Liu2014Plan, reposed_presses, simulated_presses

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
        "load-cover": drawing.load_and_cover(plan),
        "conditions": drawing.conditions(rows),
        "parts": drawing.parts(touches),
        "stages": drawing.stages(touches),
        "boundaries": drawing.boundaries(touches),
        "features": drawing.class_sets(rows),
    }


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
