"""Archives, Parquet and datasets of a library are read back to the bit."""

import json
from contextlib import ExitStack

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from palpate import Touches
from palpate.library import LibraryError, SensorDescription, TouchLibrary
from palpate.touches import ParquetTouches, TouchesError, png_bytes, read_parquet

from .conftest import assert_alike

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")


@pytest.fixture
def filled(library, seven):
    library.add(seven)
    return library


def test_an_archive_of_touches_with_several_frames_of_no_contact_says_so(
    library, tmp_path
):
    for level in (0.0, 1.0):
        rest = np.full((5, 6), level)
        library.add(_presses(1).with_columns(no_contact=rest), session=level)
    with pytest.warns(UserWarning, match="Choose those of one session .* or write"):
        library.export(tmp_path / "t.npz")
    library.export(tmp_path / "one.npz", "session = 1")
    assert_array_equal(Touches.load(tmp_path / "one.npz").no_contact, rest)
    library.export(tmp_path / "t.parquet")
    parts = read_parquet(tmp_path / "t.parquet")
    assert [part.no_contact[0, 0] for part in parts] == [0, 1]


def test_an_archive_holds_the_same_touches(filled, tmp_path):
    assert filled.export(tmp_path / "t.npz", "object = pen") == 4
    again = Touches.load(tmp_path / "t.npz")
    assert_alike(again, filled.touches("object = pen"))
    with TouchLibrary.open(tmp_path / "other", create=True) as other:
        other.add(again)
        kept = {row.id for row in filled.list("object = pen")}
        assert {row.id for row in other.list()} == kept


def test_a_parquet_file_holds_the_same_touches(filled, tmp_path, rng):
    """A row group holds 128 touches."""
    seven = filled.touches()
    more = seven[np.arange(1200) % 7].with_columns(time_s=np.arange(200.0, 1400))
    filled.add(more)
    assert filled.export(tmp_path / "t.parquet") == 1207
    file = pq.ParquetFile(tmp_path / "t.parquet")
    assert file.num_row_groups == 10  # of 1207 touches
    table = file.read()
    expected = filled.touches()
    images = table["image"].combine_chunks().to_numpy_ndarray()
    assert_array_equal(images, expected.images)
    assert table["object"].to_pylist() == expected.object.tolist()
    assert_allclose(table["position_mm"].to_pylist(), expected.columns["position_mm"])
    assert_alike(Touches.load(tmp_path / "t.parquet"), expected)
    metadata = json.loads(table.schema.metadata[b"palpate"])
    assert metadata["dtypes"]["image"] == "<f4"
    assert metadata["recordings"][0]["whole"]["no_contact"]["shape"] == [3, 4]
    assert not list(tmp_path.glob(".*partial"))


@pytest.mark.parametrize("name", ["t.npz", "t.parquet", "robot"])
def test_exports_agree_on_touches_without_a_label(filled, tmp_path, rng, name):
    """Without any label there is no column; labels of only some are refused."""
    bare = filled.touches()[np.arange(140) % 7].without("object")
    filled.add(bare.with_columns(session=["c"] * 140, time_s=np.arange(140.0)))
    with pytest.raises(LibraryError, match="all touches must have an object or none"):
        filled.export(tmp_path / name)
    assert not (tmp_path / name).exists()
    assert filled.export(tmp_path / name, "object is null") == 140
    if name != "robot":  # of one without labels see test_lerobot_contents.py
        assert_alike(Touches.load(tmp_path / name), filled.touches("object is null"))


