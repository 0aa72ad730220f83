"""Stored touches removed and moved, undone also after a restart; a lesson resumed."""

import json
import os
import time

import numpy as np
import pytest

from palpate.library import TouchLibrary
from palpate.sensors import DetectedTouch, ReplaySensor, open_sensor
from palpate.web import LiveSession

from .conftest import LearningError, learn_job, waited


def _detected(image):
    return DetectedTouch(image, began_s=0.0, ended_s=0.1, change=9.0, n_frames=3)


def counts(session):
    """Return how many touches each object of the library has."""
    objects = session.to_dict()["library"]["objects"]
    return {entry["name"]: entry["n_touches"] for entry in objects}


def test_a_touch_moved_keeps_all_but_its_object_and_can_go_there_and_back(folder):
    with LiveSession(library=folder) as session:
        row = session.teacher.newest("disc", 1)[0]
        image = session.teacher.library.image(row.id)
        assert session.move_touches([row.id], "bar") == "1 touch of disc moved to bar."
        assert counts(session) == {"bar": 9, "disc": 7}
        copy = session.teacher.library.list("object = bar", limit=None)[-1]
        assert (session.teacher.library.image(copy.id) == image).all()
        assert (copy.session, copy.category) == ("old", "long")
        assert session.undo() == "disc"
        assert counts(session) == {"bar": 8, "disc": 8}
        session.move_touches([row.id], "bar")  # its copy is there, left out
        assert counts(session) == {"bar": 9, "disc": 7}
        assert session.undo() == "disc"
        with pytest.raises(ValueError, match="of disc already"):
            session.move_touches([row.id], "disc")


def test_a_move_that_was_killed_is_finished_by_the_next_start(folder, monkeypatch):
    """A touch is of one object, never of two for good."""

    def killed(*_, **__):
        raise KeyboardInterrupt

    with LiveSession(library=folder) as session:
        n_disc, n_bar = (counts(session)[name] for name in ("disc", "bar"))
        keys = [row.id for row in session.teacher.newest("disc", 2)]
        monkeypatch.setattr(session.teacher.library, "retract", killed)
        with pytest.raises(KeyboardInterrupt):
            session.move_touches(keys, "bar")
        assert counts(session) == {"bar": n_bar + 2, "disc": n_disc}
    for _ in range(2):
        with LiveSession(library=folder) as session:
            assert counts(session) == {"bar": n_bar + 2, "disc": n_disc - 2}
    with LiveSession(library=folder) as session:
        session.undo()
        assert counts(session) == {"bar": n_bar, "disc": n_disc}


def test_a_touch_is_moved_to_a_name_that_its_object_had_before(folder):
    with LiveSession(library=folder) as session:
        (row,) = session.teacher.newest("disc", 1)
        image = session.teacher.library.image(row.id)
        session.rename("disc", "coin")
        for _ in range(2):
            session.move_touches([row.id], "disc")
            assert counts(session) == {"bar": 8, "coin": 7, "disc": 1}
            (copy,) = session.teacher.newest("disc", 1)
            assert (session.teacher.library.image(copy.id) == image).all()
            assert (copy.session, copy.time_s) == (row.session, row.time_s)
            assert session.undo() == "coin"
            assert counts(session) == {"bar": 8, "coin": 8}


def test_a_touch_whose_copy_is_called_otherwise_by_now_is_moved_anew(folder):
    with LiveSession(library=folder) as session:
        ids = [row.id for row in session.teacher.newest("disc", 2)]
        session.move_touches(ids, "bar")
        session.undo()  # both copies are left out
        session.rename("bar", "rod")
        session.move_touches(ids, "bar")
        assert counts(session) == {"bar": 2, "disc": 6, "rod": 8}


def test_a_touch_is_not_moved_to_a_name_that_was_merged_into_its_object(folder):
    with LiveSession(library=folder) as session:
        bar = session.teacher.newest("bar", 1)[0].id
        disc = session.teacher.newest("disc", 1)[0].id
        session.rename("disc", "bar", merge=True)
        for key in (bar, disc):
            with pytest.raises(ValueError, match="disc was merged into it"):
                session.move_touches([key], "disc")
            assert counts(session) == {"bar": 16}


