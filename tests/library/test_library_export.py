"""Exports are read back by other people's readers; bags are written by rosbags."""

import json
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from typer.testing import CliRunner

from palpate import Touches
from palpate.cli import app
from palpate.library import LibraryError, TouchLibrary, read_bag

pq = pytest.importorskip("pyarrow.parquet")


@pytest.fixture
def library(tmp_path, rng):
    touches = Touches(
        rng.normal(size=(7, 3, 4)).astype(np.float32),
        object=["cup"] * 3 + ["pen"] * 4,
        session=["a", "a", "b", "a", "a", "a", "b"],
        time_s=100 + np.arange(7) * 0.5,
        force_n=np.linspace(0, 1, 7),
        position_mm=rng.normal(size=(7, 3)),
        no_contact=np.zeros((3, 4), np.float32),
    )
    with TouchLibrary.open(tmp_path / "library", create=True) as opened:
        opened.add(touches)
        yield opened


def test_an_archive_holds_the_same_touches(library, tmp_path):
    assert library.export(tmp_path / "t.npz", "object = pen") == 4
    again = Touches.load(tmp_path / "t.npz")
    chosen = library.touches("object = pen")
    assert_array_equal(again.images, chosen.images)
    assert set(again.columns) == set(chosen.columns)
    other = TouchLibrary.open(tmp_path / "other", create=True)
    with other:
        other.add(again)
        kept = {row.id for row in library.list("object = pen")}
        assert {row.id for row in other.list()} == kept


def test_a_parquet_file_holds_the_same_touches(library, tmp_path, rng):
    """Of many touches, 128 at a time are a row group."""
    seven = library.touches()
    more = seven[np.arange(1200) % 7].with_columns(time_s=np.arange(200.0, 1400))
    library.add(more)
    assert library.export(tmp_path / "t.parquet") == 1207
    file = pq.ParquetFile(tmp_path / "t.parquet")
    assert file.num_row_groups == 10  # of 1207 touches
    table = file.read()
    expected = library.touches()
    images = table["image"].combine_chunks().to_numpy_ndarray()
    assert_array_equal(images, expected.images)
    assert table["object"].to_pylist() == expected.object.tolist()
    assert_allclose(table["position_mm"].to_pylist(), expected.columns["position_mm"])
    about = json.loads(table.schema.metadata[b"palpate"])
    assert about["dtypes"]["image"] == "<f4"
    assert about["recordings"][0]["whole"]["no_contact"]["shape"] == [3, 4]
    assert not list(tmp_path.glob(".*partial"))