def test_columns_of_some_episodes_are_columns_of_all(filled, tmp_path):
    """An episode without forces has NaN beside episodes with them."""
    cups = filled.touches("object = cup")
    filled.add(cups.without("force_n", "time_s").with_columns(session=["d"] * 3))
    assert filled.export(tmp_path / "robot") == 10
    frames = pq.read_table(tmp_path / "robot/data").to_pydict()
    assert np.isnan(frames["observation.force_n"]).sum() == 3
    unknown = np.isnan(frames["time_s"])
    assert np.array(frames["timestamp"])[unknown].tolist() == [0, 1, 2]


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("by", [None, "object", "session"])
def test_columns_of_some_row_groups_are_columns_of_all(library, tmp_path, order, by):
    """A category is one of none; frames and times that some lack are not known."""
    n, rng = 140, np.random.default_rng(0)
    images = rng.integers(0, 255, (2 * n, 4, 5), dtype=np.uint8)
    frames = rng.integers(0, 255, (n, 2, 4, 5), dtype=np.uint8)
    days = np.full(n, np.datetime64("2024-01-01"))
    first = Touches(
        images[:n],
        object=["a"] * n,
        category=["k"] * n,
        press_frames=frames,
        day=days,
        turn=np.arange(n),
        note=["x"] * n,
    )
    others = Touches(images[n:], object=["b"] * n)
    for touches, session in list(zip([first, others], "ab", strict=True))[::order]:
        library.add(touches, session=session)
    assert library.export(tmp_path / "t.parquet", by=by) == 2 * n
    read = Touches.load(tmp_path / "t.parquet")
    first = np.argsort(library.touches().object, kind="stable")
    assert_alike(read, library.touches() if by is None else library.touches()[first])
    assert "category" not in read.columns
    assert_array_equal(read[read.object == "a"].columns["press_frames"], frames)
    assert np.isnan(read[read.object == "b"].columns["press_frames"]).all()


def test_a_failed_export_leaves_nothing_and_can_be_tried_again(filled, tmp_path, alter):
    move = "UPDATE images SET number = {} WHERE number = {}"
    alter(filled.folder, *(move.format(*n) for n in ((0, 7), (7, 6), (6, 0))))
    (tmp_path / "empty").mkdir()
    before = sorted(tmp_path.rglob("*"))
    for name in ("robot", "empty", "t.parquet", "t.npz"):
        for _ in range(2):
            with pytest.raises(LibraryError, match="altered"):
                filled.export(tmp_path / name)
    assert sorted(tmp_path.rglob("*")) == before
    alter(filled.folder, *(move.format(*n) for n in ((0, 7), (7, 6), (6, 0))))
    assert filled.export(tmp_path / "robot") == filled.export(tmp_path / "empty") == 7
    for name, match in (("robot", "empty folder, got files"), ("t.csv", "got 't.csv'")):
        with pytest.raises(LibraryError, match=match):
            filled.export(tmp_path / name)
    assert (tmp_path / "empty/meta/info.json").is_file()
    assert not any(p.stat().st_size for p in tmp_path.rglob(".partial*"))


@pytest.mark.parametrize("name", ["t.npz", "t.parquet", "robot"])
def test_places_that_take_no_export_are_refused(filled, tmp_path, name):
    with pytest.raises(
        LibraryError, match=f"that exists, got '.*nodir/{name}'. Make .*nodir' first"
    ):
        filled.export(tmp_path / "nodir" / name)
    target = tmp_path / name
    target.mkdir() if "." in name else target.write_bytes(b"mine")
    (target / "mine" if "." in name else tmp_path / "x").write_bytes(b"mine")
    match = "must be a place with room" if "." in name else "empty folder, got a file"
    with pytest.raises(LibraryError, match=match):
        filled.export(target)
    assert not any(p.stat().st_size for p in tmp_path.rglob(".partial*"))
    assert (target / "mine" if "." in name else target).read_bytes() == b"mine"


def _presses(seed, n_touches=6, dtype=np.uint8, **more):
    rng = np.random.default_rng(seed)
    return Touches(
        rng.integers(0, 255, (n_touches, 5, 6)).astype(dtype),
        object=rng.choice(["mug", "a/b=c", "pen"], n_touches),
        force_n=np.where(rng.random(n_touches) < 0.3, np.nan, 1.5),
        order=np.arange(n_touches),
        position_mm=rng.normal(size=(n_touches, 3)),
        **more,
    )


def _ids(library):
    return {row.id for row in library.list(limit=None)}


