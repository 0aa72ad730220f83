"""What is asked of an evaluation, what one fold of it holds, and the figures of all."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from statistics import mean
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import mannwhitneyu
from sklearn.utils import check_X_y

from .._checks import (
    STRANGERS,
    check_count,
    check_number,
    check_option,
    check_strangers,
)
from .._types import Floats, Indices, Label, Presentation, PresetName
from ..recognition import PRESETS, Evidence, ObjectRecogniser
from ..touches import Touches
from ._episodes import Decisions, Episodes, Scores, answers_of
from ._splits import VISITS, Fold

# Distances of centroids below this share of the touches' extent are rounding.
_ROUNDING = 1e-14
_SHARE_DIGITS = 12


@dataclass(frozen=True)
class Plan:
    """What is asked of an evaluation.

    Attributes
    ----------
    preset, label : str
        As for `ObjectRecogniser`.
    touches : tuple of int
        Numbers of touches after which figures are given, kept in order, each once.
    orders : int
        Random orders of each object's touches.
    train_touches : int or None
        Training touches drawn per object; None takes all.
    error, refusal : float
        Accepted shares of wrong names and of known objects called unknown, for the
        stopping rule; `refusal` is `error` unless given.
    strangers : float
        The share of episodes with something never learnt that the stopping rule
        expects.
    floor, presentation
        As for `ObjectRecogniser`.
    remount : str
        What a recogniser may do with test touches before it is asked: "none";
        "recentre" (get used to each session by its touches without labels) or
        "recentre:K" (by the first K); "confirm:N" (by the first N of each object with
        labels, which are then not asked).
    seed : int
        Seed of every draw.
    """

    preset: PresetName = "default"
    label: Label = "object"
    touches: tuple[int, ...] = (1, 5, 15, 30)
    orders: int = 20
    train_touches: int | None = None
    error: float = 0.01
    refusal: float | None = None
    strangers: float = STRANGERS
    floor: float | None = None
    presentation: Presentation = "auto"
    seed: int = 0
    remount: str = "none"

    def __post_init__(self) -> None:
        check_option("preset", self.preset, PRESETS)
        check_option("label", self.label, ("object", "category"))
        for name, share in zip(("error", "refusal"), self.accepted, strict=True):
            check_number(name, share, low=1e-6, high=0.5)
        check_strangers(self.strangers)
        check_count("orders", self.orders)
        check_count("seed", self.seed, at_least=0)
        if not isinstance(self.touches, Iterable) or not len([*self.touches]):
            raise ValueError(
                "touches must hold numbers of touches, such as (1, 5), got "
                f"{self.touches!r}."
            )
        for k in self.touches:
            check_count("touches", k)
        object.__setattr__(self, "touches", tuple(sorted({*self.touches})))
        self.remounting  # noqa: B018  It says what is wrong with `remount`.

    @property
    def accepted(self) -> tuple[float, float]:
        """The accepted shares of wrong names and of refused known objects."""
        return self.error, self.error if self.refusal is None else self.refusal

    @property
    def remounting(self) -> tuple[str, int | None]:
        """What `remount` says, and its number."""
        ways = r"(none|recentre)|(recentre|confirm):([1-9][0-9]*)"
        if (match := re.fullmatch(ways, str(self.remount))) is None:
            raise ValueError(
                "remount must be none, recentre, recentre:K or confirm:N with a number "
                f"of touches, got {self.remount!r}."
            )
        return match[1] or match[2], int(match[3]) if match[3] else None


@dataclass
class Trial:
    """One fold, learnt and tested: what the figures and the report are made of.

    Attributes
    ----------
    fold : Fold
        The touches that taught and those that were asked.
    recogniser : ObjectRecogniser
        Learnt from `fold.train`.
    evidence : Evidence
        All that the test touches told, each in its session.
    episodes, uncalibrated : Episodes
        Of the test touches: many orders of each object's, and each alone; and as they
        would be if touches of one episode added up in full.
    seconds : dict
        To learn; per touch to encode and to recognise.
    confirmed : Touches or None
        Touches of the test session that were confirmed, where some were.
    unknown : Touches or None
        Touches of unknown objects, where there are any.
    unknown_episodes : Episodes or None
        Their episodes, like `episodes`.
    unknown_evidence : Evidence or None
        All that they told, each in its session.
    controls : dict
        Accuracy after k touches of each nuisance control; None where it has no cause.
    """

    fold: Fold
    recogniser: ObjectRecogniser
    evidence: Evidence
    episodes: Episodes
    uncalibrated: Episodes
    seconds: dict[str, float]
    confirmed: Touches | None = None
    unknown: Touches | None = None
    unknown_episodes: Episodes | None = None
    unknown_evidence: Evidence | None = None
    controls: dict[str, dict[str, float] | None] = field(default_factory=dict)

    def taught(self, row: int) -> Touches:
        """Return the touch of a row of the memory; confirmed ones come last."""
        later = row - len(self.fold.train)
        if later < 0 or self.confirmed is None:
            return self.fold.train[[row]]
        return self.confirmed[[later]]


def scored(trials: Sequence[Trial], k: int) -> list[Scores]:
    """Return how the episodes ended after `k` touches, of folds that have any."""
    return [scores for t in trials if (scores := t.episodes.scores(k)) is not None]


def labels_of(trials: Sequence[Trial]) -> list[str]:
    """Return all labels that a fold has learnt, in order."""
    return sorted({str(name) for t in trials for name in t.recogniser.classes_})


def confusion_of(trials: Sequence[Trial], k: int) -> tuple[list[str], Floats]:
    """Return all labels, and the share of each answer per true label, k touches in.

    Rows are true labels, columns answers: means over the folds that ask about the
    label, zeros where none does. A fold may know fewer labels.
    """
    names = labels_of(trials)
    shares, n_asked = np.zeros((len(names), len(names))), np.zeros((len(names), 1))
    for trial in trials:
        if (scores := trial.episodes.scores(k)) is not None:
            columns = np.searchsorted(names, trial.recogniser.classes_)
            shares[np.ix_(columns, columns)] += scores.confusion
            n_asked[columns, 0] += scores.confusion.sum(axis=1) > 0
    return names, shares / np.maximum(n_asked, 1)


def figures_of(
    trials: Sequence[Trial], plan: Plan, split: str | None
) -> dict[str, Any]:
    """Return the figures of all folds together; see `evaluate`."""
    first = trials[0].recogniser
    figures: dict[str, Any] = {
        **{k: v for k, v in first.summary().items() if k != "labels"},
        "n_labels": len(labels_of(trials)),
        "split": split,
        "n_folds": len(trials),
        "left_out": list(trials[0].fold.left_out),
        "elsewhere": split in VISITS or all(t.fold.elsewhere for t in trials),
        "remount": plan.remount,
        "sessions": first.across_sessions(),
        "n_train_touches": sum(len(t.fold.train) for t in trials) // len(trials),
        "n_test_touches": sum(len(t.fold.test) for t in trials),
        "n_test_touches_taught": sum(t.fold.n_taught for t in trials),
        "chance": mean(1 / len(t.recogniser.classes_) for t in trials),
        "orders": plan.orders,
        "seed": plan.seed,
    }
    names = ("accuracy", "accuracy_sd", "n_objects", "log_loss", "ece", "ece_before")
    figures.update({name: {} for name in names})
    for k in plan.touches:
        _figures_after(k, trials, figures)
    figures["notes"] = _too_long_message(trials, plan) + _all_confirmed_message(trials)
    if right := _categories_right(trials, plan):
        figures["category_accuracy"] = right
    if trials[0].unknown_episodes is not None:
        of_strangers = "unknown_auroc", "unknown_refused", "known_refused"
        figures.update(zip(of_strangers, _unknown(trials, plan), strict=True))
    accepted = *plan.accepted, plan.strangers
    ends = [t.episodes.decide(*accepted) for t in trials]
    figures["decision"] = Decisions.pooled(ends).to_dict(*accepted)
    if trials[0].unknown_episodes is not None:
        figures["unknown_decision"] = _strangers_ends(trials, *accepted)
    figures["controls"] = _mean_controls(trials)
    flagged = [(Counter(t.evidence.flags), len(t.fold.test)) for t in trials]
    seen = dict.fromkeys(flag for each, _ in flagged for flag in sorted(each) if flag)
    figures["flags"] = {
        flag: float(np.mean([each[flag] / n for each, n in flagged])) for flag in seen
    }
    figures["seconds"] = {
        name: float(np.mean([t.seconds[name] for t in trials]))
        for name in trials[0].seconds
    }
    return figures


def _too_long_message(trials: Sequence[Trial], plan: Plan) -> list[str]:
    """Return a sentence on the numbers of touches that no object has, or none."""
    longest = max(b.shape[1] for t in trials for b in t.episodes.beliefs)
    left_out = [str(k) for k in plan.touches if k > longest]
    if len(left_out) == len(plan.touches):
        raise ValueError(
            f"touches must hold a number up to {longest}, the most test touches of an "
            f"object, got {plan.touches}."
        )
    sentence = (
        f"Left out: figures after {', '.join(left_out)} touches; no object has more "
        f"than {longest} test touches."
    )
    return [sentence] if left_out else []


def _all_confirmed_message(trials: Sequence[Trial]) -> list[str]:
    """Return a sentence on the objects whose test touches were all confirmed."""
    sets = [t.confirmed.object for t in trials if t.confirmed is not None]
    names = {str(name) for of in sets if of is not None for name in of}
    gone = sorted(names.difference(*(t.episodes.objects for t in trials)))
    sentence = (
        f"Not asked, as all their test touches were confirmed: {', '.join(gone)}."
    )
    return [sentence] if gone else []


def _figures_after(k: int, trials: Sequence[Trial], figures: dict[str, Any]) -> None:
    of_folds = scored(trials, k)
    if not of_folds:
        return

    def together(ends: Sequence[Scores], name: str) -> Any:
        return np.concatenate([getattr(scores, name) for scores in ends])

    per_fold = [scores.accuracy.mean() for scores in of_folds]
    over_objects = together(of_folds, "accuracy")
    key, over = str(k), over_objects if len(trials) == 1 else per_fold
    figures["accuracy"][key] = mean_share(per_fold)
    no_spread = len(trials) > len(of_folds) == 1
    figures["accuracy_sd"][key] = None if no_spread else float(spread(over))
    enough = [t.episodes.objects_after(k) for t in trials]
    figures["n_objects"][key] = len(set().union(*enough))
    figures["log_loss"][key] = float(np.mean(together(of_folds, "log_loss")))
    before = [s for t in trials if (s := t.uncalibrated.scores(k)) is not None]
    for name, ends in {"ece": of_folds, "ece_before": before}.items():
        both = together(ends, "confidence"), together(ends, "hit")
        figures[name][key] = calibration_error(*both)


def _categories_right(trials: Sequence[Trial], plan: Plan) -> dict[str, float]:
    """Return how often the category of the best object is right; {} without any."""
    result: dict[str, float] = {}
    for k in plan.touches:
        per_fold = []
        for trial in trials:
            shares = []
            categories = trial.recogniser.belief_model().categories
            for truth, log_posterior in zip(*trial.episodes.after(k), strict=True):
                if truth >= 0 and categories[truth]:
                    best = categories[log_posterior.argmax(axis=1)]
                    shares.append(float((best == categories[truth]).mean()))
            if shares:
                per_fold.append(np.mean(shares))
        if per_fold:
            result[str(k)] = float(np.mean(per_fold))
    return result


def _strangers_ends(trials: Sequence[Trial], *accepted: float) -> dict[str, Any]:
    """Return how strangers' episodes ended; `answers` counts those of each stranger."""
    parts: list[Decisions] = []
    answers: dict[str, Counter[str]] = {}
    for trial in trials:
        assert trial.unknown_episodes is not None
        ends = trial.unknown_episodes.decide(*accepted)
        parts.append(ends)
        each = answers_of(trial.unknown_episodes, ends, trial.recogniser.classes_)
        for name in trial.unknown_episodes.objects:
            of_name = answers.setdefault(name, Counter())
            of_name.update(each[ends.objects == name].tolist())
    ended = Decisions.pooled(parts).to_dict(*accepted)
    return ended | {"answers": {n: dict(c.most_common()) for n, c in answers.items()}}


