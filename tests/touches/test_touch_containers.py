"""Files of other programs, tables and data frames are read, or refused by name."""

import struct
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest
import scipy.io
from numpy.testing import assert_array_equal
from PIL import Image

from palpate import Touches
from palpate.touches import TouchesError, taxel_names

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
        array = group.create_array(name, shape=values.shape, dtype=values.dtype)
        array[...] = values


def _mat(path, images):
    labels = np.array(OBJECTS)
    force = [1.0, 2, 3, 4]
    scipy.io.savemat(path, {"X": images, "label": labels, "force_n": force})


def _mat73(path, images, **classes):
    """Write HDF5 behind 512 bytes with its axes reversed, as MATLAB does.

    `classes` are the class of an array, as MATLAB calls it, and the array.
    """
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        file["X"] = images.T
        file["force_n"] = [[1.0, 2, 3, 4]]
        for name, (kind, array) in classes.items():
            file[name] = np.transpose(array)
            file[name].attrs["MATLAB_class"] = np.bytes_(kind)
    with path.open("r+b") as file:
        text = b"MATLAB 7.3 MAT-file, made by a test"
        file.write(text.ljust(124) + struct.pack("<H", 0x200) + b"IM")


@pytest.mark.parametrize(
    ("name", "write"),
    [("t.h5", _h5), ("t.zarr", _zarr), ("t.mat", _mat), ("t73.mat", _mat73)],
)
def test_arrays_are_read_with_their_columns(tmp_path, images, name, write):
    write(tmp_path / name, images)
    touches = Touches.load(tmp_path / name)
    assert_array_equal(touches.images, images)
    assert touches.images.dtype == np.uint16
    assert touches.columns["force_n"].tolist() == [1, 2, 3, 4]
    if name in ("t.h5", "t.mat"):
        assert touches.object.tolist() == OBJECTS
    with pytest.raises(TouchesError, match="at most 50 bytes, got"):
        Touches.load(tmp_path / name, max_bytes=50)


def _h5_labels(path, labels):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["X"], file["label"] = np.zeros((len(labels), 4, 5)), labels


def _mat_labels(path, labels):
    content = {"X": np.zeros((len(labels), 4, 5)), "label": labels}
    scipy.io.savemat(path, content)


@pytest.mark.parametrize("values", [["T", "brain"], ["a b", "c"], [3.0, 12.0]])
def test_labels_of_matlab_are_read_as_meant(tmp_path, values):
    """Rows of text are filled up with blanks there, and numbers are doubles."""
    _mat_labels(tmp_path / "t.mat", np.array(values))
    names = [f"{value:g}" if isinstance(value, float) else value for value in values]
    assert Touches.load(tmp_path / "t.mat").object.tolist() == names


def test_the_best_name_of_labels_is_the_object_wherever_it_stands(tmp_path):
    arrays = {"X": np.zeros((4, 2, 3)), "y": np.arange(4.0), "label": [1.0, 1, 2, 2]}
    scipy.io.savemat(tmp_path / "t.mat", arrays)
    np.savez(tmp_path / "t.npz", **arrays)
    for name in ("t.mat", "t.npz"):
        touches = Touches.load(tmp_path / name)
        assert touches.object.tolist() == [*"1122"]
        assert touches.columns["y"].tolist() == [0, 1, 2, 3]
    np.savez(tmp_path / "axis.npz", X=arrays["X"], y=[0, 1])
    assert Touches.load(tmp_path / "axis.npz").object is None


@pytest.mark.parametrize("comments", ["", "# "])
@pytest.mark.parametrize("delimiter", [",", "\t"])
def test_names_of_taxels_are_those_that_numpy_wrote(tmp_path, comments, delimiter):
    header = delimiter.join(["p_1", "p_0", "object"])
    how = {"delimiter": delimiter, "comments": comments, "header": header}
    np.savetxt(tmp_path / "t.csv", np.eye(3, dtype=int), fmt="%d", **how)
    columns = Touches.load(tmp_path / "t.csv").columns
    assert taxel_names(tmp_path / "t.csv", columns) == ["p_1", "p_0"]


@pytest.mark.parametrize("name", ["t.h5", "t.mat"])
@pytest.mark.parametrize("odd", [0.5, np.nan, np.inf, 1e19])
def test_labels_that_are_not_whole_numbers_are_refused(tmp_path, name, odd):
    write = _mat_labels if name.endswith("mat") else _h5_labels
    write(tmp_path / name, np.array([1.0, odd]))
    with pytest.raises(TouchesError, match=r"object must (be text or|name every)"):
        Touches.load(tmp_path / name)


def test_labels_of_matlab_that_would_be_lost_are_refused(tmp_path):
    path, names = tmp_path / "t.mat", np.array(["cup", "pen"] * 3, dtype=object)
    for content, message in (
        ({"X": np.zeros((6, 4, 5)), "label": names}, "got cell label. .* char"),
        ({"data": {"X": np.zeros((6, 4, 5))}}, "got struct data"),
        ({"X": np.zeros((4, 5, 6)), "label": np.arange(6.0)}, "permute"),
    ):
        scipy.io.savemat(path, content)
        with pytest.raises(TouchesError, match=message):
            Touches.load(path)
    # The names of the classes, of which there are as many as columns, are no labels.
    names = np.array(["cup", "pen", "mug"])
    scipy.io.savemat(path, {"X": np.zeros((6, 4, 3)), "labels": names, "y": np.ones(6)})
    assert Touches.load(path).object.tolist() == ["1"] * 6


