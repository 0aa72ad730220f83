"""The contract of sensors: those without hardware keep it, and broken ones do not."""

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from types import SimpleNamespace
from urllib.parse import quote

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from palpate import Touches
from palpate.cli.sensor import SensorOptions
from palpate.sensors import (
    AddressError,
    Frame,
    LiveSensor,
    Reading,
    ReplaySensor,
    SensorError,
    TouchDetector,
    channels_of,
    check_sensor,
    open_sensor,
)


class Counting(LiveSensor):
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
        open_sensor("sim:bar10", rate_hz=300),
        open_sensor("sim:mug", image_shape=(32, 32), rate_hz=200),
        open_sensor("sim:gel", image_shape=(32, 48), rate_hz=200),
    ],
    ids=lambda sensor: sensor.name,
)
def test_every_sensor_without_hardware_keeps_the_contract(sensor):
    check_sensor(sensor)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"unit": ""}, "unit must be a text"),
        ({"image_shape": (2, 0)}, "two or three positive integers"),
        ({"image_shape": (2, 3, 2)}, "channels must name each channel"),
        ({"geometry": "ball"}, "geometry must be one of"),
        ({"connect": lambda self: None}, "must return the sensor"),
        ({"disconnect": lambda self: None}, "connected must be False"),
        (
            {
                "_put": lambda self, reading, room: None,
                "read_next": lambda self, t=0.1: LiveSensor.read_next(self, t),
            },
            "gave no frame in 0.1 s",
        ),
        ({"read_next": lambda self, t=2.0: self.read_latest(t)}, "numbers must rise"),
        (
            {"_grab": lambda self: [Reading(i, 3.0) for i in Counting._grab(self)]},
            r"time_s must be of now, got \d+.\d s ago",
        ),
        (
            {"_grab": lambda self: [Reading(i, np.nan) for i in Counting._grab(self)]},
            "time_s must be of now, got nan s ago",
        ),
    ],
)
def test_the_check_says_what_a_driver_breaks(change, message):
    broken = type("Broken", (Counting,), change)()
    for name in {"unit", "geometry", "image_shape"} & set(change):
        setattr(broken, name, change[name])
    with pytest.raises((AssertionError, SensorError), match=message):
        check_sensor(broken)
    LiveSensor.disconnect(broken)


def test_the_check_asks_for_a_frame():
    with pytest.raises(ValueError, match="n_frames must be at least 1, got 0"):
        check_sensor(Counting(), n_frames=0)


def test_frames_come_in_order_and_those_never_read_are_counted():
    with Counting() as sensor:
        time.sleep(0.1)
        first = sensor.read_next()
        assert first.number > 0  # two wait, the older ones were dropped
        assert sensor.n_dropped >= first.number
        assert_array_equal(first.image, np.full((2, 3), first.number))
        assert sensor.read_latest().number >= first.number
        assert sensor.n_frames >= first.number


def test_a_sensor_can_be_disconnected_while_it_connects():
    class Slow(Counting):
        closed = 0

        def _open(self):
            opening.set()
            self._stop.wait(5.0)  # as a topic is waited for
            super()._open()

        def _close(self):
            self.closed += 1

    opening, sensor = Event(), Slow()
    with ThreadPoolExecutor(1) as pool:
        connecting = pool.submit(sensor.connect)
        assert opening.wait(5.0)
        sensor.disconnect()
        with pytest.raises(SensorError, match="was disconnected"):
            connecting.result(timeout=2.0)
    assert not sensor.connected
    assert sensor.closed == 1


def test_a_sensor_that_two_threads_connect_is_opened_once():
    class Slow(Counting):
        def _open(self):
            super()._open()
            opening.set()
            self._stop.wait(0.2)

    opening, sensor = Event(), Slow()
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(sensor.connect)
        assert opening.wait(5.0)
        assert pool.submit(sensor.connect).result(5.0) is first.result(5.0) is sensor
    assert sensor.opened == 1
    sensor.disconnect()


def test_a_lost_device_is_found_again():
    sensor = Counting(fails={3, 4, 5})
    sensor.retry_s = 0.01
    with sensor:
        numbers = [sensor.read_next().image[0, 0] for _ in range(20)]
        assert sensor.n_dropped >= 3  # at least one for each failure
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


