"""The papers' experiments: each study prints the paper's figures beside ours.

A study is a module with `run(**options)`, which returns `{"study", "rows",
"skipped", ...}`; `tables(result)`, what a person reads; and `write_report(path,
result)`. Figures are in per cent.
"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from .._checks import check_option
from ._liu2014_plan import Liu2014Plan

Table = tuple[str, list[str], list[list[str]]]


class Study(NamedTuple):
    """Where a study lives, and what it is about."""

    module: str
    summary: str


STUDIES: dict[str, Study] = {
    "liu2014": Study("_liu2014", "twelve metal parts on a 10 x 10 pressure array"),
}


def check_study(name: object) -> str:
    """Return `name` if there is such a study; the error lists them."""
    return str(check_option("study", name, STUDIES))


def run_study(name: str, **options: Any) -> dict[str, Any]:
    """Run a study and return its rows.

    Parameters
    ----------
    name : str
        One of `STUDIES`.
    **options
        `data` (the folder of recorded touches), `quick`, `workers`, `seed`,
        `progress`, and what the study itself offers: see its module.
    """
    result: dict[str, Any] = _module(name).run(**options)
    return result


def study_tables(result: dict[str, Any]) -> Sequence[Table]:
    """Return what a person reads of a result: (title, columns, rows of text)."""
    tables: Sequence[Table] = _module(result["study"]).tables(result)
    return tables


def write_study_report(path: str | Path, result: dict[str, Any]) -> Path:
    """Write a result with its pictures as one self-contained `.html` page."""
    written: Path = _module(result["study"]).write_report(path, result)
    return written


def _module(name: str) -> Any:
    return import_module(f"{__name__}.{STUDIES[check_study(name)].module}")


__all__ = [
    "STUDIES",
    "Liu2014Plan",
    "Study",
    "check_study",
    "run_study",
    "study_tables",
    "write_study_report",
]
