"""The state of a sensor that is followed, without threads and without a server."""

import json
import queue
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.sensors import Frame, SensorError
from palpate.web import LiveSession

from .conftest import Event, Still


@pytest.fixture
def watch():
    return LiveSession(Still()).watch


def learnt(shape):
    """A model of images of a shape, which remembers no sensor."""
    return SimpleNamespace(
        memory_=SimpleNamespace(sensor=None),
        encoder_=SimpleNamespace(image_shape_=shape),
    )


def frame(image, number=0):
    return Frame(np.asarray(image), time.monotonic(), number)


@pytest.mark.parametrize(
    ("shape", "other", "sizes"),
    [
        ((4, 5), (6, 7), ("4 x 5 taxels", "6 x 7 taxels")),
        ((4, 5, 3), (6, 7, 3), ("4 x 5 taxels", "6 x 7 taxels")),
        ((4, 5), (4, 5, 3), ("4 x 5 taxels in grey", "4 x 5 taxels in colour")),
        ((4, 5, 3), (4, 5), ("4 x 5 taxels in colour", "4 x 5 taxels in grey")),
    ],
)
def test_a_misfit_names_both_sizes_and_colour_where_that_differs(shape, other, sizes):
    watch = LiveSession(Still(shape)).watch
    watch.compare_with(learnt(other))
    sensor_size, model_size = sizes
    assert (
        f"images of {sensor_size}, which still gives, got one of {model_size}."
        in watch.misfit
    )


def test_a_model_of_other_images_is_a_misfit(watch):
    watch.compare_with(learnt((4, 4)))
    assert watch.misfit == ""
    assert watch.to_dict()["warnings"] == []
    watch.compare_with(learnt((5, 4)))
    sizes = "of 4 x 4 taxels, which still gives, got one of 5 x 4 taxels."
    assert sizes in watch.misfit
    assert watch.misfit.endswith("that the model learnt from.")
    assert watch.to_dict()["warnings"] == [watch.misfit]
    watch.compare_with(learnt((4, 4, 3)))
    assert "taxels in grey, which still gives, got one of 4 x 4 taxels in colour" in (
        watch.misfit
    )
    assert watch.misfit.endswith("with colour=1.")
    watch.compare_with(None)
    assert watch.to_dict()["warnings"] == []


def test_a_sensor_that_knows_its_size_once_it_is_open_suits_its_model():
    class Late(Still):
        def _open(self):
            self.image_shape = (64, 48)

    session = LiveSession(Late((1, 1), geometry=None))
    session.recogniser = learnt((64, 48))
    with session:
        assert session.watch.misfit == ""
        # A picture of a camera: one of an array would be in false colour.
        assert not session.watch._painter.coloured
    session = LiveSession(late := Late((1, 1)))
    session.recogniser = learnt((5, 4))
    with pytest.raises(ValueError, match="of 64 x 48 pixels, which still gives"):
        session.start()
    assert not late.connected


@pytest.mark.parametrize(("level", "lower"), [(30, False), (10, True), (20, False)])
def test_a_press_of_an_array_that_reads_lower_is_reported(watch, level, lower):
    image = np.full((4, 4), 20, np.uint8)
    watch.detector.take_baseline([image] * 3)
    with pytest.raises(SensorError, match="There was no test press"):
        watch.press_difference()
    watch._asking, watch.press = True, np.full((4, 4), level, np.uint8)
    assert watch.to_dict()["press"] == {"found": True, "lower": lower, "number": 0}
    assert (watch.press_difference() == abs(level - 20)).all()
    watch.end_press()
    assert watch.press is None
    assert watch.to_dict()["press"] is None


def test_the_state_of_a_sensor_has_its_name_shape_and_baseline(watch):
    state = watch.to_dict()
    assert state["name"] == "still"
    assert state["shape"] == [4, 4]
    assert (state["baseline"], state["zero"], state["desk"]) == (False, False, None)
    watch.address, watch.failed = "serial:x", "It is left out."
    assert watch.to_dict()["name"] == "still (serial:x)"
    assert watch.to_dict()["lost"] == "It is left out."
    watch.detector.take_baseline([np.zeros((4, 4), np.uint8)] * 3)
    assert watch.to_dict()["baseline"]
    assert watch.to_dict()["zero"]


def test_frames_go_to_those_who_take_frames(watch):
    all_events, others = [], []
    listeners = watch._listeners
    watch._show(frame(np.zeros((4, 4), np.uint8)))  # no listener: nothing is painted
    assert watch._health.to_dict()["frame_ms"] is None
    listeners.add(all_events.append)
    listeners.add(others.append, frames=False)
    assert (len(listeners), listeners.n_of_frames) == (2, 1)
    image = np.zeros((4, 4), np.uint8)
    watch._show(frame(image, 7))
    assert others == []
    (event,) = all_events
    assert event.kind == "frame"
    assert event.values["number"] == 7
    assert event.values["sensor_number"] == 1
    assert event.values["touching"] is False
    assert event.values["type"] == "image/png"
    assert event.picture.startswith(b"\x89PNG")
    assert event.image is image
    assert json.loads(event.text)["kind"] == "frame"
    for kind in ("touch", "state"):
        listeners.notify(Event(kind))
    assert [event.kind for event in all_events] == ["frame", "touch", "state"]
    assert [event.kind for event in others] == ["touch", "state"]
    listeners.discard(all_events.append)
    assert (len(listeners), listeners.n_of_frames) == (1, 0)


