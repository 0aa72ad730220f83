"""`make check-lerobot`: lerobot's own package, in an environment of its own."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_lerobot_reads_exports_and_finds_the_camera():
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    made = subprocess.run(
        ["make", "--silent", "check-lerobot"], cwd=ROOT, capture_output=True, text=True
    )
    said = made.stdout + made.stderr
    if made.returncode and ".installed] Error" in said:
        pytest.skip(f"lerobot's environment cannot be made: {said.strip()[-300:]}")
    assert made.returncode == 0, said[-3000:]
    assert " passed" in said
    assert "skipped" not in said
