"""Bags of ROS 2 and 1, written by rosbags, become touches."""

import re
import sqlite3
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from typer.testing import CliRunner

from palpate.cli import app
from palpate.library import LibraryError, is_recording, read_bag

rosbag2 = pytest.importorskip("rosbags.rosbag2")
rosbag1 = pytest.importorskip("rosbags.rosbag1")
typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
ROS1 = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)


def _header(types, stamp, nanosec=250_000_000):
    time = types["builtin_interfaces/msg/Time"](stamp, nanosec)
    header = types["std_msgs/msg/Header"]
    # Headers of ROS 1 are numbered.
    number = [0] if types is ROS1.types else []
    return header(*number, time, "pad")


def _image(values, encoding, step=None, stamp=0, big=0, types=STORE.types):
    rows = values.reshape(len(values), -1).view(np.uint8)
    if step is not None:
        rows = np.pad(rows, ((0, 0), (0, step - rows.shape[1])))
    return types["sensor_msgs/msg/Image"](
        _header(types, stamp),
        values.shape[0],
        values.shape[1],
        encoding,
        big,
        rows.shape[1],
        np.ascontiguousarray(rows).reshape(-1),
    )


def _array(values, sizes, types=STORE.types):
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


@pytest.mark.parametrize(
    ("stamps", "times"),
    [([2, 0, 3], [2, 0, 3]), ([0, 0, 0], [0, 1, 2]), ([10**9, 0], [10**9, 1])],
)
def test_a_stamp_of_0_is_a_time_of_a_simulated_clock_alone(bag, stamps, times):
    messages = [_image(np.zeros((2, 2), np.uint8), "mono8") for _ in stamps]
    for message, stamp in zip(messages, stamps, strict=True):
        message.header = _header(STORE.types, stamp, 0)
    assert read_bag(bag(*messages)).columns["time_s"].tolist() == times


def test_a_folder_with_a_file_of_a_bags_name_is_no_bag(bag, tmp_path):
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "metadata.yaml").write_text("camera: left")
    assert not is_recording(tmp_path / "pictures")
    assert is_recording(bag(_image(np.zeros((2, 2), np.uint8), "mono8")))


def test_a_digest_of_all_messages_is_kept(bag, library):
    """Bags in SQLite have no checksum; the library keeps one of their messages."""
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
    library.add(touches)
    assert library.touches().whole["set_bag_sha256"] == digest


def test_a_misspelt_topic_is_refused_with_the_one_that_was_meant(bag, tmp_path):
    path = bag(_image(np.zeros((2, 2), np.uint8), "mono8"), topic="/finger/image")
    arguments = ["library", "add", str(tmp_path / "lab"), str(path)]
    topics = r"\(/finger/image of sensor_msgs/msg/Image\), got "
    result = CliRunner().invoke(app, [*arguments, "--topic", "/finger/imag"])
    assert re.search(topics + "'/finger/imag'.*mean", str(result.exception))
    assert not (tmp_path / "lab").exists()


def test_a_fourth_channel_of_a_bag_is_left_out(bag):
    """The luma of blue is 0.114 * 255 = 29.07, of red 76.2, whatever the fourth."""
    bgra = np.array([[[255, 0, 0, 0], [255, 0, 0, 255]]], dtype=np.uint8)
    images = read_bag(bag(_image(bgra, "bgra8")), "/pad").images.tolist()
    assert images == [[[29, 29]]]
    images = read_bag(bag(_image(bgra, "rgba8")), "/pad").images.tolist()
    assert images == [[[76, 76]]]


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


def _cloud(values, names=("x", "y", "z", "force"), row_pad=0, types=STORE.types):
    """Return a cloud of points; the last of their float32 fields is the reading."""
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
    kind = types["sensor_msgs/msg/PointCloud2"]
    return kind(_header(types, 0), n_rows, n_cols, fields, *size, rows.ravel(), True)


