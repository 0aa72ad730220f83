"""Topics of ROS 2 over real DDS: the publisher is another process with own types."""

import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ros_network import NUMBER, variables

from palpate.sensors import SensorError, check_sensor, open_sensor, ros

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

KIND = "sensor_msgs/msg/Image"
PEER = Path(__file__).with_name("ros_peer.py")
DOMAIN = 50 + NUMBER


@pytest.fixture(autouse=True)
def network(monkeypatch):
    for name, value in variables().items():
        monkeypatch.setenv(name, value)


@contextmanager
def peer(topic, what="best_effort"):
    command = [sys.executable, str(PEER), topic, what, str(DOMAIN)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE)
    try:
        yield process
    finally:
        process.stdin.close()
        process.wait(timeout=20)


def address(topic, more=""):
    return f"ros:{topic}?domain={DOMAIN}{more}"


def all_frames(sensor):
    """Return the frames until none comes, and the sentence that says so."""
    frames = []
    try:
        while True:
            frames.append(sensor.read_next(0.7))
    except SensorError as error:
        return frames, str(error)


@pytest.mark.parametrize("what", ["best_effort", "reliable"])
def test_frames_are_those_that_were_sent_with_their_stamps(what):
    with peer(f"/t_{what}", what):
        sensor = open_sensor(address(f"/t_{what}"))
        assert sensor.image_shape == (12, 12)
        assert sensor.dtype == np.uint8
        with sensor:
            frames = [sensor.read_next() for _ in range(40)]
    numbers = [frame.device_time_s - 1000.5 for frame in frames]
    assert numbers == list(np.arange(numbers[0], numbers[0] + 40))
    assert all(np.ptp(frame.image) == 0 for frame in frames)
    # On a slow machine the 250th frame is sent before the first is read.
    assert [int(frame.image[0, 0]) for frame in frames] == [n % 250 for n in numbers]


def test_no_frame_is_lost_that_comes_together_with_the_first():
    with peer("/t_burst", "burst"):
        sensor = open_sensor(address("/t_burst"))
        for _ in range(4):
            with sensor:
                times = [sensor.read_next().device_time_s for _ in range(7)]
            assert np.array_equal(np.diff(times), np.ones(6))


def test_a_ros_sensor_keeps_the_contract():
    with peer("/t_contract"):
        check_sensor(open_sensor(address("/t_contract", "&shape=12x12")))


def test_arrays_are_frames_too():
    with peer("/t_array", "array"), open_sensor(address("/t_array")) as sensor:
        frame = sensor.read_next().image
    assert frame.shape == (3, 2)
    assert frame.dtype == np.float32
    assert frame[0, 0] % 1 == 0.5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("&qos=reliable", r"does not match, by its reliability.*qos"),
        ("&shape=9x12", "gives frames of 12 x 12, shape asks for 9 x"),
    ],
)
def test_what_is_asked_for_and_not_offered_is_refused(options, message):
    with peer("/t_other"), pytest.raises(SensorError, match=message):
        open_sensor(address("/t_other", options)).connect()


def test_a_topic_that_is_no_image_and_one_of_nobody_are_refused():
    with peer("/t_text", "string"):
        with pytest.raises(SensorError, match=r"got std_msgs/msg/String"):
            open_sensor(address("/t_text"))
        missing = "Nobody publishes /t_txt in domain .*topics seen: .*/t_text"
        with pytest.raises(SensorError, match=missing):
            open_sensor(address("/t_txt", "&wait=1"))


def test_a_topic_that_changes_its_size_gives_no_wrong_frame():
    with peer("/t_resize", "resize"), open_sensor(address("/t_resize")) as sensor:
        frames, why = all_frames(sensor)
        assert "gives frames of 8 x 8 of uint8 now" in why
        assert {frame.image.shape for frame in frames} == {(12, 12)}
        assert max(int(frame.image[0, 0]) for frame in frames) == 19
        assert sensor.n_dropped > 10


def test_messages_that_lie_are_counted_and_never_become_frames():
    with peer("/t_hostile", "hostile"), open_sensor(address("/t_hostile")) as sensor:
        frames = [sensor.read_next() for _ in range(20)]
        dropped = sensor.n_dropped
    assert all(int(frame.image[0, 0]) % 4 == 0 for frame in frames)
    assert all(np.ptp(frame.image) == 0 for frame in frames)
    assert dropped >= 19 * 3


def test_damaged_bytes_are_no_frame_whatever_they_are():
    whole = ros.write_message(rosbags_picture(), KIND)
    sensor = open_sensor(address("/t_bytes", "&shape=12x12"))
    sensor._reader = SimpleNamespace(kind=KIND)
    rng = np.random.default_rng(0)
    assert (sensor._frame(whole).image == 7).all()
    for number in range(600):
        raw = bytearray(whole)
        at = rng.integers(4, 60, size=3)  # the header and every length
        raw[at[0]] = raw[at[1]] = raw[at[2]] = 255
        cut = len(raw) if number % 2 else int(rng.integers(0, len(raw)))
        reading = sensor._frame(bytes(raw[:cut]))
        assert reading is None or reading.image.size <= 12 * 12
    for size in (0, 3, 4, 64):
        assert sensor._frame(rng.bytes(size)) is None
    assert sensor.n_dropped > 300


def rosbags_picture():
    types = ros.store().types
    stamp = types["builtin_interfaces/msg/Time"](3, 0)
    header = types["std_msgs/msg/Header"](stamp, "pad")
    return types[KIND](header, 12, 12, "mono8", 0, 12, np.full(144, 7, np.uint8))


def test_a_publisher_that_is_killed_is_heard_again_when_it_is_back():
    with peer("/t_back") as first, open_sensor(address("/t_back")) as sensor:
        sensor.read_next()
        first.kill()
        first.wait()
        all_frames(sensor)
        with peer("/t_back"):
            end_s = time.monotonic() + 20
            while time.monotonic() < end_s and not sensor._queue:
                time.sleep(0.05)
            assert sensor.read_next().image.shape == (12, 12)
        assert sensor.connected