def test_labels_of_matlab_7_3_are_texts_or_refused(tmp_path, images):
    """A matrix of letters is one of their codes there; a cell refers to others."""
    path, names = tmp_path / "t.mat", ["µg  ", "cup ", "pens", "cup "]
    letters = np.array([[*map(ord, name)] for name in names], np.uint16)
    _mat73(path, images, object=("char", letters), session=("char", letters[:, :1]))
    touches = Touches.load(path)
    assert touches.object.tolist() == ["µg", "cup", "pens", "cup"]
    assert touches.session.tolist() == [*"µcpc"]
    _mat73(path, images, label=("cell", np.zeros((1, 4))))
    with pytest.raises(TouchesError, match=r"got cell label\. .* char"):
        Touches.load(path)


def test_bytes_of_hdf5_are_utf_8(tmp_path):
    _h5_labels(tmp_path / "t.h5", np.array(["café".encode(), b"mug"]))
    assert Touches.load(tmp_path / "t.h5").object.tolist() == ["café", "mug"]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_every_page_of_a_tiff_is_a_touch(tmp_path, images, dtype):
    tifffile = pytest.importorskip("tifffile")
    stack = images.astype(dtype)
    tifffile.imwrite(tmp_path / "s.tiff", stack, photometric="minisblack")
    touches = Touches.load(tmp_path / "s.tiff")
    assert_array_equal(touches.images, stack)
    assert touches.images.dtype == dtype
    folder = tmp_path / "in"
    folder.mkdir()
    tifffile.imwrite(folder / "9.tif", stack, photometric="minisblack")
    with pytest.raises(TouchesError, match="must be one touch in a folder"):
        Touches.load(folder)


def test_levels_of_a_tiff_are_those_that_it_shows(tmp_path, images):
    tifffile = pytest.importorskip("tifffile")
    path, levels = tmp_path / "s.tif", images.astype(np.uint8)
    tifffile.imwrite(path, 255 - levels, photometric="miniswhite")
    assert_array_equal(Touches.load(path).images, levels)
    planes = np.repeat(levels[:, None], 3, axis=1)  # the luma of grey is its level
    how = {"photometric": "rgb", "planarconfig": "separate"}
    tifffile.imwrite(path, planes, **how)
    assert_array_equal(Touches.load(path).images, levels)
    colours = np.zeros((3, 256), np.uint16)
    tifffile.imwrite(path, levels, photometric="palette", colormap=colours)
    with pytest.raises(TouchesError, match="got numbers of colours in a palette"):
        Touches.load(path)


def test_channels_of_a_tiff_are_no_touches(tmp_path, rng):
    tifffile = pytest.importorskip("tifffile")
    levels = rng.integers(0, 4096, (5, 3, 6, 4), dtype=np.uint16)
    tifffile.imwrite(tmp_path / "s.tif", levels, imagej=True, metadata={"axes": "TCYX"})
    with pytest.raises(TouchesError, match="for each touch, got pages along TCYX"):
        Touches.load(tmp_path / "s.tif")


@pytest.mark.parametrize("shape", [(5, 6, 4), (1, 5, 6, 4), (5, 1, 6, 4)])
@pytest.mark.parametrize("how", ["imagej", "ome", ""])
def test_pages_whose_axes_nobody_named_are_touches(tmp_path, rng, how, shape):
    """A program that writes TIFF calls the first of three axes channels."""
    tifffile = pytest.importorskip("tifffile")
    levels = rng.integers(0, 4096, shape, dtype=np.uint16)
    kind = {how: True} if how else {}
    tifffile.imwrite(tmp_path / "s.ome.tif", levels, photometric="minisblack", **kind)
    read = Touches.load(tmp_path / "s.ome.tif")
    assert_array_equal(read.images, levels.reshape(5, 6, 4))


@pytest.mark.parametrize(
    ("first", "n_taxels"),
    [
        ("object,15,14,13,12,11", 5),
        ("object,101,203,107,105,109", 5),
        ("#0,#1,#2,#3,weight,object", 4),
        ("#,t0,t1,t2,t3,object", 4),  # a row's number
        ("time_0,time_1,time_2,time_3,weight,object", 4),
        ("peak,area,time_to_peak,time constant,width,object", 5),
        ("label,Label,t0,t1,t2,t3", 4),
        ("Order,t0,t1,t2,t3,object", 4),
    ],
)
def test_names_of_taxels_are_taken_as_they_are(tmp_path, first, n_taxels):
    path, names = tmp_path / "t.csv", first.split(",")
    texts = {"object": "mug", "label": "mug", "Label": "7", "Order": "last"}
    rows = [
        ",".join(texts.get(n, f"{k}.{i}7") for i, n in enumerate(names)) for k in "13"
    ]
    path.write_text("\n".join([first, *rows]))
    touches = Touches.load(path)
    assert touches.images.shape == (2, 1, n_taxels)
    assert touches.object is not None
    assert [*touches.object] == ["mug", "mug"]


