"""Objects of a library on the page: undone, renamed, exported, of several sizes."""

import io
import os
import shutil
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from palpate import Touches
from palpate.library import LibraryError, TouchLibrary
from palpate.recognition import ObjectRecogniser
from palpate.sensors import ReplaySensor, SensorMemory
from palpate.web import LiveSession

from .conftest import LearningError, learn_job, waited

SMALL = np.arange(64, dtype=np.uint8).reshape(8, 8)


def small_touches(name, count, start=0):
    """Touches of 8 x 8 taxels, as from another sensor than that of the drawn ones."""
    images = np.stack([np.roll(SMALL, start + n) for n in range(count)])
    return Touches(images, object=[name] * count, time_s=np.arange(count) + start)


def settled(session):
    """Wait until a session has learnt; return the names that its model knows."""
    assert waited(lambda: not session.learning, 60)
    assert session.learn_error == ""
    return session.recogniser.classes_.tolist()


def test_undo_leaves_out_what_was_taught_here_and_nothing_else(folder, drawn):
    with LiveSession(library=folder) as session:
        for row, name in enumerate(("cup", "cup", "pen")):
            session.post_lesson(name, drawn.images[40 + row])
        with TouchLibrary.open(folder) as other:  # meanwhile, another program adds
            other.add(drawn[60:70])
        session.forget("pen")
        names = [session.undo() for _ in range(4)]
        assert names == ["pen", "pen", "cup", "cup"]
        with pytest.raises(LibraryError, match="no touch to undo"):
            session.undo()
        assert session.to_dict()["library"]["undoable"] == 0
        assert session.teacher.library.count() == 26


@pytest.fixture(scope="module")
def model_of_elsewhere(drawn, tmp_path_factory):
    """Return a function that writes a model to a path, as other programs do.

    The model has names, but no ids of touches.
    """
    learnt = tmp_path_factory.mktemp("elsewhere") / "m.palpate"
    ObjectRecogniser().fit(drawn[drawn.object != "both"][::2]).save(learnt)
    return lambda path: Path(shutil.copy(learnt, path))


def test_a_rename_that_would_lose_what_the_model_knows_is_refused(
    tmp_path, drawn, model_of_elsewhere
):
    model = model_of_elsewhere(tmp_path / "m.palpate")
    with LiveSession(library=tmp_path / "library", model=model) as session:
        session.post_lesson("disc", drawn.images[0])
        with pytest.raises(
            ValueError, match=r"'disc' must have at least 2 touches .*1"
        ):
            session.rename("disc", "coin")
        assert session.teacher.to_dict()["objects"] == [
            {"name": "disc", "n_touches": 1}
        ]
        session.post_lesson("disc", drawn.images[1])
        session.rename("disc", "coin")
        assert settled(session) == ["bar", "coin"]


def test_a_name_that_the_model_knows_from_elsewhere_is_taken(
    tmp_path, drawn, model_of_elsewhere
):
    model = model_of_elsewhere(tmp_path / "m.palpate")  # 15 of each
    with LiveSession(library=tmp_path / "library", model=model) as session:
        for image in drawn.images[60:64]:
            session.post_lesson("both", image)
        session.learn(wait=True)
        with pytest.raises(ValueError, match="'disc', which the model knows"):
            session.rename("both", "disc")
        assert counts(session) == {"bar": 15, "both": 4, "disc": 15}
        session.rename("both", "disc", merge=True)
        assert settled(session) == ["bar", "disc"]
        assert counts(session) == {"bar": 15, "disc": 19}
        assert session.teacher.to_dict()["objects"] == [
            {"name": "disc", "n_touches": 4}
        ]


def test_an_object_renamed_elsewhere_is_known_by_its_touches(folder):
    model = folder / "model.palpate"
    learn_job(folder, model)
    with TouchLibrary.open(folder) as library:
        library.rename_object("disc", "coin")
    assert learn_job(folder, model, model)["objects"] == ["bar", "coin"]


def test_each_sensor_learns_from_touches_of_its_size(folder, drawn):
    with TouchLibrary.open(folder) as library:
        library.add(small_touches("ball", 4))
        library.add(small_touches("disc", 3, start=9))
    with LiveSession(ReplaySensor(drawn), library=folder) as session:
        session.learn(wait=True)
        assert settled(session) == ["bar", "disc"]
        assert len(session.recogniser.memory_) == 16
        session.rename("bar", "rod")
        assert settled(session) == ["disc", "rod"]
    other = ReplaySensor(small_touches("ball", 2), rate_hz=500)
    with LiveSession(other, library=folder) as session:
        (warning,) = session.to_dict()["sensor"]["warnings"]
        assert "8 x 8 taxels" in warning
        assert "12 x 12" in warning
        session.learn(wait=True)
        assert settled(session) == ["ball", "disc"]
        assert session.recogniser.encoder_.image_shape_ == (8, 8)


