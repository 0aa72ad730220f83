"""Sensors that are followed: what each tells, and several at one server."""

import json
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner
from websockets.sync.client import connect

from palpate import TouchLibrary
from palpate.cli import app
from palpate.cli.serve import _folders
from palpate.recognition import ModelFileError
from palpate.sensors import Frame, SensorError
from palpate.web import LiveSession, PageServer

from .conftest import Event, Still, waited


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


GREY, COLOUR = "4 x 5 taxels in grey", "4 x 5 taxels in colour"


@pytest.mark.parametrize(
    ("shape", "other", "kinds", "fix"),
    [
        ((4, 5), (6, 7), ("4 x 5 taxels", "6 x 7 taxels"), "to a size."),
        ((4, 5, 3), (6, 7, 3), ("4 x 5 taxels", "6 x 7 taxels"), "to a size."),
        ((4, 5), (4, 5, 3), (GREY, COLOUR), "with colour=1."),
        ((4, 5, 3), (4, 5), (COLOUR, GREY), "with colour=0."),
    ],
)
def test_a_misfit_names_both_sizes_and_colour_where_that_differs(
    shape, other, kinds, fix
):
    watch = LiveSession(Still(shape)).watch
    watch.compare_with(learnt(shape))
    assert watch.misfit == ""
    assert watch.to_dict()["warnings"] == []
    watch.compare_with(learnt(other))
    of_sensor, of_model = kinds
    words = f"images of {of_sensor}, which still gives, got one of {of_model}."
    assert words in watch.misfit
    assert watch.misfit.endswith(fix)
    assert watch.to_dict()["warnings"] == [watch.misfit]
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


def test_a_sensor_that_hangs_is_told(hand, monkeypatch):
    def lost():
        return session.to_dict()["sensor"]["lost"]

    with LiveSession(hand) as session:
        assert waited(lambda: session.health.to_dict()["n_frames"] > 3)
        assert lost() == ""
        with monkeypatch.context() as patched:
            patched.setattr("palpate.web._sensor_watch._SILENT_S", 0.1)
            patched.setattr(hand, "_grab", lambda: time.sleep(0.01) or [])
            assert waited(lambda: lost().startswith("hand gives no frames. Check its"))
        assert waited(lambda: lost() == "")


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


@pytest.fixture
def missing(hand):
    """Give a sensor that is not plugged in."""
    hand.unplugged = True
    return hand


@pytest.fixture
def fingers(make_session, drawn_model):
    """Two sensors before which nothing lies yet, and the model of both."""
    options = {"model": drawn_model, "library": None, "rate_hz": 100.0}
    return [make_session(**options) for _ in range(2)]


def test_each_sensor_has_an_episode_of_its_own(fingers, connected, drawn):
    discs = drawn.images[drawn.object == "disc"]
    with connected(fingers) as client:
        for number, count in ((1, 2), (2, 3)):
            for image in discs[:count]:
                body = {"image": image.tolist()}
                request = {"params": {"sensor": number}, "json": body}
                assert client.post("/api/touch", **request).status_code == 200
        episodes = [
            client.get("/api/episode", params={"sensor": number}).json()["touches"]
            for number in (1, 2)
        ]
        assert [len(touches) for touches in episodes] == [2, 3]
        assert client.get("/api/episode").json()["touches"] == episodes[0]
        client.post("/api/episode/start", params={"sensor": 2})
        assert len(fingers[0].episode.touches) == 2
        assert fingers[1].episode.touches == []
        refused = client.get("/api/state", params={"sensor": 3})
        assert refused.status_code == 404
        assert refused.json()["detail"] == "sensor must be at most 2, got 3."


def test_frames_and_states_of_all_go_through_one_websocket(fingers, serving):
    with (
        serving(fingers, "token") as (address, _),
        connect(f"ws{address[4:]}/ws?token=token") as socket,
    ):
        seen = set()
        while len(seen) < 4:
            data = socket.recv(timeout=10)
            if isinstance(data, bytes):
                data = data[4 : 4 + int.from_bytes(data[:4], "big")]
            event = json.loads(data)
            if event["kind"] in ("frame", "state"):
                seen.add((event["kind"], event["sensor_number"]))
    assert seen == {(kind, n) for kind in ("frame", "state") for n in (1, 2)}


