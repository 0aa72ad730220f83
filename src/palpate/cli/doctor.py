"""`palpate doctor`: what is installed, what is missing, and how to get it."""

import os
import platform
import re
import shutil
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import typer

from .._extras import install
from ._options import AsJson
from ._output import answer

# Extras of those who change palpate, not of those who use it.
_WIDE = 80
FOR_AUTHORS = ("test", "dev", "docs")


def doctor(as_json: AsJson = False) -> None:
    """Check this installation; exit 1 when something that palpate needs is missing."""
    old = "" if sys.version_info >= (3, 11) else "install Python 3.11 or newer"
    python = _check("Python", platform.python_version(), old, needed=True)
    checks = [python, *(_package(*package) for package in _packages()), _data()]
    healthy = all(check["ok"] or not check["needed"] for check in checks)
    rows = [[c["name"], c["found"], c["fix"]] for c in checks]
    # Names stay whole, and so does what is to be typed, unless there is no room.
    narrow = shutil.get_terminal_size().columns < _WIDE
    whole = ["what", "found"] if narrow else ["what", "to do"]
    answer(
        as_json,
        {"healthy": healthy, "cores": os.cpu_count(), "checks": checks},
        ("palpate doctor", ["what", "found", "to do"], rows, whole, True),
        _verdict(checks, healthy=healthy),
    )
    if not healthy:
        raise typer.Exit(1)


def _verdict(checks: list[dict[str, Any]], *, healthy: bool) -> str:
    """Return whether palpate can work here, and what to do next."""
    if not healthy:
        lacking = [c["name"] for c in checks if c["needed"] and not c["ok"]]
        return (
            f"Missing, and needed: {', '.join(lacking)}. Type what stands beside it, "
            "then `palpate doctor` again."
        )
    optional = any(not check["ok"] for check in checks)
    return f"Healthy.{' What is missing is optional.' * optional}\nTry it: palpate demo"


def _packages() -> list[tuple[str, str | None]]:
    """Return what palpate was packaged to need: names, and the extra of each."""
    packages: list[tuple[str, str | None]] = []
    try:
        lines = metadata.requires("palpate") or []
    except metadata.PackageNotFoundError:
        return [("palpate", None)]
    for line in lines:
        name, extra = re.match(r"[\w.-]+", line), re.search(r"extra == .(\w+)", line)
        if name and name[0] != "palpate" and not (extra and extra[1] in FOR_AUTHORS):
            packages.append((name[0], extra[1] if extra else None))
    return packages


def _check(name: str, state: str, fix: str, *, needed: bool) -> dict[str, Any]:
    """Return one line of the report; what has a fix is not as it should be."""
    return {"name": name, "found": state, "fix": fix, "ok": not fix, "needed": needed}


def _package(name: str, extra: str | None) -> dict[str, Any]:
    try:
        state, fix = metadata.version(name), ""
    except metadata.PackageNotFoundError:
        state, fix = "missing", install(extra) if extra else f"pip install {name}"
    return _check(name, state, fix, needed=extra is None)


def _data() -> dict[str, Any]:
    folder = os.environ.get("PALPATE_DATA")
    if not folder:
        fix = "optional: palpate data fetch NAME"
    else:
        fix = "" if Path(folder).is_dir() else "name a folder that exists"
    return _check("PALPATE_DATA", folder or "not set", fix, needed=False)