@pytest.mark.parametrize("row_pad", [0, 6])
def test_points_of_a_cloud_are_taxels(bag, rng, row_pad):
    values = rng.normal(size=(3, 4)).astype(np.float32)
    touches = read_bag(bag(_cloud(values, row_pad=row_pad)))
    assert_array_equal(touches.images, values[None])
    named = _cloud(values, ("x", "y", "z", "ring", "intensity"))
    assert_array_equal(read_bag(bag(named)).images, values[None])
    with pytest.raises(LibraryError, match=r"one reading a point .* fields ring, time"):
        read_bag(bag(_cloud(values, ("x", "y", "z", "ring", "time"))))
    forces = _cloud(values)
    forces.fields[3].count = 3  # of which one was read in silence
    with pytest.raises(LibraryError, match=r"the fields force \(3 a point\)\."):
        read_bag(bag(forces))
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
    header = _header(STORE.types, 0)
    data = cv2.imencode(".png", image)[1].ravel()
    assert_array_equal(read_bag(bag(kind(header, "png", data))).images, image[None])
    with pytest.raises(
        LibraryError, match="message 0 of /pad: A picture must be a whole JPEG"
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
    with pytest.raises(LibraryError, match="encoded as mono8"):
        read_bag(bag(_image(np.zeros((2, 2), np.uint8), "bayer_rggb8")), "/pad")
    empty = _image(np.zeros((1, 2), np.uint8), "mono8")
    empty.height, empty.data = 0, np.empty(0, np.uint8)
    with pytest.raises(LibraryError, match="message 0 of /pad must hold 0 rows of 2"):
        read_bag(bag(empty), "/pad")
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
    with pytest.raises(LibraryError, match="must not be infinite"):
        read_bag(bag(_array(np.full(4, np.inf), (2, 2))), "/pad")
    (tmp_path / "no.mcap").write_bytes(b"nothing")
    with pytest.raises(LibraryError, match="must be a bag of ROS"):
        read_bag(tmp_path / "no.mcap", "/pad")
    killed = bag(good)  # before it wrote its metadata
    (killed / "metadata.yaml").unlink()
    result = CliRunner().invoke(app, ["library", "add", f"{tmp_path}/lab", str(killed)])
    assert re.search("must be a bag .*`ros2 bag reindex`", str(result.exception))


def test_a_database_that_lacks_messages_is_refused(tmp_path):
    """As one copied without its `-wal`; by itself it counts what is there."""
    path = tmp_path / "bag"
    messages = [_image(np.zeros((2, 2), np.uint8), "mono8")] * 3
    kind = messages[0].__msgtype__
    plugin = rosbag2.StoragePlugin.SQLITE3
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/pad", kind, typestore=STORE)
        for number, message in enumerate(messages):
            writer.write(connection, number, STORE.serialize_cdr(message, kind))
    with closing(sqlite3.connect(path / "bag.db3", isolation_level=None)) as database:
        database.execute("DELETE FROM messages WHERE timestamp = 2")
    with pytest.raises(LibraryError, match=r"/pad must have 3 messages.*got 2\. Copy"):
        read_bag(path)
    assert len(read_bag(path / "bag.db3")) == 2


@pytest.mark.parametrize("others", [False, True])
def test_the_package_that_reads_a_dataset_is_named(tmp_path, monkeypatch, others):
    """Also where a package for recordings of another kind is installed."""
    (tmp_path / "robot" / "meta").mkdir(parents=True)
    (tmp_path / "robot" / "meta" / "info.json").touch()
    other = SimpleNamespace(load=lambda: other, is_dataset=lambda path: False)
    points = [other] if others else []
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points)
    with pytest.raises(LibraryError, match="install what reads it, plugs/lerobot"):
        read_bag(tmp_path / "robot")


def old_bag(path, compression=None, **topics):
    """Write a bag of ROS 1 with some messages of each topic."""
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(getattr(writer.CompressionFormat, compression))
    with writer:
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__
            connection = writer.add_connection(f"/{topic}", kind, typestore=ROS1)
            for number, message in enumerate(messages):
                raw = ROS1.serialize_ros1(message, kind)
                writer.write(connection, (5 + number) * 10**9, raw)
    return path


def _pictures(n_pictures, side=6):
    levels = np.arange(n_pictures, dtype=np.uint8)[:, None, None]
    images = np.broadcast_to(levels, (n_pictures, side, side))
    return [
        _image(np.array(image), "mono8", stamp=100 + n, types=ROS1.types)
        for n, image in enumerate(images)
    ]


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_pictures_of_ros_1_keep_levels_and_stamps(compression, tmp_path):
    path = old_bag(tmp_path / "a.bag", compression, pad=_pictures(4))
    touches = read_bag(path, object="mug")
    assert touches.images.shape == (4, 6, 6)
    assert_array_equal(touches.images[:, 0, 0], [0, 1, 2, 3])
    assert touches.columns["time_s"].tolist() == [100.25, 101.25, 102.25, 103.25]
    assert touches.object.tolist() == ["mug"] * 4


def test_clouds_and_arrays_of_ros_1_are_frames(tmp_path):
    expected = np.arange(4)[:, None, None] + np.arange(6.0).reshape(2, 3)
    topics = {
        "cloud": [_cloud(values, types=ROS1.types) for values in expected],
        "array": [_array(v.ravel(), (2, 3), ROS1.types) for v in expected],
    }
    path = old_bag(tmp_path / "b.bag", **topics)
    for topic in topics:
        assert_array_equal(read_bag(path, f"/{topic}").images, expected)


def test_a_bag_of_ros_1_that_unpacks_to_much_or_is_damaged_is_refused(tmp_path):
    for compression in ("BZ2", "LZ4"):
        path = tmp_path / f"{compression}.bag"
        old_bag(path, compression, pad=_pictures(1, side=2000))
        with pytest.raises(LibraryError, match="must unpack to at most"):
            read_bag(path, max_bytes=2**20)
        assert read_bag(path, max_bytes=2**30).images.shape == (1, 2000, 2000)
    whole = old_bag(tmp_path / "d.bag", pad=_pictures(4)).read_bytes()
    damaged = tmp_path / "cut.bag"
    for content in (b"#ROSBAG V2.0\n", whole[: len(whole) // 2], b"no bag at all"):
        damaged.write_bytes(content)
        with pytest.raises(LibraryError, match=r"cut.bag must be a bag of ROS or"):
            read_bag(damaged)
