"""`palpate doctor`: what is installed, what is missing, and how to get it."""

import os
import platform
import re
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import typer

from .._extras import install
from ._options import AsJson
from ._output import print_json, table

# Extras of those who change palpate, not of those who use it.
FOR_AUTHORS = ("test", "dev")


def doctor(as_json: AsJson = False) -> None:
    """Check this installation; exit 1 when something that palpate needs is missing."""
    checks = [_python(), *map(_package, *zip(*_packages(), strict=True)), _data()]
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


def _packages() -> list[tuple[str, str | None]]:
    """Return what palpate was packaged to need: names, and the extra of each."""
    found: list[tuple[str, str | None]] = []
    try:
        lines = metadata.requires("palpate") or []
    except metadata.PackageNotFoundError:
        return [("palpate", None)]
    for line in lines:
        name, extra = re.match(r"[\w.-]+", line), re.search(r"extra == .(\w+)", line)
        if name and name[0] != "palpate" and not (extra and extra[1] in FOR_AUTHORS):
            found.append((name[0], extra[1] if extra else None))
    return found


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
        found = metadata.version(name)
    except metadata.PackageNotFoundError:
        fix = f"pip install {name}" if extra is None else install(extra)
        return _check(name, "missing", fix, ok=False, needed=extra is None)
    return _check(name, found, "", ok=True, needed=extra is None)


def _data() -> dict[str, Any]:
    folder = os.environ.get("PALPATE_DATA")
    name = "PALPATE_DATA"
    if not folder:
        fix = "optional: name the folder of recorded touches"
        return _check(name, "not set", fix, ok=False, needed=False)
    ok = Path(folder).is_dir()
    fix = "" if ok else f"{folder} is not a folder"
    return _check(name, folder, fix, ok=ok, needed=False)
