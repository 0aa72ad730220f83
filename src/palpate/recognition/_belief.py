"""The current belief over objects, and what to make of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_softmax

from .._checks import check_number, check_option
from ..touches import Touches
from ._explanation import explanation
from ._sequence import (
    Evidence,
    Floats,
    doubts,
    log_posteriors,
    n_informative,
    with_floor,
)

if TYPE_CHECKING:
    from ._recogniser import ObjectRecogniser

Costs = Mapping[str, Mapping[str, float]]


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
    """

    def __init__(
        self, recogniser: ObjectRecogniser, log_prior: Floats | None = None
    ) -> None:
        self._recogniser = recogniser
        self._log_prior = recogniser.log_prior() if log_prior is None else log_prior
        self._floored = np.empty((0, len(recogniser.classes_)))
        self._features = np.empty((0, recogniser.features_.shape[1]))
        self._novelty = np.empty(0)
        self._senses: dict[str, Floats] = {}
        self._log_posterior = self._log_prior
        self._unknown: float | None = None
        self.flags: list[str] = []

    def update(self, touch: Touches | NDArray | Evidence) -> Belief:
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
        if not isinstance(touch, Evidence):
            touch = self._recogniser.evidence(as_touches(touch))
        given = touch._asdict()
        return self.update_from_log_likelihood(given.pop("log_likelihood"), **given)

    def update_from_log_likelihood(
        self,
        log_likelihood: NDArray,
        *,
        features: NDArray | None = None,
        flags: list[str] | None = None,
        novelty: NDArray | None = None,
    ) -> Belief:
        """Take in touches by their log-likelihoods, shape (n_touches, n_objects).

        With `features` (n_touches, n_features) they can be explained later; `flags` and
        `novelty` (n_touches,) are as in `ObjectRecogniser.evidence`.
        """
        rows = _checked_rows(log_likelihood, len(self._recogniser.classes_))
        floored = with_floor(rows, self._recogniser.floor_)
        n_touches = len(floored)
        if features is None:
            features = np.full((n_touches, self._features.shape[1]), np.nan)
        if novelty is None:
            novelty = np.full(n_touches, np.nan)
        self._novelty = np.concatenate([self._novelty, np.atleast_1d(novelty)])
        self._floored = np.vstack([self._floored, floored])
        self._features = np.vstack([self._features, np.atleast_2d(features)])
        self.flags += flags or [""] * n_touches
        self._weigh()
        return self

    def update_sense(self, name: str, X: ArrayLike) -> Belief:
        """Take in what another sense tells of the same object.

        Parameters
        ----------
        name : str
            A modality that the recogniser has learnt, see `learn_modality`.
        X : array-like of shape (n_features,) or (n_examples, n_features)
            One example or several.
        """
        senses = self._recogniser.modalities_
        if not senses:
            raise ValueError(
                f"name must be a sense that was learnt, got {name!r} and none is. Call "
                "learn_modality first."
            )
        check_option("name", name, senses)
        classes = self._recogniser.classes_
        rows = senses[name].log_likelihood(np.atleast_2d(np.asarray(X)), classes)
        before = self._senses.get(name, np.empty((0, len(classes))))
        self._senses[name] = np.vstack([before, rows])
        self._weigh()
        return self

    def _weigh(self) -> None:
        """Add up the prior, the other senses and the touches."""
        total = self._log_prior
        for name, rows in self._senses.items():
            trust = self._recogniser.modalities_[name].sequence_calibration_
            total = total + rows.sum(axis=0) * trust.weight(len(rows))
        if len(self._floored):
            trust = self._recogniser.sequence_calibration_
            total = log_posteriors(self._floored, total, trust)[-1]
        self._log_posterior = log_softmax(total)
        self._unknown = None

    @property
    def touches_used(self) -> int:
        """Number of touches that entered so far."""
        return len(self._floored)

    @property
    def posterior(self) -> dict[str, float]:
        """Probability of each known object."""
        probabilities = np.exp(self._log_posterior)
        names = map(str, self._recogniser.classes_)
        return dict(zip(names, map(float, probabilities), strict=True))

    @property
    def best(self) -> str:
        """The most probable object; ties go to the first in sorted order."""
        return str(self._recogniser.classes_[self._log_posterior.argmax()])

    @property
    def doubt(self) -> float:
        """Probability outside `best`."""
        return float(doubts(self._log_posterior))

    @property
    def unknown(self) -> float:
        """How little the touches look like any known object; see `UnknownScale`."""
        if not len(self._floored):
            return 0.0
        if self._unknown is None:
            beliefs = np.broadcast_to(self._log_posterior, self._floored.shape)
            scores = self._recogniser.unknown_scale_.scores
            self._unknown = float(scores(beliefs, self._floored, self._novelty)[-1])
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
        expected = np.exp(self._log_posterior) @ self._cost_table(costs)
        affordable = expected.min() <= error
        return str(self._recogniser.classes_[expected.argmin()]) if affordable else None

    def looks_known(self) -> bool:
        """Whether the touches fit a known object as four in five known episodes do."""
        scale = self._recogniser.unknown_scale_
        return self.unknown <= scale.naming_threshold(self._n_informative)

    def unknown_limit(self, error: float = 0.01) -> float | None:
        """Return the unknown score above which `decide(error)` says "unknown".

        None before any touch said something.
        """
        count = self._n_informative
        return self._recogniser.refusal_threshold(count, error) if count else None

    @property
    def _n_informative(self) -> int:
        """Number of touches that said anything."""
        return int(n_informative(self._floored)[-1]) if len(self._floored) else 0

    def _cost_table(self, costs: Costs) -> Floats:
        names = [str(name) for name in self._recogniser.classes_]
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
        sure = f"{self.best} has probability {1 - self.doubt:.4f} after {touches}"
        if decision is None and not self.looks_known():
            return (
                f"Undecided: {sure}, but four in five known episodes fit better "
                f"(unknown score {self.unknown:.3f}). Touch again."
            )
        if costs is not None and decision != "unknown":
            expected = np.exp(self._log_posterior) @ self._cost_table(costs)
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
        return explanation(
            self._recogniser,
            self._floored,
            self._features,
            self._log_posterior,
            self.flags,
            (n_touches, n_nearest),
        )

    def __repr__(self) -> str:
        order = np.argsort(self._log_posterior)[::-1][:3]
        names = self._recogniser.classes_[order]
        shares = np.exp(self._log_posterior[order])
        listed = ", ".join(f"{n} {p:.2f}" for n, p in zip(names, shares, strict=True))
        return f"<Belief after {self.touches_used} touches: {listed}>"


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


def as_touches(touch: Touches | NDArray) -> Touches:
    """Return one image or a set of touches as `Touches`, or explain."""
    if isinstance(touch, Touches):
        return touch
    image = np.asarray(touch)
    if image.ndim != 2:
        raise ValueError(
            "touch must be Touches or one image (n_rows, n_cols), "
            f"got an array of shape {image.shape}."
        )
    return Touches(image[np.newaxis])
