"""Pictures of what benchmarks/choose_touches.py measured."""

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

Rows = list[dict[str, Any]]
CHOSEN = Path(__file__).with_name("choose_touches.json")
POOL = Path(__file__).with_name("choose_touches_pool.json")
COLOURS = {"random": "#888888", "raster": "#c98a1b", "chosen": "#1b6fc9"}
TITLES = {
    "between": "recorded, test touches between",
    "last": "recorded, test touches last",
}


def draw(folder: Path) -> None:
    """Write the picture of whatever was measured."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [
        row
        for path in (CHOSEN, POOL)
        if path.exists()
        for row in json.loads(path.read_text())["rows"]
    ]
    if rows:
        _chosen(folder / "exploration-chosen.png", rows)


def _chosen(path: Path, rows: Rows) -> None:
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    order = ["training pose", "new yaw", "other face", "between", "last"]
    conditions.sort(key=order.index)
    figure, axes = plt.subplots(
        1, len(conditions), figsize=(2.7 * len(conditions), 3), sharey=True, dpi=120
    )
    for axis, condition in zip(np.atleast_1d(axes), conditions, strict=True):
        for row in rows:
            if row["condition"] == condition and row["belief"] == "by place":
                _band(axis, row, row["strategy"], COLOURS[row["strategy"]])
        axis.axhline(0.95, color="k", linewidth=0.6, linestyle=":")
        axis.set_title(TITLES.get(condition, f"simulated, {condition}"), fontsize=8)
        axis.set(xlabel="touches", ylim=(0, 1.02))
        axis.grid(alpha=0.3)
    np.atleast_1d(axes)[0].set_ylabel("accuracy")
    np.atleast_1d(axes)[0].legend(loc="lower right", fontsize=8)
    _write(figure, path)


def _band(axis: Any, row: dict[str, Any], label: str, colour: str | None) -> None:
    """Draw a mean and one standard deviation to either side."""
    mean, sd = np.array(row["accuracy"]), np.array(row["accuracy_sd"])
    touches = np.arange(1, len(mean) + 1)
    (line,) = axis.plot(touches, mean, label=label, color=colour)
    band = mean - sd, np.minimum(mean + sd, 1)
    axis.fill_between(touches, *band, alpha=0.15, color=line.get_color())


def _write(figure: Any, path: Path) -> None:
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)
