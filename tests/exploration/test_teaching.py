"""Putting objects down before the arm, and exploring to learn them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from palpate.exploration import (
    RandomHemisphere,
    RobotError,
    explore_to_learn,
    put_down,
    read_episode,
)
from palpate.simulation import DomeCamera, SimObject, find_object

CAMERA = DomeCamera(image_shape=(24, 24), n_nodes=20)
BOX, PEN, BALL = (find_object(name) for name in ("box", "pen", "ball"))
HUGE = SimObject("huge", "huge", lambda: BALL.build().apply_scale(10))


def test_touches_are_of_every_object_and_session():
    touches = explore_to_learn([PEN, BOX], 3, CAMERA, n_sessions=2)
    assert touches.images.shape == (6, 24, 24)
    assert touches.object.tolist() == ["pen"] * 3 + ["box"] * 3
    assert touches.session.tolist() == [0, 0, 1] * 2
    assert np.array_equal(touches.no_contact, CAMERA.no_contact())
    assert_allclose(np.linalg.norm(touches.columns["direction"], axis=1), 1)


def test_the_same_seed_gives_the_same_touches():
    first, same, other = (
        explore_to_learn([BOX], 2, CAMERA, n_sessions=1, random_state=seed).images
        for seed in (3, 3, 4)
    )
    assert np.array_equal(first, same)
    assert not np.array_equal(first, other)


def test_unguarded_touches_are_the_guarded_ones_made_in_one_step(tmp_path):
    guarded, at_once = (
        explore_to_learn([BOX], 4, CAMERA, n_sessions=2, turned=True, guarded=guarded)
        for guarded in (True, False)
    )
    # The guard's last step is of a quarter of a millimetre; its readings are noisy by
    # 0.005 N, and between solved forces the bench interpolates.
    places = guarded.columns["position_mm"], at_once.columns["position_mm"]
    assert_allclose(*places, atol=0.35)
    assert at_once.session.tolist() == [0, 0, 1, 1]
    with pytest.raises(ValueError, match="folder must be None where guarded is False"):
        explore_to_learn([BOX], 1, CAMERA, guarded=False, folder=tmp_path)


def test_places_are_in_the_objects_frame_however_it_is_turned():
    touches = explore_to_learn(
        [BOX], 12, CAMERA, n_sessions=3, turned=True, placement_sd_mm=0.0
    )
    # The tip ends on the surface of the box, 160 x 110 x 60 mm and aligned with its
    # own frame, or pressed into it by a dent of at most 12 mm; the object gives way
    # by up to 5 % of its size.
    half = np.array([80.0, 55.0, 30.0])
    centre = np.array([0.0, 0.0, 30.0])
    outside = np.abs(touches.columns["position_mm"] - centre) - half
    assert_allclose(outside.max(axis=1), -4, atol=8 + 8)


def test_an_episode_that_was_begun_goes_on(tmp_path):
    def run(n_touches):
        return explore_to_learn([PEN], n_touches, CAMERA, n_sessions=1, folder=tmp_path)

    few, more = run(2), run(4)
    assert np.array_equal(more.images[:2], few.images)
    kept = read_episode(tmp_path / "pen" / "0")
    assert sum(record.touched for record in kept) == 4


@pytest.mark.parametrize(
    "otherwise",
    [
        {"turned": True},
        {"faces": "all"},
        {"placement_sd_mm": 1.0},
        {"drift": True},
        {"camera": replace(CAMERA, gain=0.5)},
    ],
    ids=lambda otherwise: next(iter(otherwise)),
)
def test_what_was_begun_otherwise_is_refused(tmp_path, otherwise):
    # At one height whatever the face: the hemisphere does not tell them apart.
    how = {"n_sessions": 2, "known_height": False, "folder": tmp_path, "n_jobs": 1}
    how |= {"camera": CAMERA}
    explore_to_learn([BOX], 2, **how)
    with pytest.raises(ValueError, match="Go on with the same settings"):
        explore_to_learn([BOX], 2, **how | otherwise)


def test_another_surface_of_the_same_name_and_size_is_refused(tmp_path):
    box, can = (
        SimObject("thing", "thing", mesh.copy)
        for mesh in (
            trimesh.creation.box((40, 40, 40)),
            trimesh.creation.cylinder(radius=20, height=40),
        )
    )
    how = {"n_sessions": 1, "folder": tmp_path, "n_jobs": 1}
    explore_to_learn([box], 1, CAMERA, **how)
    with pytest.raises(ValueError, match="Go on with the same settings"):
        explore_to_learn([can], 1, CAMERA, **how)


@pytest.mark.parametrize("random_state", [None, -1, 0.5])
def test_a_seed_that_is_none_is_refused(random_state):
    message = "random_state must be a"
    with pytest.raises((TypeError, ValueError), match=message):
        explore_to_learn([BOX], 2, CAMERA, random_state=random_state)
    with pytest.raises((TypeError, ValueError), match=message):
        RandomHemisphere(random_state=random_state)


@pytest.mark.parametrize("name", ["../elsewhere", "/elsewhere", "box/../../elsewhere"])
def test_a_name_that_leads_out_of_the_folder_is_refused(tmp_path, name):
    box = SimObject(name, "box", partial(trimesh.creation.box, (40, 40, 40)))
    folder = tmp_path / "taught"
    with pytest.raises(ValueError, match="names of folders within `folder`"):
        explore_to_learn([box], 1, CAMERA, folder=folder)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("things", "message"),
    [([PEN, BOX, PEN], "of their own, got 'pen' twice"), ([], "one object, got none")],
)
def test_no_objects_and_two_of_one_name_are_no_set(things, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        explore_to_learn(things, 2, CAMERA, folder=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_frames_are_lost_and_objects_go_out_of_reach_when_asked():
    stand = put_down(BOX, CAMERA, faults={0: "no frame", 1: "out of reach"})
    poses = [stand.hemisphere.pose(0.7 * number, 0.8) for number in range(3)]
    records = [stand.touch(pose) for pose in poses]
    assert [r.outcome for r in records] == ["no frame", "nothing", "touched"]


def test_nothing_to_touch_is_told_though_nothing_is_guarded():
    nothing = [find_object("nothing")]
    with pytest.raises(RobotError, match="Only 0 of 2 touches"):
        explore_to_learn(nothing, 2, CAMERA, n_sessions=1, guarded=False)


def test_an_object_is_put_down_near_the_middle_turned_and_on_a_face():
    stand = put_down(BOX, CAMERA, face=1, yaw_rad=0.5, placement_sd_mm=0.0)
    assert stand.thing is BOX
    x, y, z = stand.hemisphere.centre_mm
    # Turned by half a radian, its middle is above the origin all the same; face 1 of
    # a box is one of its sides, so it stands as high as another of its lengths.
    assert_allclose((x, y), 0, atol=1e-6)
    assert min(abs(2 * z - side) for side in (160, 110)) < 1e-3
    record = stand.touch(stand.hemisphere.pose(0.3, 0.8))
    assert record.outcome == "touched"
    assert_allclose(
        np.linalg.norm(np.subtract(stand.robot.read_pose().position_mm, (x, y, z))),
        300,
        atol=1e-6,
    )


@pytest.mark.parametrize(
    ("name", "known_height", "height_mm"),
    [
        ("water bottle", True, 112.5),
        ("water bottle", False, 10.0),
        ("pen", False, 10.0),
    ],
)
def test_lines_aim_at_the_middle_of_an_object_or_at_one_height_whatever_it_is(
    name, known_height, height_mm
):
    options = {"n_sessions": 1, "placement_sd_mm": 0.0, "known_height": known_height}
    touches = explore_to_learn([find_object(name)], 6, CAMERA, **options)
    tips, directions = touches.columns["position_mm"], touches.columns["direction"]
    aside = np.linalg.norm(np.cross(tips - [0, 0, height_mm], directions), axis=1)
    assert_allclose(aside, 0, atol=0.1)


def test_an_arm_that_does_not_know_heights_meets_the_top_from_above():
    stand = put_down(find_object("water bottle"), CAMERA, known_height=False)
    above = stand.touch_at_once(stand.hemisphere.pose(0.0, np.pi / 2))
    # So high, less the press.
    assert above.position_mm[2] == pytest.approx(225, abs=6)


@pytest.mark.parametrize(
    ("thing", "options", "error", "message"),
    [
        ("mug", {}, TypeError, r"must be a SimObject, got str.*find_object"),
        (PEN, {"face": 1}, ValueError, r"face must be below 1.*'pen'"),
        (HUGE, {}, ValueError, r"fit into a hemisphere of 300 mm.*its unit"),
        (BOX, {"placement_sd_mm": 4000.0}, ValueError, r"was put \d+ mm aside"),
    ],
    ids=["name", "face", "huge", "aside"],
)
def test_what_cannot_be_put_down_is_refused(thing, options, error, message):
    with pytest.raises(error, match=message):
        put_down(thing, CAMERA, **options)
