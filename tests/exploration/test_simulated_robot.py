"""Every fault of the simulated arm in a real episode: it retracts, nothing is lost."""

import re

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
    put_down,
    read_episode,
)
from palpate.simulation import DomeCamera, find_object

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


def before(name="ball", **faults):
    """Return an object before the simulated arm, and a hemisphere of 100 mm."""
    stand = put_down(find_object(name), CAMERA, placement_sd_mm=0, **faults)
    return stand, Hemisphere(stand.hemisphere.centre_mm, radius_mm=100)


def explored(stand, hemisphere, folder=None, n_attempts=3):
    return explore(
        stand.robot,
        stand.sensor,
        SlowlySure(),
        RandomHemisphere(hemisphere),
        folder,
        guard=Guard(max_travel_mm=115),
        max_attempts=n_attempts,
        clock=stand.robot.clock,
    )


def test_the_force_sensor_has_offset_and_noise():
    stand, hemisphere = before()
    home = hemisphere.pose(0.0, 1.5)
    robot = SimulatedRobot(stand.bench, home, noise_n=0.02, offset_n=0.3)
    readings = np.array([robot.read_force() for _ in range(2000)])
    # Standard errors of 2000 readings: 0.0005 of the mean, 0.0003 of the deviation.
    assert_allclose(readings.mean(), 0.3, atol=0.003)
    assert_allclose(readings.std(), 0.02, atol=0.002)


@pytest.mark.parametrize("name", ["ball", "box", "stapler"])
def test_a_touch_ends_at_the_force_in_spite_of_noise(name):
    stand, hemisphere = before(name)
    start, robot = hemisphere.pose(0.3, 0.9), stand.robot
    record = guarded_touch(robot, stand.sensor, start, clock=robot.clock)
    assert record.outcome == "touched"
    # Four standard deviations of three readings (0.01 N each), and a step of 0.25 mm
    # at 0.3 N/mm beyond it.
    assert 0.735 - 0.025 < stand.bench.peak_force_n < 0.735 + 0.025 + 0.08
    assert_allclose(record.force_n, stand.bench.peak_force_n, atol=0.03)
    moved = record.image.astype(float) - CAMERA.no_contact()
    assert np.abs(moved).max() > 20


def test_every_fault_is_told_in_this_file():
    with pytest.raises(ValueError, match="faults must be one of") as refused:
        before(faults={0: "none of these"})
    listed = str(refused.value).partition(", got ")[0]
    assert re.findall(r"'([^']+)'", listed) == [*OUTCOME_OF]
    for number, error in ((-1, ValueError), ("1", TypeError)):  # would never come
        with pytest.raises(error, match="faults must be"):
            before(faults={number: "slow"})


@pytest.mark.parametrize(
    "fault", [fault for fault in OUTCOME_OF if fault != "arm stuck"]
)
def test_after_a_fault_the_arm_is_back_and_the_episode_goes_on(fault, tmp_path):
    stand, hemisphere = before(faults={1: fault})
    end = explored(stand, hemisphere, tmp_path)
    outcomes = [record.outcome for record in end.history]
    assert outcomes == ["touched", OUTCOME_OF[fault], "touched"]
    assert end.history[1].message or not end.history[1].faulty
    assert [record.outcome for record in read_episode(tmp_path)] == outcomes
    assert end.ended_by == "budget"
    tip_mm = np.subtract(stand.bench.pose.position_mm, hemisphere.centre_mm)
    assert_allclose(np.linalg.norm(tip_mm), 100, atol=1e-6)
    assert stand.bench.force_n == 0
    assert not stand.robot.stopped


@pytest.mark.parametrize("fault", OUTCOME_OF)
def test_no_fault_presses_hard(fault):
    stand, hemisphere = before(faults={0: fault})
    explored(stand, hemisphere, n_attempts=1)
    # The overshoot of 14 mm lands where it lands; all else ends within a millimetre
    # of the force at which it should have ended, 0.3 N/mm.
    most = 0.735 + 0.3 * 1.25 if fault != "overshoot" else 12.0
    assert stand.bench.peak_force_n < most


def test_an_arm_that_is_stuck_in_contact_is_stopped(tmp_path):
    stand, hemisphere = before(faults={1: "arm stuck"})
    end = explored(stand, hemisphere, tmp_path, n_attempts=10)
    assert (end.ended_by, end.n_touches, len(end.history)) == ("faults", 2, 2)
    assert stand.robot.stopped
    assert "brakes" in end.reason
    last = read_episode(tmp_path)[-1]
    assert last.image is not None
    assert not last.retracted
