"""Touch archives come back to the bit, and are written whole or not at all."""

import signal
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.touches import TouchesError

from .conftest import assert_same

NAME = st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1)
PRINTED = st.characters(codec="utf-8", exclude_categories=("Cc", "Zl", "Zp"))
LABEL = st.text(PRINTED, min_size=1).map(lambda text: text + ".")
PLAIN = st.one_of(
    hnp.boolean_dtypes(),
    hnp.integer_dtypes(),
    hnp.unsigned_integer_dtypes(),
    hnp.floating_dtypes(),
    hnp.complex_number_dtypes(),
    hnp.unicode_string_dtypes(),
    hnp.byte_string_dtypes(),
    hnp.datetime64_dtypes(),
)
IMAGES = st.one_of(
    hnp.integer_dtypes(), hnp.unsigned_integer_dtypes(), hnp.floating_dtypes()
)


def any_array(draw, dtype, shape):
    """Draw bytes, not values, so that NaN payloads are drawn as well."""
    if dtype.kind in "UMb":
        return draw(hnp.arrays(dtype, shape))
    size = int(np.prod(shape)) * dtype.itemsize
    raw = draw(st.binary(min_size=size, max_size=size))
    return np.frombuffer(raw, dtype).reshape(shape)


@st.composite
def sets_of_touches(draw):
    n, n_rows, n_cols = (draw(st.integers(1, 4)) for _ in range(3))
    images = any_array(draw, draw(IMAGES), (n, n_rows, n_cols))
    if images.dtype.kind == "f":
        images = np.where(np.isinf(images), images.dtype.type(1), images)
    names = draw(st.lists(NAME.map("x{}.".format), max_size=3, unique=True))
    columns = {}
    for name in names:
        tail = draw(st.lists(st.integers(0, 3), max_size=2))
        rows = draw(st.integers(0, 5))
        columns[name] = any_array(draw, draw(PLAIN), (rows, *tail))
    if draw(st.booleans()):
        columns["object"] = draw(st.lists(LABEL, min_size=n, max_size=n))
    return Touches(images, **columns)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("archives") / "touches.npz"


@settings(max_examples=80, deadline=None)
@given(touches=sets_of_touches(), data=st.data())
def test_round_trip_to_the_bit(touches, data, scratch):
    touches.save(scratch)
    assert_same(Touches.load(scratch), touches)
    n_kept = data.draw(st.integers(1, len(touches)))
    touches[:n_kept].save(scratch)
    assert_same(Touches.load(scratch), touches[:n_kept])


def test_numpy_reads_what_is_written_and_the_other_way_round(tmp_path, rng):
    arrays = {
        "images": np.asfortranarray(rng.normal(size=(4, 3, 2))),
        "object": np.array(["a", "b", "b", "é"]),
        "force_n": rng.normal(size=(4, 3)).astype(">f4"),
        "geometry": np.array("array"),
        "no_contact": rng.normal(size=(3, 2)).T.copy().T,
        "frame_index": np.arange(4),
    }
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "numpy.npz", **arrays)
        touches = Touches.load(tmp_path / "numpy.npz")
        touches.save(tmp_path / "ours.npz")
        with np.load(tmp_path / "ours.npz") as again:
            for name, array in arrays.items():
                assert again[name].dtype == array.dtype
                assert_array_equal(again[name], array)
    assert list(touches.columns) == ["object", "force_n"]
    assert touches.geometry == "array"


def test_path_like_names_are_just_names(tmp_path):
    names = {"../../evil": [1, 2], "/etc/passwd": [3, 4], "a/b.npy": [5, 6]}
    Touches(np.zeros((2, 2, 2)), **names).save(tmp_path / "in" / ".." / "t.npz")
    assert set(Touches.load(tmp_path / "t.npz").columns) == set(names)
    assert [p.name for p in tmp_path.iterdir()] == ["t.npz"]


def test_equal_touches_give_equal_files_of_one_date_that_all_may_read(tmp_path):
    for name in ("a.npz", "b.npz"):
        Touches(np.zeros((2, 2, 2)), object=["a", "b"]).save(tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        for member in archive.infolist():
            assert member.external_attr >> 16 == 0o644
            assert member.date_time == (1980, 1, 1, 0, 0, 0)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("touches.npy", r"must have a name that ends in .npz.*touches.npy.npz"),
        ("touches", "must have a name that ends in .npz"),
        ("missing/touches.npz", "No such file or directory. Check that its folder"),
        ("folder.npz", "Is a directory"),
    ],
)
def test_bad_targets_are_refused(tmp_path, name, message):
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(TouchesError, match=message):
        Touches(np.zeros((1, 2, 2))).save(tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.npz"]


@pytest.mark.parametrize("name", ["a\0b", "a" * 40_000, "\ud800"])
def test_names_that_a_zip_would_change_are_refused(tmp_path, name):
    touches = Touches(np.zeros((2, 2, 2)), **{name: [1, 2]})
    with pytest.raises(TouchesError, match="Rename that column"):
        touches.save(tmp_path / "t.npz")
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_the_old_archive(tmp_path, monkeypatch):
    old = Touches(np.zeros((2, 2, 2)), object=["old", "old"])
    old.save(tmp_path / "t.npz")

    def fails(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numpy.lib.format.write_array", fails)
    with pytest.raises(TouchesError, match=r"t.npz must be .* No space left"):
        Touches(np.ones((2, 2, 2))).save(tmp_path / "t.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["t.npz"]
    assert_same(Touches.load(tmp_path / "t.npz"), old)


def test_a_kill_in_mid_write_leaves_the_old_archive(tmp_path):
    old = Touches(np.zeros((2, 2, 2)))
    old.save(tmp_path / "t.npz")
    code = (
        "import sys, numpy as np; from palpate import Touches\n"
        "r = np.random.default_rng(0).integers(0, 256, (900, 300, 300), np.uint8)\n"
        "Touches(r).save(sys.argv[1])"
    )
    writer = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "t.npz")])
    while not list(tmp_path.glob(".partial-*")) and writer.poll() is None:
        time.sleep(0.001)
    writer.kill()
    assert writer.wait() == -signal.SIGKILL
    assert_same(Touches.load(tmp_path / "t.npz"), old)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "shape", "n_objects", "columns"),
    [
        ("bathtip/bathtip50", (3953, 120, 120), 50, {"position_raw", "source_path"}),
        ("taxel10x10/taxel10x10", (324, 10, 10), 17, {"press", "frames"}),
        ("tactip4/tactip4", (800, 300, 300), 4, {"frame"}),
    ],
)
def test_real_archives_load(data_folder, name, shape, n_objects, columns):
    touches = Touches.load(data_folder / f"{name}.npz")
    assert touches.images.shape == shape
    assert len(touches.episodes()) == n_objects
    assert columns <= set(touches.columns)
