"""Fifty arms that each do one thing wrong, before a springy ball known on paper.

For drivers of one's own: what palpate does beside an arm like these is tested here.
`FAULTS` names what a `FaultyArm` may do wrong; `peak_n` is the greatest force it truly
pressed with, all along its ways, `inside` whether it truly stands pressed now. `PATHS`
are all the ways in which palpate moves an arm: each takes one, and returns what was
recorded.
"""

from contextlib import ExitStack, contextmanager
from dataclasses import fields
from functools import partial
from importlib import import_module
from math import dist
from unittest import mock

import numpy as np
from ball_world import SlowlySure

from palpate.exploration import (
    Guard,
    Hemisphere,
    RandomHemisphere,
    explore,
    gather,
    guarded_touch,
)
from palpate.simulation import DomeCamera, SensorPose, find_object

NEAR = Hemisphere(radius_mm=100)
GUARD_FIELDS = {field.name for field in fields(Guard)}


def guard_of(**settings):
    """Return a guard for the hemisphere of 100 mm, without fields that `Guard` lacks.

    In the air steps are of 0.5 mm: 2.5 N of what has 5 N/mm.
    """
    usual = {"timeout_s": 1e9, "max_travel_mm": 110.0, "air_step_mm": 0.5}
    usual |= {"expected_n_mm": 0.8, "frame_change": 2.0}
    return Guard(
        **{name: n for name, n in (usual | settings).items() if name in GUARD_FIELDS}
    )


GUARD = guard_of()


class FaultyArm:
    """A ball of a radius and a stiffness, a hemisphere of 100 mm, and one fault."""

    image_shape = (8, 8)
    geometry = "none"

    def __init__(self, fault="", stiffness_n_mm=1.0, radius_mm=40.0):
        self.stiffness, self.radius_mm, self.fault = stiffness_n_mm, radius_mm, fault
        self.ball_mm = np.zeros(3)
        self.pose = SensorPose((0, 0, 300), (0, 0, -1))
        self.peak_n, self.stopped, self.n = 0.0, False, 0
        self.history, self.counts = [0.0], {}
        self.filtered = self.drift = 0.0
        prepare = SCENES.get(fault)
        if prepare is not None:
            prepare(self)

    @property
    def force_n(self):
        return self._force_at(dist(self.pose.position_mm, self.ball_mm))

    def _force_at(self, distance_mm):
        return self.stiffness * max(self.radius_mm - distance_mm, 0.0)

    @property
    def inside(self):
        return self.force_n > 1e-9

    def once(self, name, times=1):
        """Whether this fault is on, and was not met so often yet."""
        if self.fault != name or self.counts.get(name, 0) >= times:
            return False
        self.counts[name] = self.counts.get(name, 0) + 1
        return True

    def put(self, pose):
        """Move in a straight line, and press on whatever lies on it."""
        if self.stopped:
            raise RuntimeError("stopped")
        here, there = self.pose.position_mm, pose.position_mm
        shares = np.linspace(0, 1, 2 + int(dist(there, here)))[:, np.newaxis]
        places = here + shares * np.subtract(there, here)
        nearest_mm = np.linalg.norm(places - self.ball_mm, axis=1).min()
        self.peak_n = max(self.peak_n, self._force_at(nearest_mm))
        self.pose = pose

    def clock(self):
        """Return the seconds that readings of 1 kHz have taken."""
        return self.n / 1000

    def move_to(self, pose):
        if self.fault == "move raises before":
            raise OSError("cable")
        if self.fault == "undershoots":
            pose = pose.advanced(-2.0)
        self.put(pose)
        if self.inside:
            if self.fault == "overshoots each step":
                self.put(pose.advanced(0.2))
            if self.once("overshoots by 3 mm"):
                self.put(pose.advanced(3.0))
            if self.once("move raises after"):
                raise OSError("cable")
            if self.once("interrupted in contact") or self.once(
                "interrupted in contact and when pulled back"
            ):
                raise KeyboardInterrupt

    def read_pose(self):
        if self.fault == "pose does not change":
            return SensorPose((0, 0, 300), (0, 0, -1))
        if self.fault == "pose is off by 1 mm":
            return self.pose.advanced(1.0)
        if self.fault == "pose raises":
            raise OSError("cable")
        if self.fault == "neither retracts nor tells" and self.counts.get("pulled"):
            return self.sent_back
        return self.pose

    def read_force(self):
        self.n += 1
        true, noise = self.force_n, 1e-5 * (self.n % 7)
        self.history.append(true)
        if self.fault.startswith("lags by"):
            late = int(self.fault.split()[2])
            return self.history[max(len(self.history) - 1 - late, 0)] + noise
        if self.fault.startswith("filtered by"):
            keep = float(self.fault.split()[2])
            self.filtered = keep * self.filtered + (1 - keep) * true
            return self.filtered + noise
        reads = READINGS.get(self.fault)
        return true + noise if reads is None else reads(self, true) + noise

    def retract(self, way_mm):
        if self.fault == "retract does not move":
            return
        if self.fault == "neither retracts nor tells" and self.inside:
            self.counts["pulled"], self.sent_back = 1, self.pose.advanced(-way_mm)
            return
        if self.fault == "retract always raises":
            raise OSError("brakes")
        if self.once("retract raises once"):
            raise OSError("lost")
        if self.once("interrupted in contact and when pulled back"):
            raise KeyboardInterrupt
        if self.fault == "interrupted at every retract":
            raise KeyboardInterrupt
        if self.fault == "retracts half":
            way_mm /= 2
        self.put(self.pose.advanced(-way_mm))
        if self.once("retract raises after"):
            raise OSError("lost")

    def stop(self):
        self.stopped = True
        if self.fault == "stop raises":
            raise OSError("no power")

    def read(self):
        if self.fault == "no frame":
            return None
        if self.fault == "frame of another shape":
            return np.zeros((2, 5))
        return np.full((8, 8), 5.0 * self.inside)

    def no_contact(self):
        return None


