"""Choosing and making touches: the robot contract, guarded touches, episodes.

A strategy chooses where, `guarded_touch` goes there and comes back whatever happens,
`explore` repeats it until the object is recognised and keeps every attempt.
"""

from ._episode import Exploration, explore, gather
from ._guarded import Guard, guarded_touch
from ._hemisphere import Hemisphere
from ._informative import InformativeTouch
from ._log import EpisodeError, EpisodeLog, read_episode
from ._placed_belief import PlacedBelief
from ._record import OUTCOMES, TouchRecord, as_touches
from ._recorded import (
    InformativeRecorded,
    RandomRecorded,
    RasterRecorded,
    look_at_recorded,
)
from ._robot import Robot, RobotError
from ._simulated_robot import FAULTS, SimulatedRobot
from ._stand import QUICK_GUARD, Stand, put_down
from ._strategies import RandomHemisphere, Raster, Strategy
from ._teaching import explore_to_learn
from ._touch_map import TouchMap

__all__ = [
    "FAULTS",
    "OUTCOMES",
    "QUICK_GUARD",
    "EpisodeError",
    "EpisodeLog",
    "Exploration",
    "Guard",
    "Hemisphere",
    "InformativeRecorded",
    "InformativeTouch",
    "PlacedBelief",
    "RandomHemisphere",
    "RandomRecorded",
    "Raster",
    "RasterRecorded",
    "Robot",
    "RobotError",
    "SimulatedRobot",
    "Stand",
    "Strategy",
    "TouchMap",
    "TouchRecord",
    "as_touches",
    "explore",
    "explore_to_learn",
    "gather",
    "guarded_touch",
    "look_at_recorded",
    "put_down",
    "read_episode",
]