def _unknown(trials: Sequence[Trial], plan: Plan) -> list[dict[str, float]]:
    """Return ROC areas, and shares of strangers and of known objects refused.

    After each number of touches. Refused is what exceeds the limit of learning: the
    evidence that one in twenty episodes of training touches left out exceeds.
    """
    area: dict[str, float] = {}
    refused: dict[str, float] = {}
    refused_known: dict[str, float] = {}
    for k in plan.touches:
        ends = []
        for trial in trials:
            assert trial.unknown_episodes is not None
            below = trial.episodes.unknown_after(k)
            above = trial.unknown_episodes.unknown_after(k)
            if len(below) and len(above):
                limit = trial.recogniser.strangers_.threshold(k)
                shares = (above > limit).mean(), (below > limit).mean()
                ends.append((roc_area(below, above), *shares))
        if ends:
            means = [float(np.mean(each)) for each in zip(*ends, strict=True)]
            area[str(k)], refused[str(k)], refused_known[str(k)] = means
    return [area, refused, refused_known]


def _mean_controls(trials: Sequence[Trial]) -> dict[str, dict[str, float] | None]:
    result: dict[str, dict[str, float] | None] = {}
    for name in trials[0].controls:
        curves = [c for t in trials if (c := t.controls[name]) is not None]
        keys = dict.fromkeys(k for curve in curves for k in curve)
        mean = {k: mean_share([c[k] for c in curves if k in c]) for k in keys}
        result[name] = mean if curves else None
    return result