def test_a_model_is_not_given_up_for_a_sensor_without_touches(folder, drawn):
    with LiveSession(ReplaySensor(drawn), library=folder) as session:
        session.learn(wait=True)
    other = ReplaySensor(small_touches("ball", 2), rate_hz=500)
    with LiveSession(other, library=folder) as session:
        session.learn(wait=True)
        assert "for it is of another sensor (12 x 12 taxels)" in session.learn_error
        assert (folder / "model.palpate").is_file()
    with LiveSession(ReplaySensor(drawn), library=folder) as session:
        session.forget("bar")
        assert waited(lambda: session.learn_error)
        assert not (folder / "model.palpate").is_file()


def test_objects_of_another_size_that_are_nowhere_else_are_kept(
    tmp_path, model_of_elsewhere
):
    model = model_of_elsewhere(tmp_path / "m.palpate")
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        library.add(small_touches("ball", 4))
        library.add(small_touches("cube", 4, start=9))
    with pytest.raises(LearningError, match=r"8 x 8 .*'bar', 'disc' from .*12 x 12"):
        learn_job(tmp_path / "library", model, model)
    forgotten = [("disc", ""), ("bar", "")]
    dropped = learn_job(tmp_path / "library", model, model, forgotten)
    assert dropped["objects"] == ["ball", "cube"]


@pytest.mark.parametrize("name", ["ball", "it's", 'a "b"', """5'6" tall"""])
def test_one_object_is_exported_whatever_else_there_is(
    folder, connected, make_session, name
):
    with TouchLibrary.open(folder) as library:
        library.add(small_touches(name, 3))
        library.add(small_touches(f"{name}!", 2, start=20))
    with connected(make_session(library=folder)) as client:
        answer = client.get("/api/objects/archive", params={"object": name})
        assert answer.status_code == 200
        with np.load(io.BytesIO(answer.content)) as stored:
            assert (stored["images"] == small_touches(name, 3).images).all()
            assert stored["object"].tolist() == [name] * 3
        ids = client.get("/api/objects/touches", params={"object": name, "limit": 2})
        rows = client.session.teacher.library.list(limit=None)
        stored_ids = [row.id for row in rows if row.object == name]
        assert [touch["id"] for touch in ids.json()] == [stored_ids[2], stored_ids[1]]


def test_thumbnails_are_asked_for_without_listing_everything(folder, monkeypatch):
    session = LiveSession(library=folder)
    listed, plain = [], TouchLibrary.list

    def spy(self, *arguments, **options):
        rows = plain(self, *arguments, **options)
        listed.append(len(rows))
        return rows

    monkeypatch.setattr(TouchLibrary, "list", spy)
    ids = [row.id for row in session.teacher.newest("disc", 5)]
    assert len(ids) == 5
    with pytest.raises(LibraryError, match=r"'disk' in .*Did you mean 'disc'\?"):
        session.teacher.newest("disk", 5)
    assert max(listed) <= 5
    session.stop()


def test_learning_reads_images_piece_by_piece(folder, tmp_path, monkeypatch):
    def refuse(self, where=None, **options):
        raise AssertionError("all touches were read at once")

    monkeypatch.setattr(TouchLibrary, "touches", refuse)
    assert learn_job(folder, tmp_path / "m.palpate")["n_touches"] == 16


def test_kept_objects_leave_the_others_their_touches(
    tmp_path, drawn, model_of_elsewhere
):
    base = model_of_elsewhere(tmp_path / "m.palpate")
    taught = drawn[drawn.object == "both"][:6]
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        ids = library.add(taught)
        baseline = library.no_contact()
    output = tmp_path / "o.palpate"
    answer = learn_job(tmp_path / "library", output, base)
    assert answer["objects"] == ["bar", "both", "disc"]
    assert sorted(answer["kept"]) == ["bar", "disc"]
    model = ObjectRecogniser.load(output)
    assert model.memory_.touch_ids[model.memory_.labels == "both"].tolist() == ids
    assert set(model.memory_.touch_ids[model.memory_.labels != "both"]) == {""}
    memory = SensorMemory.from_dict(model.memory_.sensor)
    assert memory.n_touches == 6
    assert (memory.no_contact == baseline).all()
    for folder, known_id in [("library", ids[-1]), ("another", None)]:
        with LiveSession(model=output, library=tmp_path / folder) as session:
            session.post_touch(taught.images[-1])
            near = session.to_dict()["nearest"][0]
            assert (near["id"], near["object"]) == (known_id, "both")
            # Encoded alone a touch differs by rounding from one among others.
            assert near["distance"] == pytest.approx(0, abs=1e-9)
    again = learn_job(tmp_path / "library", output, output, [("disc", "")])
    assert again["objects"] == ["bar", "both"]


