"""Choosing and making touches: the robot contract, guarded touches, episodes.

A strategy chooses where, `guarded_touch` touches from there and comes back whatever
happens, `explore` goes round the object and repeats it until that is recognised, and
keeps every attempt.
"""

from ._episode import explore
from ._episode import gather as gather
from ._guarded import Guard, guarded_touch
from ._place_belief import PlaceBelief
from ._place_filter import advice
from ._record import TouchRecord as TouchRecord
from ._record import as_touches as as_touches
from ._record import read_episode
from ._robot import Robot, RobotError, SimulatedRobot, check_robot
from ._simulated_objects import explore_to_learn, put_down
from ._strategies import (
    Hemisphere,
    InformativeTouch,
    RandomHemisphere,
    Raster,
    Strategy,
)
from ._surface_map import SurfaceMap
from ._touch_map import TouchMap

__all__ = [
    "Guard",
    "Hemisphere",
    "InformativeTouch",
    "PlaceBelief",
    "RandomHemisphere",
    "Raster",
    "Robot",
    "RobotError",
    "SimulatedRobot",
    "Strategy",
    "SurfaceMap",
    "TouchMap",
    "advice",
    "check_robot",
    "explore",
    "explore_to_learn",
    "guarded_touch",
    "put_down",
    "read_episode",
]
