"""`palpate explore` from outside: learning, recognising, going on, refusing."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import trimesh

from palpate import Touches
from palpate.exploration import (
    Hemisphere,
    InformativeTouch,
    RandomHemisphere,
    Raster,
    SurfaceMap,
    read_episode,
)
from palpate.recognition import ObjectRecogniser

ENDS = {"decision", "unknown", "budget"}


@pytest.fixture
def model(explored, tmp_path):
    shutil.copytree(explored, tmp_path, dirs_exist_ok=True)
    return tmp_path / "m.palpate"


def test_learning_writes_a_model_and_its_touches_and_goes_on(palpate, tmp_path):
    words = (
        "explore", "learn", "pen", "ball", "--touches", 4, "--sessions", 2,
        "--rows", 32, "--workers", 1, "--folder", "kept",
    )  # fmt: skip
    answer = palpate.answer(*words, "-o", "m.palpate", cwd=tmp_path)
    assert answer["labels"] == ["ball", "pen"]
    touches = Touches.load(tmp_path / answer["touches"])
    assert touches.object.tolist() == ["pen"] * 4 + ["ball"] * 4
    assert touches.columns["direction"].shape == (8, 3)
    assert ObjectRecogniser.load(tmp_path / answer["model"]).classes_.size == 2
    # Recorded touches are not made again: their files keep their times.
    files = sorted((tmp_path / "kept").rglob("touch_*.npz"))
    times = [file.stat().st_mtime_ns for file in files]
    palpate.printed(*words, "-o", "again.palpate", cwd=tmp_path)
    assert [file.stat().st_mtime_ns for file in files] == times
    assert np.array_equal(Touches.load(tmp_path / "again.npz").images, touches.images)


def starts_as_in(record, pose):
    """Whether a touch began on the side where a strategy chose."""
    directions = record.start.direction, pose.direction
    return np.allclose(*directions, rtol=0, atol=1e-9)  # rounding of a file


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["informative", "random", "raster"])
def test_every_strategy_comes_to_an_end(palpate, model, strategy):
    answer = palpate.answer(
        "explore", "recognise", model, "ball", "--strategy", strategy,
        "--max-touches", 6,
    )  # fmt: skip
    assert answer["strategy"] == strategy
    assert answer["ended_by"] in ENDS
    assert answer["n_attempts"] == len(answer["attempts"]) <= 6
    for attempt in answer["attempts"]:
        assert set(attempt["posterior"]) == {"ball", "box", "pen"}
        # Probabilities in doubles: rounding of four terms.
        known_probability = sum(attempt["posterior"].values())
        assert abs(known_probability + attempt["unknown"] - 1) < 1e-9


def test_the_belief_is_drawn_and_faults_are_shown(palpate, model, tmp_path):
    lines = palpate.printed(
        "explore", "recognise", model, "box", "--strategy", "raster", "--error", 1e-6,
        "--max-touches", 3, "--fault", "1=no force", "--folder", "kept", cwd=tmp_path,
    ).splitlines()  # fmt: skip
    assert "touch   1" in lines[0]
    assert "reads nan" in lines[1]
    records = read_episode(tmp_path / "kept")
    assert [record.outcome for record in records][:2] == ["touched", "force sensor"]
    assert starts_as_in(records[1], Raster(Hemisphere()).next_pose(None, records[:1]))


def test_flags_faults_and_what_moved_the_belief_are_given(palpate, model, tmp_path):
    answer = palpate.answer(
        "explore", "recognise", model, "box", "--error", 1e-6, "--max-touches", 4,
        "--fault", "0=no frame", "--fault", "2=out of reach", "--folder", "kept",
        cwd=tmp_path,
    )  # fmt: skip
    touches = Touches.load(model.with_suffix(".npz"))
    touch_map = SurfaceMap().fit(ObjectRecogniser.load(model), touches)
    start = InformativeTouch(touch_map, Hemisphere()).next_pose(touch_map.start(), [])
    assert starts_as_in(read_episode(tmp_path / "kept")[0], start)
    outcomes = [attempt["outcome"] for attempt in answer["attempts"]]
    assert outcomes == ["no frame", "touched", "nothing", "touched"]
    flags = [attempt["flag"] for attempt in answer["attempts"]]
    assert [flag is None for flag in flags] == [True, False, True, False]
    assert {moved["attempt"] for moved in answer["explanation"]} == {1, 3}
    for moved in answer["explanation"]:
        assert moved["flag"] == flags[moved["attempt"]]
        assert {near["object"] for near in moved["nearest"]} <= {"ball", "box", "pen"}


def test_a_refusal_reaches_the_belief(palpate, model, error_shares):
    palpate.printed(
        "explore", "recognise", model, "ball", "--strategy", "random",
        "--max-touches", 2, "--error", 0.02, "--refusal", 0.3,
    )  # fmt: skip
    # A model that is read is tried first, at the usual error.
    assert error_shares - {(0.01, None)} == {(0.02, 0.3)}


FAULTS = (
    *("stuck force", "stuck force in contact", "no force", "overshoot", "driver error"),
    *("slow", "retract error", "arm stuck", "no frame", "out of reach"),
)


def test_every_fault_is_in_the_help(palpate):
    help_text = palpate("explore", "recognise", "--help").stdout
    words = " ".join(help_text.replace("│", " ").split())
    assert all(fault in words for fault in FAULTS)


def test_fewer_touches_than_a_folder_holds_are_learnt(palpate, tmp_path):
    for touches in (4, 2):
        printed = palpate.printed(
            "explore", "learn", "pen", "ball", "--touches", touches, "--sessions", 1,
            "--rows", 32, "--workers", 1, "--folder", "kept", "-o", "m.palpate",
            cwd=tmp_path,
        )  # fmt: skip
        assert f"Explored 2 objects with {2 * touches} touches." in printed
        assert len(Touches.load(tmp_path / "m.npz")) == 2 * touches
    assert len(read_episode(tmp_path / "kept" / "pen" / "0")) >= 4


def test_an_episode_goes_on_in_its_folder(palpate, model, tmp_path):
    def run(most, *more):
        return palpate.printed(
            "explore", "recognise", model, "box", "--strategy", "random",
            "--error", 1e-6, "--max-touches", most, "--folder", "kept", *more,
            cwd=tmp_path,
        )  # fmt: skip

    first = json.loads(run(2, "--json"))
    assert run(4).startswith("Goes on after 2 attempts.")
    third = json.loads(run(4, "--json"))
    assert third["attempts"][:2] == first["attempts"]
    records = read_episode(tmp_path / "kept")
    assert third["n_attempts"] == len(records)
    drawn = RandomHemisphere(Hemisphere(), 0).next_pose(None, records[:1])
    assert starts_as_in(records[1], drawn)


@pytest.mark.parametrize("more", [("--yaw", 90), ("--face", 1), ("--seed", 1)])
def test_an_episode_does_not_go_on_with_what_stands_otherwise(
    palpate, model, tmp_path, more
):
    command = (
        "explore", "recognise", model, "mug", "--strategy", "raster",
        "--error", 1e-6, "--max-touches", 1, "--folder", tmp_path / "kept",
    )  # fmt: skip
    palpate.printed(*command)
    assert "was begun with" in palpate.refusal(*command, *more)
    assert len(read_episode(tmp_path / "kept")) == 1


def test_an_episode_does_not_go_on_with_another_mesh_of_the_same_name(
    palpate, model, tmp_path
):
    command = (
        "explore", "recognise", model, "thing.stl", "--strategy", "raster",
        "--error", 1e-6, "--max-touches", 1, "--folder", "kept",
    )  # fmt: skip
    trimesh.creation.box((40, 40, 40)).export(tmp_path / "thing.stl")
    palpate.printed(*command, cwd=tmp_path)
    trimesh.creation.cylinder(radius=20, height=40).export(tmp_path / "thing.stl")
    assert "was begun with" in palpate.refusal(*command, cwd=tmp_path)
    assert len(read_episode(tmp_path / "kept")) == 1


@pytest.mark.slow
def test_killed_while_learning_nothing_recorded_is_lost(tmp_path):
    arguments = (
        "explore", "learn", "pen", "ball", "--touches", "8", "--sessions", "1",
        "--rows", "48", "--workers", "1", "--folder", "kept", "-o", "m.palpate",
    )  # fmt: skip
    code = (
        f"import sys; sys.argv[1:] = {arguments}\nfrom palpate.cli import main\nmain()"
    )

    def start():
        return subprocess.Popen(
            [sys.executable, "-c", code],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )

    for wanted in (2, 5):
        program = start()
        end = time.monotonic() + 60
        while len(list((tmp_path / "kept").rglob("touch_*.npz"))) < wanted:
            assert time.monotonic() < end
            assert program.poll() is None
            time.sleep(0.01)
        program.send_signal(signal.SIGKILL)
        program.communicate()
        kept = read_episode(tmp_path / "kept" / "pen" / "0")
        assert len(kept) >= wanted
    images = [record.image for record in kept]
    program = start()
    _, errors = program.communicate(timeout=120)
    assert program.returncode == 0, errors
    touches = Touches.load(tmp_path / "m.npz")
    assert touches.object.tolist() == ["pen"] * 8 + ["ball"] * 8
    kept_images = [image for image in images if image is not None]
    assert all(map(np.array_equal, touches.images, kept_images))


def test_the_belief_is_drawn_from_above(palpate, model, tmp_path):
    pytest.importorskip("matplotlib")
    words = ("explore", "recognise", model, "box", "--max-touches", 1)
    palpate.printed(*words, "--picture", "above.PNG", cwd=tmp_path)
    assert (tmp_path / "above.PNG").read_bytes().startswith(b"\x89PNG")
    (tmp_path / "m.npz").unlink()
    bare = palpate.refusal(
        *words, "--strategy", "random", "--picture", "no.png", cwd=tmp_path
    )
    assert "--picture needs to know where touches were made" in bare
    assert not (tmp_path / "no.png").exists()


def test_choosing_needs_the_touches_that_were_learnt(palpate, model, tmp_path):
    (tmp_path / "m.npz").unlink()
    assert "--taught" in palpate.refusal("explore", "recognise", model, "ball")


def test_a_model_of_another_sensor_is_refused(palpate, tmp_path):
    rng = np.random.default_rng(0)
    touches = Touches(rng.random((8, 3, 8)), object=["a", "b"] * 4, geometry="none")
    path = ObjectRecogniser().fit(touches).save(tmp_path / "array.palpate")
    words = ("explore", "recognise", path, "ball", "--strategy", "random")
    assert "must be of a dome camera, got one of 3 x 8" in palpate.refusal(*words)
