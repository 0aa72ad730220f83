"""One episode: the touches of one object, what each told, and what is decided."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from .._numbers import share_of
from .._types import Array
from ..touches import Touches
from ._belief import Belief, Level, Named
from ._evidence import Evidence
from ._memory import UNKNOWN
from ._sentences import NOTHING, draw_episode, is_counted, touch_note

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class EpisodeTouch:
    """A touch of an episode and the belief after it.

    Attributes
    ----------
    touch : int
        Its number, from 1.
    posterior : dict of str to float
        Probability of each learnt object after it.
    unknown : float
        Probability of none of them; 1 in all.
    categories : dict of str to float
        Probability of each category, empty where the objects have none.
    flag : str
        What is wrong with it, such as "no contact"; "" for most.
    """

    touch: int
    posterior: dict[str, float]
    unknown: float
    categories: dict[str, float]
    flag: str

    @property
    def note(self) -> str:
        """The sentence about what is wrong with it, "" for most."""
        return touch_note(self.touch, self.flag)


class Episode:
    """The touches of one object, from the first to the decision and beyond.

    A decision stays: touches after it are taken in, and it is withdrawn only when what
    was named has become as improbable as anything else had to be: at most `error` (of
    "unknown": `refusal`).

    Parameters
    ----------
    belief : Belief
        Before its first touch, from `start` of `ObjectRecogniser`, `TouchMap` or
        `SurfaceMap`.
    error, refusal, level
        As for `Belief.decide`, asked after every touch.

    Attributes
    ----------
    belief : Belief
        After the touches so far.
    touches : list of EpisodeTouch
        All of them, in order.
    decided_at : int or None
        Number of the touch after which that was decided.
    withdrawn : list of str
        A sentence for each decision that was withdrawn.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate import ObjectRecogniser, Touches
    >>> images = np.random.default_rng(0).random((40, 3, 24))
    >>> images[:20] += 1
    >>> touches = Touches(images, object=["pen"] * 20 + ["mug"] * 20, geometry="none")
    >>> episode = ObjectRecogniser().fit(touches).episode(strangers=0)
    >>> episode.add(touches[:2])
    'pen, over 99.9 % after 2 touches'
    """

    def __init__(
        self,
        belief: Belief,
        *,
        error: float = 0.01,
        refusal: float | None = None,
        level: Level = "object",
    ) -> None:
        self.belief, self.error, self.refusal = belief, error, refusal
        self._level: Level = level
        self.touches: list[EpisodeTouch] = []
        self.withdrawn: list[str] = []
        self.decided_at: int | None = None
        self._named: Named | None = None
        belief.decide(**self._accepted)  # refuses wrong shares now

    def add(self, touch: Touches | Array | Evidence | Any, **options: Any) -> str:
        """Take in one touch, or several in order, and return the sentence now.

        What else the belief's `update` takes may be given: a record of an attempt, or
        `options` such as the evidence of a touch where it is known.

        Raises
        ------
        ValueError
            As `Belief.update` does; the episode is then as it was before that touch.
        """
        if type(self.belief) is Belief and not isinstance(touch, Touches | Evidence):
            touch = self.belief._evidence_of(touch)  # of one image, or of several
        if isinstance(touch, Evidence):
            for number in range(len(touch.flags)):
                self._add(touch.of_touch(number), options)
        elif isinstance(touch, Touches):
            for number in range(len(touch)):
                self._add(touch[number : number + 1], options)
        else:
            self._add(touch, options)
        return self.sentence

    def _add(self, touch: Any, options: dict[str, Any]) -> None:
        belief, n_before = self.belief, self.belief.touches_used
        belief.update(touch, **options)
        self.touches.append(
            EpisodeTouch(
                touch=len(self.touches) + 1,
                posterior=belief.posterior,
                unknown=belief.unknown,
                categories=belief.categories,
                flag=", ".join(filter(None, belief.flags[n_before:])),
            )
        )
        self._decide()

    def _decide(self) -> None:
        """Keep, take or withdraw a decision after a touch."""
        before, now = self._named, self.belief.named(**self._accepted)
        if before is not None and not self._is_over(before):
            # A category may become one object of it; anything else stays as it is.
            if not (before.level == "category" and now and now.level == "object"):
                return
        elif before is not None:
            leader = self._leader(before)
            why = f"{_in_words(leader)} was more probable"
            if leader == before.name:
                why = f"it had {share_of(self.belief.probability(before))} left"
            self.withdrawn.append(
                f"{_in_words(before.name)} was withdrawn after touch "
                f"{len(self.touches)}, when {why}"
            )
        self._named = now
        self.decided_at = len(self.touches) if now is not None else None

    def _is_over(self, named: Named) -> bool:
        """Whether it is as sure now that it is something else as naming it had to be.

        Which of several other things it is need not be sure.
        """
        accepted = self.error
        if named.level == UNKNOWN and self.refusal is not None:
            accepted = self.refusal
        return self.belief.probability(named) <= accepted

    def _leader(self, named: Named) -> str:
        """Return what is most probable now, of categories where one was named."""
        belief = self.belief
        of_categories = named.level == "category"
        shares = belief.categories if of_categories else belief.posterior
        unknown = 1 - sum(shares.values()) if of_categories else belief.unknown
        shares = {**shares, UNKNOWN: unknown}
        return max(shares, key=lambda name: shares[name])

    @property
    def _accepted(self) -> dict[str, Any]:
        """What `Belief.decide` takes."""
        return {"error": self.error, "refusal": self.refusal, "level": self._level}

    @property
    def decision(self) -> str | None:
        """The object or category, "unknown", or None."""
        return None if self._named is None else self._named.name

    @property
    def level(self) -> str | None:
        """What was named: "object", "category", "unknown", or None."""
        return None if self._named is None else self._named.level

    @property
    def touches_used(self) -> int:
        """Touches until the decision; all of them where there is none."""
        return len(self.touches) if self.decided_at is None else self.decided_at

    @property
    def n_counted(self) -> int:
        """How many touches count: all that show contact."""
        return sum(is_counted(touch.flag) for touch in self.touches)

    @property
    def sentence(self) -> str:
        """What is decided, or what it may be, as it is now."""
        named, n_touches = self._named, self.n_counted
        if self.touches and not n_touches:
            return "no contact yet: touch again"
        words = self.belief._sentence_on(named, n_touches, **self._accepted)
        if named is None or not self.in_doubt:
            return words
        leader = _in_words(self._leader(named))
        return f"{words}; {leader} is more probable now: touch again"

    @property
    def in_doubt(self) -> bool:
        """Whether something else is more probable now than what was decided."""
        named = self._named
        return named is not None and self._leader(named) != named.name

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.sentence}>"

    def explain(self) -> dict[str, Any]:
        """Return the figures behind the sentence, and the touches that moved it most.

        `why` are sentences (`Belief.why`), `touches` as of `Belief.explain`.
        """
        return {"why": self.belief.why(self.error), "touches": self.belief.explain()}

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values, ready for JSON."""
        return {
            "beliefs": [asdict(touch) for touch in self.touches],
            "decision": self.decision,
            "level": None if self.level == UNKNOWN else self.level,
            "touches_used": self.touches_used,
            "sentence": self.sentence,
            "reasons": [self.sentence],
            "withdrawn": list(self.withdrawn),
            "error": self.error,
            "refusal": self.error if self.refusal is None else self.refusal,
            "strangers": self.belief.strangers,
        }

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the probability of the leading objects and of none, touch by touch.

        Returns matplotlib's axes (extra `plot`), `ax` or new ones.
        """
        last = self.touches[-1].posterior if self.touches else self.belief.posterior
        leading = sorted(last, key=lambda name: -last[name])[:5]
        shares = {n: [touch.posterior[n] for touch in self.touches] for n in leading}
        unknown = [touch.unknown for touch in self.touches]
        return draw_episode(shares, unknown, 1 - self.error, self.sentence, ax)


def _in_words(name: str) -> str:
    return NOTHING if name == UNKNOWN else name
