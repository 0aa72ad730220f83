"""Sessions, servers and drawn things to touch, for all tests of the page."""

import json
import shutil
import time
from contextlib import contextmanager
from pathlib import Path

import httpx
import numpy as np
import pytest

from palpate import ObjectRecogniser, Touches
from palpate.library import TouchLibrary
from palpate.sensors import LiveSensor, ReplaySensor, SensorError
from palpate.web import LiveSession, PageServer, create_app
from palpate.web._learning import _LEARNER, learn_job
from palpate.web._learning import LearningError as LearningError
from palpate.web._sensor_watch import Event as Event

pytest.importorskip("fastapi", reason='pip install "palpate[web]"')
pytest.importorskip("uvicorn", reason='pip install "palpate[web]"')

SIDE = 12
CHROMIUM = Path("/usr/bin/chromium")


def drawn_touches(name, count, rng):
    """Presses of a drawn object: its shape at a random place, over noise."""
    row, col = np.mgrid[:SIDE, :SIDE]
    images = []
    for number in range(count):
        shape = name if name != "both" else ("disc", "bar")[number % 2]
        y, x = rng.uniform(4, 7, size=2)
        if shape == "disc":
            image = np.hypot(row - y, col - x) < 3.2
        else:
            image = (abs(row - y) < 1.2) & (abs(col - x) < 4.5)
        images.append(image * 150 + rng.normal(scale=3, size=image.shape))
    return np.rint(images).clip(0, 255).astype(np.uint8)


def waited(condition, seconds=20.0):
    """Wait until a condition holds; return whether it does."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


@pytest.fixture(scope="session")
def drawn():
    """Thirty touches each of a disc, a bar, and a thing that is both by turns."""
    rng = np.random.default_rng(1)
    names = ["disc", "bar", "both"]
    images = np.concatenate([drawn_touches(name, 30, rng) for name in names])
    baseline = np.zeros((SIDE, SIDE), np.uint8)
    return Touches(
        images, object=np.repeat(names, 30), no_contact=baseline, geometry="array"
    )


@pytest.fixture(scope="session")
def drawn_model(tmp_path_factory, drawn):
    """The file of a model of the disc and the bar."""
    path = tmp_path_factory.mktemp("model") / "two.palpate"
    two = drawn[np.flatnonzero(drawn.object != "both")]
    ObjectRecogniser("liu2014").fit(two).save(path)
    return path


@pytest.fixture(scope="session")
def make_session(tmp_path_factory, drawn):
    """Return a function that makes a session over a fast replay of drawn touches."""

    def make(sensor=True, rate_hz=100.0, **options):
        options.setdefault("library", tmp_path_factory.mktemp("live") / "library")
        replay = None
        if sensor:
            replay = ReplaySensor(drawn, rate_hz=rate_hz, hold=3, gap=3)
            replay.place(None)
        return LiveSession(replay, **options)

    return make


@pytest.fixture
def learning_apart():
    """Learn in a process of its own, as servers do."""


@pytest.fixture
def another_learns(learning_apart):
    """Keep the process that learns at the lesson of another session."""
    with _LEARNER._lock:
        yield


@pytest.fixture
def learn_by(monkeypatch):
    """Return a function that sets the function by which sessions learn."""

    def learn(function):
        monkeypatch.setattr("palpate.web._session.learn_in_process", function)

    return learn


@pytest.fixture
def learning_starts(monkeypatch):
    """A list that grows when the process that learns is to be started early."""
    starts = []
    name = "palpate.web._session.start_learning"
    monkeypatch.setattr(name, lambda: starts.append("learning"))
    return starts


@pytest.fixture(autouse=True)
def learning_here(request):
    """Let all other tests learn in this process: starting another takes seconds."""

    def as_sent(*job):
        return learn_job(*json.loads(json.dumps(job, default=str)))

    if "learning_apart" not in request.fixturenames:
        request.getfixturevalue("learn_by")(as_sent)
        request.getfixturevalue("learning_starts")


class Still(LiveSensor):
    """A sensor that gives no frames by itself."""

    def __init__(self, shape=(4, 4), geometry="array", unit="count", dtype=np.uint8):
        super().__init__("still", unit, shape, dtype, geometry)

    def _open(self):
        pass

    def _grab(self):
        return []

    def _close(self):
        pass


@pytest.fixture(autouse=True)
def _short_baselines(monkeypatch, lower):
    lower(monkeypatch, baseline_s=0.0)


class HandSensor(LiveSensor):
    """An array that reads whatever a test says, and does not know its baseline."""

    def __init__(self, geometry="array"):
        super().__init__("hand", "count", (SIDE, SIDE), np.uint8, geometry)
        self.pressed = self.unplugged = False

    def show(self, session, pressed):
        """Be pressed, or not, until a session has followed six more frames.

        A press must last more than one frame, and three may be on their way.
        """
        self.pressed = pressed
        enough = session.health.to_dict()["n_frames"] + 6
        waited(lambda: session.health.to_dict()["n_frames"] >= enough)

    def _open(self):
        if self.unplugged:
            raise SensorError("it is unplugged")

    def _grab(self):
        time.sleep(0.005)
        self._open()
        image = np.full((SIDE, SIDE), 20, np.uint8)
        if self.pressed:
            image[3:7, 4:9] = 200
        return [image]

    def _close(self):
        pass


@pytest.fixture
def hand():
    """Give a sensor that is pressed by setting `pressed`."""
    return HandSensor()


@contextmanager
def serving(session, token=None, port=0, keep_alive_s=5, **limits):
    """Run the application of a session, on a free port; give address and token."""
    server = PageServer(port=port)
    token = token or server.token
    app = create_app(session, token, **limits)
    options = {"log_level": "error", "timeout_keep_alive": keep_alive_s}
    with server.running(app, **options) as address:
        yield address.rstrip("/"), token


@pytest.fixture(name="serving", scope="session")
def serving_fixture():
    """Give `serving` to tests."""
    return serving


@pytest.fixture(scope="session")
def connected():
    """Return a context manager: a client of a served session, signed in or not."""

    @contextmanager
    def connect(session, token="token", *, signed_in=True, **limits):
        with serving(session, token, **limits) as (address, _):
            headers = {"Authorization": f"Bearer {token}"} if signed_in else {}
            # Nothing is encrypted, and loading certificates takes longer than a test.
            plain = {"verify": False, "follow_redirects": True}
            with httpx.Client(
                base_url=address, headers=headers, timeout=30, **plain
            ) as client:
                client.session = session
                yield client

    return connect


@pytest.fixture
def client(make_session, connected):
    """A client of a session that has neither a sensor nor a model."""
    with connected(make_session(sensor=False), rate_hz=2000) as client:
        yield client


@pytest.fixture(scope="module")
def window():
    """One window of a browser: opening one takes a second of two processors' time."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed"
    )
    if not CHROMIUM.exists():
        pytest.skip("Debian's chromium is not installed (apt install chromium)")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(
            executable_path=str(CHROMIUM), args=["--no-sandbox"]
        )
        context = started.new_context(viewport={"width": 1280, "height": 900})
        context.new_page()  # the window stays open while it has a tab
        yield context
        started.close()


