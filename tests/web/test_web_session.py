"""The live loop by itself, without any web in it."""

import os
import queue
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from palpate import Touches
from palpate.library import TouchLibrary
from palpate.recognition import ModelFileError, ObjectRecogniser
from palpate.sensors import (
    ContactError,
    DetectedTouch,
    Reading,
    ReplaySensor,
    SensorError,
    SensorMemory,
)
from palpate.web import LiveSession

from .conftest import SIDE, HandSensor, LearningError, Still, learn_job, waited


@pytest.fixture(scope="module")
def model(drawn, tmp_path_factory):
    """A model that knows the disc and the bar, and remembers its sensor."""
    learnt = drawn[drawn.object != "both"][::2]
    recogniser = ObjectRecogniser().fit(learnt)
    memory = SensorMemory.of(learnt.images, learnt.no_contact)
    recogniser.remember_sensor(memory.to_dict())
    return recogniser.save(tmp_path_factory.mktemp("model") / "m.palpate")


def test_touches_of_the_sensor_move_the_belief(make_session, model):
    session = make_session(library=None, model=model)
    events = queue.Queue()
    session.listeners.add(events.put)
    with session:
        session.place("disc")
        assert waited(lambda: len(session.episode.touches) >= 5)
        session.place(None)
    kinds = {events.get_nowait().kind for _ in range(events.qsize())}
    assert {"frame", "contact", "touch", "state"} <= kinds
    assert session.episode.to_dict()["best"] == "disc"
    numbers = [touch.number for touch in session.episode.touches]
    assert numbers == list(range(1, len(numbers) + 1))
    assert session.health.to_dict()["belief_ms"] < 20_000  # since the last frame
    assert session.health.to_dict()["n_dropped"] == 0


def test_touches_go_on_after_whatever_fails_with_some(make_session, model, monkeypatch):
    class OwnError(Exception):
        """Of a package that a model needs."""

    def fail(*arguments):
        raise OwnError("no room on the card")

    session = make_session(model=model)
    with session:
        with monkeypatch.context() as patched:
            patched.setattr(session.recogniser, "evidence", fail)
            session.place("disc")
            assert waited(lambda: "no room on the card" in session.trouble)
            # Nor can the state be told, as where the library is damaged.
            patched.setattr(session.teacher, "to_dict", fail)
            patched.setattr(session.listeners, "_takes_frames", {fail: False})
            n_taken = len(session.watch._recent)
            assert waited(lambda: len(session.watch._recent) > n_taken + 1)
        assert waited(lambda: len(session.episode.touches) > 1)
        session.place(None)


def test_a_lesson_takes_so_many_touches_and_no_more(make_session):
    session = make_session()
    with session:
        session.teach("disc", 4)
        session.place("disc")
        assert waited(lambda: session.teacher.lesson is None)
        session.place(None)
        stored = session.teacher.library.list()
        assert [row.object for row in stored] == ["disc"] * 4
        assert session.undo() == "disc"
        assert session.teacher.library.count() == 3


def test_the_baseline_is_refused_while_touching(make_session, drawn):
    sensor = ReplaySensor(drawn, rate_hz=100, hold=1000, gap=2)
    session = LiveSession(sensor)
    with session:
        assert waited(lambda: session.watch.detector.touching)
        # What is played cannot be lifted.
        message = "disc touches the sensor. Put nothing on the desk"
        with pytest.raises(ContactError, match=message):
            session.take_baseline()
        session.place(None)
        assert waited(lambda: not session.watch.detector.touching)
        session.take_baseline()
        assert not session.baseline.any()
        sensor_state = session.to_dict()["sensor"]
        assert sensor_state["baseline"]
        assert sensor_state["zero"]  # the name before, for one release
    with pytest.raises(SensorError, match="no sensor"):
        LiveSession().take_baseline()


