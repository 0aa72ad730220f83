"""`palpate evaluate`: accuracy against touches, calibration, controls, report."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from ._options import (
    AsJson,
    ErrorRate,
    Learning,
    Reading,
    Refusal,
    Report,
    Working,
    counts,
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
    refusal: Refusal = None,
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
        touches=counts(touches),
        orders=orders,
        train_touches=train_touches,
        error=error,
        refusal=refusal,
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


def _print_figures(figures: dict[str, Any]) -> None:
    from ..evaluation import as_good_alone

    keys = list(figures["accuracy"])
    spread = "folds" if figures["n_folds"] > 1 else "objects"
    rows = [
        ["accuracy, %", *(percent(figures["accuracy"][k]) for k in keys)],
        [f"sd over {spread}", *(percent(figures["accuracy_sd"][k]) for k in keys)],
        ["objects", *(str(figures["n_objects"][k]) for k in keys)],
        ["log loss, nats", *(f"{figures['log_loss'][k]:.2f}" for k in keys)],
        *_category_rows(figures, keys),
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
    for sentence in figures["chosen"].get("found", ()):
        print(f"Found out from the training touches: {sentence}.")
    for flag, share in figures["flags"].items():
        print(f"Flagged as {flag!r}: {percent(share)} % of the test touches.")
    decision = figures["decision"]
    print(
        f"Deciding at an error of {decision['error']:g} and a refusal of "
        f"{decision['refusal']:g}: of {decision['n_episodes']} episodes "
        f"{decision['right']} named right, {decision['wrong']} named wrong, "
        f"{decision['refused']} refused as unknown, "
        f"{percent(decision['undecided'])} % undecided, after "
        f"{decision['mean_touches']:.1f} touches on average."
    )
    print(
        f"At most {percent(decision['bound'])} % of new objects that are named would "
        f"be named wrong, at 95 % confidence from {decision['n_objects']} objects"
        + ("." if decision["can_be_verified"] else ": too few to show the error asked.")
    )
    for sentence in as_good_alone(figures):
        print(sentence)


def _category_rows(figures: dict[str, Any], keys: list[str]) -> list[list[str]]:
    if "category_accuracy" not in figures:
        return []
    right = figures["category_accuracy"]
    return [["category right, %", *(percent(right.get(k)) for k in keys)]]
