"""A command without its extra says in one sentence what to install, and how.

The package of the extra is hidden, so these tests run with and without it.
"""

import importlib
import os
import subprocess
import sys

import numpy as np
import pytest

from palpate import Touches
from palpate.library import TouchLibrary
from palpate.simulation import find_object

# The hidden package, its extra, and a command that needs it.
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
    with TouchLibrary.open(folder / "lib", create=True) as library:
        library.add(Touches.load(folder / "touches.npz"))
    return folder


@pytest.fixture
def web_anew(monkeypatch):
    """Let `palpate.web` be imported again: its files import an extra at the top."""
    for name in [*sys.modules]:
        if f"{name}.".startswith("palpate.web."):
            monkeypatch.delitem(sys.modules, name)
    yield
    monkeypatch.undo()
    if (web := sys.modules.get("palpate.web")) is not None:
        importlib.import_module("palpate").web = web


@pytest.mark.usefixtures("web_anew")
@pytest.mark.parametrize(("package", "extra", "command"), COMMANDS)
def test_the_refusal_names_package_and_extra(
    folder, package, extra, command, monkeypatch, capsys
):
    for name in [*sys.modules]:
        if name.partition(".")[0] == package:
            monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, package, None)
    for name in ("mug", "box"):  # cached by another test, they would need no package
        for attribute in ("mesh", "_scene"):
            monkeypatch.delitem(vars(find_object(name)), attribute, raising=False)
    # Another process would find the package.
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "1")
    monkeypatch.setattr(sys, "argv", ["palpate", *command.split()])
    monkeypatch.chdir(folder)
    with pytest.raises(SystemExit) as stop:
        importlib.import_module("palpate.cli").main()
    printed = capsys.readouterr().err
    assert stop.value.code == 1, printed
    message = " ".join(printed.split())
    assert f'which is not installed: pip install "palpate[{extra}]"' in message
    assert package.replace("_", "-").lstrip("py") in message.replace("_", "-")
    assert "Traceback" not in message


NEED_NONE = """
import sys
from palpate.cli import main
for command in (
    "learn touches.npz -o few.palpate",
    "recognise few.palpate touches.npz --json",
    "evaluate --train touches.npz --split between --touches 1 --orders 1 --json",
    "simulate array bar10 disc13 -o parts.npz --presses 4",
    "library stats lib",
    "doctor",
):
    sys.argv = ["palpate", *command.split()]
    try:
        main()
    except SystemExit as end:
        assert not end.code, command
"""


def run_without(packages, arguments, folder, hidden):
    """Run Python where it and its workers cannot import some packages."""
    for package in packages:
        refusal = f"raise ModuleNotFoundError('no {package}', name='{package}')"
        (hidden / f"{package}.py").write_text(refusal)
    searched = [str(hidden), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, searched))},
        capture_output=True,
        text=True,
    )


@pytest.mark.slow
def test_what_needs_no_extra_works_without_any(folder, tmp_path):
    packages = {package for package, _, _ in COMMANDS}
    completed = run_without(packages, ["-c", NEED_NONE], folder, tmp_path)
    assert completed.returncode == 0, completed.stderr


@pytest.mark.slow
def test_workers_refuse_as_well(folder, tmp_path):
    arguments = ["-m", "palpate", "simulate", "dome", "mug"]
    arguments += ["-o", "d.npz", "--workers=2"]
    completed = run_without({"trimesh"}, arguments, folder, tmp_path)
    assert completed.returncode == 1
    assert 'pip install "palpate[sim]"' in completed.stderr
    assert "Traceback" not in completed.stderr
