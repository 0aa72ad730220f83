"""What was exported comes back; damaged and foreign datasets are refused by name."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary, read_bag
from palpate.touches import png_bytes

pytest.importorskip("pyarrow.parquet")
palpate_lerobot = pytest.importorskip("palpate_lerobot")


@pytest.fixture(autouse=True)
def plugged(monkeypatch):
    """As if the package were installed: its entry point is found."""
    point = SimpleNamespace(load=lambda: palpate_lerobot)
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [point])


@pytest.fixture(params=[np.float32, np.int32, np.float64])
def library(tmp_path, request):
    rng = np.random.default_rng(0)
    touches = Touches(
        rng.integers(-(2**20), 2**20, (7, 3, 4)).astype(request.param),
        object=["cup"] * 3 + ["pen"] * 4,
        session=["a", "a", "b", "a", "a", "a", "b"],
        episode=[1, 2, 2, 1, 1, 2, 2],
        subject=["ann", "bob"] * 3 + ["ann"],
        sensor=["pad"] * 7,
        time_s=100 + np.arange(7) * 0.5,
        position_mm=rng.integers(-40, 40, (7, 3)).astype(np.float64),
        direction=np.eye(3)[[0, 1, 2, 0, 1, 2, 0]],
        no_contact=np.zeros((3, 4), request.param),
    )
    with TouchLibrary.open(tmp_path / "library", create=True) as opened:
        opened.add(touches)
        yield opened


def test_an_export_to_lerobot_comes_back(library, tmp_path):
    library.export(tmp_path / "robot")
    again, stored = read_bag(tmp_path / "robot"), library.touches()
    order = np.argsort(again.columns["time_s"])
    assert_array_equal(again.images[order], stored.images)
    assert again.images.dtype == stored.images.dtype
    labels = ("object", "session", "episode", "subject", "sensor")
    for column in (*labels, "time_s", "position_mm", "direction"):
        assert_array_equal(again.columns[column][order], stored.columns[column])
    assert_array_equal(again.no_contact, stored.no_contact)
    library.add(again)
    assert library.stats().n_touches == 7  # all are known again
    for feature in ("meta", "object"):
        with pytest.raises(
            LibraryError, match=r"must be an image, a video.*tactile.*got"
        ):
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


@pytest.mark.parametrize("sides", [[3, 4, 5], [4, 5, 3]], ids=["first", "last"])
def test_pictures_of_others_have_channels_first_or_last(tmp_path, sides):
    """A column `object` of theirs is what is touched; one of vectors is none."""
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    pictures = np.arange(180, dtype=np.uint8).reshape(3, 4, 5, 3)
    features = {"gel": {"dtype": "image", "shape": sides}}
    columns = {
        "gel": [{"bytes": png_bytes(picture), "path": ""} for picture in pictures],
        "object": ["cup", "pen", "pen"],
        "order": [[1.0, 2.0]] * 3,
        "task_index": [0, 0, 0],
        "episode_index": [0, 0, 1],
        "timestamp": np.array([0, 0.5, 0], np.float32),
    }
    features |= {n: {"dtype": "int64", "shape": [1]} for n in columns if n != "gel"}
    features["order"]["shape"] = [2]
    (tmp_path / "data/0").mkdir(parents=True)
    (tmp_path / "meta").mkdir()
    pq.write_table(pa.table(columns), tmp_path / "data/0/0.parquet")
    tasks = pa.table({"task_index": [0], "task": ["touch something"]})
    pq.write_table(tasks, tmp_path / "meta/tasks.parquet")
    info = {"codebase_version": "v3.0", "features": features, "total_frames": 3}
    (tmp_path / "meta/info.json").write_text(json.dumps(info))
    read = read_bag(tmp_path)
    assert_array_equal(read.images, pictures)
    assert read.object.tolist() == ["cup", "pen", "pen"]
    assert read.columns["episode"].tolist() == [0, 0, 1]
    assert "order" not in read.columns


@pytest.fixture
def filmed(tmp_path):
    """Two episodes of a dataset whose feature `gel` is one film; their grey levels."""
    av = pytest.importorskip("av")
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    levels = [20, 60, 100, 140, 180, 220, 250]
    film = tmp_path / "videos/gel/chunk-000/file-000.mp4"
    for folder in (film.parent, tmp_path / "data/0", tmp_path / "meta/episodes/0"):
        folder.mkdir(parents=True)
    with av.open(str(film), "w") as out:
        stream = out.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for level in levels:
            picture = np.full((48, 64, 3), level, np.uint8)
            out.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        out.mux(stream.encode())
    times = [0.0, 0.1, 0.2, 0.0, 0.1, 0.2, 0.3]
    rows = {"episode_index": [0, 0, 0, 1, 1, 1, 1], "task_index": [0] * 3 + [1] * 4}
    pq.write_table(
        pa.table({**rows, "timestamp": times}), tmp_path / "data/0/0.parquet"
    )
    key = "videos/gel/"
    where = {"episode_index": [0, 1], key + "from_timestamp": [0.0, 0.3]}
    where |= {key + "chunk_index": [0, 0], key + "file_index": [0, 0]}
    pq.write_table(pa.table(where), tmp_path / "meta/episodes/0/0.parquet")
    tasks = pa.table({"task_index": [0, 1], "task": ["cup", "pen"]})
    pq.write_table(tasks, tmp_path / "meta/tasks.parquet")
    features = {name: {"dtype": "int64", "shape": [1]} for name in (*rows, "timestamp")}
    features["gel"] = {"dtype": "video", "shape": [48, 64, 3]}
    info = {"codebase_version": "v3.0", "features": features, "total_frames": 7}
    (tmp_path / "meta/info.json").write_text(json.dumps(info))
    return tmp_path, film, levels


def test_a_feature_that_is_a_video_is_read(filmed):
    folder, film, levels = filmed
    read = read_bag(folder)
    assert read.images.shape == (7, 48, 64, 3)
    assert read.channels == ("r", "g", "b")
    means = read.images.mean(axis=(1, 2, 3))
    np.testing.assert_allclose(means, levels, atol=3)  # the codec loses a little
    assert read.object.tolist() == ["cup"] * 3 + ["pen"] * 4
    film.write_bytes(film.read_bytes()[:-300])
    with pytest.raises(LibraryError, match=r"must be a LeRobotDataset.*file-000"):
        read_bag(folder)
    film.unlink()
    with pytest.raises(LibraryError, match=r"must be a LeRobotDataset.*file-000"):
        read_bag(folder)


def test_times_that_no_picture_has_are_refused(filmed):
    folder, *_ = filmed
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    table = pq.read_table(folder / "data/0/0.parquet")
    late = pa.array([0.0, 0.1, 0.25, 0.0, 0.1, 0.2, 0.3])
    table = table.set_column(table.column_names.index("timestamp"), "timestamp", late)
    pq.write_table(table, folder / "data/0/0.parquet")
    with pytest.raises(LibraryError, match=r"no picture at 0.2500 s of file-000.mp4"):
        read_bag(folder)


def test_a_video_without_pyav_says_what_to_install(filmed, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImportError, match=r"gel is a video.*pip install av"):
        read_bag(filmed[0])
