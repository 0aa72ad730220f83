"""Every kind of file that people have goes into a library, or is refused in a sentence.

`palpate library add` as a shell calls it; what is stored is compared with what numpy,
h5py, tifffile, zarr, scipy, Pillow and rosbags wrote. Other types of levels, and what
else such files may hold, are asked for in `tests/touches/test_touch_containers.py`.
"""

import numpy as np
import pytest
import scipy.io
from numpy.testing import assert_array_equal

from palpate.library import TouchLibrary

from .conftest import put

IMAGES = np.random.default_rng(0).integers(0, 256, (4, 5, 6), dtype=np.uint8)
LABELS = ["cup", "cup", "pen", "pen"]


def hdf5(folder):
    with pytest.importorskip("h5py").File(folder / "t.h5", "w") as file:
        file["images"], file["label"] = IMAGES, LABELS
    return folder / "t.h5"


def tiff(folder):
    write = pytest.importorskip("tifffile").imwrite
    write(folder / "t.tif", IMAGES, photometric="minisblack")
    return folder / "t.tif"


def zarr(folder):
    group = pytest.importorskip("zarr").open_group(str(folder / "t.zarr"), mode="w")
    group.create_array("images", data=IMAGES)
    return folder / "t.zarr"


def mat(folder):
    scipy.io.savemat(folder / "t.mat", {"images": IMAGES, "label": np.array(LABELS)})
    return folder / "t.mat"


def pictures(folder):
    for number, image in enumerate(IMAGES):
        put(folder / "cup" / f"{number}.png", image)
    return folder


def labelled(folder):
    for number, image in enumerate(IMAGES):
        put(folder / f"{number}.png", image)
    rows = [f"{number}.png,{label}" for number, label in enumerate(LABELS)]
    (folder / "labels.csv").write_text("\n".join(["file,label", *rows]))
    return folder


def text(folder, name, **options):
    np.savetxt(folder / name, IMAGES.reshape(4, -1), fmt="%d", **options)
    return folder / name


def raw(folder):
    IMAGES.astype("<u2").tofile(folder / "t.raw")
    return folder / "t.raw"


def npy(folder):
    np.save(folder / "t.npy", IMAGES)
    return folder / "t.npy"


def npz(folder):
    np.savez(folder / "t.npz", X=IMAGES, y=np.array(LABELS))
    return folder / "t.npz"


def bag(folder, generation):
    """Write a bag of ROS 1 or 2 with four pictures."""
    typesys = pytest.importorskip("rosbags.typesys")
    package = pytest.importorskip(f"rosbags.rosbag{generation}")
    store_name = {1: "ROS1_NOETIC", 2: "ROS2_HUMBLE"}[generation]
    types = typesys.get_typestore(getattr(typesys.Stores, store_name))
    kind, message_types = "sensor_msgs/msg/Image", types.types
    path = folder / ("t.bag" if generation == 1 else "bag")
    options = {} if generation == 1 else {"version": 9}
    with package.Writer(path, **options) as writer:
        connection = writer.add_connection("/pad", kind, typestore=types)
        for number, image in enumerate(IMAGES):
            stamp = message_types["builtin_interfaces/msg/Time"](5 + number, 0)
            counted = (number,) if generation == 1 else ()
            header = message_types["std_msgs/msg/Header"](*counted, stamp, "pad")
            message = message_types[kind](header, 5, 6, "mono8", 0, 6, image.ravel())
            serialize = getattr(
                types, {1: "serialize_ros1", 2: "serialize_cdr"}[generation]
            )
            writer.write(connection, (5 + number) * 10**9, serialize(message, kind))
    return path


KINDS = {
    "hdf5": (hdf5, ""),
    "tiff": (tiff, "--object cup"),
    "zarr": (zarr, "--object cup"),
    "mat": (mat, ""),
    "png": (pictures, ""),
    "labels.csv": (labelled, ""),
    "bag of ROS 1": (lambda folder: bag(folder, 1), "--object cup"),
    "bag of ROS 2": (lambda folder: bag(folder, 2), "--object cup"),
    "blanks": (lambda folder: text(folder, "t.txt"), "--shape 5x6 --object cup"),
    "csv": (
        lambda folder: text(folder, "t.csv", delimiter=","),
        "--shape 5x6 --object cup",
    ),
    "raw": (raw, "--shape 5x6 --dtype <u2 --object cup"),
    "raw of three axes": (raw, "--shape 5x2 --dtype <u2 --channels x,y,z --object cup"),
    "npy": (npy, "--object cup"),
    "npz": (npz, ""),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_goes_into_a_library_as_it_is(kind, palpate, tmp_path):
    write, options = KINDS[kind]
    (tmp_path / "files").mkdir()
    path, lab = write(tmp_path / "files"), tmp_path / "lab"
    palpate.answer("library", "add", lab, path, *options.split())
    with TouchLibrary.open(lab) as library:
        touches = library.touches()
    assert touches.object is not None
    assert_array_equal(touches.images.reshape(IMAGES.shape), IMAGES)


def cut(folder, write):
    path = write(folder)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def written(folder, name, content):
    (folder / name).write_bytes(content)
    return folder / name


REFUSED = {
    "a pickle": (lambda folder: written(folder, "t.pkl", b"\x80\x04N."), ()),
    "weights of torch": (lambda folder: written(folder, "t.pt", b"PK\3\4"), ()),
    "text that is none": (lambda folder: written(folder, "t.csv", b"\xff\xfe,"), ()),
    "raw without a shape": (raw, ()),
    "raw that does not fit": (raw, ("--shape", "7x7", "--dtype", "<u2")),
    "hdf5 cut short": (lambda folder: cut(folder, hdf5), ()),
    "mat cut short": (lambda folder: cut(folder, mat), ()),
    "tiff of nothing": (lambda folder: written(folder, "t.tif", b"II*\0"), ()),
    "a bag of ROS 1 cut short": (lambda folder: cut(folder, lambda f: bag(f, 1)), ()),
    "a film of nothing": (lambda folder: written(folder, "t.mp4", b"\0" * 64), ()),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_file_that_cannot_be_read_is_refused_in_a_sentence(kind, palpate, tmp_path):
    write, options = REFUSED[kind]
    path = write(tmp_path)
    result = palpate("library", "add", tmp_path / "lab", path, *options)
    assert result.returncode in (1, 2)
    assert path.name in result.stderr.replace("\n", "")
