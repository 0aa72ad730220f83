"""Touches that come back from an export, renamed or not, are the same touches."""

import numpy as np
import pytest

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary, quoted


@pytest.fixture
def library(tmp_path):
    with TouchLibrary.open(tmp_path / "library", create=True) as opened:
        yield opened


def _touches(seed=0, **columns):
    images = np.random.default_rng(seed).integers(0, 255, (6, 4, 4), dtype=np.uint8)
    known = {"object": ["a", "b", "c"] * 2, "press": np.arange(6)} | columns
    return Touches(images, **known)


def _exported(library, tmp_path, where=None):
    library.export(tmp_path / "e.npz", where)
    return Touches.load(tmp_path / "e.npz")


def test_an_export_after_a_rename_adds_nothing(library, tmp_path):
    ids = library.add(_touches())
    library.rename_object("a", "mug")
    library.rename_object("mug", "cup")
    assert library.add(_exported(library, tmp_path)) == ids
    assert library.add(library.touches("object = cup")) == ids[::3]
    assert library.add(_touches()) == ids
    assert len(library) == 6


def test_an_export_after_a_merge_adds_nothing(library, tmp_path):
    ids = library.add(_touches())
    library.merge_objects("a", "b")
    library.rename_object("a", "thing")  # it is b's name that changes
    library.merge_objects("thing", "c")
    assert library.add(_exported(library, tmp_path)) == ids
    assert len(library) == 6


def test_another_object_of_a_freed_name_stays_another(library, tmp_path):
    """The same image and labels once as `a` and once as the next `a`: two touches."""
    library.add(_touches())
    library.rename_object("a", "mug")
    new = _touches(1)
    library.add(new)
    assert library.count("object = a") == library.count("object = mug") == 2
    exported = _exported(library, tmp_path)
    library.add(exported)
    assert len(library) == 12
    moved = exported[np.flatnonzero(exported.object == "mug")]
    library.add(moved.with_columns(object=["b", "b"]))  # never called b: new touches
    assert len(library) == 14


def test_touches_of_unlike_columns_come_back(library, tmp_path):
    """An export fills what some lack, and writes numbers among texts as text."""
    first = library.add(_touches(session=np.arange(6), episode=["x", "", "y"] * 2))
    second = library.add(_touches(1, session=["s", "t", "u"] * 2))
    third = library.add(_touches(2))
    library.rename_object("c", "cup")
    assert library.add(_exported(library, tmp_path)) == first + second + third
    assert len(library) == 18


def test_an_export_given_twice_at_once_adds_nothing(library, tmp_path):
    library.add(_touches())
    library.rename_object("a", "mug")
    exported = _exported(library, tmp_path)
    library.add(Touches.concatenate([exported, exported]))
    assert len(library) == 6


def test_a_renamed_touch_that_a_repair_lost_comes_back(library, tmp_path, alter):
    """As what its object is called now, beside those that were kept."""
    ids = library.add(_touches())
    library.rename_object("a", "mug")
    exported = _exported(library, tmp_path)
    alter(library.folder, "UPDATE images SET image = x'00' WHERE number = 1")
    assert library.repair().lost == ids[:1]
    assert library.add(exported)[1:] == ids[1:]
    assert library.touches("object = mug").columns["press"].tolist() == [3, 0]
    assert library.check().ok


@pytest.mark.parametrize("cell", ["nan", "inf", "1e5", "1_0", "9" * 5000, "9" * 400])
def test_odd_cells_are_only_text(library, cell):
    touches = _touches(session=[cell] * 6)
    assert library.add(touches) == library.add(touches)
    assert library.touches().session.tolist() == [cell] * 6


@pytest.mark.parametrize(
    "name",
    ["x\ny", "x\0", "\ud800", "\x7f", " ", "", 5, None, "tab\t", "...", "\u200b"],
)
def test_names_that_cannot_be_shown_are_refused(library, name):
    library.add(_touches())
    with pytest.raises(LibraryError, match="The name of an object must"):
        library.rename_object("a", name)
    assert [row.name for row in library.objects()] == ["a", "b", "c"]


def test_a_name_that_no_database_holds_is_unknown(library):
    library.add(_touches())
    for act in (
        lambda: library.rename_object("\ud800", "x"),
        lambda: library.merge_objects("a", "\ud800"),
        lambda: library.retract(object="\ud800", reason="x"),
    ):
        with pytest.raises(LibraryError, match="must be one in the library"):
            act()
    with pytest.raises(LibraryError, match="such as UTF-8 can hold"):
        library.no_contact("\ud800")
    with pytest.raises(ValueError, match="reason must be a text"):
        library.retract(object="a", reason="\ud800")


@pytest.mark.parametrize("name", ["it's", "a \"b\" 'c'", "''", "and", "5", "ツ = or"])
def test_any_name_can_be_asked_for(library, name):
    library.add(_touches(object=[name, "b", "c"] * 2))
    assert [r.object for r in library.list(f"object = {quoted(name)}")] == [name] * 2
    assert library.count(f"object != {quoted(name)}") == 4


def test_one_object_is_read_without_the_others(library, alter):
    """Images and columns of other touches may even be gone."""
    library.add(_touches()[[0, 3]])
    library.add(_touches(object=["d"] * 6, clicks=np.zeros((6, 9, 9))))
    alter(library.folder, "DELETE FROM images WHERE number > 2")
    assert len(library.list("object = a", limit=1)) == 1
    assert len(library.select("object = a").touches([0, 1])) == 2
    assert set(library.touches("object = a").columns) == {"object", "press"}
