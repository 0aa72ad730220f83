"""Renames, merges, retractions, and touches that come back from an export."""

import itertools
import time
import unicodedata
from contextlib import suppress

import numpy as np
import pytest

from palpate import Touches
from palpate.library import (
    LibraryError,
    TouchLibrary,
    _rows,
    check_library,
    quoted,
)
from palpate.touches import TouchesError


def touches(names="abcabc", seed=0, **columns):
    """Return a touch of each of these objects, by default two of each of three."""
    images = np.random.default_rng(seed).integers(0, 255, (len(names), 3, 3), np.uint8)
    return Touches(images, object=list(names), press=np.arange(len(names)), **columns)


@pytest.fixture
def folder(tmp_path):
    """A library of three objects."""
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        library.add(touches("aabbcc"))
    return tmp_path / "library"


def state_of(folder):
    with TouchLibrary.open(folder) as library:
        rows = library.list(limit=None, retracted=True)
        return rows, library.objects(), library.history()


@pytest.fixture
def rebuilt(alter):
    """Have a whole database rebuilt; return its rows, objects and history."""

    def rebuild(folder):
        alter(folder, "UPDATE tally SET touches = x'00'")
        repair = TouchLibrary.repair_folder(folder)
        assert (repair.rebuilt, repair.lost, repair.n_changes_lost) == (True, [], 0)
        assert check_library(folder).ok
        return state_of(folder)

    return rebuild


def test_changes_follow_one_another_even_while_the_clock_is_wrong(
    folder, rebuilt, monkeypatch
):
    """A change names the objects of its time, also where the clock stands still."""
    monkeypatch.setattr(time, "time", lambda: 1000.0)
    with TouchLibrary.open(folder) as library:
        for old, new in ("ax", "xy", "ya", "az"):
            library.rename_object(old, new)
        library.add(touches("a", 1))
        library.rename_object("a", "q")
        library.add(touches("aq", 2))
        history = library.history()
    monkeypatch.undo()
    assert [change.content["new"] for change in history] == ["x", "y", "a", "z", "q"]
    assert [change.after for change in history] == [*[6] * 4, 7]
    assert {change.time_s for change in history} == {1000.0}
    before = state_of(folder)
    assert [row.object for row in before[0]] == [*"zzbbcc", *"qaq"]
    assert rebuilt(folder) == before


@pytest.mark.parametrize(
    ("first", "second", "objects"),
    [
        (("merge_objects", "a", "b"), ("rename_object", "a", "x"), "xxxxcc"),
        (("merge_objects", "a", "b"), ("merge_objects", "a", "c"), "cccccc"),
        (("merge_objects", "b", "c"), ("merge_objects", "a", "b"), "cccccc"),
        (("rename_object", "b", "x"), ("merge_objects", "a", "b"), "aaxxcc"),
    ],
)
def test_changes_asked_for_at_once_follow_one_another(
    folder, rebuilt, monkeypatch, first, second, objects
):
    """A change knows what another program changed just before it is written."""
    with TouchLibrary.open(folder) as library, TouchLibrary.open(folder) as other:
        write = library._store.write

        def write_after(job):
            getattr(other, first[0])(*first[1:])
            return write(job)

        monkeypatch.setattr(library._store, "write", write_after)
        with suppress(LibraryError):  # the object has another name now
            getattr(library, second[0])(*second[1:])
    assert check_library(folder).ok
    before = state_of(folder)
    assert [row.object for row in before[0]] == [*objects]
    assert rebuilt(folder) == before


