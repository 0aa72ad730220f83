"""A disk without room: one sentence names the output; the old file stays."""

import errno
import os
import signal
from contextlib import contextmanager

import pytest

from palpate import Touches

resource = pytest.importorskip("resource")


@contextmanager
def no_room():
    """Let no file of this process grow over 500 bytes."""
    kind = resource.RLIMIT_FSIZE
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN), resource.getrlimit(kind)
    resource.setrlimit(kind, (500, before[1][1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before[1])
        signal.signal(signal.SIGXFSZ, before[0])


@pytest.mark.parametrize(
    ("verb", "name"),
    [
        ("learn {} -o", "m.palpate"),
        ("evaluate --train {} --split last --touches 1 --orders 2 --report", "r.html"),
    ],
)
def test_an_output_without_room_is_refused_and_the_old_file_stays(
    palpate, tmp_path, rng, verb, name
):
    archive, target = tmp_path / "touches.npz", tmp_path / name
    images = rng.uniform(0, 9, (24, 8, 8))
    Touches(images, object=["a", "b"] * 12, geometry="array").save(archive)
    target.write_bytes(b"old")
    with no_room():
        refused = palpate.refusal(*verb.format(archive).split(), target)
    assert f"{target} must be a place with room" in refused
    assert os.strerror(errno.EFBIG) in refused
    assert "Free space" in refused
    assert target.read_bytes() == b"old"
    assert {path.name for path in tmp_path.iterdir()} == {archive.name, name}
