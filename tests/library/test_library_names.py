"""Names of objects: one spelling each, and nothing that a terminal would obey."""

import unicodedata

import numpy as np
import pytest

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary
from palpate.touches import TouchesError

NFC = unicodedata.normalize("NFC", "café")
NFD = unicodedata.normalize("NFD", "café")
IMAGES = np.zeros((2, 3, 3), np.uint8)
BAD = {
    "escape": "\x1b[2Jmug",
    "a terminal's own control": "\x9b2Jmug",
    "line break": "mug\n",
    "line separator": "mug\u2028",
    "NUL within": "m\0ug",
}


def test_two_spellings_are_one_object(tmp_path):
    assert NFC != NFD
    touches = Touches(IMAGES, object=[NFC, NFD], category=[NFD, NFD])
    assert [*touches.object] == [NFC, NFC]
    with TouchLibrary.open(tmp_path, create=True) as library:
        ids = library.add(touches)
        assert ids[0] == ids[1]
        assert library.add(Touches(IMAGES[:1], object=[NFD])) == ids[:1]
        assert [row.name for row in library.objects()] == [NFC]
        assert library.count(f"object = {NFD}") == 1
        library.rename_object(NFD, "mug")
        library.rename_object("mug", NFD)
        assert [row.name for row in library.objects()] == [NFC]
        assert library.check().ok


@pytest.mark.parametrize("name", BAD.values(), ids=BAD)
def test_a_name_that_no_terminal_should_print_is_refused(name, tmp_path):
    for column in ("object", "category"):
        with pytest.raises(
            TouchesError, match="must be of letters that can be printed"
        ):
            Touches(IMAGES, **{column: ["pen", name]})
    with TouchLibrary.open(tmp_path, create=True) as library:
        library.add(Touches(IMAGES, object=["pen", "cup"]))
        with pytest.raises(LibraryError, match="letters that can be printed"):
            library.rename_object("pen", name)


@pytest.mark.parametrize("given", [["pen", "mug\0"], ("pen", "mug\0")])
def test_a_trailing_nul_is_refused_rather_than_lost(given):
    """Numpy drops it without a word."""
    with pytest.raises(TouchesError, match="must be of letters that can be printed"):
        Touches(IMAGES, object=given)


def test_other_scripts_and_emoji_are_names():
    names = ["杯子", "👩‍🔧"]
    assert [*Touches(IMAGES, object=names).object] == names
