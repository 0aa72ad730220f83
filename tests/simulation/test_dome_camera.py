"""The dome camera: physics that any such sensor obeys, and its own promises."""

import pickle
from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from palpate.simulation import (
    DomeCamera,
    Lighting,
    PlacedObject,
    SensorPose,
    SimObject,
    find_object,
)

DOWN = SensorPose((0, 0, 50), (0, 0, -1))
CLEAN = DomeCamera(image_shape=(120, 120), texture_sd=0.0)
# Disc in the middle of a square picture: turning the scene turns the picture.
CENTRED = replace(CLEAN, disc_centre=(0.5, 0.5), disc_radius=0.45)


def placed(name, **where):
    return PlacedObject(find_object(name), **where)


def within(share, n_rows):
    """Pixels of a square picture within a share of the default rim's radius."""
    row, col = (np.mgrid[:n_rows, :n_rows] + 0.5) / n_rows
    away = np.hypot(row - CLEAN.disc_centre[0], col - CLEAN.disc_centre[1])
    return away < share * CLEAN.disc_radius


def test_picture_is_like_the_real_one():
    """The disc is cut on the left, above and below; all else is white."""
    picture = DomeCamera().no_contact()
    assert picture.shape == (480, 640)
    assert picture.dtype == np.uint8
    white = picture == 255
    assert white[:, 500:].all()
    assert white[0, 0]
    assert white[-1, 0]
    assert not white[210, 400:480].any()
    assert not white[0, 213]
    assert not white[210, 0]
    assert 85 < picture[210, 470] < 110
    assert picture[210, 213] > 250


def test_square_picture_is_the_left_of_the_whole_one():
    whole = replace(CLEAN, image_shape=(480, 640)).no_contact()
    square = replace(CLEAN, image_shape=(120, 120)).no_contact()
    binned = whole[:, :480].reshape(120, 4, 120, 4).mean(axis=(1, 3))
    inside = within(0.98, 120)
    # Rounding; shading is sampled at 120 rows here, at 128 and binned there.
    assert_allclose(square[inside], binned[inside], atol=1.5)


@pytest.mark.parametrize("shape", [(96, 96), (150, 200), (300, 300), (129, 64)])
def test_any_size_shows_the_same_scene(shape):
    camera = replace(CLEAN, image_shape=shape)
    large = replace(CLEAN, image_shape=(shape[0] * 2, shape[1] * 2))
    target = placed("edge")
    small, fine = camera.touch(target, DOWN), large.touch(target, DOWN)
    binned = fine.reshape(shape[0], 2, shape[1], 2).mean(axis=(1, 3))
    # The rim's pixels aside.
    assert np.abs(small - binned).mean() < 2


def test_nothing_touched_gives_the_no_contact_frame():
    press = CLEAN.press(find_object("nothing"), DOWN)
    assert (press.touched, press.stopped_by) == (False, "nothing")
    assert (press.force_n, press.depth_mm, press.travel_mm) == (0, 0, 0)
    assert_array_equal(CLEAN.image(press), CLEAN.no_contact())
    assert_array_equal(CLEAN.force_curve(press, np.array([1.0, 2.0])), [0, 0])
    out_of_reach = CLEAN.press(placed("flat"), DOWN, reach_mm=49.0)
    assert not out_of_reach.touched


def test_flat_is_met_where_it_is():
    press = CLEAN.press(placed("flat", position_mm=(0, 0, 7)), DOWN)
    # Nodes straddle the axis: 0.4 mm from it the dome is 0.004 mm behind the tip.
    assert_allclose(press.travel_mm - press.depth_mm, 43, atol=0.02)
    assert press.stopped_by == "force"
    assert_allclose(press.force_n, 0.735, rtol=1e-5)


def test_the_picture_changes_with_the_force_and_by_next_to_nothing_at_first():
    nothing = CLEAN.no_contact().astype(float)
    first, *changes = (
        np.abs(CLEAN.touch(placed("flat"), DOWN, force_n=force_n) - nothing)
        for force_n in (1e-6, 0.1, 0.3, 0.9)
    )
    assert first.max() <= 1
    assert (np.diff([change.mean() for change in changes]) > 0).all()


def test_symmetric_object_gives_a_symmetric_picture():
    picture = CENTRED.touch(placed("cylinder"), DOWN).astype(int)
    # Grey levels where the dent is steep; the solver's tolerance is 0.01 mm.
    for mirrored in (picture[::-1], picture[:, ::-1]):
        assert np.abs(picture - mirrored).max() <= 6
    # The cylinder lies along x: its dent is longer across than up.
    change = np.abs(picture - CENTRED.no_contact()) > 20
    assert change.any(axis=0).sum() > 1.3 * change.any(axis=1).sum()


