"""One episode as it goes: touches, the belief after each, decision, report."""

import base64
import time
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np

from .._types import Array, Floats
from ..recognition import Belief, ObjectRecogniser
from ..touches import Touches
from ._images import thumbnail

_SHOWN = 5
_STYLE = """
:root{color-scheme:light dark;--line:#d5dbe1;--soft:#5a6572;--bar:#2f6f8f}
@media(prefers-color-scheme:dark){:root{--line:#39424c;--soft:#a3afbb;--bar:#6fb7d6}}
body{font:16px/1.5 system-ui,sans-serif;max-width:56rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem}h1,p,th{overflow-wrap:anywhere}.note{color:var(--soft)}
ol{list-style:none;padding:0}
li{display:grid;grid-template-columns:104px minmax(0,1fr);gap:1rem;align-items:center;
border-top:1px solid var(--line);padding:.8rem 0}
img{width:96px;border-radius:6px}
table{border-collapse:collapse;width:100%;table-layout:fixed}
th,td{text-align:left;padding:.1rem .5rem 0 0;
font-weight:400}td:last-child{text-align:right;width:4rem}
.track{background:var(--line);border-radius:4px;height:.6rem}
.bar{background:var(--bar);border-radius:4px;height:.6rem}
"""


@dataclass(eq=False)
class LiveTouch:
    """A touch of the episode and what was believed after it.

    `posterior` is empty and `unknown` None where there is no model; `limit` is the
    unknown score above which the object counts as unknown.
    """

    number: int
    image: Array
    time_s: float
    posterior: dict[str, float] = field(default_factory=dict)
    unknown: float | None = None
    limit: float | None = None
    latency_ms: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values, without the image."""
        return {
            "number": self.number,
            "time_s": self.time_s,
            "posterior": self.posterior,
            "unknown": self.unknown,
            "limit": self.limit,
            "latency_ms": self.latency_ms,
        }


class LiveEpisode:
    """Touches of one object, from the first to the decision and beyond.

    Parameters
    ----------
    number : int
        Its number in this session, from 1.
    recogniser : ObjectRecogniser or None
        What recognises; None collects touches without a belief.
    error : float
        Accepted share of wrong decisions.
    """

    def __init__(
        self, number: int, recogniser: ObjectRecogniser | None, error: float
    ) -> None:
        self.number, self.error = number, error
        self.recogniser = recogniser
        self.belief: Belief | None = None if recogniser is None else recogniser.start()
        self.touches: list[LiveTouch] = []
        self.open = True

    def add(self, image: Array) -> tuple[LiveTouch, Floats | None]:
        """Take in a touch; return it and its features, None without a model.

        Raises
        ------
        ValueError
            The recogniser cannot take this image; the episode is unchanged.
        """
        touch = LiveTouch(len(self.touches) + 1, image, time.time())
        features = None
        if self.recogniser is not None and self.belief is not None:
            one = Touches(image[np.newaxis])
            evidence = self.recogniser.evidence(one)
            features = evidence.features
            self.belief.update(evidence)
            touch.posterior = self.belief.posterior
            touch.unknown = self.belief.unknown
            touch.limit = self.belief.unknown_limit(self.error)
        self.touches.append(touch)
        return touch, features

    @property
    def decision(self) -> str | None:
        """The object, "unknown", or None, as the belief is now."""
        return None if self.belief is None else self.belief.decide(self.error)

    @property
    def reason(self) -> str:
        """One sentence that says why."""
        if self.belief is None:
            return "Nothing is learnt yet: teach two objects, then learn."
        if not self.touches:
            return "No touch yet."
        return self.belief.reason(self.error)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values, without images."""
        return {
            "number": self.number,
            "open": self.open,
            "error": self.error,
            "decision": self.decision,
            "best": None if not self.touches or not self.belief else self.belief.best,
            "reason": self.reason,
            "touches": [touch.to_dict() for touch in self.touches],
        }

    def as_touches(self) -> Touches:
        """Return the touches of the episode, with their times.

        Raises
        ------
        ValueError
            There is none yet.
        """
        if not self.touches:
            raise ValueError("The episode has no touch yet; touch something first.")
        times = np.array([touch.time_s for touch in self.touches])
        episode = np.full(len(times), self.number)
        images = np.stack([touch.image for touch in self.touches])
        return Touches(images, time_s=times, episode=episode)


def episode_report(episode: LiveEpisode) -> str:
    """Return one HTML page: the decision, and every touch with the belief after it.

    Nothing is loaded from elsewhere when it is looked at.

    Raises
    ------
    ValueError
        The episode has no touch yet.
    """
    if not episode.touches:
        raise ValueError("The episode has no touch yet; touch something first.")
    when = time.strftime("%Y-%m-%d %H:%M", time.localtime(episode.touches[0].time_s))
    decided = episode.decision or "undecided"
    items = "".join(_item(touch) for touch in episode.touches)
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width,initial-scale=1'>"
        f"<title>Episode {episode.number}: {escape(decided)}</title>"
        f"<style>{_STYLE}</style><body>"
        f"<h1>Episode {episode.number}: {escape(decided)}</h1>"
        f"<p>{escape(episode.reason)}</p>"
        f"<p class=note>{when}, {len(episode.touches)} touches. At most "
        f"{episode.error:.1%} of decisions should be wrong.</p>"
        f"<ol>{items}</ol></body></html>"
    )


def _item(touch: LiveTouch) -> str:
    picture = base64.b64encode(thumbnail(touch.image)).decode()
    shown = sorted(touch.posterior.items(), key=lambda item: -item[1])[:_SHOWN]
    rows = "".join(_row(name, share) for name, share in shown)
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


def _row(name: str, share: float) -> str:
    width = f"{100 * share:.1f}%"
    return (
        f"<tr><th scope=row>{escape(name)}<div class=track>"
        f"<div class=bar style='width:{width}'></div></div></th>"
        f"<td>{width}</td></tr>"
    )
