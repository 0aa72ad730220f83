"""One episode as it goes: touches, the belief after each, decision, report, top view.

A model whose touches were taught with their places, as `explore_to_learn` does, tells
more of an episode whose touches have places too: its belief is then by pictures and
places. The map that this needs is learnt when the first touch with a place comes, in a
thread of its own, and never keeps a touch waiting.
"""

import base64
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import asdict, dataclass, field
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from .._numbers import figure_of, share_of
from .._types import Array, Floats
from ..exploration import PlaceBelief, SurfaceMap, TouchRecord
from ..recognition import (
    Belief,
    Episode,
    Evidence,
    ObjectRecogniser,
    touch_note,
)
from ..simulation import SensorPose
from ..touches import Touches
from ._images import thumbnail

Vector = tuple[float, float, float]
_OBJECTS_LISTED, _NEAREST = 5, 6
# Whose places count, of an episode: what every next one costs grows with their cube.
_MOST_PLACED = 100
_NOTHING_MET = "touch {}: nothing met"
_TEACH = "teach two objects, then learn"
_START_AGAIN = "start again with `library=FOLDER` to teach"
_TELLS_NOTHING = _NOTHING_MET + ", which tells nothing without a map of the objects"
# How far back the way of a miss is known to be free.
_FREE_WAY_MM = 300.0
_PAGE = Path(__file__).parent / "static" / "report.html"
LEARNING = "Learning where the objects have their surface; this takes some seconds."
_NO_PLACE = "No touch has a place that counts."
_NO_PLACES = "The model was taught without places, so that these tell nothing."
_TOO_MANY = "The model is of {} touches; where they met something is used up to {}."
_MOST_TOUCHES = 3000
_ELLIPSE = "x_mm", "y_mm", "long_mm", "short_mm", "turn_deg"


@dataclass(eq=False)
class LiveTouch:
    """A touch of the episode and what was believed after it.

    `posterior` is empty and `unknown` None where there is no model; `note` is what is
    wrong with the touch, "" for most; `device_time_s` when the device took it.
    `position_mm` is where the tip was, and `direction` the unit vector of its approach,
    both from where the middle of the object is assumed, `force_n` how hard it was
    pressed; None where they are not known. Of a `miss` the tip went there and met
    nothing, so that there is no picture.
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
    force_n: float | None = None
    miss: bool = False


PLACED = "position_mm", "direction", "force_n"


def place_of(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return of what was measured with a touch its place, if known, and its force."""
    place = {
        name: columns[name]
        for name in PLACED
        if name in columns and np.isfinite(columns[name]).all()
    }
    if not place.keys() >= {"position_mm", "direction"}:
        place = {name: place[name] for name in place if name == "force_n"}
    return place


