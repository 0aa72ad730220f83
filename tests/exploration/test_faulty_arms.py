"""Fifty kinds of faulty arms, two stiffnesses, every path that moves an arm.

No force above what is promised goes untold, and no arm is said to be out that is not.
"""

from dataclasses import replace
from types import SimpleNamespace

import faulty_arms
import numpy as np
import pytest
from ball_world import SlowlySure
from faulty_arms import NEAR, PATHS, FaultyArm

from palpate.exploration import (
    Guard,
    RandomHemisphere,
    RobotError,
    check_robot,
    explore,
    gather,
    guarded_touch,
)
from palpate.simulation import SensorPose

# Steps in the air are as long as usual: the promise follows from them.
GUARD = faulty_arms.GUARD = faulty_arms.guard_of(air_step_mm=1.0)
# Met lightly between touches: below the limit a way goes on.
LIGHT = "object beside the way", "object too tall", "object too large"
# Readings that are wrong by a factor, and by an offset: what is promised then.
SHARE = {"reads half": 0.5, "reads a tenth": 0.1}


def ended(arm, path):
    """Return the attempts and what was raised, if anything was."""
    if path == "environment":
        pytest.importorskip("gymnasium", reason='pip install "palpate[sim]"')
    try:
        return PATHS[path](arm), None
    except (RobotError, KeyboardInterrupt, OSError) as error:
        return [], error


def most_in_haste(paths):
    """Return paths; gathering and teaching move as exploring does, and take longest."""
    return [
        pytest.param(path, marks=[pytest.mark.slow] * (path in ("gather", "teach")))
        for path in paths
    ]


# Five times as stiff, the same faults press harder: the softer takes its time.
@pytest.mark.parametrize(
    "stiffness_n_mm", [pytest.param(1.0, marks=pytest.mark.slow), 5.0]
)
@pytest.mark.parametrize("path", most_in_haste(PATHS))
@pytest.mark.parametrize("fault", faulty_arms.FAULTS)
def test_no_force_above_the_promise_goes_untold(fault, path, stiffness_n_mm):
    arm = FaultyArm(fault, stiffness_n_mm)
    attempts, error = ended(arm, path)
    reported = error is not None or any(record.faulty for record in attempts)
    # What the force to stop at, an offset of half a newton, and one step in the air
    # add up to; more must be told.
    quiet_n = (GUARD.force_n + 0.5) / SHARE.get(fault, 1.0)
    quiet_n += stiffness_n_mm * GUARD.air_step_mm
    assert arm.peak_n <= quiet_n or reported
    if path in ("touch", "come out") and fault == "object too large":
        return  # somebody else has put the arm into it
    step_mm = max(GUARD.way_step_mm, GUARD.air_step_mm, 3.5)
    most_n = GUARD.limit_n / SHARE.get(fault, 1.0) + stiffness_n_mm * step_mm
    assert arm.peak_n <= most_n
    if path == "touch" and fault == "neither retracts nor tells":
        return  # what lies about its pose is found before the next way
    if attempts and attempts[-1].retracted and not arm.stopped:
        assert not arm.inside or (arm.force_n <= GUARD.limit_n and fault in LIGHT)


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    "fault",
    [
        "retract does not move",
        "neither retracts nor tells",
        "retract always raises",
        "retracts half",
        "interrupted at every retract",
        "interrupted in contact and when pulled back",
        "stop raises",
    ],
)
def test_an_arm_is_pulled_out_or_stopped_whatever_is_raised(fault, path):
    arm = FaultyArm(fault)
    attempts, _ = ended(arm, path)
    assert arm.stopped or not arm.inside
    # Once an attempt ends without a retreat, so do all after it.
    retracted = [record.retracted for record in attempts]
    assert retracted == sorted(retracted, reverse=True)
    if attempts and arm.inside:
        assert not attempts[-1].retracted
    if path in ("explore", "gather", "teach"):
        assert all(retracted[:-1])  # the episode ends there


@pytest.mark.parametrize(
    ("fault", "stopped"),
    [
        ("interrupted in contact and when pulled back", False),
        ("interrupted at every retract", True),
    ],
)
def test_an_interrupt_goes_on_once_the_arm_is_out_or_stopped(fault, stopped):
    arm = FaultyArm(fault)
    with pytest.raises(KeyboardInterrupt):
        faulty_arms.touching(arm)
    assert arm.inside == arm.stopped == stopped


