"""The API does what the page does: teach, recognise, undo, rename, forget, export."""

import io
import json
import re
import zlib

import numpy as np
import pytest
from PIL import Image

from palpate.library import TouchLibrary

from .conftest import waited

NPY = "application/x-npy"


@pytest.fixture(scope="module")
def shared(make_session, connected):
    """A client that teaches nothing: what it does leaves at most an episode."""
    with connected(make_session(sensor=False), max_body=400_000) as client:
        yield client


@pytest.fixture
def untaught(shared):
    """The same client, at the beginning of an episode."""
    assert shared.post("/api/episode/start").status_code == 200
    return shared


def test_the_state_is_what_was_promised(untaught):
    schemas = untaught.get("/openapi.json").json()["components"]["schemas"]
    assert {*schemas["State"]["properties"]} == {*untaught.session.to_dict()}


def picture(image, kind="PNG"):
    written = io.BytesIO()
    Image.fromarray(image).save(written, kind)
    return written.getvalue()


def npy(image, version=(1, 0)):
    written = io.BytesIO()
    np.lib.format.write_array(written, np.asarray(image), version)
    return written.getvalue()


def teach(client, drawn, name, count):
    """Store the first touches of an object; return their ids."""
    images = drawn.images[drawn.object == name][:count]
    bodies = [{"object": name, "image": image.tolist()} for image in images]
    answers = [client.post("/api/teach/touch", json=body) for body in bodies]
    assert {answer.status_code for answer in answers} == {200}
    return [answer.json()["id"] for answer in answers]


def settled(client):
    assert waited(lambda: not client.get("/api/state").json()["learning"], 60)
    return client.get("/api/state").json()


def touch(client, image):
    return client.post("/api/touch", json={"image": image.tolist()})


def test_taught_touches_are_recognised_undone_renamed_and_forgotten(client, drawn):
    for name in ("disc", "bar"):
        teach(client, drawn, name, 12)
    assert client.post("/api/teach/undo").json()["message"].endswith("bar is undone.")
    assert client.post("/api/learn").status_code == 202
    state = settled(client)
    assert state["model"]["objects"] == ["bar", "disc"]
    assert state["model"]["n_touches"] == 23
    held_out = drawn.images[drawn.object == "disc"][20:26]
    answers = [touch(client, image).json() for image in held_out]
    assert answers[-1]["best"] == "disc"
    assert [len(answer["touches"]) for answer in answers] == [1, 2, 3, 4, 5, 6]
    last = answers[-1]["touches"][-1]
    assert sum(last["posterior"].values()) + last["unknown"] == pytest.approx(1)
    _check_downloads(client, held_out)
    _check_nearest(client)
    renamed = client.post(
        "/api/objects/rename", json={"object": "disc", "name": "coin"}
    )
    assert renamed.status_code == 200
    assert settled(client)["model"]["objects"] == ["bar", "coin"]
    assert touch(client, held_out[0]).json()["best"] == "coin"
    assert client.post("/api/objects/forget", json={"object": "bar"}).status_code == 200
    state = settled(client)
    assert state["model"] is None  # one object is no model
    assert "at least two objects" in state["learn_error"]
    assert state["library"]["objects"] == [{"name": "coin", "n_touches": 12}]


def _check_downloads(client, held_out):
    archive = client.get("/api/episode/archive")
    assert "attachment" in archive.headers["content-disposition"]
    with np.load(io.BytesIO(archive.content)) as stored:
        assert (stored["images"] == held_out).all()
    report = client.get("/api/episode/report").text
    assert report.count("<img") == 6
    assert "http" not in report
    thumbnail = client.get("/api/episode/touches/1/picture")
    assert Image.open(io.BytesIO(thumbnail.content)).size == (96, 96)
    assert client.get("/api/episode/touches/99/picture").status_code == 404


def _check_nearest(client):
    nearest = client.get("/api/state").json()["nearest"]
    assert [neighbour["distance"] for neighbour in nearest] == sorted(
        neighbour["distance"] for neighbour in nearest
    )
    assert nearest[0]["object"] == "disc"
    thumbnail = client.get(f"/api/touches/{nearest[0]['id']}/picture")
    assert thumbnail.headers["content-type"] == "image/png"


