"""One self-contained HTML page that a person would rather look at than numbers.

It says why the recogniser answered as it did: beside each touch that moved the belief
stand the training touches that it resembles.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._durable import write_text
from .._numbers import about, evenly_spaced, n_touches_of, units_needed
from .._page import (
    CONTROL_COLOURS,
    INK,
    OURS,
    as_shown,
    check_report_path,
    draw_confusion,
    html_table,
    panels,
    png_address,
    report_page,
    svg,
    worded,
)
from .._types import Array, Bools, Indices
from ..recognition import Evidence, sessions_message
from ..touches import Touches
from ._comparisons import as_good_alone
from ._episodes import Decisions, answers_of
from ._splits import VISITS
from ._trial import Trial, calibration_bins, confusion_of, labels_of, scored, spread

EXAMPLES = 6
SIDE = 120
PAIRS = 5
PICTURES_PER_PAIR = 4
EPISODES, WRONG = 6, 4
STRANGERS_LISTED = 8
MOVED, NEAREST = 3, 3
SMALL_SIDE = 72
# Inches: two beside each other in a window, and text of one size on a phone.
SIDE_BY_SIDE = 4.1, 3.7
# Title, columns and lines of text.
TextTable = tuple[str, list[str], list[list[str]]]


class Explained(NamedTuple):
    """One episode up to its end: the touches, and what was made of them.

    What they told is as in the session in which they were asked.
    """

    trial: Trial
    name: str
    truth: str
    rows: Indices
    touches: Touches
    evidence: Evidence
    label: str
    right: bool
    is_stranger: bool


class Figures(dict[str, Any]):
    """What `evaluate` returns: plain values, ready for JSON, and what they say."""

    def summary(self) -> Iterator[str | TextTable]:
        """Yield what figures say to people: sentences, and tables to be drawn."""
        title = (
            f"{self['preset']}: {self['n_labels']} {self['label']} labels, "
            f"{self['n_train_touches']} training and {self['n_test_touches']} test "
            f"touches, chance {100 * self['chance']:.3g} %"
        )
        if self["remount"] != "none":
            title += f", remount {self['remount']}"
        yield self["verdict"]
        yield title, _columns(self), _figure_lines(self)
        yield from self["notes"]
        for sentence in self["chosen"].get("found", ()):
            yield f"From the training touches: {sentence}."
        for flag, share in self["flags"].items():
            yield f"Flagged as {flag!r}: {as_text(share, 100)} % of the test touches."
        yield _decision_table(self)
        yield from _strangers_answers(self)
        yield _bound(self)
        yield from as_good_alone(self)
        if other_day := _other_day(self):
            yield other_day
        if gone := self["left_out"]:
            names = ", ".join(gone[:5]) + (", ..." if len(gone) > 5 else "")
            why = f"Left out, met in no other {self['split']}"
            if self["split"] not in VISITS:
                why = "Never asked, alone in their category"
            yield f"{why}: {len(gone)} ({names})."
        if todo := self["recommendations"]:
            yield "What to do now:"
            yield from (f"- {sentence}" for sentence in todo)


def write_report(
    path: str | Path, figures: dict[str, Any], trials: Sequence[Trial]
) -> Path:
    """Write accuracy, confusion, calibration, reasons and touches as one page.

    Parameters
    ----------
    path : str or Path
        Ending in `.html`; nothing else is written and nothing is loaded from
        elsewhere when it is looked at.
    figures : dict
        From `evaluate`.
    trials : sequence of Trial
        From `evaluate`.

    Raises
    ------
    ValueError
        `path` does not end in `.html`, or its folder is not there.
    """
    target = check_report_path(path)
    sections = [
        _head(figures),
        _accuracy(figures, trials),
        "".join(
            f"<p><b>{worded(sentence)}</b></p>" for sentence in as_good_alone(figures)
        ),
        _recommended(figures.get("recommendations", ())),
        _ends(figures),
        f"<p class=note>{_bound(figures)}</p>",
        _confusion(figures, trials),
        _explanations(figures, trials),
        _examples(trials),
    ]
    title = f"palpate: {figures['n_labels']} {figures['label']} labels"
    write_text(target, report_page(title, sections))
    return target


def _ends(figures: dict[str, Any]) -> str:
    """Return how many episodes ended how, a line each: that fits a phone."""
    title, columns, lines = _decision_table(figures)
    head, *rows = zip(columns, *lines, strict=True)
    return html_table(title, head, rows)


def _recommended(sentences: Sequence[str]) -> str:
    lines = "".join(f"<li>{worded(sentence)}</li>" for sentence in sentences)
    return f"<h2>What to do now</h2><ul>{lines}</ul>" if lines else ""


def _columns(figures: dict[str, Any]) -> list[str]:
    return ["after touches", *figures["accuracy"]]


def _figure_lines(figures: dict[str, Any]) -> list[list[str]]:
    """Return what each figure is, and its value after each number of touches."""
    over = "folds" if figures["n_folds"] > 1 else "objects"
    rows: list[tuple[str, dict[str, Any], float, int]] = [
        ("right, strangers aside, %", figures["accuracy"], 100, 1),
        (f"sd over {over}, %", figures["accuracy_sd"], 100, 1),
        ("objects", figures["n_objects"], 1, 0),
        ("log loss, nats", figures["log_loss"], 1, 2),
        ("category right, %", figures.get("category_accuracy", {}), 100, 1),
        ("calibration error", figures["ece"], 1, 3),
        ("the same before calibration", figures["ece_before"], 1, 3),
    ]
    for name, curve in figures["controls"].items():
        bare = name == "no contact"
        label = f"control: {'touches without contact' if bare else name} alone, %"
        rows.append((label, curve or dict.fromkeys(figures["accuracy"]), 100, 1))
    rows.append(("unknown, ROC area", figures.get("unknown_auroc", {}), 1, 3))
    for name, key in {"strangers": "unknown_refused", "known": "known_refused"}.items():
        over = f"{name} refused at the learnt limit, %"
        rows.append((over, figures.get(key, {}), 100, 1))
    return [
        [name, *(as_text(values.get(k), scale, n) for k in figures["accuracy"])]
        for name, values, scale, n in rows
        if any(value is not None for value in values.values())
    ]


def _decision_table(figures: dict[str, Any]) -> TextTable:
    """Return how many episodes of known objects, and of strangers, ended how."""
    decision = figures["decision"]
    title = (
        f"Stopping at an error of {decision['error']:g}, a refusal of "
        f"{decision['refusal']:g}, in {decision['n_episodes']} episodes"
    )
    ends = ["named right", "named wrong", "called unknown", "undecided"]
    lines = [["known", *_ended(decision)]]
    if "unknown_decision" in figures:
        lines.append(["strangers", *_ended(figures["unknown_decision"])])
    return title, ["objects", *ends, "touches on average"], lines


def _ended(decision: dict[str, Any]) -> list[str]:
    n_episodes = decision["n_episodes"]
    undecided = round(n_episodes * decision["undecided"])
    counts = decision["right"], decision["wrong"], decision["refused"], undecided
    shares = [as_text(n / n_episodes, 100).removesuffix(".0") for n in counts]
    cells = [f"{n} ({share} %)" for n, share in zip(counts, shares, strict=True)]
    return [*cells, as_text(decision["mean_touches"])]


def _strangers_answers(figures: dict[str, Any]) -> list[str]:
    """Return what strangers were called, a line each, those named oftenest first."""
    answers = figures.get("unknown_decision", {}).get("answers", {})
    not_named = {"unknown", "undecided"}
    n_named = {
        stranger: sum(n for answer, n in counts.items() if answer not in not_named)
        for stranger, counts in answers.items()
    }
    ranked = sorted(answers, key=lambda stranger: -n_named[stranger])
    lines = []
    for stranger in ranked[:STRANGERS_LISTED]:
        each = ", ".join(f"{answer} {n}" for answer, n in answers[stranger].items())
        lines.append(f"{stranger}, never learnt: {each}.")
    if more := len(ranked) - STRANGERS_LISTED:
        lines += [f"And {more} more things never learnt."] if more > 0 else []
    return lines


def _bound(figures: dict[str, Any]) -> str:
    """Return what the episodes that ended say of new objects, as a sentence.

    Every name that a thing never learnt was given is wrong.
    """
    decision, strangers = figures["decision"], figures.get("unknown_decision")
    n_named, n_wrong = decision["right"] + decision["wrong"], decision["wrong"]
    n_strangers = strangers["wrong"] if strangers else 0
    if not n_named + n_strangers:
        n_episodes, n_refused = decision["n_episodes"], decision["refused"]
        if n_refused == n_episodes:
            ends = f"in all {n_episodes} episodes a known object was called unknown"
        elif not n_refused:
            ends = f"all {n_episodes} with known objects stayed undecided"
        else:
            ends = f"of {n_episodes} with known objects {n_refused} were called unknown"
            ends += ", and the others stayed undecided"
        return f"No episode ended with a name: {ends}."
    counts = f"{n_wrong + n_strangers} of {n_named + n_strangers} names were wrong"
    if n_strangers:
        counts += f", {n_strangers} of them given to strangers"
    if not n_named:
        return f"{counts}; no known object was named."
    error, n_objects = decision["error"], decision["n_objects"]
    aside = "strangers aside, " if n_strangers else ""
    if decision["can_be_verified"]:
        return (
            f"{counts}; {aside}of new objects like these {n_objects} at most "
            f"{as_text(decision['bound'], 100)} % would be (95 % confidence)."
        )
    n_needed = about(units_needed(error))
    return (
        f"{counts}; {aside}{n_objects} named object{'s' * (n_objects != 1)} cannot "
        f"prove an error of {100 * error:g} %, about {n_needed} would."
    )


def _other_day(figures: dict[str, Any]) -> str:
    """Return what to expect on another day: as measured, where that was asked.

    "" where categories of objects never touched were asked: expected are learnt ones.
    """
    accuracy = figures["accuracy"]
    if figures["split"] == "unseen-objects":
        return ""
    if not figures["elsewhere"]:
        return sessions_message(figures["sessions"])
    visit = figures["split"] if figures["split"] in VISITS else ""
    k, *_ = accuracy
    how = "Nothing was learnt from the sessions of the test touches"
    if visit:
        how = f"Each {visit} was left out of learning in turn"
    used = figures["remount"]
    return (
        f"{how}: {as_text(accuracy[k], 100)} % right after "
        f"{n_touches_of(k)}{f' (remount {used})' * (used != 'none')} is what "
        f"to expect of another {visit or 'session'}."
    )


def as_text(value: float | None, scale: float = 1, digits: int = 1) -> str:
    """Return a figure with so many decimals, or a dash."""
    return "-" if value is None else f"{scale * value:.{digits}f}"


def explained_episodes(
    figures: dict[str, Any], trials: Sequence[Trial]
) -> list[Explained]:
    """Return at most six decided episodes: up to four wrong, the others right.

    Names given to strangers come first.
    """
    accepted = [figures["decision"][k] for k in ("error", "refusal", "strangers")]
    ends = [t.episodes.decide(*accepted) for t in trials]
    strange = [
        t.unknown_episodes.decide(*accepted)
        for t in trials
        if t.unknown_episodes is not None and t.unknown is not None
    ]
    named = _first_of_each(strange, lambda end: end.decided & ~end.refused)
    wrong = _first_of_each(ends, lambda end: end.decided & ~end.right)
    right = _first_of_each(ends, lambda end: end.right)
    n_wrong = max(WRONG, EPISODES - len(right))
    n_wrong = min(n_wrong, len(named) + len(wrong), EPISODES)
    n_right = min(EPISODES - n_wrong, len(right))
    wrong = wrong[: max(0, n_wrong - len(named))]
    shown = wrong + [right[place] for place in evenly_spaced(len(right), n_right)]
    return [
        *(
            _explained(trials[f], strange[f], number, is_stranger=True)
            for f, number in named[:n_wrong]
        ),
        *(_explained(trials[f], ends[f], number) for f, number in shown),
    ]


def _head(figures: dict[str, Any]) -> str:
    how = figures["split"] or "separate test touches"
    folds = f", {figures['n_folds']} folds" if figures["n_folds"] > 1 else ""
    good = f"<p><b>{worded(figures['verdict'])}</b></p>"
    chosen = figures["chosen"]
    findings = "".join(
        f"<br>Found: {worded(finding)}." for finding in chosen.get("found", ())
    )
    other_day = _other_day(figures)
    return (
        f"<h1>Recognising {figures['n_labels']} {figures['label']} labels by touch</h1>"
        f"{good}<p>Preset <b>{escape(figures['preset'])}</b>, "
        f"{figures['n_train_touches']} training and {figures['n_test_touches']} "
        f"test touches ({escape(how)}{folds}), "
        f"{figures['orders']} random orders of each object's touches.<br>"
        f"<span class=note>Encoding: {escape(str(chosen['encoding']))} "
        f"({escape(str(chosen['why']))}; geometry {escape(str(chosen['geometry']))})."
        f"{findings}{'<br>' * bool(other_day)}{worded(other_day)}</span></p>"
    )


def _accuracy(figures: dict[str, Any], trials: Sequence[Trial]) -> str:
    # After 1, 2, 3... touches, as far as every object has that many.
    shortest = min(b.shape[1] for trial in trials for b in trial.episodes.beliefs)
    each = [
        [scores.accuracy for scores in scored(trials, k)]
        for k in range(1, shortest + 1)
    ]
    per_fold = np.array([[over.mean() for over in folds] for folds in each])
    over = [folds[0] for folds in each] if len(trials) == 1 else per_fold
    sd = np.array([float(spread(scores)) for scores in over])
    plot = accuracy_curve(figures, per_fold.mean(axis=1), sd)
    bins = {}
    for k in figures["accuracy"]:
        ends = scored(trials, int(k))
        confidence = np.concatenate([scores.confidence for scores in ends])
        bins[k] = calibration_bins(confidence, np.concatenate([e.hit for e in ends]))
    return (
        "<h2>Accuracy against touches, and whether the belief can be trusted</h2>"
        f"<div class=row>{plot}{calibration_plot(bins)}</div>"
        "<p class=note>First: mean and one standard deviation over objects (over folds "
        "where there are several). Dashed: what nuisance values achieve by themselves."
        " Second: a belief of 0.9 should be right nine times in ten.</p>"
        + html_table("", _columns(figures), _figure_lines(figures))
        + _lines(figures["notes"])
    )


def _confusion(figures: dict[str, Any], trials: Sequence[Trial]) -> str:
    k = [int(key) for key in figures["accuracy"]][min(1, len(figures["accuracy"]) - 1)]
    names, confusion = confusion_of(trials, k)
    off = confusion.copy()
    np.fill_diagonal(off, 0)
    order = np.argsort(off, axis=None)[::-1][:PAIRS].tolist()
    pairs = [divmod(place, len(names)) for place in order if off.flat[place] > 0]
    shown = "".join(
        _pair(trials, names[true], names[taken_for], off[true, taken_for])
        for true, taken_for in pairs
    )
    none = "No learnt label was ever taken for another."
    return (
        f"<h2>What is taken for what, after {n_touches_of(k)}</h2>"
        + confusion_plot(confusion, names)
        + _lines(_strangers_answers(figures))
        + "<h2>Most confused pairs</h2>"
        + (shown or f"<p>{none}</p>")
    )


def accuracy_curve(figures: dict[str, Any], curve: Array, spread: Array) -> str:
    """Return accuracy against touches with its spread, chance and the controls.

    `curve` and `spread` hold mean and standard deviation after 1, 2, 3... touches.
    """
    figure, ((axes,),) = panels(1, 1, SIDE_BY_SIDE)
    touches = np.arange(1, len(curve) + 1)
    low, high = np.clip(curve - spread, 0, 1), np.clip(curve + spread, 0, 1)
    axes.fill_between(touches, 100 * low, 100 * high, color=OURS, alpha=0.15, lw=0)
    axes.plot(touches, 100 * curve, color=OURS, lw=2.2, label=figures["preset"])
    for colour, (name, control) in zip(
        CONTROL_COLOURS, figures["controls"].items(), strict=False
    ):
        if control:
            label = "without contact" if name == "no contact" else f"{name} alone"
            after, right = map(int, control), (100 * v for v in control.values())
            axes.plot([*after], [*right], "o--", color=colour, ms=4, lw=1, label=label)
    axes.axhline(100 * figures["chance"], color=INK, lw=0.8, ls=":", label="chance")
    axes.set(
        xlabel="touches", ylabel="right, %", ylim=(0, 101), xlim=(1, max(2, len(curve)))
    )
    axes.set_xticks(whole_ticks(max(2, len(curve))))
    # Beside the curves there is no place that is always free.
    figure.legend(frameon=False, loc="outside upper left", ncols=2, fontsize=8)
    return svg(figure, "Share right against touches")


def whole_ticks(last: int) -> list[int]:
    """Return at most eight numbers of touches from 1 to `last`, round ones."""
    steps = (factor * 10**power for power in range(9) for factor in (1, 2, 5))
    step = next(size for size in steps if last / size <= 7)
    return [1, *range(step, last + 1, step)] if step > 1 else [*range(1, last + 1)]


def calibration_plot(bins: dict[str, tuple[Array, Array, Array]]) -> str:
    """Return share right against belief, one line per number of touches."""
    figure, ((axes,),) = panels(1, 1, SIDE_BY_SIDE)
    axes.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=":")
    shades = np.linspace(0.35, 1.0, max(1, len(bins)))
    for shade, (name, (means, shares, _)) in zip(shades, bins.items(), strict=True):
        style = {"color": OURS, "alpha": float(shade), "ms": 4, "lw": 1.4}
        axes.plot(means, shares, "o-", label=f"after {name}", **style)
    axes.set(xlabel="belief in the best", xlim=(0, 1.01))
    axes.set(ylabel="share right", ylim=(0, 1.01))
    axes.legend(frameon=False, fontsize=8)
    return svg(figure, "Share right against belief")


def confusion_plot(confusion: Array, names: Sequence[str]) -> str:
    """Return the share of answers (columns) per true label (rows)."""
    size = min(11.0, 2.6 + 0.33 * len(names))
    figure, ((axes,),) = panels(1, 1, (size + 0.8, size))
    draw_confusion(axes, confusion, names, max(4.5, 9 - 0.08 * len(names)))
    axes.set(xlabel="recognised as", ylabel="touched")
    return svg(figure, "Share of answers for each label touched")


def _lines(sentences: Iterable[str]) -> str:
    """Return sentences as a paragraph, a line each; nothing of none."""
    text = "<br>".join(worded(sentence) for sentence in sentences if sentence)
    return f"<p>{text}</p>" if text else ""


def _pair(trials: Sequence[Trial], true: str, taken_for: str, share: float) -> str:
    """Return a confused pair: the touches that alone were confused, and examples."""
    pictures = _confused_touches(trials, true, taken_for)
    label = f"touches of {true} taken for {taken_for}, one at a time"
    if not pictures:  # together alone
        pictures = _pictures(trials, true, PICTURES_PER_PAIR)
        label = f"examples that taught {true}"
    others = _pictures(trials, taken_for, PICTURES_PER_PAIR)
    columns = (pictures, label), (others, f"examples that taught {taken_for}")
    cells = "".join(
        f"<div><div class=touches>{images}</div>"
        f"<span class=note>{escape(text)}</span></div>"
        for images, text in columns
    )
    title = f"<b>{escape(true)}</b> taken for <b>{escape(taken_for)}</b>"
    return f"<p>{title}: {100 * share:.0f} %</p><div class=row>{cells}</div>"


def _examples(trials: Sequence[Trial]) -> str:
    lines = "".join(
        f"<div class=line><div class=name>{escape(name)}</div>"
        f"<div class=touches>{_pictures(trials, name, EXAMPLES)}</div></div>"
        for name in labels_of(trials)
    )
    return f"<h2>Touches of each label</h2>{lines}"


def _confused_touches(trials: Sequence[Trial], true: str, taken_for: str) -> str:
    """Return test touches that by themselves are taken for the other, as images."""
    images: list[str] = []
    for trial in trials:
        singles = trial.episodes.singles or trial.episodes
        names = [str(name) for name in trial.recogniser.classes_]
        for truth, rows, beliefs in zip(
            singles.truth, singles.rows, singles.beliefs, strict=True
        ):
            if truth >= 0 and names[truth] == true and taken_for in names:
                answers = beliefs[:, 0].argmax(axis=1)
                confused = rows[answers == names.index(taken_for), 0]
                shown = confused[: PICTURES_PER_PAIR - len(images)]
                if len(shown):
                    images += _images(trial, trial.fold.test[shown], true)
    return "".join(images)


def _pictures(trials: Sequence[Trial], name: str, count: int) -> str:
    """Return evenly spaced training touches of a label, cleaned up, as images."""
    trial = next(t for t in trials if name in t.recogniser.classes_)
    of_train = trial.recogniser.memory_.labels[: len(trial.fold.train)]
    rows = np.flatnonzero(of_train == name)
    rows_shown = rows[evenly_spaced(len(rows), count)]
    return "".join(_images(trial, trial.fold.train[rows_shown], name))


def _images(trial: Trial, touches: Touches, name: str) -> list[str]:
    """Return touches of a label, cleaned up, as images."""
    cleaned = as_shown(trial.recogniser.encoder_.clean(touches), touches.channels)
    alt = escape(f"touch of {name}")
    return [f"<img src='{png_address(image, SIDE)}' alt='{alt}'>" for image in cleaned]


def _explanations(figures: dict[str, Any], trials: Sequence[Trial]) -> str:
    """Return the touches that moved some decisions most, wrong ones first, as HTML."""
    ends = figures["decision"]
    shown = "".join(
        _episode(episode, ends) for episode in explained_episodes(figures, trials)
    )
    if not shown:
        return ""
    return (
        "<h2>Why: the touches that moved the belief most</h2>"
        "<p class=note>Some episodes, wrong decisions first: names given to things "
        "never learnt, then other wrong ones. Each line shows a touch, and how "
        "far it moved the balance between the two most probable labels (in nats: 2.3 "
        "make one of them ten times more probable). Beside it are the training touches "
        "most like it, and their distance: 1 is the median distance between two "
        f"training touches.</p>{shown}"
    )


def _first_of_each(
    ends: Sequence[Decisions], which: Callable[[Decisions], Bools]
) -> list[tuple[int, int]]:
    """Return the first such episode of each object: fold, and number in it."""
    first_of: dict[str, tuple[int, int]] = {}
    for fold, end in enumerate(ends):
        for number in np.flatnonzero(which(end)).tolist():
            first_of.setdefault(str(end.objects[number]), (fold, number))
    return list(first_of.values())


def _explained(
    trial: Trial, end: Decisions, number: int, *, is_stranger: bool = False
) -> Explained:
    """Return an episode with the touches up to its end, and its answer."""
    met: tuple[Any, ...] = trial.episodes, trial.fold.test, trial.evidence
    if is_stranger:
        met = trial.unknown_episodes, trial.unknown, trial.unknown_evidence
    episodes, touches, of_all = met
    name, classes = str(end.objects[number]), trial.recogniser.classes_
    place = episodes.objects.index(name)
    truth = name if is_stranger else str(classes[episodes.truth[place]])
    orders = episodes.rows[place]
    rows = orders[number % len(orders), : int(end.touches[number])]
    answer = str(answers_of(episodes, end, classes)[number])
    evidence = Evidence.together([*map(of_all.of_touch, rows.tolist())])
    of_episode, right = (rows, touches[rows], evidence), bool(end.right[number])
    return Explained(trial, name, truth, *of_episode, answer, right, is_stranger)


def _episode(explained: Explained, decision: dict[str, Any]) -> str:
    belief = explained.trial.recogniser.start(strangers=decision["strangers"])
    belief.update(explained.evidence)
    reason = belief.reason(decision["error"], refusal=decision["refusal"])
    of_label = ", never learnt," if explained.is_stranger else ""
    if explained.name != explained.truth:
        of_label = f" ({escape(explained.truth)})"
    moved = "".join(
        f"<div class=why>{''.join(_touch(explained, step))}</div>"
        for step in belief.explain(MOVED, NEAREST)
    )
    label = (
        "nothing I know" if explained.label == "unknown" else escape(explained.label)
    )
    if explained.label == "unknown":  # lines of touches weigh learnt labels alone
        reason += (
            f". All touches together speak for a stranger by "
            f"{belief.unknown_evidence:.1f} nats; among what was learnt:"
        )
    ended = "recognised" if explained.right else f"taken for <b>{label}</b>"
    return (
        f"<p><b>{escape(explained.name)}</b>{of_label} {ended}.<br>"
        f"<span class=note>{escape(reason)}</span></p>{moved}"
    )


def _touch(explained: Explained, step: dict[str, Any]) -> Iterator[str]:
    """Yield a touch that moved the belief, then its nearest training touches."""
    pair = step["best"], step["rival"]
    more, less = pair if step["nats"] > 0 else pair[::-1]
    lines = [f"touch {step['touch']}:", f"{abs(step['nats']):.1f} nats for {more}"]
    lines += [f"over {less}", *filter(None, [step["flag"]])]
    yield _cell(explained.trial, explained.touches[[step["touch"] - 1]], lines)
    for near in step["nearest"]:
        lines = [near["object"], f"{near['distance']:.2f} away"]
        yield _cell(explained.trial, explained.trial.taught(near["row"]), lines)


def _cell(trial: Trial, touch: Touches, lines: Iterable[str]) -> str:
    """Return a touch as a small picture, where it has places, above its lines."""
    picture = ""
    if trial.recogniser.chosen_["geometry"] != "none":
        cleaned = as_shown(trial.recogniser.encoder_.clean(touch), touch.channels)[0]
        picture = f"<img src='{png_address(cleaned, SMALL_SIDE)}' alt='touch'>"
    text = "<br>".join(escape(line) for line in lines)
    return f"<div>{picture}<span>{text}</span></div>"