def counts(session):
    """Return how many touches of each object the model knows."""
    names, n_touches = np.unique(session.recogniser.memory_.labels, return_counts=True)
    return dict(zip(names.tolist(), n_touches.tolist(), strict=True))


def test_a_model_from_elsewhere_is_extended_and_never_replaced(
    tmp_path, drawn, model_of_elsewhere
):
    base = model_of_elsewhere(tmp_path / "m.palpate")  # 15 of each
    before = base.read_bytes()
    kept = tmp_path / "library" / "given-m.palpate"
    new = drawn.images[1:9:2]
    with LiveSession(library=tmp_path / "library", model=base) as session:
        assert session.to_dict()["model"]["to_keep"] == str(kept)
        for image in new:
            session.post_lesson("disc", image)
        for _ in range(2):  # what was learnt already is not added again
            session.learn(wait=True)
            assert session.learn_error == ""
            assert counts(session) == {"bar": 15, "disc": 19}
            assert "34 touches, 30 of them known from elsewhere" in session.message
        model = session.to_dict()["model"]
        assert model["n_elsewhere"] == {"bar": 15, "disc": 15}
        assert model["to_keep"] == ""
        keys = [row.id for row in session.teacher.newest("disc", 2)]
        session.remove_touches(keys[:1])
        session.move_touches(keys[1:], "bar")
        session.learn(wait=True)
        assert counts(session) == {"bar": 16, "disc": 17}
        session.undo()
        session.rename("disc", "coin")
        assert settled(session) == ["bar", "coin"]
        assert counts(session) == {"bar": 15, "coin": 18}
    assert kept.read_bytes() == before
    # Another session that starts from the written file goes on from there.
    with LiveSession(library=tmp_path / "library", model=base) as session:
        session.post_lesson("bar", drawn.images[31])
        session.learn(wait=True)
        assert counts(session) == {"bar": 16, "coin": 18}
        session.forget("coin")
        assert waited(lambda: not session.learning)
        # One object is no model: its touches of elsewhere are nowhere but in the file.
        assert "bar is known from it alone" in session.learn_error
    with LiveSession(library=tmp_path / "library", model=base) as session:
        assert session.unlearnt
        for image in drawn.images[60:62]:
            session.post_lesson("both", image)
        session.learn(wait=True)
        assert counts(session) == {"bar": 16, "both": 2}
    assert kept.read_bytes() == before
    # Nothing is added to it by a sensor of another size, and no such thing is said.
    other = ReplaySensor(small_touches("disc", 2).with_columns(no_contact=0 * SMALL))
    base = model_of_elsewhere(base)
    with LiveSession(other, library=tmp_path / "other", model=base) as session:
        assert session.to_dict()["model"]["to_keep"] == ""


@pytest.mark.parametrize("change", ["rename", "forget"])
def test_a_name_changed_while_the_first_model_is_learnt_is_learnt_next(
    folder, drawn, learn_by, change
):
    """It has read the touches by then."""
    has_read, go_on = threading.Event(), threading.Event()

    def learn(*job):
        answer = learn_job(*job)
        has_read.set()
        go_on.wait(10)
        return answer

    learn_by(learn)
    with LiveSession(library=folder) as session:
        for image in drawn.images[60:62]:
            session.post_lesson("shoe", image)
        session.learn()
        assert has_read.wait(10)
        if change == "rename":
            session.rename("disc", "coin")
        else:
            session.forget("disc")
        go_on.set()
        names = ["bar", "coin", "shoe"] if change == "rename" else ["bar", "shoe"]
        assert waited(lambda: session.recogniser is not None)
        assert waited(lambda: session.recogniser.classes_.tolist() == names)
        assert waited(lambda: not session.learning)


