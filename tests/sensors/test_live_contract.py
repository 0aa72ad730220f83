"""The contract, on every sensor that needs no hardware, and on ones that break it."""

import time

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import Touches
from palpate.sensors import (
    ReplaySensor,
    SensorError,
    SimulatedStream,
    StreamingSensor,
    TouchSensor,
    check_sensor,
    open_sensor,
)


class Counting(StreamingSensor):
    """Gives frames that hold their own number; fails where it is told to."""

    def __init__(self, fails=(), period_s=0.001):
        super().__init__("counting", "count", (2, 3), np.int32)
        self.fails, self.period_s, self.at, self.opened = set(fails), period_s, 0, 0

    def _open(self):
        self.opened += 1

    def _grab(self):
        time.sleep(self.period_s)
        number, self.at = self.at, self.at + 1
        if number in self.fails:
            raise SensorError("the plug fell out")
        return [np.full((2, 3), number)]

    def _close(self):
        pass


def recording(n=6, shape=(4, 5)):
    images = np.arange(1, n + 1, dtype=np.uint8).reshape(-1, 1, 1) * 10
    images = images + np.zeros(shape, np.uint8)
    return Touches(images, object=["cup"] * (n // 2) + ["pen"] * (n - n // 2))


@pytest.mark.parametrize(
    "sensor",
    [
        Counting(),
        ReplaySensor(recording(), rate_hz=500),
        SimulatedStream("bar10", rate_hz=300),
        SimulatedStream("mug", (32, 32), rate_hz=200),
    ],
    ids=lambda sensor: sensor.name,
)
def test_the_contract_is_kept(sensor):
    check_sensor(sensor)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"unit": ""}, "unit must be a text"),
        ({"geometry": "ball"}, "geometry must be one of"),
        ({"connect": lambda self: None}, "must return the sensor"),
        ({"disconnect": lambda self: None}, "connected must be False"),
        ({"_put": lambda self, image: None}, "gave no frame"),
        ({"read_next": lambda self, t=2.0: self.read_latest(t)}, "numbers must rise"),
    ],
)
def test_a_broken_driver_is_told_what_it_breaks(change, message):
    broken = type("Broken", (Counting,), change)()
    if "unit" in change:
        broken.unit = ""
    with pytest.raises((AssertionError, SensorError), match=message):
        check_sensor(broken)
    StreamingSensor.disconnect(broken)


def test_frames_come_in_order_and_those_never_read_are_counted():
    with Counting() as sensor:
        time.sleep(0.1)
        first = sensor.read_next()
        assert first.number > 0  # two wait, the older ones were dropped
        assert sensor.n_dropped >= first.number
        assert_array_equal(first.image, np.full((2, 3), first.number))
        assert sensor.read_latest().number >= first.number
        assert sensor.n_frames >= first.number


def test_a_lost_device_is_found_again():
    sensor = Counting(fails={3, 4, 5})
    sensor.retry_s = 0.01
    with sensor:
        numbers = [sensor.read_next().image[0, 0] for _ in range(20)]
    assert {3, 4, 5}.isdisjoint(numbers)
    assert numbers[-1] > 5
    assert sensor.opened >= 4  # at first, and after each failure


def test_a_driver_that_fails_to_open_in_its_own_way_is_tried_again():
    class Clumsy(Counting):
        """Fails as drivers of others do: not by SensorError, not even to close."""

        def _open(self):
            super()._open()
            if self.opened in (2, 3):
                raise OSError("no such device")

        def _close(self):
            if self.opened == 2:
                raise RuntimeError("closed already")

    sensor = Clumsy(fails={3})
    sensor.retry_s = 0.01
    with sensor:
        numbers = [sensor.read_next().image[0, 0] for _ in range(20)]
        assert sensor.lost == ""
    assert numbers[-1] > 3
    assert sensor.opened == 4


def test_a_frame_that_is_none_is_an_error_of_the_device():
    class Odd(Counting):
        def _grab(self):
            (image,) = super()._grab()
            return ["nonsense"] if self.at == 3 else [image]

    sensor = Odd()
    sensor.retry_s = 0.01
    with sensor:
        assert sensor.read_next().image.shape == (2, 3)
        time.sleep(0.05)
        assert sensor.read_next().number > 3


