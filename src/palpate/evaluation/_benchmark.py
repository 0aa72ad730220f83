"""Presets beside simple recognisers on many sets of touches, whoever made them.

Archives x protocols x recognisers, with what nuisance values alone achieve, the spread
over folds, and CPU time; for people a table and sentences for each archive, one page.
"""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from sklearn.base import clone

from .._checks import check_count, check_option
from .._durable import write_text
from .._numbers import n_touches_of
from .._page import check_report_path, html_table, report_page, worded
from .._parallel import in_parallel
from .._types import Array, Bools, Floats, Label, PresetName
from ..recognition import PRESETS, ObjectRecogniser, find_geometry
from ..touches import Touches
from ._comparisons import CONTROLS, SIMPLE, STANDARDISED, taxels, without_contact
from ._episodes import run_episodes
from ._evaluate import Progress, silent
from ._report import TextTable, as_text
from ._splits import PROTOCOLS, RowFold, column_of, protocol_folds
from ._trial import spread

RECOGNISERS = (*PRESETS, *SIMPLE)
# Papers as written stay on their sensor; `liu2014` learns each pair of labels.
WRITTEN_FOR = {"corradi2015": ("dome", np.inf), "liu2014": ("array", 30)}
ORDERS = 20
POINTS = 1.0
TITLE = "Presets beside simple recognisers"

Archives = str | Path | Iterable[str | Path] | Mapping[str, Touches]


class Answers(NamedTuple):
    """A recogniser's answers in one fold: whether right, shape (n_test,), and more.

    And which are `informative`, (n_test,): of others the first label is no answer.
    """

    right: Bools
    informative: Bools
    learn_s: float
    per_touch_s: float
    after: dict[str, float]
    log_loss: float | None
    chosen: dict[str, Any] | None


class Task(NamedTuple):
    """A protocol on one set, and labels of shape (n_touches,)."""

    protocol: str
    label: Label
    labels: Array
    folds: list[RowFold]
    left_out: list[str]


class Comparison(dict[str, Any]):
    """What `benchmark` returns: plain values, ready for JSON, and what they say."""

    def summary(self) -> Iterator[str | TextTable]:
        """Yield a table for each archive, then a sentence for each comparison."""
        yield from _tables(self)
        yield from _verdicts(self)

    def write_report(self, path: str | Path) -> Path:
        """Write tables and sentences as one self-contained `.html`."""
        target = check_report_path(path)
        lines = "".join(f"<li>{worded(line)}</li>" for line in _verdicts(self))
        tables = [html_table(*table) for table in _tables(self)]
        sections = [f"<h1>{TITLE}</h1>", *tables, f"<ul>{lines}</ul>"]
        write_text(target, report_page(TITLE, sections))
        return target


def benchmark(
    archives: Archives,
    *,
    recognisers: Sequence[str] = RECOGNISERS,
    protocols: Sequence[str] = tuple(PROTOCOLS),
    label: Label = "object",
    touches: Sequence[int] = (1, 5, 10),
    repeats: int = 3,
    seed: int = 0,
    progress: Progress = silent,
) -> Comparison:
    """Compare presets with simple recognisers on sets of touches.

    Parameters
    ----------
    archives : path, iterable of paths, or mapping of str to Touches
        Touch archives (`.npz`), folders that hold some at any depth, or named touches.
    recognisers, protocols : sequence of str
        What is compared, and how; see docs/explanation/benchmark.md.
    label : {"object", "category"}
        What is recognised; protocol "categories" always recognises categories.
    touches : sequence of int
        Numbers of touches after which presets are scored.
    repeats, seed : int
        Draws of the protocol "random", and the seed of everything random.
    progress : callable, optional
        Called with the name of each stage. Folds run one after the other, or where
        `joblib.parallel_config` says.

    Returns
    -------
    result : dict
        Plain values, ready for JSON: "benchmark", an entry per archive and protocol,
        and "skipped", with reasons. For people it has `summary()`, tables and
        sentences, and `write_report(path)`, one page of HTML with them.

    Raises
    ------
    ValueError
        An option is not known, or there is no archive.
    """
    for name in recognisers:
        check_option("recognisers", name, RECOGNISERS)
    for name in protocols:
        check_option("protocols", name, PROTOCOLS)
    check_option("label", label, ("object", "category"))
    if not isinstance(touches, Iterable):
        raise ValueError(
            f"touches must hold numbers of touches, such as (1, 5), got {touches!r}."
        )
    for k in touches:
        check_count("touches", k)
    check_count("repeats", repeats)
    check_count("seed", seed, at_least=0)
    entries: list[dict[str, Any]] = []
    skipped: list[dict[str, Any]] = []
    sets = _sets(archives)
    if not sets:
        raise ValueError(
            "archives must hold one archive or more, got none. Name a folder."
        )
    for name, source in sets.items():
        progress(f"{name}: reading")
        skip = {"archive": name, "protocol": None}
        try:
            touch_set = source if isinstance(source, Touches) else Touches.load(source)
            column_of(touch_set, "object")
            empty = np.isnan(touch_set.images).reshape(len(touch_set), -1).all(axis=1)
            if empty.any():
                reason = f"left out {n_touches_of(int(empty.sum()))} of NaN alone."
                skipped.append({**skip, "reason": reason})
                touch_set = touch_set[~empty]
        except Exception as error:
            skipped.append({**skip, "reason": _reason(error)})
            continue
        tasks = []
        for protocol in protocols:
            wanted = "category" if protocol == "categories" else label
            try:
                folds = protocol_folds(touch_set, protocol, wanted, repeats, seed)
                tasks.append(
                    Task(protocol, wanted, column_of(touch_set, wanted), *folds)
                )
            except ValueError as error:
                skipped.append({**skip, "protocol": protocol, "reason": str(error)})
        answers: dict[str, list[list[Answers] | str]] = {}
        for method in recognisers if tasks else ():
            progress(
                f"{name}: {method}, {sum(len(task.folds) for task in tasks)} folds"
            )
            answers[method] = _answers(method, touch_set, tasks, touches, seed)
        progress(f"{name}: controls")
        entries += _entries(name, touch_set, tasks, answers)
    done = {"label": label, "repeats": repeats, "seed": seed}
    return Comparison(benchmark=entries, skipped=skipped, **done)