class LiveEpisode:
    """Touches of one object, from the first to the decision and beyond.

    Without a recogniser touches are only kept. `nearest` holds the learnt touches most
    similar to the last one; `id` is None where one is not among `stored_ids`, those in
    the library at hand. `episode_options` is what `ObjectRecogniser.episode` takes;
    `can_teach` whether there is a library, without which nothing can be taught.
    """

    def __init__(
        self,
        number: int,
        recogniser: ObjectRecogniser | None,
        episode_options: dict[str, Any],
        stored_ids: Set[str] = frozenset(),
        *,
        can_teach: bool = True,
    ) -> None:
        self.number, self.episode_options, self.can_teach = (
            number,
            episode_options,
            can_teach,
        )
        self.recogniser, self._stored_ids = recogniser, stored_ids
        self.nearest: list[dict[str, Any]] = []
        self.episode: Episode | None = None
        if recogniser is not None:
            self.episode = recogniser.episode(**episode_options, level="any")
        self.limits = "" if recogniser is None else recogniser.limits_message()
        self.by_place = False
        self.touches: list[LiveTouch] = []
        self.images: list[Array | None] = []
        self._evidences: list[Evidence | None] = []
        self._columns: list[Mapping[str, Any]] = []
        self.channels: Sequence[str] | None = None
        self.open = True
        self.n_before_baseline = 0  # touches from before it was taken, or undone

    def add(
        self,
        image: Array | None,
        channels: Sequence[str] | None,
        columns: Mapping[str, Any],
        rest: Array | None = None,
    ) -> LiveTouch:
        """Take in a touch and return it; one that is refused changes nothing.

        Without an `image` it is a miss. `columns` holds all that was measured with it;
        `rest` is the frame of no contact of today.
        """
        number, placed = len(self.touches) + 1, place_of(columns)
        touch = LiveTouch(number, time.time(), miss=image is None, **placed)
        evidence = None
        if self.recogniser is not None and image is not None:
            touches = Touches(image[np.newaxis], channels=channels, no_contact=rest)
            evidence = self.recogniser.evidence(touches)
            self.nearest = self._nearest(self.recogniser, evidence)
        if image is not None:
            self.channels = channels
        self._take_in(touch, image, evidence)
        self._evidences.append(evidence)
        self._columns.append(columns)
        self.images.append(image)  # first, for those who read meanwhile
        self.touches.append(touch)
        return touch

    def believe_by_place(self, surface_map: SurfaceMap) -> None:
        """Believe by pictures and places from now on, and anew what was touched."""
        options = dict(self.episode_options)
        belief = surface_map.start(strangers=options.pop("strangers"))
        self.episode, self.by_place = Episode(belief, **options, level="any"), True
        touched = zip(self.touches, self.images, self._evidences, strict=False)
        for touch, image, evidence in touched:
            try:
                self._take_in(touch, image, evidence)
            except ValueError as error:  # of a miss, which has no picture to count
                touch.note = f"touch {touch.number}: it does not count. {error}"

    @property
    def is_placed(self) -> bool:
        """Whether a touch of it has a place."""
        return any(touch.position_mm for touch in self.touches)

    @property
    def evidence(self) -> Evidence | None:
        """What the last touch told, None where that was a miss."""
        return self._evidences[-1] if self._evidences else None

    def _take_in(
        self, touch: LiveTouch, image: Array | None, evidence: Evidence | None
    ) -> None:
        """Update the belief, and keep with the touch what it came to."""
        if self.episode is None:
            return
        touch.note = self._update(self.episode, touch, image, evidence)
        belief = self.episode.belief
        touch.posterior, touch.unknown = belief.posterior, belief.unknown

    def _update(
        self,
        episode: Episode,
        touch: LiveTouch,
        image: Array | None,
        evidence: Evidence | None,
    ) -> str:
        """Update the belief, by a picture alone if its place is refused; return why."""
        trouble = ""
        if image is None:
            if not self.by_place:
                return _TELLS_NOTHING.format(touch.number)
            episode.add(_miss(touch))
            return _NOTHING_MET.format(touch.number)
        if not self.by_place:
            episode.add(evidence)
        else:
            measured = {name: getattr(touch, name) for name in PLACED}
            columns = {name: v for name, v in measured.items() if v is not None}
            if touch.number > _MOST_PLACED:
                columns = {}
            try:
                episode.add(self._placed(image, columns), evidence=evidence)
            except ValueError as error:
                trouble = f"touch {touch.number}: its place does not count. {error}"
                episode.add(self._placed(image, {}), evidence=evidence)
        return trouble or touch_note(touch.number, episode.touches[-1].flag)

    def _placed(self, image: Array, columns: Mapping[str, Any]) -> Touches:
        nowhere = (np.nan,) * 3
        about = {"position_mm": nowhere, "direction": nowhere, **columns}
        rows: dict[str, Any] = {name: [value] for name, value in about.items()}
        return Touches(image[np.newaxis], channels=self.channels, **rows)

    def _nearest(
        self, recogniser: ObjectRecogniser, evidence: Evidence
    ) -> list[dict[str, Any]]:
        memory = recogniser.memory_
        (near,) = memory.most_like(evidence.features, _NEAREST)
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
            next_step = _TEACH if self.can_teach else _START_AGAIN
            return f"nothing is learnt yet: {next_step}"
        by = " (by pictures alone)" if self.is_placed else ""
        return self.episode.sentence + (
            " (by pictures and places)" if self.by_place else by
        )

    def to_dict(self) -> dict[str, Any]:
        episode = self.episode
        return {
            "number": self.number,
            "open": self.open,
            **self.episode_options,
            "decision": self.decision,
            "category": self.category,
            "in_doubt": episode is not None and episode.in_doubt,
            "best": episode.belief.best if episode and self.touches else None,
            "sentence": self.sentence,
            "reason": self.sentence,
            "limits": self.limits,
            "withdrawn": episode.withdrawn if episode else [],
            "why": episode.belief.why(episode.error) if episode else [],
            "n_counted": episode.n_counted if episode else len([*self.pictured()]),
            "touches": [dict(vars(touch)) for touch in self.touches],
        }

    def pictured(self) -> Iterator[tuple[LiveTouch, Array]]:
        """Yield the touches that met something, with their pictures."""
        for touch, image in zip(self.touches, self.images, strict=False):
            if image is not None:
                yield touch, image

    def since_baseline(self) -> list[tuple[Array, Mapping[str, Any]]]:
        """Return pictures, and what was measured with each, since the baseline."""
        rows = [*zip(self.images, self._columns, strict=False)]
        later = rows[self.n_before_baseline :]
        return [(image, columns) for image, columns in later if image is not None]

    def as_touches(
        self, baseline: Array | None = None, geometry: str | None = None
    ) -> Touches:
        """Return the touches that met something, with what was measured with each.

        Those from before the `baseline` was taken are without it, and the others too.
        """
        pictured = list(self.pictured())
        if not pictured:
            raise ValueError(
                "The episode has no touch yet that met something; touch something "
                "first."
            )
        touches = [touch for touch, _ in pictured]
        about: dict[str, Any] = {
            "time_s": [touch.time_s for touch in touches],
            "episode": np.full(len(touches), self.number),
        }
        unknown = {"position_mm": (np.nan,) * 3, "direction": (np.nan,) * 3}
        for name, value in {**unknown, "force_n": np.nan}.items():
            measured = [getattr(touch, name) for touch in touches]
            if any(number is not None for number in measured):
                about[name] = [value if m is None else m for m in measured]
        columns = [self._columns[touch.number - 1] for touch in touches]
        for name in sorted(set.intersection(*map(set, columns)) - {*about, *PLACED}):
            about[name] = [values[name] for values in columns]
        about["no_contact"] = None if self.n_before_baseline else baseline
        images = np.stack([image for _, image in pictured])
        return Touches(images, **about, channels=self.channels, geometry=geometry)


