"""A disk without room: the answer is 507, never a fault of the server."""

import errno
import io
import shutil
import sqlite3

import pytest
from PIL import Image

from palpate.library import LibraryError


def full(*arguments, **options):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_pictures_need_no_room_on_the_disk(client, drawn, monkeypatch):
    monkeypatch.setattr("tempfile.TemporaryDirectory", full)
    written = io.BytesIO()
    Image.fromarray(drawn.images[0]).save(written, "PNG")
    kind = {"Content-Type": "image/png"}
    answer = client.post("/api/touch/picture", content=written.getvalue(), headers=kind)
    assert answer.status_code == 200
    archive = client.get("/api/episode/archive")
    assert archive.status_code == 507
    assert "No space left on device" in archive.json()["detail"]


@pytest.mark.parametrize("failing", ["add", "retract"])
def test_a_move_that_fails_moves_nothing(failing, make_session, folder, monkeypatch):
    with make_session(sensor=False, library=folder) as session:
        library, n_calls = session.teacher.library, []
        plain = getattr(library, failing)

        def fail(*arguments, **options):
            n_calls.append(failing)
            if len(n_calls) == (2 if failing == "add" else 1):
                raise LibraryError("The library has no room. Free space.")
            return plain(*arguments, **options)

        monkeypatch.setattr(library, failing, fail)
        keys = [row.id for row in session.teacher.newest("disc", 2)]
        with pytest.raises(LibraryError, match="no room"):
            session.move_touches(keys, "bar")
        objects = session.to_dict()["library"]["objects"]
        assert [counted["n_touches"] for counted in objects] == [8, 8]
        assert session.move_touches(keys, "bar") == "2 touches of disc moved to bar."


def test_a_given_model_is_kept_whole_or_not_at_all(make_session, folder, drawn_model):
    resource = pytest.importorskip("resource", reason="limits are of POSIX")
    model = folder.parent / "given.palpate"
    before = shutil.copyfile(drawn_model, model).read_bytes()
    _, most = limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with make_session(sensor=False, library=folder, model=model) as session:
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, most))
        try:
            session.learn(wait=True)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert "File too large" in session.learn_error
        assert not session.given_model.exists()
        assert model.read_bytes() == before
        session.learn(wait=True)
        assert session.learn_error == ""
        assert session.given_model.read_bytes() == before


@pytest.fixture
def causes():
    """What the system and SQLite raise without room, and nothing of the kind."""
    small = sqlite3.connect(":memory:")
    small.execute("CREATE TABLE t (x)")
    small.execute("PRAGMA max_page_count = 2")
    with pytest.raises(sqlite3.OperationalError) as caught:
        small.execute("INSERT INTO t VALUES (zeroblob(100000))")
    small.close()
    full_disk = OSError(errno.ENOSPC, "No space left on device")
    return {"disk": full_disk, "database": caught.value, "other": None}


@pytest.mark.parametrize(
    ("cause", "status"), [("disk", 507), ("database", 507), ("other", 422)]
)
def test_a_touch_that_cannot_be_stored_is_not_acknowledged(
    client, drawn, monkeypatch, causes, cause, status
):
    def add(**options):
        raise LibraryError("The library has no room. Free space.") from causes[cause]

    monkeypatch.setattr(client.session.teacher.library, "add", add)
    body = {"object": "cup", "image": drawn.images[0].tolist()}
    answer = client.post("/api/teach/touch", json=body)
    assert answer.status_code == status
    assert answer.json()["detail"] == "The library has no room. Free space."
    assert client.get("/api/state").json()["library"]["undoable"] == 0