def calibration_bins(
    confidence: ArrayLike, hit: ArrayLike, n_bins: int = 10
) -> tuple[Floats, Floats, Indices]:
    """Return mean confidence, share of hits and count of equal-mass bins.

    `confidence` holds the largest posterior of each episode, `hit` whether the most
    probable label was right; there are fewer bins for fewer episodes.
    """
    belief, right = _numbers("confidence", confidence), _numbers("hit", hit)
    if len(belief) != len(right):
        raise ValueError(
            f"hit must have one value for each of {len(belief)} episodes, got "
            f"{len(right)}."
        )
    check_count("n_bins", n_bins)
    # Which of equal beliefs come first is no matter of belief: each has their mean.
    _, value = np.unique(belief, return_inverse=True)
    right = (np.bincount(value, right) / np.bincount(value))[value]
    order = np.argsort(belief, kind="stable")
    parts = np.array_split(order, min(n_bins, len(order)))
    means = np.array([belief[part].mean() for part in parts])
    shares = np.array([right[part].mean() for part in parts])
    return means, shares, np.array([len(part) for part in parts])


def calibration_error(confidence: ArrayLike, hit: ArrayLike, n_bins: int = 10) -> float:
    """Return the expected calibration error over equal-mass bins.

    The mean distance between belief and share of hits, weighted by bin size;
    0 is perfect. With few episodes even a perfect recogniser scores above 0.
    `confidence` (n_episodes,) are beliefs in the best object, `hit` whether it was
    right; `n_bins` bins hold as many episodes each.

    Examples
    --------
    >>> from palpate.evaluation import calibration_error
    >>> calibration_error([0.75] * 4, [1, 1, 1, 0], n_bins=1)
    0.0
    """
    means, shares, counts = calibration_bins(confidence, hit, n_bins)
    return float(np.abs(means - shares) @ counts / counts.sum())