def _miss(touch: LiveTouch) -> TouchRecord:
    """Return the record of an approach that met nothing."""
    assert touch.position_mm is not None
    assert touch.direction is not None
    end = SensorPose(touch.position_mm, touch.direction)
    return TouchRecord(
        "nothing",
        end.advanced(-_FREE_WAY_MM),
        touch.position_mm,
        travel_mm=_FREE_WAY_MM,
    )


def episode_report(episode: LiveEpisode) -> str:
    """Return one HTML page: the decision, and every touch with the belief after it.

    Nothing is loaded from elsewhere when it is looked at.
    """
    if not episode.touches:
        raise ValueError("The episode has no touch yet; touch something first.")
    began = time.localtime(episode.touches[0].time_s)
    pictures = [
        None if image is None else thumbnail(image, episode.channels)
        for image in episode.images[: len(episode.touches)]
    ]
    return Template(_PAGE.read_text(encoding="utf-8")).substitute(
        number=episode.number,
        sentence=escape(episode.sentence),
        limits=escape(episode.limits),
        when=time.strftime("%Y-%m-%d %H:%M", began),
        count=len(episode.touches),
        why="".join(
            f"<li>{escape(reason)}</li>" for reason in episode.to_dict()["why"]
        ),
        items="".join(map(_item, episode.touches, pictures)),
    )


def _item(touch: LiveTouch, png: bytes | None) -> str:
    picture = ""
    if png is not None:
        encoded = base64.b64encode(png).decode()
        source = f"data:image/png;base64,{encoded}"
        picture = f"<img alt='touch {touch.number}' src='{source}'>"
    shown = sorted(touch.posterior.items(), key=lambda item: -item[1])[:_OBJECTS_LISTED]
    if touch.unknown is not None:
        shown.append(("nothing learnt", touch.unknown))
    rows = "".join(
        f"<tr><th scope=row>{escape(name)}<div class=track><div class=bar "
        f"style='width:{share:.1%}'></div></div></th><td>{figure_of(share)}</td></tr>"
        for name, share in shown
    )
    note = f"<p class=note>{escape(touch.note)}</p>" if touch.note else ""
    text = f"<b>Touch {touch.number}</b>{note}<table>{rows}</table>"
    return f"<li>{picture}<div>{text}</div></li>"


