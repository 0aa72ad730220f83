"""Learning, recognising and scoring touches: one protocol, from touches to figures.

`advice` says whether an accuracy is good, and what to do: at most three sentences more.
"""

import time
from collections import ChainMap, Counter
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from .._checks import listed
from .._numbers import n_touches_of
from .._parallel import in_parallel
from .._types import Array, Floats
from ..recognition import Evidence, ObjectRecogniser
from ..touches import Touches
from ._comparisons import (
    CONTROLS,
    as_good_alone,
    control_log_likelihood,
    telling,
    without_contact,
)
from ._episodes import Episodes, run_episodes
from ._report import Figures
from ._splits import (
    IN_ORDER,
    SPLITS,
    VISITS,
    Fold,
    check_touches,
    column_of,
    draw_touches,
    recorded_order,
    split_touches,
)
from ._trial import Plan, Trial, confusion_of, figures_of

_MOST = 3
# Right after the most touches that were asked for: good, and worth going on with.
_GOOD, _FAIR = 0.95, 0.8
# A share of touches without contact, an accuracy gained, a share of all mistakes, and a
# share of test touches that were taught too, at which something is worth saying.
_IDLE_SHARE, _GAIN, _SHARE_OF_MISTAKES, _TAUGHT_SHARE = 0.1, 0.05, 1 / 3, 0.1
# Touches of an object: fewer than the first are few, the second are good.
A_START, GOOD = 20, 60
_NAMED = 5
# Of fewer things than this every stranger resembles one; strangers that are expected.
_FEW_LABELS, _MANY_STRANGERS = 6, 0.2
# From this on a tenth of an accepted error is worth asking for.
_LEAST_ERROR = 1e-4
# So much (nats) decides between labels of which nothing else is said.
_TIE = 1e-9

