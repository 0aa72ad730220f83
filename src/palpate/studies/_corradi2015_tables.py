"""The Corradi 2015 study as tables of text, for a terminal, a report or a page."""

from collections.abc import Sequence
from typing import Any

from ._corradi2015_beside import MOVED, SIGHT
from ._corradi2015_plan import (
    LATER_CATEGORY,
    LATER_OBJECTS,
    LATER_SIGHT,
    PAPER,
    PAPER_CLUSTERS,
)
from ._corradi2015_tasks import DEFAULT, MAIN
from ._liu2014_tables import Row, Table, pick

DATA_NAMES = {"simulated": "simulated", "bathtip": "recorded"}
_FIRST = {MAIN: 0, DEFAULT: 1}
_TITLES = {
    "ten objects": "Ten objects",
    "all objects": "All recorded objects",
    "category": "Category of objects never touched",
    SIGHT["object"]: "Objects, with a photograph",
    SIGHT["category"]: "Category of objects never touched, with a photograph",
    MOVED["before -> after"]: "Learnt before the camera moved and recognised after",
    MOVED["after -> before"]: "Learnt after the camera moved and recognised before",
}
_PAPER_LINES: dict[str, list[tuple[str, dict[int, float]]]] = {
    "ten objects": [
        ("the paper", PAPER),
        ("its k-means", PAPER_CLUSTERS),
    ],
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


def tables(result: dict[str, Any]) -> list[Table]:
    """Return (title, columns, rows) of every table, figures in per cent."""
    rows = result["rows"]
    made = [
        _curves(experiment, data, rows)
        for experiment in _TITLES
        for data in dict.fromkeys(row["data"] for row in rows)
    ]
    made += [_mixtures(rows), _pairs(result["confusion"]), _unseen(rows)]
    made.append(_timings(rows))
    return [table for table in made if table[2]]


def _curves(experiment: str, data: str, rows: Sequence[Row]) -> Table:
    """One line per recogniser, the paper's first; a column per number of touches."""
    held = [r for r in rows if r["table"] == experiment and r["data"] == data]
    counts = sorted({row["touches"] for row in held})
    lines = [
        [label, *(f"{figures[k]:g}" if k in figures else "-" for k in counts)]
        for label, figures in _PAPER_LINES.get(experiment, [])
    ]
    names = dict.fromkeys(row["recogniser"] for row in held)
    for name in sorted(names, key=lambda name: _FIRST.get(name, len(_FIRST))):
        found = [_short(pick(held, recogniser=name, touches=k)) for k in counts]
        lines.append([name, *found])
    title = f"{_TITLES[experiment]}, {DATA_NAMES[data]}: right after so many touches, %"
    return title, ["recogniser", *map(str, counts)], lines if held else []


def _short(row: Row | None) -> str:
    """Return mean and standard deviation without decimals, or a dash."""
    if row is None:
        return "-"
    spread = "" if row["sd"] is None else f"±{row['sd']:.0f}"
    return f"{row['ours']:.0f}{spread}"


def _mixtures(rows: Sequence[Row]) -> Table:
    held = [row for row in rows if "singular" in row]
    lines = []
    for data, name in dict.fromkeys((r["data"], r["recogniser"]) for r in held):
        row = pick(held, data=data, recogniser=name)
        assert row is not None
        numbers = [f"{row[key]:.0f}" for key in ("n_features", "parameters")]
        share = f"{row['singular']:.0f}"
        lines.append([name, DATA_NAMES[data], *numbers, share])
    columns = ["recogniser", "data", "features", "numbers to learn", "singular, %"]
    return "Mixtures without a lift of their covariances", columns, lines


def _pairs(confusion: dict[str, Any]) -> Table:
    lines = [
        [DATA_NAMES[data], k, *pair["objects"], f"{pair['share']:.1f}"]
        for data, found in confusion.items()
        for k, pairs in found["pairs"].items()
        for pair in pairs
    ]
    columns = ["data", "touches", "object", "object", "taken for each other, %"]
    return "Most confused pairs (corradi2015)", columns, lines


def _unseen(rows: Sequence[Row]) -> Table:
    held = [row for row in rows if row["table"] == "unseen"]
    counts = list(dict.fromkeys(row["touches"] for row in held))
    lines = []
    for data, preset, name in dict.fromkeys(
        (r["data"], r["recogniser"], r["unseen"]) for r in held
    ):
        wanted = {"data": data, "recogniser": preset, "unseen": name}
        found = [_beliefs(pick(held, touches=k, **wanted)) for k in counts]
        lines.append([name, DATA_NAMES[data], preset, *found])
    columns = ["never learnt", "data", "recogniser", *map(str, counts)]
    return "Mean belief in known objects after so many touches, %", columns, lines


def _beliefs(row: Row | None) -> str:
    if row is None:
        return "-"
    best = list(row["beliefs"].items())[:2]
    return ", ".join(f"{name} {share:.0f}" for name, share in best)


def _timings(rows: Sequence[Row]) -> Table:
    lines = []
    for row in rows:
        if row["table"] == "timings":
            paper = "-" if row["paper"] is None else f"{row['paper']:g}"
            lines.append(
                [row["name"].removesuffix(", ms"), paper, f"{row['ours']:.3g}"]
            )
    return "Milliseconds, one thread", ["what", "paper (MATLAB)", "ours"], lines
