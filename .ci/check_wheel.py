"""Try an installed wheel as a stranger would: `check_wheel.py palpate-0.2.0-....whl`.

Run by `make dist` with the Python of an environment that holds the wheel and what it
needs, nothing else. Everything happens in a folder of its own.
"""

import json
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

BIN = Path(sys.executable).parent
NEEDED = {"palpate/py.typed", "palpate/web/static/index.html"}


def main(wheel: str) -> None:
    """Look at the files, then learn and recognise simulated touches."""
    with zipfile.ZipFile(wheel) as archive:
        check_files(set(archive.namelist()))
    version = Path(wheel).name.split("-")[1]
    with tempfile.TemporaryDirectory() as folder:
        run(folder, BIN / "python", "-c", "import palpate")
        said = run(folder, BIN / "palpate", "--version")
        expect(version in said, f"palpate --version says {said!r}, not {version}")
        run(folder, BIN / "palpate", "doctor")
        check_recognition(folder)
    print(f"{Path(wheel).name} is whole and works.")


def check_files(names: set[str]) -> None:
    """Check that what is needed is in the wheel, and tests are not."""
    expect(names >= NEEDED, f"the wheel lacks {sorted(NEEDED - names)}")
    strangers = [
        name
        for name in names
        if not name.startswith("palpate/") and ".dist-info/" not in name
    ]
    expect(not strangers, f"the wheel holds {sorted(strangers)[:3]}")
    tests = [name for name in names if "test_" in name or "/tests/" in name]
    expect(not tests, f"the wheel holds tests: {sorted(tests)[:3]}")


def check_recognition(folder: str) -> None:
    """Learn three parts on a pressure array and recognise them again."""
    parts = ["bar10", "disc13-hole8", "hexagon10"]
    simulate = [BIN / "palpate", "simulate", "array", *parts, "--presses", "12"]
    run(folder, *simulate, "-o", "train.npz")
    run(folder, *simulate, "--seed", "1", "-o", "test.npz")
    run(folder, BIN / "palpate", "learn", "train.npz", "-o", "parts.palpate")
    said = run(
        folder, BIN / "palpate", "recognise", "parts.palpate", "test.npz", "--json"
    )
    episodes = json.loads(said)["episodes"]
    right = [episode["decision"] == episode["object"] for episode in episodes]
    expect(sum(right) >= 2, f"{sum(right)} of {len(right)} parts were recognised")


def run(folder: str, *command: object) -> str:
    """Run a command there; return what it prints, or end with what it said."""
    arguments = [str(part) for part in command]
    done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True)
    expect(done.returncode == 0, f"{' '.join(arguments)} failed:\n{done.stderr}")
    return done.stdout.strip()


def expect(fact: bool, otherwise: str) -> None:
    """End with a sentence when something is not as it must be."""
    if not fact:
        raise SystemExit(f"Not fit for release: {otherwise}.")


if __name__ == "__main__":
    main(sys.argv[1])
