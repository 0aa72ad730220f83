"""Touches with places: what the page shows from above, or why it shows nothing."""

import json

import numpy as np
import pytest

from palpate import ObjectRecogniser, Touches
from palpate.sensors import ReplaySensor
from palpate.web import LiveSession

from .conftest import waited

RADIUS_MM = {"disc": 60.0, "bar": 30.0}


def on_ball(radius_mm, count, rng):
    """Return tips that met a ball's upper half straight on, and their directions."""
    normals = rng.normal(size=(count, 3))
    normals[:, 2] = abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return radius_mm * normals, -normals


@pytest.fixture(scope="module")
def balls(drawn):
    """Touches of two balls with places; their pictures tell the balls apart, too."""
    rng = np.random.default_rng(3)
    rows = np.concatenate(
        [np.flatnonzero(drawn.object == name)[:20] for name in RADIUS_MM]
    )
    places = [on_ball(radius, 20, rng) for radius in RADIUS_MM.values()]
    tips, directions = (np.concatenate(part) for part in zip(*places, strict=True))
    return drawn[rows].with_columns(position_mm=tips, direction=directions)


def test_a_force_of_zero_is_measured(make_session, drawn):
    place = {"position_mm": (0, 0, 60), "direction": (0, 0, -1)}
    with make_session(sensor=False, library=None) as session:
        for force in ({"force_n": 0.0}, {"force_n": 2.0}, {}):
            session.post_touch(drawn.images[0], {**place, **force})
        forces = session.episode.as_touches().columns["force_n"]
    np.testing.assert_array_equal(forces, [0.0, 2.0, np.nan])


@pytest.fixture(scope="module")
def placed_model(tmp_path_factory, balls):
    path = tmp_path_factory.mktemp("placed") / "balls.palpate"
    ObjectRecogniser("liu2014").fit(balls).save(path)
    balls.save(path.with_suffix(".npz"))
    return path


@pytest.fixture(scope="module")
def placed(make_session, connected, placed_model):
    """A client of a model that was taught with places, its map not yet learnt."""
    session = make_session(sensor=False, model=placed_model, library=None)
    with connected(session) as client:
        yield client


@pytest.fixture
def placed_client(placed):
    """The same client, at the beginning of an episode."""
    placed.post("/api/episode/start")
    return placed


def posted(client, image, tip, direction, path="/api/touch", **more):
    place = {
        "position_mm": np.asarray(tip).tolist(),
        "direction": np.asarray(direction).tolist(),
    }
    return client.post(path, json={"image": image.tolist(), **place, **more})


def view_from_above(client):
    """Return the answer of the view from above, once the map is learnt."""

    def above():
        return client.get("/api/episode/above").json()

    assert waited(lambda: not above()["sentence"].startswith("Learning"), 60)
    return above()


def touch_the_large_ball(client, drawn, count=5, aside_mm=(0, 0, 0)):
    images = drawn.images[drawn.object == "disc"][22:]
    tips, directions = on_ball(RADIUS_MM["disc"], count, np.random.default_rng(5))
    for image, tip, direction in zip(
        images, tips + np.array(aside_mm), directions, strict=False
    ):
        assert posted(client, image, tip, direction).status_code == 200
    return tips + np.array(aside_mm)


def test_places_tell_the_ball_and_where_it_stands(placed_client, drawn):
    tips = touch_the_large_ball(placed_client, drawn, aside_mm=(8, 0, 0))
    above = view_from_above(placed_client)
    assert above["sentence"].startswith("disc on face 0, a turn that cannot be told")
    assert above["pose"]["object"] == "disc"
    # Five contacts of 1.5 mm each, of a ball learnt to about a millimetre.
    x, y, _ = above["pose"]["offset_mm"]
    assert (x, y) == (pytest.approx(8, abs=4), pytest.approx(0, abs=4))
    assert [touch["number"] for touch in above["touches"]] == [1, 2, 3, 4, 5]
    assert [touch["x_mm"] for touch in above["touches"]] == pytest.approx(tips[:, 0])
    radius_mm = max(
        np.hypot(patch["x_mm"] - x, patch["y_mm"] - y) for patch in above["surface"]
    )
    assert radius_mm == pytest.approx(RADIUS_MM["disc"], abs=4)
    assert all(patch["long_mm"] >= patch["short_mm"] > 0 for patch in above["surface"])


def test_a_new_episode_has_a_new_view_from_above(placed_client, drawn):
    assert placed_client.get("/api/episode/above").json()["touches"] == []
    image = drawn.images[drawn.object == "disc"][22]
    placed_client.post("/api/touch", json={"image": image.tolist()})
    answer = placed_client.get("/api/episode/above").json()
    empty = {"touches": [], "misses": [], "surface": []}
    assert answer == {"sentence": "", "pose": None, **empty}
    posted(placed_client, image, [0, 0, 60], [0, 0, -1])
    above = view_from_above(placed_client)
    assert above["touches"] == [{"number": 2, "x_mm": 0.0, "y_mm": 0.0}]
    kept = Touches.load(archive(placed_client))
    assert np.isnan(kept.columns["position_mm"][0]).all()
    assert kept.columns["direction"][1].tolist() == [0, 0, -1]