def test_a_vendor_error_of_its_own_kind_is_an_error_of_the_sensor():
    class VendorError(Exception):
        pass

    class Refusing(Counting):
        closed = 0

        def _open(self):
            raise VendorError("code 17")

        def _close(self):
            self.closed += 1

    sensor = Refusing()
    with pytest.raises(SensorError, match=r"counting cannot be opened.*code 17"):
        check_sensor(sensor)
    assert sensor.closed == 1
    assert not sensor.connected


def test_a_device_that_comes_back_in_another_size_is_lost():
    class Resized(Counting):
        def _open(self):
            super()._open()
            if self.opened > 1:
                self.image_shape, self.dtype = (4, 5), np.dtype(np.int64)

        def _grab(self):
            frames = super()._grab()
            return frames if self.opened == 1 else [np.zeros((4, 5), np.int64)]

    sensor = Resized(fails={3})
    sensor.retry_s = 0.01
    with sensor:
        with pytest.raises(SensorError, match=r"are \(4, 5\), it promised \(2, 3\)"):
            [sensor.read_next(0.5) for _ in range(9)]
        assert (sensor.image_shape, sensor.dtype) == ((2, 3), np.int32)


@pytest.mark.parametrize("method", ["_grab", "_open"])
def test_a_driver_that_wants_to_end_the_program_is_lost_and_tried_again(method):
    class Ending(Counting):
        ends, queue_length = 0, 99  # a reader that is late loses no frame

        def _ended(self, name):
            if name == method and self.at >= 3 and not self.ends:
                self.ends += 1
                raise SystemExit("vendor")

        def _open(self):
            self._ended("_open")
            super()._open()

        def _grab(self):
            self._ended("_grab")
            return super()._grab()

    sensor = Ending(fails=(3,), period_s=0.01)
    sensor.retry_s = 0.05
    with sensor:
        numbers = [int(sensor.read_next().image[0, 0]) for _ in range(6)]
    assert sensor.ends == 1
    assert numbers == [0, 1, 2, 4, 5, 6]


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
    sensor.retry_s = 60.0  # it stays lost while it is asked
    with sensor, pytest.raises(SensorError, match="counting is lost: the plug fell"):
        sensor.read_next(0.5)
    with pytest.raises(SensorError, match="not connected; call connect"):
        sensor.read_latest()


def test_a_device_whose_clock_stands_still_gives_no_fresh_frame_and_says_so():
    class Standing(Counting):
        stands_s = -100.0

        def _grab(self):
            return [Reading(image, time_s=self.stands_s) for image in super()._grab()]

    # A clock of its own: all touches would have begun before they were asked for.
    with Standing() as sensor, pytest.raises(SensorError, match=r"or use time\.mono"):
        sensor.read_next(0.2)
    Standing.stands_s = time.monotonic()
    # As long as a touch waits, an arm may press.
    with Standing() as sensor, ThreadPoolExecutor(1) as pool:
        reading = pool.submit(sensor.read)
        try:
            with pytest.raises(SensorError, match=r"as they are taken.*time_s"):
                reading.result(timeout=5.0)
        finally:
            sensor.disconnect()


def test_a_replay_plays_what_was_recorded_between_frames_of_nothing():
    with ReplaySensor(recording(), rate_hz=1000, hold=2, gap=1) as sensor:
        levels = [int(sensor.read_next().image[0, 0]) for _ in range(12)]
    assert levels == [0, 10, 10, 0, 20, 20, 0, 30, 30, 0, 10, 10]
    assert sensor.objects == ("cup", "pen")


def test_the_rest_of_a_replay_is_rounded_to_the_numbers_of_its_images():
    def rest(level):
        no_contact = np.full((4, 5), level)
        return ReplaySensor(
            recording().with_columns(no_contact=no_contact)
        ).no_contact()

    assert (rest(99.9) == 100).all()
    for level in (300.0, -1.0, np.nan):
        with pytest.raises(SensorError, match=r"no_contact must hold 0 to 255, .* got"):
            rest(level)


@pytest.mark.parametrize("shape", [(16,), (2, 3, 4, 5)])
def test_images_have_rows_columns_and_perhaps_channels(shape):
    with pytest.raises(ValueError, match="image_shape must be two or three positive"):
        LiveSensor.__init__(Counting(), "odd", "count", shape, np.uint8)


def test_the_object_before_a_replay_can_be_changed():
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


