"""The Corradi 2014 study as one self-contained HTML page."""

from pathlib import Path
from typing import Any

from ..evaluation import check_report_path
from ._corradi2014_pictures import pictures
from ._corradi2014_tables import tables
from ._page import write_page

TITLE = "One touch of a dome camera: Corradi et al. (2014) beside ours"
CAPTIONS = {
    "shapes": "One simulated touch of each shape, by the dome and by its variant with "
    "pins, with the magnitude of the derivative, as the paper's Fig. 2.",
    "table2": "Table 2: Davies-Bouldin indices on the second half, the number of "
    "components being the best on the first; hollow marks are the paper's.",
    "fig3": "Fig. 3: share of touches named right on the second half. Bars are "
    "randomised fivefold cross-validation, black lines folds that leave a whole "
    "recording out; dotted, the paper's best.",
}


def write_report(path: str | Path, result: dict[str, Any]) -> Path:
    """Write tables and pictures as one page that loads nothing from elsewhere."""
    check_report_path(path)
    drawn = pictures(result)
    return write_page(path, TITLE, _head(result), tables(result), drawn, CAPTIONS)


def _head(result: dict[str, Any]) -> str:
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
