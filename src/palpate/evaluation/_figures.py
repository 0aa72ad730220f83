"""From trials to plain figures, ready for JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ._decisions import Decisions, decide_episodes
from ._episodes import outcome
from ._metrics import calibration_error, roc_area
from ._trial import Plan, Trial

REFUSED = 0.05


def figures_of(
    trials: Sequence[Trial], plan: Plan, split: str | None
) -> dict[str, Any]:
    """Return the figures of all folds together; see `evaluate`."""
    first = trials[0].recogniser
    figures: dict[str, Any] = {
        **{k: v for k, v in first.summary().items() if k != "labels"},
        "split": split,
        "n_folds": len(trials),
        "n_train_touches": sum(len(t.fold.train) for t in trials) // len(trials),
        "n_test_touches": sum(len(t.fold.test) for t in trials),
        "chance": 1 / len(first.classes_),
        "orders": plan.orders,
        "seed": plan.seed,
    }
    for name in ("accuracy", "accuracy_sd", "n_objects", "log_loss", "ece"):
        figures[name] = {}
    for k in plan.touches:
        _figures_after(k, trials, figures)
    if trials[0].unknown_episodes is not None:
        figures["unknown_auroc"], figures["unknown_refused"] = _unknown(trials, plan)
    decisions = [decide_episodes(t.recogniser, t.episodes, plan.error) for t in trials]
    figures["decision"] = Decisions.pooled(decisions).figures(plan.error)
    figures["controls"] = _mean_controls(trials)
    figures["seconds"] = {
        name: float(np.mean([t.seconds[name] for t in trials]))
        for name in trials[0].seconds
    }
    return figures


def _figures_after(k: int, trials: Sequence[Trial], figures: dict[str, Any]) -> None:
    scored = [trial.after(k) for trial in trials]
    results = [outcome(truth, beliefs) for truth, beliefs in scored if truth]
    if not results:
        return
    per_fold = [r.accuracy.mean() for r in results]
    over_objects = np.concatenate([r.accuracy for r in results])
    confidence = np.concatenate([r.confidence for r in results])
    hit = np.concatenate([r.hit for r in results])
    key = str(k)
    figures["accuracy"][key] = float(np.mean(per_fold))
    spread = over_objects if len(results) == 1 else np.array(per_fold)
    figures["accuracy_sd"][key] = float(spread.std(ddof=min(1, len(spread) - 1)))
    figures["n_objects"][key] = len(over_objects)
    figures["log_loss"][key] = float(
        np.mean(np.concatenate([r.log_loss for r in results]))
    )
    figures["ece"][key] = calibration_error(confidence, hit)


def _unknown(
    trials: Sequence[Trial], plan: Plan
) -> tuple[dict[str, float], dict[str, float]]:
    area, refused = {}, {}
    for k in plan.touches:
        areas, shares = [], []
        for trial in trials:
            below, above = (trial.unknown_after(k, unknown=u) for u in (False, True))
            if not len(below) or not len(above):
                continue
            areas.append(roc_area(below, above))
            limit = trial.recogniser.unknown_scale_.threshold(k, REFUSED)
            shares.append(float((above > limit).mean()))
        if areas:
            area[str(k)], refused[str(k)] = (
                float(np.mean(areas)),
                float(np.mean(shares)),
            )
    return area, refused


def _mean_controls(trials: Sequence[Trial]) -> dict[str, dict[str, float] | None]:
    result: dict[str, dict[str, float] | None] = {}
    for name in trials[0].controls:
        curves = [c for t in trials if (c := t.controls[name]) is not None]
        if not curves:
            result[name] = None
            continue
        keys = dict.fromkeys(k for curve in curves for k in curve)
        result[name] = {
            k: float(np.mean([c[k] for c in curves if k in c])) for k in keys
        }
    return result