def test_a_label_that_lacks_in_a_line_is_about_something_else(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("label,t0,t1\nworn,1,2\n,3,4\n")
    touches = Touches.load(path)
    assert touches.object is None
    assert touches.columns["label"].tolist() == ["worn", ""]


@pytest.mark.parametrize("places", ["-1,0,1,2", "0.25,0.5,0.75,1", "x-1,x0,x1,x2"])
def test_taxels_named_by_their_places_are_in_order(tmp_path, places):
    path = tmp_path / "t.csv"
    path.write_text(f"object,{places}\nmug,1,2,3,4\nmug,5,6,7,8\n")
    assert Touches.load(path, shape=(2, 2)).images[0].tolist() == [[1, 2], [3, 4]]


def test_a_folder_of_ramps_has_no_clock(tmp_path):
    """A tilted plane rises evenly in all columns, a clock in the first alone."""
    for n in range(3):
        ramp = np.arange(20).reshape(5, 4) + n
        np.savetxt(tmp_path / f"mug_{n}.csv", ramp, delimiter=",", fmt="%d")
    assert Touches.load(tmp_path).images.shape == (3, 5, 4)


@pytest.mark.parametrize("levels", [[10, 10], [9, 10], [10, 50]])
def test_frames_of_few_levels_are_no_text(tmp_path, levels):
    frames = np.resize(np.array(levels, np.uint8), (5, 4, 4))
    frames.tofile(tmp_path / "t.dat")
    read = Touches.load(tmp_path / "t.dat", shape=(4, 4), dtype="uint8")
    assert_array_equal(read.images, frames)


@pytest.mark.parametrize("names", ["10023401,10023402-A", "20240501_mug,20240501_pen"])
def test_part_numbers_are_no_days(tmp_path, names):
    for name in names.split(","):
        (tmp_path / name).mkdir()
        levels = np.arange(64, dtype=np.uint8).reshape(8, 8)
        Image.fromarray(levels).save(tmp_path / name / "1.png")
    assert sorted(Touches.load(tmp_path).object) == names.split(",")


def test_truth_is_a_taxel_where_it_is_numbered():
    pandas = pytest.importorskip("pandas")
    taxels = np.arange(12).reshape(3, 4) % 3 > 0
    frame = pandas.DataFrame(taxels, columns=["t0", "t1", "t2", "t3"])
    touches = Touches.from_frame(frame.assign(weight=[1.5, 2, 3], label=[1.0, 2, 1]))
    assert_array_equal(touches.images[:, 0], taxels)
    lettered = frame.set_axis([*"abcd"], axis=1).assign(weight=[1.5, 2, 3])
    assert_array_equal(Touches.from_frame(lettered).images[:, 0, :4], taxels)
    assert touches.object is not None
    assert [*touches.object] == ["1", "2", "1"]


@pytest.mark.parametrize("name", ["object", "category"])
def test_a_label_that_a_program_wrote_for_none_is_refused(name):
    pandas = pytest.importorskip("pandas")
    about = {"object": ["mug", "pen"]} | {name: ["mug", "nan"]}
    frame = pandas.DataFrame(np.eye(2), columns=["t0", "t1"]).assign(**about)
    with pytest.raises(
        TouchesError, match="not be empty, got 'nan' at touch 1, as pro"
    ):
        Touches.from_frame(frame)


def test_a_text_is_no_frames_without_a_header(tmp_path, rng):
    path = tmp_path / "t.dat"
    np.savetxt(path, rng.random((32, 4)), fmt="%.5f")
    assert path.stat().st_size % 16 == 0
    with pytest.raises(TouchesError, match=r"text of numbers: .* Rename it to end in"):
        Touches.load(path, shape=(2, 2), dtype="float32")


@pytest.mark.parametrize("ending", ["bmp", "webp"])
def test_bmp_and_webp_are_pictures(tmp_path, rng, ending):
    levels = rng.integers(0, 256, (6, 7), dtype=np.uint8)
    rgb = np.repeat(levels[..., None], 3, axis=2)  # the luma of grey is its level
    Image.fromarray(rgb).save(tmp_path / f"p.{ending}", lossless=True)
    path = tmp_path / f"p.{ending}"
    assert_array_equal(Touches.load(path).images, levels[None])
    with pytest.raises(TouchesError, match="at most 20 pixels, got 7 x 6"):
        Touches.load(path, max_pixels=20)
    if ending == "webp":
        turned = Image.Exif()
        turned[0x0112] = 6  # the camera lay on its right side
        Image.fromarray(rgb).save(path, lossless=True, exif=turned)
        upright = np.rot90(levels, -1)[None]
        assert_array_equal(Touches.load(path).images, upright)
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
        ((5, 6), "(2,", "a type of numbers such as uint16"),
        ((-5, -6), "uint16", r"shape must be rows and columns .*, got \(-5, -6\)"),
        ((30,), "uint16", "shape must be rows and columns"),
    ]:
        with pytest.raises(TouchesError, match=message):
            Touches.load(path, shape=shape, dtype=dtype)


@pytest.mark.filterwarnings("ignore")  # of zarr, that not all others read texts
@pytest.mark.parametrize("dtype", ["str", "U3", "S3"])
def test_texts_of_zarr_are_labels(tmp_path, images, dtype):
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(str(tmp_path / "t.zarr"), mode="w")
    group.create_array("images", data=images)
    kind = str if dtype == "str" else dtype
    group.create_array("label", shape=(4,), dtype=kind)[:] = np.array([*"abba"], kind)
    assert Touches.load(tmp_path / "t.zarr").object.tolist() == [*"abba"]


