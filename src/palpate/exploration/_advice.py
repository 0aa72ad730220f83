"""Where to touch next, in words for a person with a sensor in the hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..simulation import SensorPose
from ._place_filter import in_frames
from ._surface import met_along

if TYPE_CHECKING:
    from ._place_belief import PlaceBelief

_FAR_MM = 200.0
_STEEP, _FLAT = np.deg2rad(70), np.deg2rad(20)


def advice(belief: PlaceBelief, pose: SensorPose) -> str:
    """Return one sentence: which part to touch, from where, and what it would tell.

    Parameters
    ----------
    belief : PlaceBelief
        What the touches so far say.
    pose : SensorPose
        Where to begin, as a strategy chooses it.

    Returns
    -------
    str
        As "Touch the rim, from 2 o'clock and above, to tell the mug from the porridge
        pot." Hours are seen from above, 12 away along y.
    """
    out = -np.asarray(pose.direction)
    height = float(np.arcsin(np.clip(out[2], -1, 1)))
    hour = round(float(np.degrees(np.arctan2(out[0], out[1]))) / 30) % 12 or 12
    side = f"from {hour} o'clock"
    if height > _STEEP:
        where = "from straight above"
    else:
        where = side if height < _FLAT else f"{side} and above"
    names = belief.map.recogniser.classes_[np.argsort(-belief.log_posterior)[:2]]
    purpose = ""
    if len(names) > 1:
        purpose = f", to tell the {names[0]} from the {names[1]}"
    return f"Touch the {_part(belief, out)}, {where}{purpose}."


def _part(belief: PlaceBelief, out: np.ndarray) -> str:
    """Return the part of the most probable object that is met from a direction."""
    pose, table = belief.pose(), belief.map.table_
    state = belief.map.states_.index((pose.object, pose.face))
    standing = np.array([pose.turn_rad, *pose.offset_mm])
    far = in_frames(_FAR_MM * out, standing)
    way = in_frames(standing[1:] - out, standing)
    radius, _ = met_along(table, np.array([state]), far[None], way[None])
    points, _ = belief.surface()
    points = points - belief.centre_mm - pose.offset_mm
    met = out * max(float(radius[0]) - belief.map.tip_radius_mm, 0.0)
    high = met[2] / max(float(points[:, 2].max()), 1e-6)
    wide = np.hypot(*met[:2]) / max(float(np.hypot(*points[:, :2].T).max()), 1e-6)
    if high > 0.6:
        return "rim" if wide > 0.5 else "top"
    level = points[np.abs(points[:, 2]) < 0.3 * max(float(points[:, 2].max()), 1e-6)]
    reach = np.hypot(*level[:, :2].T) if len(level) else np.ones(1)
    if reach.max() > 1.3 * reach.min():
        longer = np.hypot(*met[:2]) > (reach.max() + reach.min()) / 2
        return "far end" if longer else "long side"
    return "side"