def exploring(arm):
    """Touch five times as `explore` does."""
    options = {"guard": GUARD, "max_attempts": 5}
    return explore(arm, arm, SlowlySure(), RandomHemisphere(NEAR, 1), **options).history


def gathering(arm):
    """Gather four touches."""
    return gather(arm, arm, RandomHemisphere(NEAR, 2), guard=GUARD, n_touches=4)


def touching(arm):
    """Touch once from where somebody has put the arm."""
    arm.pose = NEAR.pose(0.3, 0.9)
    return [guarded_touch(arm, arm, arm.pose, GUARD)]


@contextmanager
def put_before(arm):
    """Let whatever is put down be put before this arm."""
    names = "_simulated_objects", "environment"
    rooms = [import_module(f"palpate.exploration.{name}") for name in names]

    def put_down(thing, *_, **__):
        return rooms[0].Stand(thing, NEAR, arm, arm, arm)

    with ExitStack() as stack:
        for room in rooms:
            stack.enter_context(mock.patch.object(room, "put_down", put_down))
        yield rooms


def standing(arm):
    """Touch three times where something was put down."""
    with put_before(arm) as (room, _):
        stand = room.put_down(find_object("ball"))
        return [stand.touch(NEAR.pose(n, 0.8), GUARD) for n in (0, 2, 4)]


def teaching(arm):
    """Teach an object by exploring it, with the guard that is used for that."""
    guard = guard_of(limit_n=5.0, lag_readings=0)
    with put_before(arm) as (room, _), mock.patch.object(room, "QUICK_GUARD", guard):
        thing = find_object("ball")
        options = {"n_touches": 3, "n_sessions": 1, "n_jobs": 1}
        camera = DomeCamera(image_shape=(8, 8))
        with recorded() as history:
            room.explore_to_learn([thing], camera=camera, **options)
        return history


def toucher_of(arm):
    """Return a function that touches from a pose, as an episode that goes on does."""
    ways, guarded = (
        import_module(f"palpate.exploration.{name}") for name in ("_ways", "_guarded")
    )
    toucher = guarded.Toucher(arm, arm, GUARD, lag=0)
    return partial(ways.touch_from_hemisphere, toucher, NEAR)


@contextmanager
def recorded():
    """Keep the records of `gather`: touches that are taught keep only their images."""
    history = []
    room = import_module("palpate.exploration._simulated_objects")
    usual = room.gather

    def kept(*arguments, **options):
        history.extend(usual(*arguments, **options))
        return history

    with mock.patch.object(room, "gather", kept):
        yield history