def test_labels_beside_objects_are_a_column_of_their_own(tmp_path, images):
    """Numbers of objects beside their names, as an archive of plain arrays has them."""
    h5py = pytest.importorskip("h5py")
    arrays = {"images": images, "label": [0, 1, 1, 0], "object": [*"abba"]}
    np.savez(tmp_path / "t.npz", **arrays)
    with h5py.File(tmp_path / "t.h5", "w") as file:
        for name, values in arrays.items():
            file[name] = values
    with h5py.File(tmp_path / "two.h5", "w") as file:
        file["images"], file["labels"], file["y"] = images, [*"abba"], [0, 1, 1, 0]
    with h5py.File(tmp_path / "groups.h5", "w") as file:  # the one beside the images
        file["train/images"], file["train/label"] = images, [*"abba"]
        file["arm/label"] = [0, 1, 1, 0]
    names = {"t.npz": "label", "t.h5": "label", "two.h5": "y", "groups.h5": "label"}
    for name, column in names.items():
        touches = Touches.load(tmp_path / name)
        assert touches.object.tolist() == [*"abba"]
        assert touches.columns[column].tolist() == [0, 1, 1, 0]


@pytest.mark.parametrize(
    ("name", "taken"),
    [
        ("in/", {"name_pattern", "skip_bad", "colour", "levels"}),
        ("t.png", {"name_pattern", "skip_bad", "colour"}),
        ("t.npz", set()),
        ("t.parquet", set()),
        ("t.npy", {"channels"}),
        ("t.h5", {"channels"}),
        ("t.csv", {"channels", "shape"}),
        ("t.raw", {"channels", "shape", "dtype"}),
    ],
)
def test_options_of_other_files_are_refused_before_one_is_read(tmp_path, name, taken):
    path = tmp_path / name
    path.mkdir() if name.endswith("/") else path.touch()
    options = {"name_pattern": "(?P<object>x)", "skip_bad": True, "colour": True}
    options |= {"levels": "object", "channels": ("x", "y", "z"), "shape": (4, 6)}
    for option, value in {**options, "dtype": "u2"}.items():
        with pytest.raises(TouchesError) as refusal:
            Touches.load(path, **{option: value})
        told = f"{option} must be left out for" in str(refusal.value)
        assert told is (option not in taken)


@pytest.mark.parametrize("shape", [(-2, -2), (4,), (2.0, 2.0), (0, 4), 4])
def test_shapes_of_tables_that_are_none_are_refused(csv, shape):
    path = csv("1,2,3,4\n5,6,7,8\n")
    with pytest.raises(TouchesError, match="shape must be rows and columns of taxels"):
        Touches.load(path, shape=shape)


def test_columns_with_blanks_and_a_clock_are_read(tmp_path, rng):
    """ReSkin's program writes a clock, then x, y and z of each magnetometer."""
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


@pytest.mark.parametrize(
    ("names", "n_taxels"),
    [("time,left,right", 2), ("Unnamed: 0,t0,t1", 2), ("r0,r1,r2", 3)],
)
def test_a_clock_is_no_taxel_whatever_it_is_called(csv, rng, names, n_taxels):
    """A taxel that rises from touch to touch would tell objects taught in turns."""
    rows = np.column_stack([40 * np.arange(6), rng.normal(size=(6, 2)).round(3)])
    lines = [f"object,{names}", *("pen," + ",".join(map(str, row)) for row in rows)]
    touches = Touches.load(csv("\n".join(lines)))
    assert_array_equal(touches.images[:, 0], rows[:, -n_taxels:])
    assert (names.split(",")[0] in touches.columns) is (n_taxels == 2)


def test_a_first_column_that_is_no_clock_stays_a_taxel(tmp_path, rng):
    rows = rng.normal(size=(8, 3)).cumsum(axis=0)
    np.savetxt(tmp_path / "r.csv", rows, delimiter=",", fmt="%.17g")
    assert_array_equal(Touches.load(tmp_path / "r.csv").images[:, 0], rows)


def test_labels_beside_pictures_are_columns(put):
    root = put("0.png", "1.png", "2.png")
    table = root / "labels.csv"
    table.write_text("filename,label,force_n\n1.png,pen,2\n0.png,7,1\n2.png,cup,3\n")
    touches = Touches.load(root)
    assert touches.object.tolist() == ["7", "pen", "cup"]
    assert touches.columns["force_n"].tolist() == [1, 2, 3]
    for header in ("file,object,label,class", "file,label,object,class"):
        table.write_text(f"{header}\n0.png,a,a,1\n1.png,b,b,2\n2.png,a,a,1\n")
        touches = Touches.load(root)
        assert touches.object.tolist() == touches.columns["label"].tolist() == [*"aba"]
        assert touches.columns["class"].tolist() == [1, 2, 1]
    table.write_text("Image,Label\n0.png,a\n1.png,b\n2.png,a\n")
    assert Touches.load(root).object.tolist() == [*"aba"]
    for path_column, message in (
        ("filename", r"none for 0.png \(2 of 3\)"),
        ("what", "one of them file, filename"),
    ):
        table.write_text(f"{path_column},label\n1.png,pen\n")
        with pytest.raises(TouchesError, match=message):
            Touches.load(root)