@pytest.mark.parametrize(
    ("fault", "where"),
    [
        ("parked looking up", r"\(0, 0, 60\) mm.*looks along \(0.00, 0.00, 1.00\)"),
        ("parked looking sideways", r"looks along \(1.00, 0.00, 0.00\)"),
        ("parked below", "below it, so it is not moved"),
    ],
)
@pytest.mark.parametrize("path", ["explore", "gather"])
def test_a_way_out_through_the_object_is_refused_before_any_move(fault, where, path):
    arm = FaultyArm(fault)
    before = arm.pose
    with pytest.raises(RobotError, match=where):
        PATHS[path](arm)
    assert arm.pose is before
    assert "Take it by hand" in str(ended(arm, path)[1])


class InterruptedOnItsWay(FaultyArm):
    """An arm whose driver raises something once it presses, on the way or out."""

    error = KeyboardInterrupt

    def move_to(self, pose):
        self.put(pose)
        if self.force_n > GUARD.limit_n:
            raise self.error

    def retract(self, way_mm):
        super().retract(way_mm)
        raise self.error


def test_whatever_is_raised_on_a_way_the_arm_is_clear_or_stopped():
    arm = InterruptedOnItsWay("object beside the way", 5.0)
    with pytest.raises(KeyboardInterrupt):
        faulty_arms.going_round(arm)
    assert arm.stopped

    class Lost(InterruptedOnItsWay):
        error = OSError

    arm = Lost("object too large", 5.0)
    history = faulty_arms.standing(arm)
    assert arm.stopped
    assert not any(record.retracted for record in history)
    assert "OSError" in history[0].message
    assert "was stopped" in history[0].message


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_an_arm_whose_reading_is_interrupted_on_its_way_is_clear_or_stopped(error):
    class Interrupted(FaultyArm):
        def read_force(self):
            if self.force_n > GUARD.limit_n:
                raise error
            return super().read_force()

    arm = Interrupted("object beside the way", 5.0)
    with pytest.raises((KeyboardInterrupt, RobotError)) as raised:
        faulty_arms.going_round(arm)
    assert arm.force_n > GUARD.limit_n
    assert arm.stopped
    if error is OSError:  # no force was read that could be beyond the limit
        assert raised.value.outcome == "force sensor"


class HeldOnItsWay(FaultyArm):
    """An arm that is held once it presses: it cannot go back."""

    def __init__(self):
        super().__init__("object beside the way", 5.0)
        self.pose = NEAR.pose(3.0, 0.3)

    def move_to(self, pose):
        if self.force_n > GUARD.limit_n:
            raise OSError("brakes")
        self.put(pose)


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
@pytest.mark.parametrize("path", ["way", "come out"])
def test_an_arm_on_its_way_is_stopped_though_stopping_raises_at_first(path, error):
    arm = HeldOnItsWay() if path == "way" else FaultyArm("retract does not move")
    stop = arm.stop

    def raises_at_first():
        arm.stop = stop
        raise error

    arm.stop = raises_at_first
    with pytest.raises((KeyboardInterrupt, RobotError)) as raised:
        PATHS[path](arm)
    assert arm.stopped
    assert (raised.type is KeyboardInterrupt) == (error is KeyboardInterrupt)


class HeldAndNotStopped(HeldOnItsWay):
    """One that cannot be stopped either."""

    def stop(self):
        raise OSError("no power")


@pytest.mark.parametrize("kind", [HeldOnItsWay, HeldAndNotStopped])
def test_an_arm_that_cannot_go_back_on_its_way_is_not_said_to_be_out(kind):
    arm = kind()
    touched = faulty_arms.toucher_of(arm)
    for why in ("did not come back (OSError: brakes)", "before the arm sets out"):
        record = touched(NEAR.pose(1.5, 0.3))
        assert record.outcome == "limit exceeded"
        assert why in record.message
        stopped = "could not be stopped (OSError: no power)"
        assert (stopped in record.message) == (kind is HeldAndNotStopped)
        assert record.peak_force_n > GUARD.limit_n
        assert not record.retracted


