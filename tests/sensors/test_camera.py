"""Cameras without a device: a capture object does what drivers do."""

import os
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from palpate.sensors import (
    CameraSensor,
    SensorError,
    TouchDetector,
    check_sensor,
    open_sensor,
)

# OpenCV's numbers.
AUTO_EXPOSURE, EXPOSURE, WIDTH, HEIGHT, GAIN = 21, 15, 3, 4, 14
FOURCC, AUTO_FOCUS, FOCUS, TEMPERATURE = 6, 39, 28, 45


class FakeCapture:
    """Gives grey-blue pictures at 500 Hz until it is unplugged."""

    def __init__(self, shape=(24, 32), opens=True, gives=True, obeys=True):
        self.shape, self.opens, self.gives, self.obeys = shape, opens, gives, obeys
        self.settings = {EXPOSURE: 0.25}
        self.picture = np.zeros((*shape, 3), np.uint8)
        self.picture[..., 0] = 100  # blue
        self.plugged, self.released, self.n_read = threading.Event(), 0, 0
        self.plugged.set()

    def isOpened(self):
        return self.opens and self.plugged.is_set()

    def set(self, setting, value):
        self.settings[setting] = value
        return self.obeys

    def get(self, setting):
        return self.settings.get(setting, 0.0)

    def read(self):
        time.sleep(0.002)
        self.n_read += 1
        if not self.gives or not self.plugged.is_set():
            return False, None
        return True, self.picture

    def release(self):
        self.released += 1


def camera(capture, shape=(24, 32), **options):
    return CameraSensor("dome", shape, open_capture=lambda name: capture, **options)


def drained(sensor):
    """Read the frames that still wait; return the message when none does."""
    for _ in range(sensor.queue_length + 1):
        try:
            sensor.read_next(0.05)
        except SensorError as refusal:
            return str(refusal)
    return ""


@pytest.mark.parametrize("colour", [False, True])
def test_a_camera_keeps_the_contract(colour):
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
        assert set(sensor.fixed) == {"exposure", "white balance", "focus", "gain"}
        assert all(sensor.fixed.values())
        assert sensor.unfixed == ""
    with camera(FakeCapture(obeys=False), exposure=3.0) as sensor:
        assert not any(sensor.fixed.values())
        assert "keep exposure and white balance and focus and gain" in sensor.unfixed


def test_settings_that_a_camera_does_not_have_are_not_missed():
    capture = FakeCapture()
    capture.settings |= {AUTO_FOCUS: -1, FOCUS: -1, GAIN: -1}
    with camera(capture) as sensor:
        assert sensor.fixed == {"exposure": True, "white balance": True}
        assert capture.settings[GAIN] == -1
    with camera(FakeCapture(), gain=7.0) as sensor:
        assert sensor.kept["gain"] == 7.0


class Replugged(FakeCapture):
    """Begins with its own automatic values whenever it is plugged in."""

    def __init__(self):
        super().__init__()
        self.light = 100.0

    def plug(self, light):
        self.light = light
        self.settings = {AUTO_EXPOSURE: 3, TEMPERATURE: light}
        self.plugged.set()

    def get(self, setting):
        automatic = self.settings.get(AUTO_EXPOSURE) != 1
        return self.light if automatic and setting == EXPOSURE else super().get(setting)

    def read(self):
        self.picture[..., 0] = self.get(EXPOSURE)
        return super().read()


def test_exposure_is_kept_when_the_camera_is_found_again():
    capture = Replugged()
    capture.plug(100.0)
    sensor = camera(capture)
    sensor.retry_s = 0.01
    with sensor:
        before = sensor.read()
        capture.plugged.clear()
        time.sleep(0.05)
        capture.plug(200.0)  # a hand lies over it, say
        drained(sensor)
        after = sensor.read_next(5.0)
        assert capture.settings[EXPOSURE] == 100.0
        assert capture.settings[TEMPERATURE] == 100.0
        # Not even the first frame is of the exposure it began with.
        assert (after.image == before).all()
    capture.plug(50.0)
    with sensor:
        assert (sensor.read() == before).all()


def test_a_read_that_does_not_end_is_not_cut_off():
    capture = FakeCapture()
    free, reading = threading.Event(), threading.Event()
    sensor = camera(capture)
    sensor.patience_s = 0.05
    sensor.connect()
    sensor.read_next()

    def hang():
        reading.set()
        free.wait(10)
        return True, capture.picture

    capture.read = hang
    reading.wait(5)
    sensor.disconnect()
    assert not sensor.connected
    assert capture.released == 0
    with pytest.raises(SensorError, match=r"has not ended its last read. Unplug it"):
        sensor.connect()
    free.set()
    deadline = time.monotonic() + 5
    while not capture.released and time.monotonic() < deadline:
        time.sleep(0.005)
    assert capture.released == 1
    with sensor:
        assert sensor.read_next().image.shape == (24, 32)


