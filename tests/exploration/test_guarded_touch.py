"""Guarded touches of a springy ball, where force and depth are known on paper."""

from unittest.mock import Mock

import numpy as np
import pytest
from ball_world import SlowlySure
from numpy.testing import assert_allclose

from palpate.exploration import (
    Guard,
    Hemisphere,
    RandomHemisphere,
    RobotError,
    explore,
    gather,
    guarded_touch,
)
from palpate.sensors import SensorError

START = Hemisphere().pose(0.7, 0.6)


@pytest.mark.parametrize("offset_n", [0.0, -0.6])
def test_a_touch_stops_at_the_force_and_the_arm_comes_back(arm, sensor, offset_n):
    plain = arm.read_force
    arm.read_force = lambda: plain() + offset_n
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


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        pytest.param(lambda force: np.nan, "reads nan", id="nan"),
        pytest.param(lambda force: np.inf, "reads inf", id="infinite"),
        pytest.param(lambda force: 0.03, "stuck at 0.03", id="stuck"),
    ],
)
def test_a_bad_force_sensor_is_found_in_the_air(arm, sensor, reading, message):
    plain = arm.read_force
    arm.read_force = lambda: reading(plain())
    record = guarded_touch(arm, sensor, START)
    assert (record.outcome, record.travel_mm) == ("force sensor", 0)
    assert message in record.message
    assert record.image is None


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        pytest.param(SensorError("Nothing for 2 s."), "Nothing for 2 s.", id="missing"),
        pytest.param(
            OSError(5, "unplugged"), "OSError: [Errno 5] unpl", id="unplugged"
        ),
        pytest.param([[1.0], [2.0, 3.0]], "ValueError: setting an array", id="ragged"),
        pytest.param(np.zeros((4, 3)), "(4, 3) and type float64", id="wrong size"),
        pytest.param(None, "() and type object arrived, not (3, 3)", id="None"),
        pytest.param(np.full((3, 3), "a"), "and type <U1 arrived", id="text"),
        pytest.param(np.full((3, 3), 1j), "and type complex128 arrived", id="complex"),
        pytest.param(np.full((3, 3), np.nan), "or of NaN alone", id="NaN alone"),
        pytest.param(np.diag([0.0, np.inf, 0.0]), "with infinity", id="infinity"),
    ],
)
def test_a_missing_or_strange_frame_is_a_fault(arm, frame, message):
    sensor = Mock(image_shape=(3, 3), read=Mock(side_effect=[frame]))
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "no frame"
    assert message in record.message
    assert record.image is None
    assert record.force_n >= 0.735
    assert_allclose(arm.pose.position_mm, START.position_mm, atol=1e-9)


def test_dead_taxels_are_no_fault(arm, sensor, monkeypatch):
    monkeypatch.setattr(sensor, "read", lambda: np.diag([1.0, np.nan, 1.0]))
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "touched"
    assert np.isnan(record.image).sum() == 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"robot": Mock(spec=["move_to", "read_pose", "read_force"])}, "retract, stop"),
        ({"robot": None}, "robot must have .* got NoneType without move_to"),
        ({"sensor": None}, "sensor must have image_shape, read, got NoneType"),
        ({"guard": 3.0}, r"guard must be a Guard, got 3.0. Write Guard\("),
        ({"strategy": Hemisphere()}, "got Hemisphere without hemisphere, next_pose"),
        ({"recogniser": None}, "recogniser must have start, got NoneType"),
        ({"start": (0, 0, 300)}, "start must be a SensorPose, got tuple"),
    ],
)
def test_what_is_no_arm_or_lacks_a_method_is_not_moved(arm, sensor, given, message):
    # Missed in contact alone, `retract` and `stop` would leave the arm pressing.
    arms = {"robot": arm, "sensor": sensor}
    strategy, learnt = {"strategy": RandomHemisphere()}, {"recogniser": SlowlySure()}
    calls = {
        guarded_touch: {**arms, "start": START},
        gather: {**arms, **strategy},
        explore: {**arms, **strategy, **learnt},
    }
    for call, arguments in calls.items():
        if {*given} <= {*arguments, "guard"}:
            with pytest.raises(TypeError, match=message):
                call(**{**arguments, **given})
    assert arm.visited == arm.retracts_mm == []
    assert arm.n_read == 0


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