@pytest.mark.parametrize("kind", ["gel", "dome", "array"])
def test_nothing_can_lie_before_a_simulated_sensor(kind):
    sensor = open_sensor(f"sim:{kind}?place=nothing")
    assert sensor.placed is None
    with pytest.raises(ValueError, match="got 'nothin'"):
        open_sensor(f"sim:{kind}?place=nothin")


def test_simulated_touches_are_touches_of_what_lies_there():
    options = {"rate_hz": 200, "hold": 4, "gap": 4, "ramp": 2}
    with open_sensor("sim:disc13", **options) as sensor:
        peaks = [int(sensor.read_next().image.max()) for _ in range(120)]
    assert max(peaks) > 30  # pressed
    assert min(peaks) <= 3  # and released: noise of half a level, six sd


@pytest.mark.parametrize(
    ("address", "settings"),
    [
        ("sim:gel?place=pen", {"image_shape": (120, 160, 3), "placed": "pen"}),
        ("sim:dome", {"placed": "mug"}),
        ("sim:array", {"image_shape": (10, 10)}),
        # Without options `?` may end an address, and options may be none.
        ("sim:bar10?", {"image_shape": (10, 10)}),
        ("camera:0", {"image_shape": (480, 640)}),
        ("camera:USB Camera?rate=15", {"camera": "USB Camera", "rate_hz": 15}),
        ("camera:0?shape=24x32&exposure=3", {"kept": {"exposure": 3}}),
        ("camera:0?shape=24x32&colour=1", {"image_shape": (24, 32, 3)}),
        ("camera:0?shape=24x32&colour=yes", {"image_shape": (24, 32, 3)}),
        ("camera:0?shape=24x32&colour=0", {"image_shape": (24, 32)}),
        ("serial:/dev/x?shape=16x8", {"port": "/dev/x", "image_shape": (16, 8)}),
        ("serial:x?shape=9x9&baud=9600&unit=kPa", {"baud": 9600, "unit": "kPa"}),
        ("serial:x?shape=9x9&framing=binary&dtype=int16", {"framing": "binary"}),
        ("serial:x?shape=9x9&framing=binary&dtype=int16", {"dtype": np.int16}),
        ("serial:x?shape=9x9&checksum=no", {"checksum": False}),
        ("replay:t.npz?rate=50", {"image_shape": (4, 5), "rate_hz": 50}),
        ("replay:t.npz?place=pen&shape=4x5", {"placed": "pen"}),
    ],
)
def test_an_address_says_what_is_to_be_set(tmp_path, monkeypatch, address, settings):
    monkeypatch.chdir(tmp_path)
    recording().save("t.npz")
    sensor = open_sensor(address)
    assert {name: getattr(sensor, name) for name in settings} == settings


def test_a_shape_that_the_sensor_does_not_have_is_refused(tmp_path):
    path = tmp_path / "touches.npz"
    recording().save(path)
    for spec, fixed in ((f"replay:{path}", "4 x 5"), ("sim:bar10", "10 x 10")):
        with pytest.raises(ValueError, match=f"{fixed}, got 8 x 8.*`shape`"):
            open_sensor(spec, image_shape=(8, 8))


def test_an_address_reaches_the_frames(tmp_path):
    recording().save(tmp_path / "touches.npz")
    address = f"replay:{tmp_path}/touches.npz?rate=1000&hold=2&gap=1"
    with open_sensor(address) as sensor:
        levels = [int(sensor.read_next().image[0, 0]) for _ in range(5)]
    assert levels == [0, 10, 10, 0, 20]
    images = []
    for seed in (1, 1, 2):
        # So slow that the first frame is there until it is read.
        with open_sensor(f"sim:mug?shape=24x24&seed={seed}&rate=5") as sensor:
            images.append(sensor.read_next().image)
    assert_array_equal(images[0], images[1])
    assert not np.array_equal(images[0], images[2])


def test_values_may_be_percent_encoded(tmp_path):
    pattern = r"(?P<object>\w+)&(?P<order>\d+)"
    for number, name in enumerate(("cup&0", "cup&1", "pen&0")):
        picture = Image.fromarray(np.full((4, 5), 40 * number + 40, np.uint8))
        picture.save(tmp_path / f"{name}.png")
    for written in (quote(pattern), pattern.replace("&", "%26")):
        sensor = open_sensor(f"replay:{tmp_path}?name-pattern={written}&place=pen")
        assert sensor.objects == ("cup", "pen")
    assert open_sensor("camera:what%3F?rate=9").camera == "what?"
    # A name is a path, and paths of downloads hold percent signs.
    assert open_sensor("camera:/dev/my%20camera").camera == "/dev/my%20camera"