@pytest.fixture
def travelled():
    """Return how a library is exported as Parquet and read into another one.

    That has its ids; returned are the other one, and the parts that it was read in.
    """
    with ExitStack() as opened:

        def travel(library, path, by=None):
            assert library.export(path, by=by) == len(library)
            parts = list(read_parquet(path))
            again = library.folder.with_name("again")
            other = opened.enter_context(TouchLibrary.open(again, create=True))
            for part in parts:
                other.add(part)
            assert _ids(other) == _ids(library)
            return other, parts

        yield travel


@pytest.mark.parametrize("dtype", ["u1", "<i2", ">f4", "<f8", "<u8"])
@pytest.mark.parametrize("by", [None, "object", "session"])
def test_touches_come_back_with_their_ids(library, tmp_path, dtype, by, travelled):
    pad = SensorDescription("pad", "array", "kPa", 4.0, "array")
    for day in ("monday", "007"):  # sessions stay texts
        baseline = np.full((5, 6), len(day)).astype(dtype)
        touches = _presses(len(day), dtype=dtype, no_contact=baseline)
        library.add(touches, session=day, sensor=pad)
    path = tmp_path / "some.parquet"
    again, parts = travelled(library, path, by)
    with again:
        assert again.check().ok
        for day in ("monday", "007"):  # each session has its own baseline
            assert_array_equal(again.no_contact(day), np.full((5, 6), len(day)))
        if by is None:
            with pytest.warns(UserWarning, match="one frame of no contact, got sev"):
                held = Touches.load(path)
            assert again.add(held) == [r.id for r in library.list()]
            assert len(again) == 12
    assert sum(map(len, parts)) == 12
    assert all(part.geometry == "array" for part in parts)


@pytest.mark.parametrize("by", ["session", "episode"])
def test_touches_without_a_number_are_a_part_of_their_own(
    library, tmp_path, by, travelled
):
    library.add(_presses(1, **{by: [1, 2, 1, 2, 1, 2]}))
    library.add(_presses(2))
    again, parts = travelled(library, tmp_path / "t.parquet", by)
    folders = {path.name for path in (tmp_path / "t.parquet").iterdir()}
    assert folders == {f"{by}=", f"{by}=1.0", f"{by}=2.0"}
    assert all(part.columns[by].dtype.kind == "f" for part in parts)
    source = ParquetTouches(tmp_path / "t.parquet")
    assert_array_equal(source.columns[by], again.touches().columns[by])


def test_numbers_that_a_path_carries_stay_numbers(library, tmp_path, travelled):
    library.add(_presses(1, session=np.array([1, 12, 1, 12, 1, 12], np.int16)))
    _, parts = travelled(library, tmp_path / "t.parquet", "session")
    assert [part.session.dtype for part in parts] == [np.int16] * 2


def test_names_of_pads_that_differ_are_left_out_with_them(library, tmp_path):
    (tmp_path / "set").mkdir()
    for name, pads in (("a", [[0, 0, 5, 3]]), ("b", [[0, 3, 5, 3]])):
        touches = _presses(1).with_columns(pads=pads, pad_names=["left"])
        library.add(touches, session=name)
        library.export(tmp_path / "set" / f"{name}.parquet", f"session = {name}")
    read, source = Touches.load(tmp_path / "set"), ParquetTouches(tmp_path / "set")
    assert len(read) == len(source.touches(range(12))) == 12
    assert read.pads is read.pad_names is None
    assert not {"pads", "pad_names"} & {*source.whole}


def test_a_baseline_with_a_dead_taxel_describes_several_recordings(library, tmp_path):
    baseline = np.full((5, 6), np.nan)
    for day in ("monday", "tuesday"):
        touches = _presses(len(day), dtype="f8", no_contact=baseline, set_day=day)
        library.add(touches, session=day)
    library.export(tmp_path / "t.parquet")
    for read in (Touches.load, ParquetTouches):
        assert {*read(tmp_path / "t.parquet").whole} == {"no_contact"}