def test_numpy_takes_a_set_as_an_array_of_its_images(images):
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
    with h5py.File(tmp_path / "deep.h5", "w") as file:  # of 3,000 it took 40 s
        file["/".join("g" * 51)] = np.zeros((2, 3, 4))
        file["/".join("f" * 52)] = np.zeros((2, 3, 4))
    with pytest.raises(TouchesError, match="arrays at most 50 groups deep"):
        Touches.load(tmp_path / "deep.h5")


def test_a_mat_file_that_unpacks_to_much_is_refused(tmp_path):
    large = {"X": np.zeros((60, 300, 300))}
    scipy.io.savemat(tmp_path / "t.mat", large, do_compression=True)
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
def test_garbage_is_refused_in_one_sentence(tmp_path, rng, name):
    (tmp_path / name).write_bytes(rng.bytes(500))
    with pytest.raises(TouchesError, match="must be a whole"):
        Touches.load(tmp_path / name)


def test_none_of_these_packages_is_imported_without_need():
    code = "import sys, palpate.touches; print(*{'h5py', 'zarr'} & {*sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.stdout.strip() == ""
    assert run.returncode == 0


HEADED = """object,force_n,x_mm,y_mm,z_mm,a,b,c,d
cup,0.5,1,2,3,0,1,2,3
cup,0.6,1,2,4,4,5,,7
pen,0.7,1,2,5,8,9,10,1e1
"""


