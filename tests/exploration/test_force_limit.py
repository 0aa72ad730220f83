"""No force sensor, however wrong, lets the arm press harder than `Guard` promises.

A wall of springs stands across a straight line, so the true force is known on paper at
every moment; the force sensor is wrong in every way that can be combined.
"""

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

from palpate.exploration import Guard, guarded_touch
from palpate.simulation import SensorPose

START = SensorPose((0, 0, 0), (0, 0, 1))
GUARD = Guard(max_travel_mm=40)
quick = settings(
    derandomize=True,
    max_examples=80,
    deadline=None,
    database=None,
    phases=(Phase.explicit, Phase.generate),
)


class SpringWall:
    """An exact arm before a wall, and a force sensor as bad as one likes.

    What the sensor says is sign x scale x force, `delay` readings late, plus an offset
    that drifts with every reading, plus noise, rounded to `quantum`. From the moment
    that the force reaches `sticks_at_n` it says `stuck_n` (None: its last word), plus
    `stuck_noise_n`.
    """

    def __init__(self, wall_mm=10.3, stiffness=1.0, **wrong):
        self.wall_mm, self.stiffness = wall_mm, stiffness
        self.sign, self.scale = wrong.pop("sign", 1), wrong.pop("scale", 1.0)
        self.offset, self.drift = wrong.pop("offset", 0.05), wrong.pop("drift", 0.0)
        self.delay, self.noise = wrong.pop("delay", 0), wrong.pop("noise", 1e-4)
        self.quantum = wrong.pop("quantum", 0.0)
        self.sticks_at_n = wrong.pop("sticks_at_n", np.inf)
        self.stuck_n = wrong.pop("stuck_n", None)
        self.stuck_noise_n = wrong.pop("stuck_noise_n", 0.0)
        assert not wrong, wrong
        self.rng = np.random.default_rng(0)
        self.reading_n, self.late = 0.0, []
        self.pose, self.n_read = START, 0
        self.n_retracts, self.steps = 0, []
        self.stuck_depth_mm = None

    @property
    def travel_mm(self):
        return float(self.pose.position_mm[2])

    @property
    def depth_mm(self):
        return max(self.travel_mm - self.wall_mm, 0.0)

    @property
    def force_n(self):
        return self.stiffness * self.depth_mm

    @property
    def peak_n(self):
        return max((force for _, force in self.steps), default=0.0)

    def move_to(self, pose):
        before = self.travel_mm
        self.pose = pose
        self.steps.append((self.travel_mm - before, self.force_n))

    def read_pose(self):
        return self.pose

    def read_force(self):
        self.n_read += 1
        self.late.append(self.sign * self.scale * self.force_n)
        noise = self.rng.standard_normal()
        if self.force_n >= self.sticks_at_n or self.stuck_depth_mm is not None:
            if self.stuck_depth_mm is None:
                self.stuck_depth_mm = self.depth_mm
                if self.stuck_n is None:
                    self.stuck_n = self.reading_n
            return self.stuck_n + self.stuck_noise_n * noise
        force = self.late[max(len(self.late) - 1 - self.delay, 0)]
        self.reading_n = (
            force + self.offset + self.drift * self.n_read + self.noise * noise
        )
        if self.quantum:
            self.reading_n = round(self.reading_n / self.quantum) * self.quantum
        return self.reading_n

    def retract(self, way_mm):
        self.n_retracts += 1
        self.pose = self.pose.advanced(-way_mm)

    def stop(self):
        pass


class Skin:
    """A sensor whose picture of 4 x 4 brightens by 10 levels a newton, truly."""

    image_shape = (4, 4)
    geometry = "none"

    def __init__(self, arm):
        self.arm, self.n_read = arm, 0

    def read(self):
        self.n_read += 1
        return np.full((4, 4), 10.0 * self.arm.force_n)

    def no_contact(self):
        return None


def touch(arm, guard=GUARD):
    record = guarded_touch(arm, Skin(arm), START, guard)
    assert arm.n_retracts == 1
    assert arm.travel_mm <= 1e-9
    assert arm.force_n == 0
    # No outcome but those that an episode can be read back with.
    assert type(record).from_dict(record.to_dict(), None).outcome == record.outcome
    return record


stiffnesses = st.floats(-2, 2).map(lambda power: 10.0**power)
following = st.fixed_dictionaries(
    {
        "wall_mm": st.floats(1.2, 39),
        "stiffness": stiffnesses,
        "sign": st.sampled_from([1, -1]),
        "scale": st.floats(0.5, 2),
        "offset": st.floats(-0.9, 0.9),
        # Up to 0.45 N over the longest approaches of this world, 900 readings.
        "drift": st.floats(-5e-4, 5e-4),
        "delay": st.integers(0, 3),
        "noise": st.floats(1e-6, 0.02),
    }
)


def assert_bounded(arm, limit_n=GUARD.limit_n):
    """The limit, and what the very step that passed it adds."""
    for step_mm, force_n in arm.steps:
        assert force_n <= limit_n + arm.stiffness * max(step_mm, 0) + 1e-9


@quick
@given(following)
@example({"stiffness": 100.0, "delay": 3, "scale": 0.5})
@example({"stiffness": 3.0, "delay": 3, "scale": 0.5, "wall_mm": 10.9})
@example({"sign": -1, "stiffness": 0.05})
@example({"sign": -1, "stiffness": 100.0, "delay": 3})
@example({"drift": -5e-4, "stiffness": 0.02})
def test_the_true_force_passes_the_limit_by_one_step_at_most(world):
    arm = SpringWall(**world)
    record = touch(arm)
    assert_bounded(arm)
    if record.outcome == "nothing":
        # Twice contact_n (of the readings, and of the offset afterwards) and five
        # deviations of the mean of four readings, of a sensor that reads half.
        unseen = 2 * GUARD.contact_n + 5 * arm.noise / 2
        assert arm.peak_n <= unseen / arm.scale
    if arm.sign < 0:
        assert record.outcome != "touched"


