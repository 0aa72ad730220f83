"""Tables of docs/explanation/exploration.md, made from what was measured.

Each stands between `<!-- begin NAME -->` and `<!-- end NAME -->` and is written anew;
one that was not measured says so.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
        made = [_with_preset(part, _chosen) for part in parts]
        tables[name] = "\n\n".join(made) or _NONE
    tables["places"] = _places()
    text = document.read_text()
    for name, table in tables.items():
        block = f"<!-- begin {name} -->\n{table}\n<!-- end {name} -->"
        pattern = f"<!-- begin {name} -->.*?<!-- end {name} -->"
        text = re.sub(pattern, lambda _, block=block: block, text, flags=re.DOTALL)
    document.write_text(text)


PLACES = {
    "turns, all": "turns, taught on all faces",
    "places before, all": "before, taught on all faces",
    "places, all": "places, taught on all faces",
    "turns, usual": "turns, usual face",
    "places before, usual": "before, usual face",
    "places, usual": "places, usual face",
    "places, usual, wrong pose": "places, usual face, arm off by 2 mm, 2 degrees",
    "mesh before, all": "before, meshes alone, no picture",
}


def _places() -> str:
    """Attempts until decided rightly, by belief, condition and strategy."""
    cells = []
    file = HERE / "places.json"
    measured = json.loads(file.read_text()) if file.exists() else {}
    for name, belief in PLACES.items():
        for key, row in measured.get(name, {}).items():
            yaw, offset = (
                " / ".join(str(row.get(f"{name}_{count}", "-")) for count in (5, 10))
                for name in ("yaw_deg", "offset_mm")
            )
            shares = [row["right"], row["wrong"], row["best_by_10"]]
            right, wrong, by_10 = (f"{100 * share:.0f}" for share in shares)
            attempts = f"{row['attempts']:.1f} ({row['attempts_sd']:.1f})"
            spread = f"{right} ({100 * row['right_sd']:.0f})"
            episodes = str(row["episodes"])
            cells.append([belief, key, episodes, attempts, spread, wrong, by_10])
            cells[-1] += [yaw, offset]
    heads = ["belief", "condition, strategy", "episodes", "attempts (sd)"]
    heads += ["right % (sd)", "wrong %", "best is right by 10, %"]
    return _table([*heads, "yaw, degrees, 5 / 10", "offset, mm, 5 / 10"], cells)


def _with_preset(part: dict[str, Any], make: Callable[[Rows], str]) -> str:
    return f"Preset `{part['preset']}`.\n\n{make(part['rows'])}"


def _table(heads: list[str], rows: list[list[str]]) -> str:
    if not rows:
        return _NONE
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _several(values: list[float], spreads: list[float]) -> str:
    pairs = zip(values, spreads, strict=True)
    return " / ".join(f"{100 * v:.0f} ({100 * s:.0f})" for v, s in pairs)


def _device(rows: Rows) -> str:
    cells = [
        [
            row["device"],
            _several(row["before"], row["before_sd"]),
            _several(row["after"], row["after_sd"]),
        ]
        for row in rows
    ]
    return _table(["touched with", "before", "after"], cells)


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
    heads += ["95 % first reached (5-95 %)", "right for good after (sd)"]
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
                f"{until:.1f} ({sd:.1f})",
            ]
        )
    return _table(heads, cells)


def _count(number: int | None) -> str:
    return "never" if number is None else str(number)