@pytest.mark.parametrize("name", ["edge", "corner", "flat-to-edge"])
def test_turning_the_object_turns_the_picture(name):
    pose = SensorPose((1.5, -2.0, 50), (0, 0, -1))
    straight = CENTRED.touch(placed(name), pose).astype(int)
    turned = SensorPose((2.0, 1.5, 50), (0, 0, -1))
    quarter = CENTRED.touch(placed(name, yaw_rad=np.pi / 2), turned).astype(int)
    # Seen from above, anticlockwise is anticlockwise in the picture.
    error = np.abs(quarter - np.rot90(straight))
    assert error.mean() < 0.5
    assert np.quantile(error, 0.99) <= 8  # single pixels of a sharp edge


def test_turning_by_any_angle_turns_the_picture():
    straight = CENTRED.touch(placed("edge"), DOWN)
    turned = CENTRED.touch(placed("edge", yaw_rad=np.deg2rad(30)), DOWN)
    about = cv2.getRotationMatrix2D((59.5, 59.5), 30, 1)
    expected = cv2.warpAffine(straight, about, (120, 120), borderValue=255)
    error = np.abs(turned.astype(int) - expected)
    # The grid is square and the LEDs are eight: alike, not the same.
    assert error.mean() < 3


def test_rolling_the_sensor_is_turning_the_object_back():
    roll = SensorPose((0, 0, 50), (0, 0, -1), roll_rad=0.6)
    rolled = CLEAN.touch(placed("flat-to-edge"), roll).astype(int)
    # The sensor's axis points down: a right-handed roll is clockwise from above.
    turned = CLEAN.touch(placed("flat-to-edge", yaw_rad=0.6), DOWN).astype(int)
    # The same rays up to rounding; the solver stops a step sooner or later.
    assert np.abs(rolled - turned).mean() < 0.2


def test_only_relative_pose_matters():
    name, direction = "stapler", np.array([0.3, -0.2, -1.0])
    first = placed(name)
    start = first.centre_mm - 200 * direction / np.linalg.norm(direction)
    moved = placed(name, position_mm=(500, -300, 40))
    here = CLEAN.touch(first, SensorPose(start, direction))
    there = CLEAN.touch(moved, SensorPose(start + np.array([500, -300, 40]), direction))
    assert np.abs(here.astype(int) - there).mean() < 0.2  # single-precision rays


def test_columns_are_the_worlds_x_and_rows_its_minus_y():
    """Pushed straight down, columns are the world's x, rows its -y."""
    box = trimesh.creation.box((8, 8, 40))
    post = SimObject("post", "post", lambda: box)
    for offset, (dx, dy) in [((8, 0), (1, 0)), ((0, 8), (0, -1))]:
        target = PlacedObject(post, position_mm=(*offset, 0))
        picture = CENTRED.touch(target, DOWN).astype(float)
        change = np.abs(picture - CENTRED.no_contact())
        col = (change.sum(axis=0) * np.arange(120)).sum() / change.sum() - 59.5
        row = (change.sum(axis=1) * np.arange(120)).sum() / change.sum() - 59.5
        assert col * dx + row * dy > 10
        assert abs(col * dy) + abs(row * dx) < 3


def test_press_ends_at_the_greatest_depth():
    press = CLEAN.press(placed("point"), DOWN, force_n=5.0)
    assert press.stopped_by == "depth"
    assert press.depth_mm == CLEAN.max_depth_mm
    assert 0 < press.force_n < 5.0


def test_sleeve_stops_the_press():
    """A wall beside the dome meets its rigid edge before the dome meets the floor."""
    camera = replace(CLEAN, sleeve_mm=3.0)
    pose = SensorPose((-21.5, 0, 50), (0, 0, -1))  # block begins at x = 0
    press = camera.press(placed("flat-to-edge"), pose)
    assert not press.touched or press.contact.force_n == 0
    pose = SensorPose((-18.5, 0, 50), (0, 0, -1))
    press = camera.press(placed("flat-to-edge"), pose)
    assert press.stopped_by == "sleeve"
    assert_allclose(press.travel_mm, 50 + 20, atol=0.05)
    assert press.contact.force_n < press.force_n == 0.735


def test_depth_can_be_asked_for():
    press = CLEAN.press(placed("flat"), DOWN, depth_mm=2.0)
    assert (press.depth_mm, press.stopped_by) == (2.0, "depth")
    curve = CLEAN.force_curve(press, np.array([0.0, 1.0, 2.0, 4.0]))
    assert curve[0] == 0
    assert (np.diff(curve) > 0).all()
    assert_allclose(curve[2], press.force_n, rtol=1e-6)


def test_start_inside_the_object_is_refused():
    with pytest.raises(
        ValueError, match=r"clear of the object, got one 4\.99 mm inside 'flat'"
    ):
        CLEAN.press(placed("flat"), SensorPose((0, 0, -5), (0, 0, -1)))