def test_touches_of_several_objects_are_counted_by_their_own_names(folder):
    with LiveSession(library=folder) as session:
        journal, newest = session.teacher.journal, session.teacher.newest
        disc, bar = (newest(name, 1)[0].id for name in ("disc", "bar"))
        moved = session.move_touches([bar, disc], "bar")
        assert moved == "1 touch of disc moved to bar."
        assert session.undo() == "disc"
        journal.changed.clear()
        assert session.remove_touches([bar, disc]) == "2 touches of bar, disc removed."
        assert journal.changed == {"bar", "disc"}
    with LiveSession(library=folder) as session:
        assert session.teacher.journal.changed == {"bar", "disc"}
        assert session.to_dict()["library"]["undo"]["object"] == "bar"
        assert session.undo() == "bar, disc"
        assert session.message == "What was removed of bar, disc is back."
        assert counts(session) == {"bar": 8, "disc": 8}


def test_undo_goes_back_through_everything_in_order_after_a_restart(folder, drawn):
    with LiveSession(library=folder) as session:
        session.post_lesson("pen", drawn.images[60])
        (bar,) = (row.id for row in session.teacher.newest("bar", 1))
        assert session.remove_touches([bar]) == "1 touch of bar removed."
        session.move_touches([session.teacher.newest("disc", 1)[0].id], "coin")
    with LiveSession(library=folder) as session:
        assert counts(session) == {"bar": 7, "coin": 1, "disc": 7, "pen": 1}
        last = session.to_dict()["library"]["undo"]
        assert last == {"kind": "moved", "object": "disc", "to": "coin"}
        assert session.undo() == "disc"
        assert session.message == "What was moved to coin is back with disc."
        assert counts(session) == {"bar": 7, "disc": 8, "pen": 1}
        last = session.to_dict()["library"]["undo"]
        assert last == {"kind": "removed", "object": "bar", "to": ""}
        assert session.undo() == "bar"
        assert session.undo() == "pen"
        assert counts(session) == {"bar": 8, "disc": 8}


def test_a_journal_that_is_torn_or_foreign_costs_nothing_but_the_undo(folder):
    with LiveSession(library=folder) as session:
        session.remove_touches([session.teacher.newest("bar", 1)[0].id])
    journal = folder / "page.jsonl"
    whole = journal.read_text("utf-8")
    odd = '{"action": 3}\n[1]\n\xff\n{"lesson": {"odd": 1}}\n{"undone"'
    journal.write_bytes((whole + odd).encode("latin-1"))
    with LiveSession(library=folder) as session:
        assert session.undo() == "bar"
    with LiveSession(library=folder) as session:  # what came after the torn line counts
        assert session.to_dict()["library"]["undoable"] == 0
    journal.write_text(whole[:20], "utf-8")
    with LiveSession(library=folder) as session:
        assert session.to_dict()["library"]["undoable"] == 0


@pytest.mark.parametrize(
    "line",
    [
        {"action": {"kind": "moved", "object": ["disc"], "ids": []}},
        {"action": {"kind": "taught", "object": "disc", "ids": "abc"}},
        {"action": {"kind": "taught", "object": "disc", "ids": [7]}},
        {"lesson": {"name": 3, "wanted": 5, "ids": []}},
        {"changed": ["disc"], "renamed": [["disc"]]},
        {"lesson": {"name": "disc", "wanted": "many", "ids": []}},
        {"lesson": {"name": "disc", "wanted": 5, "ids": [None]}},
    ],
)
def test_a_line_of_a_journal_with_odd_values_is_left_out(folder, line):
    with (folder / "page.jsonl").open("a", encoding="utf-8") as journal:
        journal.write(json.dumps(line) + "\n")
    with LiveSession(library=folder) as session:
        assert session.teacher.journal.interrupted is None
        assert session.to_dict()["library"]["undoable"] == 0
        session.post_lesson(
            "disc",
            session.teacher.library.image(session.teacher.newest("disc", 1)[0].id),
        )
        assert session.undo() == "disc"


