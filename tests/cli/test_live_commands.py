"""`palpate record`, `live`, `serve`, `sensor check`: the same loop, in the terminal."""

import io
import json
import queue
import re
import signal
import subprocess
import sys
import weakref
from contextlib import closing
from types import SimpleNamespace
from urllib.parse import urlsplit

import cv2
import httpx
import numpy as np
import pytest

from palpate import Touches
from palpate.cli import live, record
from palpate.cli.sensor import give_up
from palpate.library import TouchLibrary
from palpate.recognition import Episode, ObjectRecogniser
from palpate.sensors import ReplaySensor, SensorError, SensorMemory, TouchDetector
from palpate.simulation import PressureArray, simulate_presses
from palpate.web import LiveSession, PageServer, create_app

from .conftest import put


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Discs and bars, ten each, as an archive."""
    array = PressureArray(rows=12, cols=12, random_state=0)
    pressed = simulate_presses(["disc13", "bar10"], 10, array=array, random_state=3)
    path = tmp_path_factory.mktemp("recording") / "touches.npz"
    names = ["disc"] * 10 + ["bar"] * 10
    Touches(pressed.images, object=names, geometry="array").save(path)
    return path


@pytest.fixture(scope="module")
def model(recording):
    """The file of a model that has learnt the recording."""
    recogniser = ObjectRecogniser().fit(Touches.load(recording))
    return recogniser.save(recording.with_name("model.palpate"))


@pytest.fixture
def replay(recording):
    return ["--sensor", f"replay:{recording}", "--rate", "200", "--hold", "3"]


@pytest.fixture
def served(monkeypatch):
    """Let servers end at once."""
    pytest.importorskip("fastapi", reason='needs the extra "web"')
    monkeypatch.setattr(PageServer, "run", lambda server, app: None)


def test_record_keeps_touches_in_a_library_and_an_archive(palpate, replay, tmp_path):
    library, archive = tmp_path / "library", tmp_path / "bar.npz"
    result = palpate(
        *["record", "bar", *replay, "--gap", "3", "--place", "bar", "-n", "4"],
        *["--library", library, "-o", archive, "--json"],
    )
    assert json.loads(result.stdout) == {
        "object": "bar",
        "touches": 4,
        "library": str(library),
        "output": str(archive),
    }
    touches = Touches.load(archive)
    assert touches.object.tolist() == ["bar"] * 4
    assert touches.no_contact.shape == (12, 12)
    assert "touch 4 of 4" in result.stderr


def test_touches_of_a_running_sensor_are_added(palpate, recording, tmp_path):
    address = f"replay:{recording}?rate=200&hold=3&gap=3&place=bar"
    words = ["--object", "bar", "-n", "3", "--session", "monday"]
    added = palpate.answer("library", "add", tmp_path / "lab", address, *words)
    assert added == {"library": str(tmp_path / "lab"), "given": 3, "added": 3}
    with TouchLibrary.open(tmp_path / "lab") as library:
        rows = library.list()
    assert [(row.object, row.session) for row in rows] == [("bar", "monday")] * 3


@pytest.mark.parametrize("verb", ["record", "live"])
def test_a_touch_that_does_not_come_is_given_up_and_why(
    palpate, replay, model, tmp_path, monkeypatch, capsys, verb
):
    what = ["bar", "--library", tmp_path / "l"] if verb == "record" else [model]
    words = [verb, *what, *replay, "--gap", "10000", "--timeout", "0.3"]
    assert "No touch in 0.3 s: ended.\n" in palpate.refusal(*words)
    why = "The sensor at rest no longer reads its baseline: take it again."
    monkeypatch.setattr(TouchDetector, "baseline_offer", lambda *_: why)
    result = palpate.refusal(*words)
    assert f"No touch in 0.3 s: ended. {why} Starting again takes" in result
    session = SimpleNamespace(
        watch=SimpleNamespace(to_dict=lambda: {"offer": "", "touching": True})
    )
    give_up(session, 5.0)
    assert "5 s: ended. A touch has not ended: if nothing" in capsys.readouterr().err
    gone = {"offer": why, "touching": True, "lost": "COM3 went away. Plug it in."}
    give_up(SimpleNamespace(watch=SimpleNamespace(to_dict=lambda: gone)), 5.0)
    assert capsys.readouterr().err == (
        "No touch in 5 s: ended. COM3 went away. Plug it in.\n"
    )


def test_a_touch_that_comes_while_record_looks_is_not_missed(capsys):
    listeners, event = [], SimpleNamespace(kind="state")

    class Lesson:
        """A lesson that stores one touch more, and reports it, after each count."""

        def __init__(self, n_without_contact=0):
            self.ids, self._n_without = [], n_without_contact

        @property
        def done(self):
            n_stored = len(self.ids)
            if n_stored < 2 + self._n_without:
                self.ids.append("id")
                listeners[-1](event)
            return max(n_stored - self._n_without, 0)

    def recorded(lesson, trouble=""):
        session = SimpleNamespace(
            listeners=SimpleNamespace(add=listeners.append),
            teach=lambda name, wanted: None,
            teacher=SimpleNamespace(lesson=lesson),
            trouble=trouble,
        )
        assert record._lesson(session, "bar", 2, 0.05) == 2
        return capsys.readouterr().err

    messages = recorded(Lesson())
    assert "No touch" not in messages
    assert "without contact" not in messages
    # As on the page, a touch without contact is stored and one more is asked for.
    messages = recorded(Lesson(n_without_contact=3))
    assert "without contact: it does not count" in messages
    assert "touch 2 of 2" in messages
    assert "touch 3" not in messages
    # Who touches before the lesson begins may touch again.
    assert "touch again.\n" in recorded(Lesson(), trouble=LiveSession.began_before)


def test_live_goes_on_after_a_touch_that_began_before():
    """As when a robot that still touches says `start` over --publish."""
    events = queue.Queue()
    for event in ({"lesson": None}, {"episode": {"number": 1}}):
        events.put(event)
    session = SimpleNamespace(trouble=LiveSession.began_before)
    assert live._next_touch(session, events, 0.0) == {"number": 1}


def test_live_waits_while_a_robot_teaches_and_it_learns(monkeypatch):
    clock = SimpleNamespace(s=0.0, monotonic=lambda: clock.s)
    monkeypatch.setattr(live, "time", clock)
    told = [
        (1.5, {"lesson": {"name": "mug"}, "learning": False}),
        (3.0, {"lesson": None, "learning": True}),
        (4.5, {"episode": {"number": 1}}),
    ]

    def get(timeout):
        if told[0][0] > clock.s + timeout:
            raise queue.Empty
        clock.s, values = told.pop(0)
        return values

    session = SimpleNamespace(trouble="", watch=None)
    events = SimpleNamespace(get=get)
    assert live._next_touch(session, events, 2.0) == {"number": 1}


def test_the_touches_of_an_episode_that_ends_early_are_answered(
    palpate, replay, model, monkeypatch, capsys
):
    touch = {"number": 1, "posterior": {"bar": 0.6}, "unknown": 0.4, "note": ""}
    begun = {"number": 1, "touches": [touch], "decision": None, "open": True}
    episode = SimpleNamespace(
        touches=[touch], number=1, sentence="Not sure.", to_dict=lambda: begun
    )
    session = SimpleNamespace(trouble="", watch=None, episode=episode)
    for ended, answered in ((0, begun), (1, None)):
        events = queue.Queue()
        events.put({"episode": begun})
        told = live._episode(session, events, 30, 0.0, ended, quiet=False)
        assert told == answered
        assert ("Not sure." in capsys.readouterr().out) == (ended == 0)
    whole = {"number": 1, "open": False}
    for first, n_answered in ((begun, 1), (whole, 2)):
        episodes = iter([first, begun])
        monkeypatch.setattr(live, "_episode", lambda *_, quiet, e=episodes: next(e))
        result = palpate("live", model, *replay, "--episodes", "3", "--json")
        assert result.returncode == 1
        assert len(json.loads(result.stdout)["episodes"]) == n_answered


def test_an_episode_is_of_at_most_a_thousand_touches(palpate, replay, model):
    refused = palpate.refusal("live", model, *replay, "-n", "1001")
    assert "touches must be at most 1000, got 1001" in refused
    assert LiveSession.longest_episode == 1000


def test_record_names_no_archive_that_it_did_not_write(palpate, replay, tmp_path):
    words = ["record", "bar", *replay, "--gap", "10000", "--timeout", "0.3", "--json"]
    archive = tmp_path / "none.npz"
    result = palpate(*words, "--library", tmp_path / "lab", "-o", archive)
    assert result.returncode == 1
    assert json.loads(result.stdout)["output"] is None
    assert not archive.exists()


def test_live_without_an_end_keeps_no_episodes(palpate, replay, model, monkeypatch):
    class Kept(dict):
        pass

    gone = []

    def episode(session, events, most, timeout_s, ended, *, quiet):
        if len(gone) == 3:
            return None
        told = Kept(number=ended + 1)
        gone.append(weakref.ref(told))
        assert sum(kept() is not None for kept in gone) <= 2  # with the one before
        return told

    monkeypatch.setattr(live, "_episode", episode)
    palpate.printed("live", model, *replay, "--gap", "3", "--episodes", "0")
    assert len(gone) == 3


def test_record_ends_with_a_recording_that_is_over(palpate, recording, tmp_path):
    few = Touches.load(recording)[[0, 1, 2]]
    few.save(tmp_path / "few.npz")
    address = f"replay:{tmp_path / 'few.npz'}?rate=200&hold=3&gap=3"
    words = ["record", "disc", "--sensor", address, "-n", "5"]
    done = palpate(*words, "--library", tmp_path / "lab", "--timeout", "5")
    assert done.returncode == 1
    last = "All 3 touches that were recorded here are stored: 3 of 5 of disc."
    assert done.stderr.splitlines()[-1] == last
    assert done.stdout == f"3 touches of disc in {tmp_path / 'lab'}.\n"


def test_live_follows_an_episode_to_its_decision(palpate, replay, model, monkeypatch):
    words = ["live", model, *replay, "--gap", "3", "--place"]
    assert "touch   1" in palpate.printed(*words, "bar", "-n", "6")
    answer = palpate.answer(*words, "disc", "-n", "5", "--episodes", "2")
    episodes = answer["episodes"]
    assert [episode["number"] for episode in episodes] == [1, 2]
    for episode in episodes:
        assert episode["best"] == "disc"
        assert 1 <= len(episode["touches"]) <= 5
    # As the page does, it doubts names while touches look like those of another sensor.
    monkeypatch.setattr(
        LiveSession, "_check_mounting", lambda self: setattr(self, "alarm", "Other?")
    )
    assert "Other?\n" in palpate(*words, "disc", "-n", "5", "--episodes", "2").stderr


LEVELS = "--error", "0.02", "--refusal", "0.3"


def test_live_decides_at_the_refusal_asked_for(palpate, replay, model, error_shares):
    words = ["live", model, *replay, "--gap", "3", "-n", "2", *LEVELS]
    (episode,) = palpate.answer(*words)["episodes"]
    assert (episode["error"], episode["refusal"]) == (0.02, 0.3)
    # A model that is read is tried first, at the usual error.
    assert error_shares - {(0.01, None)} == {(0.02, 0.3)}


def test_serve_decides_at_the_refusal_asked_for(
    palpate, monkeypatch, recording, model, error_shares
):
    pytest.importorskip("fastapi", reason='needs the extra "web"')
    episodes, touches = [], Touches.load(recording)

    def run(server, app):
        error_shares.clear()
        episodes.append(app.state.session.post_touch(touches.images[0]))

    monkeypatch.setattr(PageServer, "run", run)
    palpate.printed("serve", "--model", model, "--port", "0", *LEVELS)
    (episode,) = episodes
    assert (episode["error"], episode["refusal"]) == (0.02, 0.3)
    assert error_shares == {(0.02, 0.3)}


def test_serve_prints_an_address_that_opens_and_ends_by_ctrl_c():
    pytest.importorskip("fastapi", reason='needs the extra "web"')
    process = subprocess.Popen(
        [sys.executable, "-m", "palpate", "serve", "--port", "0", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    server = json.loads(process.stdout.readline())
    assert server["address"].startswith("http://127.0.0.1:")
    assert httpx.get(server["address"]).status_code == 401
    answer = httpx.get(
        server["address"], params={"token": server["token"]}, follow_redirects=True
    )
    assert "<title>palpate" in answer.text
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=20)
    assert out == ""
    assert server["token"] not in err


def test_live_says_why_a_model_does_not_suit_the_sensor(palpate, model):
    result = palpate.refusal("live", model, "--sensor", "sim:mug", "--timeout", "4")
    assert "120 x 120 pixels" in result
    assert "got one of 12 x 12" in result


def test_live_says_why_a_touch_was_not_taken(palpate, replay, model, monkeypatch):
    def refuse(self, touch, **options):
        raise ValueError("The touch is none.")

    monkeypatch.setattr(Episode, "add", refuse)
    result = palpate.refusal("live", model, *replay, "--gap", "3", "--timeout", "20")
    assert result.endswith("palpate: The touch is none.\n")


def test_record_says_that_the_disk_is_full(palpate, replay, tmp_path, monkeypatch):
    stored, plain = [], TouchLibrary.add

    def add(self, *touches, **where):
        if len(stored) == 2:
            raise OSError("No space left on device")
        stored.append(plain(self, *touches, **where))
        return stored[-1]

    monkeypatch.setattr(TouchLibrary, "add", add)
    words = ["record", "bar", *replay, "--gap", "3", "--timeout", "20"]
    result = palpate(*words, "--library", tmp_path / "l", "-n", "5")
    assert result.returncode == 1
    assert "palpate: No space left on device" in result.stderr
    assert "2 touches of bar in" in result.stdout


def test_a_name_with_blanks_is_recorded_and_written(palpate, replay, tmp_path):
    words = ["record", " tea  cup", *replay, "--gap", "3", "--place", "bar", "-n", "2"]
    result = palpate(*words, "--library", tmp_path / "l", "-o", tmp_path / "cup.npz")
    assert result.returncode == 0
    assert Touches.load(tmp_path / "cup.npz").object.tolist() == ["tea cup"] * 2


def test_a_report_of_a_sensor_that_reads_nothing_is_written(
    palpate, tmp_path, monkeypatch
):
    nothing = np.full((1, 6, 6), np.nan, np.float32)
    monkeypatch.setattr(ReplaySensor, "_with_noise", lambda self, image: nothing[0])
    Touches(np.ones((3, 6, 6), np.float32), geometry="array").save(tmp_path / "t.npz")
    sensor = ["--sensor", f"replay:{tmp_path / 't.npz'}", "--rate", "200"]
    words = ["sensor", "check", *sensor, "--seconds", "0.5"]
    result = palpate(*words, "--report", tmp_path / "r.html")
    assert result.returncode == 1
    assert result.stderr == ""
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "rest, nothing but NaN" in page


def test_a_model_learnt_of_a_library_knows_its_touches_and_sensor(
    palpate, recording, tmp_path
):
    folder, model = tmp_path / "library", tmp_path / "m.palpate"
    zero = np.zeros((12, 12), np.uint8)
    recorded = Touches.load(recording).with_columns(no_contact=zero)
    with TouchLibrary.open(folder, create=True) as library:
        ids = library.add(recorded)
        library.add(recorded[:5].with_columns(object=["lone"] * 5))
    where = "object != lone"
    palpate.printed("learn", folder, "--where", where, "-o", model)
    learnt = ObjectRecogniser.load(model)
    assert learnt.memory_.touch_ids.tolist() == ids
    memory = SensorMemory.from_dict(learnt.memory_.sensor)
    assert (memory.no_contact == zero).all()
    assert memory.n_touches == 20
    watch = "sensor", "check", "--sensor", "sim:bar10", "--seconds", "300"
    other = palpate.refusal(*watch, "--model", model)
    assert "must be of images of 10 x 10 taxels" in other
    assert "got one of 12 x 12 taxels" in other
    moved = ReplaySensor(recorded.with_columns(no_contact=zero + np.uint8(60)))
    session = LiveSession(moved, model=model)
    (warning,) = session.to_dict()["sensor"]["warnings"]
    assert "At rest the sensor differs" in warning
    more = tmp_path / "more.palpate"
    words = ["learn", folder, "--where", "object = lone", "-o", more]
    palpate.printed(*words, "--extend", model)
    extended = ObjectRecogniser.load(more)
    assert extended.memory_.touch_ids[:20].tolist() == ids
    lone = extended.memory_.touch_ids[extended.memory_.labels == "lone"].tolist()
    assert len(set(lone) - set(ids) - {""}) == 5
    assert (extended.memory_.sensor["no_contact"] == zero).all()


def test_serve_warns_when_it_listens_to_the_network(palpate, served):
    result = palpate("serve", "--port", "0", "--host", "0.0.0.0")
    starting, address, code = result.stdout.split("\n", 2)
    assert starting == "Starting; the address follows."
    assert re.match(r"Open http://[\d.]+:\d+/\?token=", address)
    assert "0.0.0.0" not in address  # no browser goes there
    assert "█" in code
    assert "everybody on that network who knows the token" in result.stderr
    quiet = palpate("serve", "--port", "0")
    assert quiet.stderr == ""
    assert "█" not in quiet.stdout


def test_the_address_is_drawn_as_a_code_that_phones_read(palpate, served):
    halves = {" ": (0, 0), "▄": (0, 1), "▀": (1, 0), "█": (1, 1)}
    codes = set()
    for _ in range(3):  # OpenCV's reader misses about 1 % of faultless codes
        printed = palpate("serve", "--port", "0", "--host", "0.0.0.0").stdout
        _, address, *lines, _ = printed.rstrip("\n").split("\n")
        rows = [[halves[c][half] for c in line] for line in lines for half in (0, 1)]
        drawn = np.kron(np.array(rows, np.uint8) * 255, np.ones((8, 8), np.uint8))
        read = cv2.QRCodeDetector().detectAndDecode(drawn)[0]
        assert read in ("", address.removeprefix("Open "))
        codes.add(read)
    assert codes != {""}


def test_the_token_is_the_one_that_was_chosen_or_kept(
    palpate, monkeypatch, served, tmp_path
):
    def token_of(words):
        return palpate.answer(*words)["token"]

    words = ["serve", "--port", "0"]
    kept = [*words, "--library", tmp_path / "l"]
    assert token_of(kept) == token_of(kept)
    assert token_of(words) != token_of(words)
    chosen = "a-token-of-my-own"
    assert token_of([*words, "--token", chosen]) == chosen
    monkeypatch.setenv("PALPATE_TOKEN", chosen)
    assert token_of(kept) == chosen
    assert "16 to 200 letters" in palpate.refusal(*words, "--token", "short")


def test_the_core_of_the_loop_needs_none_of_the_extras():
    code = (
        "import sys, palpate.web, palpate.sensors; "
        "print([m for m in ('fastapi', 'uvicorn', 'serial', 'cv2_enumerate_cameras') "
        "if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


def test_record_in_two_mountings_makes_two_sessions(
    palpate, replay, tmp_path, monkeypatch
):
    monkeypatch.setattr("sys.stdin", io.StringIO("\n" * 1000))
    archive = tmp_path / "bar.npz"
    words = ["--sessions", "2", "--changed", "new gel", "--library", tmp_path / "lab"]
    result = palpate(
        *["record", "bar", *replay, "--gap", "40", "--place", "bar", "-n", "4"],
        *[*words, "-o", archive],
    )
    assert "Lift the sensor and place it again" in result.stderr
    names, counts = np.unique(Touches.load(archive).session, return_counts=True)
    assert counts.tolist() == [2, 2]
    assert sum("new gel" in name for name in names) == 1
    assert sum("placed again" in name for name in names) == 1


def test_a_sensor_that_is_not_plugged_in_again_yet_is_waited_for(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("\n\n"))
    states = [SensorError("COM3 went away. Plug it in again.")]

    def take_baseline(changed):
        if states:
            raise states.pop()

    record._place_again(SimpleNamespace(take_baseline=take_baseline))
    assert "Plug it in again. Then press Enter.\n" in capsys.readouterr().err


def frames_of_a_check(palpate, address, page):
    """Check a sensor for a second; return of how many frames that found nothing."""
    words = ("sensor", "check", "--sensor", address, "--seconds", "1")
    result = palpate(*words, "--report", page, "--json")
    answer = json.loads(result.stdout)
    # The machine may hold frames up; nothing else can be wrong with it.
    held_up = [s for s in answer["findings"] if "One frame" in s or "lost" in s]
    assert answer["findings"] == held_up
    assert result.returncode == (1 if held_up else 0)
    return answer["figures"]["frames"]


def test_a_simulated_array_is_reported_as_healthy(palpate, tmp_path):
    page = tmp_path / "health.html"
    assert frames_of_a_check(palpate, "sim:bar10?gap=9000&rate=100", page) > 24
    assert "drift" in page.read_text()
    assert "http" not in page.read_text().replace("http-equiv", "")


def test_channels_that_are_no_colours_and_a_dead_taxel_are_reported(palpate, tmp_path):
    rng, page = np.random.default_rng(0), tmp_path / "health.html"
    images = rng.normal(size=(40, 6, 6, 2))
    images[:, 0, 0] = np.nan
    about = {"channels": ["shear", "force"], "geometry": "array"}
    Touches(images, no_contact=images[0], **about).save(tmp_path / "pad.npz")
    address = f"replay:{tmp_path / 'pad.npz'}?rate=100&gap=9000"
    assert frames_of_a_check(palpate, address, page) > 24
    assert "rest" in page.read_text()
    assert "nan" not in page.read_text()


def test_a_touched_sensor_is_not_reported_as_healthy(palpate):
    words = ("sensor", "check", "--sensor", "sim:bar10?rate=100", "--seconds", "1")
    result = palpate(*words)
    assert result.returncode == 1
    assert "touch" in result.stdout.splitlines()[0]


def test_a_folder_that_may_not_be_written_to_is_told_before_the_work(
    palpate, tmp_path, monkeypatch
):
    """The touches are not there: they were to be read after that."""

    def refuse(**how):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("palpate._durable.TemporaryFile", refuse)
    gone, page = tmp_path / "gone.npz", tmp_path / "page.html"
    model = page.with_suffix(".palpate")
    for words, place in (
        (["evaluate", "--train", gone, "--split", "last", "--report", page], page),
        (["check", gone, "--report", page], page),
        (["learn", gone, "-o", model], model),
    ):
        done = palpate.refusal(*words)
        assert f"palpate: {place} must be a place with room" in done


def test_a_library_that_is_served_already_is_named_with_its_address(
    palpate, served, tmp_path
):
    pytest.importorskip("fcntl", reason="Windows keeps no two servers apart")
    library = tmp_path / "desk"
    words = ["serve", "--library", library, "--json"]
    with closing(PageServer()) as taken:
        port = urlsplit(taken.address).port
        used = palpate.refusal(*words, "--port", port)
        assert "another program, perhaps a palpate that was not ended" in used
        assert "free one" in used
    assert palpate(*words, "--port", "0").stderr == ""  # no server has it any more
    app = create_app(LiveSession(), "token")
    with PageServer(library=library).running(app, log_level="error") as address:
        beside = palpate(*words, "--port", "0")
        message = f"{library} is served already, at {address}"
        assert message in beside.stderr
        assert json.loads(beside.stdout)["address"]
        with closing(PageServer()) as taken:
            port = urlsplit(taken.address).port
            refused = palpate.refusal(*words, "--port", port)
        assert message in refused
        assert f"port {port}" in refused
    assert palpate(*words, "--port", "0").stderr == ""


def test_ctrl_c_says_what_is_kept(palpate, monkeypatch, recording, tmp_path):
    pytest.importorskip("fastapi", reason='needs the extra "web"')

    def stop(*arguments, **more):
        raise KeyboardInterrupt

    def stopped(*words):
        result = palpate(*words)
        assert (result.returncode, result.stdout) == (130, "")
        (line,) = result.stderr.splitlines()
        return line

    monkeypatch.setattr("palpate.recognition.ObjectRecogniser.fit", stop)
    monkeypatch.setattr("palpate.evaluation.evaluate", stop)
    monkeypatch.setattr(PageServer, "run", stop)
    monkeypatch.setattr("palpate.touches.PictureCheck.of_folder", stop)
    model, report = tmp_path / "m.palpate", tmp_path / "r.html"
    model.write_text("before")
    line = stopped("learn", recording, "-o", model)
    assert line.endswith(f"Ctrl-C: nothing is learnt, and {model} is as it was.")
    assert model.read_text() == "before"
    line = stopped("learn", recording, "-o", tmp_path / "new.palpate")
    assert line.endswith("Ctrl-C: nothing is learnt.")
    words = ["evaluate", "--train", recording, "--split", "last"]
    assert stopped(*words).endswith("Ctrl-C: there are no figures.")
    assert stopped(*words, "--report", report).endswith("there are no figures.")
    assert not report.exists()
    report.write_text("before")
    assert f"and {report} is as it was." in stopped(*words, "--report", report)
    assert report.read_text() == "before"
    assert "no file is half written" in stopped("check", tmp_path)
    words = ["serve", "--port", "0", "--library", tmp_path / "desk"]
    kept = f"What was taught is kept in {tmp_path / 'desk'}."
    assert kept in palpate.refusal(*words, code=130)


@pytest.mark.parametrize("words", [["serve"], ["record", "mug"]], ids=" ".join)
def test_a_bad_picture_of_a_replay_names_the_command_that_lists_all(
    palpate, tmp_path, words
):
    pytest.importorskip("fastapi", reason='needs the extra "web"')
    put(tmp_path / "touches" / "mug" / "1.png").write_text("no picture")
    words = [*words, "--library", tmp_path / "l", "--sensor"]
    result = palpate.refusal(*words, f"replay:{tmp_path / 'touches'}?rate=9")
    assert "mug/1.png" in result
    assert f"`palpate check {tmp_path / 'touches'}` lists all" in result
    absent = palpate.refusal(*words, f"replay:{tmp_path / 'nowhere'}")
    assert "palpate check" not in absent


def test_a_replay_without_rest_does_not_call_its_pictures_wrong(palpate, tmp_path, rng):
    for number, name in enumerate(["mug", "pen"] * 4):
        picture = rng.integers(0, 255, (80, 90))
        put(tmp_path / "touches" / name / f"{number}.png", picture)
    words = ["record", "mug", "--library", tmp_path / "l", "--sensor"]
    result = palpate.refusal(*words, f"replay:{tmp_path / 'touches'}?rate=9")
    assert "must show what touching nothing looks like" in result
    assert "palpate check" not in result
