"""Touches that are read back: columns, channels, limits, selections."""

import errno
import mmap
import os

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.library import (
    LibraryError,
    SensorDescription,
    TouchLibrary,
    check_library,
)
from palpate.touches import TouchesError

from .conftest import assert_alike

N_BYTES = 6 * 4 * 5 * 2


def images(n=6, seed=0, shape=(4, 5)):
    rng = np.random.default_rng(seed)
    return rng.integers(0, 999, (n, *shape)).astype(np.uint16)


def is_mapped(array):
    while isinstance(array, np.ndarray):
        array = array.base
    return isinstance(array, mmap.mmap)


def test_limits_of_memory_are_reached_and_not_passed(library, monkeypatch):
    library.add(Touches(images(), object=["a"] * 6))
    assert not is_mapped(library.touches(in_memory=N_BYTES).images)
    mapped = library.touches(in_memory=N_BYTES - 1).images
    assert is_mapped(mapped)
    assert_array_equal(mapped, images())
    assert len(library.touches(max_bytes=N_BYTES)) == 6
    message = f"6 touches must take at most {N_BYTES - 1} bytes, got {N_BYTES}"
    with pytest.raises(LibraryError, match=message):
        library.touches(max_bytes=N_BYTES - 1)
    # By default 256 MiB are held in memory, and 64 GiB are read at all.
    assert not is_mapped(library.touches().images)

    def failing(*_):
        raise OSError(number, os.strerror(number))

    # Room is taken first: a mapping that finds none later ends the program (SIGBUS).
    monkeypatch.setattr("os.posix_fallocate", failing, raising=False)
    number = errno.EINVAL  # of some file systems
    assert is_mapped(library.touches(in_memory=0).images)
    number = errno.ENOSPC
    with pytest.raises(LibraryError, match="place with room for images, got: No space"):
        library.touches(in_memory=0)


@pytest.mark.parametrize(
    ("pick", "rows"),
    [
        ("press < 3", [0, 1, 2]),
        ("press in (0, 2, 4)", [0, 2, 4]),
        ("press != 3", [0, 1, 2, 4, 5]),
        (None, [0, 1, 2, 3, 4, 5]),
    ],
)
def test_touches_of_several_batches_come_in_the_order_added(library, pick, rows):
    parts = [
        Touches(
            images(2, seed),
            object=["a", "b"],
            press=[2 * seed, 2 * seed + 1],
            place=images(2, seed + 9, (2, 3)),
            wide=images(2, seed + 20, (7, 9)).astype(float),
        )
        for seed in range(3)
    ]
    for part in parts:
        library.add(part)
    whole = Touches.concatenate(parts)
    read, picked = library.touches(pick), library.select(pick)
    assert_alike(read, whole[rows])
    # A selection holds short columns alone until images are read.
    assert "press" in picked.columns
    assert "wide" not in picked.columns
    assert_array_equal(picked.columns["press"], rows)
    assert_array_equal(
        picked.touches([0, 2]).columns["wide"], read.columns["wide"][::2][:2]
    )
    assert_array_equal(picked[[1, 2]].touches([1]).images, read.images[2:3])
    assert len(picked) == len(rows)
    ids = [row.id for row in library.list()]
    assert picked.touch_id.tolist() == list(np.array(ids)[rows])
    assert (
        repr(picked) == f"<Selection: {len(rows)} touches of {str(library.folder)!r}>"
    )


def test_rows_of_a_selection_must_increase(library):
    library.add(Touches(images(), object=["a"] * 6))
    selection = library.select()
    for rows in ([1, 0], [1, 1]):
        with pytest.raises(TouchesError, match="rows must be increasing indices"):
            selection.touches(rows)
    with pytest.raises(TypeError, match="Touches are picked by number"):
        selection.touches([[0, 1]])
    assert len(selection[[5]]) == 1
    assert len(selection[[0, 5]]) == 2