def test_a_touch_that_is_not_there_is_named(folder, connected):
    with connected(LiveSession(library=folder)) as client:
        key = client.get("/api/objects/touches?object=disc").json()[0]["id"]
        for order in ({"ids": [key]}, {"ids": [key], "object": "bar"}):
            path = "move" if "object" in order else "remove"
            answer = client.post(f"/api/touches/{path}", json=order)
            assert answer.status_code == (200 if path == "remove" else 404)
        assert "was removed" in answer.json()["detail"]
        assert client.post("/api/touches/remove", json={"ids": []}).status_code == 422
        assert client.post("/api/teach/undo").json()["message"].endswith("is back.")
        page = client.get("/api/objects/touches?object=disc&limit=3&offset=6").json()
        assert len(page) == 2
        assert {*page[0]} == {"id", "session", "added_s"}
        large = client.get(f"/api/touches/{key}/picture?side=480").content
        assert len(large) > len(client.get(f"/api/touches/{key}/picture").content)


def test_the_objects_that_changed_since_it_learnt_are_known(folder):
    def changed(session):
        state = session.to_dict()
        # The model is behind until it learns.
        assert state["unlearnt"] == bool(state["library"]["changed"])
        return state["library"]["changed"]

    with LiveSession(library=folder) as session:
        assert changed(session) == []
        session.learn(wait=True)
        assert changed(session) == []
        (key,) = (row.id for row in session.teacher.newest("disc", 1))
        session.move_touches([key], "bar")
        assert changed(session) == ["bar", "disc"]
    with LiveSession(library=folder) as session:
        assert changed(session) == ["bar", "disc"]
        session.learn(wait=True)
        assert changed(session) == []
        session.undo()
        assert changed(session) == ["bar", "disc"]
        session.learn(wait=True)
        session.remove_touches([session.teacher.newest("bar", 1)[0].id])
        session.learn(wait=True)
        assert len(session.recogniser.memory_) == 15
        session.remove_touches([session.teacher.newest("bar", 1)[0].id])
    with LiveSession(library=folder) as session:
        assert changed(session) == ["bar"]
        # The model counts as newer where the clock has gone back since.
        model = folder / "model.palpate"
        os.utime(model, (time.time() + 9, time.time() + 9))
    with LiveSession(library=folder) as session:
        assert changed(session) == ["bar"]
        learn_job(folder, model, model)  # as another program
    with LiveSession(library=folder) as session:
        assert changed(session) == []


def test_an_object_put_back_as_it_was_learnt_counts_as_unchanged(folder):
    with LiveSession(library=folder) as session:
        session.learn(wait=True)
        session.move_touches([session.teacher.newest("disc", 1)[0].id], "cup")
        session.remove_touches([session.teacher.newest("bar", 1)[0].id])
        assert session.to_dict()["library"]["changed"] == ["bar", "cup", "disc"]
        session.undo()
        assert session.to_dict()["library"]["changed"] == ["cup", "disc"]
        session.undo()
    with LiveSession(library=folder) as session:
        assert session.to_dict()["library"]["changed"] == []
        assert not session.unlearnt


def test_what_is_undone_is_known_by_its_name_of_now(folder):
    """The model holds the touch, whatever its object was called when it was taught."""
    with LiveSession(library=folder) as session:
        session.move_touches([session.teacher.newest("bar", 1)[0].id], "disc")
        session.learn(wait=True)
        for old, new in (("disc", "x"), ("bar", "disc"), ("x", "bar")):
            session.rename(old, new)
            assert waited(lambda: not session.learning)
        assert not session.unlearnt
        last = session.to_dict()["library"]["undo"]
        assert last == {"kind": "moved", "object": "disc", "to": "bar"}
        session.undo()
        assert session.message == "What was moved to bar is back with disc."
        session.learn(wait=True)
        keys = [row.id for row in session.teacher.newest("bar", 2)]
        session.move_touches(keys, "cup")
        session.learn(wait=True)
        session.rename("cup", "mug")
        assert waited(lambda: not session.learning)
        session.undo()
    with LiveSession(library=folder) as session:
        assert session.to_dict()["library"]["changed"] == ["bar", "mug"]
        assert session.unlearnt


