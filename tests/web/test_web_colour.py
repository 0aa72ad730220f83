"""Touches with channels on the page: colour in colour, others as their mean."""

import time

import cv2
import numpy as np
import pytest

from palpate import Touches
from palpate.library import TouchLibrary
from palpate.sensors import CameraSensor
from palpate.web import LiveSession, learn_job


def red_left(side=60):
    """A picture that is red on its left half and blue on its right."""
    image = np.zeros((side, side, 3), np.uint8)
    image[:, : side // 2, 0] = image[:, side // 2 :, 2] = 200
    return image


@pytest.fixture
def shown(tmp_path, make_session, connected):
    """Return what the page shows of one touch: blue, green, red."""

    def show(image, channels):
        folder = tmp_path / "-".join(channels)
        with TouchLibrary.open(folder, create=True) as library:
            touches = Touches(image[np.newaxis], object=["cup"], channels=channels)
            (key,) = library.add(touches)
        with connected(make_session(sensor=False, library=folder)) as client:
            answer = client.get(f"/api/touches/{key}/picture")
            assert answer.status_code == 200, answer.text
            grey = cv2.imencode(".png", image[..., 0])[1].tobytes()
            kind = {"content-type": "image/png"}
            refused = client.post("/api/touch/picture", content=grey, headers=kind)
            assert "must have 60 x 60 x 3 taxels, got 60 x 60" in refused.text
        data = np.frombuffer(answer.content, np.uint8)
        return cv2.imdecode(data, cv2.IMREAD_COLOR)

    return show


def test_colour_is_shown_in_colour(shown):
    picture = shown(red_left(), ["r", "g", "b"])
    assert picture.shape == (96, 96, 3)
    assert picture[48, 10].tolist() == [0, 0, 200]
    assert picture[48, 85].tolist() == [200, 0, 0]
    turned = shown(red_left()[..., ::-1].copy(), ["b", "g", "r"])
    np.testing.assert_array_equal(turned, picture)


def test_other_channels_are_shown_as_their_mean(shown):
    picture = shown(red_left(), ["x", "y", "z"])
    assert len(np.unique(picture)) == 1


def test_touches_of_a_colour_are_learnt_apart_from_grey(tmp_path):
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        grey = np.zeros((4, 12, 12), np.uint8)
        library.add(Touches(grey, object=["cup", "cup", "pen", "pen"]))
        colour = np.zeros((1, 12, 12, 3), np.uint8)
        library.add(Touches(colour, object=["mug"], channels=["r", "g", "b"]))
    answer = learn_job(tmp_path / "library", tmp_path / "m.palpate")
    assert answer["objects"] == []


HUES = {"rose": (0, 0, 98), "leaf": (0, 50, 0)}  # luma 29.3 and 29.4


class Gel:
    """A capture of a gel that two things, of one shape and luma, press by turns.

    Pictures are blue, green, red, as drivers give them.
    """

    def __init__(self):
        self.rng = np.random.default_rng(0)
        self.hue, self.place, self.number = None, (24, 32), 0

    def isOpened(self):
        return True

    def set(self, what, value):
        return True

    def get(self, what):
        return 0.0

    def release(self):
        pass

    def read(self):
        time.sleep(0.004)
        self.number += 1
        if self.number % 16 == 0:
            self.place = self.rng.uniform((20, 20), (28, 44))
        picture = 60 + self.rng.normal(scale=0.5, size=(48, 64, 3))
        if self.hue is not None and self.number % 16 > 7:
            row, col = np.mgrid[:48, :64]
            y, x = self.place
            blob = np.exp(-((row - y) ** 2 + (col - x) ** 2) / 120)
            picture += blob[..., np.newaxis] * HUES[self.hue]
        return True, np.rint(picture).astype(np.uint8)


def waited(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


def seen(picture):
    return cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)


@pytest.fixture
def gel():
    return Gel()


@pytest.fixture
def camera(gel):
    """Return a function that makes a camera before the gel."""

    def make(**options):
        return CameraSensor("gel", (48, 64), open_capture=lambda _: gel, **options)

    return make


def pressed_by(session, gel, hue, done):
    """Let a thing press until something is done, and let what comes late pass."""
    gel.hue = hue
    waited(done)
    gel.hue = None
    time.sleep(0.3)


def taught(session, gel):
    """Teach both things, six touches each."""
    session.take_baseline()
    for hue in HUES:
        session.teach(hue, 6)
        pressed_by(session, gel, hue, lambda: session.teacher.lesson is None)
    assert session.trouble == ""


def test_a_colour_camera_teaches_what_differs_in_hue_alone(
    tmp_path, gel, camera, connected, learning_here
):
    library, events = tmp_path / "library", []
    session = LiveSession(camera(colour=True), library=library)
    session.listeners.add(events.append)
    with connected(session) as client:
        taught(session, gel)
        session.learn(wait=True)
        assert session.learn_error == ""
        for hue in HUES:
            session.begin_episode()
            episode = session.episode
            pressed_by(session, gel, hue, lambda e=episode: len(e.touches) > 2)
            assert session.end_episode()["best"] == hue
        touches = episode.as_touches()
        assert touches.channels == ("r", "g", "b")
        assert touches.images.shape[1:] == (48, 64, 3)
        # The leaf is greener than the gel, and no redder than its noise.
        change = (touches.images.max(axis=(1, 2)) - session.baseline.max()).mean(0)
        assert change[1] > 30 > change[0]
        shown = seen(client.get("/api/episode/touches/1/picture").content)
        assert (shown[..., 1] > shown[..., 2].max()).any()  # green above all red
        assert "data:image/png" in client.get("/api/episode/report").text
        assert client.get("/api/episode/archive").status_code == 200

        assert client.post("/api/baseline", json={"ask_press": True}).is_success
        pressed_by(session, gel, "rose", lambda: session.watch.press is not None)
        press = seen(client.get("/api/baseline/press").content)
        assert press[..., 2].max() > 2 * press[..., 1].max()
    frames = [event.picture for event in events if event.kind == "frame"]
    assert any(np.ptp(seen(one).astype(int).mean((0, 1))) > 3 for one in frames)
    with TouchLibrary.open(library) as kept:
        stored = kept.touches()
        assert stored.channels == ("r", "g", "b")
        assert stored.no_contact.shape == stored.images.shape[1:] == (48, 64, 3)


@pytest.mark.parametrize("colour", [False, True], ids=["grey", "colour"])
def test_a_model_of_the_other_kind_is_refused_with_the_fix(
    tmp_path, gel, camera, learning_here, colour
):
    library, model = tmp_path / "library", tmp_path / "library" / "model.palpate"
    with LiveSession(camera(colour=colour), library=library) as session:
        taught(session, gel)
        session.learn(wait=True)
        assert session.learn_error == ""
    kinds = ["colour", "grey"] if colour else ["grey", "colour"]
    message = (
        f"must be of images of 48 x 64 taxels in {kinds[1]}, which camera gel gives, "
        f"got one of 48 x 64 taxels in {kinds[0]}.* with colour={int(colour)}"
    )
    with pytest.raises(ValueError, match=message):
        LiveSession(camera(colour=not colour), model=model).start()
    with LiveSession(camera(colour=not colour), library=library) as session:
        assert session.to_dict()["sensor"]["warnings"] == [session.watch.misfit]
        session.take_baseline()
        pressed_by(session, gel, "rose", lambda: session.trouble != "")
        assert session.trouble == session.watch.misfit
        # One sensor of a library gives colour or grey, never both.
        session.teach("rose", 2)
        pressed_by(session, gel, "rose", lambda: session.trouble != "")
        assert "channels like those in the library" in session.trouble
        assert len(session.teacher.library) == 12