def test_noise_needs_a_generator_and_has_its_spread():
    camera = DomeCamera(image_shape=(240, 240), noise_sd=4.0)
    clean = camera.image()
    assert_array_equal(clean, camera.image())
    noisy = camera.image(rng=np.random.default_rng(1)).astype(float)
    again = camera.image(rng=np.random.default_rng(1))
    assert_array_equal(noisy, again)
    grey = clean < 200  # not cut at white
    assert_allclose((noisy - clean)[grey].std(), 4.0, rtol=0.05)  # 20,000 pixels
    small = DomeCamera(image_shape=(120, 120), noise_sd=4.0)
    noise = small.image(rng=np.random.default_rng(1)).astype(float) - small.image()
    assert_allclose(noise[small.image() < 200].std(), 2.0, rtol=0.1)  # 2 x 2 binned


def test_drift_changes_exposure_and_place_only():
    other = DomeCamera().drifted(np.random.default_rng(0))
    assert other.gain != 1
    assert other.disc_centre != DomeCamera().disc_centre
    same = replace(other, gain=1.0, disc_centre=DomeCamera().disc_centre)
    assert same == DomeCamera()
    steady = replace(DomeCamera(), exposure_drift_sd=0.0, centre_drift_sd=0.0)
    assert steady.drifted(np.random.default_rng(0)) == steady


def test_exposure_and_gamma_follow_the_formula():
    bright = replace(CLEAN, gain=0.25, gamma=1.0).no_contact().astype(float)
    dim = replace(CLEAN, gain=0.125, gamma=1.0).no_contact()
    root = replace(CLEAN, gain=0.25, gamma=2.0).no_contact()
    inside = within(0.97, 120) & (bright < 250)
    assert_allclose(dim[inside], bright[inside] / 2, atol=1)  # whole grey levels
    expected = 255 * np.sqrt(bright / 255)
    assert_allclose(root[inside], expected[inside], atol=3)


def test_light_of_a_single_led_at_the_lens():
    """A plane facing the lens: diffuse + specular on the axis, cos^n off it."""
    lamp = Lighting(n_leds=1, ring_radius_mm=0.0, diffuse=1.0, specular=0.0)
    x = np.array([[0.0, 30.0, 60.0]], np.float32)
    flat = np.zeros_like(x)
    light = lamp.shade((x, flat, flat + 60), (flat, flat), 60.0)
    cosine = 60 / np.hypot(x, 60)
    # Lambert's cosine, the inverse square (cos^2) and the lens (cos^4).
    assert_allclose(light, cosine**7, rtol=1e-5)
    shiny = replace(lamp, diffuse=0.0, specular=1.0, shininess=10.0)
    light = shiny.shade((x, flat, flat + 60), (flat, flat), 60.0)
    assert_allclose(light, cosine ** (10 + 6), rtol=1e-4)


def test_pickle_keeps_the_camera():
    DomeCamera().no_contact()
    assert pickle.loads(pickle.dumps(DomeCamera(gain=0.9))) == DomeCamera(gain=0.9)


@pytest.mark.parametrize(
    ("fields", "error", "message"),
    [
        ({"image_shape": 96}, ValueError, "image_shape must be a pair"),
        ({"image_shape": (4, 96)}, ValueError, "image_shape must be at least 8"),
        ({"image_shape": (10**5, 10**5)}, ValueError, "at most 8000000 pixels, got 1"),
        ({"image_shape": (96.0, 96)}, TypeError, "image_shape must be an integer"),
        ({"force_n": -1.0}, ValueError, "force_n must be positive"),
        ({"noise_sd": -1.0}, ValueError, "noise_sd must be finite and between 0"),
        ({"camera_distance_mm": 25.0}, ValueError, "camera_distance_mm must exceed"),
        ({"n_leds": 0}, ValueError, "n_leds must be at least 1"),
        ({"youngs_mpa": np.nan}, ValueError, "youngs_mpa must be positive"),
        ({"disc_centre": (0.5, np.inf)}, ValueError, "disc_centre must be finite"),
    ],
)
def test_bad_cameras_are_refused(fields, error, message):
    with pytest.raises(error, match=message):
        DomeCamera(**fields)


@pytest.mark.realdata
def test_no_contact_frame_is_as_bright_as_the_real_one(data_folder):
    """Light was fitted to this one frame: medians over rings, rim to saturation."""
    path = data_folder / "bathtip" / "originals" / "baselineForCalibration.jpg"
    real = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    ours = replace(CLEAN, image_shape=(480, 640)).no_contact()
    row, col = np.mgrid[:480, :640] + 0.5
    # Radii are about each picture's own disc; the real one is 4 pixels higher.
    real_radius = np.hypot(row - 206.5, col - 215.5)
    our_radius = np.hypot(row - 210, col - 213)
    for inner in range(0, 250, 10):
        ring = [
            np.median(picture[(radius >= inner) & (radius < inner + 10)])
            for picture, radius in ((real, real_radius), (ours, our_radius))
        ]
        assert_allclose(ring[1], ring[0], atol=4)
