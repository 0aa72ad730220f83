"""Some seeds of the standing campaign, and its findings; `make fuzz` goes on."""

import subprocess
import sys
from pathlib import Path

import pytest

import fuzz
from palpate.library import LibraryError, read_bag

SEEDS = {
    "model": 2,
    "archive": 30,
    "picture": 40,
    "bag": 10,
    "message": 40,
    "learning": 2,
    "library": 1,
    "belief": 1,
    "session": 1,
}


@pytest.mark.parametrize(("kind", "n_seeds"), SEEDS.items())
def test_inputs_of_some_seeds_are_handled(kind, n_seeds):
    if kind == "bag":
        pytest.importorskip("lz4", reason='needs the extra "ros"')
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


def test_a_bag_that_unpacks_to_much_is_refused(tmp_path):
    """Bags in any container are refused below their size; whole ones are read above."""
    forged_bags = pytest.importorskip("forged_bags")
    whole, forged = forged_bags.bombs(tmp_path, 4 * 2**20)
    for path in [*whole, *forged]:
        with pytest.raises(LibraryError, match=r"must unpack to at most .* max_bytes"):
            read_bag(path, max_bytes=2**20)
    for path in whole:
        assert read_bag(path, max_bytes=2**30).images.shape == (1, 1, 4 * 2**20)


PEAKS = """
import sys
from palpate.library import LibraryError, read_bag
def peak_kib():
    return next(int(l.split()[1]) for l in open("/proc/self/status") if "VmHWM" in l)
before = 0
for path in sys.argv[1:]:
    try:
        read_bag(path, max_bytes=2**20)
    except LibraryError as error:
        before = before or peak_kib()
print(peak_kib() - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux")
def test_a_refused_bag_was_not_unpacked(tmp_path):
    forged_bags = pytest.importorskip("forged_bags")
    small, _ = forged_bags.bombs(tmp_path / "small", 4 * 2**20)
    whole, forged = forged_bags.bombs(tmp_path, 64 * 2**20)
    command = [sys.executable, "-c", PEAKS, *map(str, [small[0], *whole, *forged])]
    completed = subprocess.run(command, check=True, capture_output=True, text=True)
    # It is unpacked in pieces of 1 MiB, from files of up to 280 KiB.
    assert int(completed.stdout) < 16 * 2**10
