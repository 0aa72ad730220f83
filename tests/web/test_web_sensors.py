"""Several sensors at one server: each its own session, and what all say together."""

import json

import pytest
from typer.testing import CliRunner

from palpate import TouchLibrary
from palpate.cli import app
from palpate.recognition import ModelFileError
from palpate.sensors import SensorError
from palpate.web import LiveSession, PageServer


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
    sync = pytest.importorskip("websockets.sync.client")
    with serving(fingers, "token") as (address, _):
        where = f"ws{address[4:]}/ws?token=token"
        with sync.connect(where) as socket:
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