def test_a_silent_device_says_why():
    sensor = Counting(fails=range(10_000))
    sensor.retry_s = 0.01
    with sensor, pytest.raises(SensorError, match="counting is lost: the plug fell"):
        sensor.read_next(0.1)
    with pytest.raises(SensorError, match="not connected; call connect"):
        sensor.read_latest()


def test_every_live_sensor_does_for_exploration():
    with Counting() as sensor:
        assert isinstance(sensor, TouchSensor)
        before = sensor.read_latest().number
        assert sensor.read()[0, 0] > before
        assert sensor.no_contact() is None


def test_a_replay_plays_what_was_recorded_between_frames_of_nothing():
    with ReplaySensor(recording(), rate_hz=1000, hold=2, gap=1) as sensor:
        levels = [int(sensor.read_next().image[0, 0]) for _ in range(12)]
    assert levels == [0, 10, 10, 0, 20, 20, 0, 30, 30, 0, 10, 10]
    assert sensor.objects == ("cup", "pen")


def test_what_lies_on_the_desk_can_be_changed():
    sensor = ReplaySensor(recording(), rate_hz=500, hold=1, gap=0)
    sensor.place("pen")
    with sensor:
        levels = {int(sensor.read_next().image[0, 0]) for _ in range(30)}
        assert levels <= {0, 40, 50, 60}
        sensor.place(None)
        time.sleep(0.3)
        assert not sensor.read().any()
    with pytest.raises(ValueError, match="name must be one of 'cup', 'pen', got 'hat'"):
        sensor.place("hat")


def test_a_replay_keeps_its_rate():
    with ReplaySensor(recording(), rate_hz=200) as sensor:
        first = sensor.read_next()
        later = [sensor.read_next() for _ in range(60)][-1]
    rate = (later.number - first.number) / (later.time_s - first.time_s)
    # Frames are due at fixed times; half is room for a machine busy with others.
    assert 100 < rate < 260


def test_simulated_touches_are_touches_of_what_lies_there():
    with SimulatedStream("disc13", rate_hz=200, hold=4, gap=4, ramp=2) as sensor:
        peaks = [int(sensor.read_next().image.max()) for _ in range(120)]
    assert max(peaks) > 30  # pressed
    assert min(peaks) <= 3  # and released: noise of half a level, six sd


def test_sensors_by_name(tmp_path):
    recording().save(tmp_path / "touches.npz")
    replay = open_sensor(f"replay:{tmp_path / 'touches.npz'}", rate_hz=50, hold=3)
    assert replay.image_shape == (4, 5)
    assert replay.rate_hz == 50
    assert open_sensor("sim:mug", image_shape=(32, 32)).image_shape == (32, 32)
    array = open_sensor("serial:/dev/nowhere", image_shape=(16, 8), baud=9600)
    assert (array.image_shape, array.baud) == ((16, 8), 9600)
    assert open_sensor("camera:0").image_shape == (480, 640)


def test_a_shape_that_the_sensor_does_not_have_is_refused(tmp_path):
    path = tmp_path / "touches.npz"
    recording().save(path)
    assert open_sensor(f"replay:{path}", image_shape=(4, 5)).image_shape == (4, 5)
    for spec, fixed in ((f"replay:{path}", "4 x 5"), ("sim:bar10", "10 x 10")):
        with pytest.raises(ValueError, match=f"{fixed}, got 8 x 8.*--shape"):
            open_sensor(spec, image_shape=(8, 8))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("mug", "camera:NAME, serial:PORT, replay:PATH or sim:OBJECT, got 'mug'"),
        ("sim:", "must be camera:NAME"),
        ("sim:unicorn", "name must be one of .*'mug'"),
        ("serial:/dev/ttyUSB0", "--shape 16x16"),
    ],
)
def test_a_text_that_names_no_sensor_is_refused(spec, message):
    with pytest.raises(ValueError, match=message):
        open_sensor(spec)


def test_a_recording_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SensorError, match="cannot be replayed"):
        open_sensor(f"replay:{tmp_path / 'none.npz'}")


@pytest.mark.realdata
def test_real_pictures_are_replayed_as_the_camera_wrote_them(data_folder):
    folder = data_folder / "bathtip" / "originals" / "07_mug"
    rest = data_folder / "bathtip" / "originals" / "baselineForCalibration.jpg"
    sensor = ReplaySensor(folder, rate_hz=200, hold=1, gap=1, no_contact=rest)
    check_sensor(sensor)
    assert sensor.image_shape == (480, 640)
    assert sensor.no_contact().shape == (480, 640)