def test_one_listener_goes_and_the_others_stay():
    listeners, gone, stays = LiveSession().listeners, [], []
    for events in (gone, stays):
        listeners.add(events.append)
    listeners.notify(Event("state"))
    for _ in range(2):  # again does no harm
        listeners.discard(gone.append)
    listeners.number = 3
    listeners.notify(Event("state"))
    assert (len(gone), len(stays), len(listeners)) == (1, 2, 1)
    assert stays[-1].values["sensor_number"] == 3


def test_a_listener_that_fails_is_not_called_again_and_holds_up_nobody():
    listeners, calls = LiveSession().listeners, []

    def fail(event):
        calls.append("fail")
        raise OSError

    listeners.add(fail)
    listeners.add(lambda event: calls.append("well"))
    for _ in range(2):
        listeners.notify(Event("state"))
    assert calls == ["fail", "well", "well"]


def test_a_baseline_is_of_ten_frames_that_come(watch):
    with pytest.raises(SensorError, match="still gave too few frames for a baseline"):
        watch.take_baseline(timeout_s=0.05)
    assert watch.detector.baseline is None
    frames = []
    watch._resting = frames
    for _ in range(3):
        watch._step(frame(np.full((4, 4), 9, np.uint8)))
    assert len(frames) == 3
    assert watch._health.to_dict()["n_frames"] == 3
    assert watch._detected.empty()


def test_a_slow_sensor_gets_its_baseline_too(hand, monkeypatch):
    grab = hand._grab
    monkeypatch.setattr(hand, "_grab", lambda: time.sleep(0.1) or grab())
    with LiveSession(hand) as session:
        session.watch.take_baseline(timeout_s=0.5)  # ten frames take a second
        assert session.baseline is not None


def test_two_who_ask_at_once_both_get_a_baseline(hand):
    taken = []
    with LiveSession(hand) as session:

        def take():
            session.watch.take_baseline()
            taken.append(session.baseline)

        both = [threading.Thread(target=take, daemon=True) for _ in range(2)]
        for thread in both:
            thread.start()
            time.sleep(0.02)  # of the ten frames a few have come
        for thread in both:
            thread.join()
    assert [baseline.max() for baseline in taken] == [20, 20]


def test_touches_are_tried_while_a_press_is_asked_for(watch, monkeypatch):
    touch = SimpleNamespace(image=np.ones((4, 4), np.uint8))
    monkeypatch.setattr(watch.detector, "update", lambda _: touch)
    watch._asking = True
    for number in (1, 2):
        watch._step(frame(touch.image))
        assert watch.to_dict()["press"]["number"] == number
    assert watch._detected.empty()
    watch.end_press()
    last = frame(touch.image)
    watch._step(last)
    assert watch._detected.get_nowait() == (touch, last.time_s)
    with pytest.raises(queue.Empty):
        watch._detected.get_nowait()


def test_the_last_forty_touches_are_compared(watch):
    taken = []
    watch._take = lambda touch, ended_s: taken.append((touch, ended_s))
    for number in range(50):
        image = np.full((4, 4), number, np.uint8)
        watch._detected.put((SimpleNamespace(image=image), float(number)))
    watch._detected.put(None)
    watch._hand_on()
    assert [ended_s for _, ended_s in taken] == list(range(50))
    assert [int(image[0, 0]) for image in watch._recent] == list(range(10, 50))


def test_health_is_of_the_last_hundred_and_the_sensors_drops():
    sensor = Still()
    sensor.n_dropped = 3
    health = LiveSession(sensor).health
    nothing = {"rate_hz": 0.0, "n_frames": 0, "frame_ms": None, "belief_ms": None}
    assert health.to_dict() == {"n_dropped": 3, **nothing}
    latencies_ms = np.arange(150.0) ** 2
    for latency_ms in latencies_ms.tolist():
        health.count_touch(latency_ms)
    assert health.to_dict()["belief_ms"] == np.median(latencies_ms[50:])
    health.count_shown(time.monotonic() - 0.2)
    assert health.to_dict()["frame_ms"] == pytest.approx(200, abs=150)
    now_s = time.monotonic()
    health.count_frame(now_s)
    assert health.to_dict()["rate_hz"] == 0
    health.count_frame(now_s + 0.25)
    assert health.to_dict()["rate_hz"] == pytest.approx(4)
    same = LiveSession().health
    for _ in range(2):
        same.count_frame(now_s)
    assert same.to_dict()["rate_hz"] == 0


@pytest.mark.parametrize(("ago_s", "rate_hz"), [(1.5, 10), (2.5, 0)])
def test_a_sensor_silent_for_two_seconds_has_no_rate(ago_s, rate_hz):
    health, now_s = LiveSession().health, time.monotonic()
    for number in range(150):  # the last hundred
        health.count_frame(now_s - ago_s - (149 - number) / 10)
    assert health.to_dict()["rate_hz"] == pytest.approx(rate_hz)
    assert health.to_dict()["n_frames"] == 150


def test_two_events_alike_are_two_events():
    assert Event("state") != Event("state")
