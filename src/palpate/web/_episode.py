"""One episode as it goes: touches, the belief after each, decision, report."""

import base64
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from .._types import Array, Floats
from ..recognition import Belief, Evidence, ObjectRecogniser
from ..touches import Touches
from ._images import thumbnail

_SHOWN, _NEAREST = 5, 6
_PAGE = Path(__file__).parent / "static" / "report.html"


@dataclass(eq=False)
class LiveTouch:
    """A touch of the episode and what was believed after it.

    `posterior` is empty and `unknown` None where there is no model; `limit` is the
    unknown score above which the object counts as unknown.
    """

    number: int
    time_s: float
    posterior: dict[str, float] = field(default_factory=dict)
    unknown: float | None = None
    limit: float | None = None
    latency_ms: float | None = None


class Neighbours:
    """Nearest learnt touches, each feature measured in its own spread.

    `stored_ids` are those of the touches in the library at hand.
    """

    def __init__(self, recogniser: ObjectRecogniser, stored_ids: set[str]) -> None:
        memory = recogniser.memory_
        spread = memory.features.std(axis=0)
        self._scale = np.where(spread > 0, spread, 1.0)
        self._features = memory.features / self._scale
        self._labels = memory.labels
        ids = memory.touch_ids.tolist()
        self._ids = [key if key in stored_ids else None for key in ids]

    def of(self, features: Floats) -> list[dict[str, Any]]:
        """Return the nearest touches of features (1, n_features), nearest first.

        `id` is None where the touch is not in the library.
        """
        apart = self._features - features / self._scale
        distance = np.sqrt(np.mean(apart**2, axis=1))
        some = np.argsort(distance, kind="stable")[:_NEAREST].tolist()
        far, ids, labels = distance.tolist(), self._ids, self._labels
        return [
            {"id": ids[row], "object": str(labels[row]), "distance": far[row]}
            for row in some
        ]


class LiveEpisode:
    """Touches of one object, from the first to the decision and beyond.

    Without a recogniser touches are collected without a belief; `neighbours` finds
    the learnt touches most similar to the last one, `nearest`. `accepted` are the
    shares of errors, as `Belief.decide` takes them.
    """

    def __init__(
        self,
        number: int,
        recogniser: ObjectRecogniser | None,
        accepted: dict[str, Any],
        neighbours: Neighbours | None = None,
    ) -> None:
        self.number, self.accepted = number, accepted
        self.recogniser, self.neighbours = recogniser, neighbours
        self.nearest: list[dict[str, Any]] = []
        self.belief: Belief | None = None if recogniser is None else recogniser.start()
        self.touches: list[LiveTouch] = []
        self.images: list[Array] = []
        self.channels: Sequence[str] | None = None
        self.open = True
        self.evidence: Evidence | None = None  # of the last touch

    def add(self, image: Array, channels: Sequence[str] | None) -> LiveTouch:
        """Take in a touch and return it; one that is refused changes nothing."""
        self.channels = channels
        touch = LiveTouch(len(self.touches) + 1, time.time())
        if self.recogniser is not None and self.belief is not None:
            touches = Touches(image[np.newaxis], channels=channels)
            evidence = self.recogniser.evidence(touches)
            self.belief.update(evidence)
            self.evidence = evidence
            touch.posterior = self.belief.posterior
            touch.unknown = self.belief.unknown
            touch.limit = self.belief.unknown_limit(self.accepted["refusal"])
            if self.neighbours is not None:
                self.nearest = self.neighbours.of(evidence.features)
        self.images.append(image)  # first, for those who read meanwhile
        self.touches.append(touch)
        return touch

    @property
    def decision(self) -> str | None:
        """The object, "unknown", or None, as the belief is now."""
        return None if self.belief is None else self.belief.decide(**self.accepted)

    @property
    def category(self) -> str | None:
        """The category where only that is sure, or None."""
        if self.belief is None or not self.touches or not self.belief.categories:
            return None
        named = self.belief.decide(**self.accepted, level="any")
        return named.name if named is not None and named.level == "category" else None

    @property
    def reason(self) -> str:
        if self.belief is None:
            return "Nothing is learnt yet: teach two objects, then learn."
        if not self.touches:
            return "No touch yet."
        return self.belief.reason(**self.accepted)

    def to_dict(self) -> dict[str, Any]:
        return {
            "number": self.number,
            "open": self.open,
            **self.accepted,
            "decision": self.decision,
            "category": self.category,
            "promise": self.belief.promise._asdict() if self.belief else None,
            "best": None if not self.touches or not self.belief else self.belief.best,
            "reason": self.reason,
            "touches": [dict(vars(touch)) for touch in self.touches],
        }

    def as_touches(self) -> Touches:
        if not self.touches:
            raise ValueError("The episode has no touch yet; touch something first.")
        times = np.array([touch.time_s for touch in self.touches])
        episode = np.full(len(times), self.number)
        images = np.stack(self.images[: len(times)])
        about = {"time_s": times, "episode": episode}
        return Touches(images, **about, channels=self.channels)


def episode_report(episode: LiveEpisode) -> str:
    """Return one HTML page: the decision, and every touch with the belief after it.

    Nothing is loaded from elsewhere when it is looked at.
    """
    if not episode.touches:
        raise ValueError("The episode has no touch yet; touch something first.")
    began = time.localtime(episode.touches[0].time_s)
    pictures = (thumbnail(image, episode.channels) for image in episode.images)
    return Template(_PAGE.read_text(encoding="utf-8")).substitute(
        number=episode.number,
        decision=escape(episode.decision or "undecided"),
        reason=escape(episode.reason),
        when=time.strftime("%Y-%m-%d %H:%M", began),
        count=len(episode.touches),
        error=f"{episode.accepted['error']:.1%}",
        items="".join(map(_item, episode.touches, pictures)),
    )


def _item(touch: LiveTouch, png: bytes) -> str:
    picture = base64.b64encode(png).decode()
    shown = sorted(touch.posterior.items(), key=lambda item: -item[1])[:_SHOWN]
    rows = "".join(
        f"<tr><th scope=row>{escape(name)}<div class=track><div class=bar "
        f"style='width:{share:.1%}'></div></div></th><td>{share:.1%}</td></tr>"
        for name, share in shown
    )
    unknown = ""
    if touch.unknown is not None and touch.limit is not None:
        unknown = (
            f"<p class=note>Unknown score {touch.unknown:.3f}; unknown above "
            f"{touch.limit:.3f}.</p>"
        )
    return (
        f"<li><img alt='touch {touch.number}' src='data:image/png;base64,{picture}'>"
        f"<div><b>Touch {touch.number}</b><table>{rows}</table>{unknown}</div></li>"
    )
