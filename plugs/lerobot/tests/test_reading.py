"""What was exported comes back; damaged and foreign datasets are refused by name."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary, read_bag

pytest.importorskip("pyarrow.parquet")
palpate_lerobot = pytest.importorskip("palpate_lerobot")


@pytest.fixture(autouse=True)
def plugged(monkeypatch):
    """As if the package were installed: its entry point is found."""
    point = SimpleNamespace(load=lambda: palpate_lerobot)
    monkeypatch.setattr("palpate.library._bags.entry_points", lambda group: [point])


@pytest.fixture
def library(tmp_path):
    rng = np.random.default_rng(0)
    touches = Touches(
        rng.normal(size=(7, 3, 4)).astype(np.float32),
        object=["cup"] * 3 + ["pen"] * 4,
        session=["a", "a", "b", "a", "a", "a", "b"],
        time_s=100 + np.arange(7) * 0.5,
        no_contact=np.zeros((3, 4), np.float32),
    )
    with TouchLibrary.open(tmp_path / "library", create=True) as opened:
        opened.add(touches)
        yield opened


def test_an_export_to_lerobot_comes_back(library, tmp_path):
    library.export(tmp_path / "robot")
    again, stored = read_bag(tmp_path / "robot"), library.touches()
    order = np.argsort(again.columns["time_s"])
    assert_array_equal(again.images[order], stored.images)
    for column in ("object", "session", "time_s"):
        assert_array_equal(again.columns[column][order], stored.columns[column])
    assert_array_equal(again.no_contact, stored.no_contact)
    for feature in ("meta", "object"):
        with pytest.raises(LibraryError, match=r"an image or an array.*tactile.*got"):
            read_bag(tmp_path / "robot", feature)
    with pytest.raises(LibraryError, match="at most 5 bytes"):
        read_bag(tmp_path / "robot", max_bytes=5)
    tasks = tmp_path / "robot/meta/tasks.parquet"
    tasks.write_bytes(tasks.read_bytes()[:50])
    with pytest.raises(LibraryError, match="must be a LeRobotDataset of format"):
        read_bag(tmp_path / "robot")
    info = tmp_path / "robot/meta/info.json"
    info.write_text(info.read_text().replace('"v3.0"', '"v2.1"'))
    with pytest.raises(LibraryError, match=r"format v3.0, got 'v2.1'"):
        read_bag(tmp_path / "robot")


def test_videos_are_refused_by_name(tmp_path):
    (tmp_path / "meta").mkdir()
    film = {"dtype": "video", "shape": [48, 64, 3]}
    info = {"codebase_version": "v3.0", "features": {"gel": film}, "total_frames": 1}
    (tmp_path / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(LibraryError, match=r"Videos \(gel\) are not read"):
        read_bag(tmp_path)
