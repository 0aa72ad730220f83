"""Drivers on recorded bytes and played cameras, entry points, and false drivers."""

import importlib.metadata
import json
import socket
import threading
import time

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import sensors
from palpate.sensors import SensorError, check_sensor, is_address, open_sensor

cv2 = pytest.importorskip("cv2")
cameras = pytest.importorskip("palpate_drivers.cameras")
fingers = pytest.importorskip("palpate_drivers.fingers")
network = pytest.importorskip("palpate_drivers.network")
serials = pytest.importorskip("palpate_drivers.serials")


class Camera:
    """Stands for `cv2.VideoCapture`: one picture, over and over; keeps its settings."""

    def __init__(self, picture):
        self.picture, self.settings = picture, {}

    def isOpened(self):
        return True

    def set(self, number, value):
        self.settings[number] = value
        return True

    def get(self, number):
        return self.settings.get(number, 0.0)

    def read(self):
        time.sleep(0.005)
        return True, self.picture

    def release(self):
        pass


class Port:
    """Stands for `serial.Serial`: bytes over and over, some at a time."""

    def __init__(self, data, at_once=53):
        self.data, self.at, self.at_once, self.in_waiting = data, 0, at_once, at_once

    def read(self, n):
        time.sleep(0.001)
        start, self.at = self.at, self.at + self.at_once
        return bytes(self.data[i % len(self.data)] for i in range(start, self.at))

    def close(self):
        pass


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_a_digit_stands_upright_and_has_its_light_set(rng):
    picture = rng.integers(0, 256, (240, 320, 3), dtype=np.uint8)
    camera = Camera(picture)
    sensor = cameras.digit("DIGIT", light=7, open_capture=lambda name: camera)
    check_sensor(sensor)
    with sensor:
        image = sensor.read_next().image
    assert_array_equal(image[..., ::-1], np.rot90(picture))  # red first, blue was
    assert camera.settings[cv2.CAP_PROP_ZOOM] == 7
    assert camera.settings[cv2.CAP_PROP_FRAME_WIDTH] == 320
    assert camera.settings[cv2.CAP_PROP_FRAME_HEIGHT] == 240
    mirrored = cameras.digit("DIGIT", mirror=True, open_capture=lambda name: camera)
    with mirrored:
        assert_array_equal(mirrored.read_next().image, image[:, ::-1])


def test_a_gelsight_mini_loses_its_border():
    picture = np.zeros((2464, 3280, 3), np.uint8)
    picture[352:-352, 468:-468] = 100  # a seventh of each side
    sensor = cameras.gelsight_mini("Mini", open_capture=lambda name: Camera(picture))
    with sensor:
        image = sensor.read_next().image
    assert image.shape == (240, 320, 3)
    assert (image == 100).all()
    with pytest.raises(ValueError, match=r"share below 0\.5, got 0\.7"):
        cameras.gelsight_mini("Mini", border=0.7)


def test_a_camera_of_another_size_is_refused_by_its_size():
    small = np.zeros((48, 64, 3), np.uint8)
    sensor = cameras.digit("DIGIT", open_capture=lambda name: Camera(small))
    with pytest.raises(SensorError, match=r"must give 320 rows x 240 .* got 48 x 64"):
        sensor.connect()


def skin_bytes(rng, n=20, n_magnets=5):
    values = rng.normal(scale=300, size=(n, n_magnets, 4)).astype("<f4")
    return values, b"".join(frame.tobytes() + b"\r\n" for frame in values)


def taxel_bytes(rng, n=20):
    """Return taxels that also hold the two bytes that begin a frame."""
    frames = rng.integers(0, 256, (n, 12, 32), dtype=np.uint8)
    for number, frame in enumerate(
        frames
    ):  # the two bytes are never twice in one place
        frame[3, number : number + 2] = 0xAA, 0x55
    return frames, b"".join(b"\xaa\x55" + frame.tobytes() for frame in frames)


def test_bytes_of_a_magnetic_skin_are_frames(rng):
    values, data = skin_bytes(rng)
    make_sensor = lambda: serials.MagneticSkin("p", open_port=lambda *_: Port(data))  # noqa: E731
    check_sensor(make_sensor())
    with make_sensor() as sensor:
        images = [sensor.read_next().image for _ in range(15)]
        assert sensor.channels == ("x", "y", "z")
    for image, expected in zip(images, values, strict=False):
        assert_array_equal(image[0], expected[:, 1:])  # temperature is left out


