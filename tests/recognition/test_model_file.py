"""Model files: what they hold, and that a hostile one executes nothing."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from forged_models import forged
from numpy.testing import assert_array_equal

from palpate.recognition import ModelFileError, SequenceCalibration
from palpate.recognition._model_file import read_model, write_model


@dataclass
class Box:
    value: object = None


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
def test_plain_values_survive(tmp_path, value):
    path = write_model(tmp_path / "b.palpate", Box(value))
    assert read_model(path, Box) == Box(value)


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
def test_arrays_survive(tmp_path, array):
    path = write_model(tmp_path / "b.palpate", Box(array))
    again = read_model(path, Box).value
    assert_array_equal(again, array)
    assert again.dtype == array.dtype
    assert again.shape == array.shape


def test_what_is_not_on_the_list_is_refused_when_written(tmp_path):
    with pytest.raises(ModelFileError, match="cannot hold a set"):
        write_model(tmp_path / "b.palpate", Box({1, 2}))
    with pytest.raises(ModelFileError, match=r"must end in \.palpate, got 'b.pkl'"):
        write_model(tmp_path / "b.pkl", Box(1))
    with pytest.raises(ModelFileError, match="no folder"):
        write_model(tmp_path / "gone" / "b.palpate", Box(1))
    assert list(tmp_path.iterdir()) == []


def test_writing_replaces_in_one_step(tmp_path):
    path = write_model(tmp_path / "b.palpate", Box(1))
    with pytest.raises(ModelFileError, match="cannot hold"):
        write_model(path, Box(object()))
    assert read_model(path, Box) == Box(1)
    assert [p.name for p in tmp_path.iterdir()] == ["b.palpate"]


HOSTILE = {"class": "Box", "params": {"value": 1}, "learnt": {}}


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({**HOSTILE, "class": "Popen"}, "does not know"),
        ({**HOSTILE, "class": "__import__"}, "does not know"),
        ({**HOSTILE, "params": {"command": "ls"}}, "damaged"),
        ({**HOSTILE, "learnt": {"__class__": 1}}, "not a learnt attribute"),
        ({**HOSTILE, "learnt": {"save": 1}}, "not a learnt attribute"),
        ({"array": "t9", "shape": [1]}, "damaged"),
        ({"float": "os.system('ls')"}, "damaged"),
        ({"text": ["a"], "shape": [7]}, "damaged"),
        ([1], "unexpected list"),
        ({}, "damaged"),
    ],
)
def test_forged_content_is_refused(tmp_path, model, message):
    path = tmp_path / "b.palpate"
    with pytest.raises(ModelFileError, match=message):
        read_model(forged(path, {"format": 4, "model": model}, {}), Box)


def test_another_version_is_named(tmp_path):
    path = forged(tmp_path / "b.palpate", {"format": 99, "model": HOSTILE}, {})
    with pytest.raises(ModelFileError, match="format 99, this palpate reads 4 to 6"):
        read_model(path, Box)


def test_a_deep_document_is_refused(tmp_path):
    nested = "[" * 100_000 + "]" * 100_000
    with pytest.raises(ModelFileError, match="damaged"):
        read_model(forged(tmp_path / "b.palpate", nested, {}), Box)


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", b"\x80\x04.", b"x" * 4096, pickle.dumps({"a": 1})]
)
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "b.palpate"
    path.write_bytes(content)
    with pytest.raises(ModelFileError, match=r"b\.palpate"):
        read_model(path, Box)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ModelFileError, match="no model file"):
        read_model(tmp_path / "gone.palpate", Box)