ReadLearnt = Callable[[], Touches | None]


class TopView:
    """What the places of touches tell, by one model.

    Parameters
    ----------
    recogniser : ObjectRecogniser
        The model.
    read_learnt : callable
        Returns the touches that it learnt, in that order, or None.
    learnt : callable
        Called with the map when it is learnt, from another thread; with None where
        that cannot be.

    Attributes
    ----------
    map : SurfaceMap or None
        Where the objects have their surface, once that is learnt.
    """

    def __init__(
        self,
        recogniser: ObjectRecogniser,
        read_learnt: ReadLearnt,
        learnt: Callable[[SurfaceMap | None], None],
    ) -> None:
        self._recogniser, self._read_learnt = recogniser, read_learnt
        self._learnt = learnt
        self._lock = threading.Lock()
        self._learner: threading.Thread | None = None
        self.map: SurfaceMap | None = None
        self._trouble = LEARNING

    def learn(self) -> None:
        """Begin to learn the map, where that has not begun."""
        with self._lock:
            if self._learner is None:
                self._learner = threading.Thread(target=self._learn, daemon=True)
                self._learner.start()

    def of(self, touches: list[LiveTouch], belief: object) -> dict[str, Any]:
        """Return what is seen of an episode; nothing where no touch has a place."""
        placed = [touch for touch in touches if touch.position_mm]
        view: dict[str, Any] = {
            "touches": [_dot(touch) for touch in placed if not touch.miss],
            "misses": [_dot(touch) for touch in placed if touch.miss],
        }
        if not placed or not isinstance(belief, PlaceBelief):
            return {**view, "sentence": self._trouble if placed else ""}
        if not belief.n_contacts:
            return {**view, "sentence": placed[-1].note or _NO_PLACE}
        return {**view, **_expected(belief)}

    def _learn(self) -> None:
        try:
            self.map, trouble = self._learnt_map(), ""
        except (ValueError, OSError, MemoryError) as error:
            trouble = str(error)
        self._trouble = trouble
        self._learnt(self.map)

    def _learnt_map(self) -> SurfaceMap:
        n_touches = len(self._recogniser.memory_)
        if n_touches > _MOST_TOUCHES:
            raise ValueError(_TOO_MANY.format(n_touches, _MOST_TOUCHES))
        learnt = self._read_learnt()
        if learnt is None or "position_mm" not in learnt.columns:
            raise ValueError(_NO_PLACES)
        return SurfaceMap().fit(self._recogniser, learnt)


def _dot(touch: LiveTouch) -> dict[str, Any]:
    assert touch.position_mm is not None
    x_mm, y_mm, _ = touch.position_mm
    return {"number": touch.number, "x_mm": x_mm, "y_mm": y_mm}


def _expected(belief: PlaceBelief) -> dict[str, Any]:
    """Return pose, sentence, and the ellipses that `PlaceBelief.plot_surface` draws."""
    pose, posterior = belief.pose(), belief.posterior
    if belief.unknown > posterior[pose.object]:
        share = share_of(belief.unknown)
        return {"sentence": f"Nothing I know, by pictures and places ({share})."}
    share = share_of(posterior[pose.object])
    points, covariances = belief.surface()
    return {
        "sentence": f"{pose} ({share} by pictures and places).",
        "pose": {**asdict(pose), "probability": posterior[pose.object]},
        "surface": [
            dict(zip(_ELLIPSE, row, strict=True))
            for row in _ellipses(points, covariances).round(2).tolist()
        ],
    }


def _ellipses(points_mm: Floats, covariances: Floats) -> Floats:
    """Return x, y, two half axes (mm) and the angle of the first (degrees), (n, 5)."""
    lengths, ways = np.linalg.eigh(covariances[:, :2, :2])
    axes = np.sqrt(np.maximum(lengths[:, ::-1], 0))
    angle = np.degrees(np.arctan2(ways[:, 1, 1], ways[:, 0, 1]))
    return np.column_stack([points_mm[:, :2], axes, angle])