def test_an_option_beside_the_address_must_agree_with_it():
    for shape in ("16x8", (16, 8)):
        array = open_sensor("serial:/dev/x?shape=16x8", baud=9600, image_shape=shape)
        assert (array.image_shape, array.baud) == ((16, 8), 9600)
    assert open_sensor("sim:mug", image_shape=(32, 32)).image_shape == (32, 32)
    assert open_sensor("camera:0?rate=15", rate_hz=15).rate_hz == 15
    assert open_sensor("camera:0?colour=1", colour=True).unit == "colour level"
    for options, message in (
        ({"image_shape": (8, 8)}, "shape=16x8 in .* and `shape=8x8` contradict"),
        ({"checksum": True}, "checksum=no in .* and `checksum=yes` contradict"),
    ):
        with pytest.raises(ValueError, match=message):
            open_sensor("serial:/dev/x?shape=16x8&checksum=no", **options)


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("mug", "serial:PORT, ros:TOPIC, replay:PATH or sim:OBJECT.*, got 'mug'"),
        ("mug?rate=3", "must be camera:NAME"),
        ("sim:", "must be camera:NAME"),
        ("sim:?rate=3", "must be camera:NAME"),
        ("sim:unicorn", "sim:OBJECT must be one of .*'mug'"),
        ("sim:mug?place=unicorn", "^place must be one of .*'mug', .*'nothing', got"),
        ("serial:/dev/ttyUSB0", "`shape=16x16`"),
        ("camera:0?baud=9", "'baud' is no option .* are shape, rate, exposure"),
        ("camera:0?image_shape=4x4", "'image_shape' is no option"),
        ("camera:0?=4", "'' is no option"),
        ("camera:0?rate=3&rate=4", "rate must be given once.*shape, rate, exposure"),
        ("camera:0?rate=3&rate=3", "rate must be given once"),
        ("camera:0?rate", "rate must be a number .*, got ''.* shape, rate"),
        ("camera:0?rate=fast", "got 'fast' .*are shape, rate, exposure"),
        ("camera:0?rate=nan", "rate_hz must be positive and finite, got nan"),
        ("camera:0?rate=-1", "rate_hz must be positive and finite, got -1"),
        ("camera:0?colour=red", "colour must be 1 or 0 or yes or no, got 'red'"),
        ("camera:0?shape=big", "shape must be rows x columns such as 16x16, got 'big'"),
        ("camera:0?shape=0x9", "n_rows must be at least 1, got 0"),
        ("serial:x?shape=4x4&framing=post", "framing must be line or binary"),
        ("serial:x?shape=4x4&checksum=1", "checksum must be yes or no, got '1'"),
        ("serial:x?shape=4x4&dtype=O", "uint8 or uint16 or int16 or float32, got 'O'"),
        ("serial:x?shape=4x4&baud=9.6", "baud must be a whole number"),
        ("sim:mug?hold=0", "hold must be at least 1, got 0"),
        ("sim:mug?seed=%20", "seed must be a whole number, got ' '"),
    ],
)
def test_an_address_that_is_none_is_refused_in_one_sentence(address, message):
    with pytest.raises(AddressError, match=message):
        open_sensor(address)


@pytest.mark.parametrize(
    ("address", "option"),
    [
        ("sim:mug", {"baud": 9600}),
        ("sim:mug", {"colour": True}),
        ("serial:x?shape=4x4", {"rate_hz": 30}),
        ("camera:0", {"place": "mug"}),
        ("camera:0", {"hold": 3}),
    ],
)
def test_an_option_of_another_kind_of_sensor_is_refused(address, option):
    kind = address.partition(":")[0]
    with pytest.raises(ValueError, match=f"must be left out: a {kind} sensor has none"):
        open_sensor(address, **option)


def test_a_recording_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SensorError, match="cannot be replayed"):
        open_sensor(f"replay:{tmp_path / 'none.npz'}")


