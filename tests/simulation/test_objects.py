"""Built-in objects: closed, of plausible size, resting where they say."""

import pickle
import sys

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from palpate.simulation import (
    HOUSEHOLD,
    PlacedObject,
    SensorPose,
    SimObject,
    find_object,
    find_objects,
    load_mesh,
)

EVERYTHING = find_objects(["household", "unseen", "unlike others", "shapes"])
UNSEEN, BASIC_SHAPES = find_objects("unseen"), find_objects("shapes")
solid = pytest.mark.parametrize(
    "thing", [o for o in EVERYTHING if o.name != "nothing"], ids=lambda o: o.name
)


def test_sets_are_those_of_the_papers():
    assert [len(s) for s in (HOUSEHOLD, UNSEEN, BASIC_SHAPES)] == [10, 5, 7]
    assert len({thing.name for thing in EVERYTHING}) == 23
    household = {thing.category for thing in HOUSEHOLD}
    # All five but the card are of a kind that training knows.
    assert [o.name for o in UNSEEN if o.category not in household] == ["plastic card"]


@solid
def test_surface_is_closed_and_faces_outward(thing):
    assert thing.mesh.is_watertight
    assert thing.mesh.is_winding_consistent
    assert thing.mesh.volume > 0
    # A pen to a book: 5 to 250 mm.
    assert 5 < thing.size_mm.max() < 250


@solid
def test_things_stand_on_level_zero_and_basic_shapes_end_there(thing):
    low, high = thing.mesh.bounds
    level = high[2] if thing in BASIC_SHAPES else low[2]
    # Round feet are polygons; the knobs of the massage ball stand anywhere.
    assert_allclose(level, 0, atol=0.5 if thing.name == "massage ball" else 0.02)


@pytest.mark.parametrize(
    ("name", "size_mm"),
    [
        ("stapler", (140, 32, 50)),
        ("mug", (111, 82, 95)),
        ("box", (160, 110, 60)),
        ("ball", (72, 72, 72)),
        ("textbook", (240, 170, 32)),
        ("water bottle", (65, 65, 225)),
        ("plastic card", (85.6, 54, 0.76)),  # ISO/IEC 7810 ID-1
        ("smaller ball", (46, 46, 46)),
    ],
)
def test_sizes_are_those_of_the_real_things(name, size_mm):
    assert_allclose(find_object(name).size_mm, size_mm, atol=0.2)


def test_nothing_has_no_surface():
    nothing = find_object("nothing")
    assert len(nothing.mesh.faces) == 0
    assert_array_equal(nothing.size_mm, [0, 0, 0])
    distance = PlacedObject(nothing).distance_mm([[0.0, 0, 100]], (0, 0, -1))
    assert_array_equal(distance, [np.inf])


def test_mug_is_hollow_and_has_a_handle():
    placed = PlacedObject(find_object("mug"))
    rays = [[0.0, 0, 200], [39.5, 0, 200], [64, 0, 200], [-64, 0, 200]]
    floor, lip, handle, outside = placed.distance_mm(rays, (0, 0, -1))
    assert 190 < floor < 197  # 3 to 10 mm of floor
    assert_allclose(lip, 200 - 95, atol=0.5)
    assert lip < handle < floor
    assert outside == np.inf


@pytest.mark.parametrize(
    "thing", find_objects(["household", "unseen"]), ids=lambda o: o.name
)
def test_resting_poses_have_ground_below_the_centre_of_mass(thing):
    """Below the centre of mass there is ground that the object stands on."""
    for number in range(len(thing.resting_rotations)):
        rotation = thing.resting_rotations[number]
        assert_allclose(np.linalg.det(rotation), 1)
        corners = thing.mesh.convex_hull.vertices @ rotation.T
        centre = rotation @ thing.mesh.convex_hull.center_mass
        # A pen's clip or a book's cover sag by less than this.
        base = corners[corners[:, 2] < corners[:, 2].min() + 0.7]
        low, high = base[:, :2].min(axis=0), base[:, :2].max(axis=0)
        assert (low <= centre[:2] + 0.5).all()
        assert (centre[:2] - 0.5 <= high).all()


@pytest.fixture
def rests(tmp_path):
    """Return the resting rotations of a mesh, without the one it is built in."""

    def resting(mesh):
        mesh.export(tmp_path / "mesh.ply")
        return load_mesh(tmp_path / "mesh.ply").resting_rotations[1:]

    return resting


