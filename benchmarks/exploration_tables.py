"""Tables of docs/explanation/exploration-measured.md, made from measured rows.

Each stands between `<!-- begin NAME -->` and `<!-- end NAME -->` and is replaced; a
table that was not measured says so.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tables import split

Rows = list[dict[str, Any]]
_NONE = "Not measured yet."
HERE = Path(__file__).parent
CHOSEN = {
    "chosen": ["choose_touches.json"],
    "pool": ["choose_touches_pool.json", "choose_touches_pool_corradi2015.json"],
}


def fill(document: Path, measured: dict[str, Any]) -> None:
    """Write every table into the document."""
    tables = {
        name: _with_preset(measured[name], make) if name in measured else _NONE
        for name, make in (("device", _device), ("real", _real))
    }
    for name, files in CHOSEN.items():
        parts = [
            json.loads((HERE / f).read_text()) for f in files if (HERE / f).exists()
        ]
        sections = [_with_preset(part, _chosen) for part in parts]
        tables[name] = "\n\n".join(sections) or _NONE
    tables["places"] = _places()
    text = document.read_text()
    for name, table in tables.items():
        block = f"<!-- begin {name} -->\n{table}\n<!-- end {name} -->"
        pattern = f"<!-- begin {name} -->.*?<!-- end {name} -->"
        text, n_found = re.subn(
            pattern, lambda _, block=block: block, text, flags=re.DOTALL
        )
        if not n_found:
            raise ValueError(f"{document} must have the marks of the table {name!r}.")
    document.write_text(text)


PLACES = {
    "places, all": "taught on all faces",
    "places, usual": "usual face",
    "places, usual, wrong pose": "usual face, arm off by 2 mm, 2 degrees",
    "places, all, unknown height": "height unknown, all faces",
    "places, usual, unknown height": "height unknown, usual face",
    "turns, all": "turns, all faces",
    "turns, usual": "turns, usual face",
}


PLACES_COLUMNS = {
    "episodes": "episodes",
    "attempts": "attempts",
    "attempts_sd": "sd",
    "less_random": "less random",
    "less_random_error": "its error",
    "right": "right %",
    "right_sd": "sd",
    "wrong": "wrong %",
    "wrong_sd": "sd",
    "best_by_10": "best is right by 10, %",
    "yaw_deg_5": "yaw after 5, degrees",
    "yaw_deg_10": "after 10",
    "offset_mm_5": "offset after 5, mm",
    "offset_mm_10": "after 10",
}


def _places() -> str:
    """Return attempts until decided rightly, by belief, condition and strategy."""
    file = HERE / "places.json"
    measured = json.loads(file.read_text()) if file.exists() else {}
    cells = [
        [belief, key, *(_figure(row, name) for name in PLACES_COLUMNS)]
        for name, belief in PLACES.items()
        for key, row in measured.get(name, {}).items()
    ]
    return _table(["belief", "condition, strategy", *PLACES_COLUMNS.values()], cells)


def _figure(row: dict[str, Any], name: str) -> str:
    """Return one figure of a row, "-" where it was not measured."""
    if name not in row:
        return "-"
    if name.startswith(("right", "wrong", "best")):
        return f"{100 * row[name]:.0f}"
    return str(row[name]) if isinstance(row[name], int) else f"{row[name]:.1f}"


def _with_preset(part: dict[str, Any], make: Callable[[Rows], str]) -> str:
    return f"Preset `{part['preset']}`.\n\n{make(part['rows'])}"


def _table(heads: list[str], rows: list[list[str]]) -> str:
    if not rows:
        return _NONE
    heads, rows = split(heads, rows)
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _several(values: list[float], spreads: list[float]) -> str:
    pairs = zip(values, spreads, strict=True)
    return " / ".join(f"{100 * v:.0f} ± {100 * s:.0f}" for v, s in pairs)


def _device(rows: Rows) -> str:
    cells = [
        [
            row["device"],
            _several(row["before"], row["before_sd"]),
            _several(row["after"], row["after_sd"]),
        ]
        for row in rows
    ]
    return _table(["touched with", "before: 1 / 5 / 15", "after: 1 / 5 / 15"], cells)


def _real(rows: Rows) -> str:
    cells = [
        [
            row["learnt on"],
            str(row["n_seeds"]),
            _several(row["accuracy"], row["accuracy_sd"]),
        ]
        for row in rows
    ]
    return _table(["learnt on", "seeds", "right after 1 / 5 / 15 touches"], cells)


def _chosen(rows: Rows) -> str:
    heads = ["condition", "strategy", "seeds", "after 1 / 3 / 5 / 10"]
    heads += ["95 % first reached (5-95 %)", "right for good after"]
    cells = []
    for row in [row for row in rows if row["belief"] == "by place"]:
        at = [k - 1 for k in (1, 3, 5, 10)]
        mean = [row["accuracy"][k] for k in at]
        spread = [row["accuracy_sd"][k] for k in at]
        low, high = (_count(n) for n in row["touches_for_95_range"])
        until, sd = row["touches_until_right"], row["touches_until_right_sd"]
        cells.append(
            [
                row["condition"],
                row["strategy"],
                str(row["n_seeds"]),
                _several(mean, spread),
                f"{_count(row['touches_for_95'])} ({low}-{high})",
                f"{until:.1f} ± {sd:.1f}",
            ]
        )
    return _table(heads, cells)


def _count(number: int | None) -> str:
    return "never" if number is None else str(number)