def roc_area(known_scores: ArrayLike, unknown_scores: ArrayLike) -> float:
    """Return the area under the ROC curve of a score that is higher for unknown.

    The chance that an unknown episode scores higher than a known one, ties half.
    `known_scores` (n_known,) and `unknown_scores` (n_unknown,).

    Examples
    --------
    >>> from palpate.evaluation import roc_area
    >>> roc_area([0.1, 0.2], [0.2, 0.9])
    0.875
    """
    below = _numbers("known_scores", known_scores)
    above = _numbers("unknown_scores", unknown_scores)
    n_won = mannwhitneyu(above, below, method="asymptotic").statistic
    return float(n_won / (len(below) * len(above)))


def _numbers(name: str, values: ArrayLike) -> Floats:
    """Return values of one episode at least, (n_episodes,), or explain."""
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.ndim != 1 or not len(numbers):
        raise ValueError(
            f"{name} must hold a number for each of one episode or more, got an array "
            f"of shape {numbers.shape}."
        )
    if np.isnan(numbers).any():
        episode = np.flatnonzero(np.isnan(numbers))[0]
        raise ValueError(
            f"{name} must hold no NaN, got one for episode {episode}. Leave it out."
        )
    return numbers


def mean_share(shares: Sequence[float] | Floats) -> float:
    """Return the mean of shares: means that differ by rounding alone are the same."""
    return round(float(np.mean(shares)), _SHARE_DIGITS)


