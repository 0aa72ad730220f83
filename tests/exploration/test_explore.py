"""Episodes end when they should, and go on after anything."""

from types import SimpleNamespace

import numpy as np
import pytest
from ball_world import BallSensor, SlowlySure
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


def test_an_episode_stops_when_its_budget_is_spent(arm, sensor, tmp_path):
    arms = arm, sensor, SlowlySure(), STRATEGY, tmp_path
    for budget in (3, 2):  # of one that is longer it is told how long it is
        end = explore(*arms, max_attempts=budget)
        assert (end.decision, end.ended_by, end.n_touches) == (None, "budget", 3)
        assert end.reason.startswith("3 attempts made.")


def test_nothing_counts_against_the_budget_but_not_for_the_belief(arm, sensor):
    arm.radius_mm = 0.0
    end = explore(arm, sensor, SlowlySure(1), STRATEGY, max_attempts=5)
    assert (end.ended_by, end.n_touches) == ("budget", 0)
    assert [record.outcome for record in end.history] == ["nothing"] * 5


def test_the_arm_goes_round_the_object(arm, sensor):
    end = explore(arm, sensor, SlowlySure(), STRATEGY, max_attempts=8)
    lines = {tuple(np.round(record.direction, 9)) for record in end.history}
    for pose in arm.visited:
        inside = np.linalg.norm(pose.position_mm) < 99
        assert not inside or tuple(np.round(pose.direction, 9)) in lines


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


def test_a_hemisphere_that_the_arm_cannot_reach_is_said_in_one_sentence(arm, sensor):
    def short(pose):
        raise RuntimeError("joint 3 at its limit")

    arm.move_to = short
    strategy = RandomHemisphere(Hemisphere(radius_mm=150), 1)
    end = explore(arm, sensor, SlowlySure(), strategy, max_attempts=9)
    assert end.ended_by == "faults"
    assert "reached none of the last 3 places of the hemisphere of 150 mm" in end.reason
    assert "joint 3 at its limit" in end.reason


def test_an_arm_that_will_not_retract_ends_an_episode_at_once(arm, sensor, tmp_path):
    def never(way_mm):
        raise RobotError("no power")

    plain, arm.retract = arm.retract, never
    end = explore(arm, sensor, SlowlySure(2), STRATEGY, tmp_path)
    assert (end.ended_by, end.n_touches) == ("faults", 1)
    assert "would not retract" in end.reason
    assert "The arm was stopped." in end.reason
    assert arm.stopped
    # Someone has mended it: the episode goes on, its one touch counts, and first of
    # all the arm comes out of the hemisphere.
    arm.retract = plain
    end = explore(arm, sensor, SlowlySure(2), STRATEGY, tmp_path)
    assert (end.decision, end.n_touches) == ("ball", 2)
    n_steps = int(np.ceil((60 + 0.735 / 0.2) / Guard().way_step_mm))
    out_mm = sum(arm.retracts_mm[:n_steps])
    assert out_mm == pytest.approx(60 + 0.735 / 0.2, abs=0.25)


def test_an_arm_that_was_lost_in_contact_is_not_said_to_be_stopped(arm, sensor):
    def lost(*_):
        raise ConnectionError("no route to host")

    arm.retract = arm.stop = lost
    end = explore(arm, sensor, SlowlySure(2), STRATEGY)
    assert (end.ended_by, len(end.history)) == ("faults", 1)
    assert "could not be stopped (ConnectionError: no route to host)" in end.reason
    assert "was stopped" not in end.reason


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
def test_an_episode_in_pieces_is_the_whole_episode(tmp_path, strategy):
    def run(folder, budget):
        sensor = BallSensor()
        robot = sensor.arm, sensor
        return explore(*robot, SlowlySure(), strategy, folder, max_attempts=budget)

    whole = run(None, 9)
    for budget in (2, 3, 7, 9):
        pieces = run(tmp_path, budget)
    images = pieces.belief.images
    for record, in_pieces, image in zip(
        whole.history, pieces.history, images, strict=True
    ):
        assert record.position_mm == in_pieces.position_mm
        assert np.array_equal(record.image, in_pieces.image)
        assert np.array_equal(record.image, image)


@pytest.mark.parametrize(
    ("pose", "error", "message"),
    [
        (None, TypeError, "must return a SensorPose, got NoneType"),
        (NEAR.pose(0.3, 0.9).advanced(60), ValueError, "must return a pose on Hemi"),
        (NEAR.pose(0.3, -0.5), ValueError, r"got one at \(84, 26, -48\) mm"),
    ],
    ids=["none", "inside", "below"],
)
def test_a_strategy_of_ones_own_sends_no_arm_inside_the_hemisphere(
    arm, sensor, pose, error, message
):
    strategy = SimpleNamespace(hemisphere=NEAR, next_pose=lambda belief, history: pose)
    with pytest.raises(error, match=message):
        explore(arm, sensor, SlowlySure(), strategy)
    with pytest.raises(error, match=message):
        gather(arm, sensor, strategy)
    assert arm.visited == []


