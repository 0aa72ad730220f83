"""The simulated bench against the simulated dome it is made of, and its promises."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.sensors import SensorError, SimulatedBench, SimulatedSensor, TouchSensor
from palpate.simulation import (
    DomeCamera,
    GelCamera,
    PlacedObject,
    SensorPose,
    TacTipPins,
    find_object,
)

CAMERA = DomeCamera(image_shape=(48, 48), n_nodes=24)
OUT = np.array([0.5, 0.3, 0.8]) / np.sqrt(0.98)


def _bench(name="box", **settings):
    target = PlacedObject.resting(find_object(name), yaw_rad=0.4)
    return SimulatedBench(target, CAMERA, **settings)


def _start(bench):
    return SensorPose(bench.centre_mm + 200 * OUT, -OUT)


def _forces(bench, travels_mm):
    """Yield the force after each step along one way."""
    start = _start(bench)
    for travel in travels_mm:
        bench.move_to(start.advanced(travel))
        yield bench.force_n


@pytest.mark.parametrize("name", ["box", "mug", "pen"])
def test_force_and_picture_are_those_of_the_dome(name):
    bench = _bench(name, shift_share=0.0)
    start = _start(bench)
    press = CAMERA.press(bench.target, start, force_n=0.5)
    bench.move_to(start)
    bench.move_to(start.advanced(press.travel_mm))
    # The bench solves the contact at a few forces and interpolates between them.
    # The pen meets the sleeve at that place, so the dome bears less than 0.5 N.
    assert_allclose(bench.force_n, press.contact.force_n, rtol=0.05)
    picture = CAMERA.image(press).astype(float)
    assert_allclose(bench.frame().astype(float), picture, atol=6)
    # The picture is of this press and of no other: nothing pressed is far off.
    assert np.abs(CAMERA.no_contact() - picture).max() > 20


def test_force_grows_with_depth_and_is_zero_in_the_air():
    bench = _bench(shift_share=0.0)
    first = CAMERA.press(bench.target, _start(bench), depth_mm=0.0).travel_mm
    forces = np.array([*_forces(bench, first + np.linspace(-20, 12, 65))])
    assert_array_equal(forces[:40], 0)
    assert (np.diff(forces[42:]) > 0).all()
    assert bench.peak_force_n == forces[-1]


def test_beyond_the_deepest_press_the_housing_is_met():
    bench = _bench("ball", shift_share=0.0, housing_n_mm=2.0)
    start = SensorPose(bench.centre_mm + np.array([0, 0, 200]), (0, 0, -1))
    deepest = 200 - 36 + CAMERA.max_depth_mm
    bench.move_to(start.advanced(deepest + 1))
    at_one = bench.force_n
    bench.move_to(start.advanced(deepest + 3))
    assert_allclose(bench.force_n - at_one, 2 * 2.0, rtol=1e-6)


def test_frames_in_the_air_show_no_contact():
    bench = _bench()
    assert_array_equal(bench.frame(), CAMERA.no_contact())
    bench.move_to(_start(bench))
    assert_array_equal(bench.frame(), CAMERA.no_contact())


@pytest.mark.parametrize("name", ["stapler", "box"])
def test_contact_shifts_the_object_but_never_by_more_than_it_may(name):
    bench = _bench(name, shift_share=0.05, random_state=1)
    before = bench.target.vertices_mm
    allowed = 0.05 * np.ptp(bench.target.bounds_mm, axis=0).max()
    rng, strayed = np.random.default_rng(0), []
    for _ in range(40):
        out = rng.standard_normal(3) * (1, 1, 0) + (0, 0, 0.5)
        direction = out / np.linalg.norm(out)
        start = SensorPose(bench.centre_mm + 200 * direction, -direction)
        depth = CAMERA.press(bench.target, start, force_n=0.7).travel_mm
        bench.move_to(start)
        bench.move_to(start.advanced(depth))
        moved = bench.target.vertices_mm - before
        strayed.append(np.linalg.norm(moved, axis=1).max())
        assert_allclose(moved[:, 2], 0, atol=1e-9)
    # Half the allowance slides; half turns, taken at the end of the longest side,
    # and the corner of a box is further out than that by at most the square root 2.
    assert 0.3 * allowed < max(strayed) <= allowed * (0.5 + 0.5 * np.sqrt(2))


# Round things: sliding along a flat side changes no force, and rounding decides.
@pytest.mark.parametrize("name", ["mug", "ball", "pen", "shampoo bottle"])
def test_an_approach_at_once_ends_where_steps_end_with_the_same_slip(name):
    rng = np.random.default_rng(1)
    stepped, at_once = (_bench(name, random_state=4) for _ in range(2))
    for _ in range(6):
        out = np.abs(rng.standard_normal(3)) * rng.choice([-1, 1], 3)
        out[2] = abs(out[2])
        direction = out / np.linalg.norm(out)
        start = SensorPose(stepped.centre_mm + 200 * direction, -direction)
        at_once_mm = at_once.approach(start, 0.735, 215.0)
        # Steps through the air before the contact, which is 12 mm deep at most, change
        # nothing.
        travel = at_once_mm - 15
        stepped.move_to(start.advanced(travel))
        assert stepped.force_n == 0
        while stepped.force_n < 0.735:
            travel += 0.1
            stepped.move_to(start.advanced(travel))
        # Steps pass the force by up to one of them, and the bench interpolates the
        # force between those that it solves.
        assert_allclose(travel, at_once_mm, atol=0.25)
        moved = stepped.target.vertices_mm - at_once.target.vertices_mm
        assert_allclose(moved, 0, atol=1e-9)
        pictures = [bench.frame().astype(float) for bench in (stepped, at_once)]
        assert_allclose(*pictures, atol=12)


def test_an_approach_at_once_that_meets_nothing_says_so():
    bench = _bench("ball")
    beside = SensorPose(bench.centre_mm + np.array([200, 100, 0]), (-1, 0, 0))
    assert bench.approach(beside, 0.735, 215.0) is None
    assert bench.force_n == 0
    assert_array_equal(bench.frame(), CAMERA.no_contact())
    # Too short a way is nothing too.
    assert bench.approach(_start(bench), 0.735, 50.0) is None


def test_a_fixed_object_stays():
    bench = _bench(shift_share=0.0)
    target, start = bench.target, _start(bench)
    for _ in range(5):
        bench.move_to(start)
        bench.move_to(start.advanced(CAMERA.press(target, start).travel_mm))
        assert bench.force_n > 0.5
    assert bench.target is target


def test_the_same_seed_gives_the_same_bench():
    def run(seed):
        bench = _bench("stapler", random_state=seed)
        forces = [*_forces(bench, np.arange(150, 200, 0.5))]
        return np.array(forces), bench.frame(np.random.default_rng(seed))

    for first, second in zip(run(3), run(3), strict=True):
        assert_array_equal(first, second)
    assert not np.array_equal(run(3)[0], run(4)[0])


def test_slipping_never_makes_the_force_jump():
    for seed in range(10):
        forces = [0.0]
        bench = _bench("textbook", random_state=seed)
        for force in _forces(bench, np.arange(120, 200, 0.25)):
            forces.append(force)
            if force > 0.735:
                break
        # 0.3 N/mm is the stiffest the rubber gets below 1 N; 2 N/mm is the housing.
        assert np.diff(forces).max() < 0.25 * 2.0 + 1e-6


def test_the_sensor_keeps_the_contract():
    sensor = SimulatedSensor(_bench())
    assert isinstance(sensor, TouchSensor)
    assert sensor.read().shape == sensor.image_shape == (48, 48)
    assert sensor.geometry == "dome"
    assert_array_equal(sensor.no_contact(), CAMERA.no_contact())


def test_frames_are_noisy_by_the_seed():
    frames = [SimulatedSensor(_bench(), random_state=seed).read() for seed in (1, 1, 2)]
    assert_array_equal(frames[0], frames[1])
    assert not np.array_equal(frames[0], frames[2])


def test_chosen_frames_are_missing():
    sensor = SimulatedSensor(_bench(), missing={1})
    assert sensor.read().shape == (48, 48)
    with pytest.raises(SensorError, match="Frame 1 did not arrive"):
        sensor.read()
    assert sensor.read().shape == (48, 48)


def test_a_share_that_is_none_is_refused():
    with pytest.raises(ValueError, match="shift_share must be finite and between"):
        _bench(shift_share=-0.1)


@pytest.mark.parametrize("camera", [TacTipPins(), GelCamera()], ids=["pins", "gel"])
def test_what_is_no_dome_is_refused(camera):
    with pytest.raises(TypeError, match=r"must be a DomeCamera, got (TacTip|Gel)"):
        SimulatedBench(PlacedObject(find_object("box")), camera)