def test_what_describes_all_is_no_column_of_as_many_touches(library, tmp_path):
    """The last rows of Parquet read at once are as many as the thresholds."""
    thresholds = [1.0, 2.0, 3.0]
    touches = _presses(1, 515, set_gain=2.0, thresholds=thresholds)
    library.add(touches.with_columns(object=["mug"] * 512 + ["pen"] * 3))
    library.export(tmp_path / "t.parquet")
    source = ParquetTouches(tmp_path / "t.parquet")
    read = [
        Touches.load(tmp_path / "t.parquet"),
        *read_parquet(tmp_path / "t.parquet"),
        source.touches([512, 513, 514]),
        source.resting_at(np.ones((5, 6))).touches([0, 1, 2]),
        library.touches("object = pen"),
    ]
    for held in read:
        assert_array_equal(held.whole["thresholds"], thresholds)


def test_pictures_travel_as_their_own_files(library, tmp_path, travelled):
    folder = tmp_path / "in" / "cup"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for number in range(3):
        levels = rng.integers(0, 255, (60, 80, 3), dtype=np.uint8)
        Image.fromarray(levels).save(folder / f"{number}.jpg", quality=80)
    library.add(Touches.load(tmp_path / "in", colour=True))
    again, _ = travelled(library, tmp_path / "some.parquet")
    kept = [
        row["bytes"]
        for row in pq.read_table(tmp_path / "some.parquet")["image"].to_pylist()
    ]
    assert kept == [path.read_bytes() for path in sorted(folder.iterdir())]
    assert again.select().files() == kept


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("order", [1, -1])
def test_pictures_travel_beside_arrays_of_their_size(
    library, tmp_path, dtype, order, travelled
):
    """Small ones, of which 128 are a row group; one has both."""
    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (300, 6, 7)).astype(dtype)
    (tmp_path / "in" / "pen").mkdir(parents=True)
    for number, image in enumerate(images[:140]):
        Image.fromarray(image).save(tmp_path / "in" / "pen" / f"{number}.png")
    pictures = Touches.load(tmp_path / "in").without("source_path")
    sets = [pictures, Touches(images[140:], object=["cup"] * 160)]
    for touches in sets[::order]:
        library.add(touches)
    _, parts = travelled(library, tmp_path / "t.parquet")
    assert_alike(Touches.load(tmp_path / "t.parquet"), library.touches())
    files = {bytes(file) for part in parts for file in part.files}
    assert files >= {bytes(file) for file in pictures.files}


def test_bytes_travel_with_the_zeros_in_them(library, tmp_path):
    """A digest of each touch, say."""
    digests = np.array([b"a\0b", b"\0\1\2", b"", b"xyz", b"\1", b"\0\0\3"])
    library.add(_presses(1, digest=digests))
    library.export(tmp_path / "t.parquet")
    read = Touches.load(tmp_path / "t.parquet").columns["digest"]
    assert read.dtype == digests.dtype
    assert_array_equal(read, digests)


@pytest.mark.parametrize("shape", [(2, 4, 5), (2, 4, 5, 2)])
def test_images_of_true_and_false_travel(library, tmp_path, shape, travelled):
    images = np.arange(np.prod(shape)).reshape(shape) % 3 == 0
    channels = {"channels": ["x", "y"]} if len(shape) == 4 else {}
    library.add(Touches(images, object=["a", "b"], **channels))
    _, [part] = travelled(library, tmp_path / "t.parquet")
    assert part.images.dtype == np.bool_
    assert_array_equal(part.images, images)


def test_other_programs_show_camera_images_as_pictures(library, tmp_path):
    """`datasets` of Hugging Face takes the feature Image from this metadata."""
    images = np.random.default_rng(0).integers(0, 255, (2, 60, 80), dtype=np.uint8)
    library.add(Touches(images, object=["mug", "pen"], order=[1, 2]))
    library.export(tmp_path / "some.parquet")
    schema = pq.read_schema(tmp_path / "some.parquet")
    features = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
    assert features["image"] == {"_type": "Image"}
    assert features["object"] == {"dtype": "string", "_type": "Value"}
    assert set(features) == set(schema.names)
    (tmp_path / "rest.png").write_bytes(png_bytes(images[0]))
    options = {"no_contact": tmp_path / "rest.png", "max_pixels": 60 * 80}
    again = Touches.load(tmp_path / "some.parquet", **options)  # PNG loses nothing
    assert_array_equal(again.images, images)
    assert_array_equal(again.no_contact, images[0])
    with pytest.raises(TouchesError, match=r"80 x 60 .* at most 4799 pixels"):
        Touches.load(tmp_path / "some.parquet", max_pixels=60 * 80 - 1)


