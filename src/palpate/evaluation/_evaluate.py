"""Learning, recognising and scoring touches: one protocol, from touches to figures."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from .._parallel import in_parallel
from .._types import Array, Floats
from ..recognition import Evidence, ObjectRecogniser, left_out_groups
from ..touches import Touches
from ._controls import (
    brightness,
    control_log_likelihood,
    disc_centres,
    sorted_pixels,
    without_contact,
)
from ._episodes import Episodes, run_episodes, scores, single_touches
from ._splits import Fold, draw_touches, split_touches
from ._trial import Plan, Trial, figures_of

Progress = Callable[[str], None]
N_TIMED = 100


def silent(stage: str) -> None:
    """Show no stage: without `progress`, and in other processes."""


def evaluate(
    train: Touches,
    test: Touches | None = None,
    *,
    split: str | None = None,
    unknown: Touches | None = None,
    plan: Plan | None = None,
    progress: Progress = silent,
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
        Preset, label, numbers of touches, orders, seed; `Plan()` by default.
    progress : callable, optional
        Called with the name of each stage. Several folds run one after the other, or
        where `joblib.parallel_config` says, and name no stages of their own.

    Returns
    -------
    figures : dict
        Plain values, ready for JSON. `accuracy_sd` is the spread over objects,
        over folds where there are several.
    trials : list of Trial
        One per fold, for `write_report`.

    Raises
    ------
    ValueError
        Both or neither of `test` and `split` are given; labels are missing, were not
        learnt, or are among the unknown ones; no object has as many test touches as
        the plan asks for.

    Examples
    --------
    >>> from palpate.evaluation import Plan, evaluate
    >>> from palpate.simulation import simulate_presses
    >>> touches = simulate_presses(["bar10", "disc13"], 12, random_state=0)
    >>> plan = Plan(preset="liu2014", touches=(1,), orders=2)
    >>> figures, trials = evaluate(touches, split="between", plan=plan)
    >>> figures["accuracy"]
    {'1': 1.0}
    """
    plan = plan or Plan()
    folds = _folds(train, test, split)
    if split == "unseen-objects":
        plan = replace(plan, label="category")
    if len(folds) == 1:
        trials = [_run(folds[0], unknown, plan, progress)]
    else:
        progress(f"{len(folds)} folds")
        tasks = [(fold, unknown, plan, silent) for fold in folds]
        trials = in_parallel(_run, tasks, "Folds", show=False)
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
    objects = labels if test.object is None else test.object
    _check_lengths(objects, plan)
    trial = Trial(
        Fold(fold.name, train, test),
        recogniser,
        evidence.log_likelihood,
        *_met(recogniser, evidence, objects, labels, plan.orders, plan.seed),
        seconds={**seconds, **timing},
    )
    if unknown is not None:
        progress(f"{fold.name}: meeting {len(unknown)} unknown touches")
        met = _meet_unknown(recogniser, unknown, plan)
        trial.unknown_singles, trial.unknown_episodes = met
    progress(f"{fold.name}: nuisance controls")
    trial.controls = _controls(trial, labels, objects, plan)
    return trial


def _met(
    recogniser: ObjectRecogniser,
    evidence: Evidence,
    objects: Array,
    labels: Array | None,
    orders: int,
    seed: int,
) -> tuple[Episodes, Episodes]:
    """Return episodes of one touch each, and of many orders of all touches."""
    rows, novelty = evidence.log_likelihood, evidence.novelty
    many = run_episodes(recogniser, rows, objects, labels, orders, seed, novelty)
    return single_touches(recogniser, rows, many, objects, novelty), many


def _check_lengths(objects: Array, plan: Plan) -> None:
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


def _test_labels(test: Touches, label: str, recogniser: ObjectRecogniser) -> Array:
    labels = test.object if label == "object" else test.category
    if labels is None:
        raise ValueError(
            f"test touches must have a column {label!r} to be scored against."
        )
    new = np.setdiff1d(labels, recogniser.classes_)
    if len(new):
        raise ValueError(
            f"test touches hold {label} {str(new[0])!r}, which was not learnt "
            f"({len(new)} such labels). Leave them out, or pass them as --unknown."
        )
    return labels


def _meet_unknown(
    recogniser: ObjectRecogniser, unknown: Touches, plan: Plan
) -> tuple[Episodes, Episodes]:
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
    return _met(recogniser, evidence, objects, None, plan.orders, plan.seed + 1)


def _controls(
    trial: Trial, labels: Array, objects: Array, plan: Plan
) -> dict[str, dict[str, float] | None]:
    train, test = trial.fold.train, trial.fold.test
    recogniser = trial.recogniser
    result: dict[str, dict[str, float] | None] = {}
    measures: dict[str, Callable[[Touches], Floats | None]] = {
        "disc centre": disc_centres,
        "brightness": brightness,
        "sorted pixels": sorted_pixels,
    }
    memory = recogniser.memory_
    groups = left_out_groups(train, memory.labels, memory.objects, plan.label)
    for name, measure in measures.items():
        result[name] = None
        if (of_train := measure(train)) is None or (of_test := measure(test)) is None:
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
    log_likelihood: Array,
    objects: Array,
    labels: Array,
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
            result[str(k)] = float(scores(truth, beliefs).accuracy.mean())
    return result
