"""The papers' experiments: each study prints the paper's figures beside ours.

One subpackage per paper says what is measured and how it is shown; `_study` runs it and
makes tables, pictures and a page of the result. Figures are in per cent.
"""

from typing import Any

from .._checks import check_option
from ._study import Study as Study

STUDIES: dict[str, Study] = {
    "corradi2014": Study("corradi2014", "seven shapes before a dome camera"),
    "corradi2015": Study("corradi2015", "ten objects before a dome camera"),
    "liu2014": Study("liu2014", "twelve metal parts on a 10 x 10 pressure array"),
    "sessions": Study("sessions", "taught in some sessions, asked in another"),
}


def run_study(name: str, **options: Any) -> dict[str, Any]:
    """Run the study called `name`, one of `STUDIES`; `options` as `Study.run` has them.

    Raises
    ------
    ValueError
        There is no such study, or it has no such option; the message lists them.
    """
    study: Study = STUDIES[check_option("study", name, STUDIES)]
    return study.run(**options)


__all__ = ["STUDIES", "run_study"]
