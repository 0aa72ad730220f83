"""Beliefs out and commands in, over real DDS and zenoh: the robot is another process.

The robot's types, bytes and keys are written by hand in `ros_robot.py`.
"""

import json
import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib.util import find_spec
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from ros_network import (
    NUMBER,
    eventually,
    heard_by,
    learn,
    own_number,
    robot,
    router,
    variables,
)
from typer.testing import CliRunner

from palpate.cli import app
from palpate.library import LibraryError, TouchLibrary
from palpate.sensors import open_sensor, ros_place
from palpate.sensors.ros import STRING, read_message, text_message, write_message
from palpate.web import LiveSession

from .conftest import Event

pytest.importorskip("rosbags")

DOMAIN, ENDPOINT = 150 + NUMBER, f"tcp/127.0.0.1:{17500 + NUMBER}"
VIA = [
    pytest.param(
        "dds",
        marks=pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds"),
    ),
    pytest.param(
        "zenoh",
        marks=[
            pytest.mark.slow,
            pytest.mark.skipif(not find_spec("zenoh"), reason="no zenoh"),
        ],
    ),
]


@pytest.fixture(autouse=True)
def network(monkeypatch):
    for name, value in variables(ENDPOINT).items():
        monkeypatch.setenv(name, value)


def pressing(via, **todo):
    """Start the robot on a wire; yield its process."""
    return robot(via=via, domain=DOMAIN, endpoint=ENDPOINT, **todo)


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    return learn(tmp_path_factory.mktemp("model") / "two.palpate")


@contextmanager
def recognising(via, model, library=None):
    """Run a live session on the robot's topic that publishes what it believes."""
    where = f"domain={DOMAIN}&via={via}"
    sensor = open_sensor(f"ros:/pad?{where}")
    with LiveSession(sensor, model=model, library=library) as session:
        session.take_baseline()
        publisher = session.publish(f"ros:/palpate?{where}")
        try:
            yield session
        finally:
            publisher.close()


@pytest.mark.parametrize("via", VIA)
def test_a_robot_hears_beliefs_with_the_header_of_its_touch(via, learnt):
    kinds = ["rows", "rows", "columns"]
    with (
        router(ENDPOINT) if via == "zenoh" else nullcontext(),
        pressing(via, kinds=kinds) as process,
        recognising(via, learnt) as session,
    ):
        received = heard_by(process)
        beliefs = [
            {**touch.posterior, "unknown": touch.unknown}
            for touch in session.episode.touches
        ]
        frames_lost = session.health.to_dict()["n_dropped"]
    assert frames_lost == 0
    assert [dict(belief["results"]) for belief in received["belief"]] == beliefs
    best = [belief["results"][0][0] for belief in received["belief"]]
    assert best[:2] == ["rows", "rows"]
    for belief, end in zip(received["belief"], received["ends"], strict=True):
        shares = [share for _, share in belief["results"]]
        assert shares == sorted(shares, reverse=True)
        assert sum(shares) == pytest.approx(1.0, abs=1e-9)
        # To the nanosecond, that of one of the six frames of the press.
        stamps = received["sent"]
        assert belief["stamp"] in stamps
        assert 1 <= stamps.index(end) - stamps.index(belief["stamp"]) <= 6
        assert belief["frame_id"] == "pad"
    assert len(received["decision"]) == len(received["belief"])
    decisions = {decision["text"] for decision in received["decision"]}
    assert decisions <= {"", "rows", "columns"}


@pytest.mark.slow
@pytest.mark.parametrize("via", VIA)
def test_each_command_is_answered_as_done_or_refused(via, learnt, tmp_path):
    commands = ["confirm knob", "dance", "start", "teach", "teach lid", "stop"]
    with (
        router(ENDPOINT) if via == "zenoh" else nullcontext(),
        pressing(via, kinds=["rows"] * 3, commands=commands) as process,
        recognising(via, learnt, tmp_path / "lab") as session,
    ):
        received = heard_by(process)
        assert session.teacher.lesson is None
    answers = [answer["text"] for answer in received["answer"]]
    choices = "start, object, teach, stop, confirm, learn, session"
    name_it = "Publish 'object NAME' to /palpate/command first."
    assert answers == [
        "done: 3 touches are kept as knob; learn to use them.",
        f"refused: command must be one of {choices}, got 'dance'.",
        "done: The next touch begins an episode.",
        f"refused: An object must be named, got none. {name_it}",
        "done: Touches teach lid.",
        "done: Touches are recognised.",
    ]
    with TouchLibrary.open(tmp_path / "lab") as library:
        assert library.touches().object.tolist() == ["knob"] * 3


@pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds")
def test_a_touch_without_contact_keeps_no_lesson_open_that_confirm_began(
    make_session, drawn
):
    empty = drawn.no_contact.copy()
    empty[0, 0] = 1
    with make_session() as session:
        for image in (*drawn.images[:3], empty):
            session.post_touch(image)
        publisher = session.publish(f"ros:/desk?domain={DOMAIN}")
        answer = publisher.ask("confirm knob")
        for image in drawn.images[:3]:
            session.post_touch(image)
        again = publisher.ask("confirm knob")
        publisher.close()
        assert session.teacher.lesson is None
    assert again[0] is False
    assert "No touch is kept as knob. That touch of knob is stored already" in again[1]
    assert answer == (True, "3 touches are kept as knob; learn to use them.")


@pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds")
def test_what_is_refused_leaves_no_lesson_open_and_ends_nothing(
    make_session, drawn, monkeypatch
):
    with make_session() as session:
        for image in drawn.images[:3]:
            session.post_touch(image)
        publisher = session.publish(f"ros:/desk?domain={DOMAIN}")
        states = []
        session.listeners.add(lambda event: states.append(event.kind))
        library, plain = session.teacher.library, session.teacher.library.add
        calls = iter([plain, Mock(side_effect=LibraryError("No room. Free space."))])
        monkeypatch.setattr(library, "add", lambda **touch: next(calls)(**touch))
        assert publisher.ask("confirm knob") == (False, "No room. Free space.")
        assert session.teacher.lesson is None  # else the next thing would be a knob
        assert "state" in states  # of the touch that was stored
        full = Mock(side_effect=OSError(28, "No space left on device"))
        monkeypatch.setattr(session.teacher.journal, "begin_lesson", full)
        assert publisher.ask("teach lid")[0] is False
        assert session.teacher.lesson is None
        # Whatever is raised, the thread that hears commands lives.
        monkeypatch.setattr(session, "begin_episode", Mock(side_effect=KeyError("x")))
        assert publisher.ask("start") == (False, "KeyError('x')")
        publisher.close()


def test_runs_of_the_tests_at_the_same_time_have_different_numbers():
    """Without it two runs on one machine received each other's messages."""
    others = [own_number() for _ in range(3)]
    assert len({NUMBER, *others}) == 4


@pytest.mark.parametrize(
    ("address", "why"), [("/palpate", "like ros:/palpate"), ("ros:/a?qos=x", "'qos'")]
)
def test_an_address_to_publish_at_is_checked_before_anything_starts(address, why):
    words = ["live", "no.palpate", "--sensor", "sim:mug", "--publish", address]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert why in " ".join(result.output.replace("│", " ").split())


@pytest.mark.slow
@pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds")
def test_the_command_publishes_too(learnt, tmp_path):
    where = f"domain={DOMAIN}"
    words = ["live", str(learnt), "--sensor", f"ros:/pad?shape=12x12&{where}"]
    words += ["--publish", f"ros:/palpate?{where}", "--json", "-n", "3"]
    words += ["--timeout", "20"]
    code = "import sys; from palpate.cli import main; sys.argv[0] = 'palpate'; main()"
    with pressing("dds", kinds=["rows"] * 3) as process:
        command = [sys.executable, "-c", code, *words]
        completed = subprocess.run(command, capture_output=True, text=True, check=False)
        assert completed.returncode == 0, completed.stderr
        (episode,) = json.loads(completed.stdout)["episodes"]
        assert episode["touches"]
        received = heard_by(process)
    assert received["belief"][0]["results"][0][0] == "rows"


@pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds")
def test_an_object_must_have_a_name_that_can_be_taught(make_session):
    with make_session() as session:
        publisher = session.publish(f"ros:/desk?domain={DOMAIN}")
        sentence = "teach and confirm mean red mug now."
        assert publisher.ask("object  red mug ") == (True, sentence)
        done, why = publisher.ask("object unknown")
        assert not done
        assert "must not be 'unknown'" in why
        assert publisher.ask("start mug") == (
            False,
            "start must stand alone, got 'mug' after it.",
        )
        publisher.close()


@pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds")
def test_a_touch_that_cannot_be_written_ends_no_publishing(
    make_session, drawn, monkeypatch, capsys
):
    with make_session() as session:
        publisher = session.publish(f"ros:/desk?domain={DOMAIN}")
        written = []
        writing = Mock(side_effect=[OSError("no route"), None, None])
        belief = SimpleNamespace(write_bytes=writing, hindrance="")
        monkeypatch.setattr(publisher, "_belief", belief)
        decision = SimpleNamespace(write_bytes=written.append)
        monkeypatch.setattr(publisher, "_decision", decision)
        for image in drawn.images[:3]:
            session.post_touch(image)
        publisher.close()
    assert writing.call_count == 3
    assert len(written) == 2
    assert capsys.readouterr().err.count("was not published to /desk: OSError") == 1


@pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds")
def test_a_numbered_command_gets_a_numbered_answer_and_late_readers_all(make_session):
    place, numbers = f"ros:/desk?domain={DOMAIN}", range(5)
    with make_session() as session:
        publisher = session.publish(place)
        node = ros_place(place).open_node()
        commands = node.publish("/desk/command", STRING)
        answers = node.subscribe("/desk/answer", STRING, reliable=True)
        texts = []

        def is_answered(number, commands=commands, answers=answers):
            # Whoever writes before the reader is there is not heard: it asks again.
            text = text_message(f"#{number} start")
            commands.write_bytes(write_message(text, STRING))
            texts.extend(read_message(raw, STRING).data for raw in answers.take(0.2))
            return f"#{number} done: The next touch begins an episode." in texts

        assert all(eventually(partial(is_answered, number)) for number in numbers)
        assert set(texts) <= set(heard_late("rt/desk/answer", len(texts)))
        del answers, commands
        publisher.close()
        node.close()


def heard_late(topic, n_messages):
    """What a transient-local reader of another program gets of a topic of strings."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    kind = make_idl_struct("String_", "std_msgs::msg::dds_::String_", {"data": str})
    quality = Qos(
        Policy.Reliability.Reliable(100_000_000),
        Policy.Durability.TransientLocal,
        Policy.History.KeepAll,
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    participant = DomainParticipant(DOMAIN)
    reader = DataReader(participant, Topic(participant, topic, kind), qos=quality)
    heard = []

    def is_all():
        heard.extend(sample.data for sample in reader.take(N=64))
        return len(heard) >= n_messages

    eventually(is_all)
    return heard


@pytest.mark.skipif(not find_spec("cyclonedds"), reason="no cyclonedds")
def test_the_end_of_learning_is_a_second_answer():
    session = LiveSession()
    place = f"ros:/desk?domain={DOMAIN}"
    node = ros_place(place).open_node()
    answers = node.subscribe("/desk/answer", STRING, reliable=True)
    publisher = session.publish(place)
    assert eventually(lambda reader=answers: reader.n_publishers)
    end_s = time.monotonic() + 10
    state = {"learning": True, "learn_error": "", "message": "Learnt 2 objects."}
    for change in (
        {},
        {"learning": False},
        {"learning": False},
        {},
        {"learning": False, "learn_error": "Too little to learn."},
    ):
        session.listeners.notify(Event("state", {**state, **change}))
    texts = []
    while len(texts) < 2 and time.monotonic() < end_s:
        texts += [read_message(raw, STRING).data for raw in answers.take(0.2)]
    assert texts == ["done: Learnt 2 objects.", "refused: Too little to learn."]
    del answers
    publisher.close()
    node.close()
