"""Killed writers and power cuts: no acknowledged touch is gone without a word.

    python tests/fuzz/library_campaign.py --kills 60 --cuts 50

Writers are other processes that say what `add` has returned. They are killed; or
stopped while the disk under them, a file mounted as a loop device, is copied as it is
at that moment, which is what a power cut leaves: what the file system has not flushed
is not in it. The copy is checked as a machine does that starts again, mounted, and the
library in it opened and compared. Power cuts need root, mkfs and loop devices.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary, check_library

# What the kernel calls a file system, who makes it, and who mends it after a cut.
FILE_SYSTEMS = {
    "ext4": ("ext4", ["mkfs.ext4", "-q", "-F"], None),
    "ext4 without a journal": (
        "ext4",
        ["mkfs.ext4", "-q", "-F", "-O", "^has_journal"],
        ["e2fsck", "-fy"],
    ),
    "FAT": ("vfat", ["mkfs.vfat"], ["fsck.vfat", "-a"]),
}
firsts: dict[int, str] = {}  # the first line of each writer
_DISK_BYTES = 96 * 2**20
_WRITER = """
import sys
from library_campaign import touches_of
from palpate.library import TouchLibrary
with TouchLibrary.open(sys.argv[1], create=True) as library:
    for number in range(int(sys.argv[2]), 10**9):
        for key in library.add(touches_of(number)):
            print(number, key, flush=True)
"""


def touches_of(number: int) -> Touches:
    """Return the one to three touches that a number alone decides."""
    rng = np.random.default_rng(number)
    n_touches = 1 + number % 3
    images = rng.integers(0, 255, (n_touches, 20, 20), dtype=np.uint8)
    return Touches(
        images, object=[f"o{number % 5}"] * n_touches, press=[number] * n_touches
    )


@contextmanager
def writers(
    folder: Path, n_writers: int, first: int
) -> Iterator[list[subprocess.Popen]]:
    """Run programs that add touches until the block ends; then they are killed."""
    place = Path(__file__).parent
    started = [
        subprocess.Popen(
            [sys.executable, "-c", _WRITER, folder, str(first + 10**6 * number)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(place), *sys.path])},
        )
        for number in range(n_writers)
    ]
    try:
        for one in started:  # until each has stored something
            assert one.stdout is not None
            firsts[one.pid] = one.stdout.readline()
        yield started
    finally:
        for one in started:
            with suppress(ProcessLookupError):
                one.send_signal(signal.SIGCONT)
                one.kill()
            one.wait()


def acknowledged(one: subprocess.Popen) -> dict[str, int]:
    """Return the ids that a killed writer has said are stored, and their numbers."""
    assert one.stdout is not None
    text = firsts.pop(one.pid, "") + one.stdout.read()
    lines = [line.split() for line in text.splitlines(keepends=True)[:-1]]
    return {line[1]: int(line[0]) for line in lines if len(line) == 2}


def judge(folder: Path, known: dict[str, int]) -> str:
    """Return what became of acknowledged touches, some of which may be gone."""
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always")
        try:
            with TouchLibrary.open(folder) as library:
                there = {row.id for row in library.list(limit=None)}
                for key in known.keys() & there:
                    image = library.image(key).tobytes()
                    given = [i.tobytes() for i in touches_of(known[key]).images]
                    assert image in given, f"{key} is another one"
            report = check_library(folder)
        except LibraryError:
            return "refused aloud"
    gone = known.keys() - there
    if not gone:
        return "all there" if report.ok else "all there, a problem told"
    return "gone, told" if messages or not report.ok else "GONE IN SILENCE"


def kill_writers(folder: Path, n_kills: int, seed: int) -> tuple[Counter[str], int]:
    """Kill two or three writers at random moments; return outcomes and touches."""
    rng = random.Random(seed)
    outcomes: Counter[str] = Counter()
    known: dict[str, int] = {}
    for number in range(n_kills):
        with writers(folder, rng.choice((2, 3)), 10**7 * number) as started:
            time.sleep(rng.uniform(0.0, 1.5))
            for one in started:
                one.kill()
        for one in started:
            known |= acknowledged(one)
        outcomes[judge(folder, known)] += 1
    return outcomes, len(known)


def cut_power(kind: str, n_cuts: int, seed: int) -> tuple[Counter[str], int]:
    """Cut the power of two writers on a file system; return outcomes and touches."""
    _, make, mend = FILE_SYSTEMS[kind]
    rng = random.Random(seed)
    outcomes: Counter[str] = Counter()
    n_known = 0
    with tempfile.TemporaryDirectory() as scratch:
        disk, copy, there = (Path(scratch) / n for n in ("disk", "copy", "mounted"))
        for number in range(n_cuts):
            disk.write_bytes(b"")
            os.truncate(disk, _DISK_BYTES)
            subprocess.run([*make, disk], check=True, stdout=subprocess.DEVNULL)
            with _mounted(disk, there):
                with writers(there / "library", 2, 10**7 * number) as started:
                    time.sleep(rng.uniform(0.0, 1.5))
                    for one in started:
                        one.send_signal(signal.SIGSTOP)
                    shutil.copyfile(disk, copy)
                    for one in started:  # nothing is said after the copy
                        one.kill()
                known = {}
                for one in started:
                    known |= acknowledged(one)
            if mend is not None:
                subprocess.run([*mend, copy], capture_output=True, check=False)
            with _mounted(copy, there):
                outcomes[judge(there / "library", known) if known else "none yet"] += 1
            n_known += len(known)
    return outcomes, n_known


@contextmanager
def _mounted(disk: Path, folder: Path) -> Iterator[None]:
    folder.mkdir(exist_ok=True)
    subprocess.run(["mount", "-o", "loop", disk, folder], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", folder], check=True)


def can_cut(kind: str) -> bool:
    """Tell whether this machine can make and mount a file system."""
    name, make, mend = FILE_SYSTEMS[kind]
    tools = [make[0], *([mend[0]] if mend else []), "mount"]
    root = hasattr(os, "geteuid") and os.geteuid() == 0
    known = Path("/proc/filesystems")
    ready = known.is_file() and name in known.read_text().split()
    loops = Path("/dev/loop-control").exists()
    return root and ready and loops and all(map(shutil.which, tools))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=60)
    parser.add_argument("--cuts", type=int, default=50, help="on each file system")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if asked.kills:
            outcomes, n = kill_writers(Path(folder) / "lab", asked.kills, asked.seed)
            print(f"kills: {dict(outcomes)}; {n} acknowledged touches", flush=True)
    for kind in FILE_SYSTEMS if asked.cuts else ():
        if not can_cut(kind):
            print(f"power cuts, {kind}: cannot be made on this machine")
            continue
        outcomes, n = cut_power(kind, asked.cuts, asked.seed)
        print(f"power cuts, {kind}: {dict(outcomes)}; {n} acknowledged", flush=True)


if __name__ == "__main__":
    main()
