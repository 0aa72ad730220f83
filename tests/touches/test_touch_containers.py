"""Files of other programs are touches, or one sentence; nothing large is read."""

import struct
import subprocess
import sys

import numpy as np
import pytest
import scipy.io
from numpy.testing import assert_array_equal
from PIL import Image

from palpate import Touches
from palpate.touches import TouchesError

OBJECTS = ["cup", "cup", "pen", "pen"]


@pytest.fixture
def images(rng):
    return rng.integers(0, 2**16, (4, 5, 6), dtype=np.uint16)


def _h5(path, images):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        group = file.create_group("session")
        group.create_dataset("X", data=images, compression="gzip")
        group.create_dataset("label", data=OBJECTS)
        group.create_dataset("force_n", data=[1.0, 2, 3, 4])
        group.create_dataset("rate", data=30)


def _zarr(path, images):
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(str(path), mode="w")
    for name, values in {"X": images, "force_n": np.array([1.0, 2, 3, 4])}.items():
        made = group.create_array(name, shape=values.shape, dtype=values.dtype)
        made[...] = values


def _mat(path, images):
    labels = np.array(OBJECTS)
    force = [1.0, 2, 3, 4]
    scipy.io.savemat(path, {"X": images, "label": labels, "force_n": force})


def _mat73(path, images):
    """As MATLAB writes it: HDF5 behind 512 bytes, axes the other way round."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        file["X"] = images.T
        file["force_n"] = [[1.0, 2, 3, 4]]
    with path.open("r+b") as file:
        text = b"MATLAB 7.3 MAT-file, made by a test"
        file.write(text.ljust(124) + struct.pack("<H", 0x200) + b"IM")


@pytest.mark.parametrize(
    ("name", "write"),
    [("t.h5", _h5), ("t.zarr", _zarr), ("t.mat", _mat), ("t73.mat", _mat73)],
)
def test_arrays_come_with_their_columns(tmp_path, images, name, write):
    write(tmp_path / name, images)
    touches = Touches.load(tmp_path / name)
    assert_array_equal(touches.images, images)
    assert touches.images.dtype == np.uint16
    assert touches.columns["force_n"].tolist() == [1, 2, 3, 4]
    if name in ("t.h5", "t.mat"):
        assert touches.object.tolist() == OBJECTS
    with pytest.raises(TouchesError, match="at most 50 bytes, got"):
        Touches.load(tmp_path / name, max_bytes=50)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_every_page_of_a_tiff_is_a_touch(tmp_path, images, dtype):
    tifffile = pytest.importorskip("tifffile")
    stack = images.astype(dtype)
    tifffile.imwrite(tmp_path / "s.tiff", stack, photometric="minisblack")
    touches = Touches.load(tmp_path / "s.tiff")
    assert_array_equal(touches.images, stack)
    assert touches.images.dtype == dtype
    for n, page in enumerate(stack):
        path = tmp_path / "in" / OBJECTS[n] / f"{n}.tif"
        path.parent.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(path, page, photometric="minisblack")
    folder = Touches.load(tmp_path / "in")
    assert_array_equal(folder.images, stack)
    assert folder.object.tolist() == OBJECTS
    tifffile.imwrite(tmp_path / "in/pen/9.tif", stack, photometric="minisblack")
    with pytest.raises(TouchesError, match="must be one touch in a folder"):
        Touches.load(tmp_path / "in")


@pytest.mark.parametrize("ending", ["bmp", "webp"])
def test_bmp_and_webp_are_pictures(tmp_path, rng, ending):
    levels = rng.integers(0, 256, (6, 7), dtype=np.uint8)
    rgb = np.repeat(levels[..., None], 3, axis=2)  # of grey the luma is the level
    Image.fromarray(rgb).save(tmp_path / f"p.{ending}", lossless=True)
    path = tmp_path / f"p.{ending}"
    assert_array_equal(Touches.load(path).images, levels[None])
    with pytest.raises(TouchesError, match="at most 20 pixels, got 7 x 6"):
        Touches.load(path, max_pixels=20)
    path.write_bytes(path.read_bytes()[:30])
    with pytest.raises(TouchesError, match="must be a whole"):
        Touches.load(path)


def test_frames_without_a_header_need_shape_and_type(tmp_path, images):
    path = tmp_path / "f.raw"
    images.tofile(path)
    touches = Touches.load(path, shape=(5, 6), dtype="uint16")
    assert_array_equal(touches.images, images)
    swapped = Touches.load(path, shape=(5, 6), dtype=">u2")
    assert_array_equal(swapped.images, images.byteswap())
    forces = Touches.load(path, shape=(5, 2), dtype="uint16", channels=["x", "y", "z"])
    assert_array_equal(forces.images, images.reshape(4, 5, 2, 3))
    assert forces.channels == ("x", "y", "z")
    for shape, dtype, message in [
        (None, "uint16", "shape and dtype must be given"),
        ((5, 7), "uint16", "5 x 7 uint16, 70 bytes each, got 240 bytes"),
        ((5, 6), "object", "a type of numbers such as uint16"),
        ((5, 6), "no type", "a type of numbers such as uint16"),
    ]:
        with pytest.raises(TouchesError, match=message):
            Touches.load(path, shape=shape, dtype=dtype)
    np.save(tmp_path / "a.npy", images)
    with pytest.raises(TouchesError, match="dtype must be left out"):
        Touches.load(tmp_path / "a.npy", dtype="uint16")


def test_columns_with_blanks_and_a_clock_are_read(tmp_path, rng):
    """As ReSkin's program writes: a clock, then x, y, z of each magnetometer."""
    readings = rng.normal(size=(6, 2, 3)).round(3)
    time_s = 1e9 + 0.04 * np.arange(6)
    rows = np.column_stack([time_s, readings.reshape(6, -1)])
    np.savetxt(tmp_path / "r.txt", rows, header="time and fields")
    np.savetxt(tmp_path / "r.csv", rows, delimiter=",")
    for name in ("r.txt", "r.csv"):
        touches = Touches.load(tmp_path / name, channels=["x", "y", "z"])
        assert_array_equal(touches.images[:, 0], readings)
        assert_array_equal(touches.columns["time_s"], time_s)
    with pytest.raises(TouchesError, match="as many of each channel"):
        Touches.load(tmp_path / "r.txt", channels=["x", "y", "z", "t"])


