"""`palpate evaluate`: accuracy against touches, calibration, controls, report."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from ._options import (
    AsJson,
    ErrorRate,
    Learning,
    Reading,
    Report,
    Working,
    grouped,
    option,
)
from ._output import percent, print_json, stages, table


@grouped
def evaluate(
    train: Annotated[Path, option("Training touches.")],
    *,
    test: Annotated[Path | None, option("Test touches; or give --split.")] = None,
    split: Annotated[
        str | None, option("Split --train itself: between, last or unseen-objects.")
    ] = None,
    touches: Annotated[
        str, option("Give figures after so many touches.")
    ] = "1,5,15,30",
    train_touches: Annotated[
        int | None, option("Draw so many per object to train.")
    ] = None,
    orders: Annotated[int, option("Random orders of each object's touches.")] = 20,
    unknown: Annotated[
        Path | None, option("Touches of objects that are not trained on.")
    ] = None,
    test_where: Annotated[str | None, option("The same for --test.")] = None,
    unknown_where: Annotated[str | None, option("The same for --unknown.")] = None,
    error: ErrorRate = 0.01,
    report: Report = None,
    how: Learning,
    reading: Reading,
    working: Working,
    as_json: AsJson = False,
) -> None:
    """Learn, recognise and score, with spread, calibration and nuisance controls."""
    from ..evaluation import Plan, check_report_path, write_report
    from ..evaluation import evaluate as run

    plan = Plan(
        **vars(how),
        touches=_counts(touches),
        orders=orders,
        train_touches=train_touches,
        error=error,
    )
    if report is not None:
        check_report_path(report)

    def read(path: Path | None, where: str | None) -> Any:
        if path is None:
            return None
        stage(f"reading {path}")
        return replace(reading, where=where).touches(path)

    with stages() as stage, working.started():
        training, testing = read(train, reading.where), read(test, test_where)
        others = read(unknown, unknown_where)
        figures, trials = run(
            training, testing, split=split, unknown=others, plan=plan, progress=stage
        )
        if report is not None:
            stage(f"writing {report}")
            write_report(report, figures, trials)
    if as_json:
        print_json(figures)
        return
    _print_figures(figures)
    if report is not None:
        print(report)


def _counts(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(
            f"--touches must be whole numbers with commas, got {text!r}; "
            "write --touches 1,5,15."
        ) from None


def _print_figures(figures: dict[str, Any]) -> None:
    keys = list(figures["accuracy"])
    spread = "folds" if figures["n_folds"] > 1 else "objects"
    rows = [
        ["accuracy, %", *(percent(figures["accuracy"][k]) for k in keys)],
        [f"sd over {spread}", *(percent(figures["accuracy_sd"][k]) for k in keys)],
        ["objects", *(str(figures["n_objects"][k]) for k in keys)],
        ["log loss, nats", *(f"{figures['log_loss'][k]:.2f}" for k in keys)],
        ["calibration error", *(f"{figures['ece'][k]:.3f}" for k in keys)],
    ]
    for name, curve in figures["controls"].items():
        values = [percent((curve or {}).get(k)) for k in keys]
        bare = name == "no contact"
        label = "touches without contact, %" if bare else f"{name} alone, %"
        rows.append([label, *values])
    if "unknown_auroc" in figures:
        area, refused = figures["unknown_auroc"], figures["unknown_refused"]
        areas = (f"{area.get(k, float('nan')):.3f}" for k in keys)
        rows.append(["unknown, ROC area", *areas])
        rows.append(["unknown refused, %", *(percent(refused.get(k)) for k in keys)])
    title = (
        f"{figures['preset']}: {figures['n_labels']} {figures['label']} labels, "
        f"{figures['n_train_touches']} training and {figures['n_test_touches']} test "
        f"touches, chance {percent(figures['chance'])} %"
    )
    table(title, ["after touches", *keys], rows)
    decision = figures["decision"]
    print(
        f"Deciding at an error of {decision['error']:g}: "
        f"{percent(decision['accuracy'])} % right after "
        f"{decision['mean_touches']:.1f} touches on average, "
        f"{percent(decision['undecided'])} % undecided."
    )
