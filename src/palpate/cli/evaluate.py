"""`palpate evaluate`: accuracy against touches, calibration, controls, report."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from . import _notes, _options
from ._options import option
from ._output import answer, as_typed, message_if_stopped, stages, unless_made


@_options.grouped
def evaluate(
    train: Annotated[Path, option("Training touches.")],
    *,
    test: Annotated[Path | None, option("Test touches; or give --split.")] = None,
    split: Annotated[
        str | None,
        option(
            "Split --train itself: between, last, unseen-objects, session or subject.",
            callback=_options.one_of("--split", _options.allowed("Split")),
        ),
    ] = None,
    touches: Annotated[str, option("Accuracy after so many touches.")] = "1,5,15,30",
    train_touches: Annotated[
        int | None, option("Learn from so many touches of each object.")
    ] = None,
    remount: Annotated[
        str,
        option(
            "What to do with the test touches' sessions first: none, recentre[:K] "
            "(use their touches, or the first K, without labels) or confirm:N (be told "
            "the first N of each object)."
        ),
    ] = "none",
    orders: Annotated[int, option("Random orders of each object's touches.")] = 20,
    unknown: Annotated[Path | None, option("Touches of things never learnt.")] = None,
    test_where: Annotated[str | None, option("As --where, of --test.")] = None,
    unknown_where: Annotated[str | None, option("As --where, of --unknown.")] = None,
    deciding: _options.Deciding,
    report: _options.Report = None,
    how: _options.Learning,
    reading: _options.Reading,
    working: _options.Working,
    as_json: _options.AsJson = False,
) -> None:
    """Learn, recognise and score, with spread, calibration and nuisance controls.

    For example: palpate evaluate --train touches/ --split last. With `session` in place
    of `last` it says what to expect on another day.
    """
    from ..evaluation import Plan, write_report
    from ..evaluation import evaluate as run

    plan = Plan(
        **vars(how),
        **vars(deciding),
        touches=_options.numbers_of_touches(touches),
        orders=orders,
        train_touches=train_touches,
        remount=remount,
    )
    for name, path, where in (
        ("test", test, test_where),
        ("unknown", unknown, unknown_where),
    ):
        if path is None and where is not None:
            raise ValueError(
                f"--{name}-where must come with --{name}, got {where!r} alone. --where "
                "is of --train."
            )

    def read(path: Path | None, where: str | None) -> Any:
        if path is None:
            return None
        stage(f"reading {path}")
        try:
            return replace(reading, where=where).touches(path)
        except ValueError as error:
            as_it_is = reading == _options.Reading(where=reading.where)
            if path == train or as_it_is or not path.exists():
                raise
            raise ValueError(
                f"{error} Options that say how files are read hold for --train, "
                "--test and --unknown alike; if they differ, bring each into a library "
                "(`palpate library add`), or save it as an archive (`Touches.save`)."
            ) from error

    kept = unless_made("there are no figures", report)
    with message_if_stopped(kept), stages() as stage, working.started():
        training, testing = read(train, reading.where), read(test, test_where)
        others = read(unknown, unknown_where)
        for path, touches in ((test, testing), (unknown, others)):
            if path is not None:
                _notes.refuse_another_order(train, training, path, touches)
        figures, trials = run(
            training, testing, split=split, unknown=others, plan=plan, progress=stage
        )
        in_options(figures)
        if left := _notes.left_aside(reading, train, training):
            figures["recommendations"].insert(0, f"{left[0].upper()}{left[1:]}.")
        if report is not None:
            stage(f"writing {report}")
            write_report(report, figures, trials)
    answer(as_json, figures, *figures.summary(), report)


def in_options(figures: dict[str, Any]) -> None:
    """Let the sentences of figures name options of `palpate evaluate`."""
    todo = [as_typed(sentence, "evaluate") for sentence in figures["recommendations"]]
    figures["verdict"] = as_typed(figures["verdict"], "evaluate")
    figures["recommendations"] = todo
