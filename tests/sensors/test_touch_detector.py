"""Touches in streams whose touches are known."""

import re
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.sensors import ContactError, Frame, SensorError, TouchDetector

REST = np.full((4, 4), 100, np.uint8)


def touches_in(detector, images):
    """Update the detector with images, ten a second; return the touches it tells."""
    results = (
        detector.update(Frame(np.asarray(image), number / 10, number))
        for number, image in enumerate(images)
    )
    return [touch for touch in results if touch is not None]


def touches_of(detector, levels, zero=REST):
    """Return the touches of frames that are `level` above the baseline everywhere."""
    images = ((zero.astype(float) + level).astype(zero.dtype) for level in levels)
    return touches_in(detector, images)


def test_one_touch_is_its_frame_of_greatest_change():
    (touch,) = touches_of(TouchDetector(REST), [0, 0, 10, 40, 30, 10, 0, 0])
    assert_array_equal(touch.image, REST + 40)
    assert touch.change == 40
    assert (touch.began_s, touch.ended_s, touch.n_frames) == (0.2, 0.6, 4)


def test_arrays_and_frames_are_told_apart():
    """A loop of one's own mixes them up: `read` gives one, `read_next` the other."""
    with pytest.raises(TypeError, match=r"a Frame, as `read_next` .* got ndarray"):
        TouchDetector(REST).update(REST)
    with pytest.raises(TypeError, match=r"arrays, as `read` .* got Frame"):
        TouchDetector().take_baseline([Frame(REST, 0.0, 0)] * 3)


def test_the_change_of_a_colour_frame_is_over_taxels_and_colours():
    rest = np.full((4, 4, 3), 100, np.uint8)
    redder = [0, 40, 40, 0] * np.array([[1.0], [0], [0]])  # red, green, blue by time
    (touch,) = touches_of(TouchDetector(rest), redder.T, rest)
    assert_array_equal(touch.image, rest + np.array([40, 0, 0], np.uint8))
    assert touch.change == pytest.approx(40 / np.sqrt(3))


def test_a_touch_may_be_the_mean_over_the_hold():
    detector = TouchDetector(REST, summary="mean")
    (touch,) = touches_of(detector, [0, 10, 40, 34, 40, 34, 10, 0])
    # The hold is what reaches 0.8 of 40: four frames, their mean 37.
    assert_array_equal(touch.image, REST + 37)


def test_a_change_that_wavers_about_the_limit_is_one_touch():
    detector = TouchDetector(REST, begin=10, end=4)
    assert len(touches_of(detector, [0, 12, 6, 12, 5, 11, 9, 12, 0])) == 1
    flat = TouchDetector(REST, begin=10, end=10)
    assert len(touches_of(flat, [0, 12, 12, 6, 12, 12, 6, 12, 12, 0])) == 3


def flickers(count=20):
    """Frames of 16 x 16 counts as a line array gives them; one taxel flickers."""
    images = np.zeros((count, 16, 16), np.float32)
    images[:, 3, 3] = np.arange(count) % 4 > 1
    return list(images)


def test_one_count_is_no_touch_where_the_step_is_known():
    still = [np.zeros((16, 16), np.float32)] * 10
    detector = TouchDetector()
    detector.step = 1.0
    detector.take_baseline(still)
    assert detector.begin == 2.0
    assert touches_in(detector, flickers()) == []
    fine = TouchDetector()
    fine.step = 0.01
    fine.take_baseline(still)
    # One count on one taxel of 256 is a change of 1/16: over 2 steps of 0.01.
    assert len(touches_in(fine, flickers())) >= 4
    # One count more in the second half is not taken for something coming down.
    detector.take_baseline(flickers(count=4))


def test_pulling_counts_like_pressing():
    (touch,) = touches_of(TouchDetector(REST), [0, -20, -50, -20, 0])
    assert touch.change == 50


def test_a_flash_of_one_frame_is_no_touch():
    assert touches_of(TouchDetector(REST), [0, 50, 0, 0, 50, 0]) == []
    assert len(touches_of(TouchDetector(REST, min_frames=1), [0, 50, 0, 50, 0])) == 2


def test_dead_taxels_do_not_hide_touches():
    zero = np.full((4, 4), 1.0)
    zero[0] = np.nan
    (touch,) = touches_of(TouchDetector(zero, begin=0.5), [0, 1, 2, 1, 0], zero)
    assert_allclose(touch.change, 2)


