"""Some seeds of the standing campaign, and what it found; `make fuzz` goes on."""

import subprocess
import sys

import pytest

import fuzz

SEEDS = {
    "model": 10,
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


def test_a_run_goes_on_where_the_last_one_stopped(tmp_path):
    file = tmp_path / "seeds.json"
    for _ in range(2):
        before = file.read_text() if file.exists() else '{"message": 0}'
        subprocess.run(
            [
                sys.executable,
                fuzz.__file__,
                "--kind",
                "message",
                "--seconds",
                "0.3",
                "--file",
                str(file),
            ],
            check=True,
            capture_output=True,
        )
        assert int(file.read_text().strip("}").rsplit(": ")[1]) > int(
            before.strip("}").rsplit(": ")[1]
        )
