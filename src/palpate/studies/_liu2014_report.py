"""The Liu 2014 study as one self-contained HTML page."""

from pathlib import Path
from typing import Any

from ..evaluation import check_report_path
from ._liu2014_pictures import pictures
from ._liu2014_tables import tables
from ._page import write_page

TITLE = "One press of a pressure array: Liu et al. (2014) beside ours"
CAPTIONS = {
    "stages": "The clean-up of simulated presses, stage by stage, as the paper's "
    "Fig. 10; the last three are thresholded as a whole, and on 2 x 2 and 3 x 3 "
    "partitions.",
    "parts": "Simulated presses of every part, with the outline of where it lay.",
    "conditions": "Load (cover 0.9 mm) and cover (4 kgf), as the paper's Figs 5 and 6 "
    "ask: accuracy, presses whose binary image falls into several pieces, and its "
    "overlap with the part's true face.",
}
REAL = (
    "Real presses are those of 17 objects on another 10 x 10 array, each object in one "
    "pose; in software they are turned by any angle, shifted by up to 2 taxels, their "
    "total made 1 and their gain varied by 20 %. The paper's parts they are not."
)


def write_report(path: str | Path, result: dict[str, Any]) -> Path:
    """Write tables and pictures as one page that loads nothing from elsewhere."""
    check_report_path(path)
    drawn = pictures(result)
    return write_page(path, TITLE, _head(result), tables(result), drawn, CAPTIONS)


def _head(result: dict[str, Any]) -> str:
    plan = result["plan"]
    real = " ".join(result["skipped"]) or REAL
    return (
        f"{len(plan['parts'])} simulated parts, {plan['n_presses']} presses each; "
        f"{plan['runs']} runs of twofold cross-validation, seed {plan['seed']}; mean ± "
        "standard deviation over runs, in per cent. nested: parameters chosen inside "
        f"the training half; paper: on the runs reported, as the paper did. {real}"
    )
