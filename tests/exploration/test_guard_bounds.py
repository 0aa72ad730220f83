"""Every bound of a guarded touch, at the bound itself and just beside it.

An arm on a straight line, and a force sensor that says what a test tells it to, in
binary fractions, so that nothing is rounded: each step, each reading and each decision
is known beforehand. `JUST` is the least that matters.
"""

import dataclasses
import inspect
import re

import numpy as np
import pytest

from palpate.exploration import Guard, guarded_touch
from palpate.simulation import SensorPose

START = SensorPose((8, 0, -4), (0, 0, 1))
JUST = 2.0**-10
GUARD = Guard(
    force_n=0.75, contact_n=0.25, max_travel_mm=16, stuck_after=None, flat_mm=15
)


def guard(**changed):
    return dataclasses.replace(GUARD, **changed)


class Line:
    """An arm, and a sensor that says `says(line)`; remembers all that was asked.

    `visited` are the travels (mm) it was sent to, `read_at` where each force was read,
    `seen_at` where each frame was; `since` counts the readings since the last move.
    """

    image_shape = (2, 2)
    geometry = "none"
    ahead_mm = 0.0

    def __init__(self, says=lambda line: 0.0, shows=lambda line: 50.0):
        self.says, self.shows = says, shows
        self.visited, self.read_at, self.seen_at, self.retracted = [], [], [], []
        self.since = 0
        self.stopped = False

    @property
    def at(self):
        return self.visited[-1] if self.visited else 0.0

    def move_to(self, pose):
        self.visited.append(float(pose.position_mm[2]) + 4)
        self.since = 0

    def read_pose(self):
        return START if self.retracted else START.advanced(self.at + self.ahead_mm)

    def read_force(self):
        self.read_at.append(None if self.retracted else self.at)
        self.since += 1
        return self.says(self)

    def retract(self, way_mm):
        self.retracted.append(way_mm)
        self.since = 0

    def stop(self):
        self.stopped = True

    def read(self):
        self.seen_at.append(self.at)
        return np.full((2, 2), self.shows(self))

    def no_contact(self):
        return None

    def touch(self, limits=GUARD, clock=lambda: 100.0):
        return guarded_touch(self, self, START, limits, clock=clock)


def at(forces, otherwise=0.0):
    """Say a force by where the arm is, until it is back again."""
    return lambda line: 0.0 if line.retracted else forces.get(line.at, otherwise)


def steps(first, last, step):
    return np.arange(first, last + step / 2, step).tolist()


def test_defaults_are_those_that_the_docstring_gives():
    documented = re.findall(
        r"^([\w, ]+) : .*default=(.*)$", inspect.getdoc(Guard), re.M
    )
    values = {
        name: value
        for names, defaults in documented
        for name, value in zip(names.split(", "), defaults.split(", "), strict=True)
    }
    assert values == {name: str(value) for name, value in vars(Guard()).items()}


def test_least_counts_and_equal_limits():
    Guard(n_readings=1, n_tare=1, stuck_after=3)
    Guard(contact_step_mm=1.0, air_step_mm=1.0)
    Guard(contact_step_mm=0.25, flat_mm=0.25)
    Guard(force_n=0.5, contact_n=0.5)
    with pytest.raises(dataclasses.FrozenInstanceError):
        Guard().limit_n = 100.0


def test_nothing_takes_every_step_once_and_says_so():
    line = Line()
    record = line.touch()
    assert (record.outcome, record.message, record.duration_s) == ("nothing", "", 0.0)
    assert (record.image, record.faulty) == (None, False)
    assert (record.force_n, record.peak_force_n, record.travel_mm) == (0, 0, 16)
    assert line.visited == steps(0, 16, 1)
    assert line.retracted == [16]
    assert line.seen_at == []
    # 12 of the air, 4 at each step, 4 more at the end, 4 stale and 12 afterwards.
    counts = [line.read_at.count(mm) for mm in [*line.visited, None]]
    assert counts == [12, *[4] * 15, 8, 16]