def test_a_first_taxel_that_is_no_clock_stays_one(tmp_path, rng):
    rows = rng.normal(size=(8, 3)).cumsum(axis=0)
    np.savetxt(tmp_path / "r.csv", rows, delimiter=",", fmt="%.17g")
    assert_array_equal(Touches.load(tmp_path / "r.csv").images[:, 0], rows)


def test_labels_beside_pictures_are_columns(tmp_path, rng):
    for n in range(3):
        levels = rng.integers(0, 256, (6, 7), dtype=np.uint8)
        Image.fromarray(levels).save(tmp_path / f"{n}.png")
    table = tmp_path / "labels.csv"
    table.write_text("filename,label,force_n\n1.png,pen,2\n0.png,7,1\n2.png,cup,3\n")
    touches = Touches.load(tmp_path)
    assert touches.object.tolist() == ["7", "pen", "cup"]
    assert touches.columns["force_n"].tolist() == [1, 2, 3]
    table.write_text("filename,label\n1.png,pen\n")
    with pytest.raises(TouchesError, match=r"none for 0.png \(2 of 3\)"):
        Touches.load(tmp_path)
    table.write_text("what,label\n1.png,pen\n")
    with pytest.raises(TouchesError, match="one of them file, filename"):
        Touches.load(tmp_path)


def test_a_set_is_an_array(images):
    touches = Touches(images)
    assert_array_equal(np.asarray(touches), images)
    assert np.asarray(touches, dtype=float).dtype == np.float64


def test_small_files_that_claim_much_are_refused_unread(tmp_path):
    h5py = pytest.importorskip("h5py")
    zarr = pytest.importorskip("zarr")
    tifffile = pytest.importorskip("tifffile")
    with h5py.File(tmp_path / "t.h5", "w") as file:
        chunk = (1, 1000, 1000)
        file.create_dataset("X", (8000, 1000, 1000), "f8", chunks=chunk)
    zarr.create_array(str(tmp_path / "t.zarr"), shape=(9000, 1000, 1000), dtype="f8")
    tifffile.imwrite(tmp_path / "t.tiff", np.zeros((4, 4), np.uint8))
    content = bytearray((tmp_path / "t.tiff").read_bytes())
    for tag in (256, 257):  # width and length
        at = content.index(struct.pack("<HHI", tag, 4, 1))
        content[at + 2 : at + 12] = struct.pack("<HII", 4, 1, 100_000)
    (tmp_path / "t.tiff").write_bytes(content)
    for name in ("t.h5", "t.zarr", "t.tiff"):
        with pytest.raises(TouchesError, match=r"bytes, got|must be a whole"):
            Touches.load(tmp_path / name)


def test_a_mat_file_that_unpacks_to_much_is_refused(tmp_path):
    scipy.io.savemat(
        tmp_path / "t.mat", {"X": np.zeros((60, 300, 300))}, do_compression=True
    )
    assert (tmp_path / "t.mat").stat().st_size < 100_000
    with pytest.raises(TouchesError, match="at most 1000000 bytes, got 43200000"):
        Touches.load(tmp_path / "t.mat", max_bytes=1_000_000)


def test_links_out_of_a_file_are_not_followed(tmp_path, images):
    h5py = pytest.importorskip("h5py")
    (tmp_path / "secret").write_bytes(images.tobytes())
    with h5py.File(tmp_path / "t.h5", "w") as file:
        shape = images.shape
        external = [(str(tmp_path / "secret"), 0, images.nbytes)]
        file.create_dataset("X", shape, "u2", external=external)
    with pytest.raises(TouchesError, match="must lie in the file itself"):
        Touches.load(tmp_path / "t.h5")
    with h5py.File(tmp_path / "l.h5", "w") as file:
        file["X"] = h5py.ExternalLink("t.h5", "X")
    with pytest.raises(TouchesError, match="must hold one array of images"):
        Touches.load(tmp_path / "l.h5")


@pytest.mark.parametrize(
    "name", ["x.h5", "x.tif", "x.mat", "x.webp", "x.bmp", "x.hdf5"]
)
def test_garbage_is_one_sentence(tmp_path, rng, name):
    (tmp_path / name).write_bytes(rng.bytes(500))
    with pytest.raises(TouchesError, match="must be a whole"):
        Touches.load(tmp_path / name)


def test_none_of_these_packages_is_imported_without_need():
    code = "import sys, palpate.touches; print(*{'h5py', 'zarr'} & {*sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.stdout.strip() == ""
    assert run.returncode == 0
