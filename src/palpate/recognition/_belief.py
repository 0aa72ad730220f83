"""The current belief over objects, and what to make of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_number, check_option
from .._numbers import log_softmax
from .._types import Array, Floats
from ..touches import Touches
from . import _evidence, _unknown
from ._calibration import Modality
from ._evidence import Evidence
from ._memory import UNKNOWN, Memory, nearest_touches

Costs = Mapping[str, Mapping[str, float]]
LEVELS = ("object", "category", "any")


class Named(NamedTuple):
    """What was decided: a `name`, at the `level` "object", "category" or "unknown"."""

    level: str
    name: str


@dataclass(frozen=True)
class Judge:
    """What a belief is made by: all that a recogniser has learnt beside its encoding.

    The `classes` (n_objects,) by name, their `log_prior` (n_objects,) before the first
    touch (nats), the `floor` that one touch leaves to all of them together, how the
    evidence of an episode adds up, what may be decided (`limits`), other senses, the
    category of each object, "" where none is known (`categories`, (n_objects,)), and
    the training touches (`memory`), for `Belief.explain`.
    """

    classes: NDArray[np.str_]
    log_prior: Floats
    floor: float
    sequence_calibration: _evidence.SequenceCalibration
    limits: _unknown.DecisionLimits
    senses: Mapping[str, Modality]
    categories: NDArray[np.str_]
    memory: Memory


class Belief:
    """A posterior over objects that moves with every touch.

    Made by `ObjectRecogniser.start`. The touches of one belief are one episode:
    touches of one object, in any order.

    Attributes
    ----------
    posterior : dict of str to float
        Probability of each known object; sums to one.
    best : str
        The most probable object.
    doubt : float
        Probability outside `best`.
    unknown : float
        How little the encodings agree on any object, between 0 and 1: 1 less the
        geometric mean of the probabilities that each alone gives to the object on
        which they agree best, and more where the touches are far from its training
        touches. It falls as touches of a known object come in.
    touches_used : int
        Number of touches that entered so far, those without contact among them.
    flags : list of str
        What was wrong with each touch, "" for most; see `ObjectRecogniser.flags`.

    Notes
    -----
    It is not safe in threads: one thread at a time may update it.
    """

    # What the touches are weighed with, in sentences.
    _basis = ""

    def __init__(
        self,
        judge: Judge,
        evidence_of: Callable[[Touches | Array], Evidence],
        log_prior: Floats | None = None,
    ) -> None:
        self._judge = judge
        self._evidence_of = evidence_of
        self._log_prior = judge.log_prior if log_prior is None else log_prior
        self.flags: list[str] = []
        self._floored: list[Floats] = []
        self._features: list[Floats] = []
        self._senses: dict[str, list[Floats]] = {}
        # Sums over the touches that said anything: of log-likelihoods, of those of each
        # encoding alone, of log distances.
        self._n_informative = 0
        self._total = np.zeros(len(judge.classes))
        self._each = np.zeros((len(judge.limits.weights), len(judge.classes)))
        self._distance = np.zeros(len(judge.classes))
        self._touch_log_posterior = self._log_prior
        self._unknown: float | None = None
        self._error = 0.01

    def __copy__(self) -> Self:
        """Return a belief that goes on by itself; what was learnt is shared."""
        other = type(self).__new__(type(self))
        mine = vars(self).items()
        other.__dict__ = {n: [*v] if isinstance(v, list) else v for n, v in mine}
        other._senses = {name: [*rows] for name, rows in self._senses.items()}
        return other

    def update(self, touch: Touches | Array | Evidence) -> Self:
        """Take in one touch (or several, in order) and return this belief.

        Parameters
        ----------
        touch : Touches, ndarray of shape (n_rows, n_cols), or Evidence
            A touch of the same sensor as the training touches, or what
            `ObjectRecogniser.evidence` returned for it.

        Raises
        ------
        ValueError
            If the image has another size than the training touches, or holds
            NaN or infinity where the recogniser cannot take it; the belief is
            then unchanged.
        """
        given = touch if isinstance(touch, Evidence) else self._evidence_of(touch)
        return self.update_from_log_likelihood(
            given.log_likelihood,
            features=given.features,
            flags=given.flags,
            by_encoding=given.by_encoding,
            log_distances=given.log_distances,
        )

    def update_from_log_likelihood(
        self,
        log_likelihood: ArrayLike,
        *,
        features: Floats | None = None,
        flags: list[str] | None = None,
        by_encoding: Floats | None = None,
        log_distances: Floats | None = None,
    ) -> Self:
        """Take in touches by their log-likelihoods, shape (n_touches, n_objects).

        With `features` (n_touches, n_features) they can be explained later; `flags`,
        `by_encoding` and `log_distances` are as in `Evidence`. Without `by_encoding`
        all encodings are taken to say the same. What does not fit raises ValueError and
        changes nothing.
        """
        judge = self._judge
        rows = _checked_rows(log_likelihood, len(judge.classes))
        n_touches = len(rows)
        flags = [""] * n_touches if flags is None else flags
        if len(flags) != n_touches:
            raise ValueError(
                f"flags must be one for each of {n_touches} touches, got {len(flags)}."
            )
        n_features = judge.memory.features.shape[1]
        seen = _checked_part("features", features, (n_touches, n_features))
        apart = _checked_part("log_distances", log_distances, rows.shape)
        each = rows[:, np.newaxis]
        if by_encoding is not None:
            shape = n_touches, *self._each.shape
            each = _checked_part("by_encoding", by_encoding, shape)
        floored, each = (
            _evidence.with_floor(rows, judge.floor),
            _evidence.with_floor(each, judge.floor),
        )
        self.flags += flags
        self._features += list(seen)
        self._floored += list(floored)
        informative = _evidence.is_informative(floored)
        self._n_informative += int(informative.sum())
        self._total = self._total + floored[informative].sum(axis=0)
        self._each = self._each + each[informative].sum(axis=0)
        self._distance = self._distance + apart[informative].sum(axis=0)
        self._weigh()
        return self

    def update_sense(self, name: str, X: ArrayLike) -> Self:
        """Take in what another sense tells of the same object.

        Parameters
        ----------
        name : str
            A modality that the recogniser has learnt, see `learn_modality`.
        X : array-like of shape (n_features,) or (n_examples, n_features)
            One example or several.
        """
        senses = self._judge.senses
        if not senses:
            raise ValueError(
                f"name must be a sense that was learnt, got {name!r} and none is. Call "
                "learn_modality first."
            )
        check_option("name", name, senses)
        examples = np.atleast_2d(np.asarray(X))
        rows = senses[name].log_likelihood(examples, self._judge.classes)
        self._senses.setdefault(name, []).extend(rows)
        self._weigh()
        return self

    def _weigh(self) -> None:
        total = self._prior_and_senses()
        if self._floored:
            weight = self._judge.sequence_calibration.weight(self._n_informative)
            total = self._total * weight + total
        self._touch_log_posterior = log_softmax(total)
        self._unknown = None

    def _prior_and_senses(self) -> Floats:
        total = self._log_prior
        for name, rows in self._senses.items():
            calibration = self._judge.senses[name].sequence_calibration_
            total = total + np.sum(rows, axis=0) * calibration.weight(len(rows))
        return total

    @property
    def log_posterior(self) -> Floats:
        """Log posterior of each known object (nats), shape (n_objects,)."""
        return self._touch_log_posterior

    @property
    def touches_used(self) -> int:
        """Number of touches that entered so far."""
        return len(self._floored)

    @property
    def posterior(self) -> dict[str, float]:
        """Probability of each known object."""
        names = self._judge.classes.tolist()
        return dict(zip(names, self._shares(self.log_posterior), strict=True))

    def _shares(self, logs: Floats) -> list[float]:
        """Return probabilities by their logarithms; never 0 unless the floor is."""
        least = _unknown.LEAST_LOG if self._judge.floor else -np.inf
        return list(np.exp(np.maximum(logs, least)).tolist())

    @property
    def best(self) -> str:
        """The most probable object; ties go to the first in sorted order."""
        return str(self._judge.classes[self.log_posterior.argmax()])

    @property
    def doubt(self) -> float:
        """Probability outside `best`."""
        return float(_evidence.doubts(self.log_posterior))

    @property
    def unknown(self) -> float:
        """How little the encodings agree; 0 before any touch said something."""
        if not self._n_informative:
            return 0.0
        if self._unknown is None:
            self._unknown = self._score(self._said())
        return self._unknown

    def _said(self) -> Floats:
        """Return the log posterior that each encoding alone would have."""
        weight = self._judge.sequence_calibration.weight(self._n_informative)
        return np.asarray(
            log_softmax(self._each * weight + self._prior_and_senses(), axis=-1)
        )

    def _score(self, said: Floats) -> float:
        """Return the unknown score of objects, or of categories."""
        limits, count = self._judge.limits, np.asarray(self._n_informative)
        mean = self._distance / max(self._n_informative, 1)
        return float(limits.score(said, limits.apart(self._said(), mean), count))

    @property
    def categories(self) -> dict[str, float]:
        """Probability of each category; empty where the objects have none.

        Objects without a category count as one each.
        """
        codes = _unknown.category_codes(self._judge.categories)
        if codes is None:
            return {}
        names = np.where(
            self._judge.categories == "", self._judge.classes, self._judge.categories
        )
        present, first = np.unique(codes, return_index=True)
        shares = self._shares(
            _unknown.summed_by_category(self.log_posterior, codes, present)
        )
        return dict(zip(names[first].tolist(), shares, strict=True))

    @property
    def promise(self) -> _unknown.Promise:
        """What is known of the share of wrong names at the error last asked for."""
        return self._judge.limits.promise(self._error)

    def decide(
        self,
        error: float = 0.01,
        costs: Costs | None = None,
        *,
        refusal: float | None = None,
        level: str = "object",
    ) -> Any:
        """Return the object, "unknown", or None while more touches are needed.

        Parameters
        ----------
        error : float, default=0.01
            Accepted share of episodes in which another object is named. One is named
            when its probability is at least 1 - error and the encodings agree on it as
            on few left-out touches of objects that were never learnt; see `promise`
            for what that is worth.
        costs : mapping of str to mapping of str to float, optional
            `costs[truth][named]`, at least 0: what it costs to take one object for
            another; 1 where not given. The object of least expected cost is named,
            once that cost is at most `error`.
        refusal : float, optional
            Accepted share of episodes of known objects that are called unknown, asked
            after every touch; `error` unless given.
        level : {"object", "category", "any"}, default="object"
            What may be named. "any" names the object, or its category where only that
            is sure, and returns a value with `level` and `name`.

        Returns
        -------
        str, Named or None
            A known object or category, "unknown", or None.

        Raises
        ------
        ValueError
            If a share is not between 1e-6 and 0.5, or a category is asked for and
            none is known.
        """
        self._error = check_number("error", error, low=1e-6, high=0.5)
        asked = refusal if refusal is not None else error
        asked = check_number("refusal", asked, low=1e-6, high=0.5)
        check_option("level", level, LEVELS)
        if level == "category" and not self.categories:
            raise ValueError(
                "level must be 'object' or 'any', got 'category' and the objects have "
                "none. Learn from touches with a column 'category'."
            )
        found = self._decide(asked, costs, level)
        return found if found is None or level == "any" else found.name

    def _decide(self, refusal: float, costs: Costs | None, level: str) -> Named | None:
        if self.touches_used == 0 and not self._senses:
            return None
        limit = self.unknown_limit(refusal)
        unlike = limit is not None and self.unknown > limit
        if level != "category" and not unlike and (name := self._object(costs)):
            return Named("object", name)
        if level != "object" and (name := self._category()):
            return Named("category", name)
        return Named(UNKNOWN, UNKNOWN) if unlike else None

    def _object(self, costs: Costs | None) -> str | None:
        """Return the object that may be named at the error asked for, or None."""
        table = None if costs is None else self._cost_table(costs)
        if not self._is_agreed():
            return None
        if table is None:
            return self.best if self.doubt <= self._error else None
        expected = np.exp(self.log_posterior) @ table
        affordable = expected.min() <= self._error
        return str(self._judge.classes[expected.argmin()]) if affordable else None

    def _category(self) -> str | None:
        """Return the category that may be named at the error asked for, or None."""
        shares = self.categories
        if not shares:
            return None
        best = max(shares, key=lambda name: shares[name])
        if sum(shares.values()) - shares[best] > self._error:
            return None
        codes = _unknown.category_codes(self._judge.categories)
        assert codes is not None
        said = _unknown.summed_by_category(self._said(), codes, np.unique(codes))
        limit = self._judge.limits.naming_limit(self._error, category=True)
        return best if self._score(said) <= limit else None

    def _is_agreed(self) -> bool:
        return self.unknown <= self._judge.limits.naming_limit(self._error)

    def unknown_limit(self, refusal: float = 0.01) -> float | None:
        """Return the unknown score above which `decide` says "unknown".

        None before any touch said something.
        """
        if not self._n_informative:
            return None
        return self._judge.limits.refusing_limit(refusal)

    def _cost_table(self, costs: Costs) -> Floats:
        names = self._judge.classes.tolist()
        table = 1.0 - np.eye(len(names))
        if not isinstance(costs, Mapping):
            raise TypeError(
                "costs must map truths to what naming others costs, got "
                f"{type(costs).__name__}. Write {{truth: {{named: cost}}}}."
            )
        for truth, row in costs.items():
            check_option("costs", truth, names)
            if not isinstance(row, Mapping):
                raise TypeError(
                    f"costs of {truth!r} must map what is named to a cost, got "
                    f"{type(row).__name__}. Write {{{truth!r}: {{named: cost}}}}."
                )
            for named, cost in row.items():
                check_option("costs", named, names)
                value = check_number("costs", cost, low=0)
                if named == truth and value > 0:
                    raise ValueError(
                        f"costs must be 0 for the right name, got {value} for naming "
                        f"{truth!r} rightly. Leave it out."
                    )
                table[names.index(truth), names.index(named)] = value
        return table

    def reason(
        self,
        error: float = 0.01,
        costs: Costs | None = None,
        *,
        refusal: float | None = None,
        level: str = "object",
    ) -> str:
        """Return one sentence that says why `decide` answers as it does."""
        decision = self.decide(error, costs, refusal=refusal, level=level)
        name = decision.name if isinstance(decision, Named) else decision
        touches = f"{self.touches_used} touch{'es' * (self.touches_used != 1)}"
        chance = f"{self.best} has probability {1 - self.doubt:.4f}"
        sure = f"{chance} after {touches}{self._basis}"
        if name == UNKNOWN:
            limit = self.unknown_limit(error if refusal is None else refusal)
            return (
                f"Unknown: after {touches} the unknown score (nearest: {self.best}) is "
                f"{self.unknown:.3f}, above {limit:.3f}: what was learnt is hardly "
                "ever so."
            )
        if name is not None and name in self.categories and name != self.best:
            return (
                f"Decided for the category {name}: it has probability "
                f"{self.categories[name]:.4f} after {touches}{self._basis}; which one "
                "is not sure."
            )
        if costs is not None and (name is not None or self._is_agreed()):
            expected = np.exp(self.log_posterior) @ self._cost_table(costs)
            least = f"{expected.min():.4f} after {touches}"
            if name is None:
                return f"Undecided: the least expected cost is {least}, over {error:g}."
            return f"Decided for {name}: its expected cost is {least}."
        if name is not None:
            return f"Decided for {name}: {sure}, at least {1 - error:g}."
        if self.doubt > error:
            return f"Undecided: {sure}, less than {1 - error:g}."
        limit = self._judge.limits.naming_limit(error)
        return (
            f"Undecided: {sure}, but the encodings do not agree enough (unknown score "
            f"{self.unknown:.3g}, above {limit:.3g}). Touch again."
        )

    def explain(self, n_touches: int = 3, n_nearest: int = 3) -> list[dict[str, Any]]:
        """Return the touches that moved the belief most, and what they resemble.

        Parameters
        ----------
        n_touches, n_nearest : int, default=3
            How many touches, and how many training touches beside each.

        Returns
        -------
        list of dict
            By falling weight: `touch` (from 1), `best` and `rival` (the two most
            probable objects now), `nats` (how far the touch moved the balance towards
            `best`; negative: towards `rival`), `flag`, and `nearest`: dicts of
            `object`, `row` (among the training touches) and `distance` (1 is that of
            a middling pair of training touches).
        """
        if not self._floored:
            return []
        order = np.argsort(-self._touch_log_posterior, kind="stable")
        best, rival = map(int, order[:2])
        floored, names = np.stack(self._floored), self._judge.classes
        weight = float(self._judge.sequence_calibration.weight(self._n_informative))
        nats = weight * (floored[:, best] - floored[:, rival])
        moved = np.argsort(-np.abs(nats), kind="stable")[:n_touches]
        features = np.stack(self._features)[moved]
        nearest = nearest_touches(self._judge.memory, features, n_nearest)
        return [
            {
                "touch": int(k) + 1,
                "best": str(names[best]),
                "rival": str(names[rival]),
                "nats": float(nats[k]),
                "nearest": near,
                "flag": self.flags[k],
            }
            for k, near in zip(moved, nearest, strict=True)
        ]

    def __repr__(self) -> str:
        order = np.argsort(self.log_posterior)[::-1][:3]
        names = [str(name) for name in self._judge.classes[order]]
        some = [n if len(n) <= _LETTERS else f"{n[: _LETTERS - 3]}..." for n in names]
        shares = np.exp(self.log_posterior[order])
        listed = ", ".join(f"{n} {p:.2f}" for n, p in zip(some, shares, strict=True))
        return f"<{type(self).__name__} after {self._made}: {listed}>"

    @property
    def _made(self) -> str:
        return f"{self.touches_used} touch{'es' * (self.touches_used != 1)}"

    def _repr_html_(self) -> str:
        """Return bars of the ten most probable objects, for notebooks."""
        order = np.argsort(-self.log_posterior, kind="stable")[:_BARS]
        shares = np.exp(self.log_posterior[order])
        rows = "".join(
            _bar(str(self._judge.classes[k]), float(share))
            for k, share in zip(order, shares, strict=True)
        )
        n_more = len(self._judge.classes) - len(order)
        more = f"<tr><td colspan=2>and {n_more} more</td></tr>" if n_more else ""
        head = f"After {self._made}; unknown score {self.unknown:.2f}"
        return f"<table><caption>{head}</caption>{rows}{more}</table>"


# Objects and letters that a picture of a belief shows.
_BARS, _LETTERS = 10, 24


def _bar(name: str, share: float) -> str:
    style = f"background:#4c78a8;height:0.8em;width:{max(share, 0.002) * 12:.2f}em"
    bar = f'<div style="{style};display:inline-block"></div> {share:.3f}'
    return f'<tr><td>{escape(name)}</td><td style="text-align:left">{bar}</td></tr>'


def _checked_rows(log_likelihood: ArrayLike, n_objects: int) -> Floats:
    rows = np.atleast_2d(np.asarray(log_likelihood, dtype=np.float64))
    if rows.ndim != 2 or rows.shape[1] != n_objects:
        raise ValueError(
            f"log_likelihood must have shape (n_touches, {n_objects}), got "
            f"{rows.shape}. Its columns are the recogniser's classes_."
        )
    if np.isnan(rows).any() or not np.isfinite(rows.max(axis=1)).all():
        bad = np.isnan(rows).any(axis=1) | ~np.isfinite(rows.max(axis=1))
        raise ValueError(
            "log_likelihood must hold a finite number and no NaN for every touch, got "
            f"{rows[bad][0]} for touch {np.flatnonzero(bad)[0]}. Leave that touch out."
        )
    with np.errstate(over="ignore"):  # what is less by more than 1e308 is ruled out
        less: Floats = rows - rows.max(axis=1, keepdims=True)
    return less


def _checked_part(name: str, part: ArrayLike | None, shape: tuple[int, ...]) -> Floats:
    """Return a part of the evidence, NaN where there is none, or explain."""
    if part is None:
        return np.full(shape, np.nan)
    array = np.atleast_2d(np.asarray(part, dtype=np.float64))
    if array.shape != shape:
        raise ValueError(
            f"{name} must have shape {shape}, got {array.shape}. Take it from "
            "ObjectRecogniser.evidence, of the same touches."
        )
    return array