def pictures_of(n_quiet, rng):
    """Pictures of 60 x 80, two things, bright somewhere; some of them of nothing."""
    rest = np.full((60, 80), 90.0)
    touches = [rest.copy() for _ in range(24)]
    for number, image in enumerate(touches):
        row, col = rng.integers(0, 40, 2)
        image[row : row + 20, col : col + 20] += 80 * (number >= n_quiet)
    order = rng.permutation(24)
    noisy = np.stack(touches)[order] + rng.normal(scale=2, size=(24, 60, 80))
    names = np.array(["cup", "pen"])[rng.permutation(24) % 2]
    return Touches(np.rint(noisy).astype(np.uint8), object=names)


@pytest.mark.parametrize("n_quiet", [8, 20])
def test_rest_is_taken_from_quiet_pictures_of_a_recording(rng, n_quiet):
    sensor = ReplaySensor(pictures_of(n_quiet, rng))
    # The mean of 8 pictures with a noise of 2 has one of 0.7; rounding adds 0.3.
    assert abs(sensor.no_contact().astype(float) - 90).mean() < 1


def test_a_recording_of_touches_alone_asks_for_a_picture_of_nothing(tmp_path, rng):
    touches = pictures_of(0, rng)
    with pytest.raises(SensorError, match=r"touches alone. Give .* as `no_contact`.$"):
        ReplaySensor(touches)
    assert ReplaySensor(touches, gap=0).no_contact() is None  # as they are
    touches.save(tmp_path / "touches.npz")
    rest = np.full((60, 80), 90, np.uint8)
    Image.fromarray(rest).save(tmp_path / "rest.png")
    address = f"replay:{tmp_path}/touches.npz"
    for sensor in (
        open_sensor(f"{address}?no-contact={tmp_path}/rest.png"),
        ReplaySensor(touches, no_contact=tmp_path / "rest.png"),
    ):
        assert_array_equal(sensor.no_contact(), rest)
    with pytest.raises(SensorError, match=r"cannot be replayed: .*none\.png"):
        ReplaySensor(touches, no_contact=tmp_path / "none.png")
    with pytest.raises(SensorError, match="as `no_contact`"):
        SensorOptions().open(address)


@pytest.mark.realdata
def test_real_pictures_are_replayed_as_the_camera_wrote_them(data_folder):
    folder = data_folder / "bathtip" / "originals" / "07_mug"
    rest = data_folder / "bathtip" / "originals" / "baselineForCalibration.jpg"
    sensor = ReplaySensor(folder, rate_hz=200, hold=1, gap=1, no_contact=rest)
    check_sensor(sensor)
    assert sensor.image_shape == (480, 640)
    assert sensor.no_contact().shape == (480, 640)


@pytest.mark.parametrize("names", ["rgb", "bgr", "xyz", "abcdef"])
def test_touches_with_channels_are_replayed_with_them(tmp_path, names):
    images = np.arange(2 * 4 * 4 * len(names), dtype=np.uint8) + 1
    recorded = Touches(images.reshape(2, 4, 4, -1), channels=[*names])
    recorded.save(tmp_path / "touches.npz")
    address = f"replay:{tmp_path}/touches.npz?rate=200&hold=1&gap=1"
    check_sensor(open_sensor(address))
    sensor = open_sensor(address)
    assert sensor.channels == tuple(names)
    assert sensor.image_shape == (4, 4, len(names))
    with sensor:
        frames = [sensor.read_next().image for _ in range(4)]
    assert_array_equal(frames[0], np.zeros_like(frames[0]))
    assert_array_equal(frames[1::2], recorded.images)


class Bursting(Counting):
    """Gives many frames at once, each with its time, and a temperature beside them."""

    burst = 20
    n_read = None  # where it waits for who reads, as many as were read

    def _grab(self):
        time.sleep(0.02)
        deadline = time.monotonic() + 5
        while self.n_read is not None and self.n_read < self.at:
            assert time.monotonic() < deadline
            time.sleep(0.001)
        now_s = time.monotonic()
        start, self.at = self.at, self.at + self.burst
        return [
            Reading(
                np.full((2, 3), number),
                now_s - (start + self.burst - number) / 1000,
                device_time_s=float(number),
                columns={"temperature_c": 20.0 + number},
            )
            for number in range(start, start + self.burst)
        ]


def test_a_burst_is_kept_whole_with_the_time_of_each_frame():
    frames, sensor = [], Bursting()
    sensor.n_read = 0
    with sensor:
        while len(frames) < 200:
            frames.append(sensor.read_next())
            sensor.n_read = len(frames)
    assert [f.number for f in frames] == list(range(200))
    assert [int(f.image[0, 0]) for f in frames] == list(range(200))
    assert [f.device_time_s for f in frames] == list(range(200))
    assert frames[7].columns == {"temperature_c": 27.0}
    steps = np.diff([f.time_s for f in frames[:20]])
    np.testing.assert_allclose(steps, 1e-3, atol=1e-6)