def test_bytes_of_a_flexitac_are_frames(rng):
    frames, data = taxel_bytes(rng)
    make_sensor = lambda: serials.FlexiTac("p", open_port=lambda *_: Port(data, 401))  # noqa: E731
    check_sensor(make_sensor())
    with make_sensor() as sensor:
        images = [sensor.read_next().image for _ in range(15)]
    assert_array_equal(images, frames[:15])


@pytest.mark.parametrize("kind", ["skin", "array"])
def test_after_garbage_and_cuts_the_next_whole_frame_is_read(rng, kind):
    expected, data = skin_bytes(rng) if kind == "skin" else taxel_bytes(rng)
    data = bytes(rng.integers(0, 256, 99, dtype=np.uint8)) + data[7:]
    driver = serials.MagneticSkin if kind == "skin" else serials.FlexiTac
    with driver("p", open_port=lambda *_: Port(data, 211)) as sensor:
        images = [sensor.read_next().image for _ in range(10)]
        assert sensor.n_dropped > 0
    frames = expected[..., 1:][:, None] if kind == "skin" else expected
    # The first frame lacks a part; the following ones come whole and in order.
    assert_array_equal(images, frames[1:11])


@pytest.mark.parametrize("framing", ["line", "binary"])
@pytest.mark.parametrize("kind", ["udp", "tcp"])
def test_arrays_come_over_a_network(rng, kind, framing):
    frame = rng.integers(0, 1000, (4, 5)).astype(np.uint16)
    stop = threading.Event()
    stream = kind == "tcp"
    socket_kind = socket.SOCK_STREAM if stream else socket.SOCK_DGRAM
    server = socket.socket(socket.AF_INET, socket_kind)
    server.bind(("127.0.0.1", 0))
    port = server.getsockname()[1]
    if stream:
        server.listen()
    else:  # the port is free again for the sensor
        server.close()

    def send():
        out = (
            server.accept()[0] if stream else socket.socket(socket.AF_INET, socket_kind)
        )
        number = 0
        while not stop.is_set():
            if framing == "line":
                data = sensors.LineFraming.write(frame)
            else:
                data = sensors.BinaryFraming.write(frame, number)
            number = (number + 1) % 65536
            try:
                out.sendall(data) if stream else out.sendto(data, ("127.0.0.1", port))
            except OSError:
                break
            time.sleep(0.002)
        out.close()

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    driver = getattr(network, kind)
    try:
        with driver(f"127.0.0.1:{port}", image_shape=(4, 5), framing=framing) as sensor:
            for _ in range(5):
                assert_array_equal(sensor.read_next(5.0).image, frame)
    finally:
        stop.set()
        thread.join(5)
        server.close()


def test_addresses_that_cannot_be_reached_are_refused():
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        port = bound.getsockname()[1]  # bound, but nobody listens
        with pytest.raises(SensorError, match="cannot be reached"):
            network.tcp(f"127.0.0.1:{port}", image_shape=(2, 2)).connect()
    for odd in ("nowhere", "host:port", "host:99999"):
        with pytest.raises(ValueError, match="must be HOST:PORT"):
            network.tcp(odd, image_shape=(2, 2))
    with pytest.raises(ValueError, match="framing must be"):
        network.udp("127.0.0.1:1", image_shape=(2, 2), framing="morse")
    pytest.importorskip("serial")
    with pytest.raises(SensorError, match="/dev/none cannot be opened"):
        serials.FlexiTac("/dev/none").connect()


@pytest.fixture
def plugged(monkeypatch):
    """Name entry points of the group, as installed packages would."""

    def plug(**named):
        points = [
            importlib.metadata.EntryPoint(name, value, "palpate.sensors")
            for name, value in named.items()
        ]

        def entry_points(group, name=None):
            return [p for p in points if group == p.group and name in (None, p.name)]

        monkeypatch.setattr("palpate.sensors._address.entry_points", entry_points)

    return plug


