"""What is skipped where an extra is missing: in the tests and in the doctests.

And what is imported to find the tests is no garbage: Python need not look for it.
"""

import gc
import os
import re
from collections.abc import Generator
from typing import Any

import pytest

# `make test-bare` runs without any extra and sets PALPATE_BARE: what then fails for
# want of one is skipped, with the extra as the reason. Elsewhere it is a failure.
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


def needed_extra(said: str) -> str | None:
    """Return the extra whose want a failure's text speaks of, or None."""
    for found in REFUSED.finditer(said):
        if found["extra"]:
            return found["extra"]
        for extra, modules in BRINGS.items():
            if found["module"] in modules:
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