@pytest.fixture
def csv(tmp_path):
    def write(text, name="touches.csv"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write


def test_each_line_is_a_touch(csv):
    touches = Touches.load(csv(HEADED), shape=(2, 2))
    assert touches.object.tolist() == ["cup", "cup", "pen"]
    assert touches.columns["force_n"].tolist() == [0.5, 0.6, 0.7]
    assert_array_equal(touches.columns["position_mm"][:, 2], [3, 4, 5])
    assert_array_equal(touches.images[0], [[0, 1], [2, 3]])
    assert_array_equal(touches.images[1], [[4, 5], [np.nan, 7]])  # a dead taxel
    assert touches.geometry is None


@pytest.mark.parametrize(
    ("names", "n_taxels"),
    [
        ("object,t0,t1,humidity,t2", 3),
        ("0,1,2,object,humidity", 3),
        ("palm,t1,t2,t3,object,humidity", 3),
        ("palm,thumb1,index1,object,humidity", 4),  # not numbered through
        ("x0,y0,x1,y1,humidity", 5),
        ("a,b,c,d,humidity", 5),
    ],
)
def test_beside_numbered_taxels_other_numbers_are_columns(csv, names, n_taxels):
    values = {name: str(n) for n, name in enumerate(names.split(","))}
    row = ",".join("mug" if name == "object" else n for name, n in values.items())
    touches = Touches.load(csv(f"{names}\n{row}\n{row}\n"))
    assert touches.images.shape == (2, 1, n_taxels)
    if n_taxels == 3:
        assert touches.columns["humidity"].tolist() == [float(values["humidity"])] * 2


@pytest.mark.parametrize("index", [False, True])
def test_numbers_that_count_the_columns_are_names(csv, tmp_path, rng, index):
    """They were a touch more, or a row of every touch."""
    pandas = pytest.importorskip("pandas")
    images = rng.integers(0, 9, (3, 6, 6))
    for number, image in enumerate(images):
        pandas.DataFrame(image).to_csv(tmp_path / f"{number}.csv", index=index)
    assert_array_equal(Touches.load(tmp_path).images, images)
    table = csv(pandas.DataFrame(images.reshape(3, 36)).to_csv(index=index))
    if index:
        with pytest.raises(TouchesError, match=r"got , 0, 1.*to_csv\(index=False\)"):
            Touches.load(table, shape=(6, 6))
    else:
        assert_array_equal(Touches.load(table, shape=(6, 6)).images, images)


def test_numbers_with_an_underscore_between_are_names(csv):
    touches = Touches.load(csv("0_0,0_1,1_0,1_1\n1,2,3,4\n"), shape=(2, 2))
    assert_array_equal(touches.images, [[[1, 2], [3, 4]]])
    touches = Touches.load(csv("trial,a,b\n1_1,1,2\n1_10,3,4\n"))
    assert touches.columns["trial"].tolist() == ["1_1", "1_10"]


@pytest.mark.parametrize("name", ["Object", " OBJECT", "label", "Class", "# object"])
def test_the_column_of_names_may_be_spelt_otherwise(csv, tmp_path, name):
    """Numbers of objects under such a name were a taxel that tells all of them."""
    table = csv(f"{name},Session,left,right\n7,1,0.5,0.25\n8,1,0.25,0.5\n")
    touches = Touches.load(table)
    assert touches.object.tolist() == ["7", "8"]
    assert touches.session.tolist() == ["1", "1"]
    assert touches.images.shape == (2, 1, 2)
    table = csv(f"object,{name},left\nmug,7,0.5\n", "in/table.csv")
    if name in ("label", "Class"):
        assert Touches.load(table).images.tolist() == [[[7, 0.5]]]


@pytest.mark.parametrize("name", ["Time", "timestamp", "time (ms)", "stamp_ns"])
def test_a_column_called_time_is_a_clock_wherever_it_stands(csv, rng, name):
    """Touches that a hand makes do not come at even steps."""
    rows = [f"{rng.random()},{rng.random()},pen,{1e9 + rng.random()}" for _ in "123456"]
    touches = Touches.load(csv("\n".join([f"left,right,object,{name}", *rows])))
    assert touches.images.shape == (6, 1, 2)
    assert touches.columns[name].min() > 1e9


@pytest.mark.parametrize(
    ("names", "order"),
    [
        ("t0,t1,t10,t11,t2,t3,t4,t5,t6,t7,t8,t9", "t0, t1, t10, t11"),
        ("p10_x,p10_y,p10_z,p1_x,p1_y,p1_z,p2_x,p2_y,p2_z,p3_x,p3_y,p3_z", "p10_x"),
        ("t00,t01,t02,t03,t04,t05,t06,t07,t08,t09,t10,t11", ""),
        ("t11,t10,t9,t8,t7,t6,t5,t4,t3,t2,t1,t0", ""),
    ],
)
def test_taxels_that_were_sorted_as_text_lie_elsewhere(csv, names, order):
    table = csv(f"{names}\n{','.join('123456789012')}\n")
    assert Touches.load(table).geometry == "none"
    if not order:
        assert Touches.load(table, shape=(3, 4)).images[0, 0, 1] == 2
        return
    with pytest.raises(TouchesError, match=f"stand row by row, got {order}"):
        Touches.load(table, shape=(3, 4))


@pytest.mark.parametrize(
    ("names", "channels", "message"),
    [
        ("p0_x,p0_y,p1_x,p1_y", "xy", ""),
        ("Bx0,By0,Bx1,By1", "xy", ""),
        ("sensor0,sensor1,sensor2,sensor3", "rg", ""),
        ("p0_x,p1_x,p0_y,p1_y", "xy", "got p1_x for y. Sort them so"),
        ("p0_y,p0_x,p1_y,p1_x", "xy", "got p0_y for x. Sort them so"),
    ],
)
def test_numbers_of_another_channel_are_refused(csv, names, channels, message):
    table = csv(f"{names}\n1,2,3,4\n")
    if not message:
        touches = Touches.load(table, channels=[*channels])
        assert touches.images.tolist() == [[[[1, 2], [3, 4]]]]
        return
    with pytest.raises(TouchesError, match=message):
        Touches.load(table, channels=[*channels])


def test_files_that_are_no_rows_of_taxels_are_refused(csv):
    """A clock beside the frames of a recording was a column of each image."""
    for name in ("in/mug/0.csv", "in/pen/1.csv"):
        path = csv("\n".join(f"{0.5 * n},{n % 2},{n % 3}" for n in range(6)), name)
    with pytest.raises(TouchesError, match="rises evenly, as a clock does"):
        Touches.load(path.parents[1])
    csv("time,t0,t1\n0,1,2\n", "in/mug/0.csv")
    with pytest.raises(TouchesError, match=r"alone, .* got names \(time, t0, t1"):
        Touches.load(path.parents[1])
    table = csv("1,2,3\n4,5,6\n")
    with pytest.raises(TouchesError, match="write all rows of a touch into one line"):
        Touches.load(table, shape=(2, 3))


def test_without_a_shape_a_table_has_no_geometry(csv):
    """With one of a single row it is a strip, which images alone do not say."""
    file = csv("1;2;3\n4;5;6\n")
    touches = Touches.load(file)
    assert_array_equal(touches.images, [[[1, 2, 3]], [[4, 5, 6]]])
    assert touches.geometry == "none"
    assert touches.object is None
    assert Touches.load(file, shape=(1, 3)).geometry == "array"


def test_an_array_with_a_flipped_bit_is_refused_or_read(tmp_path, images):
    """Whatever bit of its head it is; and an archive under the name of an array."""
    path = tmp_path / "t.npy"
    np.save(path, images)
    whole = path.read_bytes()
    for place in range(8 * 128):
        flipped = bytearray(whole)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        with suppress(TouchesError):
            Touches.load(path)
    path.write_bytes(b"PK\3\4 and no more")
    with pytest.raises(TouchesError, match="got: several in an archive"):
        Touches.load(path)
    np.savez(tmp_path / "t.npz", images=images)
    (tmp_path / "t.npz").rename(path)
    with pytest.raises(TouchesError, match="got: several in an archive"):
        Touches.load(path)


def _tiff(path, image):
    pytest.importorskip("tifffile").imwrite(path, image, photometric="minisblack")


def _csv(path, image):
    np.savetxt(path, image, delimiter=",", fmt="%.17g")


@pytest.mark.parametrize(
    ("ending", "write"), [("csv", _csv), ("npy", np.save), ("tif", _tiff)]
)
def test_each_file_of_a_folder_is_a_touch(tmp_path, rng, ending, write):
    images = rng.normal(size=(4, 3, 2))
    for n, image in enumerate(images):
        path = tmp_path / "in" / OBJECTS[n] / f"{n}.{ending}"
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, image)
    touches = Touches.load(tmp_path / "in")
    assert_array_equal(touches.images, images)
    assert touches.object.tolist() == OBJECTS
    for option in ({"skip_bad": True}, {"colour": True}):
        with pytest.raises(TouchesError, match="must be left out for arrays, as in"):
            Touches.load(tmp_path / "in", **option)
    write(tmp_path / "in" / "pen" / f"9.{ending}", np.zeros((3, 3)))
    message = rf"9.{ending} must be \(3, 2\) float64 like"
    with pytest.raises(TouchesError, match=message):
        Touches.load(tmp_path / "in")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must hold lines of numbers, got none"),
        ("a,b\n", "a line for each touch, got names alone"),
        ("1,2\n3\n", "line 2 must have 2 cells like the first, got 1"),
        ("1,2\n3,x\n", "taxel 1, number 2 must be a number as others are, got 'x'"),
        ("a,b\n1,2\n3,oops\n", "b, number 3 must be a number as others are"),
        ("1,2\n3,inf\n", "must be a number .*got 'inf'"),
        ("1,-inf\n2,3\n", "must be a number .*got '-inf'"),
        ("a,a\n1,2\n", "first line of names that differ, got a, a"),
        ("object,session\ncup,a\n", "must have columns of taxels, got object"),
        ("object;a;n\ncup;1,5;2\n", "a must hold numbers with a decimal point"),
        ("1,5;2,5\n3,5;4,5\n", "must hold numbers with a decimal point"),
        ("1,5;;2,5\n3,5;;4,5\n", "must hold numbers with a decimal point"),
        ('"1,2\n3,4\n', "must be a CSV file of numbers in UTF-8"),
        ("mug,3,9,4\npen,3,8,4\n", "begin with a line of names, .* got mug, 3, 9, 4"),
        ("object;t0\n;kPa\nmug;1,5\nmug;2,5\n", "t0 must hold .* point, got '1,5'"),
        ("t0,t1,t2\n0x1F,2,3\n0x1E,2,4\n", "t0 must hold numbers as t2 does, got '0x"),
        ("ROWS\t4\nNOTES\n1,2\n", "or have lines before its table: take these out"),
        (
            "# by Jo\nobject,t0,t1\nmug,1,2\n",
            "line 2 must have 1 cells .* lines before",
        ),
    ],
)
def test_what_is_no_table_of_touches_is_refused(csv, text, message):
    with pytest.raises(TouchesError, match=message):
        Touches.load(csv(text))


def test_bytes_that_are_no_text_and_wrong_options_are_refused(csv, tmp_path):
    (tmp_path / "b.csv").write_bytes(b"1,2\n\xff\xfe\n")
    with pytest.raises(TouchesError, match="in UTF-8, got"):
        Touches.load(tmp_path / "b.csv")
    with pytest.raises(TouchesError, match=r"as the table, 4, got 2 x 3\. .* a, b"):
        Touches.load(csv(HEADED), shape=(2, 3))
    with pytest.raises(TouchesError, match=r"a file of \d+ bytes"):
        Touches.load(csv(HEADED), max_bytes=100)
    with pytest.raises(TouchesError, match="line 2, number 1 must be a number"):
        Touches.load(csv("1,2\nx,3\n", "in/cup/1.csv").parents[1])


def test_what_is_missing_to_be_images_is_named(tmp_path, images):
    h5py = pytest.importorskip("h5py")
    np.savez(tmp_path / "v.npz", X=np.eye(4), y=OBJECTS)
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file["X"] = np.eye(4)
    for name in ("v.npz", "v.h5"):
        with pytest.raises(TouchesError, match=r"For vectors, .* Touches\(X\["):
            Touches.load(tmp_path / name)
    with h5py.File(tmp_path / "g.h5", "w") as file:
        file["mug/frames"] = file["pen/frames"] = images
    with pytest.raises(TouchesError, match="Join those of all groups, and name the ob"):
        Touches.load(tmp_path / "g.h5")


def test_arrays_of_numpy_are_touches(tmp_path, rng):
    images = rng.normal(size=(4, 3, 2))
    np.save(tmp_path / "many.npy", images)
    np.save(tmp_path / "one.npy", images[0])
    assert_array_equal(Touches.load(tmp_path / "many.npy").images, images)
    assert_array_equal(Touches.load(tmp_path / "one.npy").images, images[:1])
    np.save(tmp_path / "forces.npy", np.stack([images] * 3, axis=-1))
    forces = Touches.load(tmp_path / "forces.npy", channels=("x", "y", "z"))
    assert (forces.images.shape, forces.channels) == ((4, 3, 2, 3), ("x", "y", "z"))
    np.savez(tmp_path / "plain.npz", X=images, y=[1, 1, 2, 2])
    touches = Touches.load(tmp_path / "plain.npz")
    assert_array_equal(touches.images, images)
    assert touches.object.tolist() == ["1", "1", "2", "2"]
    np.savez(tmp_path / "two.npz", X=images, Z=images)
    with pytest.raises(TouchesError, match=r"named images .* it holds X .*, Z"):
        Touches.load(tmp_path / "two.npz")
    np.save(tmp_path / "odd.npy", np.array([{}, None]), allow_pickle=True)
    with pytest.raises(TouchesError, match=r"an array that numpy\.save wrote"):
        Touches.load(tmp_path / "odd.npy")
    content = (tmp_path / "many.npy").read_bytes()
    (tmp_path / "cut.npy").write_bytes(content[:-8])
    with pytest.raises(TouchesError, match=r"an array that numpy\.save wrote"):
        Touches.load(tmp_path / "cut.npy")
    with pytest.raises(TouchesError, match="more than 100 bytes"):
        Touches.load(tmp_path / "many.npy", max_bytes=100)


def test_a_picture_is_one_touch(tmp_path, rng):
    deep = rng.integers(0, 2**16, (5, 4), dtype=np.uint16)
    Image.fromarray(deep).save(tmp_path / "deep.png")
    assert_array_equal(Touches.load(tmp_path / "deep.png").images, deep[None])
    rgb = rng.integers(0, 256, (5, 4, 3), dtype=np.uint8)
    Image.fromarray(rgb).save(tmp_path / "rgb.png")
    touches = Touches.load(tmp_path / "rgb.png", colour=True)
    assert_array_equal(touches.images, rgb[None])
    assert touches.channels == ("r", "g", "b")


def test_data_frames_become_touches_and_touches_data_frames(csv):
    pandas = pytest.importorskip("pandas")
    from_file = Touches.load(csv(HEADED), shape=(2, 2))
    frame = pandas.read_csv(csv(HEADED))
    touches = Touches.from_frame(frame, shape=(2, 2))
    assert_array_equal(touches.images, from_file.images)
    assert touches.object.tolist() == from_file.object.tolist()
    columns = touches.to_frame()
    assert columns["object"].tolist() == ["cup", "cup", "pen"]
    assert columns["position_mm_2"].tolist() == [3, 4, 5]
    assert len(columns) == 3
    with pytest.raises(TouchesError, match="must have columns of taxels"):
        Touches.from_frame(frame[["object"]])


def test_blanks_around_labels_of_others_are_none_of_them(tmp_path, images, put):
    """Else "mug " and "mug" were two objects."""
    labels = ["mug", "mug ", " mug", "my mug\u00a0"]
    h5py, pandas = pytest.importorskip("h5py"), pytest.importorskip("pandas")
    with h5py.File(tmp_path / "t.h5", "w") as file:
        file["images"], file["label"] = images, labels
    frame = pandas.DataFrame({"left": [1, 2, 3, 4], "object": labels})
    folder = Touches.load(put("mug /0.png", "mug /1.png", "mug /2.png", "my mug/3.png"))
    for touches in (Touches.load(tmp_path / "t.h5"), Touches.from_frame(frame), folder):
        assert touches.object.tolist() == ["mug"] * 3 + ["my mug"]


def test_what_a_data_frame_says_of_touches_is_no_taxel():
    """Its index was lost, and truth among numbers a taxel, as it is not in a CSV."""
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(
        {"left": [0.5, 0.25], "right": [1.5, 1.25], "valid": [True, False]},
        index=pandas.Index(["mug", "pen"], name="object"),
    )
    touches = Touches.from_frame(frame)
    assert touches.object.tolist() == ["mug", "pen"]
    assert touches.columns["valid"].tolist() == [True, False]
    assert touches.images.tolist() == [[[0.5, 1.5]], [[0.25, 1.25]]]
    switches = pandas.DataFrame({"left": [True, False], "right": [False, False]})
    assert Touches.from_frame(switches).images.tolist() == [
        [[True, False]],
        [[False, False]],
    ]


@pytest.mark.parametrize("name", ["object", "Object", "label", "category"])
def test_whole_numbers_of_a_data_frame_are_labels(name):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"t0": [0.5, 0.25], "t1": [1.0, 2.0], name: [1.0, 2.0]})
    columns = Touches.from_frame(frame).columns
    (labels,) = columns.values()
    assert labels.tolist() == ["1", "2"]


@pytest.mark.parametrize("names", [[0, 1, 0, 1], [0, 1, 2, "1"]])
def test_columns_of_one_name_in_a_data_frame_are_refused(names):
    """Of two pads side by side, touches would be of one pad, or lack a taxel."""
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(np.eye(4), columns=names)
    with pytest.raises(TouchesError, match="names that differ, got several called"):
        Touches.from_frame(frame)


@pytest.mark.parametrize("nothing", [None, float("nan")])
def test_texts_that_a_data_frame_lacks_are_empty(nothing):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"session": ["a", nothing], "t": [1.0, 2.0]})
    assert Touches.from_frame(frame).session.tolist() == ["a", ""]
    # Of a German export: whole numbers have no comma, and cells may be empty.
    commas = pandas.DataFrame(
        {"t0": ["0", "0,25", "1,5E-05", None], "t1": [1, 2, 3, 4]}
    )
    with pytest.raises(TouchesError, match="t0 must hold numbers with a decimal point"):
        Touches.from_frame(commas)
    # A cell that is no number makes texts of a whole column.
    for cells in (["1.5", "2", "ERR"], [1.5, 2, "ERR"]):
        odd = pandas.DataFrame({"a": cells, "b": [1.0, 2.0, 3.0]})
        with pytest.raises(TouchesError, match=r"a must hold numbers .* got 'ERR'"):
            Touches.from_frame(odd)
    frame["object"] = ["cup", nothing]
    with pytest.raises(TouchesError, match="empty label at touch 1"):
        Touches.from_frame(frame)
