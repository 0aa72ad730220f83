"""A camera without a camera: a capture object that does what drivers do."""

import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.sensors import (
    CameraSensor,
    SensorError,
    TouchDetector,
    camera_names,
    check_sensor,
    find_camera,
)

AUTO_EXPOSURE, EXPOSURE, WIDTH, HEIGHT = 21, 15, 3, 4  # OpenCV's numbers


class FakeCapture:
    """Gives grey-blue pictures at 500 Hz until it is unplugged."""

    def __init__(self, shape=(24, 32), opens=True, gives=True, obeys=True):
        self.shape, self.opens, self.gives, self.obeys = shape, opens, gives, obeys
        self.settings = {EXPOSURE: 0.25}
        self.plugged, self.released, self.n_read = threading.Event(), 0, 0
        self.plugged.set()

    def isOpened(self):
        return self.opens and self.plugged.is_set()

    def set(self, what, value):
        self.settings[what] = value
        return self.obeys

    def get(self, what):
        return self.settings.get(what, 0.0)

    def read(self):
        time.sleep(0.002)
        self.n_read += 1
        if not self.gives or not self.plugged.is_set():
            return False, None
        picture = np.zeros((*self.shape, 3), np.uint8)
        picture[..., 0] = 100  # blue
        return True, picture

    def release(self):
        self.released += 1


def camera(capture, shape=(24, 32), **options):
    return CameraSensor("dome", shape, open_capture=lambda name: capture, **options)


def drained(sensor):
    """Read what still waits; return what is said when nothing does."""
    for _ in range(sensor.queue_length + 1):
        try:
            sensor.read_next(0.05)
        except SensorError as refusal:
            return str(refusal)
    return ""


@pytest.mark.parametrize("colour", [False, True])
def test_it_keeps_the_contract(colour):
    check_sensor(camera(FakeCapture(), colour=colour))


def test_colour_becomes_luma():
    with camera(FakeCapture()) as sensor:
        # 0.114 of blue (ITU-R BT.601), rounded to a grey level.
        assert (sensor.read_next().image == 11).all()


def test_colours_are_red_green_blue_where_they_are_wanted():
    with camera(FakeCapture(), colour=True) as sensor:
        assert sensor.image_shape == (24, 32, 3)
        image = sensor.read_next().image
        assert (image == [0, 0, 100]).all()
        detector = TouchDetector()
        detector.take_baseline([sensor.read_next().image for _ in range(3)])
        assert (detector.baseline == image).all()


def test_a_camera_without_colours_cannot_give_them():
    capture = FakeCapture()
    capture.read = lambda: (True, np.zeros((24, 32), np.uint8))
    with pytest.raises(SensorError, match="must give colours, got grey"):
        camera(capture, colour=True).connect()
    with camera(capture) as sensor:
        assert sensor.read_next().image.shape == (24, 32)


def test_exposure_is_fixed_where_the_driver_lets_it():
    capture = FakeCapture()
    with camera(capture) as sensor:
        assert capture.settings[AUTO_EXPOSURE] == 1
        assert capture.settings[EXPOSURE] == 0.25  # what it had settled on
        assert (capture.settings[WIDTH], capture.settings[HEIGHT]) == (32, 24)
        assert sensor.fixed == {"exposure": True, "white balance": True, "focus": True}
    with camera(FakeCapture(obeys=False), exposure=3.0) as sensor:
        assert not any(sensor.fixed.values())


def test_an_unplugged_camera_is_found_again():
    capture = FakeCapture()
    sensor = camera(capture)
    sensor.retry_s = 0.01
    with sensor:
        sensor.read_next()
        capture.plugged.clear()
        time.sleep(0.1)
        assert "cannot be opened" in sensor.lost
        assert "camera dome is lost: The camera 'dome' cannot" in drained(sensor)
        capture.plugged.set()
        assert sensor.read_next(5.0).image.shape == (24, 32)
        assert sensor.lost == ""
    assert capture.released >= 2


def test_frames_nobody_reads_are_dropped_and_counted():
    with camera(FakeCapture()) as sensor:
        time.sleep(0.1)
        old = sensor.read_next()
        assert sensor.n_dropped > 0
        assert time.monotonic() - old.time_s < 0.1  # two frames wait at most


@pytest.mark.parametrize(
    ("capture", "message"),
    [
        (FakeCapture(opens=False), "cannot be opened. Close the program"),
        (FakeCapture(gives=False), "opens but gives no picture"),
        (FakeCapture(shape=(48, 64)), "must give 32 x 24 pixels, got 64 x 48"),
    ],
)
def test_what_is_wrong_is_one_sentence_with_the_fix(capture, message):
    with pytest.raises(SensorError, match=message):
        camera(capture).connect()
    assert capture.released == 1


def test_names_choose_one_camera(monkeypatch):
    listed = [
        SimpleNamespace(name="Dome cam", path="/dev/video0", index=0),
        SimpleNamespace(name="Desk cam", path="/dev/video2", index=2),
    ]
    package = SimpleNamespace(enumerate_cameras=lambda: listed)
    monkeypatch.setitem(sys.modules, "cv2_enumerate_cameras", package)
    assert camera_names() == [("Dome cam", "/dev/video0"), ("Desk cam", "/dev/video2")]
    assert find_camera("dome") == "/dev/video0"
    assert find_camera("3") == "3"
    with pytest.raises(SensorError, match=r"2 cameras have 'cam' .*'Dome cam'"):
        find_camera("cam")
    with pytest.raises(SensorError, match="No camera has 'hall' in the name"):
        find_camera("hall")
    with pytest.raises(SensorError, match="no camera at /dev/nowhere"):
        find_camera("/dev/nowhere")


def test_without_the_package_names_are_refused_and_paths_are_not(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "cv2_enumerate_cameras", None)
    with pytest.raises(ImportError, match=r'pip install "palpate\[camera\]"'):
        camera_names()
    path = tmp_path / "video0"
    path.touch()
    assert find_camera(str(path)) == str(path)