def archive(client):
    """Download the episode; return the file."""
    path = client.session.model_path.with_name("episode.npz")
    path.write_bytes(client.get("/api/episode/archive").content)
    return path


def test_another_unit_is_reported_and_the_touch_counts(placed_client, drawn):
    image = drawn.images[drawn.object == "disc"][22]
    answer = posted(placed_client, image, [0, 0, 60_000], [0, 0, -1])
    assert len(answer.json()["touches"]) == 1
    above = view_from_above(placed_client)
    assert "another unit or frame" in above["sentence"]
    assert above["surface"] == []


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ({"direction": None}, "go together"),
        ({"direction": [0, 0, 2]}, "length 1, got 2"),
        ({"position_mm": [0, 1]}, "position_mm"),
        ({"position_mm": [0, 0, np.nan]}, "should be a finite number"),
        ({"direction": [0, 0, np.nan]}, "should be a finite number"),
        ({"force_n": np.nan}, "should be a finite number"),
    ],
)
def test_a_wrong_place_is_refused(placed_client, drawn, place, words):
    whole = {"position_mm": [0, 0, 60], "direction": [0, 0, -1], "force_n": 1}
    body = json.dumps({"image": drawn.images[0].tolist(), **whole, **place})
    answer = placed_client.post("/api/touch", content=body.encode())
    assert answer.status_code == 422
    assert words in answer.text
    assert placed_client.get("/api/episode").json()["touches"] == []


def test_the_belief_is_by_pictures_and_places_once_the_map_is_learnt(
    placed_client, drawn
):
    posted(placed_client, drawn.images[0], [0, 0, 60], [0, 0, -1])
    view_from_above(placed_client)
    placed_client.post("/api/episode/start")
    image = drawn.images[drawn.object == "bar"][22]
    alone = placed_client.post("/api/touch", json={"image": image.tolist()}).json()
    assert "places" not in alone["sentence"]
    for _ in range(4):
        body = {"image": image.tolist()}
        pictures = placed_client.post("/api/touch", json=body).json()["touches"]
    placed_client.post("/api/episode/start")
    placed_client.post("/api/touch", json={"image": image.tolist()})
    tips, directions = on_ball(RADIUS_MM["disc"], 4, np.random.default_rng(6))
    for tip, direction in zip(tips, directions, strict=True):
        answer = posted(placed_client, image, tip, direction, force_n=1.0).json()
    assert answer["sentence"].endswith("(by pictures and places)")
    last = answer["touches"][-1]["posterior"]
    assert last["disc"] > pictures[-1]["posterior"]["disc"]
    assert answer["touches"][-1]["force_n"] == 1.0
    placed_client.post("/api/episode/start")
    again = placed_client.post("/api/touch", json={"image": image.tolist()}).json()
    assert again["sentence"] == alone["sentence"]


def test_a_miss_is_evidence_of_the_smaller_ball(placed_client, drawn):
    image = drawn.images[drawn.object == "disc"][22]
    posted(placed_client, image, [0, 0, 60], [0, 0, -1])
    view_from_above(placed_client)
    before = placed_client.get("/api/episode").json()["touches"][-1]
    body = {"position_mm": [0, 0, 40], "direction": [0, 0, -1], "miss": True}
    answer = placed_client.post("/api/touch", json=body)
    assert answer.status_code == 200
    touch = answer.json()["touches"][-1]
    assert touch["miss"]
    assert touch["note"] == "touch 2: nothing met"
    assert touch["posterior"]["bar"] > before["posterior"]["bar"]
    above = view_from_above(placed_client)
    assert above["misses"] == [{"number": 2, "x_mm": 0.0, "y_mm": 0.0}]
    path = "/api/episode/touches/2/picture"
    assert placed_client.get(path).status_code == 404
    assert len(Touches.load(archive(placed_client))) == 1
    kept = placed_client.get("/api/episode").json()["touches"][-1]
    assert (kept["miss"], kept["position_mm"]) == (True, [0, 0, 40])
    assert "nothing met" in placed_client.get("/api/episode/report").text