def test_an_arm_that_says_nan_for_its_place_is_never_told_to_go_back_by_nan():
    class Lost(FaultyArm):
        ways_mm = ()

        def read_pose(self):
            pose = super().read_pose()
            nowhere = SimpleNamespace(position_mm=[np.nan] * 3)
            return nowhere if self.peak_n else pose

        def retract(self, way_mm):
            self.ways_mm += (way_mm,)
            super().retract(way_mm)

    arm = Lost()
    record = guarded_touch(arm, arm, SensorPose((0, 0, 100), (0, 0, -1)), GUARD)
    assert (record.outcome, record.retracted) == ("robot error", False)
    assert arm.stopped
    assert not arm.inside
    assert arm.ways_mm
    assert np.isfinite(arm.ways_mm).all()


def test_whatever_is_raised_on_the_way_out_the_arm_is_stopped():
    arm = InterruptedOnItsWay("parked in contact")
    with pytest.raises(KeyboardInterrupt):
        faulty_arms.coming_out(arm)
    assert arm.stopped


def test_an_arm_that_met_something_on_its_way_out_and_cannot_say_where_is_stopped():
    class Blind(FaultyArm):
        def read_pose(self):
            if self.inside:
                raise OSError("cable")
            return self.pose

    arm = Blind("", 5.0)
    arm.pose = NEAR.pose(0.3, 0.9).advanced(60)
    arm.ball_mm, arm.radius_mm = np.asarray(NEAR.pose(0.3, 0.9).position_mm), 30.0
    with pytest.raises(OSError, match="cable"):
        faulty_arms.coming_out(arm)
    assert arm.force_n > GUARD.limit_n
    assert arm.stopped


@pytest.mark.parametrize("stiffness_n_mm", [1.0, 5.0])
def test_an_object_on_the_way_out_is_met_lightly(stiffness_n_mm):
    """Something stands behind an arm that is inside the hemisphere."""
    arm = FaultyArm("", stiffness_n_mm)
    arm.pose = NEAR.pose(0.3, 0.9).advanced(60)
    arm.ball_mm, arm.radius_mm = np.asarray(NEAR.pose(0.3, 0.9).position_mm), 30.0
    with pytest.raises(RobotError, match=r"mm are left, with .* N: it was stopped"):
        faulty_arms.coming_out(arm)
    assert arm.stopped
    assert arm.peak_n <= GUARD.limit_n + stiffness_n_mm * GUARD.way_step_mm


def test_a_force_sensor_that_dies_in_contact_on_a_way_is_believed_to_press():
    arm = FaultyArm("no number in contact", 5.0)
    arm.ball_mm, arm.radius_mm = np.array([0.0, 90.0, 60.0]), 30.0
    history = faulty_arms.exploring(arm)
    assert {record.outcome for record in history} <= {"force sensor", "nothing"}
    assert arm.stopped or not arm.inside
    assert arm.peak_n <= 5.0 * GUARD.way_step_mm


class FreezesInContact(FaultyArm):
    """Its force sensor repeats what it read in the air; some hold after some steps."""

    air_n, n_steps, holds_after = 0.0, 0, np.inf

    def read_force(self):
        if not self.inside:
            self.air_n = super().read_force()
        return self.air_n

    def move_to(self, pose):
        if self.n_steps < self.holds_after:
            super().move_to(pose)
        self.n_steps += self.inside


@pytest.mark.parametrize(
    ("lag_readings", "holds_after"), [(0, np.inf), (0, 6), (8, np.inf), (64, np.inf)]
)
def test_a_force_sensor_that_freezes_on_a_way_ends_it(lag_readings, holds_after):
    arm = FreezesInContact()
    arm.ball_mm, arm.radius_mm = np.array([0.0, 90.0, 60.0]), 30.0
    arm.pose, arm.holds_after = NEAR.pose(0.8, 0.6), holds_after
    way = SimpleNamespace(hemisphere=NEAR, next_pose=lambda *_: NEAR.pose(2.3, 0.6))
    guard = replace(GUARD, way_step_mm=0.5, lag_readings=lag_readings)
    end = explore(arm, arm, SlowlySure(), way, guard=guard, max_attempts=1)
    (record,) = end.history
    # One that is held is first found by that.
    is_held = holds_after < np.inf
    assert record.outcome == ("robot error" if is_held else "force sensor")
    assert ("mm from where it was sent" if is_held else "stuck at") in record.message
    # Where it read the air, or else stopped.
    assert (arm.inside, record.retracted, arm.stopped) == (
        is_held,
        not is_held,
        is_held,
    )
    n_steps = guard.stuck_after if lag_readings < guard.stuck_after else 1
    assert arm.peak_n <= arm.stiffness * guard.way_step_mm * n_steps


