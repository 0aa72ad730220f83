"""How well a recogniser recognises: one protocol, from touches to figures."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import check_count
from ..recognition import ObjectRecogniser, summary, training_groups
from ..touches import Touches
from ._controls import (
    brightness,
    control_log_likelihood,
    disc_centres,
    sorted_pixels,
    without_contact,
)
from ._decisions import Decisions, decide_episodes
from ._episodes import Episodes, outcome, run_episodes, single_touches
from ._metrics import calibration_error, roc_area
from ._splits import Fold, draw_touches, split_touches

Progress = Callable[[str], None]
REFUSED = 0.05


@dataclass(frozen=True)
class Plan:
    """What is asked of an evaluation.

    Attributes
    ----------
    preset, label : str
        As for `ObjectRecogniser`.
    touches : tuple of int
        Numbers of touches after which figures are given.
    orders : int
        Random orders of each object's touches.
    train_touches : int or None
        Training touches drawn per object; None takes all.
    error : float
        Accepted share of wrong decisions, for the stopping rule.
    floor : float or None
        As for `ObjectRecogniser`.
    seed : int
        Seed of every draw.
    """

    preset: str = "default"
    label: str = "object"
    touches: tuple[int, ...] = (1, 5, 15, 30)
    orders: int = 20
    train_touches: int | None = None
    error: float = 0.01
    floor: float | None = None
    seed: int = 0


@dataclass
class Trial:
    """One fold, learnt and tested: what the figures and the report are made of."""

    fold: Fold
    recogniser: ObjectRecogniser
    log_likelihood: NDArray
    singles: Episodes
    episodes: Episodes
    unknown_singles: Episodes | None
    unknown_episodes: Episodes | None
    seconds: dict[str, float]
    controls: dict[str, dict[str, float] | None] = field(default_factory=dict)


def evaluate(
    train: Touches,
    test: Touches | None = None,
    *,
    split: str | None = None,
    unknown: Touches | None = None,
    plan: Plan | None = None,
    progress: Progress = lambda stage: None,
) -> tuple[dict[str, Any], list[Trial]]:
    """Learn, recognise and score.

    Parameters
    ----------
    train : Touches
        Training touches; with `split`, the touches to be split.
    test : Touches, optional
        Test touches. Exactly one of `test` and `split` must be given.
    split : {"between", "last", "unseen-objects"}, optional
        See `split_touches`; "unseen-objects" recognises categories.
    unknown : Touches, optional
        Touches of objects that are not among the training objects.
    plan : Plan, optional
        Preset, label, numbers of touches, orders, seed.
    progress : callable, optional
        Called with the name of each stage.

    Returns
    -------
    figures : dict
        Plain values, ready for JSON. `accuracy_sd` is the spread over objects,
        over folds where there are several.
    trials : list of Trial
        One per fold, for the report.
    """
    plan = plan or Plan()
    for k in plan.touches:
        check_count("touches", k)
    check_count("orders", plan.orders)
    folds = _folds(train, test, split)
    if split == "unseen-objects":
        plan = Plan(**{**plan.__dict__, "label": "category"})
    trials = [_run(fold, unknown, plan, progress) for fold in folds]
    return _figures(trials, plan, split), trials


def _folds(train: Touches, test: Touches | None, split: str | None) -> list[Fold]:
    if (test is None) == (split is None):
        raise ValueError(
            "Give either test touches or a split, got "
            f"{'both' if split is not None else 'neither'}: "
            "--test TOUCHES or --split between|last|unseen-objects."
        )
    if split is not None:
        return split_touches(train, split)
    assert test is not None
    return [Fold("test", train, test)]


def _run(fold: Fold, unknown: Touches | None, plan: Plan, progress: Progress) -> Trial:
    train, test = fold.train, fold.test
    if plan.train_touches is not None:
        train = draw_touches(train, plan.train_touches, plan.seed)
    recogniser = ObjectRecogniser(
        plan.preset, label=plan.label, floor=plan.floor, random_state=plan.seed
    )
    progress(f"{fold.name}: learning from {len(train)} touches")
    start = time.perf_counter()
    recogniser.fit(train)
    seconds = {"learn": time.perf_counter() - start}
    progress(f"{fold.name}: recognising {len(test)} touches")
    log_likelihood, timing = _timed_log_likelihood(recogniser, test)
    labels = _test_labels(test, plan.label, recogniser)
    objects = _objects(test, labels)
    episodes = run_episodes(
        recogniser, log_likelihood, objects, labels, plan.orders, plan.seed
    )
    singles = single_touches(recogniser, log_likelihood, episodes, objects)
    trial = Trial(
        Fold(fold.name, train, test), recogniser, log_likelihood, singles, episodes,
        None, None, {**seconds, **timing},
    )
    if unknown is not None:
        progress(f"{fold.name}: meeting {len(unknown)} unknown touches")
        _meet_unknown(trial, unknown, plan)
    progress(f"{fold.name}: nuisance controls")
    trial.controls = _controls(trial, labels, objects, plan)
    return trial


def _timed_log_likelihood(
    recogniser: ObjectRecogniser, test: Touches
) -> tuple[NDArray, dict[str, float]]:
    start = time.perf_counter()
    features = recogniser.encoder_.transform(test)
    encoded = time.perf_counter()
    log_likelihood = recogniser.feature_log_likelihood(features)
    done = time.perf_counter()
    return log_likelihood, {
        "encode_per_touch": (encoded - start) / len(test),
        "recognise_per_touch": (done - encoded) / len(test),
    }


def _test_labels(test: Touches, label: str, recogniser: ObjectRecogniser) -> NDArray:
    labels = test.object if label == "object" else test.category
    if labels is None:
        raise ValueError(
            f"test touches must have a column {label!r} to be scored against."
        )
    strange = np.setdiff1d(labels, recogniser.classes_)
    if len(strange):
        raise ValueError(
            f"test touches hold {label} {str(strange[0])!r}, which was not learnt "
            f"({len(strange)} such labels). Leave them out, or pass them as --unknown."
        )
    return labels


def _objects(touches: Touches, labels: NDArray) -> NDArray:
    """Return what makes one episode: the object, or the label where none is told."""
    return labels if touches.object is None else touches.object


def _meet_unknown(trial: Trial, unknown: Touches, plan: Plan) -> None:
    recogniser = trial.recogniser
    column = unknown.object if unknown.object is not None else unknown.category
    objects = np.full(len(unknown), "unknown") if column is None else column
    log_likelihood = recogniser.log_likelihood(unknown)
    episodes = run_episodes(
        recogniser, log_likelihood, objects, None, plan.orders, plan.seed + 1
    )
    trial.unknown_episodes = episodes
    trial.unknown_singles = single_touches(
        recogniser, log_likelihood, episodes, objects
    )


def _controls(
    trial: Trial, labels: NDArray, objects: NDArray, plan: Plan
) -> dict[str, dict[str, float] | None]:
    train, test = trial.fold.train, trial.fold.test
    recogniser = trial.recogniser
    result: dict[str, dict[str, float] | None] = {}
    measures = {
        "disc centre": disc_centres,
        "brightness": brightness,
        "sorted pixels": sorted_pixels,
    }
    train_labels = recogniser.labels_
    groups = training_groups(train, train_labels, recogniser.objects_, plan.label)
    for name, measure in measures.items():
        of_train = measure(train)
        of_test = None if of_train is None else measure(test)
        if of_train is None or of_test is None:
            result[name] = None
            continue
        values = control_log_likelihood(of_train, train_labels, groups, of_test)
        result[name] = _curve(recogniser, values, objects, labels, plan)
    idle = without_contact(test)
    result["no contact"] = None
    if idle is not None and idle.any():
        result["no contact"] = _curve(
            recogniser, trial.log_likelihood[idle], objects[idle], labels[idle], plan
        )
    return result


def _curve(
    recogniser: ObjectRecogniser,
    log_likelihood: NDArray,
    objects: NDArray,
    labels: NDArray,
    plan: Plan,
) -> dict[str, float]:
    episodes = run_episodes(
        recogniser, log_likelihood, objects, labels, plan.orders, plan.seed
    )
    singles = single_touches(recogniser, log_likelihood, episodes, objects)
    result = {}
    for k in plan.touches:
        truth, beliefs = (singles if k == 1 else episodes).after(k)
        if truth:
            result[str(k)] = float(outcome(truth, beliefs).accuracy.mean())
    return result


def _figures(trials: Sequence[Trial], plan: Plan, split: str | None) -> dict[str, Any]:
    first = trials[0].recogniser
    figures: dict[str, Any] = {
        **{k: v for k, v in summary(first).items() if k != "labels"},
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


def beliefs_after(
    trial: Trial, k: int, *, unknown: bool = False
) -> tuple[list, list]:
    """Return true columns and log posteriors of a trial after `k` touches."""
    singles = trial.unknown_singles if unknown else trial.singles
    episodes = trial.unknown_episodes if unknown else trial.episodes
    assert singles is not None
    assert episodes is not None
    return (singles if k == 1 else episodes).after(k)


def _figures_after(k: int, trials: Sequence[Trial], figures: dict[str, Any]) -> None:
    scored = [beliefs_after(trial, k) for trial in trials]
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
    figures["accuracy_sd"][key] = float(spread.std())
    figures["n_objects"][key] = len(over_objects)
    figures["log_loss"][key] = float(np.mean(np.concatenate([r.log_loss for r in results])))
    figures["ece"][key] = calibration_error(confidence, hit)


def _unknown(
    trials: Sequence[Trial], plan: Plan
) -> tuple[dict[str, float], dict[str, float]]:
    area, refused = {}, {}
    for k in plan.touches:
        areas, shares = [], []
        for trial in trials:
            known, strange = beliefs_after(trial, k)[1], beliefs_after(trial, k, unknown=True)
            if not known or not strange[1]:
                continue
            above = outcome(*strange).unknown
            below = outcome([0] * len(known), known).unknown
            areas.append(roc_area(below, above))
            limit = trial.recogniser.unknown_threshold(k, refused=REFUSED)
            shares.append(float((above > limit).mean()))
        if areas:
            area[str(k)], refused[str(k)] = float(np.mean(areas)), float(np.mean(shares))
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