def test_a_driver_is_found_by_its_entry_point(plugged):
    assert not is_address("flexitac:/dev/ttyUSB0?shape=16x16")
    plugged(flexitac="palpate_drivers.serials:FlexiTac")
    assert is_address("flexitac:/dev/ttyUSB0?shape=16x16")
    assert is_address("sim:mug")
    assert not is_address("touches.npz")
    assert not is_address("C:/touches.npz")
    sensor = open_sensor("flexitac:/dev/ttyUSB0?shape=16x16&baud=9600")
    assert isinstance(sensor, serials.FlexiTac)
    assert sensor.image_shape == (16, 16)
    assert sensor.baud == 9600
    assert open_sensor("flexitac:/dev/ttyUSB0", image_shape="8x4").image_shape == (8, 4)
    with pytest.raises(ValueError, match="Options of flexitac are shape, baud"):
        open_sensor("flexitac:/dev/ttyUSB0?colour=1")
    with pytest.raises(ValueError, match="baud must be a whole number, got 'fast'"):
        open_sensor("flexitac:/dev/ttyUSB0?baud=fast")
    with pytest.raises(ValueError, match=r"\(or flexitac of packages installed\)"):
        open_sensor("flexitak:/dev/ttyUSB0")


def test_drivers_that_cannot_be_used_are_named(plugged):
    plugged(gone="no_such_module:Sensor", odd="builtins:str")
    with pytest.raises(ValueError, match=r"no_such_module:Sensor, cannot be"):
        open_sensor("gone:0")
    with pytest.raises(ValueError, match="must return a LiveSensor, got str"):
        open_sensor("odd:0")


class Lying(sensors.LiveSensor):
    """Promises one shape and gives another, or does not come back in time."""

    def __init__(self, wait_s=0.0):
        super().__init__("lying", "count", (2, 3), np.uint8)
        self.wait_s = wait_s

    def _open(self):
        pass

    def _grab(self):
        time.sleep(self.wait_s or 0.01)
        return [np.zeros((2, 3) if self.wait_s else (3, 2), np.uint8)]

    def _close(self):
        pass


def test_a_driver_that_lies_about_its_shape_is_refused():
    with Lying() as sensor, pytest.raises(SensorError, match=r"\(3, 2\), it promised"):
        sensor.read_next(0.5)
    with pytest.raises(SensorError, match=r"its frames are \(3, 2\), it promised"):
        check_sensor(Lying())


def test_a_driver_that_blocks_is_reported_and_not_started_twice():
    sensor = Lying(wait_s=7.0)
    sensor.patience_s = 0.5  # with the read that does not end
    with sensor, pytest.raises(SensorError, match=r"gave no frame in 0\.1 s"):
        sensor.read_next(0.1)
    with pytest.raises(SensorError, match="has not ended its last read"):
        sensor.connect()


class Box(Port):
    """Stands for a Paxini control box: answers requests, and keeps them."""

    def __init__(self, frames, spoilt=b""):
        self.frames, self.spoilt = iter(frames), spoilt
        self.requests, self.out = [], b""

    @property
    def in_waiting(self):
        return min(97, len(self.out))

    def write(self, data):
        self.requests.append(data)
        answer = bytes(6) + next(self.frames) if data[7:9] == b"\xc0\x06" else b""
        head = b"\x0e\x00" + data[6:9] + b"\x00" + len(answer).to_bytes(2, "little")
        self.out += self.spoilt + fingers._HEAD + head + answer + b"?" + fingers._TAIL
        if data[7:9] == b"\xc0\x0c":  # then the sensor is ready
            self.out = self.out[len(self.spoilt) :]

    def read(self, n):
        time.sleep(0.001)
        taken, self.out = self.out[:n], self.out[n:]
        return taken

    def close(self):
        self.out = b""


def test_a_paxini_box_answers_requests(rng):
    # Two frames as published programs send them, sums included.
    calibrate = "55 aa 7b 7b 0e 00 70 b0 02 02 00 03 01 ca 55 aa 7d 7d"
    mode_two = "55 aa 7b 7b 0e 00 70 c0 0c 01 00 02 b3 55 aa 7d 7d"
    assert fingers.paxini_command(0xB0, 2, b"\x03\x01").hex(" ") == calibrate
    assert fingers.paxini_command(0xC0, 12, b"\x02").hex(" ") == mode_two
    taxels = rng.integers(0, 256, (900, 120, 3), dtype=np.uint8)
    box = Box([frame.tobytes() for frame in taxels])
    with fingers.Paxini("p", module=3, open_port=lambda *_: box) as sensor:
        image = sensor.read_next().image
        for _ in range(4):
            image = sensor.read_next().image
        assert sensor.channels == ("x", "y", "z")
    assert_array_equal(image[0, :, :2], taxels[4, :, :2].view(np.int8))
    assert_array_equal(image[0, :, 2], taxels[4, :, 2])
    assert box.requests[1][11] == 6  # the third plug
    assert box.requests[2][11:16] == bytes([0x7B]) + bytes([0x0E, 4, 0x68, 1])
    box = Box([frame.tobytes() for frame in taxels])
    check_sensor(fingers.Paxini("p", open_port=lambda *_: box))