def _tables(result: dict[str, Any]) -> Iterator[TextTable]:
    """Yield title, columns and lines of text of each archive."""
    entries = result["benchmark"]
    for name in dict.fromkeys(entry["archive"] for entry in entries):
        group = [entry for entry in entries if entry["archive"] == name]
        rows = [row for entry in group for row in entry["rows"]]
        counts = sorted({int(k) for row in rows for k in row["after"] or {}} - {1})
        columns = ["recogniser", "after 1, %", "±", *(f"after {k}, %" for k in counts)]
        columns += ["no contact, %", "log loss", "learn, s", "ms a touch"]
        lines = [line for entry in group for line in _lines(entry, counts)]
        blank = [[*line, *[""] * (len(columns) - len(line))] for line in lines]
        yield f"{name}: {group[0]['n_touches']} touches", columns, blank


def _verdicts(result: dict[str, Any]) -> Iterator[str]:
    """Yield a sentence for each comparison, and for all that was left out."""
    for entry in result["benchmark"]:
        where = f"{entry['archive']}, {entry['protocol']}"
        if (behind := entry["behind"]) is not None:
            side = "behind" if behind["points"] > 0 else "ahead of"
            leak = behind["no_contact"]
            bare = f", which names {as_text(leak, 100)} % of touches without contact"
            yield (
                f"{where}: {behind['verdict']}: default is {abs(behind['points']):.1f} "
                f"points (standard error {behind['se']:.1f}) {side} "
                f"{behind['recogniser']}{'' if leak is None else bare}."
            )
        if entry["left_out"]:
            names = ", ".join(entry["left_out"])
            yield f"{where}: never asked ({len(entry['left_out'])}): {names}."
        for row in entry["rows"]:
            if row["reason"] is not None:
                yield f"{where}: no {row['recogniser']}: {row['reason']}"
    for left in result["skipped"]:
        yield f"{left['archive']}, {left['protocol'] or 'skipped'}: {left['reason']}"


def _sets(archives: Archives) -> dict[str, Path | Touches]:
    """Name every archive: by its place in the folder given, or by its file's name."""
    if isinstance(archives, Mapping):
        return dict(archives)
    sets: dict[str, Path | Touches] = {}
    for path in map(Path, [archives] if isinstance(archives, str | Path) else archives):
        inside = sorted(path.rglob("*.npz")) if path.is_dir() else [path]
        if not path.exists() or not inside:
            raise ValueError(
                "archives must be touch archives (.npz) or folders that hold some, got "
                f"{path}, where there is none. Write one with `Touches.save` or "
                "`TouchLibrary.export`, or name another folder."
            )
        for archive in inside:
            short = str(archive.relative_to(path)) if path.is_dir() else path.name
            sets[str(archive) if short in sets else short] = archive
    return sets


def _reason(error: Exception) -> str:
    expected = isinstance(error, ValueError | ImportError | OSError)
    return str(error) if expected else f"{type(error).__name__}: {error}"


