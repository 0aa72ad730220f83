"""`import palpate` loads none of the heavy libraries."""

import subprocess
import sys

import pytest

HEAVY = "{'sklearn', 'cv2', 'matplotlib', 'PIL', 'rich'}"


def test_import_loads_nothing_heavy():
    code = f"import palpate, sys; print(sorted({HEAVY} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_names_are_loaded_when_they_are_used():
    import palpate

    assert set(palpate.__all__) <= set(dir(palpate))
    for name in palpate.__all__:
        assert getattr(palpate, name) is not None
    assert palpate.recognition.ObjectRecogniser is palpate.ObjectRecogniser
    with pytest.raises(
        AttributeError, match="No palpate attribute nothing_of_that_name"
    ):
        _ = palpate.nothing_of_that_name


def test_names_of_recognition_are_loaded_when_they_are_used():
    code = (
        "import sys, palpate.recognition as room\n"
        "heavy = {'numpy', 'sklearn', 'cv2', 'scipy'}\n"
        "assert not heavy & {*sys.modules}, heavy & {*sys.modules}\n"
        "assert {*room.__all__} <= {*dir(room)}\n"
        "for name in dir(room): assert getattr(room, name) is not None, name\n"
        "assert 'sklearn' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
