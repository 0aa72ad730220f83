"""The current belief over objects, and what to make of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_softmax

from .._checks import check_number, check_option
from .._types import Array, Floats
from ..touches import Touches
from ._evidence import (
    Evidence,
    SequenceCalibration,
    doubts,
    is_informative,
    log_posterior,
    with_floor,
)
from ._explanation import explanation
from ._memory import Memory
from ._modality import Modality
from ._unknown import UnknownScale

Costs = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Judge:
    """What a belief is made by: all that a recogniser has learnt beside its encoding.

    The `classes` (n_objects,) by name, their `log_prior` (n_objects,) before the first
    touch (nats), the `floor` that one touch leaves to all of them together, how the
    evidence of an episode adds up, what episodes of known objects look like, other
    senses, and the training touches (`memory`), for `Belief.explain`.
    """

    classes: NDArray[np.str_]
    log_prior: Floats
    floor: float
    sequence_calibration: SequenceCalibration
    unknown_scale: UnknownScale
    senses: Mapping[str, Modality]
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
        How little the touches look like those of any known object, between 0 and 1;
        one known episode in twenty scores above about 0.5. From the doubt, from how
        much less probable the touches make `best` than its own training touches
        would, and from how much of them the encoding leaves unexplained.
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
        # Sums over the touches that said anything: of log-likelihoods, of the
        # probabilities that they give each object, of what they leave unexplained.
        self._n_informative = self._n_novelties = 0
        self._total = np.zeros(len(judge.classes))
        self._given = np.zeros(len(judge.classes))
        self._novelty = 0.0
        self._touch_log_posterior = self._log_prior
        self._unknown: float | None = None

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
        given = touch
        if not isinstance(given, Evidence):
            given = self._evidence_of(given)
        return self.update_from_log_likelihood(
            given.log_likelihood,
            features=given.features,
            flags=given.flags,
            novelty=given.novelty,
        )

    def update_from_log_likelihood(
        self,
        log_likelihood: ArrayLike,
        *,
        features: Floats | None = None,
        flags: list[str] | None = None,
        novelty: Floats | None = None,
    ) -> Self:
        """Take in touches by their log-likelihoods, shape (n_touches, n_objects).

        With `features` (n_touches, n_features) they can be explained later; `flags` and
        `novelty` (n_touches,) are as in `Evidence`.
        """
        rows = _checked_rows(log_likelihood, len(self._judge.classes))
        n_touches = len(rows)
        if features is None:
            features = np.full(
                (n_touches, self._judge.memory.features.shape[1]), np.nan
            )
        self.flags += flags or [""] * n_touches
        self._features += list(np.atleast_2d(features))
        news = np.full(n_touches, np.nan) if novelty is None else np.ravel(novelty)
        floored = with_floor(rows, self._judge.floor)
        self._floored += list(floored)
        informative = is_informative(floored)
        for row, new in zip(floored[informative], news[informative], strict=True):
            self._add(row, float(new))
        self._weigh()
        return self

    def _add(self, floored: Floats, novelty: float) -> None:
        """Add one touch that says something to the sums."""
        self._n_informative += 1
        self._total = self._total + floored
        self._given = self._given + np.exp(floored)
        if not np.isnan(novelty):
            self._n_novelties += 1
            self._novelty += novelty

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
        """Add up the prior, the other senses and the touches."""
        total = self._prior_and_senses()
        if self._floored:
            calibration = self._judge.sequence_calibration
            total = log_posterior(self._total, self._n_informative, total, calibration)
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
        shares = np.exp(self.log_posterior).tolist()
        return dict(zip(self._judge.classes.tolist(), shares, strict=True))

    @property
    def best(self) -> str:
        """The most probable object; ties go to the first in sorted order."""
        return str(self._judge.classes[self.log_posterior.argmax()])

    @property
    def doubt(self) -> float:
        """Probability outside `best`."""
        return float(doubts(self.log_posterior))

    @property
    def unknown(self) -> float:
        """How little the touches look like any known object; see `UnknownScale`."""
        if not self._floored:
            return 0.0
        if self._unknown is None:
            told = self._n_novelties > 0
            novelty = self._novelty / self._n_novelties if told else np.nan
            self._unknown = float(
                self._judge.unknown_scale.score(
                    self._touch_log_posterior,
                    np.asarray(self._n_informative),
                    self._given,
                    np.asarray(novelty),
                )
            )
        return self._unknown

    def decide(self, error: float = 0.01, costs: Costs | None = None) -> str | None:
        """Return the object, "unknown", or None while more touches are needed.

        Parameters
        ----------
        error : float, default=0.01
            Accepted share of wrong decisions. "unknown" is said when the touches
            look less like a known object than those of known episodes do: asked
            after every touch, it is said of this share of them (learnt from left-out
            training touches). Else an object is named when its probability is at
            least 1 - error and the belief `looks_known`.
        costs : mapping of str to mapping of str to float, optional
            `costs[truth][named]`, at least 0: what it costs to take one object for
            another; 1 where not given. The object of least expected cost is named,
            once that cost is at most `error`.

        Returns
        -------
        str or None
            A known object, "unknown", or None.
        """
        error = check_number("error", error, low=1e-6, high=0.5)
        if self.touches_used == 0 and not self._senses:
            return None
        limit = self.unknown_limit(error)
        if limit is not None and self.unknown > limit:
            return "unknown"
        if not self.looks_known():
            return None
        if costs is None:
            return self.best if self.doubt <= error else None
        expected = np.exp(self.log_posterior) @ self._cost_table(costs)
        affordable = expected.min() <= error
        return str(self._judge.classes[expected.argmin()]) if affordable else None

    def looks_known(self) -> bool:
        """Whether the touches fit a known object as four in five known episodes do."""
        scale = self._judge.unknown_scale
        return self.unknown <= scale.naming_threshold(self._n_informative)

    def unknown_limit(self, error: float = 0.01) -> float | None:
        """Return the unknown score above which `decide(error)` says "unknown".

        None before any touch said something.
        """
        if not self._n_informative:
            return None
        scale = self._judge.unknown_scale
        return scale.refusal_threshold(self._n_informative, error)

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

    def reason(self, error: float = 0.01, costs: Costs | None = None) -> str:
        """Return one sentence that says why `decide` answers as it does."""
        decision = self.decide(error, costs)
        touches = f"{self.touches_used} touch{'es' * (self.touches_used != 1)}"
        chance = f"{self.best} has probability {1 - self.doubt:.4f}"
        sure = f"{chance} after {touches}{self._basis}"
        if decision is None and not self.looks_known():
            return (
                f"Undecided: {sure}, but four in five known episodes fit better "
                f"(unknown score {self.unknown:.3f}). Touch again."
            )
        if costs is not None and decision != "unknown":
            expected = np.exp(self.log_posterior) @ self._cost_table(costs)
            least = f"{expected.min():.4f} after {touches}"
            if decision is None:
                return f"Undecided: the least expected cost is {least}, over {error:g}."
            return f"Decided for {decision}: its expected cost is {least}."
        if decision is None:
            return f"Undecided: {sure}, less than {1 - error:g}."
        if decision != "unknown":
            return f"Decided for {decision}: {sure}, at least {1 - error:g}."
        limit = self.unknown_limit(error)
        return (
            f"Unknown: after {touches} the unknown score (nearest: {self.best}) is "
            f"{self.unknown:.3f}; that of known episodes exceeds {limit:.3f} so "
            f"rarely that {error:g} of them are ever refused."
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
        weight = self._judge.sequence_calibration.weight(self._n_informative)
        steps = explanation(
            self._judge.memory,
            self._judge.classes,
            np.stack(self._floored),
            float(weight),
            np.stack(self._features),
            self._touch_log_posterior,
            (n_touches, n_nearest),
        )
        return [{**step, "flag": self.flags[step["touch"] - 1]} for step in steps]

    def __repr__(self) -> str:
        order = np.argsort(self.log_posterior)[::-1][:3]
        names, shares = self._judge.classes[order], np.exp(self.log_posterior[order])
        listed = ", ".join(
            f"{_short(name)} {p:.2f}" for name, p in zip(names, shares, strict=True)
        )
        return f"<{type(self).__name__} after {self.touches_used} touches: {listed}>"

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
        head = f"After {self.touches_used} touches; unknown score {self.unknown:.2f}"
        return f"<table><caption>{head}</caption>{rows}{more}</table>"


# Objects and letters that a picture of a belief shows.
_BARS, _LETTERS = 10, 24


def _short(name: object) -> str:
    text = str(name)
    return text if len(text) <= _LETTERS else f"{text[: _LETTERS - 3]}..."


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
    return rows