def test_a_sensor_that_fails_is_reported_and_the_other_goes_on(
    fingers, missing, connected
):
    with connected([LiveSession(missing), fingers[1]]) as client:
        first = client.get("/api/state").json()["sensor"]
        assert first["lost"] == "It is left out: it is unplugged"
        second = client.get("/api/state", params={"sensor": 2}).json()["sensor"]
        assert second["lost"] == ""
        assert client.get("/api/frame", params={"sensor": 2}).status_code == 200
    with pytest.raises(SensorError, match="it is unplugged"):
        LiveSession.start_all([LiveSession(missing), LiveSession(missing)])


def test_a_session_that_was_left_out_stays_so(fingers, hand, tmp_path):
    damaged = LiveSession(hand, library=tmp_path)
    (tmp_path / "library.sqlite").write_bytes(b"no library" * 100)
    for _ in range(2):  # by the command, and by its server
        LiveSession.start_all([damaged, fingers[0]])
        assert not hand.connected
        assert "It is left out" in damaged.watch.failed
    fingers[0].stop()


def test_serve_refuses_a_sensor_named_twice_and_a_library_of_one_sensor(
    tmp_path, monkeypatch
):
    def refusal(*arguments):
        result = CliRunner().invoke(app, ["serve", "--port", "0", *arguments])
        assert result.exit_code
        return " ".join(f"{result.output} {result.exception}".split())

    two = "--sensor", "sim:mug", "--sensor", "sim:mug"
    assert "--sensor must name each once, got sim:mug, sim:mug. Sim" in refusal(*two)
    (tmp_path / "library.sqlite").touch()
    several = "--sensor", "sim:mug", "--sensor", "sim:box", "--library", str(tmp_path)
    assert "name a --library that is none of one sensor" in refusal(*several)
    (tmp_path / "library.sqlite").unlink()
    copied = []
    monkeypatch.setattr(
        "palpate.cli.serve.model_file", lambda *of: copied.append(of) or of[0]
    )
    assert "leave --model out" in refusal(*several, "--model", "sim-dome")
    assert copied == []


def test_two_sensors_of_one_kind_have_a_folder_and_a_name_each(tmp_path, monkeypatch):
    """Folders of the library, and names on the page, differ by the address."""
    served = []
    monkeypatch.setattr("palpate.web.create_app", lambda all_, *_, **__: [*all_])
    monkeypatch.setattr(PageServer, "run", lambda _, app: served.extend(app))
    monkeypatch.setattr(LiveSession, "start_all", lambda sessions: None)
    alike = _folders(["sim:a b", "sim:a-b", "sim:a-b-2"], tmp_path / "a", None)
    assert len({*alike}) == 3
    two = "--sensor", "sim:bar10?seed=1", "--sensor", "sim:bar10?seed=2"
    words = ["serve", "--port", "0", *two, "--library", str(tmp_path / "hand")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    names = [session.watch.to_dict()["name"] for session in served]
    assert [name[-18:] for name in names] == [
        "(sim:bar10?seed=1)",
        "(sim:bar10?seed=2)",
    ]
    folders = [session.teacher.folder.name for session in served]
    assert folders == ["sim-bar10-seed-1", "sim-bar10-seed-2"]


def test_a_session_that_cannot_begin_lets_go_of_its_library(
    missing, tmp_path, monkeypatch
):
    closed, plain = [], TouchLibrary.close

    def close(library):
        closed.append(library)
        plain(library)

    TouchLibrary.open(tmp_path / "lab", create=True).close()
    monkeypatch.setattr(TouchLibrary, "close", close)
    with pytest.raises(SensorError), LiveSession(missing, library=tmp_path / "lab"):
        pass
    (tmp_path / "m.palpate").write_bytes(b"no model")
    with pytest.raises(ModelFileError):
        LiveSession(model=tmp_path / "m.palpate", library=tmp_path / "lab")
    assert len(closed) == 2
