"""Episodes end when they should, and go on after anything."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.exploration import (
    Guard,
    Hemisphere,
    RandomHemisphere,
    Raster,
    RobotError,
    as_touches,
    explore,
    gather,
    read_episode,
)
from palpate.recognition import ObjectRecogniser


class SlowlySure:
    """A recogniser and its belief: sure of "ball" after a number of touches."""

    def __init__(self, after=10**9, answer="ball", refusal=None):
        self.after, self.answer, self.refusal = after, answer, refusal
        self.images = []

    def start(self):
        return type(self)(self.after, self.answer, self.refusal)

    def update(self, touches):
        self.images.extend(touches.images)

    def decide(self, error, refusal):
        assert refusal == self.refusal
        return self.answer if len(self.images) >= self.after else None

    def reason(self, error, refusal):
        assert refusal == self.refusal
        return f"{len(self.images)} touches seen."


NEAR = Hemisphere(radius_mm=100)
STRATEGY = RandomHemisphere(NEAR, 1)


@pytest.mark.parametrize("answer", ["ball", "unknown"])
def test_an_episode_stops_when_decided(arm, sensor, answer):
    end = explore(arm, sensor, SlowlySure(4, answer), STRATEGY)
    assert end.decision == answer
    assert end.ended_by == ("unknown" if answer == "unknown" else "decision")
    assert end.n_touches == len(end.history) == 4
    assert end.reason == "4 touches seen."
    assert_allclose(np.linalg.norm(arm.pose.position_mm), 100)


def test_the_refusal_is_what_was_asked_for(arm, sensor):
    recogniser = SlowlySure(2, refusal=0.2)
    assert explore(arm, sensor, recogniser, STRATEGY, refusal=0.2).decision == "ball"
    recogniser = SlowlySure(refusal=0.2)
    with pytest.raises(AssertionError):
        explore(arm, sensor, recogniser, STRATEGY, max_attempts=1)


def test_an_episode_stops_when_its_budget_is_spent(arm, sensor):
    end = explore(arm, sensor, SlowlySure(), STRATEGY, max_attempts=6)
    assert (end.decision, end.ended_by, end.n_touches) == (None, "budget", 6)
    assert "6 attempts" in end.reason


def test_nothing_counts_against_the_budget_but_not_for_the_belief(world):
    arm = world.BallArm(radius_mm=0.0)
    end = explore(arm, world.BallSensor(arm), SlowlySure(1), STRATEGY, max_attempts=5)
    assert (end.ended_by, end.n_touches) == ("budget", 0)
    assert [record.outcome for record in end.history] == ["nothing"] * 5


def test_the_belief_takes_in_every_touch_in_order(arm, sensor):
    end = explore(arm, sensor, SlowlySure(), STRATEGY, max_attempts=3)
    for image, record in zip(end.belief.images, end.history, strict=True):
        assert np.array_equal(image, record.image)


def test_the_arm_goes_round_the_object(arm, sensor):
    end = explore(arm, sensor, SlowlySure(), STRATEGY, max_attempts=8)
    lines = {tuple(np.round(record.direction, 9)) for record in end.history}
    for pose in arm.visited:
        inside = np.linalg.norm(pose.position_mm) < 99
        assert not inside or tuple(np.round(pose.direction, 9)) in lines


def test_faults_in_a_row_end_an_episode(arm, sensor, tmp_path):
    arm.read_force = lambda: np.nan
    end = explore(arm, sensor, SlowlySure(), STRATEGY, tmp_path, max_faults=3)
    assert (end.ended_by, len(end.history)) == ("faults", 3)
    assert "3 faults in a row, the last: force sensor" in end.reason
    assert len(read_episode(tmp_path)) == 3


def test_a_fault_now_and_then_does_not_end_an_episode(arm, sensor):
    plain = sensor.read

    def every_other():
        plain.__self__.n_asked = getattr(sensor, "n_asked", 0) + 1
        return plain() if sensor.n_asked % 2 else None

    sensor.read = every_other
    end = explore(arm, sensor, SlowlySure(5), STRATEGY, max_faults=2)
    outcomes = [record.outcome for record in end.history]
    assert outcomes == ["touched", "no frame"] * 4 + ["touched"]
    assert end.decision == "ball"


def test_an_arm_that_will_not_retract_ends_an_episode_at_once(arm, sensor, tmp_path):
    def never(way_mm):
        raise RobotError("no power")

    plain, arm.retract = arm.retract, never
    end = explore(arm, sensor, SlowlySure(2), STRATEGY, tmp_path)
    assert (end.ended_by, end.n_touches) == ("faults", 1)
    assert "would not retract" in end.reason
    assert arm.stopped
    # Someone has mended it: the episode goes on, its one touch counts, and first of
    # all the arm comes out of the hemisphere.
    arm.retract = plain
    end = explore(arm, sensor, SlowlySure(2), STRATEGY, tmp_path)
    assert (end.decision, end.n_touches) == ("ball", 2)
    n_steps = int(np.ceil((60 + 0.735 / 0.2) / Guard().way_step_mm))
    out_mm = sum(arm.retracts_mm[:n_steps])
    assert out_mm == pytest.approx(60 + 0.735 / 0.2, abs=0.25)


def test_a_way_that_fails_is_recorded(arm, sensor):
    plain = arm.move_to

    def blocked(pose):
        if len(arm.visited) == 3:
            arm.visited.append(pose)
            raise OSError("cable")
        plain(pose)

    arm.move_to = blocked
    end = explore(arm, sensor, SlowlySure(), STRATEGY, max_attempts=2)
    assert [record.outcome for record in end.history] == ["robot error", "touched"]
    assert "On the way to the start: OSError: cable" in end.history[0].message


@pytest.mark.parametrize("strategy", [STRATEGY, Raster(NEAR)], ids=["random", "raster"])
def test_an_episode_in_pieces_is_the_whole_episode(world, tmp_path, strategy):
    def run(folder, budget):
        arm = world.BallArm()
        sensor = world.BallSensor(arm)
        return explore(arm, sensor, SlowlySure(), strategy, folder, max_attempts=budget)

    whole = run(None, 9)
    for budget in (2, 3, 7, 9):
        pieces = run(tmp_path, budget)
    assert len(pieces.belief.images) == 9
    for record, in_pieces in zip(whole.history, pieces.history, strict=True):
        assert record.position_mm == in_pieces.position_mm
        assert np.array_equal(record.image, in_pieces.image)


def test_a_finished_episode_is_not_touched_again(arm, sensor, tmp_path):
    explore(arm, sensor, SlowlySure(3), STRATEGY, tmp_path)
    arm.visited.clear()
    end = explore(arm, sensor, SlowlySure(3), STRATEGY, tmp_path)
    assert (end.decision, len(end.history), arm.visited) == ("ball", 3, [])


def test_another_strategy_does_not_go_on(arm, sensor, tmp_path):
    explore(arm, sensor, SlowlySure(1), STRATEGY, tmp_path)
    with pytest.raises(ValueError, match=r"random_state=1.*random_state=2"):
        explore(arm, sensor, SlowlySure(1), RandomHemisphere(random_state=2), tmp_path)


class Chokes(SlowlySure):
    """Refuses frames whose corner is above 0.3."""

    def update(self, touches):
        if touches.images[0, 0, 0] > 0.3:
            raise ValueError("too bright")
        super().update(touches)


def test_a_touch_that_the_recogniser_refuses_is_no_frame_and_ends_nothing(
    arm, sensor, tmp_path
):
    end = explore(arm, sensor, Chokes(2), Raster(NEAR), tmp_path, max_faults=20)
    bright = [record.image[0, 0] > 0.3 for record in end.history]
    assert [record.outcome == "no frame" for record in end.history] == bright
    assert any(bright)
    assert (end.decision, end.n_touches) == ("ball", 2)
    fault = end.history[bright.index(True)]
    assert "cannot take this frame: ValueError: too bright" in fault.message
    # The disk holds the same records, with the frame that was refused.
    for restored, record in zip(read_episode(tmp_path), end.history, strict=True):
        assert restored.to_dict() == record.to_dict()
        assert np.array_equal(restored.image, record.image)


def test_a_recogniser_that_takes_nothing_ends_as_faults(arm, sensor, tmp_path):
    class Broken(SlowlySure):
        def update(self, touches):
            raise ZeroDivisionError("bug")

    for n_attempts in (3, 6):
        end = explore(arm, sensor, Broken(), STRATEGY, tmp_path)
        assert (end.ended_by, len(end.history)) == ("faults", n_attempts)
        assert "ZeroDivisionError: bug" in end.reason
    assert_allclose(np.linalg.norm(arm.pose.position_mm), 100)


def test_interrupted_while_the_belief_is_updated_no_touch_is_lost(
    arm, sensor, tmp_path
):
    class Interrupted(SlowlySure):
        def update(self, touches):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        explore(arm, sensor, Interrupted(), STRATEGY, tmp_path)
    assert [record.outcome for record in read_episode(tmp_path)] == ["touched"]


@pytest.mark.parametrize("bad", [np.nan, np.inf, "size"])
def test_after_bad_frames_an_episode_goes_on(world, tmp_path, knows_the_ball, bad):
    def run(sensor):
        strategy = RandomHemisphere(NEAR, 1)
        return explore(sensor.arm, sensor, knows_the_ball, strategy, tmp_path)

    sensor = world.BallSensor(world.BallArm())
    if bad == "size":
        sensor.image_shape, sensor.read = (5, 4), lambda: np.ones((5, 4))
    else:
        sensor.read = lambda: np.full((3, 3), bad)
    end = run(sensor)
    assert (end.ended_by, end.n_touches) == ("faults", 0)
    outcomes = [record.outcome for record in read_episode(tmp_path)]
    assert outcomes == ["no frame"] * 3
    end = run(world.BallSensor(world.BallArm()))
    assert end.decision == "ball"
    assert len(end.history) == 3 + end.n_touches == 3 + end.belief.touches_used


def test_touches_recorded_for_another_recogniser_do_not_stop_an_episode(
    world, tmp_path, knows_the_ball
):
    sensor = world.BallSensor(world.BallArm())
    sensor.image_shape, sensor.read = (5, 4), lambda: np.ones((5, 4))
    explore(sensor.arm, sensor, SlowlySure(2), STRATEGY, tmp_path)
    sensor = world.BallSensor(world.BallArm())
    end = explore(sensor.arm, sensor, knows_the_ball, STRATEGY, tmp_path)
    assert end.decision == "ball"
    assert [record.outcome for record in end.history[:2]] == ["no frame"] * 2
    assert "5 x 4" in end.history[0].message
    # What was written stays as it was.
    kept = read_episode(tmp_path)[:2]
    assert [record.outcome for record in kept] == ["touched"] * 2


def test_each_attempt_is_passed_on_with_the_belief(arm, sensor):
    attempts = []
    end = explore(
        arm,
        sensor,
        SlowlySure(),
        STRATEGY,
        max_attempts=3,
        on_attempt=lambda record, belief: attempts.append((record, len(belief.images))),
    )
    assert [n_seen for _, n_seen in attempts] == [1, 2, 3]
    assert [record for record, _ in attempts] == end.history


@pytest.fixture(scope="module")
def knows_the_ball(world):
    """A recogniser of the ball and a cube that differs everywhere."""
    sensor = world.BallSensor(world.BallArm())
    strategy = RandomHemisphere(NEAR, 2)
    taught = gather(sensor.arm, sensor, strategy, n_touches=40)
    ball = as_touches(taught, object="ball", geometry="none").images
    images = np.concatenate([ball, ball + np.eye(3)])
    names = ["ball"] * 40 + ["cube"] * 40
    return ObjectRecogniser().fit(Touches(images, object=names, geometry="none"))


def test_a_folder_that_holds_more_touches_gives_those_that_were_asked_for(
    world, tmp_path
):
    def run(n_touches, folder=tmp_path, size=None):
        sensor = world.BallSensor(world.BallArm(radius_mm=40.0))
        if size is not None:
            sensor.image_shape = size
        return gather(sensor.arm, sensor, STRATEGY, folder, n_touches=n_touches)

    more, fewer, anew = run(7), run(4), run(4, None)
    assert len(more) == 7
    for stored, fresh in zip(fewer, anew, strict=True):
        assert stored.position_mm == fresh.position_mm
    assert len(read_episode(tmp_path)) == 7
    with pytest.raises(ValueError, match=r"of 5 x 4 taxels.*got \(3, 3\) in att"):
        run(9, size=(5, 4))


def test_attempts_after_the_last_touch_that_is_wanted_are_left_out(world, tmp_path):
    arm = world.BallArm()
    sensor, plain = world.BallSensor(arm), arm.read_force
    gather(arm, sensor, STRATEGY, tmp_path, n_touches=2)
    arm.read_force = lambda: np.nan
    with pytest.raises(RobotError):
        gather(arm, sensor, STRATEGY, tmp_path, n_touches=3)
    arm.read_force = plain
    assert len(gather(arm, sensor, STRATEGY, tmp_path, n_touches=2)) == 2
    kept = gather(arm, sensor, STRATEGY, tmp_path, n_touches=3)
    assert [record.touched for record in kept] == [True] * 2 + [False] * 3 + [True]