def spread(values: ArrayLike) -> Floats:
    """Return the sample standard deviation (ddof 1) over the first axis.

    For results over objects, folds or draws; 0 where there are fewer than two.
    """
    numbers = np.asarray(values, dtype=np.float64)
    return np.asarray(numbers.std(axis=0, ddof=min(1, len(numbers) - 1)))


def davies_bouldin(X: ArrayLike, labels: ArrayLike, q: float = 2.0) -> float:
    """Return the Davies-Bouldin index of labelled touches; smaller is more distinct.

    Parameters
    ----------
    X : array-like of shape (n_touches, n_features)
        Feature vectors.
    labels : array-like of shape (n_touches,)
        At least two different ones.
    q : float, default=2
        A cluster's radius is the mean of the q-th powers of distances to its
        centroid, to the power 1 / q: 2 is eq. 9 of Corradi et al. 2014 [2]_, 1 what
        scikit-learn computes.

    Returns
    -------
    index : float
        Mean over clusters of the largest (radius + other radius) / distance of the
        centroids. Infinite where two clusters share a centroid.

    Raises
    ------
    ValueError
        Fewer than two different labels, or `q` below 1.

    References
    ----------
    .. [1] D. L. Davies, D. W. Bouldin, "A cluster separation measure", IEEE Trans.
       Pattern Anal. Mach. Intell. PAMI-1(2), 1979. doi:10.1109/TPAMI.1979.4766909
    .. [2] T. Corradi, P. Hall, P. Iravani, "Tactile features: recognising touch
       sensations with a novel and inexpensive tactile sensor", TAROS 2014,
       LNCS 8717. doi:10.1007/978-3-319-10401-0

    Examples
    --------
    >>> from palpate.evaluation import davies_bouldin
    >>> davies_bouldin([[0.0], [2.0], [10.0], [12.0]], ["a", "a", "b", "b"])
    0.2
    """
    touches, names = check_X_y(X, labels, dtype=np.float64)
    power = check_number("q", q, low=1)
    kinds, codes = np.unique(names, return_inverse=True)
    if len(kinds) < 2:
        raise ValueError(
            f"labels must hold at least two different ones, got {len(kinds)}. "
            "Clusters are compared with each other."
        )
    # Exact where touches are close; the index does not notice, and no square overflows.
    halved = _scaled(touches) / 2
    touches = _scaled(halved - halved[0])
    members = [touches[codes == kind] for kind in range(len(kinds))]
    centres = np.array([part.mean(axis=0) for part in members])
    pairs = zip(members, centres, strict=True)
    away = [np.linalg.norm(part - centre, axis=1) for part, centre in pairs]
    radius = np.array([_power_mean(distances, power) for distances in away])
    distance = np.sqrt(((centres[:, None] - centres) ** 2).sum(axis=2))
    extent = np.linalg.norm(touches, axis=1).max()
    distance[distance <= _ROUNDING * extent] = 0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.add.outer(radius, radius) / distance
    ratio[distance == 0] = np.inf
    np.fill_diagonal(ratio, -np.inf)
    return float(ratio.max(axis=1).mean())


def _scaled(values: Floats) -> Floats:
    """Multiply by the power of two that brings the largest to between 0.5 and 1."""
    _, exponent = np.frexp(np.abs(values).max())
    return np.asarray(np.ldexp(values, -exponent))


def _power_mean(distances: Floats, power: float) -> float:
    """Return the mean of powers of distances, to one over the power."""
    largest = distances.max() or 1.0
    mean = np.mean((distances / largest) ** power)
    return float(largest * mean ** (1 / power))