def test_a_rename_while_touches_are_read_makes_no_object_two(folder, monkeypatch):
    """What is read has the names of when it began, and nothing is called damaged."""
    read, times = _rows.stored_touches, itertools.count()

    def read_before_a_rename(*arguments, **named):
        rows = read(*arguments, **named)
        if next(times) % 2 == 0:  # rows that are read again are not overtaken
            for old, new in ("bx", "cb", "xc"):
                other.rename_object(old, new)
        return rows

    monkeypatch.setattr(_rows, "AT_ONCE", 1)
    with TouchLibrary.open(folder) as library, TouchLibrary.open(folder) as other:
        chosen = library.select()
        monkeypatch.setattr(_rows, "stored_touches", read_before_a_rename)
        assert chosen.touches().object.tolist() == [*"aabbcc"]
        rows = library.list()
        assert len({row.object for row in rows}) == 3
        assert all(len({row.object for row in rows[n : n + 2]}) == 1 for n in (0, 2, 4))
        assert chosen[[2, 3, 4, 5]].touches().object.tolist() == [*"bbcc"]


def test_the_history_has_every_change_with_its_time_and_reason(folder):
    start = time.time()
    with TouchLibrary.open(folder) as library:
        ids = [row.id for row in library.list()]
        library.rename_object("a", "x")
        library.merge_objects("b", "x")
        library.retract(ids[4], reason="wet")
        library.restore(object="c")
        history = library.history()
    assert [(change.action, change.content) for change in history] == [
        ("rename", {"old": "a", "new": "x"}),
        ("merge", {"source": "b", "into": "x"}),
        ("retract", {"ids": ids[4:5], "object": None, "reason": "wet"}),
        ("restore", {"ids": ids[4:5], "object": "c"}),
    ]
    times = [start, *(change.time_s for change in history), time.time()]
    assert times == sorted(times)


def test_what_changes_nothing_leaves_nothing(folder):
    with TouchLibrary.open(folder) as library:
        first = library.list(limit=1)[0].id
        assert library.retract(first, reason="wet") == 1
        assert library.retract(first, reason="wet") == 0
        assert library.restore(object="b") == 0
        assert library.restore(first) == 1
        assert library.retract([], reason="none") == 0
        taken, unknown = "merge '{}' into it", "must be one in the library"
        for old, new, match in (
            ("a", "b", taken.format("a")),
            ("nobody", "x", unknown),
            ("b", "b", taken.format("b")),
        ):
            with pytest.raises(LibraryError, match=match):
                library.rename_object(old, new)
        for bad, match in (("xyz", "hexadecimal"), ("00" * 16, "in the library, got")):
            with pytest.raises(LibraryError, match=match):
                library.retract(bad, reason="x")
        for reason in (" ", "\ud800"):
            with pytest.raises(ValueError, match="reason must be a text"):
                library.retract(object="a", reason=reason)
        for name in "ab":
            with pytest.raises(LibraryError, match="which are one"):
                library.merge_objects(name, name)
        assert [change.action for change in library.history()] == ["retract", "restore"]
        assert library.stats().n_changes == 2
        assert library.check().ok


def test_touches_are_chosen_by_ids_or_by_their_object(folder, rebuilt):
    with TouchLibrary.open(folder) as library:
        ids = [row.id for row in library.list()]
        for chosen in ({}, {"ids": ids[:1], "object": "a"}):
            with pytest.raises(ValueError, match="Give either ids or object"):
                library.retract(**chosen, reason="wet")
        library.merge_objects("a", "b")
        assert library.retract(ids[0].upper(), reason="wet") == 1
        assert library.history()[-1].content["ids"] == ids[:1]
        assert library.check().ok
        # Touches of the merged object count; the retracted one keeps its reason.
        assert library.retract(object="a", reason="dry") == 3
        assert [row.name for row in library.objects()] == ["c"]
        assert library.add(touches("aabbcc")) == ids
        assert len(library) == len(library.touches()) == 2
        rows = library.list(retracted=True)
        assert [row.reason for row in rows] == ["wet", *["dry"] * 3, None, None]
        assert library.restore(object="b") == 4
        assert library.restore(iter(ids)) == 0
        library.retract(ids[:4], reason="wet")
        library.restore(ids[1:3])
        library.retract(ids[2], reason="dry")
    before = state_of(folder)
    assert [row.reason for row in before[0]] == ["wet", None, "dry", "wet", None, None]
    assert [(row.name, row.n_touches) for row in before[1]] == [("b", 1), ("c", 2)]
    assert rebuilt(folder) == before


