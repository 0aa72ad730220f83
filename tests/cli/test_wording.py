"""Messages of the library in the words of the verb that was typed."""

from inspect import signature

import numpy as np
import pytest

from palpate import ObjectRecogniser
from palpate.library import LibraryError, TouchLibrary
from palpate.touches import Touches

from .conftest import drawn


@pytest.fixture
def folder(tmp_path):
    touches = Touches(np.ones((1, 4, 4)), object=["mug"])
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        library.add(touches)
    return tmp_path / "lab"


def test_a_name_is_an_argument_in_python_and_an_option_when_typed(folder, palpate):
    with (
        TouchLibrary.open(folder) as library,
        pytest.raises(LibraryError, match=r"^where must name columns"),
    ):
        library.touches("objekt = 3")
    result = palpate.refusal("library", "list", folder, "--where", "objekt = 3")
    assert result.startswith("palpate: --where must name columns")


def test_a_message_that_names_no_option_stays_as_it_is(palpate, tmp_path):
    words = ("learn", tmp_path / "gone.npz", "-o", tmp_path / "m.palpate")
    refused = palpate.refusal(*words)
    assert "--" not in refused
    assert "gone.npz must be" in refused


@pytest.mark.parametrize("verb", ["recognise", "evaluate", "live", "serve"])
def test_the_default_of_strangers_is_that_of_python(palpate, verb):
    share = signature(ObjectRecogniser.start).parameters["strangers"].default
    help_text = palpate(verb, "-h").stdout.partition("--strangers")[2]
    assert f"[default: {share}]" in help_text[: help_text.index("--", 400)]


def test_what_a_file_lacks_is_no_option(palpate, tmp_path):
    np.savez(tmp_path / "t.npz", images=np.ones((2, 4, 4, 3)), object=["mug", "pen"])
    words = ("learn", tmp_path / "t.npz", "-o", tmp_path / "m.palpate")
    refused = palpate.refusal(*words)
    assert "t.npz: channels must name each of the 3 channels" in refused


def test_touches_are_no_option_where_their_number_is_one(palpate, tmp_path):
    drawn(0, ("mug",), 8).save(tmp_path / "mug.npz")
    words = "evaluate", "--train", tmp_path / "mug.npz", "--split", "last", "--touches"
    refused = palpate.refusal(*words, "1")
    only_one = "touches must hold at least two object labels, got only 'mug'."
    assert refused.endswith(f"palpate: {only_one}\n")
    refused = palpate.refusal(*words, "0")
    assert refused == "palpate: --touches must be at least 1, got 0.\n"
