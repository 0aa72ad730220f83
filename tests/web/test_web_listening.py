"""Who is told of events, and the figures of health, without a server."""

import time

import pytest

from palpate.web import Event, LiveSession


def test_one_listener_goes_and_the_others_stay():
    listeners, told = LiveSession().listeners, {"a": 0, "b": 0}
    ears = {}
    for name in told:

        def hear(event, name=name):
            told[name] += 1

        ears[name] = hear
        listeners.add(hear)
    listeners.notify(Event("state", {}))
    listeners.discard(ears["a"])
    listeners.discard(ears["a"])  # again does no harm
    event = Event("state", {})
    listeners.number = 3
    listeners.notify(event)
    assert told == {"a": 1, "b": 2}
    assert len(listeners) == 1
    assert event.values["sensor_number"] == 3


def test_a_listener_that_fails_is_not_told_again_and_holds_up_nobody():
    listeners, told = LiveSession().listeners, []

    def fail(event):
        told.append("fail")
        raise OSError

    listeners.add(fail)
    listeners.add(lambda event: told.append("well"))
    for _ in range(2):
        listeners.notify(Event("state", {}))
    assert told == ["fail", "well", "well"]


def test_health_counts_frames_of_the_last_seconds():
    health = LiveSession().health
    assert health.to_dict() == {
        "rate_hz": 0.0,
        "n_frames": 0,
        "n_dropped": 0,
        "frame_ms": None,
        "belief_ms": None,
    }
    now_s = time.monotonic()
    for number in range(150):
        health.count_frame(now_s - (149 - number) / 50)
    found = health.to_dict()
    assert found["n_frames"] == 150
    assert found["rate_hz"] == pytest.approx(50)  # of the last hundred
    old = LiveSession().health
    for number in range(150):
        old.count_frame(now_s - 3 - (149 - number) / 50)
    assert old.to_dict()["rate_hz"] == 0.0  # none within two seconds


def test_latencies_are_medians_in_milliseconds():
    health = LiveSession().health
    for latency_ms in (10.0, 20.0, 900.0):
        health.count_touch(latency_ms)
    assert health.to_dict()["belief_ms"] == 20.0
    health.count_shown(time.monotonic() - 0.2)
    assert health.to_dict()["frame_ms"] == pytest.approx(200, abs=150)