def test_a_driver_that_is_asked_too_often_gets_a_baseline(rng, monkeypatch, lower):
    """Asked up to 1000 times a second, six times for each reading of its device."""
    readings = rng.normal(100, 1.0, (400, SIDE, SIDE)).astype(np.float32)

    class Polled(HandSensor):
        n_asked = 0

        def _grab(self):
            time.sleep(0.001)
            self.n_asked += 1
            return [readings[self.n_asked // 6 % 400]]

    sensor = Polled()
    sensor.dtype = np.dtype(np.float32)
    with LiveSession(sensor) as session:
        session.take_baseline()
        assert session.watch.detector.noise == pytest.approx(1.0, rel=0.4)
        # Ten frames of 10 ms would be half a period of the mains, which they hum with.
        lower(monkeypatch, baseline_s=0.1)
        n_before = sensor.n_asked
        session.take_baseline(force=True)
        assert sensor.n_asked - n_before > 30


def press_once(sensor, session):
    sensor.show(session, pressed=True)
    assert waited(lambda: session.watch.detector.touching)
    sensor.show(session, pressed=False)
    assert waited(lambda: not session.watch.detector.touching)


def test_a_test_press_is_shown_and_not_stored(hand, tmp_path):
    with LiveSession(hand, library=tmp_path / "library") as session:
        with pytest.raises(SensorError, match="no test press"):
            session.press_difference()
        session.take_baseline(ask_press=True)
        state = session.watch.to_dict
        assert state()["press"] == {"found": False, "lower": False, "number": 0}
        for number in (1, 2):
            press_once(hand, session)
            assert waited(lambda n=number: state()["press"]["number"] == n)
        assert state()["press"] == {"found": True, "lower": False, "number": 2}
        difference = session.press_difference()
        assert difference.max() == 180
        assert (difference > 0).sum() == 20
        session.end_press()
        assert state()["press"] is None
        assert session.episode.touches == []
        press_once(hand, session)
        assert waited(lambda: len(session.episode.touches) == 1)


def test_a_touch_under_way_is_of_neither_a_new_lesson_nor_a_new_episode(hand, tmp_path):
    with LiveSession(hand, library=tmp_path / "library") as session:
        session.take_baseline()
        starts = session.begin_episode, lambda: session.teach("pen", 2)
        for start in starts:
            hand.show(session, pressed=True)
            assert waited(lambda: session.watch.detector.touching)
            start()
            hand.show(session, pressed=False)
            assert waited(lambda: "began before" in session.trouble)
            session.trouble = ""
            assert session.episode.touches == []
        assert session.teacher.lesson.done == 0
        press_once(hand, session)
        assert waited(lambda: session.teacher.lesson.done == 1)


def test_a_first_baseline_of_a_pressed_array_is_refused(hand):
    hand.pressed = True
    with LiveSession(hand) as session:
        with pytest.raises(ContactError, match="row 4 column 6, where 20 neighbouring"):
            session.take_baseline()
        assert session.baseline is None
        session.take_baseline(force=True, ask_press=True)  # somebody insists
        hand.show(session, pressed=False)
        assert waited(lambda: session.watch.detector.touching)
        hand.show(session, pressed=True)
        assert waited(lambda: session.watch.press is not None)
        assert session.to_dict()["sensor"]["press"]["lower"]
        assert session.press_difference().max() == 180
        session.end_press(undo=True)
        assert session.baseline is None
        hand.show(session, pressed=False)
        session.take_baseline()
        assert (session.baseline == 20).all()


def test_a_press_that_ends_while_the_baseline_is_refused_is_none(hand):
    with LiveSession(hand) as session:
        session.take_baseline()
        hand.show(session, pressed=True)
        assert waited(lambda: session.watch.detector.touching)
        pressed = hand.read_latest()

        def read_as_it_ends():
            hand.show(session, pressed=False)
            assert waited(lambda: not session.watch.detector.touching)
            return pressed

        hand.read_latest = read_as_it_ends
        session.take_baseline()
        assert session.baseline.max() == 20


def test_the_state_of_a_sensor_without_a_baseline(hand):
    hand.fixed, hand.unfixed = {"exposure": False}, "It does not keep exposure fixed."
    state = LiveSession(hand).to_dict()["sensor"]
    assert (state["name"], state["shape"]) == ("hand", [12, 12])
    assert (state["baseline"], state["zero"], state["desk"]) == (False, False, None)
    assert state["fixed"] == {"exposure": False}
    assert state["warnings"] == [hand.unfixed]


def test_a_frame_of_no_contact_of_another_sensor_is_said_and_taken_anew(hand):
    hand.no_contact = lambda: np.zeros((4, 4), np.uint8)
    with LiveSession(hand) as session:
        told = "Frames must be of 4 x 4 taxels like the frame of no contact, got 12"
        assert waited(lambda: told in session.to_dict()["sensor"]["lost"])
        session.take_baseline()
        press_once(hand, session)
        assert session.to_dict()["sensor"]["lost"] == ""


def test_a_lesson_ends_the_test_press(hand, tmp_path):
    with LiveSession(hand, library=tmp_path / "library") as session:
        session.take_baseline(ask_press=True)
        session.teach("cup", 1)
        press_once(hand, session)
        assert waited(lambda: session.teacher.lesson is None)
        assert session.teacher.library.count() == 1


def test_the_touches_of_an_episode_begin_a_lesson(make_session, drawn):
    session = make_session()
    with session:
        place = {"position_mm": (1.0, 2.0, 3.0), "direction": (0.0, 0.0, -1.0)}
        for image, placed in zip(drawn.images[:3], (None, place, None), strict=True):
            session.post_touch(image, placed)
        session.teach("disc", 2, keep_episode=True)
        assert session.teacher.lesson is None  # two were wanted
        kept = session.teacher.touches("disc")
        # The last two: before them something else may have lain there.
        np.testing.assert_array_equal(kept.images, drawn.images[1:3])
        positions_mm = [[1, 2, 3], [np.nan] * 3]
        np.testing.assert_array_equal(kept.columns["position_mm"], positions_mm)
        session.post_touch(drawn.images[5])
        session.teach("bar", 4, keep_episode=True)
        lesson = session.to_dict()["lesson"]
        assert (lesson["name"], lesson["wanted"], lesson["done"]) == ("bar", 4, 1)
        assert session.episode.touches == []
        session.stop_teaching()


def test_touches_from_before_a_baseline_begin_no_lesson_after_it(hand, tmp_path):
    with LiveSession(hand, library=tmp_path / "library") as session:
        session.take_baseline()
        press_once(hand, session)
        assert waited(lambda: len(session.episode.touches) == 1)
        session.episode.touches[0].time_s += 3600  # the clock has gone back since
        session.take_baseline()
        session.teach("mug", 3, keep_episode=True)
        assert session.teacher.lesson.done == 0
        assert "since the baseline" in session.message
        session.stop_teaching()
        press_once(hand, session)
        assert waited(lambda: len(session.episode.touches) == 1)
        session.take_baseline(ask_press=True)
        session.end_press(undo=True)  # so that the touch is of the baseline of now
        session.teach("mug", 3, keep_episode=True)
        assert session.teacher.lesson.done == 1
        sessions = {row.session for row in session.teacher.newest("mug", 9)}
        session.stop_teaching()
        session.take_baseline(ask_press=True)
        session.end_press(undo=True)
        session.post_lesson("mug", np.full((SIDE, SIDE), 90, np.uint8))
        assert {row.session for row in session.teacher.newest("mug", 9)} == sessions
        for level in (90, 91, 92):
            session.post_touch(np.full((SIDE, SIDE), level, np.uint8))
            if level == 91:
                session.take_baseline()
        session.teach("cup", 3, keep_episode=True)
        assert session.message == (
            "Touch 1 of 3 of cup is stored. Those from before the baseline was taken "
            "are not kept."
        )


def test_a_touch_on_its_way_is_not_of_a_baseline_taken_meanwhile(hand, tmp_path):
    with LiveSession(hand, library=tmp_path / "library") as session:
        session.take_baseline()
        session.teach("mug", 3)
        now_s = time.monotonic()
        image = np.full((SIDE, SIDE), 90, np.uint8)
        touch = DetectedTouch(image, now_s, now_s, 70.0, 5)
        session.take_baseline()
        session._on_touch(touch, now_s)
        assert session.teacher.lesson.done == 0
        assert session.trouble == session.began_before


def test_touches_of_an_episode_keep_what_the_sensor_told_beside_them(
    tmp_path, connected
):
    class Warm(HandSensor):
        def _grab(self):
            (image,) = super()._grab()
            return [Reading(image, columns={"temperature_c": 21.5})]

    hand = Warm()
    with LiveSession(hand, library=tmp_path / "library") as session:
        session.take_baseline()
        press_once(hand, session)
        assert waited(lambda: len(session.episode.touches) == 1)
        session.teach("mug", 1, keep_episode=True)
        stored = session.teacher.touches("mug")
        press_once(hand, session)
        assert waited(lambda: len(session.episode.touches) == 1)
        with connected(session) as client:
            archive = client.get("/api/episode/archive").content
            session.take_baseline()
            assert session.episode.as_touches(session.baseline).no_contact is None
    (tmp_path / "episode.npz").write_bytes(archive)
    for touches in (stored, Touches.load(tmp_path / "episode.npz")):
        assert touches.columns["temperature_c"] == [21.5]
        assert touches.geometry == "array"
        assert (touches.no_contact == 20).all()


@pytest.mark.parametrize("unknown", ["x_mm", "direction_z", "force_n"])
def test_a_place_that_is_not_known_yet_is_none(connected, tmp_path, unknown):
    ways = [f"direction_{axis}" for axis in "xyz"]
    names = ["x_mm", "y_mm", "z_mm", *ways, "force_n"]
    values = 1.0, 2.0, 3.0, 0.0, 0.0, -1.0, 0.5

    class Arm(HandSensor):
        def _grab(self):
            (image,) = super()._grab()
            columns = dict(zip(names, values, strict=True)) | {unknown: np.nan}
            return [Reading(image, columns=columns)]

    hand = Arm()
    with connected(LiveSession(hand, library=tmp_path / "library")) as client:
        client.session.take_baseline()
        press_once(hand, client.session)
        assert waited(lambda: len(client.session.episode.touches) == 1)
        (touch,) = client.get("/api/state").json()["episode"]["touches"]
        assert touch["force_n"] == (None if unknown == "force_n" else 0.5)
        where = [1.0, 2.0, 3.0] if unknown == "force_n" else None
        assert touch["position_mm"] == where


def test_a_sensor_that_has_changed_since_learning_is_warned_of(model, drawn):
    same = LiveSession(ReplaySensor(drawn), model=model)
    assert same.to_dict()["sensor"]["warnings"] == []
    moved = drawn.with_columns(no_contact=drawn.no_contact + np.uint8(60))
    other = LiveSession(ReplaySensor(moved), model=model)
    (warning,) = other.to_dict()["sensor"]["warnings"]
    assert "At rest the sensor differs" in warning


def test_a_taxel_that_flickers_by_one_count_is_not_stored(tmp_path):
    class Flickering(Still):
        step = 1.0
        levels = (0.0,) * 4

        def _grab(self):
            time.sleep(0.002)
            image = np.zeros((16, 16), np.float32)
            image[3, 3] = self.levels[self.n_frames % 4]
            return [image]

    sensor = Flickering((16, 16), dtype=np.float32)
    with LiveSession(sensor, library=tmp_path / "library") as session:
        session.take_baseline()
        sensor.levels = [0.0, 0.0, 1.0, 1.0]
        session.teach("cup", 2)
        begun = sensor.n_frames
        assert waited(lambda: sensor.n_frames > begun + 40)
        assert session.teacher.library.count() == 0
        sensor.levels = [0.0, 0.0, 200.0, 200.0]  # a change of 200 / 16 is one
        assert waited(lambda: session.teacher.lesson is None)


def test_a_model_of_another_sensor_is_refused_where_nothing_can_be_learnt(model, drawn):
    other = ReplaySensor(Touches(drawn.images[:, :8, :8]))
    with pytest.raises(ValueError, match=r"8 x 8 taxels.* of 12 x 12 taxels. Learn"):
        LiveSession(other, model=model).start()
    assert not other.connected


def test_a_missing_sensor_leaves_no_library_behind(hand, tmp_path):
    hand.unplugged = True
    session = LiveSession(hand, library=tmp_path / "library")
    with pytest.raises(SensorError, match="unplugged"):
        session.start()
    assert not (tmp_path / "library").exists()


def test_touches_too_few_for_two_objects_make_no_model(drawn, tmp_path):
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        library.add(drawn[drawn.object == "disc"])
        library.add(drawn[drawn.object == "bar"][:1])
    learnt = learn_job(tmp_path / "library", tmp_path / "o.palpate")
    assert learnt["objects"] == []
    assert not (tmp_path / "o.palpate").exists()


def test_no_process_is_started_where_nothing_can_be_taught(learning_starts):
    with pytest.raises(ValueError, match="without a library"):
        LiveSession().teach("cup", 3)
    assert learning_starts == []


def test_learning_is_refused_while_the_session_learns(make_session):
    session = make_session(sensor=False)
    with session:
        session._learn_lock.acquire()
        with pytest.raises(LearningError, match="learning already"):
            session.learn()
        session._learn_lock.release()


def test_changes_while_a_session_learns_are_learnt_afterwards(make_session, model):
    session = make_session(sensor=False)
    session._use(ObjectRecogniser.load(model))
    orders = []
    with session:
        session._learn_lock.acquire()  # as if it were learning
        session.forget("disc")
        session._learn_in_process = orders.append
        session._learn([])  # ends what goes on, and begins what waits
        assert waited(lambda: len(orders) == 2 and not session.learning)
    assert orders == [[], [("disc", "")]]


def test_frames_go_on_while_a_session_learns(make_session, drawn, learning_apart):
    session = make_session(rate_hz=25.0)
    with session:
        session.teacher.library.add(drawn[::3])
        session.learn(wait=True)
        assert session.recogniser is not None
        # The sensor keeps 256 frames: a stall of over 10 s would have dropped some.
        assert session.health.to_dict()["n_dropped"] == 0


def test_a_lesson_begins_while_another_is_learnt(make_session, another_learns):
    with make_session() as session:
        begins = threading.Thread(target=session.teach, args=("cup", 3), daemon=True)
        begins.start()
        assert waited(lambda: session.teacher.lesson is not None, 5.0)
        begins.join()


def learning_processes():
    """The processes that this one has started to learn in."""
    learning = []
    for children in Path(f"/proc/{os.getpid()}/task").glob("*/children"):
        with suppress(FileNotFoundError, ProcessLookupError):  # it has ended since
            for pid in children.read_text().split():
                if b"_learning" in Path(f"/proc/{pid}/cmdline").read_bytes():
                    learning.append(int(pid))
    return learning


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs Linux's /proc")
@pytest.mark.slow
def test_the_process_that_learns_stays_and_is_replaced_when_it_ends(
    make_session, drawn, learning_apart
):
    with make_session(sensor=False) as session:
        session.teacher.library.add(drawn[drawn.object != "both"][::4])
        session.learn(wait=True)
        (first,) = learning_processes()
        os.kill(first, signal.SIGINT)  # as Ctrl-C in a terminal does to both
        session.learn(wait=True)
        assert learning_processes() == [first]
        assert session.learn_error == ""
        session.learn()
        os.kill(first, signal.SIGKILL)  # in the midst of it, or just before
        assert waited(lambda: not session.learning)
        assert "ended with -9; was memory short?" in session.learn_error
        names = session.recogniser.classes_.tolist()
        session.learn(wait=True)
        assert (session.learn_error, learning_processes() != [first]) == ("", True)
        assert session.recogniser.classes_.tolist() == names


def test_a_missing_model_and_wrong_arguments_are_refused(tmp_path, drawn):
    with pytest.raises(ModelFileError, match="no model file"):
        LiveSession(model=tmp_path / "none.palpate")
    with pytest.raises(ValueError, match="error must be finite and between"):
        LiveSession(error=0.9)
    with pytest.raises(ValueError, match="summary must be one of"):
        LiveSession(ReplaySensor(Touches(drawn.images)), summary="loudest")
    session = LiveSession(ReplaySensor(Touches(drawn.images)), library=tmp_path / "l")
    with pytest.raises(ValueError, match="wanted must be at most 1000"):
        session.teach("cup", 5000)
    session.stop()


class RestingSensor(HandSensor):
    """An array whose taxels rest at levels of their own."""

    def _grab(self):
        super()._grab()
        return [self.rest]


def test_an_array_that_rests_at_other_levels_today_is_no_other_array(drawn, tmp_path):
    two = drawn[drawn.object != "both"]
    rest = np.random.default_rng(0).integers(0, 80, (SIDE, SIDE)).astype(np.uint8)
    taught = Touches(
        two.images // 2 + rest, object=two.object, no_contact=rest, geometry="array"
    )
    learnt = ObjectRecogniser(rehearse=False).fit(taught[::2])
    assert learnt.encoder_.as_changes
    path = learnt.save(tmp_path / "m.palpate")
    sensor = RestingSensor()
    sensor.rest = today = np.ascontiguousarray(rest[::-1])
    new = (two.images // 2 + today)[1::6]
    with LiveSession(sensor, library=None, model=path) as session:
        session.take_baseline()
        there = []
        for image in new:
            session.post_touch(image)
            there.append(session.episode.evidence.log_likelihood[0])
        assert session.alarm == ""
    here = learnt.evidence(Touches(new, no_contact=today)).log_likelihood
    np.testing.assert_allclose(there, here, atol=1e-4)
    right = learnt.classes_[here.argmax(axis=1)] == two.object[1::6]
    assert right.mean() > 0.8


def test_another_mounting_is_reported_after_ten_touches(make_session, drawn, model):
    learnt = drawn[drawn.object != "both"]
    with make_session(sensor=False, library=None, model=model) as session:
        for image in learnt.images[1::6]:
            session.post_touch(image)
        assert session.alarm == ""
        for image in learnt.images[1::3]:
            session.post_touch(image // 2 + 60)
        assert "sensor, mounting or light" in session.alarm
        assert session.advice[0] == session.to_dict()["alarm"] == session.alarm


def test_touches_without_contact_do_not_count_towards_the_mounting(
    make_session, drawn, model, monkeypatch
):
    learnt = drawn[drawn.object != "both"]
    checked = []

    def check(self, evidence):
        checked.append([*evidence.flags])
        return SimpleNamespace(message=lambda: "changed")

    monkeypatch.setattr(ObjectRecogniser, "check_mounting", check)
    with make_session(sensor=False, library=None, model=model) as session:
        for image in learnt.images[1:30:3]:
            session.post_touch(np.zeros_like(image))
        assert {*session.episode.evidence.flags} == {"no contact"}
        for image in learnt.images[1:28:3]:
            session.post_touch(image)
        assert checked == []
        session.post_touch(learnt.images[1])
        assert checked == [[""] * 10]
        assert session.alarm


def test_learning_leaves_out_touches_without_a_number_and_names_them(drawn, tmp_path):
    images = drawn.images[:60].astype(np.float32)
    images[[5, 41]] = np.nan
    touches = Touches(images, object=drawn.object[:60], geometry="array")
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        ids = library.add(touches)
        empty = ids[5], ids[41]
        with pytest.raises(ValueError, match=f"NaN in touch {', '.join(empty)}.*id"):
            ObjectRecogniser("liu2014").fit(library.select())
    with LiveSession(library=tmp_path / "library") as session:
        session.learn(wait=True)
        assert session.learn_error == ""
        assert session.recogniser.classes_.tolist() == ["bar", "disc"]
        assert len(session.recogniser.memory_) == 58
        assert all(key in session.message for key in empty)


def test_programs_that_begin_within_a_second_have_sessions_of_their_own(
    tmp_path, monkeypatch
):
    """A script starts three robots at once, whose touches go to one library."""
    monkeypatch.setattr(time, "strftime", lambda *_: "2026-01-01 08:00:00")
    robots = [LiveSession(library=tmp_path) for _ in range(2)]
    for number in range(4):
        robots[number % 2].post_lesson("mug", np.full((3, 4), number))
    with TouchLibrary.open(tmp_path) as library:
        sessions = [row.session for row in library.list()]
    assert sessions == 2 * sessions[:2]
    assert sessions[0] == "2026-01-01 08:00:00"
    assert sessions[1].startswith("2026-01-01 08:00:00.")
    for robot in robots:
        robot.stop()
