"""Every fault of the simulated arm in a real episode: it retracts, nothing is lost."""

import re
from functools import cache

import numpy as np
import pytest
from ball_world import SlowlySure
from numpy.testing import assert_allclose

from palpate.exploration import (
    Guard,
    Hemisphere,
    RandomHemisphere,
    SimulatedRobot,
    explore,
    guarded_touch,
    read_episode,
)
from palpate.sensors import SimulatedBench, SimulatedSensor
from palpate.simulation import DomeCamera, PlacedObject, find_object

CAMERA = DomeCamera(image_shape=(32, 32), n_nodes=20)
OUTCOME_OF = {
    "stuck force": "force sensor",
    "stuck force in contact": "force sensor",
    "no force": "force sensor",
    "overshoot": "limit exceeded",
    "driver error": "robot error",
    "slow": "timed out",
    "retract error": "touched",
    "arm stuck": "touched",
    "no frame": "no frame",
    "out of reach": "nothing",
}


@cache
def resting(name):
    """The object on the ground; nothing changes it, so that all meet the same."""
    return PlacedObject.resting(find_object(name))


class Setup:
    """A ball or another object before the simulated arm and sensor."""

    def __init__(self, name="ball", **settings):
        self.bench = SimulatedBench(resting(name), CAMERA)
        centre = self.bench.centre_mm
        self.hemisphere = Hemisphere(tuple(centre), radius_mm=100)
        home = self.hemisphere.pose(0.0, 1.5)
        self.robot = SimulatedRobot(self.bench, home, **settings)
        lost = self.robot.missing_frames
        self.sensor = SimulatedSensor(self.bench, missing=lost)

    def explore(self, folder=None, n_attempts=3):
        strategy = RandomHemisphere(self.hemisphere)
        guard = Guard(max_travel_mm=115)
        return explore(
            self.robot,
            self.sensor,
            SlowlySure(),
            strategy,
            folder,
            guard=guard,
            max_attempts=n_attempts,
            clock=self.robot.clock,
        )

    @property
    def distance_mm(self):
        tip = np.asarray(self.bench.pose.position_mm)
        return np.linalg.norm(tip - self.hemisphere.centre_mm)


def test_the_force_sensor_has_offset_and_noise():
    robot = Setup(noise_n=0.02, offset_n=0.3).robot
    readings = np.array([robot.read_force() for _ in range(2000)])
    # Standard errors of 2000 readings: 0.0005 of the mean, 0.0003 of the deviation.
    assert_allclose(readings.mean(), 0.3, atol=0.003)
    assert_allclose(readings.std(), 0.02, atol=0.002)


@pytest.mark.parametrize("name", ["ball", "box", "stapler"])
def test_a_touch_ends_at_the_force_in_spite_of_noise(name):
    setup = Setup(name)
    start = setup.hemisphere.pose(0.3, 0.9)
    record = guarded_touch(setup.robot, setup.sensor, start, clock=setup.robot.clock)
    assert record.outcome == "touched"
    # Four standard deviations of three readings (0.01 N each), and a step of 0.25 mm
    # at 0.3 N/mm beyond it.
    assert 0.735 - 0.025 < setup.bench.peak_force_n < 0.735 + 0.025 + 0.08
    assert_allclose(record.force_n, setup.bench.peak_force_n, atol=0.03)
    moved = record.image.astype(float) - CAMERA.no_contact()
    assert np.abs(moved).max() > 20


def test_every_fault_is_told_in_this_file():
    with pytest.raises(ValueError, match="faults must be one of") as refused:
        Setup(faults={0: "none of these"})
    listed = str(refused.value).partition(", got ")[0]
    assert re.findall(r"'([^']+)'", listed) == [*OUTCOME_OF]


@pytest.mark.parametrize(
    "fault", [fault for fault in OUTCOME_OF if fault != "arm stuck"]
)
def test_after_a_fault_the_arm_is_back_and_the_episode_goes_on(fault, tmp_path):
    setup = Setup(faults={1: fault})
    end = setup.explore(tmp_path)
    outcomes = [record.outcome for record in end.history]
    assert outcomes == ["touched", OUTCOME_OF[fault], "touched"]
    assert end.history[1].message or not end.history[1].faulty
    assert [record.outcome for record in read_episode(tmp_path)] == outcomes
    assert end.ended_by == "budget"
    assert_allclose(setup.distance_mm, 100, atol=1e-6)
    assert setup.bench.force_n == 0
    assert not setup.robot.stopped


@pytest.mark.parametrize("fault", OUTCOME_OF)
def test_no_fault_presses_hard(fault):
    setup = Setup(faults={0: fault})
    setup.explore(n_attempts=1)
    # The overshoot of 14 mm lands where it lands; all else ends within a millimetre
    # of the force at which it should have ended, 0.3 N/mm.
    most = 0.735 + 0.3 * 1.25 if fault != "overshoot" else 12.0
    assert setup.bench.peak_force_n < most


def test_an_arm_that_is_stuck_in_contact_is_stopped(tmp_path):
    setup = Setup(faults={1: "arm stuck"})
    end = setup.explore(tmp_path, n_attempts=10)
    assert (end.ended_by, end.n_touches, len(end.history)) == ("faults", 2, 2)
    assert setup.robot.stopped
    assert "brakes" in end.reason
    last = read_episode(tmp_path)[-1]
    assert last.image is not None
    assert not last.retracted