@pytest.mark.parametrize(
    ("is_in_reach", "stuck_after"),
    [
        (lambda x_mm, y_mm: y_mm < 50, 12),
        (lambda x_mm, y_mm: x_mm > -70, None),
        (lambda x_mm, y_mm: x_mm > -70, 1000),
    ],
)
def test_an_arm_that_is_out_of_reach_on_its_way_is_not_moved_on_from_there(
    is_in_reach, stuck_after
):
    """It stays in silence where it cannot go: the next step was through the ball.

    So was the way back to where a coarse force sensor changed last, at the beginning.
    """

    class Stays(FaultyArm):
        def move_to(self, pose):
            if is_in_reach(*pose.position_mm[:2]):
                super().move_to(pose)

    arm, guard = Stays(), replace(GUARD, stuck_after=stuck_after, lag_readings=0)
    if stuck_after != 12:
        arm.read_force = lambda: round(arm.force_n)
    arm.radius_mm, arm.pose = 70.0, NEAR.pose(0.4, 0.2)
    way = SimpleNamespace(hemisphere=NEAR, next_pose=lambda *_: NEAR.pose(2.7, 0.2))
    end = explore(arm, arm, SlowlySure(), way, guard=guard)
    assert arm.peak_n == 0
    assert len(end.history) == 3
    assert "reached none of the last 3 places" in end.reason
    assert "mm from where it was sent" in end.reason


def test_an_arm_that_stands_in_contact_comes_out_and_goes_on():
    arm = FaultyArm("parked in contact")
    assert [record.outcome for record in faulty_arms.gathering(arm)] == ["touched"] * 4


@pytest.mark.parametrize("stiffness_n_mm", [1.0, 5.0])
@pytest.mark.parametrize("lag", [0, 3, 8, 20, 40, 60])
def test_a_late_force_sensor_is_waited_for(lag, stiffness_n_mm):
    arm = FaultyArm(f"lags by {lag}", stiffness_n_mm)
    # Steps below the limit divided by the stiffness, as `Guard` asks for.
    guard = replace(GUARD, air_step_mm=0.5)
    history = gather(arm, arm, RandomHemisphere(NEAR, 2), guard=guard, n_touches=4)
    assert [record.outcome for record in history] == ["touched"] * 4
    # The force to stop at, and one step in the air.
    assert arm.peak_n <= guard.force_n + 0.5 * stiffness_n_mm + 0.1


def test_a_force_sensor_later_than_is_waited_for_is_refused():
    arm = FaultyArm("lags by 60")
    guard = Guard(lag_readings=20, timeout_s=1e9, max_travel_mm=110.0)
    history = explore(
        arm, arm, SlowlySure(), RandomHemisphere(NEAR, 1), guard=guard, max_attempts=2
    ).history
    assert history[0].faulty


def test_too_small_readings_are_told_where_the_stiffness_is_known():
    arm = FaultyArm("reads a tenth")
    arm.pose = NEAR.pose(0.3, 0.9)
    guard = Guard(max_travel_mm=110.0, expected_n_mm=0.8)
    record = guarded_touch(arm, arm, arm.pose, guard)
    assert record.outcome == "force sensor"
    assert "less than 0.800, half of what expected_n_mm = 0.8 gives" in record.message
    blind = FaultyArm("reads a tenth")
    blind.pose = NEAR.pose(0.3, 0.9)
    guarded_touch(blind, blind, blind.pose, Guard(max_travel_mm=110.0))
    assert blind.peak_n > 1.5 * arm.peak_n


@pytest.mark.parametrize("path", most_in_haste(["explore", "gather"]))
@pytest.mark.parametrize("scene", ["object beside the way", "object too large"])
@pytest.mark.parametrize("fault", ["lags by 8", "lags by 60", "filtered by 0.97"])
def test_a_late_force_is_waited_for_on_ways_too(fault, scene, path):
    arm = FaultyArm(scene, 5.0)
    arm.fault = fault
    attempts, error = ended(arm, path)
    assert error is not None or any(record.faulty for record in attempts)
    assert arm.peak_n <= GUARD.limit_n + 5.0 * GUARD.way_step_mm
    assert not arm.stopped  # it went back, which its late readings show in time