def test_a_part_of_the_picture_is_cut_turned_and_shrunk():
    capture = FakeCapture(shape=(24, 32))
    rng = np.random.default_rng(0)
    capture.picture = rng.integers(0, 255, (24, 32, 3), np.uint8)
    part = capture.picture[4:16, 10:28, ::-1]
    colour = {"colour": True, "crop": (4, 10, 12, 18)}
    with camera(capture, **colour) as sensor:
        assert sensor.image_shape == (12, 18, 3)
        assert (sensor.read() == part).all()
    for rotation in (90, 180, 270):
        with camera(capture, rotation=rotation, **colour) as sensor:
            assert (sensor.read() == np.rot90(part, rotation // 90)).all()
    check_sensor(camera(capture, rotation=90, scale=0.5, **colour))
    with camera(capture, rotation=90, scale=0.5, **colour) as sensor:
        assert sensor.image_shape == (9, 6, 3)
        means = part.reshape(6, 2, 9, 2, 3).mean(axis=(1, 3))
        # OpenCV rounds means over areas to the nearest level.
        assert abs(sensor.read() - np.rot90(means)).max() <= 0.5
    with camera(capture, scale=0.25, crop=(0, 0, 1, 32)) as sensor:
        assert sensor.read().shape == (1, 8)


def test_an_address_says_what_of_the_picture_is_taken():
    address = "camera:0?shape=24x32&crop=4,10,12,18&rotation=270&scale=0.5&gain=3"
    sensor = open_sensor(f"{address}&fourcc=MJPG")
    assert sensor.picture_shape == (24, 32)
    assert sensor.image_shape == (9, 6)
    assert (sensor.kept, sensor.fourcc) == ({"gain": 3.0}, "MJPG")


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("crop=4,10,12", "columns within 24 x 32, got 4,10,12. Take"),
        ("crop=4,a", "crop must be row,.* like 0,80,480,480, got '4,a'"),
        ("crop=20,0,5,5", "columns within 24 x 32, got 20,0,5,5. Take"),
        ("crop=-1,0,5,5", "columns within 24 x 32, got -1,0,5,5. Take"),
        ("crop=1,1,0,5", "columns within 24 x 32, got 1,1,0,5. Take"),
        ("rotation=45", "rotation must be one of 0, 90, 180, 270, got 45"),
        ("scale=2", "scale must be finite and between -inf and 1.0, got 2.0"),
        ("scale=0", "scale must be positive and finite, got 0.0"),
        ("fourcc=MJPEG", "fourcc must be four letters such as MJPG, got 'MJPEG'"),
    ],
)
def test_parts_of_a_picture_that_cannot_be_taken_are_refused(option, message):
    with pytest.raises(ValueError, match=message):
        open_sensor(f"camera:0?shape=24x32&{option}")


def test_a_camera_is_asked_how_to_send_pictures():
    capture = FakeCapture()
    with camera(capture, fourcc="MJPG"):
        assert int(capture.settings[FOURCC]).to_bytes(4, "little") == b"MJPG"


def device():
    """Return a V4L2 camera of this machine, if there is one."""
    candidates = [
        os.environ.get("PALPATE_CAMERA"),
        *sorted(Path("/dev").glob("video*")),
    ]
    return next((str(path) for path in candidates if path), None)


@pytest.mark.camera
@pytest.mark.skipif(device() is None, reason="no /dev/video*, and no PALPATE_CAMERA")
def test_a_real_camera_keeps_the_contract_and_its_exposure():
    with CameraSensor(device()) as sensor:
        sensor.read()
        kept = dict(sensor.kept)
        assert set(sensor.fixed) >= {"exposure", "white balance"}
    check_sensor(sensor)
    assert sensor.kept == kept
    check_sensor(CameraSensor(device(), crop=(0, 80, 480, 480), scale=0.5, rotation=90))


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


def test_no_frame_is_made_of_pictures_of_another_size():
    """Another program has set the size: of larger pictures a corner was taken."""
    capture = FakeCapture()
    sensor = camera(capture)
    sensor.retry_s = 0.01
    with sensor:
        sensor.read_next()
        capture.picture = np.full((48, 64, 3), 200, np.uint8)
        assert "got 48 x 64. Ask for shape=48x64." in drained(sensor)
        assert sensor.read_latest().image.max() < 200


@pytest.mark.parametrize(
    ("capture", "message"),
    [
        (FakeCapture(opens=False), "cannot be opened. Close the program"),
        (FakeCapture(gives=False), "opens but gives no picture"),
        (FakeCapture(shape=(48, 64)), r"24 rows x 32 columns, got 48 x 64\. Ask"),
    ],
)
def test_a_camera_that_fails_is_one_sentence_with_the_fix(capture, message):
    with pytest.raises(SensorError, match=message):
        camera(capture).connect()
    assert capture.released == 1


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_a_camera_is_let_go_whatever_opening_it_raises(error):
    class Broken(FakeCapture):
        def read(self):
            raise error

    capture = Broken()
    with pytest.raises(error):
        camera(capture).connect()
    assert capture.released == 1


def test_names_choose_one_camera(monkeypatch):
    listed = [
        SimpleNamespace(name="Dome cam", path="/dev/video0", index=0),
        SimpleNamespace(name="Desk cam", path="/dev/video2", index=2),
    ]
    package = SimpleNamespace(enumerate_cameras=lambda: listed)
    monkeypatch.setitem(sys.modules, "cv2_enumerate_cameras", package)
    assert CameraSensor.path_of("dome") == "/dev/video0"
    assert CameraSensor.path_of("3") == "3"
    with pytest.raises(SensorError, match=r"2 cameras have 'cam' .*'Dome cam'"):
        CameraSensor.path_of("cam")
    none = "No camera has 'hall' in the name"
    with pytest.raises(SensorError, match=none) as refused:
        CameraSensor.path_of("hall")
    there = "There are: 'Dome cam' (/dev/video0), 'Desk cam' (/dev/video2)."
    assert str(refused.value).endswith(there)
    with pytest.raises(SensorError, match="no camera at /dev/nowhere"):
        CameraSensor.path_of("/dev/nowhere")


def test_without_the_package_names_are_refused_and_paths_are_not(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "cv2_enumerate_cameras", None)
    with pytest.raises(ImportError, match=r'pip install "palpate\[camera\]"'):
        CameraSensor.path_of("dome")
    path = tmp_path / "video0"
    path.touch()
    assert CameraSensor.path_of(str(path)) == str(path)
