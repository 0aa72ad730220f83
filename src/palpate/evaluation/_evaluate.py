"""How well a recogniser recognises: one protocol, from touches to figures."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..recognition import Evidence, ObjectRecogniser, left_out_groups
from ..touches import Touches
from ._controls import (
    brightness,
    control_log_likelihood,
    disc_centres,
    sorted_pixels,
    without_contact,
)
from ._episodes import outcome, run_episodes, single_touches
from ._figures import figures_of
from ._splits import Fold, draw_touches, split_touches
from ._trial import Plan, Trial

Progress = Callable[[str], None]
N_TIMED = 100


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
    folds = _folds(train, test, split)
    if split == "unseen-objects":
        plan = replace(plan, label="category")
    trials = _run_all(folds, unknown, plan, progress)
    return figures_of(trials, plan, split), trials


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


def _run_all(
    folds: list[Fold], unknown: Touches | None, plan: Plan, progress: Progress
) -> list[Trial]:
    """Run folds one after the other, or where `joblib.parallel_config` says."""
    if len(folds) == 1:
        return [_run(folds[0], unknown, plan, progress)]
    from joblib import Parallel, delayed

    progress(f"{len(folds)} folds")
    jobs = (delayed(_run)(fold, unknown, plan, _silent) for fold in folds)
    trials: list[Trial] = Parallel()(jobs)
    return trials


def _silent(stage: str) -> None:
    """Tell nothing: another process has no screen."""


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
    evidence, timing = _timed(recogniser, test)
    labels = _test_labels(test, plan.label, recogniser)
    objects = _objects(test, labels)
    _check_lengths(objects, plan)
    learnt = (recogniser, evidence.log_likelihood)
    episodes = run_episodes(
        *learnt, objects, labels, plan.orders, plan.seed, evidence.novelty
    )
    singles = single_touches(*learnt, episodes, objects, evidence.novelty)
    trial = Trial(
        Fold(fold.name, train, test),
        *learnt,
        singles,
        episodes,
        None,
        None,
        {**seconds, **timing},
    )
    if unknown is not None:
        progress(f"{fold.name}: meeting {len(unknown)} unknown touches")
        _meet_unknown(trial, unknown, plan)
    progress(f"{fold.name}: nuisance controls")
    trial.controls = _controls(trial, labels, objects, plan)
    return trial


def _check_lengths(objects: NDArray, plan: Plan) -> None:
    longest = int(np.unique(objects, return_counts=True)[1].max())
    if min(plan.touches) > longest:
        raise ValueError(
            f"touches must hold a number up to {longest}, the most test touches of an "
            f"object, got {plan.touches}."
        )


def _timed(
    recogniser: ObjectRecogniser, test: Touches
) -> tuple[Evidence, dict[str, float]]:
    some = test[: min(len(test), N_TIMED)]
    start = time.perf_counter()
    features = recogniser.encoder_.transform(some)
    encoded = time.perf_counter()
    recogniser.classifier_.log_likelihood(features)
    done = time.perf_counter()
    return recogniser.evidence(test), {
        "encode_per_touch": (encoded - start) / len(some),
        "recognise_per_touch": (done - encoded) / len(some),
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
    memory = recogniser.memory_
    known = np.intersect1d(objects, np.union1d(memory.objects, memory.labels))
    if len(known):
        raise ValueError(
            f"unknown touches must be of objects that were not learnt, got "
            f"{str(known[0])!r}. Leave those out."
        )
    evidence = recogniser.evidence(unknown)
    learnt = (recogniser, evidence.log_likelihood)
    episodes = run_episodes(
        *learnt, objects, None, plan.orders, plan.seed + 1, evidence.novelty
    )
    trial.unknown_episodes = episodes
    trial.unknown_singles = single_touches(*learnt, episodes, objects, evidence.novelty)


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
    memory = recogniser.memory_
    groups = left_out_groups(train, memory.labels, memory.objects, plan.label)
    for name, measure in measures.items():
        of_train = measure(train)
        of_test = None if of_train is None else measure(test)
        if of_train is None or of_test is None:
            result[name] = None
            continue
        values = control_log_likelihood(of_train, memory.labels, groups, of_test)
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