def test_what_is_taught_before_the_library_is_read_is_learnt(folder, drawn, learn_by):
    with LiveSession(library=folder) as session:
        session.learn(wait=True)

        def learn(*job):
            session.post_lesson("disc", drawn.images[20])
            return learn_job(*job)

        learn_by(learn)
        session.learn(wait=True)
        assert len(session.recogniser.memory_) == 17
        assert not session.unlearnt


def test_what_is_undone_while_it_learns_is_still_to_be_learnt(folder, drawn, learn_by):
    with LiveSession(library=folder) as session:
        session.learn(wait=True)
        session.post_lesson("disc", drawn.images[20])

        def learn(*job):
            answer = learn_job(*job)  # with that touch
            session.undo()
            return answer

        learn_by(learn)
        session.learn(wait=True)
        assert len(session.recogniser.memory_) == 17
        assert session.unlearnt
        learn_by(learn_job)
        session.learn(wait=True)
        assert len(session.recogniser.memory_) == 16
        assert not session.unlearnt


def test_a_forgotten_object_comes_back_by_undo_and_is_learnt_again(folder):
    with LiveSession(library=folder) as session:
        session.learn(wait=True)
        session.forget("disc")
        assert waited(lambda: not session.learning)
        assert counts(session) == {"bar": 8}
        assert session.to_dict()["library"]["undo"]["kind"] == "forgotten"
        assert session.undo() == "disc"
        assert session.message == "The touches of disc are back: learn again."
        assert counts(session) == {"bar": 8, "disc": 8}
        session.learn(wait=True)
        assert session.recogniser.classes_.tolist() == ["bar", "disc"]


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (LearningError, "no memory"),
        (MemoryError, "no memory"),
        (KeyError, "KeyError('no memory')"),
    ],
)
def test_changed_objects_stay_changed_where_learning_fails(
    folder, learn_by, error, message
):
    """Learning may fail in its own process, or this one may lack memory for it."""

    def fail(*job):
        raise error("no memory")

    with LiveSession(library=folder) as session:
        session.learn(wait=True)
        session.remove_touches([session.teacher.newest("bar", 1)[0].id])
        learn_by(fail)
        session.learn(wait=True)
        assert session.to_dict()["library"]["changed"] == ["bar"]
        assert session.unlearnt
        assert session.learn_error == message
        assert session.message == ""


def test_an_interrupted_lesson_finds_its_object_before_a_simulated_sensor(
    make_session, folder, drawn
):
    with make_session(library=folder) as session:
        session.place("disc")
        session.teach("bar", 800)  # more than are touched meanwhile
    with make_session(library=folder) as session:
        session.place("disc")
        assert waited(lambda: session.watch.detector.touching)
        began_s = time.monotonic()
        session.resume_teaching()
        assert session.watch.sensor.placed == "bar"
        # The touch under way, and what waits to be handed on, is of the disc.
        image, n_stored = drawn.images[0], session.teacher.library.count()
        session._on_touch(DetectedTouch(image, began_s, began_s, 9.0, 3), 0.0)
        assert session.teacher.library.count() == n_stored
        session.stop_teaching()
    with make_session(library=folder) as session:
        session.teach("my own bar", 8)
    with make_session(library=folder) as session:
        session.place("disc")
        session.resume_teaching()
        assert session.watch.sensor.placed is None
        assert (
            session.message == "Choose what my own bar is: nothing is on the desk now."
        )


def test_a_place_that_is_refused_costs_no_touch(make_session, drawn):
    session = make_session()  # not started: it touches nothing by itself
    session.place("disc")
    began_s = time.monotonic()
    with pytest.raises(ValueError, match="must be one of 'disc', 'bar', 'both'"):
        session.place("nonsense")
    session.teach("cup", 8)
    session._on_touch(DetectedTouch(drawn.images[0], began_s, began_s, 9.0, 3), 0.0)
    assert counts(session) == {"cup": 1}
    session.stop()


