"""The papers' experiments: each study prints the paper's figures beside ours.

A study is a module with `run(**options)`, which returns `{"study", "rows",
"skipped", ...}`; `tables(result)`, what a person reads; and `write_report(path,
result)`. Figures are in per cent.
"""

from collections.abc import Sequence
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

from .._checks import check_option
from ._corradi2014_plan import Corradi2014Plan
from ._corradi2015_plan import Corradi2015Plan
from ._liu2014_plan import Liu2014Plan

Table = tuple[str, list[str], list[list[str]]]


class Study(NamedTuple):
    """Where a study lives, and what it is about."""

    module: str
    summary: str


STUDIES: dict[str, Study] = {
    "corradi2014": Study("_corradi2014", "seven shapes before a dome camera"),
    "corradi2015": Study("_corradi2015", "ten objects before a dome camera"),
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
    module = _module(name)
    known = signature(module.run).parameters
    for option in options:
        if option not in known:
            raise ValueError(
                f"options of the study {name} must be among {', '.join(known)}, got "
                f"{option!r}. Leave it out."
            )
    result: dict[str, Any] = module.run(**options)
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
    "Corradi2014Plan",
    "Corradi2015Plan",
    "Liu2014Plan",
    "Study",
    "check_study",
    "run_study",
    "study_tables",
    "write_study_report",
]