def playing(arm):
    """Take three steps of the environment for learned policies."""
    with put_before(arm) as (_, room):
        env = room.TouchEnv(
            ["ball", "mug"], camera=DomeCamera(image_shape=(8, 8)), guard=GUARD
        )
        env.reset(seed=0)
        for direction in ((1, 0, 1), (0, 1, 1), (-1, 0, 1)):
            env.step({"action": np.array(direction), "prediction": np.zeros(2)})
        return env.history


def coming_out(arm):
    """Come out of the hemisphere from near the object, or from where it is parked."""
    if np.allclose(arm.pose.position_mm, (0, 0, 300)):
        arm.pose = NEAR.pose(0.3, 0.9).advanced(55)
    import_module("palpate.exploration._ways").come_out(arm, NEAR, GUARD)
    return []


def going_round(arm):
    """Go over the object and back, without touching it."""
    ways = import_module("palpate.exploration._ways")
    arm.pose = NEAR.pose(0.0, 0.3)
    for azimuth in (3.0, 1.5, -1.5):
        ways.Way(arm, GUARD).follow(NEAR, NEAR.pose(azimuth, 0.3))
    return []


PATHS = {
    "explore": exploring,
    "gather": gathering,
    "touch": touching,
    "put down": standing,
    "teach": teaching,
    "environment": playing,
    "come out": coming_out,
    "way": going_round,
}


def _parked(place, look):
    def prepare(arm):
        arm.pose = SensorPose(place, look)

    return prepare


def _ball(place, radius_mm=40.0):
    def prepare(arm):
        arm.ball_mm, arm.radius_mm = np.array(place, float), radius_mm

    return prepare


def _alternating(arm, true):
    return true + (0.3 if arm.n % 2 else -0.3)


def _drifting(arm, true):
    arm.drift += 1e-3
    return true + arm.drift


READINGS = {
    "no number": lambda arm, true: np.nan,
    "no number in contact": lambda arm, true: np.nan if true else 0.0,
    "stuck": lambda arm, true: -1e-5 * (arm.n % 7),
    "wrong sign": lambda arm, true: -true,
    "offset of 0.9": lambda arm, true: true + 0.9,
    "offset of 2": lambda arm, true: true + 2.0,
    "drifts": _drifting,
    "noise of 0.3": _alternating,
    "reads half": lambda arm, true: true / 2,
    "reads tenfold": lambda arm, true: 10 * true,
    "reads a tenth": lambda arm, true: true / 10,
    "dead but noisy": lambda arm, true: 0.0,
    "spikes": lambda arm, true: true + (9.0 if arm.n % 997 == 0 else 0.0),
    "saturates at 0.5": lambda arm, true: min(true, 0.5),
    "coarse": lambda arm, true: round(true / 0.05) * 0.05,
}
SCENES = {
    "object 60 mm off": _ball((60, 0, 0)),
    "object 150 mm off": _ball((150, 0, 0)),
    "object too large": _ball((0, 0, 0), 110.0),
    "object too tall": _ball((0, 0, 70)),
    "object beside the way": _ball((0, 90, 60), 30.0),
    "parked looking up": _parked((0, 0, 60), (0, 0, 1)),
    "parked looking sideways": _parked((0, 0, 60), (1, 0, 0)),
    "parked below": _parked((0, 0, -60), (0, 0, 1)),
    "parked in contact": _parked((0, 0, 39.5), (0, 0, -1)),
}
FAULTS = (
    *READINGS,
    *SCENES,
    *(f"lags by {n}" for n in (8, 20, 40, 60)),
    *(f"filtered by {keep}" for keep in (0.9, 0.97)),
    "overshoots each step",
    "overshoots by 3 mm",
    "undershoots",
    "move raises before",
    "move raises after",
    "pose does not change",
    "pose is off by 1 mm",
    "pose raises",
    "retract does not move",
    "neither retracts nor tells",
    "retract always raises",
    "retract raises once",
    "retract raises after",
    "retracts half",
    "interrupted in contact",
    "interrupted in contact and when pulled back",
    "interrupted at every retract",
    "stop raises",
    "no frame",
    "frame of another shape",
)
