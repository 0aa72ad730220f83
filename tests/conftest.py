"""Fixtures shared by the whole suite: small drawn touches and the real ones."""

import os
import re
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real touches; skips the test where it is not there."""
    folder = os.environ.get("PALPATE_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("PALPATE_DATA does not name the folder of real touches")
    return Path(folder)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def touches(rng: np.random.Generator) -> NDArray[np.float64]:
    """Twelve smooth images of 10 x 10 taxels: pressed blobs over a little noise."""
    row, col = np.mgrid[:10, :10]
    centre = rng.uniform(3, 6, size=(12, 2, 1, 1))
    width = rng.uniform(1.5, 3, size=(12, 1, 1))
    squared = (row - centre[:, 0]) ** 2 + (col - centre[:, 1]) ** 2
    noise = rng.normal(scale=0.01, size=(12, 10, 10))
    return np.exp(-squared / (2 * width**2)) + noise


# `make test-bare` runs without any extra and sets PALPATE_BARE: what then fails for
# want of one is skipped, with the extra as the reason. Elsewhere it is a failure.
BRINGS = {
    "camera": {"cv2_enumerate_cameras"},
    "distributed": {"dask", "distributed"},
    "index": {"faiss"},
    "parquet": {"pyarrow"},
    "plot": {"matplotlib"},
    "ros": {"rosbags"},
    "serial": {"serial"},
    "sim": {"trimesh", "embreex", "shapely", "gymnasium"},
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
