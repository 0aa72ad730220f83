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
    done = simulate(
        "dome", "-o", "t.npz", "mug", "brick.stl", "--touches", 3, "--sessions", 2,
        "--rows", 64, "--cols", 64, "--workers", 1, "--json", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["n_touches"] == 6
    made = Touches.load(tmp_path / "t.npz")
    assert made.images.shape == (6, 64, 64)
    assert set(made.object) == {"mug", "brick"}
    assert made.geometry == "dome"


def test_pins_touch_the_basic_shapes(simulate, tmp_path):
    done = simulate(
        "pins", "-o", "t.npz", "edge", "nothing", "--touches", 2,
        "--rows", 80, "--cols", 80, "--workers", 1, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    made = Touches.load(tmp_path / "t.npz")
    assert made.images.shape == (4, 80, 80)


def test_same_seed_same_touches(simulate, tmp_path):
    for name in ("a.npz", "b.npz"):
        done = simulate(
            "dome", "-o", name, "pen", "--touches", 2, "--rows", 48, "--cols", 48,
            "--seed", 7, cwd=tmp_path,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    first, second = (Touches.load(tmp_path / name) for name in ("a.npz", "b.npz"))
    assert np.array_equal(first.images, second.images)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["dome", "-o", "t.npz", "spoon"], "got 'spoon'"),
        (["dome", "-o", "t.txt"], "must end in .npz"),
        (["dome", "-o", "gone/t.npz"], "no folder gone"),
        (["dome", "-o", "t.npz", "gone.stl"], "gone.stl"),
        (["dome", "-o", "t.npz", "mug", "edge"], "archives of their own"),
        (["dome", "-o", "t.npz", "mug", "--force", "-1"], "force_n must be positive"),
        (["pins", "-o", "t.npz", "mug", "--touches", "0"], "at least 1, got 0"),
    ],
)
def test_refusals_leave_nothing(simulate, tmp_path, arguments, message):
    done = simulate(*arguments, cwd=tmp_path)
    assert done.returncode == 1
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