@pytest.fixture
def page(window):
    """A new tab, without the cookies of earlier ones."""
    opened = window.new_page()
    opened.errors = []
    opened.on("pageerror", lambda error: opened.errors.append(str(error)))
    yield opened
    for tab in window.pages[1:]:
        tab.close()
    window.clear_cookies()
    assert opened.errors == []


@pytest.fixture
def open_page(page):
    """Return a context manager: a session that is served and open in the tab.

    With `frames` the tab shows some by then. Yields address and token.
    """

    @contextmanager
    def opened(session, *, frames=False):
        with serving(session) as (address, token):
            page.goto(f"{address}/?token={token}")
            if frames:
                page.locator("#rate", has_text="Hz").wait_for(timeout=40_000)
            yield address, token

    return opened


@pytest.fixture(scope="session")
def taught_library(tmp_path_factory, drawn):
    """The library of a session that has learnt the disc and the bar."""
    folder = tmp_path_factory.mktemp("taught") / "library"
    with TouchLibrary.open(folder, create=True) as library:
        library.add(drawn[drawn.object != "both"])
    learn_job(folder, folder / "model.palpate")
    return folder


@pytest.fixture
def taught(make_session, taught_library, tmp_path):
    """A session that has learnt the disc and the bar."""
    folder = shutil.copytree(taught_library, tmp_path / "taught")
    return make_session(library=folder, rate_hz=60.0)


@pytest.fixture
def folder(tmp_path, drawn):
    """A library of eight discs and eight bars, with a session and a category."""
    touches = drawn[[*range(8), *range(30, 38)]]
    kinds = ["round"] * 8 + ["long"] * 8
    with TouchLibrary.open(tmp_path / "library", create=True) as library:
        library.add(touches.with_columns(category=kinds), session="old")
    return tmp_path / "library"
