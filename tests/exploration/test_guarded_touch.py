"""Guarded touches of a springy ball, where force and depth are known on paper."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.exploration import Guard, Hemisphere, Robot, RobotError, guarded_touch
from palpate.sensors import SensorError, TouchSensor

START = Hemisphere().pose(0.7, 0.6)


def test_the_ball_world_keeps_the_contracts(arm, sensor):
    assert isinstance(arm, Robot)
    assert isinstance(sensor, TouchSensor)


def test_it_stops_at_the_force_and_comes_back(arm, sensor):
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "touched"
    # 0.735 N at 0.2 N/mm is 3.675 mm deep; steps of 0.25 mm end at the next one.
    depth = record.travel_mm - (300 - 40)
    assert 0.735 / 0.2 <= depth <= 0.735 / 0.2 + 0.25
    assert_allclose(record.force_n, 0.2 * depth, atol=1e-5)
    assert_allclose(np.linalg.norm(record.position_mm), 40 - depth, rtol=1e-9)
    assert_allclose(record.image, np.outer(START.direction, START.direction))
    assert_allclose(arm.pose.position_mm, START.position_mm, atol=1e-9)
    assert record.retracted


def test_it_steps_finely_once_it_feels_something(arm, sensor):
    guarded_touch(arm, sensor, START)
    travelled = [300 - np.linalg.norm(pose.position_mm) for pose in arm.visited]
    steps = np.diff(travelled)
    # 0.1 N, the least contact, is 0.5 mm deep: felt by the step that ends at 261.
    assert_allclose(steps[np.array(travelled[:-1]) < 261], 1.0)
    assert_allclose(steps[np.array(travelled[:-1]) >= 261], 0.25)


def test_a_hard_first_contact_is_made_again_in_small_steps(world):
    arm = world.BallArm(radius_mm=40.4, stiffness_n_mm=4.0)
    record = guarded_touch(arm, world.BallSensor(arm), START)
    assert record.outcome == "touched"
    # A step in the air may go 1 mm too far, 4 N/mm x 0.4 mm here; a fine one 1 N.
    assert record.peak_force_n == pytest.approx(4.0 * 0.4, abs=1e-4)
    assert record.force_n <= 0.735 + 4.0 * 0.25


def test_a_force_sensor_with_an_offset_is_tared(arm, sensor, monkeypatch):
    plain = arm.read_force
    monkeypatch.setattr(arm, "read_force", lambda: plain() - 0.6)
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "touched"
    assert 0.735 <= record.force_n <= 0.735 + 0.05


def test_nothing_on_the_way_is_recorded_as_nothing(world):
    arm = world.BallArm(radius_mm=0.0)
    record = guarded_touch(arm, world.BallSensor(arm), START)
    assert record.outcome == "nothing"
    assert record.image is None
    assert not record.faulty
    assert record.travel_mm == Guard().max_travel_mm
    assert_allclose(arm.pose.position_mm, START.position_mm, atol=1e-9)


def test_an_object_out_of_reach_is_nothing(arm, sensor):
    record = guarded_touch(arm, sensor, START, Guard(max_travel_mm=250))
    assert (record.outcome, record.travel_mm) == ("nothing", 250)


def test_the_limit_is_never_passed_by_more_than_a_step(world):
    arm = world.BallArm(stiffness_n_mm=50.0)
    record = guarded_touch(arm, world.BallSensor(arm), START)
    assert record.outcome == "limit exceeded"
    assert "above the limit of 3" in record.message
    assert record.image is None
    assert record.peak_force_n <= 50 * 1.0 + 1e-5
    assert arm.force_n == 0


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        pytest.param(lambda force: np.nan, "reads nan", id="nan"),
        pytest.param(lambda force: np.inf, "reads inf", id="infinite"),
        pytest.param(lambda force: 0.03, "stuck at 0.03", id="stuck"),
        pytest.param(lambda force: force + 1.5, "1.500 N in the air", id="drifted"),
    ],
)
def test_a_bad_force_sensor_is_found_in_the_air(arm, sensor, reading, message):
    plain = arm.read_force
    arm.read_force = lambda: reading(plain())
    record = guarded_touch(arm, sensor, START)
    assert (record.outcome, record.travel_mm) == ("force sensor", 0)
    assert message in record.message
    assert record.image is None


def test_a_sensor_that_sticks_in_contact_is_found_in_a_millimetre(arm, sensor):
    plain, seen = arm.read_force, []

    def sticks():
        if not (seen and arm.force_n > 0.3):
            seen.append(plain())
        return seen[-1]

    arm.read_force = sticks
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "force sensor"
    # Four steps of 0.25 mm at 0.2 N/mm beyond 0.3 N, and the step that reached it.
    deepest = min(np.linalg.norm(pose.position_mm) for pose in arm.visited)
    assert 0.2 * (40 - deepest) < 0.3 + 0.2 * 1.25
    assert arm.force_n == 0


def test_a_coarse_sensor_may_repeat_itself(arm, sensor):
    plain = arm.read_force
    arm.read_force = lambda: round(plain(), 1)
    assert guarded_touch(arm, sensor, START).outcome == "force sensor"
    guard = Guard(stuck_after=None)
    assert guarded_touch(arm, sensor, START, guard).outcome == "touched"


def test_pressing_without_end_is_given_up(world):
    arm = world.BallArm(radius_mm=100.0, stiffness_n_mm=0.01)
    record = guarded_touch(arm, world.BallSensor(arm), START)
    assert record.outcome == "force sensor"
    assert "20 mm beyond the first contact" in record.message


def test_a_slow_arm_times_out_and_comes_back(arm, sensor):
    seconds = iter(range(10000))
    record = guarded_touch(arm, sensor, START, clock=lambda: float(next(seconds)))
    assert record.outcome == "timed out"
    assert 60 < record.travel_mm < 64
    assert_allclose(arm.pose.position_mm, START.position_mm, atol=1e-9)


@pytest.mark.parametrize(
    "frame",
    [
        pytest.param(SensorError("Nothing for 2 s."), id="missing"),
        pytest.param(np.zeros((4, 3)), id="wrong size"),
        pytest.param(None, id="None"),
        pytest.param(np.full((3, 3), np.nan), id="NaN alone"),
        pytest.param(np.diag([0.0, np.inf, 0.0]), id="infinity"),
    ],
)
def test_a_missing_or_strange_frame_is_a_fault(arm, sensor, monkeypatch, frame):
    def read():
        if isinstance(frame, Exception):
            raise frame
        return frame

    monkeypatch.setattr(sensor, "read", read)
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "no frame"
    assert record.image is None
    assert record.force_n >= 0.735
    assert_allclose(arm.pose.position_mm, START.position_mm, atol=1e-9)


def test_dead_taxels_are_no_fault(arm, sensor, monkeypatch):
    monkeypatch.setattr(sensor, "read", lambda: np.diag([1.0, np.nan, 1.0]))
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "touched"
    assert np.isnan(record.image).sum() == 1


@pytest.mark.parametrize("error", [RobotError, OSError, ZeroDivisionError])
@pytest.mark.parametrize("method", ["move_to", "read_force"])
def test_whatever_a_driver_raises_the_arm_comes_back(arm, sensor, method, error):
    plain = getattr(arm, method)

    def breaks(*args):
        result = plain(*args)
        if arm.force_n > 0.2:
            raise error("broken")
        return result

    setattr(arm, method, breaks)
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "robot error"
    assert f"{error.__name__}: broken" in record.message
    assert record.retracted
    # The arm had moved when the driver raised: it is pulled back by that step too.
    assert np.linalg.norm(arm.pose.position_mm) >= 300 - 1e-9
    assert arm.force_n == 0


def test_a_program_that_is_interrupted_pulls_the_arm_back(arm, sensor, monkeypatch):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr(sensor, "read", interrupted)
    with pytest.raises(KeyboardInterrupt):
        guarded_touch(arm, sensor, START)
    assert_allclose(arm.pose.position_mm, START.position_mm, atol=1e-9)


def test_a_lost_retract_is_sent_again(arm, sensor):
    plain, calls = arm.retract, []

    def lost_once(way_mm):
        calls.append(way_mm)
        if len(calls) == 1:
            raise RobotError("lost")
        plain(way_mm)

    arm.retract = lost_once
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "touched"
    assert record.retracted
    assert "lost" in record.message
    assert not arm.stopped


def test_an_arm_that_will_not_retract_is_stopped_and_its_touch_kept(arm, sensor):
    def never(way_mm):
        raise RobotError("no power")

    arm.retract = never
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "touched"
    assert record.image is not None
    assert not record.retracted
    assert arm.stopped


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"force_n": 0.0}, "force_n must be positive"),
        ({"limit_n": 0.5}, r"limit_n must be above force_n \(0.735\), got 0.5"),
        ({"contact_n": 0.9}, "contact_n must be finite and between -inf and 0.735"),
        ({"stuck_after": 1}, "stuck_after must be at least 3"),
        ({"n_readings": 0}, "n_readings must be at least 1"),
    ],
)
def test_what_guards_nothing_is_refused(parameters, message):
    with pytest.raises(ValueError, match=message):
        Guard(**parameters)