@quick
@given(following, st.sampled_from([0.01, 0.05, 0.2]))
def test_a_coarse_force_sensor_passes_the_limit_by_no_more(world, quantum):
    arm = SpringWall(quantum=quantum, **world)
    touch(arm, Guard(max_travel_mm=40, stuck_after=None, flat_mm=20))
    assert_bounded(arm)


@quick
@given(following, st.floats(0, 4), st.one_of(st.none(), st.floats(-4, 4)))
@example({"stiffness": 100.0}, 0.3, None)
@example({"stiffness": 0.3}, 0.0, 0.05)
@example({"stiffness": 0.3}, 0.3, 0.8)
def test_a_sensor_that_repeats_itself_is_found_in_three_steps(world, at_n, stuck_n):
    arm = SpringWall(**world, sticks_at_n=at_n, stuck_n=stuck_n)
    touch(arm)
    if arm.stuck_depth_mm is not None:
        # 12 equal readings are three steps of four; the reading that sticks is taken
        # after a step of its own. What was unseen before is bounded as above.
        before = max(arm.stuck_depth_mm, GUARD.limit_n / arm.stiffness)
        deepest = arm.peak_n / arm.stiffness
        assert deepest <= before + 3 * GUARD.air_step_mm + 1e-9


@quick
@given(st.floats(0.1, 100), st.floats(0.06, 0.6), st.floats(1e-6, 0.005))
@example(0.3, 0.06, 0.005)
@example(100.0, 0.06, 0.005)
def test_a_sensor_that_sticks_noisily_in_contact_is_found_by_not_changing(
    stiffness, stuck_n, noise
):
    arm = SpringWall(
        stiffness=stiffness,
        noise=0.005,
        sticks_at_n=stuck_n,
        stuck_n=stuck_n + 0.1,
        stuck_noise_n=noise,
    )
    record = touch(arm)
    assert record.outcome == "force sensor"
    # flat_mm from where contact was read, a step to it and one of slack.
    most = GUARD.flat_mm + GUARD.air_step_mm + GUARD.contact_step_mm
    assert arm.peak_n / stiffness <= arm.stuck_depth_mm + most


@quick
@given(stiffnesses, st.floats(1e-4, 0.02))
def test_a_dead_and_noisy_sensor_is_found_by_the_tactile_image(stiffness, noise):
    arm = SpringWall(
        stiffness=stiffness, sticks_at_n=0, stuck_n=0.05, stuck_noise_n=noise
    )
    record = touch(arm, Guard(max_travel_mm=40, frame_change=1.0))
    # A change by 1 level is 0.1 N; the picture is looked at every 2 mm.
    deepest = 0.1 / stiffness + GUARD.frame_every_mm
    if arm.wall_mm + deepest < 40:
        assert record.outcome == "force sensor"
        assert "tactile image changed" in record.message
    assert arm.peak_n / stiffness <= deepest + 1e-9


def test_a_good_force_sensor_and_its_image_agree():
    arm = SpringWall(stiffness=0.5)
    record = touch(arm, Guard(max_travel_mm=40, frame_change=1.5))
    assert record.outcome == "touched"


def test_a_force_of_the_wrong_sign_names_its_value_and_the_fix():
    record = touch(SpringWall(stiffness=0.05, sign=-1))
    assert record.outcome == "force sensor"
    assert "must be positive when something pushes back" in record.message
    assert f"{record.force_n:.3f} N" in record.message
    assert record.force_n < 0
    assert record.peak_force_n == pytest.approx(-record.force_n, rel=0.05)


def test_a_force_above_the_limit_counts_before_a_place_that_was_missed():
    class Overshoots(SpringWall):
        def move_to(self, pose):
            far = 9.0 if float(pose.position_mm[2]) == 5 else 0.0
            super().move_to(pose.advanced(far))

    assert touch(Overshoots(stiffness=0.1)).outcome == "robot error"
    assert touch(Overshoots(stiffness=20.0)).outcome == "limit exceeded"


@pytest.mark.parametrize(
    ("parameters", "error", "message"),
    [
        ({"force_n": 0.0}, ValueError, "force_n must be positive"),
        ({"limit_n": np.inf}, ValueError, "limit_n must be positive and finite"),
        ({"limit_n": "3"}, TypeError, "limit_n must be a number, got str"),
        ({"contact_step_mm": 2.0}, ValueError, r"at most air_step_mm \(1.0\), got 2.0"),
        ({"flat_mm": 0.1}, ValueError, r"at least contact_step_mm \(0.25\), got 0.1"),
        ({"flat_mm": None}, TypeError, "flat_mm must be a number"),
        ({"max_miss_mm": 0.0}, ValueError, "max_miss_mm must be positive"),
        ({"frame_change": -1.0}, ValueError, "frame_change must be positive"),
        ({"n_tare": 1.5}, TypeError, "n_tare must be an integer"),
        ({"n_readings": 0}, ValueError, "n_readings must be at least 1"),
        ({"contact_n": 0.9}, ValueError, "contact_n must be .*between -inf and 0.735"),
        ({"stuck_after": 2}, ValueError, "stuck_after must be at least 3, got 2"),
        ({"limit_n": 0.735}, ValueError, r"above force_n \(0.735\), got 0.735"),
    ],
)
def test_bad_guards_are_refused(parameters, error, message):
    with pytest.raises(error, match=message):
        Guard(**parameters)