def test_objects_are_merged_only_where_merge_is_true(client, drawn):
    teach(client, drawn, "disc", 2)
    teach(client, drawn, "bar", 3)
    order = {"object": "bar", "name": "disc"}
    refused = client.post("/api/objects/rename", json=order)
    assert refused.status_code == 422
    assert "must not be taken" in refused.json()["detail"]
    merged = client.post("/api/objects/rename", json={**order, "merge": True})
    assert merged.status_code == 200
    objects = client.get("/api/state").json()["library"]["objects"]
    assert objects == [{"name": "disc", "n_touches": 5}]


def test_an_acknowledged_touch_is_in_the_library(client, drawn):
    ids = teach(client, drawn, "disc", 3)
    library = TouchLibrary.open(client.session.teacher.folder)
    assert [row.id for row in library.list()] == ids
    for key, image in zip(ids, drawn.images[:3], strict=True):
        assert (library.image(key) == image).all()
    library.close()


@pytest.mark.parametrize(
    ("body", "image"),
    [
        (b'{"image":[[1,2],[3,4]]}', [[1, 2], [3, 4]]),
        (
            b' { "image" : [ [1.5 , null]\r\n,\t[-3e2,NaN] ] } ',
            [[1.5, None], [-300, None]],
        ),
    ],
    ids=["plain", "blanks"],
)
def test_numbers_are_read_however_json_is_written(untaught, body, image):
    headers = {"Content-Type": "application/json"}
    answer = untaught.post("/api/touch", content=body, headers=headers)
    assert answer.status_code == 200
    (stored,) = untaught.session.episode.images
    np.testing.assert_array_equal(stored, np.array(image, np.float32))
    assert stored.dtype == np.float32


def test_the_name_of_an_object_may_look_like_rows(client):
    headers = {"Content-Type": "application/json"}
    for number, body in enumerate(
        [
            b'{"object": "[[\\"image\\": [[9]]", "image": [[7]]}',
            b'{"image": [[7]], "object": "]],[9]"}',
        ]
    ):
        answer = client.post("/api/teach/touch", content=body, headers=headers)
        assert answer.status_code == 200
        library = client.session.teacher.library
        stored = library.image(answer.json()["id"])
        rows = library.list()
        assert len(rows) == number + 1
        assert rows[-1].object == json.loads(body)["object"]
        np.testing.assert_array_equal(stored, np.array([[7]], np.float32))