def test_what_whole_sets_share_is_read_and_the_rest_left_out(library):
    frame = images(1)[0]
    about = {"no_contact": frame, "set_unit": "kPa", "geometry": "array"}
    library.add(Touches(images(2), object=["a", "b"], **about))
    assert set(library.touches().whole) == set(about)
    library.add(
        Touches(images(2, 1), object=["a", "b"], **{**about, "set_unit": "bar"})
    )
    assert set(library.touches().whole) == {"no_contact", "geometry"}
    assert_array_equal(library.select().whole["no_contact"], frame)
    library.add(Touches(images(2, 2), object=["c", "d"], set_unit="kPa"))
    # Touches without a geometry leave it unknown.
    assert library.touches().whole == {}
    assert library.touches("object in (a, b)").geometry == "array"
    library.add(Touches(images(2, 3), object=["e", "f"], geometry="plane"))
    with pytest.raises(LibraryError, match=r"one geometry, got array, plane\. Choose"):
        library.touches()
    assert library.touches("object in (c, d, e)").geometry is None


def test_the_newest_baseline_is_that_of_the_last_touch(library):
    """One sensor may keep its baseline while another comes; retracted ones are none."""
    for seed, level in enumerate((5, 7, 5, 9)):
        rest = np.full((4, 5), level, np.uint16)
        ids = library.add(Touches(images(2, seed), object=["a", "b"], no_contact=rest))
    for level, change in ((9, library.retract), (5, library.restore)):
        assert (library.no_contact() == level).all()
        assert (library.select().no_contact == level).all()
        change(ids, **({"reason": "pressed"} if level == 9 else {}))
    assert (library.no_contact() == 9).all()


@pytest.mark.parametrize(
    ("shape", "channels", "got", "where"),
    [
        ((3, 5), None, "3 x 5 <u2; 4 x 5 <u2", "n_rows = 3"),
        ((4, 5, 2), ["x", "y"], "4 x 5 <u2; 4 x 5 x 2 <u2", "n_channels is null"),
    ],
)
def test_touches_of_several_shapes_are_refused_with_a_filter_that_chooses(
    library, shape, channels, got, where
):
    with pytest.raises(LibraryError, match="at least one touch, got none"):
        library.select()
    library.add(Touches(images(2), object=["a", "b"]))
    library.add(Touches(images(2, 1, shape), object=["c"] * 2, channels=channels))
    for read in (library.touches, library.select):
        with pytest.raises(
            LibraryError, match=rf'got {got}\. .*`where`.* or "{where}"'
        ):
            read()
    assert len(library.touches(where)) == 2
    assert library.touches("object = c").images.shape == (2, *shape)


def test_columns_of_several_kinds_are_joined_as_texts_or_refused(library):
    library.add(Touches(images(2), object=["a", "b"], note=["x", "y"], turn=[1, 2]))
    library.add(Touches(images(2, 1), object=["a", "b"], note=[5, 6], turn=[0.5, 1.5]))
    read = library.touches()
    assert read.columns["note"].tolist() == ["x", "y", "5", "6"]
    assert read.columns["turn"].tolist() == [1, 2, 0.5, 1.5]
    library.add(Touches(images(2, 2), object=["a", "b"], note=[[1, 2]] * 2))
    with pytest.raises(
        LibraryError, match=r"'note' must have one shape .* got \(\) of .* \(2,"
    ):
        library.touches()


@pytest.mark.parametrize(
    ("values", "nothing"),
    [
        (np.array(["2024-01-01", "2024-01-02"], "M8[s]"), np.datetime64("NaT")),
        (np.array([1, 2], "m8[ms]"), np.timedelta64("NaT")),
        (np.array([b"y", b"nan"]), b""),
        (np.full((2, 3), np.datetime64("2024-01-01")), np.datetime64("NaT")),
    ],
)
def test_times_and_bytes_that_some_lack_are_empty(library, values, nothing):
    library.add(Touches(images(2), object=["a", "b"], note=values))
    library.add(Touches(images(2, 1), object=["a", "b"]))
    read = library.touches().columns["note"]
    assert read.dtype == values.dtype
    assert_array_equal(read[:2], values)
    assert_array_equal(read[2:], np.full_like(values, nothing))


@pytest.mark.parametrize("kind", ["M8[D]", "S10"])
def test_sessions_of_dates_or_bytes_are_known_before_images_are_read(library, kind):
    days = np.array(["2024-01-01", "2024-01-02"], kind)
    library.add(Touches(images(2), object=["a", "b"], session=days, note=days))
    library.add(Touches(images(2, 1), object=["a", "b"], session=days))
    chosen = library.select()
    assert {*chosen.columns} == {"object", "session"}
    assert_array_equal(chosen.session, [*days, *days])