def test_a_simulated_lesson_goes_on_with_other_touches_after_a_restart(tmp_path):
    pictures = []
    for _ in range(2):
        desk = open_sensor("sim:bar10?rate=500&hold=3&gap=3")
        with LiveSession(desk, library=tmp_path / "desk") as session:
            session.teach("bar10", 4)
            assert waited(lambda opened=session: opened.teacher.lesson is None)
            session.place(None)
            rows = session.teacher.library.list(limit=None)
            pictures = [session.teacher.library.image(row.id).tobytes() for row in rows]
    assert len(pictures) == 8
    assert len({*pictures}) == 8


def test_a_recording_that_begins_anew_is_not_stored_twice(tmp_path, drawn):
    few = drawn[np.flatnonzero(drawn.object == "disc")[:5]]
    for n_stored in (3, 5):
        replay = ReplaySensor(few, rate_hz=250, hold=3, gap=3)
        with LiveSession(replay, library=tmp_path / "few") as session:
            session.teach("disc", 3)
            assert waited(lambda opened=session: opened.teacher.lesson is None)
            session.place(None)
            assert session.teacher.library.count() == n_stored
    message = "All 5 touches that were recorded here are stored: 2 of 3 of disc."
    assert session.message == message


def test_an_episode_of_a_recording_that_is_stored_is_not_kept(tmp_path, drawn):
    few = drawn[np.flatnonzero(drawn.object == "disc")[:2]]
    replay = ReplaySensor(few, rate_hz=250, hold=3, gap=3)
    with LiveSession(replay, library=tmp_path / "few") as session:
        session.teach("disc", 2)
        assert waited(lambda: len(session.episode.touches) > 2)
        session.teach("disc", 5, keep_episode=True)
        message = "All 2 touches that were recorded here are stored: 0 of 5 of disc."
        assert (session.message, session.teacher.lesson) == (message, None)


def test_an_interrupted_lesson_goes_on_where_it_was(make_session, folder, drawn):
    with make_session(library=folder) as session:
        session.teach("shoe", 8)
        for image in drawn.images[:3]:
            session._on_touch(_detected(image), 0.0)
        session.undo()
        session._on_touch(_detected(session.baseline), 0.0)  # shows no contact
        silent = session.to_dict()["no_contact"]
    # Leaving the session does not end the lesson, as if the server was killed.
    with make_session(library=folder) as session:
        session.watch.detector.baseline = None  # of a real sensor it is not taken yet
        interrupted = session.to_dict()["library"]["interrupted"]
        assert interrupted == {"name": "shoe", "wanted": 8, "done": 2}
        session.resume_teaching()
        lesson = session.to_dict()["lesson"]
        assert (lesson["name"], lesson["done"], lesson["wanted"]) == ("shoe", 2, 8)
        assert lesson["no_contact"] == [3]
        assert session.to_dict()["no_contact"] == silent
        assert session.to_dict()["library"]["interrupted"] is None
        session._on_touch(_detected(drawn.images[3]), 0.0)
        assert session.to_dict()["lesson"]["done"] == 3
    with make_session(library=folder) as session:
        assert session.to_dict()["library"]["interrupted"]["done"] == 3
        session.stop_teaching()
        assert session.to_dict()["library"]["interrupted"] is None
        with pytest.raises(ValueError, match="no interrupted lesson"):
            session.resume_teaching()
    with make_session(library=folder) as session:
        assert session.to_dict()["library"]["interrupted"] is None


def test_an_interrupted_lesson_follows_the_name_of_its_object(make_session, folder):
    with make_session(library=folder) as session:
        session.teach("disc", 8)
    with make_session(library=folder) as session:
        session.rename("disc", "coin")
    with make_session(library=folder) as session:
        session.resume_teaching()
        assert session.to_dict()["lesson"]["name"] == "coin"


def test_an_interrupted_lesson_lacks_what_was_left_out_meanwhile(
    make_session, folder, drawn
):
    with make_session(library=folder) as session:
        session.teach("shoe", 8)
        for image in drawn.images[:3]:
            session._on_touch(_detected(image), 0.0)
        key = session.teacher.lesson.ids[0]
    with TouchLibrary.open(folder) as library:
        library.retract(key, reason="it was another shoe")
    with make_session(library=folder) as session:
        session.resume_teaching()
        assert session.to_dict()["lesson"]["done"] == 2
        assert session.undo() == "shoe"
        assert session.to_dict()["lesson"]["done"] == counts(session)["shoe"] == 1


