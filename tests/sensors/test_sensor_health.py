"""Each fault that is put into a sensor is found, and nothing else."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate import sensors
from palpate.recognition import ObjectRecogniser
from palpate.sensors import SensorError, SensorMemory
from palpate.touches import Touches

health = sensors.sensor_health


def frames(rng, n=600, shape=(10, 10), noise=2.0, rate_hz=50.0, dtype=np.int16):
    """Frames of a sensor that is well: white noise about offsets of its taxels."""
    offsets = rng.uniform(90, 110, shape)
    images = np.rint(offsets + rng.normal(scale=noise, size=(n, *shape)))
    return images.astype(dtype), np.arange(n) / rate_hz


def as_frames(images, times):
    return [
        sensors.Frame(i, t, n)
        for n, (i, t) in enumerate(zip(images, times, strict=True))
    ]


def findings(report):
    return " ".join(report["findings"])


def test_a_sensor_that_is_well_has_no_finding(rng):
    images, times = frames(rng)
    report = health(as_frames(images, times))
    assert report["ok"]
    assert report["findings"] == []
    figures = report["figures"]
    # White noise of 2 and rounding (1/12 in variance): 2.02; 600 frames tell it to 3 %.
    assert figures["noise"] == pytest.approx(2.02, rel=0.05)
    assert figures["rate_hz"] == pytest.approx(50)
    assert figures["interval_99_ms"] == pytest.approx(20)
    assert figures["frames"] == 600
    assert figures["drift"] < 0.2
    assert figures["lost"] == 0
    assert abs(figures["shared_by_rows"]) < 0.05


def test_three_dead_taxels_are_named_first(rng):
    images, times = frames(rng)
    for row, col in ((0, 3), (4, 4), (9, 9)):
        images[:, row, col] = 100
    report = health(as_frames(images, times))
    assert report["dead"] == [[0, 3], [4, 4], [9, 9]]
    assert report["findings"][0].startswith("3 taxels (row 0 column 3, row 4 column 4,")
    assert len(report["findings"]) == 1


def test_taxels_that_are_nan_are_dead(rng):
    images, times = frames(rng, dtype=np.float32)
    images[:, 2, 5] = np.nan
    report = health(as_frames(images, times))
    assert report["dead"] == [[2, 5]]
    assert np.isfinite(report["figures"]["noise"])
    # Unplugged: one finding, no warnings of numpy's, and no figure of nothing.
    memory = sensors.SensorMemory.of(images[:3] + 5.0, images[0])
    images[:] = np.nan
    report = health(as_frames(images, times), memory=memory)
    assert [finding[:10] for finding in report["findings"]] == ["100 taxels"]
    # A reading that failed makes no taxel dead.
    images, times = frames(rng, dtype=np.float32)
    images[[3, 100]] = np.nan
    report = health(as_frames(images, times))
    (finding,) = report["findings"]
    assert finding.startswith(f"2 of {len(images)} frames are NaN alone")
    assert report["dead"] == []
    assert np.isfinite(report["figures"]["noise"])
    # Nor do a few, each of another taxel; of one in over 1 % of frames they do.
    images, times = frames(rng, dtype=np.float32)
    images[np.arange(100), np.repeat(np.arange(10), 10), np.tile(np.arange(10), 10)] = (
        np.nan
    )
    images[::50, 4, 4] = np.nan
    report = health(as_frames(images, times))
    assert report["dead"] == [[4, 4]]
    (finding,) = report["findings"]
    assert "(row 4 column 4) never change or lack readings: dead, loose" in finding
    assert np.isfinite(report["rest"]).all()
    assert report["figures"]["noise"] == pytest.approx(2.02, rel=0.05)


def test_hot_and_saturated_taxels_are_told_apart(rng):
    images, times = frames(rng, dtype=np.uint8)
    images[:, 1, 1] = 255
    images[:, 2, 2] = np.clip(100 + rng.normal(scale=40, size=600), 0, 254)
    report = health(as_frames(images, times))
    assert report["saturated"] == [[1, 1]]
    assert report["hot"] == [[2, 2]]
    assert "saturated" in report["findings"][0]
    assert report["dead"] == []


def test_a_steady_drift_is_measured_beside_the_noise(rng):
    """A steady way up by 40 over all: twelfths differ by 11/12 of it."""
    images, times = frames(rng)
    ramp = np.linspace(0, 40, len(images))[:, None, None]
    report = health(as_frames(np.rint(images + ramp).astype(np.int16), times))
    assert report["figures"]["drift"] == pytest.approx(40 * 11 / 12, rel=0.01)
    assert report["figures"]["noise"] == pytest.approx(2.02, rel=0.05)
    assert "Rest drifted by 36." in report["findings"][0]
    assert report["levels"][-1] == pytest.approx(40 * 11 / 12, rel=0.01)
    assert not report["ok"]


def test_rest_that_does_not_move_has_no_drift():
    # The mean of 150 times 0.1 is 0.1 less a rounding error, of 40 times it is another.
    times = np.arange(590) / 50
    report = health(as_frames(np.full((590, 6, 6), 0.1), times))
    assert report["findings"] == []
    assert report["figures"]["drift"] == 0


def test_a_baseline_under_load_is_named_with_its_place(rng):
    images, times = frames(rng, noise=1.0)
    images[:, 3:7, 3:7] += 200
    report = health(as_frames(images, times))
    assert "may press the sensor around row 4 column 4" in report["findings"][0]


def test_hum_of_the_mains_is_no_press(rng):
    """1000 frames a second of an array that hums with 50 Hz by 6 counts."""
    images, times = frames(rng, noise=1.0, rate_hz=1000.0)
    hum = np.rint(6 * np.cos(2 * np.pi * 50 * times)).astype(np.int16)
    report = health(as_frames(images + hum[:, None, None], times))
    assert "still changing" not in findings(report)
    assert "unsteady supply" in findings(report)
    assert len(report["findings"]) == 1


def test_rest_that_differs_from_what_a_model_remembers_is_named(rng):
    images, times = frames(rng)
    rest = images.mean(axis=0)
    presses = rest + rng.uniform(0, 40, (12, 10, 10))
    memory = sensors.SensorMemory.of(presses, rest)
    assert health(as_frames(images, times), memory=memory)["ok"]
    other = sensors.SensorMemory.of(presses, rest - 30)
    report = health(as_frames(images, times), memory=other)
    message = "At rest the sensor differs from when the model learnt"
    assert message in report["findings"][0]
    smaller = sensors.SensorMemory.of(presses[:, :4], rest[:4])
    report = health(as_frames(images, times), memory=smaller)
    message = "learnt from a sensor of 4 x 10 taxels, this one has"
    assert message in report["findings"][0]


def test_a_touch_meanwhile_is_the_only_finding(rng):
    images, times = frames(rng)
    images[300:320, 4:6, 4:6] += 300
    [finding] = health(as_frames(images, times))["findings"]
    assert "Rest left its baseline 1 times and came back: something touched" in finding


def test_numbers_coarser_than_noise_tell_of_no_dead_taxel():
    images = np.zeros((100, 4, 4), np.uint8)
    images[::2, 0, 0] = 1
    assert health(as_frames(images, np.arange(100) / 50))["dead"] == []


@pytest.mark.parametrize(("times_typical", "hot"), [(5.0, False), (7.5, True)])
def test_hot_is_over_six_times_as_noisy_as_others(rng, times_typical, hot):
    images, times = frames(rng, n=900, dtype=np.float64)
    images[:, 2, 2] = 100 + rng.normal(scale=2.02 * times_typical, size=900)
    assert health(as_frames(images, times))["hot"] == ([[2, 2]] if hot else [])


@pytest.mark.parametrize(("rho", "reported"), [(0.2, False), (0.4, True), (0.8, True)])
def test_noise_is_crosstalk_where_rows_share_a_third_of_it(rng, rho, reported):
    images, times = frames(rng, n=900, noise=2.0, dtype=np.float64)
    shared = 4.08 * rho / (1 - rho)  # variance: 4 and that of rounding
    images = images + rng.normal(scale=shared**0.5, size=(900, 10, 1))
    report = health(as_frames(images, times))
    assert report["figures"]["shared_by_rows"] == pytest.approx(rho, abs=0.05)
    assert abs(report["figures"]["shared_by_columns"]) < 0.1
    assert ("Rows share" in findings(report)) == reported
    assert ("crosstalk" in findings(report)) == reported


@pytest.mark.parametrize(("late_ms", "reported"), [(55, False), (65, True)])
def test_one_frame_in_a_hundred_is_late_at_three_times_the_usual(
    rng, late_ms, reported
):
    images, _ = frames(rng)
    gaps = np.full(600, 0.02)
    gaps[::30] = late_ms / 1000
    report = health(as_frames(images, np.cumsum(gaps)))
    late = f"comes {late_ms} ms after the last, usually 20: something holds it up"
    assert (late in findings(report)) == reported


def test_frames_that_a_port_hands_on_together_have_their_rate(rng):
    """Eight of 500 a second every 16 ms, read within 10 us of each other."""
    images, _ = frames(rng)
    bursts, places = np.divmod(np.arange(600), 8)
    report = health(as_frames(images, bursts * 0.016 + places * 1e-5))
    assert report["figures"]["rate_hz"] == pytest.approx(500, rel=0.01)
    assert "comes 16 ms after the last, usually 2:" in findings(report)


@pytest.mark.parametrize(("n_lost", "reported"), [(5, False), (8, True)])
def test_one_frame_in_a_hundred_may_be_lost(rng, n_lost, reported):
    images, times = frames(rng)
    lost = set(range(20, 20 + 10 * n_lost, 10))
    arrived = [frame for frame in as_frames(images, times) if frame.number not in lost]
    report = health(arrived)
    assert report["figures"]["lost"] == pytest.approx(n_lost / 600)
    assert ("1.3 % of the frames are lost" in findings(report)) == reported


def test_a_check_needs_two_frames_for_each_twelfth(rng):
    images, times = frames(rng, n=24)
    health(as_frames(images, times))
    with pytest.raises(SensorError, match="needs 24 frames, got 23"):
        health(as_frames(images, times)[:-1])


def test_the_noise_is_what_neighbours_differ_by_over_the_root_of_two():
    """Frames of 100 and 102 in turn: each pair differs by 2."""
    images = np.full((24, 3, 3), 100.0)
    images[1::2] += 2
    report = health(as_frames(images, np.arange(24) / 50))
    assert report["figures"]["noise"] == pytest.approx(2 / np.sqrt(2))
    assert report["noise"].shape == (3, 3)
    assert report["rest"] == pytest.approx(np.full((3, 3), 101.0))


def test_chance_is_no_drift(rng):
    """Means of 2 frames differ by chance by as much as the noise; that is taken off.

    Over many sensors the square of the drift that is left is 0 in the mean.
    """
    squares = []
    for _ in range(60):
        images = rng.normal(scale=2.0, size=(24, 8, 8)) + 100
        report = health(as_frames(images, np.arange(24) / 50))
        squares.append(report["figures"]["drift"] ** 2)
    # The mean square of 64 taxels has a spread of 4 (2 / 64)^0.5 = 0.7; half of them,
    # those below 0, count as 0: their mean is 0.7 / sqrt(2 pi) = 0.28.
    assert np.mean(squares) < 0.6
    assert 0.2 < np.mean(np.array(squares) == 0) < 0.8


@pytest.fixture
def presses(rng):
    """Sixty presses of 6 x 6 taxels at random places, about 1 everywhere on average."""
    return rng.gamma(4.0, 0.25, size=(60, 6, 6))


def test_the_share_of_each_taxel_is_remembered():
    rest = np.full((2, 2), 10.0)
    images = rest + np.array([[[4, 0], [0, 0]], [[0, -2], [0, -2]]])
    memory = SensorMemory.of(images, rest)
    # Changes: 4 / 2 of four taxels, and 2 sqrt(2) / 2; shares 1 and twice a half.
    assert memory.touch_change == pytest.approx((2 + np.sqrt(2)) / 2)
    assert_allclose(memory.response, [[0.5, 0.25], [0, 0.25]])
    assert_allclose(memory.response_var, [[0.125, 0.03125], [0, 0.03125]])
    assert memory.n_touches == 2
    still = SensorMemory.of([rest], rest)
    assert_allclose(still.response, 0)
    large = SensorMemory.of([np.ones((65, 64))], np.zeros((65, 64)))
    assert large.response.shape == (0, 0)


@pytest.mark.parametrize("harder", [1, 5])
def test_the_same_sensor_is_not_accused(presses, harder):
    before = SensorMemory.of(presses[:30], np.zeros((6, 6)))
    assert before.gain_warning(presses[30:] * harder, np.zeros((6, 6))) == ""
    assert before.baseline_warning(np.zeros((6, 6))) == ""
    # Nor is a taxel whose reading failed once, before or now; one that is dead is.
    failed = presses.copy()
    failed[[3, 40], 2, [1, 4]] = np.nan
    before = SensorMemory.of(failed[:30], np.zeros((6, 6)))
    assert before.gain_warning(failed[30:] * harder, np.zeros((6, 6))) == ""
    failed[30:, 2, 4] = np.nan
    assert "row 2 column 4." in before.gain_warning(failed[30:], np.zeros((6, 6)))


@pytest.mark.parametrize("gain", [0.0, 0.3, 4.0])
def test_a_taxel_whose_gain_has_left_tolerance_is_named(presses, gain):
    before = SensorMemory.of(presses[:30], np.zeros((6, 6)))
    faded = presses[30:].copy()
    faded[:, 2, 4] *= gain
    warning = before.gain_warning(faded, np.zeros((6, 6)))
    assert "row 2 column 4." in warning


@pytest.mark.parametrize(
    ("times", "n_touches", "reported"),
    [(1.9, 40, False), (2.2, 40, True), (1 / 2.2, 40, True), (2.2, 9, False)],
)
def test_a_taxel_that_answers_twice_as_much_is_named(times, n_touches, reported, rng):
    rest = np.zeros((4, 4))
    images = 10 + rng.normal(scale=0.1, size=(n_touches, 4, 4))
    before = SensorMemory.of(images, rest)
    other = images.copy()
    other[:, 1, 2] *= times
    # All shares sum to 1: one that doubles lessens the others by a sixteenth.
    warning = before.gain_warning(other, rest)
    assert ("row 1 column 2" in warning) == reported
    assert before.gain_warning(images, rest) == ""


def test_a_baseline_is_judged_by_what_touches_change(presses):
    memory = SensorMemory.of(presses, np.zeros((6, 6)))
    rms = np.median(np.sqrt((presses**2).mean((1, 2))))
    assert memory.touch_change == pytest.approx(rms)
    assert memory.baseline_warning(np.full((6, 6), 0.24 * rms)) == ""
    assert "by 26 % of what" in memory.baseline_warning(np.full((6, 6), 0.26 * rms))
    other = memory.baseline_warning(np.zeros((5, 5)))
    assert "6 x 6 taxels, this one has 5 x 5" in other


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
    warning = before.gain_warning(faded, rest)
    assert warning.count("row") == 1
    assert "row 2 column 4." in warning
    grey = before.baseline_warning(rest[..., 0])
    assert "6 x 6 x 3 taxels, this one has 6 x 6 taxels." in grey