def test_merged_objects_stay_one_through_merges_renames_and_repairs(folder, rebuilt):
    with TouchLibrary.open(folder) as library:
        library.merge_objects("a", "b")
        library.rename_object("a", "bowl")
        library.merge_objects("bowl", "c")
        library.rename_object("c", "cup")
        library.add(touches("ab", 1))
        assert [row.name for row in library.objects()] == ["b", "cup"]
    before = state_of(folder)
    assert [row.object for row in before[0]] == [*["cup"] * 7, "b"]
    assert rebuilt(folder) == before
    with TouchLibrary.open(folder) as library:
        library.add(touches("a", 2))
    assert state_of(folder)[0][-1].object == "cup"


@pytest.mark.parametrize(("n_objects", "more"), [(20, False), (21, True)])
def test_unknown_names_are_refused_with_the_first_twenty_names(
    library, n_objects, more
):
    names = [f"thing {k:02}" for k in range(n_objects)]
    with pytest.raises(LibraryError, match=r"library \(it has none\), got 'x'"):
        library.rename_object("x", "y")
    library.add(touches(names))
    with pytest.raises(LibraryError) as refusal:
        library.rename_object("thing 7", "y")
    listed = ", ".join(map(repr, names[:20])) + ", ..." * more
    assert f"library ({listed}), got 'thing 7'" in str(refusal.value)
    assert "Did you mean" in str(refusal.value)


@pytest.mark.parametrize("name", ["time_s", "force_n"])
def test_numbers_of_any_size_and_texts_of_digits_stay_what_they_are(folder, name):
    large = np.array([2**64 - 1, 7], dtype=np.uint64)
    with TouchLibrary.open(folder) as library:
        library.add(touches("de", 1, session=["12", "2.0"], **{name: large}))
        assert library.list("object = d")[0].session == "12"
        read = library.touches("object in (d, e)").columns[name]
        assert read.tolist() == large.tolist()
    assert not check_library(folder).problems


@pytest.mark.parametrize("gone", ["a", "c"])
def test_changes_of_touches_that_are_lost_cost_no_other(folder, alter, gone):
    """A change that concerns other touches too is kept, and a check accepts it."""
    with TouchLibrary.open(folder) as library:
        ids = {n: [row.id for row in library.list(f"object = {n}")] for n in "abc"}
        library.retract([ids["a"][0], *ids["b"], ids["c"][1]], reason="wet")
        library.restore([ids["b"][1], ids["c"][1]])
        library.rename_object("a", "disk")  # a name that is in messages too
        library.merge_objects("c", "b")
    numbers = {"a": "1, 2", "c": "5, 6"}[gone]
    alter(folder, f"UPDATE touches SET force_n = 9 WHERE number IN ({numbers})")
    repair = TouchLibrary.repair_folder(folder)
    assert repair.lost == ids[gone]
    assert (repair.n_changes, repair.n_changes_lost) == (3, 1)
    rows = {row.id: (row.object, row.reason) for row in state_of(folder)[0]}
    kept = {
        "a": dict(zip(ids["c"], [("b", None)] * 2, strict=True)),
        "c": {ids["a"][0]: ("disk", "wet"), ids["a"][1]: ("disk", None)},
    }[gone]
    assert rows == kept | {ids["b"][0]: ("b", "wet"), ids["b"][1]: ("b", None)}
    assert str(check_library(folder)).startswith("4 touches: all present")
    assert not TouchLibrary.repair_folder(folder).rebuilt


