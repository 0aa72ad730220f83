"""Images going out as pictures and coming in: numbers, grey, colour, channels."""

import io

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palpate import Touches
from palpate.library import TouchLibrary
from palpate.sensors import ReplaySensor
from palpate.web import LiveSession
from palpate.web._images import FramePainter, thumbnail

from .conftest import Still, learn_job, waited


def decoded(picture):
    return cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize(
    ("dtype", "level"), [(np.uint8, 0.0), (np.uint8, 255.0), (np.float32, 0.5)]
)
def test_levels_that_a_type_can_hold_are_taken_as_it(dtype, level):
    session = LiveSession(Still((2, 2), dtype=dtype))
    session.post_touch(np.array([[1.0, 2.0], [3.0, level]]))
    (image,) = session.episode.images
    assert image.dtype == dtype
    assert_array_equal(image, [[1, 2], [3, level]])


@pytest.mark.parametrize("level", [-1.0, 256.0, 1.5, np.nan])
def test_numbers_outside_a_type_are_refused(level):
    with pytest.raises(ValueError, match="whole numbers from 0 to 255"):
        LiveSession(Still((2, 2))).post_touch(np.array([[1.0, 2.0], [3.0, level]]))


def test_arrays_are_false_colours_over_the_widest_range_yet():
    painter = FramePainter((2, 2))
    assert painter.content_type == "image/png"
    first = painter.levels(np.array([[0.0, 10.0], [np.nan, 5.0]]))
    levels = np.arange(256, dtype=np.uint8)[:, np.newaxis]
    viridis = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
    assert_array_equal(first[0, 0], viridis[0, 0])
    assert_array_equal(first[0, 1], viridis[255, 0])
    assert_array_equal(first[1, 0], (16, 14, 11))  # a gap
    half = painter.levels(np.array([[0.0, 5.0], [0.0, 0.0]]))
    assert_array_equal(half[0, 1], viridis[127, 0])
    assert FramePainter((2, 2)).levels(np.full((2, 2), np.nan)).shape == (2, 2, 3)


@pytest.mark.parametrize(
    ("shape", "false_colour", "coloured"),
    [((48, 48), False, True), ((49, 48), False, False), ((49, 48), True, True)],
)
def test_pictures_of_cameras_are_grey(shape, false_colour, coloured):
    painter = FramePainter(shape, false_colour=false_colour)
    assert painter.coloured == coloured
    image = np.full(shape, 90, np.uint8)
    picture = decoded(painter.paint(image))
    assert (picture.ndim == 3) == coloured
    if not coloured:
        assert painter.content_type == "image/jpeg"
        assert_allclose(picture, 90, atol=1)


def test_a_thumbnail_is_96_pixels_at_its_longer_side():
    assert decoded(thumbnail(np.arange(8.0).reshape(2, 4))).shape == (48, 96, 3)
    assert decoded(thumbnail(np.zeros((480, 640), np.uint8))).shape == (72, 96)
    assert decoded(thumbnail(np.zeros((1, 400), np.uint8))).shape == (1, 96)


def test_taxels_stay_squares_and_pixels_are_averaged():
    """An array's taxels are enlarged as they are; a camera's pixels are means."""
    taxels = decoded(thumbnail(np.array([[0.0, 1.0], [2.0, 3.0]])))
    assert len(np.unique(taxels.reshape(-1, 3), axis=0)) == 4
    stripes = np.zeros((960, 960), np.uint8)
    stripes[::2] = 200
    assert_allclose(decoded(thumbnail(stripes)), 100, atol=1)


def test_cameras_pictures_are_of_quality_80():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (64, 64), dtype=np.uint8)
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
    assert FramePainter((64, 64)).paint(image) == coded


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
        return decoded(answer.content)

    return show


def test_colour_is_shown_in_colour(picture_of):
    picture = picture_of(red_left(), ["r", "g", "b"])
    assert picture.shape == (96, 96, 3)
    assert picture[48, 10].tolist() == [0, 0, 200]
    assert picture[48, 85].tolist() == [200, 0, 0]
    turned = picture_of(red_left()[..., ::-1].copy(), ["b", "g", "r"])
    assert_array_equal(turned, picture)


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


def test_colour_is_refused_where_grey_was_learnt(client, drawn):
    image = drawn.images[0]
    painted = np.stack([image, image, image // 2], axis=-1)
    path = "/api/teach/touch/picture?object=cup"
    assert posted(client, path, as_png(image)).status_code == 200
    for query, body in ("&colour=1", as_png(painted)), ("", as_npy(painted)):
        refused = posted(client, path + query, body)
        assert refused.status_code == 422
        assert "must have 12 x 12 taxels in grey" in refused.text
        assert "got 12 x 12 with 3 channels" in refused.text
    # A grey picture has no colour to read.
    assert posted(client, path + "&colour=1", as_png(image)).status_code == 200
    # A picture in colour is read in grey, as those of folders are.
    assert posted(client, path, as_png(painted)).status_code == 200
    same = as_png(np.stack([image] * 3, axis=-1))
    key = posted(client, path, same).json()["id"]
    stored = client.session.teacher.library.image(key)
    assert_array_equal(stored, image)


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
        assert client.get("/api/episode/archive").status_code == 200
        assert "data:image/png" in client.get("/api/episode/report").text
        assert session.teacher.touches("rose").channels == tuple(names)
        assert session.teacher.touches("rose").no_contact.shape == baseline.shape
        assert session.episode.as_touches().channels == tuple(names)
        assert waited(lambda: not session.watch.detector.touching)
        session.take_baseline(ask_press=True)
        session.place("rose")
        assert waited(lambda: session.watch.press is not None)
        press = decoded(client.get("/api/baseline/press").content)
    assert session.trouble == ""
    for picture in (strongest(events), stored_picture, press):
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


@pytest.mark.parametrize("colour", [False, True], ids=["grey", "colour"])
def test_a_model_of_the_other_kind_is_refused_with_the_fix(tmp_path, rng, colour):
    images = np.concatenate([*hues(rng, 6)])
    things = np.repeat(["rose", "leaf"], 6)
    grey = Touches(images[..., 0], object=things, no_contact=images[0, ..., 0])
    painted = Touches(images, object=things, channels=[*"rgb"], no_contact=images[0])
    learnt, played = (painted, grey) if colour else (grey, painted)
    library, model = tmp_path / "library", tmp_path / "library" / "model.palpate"
    with LiveSession(ReplaySensor(learnt), library=library) as session:
        for thing, image in zip(things, learnt.images, strict=True):
            session.post_lesson(thing, image)
        session.learn(wait=True)
        assert session.learn_error == ""
    kinds = ["colour", "grey"] if colour else ["grey", "colour"]
    message = (
        f"must be of images of 24 x 32 taxels in {kinds[1]}, which replay of touches "
        f"gives, got one of 24 x 32 taxels in {kinds[0]}.* with colour={int(colour)}"
    )
    sensor = ReplaySensor(played, rate_hz=200, hold=3, gap=3)
    with pytest.raises(ValueError, match=message):
        LiveSession(sensor, model=model).start()
    with LiveSession(sensor, library=library) as session:
        assert session.to_dict()["sensor"]["warnings"] == [session.watch.misfit]
        assert waited(lambda: session.trouble == session.watch.misfit)
        # One sensor of a library gives colour or grey, never both.
        session.teach("rose", 2)
        assert waited(lambda: "channels like those in the library" in session.trouble)
        assert len(session.teacher.library) == 12