def _answers(
    name: str, touches: Touches, tasks: list[Task], counts: Sequence[int], seed: int
) -> list[list[Answers] | str]:
    """Return the answers of one recogniser in each protocol, or why there are none."""
    answers: list[list[Answers] | str] = []
    learner: Any = None
    for task in tasks:
        try:
            if name in SIMPLE and learner is None:
                start = time.process_time()
                encode, learner = SIMPLE[name]
                values = encode(touches.images)
                encode_s = (time.process_time() - start) / len(touches)
            if name in SIMPLE:
                answers.append(_simply(learner, values, task, encode_s))
                continue
            _check_written_for(name, touches, task.labels)
            preset = cast(PresetName, name)
            recogniser = ObjectRecogniser(preset, label=task.label, random_state=seed)
            calls = [(fold, recogniser, touches, task, counts) for fold in task.folds]
            answers.append(in_parallel(_preset_answers, calls, "Folds", show=False))
        except Exception as error:
            learner = None
            answers.append(_reason(error))
    return answers


def _check_written_for(preset: str, touches: Touches, labels: Array) -> None:
    sensor, most = WRITTEN_FOR.get(preset, (None, np.inf))
    wrong = None
    if sensor and (geometry := find_geometry(touches)) != sensor:
        wrong = f"written for a sensor {sensor!r}, got {geometry!r}"
    elif (n_labels := len(np.unique(labels))) > most:
        wrong = f"asked about at most {most} labels, got {n_labels}"
    if wrong:
        raise ValueError(f"{preset} is {wrong}.")


def _simply(
    learner: Any, values: Floats, task: Task, encode_s: float = 0.0
) -> list[Answers]:
    calls = [(fold, learner, values, task.labels, encode_s) for fold in task.folds]
    return in_parallel(_simple_answers, calls, "Folds", show=False)


def _simple_answers(
    fold: RowFold, learner: Any, values: Floats, labels: Array, encode_s: float
) -> Answers:
    start = time.process_time()
    fitted = clone(learner).fit(values[fold.train], labels[fold.train])
    learnt = time.process_time()
    right = fitted.predict(values[fold.test]) == labels[fold.test]
    ask_s = (time.process_time() - learnt) / len(right) + encode_s
    learn_s = learnt - start + encode_s * len(fold.train)
    return Answers(right, np.ones_like(right), learn_s, ask_s, {}, None, None)


def _preset_answers(
    fold: RowFold,
    recogniser: ObjectRecogniser,
    touches: Touches,
    task: Task,
    counts: Sequence[int],
) -> Answers:
    start = time.process_time()
    recogniser = clone(recogniser).fit(touches[fold.train])
    learnt, test = time.process_time(), touches[fold.test]
    rows = recogniser.log_likelihood(test)
    ask_s = (time.process_time() - learnt) / len(test)
    whose = test.columns["object"], task.labels[fold.test]
    episodes = run_episodes(recogniser, rows, *whose, ORDERS, recogniser.random_state)
    ends = {k: end for k in {1, *counts} if (end := episodes.scores(k)) is not None}
    right = np.empty(len(test), dtype=bool)
    assert episodes.singles is not None
    right[np.concatenate(episodes.singles.rows)[:, 0]] = ends[1].hit
    after = {str(k): float(ends[k].accuracy.mean()) for k in sorted(ends) if k > 1}
    loss = float(ends[1].log_loss.mean())
    informative, learn_s = rows.max(axis=1) > rows.min(axis=1), learnt - start
    return Answers(right, informative, learn_s, ask_s, after, loss, recogniser.chosen_)


def _entries(
    name: str,
    touches: Touches,
    tasks: list[Task],
    answers: dict[str, list[list[Answers] | str]],
) -> list[dict[str, Any]]:
    idle, values = without_contact(touches), _nuisances(touches) if tasks else {}
    entries = []
    for i, task in enumerate(tasks):
        of_task = {method: of_tasks[i] for method, of_tasks in answers.items()}
        rows = [_row(method, part, task, idle) for method, part in of_task.items()]
        majority = float(np.mean([_majority(task.labels, fold) for fold in task.folds]))
        alone = {method: _alone(value, task) for method, value in values.items()}
        entries.append(
            {
                "archive": name,
                "protocol": task.protocol,
                "label": task.label,
                "n_touches": len(touches),
                "n_asked": sum(len(fold.test) for fold in task.folds),
                "n_labels": len(np.unique(task.labels)),
                "n_folds": len(task.folds),
                "left_out": task.left_out,
                "rows": rows,
                "controls": {"majority": majority, **alone},
                "behind": _behind(of_task, rows),
            }
        )
    return entries


