"""A sensor that stays, one whose baseline moves, one whose taxel fades."""

import numpy as np
import pytest

from palpate.recognition import ObjectRecogniser
from palpate.sensors import SensorMemory, baseline_warning, gain_warning
from palpate.touches import Touches


@pytest.fixture
def presses(rng):
    """Sixty presses of 6 x 6 taxels at random places, about 1 everywhere on average."""
    return rng.gamma(4.0, 0.25, size=(60, 6, 6))


def test_the_same_sensor_is_not_accused(presses):
    before = SensorMemory.of(presses[:30], np.zeros((6, 6)))
    after = SensorMemory.of(presses[30:], np.zeros((6, 6)))
    assert gain_warning(before, after) == ""
    assert baseline_warning(before, np.zeros((6, 6))) == ""


def test_pressing_harder_is_no_drift(presses):
    before = SensorMemory.of(presses[:30], np.zeros((6, 6)))
    after = SensorMemory.of(presses[30:] * 5, np.zeros((6, 6)))
    assert gain_warning(before, after) == ""


@pytest.mark.parametrize("gain", [0.0, 0.3, 4.0])
def test_a_taxel_whose_gain_has_left_tolerance_is_named(presses, gain):
    before = SensorMemory.of(presses[:30], np.zeros((6, 6)))
    faded = presses[30:].copy()
    faded[:, 2, 4] *= gain
    warning = gain_warning(before, SensorMemory.of(faded, np.zeros((6, 6))))
    assert "row 2 column 4." in warning


def test_a_few_touches_accuse_nobody(presses):
    few = presses[:5].copy()
    few[:, 0, 0] = 0
    before = SensorMemory.of(presses, np.zeros((6, 6)))
    assert gain_warning(before, SensorMemory.of(few, np.zeros((6, 6)))) == ""


def test_a_baseline_is_judged_by_what_touches_change(presses):
    memory = SensorMemory.of(presses, np.zeros((6, 6)))
    rms = np.median(np.sqrt((presses**2).mean((1, 2))))
    assert memory.touch_change == pytest.approx(rms)
    assert baseline_warning(memory, np.full((6, 6), 0.24 * rms)) == ""
    assert "by 26% of what" in baseline_warning(memory, np.full((6, 6), 0.26 * rms))
    assert "6 x 6 taxels, this one has 5 x 5" in baseline_warning(
        memory, np.zeros((5, 5))
    )


def test_a_model_file_remembers_its_sensor(presses, tmp_path):
    touches = Touches(presses, object=["a"] * 30 + ["b"] * 30, geometry="none")
    recogniser = ObjectRecogniser().fit(touches)
    memory = SensorMemory.of(presses, np.ones((6, 6)))
    recogniser.remember_sensor(memory.to_dict())
    recogniser.save(tmp_path / "model.palpate")
    stored = ObjectRecogniser.load(tmp_path / "model.palpate").memory_.sensor
    again = SensorMemory.from_dict(stored)
    assert again.touch_change == memory.touch_change
    assert np.array_equal(again.response, memory.response)


def test_a_taxel_that_fades_in_colour_is_named_once(presses):
    colour, rest = presses[..., np.newaxis] * [1.0, 0.5, 0.2], np.zeros((6, 6, 3))
    before, faded = SensorMemory.of(colour[:30], rest), colour[30:].copy()
    faded[:, 2, 4] = 0
    warning = gain_warning(before, SensorMemory.of(faded, rest))
    assert warning.count("row") == 1
    assert "row 2 column 4." in warning
    assert "6 x 6 x 3 taxels, this one has 6 x 6 taxels." in baseline_warning(
        before, rest[..., 0]
    )
