"""Killed writers and power cuts: no acknowledged touch is lost silently.

    python tests/fuzz/library_campaign.py --kills 60 --cuts 50

Writers are other processes that print what `add` has returned. They are killed; or
they are stopped while the disk under them, a file mounted as a loop device, is copied.
The copy is what a power cut leaves: it lacks what the file system has not flushed. It
is checked as at the start of a machine and mounted, and its library is opened and
compared. Power cuts need root, mkfs and loop devices.
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

# The kernel's name of a file system, and the commands that make and repair it.
FILE_SYSTEMS = {
    "ext4": ("ext4", ["mkfs.ext4", "-q", "-F"], None),
    "ext4 without a journal": (
        "ext4",
        ["mkfs.ext4", "-q", "-F", "-O", "^has_journal"],
        ["e2fsck", "-fy"],
    ),
    "FAT": ("vfat", ["mkfs.vfat"], ["fsck.vfat", "-a"]),
}
first_lines: dict[int, str] = {}  # the first line of each writer
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
    """Return one to three touches that follow from a number."""
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
    """Run processes that add touches until the block ends; then kill them."""
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
        for writer in started:  # until each has stored a touch
            assert writer.stdout is not None
            first_lines[writer.pid] = writer.stdout.readline()
        yield started
    finally:
        for writer in started:
            with suppress(ProcessLookupError):
                writer.send_signal(signal.SIGCONT)
                writer.kill()
            writer.wait()


def acknowledged(writer: subprocess.Popen) -> dict[str, int]:
    """Return the ids that a killed writer acknowledged, and their numbers."""
    assert writer.stdout is not None
    text = first_lines.pop(writer.pid, "") + writer.stdout.read()
    lines = [line.split() for line in text.splitlines(keepends=True)[:-1]]
    return {line[1]: int(line[0]) for line in lines if len(line) == 2}


def judge(folder: Path, numbers: dict[str, int]) -> str:
    """Return the outcome for acknowledged touches by id, some of which may be lost."""
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always")
        try:
            with TouchLibrary.open(folder) as library:
                stored_ids = {row.id for row in library.list(limit=None)}
                for key in numbers.keys() & stored_ids:
                    stored = library.image(key).tobytes()
                    images = [i.tobytes() for i in touches_of(numbers[key]).images]
                    assert stored in images, f"{key} is another one"
            report = check_library(folder)
        except LibraryError:
            return "refused aloud"
    gone = numbers.keys() - stored_ids
    if not gone:
        return "all there" if report.ok else "all there, a problem told"
    return "gone, told" if messages or not report.ok else "GONE IN SILENCE"


def kill_writers(folder: Path, n_kills: int, seed: int) -> tuple[Counter[str], int]:
    """Kill two or three writers at random moments; return outcomes and touches."""
    rng = random.Random(seed)
    outcomes: Counter[str] = Counter()
    numbers: dict[str, int] = {}
    for number in range(n_kills):
        with writers(folder, rng.choice((2, 3)), 10**7 * number) as started:
            time.sleep(rng.uniform(0.0, 1.5))
            for writer in started:
                writer.kill()
        for writer in started:
            numbers |= acknowledged(writer)
        outcomes[judge(folder, numbers)] += 1
    return outcomes, len(numbers)


def cut_power(kind: str, n_cuts: int, seed: int) -> tuple[Counter[str], int]:
    """Cut the power of two writers on a file system; return outcomes and touches."""
    _, make, mend = FILE_SYSTEMS[kind]
    rng = random.Random(seed)
    outcomes: Counter[str] = Counter()
    n_acknowledged = 0
    with tempfile.TemporaryDirectory() as scratch:
        disk, copy, mount_point = (
            Path(scratch) / n for n in ("disk", "copy", "mounted")
        )
        for number in range(n_cuts):
            disk.write_bytes(b"")
            os.truncate(disk, _DISK_BYTES)
            subprocess.run([*make, disk], check=True, stdout=subprocess.DEVNULL)
            with _mounted(disk, mount_point):
                with writers(mount_point / "library", 2, 10**7 * number) as started:
                    time.sleep(rng.uniform(0.0, 1.5))
                    for writer in started:
                        writer.send_signal(signal.SIGSTOP)
                    shutil.copyfile(disk, copy)
                    for writer in started:  # no touch is acknowledged after the copy
                        writer.kill()
                numbers = {}
                for writer in started:
                    numbers |= acknowledged(writer)
            if mend is not None:
                subprocess.run([*mend, copy], capture_output=True, check=False)
            with _mounted(copy, mount_point):
                library = mount_point / "library"
                outcomes[judge(library, numbers) if numbers else "none yet"] += 1
            n_acknowledged += len(numbers)
    return outcomes, n_acknowledged


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
    file_systems = Path("/proc/filesystems")
    ready = file_systems.is_file() and name in file_systems.read_text().split()
    loops = Path("/dev/loop-control").exists()
    return root and ready and loops and all(map(shutil.which, tools))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=60)
    parser.add_argument("--cuts", type=int, default=50, help="on each file system")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.kills:
            outcomes, n_touches = kill_writers(
                Path(folder) / "lab", options.kills, options.seed
            )
            print(
                f"kills: {dict(outcomes)}; {n_touches} acknowledged touches", flush=True
            )
    for kind in FILE_SYSTEMS if options.cuts else ():
        if not can_cut(kind):
            print(f"power cuts, {kind}: cannot be made on this machine")
            continue
        outcomes, n_touches = cut_power(kind, options.cuts, options.seed)
        print(
            f"power cuts, {kind}: {dict(outcomes)}; {n_touches} acknowledged",
            flush=True,
        )


if __name__ == "__main__":
    main()
