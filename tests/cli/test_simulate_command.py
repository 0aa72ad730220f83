"""`palpate simulate` from outside: archives, repeatability, units."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.simulation import simulate_presses


@pytest.fixture
def simulate(palpate, tmp_path):
    """Return a function that simulates into a file, and reads its touches."""

    def touches(name, *words):
        path = tmp_path / f"{name}.npz"
        palpate.printed("simulate", *words, "-o", path, cwd=tmp_path)
        return Touches.load(path)

    return touches


def test_all_parts_as_the_library_presses_them(palpate, tmp_path):
    path = tmp_path / "t.npz"
    words = ("simulate", "array", "-o", path, "--presses", 2, "--seed", 5)
    expected = simulate_presses(n_presses=2, random_state=5)
    assert palpate.answer(*words) == {
        "touches": str(path),
        "n_touches": 24,
        "objects": list(dict.fromkeys(expected.object)),
    }
    touches = Touches.load(path)
    assert_array_equal(touches.images, expected.images)
    assert_array_equal(touches.object, expected.object)
    assert touches.geometry == "array"


def test_every_option_reaches_the_press(palpate, tmp_path):
    path = tmp_path / "t.npz"
    options = {
        "--presses": 4, "--rows": 12, "--cols": 16, "--pitch": 1.5, "--load": "1:5",
        "--cover": 1.2, "--shift": 0.2, "--turn": 10, "--tilt": 0, "--roughness": 0,
        "--noise": 0, "--gain-spread": 0, "--dead-zone": 0, "--full-scale": 3000,
    }  # fmt: skip
    words = [part for pair in options.items() for part in pair]
    printed = palpate.printed("simulate", "array", "disc13", 8, "-o", path, *words)
    assert printed.splitlines()[-1] == str(path)
    touches = Touches.load(path)
    assert touches.images.shape == (8, 12, 16)
    assert list(dict.fromkeys(touches.object)) == ["disc13", "square13"]
    assert touches.whole["set_pitch_mm"] == 1.5
    columns = touches.columns
    load = columns["force_n"] / 9.80665
    assert ((load >= 1) & (load <= 5)).all()
    assert np.ptp(load) > 0.5
    assert np.abs(columns["position_mm"]).max() <= 0.2
    assert np.abs((columns["angle_deg"] + 180) % 360 - 180).max() <= 10
    assert (columns["tilt_deg"] == 0).all()


@pytest.mark.parametrize(
    "changes",
    [
        ("--cover", 2),
        ("--noise", 40),
        ("--gain-spread", 0.3),
        ("--dead-zone", 600),
        ("--full-scale", 2000),
        ("--sensing", 2),
        ("--roughness", 30),
        ("--tilt", 0.3),
        ("--device", 1),
        ("--seed", 1),
    ],
    ids=lambda changes: changes[0],
)
def test_each_option_changes_the_images(simulate, changes):
    words = ("array", "square13-hole8", "--presses", 3)
    plain, changed = simulate("plain", *words), simulate("changed", *words, *changes)
    assert (plain.images != changed.images).any()


def test_the_same_seed_writes_the_same_touches_with_any_workers(simulate):
    words = ("array", "bar10", 12, "--presses", 30, "--seed", 3)
    serial, parallel = simulate("1", *words), simulate("2", *words, "--workers", 2)
    assert_array_equal(serial.images, parallel.images)


def test_dome_touches_objects_and_a_mesh_file(palpate, tmp_path):
    trimesh.creation.box((30, 40, 50)).export(tmp_path / "brick.stl")
    answer = palpate.answer(
        "simulate", "dome", "-o", "t.npz", "mug", "brick.stl", "--touches", 3,
        "--sessions", 2, "--rows", 64, "--cols", 64, "--workers", 1, cwd=tmp_path,
    )  # fmt: skip
    assert answer["n_touches"] == 6
    touches = Touches.load(tmp_path / "t.npz")
    assert touches.images.shape == (6, 64, 64)
    assert set(touches.object) == {"mug", "brick"}
    assert touches.geometry == "dome"


def test_pins_touch_the_basic_shapes(simulate):
    words = ("--touches", 2, "--rows", 80, "--cols", 80, "--workers", 1)
    touches = simulate("t", "pins", "edge", "nothing", *words)
    assert touches.images.shape == (4, 80, 80)


def test_the_seed_of_a_dome_settles_its_touches(simulate):
    words = ("dome", "pen", "--touches", 2, "--rows", 48, "--cols", 48, "--seed")
    first, same, other = (simulate("t", *words, seed).images for seed in (7, 7, 8))
    assert_array_equal(first, same)
    assert (first != other).any()


def test_inches_are_read_as_the_help_says(palpate, simulate, tmp_path):
    assert "mm, cm, m or in" in palpate.printed("simulate", "dome", "--help")
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "brick.stl")
    trimesh.creation.box((25.4, 50.8, 76.2)).export(tmp_path / "same.stl")
    small = ("--touches", 2, "--rows", 32, "--cols", 32, "--workers", 1)
    inches, mm, cm = (
        simulate("t", "dome", f"{name}.stl", "--unit", unit, *small).images.astype(int)
        for name, unit in (("brick", "in"), ("same", "mm"), ("same", "cm"))
    )
    # Corners in inches times 25.4 round otherwise in the last bit of a float32.
    assert np.abs(inches - mm).max() <= 1
    assert np.abs(inches - cm).max() > 1


def test_a_mesh_of_a_known_name_is_refused(palpate, tmp_path):
    trimesh.creation.box((30, 40, 50)).export(tmp_path / "mug.stl")
    words = ("simulate", "dome", "mug", "mug.stl", "-o", "o.npz")
    refused = palpate.refusal(*words, cwd=tmp_path)
    assert "got 'mug' as 'mug' and 'mug.stl'. Leave one out" in refused
    assert not (tmp_path / "o.npz").exists()