@pytest.mark.parametrize("n_readings", [1, 3])
def test_a_reading_at_the_force_is_waited_for_and_read_again(n_readings):
    """One of four readings at 5 mm reaches the force: only the second four count."""
    line = Line(lambda line: 0.75 if (line.at, line.since) == (5, n_readings) else 0.0)
    assert line.touch().outcome == "nothing"
    assert [line.read_at.count(mm) for mm in (4, 5, 6)] == [4, 8, 4]
    under = Line(lambda line: 0.75 - JUST if (line.at, line.since) == (5, 2) else 0.0)
    assert under.touch().outcome == "nothing"
    assert under.read_at.count(5) == 4


def test_the_force_at_the_bound_is_a_touch_in_a_small_step():
    line = Line(at({5: 0.25, 5.25: 0.75 - JUST, 5.5: 0.75}))
    record = line.touch()
    assert (record.outcome, record.travel_mm, record.force_n) == ("touched", 5.5, 0.75)
    assert line.visited == [*steps(0, 5, 1), 5.25, 5.5]
    assert [line.read_at.count(mm) for mm in (5, 5.25, 5.5)] == [4, 4, 8]
    assert line.retracted == [5.5]
    assert line.seen_at == [5.5]
    assert record.image.tolist() == [[50, 50], [50, 50]]


def test_contact_begins_at_its_force_and_ends_below_half_of_it():
    line = Line(at({8: 0.25 - JUST, 10: 0.25, 10.25: 0.125, 10.5: 0.125 - JUST}))
    record = line.touch()
    assert line.visited == [*steps(0, 10, 1), 10.25, 10.5, *steps(11.5, 15.5, 1), 16]
    assert record.outcome == "force not reached"
    assert "0.250 N at most on 16 mm" in record.message


@pytest.mark.parametrize(
    ("millimetre", "force", "outcome"),
    [
        (1, 0.25, "force sensor"),
        (1, 0.25 - JUST, "nothing"),
        (2, 0.25, "force not reached"),
    ],
)
def test_a_load_after_the_first_step_is_a_start_that_is_not_clear(
    millimetre, force, outcome
):
    line = Line(at({millimetre: force}))
    record = line.touch()
    assert record.outcome == outcome
    if outcome == "force sensor":
        assert "0.250 N after the first 1 mm" in record.message
        assert "Start further away, clear of everything." in record.message
        assert line.retracted == [1]


def test_one_reading_beyond_the_limit_ends_a_touch_whatever_the_mean():
    line = Line(lambda line: 3.5 if (line.at, line.since) == (5, 3) else 0.0)
    record = line.touch()
    assert (record.outcome, record.travel_mm) == ("limit exceeded", 5)
    assert record.peak_force_n == 3.5
    # The arm comes out without another reading or step.
    assert (line.read_at.count(5), line.visited[-1], line.retracted) == (3, 5, [5])


@pytest.mark.parametrize(
    ("force", "outcome"),
    [
        (3.0, "touched"),
        (3.0 + JUST, "limit exceeded"),
        (0.75, "touched"),
        (0.75 - JUST, "force not reached"),
        (-0.125, "nothing"),
        (-0.125 - JUST, "force sensor"),
        (0.125, "force not reached"),
        (0.125 - JUST, "nothing"),
    ],
)
def test_a_force_at_a_bound_counts_as_that_bound_says(force, outcome):
    line = Line(at(dict.fromkeys(steps(10, 12, 0.25), force)))
    limits = guard(max_travel_mm=12, contact_n=0.125, flat_mm=20)
    assert line.touch(limits).outcome == outcome


def test_a_step_that_landed_too_hard_is_made_again_in_small_ones():
    line = Line(at({10: 1.5}))
    record = line.touch()
    assert record.outcome == "touched"
    assert record.force_n == record.peak_force_n == 1.5
    assert line.visited == [*steps(0, 10, 1), *steps(9, 10, 0.25)]
    assert line.retracted == [10]


def test_small_steps_end_where_the_hard_one_had_ended():
    def once(line):
        return 0.75 if line.visited.count(10) == 1 and line.at == 10 else 0.0

    line = Line(once)
    line.touch()
    assert line.visited[10:] == [10, *steps(9, 10, 0.25), *steps(11, 16, 1)]


