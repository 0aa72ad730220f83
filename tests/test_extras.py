"""Without its extra a command says in one sentence what to install, and how.

The extra's package is hidden behind one that cannot be imported, so this runs wherever
palpate does.
"""

import os
import subprocess
import sys

import numpy as np
import pytest

# What is hidden, the extra that brings it, and the command that wants it.
COMMANDS = [
    (
        "matplotlib",
        "plot",
        "evaluate --train touches.npz --split between --touches 1 --report page.html",
    ),
    ("matplotlib", "plot", "demo --output demo"),
    ("matplotlib", "plot", "study liu2014 --quick --report page.html"),
    ("trimesh", "sim", "simulate dome mug -o dome.npz --touches 2"),
    ("trimesh", "sim", "simulate pins mug -o pins.npz --touches 2"),
    ("trimesh", "sim", "explore learn mug box -o model.palpate"),
    ("fastapi", "web", "serve"),
    ("uvicorn", "web", "serve"),
    (
        "distributed",
        "distributed",
        "learn touches.npz -o m.palpate --cluster tcp://lab:8786",
    ),
    ("serial", "serial", "record mug --sensor serial:COM3 --library lib --shape 4x4"),
    (
        "cv2_enumerate_cameras",
        "camera",
        "record mug --sensor camera:Desk --library lib",
    ),
    ("pyarrow", "parquet", "library export lib -o touches.parquet"),
    ("pooch", "data", "data fetch tactip4 --data fetched --mirror http://127.0.0.1:9"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a few touches, and a library of them."""
    folder = tmp_path_factory.mktemp("extras")
    rng = np.random.default_rng(0)
    images = rng.normal(size=(12, 8, 8)) + np.repeat([0, 5], 6)[:, None, None]
    np.savez(folder / "touches.npz", images=images, object=["a"] * 6 + ["b"] * 6)
    done = palpate(folder, "library add lib touches.npz")
    assert done.returncode == 0, done.stderr
    return folder


def palpate(folder, command, *hidden):
    """Run a command where packages are hidden, from its workers too."""
    paths = [folder / f"without-{package}" for package in hidden]
    for package, path in zip(hidden, paths, strict=True):
        path.mkdir(exist_ok=True)
        refusal = f"raise ModuleNotFoundError('no {package}', name='{package}')"
        (path / f"{package}.py").write_text(refusal)
    searched = [*map(str, paths), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(
        [sys.executable, "-m", "palpate", *command.split()],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, searched))},
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize(("package", "extra", "command"), COMMANDS)
def test_the_refusal_names_package_and_extra(folder, package, extra, command):
    done = palpate(folder, command, package)
    assert done.returncode == 1, done.stderr
    said = " ".join(done.stderr.split())
    assert f'which is not installed: pip install "palpate[{extra}]"' in said
    assert package.replace("_", "-").lstrip("py") in said.replace("_", "-")
    assert "Traceback" not in said


def test_what_needs_no_extra_works_without_any(folder):
    packages = {package for package, _, _ in COMMANDS}
    for command in (
        "learn touches.npz -o few.palpate",
        "recognise few.palpate touches.npz --json",
        "evaluate --train touches.npz --split between --touches 1 --orders 1 --json",
        "simulate array bar10 disc13 -o parts.npz --presses 4",
        "library stats lib",
        "doctor",
    ):
        done = palpate(folder, command, *packages)
        assert done.returncode == 0, (command, done.stderr)
