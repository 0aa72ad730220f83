"""`palpate benchmark`: presets beside simple recognisers, on sets of touches."""

from pathlib import Path
from typing import Annotated, Any, cast

from . import _options
from ._options import option
from ._output import answer, stages


@_options.grouped
def benchmark(
    archives: Annotated[
        list[Path] | None,
        _options.argument(
            "ARCHIVE", "Archives (.npz) or folders. Default: `palpate data where`."
        ),
    ] = None,
    *,
    recognisers: Annotated[
        str | None,
        option(
            'With commas, of the presets and "taxels SVM", "roots SVM", "HOG SVM", '
            '"3-NN", "small CNN". Default: all.'
        ),
    ] = None,
    protocols: Annotated[
        str | None,
        option(
            "With commas, of subjects, sessions, blocks, halves, random, categories. "
            "Default: all that the touches allow."
        ),
    ] = None,
    label: _options.Label = "object",
    touches: Annotated[str, option("Score presets after so many touches.")] = "1,5,10",
    repeats: Annotated[int, option("Draws of the protocol random.")] = 3,
    seed: _options.Seed = 0,
    report: _options.Report = None,
    working: _options.Working,
    as_json: _options.AsJson = False,
) -> None:
    """Compare presets with simple recognisers and controls on sets of touches."""
    from .. import datasets, evaluation

    with stages() as stage, working.started():
        result = evaluation.benchmark(
            archives or [datasets.where()],
            **_names(recognisers=recognisers, protocols=protocols),
            label=cast(Any, label),
            touches=_options.numbers_of_touches(touches),
            repeats=repeats,
            seed=seed,
            progress=stage,
        )
    if report is not None:
        result.write_report(report)
    parts = (
        part if isinstance(part, str) else (*part, ["recogniser"])
        for part in result.summary()
    )
    answer(as_json, result, *parts, report)


def _names(**texts: str | None) -> dict[str, Any]:
    """Return those that were typed, taken apart at the commas."""
    return {
        key: [name.strip() for name in text.split(",")]
        for key, text in texts.items()
        if text is not None
    }
