"""The Corradi 2015 study as one self-contained HTML page."""

from pathlib import Path
from typing import Any

from ..evaluation import check_report_path
from ._corradi2015_pictures import pictures
from ._corradi2015_tables import tables
from ._page import write_page

TITLE = "Ten objects, touch by touch: Corradi et al. (2015) beside ours"
CAPTIONS = {
    "accuracy": "Right against touches, as the paper's Fig. 7; the bands are one "
    "standard deviation over partitions.",
    "confusion": "Answers (columns) for each object touched (rows), in per cent, as "
    "the paper's Fig. 6.",
    "unseen": "Mean belief in the known objects while an object is touched that was "
    "never learnt, as the paper's Fig. 8.",
    "later": "The first author's later experiments on these recordings.",
}
CITED = (
    "Bags of touches reached 90 % after about 60 touches of five objects in "
    "Pezzementi et al. (2011)."
)
RECORDED = (
    "Recorded touches are a later set than the paper's own: the first object of each "
    "of ten categories by name, and the second of five as unseen. Random partitions "
    "put test touches between training touches of the same recording, and the camera "
    "shifted between recordings: see what the controls reach."
)


def write_report(path: str | Path, result: dict[str, Any]) -> Path:
    """Write tables and pictures as one page that loads nothing from elsewhere."""
    check_report_path(path)
    drawn = pictures(result)
    return write_page(path, TITLE, _head(result), tables(result), drawn, CAPTIONS)


def _head(result: dict[str, Any]) -> str:
    plan = result["plan"]
    recorded = " ".join(result["skipped"]) or RECORDED
    return (
        f"{plan['partitions']} random partitions, {plan['n_train']} training and "
        f"{plan['n_test']} test touches of each object ({plan['few_train']} and "
        f"{plan['n_test']} where it has fewer), seed {plan['seed']}; mean ± standard "
        "deviation over partitions, in per cent. The preset default and the controls "
        f"(disc centre, brightness) answer {plan['default_partitions']} partitions; "
        "idle: test touches alone that look like the no-contact frame. With a "
        "photograph, and where the camera moved, the deviation is that of objects. "
        f"{CITED} {recorded}"
    )