@pytest.mark.parametrize("other", [np.array([1, 2], "m8[s]"), [1.5, 2.0], [b"x", b"y"]])
def test_times_are_not_read_with_other_values(library, other):
    when = np.array(["2024-01-01", "2024-01-02"], "M8[s]")
    library.add(Touches(images(2), object=["a", "b"], when=when))
    library.add(Touches(images(2, 1), object=["a", "b"], when=other))
    with pytest.raises(LibraryError, match=r"'when' must have .* be of times or of"):
        library.touches()


def test_what_some_lack_is_filled_a_category_left_out_an_object_refused(library):
    columns = {"category": ["x", "y"], "session": ["s", "t"], "order": [1, 2]}
    columns |= {"object": ["a", "b"], "position_mm": np.ones((2, 3))}
    library.add(Touches(images(2), **columns))
    library.add(Touches(images(2, 1), object=["a", "c"]))
    read = library.touches()
    assert read.category is None
    assert read.object.tolist() == ["a", "b", "a", "c"]
    assert read.session.tolist() == ["s", "t", "", ""]
    assert_array_equal(read.order, [1, 2, np.nan, np.nan])
    assert np.isnan(read.columns["position_mm"][2:]).all()
    assert library.touches("category is not null").category.tolist() == ["x", "y"]
    library.add(Touches(images(3, 2)))
    match = r'got 3 without\. Leave those out with the filter "object is not null"'
    for read in (library.touches, library.select):
        with pytest.raises(LibraryError, match=match):
            read()
        bare = read("object is null")
        assert bare.object is None
        assert bare.category is None


def summed(touches):
    """Return two features of each touch."""
    return touches.images.reshape(len(touches), -1)[:, :2].astype(float)


def test_features_are_those_of_each_touch_whatever_was_cached_before(library):
    library.add(Touches(images(), object=["a"] * 6, press=np.arange(6)))
    n_encoded = []

    def encode(touches):
        n_encoded.append(len(touches))
        return summed(touches)

    odd = library.select("press in (1, 3, 5)")
    expected = summed(Touches(images()))
    assert_array_equal(odd.features("key", encode), expected[1::2])
    assert_array_equal(library.select().features("key", encode), expected)
    assert_array_equal(library.select().features("key", encode), expected)
    assert n_encoded == [3, 3]
    assert_array_equal(
        library.select()[[2, 3]].features("other", encode), expected[2:4]
    )
    assert n_encoded == [3, 3, 2]
    for bad in ("", "a/b", ".."):
        with pytest.raises(ValueError, match="key must be letters and digits"):
            odd.features(bad, encode)
    # Features are only a cache: damaged and missing ones are computed again.
    for path in (library.folder / "features" / "key").rglob("*.npz"):
        path.write_bytes(b"altered")
    library.add(Touches(images(1, 5), object=["a"], press=[6]))
    features = library.select().features("key", encode)
    assert_array_equal(features[:6], expected)
    assert n_encoded == [3, 3, 2, 7]


@pytest.mark.parametrize(("cell", "what"), [("image", "its image "), ("more", "")])
def test_images_that_are_gone_or_altered_are_named(library, alter, cell, what):
    """The cell `more` holds wide columns."""
    wide = np.arange(6 * 30.0).reshape(6, 30)
    columns = {"object": ["a"] * 6, "press": np.arange(6), "wave": wide}
    ids = library.add(Touches(images(), **columns))
    later = library.add(Touches(images(2, 1), object=["b"] * 2, press=[6, 7]))
    alter(
        library.folder,
        f"UPDATE images SET {cell} = (SELECT {cell} FROM images WHERE number = 5) "
        "WHERE number = 4",
    )
    with pytest.raises(LibraryError, match=f"Touch {ids[3]}: {what}.* altered"):
        library.touches()
    with pytest.warns(UserWarning, match="^1 touches are left out: their images"):
        undamaged = library.touches(damaged="skip")
    assert undamaged.columns["press"].tolist() == [0, 1, 2, 4, 5, 6, 7]
    assert_array_equal(undamaged.columns["wave"][:5], wide[[0, 1, 2, 4, 5]])
    alter(library.folder, "DELETE FROM images WHERE number > 6")
    with pytest.warns(UserWarning, match="^3 touches are left out") as warned:
        assert len(library.select(damaged="skip")) == 5
    assert warned[0].filename == __file__
    with pytest.raises(LibraryError, match=f"Touch {later[0]}: .* got none"):
        library.image(later[0])
    assert_array_equal(library.image(ids[4]), images()[4])
    with pytest.raises(ValueError, match="damaged must be"):
        library.touches(damaged="ignore")


