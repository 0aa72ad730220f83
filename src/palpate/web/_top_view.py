"""What was touched where, seen from above, and how the object stands there.

A model whose touches were taught with their places, as `palpate explore learn` does,
tells more of an episode whose touches have places too: its belief is then by pictures
and places. The map that this needs is learnt when the first touch with a place comes,
in a thread of its own, and never keeps a touch waiting.
"""

import threading
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .._types import Floats
from ..exploration import PlaceBelief, SurfaceMap
from ..recognition import ObjectRecogniser, share_of
from ..touches import Touches
from ._episode import LiveTouch

LEARNING = "Learning where the objects have their surface; this takes some seconds."
_NO_PLACE = "No touch has a place that counts."
_NO_PLACES = "The model was taught without places, so that these tell nothing."
_TOO_MANY = "The model is of {} touches; where they met something is used up to {}."
_MOST_TOUCHES = 3000
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