def test_without_a_baseline_nothing_is_detected():
    detector = TouchDetector()
    assert touches_of(detector, [0, 50, 50, 0]) == []
    assert "No baseline yet" in detector.baseline_offer(0.0)


def test_the_baseline_is_the_mean_and_sets_the_limits(rng):
    noisy = rng.normal(scale=3.0, size=(20, 40, 40)) + 100
    detector = TouchDetector()
    detector.take_baseline(list(noisy))
    # Mean of 20: its own noise is 3 / sqrt(20) = 0.7; four of those bound it.
    assert_allclose(detector.baseline, 100, atol=4 * 0.7 * 1.5)
    # The frames' noise about their mean is 3 sqrt(1 - 1/20).
    assert_allclose(detector.begin, 6 * 3 * np.sqrt(0.95), rtol=0.05)
    assert_allclose(detector.end, detector.begin / 2)


def test_the_baseline_is_refused_while_touching_unless_insisted_on():
    detector = TouchDetector(REST)
    touches_of(detector, [0, 50, 50])
    with pytest.raises(ContactError, match="Something touches the sensor"):
        detector.take_baseline([REST + 50] * 3)
    assert detector.touching
    detector.take_baseline([REST + 50] * 3, force=True)
    assert not detector.touching
    assert_array_equal(detector.baseline, REST + 50)


def test_the_baseline_is_refused_while_something_comes_down():
    coming = [REST + 5 * step for step in range(10)]
    with pytest.raises(ContactError, match="still changing"):
        TouchDetector(REST).take_baseline(coming)
    for ramp in ([], [50], [50, 55], [5, 40, 45, 55], [20, 20, 50, 50]):
        levels = [0, 0, 0, *ramp, *[60] * 5]
        with pytest.raises(ContactError, match="still changing"):
            TouchDetector().take_baseline([REST + level for level in levels])
    with pytest.raises(ValueError, match="number of frames must be at least 3"):
        TouchDetector(REST).take_baseline([REST])


def test_a_new_baseline_is_offered_when_rest_has_moved():
    detector = TouchDetector(REST, begin=10, end=4)
    touches_of(detector, [0] * 60)
    assert detector.baseline_offer(6.0) == ""
    touches_of(detector, [6] * 100)
    assert "take it again" in detector.baseline_offer(10.0)


def test_noise_about_a_given_baseline_is_not_another_baseline(rng):
    """Frames of whole levels with a noise of one, as a camera gives them."""
    rest = np.full((40, 40), 100, np.uint8)
    noise = np.rint(rng.normal(size=(60, 40, 40)))
    images = np.asarray(rest + noise, np.uint8)
    detector = TouchDetector(rest)
    assert touches_in(detector, images) == []
    assert detector.baseline_offer(6.0) == ""


def test_a_contact_of_over_20_s_that_does_not_change_is_questioned():
    detector = TouchDetector(REST)
    touches_of(detector, [0] + [40] * 205)
    assert detector.baseline_offer(20.0) == ""
    offer = detector.baseline_offer(20.3)
    assert "over 20 s: if nothing touches the sensor, insist on a new baseline" in offer
    moving = TouchDetector(REST)
    touches_of(moving, [50, 90] * 125)
    assert moving.baseline_offer(25.0) == ""


def creeping(peaks, rows, residue, decay_s, gap_s, rng):
    """Presses of a row each, of which a share stays and decays; noise of 1, 10 Hz.

    Returns the frames and the number of the middle one of each press.
    """
    left, images, middles = np.zeros((4, 1)), [np.zeros((4, 1))] * 10, []
    for peak, row in zip(peaks, rows, strict=True):
        press = 2 * peak * np.eye(4)[:, [row]]  # root mean square over four rows: peak
        middles.append(len(images) + 3)
        for force in (0.4, 0.8, 1, 1, 1, 0.6, 0.2, *[0] * round(10 * gap_s)):
            left = np.maximum(left * np.exp(-0.1 / decay_s), residue * force * press)
            images.append(force * press + left)
    images += [left * np.exp(-n / 10 / decay_s) for n in range(20)]
    return rng.normal(images, 1.0, (len(images), 4, 4)), middles


