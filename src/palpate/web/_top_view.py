"""What was touched where, seen from above, and how the object stands there.

A model whose touches were taught with their places, as `palpate explore learn` does,
tells more of an episode whose touches have places too. This is worked out when the page
asks for it, from the touches of the episode, and never keeps a touch waiting.
"""

import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .._types import Floats
from ..exploration import PlaceBelief, SurfaceMap
from ..recognition import ObjectRecogniser, share_of
from ..touches import Touches
from ._episode import LiveEpisode, LiveTouch

LEARNING = "Learning where the objects have their surface; this takes some seconds."
_NO_PLACES = "The model was taught without places, so that these tell nothing."
_TOO_MANY = "The model is of {} touches; where they met something is used up to {}."
_MOST_TOUCHES = 3000
_MOST = 100  # of an episode: what every next one costs grows with their cube
_ELLIPSE = "x_mm", "y_mm", "long_mm", "short_mm", "turn_deg"

ReadLearnt = Callable[[], Touches | None]


class TopView:
    """What the places of touches tell, by one model.

    Parameters
    ----------
    recogniser : ObjectRecogniser
        The model.
    read_learnt : callable
        Returns the touches that it learnt, in that order, or None.
    strangers : float
        The share of episodes with something never learnt.
    changed : callable
        Called when there is more to be seen, from another thread.
    """

    def __init__(
        self,
        recogniser: ObjectRecogniser,
        read_learnt: ReadLearnt,
        strangers: float,
        changed: Callable[[], None],
    ) -> None:
        self._recogniser, self._read_learnt = recogniser, read_learnt
        self._strangers, self._changed = strangers, changed
        self._lock = threading.Lock()
        self._learner: threading.Thread | None = None
        self._map: SurfaceMap | None = None
        self._belief: PlaceBelief | None = None
        self._taken: list[LiveTouch] = []
        self._trouble = LEARNING

    def of(self, episode: LiveEpisode) -> dict[str, Any]:
        """Return what is seen of an episode; nothing where no touch has a place.

        The first time that there is something to be seen the map is learnt, in a thread
        of its own.
        """
        touches = list(episode.touches)
        placed = [touch for touch in touches if touch.place]
        view: dict[str, Any] = {"touches": [_dot(touch) for touch in placed]}
        with self._lock:
            if placed and self._learner is None:
                self._learner = threading.Thread(target=self._learn, daemon=True)
                self._learner.start()
            if not placed or self._map is None:
                return {**view, "sentence": self._trouble if placed else ""}
            try:
                return {**view, **_expected(self._believe(episode, placed[:_MOST]))}
            except ValueError as error:
                return {**view, "sentence": str(error)}

    def _learn(self) -> None:
        surface_map, trouble = None, ""
        try:
            surface_map = self._learnt_map()
        except (ValueError, OSError, MemoryError) as error:
            trouble = str(error)
        with self._lock:
            self._map, self._trouble = surface_map, trouble
        self._changed()

    def _learnt_map(self) -> SurfaceMap:
        n_touches = len(self._recogniser.memory_)
        if n_touches > _MOST_TOUCHES:
            raise ValueError(_TOO_MANY.format(n_touches, _MOST_TOUCHES))
        learnt = self._read_learnt()
        if learnt is None or "position_mm" not in learnt.columns:
            raise ValueError(_NO_PLACES)
        return SurfaceMap().fit(self._recogniser, learnt)

    def _believe(
        self, episode: LiveEpisode, placed: Sequence[LiveTouch]
    ) -> PlaceBelief:
        """Return the belief after these touches; what was taken in stays so."""
        assert self._map is not None
        belief, n_taken = self._belief, len(self._taken)
        if belief is None or self._taken != [*placed[:n_taken]]:
            belief, n_taken = self._map.start(strangers=self._strangers), 0
        self._belief = None  # begun anew where a touch is refused
        for touch in placed[n_taken:]:
            about: dict[str, Any] = {name: [at] for name, at in touch.place.items()}
            image = episode.images[touch.number - 1][np.newaxis]
            belief.update(Touches(image, channels=episode.channels, **about))
        self._belief, self._taken = belief, [*placed]
        return belief


def archive_beside(model: Path) -> Touches | None:
    """Return the touches in the archive of a model's name, None without one."""
    archive = model.with_suffix(".npz")
    return Touches.load(archive) if archive.is_file() else None


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
