"""`palpate simulate dome` and `pins` from outside."""

import json

import numpy as np
import pytest

from palpate import Touches


@pytest.fixture
def simulate(palpate):
    def run(*arguments, cwd):
        return palpate("simulate", *arguments, cwd=cwd)

    return run


def test_dome_touches_objects_and_a_mesh_file(simulate, tmp_path):
    import trimesh

    trimesh.creation.box((30, 40, 50)).export(tmp_path / "brick.stl")
    result = simulate(
        "dome", "-o", "t.npz", "mug", "brick.stl", "--touches", 3, "--sessions", 2,
        "--rows", 64, "--cols", 64, "--workers", 1, "--json", cwd=tmp_path,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["n_touches"] == 6
    touches = Touches.load(tmp_path / "t.npz")
    assert touches.images.shape == (6, 64, 64)
    assert set(touches.object) == {"mug", "brick"}
    assert touches.geometry == "dome"


def test_pins_touch_the_basic_shapes(simulate, tmp_path):
    result = simulate(
        "pins", "-o", "t.npz", "edge", "nothing", "--touches", 2,
        "--rows", 80, "--cols", 80, "--workers", 1, cwd=tmp_path,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    touches = Touches.load(tmp_path / "t.npz")
    assert touches.images.shape == (4, 80, 80)


def test_the_same_seed_makes_the_same_touches(simulate, tmp_path):
    for name in ("a.npz", "b.npz"):
        result = simulate(
            "dome", "-o", name, "pen", "--touches", 2, "--rows", 48, "--cols", 48,
            "--seed", 7, cwd=tmp_path,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
    first, second = (Touches.load(tmp_path / name) for name in ("a.npz", "b.npz"))
    assert np.array_equal(first.images, second.images)


def test_inches_are_read_as_the_help_says(simulate, tmp_path):
    import trimesh

    assert "mm, cm, m or in" in simulate("dome", "--help", cwd=tmp_path).stdout
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "brick.stl")
    trimesh.creation.box((25.4, 50.8, 76.2)).export(tmp_path / "same.stl")
    images = []
    for name, unit in (("brick", "in"), ("same", "mm"), ("same", "cm")):
        result = simulate(
            "dome", "-o", "t.npz", f"{name}.stl", "--unit", unit, "--touches", 2,
            "--rows", 32, "--cols", 32, "--workers", 1, cwd=tmp_path,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
        images.append(Touches.load(tmp_path / "t.npz").images.astype(float))
    # Corners in inches times 25.4 round otherwise in the last bit of a float32.
    assert np.abs(images[0] - images[1]).max() <= 1
    assert np.abs(images[0] - images[2]).max() > 1


def test_a_mesh_of_a_known_name_is_refused(simulate, tmp_path):
    import trimesh

    trimesh.creation.box((30, 40, 50)).export(tmp_path / "mug.stl")
    result = simulate("dome", "mug", "mug.stl", "-o", "o.npz", cwd=tmp_path)
    assert result.returncode == 1
    assert "got 'mug' as 'mug' and 'mug.stl'. Leave one out" in result.stderr
    assert not (tmp_path / "o.npz").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["dome", "-o", "t.npz", "spoon"], "got 'spoon'"),
        (["dome", "-o", "t.txt"], "must end in .npz"),
        (["dome", "-o", "gone/t.npz"], "no folder gone"),
        (["dome", "-o", "t.npz", "gone.stl"], "got no file 'gone.stl'. Check its name"),
        (["dome", "-o", "t.npz", "mug", "mug"], "got 'mug' as 'mug' and 'mug'"),
        (["pins", "-o", "t.npz", "household", "mug"], "'mug' as 'household' and 'mug'"),
        (["dome", "-o", "t.npz", "--workers", "0"], "all cores, got 0."),
        (["pins", "-o", "t.npz", "--workers", "-2"], "all cores, got -2."),
        (["dome", "-o", "t.npz", "--rows", "100000"], "100000 x 120. Take fewer rows"),
        (["pins", "-o", "t.npz", "--seed", "4294967296"], "4294967295, got 4294967296"),
        (["dome", "-o", "t.npz", "mug", "edge"], "archives of their own"),
        (["dome", "-o", "t.npz", "mug", "--force", "-1"], "--force must be positive"),
        (["pins", "-o", "t.npz", "mug", "--touches", "0"], "at least 1, got 0"),
    ],
)
def test_a_refused_command_leaves_no_file(simulate, tmp_path, arguments, message):
    result = simulate(*arguments, cwd=tmp_path)
    assert result.returncode == 1 + ("--workers" in arguments or "--seed" in arguments)
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []
