"""Folders of pictures, some of which are not what they seem."""

import copy
import itertools
import os
import pickle
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from palpate import Touches
from palpate.touches import PictureCheck, TouchesError

from .conftest import first_levels


def test_endings_in_any_case_and_nothing_else(put):
    root = put("a/1.PNG", "a/2.jpg.png", "a/3.png", "a/.4.png", ".b/5.png")
    (root / "a" / "notes.txt").write_text("x")
    (root / "a" / "Thumbs.db").write_bytes(b"x")
    assert len(Touches.load(root)) == 3


def test_numbers_in_names_sort_by_value(put):
    names = ["a/img_10.png", "a/img_2.png", "A/img_1.png", "a/IMG_3.png", "a10/x.png"]
    names += ["a9/x.png", "a/img_02.png"]
    touches = Touches.load(put(*names))
    assert touches.columns["source_path"].tolist() == [
        "A/img_1.png", "a/img_02.png", "a/img_2.png", "a/IMG_3.png", "a/img_10.png",
        "a9/x.png", "a10/x.png",
    ]  # fmt: skip


def test_copies_keep_the_files_that_were_decoded(put):
    touches = Touches.load(put("cup/1.png", "cup/2.png"))
    for again in (copy.copy(touches), pickle.loads(pickle.dumps(touches))):
        assert again.files.tolist() == touches.files.tolist()


def test_no_contact_within_the_folder_is_no_touch(put, tmp_path):
    root = put("empty.png", "cup/1.png", "cup/2.png")
    link = tmp_path / "linked"
    link.symlink_to(root)
    for empty in (root / "empty.png", link / "empty.png", link / "cup/../empty.png"):
        touches = Touches.load(root, no_contact=empty)
        assert first_levels(touches) == [1, 2]
        assert_array_equal(touches.no_contact, np.zeros((4, 6)))


@pytest.mark.parametrize(
    ("name", "dtype"), [("empty.jpg", np.uint8), ("empty.png", np.uint16)]
)
def test_no_contact_from_elsewhere(put, tmp_path, name, dtype):
    empty = np.full((4, 6), 99, dtype)
    Image.fromarray(empty).save(tmp_path / name, quality=100)
    touches = Touches.load(put("a.png", dtype=dtype), no_contact=tmp_path / name)
    assert touches.images.dtype == touches.no_contact.dtype == dtype
    assert_array_equal(touches.no_contact, empty)
    touches.without("no_contact").save(tmp_path / "t.npz")
    again = Touches.load(tmp_path / "t.npz", no_contact=tmp_path / name)
    assert_array_equal(again.no_contact, empty)
    Touches(np.zeros((1, 4, 6))).save(tmp_path / "t.npz")
    with pytest.raises(TouchesError, match="must have the unit of the images"):
        Touches.load(tmp_path / "t.npz", no_contact=tmp_path / name)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (Image.new("L", (6, 5)), "must be 6 x 4 8-bit like the touches, got 6 x 5"),
        (Image.new("I;16", (6, 4)), "got 6 x 4 16-bit PNG"),
        (Image.new("RGBA", (6, 4)), "transparent parts"),
        (None, "empty.png must be readable, got: No such file"),
    ],
)
def test_a_no_contact_that_does_not_fit_is_refused(put, tmp_path, image, message):
    root = put("a.png")
    Touches.load(root).save(tmp_path / "t.npz")
    if image:
        image.save(tmp_path / "empty.png")
    for source in (root, tmp_path / "t.npz"):
        with pytest.raises(TouchesError, match=message):
            Touches.load(source, no_contact=tmp_path / "empty.png")


def test_missing_and_empty_folders(put, tmp_path):
    with pytest.raises(TouchesError, match="must be a folder of pictures, got none"):
        PictureCheck.of_folder(tmp_path / "missing")
    with pytest.raises(TouchesError, match=r"must hold pictures .* got no files"):
        Touches.load(put())
    root = put(".hidden.png")
    (root / "a.gif").write_bytes(b"x")
    (root / "b.npz").write_bytes(b"x")
    with pytest.raises(TouchesError, match=r"got 2 files of .gif, .npz.*one by one"):
        Touches.load(root)
    (root / "library.sqlite").write_bytes(b"x")
    with pytest.raises(TouchesError, match=r"library: TouchLibrary\.open\(path\)"):
        Touches.load(root)
    with pytest.raises(TouchesError, match=r"of .jpg, .jpeg, .png, .csv, .npy"):
        Touches.load(root / "a.gif")


def test_one_picture_is_one_touch(put):
    root = put("mug/1.png", "mug/2.png")
    alone = Touches.load(root / "mug" / "2.png")
    assert_array_equal(alone.images, Touches.load(root)[1:].images)
    assert alone.object is None
    named = Touches.load(root / "mug" / "2.png", name_pattern=r"(?P<order>\d+)")
    assert named.order.tolist() == [2]
    with pytest.raises(TouchesError, match="got nothing there"):
        Touches.load(root / "3.png")


def test_pictures_of_another_size_or_depth_are_named(put):
    root = put("a/1.png", "a/2.png", "a/3.png")
    Image.new("L", (6, 5)).save(root / "a" / "2.png")
    message = r"got 6 x 5 8-bit PNG in .*2.png \(2 of 3 are 6 x 4 8-bit PNG\)"
    with pytest.raises(TouchesError, match=message):
        Touches.load(root)
    Image.new("I;16", (6, 4)).save(root / "a" / "2.png")
    with pytest.raises(TouchesError, match="got 6 x 4 16-bit PNG"):
        Touches.load(root)
    with pytest.raises(TouchesError, match="Save it again with 8 bits"):
        Touches.load(root)


def test_jpeg_and_png_of_one_size_and_depth_stand_together(put):
    root = put("a/1.png", "a/2.png", "b/3.png", "b/4.png")
    for name, level in (("a/2", 90), ("b/4", 200)):
        (root / f"{name}.png").unlink()
        Image.new("L", (6, 4), level).save(root / f"{name}.jpg")
    touches = Touches.load(root)
    assert list(touches.columns["source_path"]) == [
        "a/1.png",
        "a/2.jpg",
        "b/3.png",
        "b/4.jpg",
    ]
    assert touches.images.shape == (4, 4, 6)
    for row, level in ((1, 90), (3, 200)):  # one level stays itself in a JPEG
        assert np.abs(touches.images[row].astype(int) - level).max() <= 1
    check = PictureCheck.of_folder(root)
    assert check.bad == []
    Image.new("L", (5, 4)).save(root / "a" / "2.jpg")
    with pytest.raises(TouchesError, match=r"got 5 x 4 8-bit JPEG .*Crop or pad it"):
        Touches.load(root)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "one size and depth"),
        ({"max_pixels": 23}, "6 x 4 .* at most 23 pixels.*trust"),
    ],
)
def test_no_picture_is_decoded_before_headers_suit(put, monkeypatch, options, message):
    root = put("a/1.png", "a/2.png")
    Image.new("L", (6, 5)).save(root / "a" / "2.png")
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    with pytest.raises(TouchesError, match=message):
        Touches.load(root, **options)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path, whole: path.write_bytes(b""), "got an empty file"),
        (lambda path, whole: path.write_bytes(b"hello"), "neither JPEG nor PNG"),
        (lambda path, whole: path.write_bytes(whole[:-30]), "a file that is cut short"),
        (lambda path, whole: path.symlink_to("missing"), "readable, got: No such"),
        (lambda path, whole: path.symlink_to(path), "readable, got: .*symbolic"),
        (lambda path, whole: os.mkfifo(path), "something that is not a file"),
    ],
    ids=["empty", "text", "cut", "link to nothing", "link to itself", "pipe"],
)
def test_a_file_among_many_that_is_no_picture_is_named(put, make, message):
    root = put(*[f"a/{i}.jpg" for i in range(30)])
    path = root / "a" / "17.jpg"
    whole = path.read_bytes()
    path.unlink()
    make(path, whole)
    with pytest.raises(TouchesError, match=f"17.jpg must be .*{message}"):
        Touches.load(root)


def test_a_wrong_ending_does_not_matter(put):
    root = put("a/1.png")
    (root / "a" / "1.png").rename(root / "a" / "1.jpg")
    assert first_levels(Touches.load(root)) == [0]


def test_the_memory_cap_comes_before_decoding(put):
    root = put("a.png", "b.png")
    assert len(Touches.load(root, max_bytes=48)) == 2
    with pytest.raises(TouchesError, match=r"must take at most 47 bytes, got 48"):
        Touches.load(root, max_bytes=47)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (None, r"a.png must be readable, got: No such"),
        (Image.new("1", (6, 5)), "changed meanwhile"),
        (Image.new("1", (8000, 8000)), "changed meanwhile"),
        (Image.new("I;16", (6, 4)), "changed meanwhile"),
    ],
    ids=["gone", "larger", "much larger", "deeper"],
)
def test_a_picture_that_changes_after_its_header_was_read(
    put, monkeypatch, image, message
):
    path = put("a.png") / "a.png"
    opened, times = Path.open, itertools.count()

    def changed_at_second(self, *args, **kwargs):
        if self == path and next(times) == 1:
            path.unlink() if image is None else image.save(path)
        return opened(self, *args, **kwargs)

    monkeypatch.setattr(Path, "open", changed_at_second)
    with pytest.raises(TouchesError, match=message):
        Touches.load(path.parent)