def test_a_lerobot_dataset_has_the_layout_of_v3(library, tmp_path):
    folder = tmp_path / "robot"
    assert library.export(folder) == 7
    info = json.loads((folder / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (
        4,
        7,
        2,
    )
    path = info["data_path"].format(chunk_index=0, file_index=0)
    frames = pq.read_table(folder / path).to_pydict()
    assert set(frames) == set(info["features"])
    assert frames["index"] == list(range(7))
    assert frames["frame_index"] == [0, 1, 0, 0, 1, 2, 0]
    assert frames["episode_index"] == [0, 0, 1, 2, 2, 2, 3]
    assert frames["timestamp"] == [0, 0.5, 0, 0, 0.5, 1.0, 0]
    assert np.shape(frames["observation.tactile"]) == (7, 3, 4)
    assert info["features"]["observation.tactile"]["shape"] == [3, 4]
    tasks = pq.read_table(folder / "meta/tasks.parquet").to_pydict()
    assert tasks == {"task_index": [0, 1], "task": ["touch cup", "touch pen"]}
    rows = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet")
    for row in rows.to_pylist():
        inside = frames["episode_index"][
            row["dataset_from_index"] : row["dataset_to_index"]
        ]
        assert inside == [row["episode_index"]] * row["length"]
    stats = json.loads((folder / "meta/stats.json").read_text())
    images = np.array(frames["observation.tactile"])
    spread = stats["observation.tactile"]
    # float32 values summed in float64: equal but for the order of the sums.
    assert_allclose(spread["mean"], images.mean(axis=0), atol=1e-12)
    assert_allclose(spread["std"], images.std(axis=0), atol=1e-7)
    assert_allclose(spread["max"], images.max(axis=0))
    with pytest.raises(LibraryError, match="new or empty folder"):
        library.export(folder)


def test_frames_without_times_count_touches(tmp_path, rng):
    names = ["cup"] * 2 + ["pen"] * 3
    with TouchLibrary.open(tmp_path / "bare", create=True) as library:
        library.add(Touches(rng.normal(size=(5, 2, 2)), object=names))
        library.export(tmp_path / "robot")
    table = pq.read_table(tmp_path / "robot/data/chunk-000/file-000.parquet")
    frames = table.to_pydict()
    assert frames["timestamp"] == [0, 1, 0, 1, 2]
    assert frames["index"] == [0, 1, 2, 3, 4]
    assert frames["task_index"] == [0, 0, 1, 1, 1]
    assert "observation.force_n" not in frames


@pytest.mark.parametrize("name", ["t.npz", "t.parquet", "robot"])
def test_exports_agree_on_touches_without_a_label(library, tmp_path, rng, name):
    """All or none: with none there is no column, with some it is refused."""
    bare = library.touches().without("object").with_columns(session=["c"] * 7)
    library.add(bare)
    with pytest.raises(LibraryError, match="all touches must have an object or none"):
        library.export(tmp_path / name)
    assert not (tmp_path / name).exists()
    assert library.export(tmp_path / name, "object is null") == 7
    if name == "t.npz":
        columns = set(Touches.load(tmp_path / name).columns)
    else:
        [file] = (
            tmp_path.glob("robot/data/*/*") if name == "robot" else [tmp_path / name]
        )
        columns = set(pq.read_schema(file).names)
    assert "object" not in columns
    assert "session" in columns


def test_columns_of_some_touches_are_columns_of_all(library, tmp_path):
    """An episode without forces stands beside those with them; nothing is NaN."""
    some = library.touches("object = cup")
    library.add(some.without("force_n", "time_s").with_columns(session=["d"] * 3))
    assert library.export(tmp_path / "robot") == 10
    frames = pq.read_table(tmp_path / "robot/data").to_pydict()
    assert np.isnan(frames["observation.force_n"]).sum() == 3
    unknown = np.isnan(frames["time_s"])
    assert np.array(frames["timestamp"])[unknown].tolist() == [0, 1, 2]
    assert library.export(tmp_path / "t.parquet") == 10
    forces = pq.read_table(tmp_path / "t.parquet")["force_n"].to_pylist()
    assert np.isnan(forces).sum() == 3


def test_what_reads_a_dataset_is_named(library, tmp_path, monkeypatch):
    library.export(tmp_path / "robot")
    monkeypatch.setattr("palpate.library._bags.entry_points", lambda group: [])
    with pytest.raises(LibraryError, match="install what reads it, plugs/lerobot"):
        read_bag(tmp_path / "robot")


def test_other_endings_are_refused(library, tmp_path):
    with pytest.raises(LibraryError, match=r"got 't\.csv'"):
        library.export(tmp_path / "t.csv")


def test_a_failed_export_leaves_nothing_and_can_be_tried_again(
    library, tmp_path, alter
):
    move = "UPDATE images SET number = {} WHERE number = {}"
    alter(library.folder, *(move.format(*n) for n in ((0, 7), (7, 6), (6, 0))))
    (tmp_path / "empty").mkdir()
    before = sorted(tmp_path.rglob("*"))
    for name in ("robot", "empty", "t.parquet", "t.npz"):
        for _ in range(2):
            with pytest.raises(LibraryError, match="altered"):
                library.export(tmp_path / name)
    assert sorted(tmp_path.rglob("*")) == before
    alter(library.folder, *(move.format(*n) for n in ((0, 7), (7, 6), (6, 0))))
    assert library.export(tmp_path / "robot") == library.export(tmp_path / "empty") == 7
    assert (tmp_path / "empty/meta/info.json").is_file()
    assert not any(p.stat().st_size for p in tmp_path.rglob(".partial*"))


@pytest.mark.parametrize("name", ["t.npz", "t.parquet", "robot"])
def test_places_that_take_no_export_are_refused(library, tmp_path, name):
    with pytest.raises(
        LibraryError, match=f"got '.*nodir/{name}'. Make .*nodir' first"
    ):
        library.export(tmp_path / "nodir" / name)
    there = tmp_path / name
    there.mkdir() if "." in name else there.write_bytes(b"mine")
    (there / "mine" if "." in name else tmp_path / "x").write_bytes(b"mine")
    match = "must be a place with room" if "." in name else "empty folder, got a file"
    with pytest.raises(LibraryError, match=match):
        library.export(there)
    assert not any(p.stat().st_size for p in tmp_path.rglob(".partial*"))
    assert (there / "mine" if "." in name else there).read_bytes() == b"mine"


rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def _image(values, encoding, step=None, stamp=0, big=0):
    types = STORE.types
    rows = values.reshape(len(values), -1).view(np.uint8)
    if step is not None:
        rows = np.pad(rows, ((0, 0), (0, step - rows.shape[1])))
    return types["sensor_msgs/msg/Image"](
        types["std_msgs/msg/Header"](
            types["builtin_interfaces/msg/Time"](stamp, 250_000_000), "pad"
        ),
        values.shape[0],
        values.shape[1],
        encoding,
        big,
        rows.shape[1],
        np.ascontiguousarray(rows).reshape(-1),
    )


def _array(values, sizes):
    types = STORE.types
    dims = [
        types["std_msgs/msg/MultiArrayDimension"](f"d{i}", n, n)
        for i, n in enumerate(sizes)
    ]
    layout = types["std_msgs/msg/MultiArrayLayout"](dims, 0)
    return types["std_msgs/msg/Float32MultiArray"](layout, values.astype(np.float32))


@pytest.fixture(params=["SQLITE3", "MCAP"])
def bag(request, tmp_path):
    """Write messages to a new bag; return its path."""

    def write(*messages, topic="/pad"):
        path = tmp_path / f"bag{len(list(tmp_path.iterdir()))}"
        plugin = rosbag2.StoragePlugin[request.param]
        with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
            kind = messages[0].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for number, message in enumerate(messages):
                raw = STORE.serialize_cdr(message, kind)
                writer.write(connection, number * 10**9, raw)
        return path

    return write


def test_images_of_a_bag_are_touches(bag, rng):
    images = rng.integers(0, 2**16, (3, 4, 5), dtype=np.uint16)
    path = bag(
        *[_image(i, "mono16", step=12, stamp=7 + n) for n, i in enumerate(images)]
    )
    touches = read_bag(path, "/pad", object="cup")
    assert_array_equal(touches.images, images)
    assert touches.images.dtype == np.uint16
    assert touches.object.tolist() == ["cup"] * 3
    assert touches.columns["time_s"].tolist() == [7.25, 8.25, 9.25]


def test_a_digest_of_all_messages_is_kept(bag, tmp_path):
    """Bags in SQLite have no checksum: the library keeps one of what was read."""
    images = np.zeros((2, 2, 3), np.uint8)
    messages = [_image(image, "mono8", stamp=n) for n, image in enumerate(images)]
    touches = read_bag(bag(*messages), "/pad")
    digest = touches.whole["set_bag_sha256"].item()
    assert re.fullmatch("[0-9a-f]{64}", digest)
    assert read_bag(bag(*messages), "/pad").whole["set_bag_sha256"] == digest
    for row, stamp in ((1, 1), (0, 2)):
        images[1, 0, 0] = row
        altered = bag(messages[0], _image(images[1], "mono8", stamp=stamp))
        assert read_bag(altered, "/pad").whole["set_bag_sha256"] != digest
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        library.add(touches)
        assert library.touches().whole["set_bag_sha256"] == digest


def test_a_misspelt_topic_is_told_with_the_one_meant(bag, tmp_path):
    path = bag(_image(np.zeros((2, 2), np.uint8), "mono8"), topic="/finger/image")
    words = ["library", "add", str(tmp_path / "lab"), str(path)]
    kind = r"\(/finger/image of sensor_msgs/msg/Image\), got "
    done = CliRunner().invoke(app, [*words, "--topic", "/finger/imag"])
    assert re.search(kind + "'/finger/imag'.*mean", str(done.exception))
    assert not (tmp_path / "lab").exists()


def test_a_fourth_channel_of_a_bag_is_left_out(bag):
    """Its value must not matter; blue comes first in bgra8: 0.114 * 255 = 29.07."""
    bgra = np.array([[[255, 0, 0, 0], [255, 0, 0, 255]]], dtype=np.uint8)
    found = read_bag(bag(_image(bgra, "bgra8")), "/pad").images.tolist()
    assert found == [[[29, 29]]]
    found = read_bag(bag(_image(bgra, "rgba8")), "/pad").images.tolist()
    assert found == [[[76, 76]]]


def test_byte_order_and_colour_are_understood(bag):
    wide = np.array([[1, 258], [3, 4]], dtype=">u2")
    big = read_bag(bag(_image(wide, "16UC1", big=1)), "/pad")
    assert_array_equal(big.images[0], wide)
    # Pure red and white: luma 0.299 * 255 = 76.2 and 255.
    bgr = np.array([[[0, 0, 255], [255, 255, 255]]], dtype=np.uint8)
    assert read_bag(bag(_image(bgr, "bgr8")), "/pad").images.tolist() == [[[76, 255]]]


@pytest.mark.parametrize(
    ("sizes", "shape"), [((3, 4), (3, 4)), ((1, 3, 4), (3, 4)), ((), (1, 12))]
)
def test_arrays_of_a_bag_are_touches(bag, sizes, shape):
    values = np.arange(12.0)
    touches = read_bag(bag(_array(values, sizes), _array(values, sizes)), "/pad")
    assert touches.images.shape == (2, *shape)
    assert_array_equal(touches.images[1].ravel(), values)
    assert touches.columns["time_s"].tolist() == [0, 1]


def _cloud(values, names=("x", "y", "z", "force"), row_pad=0):
    """Points whose last field is a float32 reading after those of their place."""
    types = STORE.types
    n_rows, n_cols = values.shape
    fields = [
        types["sensor_msgs/msg/PointField"](name, 4 * i, 7, 1)
        for i, name in enumerate(names)
    ]
    step = 4 * len(names)
    points = np.zeros((n_rows, n_cols, len(names)), "<f4")
    points[..., -1] = values
    rows = np.pad(points.reshape(n_rows, -1).view(np.uint8), ((0, 0), (0, row_pad)))
    size = (False, step, n_cols * step + row_pad)
    header = _image(np.zeros((1, 1), np.uint8), "mono8").header
    kind = types["sensor_msgs/msg/PointCloud2"]
    return kind(header, n_rows, n_cols, fields, *size, rows.ravel(), True)


@pytest.mark.parametrize("row_pad", [0, 6])
def test_points_of_a_cloud_are_taxels(bag, rng, row_pad):
    values = rng.normal(size=(3, 4)).astype(np.float32)
    touches = read_bag(bag(_cloud(values, row_pad=row_pad)))
    assert_array_equal(touches.images, values[None])
    named = _cloud(values, ("x", "y", "z", "ring", "intensity"))
    assert_array_equal(read_bag(bag(named)).images, values[None])
    with pytest.raises(LibraryError, match=r"one reading a point .* fields ring, time"):
        read_bag(bag(_cloud(values, ("x", "y", "z", "ring", "time"))))
    short = _cloud(values)
    short.width = 1000
    with pytest.raises(
        LibraryError, match="3 rows of 1000 points of 16 bytes, got 192"
    ):
        read_bag(bag(short))


def test_compressed_pictures_are_touches(bag, rng):
    import cv2

    image = rng.integers(0, 256, (5, 4), dtype=np.uint8)
    kind = STORE.types["sensor_msgs/msg/CompressedImage"]
    header = _image(image, "mono8").header
    data = cv2.imencode(".png", image)[1].ravel()
    assert_array_equal(read_bag(bag(kind(header, "png", data))).images, image[None])
    with pytest.raises(
        LibraryError, match="message 0 of /pad: A picture must be a JPEG"
    ):
        read_bag(bag(kind(header, "png", data[:-20])))


def test_topics_are_listed_where_none_is_named(tmp_path):
    image = _image(np.zeros((2, 2), np.uint8), "mono8")
    array = _array(np.zeros(4), (2, 2))
    word = STORE.types["std_msgs/msg/String"]("hello")
    with rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        for topic, message in (("/gel", image), ("/pad", array), ("/say", word)):
            kind = message.__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connection, 0, STORE.serialize_cdr(message, kind))
    listed = r"/gel of sensor_msgs/msg/Image, /pad of .*, /say of std_msgs/msg/String"
    with pytest.raises(LibraryError, match=rf"\({listed}\), got None"):
        read_bag(tmp_path / "bag")
    assert len(read_bag(tmp_path / "bag", "/gel")) == 1
    with pytest.raises(LibraryError, match=r"must be .*, got std_msgs/msg/String"):
        read_bag(tmp_path / "bag", "/say")


def test_what_is_no_touch_is_refused(bag, tmp_path):
    good = _image(np.zeros((2, 2), np.uint8), "mono8")
    with pytest.raises(LibraryError, match=r"bag \(/pad of .*Image\), got '/other'"):
        read_bag(bag(good), "/other")
    with pytest.raises(LibraryError, match="encoded as mono8"):
        read_bag(bag(_image(np.zeros((2, 2), np.uint8), "bayer_rggb8")), "/pad")
    short = _image(np.zeros((2, 2), np.uint8), "mono8")
    short.height = 1000
    with pytest.raises(LibraryError, match="1000 rows of 2 bytes, got 4"):
        read_bag(bag(short), "/pad")
    with pytest.raises(LibraryError, match="one size and type"):
        read_bag(bag(good, _image(np.zeros((3, 2), np.uint8), "mono8")), "/pad")
    with pytest.raises(LibraryError, match="at most 5 bytes"):
        read_bag(bag(good, good), "/pad", max_bytes=5)
    with pytest.raises(LibraryError, match="one array of rows and columns"):
        read_bag(bag(_array(np.zeros(5), (2, 3))), "/pad")
    (tmp_path / "no.mcap").write_bytes(b"nothing")
    with pytest.raises(LibraryError, match="must be a bag of ROS"):
        read_bag(tmp_path / "no.mcap", "/pad")
