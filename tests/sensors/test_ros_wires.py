"""Both wires of ROS 2 below the sensor: services, type hashes, zenoh's keys.

Requests and frames are bytes written by hand, as clients of ROS put them there.
"""

import itertools
import struct
import threading
from contextlib import contextmanager
from importlib.util import find_spec

import numpy as np
import pytest
from ros_network import NUMBER, eventually, router, variables
from ros_robot import image_bytes

from palpate.sensors import (
    SensorError,
    _ros_wires,
    check_sensor,
    open_sensor,
    ros,
    ros_place,
)

pytest.importorskip("rosbags")

DOMAIN, ENDPOINT = 100 + NUMBER, f"tcp/127.0.0.1:{17600 + NUMBER}"
IMAGE = "sensor_msgs::msg::dds_::Image_/RIHS01_d31d41"
TRIGGER = b"\0\1\0\0\0"  # CDR of a request without fields
HERE = f"ros:/desk?domain={DOMAIN}"
needs_dds = pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds")
needs_zenoh = pytest.mark.skipif(not find_spec("zenoh"), reason="no zenoh")


@pytest.fixture(autouse=True)
def network(monkeypatch):
    for name, value in variables(ENDPOINT).items():
        monkeypatch.setenv(name, value)


# The hash that ROS publishes.
def test_the_type_hash_of_a_message_is_that_of_ros():
    string = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert _ros_wires.type_hash(ros.STRING) == string


@needs_dds
def test_a_service_answers_as_rmw_cyclonedds_asks():
    from palpate.sensors._ros_wires import DdsReader, DdsWriter, _topic

    node, client = (ros_place(HERE).open_node() for _ in range(2))
    service = node.serve("/desk/start", ros.TRIGGER, lambda _: (True, "begun"))
    participant, kind = client._participant, "std_srvs/srv/Trigger"
    asks = _topic(participant, "rq/desk/startRequest", f"{kind}_Request")
    answers = _topic(participant, "rr/desk/startReply", f"{kind}_Response")
    writer = DdsWriter(participant, asks, f"{kind}_Request")
    reader = DdsReader(participant, answers, f"{kind}_Response", reliable=True)
    assert eventually(lambda: service._reader.n_publishers and reader.n_publishers)
    head = struct.pack("<Qq", 77, 5)  # the client, and the number of its request
    writer.write_bytes(b"\0\1\0\0" + head + b"\0")
    replies = []
    for _ in range(100):
        service.poll()
        replies += reader.take(0.05)
        if replies:
            break
    # Cyclone fills messages up to four bytes.
    body = struct.pack("<4sI8s", b"\1\0\0\0", 6, b"begun\0")
    assert replies == [b"\0\1\0\0" + head + body]
    client.close()
    node.close()


@needs_zenoh
def test_a_service_answers_as_rmw_zenoh_asks():
    import zenoh

    with router(ENDPOINT) as client:
        node = ros_place(f"{HERE}&via=zenoh").open_node()
        kind = ros.TRIGGER
        service = node.serve("/desk/start", kind, lambda _: (False, "no"))
        key = f"{DOMAIN}/desk/start/std_srvs::srv::dds_::Trigger_"
        key += f"/{_ros_wires.SERVICE_HASHES[kind]}"
        about = struct.pack("<qqB16s", 9, 123, 16, b"gid-of-a-client.")
        tokens = f"@ros2_lv/{DOMAIN}/*/*/*/SS/*/*/*/%desk%start/*/*/*"
        assert eventually(lambda: len([*client.liveliness().get(tokens)]) == 1)
        target = zenoh.QueryTarget.ALL_COMPLETE
        for payload in (b"", TRIGGER):  # nothing at all has no answer
            replies = client.get(key, payload=payload, attachment=about, target=target)
            assert eventually(lambda: bool(service._waiting))
            service.poll()
            bodies = [(r.ok.payload.to_bytes(), r.ok.attachment) for r in replies]
            assert len(bodies) == (payload != b"")
        raw, beside = bodies[0][0], bodies[0][1].to_bytes()
        assert raw == b"\0\1\0\0" + struct.pack("<4sI3s", b"\0\0\0\0", 3, b"no\0")
        assert struct.unpack("<q", beside[:8]) == (9,)
        assert beside[16:] == b"\x10gid-of-a-client."
        node.close()