@pytest.mark.parametrize("by", [None, "object"])
def test_a_store_that_fsspec_knows_serves(library, tmp_path, by, travelled):
    pytest.importorskip("fsspec")
    library.add(_presses(1))
    url = f"memory://bucket/{by}/some.parquet"
    travelled(library, url, by)
    assert len(Touches.load(url)) == 6
    if by is not None:  # else what was there would stay beside
        with pytest.raises(LibraryError, match="must be a new or empty folder, got "):
            library.export(url, by=by)
    library.export(f"file://{tmp_path}/{by}.parquet", by=by)
    assert len(Touches.load(tmp_path / f"{by}.parquet")) == 6
    with pytest.raises(TouchesError, match="fsspec can open"):
        list(read_parquet("nosuchscheme://bucket/some.parquet"))
    with pytest.raises(LibraryError, match=r"address of a store in \.parquet"):
        library.export("memory://bucket/some.npz")


def test_many_touches_are_read_some_at_a_time(library, tmp_path):
    library.add(_presses(3, 2000))
    library.export(tmp_path / "some.parquet")
    parts = list(read_parquet(tmp_path / "some.parquet"))
    assert max(map(len, parts)) <= 512
    assert sum(map(len, parts)) == 2000
    with pytest.raises(TouchesError, match="keep it in a library"):
        Touches.load(tmp_path / "some.parquet", max_bytes=50_000)


def test_what_takes_little_in_a_file_is_not_much_in_memory_at_once(tmp_path):
    path = tmp_path / "some.parquet"
    flat = pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(9_000_000)), 900_000)
    kind = pa.fixed_shape_tensor(pa.float64(), (900, 1000))
    table = pa.table({"image": pa.ExtensionArray.from_storage(kind, flat)})
    _written(path, table)
    assert path.stat().st_size < 10_000
    assert max(part.images.nbytes for part in read_parquet(path)) <= 2**26
    with pytest.raises(TouchesError, match="at most 1000000 bytes, got 7200000"):
        list(read_parquet(path, max_bytes=1_000_000))
    blank = png_bytes(np.zeros((1000, 1000), np.uint8))
    _written(path, pa.table({"image": [blank, blank]}))
    with pytest.raises(TouchesError, match="must take at most 1500000 bytes"):
        list(read_parquet(path, max_bytes=1_500_000))


def test_metadata_as_deep_as_can_be_are_refused(tmp_path):
    table = pa.table({"image": np.zeros((2, 3, 4)).tolist()})
    _written(tmp_path / "t.parquet", table.replace_schema_metadata({"palpate": DEEP}))
    with pytest.raises(TouchesError, match="must say of itself in JSON"):
        Touches.load(tmp_path / "t.parquet")


def _in_folders(path, table, column, *names):
    """Write a table once for each name, in folders as other programs make them."""
    for name in names:
        place = path / "set.parquet" / f"{column}={name}"
        place.mkdir(parents=True)
        pq.write_table(table, place / "0.parquet")
    return path / "set.parquet"


def test_what_another_program_wrote_is_read(tmp_path):
    """The files hold nested lists in folders by object, and no metadata of palpate."""
    images = np.arange(24.0).reshape(2, 3, 4)
    table = pa.table({"image": images.tolist(), "force_n": [0.5, None]})
    touches = Touches.load(_in_folders(tmp_path, table, "object", "mug", "pen"))
    assert touches.object.tolist() == ["mug", "mug", "pen", "pen"]
    assert_array_equal(touches.images, np.concatenate([images, images]))
    assert_array_equal(touches.columns["force_n"], [0.5, np.nan, 0.5, np.nan])


