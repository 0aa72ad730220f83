"""Logs for Rerun and Foxglove are read back by their own readers."""

import json
import struct
import subprocess
import sys
import threading
import types
from contextlib import suppress
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate import ObjectRecogniser, Touches
from palpate.library import read_bag
from palpate.sensors import ReplaySensor
from palpate.web import LiveSession

palpate_look = pytest.importorskip("palpate_look")
needs_mcap = pytest.mark.skipif("not __import__('importlib').util.find_spec('mcap')")


@pytest.fixture(scope="module")
def touches():
    """Two things, pressed here and there, on one mat."""
    rng = np.random.default_rng(0)
    row, col = np.mgrid[:12, :12]
    images = []
    for number in range(40):
        y, x = rng.uniform(4, 7, 2)
        disc = np.hypot(row - y, col - x) < 3.2
        bar = (abs(row - y) < 1.2) & (abs(col - x) < 4.5)
        image = (bar if number % 2 else disc) * 150 + rng.normal(scale=3, size=(12, 12))
        images.append(np.rint(image).clip(0, 255))
    return Touches(
        np.array(images, np.uint8),
        object=["disc", "bar"] * 20,
        time_s=1.7e9 + np.arange(40) * 0.25,
        no_contact=np.zeros((12, 12), np.uint8),
    )


@pytest.fixture(scope="module")
def model(touches, tmp_path_factory):
    """A model of both, learnt from the first thirty touches."""
    path = tmp_path_factory.mktemp("model") / "two.palpate"
    ObjectRecogniser("liu2014").fit(touches[:30]).save(path)
    return path


@pytest.fixture(scope="module")
def expected(model, touches):
    """Return row, posterior and unknown score after each of the last ten touches."""
    recogniser, tested = ObjectRecogniser.load(model), touches[30:]
    beliefs = []
    evidence = recogniser.evidence(tested)
    for _, _, rows in tested.episodes():
        belief = recogniser.start()
        for row in rows:
            belief.update(evidence.of_touch(row))
            beliefs.append((int(row), belief.posterior, belief.unknown))
    return beliefs


def read_mcap(path):
    """Return per topic the messages of a file, as mcap's own reader gives them."""
    reader = pytest.importorskip("mcap.reader")
    messages = {}
    with path.open("rb") as file:
        for _, channel, message in reader.make_reader(file).iter_messages():
            messages.setdefault(channel.topic, []).append(message)
    return messages


def belief_of(message):
    """Return the probabilities in a message of ROS, by fields read from its schema."""
    typesys = pytest.importorskip("rosbags.typesys")
    types = typesys.get_typestore(typesys.Stores.LATEST)
    hypothesis, kind = "vision_msgs/msg/ObjectHypothesis", "palpate_msgs/msg/Belief"
    texts = {
        hypothesis: "string class_id\nfloat64 score",
        kind: "std_msgs/Header header\nuint32 episode\nuint32 touch\n"
        "vision_msgs/ObjectHypothesis[] results\nstring best\nstring decision\n"
        "string reason\n",
    }
    for name, text in texts.items():
        types.register(typesys.get_types_from_msg(text, name))
    read = types.deserialize_cdr(message.data, kind)
    return {result.class_id: result.score for result in read.results}


def read_rrd(path):
    """Return per entity the rows of a recording, as Rerun's own reader gives them."""
    chunk = pytest.importorskip("rerun.chunk")
    rows = {}
    for part in chunk.RrdReader(path).stream():
        batch = part.to_record_batch()
        timed = batch.select([name for name in batch.schema.names if ":" in name])
        rows.setdefault(part.entity_path, []).extend(timed.to_pylist())
    return rows


def values_of(rows, ending):
    (key,) = {k for row in rows for k in row if k.endswith(ending)}
    return [row[key] for row in rows if row.get(key) is not None]


@needs_mcap
def test_mcap_holds_touches_and_beliefs_to_the_bit(model, touches, expected, tmp_path):
    path = tmp_path / "run.mcap"
    recogniser = ObjectRecogniser.load(model)
    assert palpate_look.log_episodes(path, recogniser, touches[30:]) == 2
    messages = read_mcap(path)
    beliefs = list(map(belief_of, messages["/belief"]))
    assert beliefs == [
        {**posterior, "unknown": unknown} for _, posterior, unknown in sorted(expected)
    ]
    assert [m.log_time for m in messages["/touch"]] == [
        1_700_000_007_500_000_000 + 250_000_000 * k for k in range(10)
    ]
    assert len(messages["/decision"]) == 2
    again = read_bag(path, "/touch", object="thing")
    assert_array_equal(again.images, touches.images[30:])
    assert_array_equal(again.columns["time_s"], touches.columns["time_s"][30:])


