"""Every feature of a LeRobotDataset, against the touches that it was exported from.

Expected values are computed here from the touches that went in, episode by episode.
"""

import io
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from palpate import Touches

pq = pytest.importorskip("pyarrow.parquet")

STARTS, LENGTHS = [0, 2, 3, 6], [2, 1, 3, 1]
DTYPES = {
    "observation.tactile": ("float32", [3, 4]),
    "observation.state": ("float32", [4]),
    "action": ("float32", [3]),
    "observation.position_mm": ("float32", [3]),
    "observation.force_n": ("float32", [1]),
    "object": ("string", [1]),
    "session": ("string", [1]),
    "time_s": ("float64", [1]),
    "order": ("float64", [1]),
    "timestamp": ("float32", [1]),
    "frame_index": ("int64", [1]),
    "episode_index": ("int64", [1]),
    "index": ("int64", [1]),
    "task_index": ("int64", [1]),
}

STATISTICS = {"min": np.nanmin, "max": np.nanmax, "mean": np.nanmean, "std": np.nanstd}


@pytest.fixture
def exported(library, tmp_path):
    """Add touches to a library, export them; return the folder."""

    def export(touches):
        library.add(touches)
        library.export(tmp_path / "robot")
        return tmp_path / "robot"

    return export


def frames_of(folder):
    return pq.read_table(folder / "data/chunk-000/file-000.parquet")


def metadata(folder, name):
    return json.loads((folder / f"meta/{name}.json").read_text())


def test_every_feature_has_its_kind_and_shape(exported, seven):
    folder = exported(seven)
    features = metadata(folder, "info")["features"]
    dtypes = {
        name: (feature["dtype"], feature["shape"]) for name, feature in features.items()
    }
    assert dtypes == DTYPES
    assert {feature["names"] for feature in features.values()} == {None}
    schema = frames_of(folder).schema
    for name, (kind, shape) in DTYPES.items():
        stored = schema.field(name).type
        for _ in shape if shape != [1] else []:
            stored = stored.value_type
        names = {"float": "float32", "double": "float64"}
        assert names.get(str(stored), str(stored)) == kind, name


def test_every_value_is_that_of_the_touches(exported, seven):
    """Arrays are stored in float32; the last action of an episode stays in place."""
    frames = frames_of(exported(seven)).to_pydict()
    columns, place = seven.columns, seven.columns["position_mm"].astype(np.float32)
    force = columns["force_n"].astype(np.float32)
    assert_array_equal(frames["observation.tactile"], seven.images)
    assert_array_equal(frames["observation.position_mm"], place)
    assert_array_equal(frames["observation.force_n"], force)
    assert_array_equal(frames["observation.state"], np.c_[place, force])
    assert_array_equal(frames["action"], place[[1, 1, 2, 4, 5, 5, 6]])
    assert frames["object"] == columns["object"].tolist()
    assert frames["session"] == columns["session"].tolist()
    assert frames["time_s"] == columns["time_s"].tolist()
    assert frames["order"] == columns["order"].tolist()
    assert frames["index"] == [0, 1, 2, 3, 4, 5, 6]
    assert frames["episode_index"] == np.repeat(range(4), LENGTHS).tolist()
    assert frames["frame_index"] == [0, 1, 0, 0, 1, 2, 0]
    assert frames["timestamp"] == [0, 0.5, 0, 0, 0.5, 1.0, 0]
    assert frames["task_index"] == [0, 0, 0, 1, 1, 1, 1]