@pytest.mark.parametrize("moved", [False, True])
@pytest.mark.parametrize("residue", [0, 0.01, 0.02, 0.05, 0.1])
def test_presses_on_what_is_left_of_others_are_told_apart(residue, moved, rng):
    """Rubber creeps: ten presses 1.5 s apart were one touch, or none."""
    n_doubled = n_merged = 0
    lost = []
    for decay_s, gap_s in product((1, 3, 10), (0.7, 1.5, 3)):
        peaks = rng.permutation([18, 18, 60, 60, 300, 300, 1000, 1000])
        rows = rng.integers(4 if moved else 1, size=8)
        images, middles = creeping(peaks, rows, residue, decay_s, gap_s, rng)
        touches = touches_in(TouchDetector(np.zeros((4, 4)), begin=6.0), images)
        holds = np.array(
            [[t.began_s <= m / 10 < t.ended_s for m in middles] for t in touches]
        )
        n_doubled += np.sum(holds.sum(1) == 0)
        n_merged += np.sum(np.maximum(holds.sum(1) - 1, 0))
        lost += peaks[~holds.any(0)].tolist()
    assert n_doubled == n_merged == 0
    # Elsewhere changes add up as squares do: 18 beside 100 is a rise of 1.6.
    assert {*lost} <= ({18} if moved else set())
    assert len(lost) <= 10  # of 72 presses, 18 of them gentle


def rising_and_falling(*levels):
    """Levels with half a second from each to the next."""
    return np.concatenate(
        [np.linspace(a, b, 5, endpoint=False) for a, b in pairwise(levels)]
    )


@pytest.mark.parametrize(
    "levels",
    [
        pytest.param(rising_and_falling(0, 1000, *[150, 1000] * 5, 0), id="rocked"),
        pytest.param(
            rising_and_falling(0, 1000, *[1000] * 20, 150, 150, 0), id="relaxed"
        ),
        pytest.param(np.linspace(1000, 0, 60), id="lifted slowly"),
        pytest.param(np.linspace(0, 1000, 60), id="pressed slowly"),
        pytest.param(
            np.array([0, 500, 500, 40, 9, 5, 12, 8, 15, 9, 4, 8]), id="left unsteady"
        ),
    ],
)
def test_a_touch_of_changing_force_is_one(levels, rng):
    shaking = levels * rng.normal(1, 0.02, len(levels))
    images = rng.normal(0, 1.0, (len(levels) + 20, 4, 4))
    images[10:-10] += shaking[:, None, None]
    assert len(touches_in(TouchDetector(np.zeros((4, 4)), begin=6.0), images)) == 1


def test_a_touch_that_weakens_to_less_than_a_tenth_is_two():
    """That cannot be told from a press on what is left, but by an end that is given."""
    rest = np.zeros((4, 4))
    levels = [0, *rising_and_falling(0, 1000, 90, 1000, 0), 0, 0]
    assert len(touches_of(TouchDetector(rest, begin=6.0), levels, rest)) == 2
    given_end = TouchDetector(rest, begin=6.0, end=3.0)
    assert len(touches_of(given_end, levels, rest)) == 1


def test_what_is_left_of_a_touch_is_no_rest_that_has_moved():
    """Until it has stayed for 20 s; when it has gone, rest is what it was."""
    detector, rest = TouchDetector(np.zeros((4, 4)), begin=6.0), np.zeros((4, 4))
    decay = 50 * np.exp(-np.arange(300) / 50)  # 5 s; below 3 after 14 s
    levels = [0] * 5 + [1000] * 5 + [*decay] + [0] * 15 + [5, 5]
    for number, level in enumerate(levels):
        detector.update(Frame(rest + level, number / 10, number))
        assert detector.touching == (5 <= number < 10)
        assert detector.baseline_offer(number / 10) == ""
    stays = TouchDetector(rest, begin=6.0)
    touches_of(stays, [0] * 5 + [1000] * 5 + [50] * 250, rest)
    assert stays.baseline_offer(20.9) == ""
    assert "no longer reads its baseline" in stays.baseline_offer(21.1)


@settings(max_examples=50, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(2, 6), st.integers(1, 5), st.integers(5, 100)), max_size=6
    )
)
def test_as_many_touches_come_out_as_went_in(presses):
    levels = [0]
    for hold, rest, level in presses:
        levels += [level] * hold + [0] * rest
    touches = touches_of(TouchDetector(REST), levels)
    assert [touch.change for touch in touches] == [level for _, _, level in presses]


@pytest.mark.realdata
def test_real_touches_played_with_gaps_are_all_found(data_folder):
    stored = np.load(data_folder / "bathtip" / "bathtip50.npz")
    rows = np.flatnonzero(stored["object"] == stored["object"][0])[:40]
    images, zero = stored["images"][rows], stored["no_contact"]
    change = np.sqrt(((images.astype(float) - zero) ** 2).mean((1, 2)))
    detector = TouchDetector(zero)
    played = (frame for image in images for frame in (zero, *[image] * 3, zero))
    assert len(touches_in(detector, played)) == (change > detector.begin).sum()