def kinds(rng):
    gaps = rng.normal(size=(5, 7)).astype(np.float32)
    gaps[2, 3] = np.nan
    return [
        gaps,
        rng.integers(0, 65536, (5, 7), dtype=np.uint16),
        rng.integers(-999, 999, (5, 7), dtype=np.int16),
        rng.normal(size=(5, 7, 3)).astype(np.float32),
    ]


@needs_mcap
def test_mcap_keeps_what_arrays_read(tmp_path):
    for number, image in enumerate(kinds(np.random.default_rng(0))):
        path = tmp_path / f"{number}.mcap"
        names = ("x", "y", "z") if image.ndim == 3 else None
        with palpate_look.FoxgloveLog(path) as log:
            log.frame(image, 1.25, names)
        for index, name in enumerate(names or ("",)):
            topic = f"/tactile/{name}".rstrip("/")
            read = read_bag(path, topic).images[0]
            assert_array_equal(read, image[..., index] if names else image)


@needs_mcap
def test_colours_of_a_camera_are_one_picture(tmp_path):
    typesys = pytest.importorskip("rosbags.typesys")
    image = np.random.default_rng(0).integers(0, 256, (4, 6, 3), dtype=np.uint8)
    with palpate_look.FoxgloveLog(tmp_path / "c.mcap") as log:
        log.frame(image, 2.0, ("r", "g", "b"))
    (message,) = read_mcap(tmp_path / "c.mcap")["/tactile"]
    types = typesys.get_typestore(typesys.Stores.LATEST)
    read = types.deserialize_cdr(message.data, "sensor_msgs/msg/Image")
    assert read.encoding == "rgb8"
    assert_array_equal(read.data.reshape(4, 6, 3), image)


def test_rerun_holds_touches_and_beliefs_to_the_bit(model, touches, expected, tmp_path):
    pytest.importorskip("rerun")
    path = tmp_path / "run.rrd"
    palpate_look.log_episodes(path, ObjectRecogniser.load(model), touches[30:])
    rows = read_rrd(path)
    buffers = values_of(rows["/touch"], "Image:buffer")
    images = [np.array(b[0], np.uint8).reshape(12, 12) for b in buffers]
    assert_array_equal(images, touches.images[30:][[row for row, *_ in expected]])
    for name in ("disc", "bar"):
        shares = [
            values[0] for values in values_of(rows[f"/belief/{name}"], ":scalars")
        ]
        assert shares == [posterior[name] for _, posterior, _ in expected]
    assert len(values_of(rows["/decision"], ":text")) == 2


def test_rerun_keeps_what_arrays_read(tmp_path):
    pytest.importorskip("rerun")
    for number, image in enumerate(kinds(np.random.default_rng(0))):
        path = tmp_path / f"{number}.rrd"
        with palpate_look.RerunLog(path) as log:
            log.frame(image, 1.25, ("x", "y", "z") if image.ndim == 3 else None)
        rows = read_rrd(path)["/tactile"]
        if image.ndim == 3:
            ((tensor,),) = values_of(rows, "Tensor:data")
            assert tensor["shape"] == [5, 7, 3]
            read = np.array(tensor["buffer"], image.dtype).reshape(image.shape)
        else:
            ((buffer,),) = values_of(rows, "Image:buffer")
            read = np.array(buffer, np.uint8).view(image.dtype).reshape(5, 7)
        assert_array_equal(read, image)


def test_reruns_own_command_finds_nothing_wrong(model, touches, tmp_path):
    pytest.importorskip("rerun")
    log = tmp_path / "run.rrd"
    palpate_look.log_episodes(log, ObjectRecogniser.load(model), touches[30:])
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(log)]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stderr


@needs_mcap
def test_a_live_session_is_written_as_it_goes(model, touches, tmp_path):
    sensor = ReplaySensor(touches[30:], rate_hz=250, hold=3, gap=3)
    log = palpate_look.FoxgloveLog(tmp_path / "live.mcap")
    enough = threading.Event()
    with log, LiveSession(sensor, model=model) as session:
        session.listeners.add(log.take)
        session.listeners.add(
            lambda event: len(session.episode.touches) > 3 and enough.set()
        )
        assert enough.wait(10)
        episode = session.episode.to_dict()["touches"]
        recorded = [image.tobytes() for image in session.episode.images]
    messages = read_mcap(log.path)
    for belief, touch in zip(messages["/belief"], episode, strict=False):
        shares = {**touch["posterior"], "unknown": touch["unknown"]}
        assert belief_of(belief) == shares
    frames = read_bag(log.path, "/tactile").images
    expected = {image.tobytes() for image in touches.images[30:]} | {bytes(144)}
    assert {frame.tobytes() for frame in frames} <= expected
    assert recorded[0] == read_bag(log.path, "/touch").images[0].tobytes()