def test_stable_rotations_of_a_block_are_its_faces(rests):
    rotations = rests(trimesh.creation.box((30, 20, 10)))
    down = np.array([rotation.T @ (0, 0, -1) for rotation in rotations])
    assert len(rotations) == 6
    assert_allclose(np.abs(down).max(axis=1), 1, atol=1e-6)
    assert_allclose(np.abs(down[:2, 2]), 1, atol=1e-6)  # the largest face first


def test_stable_rotations_leave_out_what_topples(rests):
    leaning = trimesh.creation.box((10, 10, 100))
    leaning.vertices += leaning.vertices[:, [2]] * (0.5, 0, 0)  # centre beyond base
    down = [rotation.T @ (0, 0, -1) for rotation in rests(leaning)]
    assert all(abs(direction[2]) < 0.99 for direction in down)


def test_resting_puts_the_middle_over_the_origin():
    placed = PlacedObject.resting(find_object("mug"), 1, yaw_rad=0.3)
    low, high = placed.bounds_mm
    assert_allclose(low[2], 0, atol=1e-9)
    assert_allclose((low + high)[:2], 0, atol=1e-9)


def test_rays_meet_a_cylinder_where_geometry_says():
    cylinder = trimesh.creation.cylinder(10, height=50, sections=96)
    rod = SimObject("rod", "rod", lambda: cylinder)
    lying = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    placed = PlacedObject(rod, rotation=lying, position_mm=(25, 0, 5))
    y = np.array([0.0, 4.0, 8.0, 10.5])
    origins = np.column_stack([np.full(4, 25.0), y, np.full(4, 105.0)])
    distance = placed.distance_mm(origins, (0, 0, -1))
    # The circle is a polygon of 96 sides, at most 0.005 mm inside.
    assert_allclose(distance[:3], 100 - np.sqrt(100 - y[:3] ** 2), atol=0.02)
    assert distance[3] == np.inf


def distances(direction):
    placed = PlacedObject(find_object("mug"))
    side = np.linspace(-60, 60, 25)
    across = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    origins = placed.centre_mm + np.column_stack([across, np.zeros(len(across))])
    return placed.distance_mm(origins - 300 * np.array(direction), direction)


@pytest.mark.parametrize("direction", [(0, 0, -1), (0, 0.6, -0.8), (0.48, 0.64, -0.6)])
def test_distances_are_those_of_embreex(direction, monkeypatch):
    pytest.importorskip("embreex")
    traced = distances(direction)
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    plain = distances(direction)
    assert np.isfinite(plain).sum() > 20
    # Single precision at 300 mm; a ray along an edge of the mesh may pass it.
    assert np.count_nonzero(~np.isclose(plain, traced, atol=1e-3)) <= 2


def test_sensor_axes_are_right_handed_and_look_down_as_a_map():
    down = SensorPose((0, 0, 100), (0, 0, -5))
    assert_allclose(down.axes, [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-12)
    slanted = SensorPose((0, 0, 100), (1, 2, -3), roll_rad=0.7)
    assert_allclose(slanted.axes.T @ slanted.axes, np.eye(3), atol=1e-12)
    assert_allclose(np.linalg.det(slanted.axes), 1)
    assert_allclose(slanted.axes[:, 2], np.array([1, 2, -3]) / np.sqrt(14))


def test_a_pickled_object_builds_its_mesh_anew():
    again = pickle.loads(pickle.dumps(find_object("pen")))
    assert "mesh" not in vars(again)
    assert_array_equal(again.mesh.vertices, find_object("pen").mesh.vertices)


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(
        ValueError, match=r"stapler, .*flat-to-edge.*'spoon'.*load_mesh"
    ):
        find_object("spoon")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rotation": np.ones((3, 3))}, "rotation must be a 3 x 3 rotation"),
        ({"rotation": np.diag([1.0, 1, -1])}, "rotation must be a 3 x 3 rotation"),
        ({"position_mm": (0, 0)}, "position_mm must be three finite numbers"),
        ({"position_mm": (0, 0, np.nan)}, "position_mm must be three finite"),
        ({"yaw_rad": np.inf}, "yaw_rad must be finite"),
    ],
)
def test_bad_places_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        PlacedObject(find_object("box"), **arguments)


def test_bad_poses_are_refused():
    with pytest.raises(ValueError, match="direction must not be zero"):
        SensorPose((0, 0, 0), (0, 0, 0))
