"""`palpate demo` from outside, with few touches: what it prints and leaves."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

RECORDED = ("ball_a", "box_b", "can_c", "mug_d")


@pytest.fixture
def small(monkeypatch):
    """Two objects, few touches of each."""
    demo = importlib.import_module("palpate.cli.demo")
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")  # No processes to wait for.
    monkeypatch.setattr(demo, "LEARNT", ("mug", "pen"))
    monkeypatch.setattr(demo, "UNLIKE", ("plastic card",))
    monkeypatch.setattr(demo, "TRAIN_TOUCHES", 8)
    monkeypatch.setattr(demo, "TEST_TOUCHES", 6)
    monkeypatch.setattr(demo, "UNKNOWN_TOUCHES", 6)
    monkeypatch.setattr(demo, "SIDE", 40)
    monkeypatch.setattr(demo, "EPISODES_OF", ("mug",))
    monkeypatch.setattr(demo, "MOST_ATTEMPTS", 3)


def test_demo_explores_shows_beliefs_and_controls_and_ends_with_the_report(
    palpate, small, tmp_path
):
    printed = palpate.printed("demo", cwd=tmp_path)
    lines = printed.splitlines()
    assert "touches the mug (learnt)" in printed
    assert "touches the plastic card (never learnt)" in printed
    assert any(line.startswith("  touch   1  ") for line in lines)
    for name in ("disc centre", "brightness", "sorted pixels"):
        assert name in printed
    assert Path(lines[-1]).read_text(encoding="utf-8").startswith("<!")
    assert (tmp_path / "demo" / "six-objects.palpate").is_file()


def test_a_file_in_place_of_the_demo_s_folder_is_refused_at_once(palpate, tmp_path):
    (tmp_path / "file").touch()
    refusal = palpate.refusal("demo", "--output", "file", cwd=tmp_path)
    assert "--output must be a folder, got the file 'file'" in refusal


@pytest.mark.slow
def test_demo_prints_everything_as_one_json_object(palpate, small, tmp_path):
    answer = palpate.answer("demo", cwd=tmp_path)
    assert {"accuracy", "controls", "unknown_auroc", "episodes", "report"} <= {*answer}
    assert [e["object"] for e in answer["episodes"]] == ["mug", "plastic card"]
    assert Path(answer["report"]).is_file()


@pytest.fixture
def recorded(monkeypatch, tmp_path, rng):
    """Small pictures of four objects, with names like those of the recorded ones."""
    demo = importlib.import_module("palpate.cli.demo")
    monkeypatch.setattr(demo, "RECORDED_TOUCHES", 12)
    folder = tmp_path / "data" / "bathtip" / "originals"
    folder.mkdir(parents=True)
    for code, name in enumerate(RECORDED):
        pattern = np.random.default_rng(code).integers(60, 200, (6, 24))
        for n in range(24):
            touch = pattern + rng.normal(scale=5, size=(6, 24))
            place = folder / f"touch_{n}_img_{n}_name_{name}_at_0_0_{n}.jpg"
            Image.fromarray(touch.astype(np.uint8)).save(place, quality=95)
    nothing = Image.fromarray(np.full((6, 24), 128, np.uint8))
    nothing.save(folder / "baselineForCalibration.jpg")
    monkeypatch.setenv("PALPATE_DATA", str(tmp_path / "data"))


def test_with_recorded_pictures_two_objects_are_unknown(palpate, recorded, tmp_path):
    printed = palpate.printed("demo", "--real", cwd=tmp_path)
    assert "Learnt 2 objects from 24 touches" in printed
    unknown = re.search(r"Now (\w+) and (\w+), recorded .* left out", printed)
    assert unknown is not None
    assert set(unknown.groups()) < set(RECORDED)
    before, after = printed.split("Now ")
    for name in RECORDED:
        assert f"Touches of {name}:" in (after if name in unknown.groups() else before)
    (area,) = [line for line in printed.splitlines() if "unknown, ROC area" in line]
    # The patterns have nothing in common, and the noise is small.
    assert float(area.split()[-2]) > 0.9
    assert (tmp_path / "demo" / "recorded-objects.palpate").is_file()


@pytest.mark.slow
@pytest.mark.realdata
def test_real_pictures_leave_two_objects_unknown(palpate, data_folder, tmp_path):
    answer = palpate.answer("demo", "--real", cwd=tmp_path)
    assert answer["n_labels"] == 8
    assert len(answer["episodes"]) == 10
    assert answer["unknown_auroc"]["10"] > 0.8


def test_make_demo_ends_with_what_the_demo_prints_last():
    """That is the path of the report; what else is to be said comes before."""
    recipe = (Path(__file__).parents[2] / "Makefile").read_text("utf-8")
    lines = recipe.partition("\ndemo:")[2].partition("\n\n")[0].splitlines()
    assert lines[-1].startswith("\t@$(BIN)/palpate demo")