@pytest.mark.parametrize(
    "statement", ["DELETE FROM arrays", "UPDATE arrays SET content = x'0000'"]
)
def test_a_lost_array_costs_no_touch_and_comes_back_with_them(
    library, alter, statement
):
    """Reading warns and a check reports the loss; a repair keeps the touches."""
    frame = images(1)[0]
    again = Touches(images(2, 1), object=["b", "c"], no_contact=frame, set_unit="kPa")
    library.add(Touches(images(1, 2), object=["a"], no_contact=frame + 1))
    ids = library.add(again)
    alter(
        library.folder,
        f"{statement} WHERE rowid = 3",  # 1 is of the first touch, 2 the unit
    )
    with pytest.warns(UserWarning, match="without their no_contact.*check"):
        read = library.touches("object in (b, c)")
    assert read.no_contact is None
    assert str(read.whole["set_unit"]) == "kPa"
    assert_array_equal(read.images, again.images)
    with pytest.warns(UserWarning, match="no_contact"):
        assert_array_equal(library.no_contact(), frame + 1)
    [problem] = library.check().problems
    assert (problem.kind, problem.touches) == ("array", ids)
    assert library.repair().lost == []
    with pytest.warns(UserWarning, match="no_contact"):
        assert len(library.touches("object in (b, c)")) == 2
    assert library.add(again) == ids
    assert_array_equal(library.touches("object in (b, c)").no_contact, frame)
    assert library.check().ok


@pytest.mark.parametrize("entry", ["pads", "channels"])
def test_lost_pads_or_names_of_channels_cost_no_touch(library, alter, rng, entry):
    """Names of lost pads go with them, channels are numbered."""
    if entry == "pads":
        whole = {"pads": [[0, 0, 4, 2], [0, 2, 4, 3]], "pad_names": ["left", "right"]}
        touches = Touches(images(3), object=["a"] * 3, **whole)
    else:
        touches = colour(rng)
    library.add(touches)
    alter(library.folder, "DELETE FROM arrays WHERE rowid = 1")
    with pytest.warns(UserWarning, match=f"without their {entry}"):
        read = library.touches()
    assert_array_equal(read.images, touches.images)
    assert read.channels == (None if entry == "pads" else ("0", "1", "2"))
    assert read.pads is read.pad_names is None
    with pytest.warns(UserWarning, match=f"without their {entry}"):
        assert library.select().features("key", summed).shape[0] == 3


def test_features_made_before_an_interruption_are_kept(library):
    """512 touches are encoded at a time; after every 16 times all are written."""
    n = 17 * 512
    levels = np.arange(n, dtype=np.uint16).reshape(n, 1, 1)
    library.add(Touches(levels, object=np.repeat("a", n)))
    encoded_levels = []

    def encode(touches, most=16 * 512):
        encoded_levels.extend(touches.images.ravel().tolist())
        if len(encoded_levels) > most:
            raise KeyboardInterrupt
        return touches.images.reshape(-1, 1).astype(float)

    with pytest.raises(KeyboardInterrupt):
        library.select().features("key", encode)
    encoded_levels.clear()
    features = library.select().features("key", encode)
    assert_array_equal(features.ravel(), np.arange(n))
    assert encoded_levels == list(range(16 * 512, n))


COLOUR = ["r", "g", "b"]


def colour(rng, n_touches=3, **more):
    images = rng.integers(0, 256, (n_touches, 5, 6, 3), dtype=np.uint8)
    about = {"object": ["mug"] * n_touches, "channels": COLOUR, **more}
    return Touches(images, **about)