@pytest.mark.parametrize("kind", ["<u1", ">u2", "<f4", ">f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_are_touches_too(untaught, kind, order):
    image = np.asarray([[1, 2, 3], [4, 5, 6]], kind, order=order)
    headers = {"Content-Type": NPY}
    answer = untaught.post("/api/touch/picture", content=npy(image), headers=headers)
    assert answer.status_code == 200
    (stored,) = untaught.session.episode.images
    np.testing.assert_array_equal(stored, image)
    assert stored.dtype == image.dtype.newbyteorder("=")


@pytest.mark.parametrize(
    ("path", "most"),
    [
        ("/api/touch", 400_000),
        ("/api/touch/picture", 400_000),
        ("/api/teach/touch", 400_000),
        ("/api/teach", 65_536),
        ("/api/place", 65_536),
    ],
)
def test_images_may_be_large_and_words_may_not(shared, path, most):
    assert shared.post(path, content=b" " * most).status_code == 422
    answer = shared.post(path, content=b" " * (most + 1))
    assert answer.status_code == 413
    assert f"at most {most} bytes" in answer.json()["detail"]


def test_pictures_are_touches_too(client, drawn):
    image = drawn.images[0]
    kind = {"Content-Type": "image/png; q=1"}
    answer = client.post("/api/touch/picture", content=picture(image), headers=kind)
    assert answer.json()["touches"][0]["number"] == 1
    stored = client.post(
        "/api/teach/touch/picture",
        params={"object": "cup"},
        content=picture(image),
        headers=kind,
    )
    assert (client.session.teacher.library.image(stored.json()["id"]) == image).all()


def test_episodes_start_and_end(client, drawn):
    touch(client, drawn.images[0])
    assert client.post("/api/episode/end").json()["open"] is False
    assert len(touch(client, drawn.images[1]).json()["touches"]) == 1
    assert client.post("/api/episode/start").json()["touches"] == []
    # Programs get all that the page gets.
    assert [*client.get("/api/state").json()["episode"]] == [
        *client.session.episode.to_dict()
    ]


def bomb(n_rows, n_cols):
    """A PNG whose header promises more pixels than it has."""
    head = n_cols.to_bytes(4, "big") + n_rows.to_bytes(4, "big") + b"\x08\0\0\0\0"

    def chunk(kind, data):
        check = zlib.crc32(kind + data).to_bytes(4, "big")
        return len(data).to_bytes(4, "big") + kind + data + check

    pixels = zlib.compress(bytes(20))
    chunks = chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


NO_IMAGE = r"numpy\.save writes them, got \d+ other bytes"
SQUARE = np.zeros((2, 2))


@pytest.mark.parametrize(
    ("content", "kind", "message"),
    [
        (b"", "image/png", "empty"),
        (b"hello", "image/png", "neither JPEG nor PNG"),
        (
            picture(np.zeros((12, 12), np.uint8))[:-20],
            "image/png",
            "cut short|checksum",
        ),
        (
            picture(np.zeros((64, 64), np.uint8), "JPEG")[:300],
            "image/jpeg",
            "cut short",
        ),
        (bomb(30_000, 30_000), "image/png", "pixels"),
        (bomb(2001, 2000), "image/png", "at most 4000000 pixels"),
        (bomb(12, 12), "image/png", "decoded|damaged|cut"),
        (b"GIF89a", "image/gif", "image/png, image/jpeg or .*'image/gif'"),
        (b"x", "", "image/png, image/jpeg or"),
        (b"", NPY, NO_IMAGE),
        (npy(SQUARE)[:6], NPY, NO_IMAGE),
        (npy(SQUARE)[:20], NPY, NO_IMAGE),
        (npy(SQUARE)[:-1], NPY, NO_IMAGE),
        (npy(SQUARE) + b"x", NPY, NO_IMAGE),
        (npy(SQUARE) + b"x" * 8, NPY, NO_IMAGE),
        (npy(SQUARE, version=(2, 0)), NPY, NO_IMAGE),
        (npy(SQUARE).replace(b"}", b" "), NPY, NO_IMAGE),
        (npy(SQUARE).replace(b"(2, 2)", b"(9, 9)"), NPY, NO_IMAGE),
        (npy(SQUARE).replace(b"(2, 2), }", b"(True,2)}"), NPY, NO_IMAGE),
        (npy(SQUARE).replace(b"'descr': '<f8'", b"'descr': 3    "), NPY, NO_IMAGE),
        (npy([["a"]]), NPY, "whole numbers or floats"),
        (npy(SQUARE * 1j), NPY, "whole numbers or floats"),
        (npy(np.zeros(4)), NPY, "n_rows, n_cols"),
        (npy(np.zeros((0, 2))), NPY, "n_rows, n_cols"),
        (npy(np.zeros((2, 2, 65))), NPY, "at most 64 channels"),
        (npy([[np.inf]]), NPY, "finite"),
        (npy(SQUARE * np.nan), NPY, "at least one number, got only NaN"),
        (npy(np.full((2, 2, 3), np.nan)), NPY, "at least one number, got only NaN"),
    ],
)
@pytest.mark.parametrize("path", ["/api/touch/picture", "/api/teach/touch/picture"])
def test_hostile_pictures_are_refused(shared, path, content, kind, message):
    headers = {"Content-Type": kind}
    params = {"object": "x"} if "teach" in path else {}
    answer = shared.post(path, content=content, headers=headers, params=params)
    assert answer.status_code == 422
    assert re.search(message, answer.json()["detail"])
    assert "/tmp" not in answer.json()["detail"]
    assert shared.get("/api/state").json()["library"]["objects"] == []


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"{}",
        b"\xff\xfe",
        b"[" * 5000,
        b'{"image": []}',
        b'{"image": [[]]}',
        b'{"image": [[1]',
        b'{"image": [[1]]',
        b'{"image": [["1"]]}',
        b'{"image": [[true]]}',
        b'{"image": [[1e39]]}',
        b'{"image": [[1e999]]}',
        b'{"image": 3, "more": 4}',
        b'{"image": [[1]], "more": 4}',
        b'{"image": [[1]], "image": 2}',
        b'{"image": [[1] [2]]}',
        b'{"image": [[1], 2]}',
        b'{"image": [[[null]]]}',
        b'[{"image": [[1]]}]',
        b'{"a": {"image": [[1]]}}',
        b'{"object": "unknown", "image": [[1]]}',
        b'{"object": "\\ud800", "image": [[1]]}',
        b'{"image": [[' + b"9" * 5000 + b"]]}",
        b'{"image": [[' + b"[" * 50_000 + b"]]}",
        json.dumps({"image": [[0] * 4097]}).encode() * 2,
    ],
)
@pytest.mark.parametrize("path", ["/api/touch", "/api/teach/touch", "/api/teach"])
def test_hostile_bodies_are_refused(shared, path, body):
    headers = {"Content-Type": "application/json"}
    answer = shared.post(path, content=body, headers=headers)
    assert answer.status_code in (400, 422)
    assert "detail" in answer.json()