@pytest.mark.parametrize("raises", [True, False])
def test_an_arm_that_does_not_get_to_the_start_is_not_pulled_back(arm, sensor, raises):
    def stays(pose):
        if raises:
            raise RobotError("joint 3 at its limit")

    # On the other side: far inward of the start, were it on the line.
    arm.move_to, arm.pose = stays, Hemisphere().pose(np.pi, 0.3)
    place = np.array(arm.pose.position_mm)
    record = guarded_touch(arm, sensor, Hemisphere().pose(0.0, 0.3))
    assert (record.outcome, record.retracted) == ("robot error", True)
    assert arm.retracts_mm == [0.0]
    assert_allclose(arm.pose.position_mm, place)
    assert not arm.stopped


def test_a_start_on_the_other_side_of_the_object_is_not_gone_to_through_it(arm, sensor):
    arm.stiffness_n_mm, arm.pose = 5.0, Hemisphere().pose(np.pi, 0.1)
    place = np.array(arm.pose.position_mm)
    record = guarded_touch(arm, sensor, Hemisphere().pose(0.0, 0.1))
    assert (record.outcome, record.retracted) == ("limit exceeded", True)
    assert "N on the straight way to the start" in record.message
    assert record.peak_force_n > Guard().limit_n
    pressed_mm = [40 - np.linalg.norm(pose.position_mm) for pose in arm.visited]
    assert 0 < max(pressed_mm) < Guard().limit_n / 5 + Guard().way_step_mm
    assert_allclose(arm.pose.position_mm, place)
    # One that jams once it presses did not come back, and is stopped.
    move_to = arm.move_to
    arm.move_to = lambda pose: arm.force_n or move_to(pose)
    record = guarded_touch(arm, sensor, Hemisphere().pose(0.0, 0.1))
    assert (record.retracted, arm.stopped) == (False, True)
    assert "The arm was stopped." in record.message


def test_a_start_within_the_object_is_left_again(arm, sensor):
    arm.stiffness_n_mm, start = 5.0, Hemisphere(radius_mm=39).pose(0.0, 0.1)
    arm.pose = before = Hemisphere(radius_mm=55).pose(0.0, 0.1)
    record = guarded_touch(arm, sensor, start)
    assert (record.outcome, record.retracted) == ("limit exceeded", True)
    assert_allclose(arm.pose.position_mm, before.position_mm)
    # An interrupt meanwhile does not leave it there.
    move_to = arm.move_to

    def interrupted(pose):
        if arm.force_n:
            raise KeyboardInterrupt
        move_to(pose)

    arm.move_to = interrupted
    with pytest.raises(KeyboardInterrupt):
        guarded_touch(arm, sensor, start)
    assert arm.stopped


@pytest.mark.parametrize(
    ("method", "error", "why"),
    [
        ("retract", OSError("lost"), "lost"),
        ("read_pose", TimeoutError(), "TimeoutError"),
    ],
)
def test_an_error_after_the_arm_came_back_takes_it_no_further(
    arm, sensor, method, error, why
):
    plain, errors = getattr(arm, method), [error]

    def breaks(*args):
        result = plain(*args)
        if arm.retracts_mm and errors:
            raise errors.pop()
        return result

    setattr(arm, method, breaks)
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "touched"
    assert record.retracted
    assert record.message == f"Retracting failed (1): {why}"
    assert_allclose(arm.pose.position_mm, START.position_mm, atol=1e-9)


def test_an_arm_that_only_says_that_it_came_out_is_stopped(arm, sensor):
    places = []
    arm.retract = lambda way_mm: places.append(arm.pose.advanced(-way_mm))
    arm.read_pose = lambda: places[-1] if places else arm.pose
    record = guarded_touch(arm, sensor, START)
    assert record.outcome == "robot error"
    assert record.message.startswith("The arm was stopped. ")
    assert "did not come out, whatever it says." in record.message
    assert arm.stopped
    assert not record.retracted
    # Stopping it can be interrupted too: it is tried again, and the interrupt goes on.
    arm.pose, arm.stopped, stop = START, False, arm.stop
    places.clear()

    def interrupted_once():
        arm.stop = stop
        raise KeyboardInterrupt

    arm.stop = interrupted_once
    with pytest.raises(KeyboardInterrupt):
        guarded_touch(arm, sensor, START)
    assert arm.stopped
