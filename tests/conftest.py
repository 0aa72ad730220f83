"""Fixtures shared by the whole suite: small drawn touches and the real ones."""

import os
from collections.abc import Callable, Iterator
from copy import copy
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer.main
from numpy.typing import NDArray

# What tests lower, each a number inside of palpate, to show with little what much does.
LIMITS = {
    "answers_left_out": "palpate.classifiers._touch_classifier.MOST_ANSWERS",
    "baseline_s": "palpate.web._sensor_watch._BASELINE_S",
    "browser_patience_s": "palpate.web._app._PATIENCE_S",
    "browser_queue": "palpate.web._app._LONGEST_QUEUE",
    "browsers": "palpate.web._app._MOST_CLIENTS",
    "database_patience_alone_s": "palpate.library._store._PATIENCE_ALONE_S",
    "database_patience_s": "palpate.library._store.PATIENCE_S",
    "fetch_s": "palpate.datasets._fetch._MOST_S",
    "pairs_at_once": "palpate.classifiers._nearby._PAIRS_AT_ONCE",
    "pattern_s": "palpate.touches._layout._MOST_S",
    "serial_listen_s": "palpate.sensors._serial._LISTEN_S",
    "serial_silent_s": "palpate.sensors._serial._SILENT_S",
    "targets": "palpate.classifiers._kernel_ridge._MOST_TARGETS",
    "touches_a_task": "palpate.classifiers._landmarks.TOUCHES_A_TASK",
    "touches_at_once": "palpate.classifiers._landmarks.TOUCHES_AT_ONCE",
    "touches_looked_at": "palpate.recognition._learning.AT_MOST",
    "work_of_scaling": "palpate.classifiers._matrix_scaling._MOST_WORK",
    "weights_tried": "palpate.recognition._remounting.N_WEIGHTS",
    "zip_list_bytes": "palpate.datasets._fetch._LONGEST_LIST",
}

# Tests must not depend on the data that were fetched on this computer.
os.environ["PALPATE_DATA_HOME"] = str(Path(__file__).parent / "nothing-fetched")


@pytest.fixture(scope="session", autouse=True)
def _command_line_made_once() -> Iterator[None]:
    """Build the command line once in a process of tests, as a real process does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", cache(typer.main.get_command))
        yield


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Return the folder of real touches; skip the test where it is missing."""
    folder = os.environ.get("PALPATE_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("PALPATE_DATA does not name the folder of real touches")
    return Path(folder)


@pytest.fixture(scope="session")
def disc_mask() -> Callable[[int, int], NDArray[np.bool_]]:
    """Return what gives the pixel centres within half the shorter side of a frame."""

    def mask(n_rows: int, n_cols: int) -> NDArray[np.bool_]:
        row, col = np.indices((n_rows, n_cols))
        away = np.hypot(row - (n_rows - 1) / 2, col - (n_cols - 1) / 2)
        return np.asarray(away <= min(n_rows, n_cols) / 2)

    return mask


@pytest.fixture(scope="session")
def lower() -> Callable[..., None]:
    """Return a function that sets `LIMITS` by their names, until a patch is undone."""

    def lower_by(patch: pytest.MonkeyPatch, **limits: float) -> None:
        for name, limit in limits.items():
            patch.setattr(LIMITS[name], limit)

    return lower_by


@pytest.fixture(scope="session")
def small_model() -> Any:
    """Return a recogniser of two objects that has learnt very little; to be copied."""
    from palpate import ObjectRecogniser

    images = np.random.default_rng(0).random((8, 3, 6))
    return ObjectRecogniser(rehearse=False).fit(images, ["a"] * 4 + ["b"] * 4)


@pytest.fixture
def reread(small_model: Any, tmp_path: Path) -> Callable[[Any], Any]:
    """Return a function that writes a value into a model file and reads it."""

    def written_and_read(value: Any) -> Any:
        model = copy(small_model)
        model.value_ = value
        return type(model).load(model.save(tmp_path / "m.palpate")).value_

    return written_and_read


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
