"""`palpate demo` from outside, with few touches: what it prints and leaves."""

import importlib
import json
from pathlib import Path

import pytest

from palpate.simulation import find_object


@pytest.fixture
def small(monkeypatch):
    """Two objects, few touches of each."""
    demo = importlib.import_module("palpate.cli.demo")
    simulation = importlib.import_module("palpate.simulation")
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")  # No processes to wait for.
    things = [find_object(name) for name in ("mug", "pen")]
    monkeypatch.setattr(simulation, "HOUSEHOLD", things)
    monkeypatch.setattr(simulation, "UNSEEN", [find_object("plastic card")])
    monkeypatch.setattr(demo, "TRAIN_TOUCHES", 12)
    monkeypatch.setattr(demo, "TEST_TOUCHES", 10)
    monkeypatch.setattr(demo, "UNKNOWN_TOUCHES", 10)
    monkeypatch.setattr(demo, "SIDE", 40)
    monkeypatch.setattr(demo, "KNOWN_SHOWN", ("mug",))
    monkeypatch.setattr(demo, "UNKNOWN_SHOWN", ("plastic card",))
    monkeypatch.setattr(demo, "MOST_ATTEMPTS", 3)


def test_it_explores_shows_beliefs_and_controls_and_ends_with_the_report(
    palpate, small, tmp_path
):
    done = palpate("demo", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "touches the mug (learnt)" in done.stdout
    assert "touches the plastic card (never learnt)" in done.stdout
    assert any(line.startswith("  touch   1  ") for line in lines)
    for name in ("disc centre", "brightness", "sorted pixels"):
        assert name in done.stdout
    assert Path(lines[-1]).read_text(encoding="utf-8").startswith("<!")
    assert (tmp_path / "demo" / "ten-objects.palpate").is_file()


@pytest.mark.slow
def test_its_json_is_one_object_with_everything(palpate, small, tmp_path):
    done = palpate("demo", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert {"accuracy", "controls", "unknown_auroc", "episodes", "report"} <= set(told)
    assert [e["object"] for e in told["episodes"]] == ["mug", "plastic card"]
    assert Path(told["report"]).is_file()