def test_folders_of_what_lacks_have_no_session(tmp_path):
    table = pa.table({"image": np.ones((2, 3, 4)).tolist()})
    names = "monday", "__HIVE_DEFAULT_PARTITION__"
    touches = Touches.load(_in_folders(tmp_path, table, "session", *names))
    assert touches.session.tolist() == ["", "", "monday", "monday"]


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_lists_of_another_program_keep_their_type(tmp_path, dtype):
    """As pandas and polars write arrays; a number that lacks is NaN."""
    images = np.arange(24).reshape(2, 3, 4).astype(dtype)
    lists = pa.array(images.tolist(), pa.list_(pa.list_(pa.from_numpy_dtype(dtype))))
    places = [[1.0, 2.0, None], [4.0, 5.0, 6.0]]
    pq.write_table(pa.table({"image": lists, "position_mm": places}), tmp_path / "t.pq")
    touches = Touches.load(tmp_path / "t.pq")
    assert touches.images.dtype == dtype
    assert_array_equal(touches.images, images)
    assert_array_equal(touches.columns["position_mm"], np.array(places, float))


def test_a_truth_that_a_late_row_lacks_is_a_number(tmp_path):
    valid = [True] * 599 + [None]
    table = pa.table({"image": np.ones((600, 2, 3)).tolist(), "valid": valid})
    pq.write_table(table, tmp_path / "t.pq")
    for column in (
        Touches.load(tmp_path / "t.pq").columns["valid"],
        ParquetTouches(tmp_path / "t.pq").columns["valid"],
    ):
        assert_array_equal(column, [1.0] * 599 + [np.nan])


def test_channels_of_a_former_name_are_those_of_pictures(library, tmp_path):
    images = np.zeros((2, 64, 64, 3), np.uint8)
    former = {"set_channels": np.array(["r", "g", "b"])}
    library.add(Touches._of(images, {"object": np.array(["mug", "pen"])}, former))
    library.export(tmp_path / "t.parquet")
    touches = Touches.load(tmp_path / "t.parquet")
    assert touches.images.shape == images.shape
    assert touches.channels == ("r", "g", "b")


@pytest.mark.parametrize("values", [["x", "y"], [7, 8], [0.5, None]])
def test_a_recording_of_another_program_is_a_column(tmp_path, values):
    table = pa.table({"image": np.ones((2, 3, 4)).tolist(), "recording": values})
    pq.write_table(table, tmp_path / "some.parquet")
    expected = [np.nan if value is None else value for value in values]
    for read in (Touches.load, ParquetTouches):
        columns = read(tmp_path / "some.parquet").columns
        assert_array_equal(columns["recording"], expected)


@pytest.mark.parametrize("name", ["image", "recording"])
def test_a_column_of_a_name_that_parquet_has_is_refused(library, tmp_path, name):
    library.add(_presses(1, **{name: np.arange(6)}))
    with pytest.raises(TouchesError, match=f"must not be called {name}"):
        library.export(tmp_path / "some.parquet")
    assert not (tmp_path / "some.parquet").exists()
    assert library.export(tmp_path / "some.npz") == 6


def test_files_of_format_1_are_read(tmp_path):
    """Format 1 has a flat list for each touch, and its sides in the metadata."""
    images = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
    flat = pa.FixedSizeListArray.from_arrays(pa.array(images.ravel()), 12)
    metadata = {"format": 1, "n_rows": 3, "n_cols": 4, "dtype": "<i2", "whole": {}}
    table = pa.table({"image": flat}).replace_schema_metadata(
        {"palpate": json.dumps(metadata)}
    )
    pq.write_table(table, tmp_path / "old.parquet")
    assert_array_equal(Touches.load(tmp_path / "old.parquet").images, images)


DEEP = "[" * 100_000


def _written(path, table, **metadata):
    if metadata:
        table = table.replace_schema_metadata({"palpate": json.dumps(metadata)})
    pq.write_table(table, path)


TENSOR = {"image": np.zeros((2, 3, 4)).tolist()}


