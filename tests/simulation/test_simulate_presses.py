"""Sets of simulated presses: what they say, what fixes them, what is refused."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate.simulation import PressureArray, find_parts, simulate_presses

FORCE_N = 4 * 9.80665


def test_columns_of_a_set_of_presses_tell_what_was_pressed_and_how():
    touches = simulate_presses(n_presses=3, random_state=0)
    columns = touches.columns
    assert touches.images.shape == (36, 10, 10)
    assert touches.images.dtype == np.uint8
    assert touches.geometry == "array"
    names = [part.name for part in find_parts()]
    assert list(touches.object) == [name for name in names for _ in range(3)]
    assert list(columns["part"]) == [n for n in range(1, 13) for _ in range(3)]
    assert list(columns["press"][:6]) == [0, 1, 2, 0, 1, 2]
    assert columns["position_mm"].shape == columns["tilt_deg"].shape == (36, 2)
    assert np.abs(columns["position_mm"]).max() <= 1
    assert ((columns["angle_deg"] >= 0) & (columns["angle_deg"] < 360)).all()
    assert_allclose(columns["force_n"], FORCE_N)
    assert touches.images.reshape(36, -1).any(axis=1).all()


def test_a_column_row_is_enough_to_press_again():
    device = PressureArray(noise_kpa=0)
    touches = simulate_presses(3, 4, array=device, roughness_um=0, random_state=5)
    for touch in touches:
        (x, y), tilt = touch.columns["position_mm"][0], touch.columns["tilt_deg"][0]
        angle, force = touch.columns["angle_deg"][0], touch.columns["force_n"][0]
        image = device.press(3, x, y, angle, force / 9.80665, tilt_deg=tuple(tilt))
        # The load went to newtons and back: a rounding may tip over.
        assert np.abs(image - touch.images[0].astype(int)).max() <= 1


def test_same_seed_same_touches_and_seeds_differ():
    first, again = (simulate_presses([1, 7], 5, random_state=4) for _ in range(2))
    other = simulate_presses([1, 7], 5, random_state=5)
    assert_array_equal(first.images, again.images)
    assert (first.images != other.images).any()


@pytest.mark.slow
def test_processes_do_not_change_the_touches():
    alone = simulate_presses(n_presses=10, random_state=4)
    shared = simulate_presses(n_presses=10, random_state=4, n_jobs=2)
    assert_array_equal(alone.images, shared.images)


def test_loads_can_be_drawn_from_a_range():
    loads = simulate_presses(1, 50, load_kgf=(1, 5), random_state=0).columns["force_n"]
    assert 1 <= loads.min() / 9.80665 < 2
    assert 4 < loads.max() / 9.80665 <= 5


def test_progress_goes_to_standard_error_only(capsys, monkeypatch):
    clock = itertools.count(0, 10)  # ten seconds between any two looks at it
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    simulate_presses(1, 120, random_state=0, progress=True)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Pressing" in captured.err


@pytest.mark.parametrize(
    ("kwargs", "error", "message"),
    [
        ({"n_presses": 0}, ValueError, "n_presses must be at least 1"),
        ({"load_kgf": (5, 1)}, ValueError, "from low to high"),
        ({"load_kgf": (1, 2, 3)}, ValueError, r"one load or \(low, high\)"),
        ({"max_turn_deg": 200}, ValueError, "max_turn_deg must be finite and between"),
        ({"random_state": -1}, ValueError, "random_state must be at least 0"),
        ({"array": "10x10"}, TypeError, "array must be a PressureArray, got str"),
    ],
)
def test_impossible_sets_are_refused(kwargs, error, message):
    with pytest.raises(error, match=message):
        simulate_presses(**{"parts": 1, **kwargs})


def test_parts_are_checked_before_anything_is_pressed():
    with pytest.raises(ValueError, match="got 'nut'"):
        simulate_presses(["bar10", "nut"])


def test_sessions_of_an_array_differ_more_between_than_within():
    touches = simulate_presses(
        ["disc13"], 12, n_sessions=3, max_shift_mm=0, tilt_sd_deg=0, random_state=0
    )
    assert np.unique(touches.session).tolist() == [0, 1, 2]
    means = [touches.images[touches.session == s].mean(axis=0) for s in range(3)]
    within = [touches.images[touches.session == s][:2].mean(axis=0) for s in range(3)]
    between = np.abs(means[0] - means[1]).mean()
    assert between > 2 * np.abs(means[0] - within[0]).mean()
    alone = simulate_presses(["disc13"], 12, n_sessions=1, random_state=0)
    assert set(alone.session) == {0}