def test_a_change_that_cannot_be_read_is_counted_and_the_touches_stay(folder, alter):
    """Names and retractions then follow from the changes that are left."""
    with TouchLibrary.open(folder) as library:
        library.rename_object("a", "x")
        library.retract(object="c", reason="wet")
    alter(folder, "UPDATE changes SET content = '[1]' WHERE id = 1")
    assert "change" in {p.kind for p in check_library(folder).problems}
    with TouchLibrary.open(folder) as library:
        with pytest.raises(LibraryError, match=r"check"):
            library.history()
        with pytest.raises(LibraryError):
            library.touches()
    repair = TouchLibrary.repair_folder(folder)
    assert (repair.n_touches, repair.lost, repair.n_changes_lost) == (6, [], 1)
    rows = state_of(folder)[0]
    assert [row.object for row in rows] == list("aabbcc")
    assert [row.reason for row in rows] == [*[None] * 4, "wet", "wet"]
    assert check_library(folder).ok


NFC = unicodedata.normalize("NFC", "café")
NFD = unicodedata.normalize("NFD", "café")
IMAGES = np.zeros((2, 3, 3), np.uint8)
BAD = {
    "escape": "\x1b[2Jmug",
    "a terminal's own control": "\x9b2Jmug",
    "line break": "mug\n",
    "line separator": "mug\u2028",
    "NUL within": "m\0ug",
    "NUL at the end": "mug\0",  # which numpy drops without a word
}


def test_two_spellings_are_one_object(library):
    assert NFC != NFD
    touches = Touches(IMAGES, object=[NFC, NFD], category=[NFD, NFD])
    assert [*touches.object] == [NFC, NFC]
    ids = library.add(touches)
    assert ids[0] == ids[1]
    assert library.add(Touches(IMAGES[:1], object=[NFD])) == ids[:1]
    assert [row.name for row in library.objects()] == [NFC]
    assert library.count(f"object = {NFD}") == 1
    names = {"session": [NFC, NFD], "source_path": [f"{NFC}/1.png", f"{NFD}/1.png"]}
    library.add(Touches(IMAGES, **names))  # which stay what they are
    for name in (NFC, NFD):
        assert library.count(f"session = {name}") == 2
        assert library.count(f"session != {name}") == 1
        assert library.count(f"source_path contains {name}/") == 2
    library.rename_object(NFD, "mug")
    library.rename_object("mug", NFD)
    assert [row.name for row in library.objects()] == [NFC]
    assert library.check().ok


@pytest.mark.parametrize("kind", [list, tuple])
@pytest.mark.parametrize("column", ["object", "category"])
@pytest.mark.parametrize("name", BAD.values(), ids=BAD)
def test_a_name_that_no_terminal_should_print_is_refused(name, column, kind):
    with pytest.raises(TouchesError, match="must be of letters that can be printed"):
        Touches(IMAGES, **{column: kind(["pen", name])})


def test_other_scripts_and_emoji_are_names():
    names = ["杯子", "👩‍🔧"]
    assert [*Touches(IMAGES, object=names).object] == names


def _exported(library, tmp_path, where=None):
    library.export(tmp_path / "e.npz", where)
    return Touches.load(tmp_path / "e.npz")


def test_an_export_after_renames_and_merges_adds_nothing(library, tmp_path):
    ids = library.add(touches())
    library.rename_object("a", "mug")
    library.rename_object("mug", "cup")
    assert [row.name for row in library.objects()] == ["b", "c", "cup"]
    assert set(library.touches().object) == {"b", "c", "cup"}
    assert library.add(_exported(library, tmp_path)) == ids
    assert library.add(library.touches("object = cup")) == ids[::3]
    assert library.add(touches()) == ids
    library.merge_objects("cup", "b")
    library.rename_object("cup", "thing")  # it is b's name that changes
    library.merge_objects("thing", "c")
    assert library.add(_exported(library, tmp_path)) == ids
    assert len(library) == 6