@pytest.mark.parametrize(
    ("columns", "metadata", "match"),
    [
        ({"image": [1.0, 2.0]}, {}, "images of rows and columns of numbers"),
        ({"image": ["a", "b"]}, {}, "images of rows and columns of numbers"),
        ({"image": [[[1.0]], [[1.0, 2.0]]]}, {}, "lists of unequal length"),
        ({"image": [b"no picture", b""]}, {}, "must be a whole JPEG or PNG"),
        ({"image": [b"no picture", None]}, {}, "hold every picture itself"),
        (
            {**TENSOR, "odd": [{"a": 1}, {"a": 2}]},
            {},
            "numbers or text in column 'odd'",
        ),
        ({**TENSOR, "force_n": ["x", "y"]}, {}, "force_n must"),
        (TENSOR, {"format": 9}, "Parquet format 2 or older"),
        (TENSOR, {"format": 2, "recordings": [{}]}, "of itself .* got: KeyError"),
        (TENSOR, {"format": 2, "recordings": [{"whole": "x"}]}, "must say of itself"),
        (TENSOR, {"format": float("nan")}, "must say of itself"),
        (TENSOR, {"format": 2, "dtypes": ["<f8"]}, "must say of itself"),
        (
            {**TENSOR, "recording": [0, 7]},
            {"format": 2, "recordings": [{"whole": {}}]},
            "recording 7",
        ),
    ],
)
def test_what_is_not_touches_is_refused_in_one_sentence(
    tmp_path, columns, metadata, match
):
    _written(tmp_path / "odd.parquet", pa.table(columns), **metadata)
    with pytest.raises(TouchesError, match=match):
        Touches.load(tmp_path / "odd.parquet")


@pytest.mark.parametrize("name", ["image", "force_n"])
def test_two_columns_of_one_name_are_refused(tmp_path, name):
    columns = {"image": [[[1.0]]], "force_n": [1.0]}
    arrays = [pa.array(column) for column in (*columns.values(), columns[name])]
    table = pa.Table.from_arrays(arrays, names=[*columns, name])
    _written(tmp_path / "odd.parquet", table)
    for read in (Touches.load, ParquetTouches):
        with pytest.raises(TouchesError, match=f"got '{name}' twice. Rename one"):
            read(tmp_path / "odd.parquet")


@pytest.mark.parametrize("read", [Touches.load, ParquetTouches])
def test_damaged_and_empty_files_are_refused(library, tmp_path, read):
    library.add(_presses(1))
    path = tmp_path / "some.parquet"
    library.export(path)
    for damaged in (path.read_bytes()[:-50], b"PAR1"):
        path.write_bytes(damaged)
        with pytest.raises(TouchesError, match="must be a whole Parquet file"):
            read(path)
    _written(path, pa.table({"image": pa.array([], pa.list_(pa.float32()))}))
    with pytest.raises(TouchesError, match="at least one touch"):
        read(path)
    _written(path, pa.table({"object": ["mug"]}))
    with pytest.raises(TouchesError, match=r"a column 'image'.*from_frame"):
        read(path)


def test_an_export_of_what_parquet_does_not_hold_leaves_nothing(library, tmp_path):
    fsspec = pytest.importorskip("fsspec")
    library.add(_presses(2))
    library.export("memory://out/None.parquet")
    store = fsspec.filesystem("memory")
    before = store.cat("/out/None.parquet")
    library.add(_presses(1).with_columns(wave=np.full(6, 1j)))
    (tmp_path / "out").mkdir()
    for by in (None, "object"):
        for path in (tmp_path / "out" / "x.parquet", f"memory://out/{by}.parquet"):
            with pytest.raises(TouchesError, match="a type that Parquet holds"):
                library.export(path, by=by)
    assert not [*(tmp_path / "out").iterdir()]
    assert store.find("/out") == ["/out/None.parquet"]
    assert store.cat("/out/None.parquet") == before
    with pytest.raises(LibraryError, match="by must be one of"):
        library.export(tmp_path / "x.npz", by="object")