Progress = Callable[[str], None]
N_TIMED = 100
_UNORDERED = (
    "The touches have no column order or time_s, which tells when each was made: they "
    "were split in the order in which they were read."
)


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
) -> tuple[Figures, list[Trial]]:
    """Learn, recognise and score.

    Parameters
    ----------
    train : Touches
        Training touches; with `split`, the touches to be split.
    test : Touches, optional
        Test touches. Exactly one of `test` and `split` must be given.
    split : {"between", "last", "unseen-objects", "session", "subject"}, optional
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
        over folds where there are several (None where only one has so many touches).
        `summary()` yields what they say to people: sentences, and tables as (title,
        columns, lines of text).
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
    for name, touches in (("train", train), ("test", test), ("unknown", unknown)):
        if touches is not None or name == "train":
            check_touches(name, touches)
    if test is not None and split is None:
        folds = [Fold("test", train, test)]
    elif split is not None and test is None:
        if split in VISITS and split not in train.columns:
            held = ", ".join(train.columns) or "none"
            raise ValueError(
                f"train must have a column {split!r} to be split by, got {held}. "
                f"Put the pictures into folders object/{split} and read them with "
                f"`levels=object/{split}`, or write the column into the touches' file."
            )
        folds = split_touches(train, split, plan.label)
    else:
        raise ValueError(
            f"Give either `test` touches or a `split` ({', '.join(SPLITS)}), got "
            f"{'both' if split is not None else 'neither'}."
        )
    if split == "unseen-objects":
        plan = replace(plan, label="category")
    if len(folds) == 1:
        trials = [_run(folds[0], unknown, plan, progress)]
    else:
        progress(f"{len(folds)} folds")
        tasks = [(fold, unknown, plan, silent) for fold in folds]
        trials = in_parallel(_run, tasks, "Folds", show=False)
    figures = Figures(figures_of(trials, plan, split))
    if split in IN_ORDER and recorded_order(train) is None:
        figures["notes"].append(_UNORDERED)
    figures["verdict"] = verdict(figures)
    figures["recommendations"] = recommendations(figures, trials)
    return figures, trials


def _run(fold: Fold, unknown: Touches | None, plan: Plan, progress: Progress) -> Trial:
    train, test = fold.train, fold.test
    if plan.train_touches is not None:
        train = draw_touches(train, plan.train_touches, plan.seed)
    recogniser = ObjectRecogniser(
        plan.preset,
        label=plan.label,
        floor=plan.floor,
        presentation=plan.presentation,
        random_state=plan.seed,
    )
    progress(f"{fold.name}: learning from {len(train)} touches")
    start = time.perf_counter()
    recogniser.fit(train)
    seconds = {"learn": time.perf_counter() - start}
    _check_labels(test, plan.label, recogniser)
    progress(f"{fold.name}: recognising {len(test)} touches")
    recognisers, test, evidence, confirmed = _remounted(recogniser, test, plan)
    *_, recogniser = recognisers.values()
    timing = _timed(recogniser, test)
    labels = test.columns[plan.label]
    objects = labels if test.object is None else test.object
    of_test = evidence.log_likelihood, objects, labels, plan.orders, plan.seed
    trial = Trial(
        replace(fold, train=train, test=test),
        recogniser,
        evidence,
        run_episodes(recogniser, *of_test, evidence),
        run_episodes(recogniser, *of_test, calibrated=False),
        seconds={**seconds, **timing},
        confirmed=confirmed,
    )
    if unknown is not None:
        progress(f"{fold.name}: meeting {len(unknown)} unknown touches")
        met = _meet_unknown(recognisers, unknown, plan)
        trial.unknown, trial.unknown_episodes, trial.unknown_evidence = met
    progress(f"{fold.name}: nuisance controls")
    trial.controls = _controls(trial, labels, objects, plan)
    return trial


def _remounted(
    recogniser: ObjectRecogniser, test: Touches, plan: Plan
) -> tuple[dict[Any, ObjectRecogniser], Touches, Evidence, Touches | None]:
    """Return what got used to each test session, what is asked, and what that tells.

    And the touches that were confirmed, None where none were.
    """
    way, number = plan.remounting
    if way == "none":
        return {None: recogniser}, test, recogniser.evidence(test), None
    order = recorded_order(test)
    order = np.arange(len(test)) if order is None else order
    in_order = np.argsort(order, kind="stable")
    if way == "confirm":
        names = test.columns[plan.label] if test.object is None else test.object
        first = [in_order[names[in_order] == n][:number] for n in np.unique(names)]
        confirmed = np.isin(np.arange(len(test)), np.concatenate(first))
        if confirmed.all():
            raise ValueError(
                f"remount must leave touches to ask about, got {plan.remount!r}, which "
                "takes all. Confirm fewer."
            )
        recogniser.remount(test[confirmed])
        tested = test[~confirmed]
        evidence = recogniser.evidence(tested)
        return {None: recogniser}, tested, evidence, test[confirmed]
    labels = [name for name in ("object", "category") if name in test.columns]
    session = np.zeros(len(test)) if test.session is None else test.session
    recognisers, all_rows, parts = {}, [], []
    names, codes = np.unique(session, return_inverse=True)
    for k, s in enumerate(names):
        rows = in_order[codes[in_order] == k]
        unlabelled = test[rows[:number]].without(*labels)
        recognisers[s] = copy(recogniser).remount(unlabelled)
        parts.append(recognisers[s].evidence(test[rows]))
        all_rows.append(rows)
    return recognisers, test[np.concatenate(all_rows)], Evidence.together(parts), None


def _timed(recogniser: ObjectRecogniser, test: Touches) -> dict[str, float]:
    few = test[: min(len(test), N_TIMED)]
    start = time.perf_counter()
    features = recogniser.encoder_.transform(few)
    encoded = time.perf_counter()
    recogniser.classifier_.log_likelihood(features)
    done = time.perf_counter()
    return {
        "encode_per_touch": (encoded - start) / len(few),
        "recognise_per_touch": (done - encoded) / len(few),
    }


def _check_labels(test: Touches, label: str, recogniser: ObjectRecogniser) -> None:
    new = np.setdiff1d(column_of(test, label), recogniser.classes_)
    if len(new):
        raise ValueError(
            f"test touches hold {label} {str(new[0])!r}, which was not learnt "
            f"({len(new)} such labels). Leave them out, or pass them as `unknown`."
        )


def _meet_unknown(
    recognisers: dict[Any, ObjectRecogniser], unknown: Touches, plan: Plan
) -> tuple[Touches, Episodes, Evidence]:
    """Ask strangers of what got used to their session, if test touches are of it.

    Others of the last. Returned in the order of sessions.
    """
    *_, last = recognisers
    recogniser = recognisers[last]
    sessions = [last] * len(unknown) if unknown.session is None else unknown.session
    whose = [session if session in recognisers else last for session in sessions]
    rows = {s: [n for n, of in enumerate(whose) if of == s] for s in recognisers}
    parts = {s: unknown[of] for s, of in rows.items() if of}
    unknown = Touches.concatenate(parts.values())
    objects = unknown.object if unknown.object is not None else unknown.category
    if objects is None:
        objects = np.full(len(unknown), "unknown")
    memory, names = recogniser.memory_, objects
    if plan.label == "category" and unknown.category is not None:
        names = np.union1d(objects, unknown.category)
    learnt = np.intersect1d(names, np.union1d(memory.objects, memory.labels))
    if len(learnt):
        raise ValueError(
            f"unknown touches must be of objects that were not learnt, got "
            f"{str(learnt[0])!r}. Leave those out."
        )
    evidence = Evidence.together(
        [recognisers[s].evidence(part) for s, part in parts.items()]
    )
    args = (objects, None, plan.orders, plan.seed + 1, evidence)
    episodes = run_episodes(recogniser, evidence.log_likelihood, *args)
    return unknown, episodes, evidence


def _controls(
    trial: Trial, labels: Array, objects: Array, plan: Plan
) -> dict[str, dict[str, float] | None]:
    """Return the accuracy of each nuisance control; None where it has no cause."""
    train, test, recogniser = trial.fold.train, trial.fold.test, trial.recogniser
    # Confirmed touches of the test session come after those of training.
    taught = recogniser.memory_.labels[: len(train)]
    groups = recogniser.left_out_groups(train)
    even = _evenly(taught, labels, plan.seed)

    def curve(rows: Floats, which: Any = slice(None)) -> dict[str, float]:
        episode_args = (objects[which], labels[which], plan.orders, plan.seed)
        episodes = run_episodes(recogniser, rows, *episode_args)
        of_k = {str(k): episodes.scores(k) for k in plan.touches}
        return {k: float(s.accuracy.mean()) for k, s in of_k.items() if s is not None}

    result: dict[str, dict[str, float] | None] = dict.fromkeys(CONTROLS)
    for name, measure in CONTROLS.items():
        if (in_train := measure(train)) is None or (in_test := measure(test)) is None:
            continue
        learnt = in_train[even], taught[even], groups[even]
        result[name] = curve(control_log_likelihood(*learnt, in_test))
    result["no contact"] = None
    if (idle := without_contact(test)) is not None and idle.any():
        rows = trial.evidence.log_likelihood[idle]
        # What says the same of all labels names none, also the first of them.
        own_columns = np.searchsorted(recogniser.classes_, labels[idle])
        rows[np.arange(len(rows)), own_columns] -= _TIE
        result["no contact"] = curve(rows, idle)
    return result


def _evenly(taught: Array, test_labels: Array, seed: int) -> Array:
    """Return training rows in which no count of touches gives the answer away.

    Where a fold asks about some labels alone, what is left of these in training may be
    less than of the others: to learn that is no nuisance of the sensor.
    """
    names, codes = np.unique(taught, return_inverse=True)
    here = np.isin(names, test_labels)
    if here.all() or not here.any():
        return np.arange(len(taught))
    most = np.bincount(codes)[here].min()
    order = np.random.default_rng(seed).permutation(len(taught))
    by_label = [order[codes[order] == code][:most] for code in range(len(names))]
    return np.sort(np.concatenate(by_label))


def strangers_message(figures: dict[str, Any]) -> str:
    """Return how many strangers were given a name, as a sentence; "" without any."""
    if (ends := figures.get("unknown_decision")) is None:
        return ""
    n_named, n_refused, n_episodes = ends["wrong"], ends["refused"], ends["n_episodes"]
    return (
        f"Things that were never learnt, in {n_episodes} episodes: {n_named} got a "
        f"name, {n_refused} were called unknown, {n_episodes - n_named - n_refused} "
        "stayed undecided."
    )


def _strangers_aside_message(figures: dict[str, Any]) -> str:
    """Return what becomes of known objects where strangers may come, as a sentence.

    "" where nearly as many are named right then as the most probable one is.
    """
    ends = figures.get("decision")
    *_, right = figures["accuracy"].values()
    if not ends or ends["right"] >= (right - _GAIN) * ends["n_episodes"]:
        return ""
    n_episodes, n_named, n_wrong = ends["n_episodes"], ends["right"], ends["wrong"]
    n_undecided = n_episodes - n_named - n_wrong - ends["refused"]
    return (
        "That counts the most probable object, strangers aside. To decide at an error "
        f"of {ends['error']:g}, with {100 * ends['strangers']:g} % strangers expected: "
        f"of {n_episodes} episodes with known objects {n_named} ended with the right "
        f"name, {n_wrong} with a wrong one, {ends['refused']} as unknown, "
        f"{n_undecided} undecided."
    )


def verdict(figures: dict[str, Any]) -> str:
    """Return whether this is good, and why; what else was asked of strangers."""
    aside, strangers = _strangers_aside_message(figures), strangers_message(figures)
    return " ".join(filter(None, (_verdict(figures), aside, strangers)))


def _too_many_named(figures: dict[str, Any]) -> bool:
    """Return whether more strangers were named than the accepted error."""
    ends = figures.get("unknown_decision")
    return ends is not None and bool(ends["wrong"] > ends["error"] * ends["n_episodes"])


def _verdict(figures: dict[str, Any]) -> str:
    """Return one sentence: whether known objects are told apart well, and why."""
    accuracy = figures["accuracy"]
    n_taught, n_test = figures["n_test_touches_taught"], figures["n_test_touches"]
    if n_taught >= _TAUGHT_SHARE * n_test:
        return (
            f"This says little of new touches: {n_taught} of {n_test} test touches "
            "were taught too, to the bit. Leave them out, or evaluate one set with "
            "`split=last`."
        )
    *_, last = accuracy
    right, chance = accuracy[last], figures["chance"]
    after = f"{100 * right:.0f} % right after {n_touches_of(last)}"
    beside, k = f"chance is {100 * chance:.0f} %", telling(figures)
    alone = {name: v[k] for name, v in figures["controls"].items() if v and k in v}
    alone.pop("no contact", None)
    if alone:
        best = max(alone, key=lambda name: alone[name])
        reached = f"{100 * alone[best]:.0f} %"
        if k != last:
            after += f" ({100 * accuracy[k]:.0f} % after {k})"
            reached += f" after {k}"
        at_once = reached.removesuffix(f" after {k}")
        beside += f", and {best} alone, which is no touch, {at_once}"
        if alone[best] >= accuracy[k] and right > 1.5 * chance:
            return (
                f"This does not show that touch works: {after}, but {best} alone, "
                f"which is no touch, names {reached}."
            )
        if k != last:  # there both get all right
            return (
                f"Better than no touch after {n_touches_of(k)}, not after {last}: "
                f"{100 * accuracy[k]:.0f} % right after {k}, where {beside}; after "
                f"{last} both are 100 %."
            )
    if right <= 1.5 * chance:
        return f"Not better than guessing: {after}, where {beside}."
    good = "Good" if right >= _GOOD else "Fair" if right >= _FAIR else "Not good yet"
    if _too_many_named(figures):
        good += " with known objects alone"
    return f"{good}: {after}, where {beside}."


def few_touches(numbers: dict[str, int]) -> str:
    """Return which objects have few of these numbers of touches, "" if none has."""
    few = [f"{name} ({n})" for name, n in numbers.items() if n < A_START]
    if not few:
        return ""
    return (
        f"few touches of {listed(few, _NAMED)}: {A_START} are a start, {GOOD} are good"
    )


def recommendations(figures: dict[str, Any], trials: Sequence[Trial]) -> list[str]:
    """Return at most three sentences that say what to do, what harms most first."""
    return list(islice(_all(figures, trials), _MOST))


def _all(figures: dict[str, Any], trials: Sequence[Trial]) -> Iterator[str]:
    accuracy = figures["accuracy"]
    *_, last = accuracy
    best = accuracy[last]
    idle = figures["flags"].get("no contact", 0.0)
    if idle >= _IDLE_SHARE:
        yield (
            f"{100 * idle:.0f} % of the test touches are without contact: press until "
            "the picture changes, or record with a higher `begin`."
        )
    nuisance = best > 1.5 * figures["chance"] and as_good_alone(figures)
    if nuisance and not all(map(_all_met_elsewhere, trials)):
        turns = "What is no touch does as well as touch: record objects in turns, "
        yield turns + (
            "so that each is met in every session."
            if figures["split"] == "session"
            else "mount the sensor anew in between, put each mounting into a folder of "
            "its own (object/session), and evaluate with `split=session`."
        )
    elsewhere = figures["elsewhere"]
    yield from _of_unknown(figures, elsewhere)
    counts = [dict(Counter(t.recogniser.memory_.labels.tolist())) for t in trials]
    if few := few_touches(dict(ChainMap(*counts))):
        yield f"Taught with {few}."
    confirming = _confirming(figures, trials[0], measured=elsewhere)
    if elsewhere and best < _GOOD and figures["remount"] == "none":
        yield (
            "Another mounting costs accuracy: try `remount=recentre:10`, which gets "
            f"used to it without labels, or `remount=confirm:3`.{confirming}"
        )
    elif confirming and best < _GOOD and not figures["remount"].startswith("confirm"):
        yield confirming.lstrip()
    if not elsewhere and not figures["sessions"]["asked"]:
        yield (
            "All was taught in one session: on another day expect less. Teach half "
            "of it after mounting the sensor anew."
        )
    if pair := _confused(int(last), trials):
        true, taken, share = pair
        yield (
            f"After {n_touches_of(last)} {100 * share:.0f} % of the "
            f"mistakes are {true} taken for {taken}: touch them where they differ, or "
            "give both one name if nobody needs them apart."
        )
    # Where strangers are named, touching until it decides names more of them.
    if not _too_many_named(figures) and (gained := _gained(accuracy)):
        before, after = gained
        yield (
            f"More touches help: {100 * accuracy[before]:.0f} % right after {before}, "
            f"{100 * accuracy[after]:.0f} % after {after}. Let it touch until it "
            "decides."
        )


def _all_met_elsewhere(trial: Trial) -> bool:
    """Return whether all that was taught is asked, in sessions that taught nothing."""
    taught, tested = trial.recogniser.memory_.objects, trial.episodes.objects
    return trial.fold.elsewhere and set(taught) == set(tested)


def _of_unknown(figures: dict[str, Any], elsewhere: bool) -> Iterator[str]:
    """Yield what to do where known things are unknown, or strangers are named."""
    ends = figures.get("decision", {})
    if ends and ends["refused"] > (ends["refusal"] + _GAIN) * ends["n_episodes"]:
        again = ""
        if elsewhere and figures["remount"] == "none":
            again = " or try `remount=recentre:10`"
        yield (
            f"In {ends['refused']} of {ends['n_episodes']} episodes a known object was "
            "called unknown: its touches are unlike those that taught it. Teach it as "
            f"it is touched now{again}; where nothing else can come, say `strangers=0`."
        )
    if not _too_many_named(figures):
        yield from _of_undecided(figures)
        return
    ends = figures["unknown_decision"]
    todo = []
    if (n_labels := figures["n_labels"]) < _FEW_LABELS:
        todo.append(f"teach at least {_FEW_LABELS} things, not {n_labels}")
    if ends["strangers"] < _MANY_STRANGERS:
        todo.append(f"expect more strangers (`strangers={_MANY_STRANGERS}`)")
    if ends["error"] >= _LEAST_ERROR:
        todo.append(f"accept fewer wrong names (`error={ends['error'] / 10:g}`)")
    if not todo:
        return
    yield (
        f"In {ends['wrong']} of {ends['n_episodes']} episodes a stranger was given a "
        f"name: {'; '.join(todo)}. Each makes that rarer, none impossible, "
        "and takes more touches."
    )


def _of_undecided(figures: dict[str, Any]) -> Iterator[str]:
    """Yield what to do where no stranger is ever called unknown."""
    ends = figures.get("unknown_decision")
    if not ends or ends["refused"]:
        return
    todo = ["touch more often"]
    if (n_labels := figures["n_labels"]) < _FEW_LABELS:
        todo.insert(0, f"teach at least {_FEW_LABELS} things, not {n_labels}")
    if ends["strangers"] < _MANY_STRANGERS:
        todo.append(
            f"say that more strangers come (`strangers={_MANY_STRANGERS}`), which "
            "needs less evidence for unknown, also where a known object is touched"
        )
    yield (
        f"None of {ends['n_episodes']} episodes with strangers ended as unknown. What "
        f"may help, and is not measured here: {'; '.join(todo)}."
    )


def _confirming(figures: dict[str, Any], trial: Trial, *, measured: bool) -> str:
    """Return what confirmed touches are expected to bring, and of which objects.

    Nothing is promised where another session was `measured`. "" where sessions were
    not rehearsed, or the middle of the range grows too little.
    """
    sessions = figures["sessions"]
    if "confirmed" not in sessions:
        return ""
    before, after = sessions["rehearsed"], sessions["confirmed"]
    if np.mean(after) - np.mean(before) < _GAIN:
        return ""
    remount = trial.recogniser.chosen_.get("remount", {})
    left = remount.get("confirm") or trial.recogniser.classes_.tolist()
    low, high, low_after, high_after = (f"{100 * x:.0f}" for x in (*before, *after))
    confirm = (
        f" In another session confirm a touch of each {figures['label']} "
        f"({listed(left, _MOST)})"
    )
    if measured:
        return f"{confirm}."
    return (
        f"{confirm}: expect about {low_after} to {high_after} % right after one touch, "
        f"not {low} to {high} %."
    )


def _confused(k: int, trials: Sequence[Trial]) -> tuple[str, str, float] | None:
    """Return the pair with a third of all mistakes after k touches, if there is one."""
    names, mistakes = confusion_of(trials, k)
    np.fill_diagonal(mistakes, 0)
    total = float(mistakes.sum())
    if len(names) < 3 or total / len(names) < _GAIN / 2:
        return None
    true, taken = np.unravel_index(mistakes.argmax(), mistakes.shape)
    share = float(mistakes[true, taken]) / total
    return (names[true], names[taken], share) if share >= _SHARE_OF_MISTAKES else None


def _gained(accuracy: dict[str, float]) -> tuple[str, str] | None:
    """Return the last two numbers of touches, if the second is right more often."""
    if len(accuracy) < 2:
        return None
    *_, before, after = accuracy
    return (before, after) if accuracy[after] - accuracy[before] >= _GAIN else None