def test_after_garbage_a_paxini_box_is_read_on(rng):
    taxels = rng.integers(0, 256, (900, 120, 3), dtype=np.uint8)
    box = Box([frame.tobytes() for frame in taxels])
    with fingers.Paxini("p", open_port=lambda *_: box) as sensor:
        box.spoilt = fingers._HEAD + b"garbage"
        images = [sensor.read_next().image for _ in range(5)]
        assert sensor.n_dropped > 0
    for image in images:
        assert (image[0, :, 2] == taxels[:, :, 2]).all(axis=1).any()
    silent = Port(b"")
    silent.write, silent.read = (lambda data: None), (lambda n: b"")
    with pytest.raises(SensorError, match=r"must be a Paxini control box, got .* none"):
        fingers.Paxini("p", open_port=lambda *_: silent).connect()


def tip_bytes(rng, n=20):
    """Return packets of two fingers, with motion between; some hold a first byte."""
    values = rng.integers(0, 65536, (n, 2, 7, 4), dtype=np.uint16)
    values[:, :, 2, 1] = 0x9A9A
    data = b""
    for frame in values:
        for finger, taxels in enumerate(frame):
            static = bytes([0x10 | finger << 2]) + taxels.astype(">u2").tobytes()
            motion = bytes([0x30 | finger << 2]) + bytes(6) + b"\x70\x01\x02"
            for body in (static, motion):
                data += bytes([0x9A, 0, 0x61, len(body)]) + body
    return values, data


class Tip(Port):
    """A port that keeps what is written to it."""

    def write(self, data):
        self.written = data


@pytest.mark.parametrize("spoilt", [False, True], ids=["whole", "garbage and cut"])
def test_bytes_of_a_tsf85_are_two_arrays_with_a_gap(rng, spoilt):
    values, data = tip_bytes(rng)
    if spoilt:
        data = bytes(rng.integers(0, 256, 99, dtype=np.uint8)) + data[7:]
    port = Tip(data, 211)
    make_sensor = lambda: fingers.TSF85("p", period_ms=16, open_port=lambda *_: port)  # noqa: E731
    with make_sensor() as sensor:
        images = [sensor.read_next().image for _ in range(12)]
        assert (sensor.n_dropped > 0) == spoilt
    assert port.written == bytes([0x9A, 0, 0x58, 1, 16])
    assert np.isnan(np.array(images)[:, :, 4]).all()
    whole_frames = {frame.tobytes() for frame in values.astype(np.float32)}
    read = [np.stack([image[:, :4], image[:, 5:]]) for image in images]
    if not spoilt:
        assert_array_equal(read, values[:12])
        check_sensor(make_sensor())
    # A packet that is cut costs a frame or two of one finger; then all are whole.
    assert all(
        np.ascontiguousarray(frame).tobytes() in whole_frames for frame in read[4:]
    )
    with pytest.raises(ValueError, match="period_ms 1 to 255, got 2 and 999"):
        fingers.TSF85("p", period_ms=999)


def test_messages_of_a_uskin_server_are_frames(rng):
    server = pytest.importorskip("websockets.sync.server")
    values = rng.integers(0, 65536, (50, 4, 4, 3), dtype=np.uint16)

    def speak(socket):
        socket.send('{"message": "Welcome", "version": "1.7.6"}')
        for number in range(5000):
            words = ",".join(f"{v:04X}" for v in values[number % 50].ravel())
            reading = {"sensor": "2", "taxels": 16, "data": words, "calibrated": None}
            socket.send(json.dumps({"message": number, "sensors": 1, "2": reading}))
            if number % 50 == 3:
                for odd in ("no JSON", '{"message": 4}', '{"2": {"data": "GG,1"}}'):
                    socket.send(odd)
            time.sleep(0.002)

    with server.serve(speak, "127.0.0.1", 0) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        place = f"127.0.0.1:{serving.socket.getsockname()[1]}"
        with fingers.USkin(place, number=2) as sensor:
            images = [sensor.read_next().image for _ in range(20)]
            assert sensor.n_dropped == 3
        check_sensor(fingers.USkin(place, number=2))
        serving.shutdown()
    assert_array_equal(images, values[:20])
    with pytest.raises(SensorError, match=r"cannot be reached.*Start XELA's server"):
        fingers.USkin(place).connect()