def test_episodes_have_their_task_length_and_first_and_last_index(exported, seven):
    folder = exported(seven)
    rows = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet")
    for number, row in enumerate(rows.to_pylist()):
        assert row == {
            "episode_index": number,
            "tasks": [["touch cup", "touch pen"][number // 2]],
            "length": LENGTHS[number],
            "dataset_from_index": STARTS[number],
            "dataset_to_index": STARTS[number] + LENGTHS[number],
            "data/chunk_index": 0,
            "data/file_index": 0,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
    assert rows.num_rows == 4
    tasks = pq.read_table(folder / "meta/tasks.parquet")
    assert tasks.to_pydict() == {
        "task_index": [0, 1],
        "task": ["touch cup", "touch pen"],
    }
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def test_info_says_how_much_there_is_and_where(exported, seven):
    folder = exported(seven.with_columns(no_contact=np.ones((3, 4), np.float32)))
    info = metadata(folder, "info")
    info.pop("features")
    whole = info.pop("palpate")
    assert info == {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": 4,
        "total_frames": 7,
        "total_tasks": 2,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": 1,
        "splits": {"train": "0:4"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
    }
    assert whole["dtype"] == "<f4"
    assert whole["grey"] is True
    assert whole["whole"]["no_contact"] == np.ones((3, 4)).tolist()


def test_metadata_is_json_of_which_others_know_all(exported, seven):
    """A dead taxel at rest is null, which JSON knows, and NaN it does not."""
    rest = seven.images[0]
    gains = np.array([0.5, np.inf])
    folder = exported(seven.with_columns(no_contact=rest, set_gains=gains))
    for name in ("info", "stats"):
        content = (folder / f"meta/{name}.json").read_text()
        json.loads(content, parse_constant=pytest.fail)
    whole = metadata(folder, "info")["palpate"]["whole"]
    assert_array_equal(np.array(whole["no_contact"], np.float32), rest)
    assert whole["set_gains"] == [0.5, None]


def test_statistics_are_over_all_frames_that_were_read(exported, seven):
    """NaN counts nowhere, and a taxel that is always NaN counts as 0."""
    folder = exported(seven)
    stats = metadata(folder, "stats")
    assert set(stats) == set(DTYPES) - {"object", "session"}
    frames = frames_of(folder).to_pydict()
    for name, spread in stats.items():
        values = np.asarray(frames[name], float).reshape(7, *DTYPES[name][1])
        dead = np.isnan(values).all(axis=0)
        values[:, dead] = 0
        assert set(spread) == {*STATISTICS, "count"}
        assert spread["count"] == [7]
        for statistic, function in STATISTICS.items():
            expected = function(values, axis=0)
            # The deviation comes of sums of squares: exact to the root of rounding,
            # times the level (times are near 100 s).
            assert_allclose(
                spread[statistic], expected, rtol=1e-9, atol=2e-6, err_msg=name
            )
    assert np.array(stats["observation.tactile"]["mean"])[0, 0] == 0


@pytest.mark.parametrize("channels", [None, ("r", "g", "b")])
def test_pictures_of_a_camera_are_stored_as_png(exported, rng, channels):
    """Grey is stored three times; the statistics are of shares of 255 by channel."""
    sides = (3, 60, 50) if channels is None else (3, 60, 50, 3)
    images = rng.integers(0, 200, sides, dtype=np.uint8)
    more = {} if channels is None else {"channels": list(channels)}
    folder = exported(Touches(images, object=["cup"] * 3, geometry="plane", **more))
    info, stats = metadata(folder, "info"), metadata(folder, "stats")
    assert info["features"]["observation.tactile"] == {
        "dtype": "image",
        "shape": [60, 50, 3],
        "names": ["height", "width", "channels"],
    }
    assert info["palpate"]["grey"] is (channels is None)
    assert info["palpate"]["dtype"] == "|u1"
    rgb = images if channels else np.repeat(images[..., np.newaxis], 3, axis=3)
    stored = frames_of(folder).to_pydict()["observation.tactile"]
    for record, image in zip(stored, rgb, strict=True):
        assert record["path"] is None
        assert_array_equal(np.asarray(Image.open(io.BytesIO(record["bytes"]))), image)
    shares = rgb.reshape(-1, 3) / 255
    spread = stats["observation.tactile"]
    assert np.shape(spread["mean"]) == (3, 1, 1)
    for statistic, function in STATISTICS.items():
        # Sums over 9000 pixels in another order.
        assert_allclose(
            np.ravel(spread[statistic]), function(shares, axis=0), rtol=1e-9
        )


@pytest.mark.parametrize(
    ("shape", "columns", "kind"),
    [
        ((48, 60), {"geometry": "plane"}, "float32"),
        ((48, 60, 3), {"channels": ["r", "g", "b"]}, "float32"),
        ((49, 60), {"geometry": "plane"}, "image"),
        ((49, 60), {"geometry": "array"}, "float32"),
        ((49, 60), {"geometry": "none"}, "float32"),
    ],
)
def test_what_may_be_an_array_is_stored_as_one(exported, rng, shape, columns, kind):
    images = rng.integers(0, 255, (4, *shape), dtype=np.uint8)
    folder = exported(Touches(images, object=["cup"] * 4, **columns))
    feature = metadata(folder, "info")["features"]["observation.tactile"]
    assert feature["dtype"] == kind
    if kind == "float32":
        assert feature["shape"] == [*shape]
        stored = np.array(frames_of(folder).to_pydict()["observation.tactile"])
        assert_array_equal(stored, images)


def test_without_labels_the_task_is_to_touch(exported, rng):
    folder = exported(Touches(rng.normal(size=(3, 3, 4))))
    tasks = pq.read_table(folder / "meta/tasks.parquet").to_pydict()
    assert tasks == {"task_index": [0], "task": ["touch"]}
    frames = frames_of(folder).to_pydict()
    assert not {"object", "observation.state", "action"} & set(frames)
    assert frames["timestamp"] == [0, 1, 2]


def test_pictures_of_which_only_some_say_how_they_lie_are_pictures(library, tmp_path):
    images = np.zeros((2, 60, 80), np.uint8)
    for geometry in ("array", None):
        added = Touches(images, object=["mug", "pen"], geometry=geometry)
        library.add(added, session=str(geometry))
    library.export(tmp_path / "robot")
    features = metadata(tmp_path / "robot", "info")["features"]
    assert features["observation.tactile"]["dtype"] == "image"


@pytest.mark.parametrize("force", [None, [0.5, 0.25]])
def test_a_place_may_be_one_number(exported, rng, force):
    touches = Touches(rng.random((2, 3, 4)), position_mm=[1.0, 2.0], force_n=force)
    frames = frames_of(exported(touches))
    state = [1.0, 2.0] if force is None else [[1.0, 0.5], [2.0, 0.25]]
    assert frames["observation.state"].to_pylist() == state
    assert frames["action"].to_pylist() == [2.0, 2.0]


def test_without_a_force_the_state_is_the_place(exported, rng):
    places = rng.normal(size=(3, 3))
    images = rng.normal(size=(3, 3, 4))
    ways = np.eye(3)
    touches = Touches(images, object=["cup"] * 3, position_mm=places, direction=ways)
    frames = frames_of(exported(touches)).to_pydict()
    assert_array_equal(frames["observation.state"], places.astype(np.float32))
    assert_array_equal(frames["observation.direction"], ways)
    assert_array_equal(frames["action"], places[[1, 2, 2]].astype(np.float32))
    assert "observation.force_n" not in frames


ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_lerobot_reads_exports_and_finds_the_camera():
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    completed = subprocess.run(
        ["make", "--silent", "check-lerobot"], cwd=ROOT, capture_output=True, text=True
    )
    output = completed.stdout + completed.stderr
    if completed.returncode and ".installed] Error" in output:
        pytest.skip(f"lerobot's environment cannot be made: {output.strip()[-300:]}")
    assert completed.returncode == 0, output[-3000:]
    assert " passed" in output
    assert "skipped" not in output
