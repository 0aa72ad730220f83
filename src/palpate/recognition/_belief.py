"""The current belief: each learnt object, or none of them, and what to make of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import (
    STRANGERS,
    check_count,
    check_number,
    check_option,
    check_strangers,
)
from .._numbers import log_softmax, n_touches_of, share_of, with_floor
from .._types import Array, Floats
from ..touches import Touches
from . import _evidence, _strangers
from ._evidence import NO_CONTACT, Evidence
from ._memory import UNKNOWN, Memory
from ._sentences import (
    OTHER_SESSION,
    Promise,
    belief_in_html,
    draw_belief,
    is_counted,
    sentence_of,
)
from ._user_parts import Modality

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Costs = Mapping[str, Mapping[str, float]]
Level = Literal["object", "category", "any"]
LEVELS = ("object", "category", "any")
# More touches are said not to tell after as many as an object was taught with, at most
# so many, where so many times as many would decide nothing.
_ENOUGH, _MANY_TIMES = 20, 1000
# Objects and letters that a picture of a belief shows.
_BARS, _LETTERS = 10, 24


class Named(NamedTuple):
    """A decision: a `name`, at the `level` "object", "category" or "unknown"."""

    level: str
    name: str


@dataclass(frozen=True)
class BeliefModel:
    """What a belief needs of a recogniser: all that was learnt beside the encoding.

    The `classes` (n_objects,) by name, their `log_prior` (n_objects,) before the first
    touch (nats), the `floor` that one touch leaves to all of them together, how the
    evidence of an episode adds up, what tells `strangers`, other senses, the category
    of each object, "" where none is known (`categories`, (n_objects,)), the training
    touches (`memory`), for `Belief.explain`, whether it serves in another session
    without a confirmed touch of each object (`other_session`), and whether touches
    without contact count (`uses_no_contact`).
    """

    classes: NDArray[np.str_]
    log_prior: Floats
    floor: float
    sequence_calibration: _evidence.SequenceCalibration
    strangers: _strangers.StrangerModel
    senses: Mapping[str, Modality]
    categories: NDArray[np.str_]
    memory: Memory
    other_session: bool = False
    uses_no_contact: bool = False

    def after_each(
        self, floored: Floats, by_encoding: Floats, log_distances: Floats
    ) -> tuple[Floats, Floats]:
        """Return log posteriors and the evidence for a stranger after each touch.

        Of episodes, whose log-likelihoods have their floor; see `episode_evidence`.
        """
        how = self.log_prior, self.sequence_calibration, self.strangers
        return _strangers.episode_evidence(floored, by_encoding, log_distances, *how)


class Belief:
    """The probability of each learnt object, and of none of them, touch by touch.

    Made by `ObjectRecogniser.start`. The touches of one belief are one episode:
    touches of one object, in any order.

    Attributes
    ----------
    flags : list of str
        What was wrong with each touch, "" for most; see `Evidence`. Without contact
        nothing is wrong where such touches count.

    Notes
    -----
    It is not safe in threads: one thread at a time may update it.
    """

    def __init__(
        self,
        model: BeliefModel,
        evidence_of: Callable[[Touches | Array], Evidence],
        prior: Mapping[str, float] | None = None,
        strangers: float = STRANGERS,
    ) -> None:
        self._model = model
        self._evidence_of = evidence_of
        self._log_prior = model.log_prior
        if prior is not None:
            self._log_prior = _evidence.given_prior(prior, model.classes)
        self.strangers = check_strangers(strangers)
        self.flags: list[str] = []
        self._floored: list[Floats] = []
        self._features: list[Floats] = []
        self._senses: dict[str, list[Floats]] = {}
        # Sums over the touches that said anything: of log-likelihoods, of those of each
        # encoding alone, of log distances.
        self._n_informative = 0
        self._total = np.zeros(len(model.classes))
        self._each = np.zeros((len(model.strangers.weights), len(model.classes)))
        self._distance = np.zeros(len(model.classes))
        self._touch_log_posterior = self._log_prior
        # What speaks for a stranger: what each encoding alone believes, how far the
        # touches are, and the lowest level at which each object was best so far.
        self._alone = np.zeros_like(self._each)
        self._farther = self._score = np.zeros(())
        self._lowest = np.full(len(model.classes), np.inf)
        self._log_shares: tuple[float, float] | None = None

    def __copy__(self) -> Self:
        """Return a belief that goes on by itself; what was learnt is shared."""
        other = type(self).__new__(type(self))
        for name, value in vars(self).items():
            setattr(other, name, [*value] if isinstance(value, list) else value)
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
        evidence = touch if isinstance(touch, Evidence) else self._evidence_of(touch)
        return self.update_from_log_likelihood(
            evidence.log_likelihood,
            features=evidence.features,
            flags=evidence.flags,
            by_encoding=evidence.by_encoding,
            log_distances=evidence.log_distances,
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
        model = self._model
        rows = _evidence.checked_rows(log_likelihood, len(model.classes))
        n_touches = len(rows)
        flags = [""] * n_touches if flags is None else flags
        if len(flags) != n_touches:
            raise ValueError(
                f"flags must be one for each of {n_touches} touches, got {len(flags)}."
            )
        shape = n_touches, *self._each.shape
        kept, distances, each = _evidence.checked_parts(
            features=(features, (n_touches, model.memory.features.shape[1])),
            log_distances=(log_distances, rows.shape),
            by_encoding=(by_encoding, shape),
        )
        if by_encoding is None:
            each = np.broadcast_to(rows[:, np.newaxis], shape)
        else:
            _evidence.check_every_touch("by_encoding", each)
        together = np.concatenate([rows[:, np.newaxis], each], axis=1)
        together = with_floor(together, model.floor)
        floored, each = together[:, 0], together[:, 1:]
        if model.uses_no_contact:
            flags = ["" if flag == NO_CONTACT else flag for flag in flags]
        self.flags += flags
        self._features += list(kept)
        self._floored += list(floored)
        for row in np.flatnonzero(_evidence.is_informative(floored)):
            self._n_informative += 1
            self._total = self._total + floored[row]
            self._each = self._each + each[row]
            self._distance = self._distance + distances[row]
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
        senses = self._model.senses
        if not senses:
            raise ValueError(
                f"name must be a sense that was learnt, got {name!r} and none is. Call "
                "learn_modality first."
            )
        check_option("name", name, senses)
        examples = np.atleast_2d(np.asarray(X))
        rows = senses[name].log_likelihood(examples, self._model.classes)
        self._senses.setdefault(name, []).extend(rows)
        self._weigh()
        return self

    def _weigh(self) -> None:
        """Believe what all touches and senses so far come to."""
        weight = self._model.sequence_calibration.weight(self._n_informative)
        total = np.concatenate([self._total[np.newaxis], self._each]) * weight
        logs = log_softmax(total + self._prior_and_senses())
        self._touch_log_posterior = logs[0]
        self._track_strangers(logs[0], logs[1:])

    def _track_strangers(self, log_posterior: Floats, by_encoding: Floats) -> None:
        """Keep what speaks for a stranger, or against one, by the posteriors now."""
        self._log_shares = None
        if not self._n_informative:
            return
        model, count = self._model.strangers, np.asarray(self._n_informative)
        self._alone = by_encoding
        self._farther = model.farther(by_encoding, self._distance / count)
        self._score = model.score(by_encoding, self._farther, count)
        best, shares = log_posterior.argmax(), np.exp(log_posterior)
        shares[best] = 0.0  # what is left is the doubt, exact near 0
        level = _strangers.log_level(self._score, shares.sum())
        self._lowest = self._lowest.copy()
        self._lowest[best] = np.minimum(self._lowest[best], level)

    def _prior_and_senses(self) -> Floats:
        total = self._log_prior
        for name, rows in self._senses.items():
            calibration = self._model.senses[name].sequence_calibration_
            total = total + np.sum(rows, axis=0) * calibration.weight(len(rows))
        return total

    @property
    def log_posterior(self) -> Floats:
        """Log probability of each learnt object, were it one of them, (n_objects,).

        In nats. `posterior` holds these probabilities times 1 - `unknown`.
        """
        return self._touch_log_posterior.copy()

    @property
    def touches_used(self) -> int:
        """Number of touches so far, those without contact among them."""
        return len(self._floored)

    @property
    def posterior(self) -> dict[str, float]:
        """Probability of each learnt object; they and `unknown` sum to 1."""
        names = self._model.classes.tolist()
        logs = self.log_posterior + self._log_known_and_unknown()[0]
        return dict(zip(names, self._shares(logs), strict=True))

    def _shares(self, logs: Floats) -> list[float]:
        """Return probabilities by their logarithms; never 0 unless the floor is."""
        least = _strangers.LEAST_LOG if self._model.floor else -np.inf
        return list(np.exp(np.maximum(logs, least)).tolist())

    @property
    def best(self) -> str:
        """The most probable learnt object; ties go to the first in sorted order."""
        return str(self._model.classes[self.log_posterior.argmax()])

    @property
    def doubt(self) -> float:
        """Probability outside `best`, `unknown` with it; exact near 0."""
        log_known, log_unknown = self._log_known_and_unknown()
        known_doubt = float(_evidence.doubts(self.log_posterior))
        return float(np.exp(log_known) * known_doubt + np.exp(log_unknown))

    @staticmethod
    def doubt_and_unknown(
        log_posterior: Floats, unknown_evidence: Floats, strangers: float
    ) -> tuple[Floats, Floats]:
        """Return `doubt` and `unknown` of many beliefs at once, shape (...,) each."""
        shares = _strangers.stranger_log_shares(unknown_evidence, strangers)
        of_learnt, unknown = map(np.exp, shares)
        return of_learnt * _evidence.doubts(log_posterior) + unknown, unknown

    @property
    def unknown(self) -> float:
        """Probability that it is none of the learnt objects.

        Before the first touch the share of strangers that is expected; 0 in a closed
        world.
        """
        return float(np.exp(self._log_known_and_unknown()[1]))

    @property
    def unknown_evidence(self) -> float:
        """What the touches say for a stranger and against all learnt objects (nats).

        The logarithm of how much oftener strangers come to such touches; it does not
        depend on the share of strangers that is expected. 0 before any touch said
        something.
        """
        if not self._n_informative:
            return 0.0
        count = np.asarray(self._n_informative)
        best = np.asarray(self.log_posterior.argmax())
        model, lowest = self._model.strangers, self._lowest[best]
        return float(model.evidence(lowest, self._score, best, count))

    def _log_known_and_unknown(self) -> tuple[float, float]:
        """Return the log probabilities of any learnt object, and of none."""
        if self._log_shares is None:
            evidence = np.asarray(self.unknown_evidence)
            logs = _strangers.stranger_log_shares(evidence, self.strangers)
            self._log_shares = float(logs[0]), float(logs[1])
        return self._log_shares

    @property
    def categories(self) -> dict[str, float]:
        """Probability of each category; empty where the objects have none.

        Objects without a category count as one each, or with the category that is
        called as they are. What is missing to 1 is the probability of none of these.
        """
        codes = _strangers.category_codes(self._model.categories)
        if codes is None:
            return {}
        names = np.where(
            self._model.categories == "", self._model.classes, self._model.categories
        )
        present, first = np.unique(codes, return_index=True)
        logs = _strangers.summed_by_category(self.log_posterior, codes, present)
        evidence = np.zeros(())
        if self._n_informative:
            alone = _strangers.summed_by_category(self._alone, codes, present)
            model, count = self._model.strangers, np.asarray(self._n_informative)
            score = model.score(alone, self._farther, count)
            level = _strangers.log_level(score, _evidence.doubts(logs))
            evidence = model.low_category_curve.at(level)
        log_known, _ = _strangers.stranger_log_shares(evidence, self.strangers)
        shares = self._shares(logs + log_known)
        together = dict.fromkeys(names[first].tolist(), 0.0)
        for name, share in zip(names[first].tolist(), shares, strict=True):
            together[name] += share
        return together

    def promise(self, error: float = 0.01) -> Promise:
        """Return what so many objects can show about an accepted error."""
        promise = self._model.strangers.promise(_check_share("error", error))
        return promise._replace(other_session=self._model.other_session)

    @overload
    def decide(
        self,
        error: float = ...,
        costs: Costs | None = ...,
        *,
        refusal: float | None = ...,
        level: Literal["object", "category"] = ...,
    ) -> str | None: ...

    @overload
    def decide(
        self,
        error: float = ...,
        costs: Costs | None = ...,
        *,
        refusal: float | None = ...,
        level: Literal["any"],
    ) -> Named | None: ...

    def decide(
        self,
        error: float = 0.01,
        costs: Costs | None = None,
        *,
        refusal: float | None = None,
        level: Level = "object",
    ) -> str | Named | None:
        """Return the object, "unknown", or None while more touches are needed.

        Parameters
        ----------
        error : float, default=0.01
            Accepted share of wrong names. An object is named when its probability
            (`posterior`) is at least 1 - error.
        costs : mapping of str to mapping of str to float, optional
            `costs[truth][named]`, at least 0: what it costs to take one object for
            another; 1 where not given, and for naming what was never learnt. The
            object of least expected cost is named, once that cost is at most `error`.
            Not for level "category".
        refusal : float, optional
            "unknown" is said when its probability is at least 1 - refusal; `error`
            unless given. For level "category" it is what `categories` lack to 1.
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
            none is known, or with `costs`.
        """
        named = self.named(error, costs, refusal=refusal, level=level)
        return named if named is None or level == "any" else named.name

    def named(
        self,
        error: float = 0.01,
        costs: Costs | None = None,
        *,
        refusal: float | None = None,
        level: Level = "object",
    ) -> Named | None:
        """Return what `decide` does, always with its level; parameters as there."""
        error, refusal = self._checked(error, costs, refusal, level)
        if self.touches_used == 0 and not self._senses:
            return None
        if level != "category" and (name := self._object(error, costs)):
            return Named("object", name)
        if level != "object" and (name := self._category(error)):
            return Named("category", name)
        # Of a new thing of a known category only the object is unknown.
        of_category = level == "category"
        learnt = sum(self.categories.values()) if of_category else 1 - self.unknown
        return Named(UNKNOWN, UNKNOWN) if learnt <= refusal else None

    def _checked(
        self, error: float, costs: Costs | None, refusal: float | None, level: Level
    ) -> tuple[float, float]:
        """Return the accepted shares of what may be named, and of "unknown"."""
        error = _check_share("error", error)
        refusal = error if refusal is None else _check_share("refusal", refusal)
        check_option("level", level, LEVELS)
        if level == "category" and not self.categories:
            raise ValueError(
                "level must be 'object' or 'any', got 'category' and the objects have "
                "none. Learn from touches with a column 'category'."
            )
        if costs is not None:
            if level == "category":
                raise ValueError(
                    "costs must be left out where level is 'category', got "
                    f"{costs!r}: they are of objects."
                )
            self._cost_table(costs)
        return error, refusal

    def _object(self, error: float, costs: Costs | None) -> str | None:
        """Return the object that may be named at an error, or None."""
        if costs is None:
            return self.best if self.doubt <= error else None
        log_known, log_unknown = self._log_known_and_unknown()
        of_learnt = np.exp(self.log_posterior + log_known) @ self._cost_table(costs)
        expected = of_learnt + np.exp(log_unknown)
        affordable = expected.min() <= error
        return str(self._model.classes[expected.argmin()]) if affordable else None

    def _category(self, error: float) -> str | None:
        """Return the category that may be named at an error, or None."""
        shares = self.categories
        best = max(shares, key=lambda name: shares[name], default=None)
        return best if best is not None and 1 - shares[best] <= error else None

    def _cost_table(self, costs: Costs) -> Floats:
        """Return what naming each object (columns) costs, by the truth (rows)."""
        names = self._model.classes.tolist()
        table = 1.0 - np.eye(len(names))
        if not isinstance(costs, Mapping):
            raise TypeError(
                "costs must be a mapping {object: {named: cost}}, got "
                f"{type(costs).__name__}."
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
        level: Level = "object",
    ) -> str:
        """Return one sentence: what `decide` answers, or what it may be.

        The same words stand on the page, in reports and in the terminal.
        """
        accepted: Any = {"error": error, "refusal": refusal, "level": level}
        n_counted = sum(map(is_counted, self.flags))
        named = self.named(costs=costs, **accepted)
        return self._sentence_on(named, n_counted, costs=costs, **accepted)

    def _sentence_on(self, named: Named | None, n_touches: int, **accepted: Any) -> str:
        """Return the sentence on a decision after so many touches that count."""
        shares = self.posterior, self.unknown
        if named is not None:
            decision = *named, self.probability(named)
            return sentence_of(*shares, n_touches, decision)
        is_stuck = self.is_stuck(**accepted)
        return sentence_of(*shares, n_touches, None, is_stuck=is_stuck)

    def is_stuck(
        self,
        error: float = 0.01,
        costs: Costs | None = None,
        *,
        refusal: float | None = None,
        level: Level = "object",
    ) -> bool:
        """Return whether a thousand times the touches so far would not decide.

        Parameters are those of `decide`. Where training touches left out are not told
        apart, the sequence calibration says that all touches of an episode are worth
        about one, or each says next to nothing: the belief then stays where it is,
        however many follow. False before there are as many touches as an object was
        taught with on average, 20 at most. Up to 20 touches, the longest episode that
        was learnt from, it is also False where more of them may double what they told
        and tell the learnt objects apart: what is in doubt is then only a stranger.
        """
        self._checked(error, costs, refusal, level)
        per_object = len(self._model.memory) / len(self._model.classes)
        n_touches = self._n_informative
        if n_touches < min(_ENOUGH, per_object):
            return False
        later = copy(self)
        later._n_informative *= _MANY_TIMES
        later._total = _MANY_TIMES * self._total
        later._each = _MANY_TIMES * self._each
        later._distance = _MANY_TIMES * self._distance
        later._weigh()
        if later.named(error, costs, refusal=refusal, level=level) is not None:
            return False
        weight = self._model.sequence_calibration.weight
        growth = _MANY_TIMES * weight(later._n_informative) / weight(n_touches)
        doubt = _evidence.doubts(later.log_posterior)
        return bool(n_touches >= _ENOUGH or growth <= 2 or doubt > error)

    def probability(self, decision: Named) -> float:
        """Return the probability of what was decided."""
        if decision.level == UNKNOWN:
            return self.unknown
        shares = self.posterior if decision.level == "object" else self.categories
        return shares[decision.name]

    def why(self, error: float = 0.01) -> list[str]:
        """Return the figures behind `reason`, a sentence each."""
        nats, expected = self.unknown_evidence, self.strangers
        order = np.argsort(-self.log_posterior, kind="stable")
        best, rival = self._model.classes[order[:2]].tolist()
        leaders = (
            f"{best} has probability {share_of(self.posterior[best])}, {rival} "
            f"{share_of(self.posterior[rival])}; {share_of(1 - error)} was asked for."
        )
        stranger = (
            f"Nothing that was learnt: {share_of(self.unknown)}. A share of "
            f"{expected:g} strangers was expected, and the touches speak "
            f"{'for' if nats > 0 else 'against'} one by {abs(nats):.1f} nats."
        )
        if not expected:
            stranger = "A closed world was asked for: it is one of those learnt."
        promise = self.promise(error)
        sentences = [leaders, stranger, str(promise._replace(other_session=False))]
        if promise.other_session:
            sentences.append(OTHER_SESSION)
        n_silent = self.touches_used - self._n_informative
        if n_silent:
            sentences.append(f"{n_touches_of(n_silent)} said nothing.")
        return sentences

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
        check_count("n_touches", n_touches, at_least=0)
        check_count("n_nearest", n_nearest, at_least=0)
        if not self._floored:
            return []
        order = np.argsort(-self._touch_log_posterior, kind="stable")
        best, rival = map(int, order[:2])
        floored, names = np.stack(self._floored), self._model.classes
        weight = float(self._model.sequence_calibration.weight(self._n_informative))
        nats = weight * (floored[:, best] - floored[:, rival])
        moved = np.argsort(-np.abs(nats), kind="stable")[:n_touches]
        features = np.stack(self._features)[moved]
        nearest = self._model.memory.most_like(features, n_nearest)
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

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw a bar for each of the ten most probable objects and one for none.

        Returns matplotlib's axes (extra `plot`), `ax` or new ones.
        """
        return draw_belief(self._most_probable(), self.unknown, self.reason(), ax)

    def _most_probable(self) -> dict[str, float]:
        shares = self.posterior
        ranked = sorted(shares, key=lambda name: -shares[name])[:_BARS]
        return {name: shares[name] for name in ranked}

    def __repr__(self) -> str:
        named = [
            f"{n if len(n) <= _LETTERS else f'{n[: _LETTERS - 3]}...'} {p:.2f}"
            for n, p in [*self._most_probable().items()][:3]
        ]
        listed = ", ".join([*named, f"unknown {self.unknown:.2f}"])
        after = n_touches_of(self.touches_used)
        return f"<{type(self).__name__} after {after}: {listed}>"

    def _repr_html_(self) -> str:
        """Return bars of the ten most probable objects and of none, for notebooks."""
        shares = self._most_probable()
        n_more = len(self._model.classes) - len(shares)
        return belief_in_html(shares, self.unknown, n_more, self.reason())


def _check_share(name: str, share: object) -> float:
    return check_number(name, share, low=1e-6, high=0.5)