def hill(shape, row, col):
    at = np.indices(shape)
    return 200 * np.exp(-((at[0] - row) ** 2 + (at[1] - col) ** 2) / 4)


@pytest.mark.parametrize(
    ("rest", "pressed"),
    [
        pytest.param(np.zeros((16, 16)), False, id="nothing"),
        pytest.param(hill((16, 16), 5, 9), True, id="a press"),
        pytest.param(30 + hill((8, 8), 3, 3), True, id="a press on an offset"),
        pytest.param(np.add.outer(np.arange(16.0), np.arange(16.0)), False, id="slope"),
        pytest.param(np.eye(1, 256, 40).reshape(16, 16) * 200, False, id="one taxel"),
        pytest.param(np.indices((16, 16)).sum(0) % 2 * 9.0, False, id="chequers"),
        pytest.param(hill((120, 160), 60, 60), False, id="a picture"),
    ],
)
def test_a_first_baseline_that_looks_like_a_press_is_asked_about(rest, pressed, rng):
    """A camera sees a scene, where nothing tells; an array at rest is even."""
    frames = [rest + rng.normal(scale=0.5, size=rest.shape) for _ in range(10)]
    detector = TouchDetector()
    if pressed:
        with pytest.raises(ContactError, match="may press the sensor around row"):
            detector.take_baseline(frames)
        assert detector.baseline is None
        detector.take_baseline(frames, force=True)
    else:
        detector.take_baseline(frames)
    assert_allclose(detector.baseline, rest, atol=1)  # 6 errors of a mean


def test_noise_on_few_taxels_is_no_press(rng):
    """Of nine taxels the lowest two may be near each other by chance."""
    for frames in 20 + rng.normal(scale=0.3, size=(200, 10, 3, 3)):
        TouchDetector().take_baseline(list(frames))


def test_a_baseline_is_undone_with_its_noise(rng):
    detector = TouchDetector()
    noises = []
    for scale in (1.0, 3.0):
        frames = rng.normal(scale=scale, size=(10, 6, 6))
        detector.take_baseline(list(frames))
        noises.append((detector.baseline, detector.noise))
    detector.undo_baseline()
    assert detector.noise == noises[0][1]
    assert_array_equal(detector.baseline, noises[0][0])
    first = TouchDetector()
    first.take_baseline([np.zeros((4, 4))] * 3)
    first.undo_baseline()
    assert first.baseline is None


def test_the_limit_that_finds_more_touches_is_named():
    """Three weak touches beside two strong ones: the limit between them is named."""
    rest = np.full((4, 4), 100.0)
    levels = [0.0] * 12
    for peak in (40, 6, 40, 6, 6):
        levels += [peak, peak, peak, 0, 0, 0]
    noisy = [
        rest + 0.2 * np.random.default_rng(n).normal(size=(4, 4)) for n in range(9)
    ]
    detector = TouchDetector(begin=20.0)
    detector.take_baseline(noisy)
    stream = Touches(
        np.stack([rest + level for level in levels]), time_s=np.arange(len(levels)) / 10
    )
    assert len(detector.touches_in(stream)) == 2
    match = re.fullmatch(
        r"2 touches begin at a change of 20, 5 would at ([\d.]+) "
        r"\(([\d.]+) to ([\d.]+)\); 3 changes lay below the limit\.",
        detector.note,
    )
    middle, low, high = map(float, match.groups())
    # Limits reach down to three noises of 0.2; the weak touches change by 6.
    assert low == pytest.approx(0.6, rel=0.15)
    assert 4.5 < high <= 6.1
    assert middle == pytest.approx(np.sqrt(low * high), rel=0.1)


@pytest.mark.parametrize(("n_taxels", "refused"), [(3, False), (4, True)])
def test_a_press_is_of_four_neighbours(n_taxels, refused, rng):
    rest = rng.uniform(99, 101, (10, 10))
    rest[5, 2 : 2 + n_taxels] += 200
    detector = TouchDetector()
    if not refused:
        detector.take_baseline([rest] * 3)
        return
    with pytest.raises(ContactError, match="where 4 neighbouring taxels"):
        detector.take_baseline([rest] * 3)