def test_a_miss_does_not_count_without_a_model(make_session, drawn):
    miss = {"position_mm": (0, 0, 40), "direction": (0, 0, -1)}
    with make_session(sensor=False) as session:
        assert session.post_touch(None, miss)["n_counted"] == 0
        with pytest.raises(ValueError, match="no touch yet that met something"):
            session.episode.as_touches()
        session.post_touch(drawn.images[0])
        assert session.post_touch(None, miss)["n_counted"] == 1


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"image": [[0, 1], [2, 3]]}, "must come without a picture"),
        ({"force_n": 1.0}, "no force_n"),
        ({"direction": None}, "go together"),
        ({"position_mm": None, "direction": None}, "must have position_mm"),
        ({"position_mm": [0, 0, 9e5]}, "another unit or frame"),
        ({"force_n": -1}, "force_n"),
    ],
)
def test_a_wrong_miss_is_refused(placed_client, drawn, more, words):
    posted(placed_client, drawn.images[0], [0, 0, 60], [0, 0, -1])
    view_from_above(placed_client)
    body = {"position_mm": [0, 0, 40], "direction": [0, 0, -1], "miss": True}
    answer = placed_client.post("/api/touch", json=body | more)
    assert answer.status_code in {400, 422}
    assert words in answer.text
    assert len(placed_client.get("/api/episode").json()["touches"]) == 1


def test_a_picture_has_its_place_in_the_address(placed_client, drawn):
    image = drawn.images[drawn.object == "disc"][22]
    path = placed_client.session.model_path.with_name("touch.npy")
    np.save(path, image)
    answer = placed_client.post(
        "/api/touch/picture",
        params={"position_mm": [1, 2, 3], "direction": [0, 0.6, -0.8]},
        content=path.read_bytes(),
        headers={"Content-Type": "application/x-npy"},
    )
    assert answer.status_code == 200
    (touch,) = answer.json()["touches"]
    assert (touch["position_mm"], touch["direction"]) == ([1, 2, 3], [0, 0.6, -0.8])


def test_touches_taught_with_places_make_a_map(make_session, connected, balls, drawn):
    with connected(make_session(sensor=False), rate_hz=2000) as client:
        for image, tip, direction, name in zip(
            balls.images,
            balls.columns["position_mm"],
            balls.columns["direction"],
            balls.object,
            strict=True,
        ):
            answer = posted(
                client, image, tip, direction, "/api/teach/touch", object=name
            )
            assert answer.status_code == 200
        client.session.learn(wait=True)
        stale = client.session.model_path.with_suffix(".npz")
        drawn.save(stale)  # as of a model that was there before
        touch_the_large_ball(client, drawn)
        assert view_from_above(client)["pose"]["object"] == "disc"


def test_a_replay_tells_the_places_of_its_recording(balls, placed_model):
    large = balls[np.flatnonzero(balls.object == "disc")[:3]]
    baseline = np.zeros_like(large.images[0])
    sensor = ReplaySensor(large, rate_hz=250, hold=3, gap=3, no_contact=baseline)
    with LiveSession(sensor, model=placed_model) as session:
        assert waited(lambda: len(session.episode.touches) >= 3)
    tips = [touch.position_mm for touch in session.episode.touches[:3]]
    # As stored: the first frames may be over before the sensor is followed.
    recorded = large.columns["position_mm"].tolist()
    first = recorded.index(list(tips[0]))
    assert [list(tip) for tip in tips] == (recorded[first:] + recorded[:first])
    directions = [touch.direction for touch in session.episode.touches[:3]]
    assert directions == pytest.approx(-np.array(tips) / RADIUS_MM["disc"])


def test_an_archive_that_cannot_be_read_is_reported(
    make_session, connected, placed_model, drawn, tmp_path
):
    model = tmp_path / "balls.palpate"
    model.write_bytes(placed_model.read_bytes())
    model.with_suffix(".npz").write_bytes(b"no archive")
    with connected(make_session(sensor=False, model=model, library=None)) as client:
        posted(client, drawn.images[0], [0, 0, 60], [0, 0, -1])
        assert "balls.npz" in view_from_above(client)["sentence"]


def test_a_model_without_places_says_so(make_session, connected, drawn_model, drawn):
    session = make_session(sensor=False, model=drawn_model, library=None)
    with connected(session) as client:
        posted(client, drawn.images[0], [0, 0, 60], [0, 0, -1])
        assert "taught without places" in view_from_above(client)["sentence"]


@pytest.mark.slow
def test_the_page_shows_the_view_from_above_where_a_touch_has_a_place(
    page, open_page, make_session, placed_model, drawn
):
    session = make_session(sensor=False, model=placed_model, library=None)
    images = drawn.images[drawn.object == "disc"][22:]
    with session, open_page(session):
        session.post_touch(images[0])
        page.wait_for_selector("#strip img")
        assert page.locator("#above").is_hidden()
        place = {"position_mm": (0.0, 0.0, 60.0), "direction": (0.0, 0.0, -1.0)}
        session.post_touch(images[1], place)
        page.wait_for_selector("#above ellipse", timeout=40_000)
        assert page.locator("#above circle").count() == 1
        assert "disc on face 0" in page.locator("#above-sentence").inner_text()
        session.begin_episode()
        page.wait_for_selector("#above", state="hidden")