@pytest.mark.parametrize("lag", [1, 3])
def test_a_lag_that_a_step_of_a_touch_covers_is_waited_for_on_ways(lag):
    arm = FaultyArm("object too tall", 5.0)
    arm.fault = f"lags by {lag}"
    options = {"guard": GUARD, "max_attempts": 5}
    end = explore(arm, arm, SlowlySure(), RandomHemisphere(NEAR, 0), **options)
    outcomes = [record.outcome for record in end.history]
    assert outcomes.index("touched") < outcomes.index("limit exceeded")
    assert arm.peak_n <= GUARD.limit_n + 5.0 * GUARD.way_step_mm
    assert not arm.stopped


@pytest.mark.parametrize("look", [(1, 0, 0), (0, 0, -1)])
def test_an_arm_that_looks_another_way_does_not_move_in(look):
    class Locked(FaultyArm):
        """Its wrist does not turn: pulled back, it goes through the ball, or aside."""

        def move_to(self, pose):
            super().move_to(SensorPose(pose.position_mm, look))

    arm, start = Locked(), NEAR.pose(0.0, 0.3)
    arm.pose = SensorPose(start.position_mm, look)
    record = guarded_touch(arm, arm, start, GUARD)
    assert (record.outcome, record.retracted) == ("robot error", True)
    assert "looks another way than it was sent" in record.message
    assert arm.peak_n == 0
    assert np.allclose(arm.pose.position_mm, start.position_mm)


def test_a_load_on_the_way_is_in_the_record():
    arm = FaultyArm("object too large")
    history = faulty_arms.exploring(arm)
    assert {record.outcome for record in history} == {"limit exceeded"}
    assert "on the way to the start" in history[0].message
    assert all(record.retracted for record in history)
    assert arm.peak_n <= GUARD.limit_n + GUARD.way_step_mm


CONTRACT = {
    "no number": "finite in the air",
    "offset of 2": "within 1 N of 0",
    "undershoots": "where it was sent",
    "pose does not change": "where it was sent",
    "retract does not move": "where it was sent",
    "retracts half": "where it was sent",
}


@pytest.mark.parametrize("fault", CONTRACT)
def test_a_driver_that_breaks_the_contract_is_told_how(fault):
    arm = FaultyArm(fault)
    with pytest.raises(AssertionError, match=CONTRACT[fault]):
        check_robot(arm)
    assert arm.peak_n == 0


def test_a_driver_of_two_units_is_not_sent_anywhere():
    class Metres(FaultyArm):
        """Says its place in metres, and is sent in millimetres."""

        def read_pose(self):
            return SensorPose(self.pose.position_mm / 1000, self.pose.direction)

    arm = Metres()
    with pytest.raises(AssertionError, match="where it was sent"):
        check_robot(arm)
    assert arm.peak_n == 0
    assert arm.pose.position_mm.tolist() == [0, 0, 305]  # pulled back, no more


@pytest.mark.parametrize("limit", ["way_mm", "max_miss_mm", "max_offset_n"])
def test_a_limit_that_is_none_is_not_blamed_on_the_driver(limit):
    arm = FaultyArm()
    with pytest.raises(ValueError, match=f"{limit} must be positive"):
        check_robot(arm, **{limit: np.nan})
    assert arm.n == 0


def test_a_driver_that_keeps_the_contract_passes():
    arm = FaultyArm()
    before = arm.pose
    check_robot(arm, stop=False)
    assert np.allclose(arm.pose.position_mm, before.position_mm)
    check_robot(arm)
    assert arm.stopped

    class Single(FaultyArm):
        def read_force(self):
            return np.float32(super().read_force())

    check_robot(Single())

    class Deaf(FaultyArm):
        def stop(self):
            pass

    with pytest.raises(AssertionError, match="must not move"):
        check_robot(Deaf())

    class Late(FaultyArm):
        def move_to(self, pose):
            if self.stopped:
                self.pose = pose
                raise RobotError("stopped")
            super().move_to(pose)

    with pytest.raises(AssertionError, match="must not move"):
        check_robot(Late())

    class Quiet(FaultyArm):
        def read_force(self):
            return 0.25

    with pytest.raises(AssertionError, match="fresh reading"):
        check_robot(Quiet())
    with pytest.raises(AssertionError, match="all methods"):
        check_robot(SensorPose((0, 0, 1), (0, 0, 1)))