def test_large_images_are_looked_at_in_part():
    """Images of more than 160 a side count by every second pixel alone."""
    rest = np.full((200, 161), 100, np.uint8)
    detector = TouchDetector(rest, begin=1.0)
    between = rest.copy()
    between[1::2] = between[:, 1::2] = 200
    touches_in(detector, [between])
    assert detector.change == 0
    whole = np.full((160, 160), 100, np.uint8)
    detector = TouchDetector(whole, begin=1.0)
    with_one_pixel = whole.copy()
    with_one_pixel[1, 1] = 200
    touches_in(detector, [with_one_pixel])
    assert detector.change == pytest.approx(100 / 160)


def test_the_noise_about_a_given_baseline_is_learnt_from_nine_frames_at_rest(rng):
    """Eight differences of neighbours; noise of 0.4 and rounding (1/12) about it."""
    rest = np.full((64, 64), 100, np.uint8)
    images = np.rint(rest + rng.normal(scale=0.4, size=(12, 64, 64))).astype(np.uint8)
    detector = TouchDetector(rest)
    noises = []
    for image in images:
        touches_in(detector, [image])
        noises.append(detector.noise)
    assert noises[:8] == [0.0] * 8
    expected = float(np.sqrt(np.mean((images[:9] - 100.0) ** 2)))
    assert noises[8] == pytest.approx(expected, rel=0.05)
    assert set(noises[8:]) == {noises[8]}  # and not again
    assert detector.begin == pytest.approx(max(2.0, 6 * noises[8]))


def test_a_step_of_the_numbers_bounds_the_limit_from_below():
    whole, real = TouchDetector(REST), TouchDetector(REST.astype(float))
    assert (whole.begin, whole.end) == (2.0, 1.0)
    assert real.begin < 1e-30
    for detector, begin in ((whole, 2.0), (real, 1.0)):
        detector.step = 0.5
        assert detector.begin == begin
    whole.step = 3.0
    assert whole.begin == 6.0


def test_a_touch_after_a_short_flash_is_whole():
    """Frames kept of a flash that was no touch are not part of the next touch."""
    detector = TouchDetector(REST, begin=10, end=5, summary="mean", min_frames=3)
    (touch,) = touches_of(detector, [0, 90, 90, 0, 0, 40, 40, 40, 40, 0])
    assert_array_equal(touch.image, REST + 40)
    assert (touch.began_s, touch.ended_s, touch.n_frames) == (0.5, 0.9, 4)
    assert touch.change == 40


def test_a_hold_is_of_the_last_64_frames():
    detector = TouchDetector(REST, begin=10, end=5, summary="mean")
    (touch,) = touches_of(detector, [0] + [50] * 30 + [40] * 64 + [0])
    assert_array_equal(touch.image, REST + 40)  # of 50 none is left


def test_a_stream_that_ends_in_contact_ends_with_a_touch():
    images = np.stack([REST + level for level in (0, 0, 40, 50)]).astype(np.uint8)
    labels = {"object": [*"aabc"], "force_n": [0, 0, 4, 5], "order": [6, 7, 8, 9]}
    whole = {"no_contact": REST, "geometry": "array", "set_topic": np.array("/pad")}
    touches = TouchDetector().touches_in(Touches(images, **labels, **whole))
    assert touches.columns["duration_s"].tolist() == [1]  # frames are a second apart
    assert touches.columns["time_s"].tolist() == [2]
    assert touches.order.tolist() == [0]
    assert_array_equal(touches.no_contact, REST)
    # What is told of the frames stays; labels are of that of greatest change.
    assert touches.object.tolist() == ["c"]
    assert touches.columns["force_n"].tolist() == [5]
    assert touches.geometry == "array"
    assert touches.whole["set_topic"] == "/pad"


@pytest.mark.parametrize("shape", [(4, 5), (4, 1)])
def test_frames_of_another_size_than_the_baseline_are_refused(shape):
    detector = TouchDetector(np.zeros((4, 4)))
    with pytest.raises(SensorError, match="of 4 x 4 taxels like the frame of no conta"):
        detector.touches_in(Touches(np.ones((3, *shape))))


def test_a_touch_does_not_end_above_where_it_begins():
    with pytest.raises(ValueError, match=r"end must be at most begin \(2\), got 5"):
        TouchDetector(np.zeros((4, 4)), begin=2.0, end=5.0)
    assert TouchDetector(begin=2.0, end=2.0).end == 2
    by_steps = TouchDetector(np.zeros((4, 4), np.uint8), end=60.0)
    assert by_steps.end == by_steps.begin == 2