@needs_mcap
def test_other_readers_decode_every_message_by_its_schema(
    model, touches, expected, tmp_path
):
    """The reader is `iter_decoded_messages` with the factory for ROS 2 alone."""
    decoder = pytest.importorskip("mcap_ros2.decoder")
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "run.mcap"
    palpate_look.log_episodes(path, ObjectRecogniser.load(model), touches[30:])
    decoded = {}
    with path.open("rb") as file:
        stream = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        for _, channel, _, message in stream.iter_decoded_messages():
            decoded.setdefault(channel.topic, []).append(message)
    assert {*decoded} == {"/touch", "/belief", "/decision"}
    beliefs = [
        {result.class_id: result.score for result in belief.results}
        for belief in decoded["/belief"]
    ]
    assert beliefs == [
        {**posterior, "unknown": unknown} for _, posterior, unknown in sorted(expected)
    ]
    assert {belief.episode for belief in decoded["/belief"]} == {1, 2}
    assert decoded["/belief"][0].header.stamp.sec == 1_700_000_007


def test_a_running_foxglove_sees_what_is_taken(model, touches, expected):
    """A client of its protocol subscribes and is sent frames, touches and beliefs."""
    pytest.importorskip("foxglove")
    client = pytest.importorskip("websockets.sync.client")
    log = palpate_look.FoxgloveLive("ws://127.0.0.1:0")
    row, posterior, unknown = expected[0]
    belief = {"episode": 1, "touch": 1, "posterior": posterior, "unknown": unknown}
    belief |= {"best": "bar", "decision": None, "reason": "bar or disc: touch again"}

    def touch():
        log.touch(touches[30:].images[row], 12.5, belief)

    touch()  # a topic is announced once something was written to it
    where = f"ws://127.0.0.1:{log.port}"
    with log, client.connect(where, subprotocols=["foxglove.sdk.v1"]) as socket:
        topics, messages = {}, {}
        while {*topics.values()} != {"/touch", "/belief"}:
            answer = json.loads(socket.recv(timeout=10))
            for channel in answer.get("channels", ()):
                topics[channel["id"]] = channel["topic"]
        subscriptions = [{"id": 100 + key, "channelId": key} for key in topics]
        socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
        while len(messages) < 2:
            touch()
            with suppress(TimeoutError):
                part = socket.recv(timeout=0.2)
                if isinstance(part, bytes) and part[0] == 1:
                    number, at_ns = struct.unpack_from("<IQ", part, 1)
                    messages[topics[number - 100]] = at_ns, part[13:]
    assert {at_ns for at_ns, _ in messages.values()} == {12_500_000_000}
    read = belief_of(types.SimpleNamespace(data=messages["/belief"][1]))
    assert read == {**posterior, "unknown": unknown}


def test_an_address_of_foxglove_must_be_host_and_port():
    for address in ("ws://127.0.0.1", "http://127.0.0.1:8765", "8765"):
        with pytest.raises(ValueError, match=r"must be like ws://127\.0\.0\.1:8765"):
            palpate_look.FoxgloveLive(address)


@needs_mcap
def test_the_option_of_the_command_line_finds_the_log(monkeypatch, tmp_path):
    from palpate.cli.sensor import logged

    point = EntryPoint("mcap", "palpate_look:FoxgloveLog", "palpate.logs")
    monkeypatch.setattr(
        "importlib.metadata.entry_points",
        lambda group, name: [point] * ((group, name) == (point.group, point.name)),
    )
    session = LiveSession()
    with logged(session, tmp_path / "a.mcap"):
        assert len(session.listeners) == 1
    assert read_mcap(tmp_path / "a.mcap") == {}
    with pytest.raises(Exception, match=r"must end in .rrd or .mcap or be ws://"):
        logged(session, tmp_path / "a.txt").__enter__()


@needs_mcap
def test_the_command_writes_or_says_why_not(model, touches, tmp_path, capsys):
    main = pytest.importorskip("palpate_look.__main__").main
    archive, log = tmp_path / "t.npz", tmp_path / "t.mcap"
    touches[30:].save(archive)
    arguments = [str(model), str(archive), "-o"]
    assert main([*arguments, str(log)]) == 0
    assert "10 touches in 2 episodes" in capsys.readouterr().out
    before = log.read_bytes()
    assert main([*arguments, str(log)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert log.read_bytes() == before
    assert main([*arguments, str(tmp_path / "t.avi")]) == 1
    assert "must end in .rrd or .mcap, got 't.avi'" in capsys.readouterr().err


@needs_mcap
def test_a_full_disk_is_reported_at_the_end_and_stops_nothing(tmp_path):
    log = palpate_look.FoxgloveLog(tmp_path / "full.mcap")

    def no_room(*_):
        raise OSError("No space left on device")

    log._image = no_room
    image = np.zeros((2, 2), np.uint8)
    log.take(types.SimpleNamespace(kind="frame", values={}, image=image, channels=None))
    with pytest.raises(OSError, match="is not whole: No space left"):
        log.close()