def test_links_that_lead_back_are_refused(put):
    root = put("a/1.png")
    (root / "a" / "again").symlink_to(root)
    with pytest.raises(TouchesError, match=r"must not lead back to .* Remove the link"):
        Touches.load(root)


def test_links_to_elsewhere_are_followed(put, tmp_path):
    (tmp_path / "other").mkdir()
    Image.new("L", (6, 4), 77).save(tmp_path / "other" / "1.png")
    root = put("a/1.png")
    (root / "b").symlink_to(tmp_path / "other")
    (root / "a" / "2.png").symlink_to(tmp_path / "other" / "1.png")
    assert first_levels(Touches.load(root)) == [0, 77, 77]


@pytest.mark.parametrize(
    ("owner", "call", "name"), [(Path, "open", "2.png"), (os, "scandir", "in")]
)
def test_an_unreadable_picture_or_folder_is_named(put, monkeypatch, owner, call, name):
    root = put("a/1.png", "a/2.png")
    normal = getattr(owner, call)

    def refused(path, *args, **kwargs):
        if Path(path).name == name:
            raise PermissionError(13, "Permission denied", str(path))
        return normal(path, *args, **kwargs)

    monkeypatch.setattr(owner, call, refused)
    with pytest.raises(TouchesError, match=f"{name} must be readable, got: Permission"):
        Touches.load(root)


def test_progress_goes_to_standard_error_when_it_takes_long(put, monkeypatch, capsys):
    root = put(*[f"a/{i}.png" for i in range(20)])
    Touches.load(root, progress=True)
    assert capsys.readouterr() == ("", "")
    clock = itertools.count(0, 10)
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    Touches.load(root, progress=False)
    assert capsys.readouterr() == ("", "")
    Touches.load(root, progress=True)
    out, err = capsys.readouterr()
    assert out == ""
    assert "Decoding pictures" in err
    assert "100%" in err


def test_decoding_does_not_depend_on_the_number_of_threads(put, monkeypatch):
    root = put(*[f"a/{i}.jpg" for i in range(40)])
    many = Touches.load(root)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    assert_array_equal(Touches.load(root).images, many.images)
    assert first_levels(many) == list(range(40))


BATHTIP = (
    r"touch_\d+_img_(?P<n>\d+)_name_(?P<object>(?P<category>[a-z]+)_.+)"
    r"_at_(?P<x>-?\d+)_(?P<y>-?\d+)_(?P<z>-?\d+)"
)


@pytest.mark.realdata
@pytest.mark.slow
def test_real_originals_load_with_their_labels(data_folder):
    bathtip = data_folder / "bathtip"
    originals = bathtip / "originals"
    touches = Touches.load(
        originals,
        name_pattern=BATHTIP,
        no_contact=originals / "baselineForCalibration.jpg",
    )
    assert touches.images.shape == (772, 480, 640)
    assert len(set(touches.category)) == len(set(touches.object)) == 10
    small = Touches.load(bathtip / "bathtip50.npz")
    row_of = {path: row for row, path in enumerate(small.columns["source_path"])}
    same = small[[row_of[path] for path in touches.columns["source_path"]]]
    assert_array_equal(same.object, touches.object)
    assert_array_equal(same.columns["position_raw"], touches.columns["position_raw"])
    for image, original in (
        (same.images, touches.images),
        (same.no_contact[np.newaxis], touches.no_contact[np.newaxis]),
    ):
        square = original[:, :, :480].reshape(-1, 120, 4, 120, 4)
        # The archive rounds the mean of 4 x 4 pixels to a whole grey level.
        assert_allclose(square.mean(axis=(2, 4)), image, atol=0.5)


@pytest.mark.parametrize("ending", [".csv", ".npy", ".tif"])
def test_more_files_of_another_kind_are_told(tmp_path, ending, rng):
    """One picture beside eight touches in files of their own, as a preview of them."""
    for n in range(8):
        levels, file = rng.random((4, 4)).astype(np.float32), tmp_path / f"{n}{ending}"
        if ending == ".npy":
            np.save(file, levels)
        elif ending == ".csv":
            np.savetxt(file, levels, delimiter=",")
        else:
            Image.fromarray(levels).save(file)
    assert len(Touches.load(tmp_path)) == 8
    Image.fromarray(np.eye(4, dtype=np.uint8)).save(tmp_path / "preview.png")
    message = f"has 1 of .png, which are read, and 8 of {ending}, which are left alone"
    with pytest.warns(UserWarning, match=re.escape(message)):
        assert len(Touches.load(tmp_path)) == 1