@pytest.mark.parametrize("still", [0.75, 0.75 - JUST])
def test_the_force_at_the_bound_where_it_was_air_is_a_fault(still):
    def holds(line):
        if line.retracted or 10 not in line.visited:
            return 0.0
        return 0.75 if line.at == 10 else still

    line = Line(holds)
    record = line.touch()
    assert ("Still 0.750 N where it was air" in record.message) == (still == 0.75)
    assert (record.outcome == "force sensor") == (still == 0.75)
    assert line.retracted == [10]


@pytest.mark.parametrize(
    ("last", "first", "ends_mm"),
    [
        # In 2 mm the force changes by 3 deviations of a mean of four, six of a reading
        # divided by two: 0.09375 N, or by just less.
        (0.09375, 0.0, None),
        (0.09375 - JUST, 0.0, 12.0),
        # What began 2 mm ago counts, and what began before it does not.
        (0.09375, 0.09375, 12.25),
    ],
)
def test_a_force_that_does_not_change_in_contact_is_a_fault(last, first, ends_mm):
    def says(line):
        noise = 2.0**-5 * (-1) ** line.since
        if line.retracted or line.at < 10:
            return noise
        if line.at == 10:
            return 0.5
        if line.at < 12:
            return 0.5 + first
        return 0.5 + last if line.at < 12.5 else 0.75

    record = Line(says).touch(guard(flat_mm=2.0))
    if ends_mm is None:
        assert (record.outcome, record.travel_mm) == ("touched", 12.5)
    else:
        assert (record.outcome, record.travel_mm) == ("force sensor", ends_mm)
        assert "2 mm in contact, without a change" in record.message


@pytest.mark.parametrize(("change", "is_flat"), [(0.0099, True), (0.0101, False)])
def test_a_quiet_force_sensor_must_change_by_a_hundredth_of_a_newton(change, is_flat):
    forces = dict.fromkeys(steps(10, 11.75, 0.25), 0.5) | {12: 0.5 + change}
    line = Line(at({**forces, 12.25: 0.75}))
    record = line.touch(guard(flat_mm=2.0))
    assert record.outcome == ("force sensor" if is_flat else "touched")


def test_a_press_may_be_as_long_as_its_limit_and_no_longer():
    line = Line(at(dict.fromkeys(steps(10, 16, 0.25), 0.5)))
    record = line.touch(guard(max_press_mm=2.0))
    assert (record.outcome, record.travel_mm) == ("force sensor", 12.25)
    assert "Still 0.500 N 2 mm beyond the first contact" in record.message


@pytest.mark.parametrize(
    ("after", "outcome"),
    [
        (0.5 + 0.25, "nothing"),
        (0.5 + 0.25 + JUST, "force sensor"),
        (0.25, "nothing"),
        (0.25 - JUST, "force sensor"),
    ],
)
def test_an_offset_may_move_by_the_force_of_a_contact(after, outcome):
    """The first four readings, as many as are averaged, may still be of the contact."""

    def says(line):
        if not line.retracted:
            return 0.5
        return 2.5 if line.since <= 4 else after

    line = Line(says)
    record = line.touch()
    assert record.outcome == outcome
    moved = f"offset moved by {after - 0.5:.3f} N"
    assert (moved in record.message) == (outcome == "force sensor")
    assert line.read_at.count(None) == 16


def test_after_a_fault_or_without_a_retreat_the_air_is_not_read():
    line = Line(at({5: 4.0}))
    assert line.touch().outcome == "limit exceeded"
    assert line.read_at.count(None) == 0
    for forces, outcome in (({}, "robot error"), ({5: 0.25, 5.25: 0.75}, "touched")):
        line = Line(at(forces))

        def never(way_mm, line=line):
            line.retracted.append(way_mm)
            raise OSError("stuck")

        line.retract = never
        record = line.touch()
        assert (record.outcome, record.retracted) == (outcome, False)
        assert (record.image is not None) == (outcome == "touched")
        assert record.message == (
            "Retracting failed (1): stuck Retracting failed (2): stuck "
            "The arm was stopped."
        )
        assert line.stopped
        assert line.read_at.count(None) == 0


