"""Episodes: they end when they should, and go on after anything."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import Touches
from palpate.exploration import (
    EpisodeError,
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

    def __init__(self, after=10**9, answer="ball"):
        self.after, self.answer = after, answer
        self.seen = []

    def start(self):
        return SlowlySure(self.after, self.answer)

    def update(self, touches):
        self.seen.extend(touches.images)

    def decide(self, error):
        return self.answer if len(self.seen) >= self.after else None

    def reason(self, error):
        return f"{len(self.seen)} touches seen."


NEAR = Hemisphere(radius_mm=100)
STRATEGY = RandomHemisphere(NEAR, 1)


@pytest.mark.parametrize("answer", ["ball", "unknown"])
def test_it_stops_when_decided(arm, sensor, answer):
    end = explore(arm, sensor, SlowlySure(4, answer), STRATEGY)
    assert end.decision == answer
    assert end.ended_by == ("unknown" if answer == "unknown" else "decision")
    assert end.n_touches == len(end.history) == 4
    assert end.reason == "4 touches seen."
    assert_allclose(np.linalg.norm(arm.pose.position_mm), 100)


def test_it_stops_when_the_budget_is_spent(arm, sensor):
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
    for image, record in zip(end.belief.seen, end.history, strict=True):
        assert np.array_equal(image, record.image)


def test_the_arm_goes_round_the_object(arm, sensor):
    end = explore(arm, sensor, SlowlySure(), STRATEGY, max_attempts=8)
    lines = {tuple(np.round(record.direction, 9)) for record in end.history}
    for pose in arm.visited:
        inside = np.linalg.norm(pose.position_mm) < 99
        assert not inside or tuple(np.round(pose.direction, 9)) in lines


def test_faults_in_a_row_end_it(arm, sensor, tmp_path):
    arm.read_force = lambda: np.nan
    end = explore(arm, sensor, SlowlySure(), STRATEGY, tmp_path, max_faults=3)
    assert (end.ended_by, len(end.history)) == ("faults", 3)
    assert "3 faults in a row, the last: force sensor" in end.reason
    assert len(read_episode(tmp_path)) == 3


def test_a_fault_now_and_then_does_not(arm, sensor):
    plain = sensor.read

    def every_other():
        plain.__self__.n_asked = getattr(sensor, "n_asked", 0) + 1
        return plain() if sensor.n_asked % 2 else None

    sensor.read = every_other
    end = explore(arm, sensor, SlowlySure(5), STRATEGY, max_faults=2)
    outcomes = [record.outcome for record in end.history]
    assert outcomes == ["touched", "no frame"] * 4 + ["touched"]
    assert end.decision == "ball"


def test_an_arm_that_will_not_retract_ends_it_at_once(arm, sensor, tmp_path):
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
    assert arm.retracts_mm[0] == pytest.approx(60 + 0.735 / 0.2, abs=0.25)


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
    assert len(pieces.belief.seen) == 9
    for one, two in zip(whole.history, pieces.history, strict=True):
        assert one.position_mm == two.position_mm
        assert np.array_equal(one.image, two.image)


def test_a_finished_episode_is_not_touched_again(arm, sensor, tmp_path):
    explore(arm, sensor, SlowlySure(3), STRATEGY, tmp_path)
    arm.visited.clear()
    end = explore(arm, sensor, SlowlySure(3), STRATEGY, tmp_path)
    assert (end.decision, len(end.history), arm.visited) == ("ball", 3, [])


def test_another_strategy_does_not_go_on(arm, sensor, tmp_path):
    explore(arm, sensor, SlowlySure(1), STRATEGY, tmp_path)
    with pytest.raises(EpisodeError, match=r"random_state=1.*random_state=2"):
        explore(arm, sensor, SlowlySure(1), RandomHemisphere(random_state=2), tmp_path)


def test_what_breaks_the_recogniser_loses_no_touch(arm, sensor, tmp_path):
    class Chokes(SlowlySure):
        def start(self):
            return Chokes()

        def update(self, touches):
            raise ValueError("NaN")

    with pytest.raises(ValueError, match="NaN"):
        explore(arm, sensor, Chokes(), STRATEGY, tmp_path)
    assert len(read_episode(tmp_path)) == 1
    assert_allclose(np.linalg.norm(arm.pose.position_mm), 100)


def test_each_attempt_is_told(arm, sensor):
    told = []
    end = explore(
        arm,
        sensor,
        SlowlySure(),
        STRATEGY,
        max_attempts=3,
        on_attempt=lambda record, belief: told.append((record, len(belief.seen))),
    )
    assert [n_seen for _, n_seen in told] == [1, 2, 3]
    assert [record for record, _ in told] == end.history


def test_a_real_recogniser_decides(world):
    arm = world.BallArm()
    sensor = world.BallSensor(arm)
    taught = gather(arm, sensor, RandomHemisphere(NEAR, 2), n_touches=40)
    ball = as_touches(taught, object="ball", geometry="none").images
    images = np.concatenate([ball, ball + np.eye(3)])
    names = ["ball"] * 40 + ["cube"] * 40
    recogniser = ObjectRecogniser().fit(Touches(images, object=names, geometry="none"))
    end = explore(arm, sensor, recogniser, STRATEGY, max_attempts=20)
    assert end.decision == "ball"
    assert end.belief.touches_used == end.n_touches
    assert end.belief.best == "ball"
