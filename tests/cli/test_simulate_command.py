"""`palpate simulate array` from outside: archives, repeatability, refusals."""

import json

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.simulation import simulate_presses


@pytest.fixture
def simulate(palpate):
    def run(*arguments, cwd=None):
        return palpate("simulate", "array", *arguments, cwd=cwd)

    return run


def test_all_parts_as_the_library_presses_them(simulate, tmp_path):
    path = tmp_path / "t.npz"
    result = simulate("-o", path, "--presses", 2, "--seed", 5, "--json")
    assert result.returncode == 0, result.stderr
    answer = json.loads(result.stdout)
    assert answer["touches"] == str(path)
    assert answer["n_touches"] == 24
    assert len(answer["objects"]) == 12
    touches = Touches.load(path)
    expected = simulate_presses(n_presses=2, random_state=5)
    assert_array_equal(touches.images, expected.images)
    assert_array_equal(touches.object, expected.object)
    assert touches.geometry == "array"


def test_every_option_reaches_the_press(simulate, tmp_path):
    path = tmp_path / "t.npz"
    options = {
        "--presses": 4, "--rows": 12, "--cols": 16, "--pitch": 1.5, "--load": "1:5",
        "--cover": 1.2, "--shift": 0.2, "--turn": 10, "--tilt": 0, "--roughness": 0,
        "--noise": 0, "--gain-spread": 0, "--dead-zone": 0, "--full-scale": 3000,
    }  # fmt: skip
    words = [part for pair in options.items() for part in pair]
    result = simulate("disc13", 8, "-o", path, *words)
    assert result.returncode == 0, result.stderr
    assert result.stdout.splitlines()[-1] == str(path)
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
def test_each_option_changes_the_images(simulate, changes, tmp_path):
    images = []
    for name, more in {"a.npz": (), "b.npz": changes}.items():
        result = simulate(
            "square13-hole8", "-o", tmp_path / name, "--presses", 3, *more
        )
        assert result.returncode == 0, result.stderr
        images.append(Touches.load(tmp_path / name).images)
    assert (images[0] != images[1]).any()


def test_the_same_seed_writes_the_same_touches_with_any_workers(simulate, tmp_path):
    serial, parallel = tmp_path / "1.npz", tmp_path / "2.npz"
    simulate("bar10", 12, "-o", serial, "--presses", 30, "--seed", 3)
    simulate("bar10", 12, "-o", parallel, "--presses", 30, "--seed", 3, "--workers", 2)
    assert_array_equal(Touches.load(serial).images, Touches.load(parallel).images)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["nut", "-o", "t.npz"], 1, "names among bar10"),
        (["-o", "t.npy"], 1, "must end in .npz"),
        (["-o", "gone/t.npz"], 1, "no folder gone"),
        (["-o", "t.npz", "--load", "heavy"], 1, "--load 1:5"),
        (["-o", "t.npz", "--sensing", "3"], 1, "at most pitch_mm"),
        (["-o", "t.npz", "--workers", "0"], 2, "--workers must be at least 1, or -1"),
        (["-o", "t.npz", "--pitch", "1e6"], 1, "Lower --pitch or"),
        (["-o", "t.npz", "--rows", "100000"], 1, "number of taxels (--rows, --cols)"),
        (["-o", "t.npz", "--seed", "-1"], 2, "--seed must be between 0 and 4294967295"),
        ([], 2, "Missing option"),
    ],
)
def test_failures_say_what_to_do(simulate, arguments, code, message, tmp_path):
    result = simulate(*arguments, cwd=tmp_path)
    assert result.returncode == code
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []
