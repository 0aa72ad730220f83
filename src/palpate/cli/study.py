"""`palpate study`: a paper's experiment, its figures beside ours."""

import sys
from typing import Annotated, Any

from . import _options
from ._options import flag, option
from ._output import answer, as_typed, say


@_options.grouped
def study(
    *,
    name: Annotated[str, _options.argument("Which study; see --list.")] = "",
    data: _options.RecordedData = None,
    quick: Annotated[bool, flag("--quick", "A first look: few runs.")] = False,
    protocol: Annotated[
        str | None,
        option(
            "liu2014: nested (parameters chosen inside the training half) or "
            "paper (on the runs reported). Default: both."
        ),
    ] = None,
    working: _options.Working,
    report: _options.Report = None,
    list_names: _options.ListNames = False,
    seed: _options.Seed = 0,
    as_json: _options.AsJson = False,
) -> None:
    """Run a paper's experiment and print its figures beside the paper's."""
    from .._checks import check_option
    from ..studies import STUDIES

    if list_names or not name:
        summaries = {each: study.summary for each, study in STUDIES.items()}
        lines = (f"{each:12s} {summary}" for each, summary in summaries.items())
        answer(as_json, {"studies": summaries}, *lines)
        return
    study = STUDIES[check_option("study", name, STUDIES)]
    options: dict[str, Any] = {"data": data, "quick": quick, "seed": seed}
    if protocol is not None:
        options["protocol"] = protocol
    with working.started(usual=-1) as n:
        result = study.run(**{**options, "workers": n})
    result["skipped"] = [as_typed(sentence) for sentence in result["skipped"]]
    for sentence in result["skipped"]:
        say(sentence, file=sys.stderr)
    if report is not None:
        study.write_report(report, result)
    answer(as_json, result, *study.tables(result), report)