@pytest.mark.slow
@needs_zenoh
def test_a_sensor_over_zenoh_needs_no_token_and_survives_a_restart():
    address = f"ros:/zpad?domain={DOMAIN}&via=zenoh"
    with router(ENDPOINT) as session, sending(session, "/zpad") as first:
        sensor = open_sensor(address)
        assert sensor.image_shape == (6, 6)
        check_sensor(open_sensor(address))
        with sensor:
            frame = sensor.read_next()
            level = int(frame.image[0, 0])
            assert np.ptp(frame.image) == 0
            assert frame.device_time_s == pytest.approx(100 + level, abs=1e-6)
            assert sensor.header_at(frame.device_time_s) == (100 + level, 5, "pad")
            first.stop()
            assert eventually(lambda: "nobody publishes /zpad now" in sensor.lost)
            with sending(session, "/zpad"):
                assert sensor.read_next(5.0).image.shape == (6, 6)
            with sending(session, "/zpad", side=4):
                eventually(lambda: "gives frames of 4 x 4 of uint8 now" in sensor.lost)
                assert "it gave 6 x 6" in sensor.lost


@contextmanager
def sending(session, topic, side=6):
    """Put frames on a topic, 100 a second, without telling of a publisher.

    Each is of one grey level, and stamped with it.
    """
    ended, number = threading.Event(), itertools.count()

    def send():
        while not ended.wait(0.01):
            level = next(number) % 250
            image = np.full((side, side), level, np.uint8)
            raw = image_bytes(image, 100 + level, 5)
            session.put(f"{DOMAIN}{topic}/{IMAGE}", raw)

    thread = threading.Thread(target=send)
    thread.start()
    thread.stop = lambda: (ended.set(), thread.join())
    try:
        yield thread
    finally:
        thread.stop()


def test_where_to_publish_is_one_short_address():
    assert ros_place("ros:palpate") == ("/palpate", 0, "dds", True)
    address = "ros:/a/b?domain=3&via=zenoh&services=no"
    assert ros_place(address) == ("/a/b", 3, "zenoh", False)
    with pytest.raises(ValueError, match=r"like ros:/palpate.domain=0, got 'camera:0'"):
        ros_place("camera:0")
    with pytest.raises(ValueError, match=r"'qos' is no option .* domain, via, serv"):
        ros_place("ros:/palpate?qos=reliable")
    with pytest.raises(ValueError, match="domain must be at most 232, got 233"):
        ros_place("ros:/palpate?domain=233").open_node()
    with pytest.raises(ValueError, match="via must be"):
        ros_place("ros:/palpate?via=pigeon")


@needs_zenoh
def test_a_missing_router_and_a_bad_configuration_are_named(monkeypatch):
    with pytest.raises(
        SensorError, match=r"Nobody publishes /zpad .* a router runs at"
    ):
        open_sensor(f"ros:/zpad?domain={DOMAIN}&via=zenoh&wait=0.2")
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", "no/such/key=3")
    with pytest.raises(SensorError, match=r"cannot open a session.*CONFIG_OVERRIDE"):
        open_sensor(f"ros:/zpad?domain={DOMAIN}&via=zenoh")


@needs_dds
def test_a_subscriber_that_asks_for_more_than_is_offered_is_told_by_its_policy():
    from cyclonedds.core import Policy, Qos
    from cyclonedds.sub import DataReader

    from palpate.sensors._ros_wires import _topic

    node, client = (ros_place(HERE).open_node() for _ in range(2))
    writer = node.publish("/desk/belief", ros.STRING)
    assert writer.hindrance == ""
    asks = Qos(
        Policy.Reliability.Reliable(10**9),
        Policy.Deadline(10**8),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    topic = _topic(client._participant, "rt/desk/belief", ros.STRING)
    reader = DataReader(client._participant, topic, qos=asks)
    assert eventually(lambda: writer.hindrance == "deadline")
    del reader, topic
    client.close()
    node.close()
