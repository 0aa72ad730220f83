"""Choosing and making touches: the robot contract, guarded touches, episodes.

A strategy chooses where, `guarded_touch` goes there and comes back whatever happens,
`explore` repeats it until the object is recognised and keeps every attempt.
"""

from ._episode import Exploration, explore, gather
from ._guarded import Guard, guarded_touch
from ._hemisphere import Hemisphere
from ._log import EpisodeError, EpisodeLog, read_episode
from ._record import OUTCOMES, TouchRecord, as_touches
from ._robot import Robot, RobotError
from ._simulated_robot import FAULTS, SimulatedRobot
from ._strategies import RandomHemisphere, Raster, Strategy

__all__ = [
    "FAULTS",
    "OUTCOMES",
    "EpisodeError",
    "EpisodeLog",
    "Exploration",
    "Guard",
    "Hemisphere",
    "RandomHemisphere",
    "Raster",
    "Robot",
    "RobotError",
    "SimulatedRobot",
    "Strategy",
    "TouchRecord",
    "as_touches",
    "explore",
    "gather",
    "guarded_touch",
    "read_episode",
]
