"""Recorded touches stay recorded, whatever kills the program and when."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from palpate.exploration import (
    Hemisphere,
    RandomHemisphere,
    RobotError,
    TouchRecord,
    as_touches,
    gather,
    read_episode,
)
from palpate.exploration._record import EpisodeLog

WORLD = Path(__file__).with_name("ball_world.py")
N_TOUCHES = 30


def _record(number=0, outcome="touched", **changes):
    image = np.full((2, 3), number, dtype=np.uint8) if outcome == "touched" else None
    start = Hemisphere().pose(0.1 * number, 0.3, roll_rad=0.2)
    changes = {"force_n": 0.75, "image": image, **changes}
    return TouchRecord(outcome, start, (1.0, 2.0, float(number)), **changes)


def _refused(match, *arguments):
    with pytest.raises(ValueError, match=match), EpisodeLog(*arguments):
        pass


def test_records_come_back_as_they_were(tmp_path):
    fields = {"message": "the “hand” slipped\n", "retracted": False, "travel_mm": 3.5}
    records = [_record(0), _record(1, "nothing"), _record(2, "no frame", **fields)]
    with EpisodeLog(tmp_path / "new" / "folder", {"seed": 1}) as log:
        for record in records:
            log.append(record)
    for written, restored in zip(records, read_episode(log.folder), strict=True):
        assert written.to_dict() == restored.to_dict()
        assert_array_equal(written.start.position_mm, restored.start.position_mm)
        if written.image is None:
            assert restored.image is None
        else:
            assert_array_equal(written.image, restored.image)
            assert written.image.dtype == restored.image.dtype


def test_numbers_of_a_policy_are_recorded_in_single_precision_too(tmp_path):
    start = Hemisphere().pose(0.0, 0.3, roll_rad=np.float32(0.5))
    record = _record(travel_mm=np.float32(2.25))
    with EpisodeLog(tmp_path) as log:
        log.append(replace(record, start=start))
    (restored,) = read_episode(tmp_path)
    assert (restored.start.roll_rad, restored.travel_mm) == (0.5, 2.25)


def test_an_episode_goes_on_where_it_ended(tmp_path):
    for number in range(3):
        with EpisodeLog(tmp_path, {"seed": 1}) as log:
            assert len(log.history) == number
            log.append(_record(number))
    before = {p.name: p.read_bytes() for p in tmp_path.glob("touch_*")}
    with EpisodeLog(tmp_path, {"seed": 1}) as log:
        log.append(_record(3))
    assert [record.position_mm[2] for record in read_episode(tmp_path)] == [0, 1, 2, 3]
    assert {n: (tmp_path / n).read_bytes() for n in before} == before


def test_only_one_program_adds_at_a_time(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    with EpisodeLog(tmp_path) as log:
        _refused("in use: another program", tmp_path)
    assert log.history == []

    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)  # as on some network file systems
    with EpisodeLog(tmp_path):
        pass


def test_a_folder_of_other_things_is_refused(tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    _refused(r"must be empty.*thesis\.txt", tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


@pytest.mark.parametrize("below", [(), ("mug", "0")])
def test_neither_a_file_nor_a_link_to_nothing_is_a_folder(tmp_path, below):
    (tmp_path / "kept").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    for name in ("kept", "link"):
        why = f"must be a folder.*got the file '.*{name}'"
        _refused(why, tmp_path.joinpath(name, *below))
    assert (tmp_path / "kept").read_text() == "mine"
    assert not (tmp_path / "gone").exists()


def test_no_episode_a_gap_and_damage_are_named(tmp_path):
    with pytest.raises(ValueError, match="must be the folder of an episode"):
        read_episode(tmp_path)
    with EpisodeLog(tmp_path) as log:
        for number in range(3):
            log.append(_record(number))
    whole = (tmp_path / "touch_00001.npz").read_bytes()
    (tmp_path / "touch_00001.npz").write_bytes(whole[:-30])
    with pytest.raises(ValueError, match=r"touch_00001\.npz is damaged"):
        read_episode(tmp_path)
    (tmp_path / "touch_00001.npz").unlink()
    with pytest.raises(ValueError, match="got no touch_00001"):
        read_episode(tmp_path)


def test_an_attempt_that_inflates_to_more_than_an_image_is_refused(
    tmp_path, monkeypatch
):
    with EpisodeLog(tmp_path) as log:
        log.append(_record())
    assert len(read_episode(tmp_path)) == 1
    monkeypatch.setattr("palpate.exploration._record._MOST_BYTES", 500)
    with pytest.raises(ValueError, match=r"is damaged: .* at most 500 bytes"):
        read_episode(tmp_path)


def test_nothing_in_a_file_is_executed(tmp_path):
    with EpisodeLog(tmp_path) as log:
        log.append(_record())
    harm = np.array([_record()], dtype=object)
    np.savez(tmp_path / "touch_00000.npz", record=harm)
    with pytest.raises(ValueError, match="allow_pickle=False"):
        read_episode(tmp_path)


def test_appending_to_a_closed_log_is_refused(tmp_path):
    with EpisodeLog(tmp_path) as log:
        pass
    with pytest.raises(ValueError, match="is not open"):
        log.append(_record())


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_loses_only_the_attempt_that_was_not_recorded(
    tmp_path, monkeypatch, call
):
    def full(*args):
        raise OSError(28, "No space left on device")

    with EpisodeLog(tmp_path) as log:
        log.append(_record(0))
        with monkeypatch.context() as disk:
            disk.setattr(*((os, call) if call == "fsync" else (Path, call)), full)
            with pytest.raises(OSError, match="No space"):
                log.append(_record(1))
        assert len(log.history) == 1
        log.append(_record(2))
    assert [record.position_mm[2] for record in read_episode(tmp_path)] == [0, 2]
    assert not list(tmp_path.glob(".partial*"))


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_interrupted_while_it_is_written_no_touch_is_lost(tmp_path, monkeypatch, call):
    place = os if call == "fsync" else Path
    plain = getattr(place, call)

    def interrupted(*args):
        setattr(place, call, plain)
        raise KeyboardInterrupt

    with EpisodeLog(tmp_path) as log:
        monkeypatch.setattr(place, call, interrupted)
        with pytest.raises(KeyboardInterrupt):
            log.append(_record(0))
        log.append(_record(1))
    assert [record.position_mm[2] for record in read_episode(tmp_path)] == [0, 1]
    assert not list(tmp_path.glob(".partial*"))


def test_leftovers_of_a_killed_program_are_swept(tmp_path):
    with EpisodeLog(tmp_path) as log:
        log.append(_record(0))
    (tmp_path / ".partial-0123456789ab").write_bytes(b"PK\x03\x04 half a touch")
    with EpisodeLog(tmp_path) as log:
        assert len(log.history) == 1
    assert not list(tmp_path.glob(".partial*"))


def _run_until_killed(folder, after):
    """Gather in a process that is killed once it prints `after` or more.

    Returns the lines that it printed, and its exit code.
    """
    command = [sys.executable, str(WORLD), str(folder), str(N_TOUCHES), "1e-5"]
    lines = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            lines.append(line.strip())
            if lines[-1].isdigit() and int(lines[-1]) >= after:
                # Into the approach, the writing, or the next choice: it varies.
                time.sleep(0.002 * (after % 7))
                process.kill()
    return lines, process.returncode


@pytest.mark.slow
def test_killed_again_and_again_no_recorded_touch_is_lost(tmp_path, arm, sensor):
    folder, n_recorded, contents = tmp_path / "killed", 0, {}
    for after in (1, 15):
        lines, code = _run_until_killed(folder, after)
        assert code == -signal.SIGKILL
        files = {p.name: p.read_bytes() for p in folder.glob("touch_*")}
        # Each number printed is of attempts that were recorded by then.
        assert len(files) >= max(int(word) for word in lines) >= n_recorded
        assert all(files[name] == content for name, content in contents.items())
        assert len(read_episode(folder)) == len(files)
        n_recorded, contents = len(files), files
    lines, code = _run_until_killed(folder, N_TOUCHES + 1)
    assert (lines[-1], code) == ("done", 0)
    strategy = RandomHemisphere(Hemisphere(radius_mm=100), 5)
    never_killed = gather(arm, sensor, strategy, n_touches=N_TOUCHES)
    for recorded, expected in zip(read_episode(folder), never_killed, strict=True):
        assert recorded.position_mm == expected.position_mm
        assert_array_equal(recorded.image, expected.image)


def test_records_become_touches(tmp_path):
    history = [_record(0), _record(1, "nothing"), _record(2)]
    touches = as_touches(history, object="cup", geometry="array")
    assert touches.images[:, 0, 0].tolist() == [0, 2]
    assert touches.object.tolist() == ["cup", "cup"]
    assert touches.order.tolist() == [0, 2]
    assert touches.columns["position_mm"].tolist() == [[1, 2, 0], [1, 2, 2]]
    assert_array_equal(touches.columns["direction"][1], history[2].direction)
    touches.save(tmp_path / "cup.npz")
    assert type(touches).load(tmp_path / "cup.npz").object.tolist() == ["cup", "cup"]


@pytest.mark.parametrize("image", [None, np.zeros((3, 3), np.uint8)])
def test_records_of_several_sensors_or_without_a_frame_make_no_touches(image):
    history = [_record(0), _record(1, image=image)]
    with pytest.raises(ValueError, match=r"frames of one shape, got .*\(2, 3\)"):
        as_touches(history)
    with pytest.raises(ValueError, match="must hold a touch, got 1 attempts"):
        as_touches([_record(0, "nothing")])


def test_records_in_colour_become_touches_with_channels():
    in_colour = replace(_record(0), image=np.zeros((4, 5, 3), np.uint8))
    assert as_touches([in_colour]).channels == ("r", "g", "b")


def test_gathering_gives_up_where_nothing_is(arm, sensor, tmp_path):
    arm.radius_mm = 0.0
    with pytest.raises(RobotError, match="Only 0 of 2 touches came of 10 attempts"):
        gather(arm, sensor, RandomHemisphere(), tmp_path, n_touches=2)
    assert [record.outcome for record in read_episode(tmp_path)] == ["nothing"] * 10


def test_settings_are_readable_json(arm, sensor, tmp_path):
    gather(arm, sensor, RandomHemisphere(random_state=7), tmp_path, n_touches=1)
    kept = json.loads((tmp_path / "episode.json").read_text())
    assert "random_state=7" in kept["settings"]["strategy"]