def test_another_object_of_a_freed_name_stays_another(library, tmp_path):
    """The same image and labels once as `a` and once as the next `a`: two touches."""
    library.add(touches())
    library.rename_object("a", "mug")
    new = touches(seed=1)
    library.add(new)
    assert library.count("object = a") == library.count("object = mug") == 2
    exported = _exported(library, tmp_path)
    library.add(exported)
    assert len(library) == 12
    moved = exported[np.flatnonzero(exported.object == "mug")]
    library.add(moved.with_columns(object=["b", "b"]))  # never called b: new touches
    assert len(library) == 14


def test_touches_of_unlike_columns_come_back(library, tmp_path):
    """An export fills gaps of columns, and writes numbers among texts as text."""
    first = library.add(touches(session=np.arange(6), episode=["x", "", "y"] * 2))
    second = library.add(touches(seed=1, session=["s", "t", "u"] * 2))
    third = library.add(touches(seed=2))
    placed = {"position_mm": np.ones((6, 3)), "position_raw": np.ones((6, 2))}
    fourth = library.add(touches(seed=3, **placed))
    library.rename_object("c", "cup")
    assert library.add(_exported(library, tmp_path)) == first + second + third + fourth
    assert len(library) == 24


def test_an_export_given_twice_at_once_adds_nothing(library, tmp_path):
    library.add(touches())
    library.rename_object("a", "mug")
    exported = _exported(library, tmp_path)
    library.add(Touches.concatenate([exported, exported]))
    assert len(library) == 6


def test_a_renamed_touch_that_a_repair_lost_comes_back(library, tmp_path, alter):
    """It has the present name of its object, like the touches that were kept."""
    ids = library.add(touches())
    library.rename_object("a", "mug")
    exported = _exported(library, tmp_path)
    alter(library.folder, "UPDATE images SET image = x'00' WHERE number = 1")
    assert library.repair().lost == ids[:1]
    assert library.add(exported)[1:] == ids[1:]
    assert library.touches("object = mug").columns["press"].tolist() == [3, 0]
    assert library.check().ok


@pytest.mark.parametrize("cell", ["nan", "inf", "1e5", "1_0", "9" * 5000, "9" * 400])
def test_odd_cells_are_only_text(library, cell):
    odd = touches(session=[cell] * 6)
    assert library.add(odd) == library.add(odd)
    assert library.touches().session.tolist() == [cell] * 6


@pytest.mark.parametrize(
    "name",
    [*BAD.values(), "\ud800", "\x7f", " ", "", 5, None, "tab\t", "...", "\u200b"],
)
def test_names_that_cannot_be_shown_are_refused(library, name):
    library.add(touches())
    with pytest.raises(LibraryError, match="The name of an object must"):
        library.rename_object("a", name)
    assert [row.name for row in library.objects()] == ["a", "b", "c"]


def test_a_name_that_no_database_holds_is_unknown(library):
    library.add(touches())
    for act in (
        lambda: library.rename_object("\ud800", "x"),
        lambda: library.merge_objects("a", "\ud800"),
        lambda: library.retract(object="\ud800", reason="x"),
    ):
        with pytest.raises(LibraryError, match="must be one in the library"):
            act()
    with pytest.raises(LibraryError, match="such as UTF-8 can hold"):
        library.no_contact("\ud800")


@pytest.mark.parametrize(
    "name", ["it's", "a \"b\" 'c'", "''", "and", "5", "ツ = or", "' or 1 = 1"]
)
def test_a_filter_takes_any_name(library, name):
    library.add(touches([name, "b", "c"] * 2))
    assert [r.object for r in library.list(f"object = {quoted(name)}")] == [name] * 2
    assert library.count(f"object != {quoted(name)}") == 4


def test_one_object_is_read_without_the_others(library, alter):
    """Images and columns of other touches may even be gone."""
    library.add(touches()[[0, 3]])
    library.add(touches("dddddd", clicks=np.zeros((6, 9, 9))))
    alter(library.folder, "DELETE FROM images WHERE number > 2")
    assert len(library.list("object = a", limit=1)) == 1
    assert len(library.select("object = a").touches([0, 1])) == 2
    assert set(library.touches("object = a").columns) == {"object", "press"}
