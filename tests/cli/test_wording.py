"""Messages of the library in the words of the verb that was typed."""

from inspect import signature

import numpy as np
import pytest

from palpate import ObjectRecogniser
from palpate.library import LibraryError, TouchLibrary
from palpate.touches import Touches


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


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ["learn", "LIB", "-o", "x.palpate", "--where", "order = 9"],
            "got none. See `palpate library list`, and widen the filter.",
        ),
        (["library", "list", "GONE"], "Make one with `palpate library add`."),
        (["library", "list", "LIB", "--where", "order = ("], "--where must go on"),
    ],
)
def test_functions_in_a_message_are_named_as_commands(folder, palpate, words, text):
    places = {"LIB": str(folder), "GONE": str(folder / "gone")}
    assert text in palpate.refusal(*(places.get(word, word) for word in words))


@pytest.mark.parametrize(
    ("address", "text"),
    [
        ("serial:/dev/nowhere", "or --shape 16x16; --shape auto listens to it."),
        ("sim:bar10?shape=4x4", "10 x 10, got 4 x 4. Leave --shape out."),
        ("camera:0?baud=9", "'baud' is no option"),
    ],
)
def test_options_of_a_sensor_are_named_as_they_are_typed(palpate, address, text):
    result = palpate("live", "none.palpate", "--sensor", address, "--json")
    assert text in result.stdout.replace("\\n", " ")


def test_a_message_that_names_no_option_stays_as_it_is(palpate, tmp_path):
    result = palpate("learn", tmp_path / "gone.npz", "-o", tmp_path / "m.palpate")
    assert "--" not in result.stderr
    assert "gone.npz must be" in result.stderr


def test_units_are_left_out_and_variables_of_the_environment_are_options(
    palpate, tmp_path
):
    result = palpate("simulate", "array", "-o", tmp_path / "t.npz", "--pitch", "1e6")
    assert result.stderr.startswith("palpate: --pitch must make at most")
    model = tmp_path / "m.palpate"
    model.write_bytes(bytes(4000))
    result = palpate("recognise", model, "x.npz", "--max-model-mb", "0.001")
    assert "Set --max-model-mb higher." in result.stderr


@pytest.mark.parametrize("verb", ["recognise", "evaluate", "live", "serve"])
def test_the_default_of_strangers_is_that_of_python(palpate, verb):
    share = signature(ObjectRecogniser.start).parameters["strangers"].default
    help_text = palpate(verb, "-h").stdout.partition("--strangers")[2]
    assert f"[default: {share}]" in help_text[: help_text.index("--", 400)]


def test_what_a_file_lacks_is_no_option(palpate, tmp_path):
    np.savez(tmp_path / "t.npz", images=np.ones((2, 4, 4, 3)), object=["mug", "pen"])
    result = palpate("learn", tmp_path / "t.npz", "-o", tmp_path / "m.palpate")
    assert "t.npz: channels must name each of the 3 channels" in result.stderr


def test_touches_are_no_option_where_their_number_is_one(palpate, tmp_path):
    touches = Touches(np.eye(4)[None].repeat(8, 0), object=["mug"] * 8)
    touches.save(tmp_path / "mug.npz")
    words = "evaluate", "--train", tmp_path / "mug.npz", "--split", "last"
    result = palpate(*words, "--touches", "1")
    assert result.stderr.endswith(
        "palpate: touches must hold at least two object labels, got only 'mug'.\n"
    )
    result = palpate(*words, "--touches", "0")
    assert result.stderr == "palpate: --touches must be at least 1, got 0.\n"