def test_a_burst_over_the_bound_is_counted_and_the_check_says_so():
    sensor = Bursting()
    sensor.burst = sensor.burst_length + 44
    sensor.n_read = 0  # the next burst waits, on a slow machine too
    with sensor:
        assert sensor.read_next().number == 44
        assert sensor.n_dropped >= 44
        sensor.n_read = None
    with pytest.raises(AssertionError, match="300 frames at once, of which 256"):
        check_sensor(sensor)


def test_columns_of_a_device_beside_its_frames_reach_the_touch():
    detector = TouchDetector(np.zeros((2, 3)), begin=1.0)
    touch = None
    for number, level in enumerate([0, 5, 9, 4, 0]):
        device_values = float(number), {"force_n": float(level)}
        frame = Frame(
            np.full((2, 3), float(level)), number / 10, number, *device_values
        )
        touch = detector.update(frame) or touch
    assert (touch.device_time_s, touch.columns) == (2.0, {"force_n": 9.0})


class Doubling:
    image_shape_ = (2, 3)

    def transform(self, images):
        return 2.0 * np.asarray(images)


def test_a_calibrated_sensor_gives_frames_in_its_unit(tmp_path, monkeypatch):
    """Sensors are those of a driver that a package offers."""
    offered = tmp_path / "toy-1.dist-info" / "entry_points.txt"
    offered.parent.mkdir()
    offered.write_text("[palpate.sensors]\ntoy = toy:driver\n")
    monkeypatch.syspath_prepend(tmp_path)

    def calibrated(sensor):
        package = SimpleNamespace(driver=lambda place: sensor)
        monkeypatch.setitem(sys.modules, "toy", package)
        return open_sensor("toy:0", calibration=Doubling())

    class Whole(Counting):
        step = 1.0  # of its numbers: nothing smaller is a touch

    with calibrated(Whole()) as sensor:
        sensor.read_next()
        assert sensor.step == 2.0

    check_sensor(calibrated(Counting()))
    with calibrated(Bursting()) as sensor:
        frames = [sensor.read_next() for _ in range(30)]
    assert sensor.unit == "kPa"
    for frame in frames:
        assert frame.image[0, 0] == 2 * frame.device_time_s
    with pytest.raises(ValueError, match="calibration is of 2 x 3 taxels"):
        calibrated(ReplaySensor(recording()))


@pytest.mark.parametrize(
    ("shape", "names"),
    [
        ((4, 4), None),
        ((4, 4, 3), ("r", "g", "b")),
        ((4, 4, 2), ("0", "1")),
        ((3, 3, 4), ("0", "1", "2", "3")),
    ],
)
def test_three_channels_are_colours_and_others_are_numbered(shape, names):
    assert channels_of(shape) == names


def test_a_driver_may_read_into_the_same_memory_again():
    class Buffered(Counting):
        buffer = np.zeros((4, 3), np.int32)

        def _grab(self):
            self.buffer[:] = super()._grab()[0][0, 0]
            return [self.buffer[:2]]

    with Buffered(period_s=0.02) as sensor:
        frames = [sensor.read_next() for _ in range(3)]
        sensor.read()
    assert [frame.image[0, 0] for frame in frames] == [0, 1, 2]


@pytest.mark.parametrize(
    ("level", "dtype", "message"),
    [
        (300, np.uint8, "hold 300 to 300, which its dtype uint8 cannot"),
        (-1, np.uint8, "hold -1 to -1, which"),
        (np.nan, np.uint8, "hold nan to nan, which"),
        (0.7, np.uint16, "hold 0.7, which its dtype uint16 cannot"),
        (np.inf, np.float32, "hold infinity; NaN marks a dead taxel"),
    ],
)
def test_a_frame_that_its_type_cannot_hold_is_refused(level, dtype, message):
    class Wide(Counting):
        def _grab(self):
            super()._grab()
            return [np.full((2, 3), level)]

    sensor = Wide()
    sensor.dtype = np.dtype(dtype)
    with sensor, pytest.raises(SensorError, match=message):
        sensor.read_next(0.2)
    assert sensor.n_frames == 0
    assert sensor.n_dropped > 0