def test_a_stream_without_a_touch_says_what_did_not_change():
    images = np.stack([REST + level for level in (0, 1, 0, 1)]).astype(np.uint8)
    with pytest.raises(SensorError, match=r"got 4 frames .*changed by 2 for 2 frames"):
        TouchDetector().touches_in(Touches(images, no_contact=REST))
    images = np.stack([REST + level for level in (0, 0, 0, 9)]).astype(np.uint8)
    with pytest.raises(SensorError, match="got 4 frames"):  # the last begins a touch
        TouchDetector().touches_in(Touches(images, no_contact=REST))


def test_a_frame_of_nan_alone_is_neither_rest_nor_contact():
    rest = np.full((4, 4), 100, np.float32)
    nothing = np.full((4, 4), np.nan, np.float32)
    detector = TouchDetector()
    # One failed reading among ten made a baseline of NaN, from which nothing differs.
    detector.take_baseline([rest] * 4 + [nothing] + [rest] * 5)
    assert_array_equal(detector.baseline, rest)
    press = [rest, rest + 30, rest + 40, nothing, rest + 40, rest + 30, rest]
    (touch,) = touches_in(detector, press)
    assert (touch.change, touch.n_frames) == (40, 4)


def test_a_reading_that_failed_makes_no_taxel_of_a_baseline_dead(rng):
    frames = rng.normal(100, 1.0, (10, 4, 4)).astype(np.float32)
    frames[3, 1, 1] = np.nan
    frames[:, 2, 2] = np.nan
    detector = TouchDetector()
    detector.take_baseline(list(frames))
    assert_array_equal(np.argwhere(np.isnan(detector.baseline)), [[2, 2]])
    others = np.delete(frames[:, 1, 1], 3)
    assert detector.baseline[1, 1] == pytest.approx(others.mean())


def test_a_baseline_of_nan_alone_is_refused():
    detector = TouchDetector(REST)
    nothing = [np.full((4, 4), np.nan, np.float32)] * 8
    with pytest.raises(SensorError, match="frames with numbers or more, got 2 among"):
        detector.take_baseline([*nothing, *[REST] * 2], force=True)
    assert_array_equal(detector.baseline, REST)


@pytest.mark.parametrize(("dtype", "noise"), [(np.float32, 1.0), (np.uint16, 4.0)])
@pytest.mark.parametrize("n_pressed", [0, 25])  # at first
def test_noise_beyond_the_steps_of_a_given_baseline_is_learnt(
    dtype, noise, n_pressed, rng
):
    rest = np.full((8, 8), 100, dtype)
    levels = [*[60.0] * n_pressed, *[0.0] * 25, *[60.0] * 5, *[0.0] * 5]
    images = [rng.normal(100 + x, noise, (8, 8)).round(1).astype(dtype) for x in levels]
    # It was one touch without an end: neither was ever as near as a step.
    touches = TouchDetector().touches_in(Touches(images, no_contact=rest))
    assert len(touches) == 1 + (n_pressed > 0)
    assert touches.columns["time_s"][-1] == n_pressed + 25
    assert touches.columns["duration_s"][-1] == 5


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("n_frames", [10, 11])
def test_rest_that_reads_one_decimal_is_no_touch(dtype, n_frames):
    # Ten times 0.1, one after the other, over ten is 0.1 less a rounding error; of
    # eleven the means of the first six and of the other five differ.
    rest = np.full((4, 4), 0.1, dtype)
    detector = TouchDetector()
    detector.take_baseline([rest] * n_frames)
    assert_array_equal(detector.baseline, rest)
    assert len(touches_of(detector, [0, 0, 0, 9, 9, 0, 0], rest)) == 1


def test_readings_that_are_given_again_and_again_do_not_hide_the_noise(rng):
    """A driver that is asked ten times as often as its device measures."""
    levels = np.repeat([0.0, 60.0, 0.0], [20, 5, 5])
    readings = rng.normal(100 + levels[:, None, None], 1.0, (30, 8, 8))
    images = np.repeat(readings, 10, axis=0)
    touches = TouchDetector().touches_in(Touches(images))
    assert touches.columns["time_s"].tolist() == [200]
    assert touches.columns["duration_s"].tolist() == [50]
    for n_first in range(1, 11):  # readings that the first few were cut off from
        detector = TouchDetector()
        detector.take_baseline(list(images[n_first : n_first + 100]))
        assert detector.noise == pytest.approx(1.0, rel=0.2)
