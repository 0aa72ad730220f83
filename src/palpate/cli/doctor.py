"""`palpate doctor`: what is installed, what is missing, and how to get it."""

import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import typer

from .._extras import install
from ._options import AsJson
from ._output import print_json, table

CORE = (
    "numpy",
    "scipy",
    "scikit-learn",
    "opencv-python-headless",
    "pillow",
    "joblib",
    "threadpoolctl",
    "safetensors",
    "typer",
    "rich",
)
EXTRAS = {
    "plot": ("matplotlib",),
    "sim": ("trimesh", "embreex", "shapely", "gymnasium"),
    "camera": ("cv2-enumerate-cameras",),
    "serial": ("pyserial",),
    "web": ("fastapi", "uvicorn", "websockets", "python-multipart"),
    "distributed": ("dask", "distributed"),
    "index": ("faiss-cpu",),
    "ros": ("rosbags",),
    "parquet": ("pyarrow",),
    "bench": ("mahotas", "centrosome"),
}


def doctor(as_json: AsJson = False) -> None:
    """Check this installation; exit 1 when something that palpate needs is missing."""
    checks = [_python(), *(_package(name, None) for name in CORE)]
    for extra, names in EXTRAS.items():
        checks += [_package(name, extra) for name in names]
    checks.append(_data())
    healthy = all(check["ok"] or not check["needed"] for check in checks)
    if as_json:
        print_json({"healthy": healthy, "cores": os.cpu_count(), "checks": checks})
    else:
        rows = [[c["name"], c["found"], c["fix"]] for c in checks]
        table("palpate doctor", ["what", "found", "to do"], rows)
        print(
            "Healthy." if healthy else "Something palpate needs is missing; see above."
        )
    if not healthy:
        raise typer.Exit(1)


def _check(
    name: str, found: str, fix: str, *, ok: bool, needed: bool
) -> dict[str, Any]:
    return {"name": name, "found": found, "fix": fix, "ok": ok, "needed": needed}


def _python() -> dict[str, Any]:
    ok = sys.version_info >= (3, 11)
    fix = "" if ok else "install Python 3.11 or newer"
    return _check("Python", platform.python_version(), fix, ok=ok, needed=True)


def _package(name: str, extra: str | None) -> dict[str, Any]:
    try:
        return _check(name, version(name), "", ok=True, needed=extra is None)
    except PackageNotFoundError:
        fix = f"pip install {name}" if extra is None else install(extra)
        return _check(name, "missing", fix, ok=False, needed=extra is None)


def _data() -> dict[str, Any]:
    folder = os.environ.get("PALPATE_DATA")
    name = "PALPATE_DATA"
    if not folder:
        fix = "optional: name the folder of recorded touches"
        return _check(name, "not set", fix, ok=False, needed=False)
    ok = Path(folder).is_dir()
    fix = "" if ok else f"{folder} is not a folder"
    return _check(name, folder, fix, ok=ok, needed=False)
