"""Nobody comes in without the token, and nobody brings too much."""

import json

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from palpate.web import create_app, new_token

TOKEN = "right-token"
BEARER = {"Authorization": f"Bearer {TOKEN}"}


@pytest.fixture(scope="module")
def client(make_session, connected):
    """A client that does not know the token."""
    session = make_session(sensor=False)
    with connected(
        session, TOKEN, known=False, max_body=10_000, rate_hz=5000
    ) as client:
        yield client


def socket_address(client, query=""):
    return f"{client.base_url}/ws{query}".replace("http", "ws")


def every_address(client):
    """Every path the application answers, API, page and files alike."""
    described = create_app(client.session, TOKEN).openapi()["paths"]
    paths = [(method, path) for path, ways in described.items() for method in ways]
    more = ["/", "/static/app.js", "/openapi.json", "/nowhere"]
    return [*paths, *(("get", path) for path in more)]


def test_without_the_token_everything_is_refused(client):
    client.cookies.clear()
    addresses = every_address(client)
    assert len(addresses) > 20
    for method, path in addresses:
        answer = client.request(method, path)
        assert answer.status_code == 401, path
        assert "token is missing" in answer.json()["detail"]


@pytest.mark.parametrize(
    "wrong", ["wrong", TOKEN[:-1], TOKEN + "x", "é", TOKEN.upper()]
)
def test_with_a_wrong_token_everything_is_refused(client, wrong):
    client.cookies.clear()
    for method, path in every_address(client):
        answer = client.request(method, path, params={"token": wrong})
        assert answer.status_code == 403, path
    header = {"Authorization": b"Bearer " + wrong.encode()}
    assert client.get("/api/state", headers=header).status_code == 403
    cookie = {"Cookie": b"palpate_token=" + wrong.encode()}
    assert client.get("/api/state", headers=cookie).status_code in (401, 403)


@pytest.mark.parametrize("query", ["", "?token=wrong"])
def test_the_websocket_asks_for_the_token_too(client, query):
    with pytest.raises(InvalidStatus, match="HTTP 403"):
        connect(socket_address(client, query))


def test_the_right_token_opens_by_header_query_and_cookie(client):
    assert client.get("/api/state", headers=BEARER).status_code == 200
    assert client.get(f"/api/state?token={TOKEN}").status_code == 200
    page = client.get(f"/?token={TOKEN}")
    assert page.status_code == 200
    assert page.url.query == b""  # the token is not left in the address
    assert "<title>palpate" in page.text
    assert client.get("/static/app.js").status_code == 200  # by the cookie
    cookie = {"Cookie": f"palpate_token={client.cookies['palpate_token']}"}
    with connect(socket_address(client), additional_headers=cookie) as socket:
        assert json.loads(socket.recv())["kind"] == "state"


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(client):
    answer = client.get(f"/?token={TOKEN}", follow_redirects=False)
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie


def test_pages_of_other_sites_are_refused(client):
    foreign = {**BEARER, "Origin": "http://elsewhere.example"}
    assert client.post("/api/episode/start", headers=foreign).status_code == 403
    own = {**BEARER, "Origin": str(client.base_url)}
    assert client.post("/api/episode/start", headers=own).status_code == 200


def test_nothing_may_be_loaded_from_elsewhere(client):
    answer = client.get("/", headers=BEARER)
    rules = answer.headers["content-security-policy"]
    assert rules.startswith("default-src 'none'")
    assert "http" not in rules
    assert answer.headers["cache-control"] == "no-store"


def test_a_body_that_is_too_large_is_refused(client):
    big = b"x" * 10_001
    answer = client.post("/api/touch", content=big, headers=BEARER)
    assert answer.status_code == 413
    assert "at most 10000 bytes" in answer.json()["detail"]

    def pieces():  # no content-length to go by
        for _ in range(100):
            yield b"x" * 1000

    for _ in range(5):  # the answer must not be lost while the body still comes
        answer = client.post("/api/touch", content=pieces(), headers=BEARER)
        assert answer.status_code == 413
        assert "at most 10000 bytes" in answer.json()["detail"]


def test_too_many_requests_are_slowed_down(make_session, connected):
    with connected(make_session(sensor=False), rate_hz=5) as client:
        answers = [client.get("/api/health") for _ in range(30)]
    codes = [answer.status_code for answer in answers]
    assert codes[:10] == [200] * 10  # twice the rate at once
    assert 429 in codes
    assert answers[codes.index(429)].headers["retry-after"] == "1"


def test_tokens_are_long_and_never_alike():
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 32  # 24 bytes in base64
