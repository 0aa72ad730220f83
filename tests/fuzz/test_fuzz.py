"""Some seeds of the standing campaign, and what it found; `make fuzz` goes on."""

import sys

import pytest

import fuzz

SEEDS = {
    "model": 5,
    "archive": 60,
    "picture": 80,
    "bag": 20,
    "message": 80,
    "learning": 3,
    "library": 1,
    "belief": 1,
    "session": 1,
}


@pytest.mark.parametrize(("kind", "n_seeds"), SEEDS.items())
def test_some_seeds(kind, n_seeds):
    for seed in range(n_seeds):
        assert fuzz.tried(kind, seed)


def test_a_run_goes_on_where_the_last_one_stopped(tmp_path, monkeypatch):
    file = tmp_path / "seeds.json"
    words = ["--kind", "message", "--seconds", "0.3", "--file", str(file)]
    monkeypatch.setattr(sys, "argv", [fuzz.__file__, *words])
    for _ in range(2):
        before = file.read_text() if file.exists() else '{"message": 0}'
        assert fuzz.main() == 0
        assert int(file.read_text().strip("}").rsplit(": ")[1]) > int(
            before.strip("}").rsplit(": ")[1]
        )