@pytest.mark.parametrize(
    ("change", "names"),
    [("rename", ["bar", "both", "coin"]), ("forget", ["bar", "both"])],
)
def test_a_name_changed_is_learnt_after_a_restart_before_it_was(
    tmp_path, drawn, model_of_elsewhere, learn_by, change, names
):
    def killed(*job):
        raise OSError("it is ended")

    model = model_of_elsewhere(tmp_path / "m.palpate")
    with LiveSession(library=tmp_path / "library", model=model) as session:
        for row in (0, 1, 60, 61):
            session.post_lesson("disc" if row < 60 else "both", drawn.images[row])
        session.learn(wait=True)
        learn_by(killed)
        if change == "rename":
            session.rename("disc", "coin")
        else:
            session.forget("disc")
        assert waited(lambda: not session.learning)
    learn_by(learn_job)
    os.utime(model, (time.time() + 9, time.time() + 9))  # the clock has gone back
    with LiveSession(library=tmp_path / "library", model=model) as session:
        assert session.unlearnt
        session.learn(wait=True)
        assert settled(session) == names
        assert not session.unlearnt
    with LiveSession(library=tmp_path / "library", model=model) as session:
        assert session.teacher.journal.renamed == []
        assert not session.unlearnt


def test_a_model_of_the_library_is_learnt_again_as_it_was_made(folder, drawn):
    path = folder / "model.palpate"
    with TouchLibrary.open(folder) as library:
        ObjectRecogniser("liu2014", floor=0.03).fit(library.select()).save(path)
    with LiveSession(library=folder) as session:
        session.post_lesson("disc", drawn.images[20])
        session.learn(wait=True)
        recogniser = session.recogniser
        assert counts(session) == {"bar": 8, "disc": 9}
        assert (recogniser.preset, recogniser.floor) == ("liu2014", 0.03)


def test_touches_that_a_model_has_without_ids_count_once(
    tmp_path, drawn, model_of_elsewhere
):
    base = model_of_elsewhere(tmp_path / "m.palpate")
    with LiveSession(library=tmp_path / "library", model=base) as session:
        for image in drawn.images[:6:2]:
            session.post_lesson("disc", image)
        session.learn(wait=True)
        assert counts(session) == {"bar": 15, "disc": 15}
        assert session.to_dict()["model"]["n_elsewhere"] == {"bar": 15, "disc": 12}


def test_a_posted_touch_has_its_taxels_where_those_before_it_had(tmp_path, drawn):
    disc, bar = np.flatnonzero(drawn.object == "disc"), drawn.object == "bar"
    few = drawn[np.concatenate([disc[:6], np.flatnonzero(bar)[:6]])]
    halves = np.array([[0, 0, 12, 6], [0, 6, 12, 6]])
    hand = Touches(few.images, object=few.object, geometry="none", pads=halves)
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        library.add(hand)
    with LiveSession(library=tmp_path / "library") as session:
        session.post_lesson("disc", drawn.images[disc[7]])
        kept = session.teacher.touches("disc")
        assert (len(kept), kept.geometry) == (7, "none")
        np.testing.assert_array_equal(kept.whole["pads"], halves)


@pytest.mark.parametrize(("with_sensor", "side"), [(True, 12), (False, 8)])
def test_of_an_object_of_two_sizes_those_of_the_sensor_are_exported(
    folder, make_session, with_sensor, side
):
    """Without a sensor, touches of the size of the newest one are exported."""
    with TouchLibrary.open(folder) as library:
        library.add(small_touches("disc", 3))
    session = make_session(sensor=with_sensor, library=folder)
    try:
        touches = session.teacher.touches("disc")
    finally:
        session.stop()
    assert touches.images.shape[1:] == (side, side)
    assert len(touches) == (8 if side == 12 else 3)


def test_a_new_name_is_kept_without_the_blanks_around_it(folder, drawn):
    with LiveSession(library=folder) as session:
        session.post_lesson(" tea\n cup ", drawn.images[60])
        assert session.teacher.rename("disc", "  a  disc ", learnt=False) == "a disc"
        session.rename("bar", " long bar ")
        assert session.message == "bar is called long bar now."
        names = [entry["name"] for entry in session.to_dict()["library"]["objects"]]
    assert sorted(names) == ["a disc", "long bar", "tea cup"]


def test_an_object_of_a_long_name_from_elsewhere_is_one_like_others(
    folder, drawn, connected
):
    """The page itself gives no object a name of more than 80 characters."""
    name = {"object": "long " * 40}
    with TouchLibrary.open(folder) as library:
        library.add(drawn[60:62].with_columns(object=2 * [name["object"]]))
    with connected(LiveSession(library=folder)) as client:
        touches = client.get("/api/objects/touches", params=name).json()
        assert len(touches) == 2
        assert client.get("/api/objects/archive", params=name).status_code == 200
        for path, more in (("rename", {"name": "short"}), ("forget", {})):
            answer = client.post(f"/api/objects/{path}", json=name | more)
            assert answer.status_code == 200
            name["object"] = "short"
        objects = client.get("/api/state").json()["library"]["objects"]
        assert [one["name"] for one in objects] == ["bar", "disc"]