def test_an_error_that_is_none_begins_no_folder(arm, sensor, recogniser, tmp_path):
    with pytest.raises(ValueError, match="error must be"):
        explore(arm, sensor, recogniser, STRATEGY, tmp_path / "new", error=2.0)
    assert list(tmp_path.iterdir()) == []
    assert arm.visited == []


def test_a_finished_episode_is_not_touched_again(arm, sensor, tmp_path):
    explore(arm, sensor, SlowlySure(3), STRATEGY, tmp_path)
    arm.visited.clear()
    end = explore(arm, sensor, SlowlySure(3), STRATEGY, tmp_path)
    assert (end.decision, len(end.history), arm.visited) == ("ball", 3, [])


def test_another_strategy_does_not_go_on(arm, sensor, tmp_path):
    explore(arm, sensor, SlowlySure(1), STRATEGY, tmp_path)
    with pytest.raises(ValueError, match=r"random_state=1.*random_state=2"):
        explore(arm, sensor, SlowlySure(1), RandomHemisphere(random_state=2), tmp_path)


class RoundAndRound:
    """A strategy of one's own, which has no repr."""

    hemisphere = NEAR

    def next_pose(self, belief, history):
        return NEAR.pose(len(history), 0.9)


def test_an_episode_by_a_strategy_of_ones_own_goes_on(arm, sensor, tmp_path):
    mine, of_another_run = RoundAndRound(), RoundAndRound()
    explore(arm, sensor, SlowlySure(3), mine, tmp_path, max_attempts=2)
    end = explore(arm, sensor, SlowlySure(3), of_another_run, tmp_path)
    assert (end.decision, len(end.history)) == ("ball", 3)


@pytest.mark.parametrize(("side", "n_touches"), [(48, 5), (49, 1)])
def test_a_camera_that_hangs_is_not_believed_again_and_again(
    arm, sensor, side, n_touches
):
    """Of a camera no two pictures are the same; of a small array some are."""
    sensor.image_shape = (side, side)
    frame = np.pad([[np.nan]], (0, side - 1), constant_values=1.0)  # one pixel is dead
    sensor.read = lambda: frame
    end = explore(arm, sensor, SlowlySure(5), STRATEGY)
    assert end.n_touches == len(end.belief.images) == n_touches
    repeats = "no frame. The frame is that of the touch before, pixel for pixel"
    assert (repeats in end.reason) == (end.ended_by == "faults") == (n_touches == 1)


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


def test_faults_in_a_row_end_an_episode_each_time_it_goes_on(arm, sensor, tmp_path):
    class Broken(SlowlySure):
        def update(self, touches):
            raise ZeroDivisionError("bug")

    for n_attempts in (3, 6):
        end = explore(arm, sensor, Broken(), STRATEGY, tmp_path)
        assert (end.ended_by, len(end.history)) == ("faults", n_attempts)
        assert "3 faults in a row, the last: no frame. " in end.reason
        assert "ZeroDivisionError: bug" in end.reason
        assert len(read_episode(tmp_path)) == n_attempts
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


def test_touches_recorded_for_another_recogniser_do_not_stop_an_episode(
    sensor, tmp_path, knows_the_ball
):
    sensor.image_shape, sensor.read = (5, 4), lambda: np.ones((5, 4))
    explore(sensor.arm, sensor, SlowlySure(2), STRATEGY, tmp_path)
    sensor = BallSensor()
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
def knows_the_ball():
    """A recogniser of the ball and a cube that differs everywhere."""
    sensor, strategy = BallSensor(), RandomHemisphere(NEAR, 2)
    taught = gather(sensor.arm, sensor, strategy, n_touches=40)
    ball = as_touches(taught, object="ball", geometry="none").images
    images = np.concatenate([ball, ball + np.eye(3)])
    names = ["ball"] * 40 + ["cube"] * 40
    return ObjectRecogniser().fit(Touches(images, object=names, geometry="none"))


def test_a_folder_that_holds_more_touches_gives_those_that_were_asked_for(tmp_path):
    def run(n_touches, folder=tmp_path, size=None):
        sensor = BallSensor()
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


def test_attempts_after_the_last_touch_that_is_wanted_are_left_out(
    arm, sensor, tmp_path
):
    plain = arm.read_force
    gather(arm, sensor, STRATEGY, tmp_path, n_touches=2)
    arm.read_force = lambda: np.nan
    with pytest.raises(RobotError):
        gather(arm, sensor, STRATEGY, tmp_path, n_touches=3)
    arm.read_force = plain
    assert len(gather(arm, sensor, STRATEGY, tmp_path, n_touches=2)) == 2
    kept = gather(arm, sensor, STRATEGY, tmp_path, n_touches=3)
    assert [record.touched for record in kept] == [True] * 2 + [False] * 3 + [True]
