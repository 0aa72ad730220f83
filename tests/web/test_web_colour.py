"""Touches with channels on the page: colour in colour, others as their mean."""

import io
import time

import cv2
import numpy as np
import pytest

from palpate import Touches
from palpate.library import TouchLibrary
from palpate.sensors import CameraSensor, ReplaySensor
from palpate.web import LiveSession

from .conftest import learn_job, waited


def red_left(side=60):
    """A picture that is red on its left half and blue on its right."""
    image = np.zeros((side, side, 3), np.uint8)
    image[:, : side // 2, 0] = image[:, side // 2 :, 2] = 200
    return image


@pytest.fixture
def picture_of(tmp_path, make_session, connected):
    """Return a function: the page's picture of a touch, in blue, green, red."""

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
            assert f"60 x 60 pixels with channels {', '.join(channels)}" in refused.text
            assert "got 60 x 60 in grey" in refused.text
        data = np.frombuffer(answer.content, np.uint8)
        return cv2.imdecode(data, cv2.IMREAD_COLOR)

    return show


def test_colour_is_shown_in_colour(picture_of):
    picture = picture_of(red_left(), ["r", "g", "b"])
    assert picture.shape == (96, 96, 3)
    assert picture[48, 10].tolist() == [0, 0, 200]
    assert picture[48, 85].tolist() == [200, 0, 0]
    turned = picture_of(red_left()[..., ::-1].copy(), ["b", "g", "r"])
    np.testing.assert_array_equal(turned, picture)


def test_other_channels_are_shown_as_their_mean(picture_of):
    picture = picture_of(red_left(), ["x", "y", "z"])
    assert len(np.unique(picture)) == 1


def hues(rng, count):
    """Blobs at random places over noise, of two hues of one luma, in red first."""
    row, col = np.mgrid[:24, :32]
    for hue in (98, 0, 0), (0, 50, 0):
        places = rng.uniform((8, 8), (16, 24), (count, 2))
        squared_distances = [(row - y) ** 2 + (col - x) ** 2 for y, x in places]
        blobs = np.exp(-np.array(squared_distances) / 30)[..., np.newaxis] * hue
        noise = rng.normal(scale=0.5, size=blobs.shape)
        yield np.rint(60 + blobs + noise).astype(np.uint8)


def as_png(image):
    levels = image[..., ::-1] if image.ndim == 3 else image
    return cv2.imencode(".png", levels)[1].tobytes(), "image/png"


def as_npy(image):
    written = io.BytesIO()
    np.save(written, image)
    return written.getvalue(), "application/x-npy"


def posted(client, path, body):
    content, kind = body
    return client.post(path, content=content, headers={"Content-Type": kind})


@pytest.mark.slow
@pytest.mark.parametrize("coded", [as_png, as_npy])
def test_touches_in_colour_are_taught_and_recognised_by_the_api(
    tmp_path, make_session, connected, rng, coded
):
    library, model = tmp_path / "library", tmp_path / "library" / "model.palpate"
    session = make_session(sensor=False, library=library)
    taught = dict(zip(("rose", "leaf"), hues(rng, 7), strict=True))
    with connected(session) as client:
        for name, images in taught.items():
            for image in images[:6]:
                path = f"/api/teach/touch/picture?object={name}&colour=1"
                assert posted(client, path, coded(image)).status_code == 200
        session.learn(wait=True)
        assert session.learn_error == ""
    for options in ({"library": library}, {"library": None, "model": model}):
        session = make_session(sensor=False, **options)
        with connected(session) as client:
            for name, images in taught.items():
                client.post("/api/episode/start")
                answer = posted(client, "/api/touch/picture", coded(images[6])).json()
                assert answer["best"] == name
            assert session.episode.as_touches().channels == ("r", "g", "b")
            picture = client.get("/api/episode/touches/1/picture").content
            assert decoded(picture)[..., 1].max() > decoded(picture)[..., 2].max()
            grey = images[0][..., 1].copy()
            for body in as_png(grey), as_npy(grey):
                refused = posted(client, "/api/touch/picture", body)
                assert refused.status_code == 422
                assert "must have 24 x 32 taxels with channels r, g, b" in refused.text
                assert "got 24 x 32 in grey" in refused.text


def test_colour_is_refused_where_grey_was_learnt(make_session, connected, drawn):
    image = drawn.images[0]
    painted = np.stack([image, image, image // 2], axis=-1)
    with connected(make_session(sensor=False)) as client:
        path = "/api/teach/touch/picture?object=cup"
        assert posted(client, path, as_png(image)).status_code == 200
        for query, body in ("&colour=1", as_png(painted)), ("", as_npy(painted)):
            refused = posted(client, path + query, body)
            assert refused.status_code == 422
            assert "must have 12 x 12 taxels in grey" in refused.text
            assert "got 12 x 12 with 3 channels" in refused.text
        # A picture in colour is read in grey, as those of folders are.
        assert posted(client, path, as_png(painted)).status_code == 200
        same = as_png(np.stack([image] * 3, axis=-1))
        key = posted(client, path, same).json()["id"]
        stored = client.session.teacher.library.image(key)
        np.testing.assert_array_equal(stored, image)


def strongest(events):
    """Return the shown frame with most of a pattern; a colour alone is none."""
    frames = [decoded(event.picture) for event in [*events] if event.kind == "frame"]
    return max(frames, key=lambda frame: np.ptp(frame, axis=(0, 1)).max())


@pytest.mark.parametrize("names", ["rgb", "xyz", "abcdef"])
def test_a_replay_with_channels_is_taught_and_shown(tmp_path, rng, names, connected):
    parts = np.concatenate([*hues(rng, 6)])
    images = np.concatenate([parts] * (len(names) // 3), axis=-1)
    baseline = np.full(images.shape[1:], 60, np.uint8)
    things = np.repeat(["rose", "leaf"], 6)
    recorded = Touches(images, object=things, channels=[*names], no_contact=baseline)
    sensor = ReplaySensor(recorded, rate_hz=200, hold=3, gap=3)
    sensor.place(None)
    session, events = LiveSession(sensor, library=tmp_path / "library"), []
    session.listeners.add(events.append)
    with connected(session) as client:
        session.teach("rose", 3)
        session.place("rose")
        assert waited(lambda: session.teacher.lesson is None)
        assert waited(lambda: session.episode.touches)
        # Only some frames are shown: wait until one of them is a press.
        assert waited(lambda: np.ptp(strongest(events), axis=(0, 1)).max() > 50)
        session.place(None)
        key = session.teacher.newest("rose", 3)[0].id
        stored_picture = decoded(client.get(f"/api/touches/{key}/picture").content)
        assert client.get("/api/episode/touches/1/picture").status_code == 200
        assert session.teacher.touches("rose").channels == tuple(names)
        assert session.episode.as_touches().channels == tuple(names)
    assert session.trouble == ""
    for picture in (strongest(events), stored_picture):
        _, green, red = np.ptp(picture, axis=(0, 1))
        assert red > 50
        # Other channels are shown as one, in false colour.
        assert (green < 20) == (names == "rgb")


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


def decoded(picture):
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


def press_until(session, gel, hue, condition):
    """Let a thing press until a condition holds, then wait for late frames."""
    gel.hue = hue
    assert waited(condition)
    gel.hue = None
    time.sleep(0.3)


def teach_both(session, gel):
    """Teach both things, six touches each."""
    session.take_baseline()
    for hue in HUES:
        session.teach(hue, 6)
        press_until(session, gel, hue, lambda: session.teacher.lesson is None)
    assert session.trouble == ""


@pytest.mark.slow
def test_a_colour_camera_teaches_what_differs_in_hue_alone(
    tmp_path, gel, camera, connected
):
    library, events = tmp_path / "library", []
    session = LiveSession(camera(colour=True), library=library)
    session.listeners.add(events.append)
    with connected(session) as client:
        teach_both(session, gel)
        session.learn(wait=True)
        assert session.learn_error == ""
        for hue in HUES:
            session.begin_episode()
            episode = session.episode
            press_until(session, gel, hue, lambda e=episode: len(e.touches) > 2)
            assert session.end_episode()["best"] == hue
        touches = episode.as_touches()
        assert touches.channels == ("r", "g", "b")
        assert touches.images.shape[1:] == (48, 64, 3)
        # The leaf is greener than the gel, and no redder than its noise.
        change = (touches.images.max(axis=(1, 2)) - session.baseline.max()).mean(0)
        assert change[1] > 30 > change[0]
        picture = decoded(client.get("/api/episode/touches/1/picture").content)
        assert (picture[..., 1] > picture[..., 2].max()).any()  # green above all red
        assert "data:image/png" in client.get("/api/episode/report").text
        assert client.get("/api/episode/archive").status_code == 200

        assert client.post("/api/baseline", json={"ask_press": True}).is_success
        press_until(session, gel, "rose", lambda: session.watch.press is not None)
        press = decoded(client.get("/api/baseline/press").content)
        assert press[..., 2].max() > 2 * press[..., 1].max()
    frames = [event.picture for event in events if event.kind == "frame"]
    assert any(np.ptp(decoded(frame).astype(int).mean((0, 1))) > 3 for frame in frames)
    with TouchLibrary.open(library) as kept:
        stored = kept.touches()
        assert stored.channels == ("r", "g", "b")
        assert stored.no_contact.shape == stored.images.shape[1:] == (48, 64, 3)


@pytest.mark.parametrize(
    "colour",
    [pytest.param(False, marks=pytest.mark.slow), True],
    ids=["grey", "colour"],
)
def test_a_model_of_the_other_kind_is_refused_with_the_fix(
    tmp_path, gel, camera, colour
):
    library, model = tmp_path / "library", tmp_path / "library" / "model.palpate"
    with LiveSession(camera(colour=colour), library=library) as session:
        teach_both(session, gel)
        session.learn(wait=True)
        assert session.learn_error == ""
    kinds = ["colour", "grey"] if colour else ["grey", "colour"]
    message = (
        f"must be of images of 48 x 64 pixels in {kinds[1]}, which camera gel gives, "
        f"got one of 48 x 64 pixels in {kinds[0]}.* with colour={int(colour)}"
    )
    with pytest.raises(ValueError, match=message):
        LiveSession(camera(colour=not colour), model=model).start()
    with LiveSession(camera(colour=not colour), library=library) as session:
        assert session.to_dict()["sensor"]["warnings"] == [session.watch.misfit]
        session.take_baseline()
        press_until(session, gel, "rose", lambda: session.trouble != "")
        assert session.trouble == session.watch.misfit
        # One sensor of a library gives colour or grey, never both.
        session.teach("rose", 2)
        press_until(session, gel, "rose", lambda: session.trouble != "")
        assert "channels like those in the library" in session.trouble
        assert len(session.teacher.library) == 12
