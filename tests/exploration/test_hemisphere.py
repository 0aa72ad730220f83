"""The hemisphere, and strategies on it, against geometry."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.exploration import Hemisphere, RandomHemisphere, Raster
from palpate.simulation import SensorPose

CENTRE = np.array([10.0, -20.0, 30.0])
HEMISPHERE = Hemisphere(tuple(CENTRE))


def _poses(strategy, n_poses):
    return [strategy.next_pose(None, [None] * k) for k in range(n_poses)]


@pytest.mark.parametrize(
    "strategy", [RandomHemisphere(HEMISPHERE), Raster(HEMISPHERE, 4, 8)], ids=repr
)
def test_poses_stand_on_the_upper_half_and_face_the_centre(strategy):
    for pose in _poses(strategy, 40):
        arm = np.asarray(pose.position_mm) - CENTRE
        assert_allclose(np.linalg.norm(arm), 300, rtol=1e-12)
        assert_allclose(pose.direction, -arm / 300, atol=1e-12)
        assert arm[2] >= 0


def test_random_poses_are_even_on_the_surface():
    arms = np.array([p.direction for p in _poses(RandomHemisphere(HEMISPHERE), 4000)])
    # Archimedes: heights of points spread evenly over a sphere are uniform. The
    # standard error of a mean of 4000 uniform numbers is 0.0046, of a cosine 0.011.
    assert_allclose(-arms[:, 2].mean(), 0.5, atol=0.02)
    assert_allclose(np.quantile(-arms[:, 2], [0.25, 0.75]), [0.25, 0.75], atol=0.03)
    assert_allclose(arms[:, :2].mean(axis=0), 0, atol=0.04)


def test_low_elevations_can_be_left_out():
    strategy = RandomHemisphere(Hemisphere(lowest_rad=0.5))
    heights = [-pose.direction[2] for pose in _poses(strategy, 500)]
    # Of 500 even heights the least is above the limit, and near it.
    assert np.sin(0.5) <= min(heights) < np.sin(0.5) + 0.02


def test_poses_follow_from_the_seed_and_the_number_of_attempts_alone():
    first, again = (_poses(RandomHemisphere(HEMISPHERE, 3), 5) for _ in range(2))
    other = _poses(RandomHemisphere(HEMISPHERE, 4), 5)
    for pose, same, other_pose in zip(first, again, other, strict=True):
        assert np.array_equal(pose.position_mm, same.position_mm)
        assert not np.allclose(pose.position_mm, other_pose.position_mm)


def test_raster_visits_every_place_once_and_begins_again():
    places = np.array([p.position_mm for p in _poses(Raster(HEMISPHERE, 3, 5), 30)])
    assert len(np.unique(places[:15].round(6), axis=0)) == 15
    assert_allclose(places[15:], places[:15])


@pytest.mark.parametrize("seed", range(5))
def test_the_way_between_poses_stays_outside_the_object(seed):
    rng = np.random.default_rng(seed)
    start = HEMISPHERE.pose(rng.uniform(0, 6), rng.uniform(0, 1.5))
    end = HEMISPHERE.pose(rng.uniform(0, 6), rng.uniform(0, 1.5), roll_rad=0.3)
    _assert_clear(start, end)


def test_the_way_to_the_opposite_side_goes_over_the_top():
    way = _assert_clear(HEMISPHERE.pose(0.4, 0), HEMISPHERE.pose(0.4 + np.pi, 0))
    assert max(pose.position_mm[2] for pose in way) > 30 + 295


def test_the_way_to_the_top_from_below_the_ground_goes_round_the_object():
    start = SensorPose(CENTRE - np.array([0, 0, 400]), (0, 0, 1))
    way = [start, *HEMISPHERE.way(start, HEMISPHERE.pose(0, np.pi / 2))]
    places = np.array([pose.position_mm for pose in way]) - CENTRE
    assert np.linalg.norm(places, axis=1).min() > 300 - 1e-9
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 100


def test_the_way_from_outside_comes_down_to_the_hemisphere():
    _assert_clear(SensorPose((900, -20, 30), (-1, 0, 0)), HEMISPHERE.pose(2.5, 0.2))


@pytest.mark.parametrize("azimuth_rad", [2.8, np.pi, 3.4])
def test_the_way_from_a_low_place_does_not_pass_underneath_the_object(azimuth_rad):
    # Parked 60 mm below the centre, on the other side than the touch to come.
    start = SensorPose(CENTRE + np.array([400, 0, -60]), (-1, 0, 0))
    way = [start, *HEMISPHERE.way(start, HEMISPHERE.pose(azimuth_rad, 0.1))]
    places = np.array([pose.position_mm for pose in way]) - CENTRE
    assert places[:, 2].min() >= -60
    assert np.linalg.norm(places, axis=1).min() > 300 - 1e-9
    angles = np.diff(places / np.linalg.norm(places, axis=1)[:, None], axis=0)
    assert np.linalg.norm(angles, axis=1).max() <= HEMISPHERE.arc_rad


def _assert_clear(start, end):
    way = [start, *HEMISPHERE.way(start, end)]
    assert way[-1] is end
    places = np.array([pose.position_mm for pose in way]) - CENTRE
    shares = np.linspace(0, 1, 21)[:, None]
    for here, there in pairwise(places):
        line = (1 - shares) * here + shares * there
        # A straight piece of 0.2 rad dips 300 (1 - cos 0.1) = 1.5 mm inside.
        assert np.linalg.norm(line, axis=1).min() > 298.4
        # Between points above the ground a straight line stays above it.
        assert line[:, 2].min() > -1e-9
    return way


@pytest.mark.parametrize("travel_mm", [-600.0, 0.5, 120.0, 299.0, 420.0])
def test_way_out_of_the_hemisphere_is_the_way_in(travel_mm):
    inside = HEMISPHERE.pose(1.0, 0.7).advanced(travel_mm)
    # What is less than 1 mm inside counts as being on it, or outside.
    wanted = 0 if travel_mm < 1 else travel_mm
    assert_allclose(HEMISPHERE.way_out_mm(inside), wanted, atol=1e-9)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"radius_mm": 0}, "radius_mm must be positive"),
        ({"radius_mm": 0.3}, "at least 5, got 0.3. Give millimetres"),
        ({"lowest_rad": 2.0}, "lowest_rad must be finite and between 0.0 and 1.5"),
        ({"centre_mm": (0, np.nan, 0)}, "centre_mm must be finite"),
        ({"centre_mm": (0, 0)}, r"centre_mm must be x, y, z, got \(0, 0\)"),
    ],
)
def test_what_is_no_hemisphere_is_refused(parameters, message):
    with pytest.raises(ValueError, match=message):
        Hemisphere(**parameters)
