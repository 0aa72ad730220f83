"""Model files: what they hold, and that a hostile one executes nothing."""

import pickle
from copy import copy

import numpy as np
import pytest
from forged_models import forged
from numpy.testing import assert_array_equal

from palpate import ObjectRecogniser
from palpate.recognition import ModelFileError, SequenceCalibration


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        3,
        0.1,
        float("inf"),
        "text",
        [1, [2.5, "a"]],
        (1, (2,)),
        {"a": 1, "b": [None]},
        SequenceCalibration(0.5, 0.25),
    ],
)
def test_plain_values_survive(reread, value):
    again = reread(value)
    assert again == value
    assert type(again) is type(value)


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3),
        np.float32(2) * np.ones((2, 2, 2), np.float32),
        np.array([True, False]),
        np.array(["pen", "gefäß"]),
        np.array(5),
        np.empty((0, 3)),
        np.arange(4, dtype=np.uint8),
        np.array([1 + 2j, -1j]),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    ],
    ids=lambda a: f"{a.dtype}{a.shape}",
)
def test_arrays_survive(reread, array):
    again = reread(array)
    assert_array_equal(again, array)
    assert again.dtype == array.dtype
    assert again.shape == array.shape


def test_what_is_not_on_the_list_is_refused_when_written(small_model, tmp_path):
    model = copy(small_model)
    with pytest.raises(ModelFileError, match=r"must end in \.palpate, got 'b.pkl'"):
        model.save(tmp_path / "b.pkl")
    with pytest.raises(ModelFileError, match="no folder"):
        model.save(tmp_path / "gone" / "b.palpate")
    model.value_ = {1, 2}
    with pytest.raises(ModelFileError, match="cannot hold a set"):
        model.save(tmp_path / "b.palpate")
    assert list(tmp_path.iterdir()) == []


def test_writing_replaces_in_one_step(small_model, tmp_path):
    model = copy(small_model)
    model.value_ = 1
    path = model.save(tmp_path / "b.palpate")
    model.value_ = object()
    with pytest.raises(ModelFileError, match="cannot hold"):
        model.save(path)
    assert ObjectRecogniser.load(path).value_ == 1
    assert [p.name for p in tmp_path.iterdir()] == ["b.palpate"]


def holding(**learnt):
    return {"class": "ObjectRecogniser", "params": {}, "learnt": learnt}


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({**holding(), "class": "Popen"}, "'Popen', which this palpate does not know"),
        ({**holding(), "class": "__import__"}, "does not know"),
        ({**holding(), "params": {"command": "ls"}}, "damaged.*argument 'command'"),
        (holding(__class__=1), "not a learnt attribute"),
        (holding(save=1), "not a learnt attribute"),
        (holding(a_={"array": "t9", "shape": [1]}), "damaged: 't9'"),
        (holding(a_={"float": "os.system('ls')"}), "damaged: could not convert"),
        (holding(a_={"text": ["a"], "shape": [7]}), "damaged: cannot reshape"),
        (holding(a_=[1]), "unexpected list"),
        (holding(a_={}), "damaged: 'class'"),
        ([1], "unexpected list"),
        ({}, "damaged: 'learnt'"),
    ],
)
def test_forged_content_is_refused(tmp_path, model, message):
    path = forged(tmp_path / "b.palpate", {"format": 4, "model": model}, {})
    with pytest.raises(ModelFileError, match=message):
        ObjectRecogniser.load(path)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"format": 99, "model": holding()}, "format 99, this palpate reads 4 to 6"),
        ("[" * 100_000 + "]" * 100_000, "damaged"),
    ],
    ids=["another version", "deep"],
)
def test_documents_of_another_kind_are_refused(tmp_path, document, message):
    with pytest.raises(ModelFileError, match=message):
        ObjectRecogniser.load(forged(tmp_path / "b.palpate", document, {}))


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", b"\x80\x04.", b"x" * 4096, pickle.dumps({"a": 1})]
)
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "b.palpate"
    path.write_bytes(content)
    with pytest.raises(ModelFileError, match=r"b\.palpate is no palpate model"):
        ObjectRecogniser.load(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ModelFileError, match="no model file"):
        ObjectRecogniser.load(tmp_path / "gone.palpate")
