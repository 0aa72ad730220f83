"""Bags of ROS 1, written by rosbags, become touches as those of ROS 2 do."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate.library import LibraryError, TouchLibrary, read_bag

rosbag1 = pytest.importorskip("rosbags.rosbag1")
typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
IMAGE, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
ARRAY, TEXT = "std_msgs/msg/Float32MultiArray", "std_msgs/msg/String"


def message(kind, *fields):
    return STORE.types[kind](*fields)


def header(number):
    stamp = message("builtin_interfaces/msg/Time", 100 + number, 250_000_000)
    return message("std_msgs/msg/Header", number, stamp, "pad")


def picture(number, side=6):
    levels = np.full(side * side, number, np.uint8)
    return message(IMAGE, header(number), side, side, "mono8", 0, side, levels)


def cloud(number):
    names = ("x", "y", "z", "pressure")
    field = "sensor_msgs/msg/PointField"
    fields = [message(field, name, 4 * k, 7, 1) for k, name in enumerate(names)]
    points = np.zeros((2, 3, 4), np.float32)
    points[..., 3] = number + np.arange(6).reshape(2, 3)
    data = points.view(np.uint8).ravel()
    return message(CLOUD, header(number), 2, 3, fields, False, 16, 48, data, True)


def array(number):
    dimension = "std_msgs/msg/MultiArrayDimension"
    sizes = [message(dimension, "rows", 2, 6), message(dimension, "cols", 3, 3)]
    layout = message("std_msgs/msg/MultiArrayLayout", sizes, 0)
    return message(ARRAY, layout, np.arange(6, dtype=np.float32) + number)


def write(path, topics, *, compression=None, n_messages=4):
    """Write a bag; `topics` are the kind and the maker of each."""
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(getattr(writer.CompressionFormat, compression))
    with writer:
        for topic, (kind, make) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for number in range(n_messages):
                raw = STORE.serialize_ros1(make(number), kind)
                writer.write(connection, (5 + number) * 10**9, raw)
    return path


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_pictures_keep_levels_and_stamps(compression, tmp_path):
    path = write(
        tmp_path / "a.bag", {"/pad": (IMAGE, picture)}, compression=compression
    )
    touches = read_bag(path, object="mug")
    assert touches.images.shape == (4, 6, 6)
    assert_array_equal(touches.images[:, 0, 0], [0, 1, 2, 3])
    assert touches.columns["time_s"].tolist() == [100.25, 101.25, 102.25, 103.25]
    assert touches.object.tolist() == ["mug"] * 4


def test_clouds_and_arrays_are_frames_and_topics_are_listed(tmp_path):
    topics = {"/cloud": (CLOUD, cloud), "/array": (ARRAY, array)}
    path = write(tmp_path / "b.bag", topics)
    expected = np.arange(4)[:, None, None] + np.arange(6.0).reshape(2, 3)
    for topic in topics:
        assert_array_equal(read_bag(path, topic).images, expected)
    with pytest.raises(LibraryError, match=r"/array of std_msgs.*, /cloud of sensor"):
        read_bag(path)


def test_a_library_takes_them(tmp_path):
    path = write(tmp_path / "c.bag", {"/pad": (IMAGE, picture)})
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        library.add(touches=read_bag(path, object="mug"), progress=False)
        assert len(library.touches()) == 4


def test_what_unpacks_to_much_is_no_bag_or_is_damaged_is_refused(tmp_path):
    rows = {"/pad": (IMAGE, lambda number: picture(number, side=2000))}
    for compression in ("BZ2", "LZ4"):
        path = tmp_path / f"{compression}.bag"
        write(path, rows, compression=compression, n_messages=1)
        with pytest.raises(LibraryError, match="must unpack to at most"):
            read_bag(path, max_bytes=2**20)
        assert read_bag(path, max_bytes=2**30).images.shape == (1, 2000, 2000)
    whole = write(tmp_path / "d.bag", {"/pad": (IMAGE, picture)}).read_bytes()
    cut = tmp_path / "cut.bag"
    for content in (b"#ROSBAG V2.0\n", whole[: len(whole) // 2], b"no bag at all"):
        cut.write_bytes(content)
        with pytest.raises(LibraryError, match=r"cut.bag must be a bag of ROS or"):
            read_bag(cut)