def grey(rng, **more):
    images = rng.integers(0, 256, (2, 5, 6), dtype=np.uint8)
    return Touches(images, object=["pen"] * 2, **more)


def test_channels_pads_and_frames_come_back(library, rng):
    hand = colour(
        rng,
        pads=[[0, 0, 5, 2], [0, 3, 5, 3]],
        pad_names=["thumb", "index"],
        no_contact=np.zeros((5, 6, 3), np.uint8),
        press_frames=np.ones((3, 4, 5, 6, 3), np.uint8),
    )
    ids = library.add(hand)
    back = library.touches()
    assert_alike(back, hand)
    assert (back.channels, back.pad_names) == (hand.channels, hand.pad_names)
    assert_array_equal(library.image(ids[1]), hand.images[1])
    row = library.list()[0]
    assert (row.n_rows, row.n_cols, row.n_channels, row.dtype) == (5, 6, 3, "|u1")
    assert library.add(hand) == ids
    assert len(library) == 3
    mapped = library.touches(in_memory=0)
    assert_array_equal(mapped.images, hand.images)


def test_one_channel_is_not_none(library, rng):
    image = rng.normal(size=(1, 5, 6, 1))
    library.add(Touches(image, channels=["z"]))
    assert_array_equal(library.touches().images, image)
    assert library.count("n_channels = 1") == 1


def test_one_sensor_gives_one_kind(library, rng):
    camera = SensorDescription("camera 0")
    library.add(grey(rng), sensor=camera)
    with pytest.raises(LibraryError, match=r"'camera 0' must have no channels .*got 3"):
        library.add(colour(rng), sensor=camera)
    assert len(library) == 2
    library.add(colour(rng), sensor=SensorDescription("camera 1"))
    with pytest.raises(LibraryError, match=r"'camera 1' must have 3 channels .*got no"):
        library.add(grey(rng), sensor=SensorDescription("camera 1"))
    assert len(library.touches("sensor = 'camera 1'")) == 3


def test_unlike_channels_or_pads_are_refused(library, rng):
    library.add(colour(rng))
    library.add(colour(rng, channels=["x", "y", "z"], session=["a"] * 3))
    with pytest.raises(LibraryError, match="the same channels, got several"):
        library.touches()
    assert library.touches("session = a").channels == ("x", "y", "z")
    library.add(grey(rng, pads=[[0, 0, 5, 6]]))
    library.add(grey(rng))
    with pytest.raises(LibraryError, match="the same pads, got several"):
        library.select("object = pen")


def test_pads_of_former_names_are_the_same(library, rng):
    library.add(grey(rng, set_pads=np.array([[0, 0, 5, 6]])))
    library.add(grey(rng, pads=np.array([[0, 0, 5, 6]])))
    assert library.touches().pads.tolist() == [[0, 0, 5, 6]]


def test_features_are_made_of_touches_with_channels(library, rng):
    touches = colour(rng, pads=[[0, 0, 5, 6]])
    library.add(touches)

    def encode(part):
        assert part.channels == ("r", "g", "b")
        assert len(part.pads) == 1
        return part.images.mean(axis=(1, 2))

    means = library.select().features("means", encode)
    np.testing.assert_allclose(means, touches.images.mean(axis=(1, 2)))


def test_check_and_repair_know_channels(library, rng, alter):
    touches = colour(rng, pads=[[0, 0, 5, 6]])
    library.add(touches)
    assert check_library(library.folder).ok
    library.close()
    alter(library.folder, "UPDATE touches SET force_n = 5 WHERE number = 2")
    assert TouchLibrary.repair_folder(library.folder).n_touches == 2
    with TouchLibrary.open(library.folder) as again:
        assert_alike(again.touches(), touches[::2])


def test_grey_touches_have_the_ids_that_they_ever_had(library):
    images = np.arange(24, dtype=np.uint16).reshape(2, 3, 4)
    touches = Touches(images, object=["cup", "pen"], no_contact=images[0])
    # As palpate gave them before images could have channels.
    assert library.add(touches) == [
        "f467699079c60b0d00ce6a14a4bcf3a8",
        "9fde34d0b464f2dcbe07ab4ee842b06c",
    ]