@pytest.mark.parametrize(("late_s", "outcome"), [(0, "nothing"), (JUST, "timed out")])
def test_an_approach_may_last_as_long_as_its_limit(late_s, outcome):
    line = Line()
    record = line.touch(clock=lambda: 100.0 + (60 + late_s) * (line.visited[-1:] > [6]))
    assert record.outcome == outcome
    assert record.duration_s == 60 + late_s
    assert ("7 mm from the start. If the arm is that slow" in record.message) == (
        outcome == "timed out"
    )
    assert line.retracted == [7 if late_s else 16]


@pytest.mark.parametrize(
    ("offset", "beyond", "limits", "most"),
    [
        (1.0, 0, {}, None),
        (1.0, JUST, {}, "1"),
        (-1.0, -JUST, {}, "1"),
        # Below the limit there must be room for the force.
        (0.5, 0, {"limit_n": 1.125}, "0.375"),
    ],
)
def test_an_offset_may_be_as_large_as_its_limit(offset, beyond, limits, most):
    record = Line(lambda line: offset + beyond).touch(guard(**limits))
    assert (record.outcome == "force sensor") == (most is not None)
    assert (f"N in the air, more than {most}:" in record.message) == (most is not None)
    assert record.travel_mm == (16 if most is None else 0)


def test_an_arm_may_miss_by_as_much_as_its_limit():
    line = Line(at({5: 0.25, 5.25: 0.75}))
    line.ahead_mm = 0.5
    assert line.touch().outcome == "touched"
    assert line.retracted == [5.25]


@pytest.mark.parametrize(
    ("ahead_mm", "back_mm"),
    [(0.5 + JUST, 5.5 + JUST), (-0.5 - JUST, 5), (-5, 5), (99, 16)],
)
def test_an_arm_that_missed_is_taken_back_as_far_as_it_may_have_come(ahead_mm, back_mm):
    class Misses(Line):
        @property
        def ahead_mm(self):
            return ahead_mm * (self.at == 5)

    line = Misses()
    record = line.touch()
    assert record.outcome == "robot error"
    assert f"{abs(ahead_mm):.2f} mm from where it was sent" in record.message
    assert (line.visited[-1], line.retracted) == (5, [back_mm])


@pytest.mark.parametrize("n_equal", [4, 5])
def test_a_sensor_is_stuck_at_as_many_equal_readings_as_stuck_after(n_equal):
    def says(line):
        number = len(line.read_at)
        same = 30 <= number < 30 + n_equal
        return JUST if same else JUST / 4 * (-1) ** number

    line = Line(says)
    record = line.touch(guard(stuck_after=5))
    assert record.outcome == ("nothing" if n_equal == 4 else "force sensor")
    if n_equal == 5:
        assert "for 5 readings" in record.message
        assert len(line.read_at) == 34


def test_frames_are_looked_at_as_often_as_is_asked_for():
    line = Line()
    line.touch(guard(frame_change=1.5))
    # The air, then from the first step on every 2 mm, and at the end.
    assert line.seen_at == [0, *steps(1, 15, 2), 16]


@pytest.mark.parametrize(
    ("change", "is_contact"), [(1.5, True), (1.5 - JUST, False), (-1.25, False)]
)
def test_a_frame_that_changed_by_the_limit_is_a_contact(change, is_contact):
    line = Line(shows=lambda line: 50.0 + change * (line.at >= 7))
    record = line.touch(guard(frame_change=1.5))
    assert record.outcome == ("force sensor" if is_contact else "nothing")
    if is_contact:
        assert record.travel_mm == 7
        assert "The tactile image changed by 1.5, as in contact" in record.message


@pytest.mark.parametrize(
    ("offset", "force", "has_sign"),
    [(0.0, -4.0, True), (2.25, 0.875, False), (-0.875, 3.25, False)],
)
def test_beyond_the_limit_the_sign_is_spoken_of_where_it_is_wrong(
    offset, force, has_sign
):
    line = Line(lambda line: offset + force * (line.at >= 5))
    record = line.touch(guard(max_offset_n=2.5))
    assert record.outcome == "limit exceeded"
    message = (
        f"{force:.3f} N ({offset + force:.3f} with its offset), above the limit of 3"
    )
    assert message in record.message
    assert record.peak_force_n == abs(force)
    assert record.image is None
    assert ("must be positive when something pushes" in record.message) == has_sign