def test_an_image_must_suit_those_before_it(client, drawn):
    teach(client, drawn, "disc", 1)
    wide = client.post("/api/touch", json={"image": [[0, 0]]})
    assert "12 x 12 taxels, got 1 x 2" in wide.json()["detail"]
    uneven = client.post("/api/touch", json={"image": [[0, 1], [2], [3, 4]]})
    assert "something else at row 2" in uneven.json()["detail"]
    image = drawn.images[0].astype(float).tolist()
    assert client.post("/api/touch", json={"image": image}).status_code == 200


@pytest.mark.parametrize(
    ("method", "path", "body", "status", "words"),
    [
        ("GET", "frame", None, 409, "no sensor"),
        ("POST", "baseline", {"force": False}, 409, "no sensor"),
        ("POST", "zero", {"force": False}, 409, "no sensor"),
        ("POST", "teach", {"object": "cup"}, 409, "no sensor here"),
        ("POST", "place", {"object": "mug"}, 422, "cannot be chosen"),
        ("POST", "teach/undo", None, 422, "no touch to undo"),
        ("GET", "episode/archive", None, 422, "no touch yet"),
        ("GET", "episode/report", None, 422, "no touch yet"),
        ("GET", "touches/zz/picture", None, 404, "zz"),
        ("GET", "objects/touches?object=hat", None, 404, "no object 'hat'"),
        ("GET", "objects/archive?object=hat", None, 404, "no object 'hat'"),
        ("POST", "objects/forget", {"object": "hat"}, 404, "no object 'hat'"),
        ("POST", "objects/rename", {"object": "hat", "name": "cap"}, 404, "'hat'"),
    ],
)
def test_what_this_server_cannot_do_is_refused_with_the_reason(
    untaught, method, path, body, status, words
):
    answer = untaught.request(method, f"/api/{path}", json=body)
    assert answer.status_code == status
    assert words in answer.json()["detail"]
    assert untaught.get("/api/state").json()["lesson"] is None


@pytest.mark.parametrize(
    ("path", "query"),
    [
        ("touch/picture", "position=1"),  # is called position_mm
        ("touch", "position_mm=0"),  # is read from the body
        ("touch/picture", "colour=maybe"),
    ],
)
def test_what_would_be_passed_over_in_an_address_is_refused(untaught, path, query):
    how = {"content": picture(np.eye(12, dtype=np.uint8))}
    how["headers"] = {"Content-Type": "image/png"}
    if path == "touch":
        how = {"json": {"image": np.eye(12).tolist()}}
    answer = untaught.post(f"/api/{path}?{query}", **how)
    assert answer.status_code == 422
    assert query.partition("=")[0] in str(answer.json()["detail"])
    assert untaught.get("/api/episode").json()["touches"] == []


def test_with_nothing_to_compare_the_first_touch_decides(client):
    def sent(side):
        body = {"image": np.eye(side).tolist()}
        return client.post("/api/touch", json=body)

    assert sent(12).status_code == 200
    answer = sent(16)
    assert answer.status_code == 422
    assert answer.json()["detail"] == "The image must have 12 x 12 taxels, got 16 x 16."
    assert sent(12).json()["n_counted"] == 2
    assert client.get("/api/episode/archive").status_code == 200
    client.post("/api/episode/end")
    assert sent(16).json()["n_counted"] == 1


def test_without_a_library_nothing_is_taught(make_session, connected):
    with connected(make_session(sensor=False, library=None)) as client:
        answer = client.post("/api/teach", json={"object": "cup"})
        assert answer.status_code == 409
        assert "`library=FOLDER`" in answer.json()["detail"]
        assert client.get("/api/objects/touches?object=cup").status_code == 409


@pytest.mark.parametrize(
    ("path", "more"), [("touch", {}), ("teach/touch", {"object": "disc"})]
)
def test_numbers_that_are_all_null_are_refused_at_the_door(shared, path, more):
    answer = shared.post(f"/api/{path}", json={"image": [[None] * 8] * 8, **more})
    assert answer.status_code == 422
    assert "got only NaN (null in JSON)" in answer.json()["detail"]
    assert shared.get("/api/state").json()["library"]["objects"] == []