def _row(
    name: str, answers: list[Answers] | str, task: Task, idle: Bools | None
) -> dict[str, Any]:
    if isinstance(answers, str):
        names = "accuracy", "sd", "se", "after", "no_contact", "log_loss", "seconds"
        return {
            "recogniser": name,
            **dict.fromkeys((*names, "chosen")),
            "reason": answers,
        }
    shares = [answer.right.mean() for answer in answers]
    keys = dict.fromkeys(k for answer in answers for k in answer.after)
    after = {k: _mean(answer.after.get(k) for answer in answers) for k in keys}
    bare = [] if idle is None else [idle[fold.test] for fold in task.folds]
    pairs = zip(answers, bare, strict=False)
    return {
        "recogniser": name,
        "accuracy": _mean(shares),
        "sd": float(spread(shares)) if len(shares) > 1 else None,
        "se": _error([answer.right for answer in answers]),
        "after": {"1": _mean(shares), **after},
        "no_contact": _mean(
            hit
            for answer, rows in pairs
            for hit in (answer.right & answer.informative)[rows]
        ),
        "log_loss": _mean(answer.log_loss for answer in answers),
        "seconds": {
            "learn": _mean(answer.learn_s for answer in answers),
            "per_touch": _mean(answer.per_touch_s for answer in answers),
        },
        "chosen": answers[0].chosen,
        "reason": None,
    }


def _mean(values: Iterable[float | None]) -> float | None:
    """Return the mean of the values that there are; None where there is none."""
    present = [value for value in values if value is not None]
    return float(np.mean(present)) if present else None


def _error(folds: Sequence[Array]) -> float:
    """Return the standard error of the mean over folds; of one fold, over touches."""
    values = [fold.mean() for fold in folds] if len(folds) > 1 else folds[0]
    return float(spread(values) / np.sqrt(len(values)))


def _behind(
    answers: dict[str, list[Answers] | str], rows: list[dict[str, Any]]
) -> dict[str, Any] | None:
    """Compare default with the best simple recogniser, in points that it is behind."""
    simple = [r for r in rows if r["recogniser"] in SIMPLE and r["reason"] is None]
    default = answers.get("default", "")
    if isinstance(default, str) or not simple:
        return None
    best = max(simple, key=lambda row: float(row["accuracy"]))
    of_best = answers[best["recogniser"]]
    assert not isinstance(of_best, str)
    pairs = zip(of_best, default, strict=True)
    lost = [100 * (a.right.astype(float) - b.right) for a, b in pairs]
    points, error = float(np.mean([losses.mean() for losses in lost])), _error(lost)
    return {
        "recogniser": best["recogniser"],
        "no_contact": best["no_contact"],
        "points": points,
        "se": error,
        "standard_errors": points / error if error else None,
        "verdict": "behind" if points > max(POINTS, error) else "not behind",
    }


def _nuisances(touches: Touches) -> dict[str, Floats | None]:
    """Return values that are not touch, (n_touches, n_values), by name."""
    images = touches.images
    load = np.nansum(images.reshape(len(images), -1).astype(np.float64), axis=1)
    values: dict[str, Floats | None] = {"total load": load.reshape(-1, 1)}
    for name, measure in CONTROLS.items():
        grey = images.ndim == 3 or name != "disc centre"
        values[name] = measure(touches) if grey else None
    frames, frame_of = touches.whole.get("set_idle"), touches.columns.get("idle_of")
    there = (
        frames is not None
        and frame_of is not None
        and frame_of.dtype.kind in "iu"
        and 0 <= frame_of.min() <= frame_of.max() < len(frames)
    )
    values["idle frame"] = taxels(np.asarray(frames))[frame_of] if there else None
    return values


def _alone(values: Floats | None, task: Task) -> float | None:
    """Return the accuracy from standardised values: SVM or 3-NN, the better one."""
    if values is None:
        return None
    both = [_simply(learner, values, task) for learner in STANDARDISED]
    return max(
        float(np.mean([answer.right.mean() for answer in answers])) for answers in both
    )


def _majority(labels: Array, fold: RowFold) -> float:
    names, counts = np.unique(labels[fold.train], return_counts=True)
    return float((labels[fold.test] == names[counts.argmax()]).mean())


def _lines(entry: dict[str, Any], counts: list[int]) -> Iterator[list[str]]:
    counted = f"{entry['n_labels']} labels, folds: {entry['n_folds']}"
    yield [f"{entry['protocol']} ({counted})"]
    for row in entry["rows"]:
        after, seconds = row["after"] or {}, row["seconds"] or {}
        shares = [row["accuracy"], row["se"], *(after.get(str(k)) for k in counts)]
        yield [
            f"  {row['recogniser']}",
            *(as_text(share, 100) for share in (*shares, row["no_contact"])),
            as_text(row["log_loss"], digits=2),
            as_text(seconds.get("learn"), digits=2),
            as_text(seconds.get("per_touch"), 1000, digits=2),
        ]
    for name, share in entry["controls"].items():
        if share is not None:
            yield [f"  control: {name}", as_text(share, 100)]
