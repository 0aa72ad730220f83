"""Pictures of the figures of benchmarks/choose_touches.py."""

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

Rows = list[dict[str, Any]]
HERE = Path(__file__).parent
# Where each row of panels is from, and their titles.
PANELS = {
    "choose_touches": {
        "training pose": "simulated, training pose",
        "new yaw": "simulated, new yaw",
        "other face": "simulated, other face",
    },
    "choose_touches_pool": {"between": "recorded, between", "last": "recorded, last"},
    "choose_touches_pool_corradi2015": {
        "between": "recorded, between",
        "last": "recorded, last",
    },
}
N_ACROSS = 4
COLOURS = {"random": "#888888", "raster": "#c98a1b", "chosen": "#1b6fc9"}


def draw(folder: Path) -> None:
    """Write the picture of all conditions that were measured."""
    folder.mkdir(parents=True, exist_ok=True)
    panels = [panel for name in PANELS for panel in _panels(name)]
    if panels:
        _chosen(folder / "exploration-chosen.png", panels)


def _panels(name: str) -> list[tuple[str, Rows]]:
    """Return title and rows of each condition in one file of measurements."""
    path = HERE / f"{name}.json"
    if not path.exists():
        return []
    kept = json.loads(path.read_text())
    panels = []
    for condition, title in PANELS[name].items():
        rows = [row for row in kept["rows"] if row["condition"] == condition]
        if rows:
            panels.append((f"{title}\n{kept['preset']}", rows))
    return panels


def _chosen(path: Path, panels: list[tuple[str, Rows]]) -> None:
    n_rows = -(-len(panels) // N_ACROSS)
    figure, axes = plt.subplots(
        n_rows, N_ACROSS, figsize=(10.8, 3 * n_rows), sharey=True, dpi=120
    )
    axes = np.ravel(axes)
    for axis, (title, rows) in zip(axes, panels, strict=False):
        for row in rows:
            if row["belief"] == "by place":
                _band(axis, row, row["strategy"], COLOURS[row["strategy"]])
        axis.axhline(0.95, color="k", linewidth=0.6, linestyle=":")
        axis.set_title(title, fontsize=9)
        axis.set(xlabel="touches", ylim=(0, 1.02))
        axis.grid(alpha=0.3)
    for axis in axes[len(panels) :]:
        axis.axis("off")
    for axis in axes[::N_ACROSS]:
        axis.set_ylabel("accuracy")
    axes[0].legend(loc="lower right", fontsize=8)
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