def test_a_touch_posted_meanwhile_is_none_of_the_lesson(make_session, folder, drawn):
    with make_session(library=folder) as session:
        session.teach("shoe", 8)
        session._on_touch(_detected(drawn.images[0]), 0.0)
        for name in ("pen", "shoe"):
            session.post_lesson(name, drawn.images[40])
        assert session.to_dict()["lesson"]["done"] == 1
    with make_session(library=folder) as session:
        interrupted = session.to_dict()["library"]["interrupted"]
        assert interrupted == {"name": "shoe", "wanted": 8, "done": 1}


@pytest.mark.parametrize(("name", "merge"), [("boot", False), ("disc", True)])
def test_a_lesson_goes_on_under_the_new_name_of_its_object(
    name, merge, make_session, folder, drawn
):
    with make_session(library=folder) as session:
        n_before = counts(session).get(name, 0)
        session.teach("shoe", 8)
        session._on_touch(_detected(drawn.images[10]), 0.0)
        session.rename("shoe", name, merge=merge)
        session._on_touch(_detected(drawn.images[11]), 0.0)
        lesson = session.to_dict()["lesson"]
        assert (lesson["name"], lesson["done"]) == (name, 2)
        assert "shoe" not in counts(session)
        assert counts(session)[name] == n_before + 2
    with make_session(library=folder) as session:
        interrupted = session.to_dict()["library"]["interrupted"]
        assert interrupted == {"name": name, "wanted": 8, "done": 2}


def test_a_restart_in_one_sitting_begins_no_session_and_a_baseline_does(
    make_session, tmp_path, drawn
):
    folder = tmp_path / "library"

    def sessions(n_started, session):
        rows = session.teacher.library.list()
        assert len(rows) == n_started
        assert len({row.episode for row in rows}) == n_started
        return len({row.session for row in rows})

    for n_started, pause_s in ((1, 0), (2, 600), (3, 4000), (4, -4000)):
        if folder.exists():
            then = time.time() - pause_s
            os.utime(folder / "page.jsonl", (then, then))
        with make_session(library=folder) as session:
            session.teach("shoe", 2)
            session._on_touch(_detected(drawn.images[n_started]), 0.0)
            # After more than an hour it is another sitting, or by a clock set back.
            assert sessions(n_started, session) == max(1, n_started - 1)
    with make_session(library=folder) as session:
        session.place(None)
        assert waited(lambda: not session.watch.detector.touching)
        session.take_baseline()
        session.teach("shoe", 2)
        image = drawn.images[9]
        session._on_touch(DetectedTouch(image, time.monotonic(), 0.0, 9.0, 3), 0.0)
        assert sessions(5, session) == 4


def test_the_message_is_of_what_happened_last(
    make_session, tmp_path, drawn, drawn_model
):
    with make_session(library=tmp_path / "library", model=drawn_model) as session:
        session.teach("both", 3)
        for image in drawn.images[60:62]:
            session._take(image)
        session.stop_teaching()
        assert session.message == "The lesson of both is over: 2 of 3 stored."
        session.teach("both", 1)
        # The model knows others: with this one there is something to learn.
        message = session._take(drawn.images[63])
        assert (
            message == "Touch 1 of 1 of both is stored. Next: Learn, or another object."
        )
        session.message = message
        messages = []
        session._learn_in_process = lambda changes: messages.append(session.message)
        session.learn(wait=True)
        assert messages == ["Learning."]


def test_a_lesson_that_was_finished_is_not_offered(make_session, folder, drawn):
    with make_session(library=folder) as session:
        session.teach("shoe", 1)
        session._on_touch(_detected(drawn.images[0]), 0.0)
        assert session.teacher.lesson is None
    with make_session(library=folder) as session:
        assert session.to_dict()["library"]["interrupted"] is None
