"""One episode as it goes: touches, the belief after each, decision, report."""

import base64
import time
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from .._types import Array
from ..recognition import (
    Belief,
    Episode,
    Evidence,
    ObjectRecogniser,
    nearest_touches,
)
from ..touches import Touches
from ._images import thumbnail

Vector = tuple[float, float, float]
_SHOWN, _NEAREST = 5, 6
_PAGE = Path(__file__).parent / "static" / "report.html"


@dataclass(eq=False)
class LiveTouch:
    """A touch of the episode and what was believed after it.

    `posterior` is empty and `unknown` None where there is no model; `note` is what is
    wrong with the touch, "" for most; `device_time_s` when the device took it.
    `position_mm` is where the tip was, and `direction` the unit vector of its approach,
    both from where the middle of the object is assumed; None where they are not known.
    """

    number: int
    time_s: float
    posterior: dict[str, float] = field(default_factory=dict)
    unknown: float | None = None
    note: str = ""
    latency_ms: float | None = None
    device_time_s: float | None = None
    position_mm: Vector | None = None
    direction: Vector | None = None

    @property
    def place(self) -> dict[str, Vector]:
        """Where it was made, by name; empty where that is not known."""
        if self.position_mm is None or self.direction is None:
            return {}
        return {"position_mm": self.position_mm, "direction": self.direction}


class LiveEpisode:
    """Touches of one object, from the first to the decision and beyond.

    Without a recogniser touches are only kept. `nearest` holds the learnt touches most
    similar to the last one; `id` is None where one is not among `stored_ids`, those in
    the library at hand. `accepted` is what `ObjectRecogniser.episode` takes.
    """

    def __init__(
        self,
        number: int,
        recogniser: ObjectRecogniser | None,
        accepted: dict[str, Any],
        stored_ids: Set[str] = frozenset(),
    ) -> None:
        self.number, self.accepted = number, accepted
        self.recogniser, self._stored_ids = recogniser, stored_ids
        self.nearest: list[dict[str, Any]] = []
        self.episode: Episode | None = None
        if recogniser is not None:
            self.episode = recogniser.episode(**accepted, level="any")
        self.touches: list[LiveTouch] = []
        self.images: list[Array] = []
        self.channels: Sequence[str] | None = None
        self.open = True
        self.evidence: Evidence | None = None  # of the last touch

    def add(
        self,
        image: Array,
        channels: Sequence[str] | None,
        place: Mapping[str, Vector] | None = None,
    ) -> LiveTouch:
        """Take in a touch and return it; one that is refused changes nothing.

        `place` holds its `position_mm` and `direction`, where they are known.
        """
        self.channels = channels
        touch = LiveTouch(len(self.touches) + 1, time.time())
        if place:
            touch.position_mm, touch.direction = (
                place["position_mm"],
                place["direction"],
            )
        if self.recogniser is not None and self.episode is not None:
            touches = Touches(image[np.newaxis], channels=channels)
            evidence = self.recogniser.evidence(touches)
            self.episode.add(evidence)
            self.evidence, last = evidence, self.episode.touches[-1]
            touch.posterior, touch.unknown = last.posterior, last.unknown
            touch.note = last.note
            self.nearest = self._nearest(self.recogniser, evidence)
        self.images.append(image)  # first, for those who read meanwhile
        self.touches.append(touch)
        return touch

    def _nearest(
        self, recogniser: ObjectRecogniser, evidence: Evidence
    ) -> list[dict[str, Any]]:
        memory = recogniser.memory_
        (near,) = nearest_touches(memory, evidence.features, _NEAREST)
        ids = [str(memory.touch_ids[near_touch["row"]]) for near_touch in near]
        return [
            {
                "id": key if key in self._stored_ids else None,
                "object": near_touch["object"],
                "distance": near_touch["distance"],
            }
            for key, near_touch in zip(ids, near, strict=True)
        ]

    @property
    def belief(self) -> Belief | None:
        """The belief after the touches so far, None without a recogniser."""
        return None if self.episode is None else self.episode.belief

    @property
    def decision(self) -> str | None:
        """The object, "unknown", or None."""
        episode = self.episode
        return None if episode is None or self.category else episode.decision

    @property
    def category(self) -> str | None:
        """The category where only that is sure, or None."""
        episode = self.episode
        is_one = episode is not None and episode.level == "category"
        return episode.decision if is_one and episode is not None else None

    @property
    def sentence(self) -> str:
        """What is decided, or what it may be."""
        if self.episode is None:
            return "nothing is learnt yet: teach two objects, then learn"
        return self.episode.sentence

    def to_dict(self) -> dict[str, Any]:
        episode = self.episode
        return {
            "number": self.number,
            "open": self.open,
            **self.accepted,
            "decision": self.decision,
            "category": self.category,
            "best": episode.belief.best if episode and self.touches else None,
            "sentence": self.sentence,
            "reason": self.sentence,
            "withdrawn": episode.withdrawn if episode else [],
            "why": episode.belief.why(episode.error) if episode else [],
            "touches": [dict(vars(touch)) for touch in self.touches],
        }

    def as_touches(self) -> Touches:
        if not self.touches:
            raise ValueError("The episode has no touch yet; touch something first.")
        times = np.array([touch.time_s for touch in self.touches])
        episode = np.full(len(times), self.number)
        images = np.stack(self.images[: len(times)])
        about: dict[str, Any] = {"time_s": times, "episode": episode}
        if any(touch.position_mm for touch in self.touches):
            nowhere = (np.nan,) * 3
            for name in ("position_mm", "direction"):
                about[name] = [
                    getattr(touch, name) or nowhere for touch in self.touches
                ]
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
        sentence=escape(episode.sentence),
        when=time.strftime("%Y-%m-%d %H:%M", began),
        count=len(episode.touches),
        why="".join(
            f"<li>{escape(reason)}</li>" for reason in episode.to_dict()["why"]
        ),
        items="".join(map(_item, episode.touches, pictures)),
    )


def _item(touch: LiveTouch, png: bytes) -> str:
    picture = base64.b64encode(png).decode()
    shown = sorted(touch.posterior.items(), key=lambda item: -item[1])[:_SHOWN]
    if touch.unknown is not None:
        shown.append(("nothing learnt", touch.unknown))
    rows = "".join(
        f"<tr><th scope=row>{escape(name)}<div class=track><div class=bar "
        f"style='width:{share:.1%}'></div></div></th><td>{share:.1%}</td></tr>"
        for name, share in shown
    )
    note = f"<p class=note>{escape(touch.note)}</p>" if touch.note else ""
    return (
        f"<li><img alt='touch {touch.number}' src='data:image/png;base64,{picture}'>"
        f"<div><b>Touch {touch.number}</b>{note}<table>{rows}</table></div></li>"
    )
