"""Tests and doctests that need an extra are skipped where it is missing.

The garbage collector rests while tests are collected, and keeps what was imported.
"""

import gc
import os
import re
from collections.abc import Generator
from typing import Any

import pytest

# `make test-bare` runs without any extra and sets PALPATE_BARE: a test that then fails
# because an extra is missing is skipped. Without PALPATE_BARE it fails.
BRINGS = {
    "bench": {"skimage"},
    "camera": {"cv2_enumerate_cameras"},
    "cnn": {"torch"},
    "distributed": {"dask", "distributed"},
    "frame": {"pandas"},
    "index": {"faiss"},
    "parquet": {"pyarrow"},
    "plot": {"matplotlib"},
    "ros": {"rosbags"},
    "serial": {"serial"},
    "sim": {"trimesh", "embreex", "shapely", "gymnasium"},
    "zenoh": {"zenoh"},
    "web": {"fastapi", "uvicorn", "websockets", "starlette"},
}
REFUSED = re.compile(
    r"needs?\b.{1,120}?pip install \"?palpate\[(?P<extra>\w+)\]"
    r"|No module named '(?P<module>\w+)",
    re.DOTALL,
)


def needed_extra(text: str) -> str | None:
    """Return the extra that is missing by the text of a failure, or None."""
    for refusal in REFUSED.finditer(text):
        if refusal["extra"]:
            return refusal["extra"]
        for extra, modules in BRINGS.items():
            if refusal["module"] in modules:
                return extra
    return None


def skip_without_extra(report: Any) -> None:
    """Turn a failure into a skip where an extra is missing and may be missing."""
    if not report.failed or "PALPATE_BARE" not in os.environ:
        return
    extra = needed_extra(f"{report.longreprtext}\n{report.caplog}{report.capstderr}")
    if extra is not None:
        path, line, _ = getattr(report, "location", (report.nodeid, 0, ""))
        report.outcome = "skipped"
        reason = f'Skipped: needs the extra: pip install "palpate[{extra}]"'
        report.longrepr = (str(path), line, reason)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    report = yield
    skip_without_extra(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, Any, Any]:
    report = yield
    skip_without_extra(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, Any, Any]:
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()
