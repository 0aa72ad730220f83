"""Two states of the project side by side: a revision's files in a temporary folder."""

import os
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[1]
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def checked_out(revision: str | None) -> Iterator[Path]:
    """Give the folder that holds a revision's files; without one, the tree as it is."""
    if revision is None:
        yield ROOT
        return
    with tempfile.TemporaryDirectory(prefix="palpate-") as folder:
        archive = Path(folder) / "files.tar"
        command = ["git", "archive", "-o", archive, revision]
        subprocess.run(command, cwd=ROOT, check=True)
        with tarfile.open(archive) as file:
            file.extractall(folder, filter="data")
        archive.unlink()
        yield Path(folder)


def environment(root: Path) -> dict[str, str]:
    """Return the variables under which `python` finds that palpate, on one thread."""
    return {
        **os.environ,
        **dict.fromkeys(ONE_THREAD, "1"),
        "PYTHONPATH": str(root / "src"),
        "PYTHONDONTWRITEBYTECODE": "",
    }


def python(root: Path, *arguments: object, folder: Path | None = None) -> str:
    """Run `python ARGUMENTS` with a revision's palpate; return what it prints."""
    completed = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=folder or tempfile.gettempdir(),
        env=environment(root),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return completed.stdout


def check_where(root: Path) -> None:
    """Refuse to compare when another palpate would be imported."""
    location = python(root, "-c", "import palpate; print(palpate.__file__)").strip()
    if not Path(location).resolve().is_relative_to(root.resolve()):
        raise SystemExit(f"palpate is imported from {location}, not from {root}.")
