"""Calibration of arrays whose gains, dead zones and saturation are known."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.exceptions import NotFittedError

from palpate.images import TaxelCalibration

KPA = 6.894757293168361  # 1 psi: pound-force (0.45359237 kg x 9.80665) per square inch
LOADS_PSI = np.repeat([0, 5, 10, 20, 40, 80, 160, 240, 320, 400, 480, 580, 650, 700], 5)


@pytest.fixture
def gains(rng):
    return np.exp(rng.normal(0, 0.1, (6, 5))) * 1e-3


def respond(pressure_kpa, gains, rng=None, *, rest=0.02, dead=0.0, top=np.inf):
    """Readings of taxels that start at `dead` and stop at `top`, in kPa."""
    pressure = np.asarray(pressure_kpa, dtype=float)[:, None, None]
    readings = rest + gains * (np.clip(pressure, dead, top) - dead)
    if rng is not None:
        readings = readings + rng.normal(0, 0.004, readings.shape)
    return readings


def test_straight_lines_are_found_exactly(gains):
    loads = np.array([10.0, 100, 300, 580])
    calibration = TaxelCalibration().fit(respond(loads, gains), loads)
    assert_allclose(calibration.gain_, gains, rtol=1e-9)
    assert_allclose(calibration.offset_, 0.02, atol=1e-9)
    assert not calibration.dead_.any()
    assert_array_equal(calibration.dead_zone_kpa_, 0)
    assert np.isinf(calibration.saturation_kpa_).all()
    new = np.array([33.0, 444.0])
    pressure = calibration.transform(respond(new, gains))
    assert_allclose(pressure, np.broadcast_to(new[:, None, None], pressure.shape))


@pytest.mark.parametrize(
    ("unit", "kpa"), [("psi", KPA), ("kPa", 1.0), ("Pa", 1e-3), ("bar", 100.0)]
)
def test_loads_are_converted_to_kpa(unit, kpa, gains):
    loads = np.array([1.0, 2.0, 5.0])
    frames = respond(loads * kpa, gains)
    calibration = TaxelCalibration(load_unit=unit).fit(frames, loads)
    assert_allclose(calibration.transform(frames)[:, 0, 0], loads * kpa)
    assert calibration.highest_load_kpa_ == pytest.approx(5 * kpa)


def test_dead_zone_and_saturation_are_found_and_flagged(gains, rng):
    dead, top = 10 * KPA, 590 * KPA
    frames = respond(LOADS_PSI * KPA, gains, rng, dead=dead, top=top)
    calibration = TaxelCalibration("psi").fit(frames, LOADS_PSI)
    # Noise of 0.004 is 0.6 psi, and the ends are put three sd inside the noise.
    assert_allclose(calibration.dead_zone_kpa_ / KPA, 11.7, atol=2.5)
    assert_allclose(calibration.saturation_kpa_ / KPA, 588, atol=4)
    probe = respond(np.array([0, 300, 900]) * KPA, gains, dead=dead, top=top)
    assert_array_equal(
        calibration.out_of_range(probe)[:, 0, 0], np.array([-1, 0, 1], dtype=np.int8)
    )
    pressure = calibration.transform(probe) / KPA
    assert_array_equal(pressure[0], 0)
    assert_allclose(pressure[1], 300, atol=3)
    assert_allclose(pressure[2], calibration.saturation_kpa_ / KPA)


def test_a_threshold_that_jumps_is_a_dead_zone_too(gains):
    loads = LOADS_PSI * KPA
    frames = respond(loads, gains)
    frames[loads < 15 * KPA] = 0.02
    calibration = TaxelCalibration("psi").fit(frames, LOADS_PSI)
    assert_allclose(calibration.dead_zone_kpa_ / KPA, 10)
    assert_allclose(calibration.gain_, gains, rtol=1e-6)


def test_straight_noisy_lines_get_no_flat_ends(gains, rng):
    loads = np.repeat(np.linspace(10, 580, 10), 3)
    calibration = TaxelCalibration("psi").fit(respond(loads * KPA, gains, rng), loads)
    assert_array_equal(calibration.dead_zone_kpa_, 0)
    assert np.isinf(calibration.saturation_kpa_).all()


def test_above_the_highest_load_is_extrapolated_and_flagged(gains):
    loads = np.array([10.0, 100, 300])
    calibration = TaxelCalibration().fit(respond(loads, gains), loads)
    beyond = respond([400.0], gains)
    assert_allclose(calibration.transform(beyond), 400)
    assert (calibration.out_of_range(beyond) == 1).all()
    assert not calibration.out_of_range(respond(loads, gains)).any()


def test_bad_frames_do_little_harm(gains, rng):
    frames = respond(LOADS_PSI * KPA, gains, rng)
    clean = TaxelCalibration("psi").fit(frames, LOADS_PSI)
    spoiled = frames.copy()
    spoiled[::9] *= rng.uniform(0, 3, (len(frames[::9]), 1, 1))
    robust = TaxelCalibration("psi").fit(spoiled, LOADS_PSI)
    # A least-squares line is off by 2 % and more here (checked below).
    assert_allclose(robust.gain_, clean.gain_, rtol=0.005)
    line = np.polyfit(LOADS_PSI * KPA, spoiled[:, 0, 0], 1)[0]
    assert abs(line / clean.gain_[0, 0] - 1) > 0.02


def test_taxels_that_do_not_follow_are_dead(gains, rng):
    frames = respond(LOADS_PSI * KPA, gains, rng)
    frames[:, 0, 0] = np.nan
    frames[:, 1, 1] = 0.7
    frames[:, 2, 2] = rng.random(len(frames))
    frames[:, 3, 3] = frames[::-1, 3, 3]
    frames[:, 4, 4] = respond(LOADS_PSI * KPA, 0.02 * gains, rng)[:, 4, 4]
    calibration = TaxelCalibration("psi").fit(frames, LOADS_PSI)
    assert_array_equal(
        np.argwhere(calibration.dead_), [[0, 0], [1, 1], [2, 2], [3, 3], [4, 4]]
    )
    pressure = calibration.transform(frames)
    assert_array_equal(np.isnan(pressure).any(axis=0), calibration.dead_)
    assert not calibration.out_of_range(frames)[:, 0, 0].any()


def test_an_unread_taxel_stays_unknown(gains):
    loads = np.array([10.0, 100, 300])
    frames = respond(loads, gains)
    calibration = TaxelCalibration().fit(frames, loads)
    frames[1, 2, 3] = np.nan
    assert_array_equal(
        np.argwhere(np.isnan(calibration.transform(frames))), [[1, 2, 3]]
    )


def test_resistances_are_inverted(gains):
    loads = np.array([10.0, 100, 300, 580])
    conductance = respond(loads, gains)
    calibration = TaxelCalibration(quantity="resistance").fit(1 / conductance, loads)
    assert_allclose(calibration.gain_, gains, rtol=1e-9)
    assert_allclose(calibration.transform(1 / conductance)[:, 2, 2], loads)
    with pytest.raises(ValueError, match="Resistances must be positive"):
        calibration.transform(conductance * 0)


def test_a_slow_ramp_of_many_loads_is_enough(gains, rng):
    loads = np.linspace(0, 580, 400)
    calibration = TaxelCalibration("psi").fit(respond(loads * KPA, gains, rng), loads)
    assert_allclose(calibration.gain_, gains, rtol=0.01)


def test_integer_counts_are_accepted(gains):
    loads = np.linspace(0, 580, 12)
    counts = np.rint(50 * respond(loads * KPA, gains)).astype(np.uint8)
    calibration = TaxelCalibration("psi").fit(counts, loads)
    # Half a count of rounding is 1.45 psi.
    assert_allclose(calibration.transform(counts)[-1] / KPA, 580, atol=5)


def test_a_file_keeps_the_whole_calibration(gains, rng, tmp_path):
    frames = respond(LOADS_PSI * KPA, gains, rng, dead=70, top=4000)
    frames[:, 1, 1] = 0.5
    calibration = TaxelCalibration("psi", least_gain=0.2).fit(frames, LOADS_PSI)
    path = tmp_path / "array.json"
    calibration.save(path)
    again = TaxelCalibration.load(path)
    assert again.get_params() == calibration.get_params()
    assert_array_equal(again.transform(frames), calibration.transform(frames))
    assert_array_equal(again.out_of_range(frames), calibration.out_of_range(frames))
    text = path.read_text(encoding="utf-8")
    assert "NaN" not in text
    assert "Infinity" not in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "recipe"}, '"format" is not'),
        ({"version": 99}, "version is 99"),
        ({"gain": [[1.0]]}, "gain is not of shape"),
        ({"gain": "high"}, "while reading"),
        ({"gain": [[None, 1.0], [1.0, 1.0]]}, "gain lacks values"),
        ({"gain": [[-1.0, 1.0], [1.0, 1.0]]}, "gain must be positive"),
        ({"gain": [[np.inf, 1.0], [1.0, 1.0]]}, "gain lacks values"),
        ({"dead_zone_kpa": [[np.inf, 0.0], [0.0, 0.0]]}, "dead_zone_kpa lacks"),
        ({"dead": [["no", "no"], ["no", "no"]]}, "dead must be true or false"),
        ({"highest_load_kpa": 10**400}, "while reading"),
        ({"params": {"unit": "kPa"}}, "Invalid parameter 'unit'"),
        ({"dead": None}, "dead is not of shape"),
        ({"params": None}, "while reading"),
    ],
)
def test_damaged_files_are_refused(change, message, tmp_path):
    loads = np.array([1.0, 2.0, 3.0])
    calibration = TaxelCalibration().fit(respond(loads, np.ones((2, 2))), loads)
    path = tmp_path / "array.json"
    calibration.save(path)
    content = json.loads(path.read_text(encoding="utf-8")) | change
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        TaxelCalibration.load(path)


@pytest.mark.parametrize(
    ("params", "loads", "message"),
    [
        ({}, [1.0, 2.0], "one entry for each of 3 frames"),
        ({}, [1.0, 2.0, -3.0], "at least 0"),
        ({}, [1.0, 2.0, np.nan], "finite"),
        ({}, [1.0, 1.0, 2.0], "three different loads, got 2"),
        ({"load_unit": "N"}, [1.0, 2.0, 3.0], "load_unit must be one of"),
        ({"quantity": "voltage"}, [1.0, 2.0, 3.0], "quantity must be one of"),
        ({"least_gain": 2}, [1.0, 2.0, 3.0], "between 0 and 1"),
    ],
)
def test_bad_loads_and_parameters_are_refused(params, loads, message):
    with pytest.raises(ValueError, match=message):
        TaxelCalibration(**params).fit(np.ones((3, 2, 2)), loads)


def test_unanswering_unfitted_and_misfit_are_refused(gains):
    loads = np.array([10.0, 100, 300])
    frames = respond(loads, gains)
    with pytest.raises(ValueError, match="readings rise with the load"):
        TaxelCalibration().fit(frames[::-1], loads)
    with pytest.raises(NotFittedError):
        TaxelCalibration().transform(frames)
    calibration = TaxelCalibration().fit(frames, loads)
    with pytest.raises(ValueError, match="fitted on 6 x 5"):
        calibration.transform(frames[:, :5])


def test_what_is_no_calibration_file_is_named_with_what_to_do(tmp_path):
    path = tmp_path / "array.json"
    for text in ("not json", "[" * 100_000):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=r"it is not JSON.*Calibrate"):
            TaxelCalibration.load(path)
    with pytest.raises(FileNotFoundError, match=r"got .*none\.json: .*Check the path"):
        TaxelCalibration.load(tmp_path / "none.json")
    with pytest.raises(IsADirectoryError, match="path must name a calibration"):
        TaxelCalibration.load(tmp_path)
