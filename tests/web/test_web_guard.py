"""No client comes in without the token, and none may send too much."""

import json
import logging
import socket
import threading
import time
from contextlib import ExitStack, closing, suppress
from http.client import HTTPConnection
from types import SimpleNamespace

import httpx
import pytest
from uvicorn.protocols.http.h11_impl import H11Protocol
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from palpate.library import TouchLibrary
from palpate.web import PageServer, create_app

TOKEN = "right-token"
BEARER = {"Authorization": f"Bearer {TOKEN}"}


@pytest.fixture
def clock(monkeypatch):
    """Give a clock of the guard that a test sets."""
    now = SimpleNamespace(s=100.0, monotonic=lambda: now.s)
    monkeypatch.setattr("palpate.web._request_guard.time", now)
    return now


@pytest.fixture(scope="module")
def client(make_session, connected):
    """A client that does not know the token."""
    session = make_session(sensor=False)
    with connected(
        session, TOKEN, signed_in=False, max_body=10_000, rate_hz=5000
    ) as client:
        yield client


def socket_address(client, query=""):
    return f"{client.base_url}/ws{query}".replace("http", "ws")


@pytest.fixture(scope="module")
def every_address(client):
    """Every path the application answers, API, page and files alike."""
    described = create_app(client.session, TOKEN).openapi()["paths"]
    paths = [
        (method, path) for path, methods in described.items() for method in methods
    ]
    more = ["/", "/static/app.js", "/openapi.json", "/nowhere"]
    return [*paths, *(("get", path) for path in more)]


def test_without_the_token_everything_is_refused(client, every_address):
    client.cookies.clear()
    assert len(every_address) > 20
    for method, path in every_address:
        answer = client.request(method, path)
        assert answer.status_code == 401, path
        assert "token is missing" in answer.json()["detail"]


@pytest.mark.parametrize(
    "wrong", ["wrong", TOKEN[:-1], TOKEN + "x", "é", TOKEN.upper()]
)
def test_with_a_wrong_token_everything_is_refused(client, every_address, wrong):
    client.cookies.clear()
    for method, path in every_address:
        answer = client.request(method, path, params={"token": wrong})
        assert answer.status_code == 403, path
    header = {"Authorization": b"Bearer " + wrong.encode()}
    assert client.get("/api/state", headers=header).status_code == 403
    name = f"palpate_token_{client.base_url.port}=".encode()
    cookie = {"Cookie": name + wrong.encode()}
    assert client.get("/api/state", headers=cookie).status_code == 403


@pytest.mark.parametrize("query", ["", "?token=wrong"])
def test_the_websocket_asks_for_the_token_too(client, query):
    with pytest.raises(InvalidStatus, match="HTTP 403"):
        connect(socket_address(client, query))


def test_the_right_token_opens_by_header_query_and_cookie(client):
    assert client.get("/api/state", headers=BEARER).status_code == 200
    assert client.get(f"/api/state?token={TOKEN}").status_code == 200
    page = client.get(f"/?token={TOKEN}")
    assert page.status_code == 200
    assert "<title>palpate" in page.text
    assert client.get("/static/app.js").status_code == 200  # by the cookie
    (name,) = client.cookies
    assert name == f"palpate_token_{client.base_url.port}"  # cookies know no ports
    cookie = {"Cookie": f"{name}={client.cookies[name]}"}
    with connect(socket_address(client), additional_headers=cookie) as socket:
        assert json.loads(socket.recv())["kind"] == "state"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"authorization": f"bearer  {TOKEN}"}, 200),
        ({"authorization": f"Basic {TOKEN}"}, 401),
        ({"authorization": ""}, 401),
        ({"cookie": f"palpate_token_1={TOKEN}"}, 401),  # of another port
        ({"authorization": "Bearer no", "cookie": f"{{name}}={TOKEN}"}, 403),
    ],
)
def test_where_the_token_may_stand(client, headers, status):
    client.cookies.clear()
    name = f"palpate_token_{client.base_url.port}"
    sent = {key: value.format(name=name) for key, value in headers.items()}
    assert client.get("/api/state", headers=sent).status_code == status


@pytest.mark.parametrize(
    ("method", "status"), [("GET", 200), ("HEAD", 405), ("POST", 403), ("PUT", 403)]
)
def test_a_token_in_the_address_reads_alone(client, method, status):
    client.cookies.clear()
    answer = client.request(method, f"/api/state?token={TOKEN}")
    assert answer.status_code == status
    assert status != 403 or "Send it as Authorization: Bearer" in answer.text


@pytest.mark.parametrize(("n_fields", "status"), [(100, 200), (101, 401)])
def test_the_token_is_looked_for_in_up_to_a_hundred_fields(client, n_fields, status):
    client.cookies.clear()
    query = "&".join([f"token={TOKEN}", *["a=b"] * (n_fields - 1)])
    assert client.get(f"/api/state?{query}").status_code == status


def test_a_link_on_another_site_gets_the_page_and_the_cookie_at_once(client):
    """A strict cookie is not sent along with a redirect that another site caused."""
    client.cookies.clear()
    headers = {"Sec-Fetch-Site": "cross-site", "Accept": "text/html"}
    page = client.get(f"/?token={TOKEN}", headers=headers, follow_redirects=False)
    assert page.status_code == 200
    cookie = page.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie


@pytest.mark.parametrize(
    "origin", ["http://elsewhere.example", "http://[", "null", "", "file://"]
)
def test_pages_of_other_sites_are_refused(client, origin):
    foreign = {**BEARER, "Origin": origin}
    answer = client.post("/api/episode/start", headers=foreign)
    assert answer.status_code == 403
    assert "other sites" in answer.json()["detail"]
    same_site = {**BEARER, "Origin": str(client.base_url)}
    assert client.post("/api/episode/start", headers=same_site).status_code == 200


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:{port}", 200),
        ("[::1]:{port}", 200),
        ("192.168.7.9", 200),  # a number was not looked up: no rebinding
        ("LOCALHOST:{port}", 200),
        (socket.gethostname(), 200),
        ("rebound.example:{port}", 403),
        ("127.0.0.1.rebound.example", 403),
        ("localhost@rebound.example", 403),
        ("[", 403),
        ("", 403),
    ],
)
def test_only_names_of_this_server_are_answered(client, host, status):
    headers = {**BEARER, "Host": host.format(port=client.base_url.port)}
    assert client.get("/api/health", headers=headers).status_code == status


def test_a_host_name_that_was_given_is_answered(make_session, connected):
    with connected(make_session(sensor=False), names=["Desk.Example"]) as client:
        for host, status in (("desk.example:1", 200), ("other.example", 403)):
            headers = {"Host": host}
            assert client.get("/api/health", headers=headers).status_code == status


@pytest.mark.parametrize("token", [None, "wrong"])
def test_a_browser_is_asked_for_the_token_by_a_page(client, token):
    client.cookies.clear()
    params = {} if token is None else {"token": token}
    browser = {"Accept": "text/html,application/xhtml+xml"}
    page = client.get("/", params=params, headers=browser)
    assert page.status_code == (401 if token is None else 403)
    assert page.headers["content-type"].startswith("text/html")
    assert 'name="token"' in page.text


@pytest.mark.parametrize("path", ["/static/style.css", "/static/icon.svg"])
def test_style_and_icon_need_no_token_but_a_host_name_of_the_server(client, path):
    client.cookies.clear()
    assert client.get(path).status_code == 200
    assert client.get(path, headers={"Host": "rebound.example"}).status_code == 403


@pytest.mark.parametrize("path", ["/", "/static/app.js", "/api/state"])
@pytest.mark.parametrize("headers", [{}, BEARER], ids=["refused", "answered"])
def test_every_answer_says_what_a_browser_may_do(client, path, headers):
    client.cookies.clear()
    rules = client.get(path, headers=headers).headers
    assert rules["content-security-policy"].startswith("default-src 'none'")
    assert "http" not in rules["content-security-policy"]  # nothing from elsewhere
    assert rules["x-content-type-options"] == "nosniff"
    assert rules["cross-origin-resource-policy"] == "same-origin"
    assert rules["cache-control"] == "no-store"


def test_half_a_request_is_not_waited_for(make_session, connected, monkeypatch):
    monkeypatch.setattr("palpate.web._request_guard._HEAD_S", 0.2)
    monkeypatch.setattr("palpate.web._request_guard._PART_S", 0.2)
    whole = b"GET /static/style.css HTTP/1.1\r\nHost: localhost\r\n\r\n"
    head = whole[:-2].replace(b"GET", b"POST") + b"Content-Length: 9\r\n\r\n1234"
    # Half a request after an answer has as long as uvicorn keeps the connection.
    with connected(make_session(sensor=False), keep_alive_s=0.3) as client:
        address = client.base_url.host, client.base_url.port
        for sent in (b"", b"GET / HTTP/1.1\r\nHo", whole + b"GET /"):
            with socket.create_connection(address, timeout=30) as half:
                half.sendall(sent)
                while half.recv(65536):  # to its end, or TimeoutError
                    pass
        with socket.create_connection(address, timeout=30) as half:
            half.sendall(head)
            assert half.recv(65536).startswith(b"HTTP/1.1 408")


def test_a_slow_request_that_ends_in_time_is_answered(client):
    address = client.base_url.host, client.base_url.port
    with socket.create_connection(address, timeout=5) as slow:
        for part in (b"GET /static/style.css HT", b"TP/1.1\r\nHost: ::1\r\n", b"\r\n"):
            slow.sendall(part)
        assert slow.recv(100).startswith(b"HTTP/1.1 403")  # ::1 needs brackets


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


@pytest.mark.parametrize(
    ("path", "is_large"),
    [("touch", True), ("teach/touch/picture", True), ("touches/remove", False)],
)
def test_only_images_may_be_large(make_session, connected, path, is_large):
    with connected(make_session(sensor=False), max_body=10**6) as client:
        answer = client.post(f"/api/{path}", content=b"x" * 70_000)
        assert (answer.status_code != 413) == is_large


def test_a_body_that_would_be_too_large_is_not_waited_for(client):
    head = (
        "POST /api/touch HTTP/1.1\r\nHost: localhost\r\nContent-Length: 10001\r\n"
        f"Authorization: Bearer {TOKEN}\r\n\r\n"
    )
    address = client.base_url.host, client.base_url.port
    with socket.create_connection(address, timeout=10) as half:
        half.sendall(head.encode())
        assert half.recv(65536).startswith(b"HTTP/1.1 413")


def test_no_answer_is_held_back_until_the_one_before_is_acknowledged(make_session):
    """Nagle's algorithm would add 40 ms to every answer but the first."""
    options = []

    class Taking(H11Protocol):
        def connection_made(self, transport):
            accepted = transport.get_extra_info("socket")
            options.append(accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            super().connection_made(transport)

    app = create_app(make_session(sensor=False), TOKEN)
    with PageServer().running(app, http=Taking, log_level="error") as address:
        assert httpx.get(f"{address}api/health", headers=BEARER).status_code == 200
    assert options == [1]


@pytest.mark.parametrize("token", ["", None])
def test_an_application_without_a_token_is_refused(make_session, token):
    """An empty cookie would be the right one."""
    with pytest.raises(ValueError, match="token must be a text that is not empty"):
        create_app(make_session(sensor=False), token)
    with pytest.raises(ValueError, match="session must be one or more, got none"):
        create_app([], TOKEN)


def page_token(library=None, token=None):
    with closing(PageServer(library=library, token=token)) as server:
        return server.token


def test_a_library_keeps_its_token_for_its_owner_alone(tmp_path):
    TouchLibrary.open(tmp_path / "library", create=True).close()
    token = page_token(tmp_path / "library")
    assert page_token(tmp_path / "library") == token
    kept = tmp_path / "library" / "page.token"
    assert kept.stat().st_mode & 0o777 == 0o600
    kept.chmod(0o644)  # others may have read it: it is no secret any more
    assert page_token(tmp_path / "library") != token
    assert kept.stat().st_mode & 0o777 == 0o600
    with TouchLibrary.open(tmp_path / "library") as library:
        assert library.check().ok


@pytest.mark.parametrize("token", ["short", "x" * 15, "x" * 201, "a b" * 9, "é" * 20])
def test_a_token_that_is_easily_guessed_or_sent_wrongly_is_refused(token):
    with pytest.raises(ValueError, match=r"16 to 200 letters.*Leave it out") as refused:
        page_token(token=token)
    assert token not in str(refused.value)


def test_tokens_are_long_and_never_alike():
    tokens = {page_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 32  # 24 bytes in base64


def test_idle_connections_give_way_to_whoever_comes(
    make_session, connected, monkeypatch
):
    """The oldest without a token are closed; one that has shown it is kept."""
    monkeypatch.setattr("palpate.web._request_guard.most_waiting", lambda: 5)
    with connected(make_session(sensor=False)) as client, ExitStack() as stack:
        address = client.base_url.host, client.base_url.port
        headers = {"Authorization": "Bearer token"}
        signed_in = HTTPConnection(*address, timeout=30)
        stack.callback(signed_in.close)

        def answered():
            signed_in.request("GET", "/api/health", headers=headers)
            return b"rate_hz" in signed_in.getresponse().read()

        assert answered()
        connections = [
            stack.enter_context(socket.create_connection(address, timeout=30))
            for _ in range(12)
        ]
        for closed in connections[:7]:
            with suppress(ConnectionResetError):
                assert closed.recv(1) == b""
        for connection in connections[7:]:
            connection.setblocking(False)
            with pytest.raises(BlockingIOError):
                connection.recv(1)
        assert answered()
        assert client.get("/api/health").status_code == 200


@pytest.mark.parametrize("first", ["wrong", "right"])
def test_twice_the_rate_is_answered_at_once_and_then_the_rate(
    make_session, connected, clock, first
):
    """With and without the token apart: who was slowed down learns that it is wrong."""
    status = {"wrong": 403, "right": 200}
    (second,) = {*status} - {first}
    with connected(make_session(sensor=False), TOKEN, rate_hz=5) as client:

        def n_answered(word):
            headers = {"Authorization": f"Bearer {word}-token"}
            answers = [client.get("/api/health", headers=headers) for _ in range(20)]
            assert answers[-1].headers["retry-after"] == "1"
            codes = [answer.status_code for answer in answers]
            count = codes.count(status[word])
            assert codes == [status[word]] * count + [429] * (20 - count)
            return count

        assert n_answered(first) == 10
        assert n_answered(first) == 0
        clock.s += 0.125
        assert n_answered(first) == 0
        clock.s += 0.125  # 1.25 permits by now
        assert n_answered(first) == 1
        clock.s += 0.75  # a quarter was left
        assert n_answered(first) == 4
        clock.s += 1000
        assert n_answered(first) == 10
        assert n_answered(second) == 10


def test_a_repeated_error_is_logged_once_a_minute(
    make_session, connected, caplog, clock
):
    log = logging.getLogger("asyncio")
    before = [*log.filters]
    with connected(make_session(sensor=False)):
        for clock.s in (0.0, 59.9, 60.0):
            log.error("accept() failed\nsocket %s", clock.s)
            log.error("something else %s", clock.s)
        for number in range(996):  # a thousand messages are remembered
            assert log.filter(logging.makeLogRecord({"msg": str(number)}))
        log.error("accept() failed")
        log.error("one more")  # and all are forgotten
        log.error("accept() failed")
    messages = [record.getMessage().partition("\n")[0] for record in caplog.records]
    assert messages.count("accept() failed") == 3
    assert messages[-2:] == ["one more", "accept() failed"]
    assert len(messages) == 7
    assert log.filters == before


def test_a_picture_that_takes_too_long_holds_up_nothing_else(
    make_session, connected, monkeypatch
):
    go_on = threading.Event()
    monkeypatch.setattr("palpate.web._routes.PICTURES._limit_s", 0.2)
    monkeypatch.setattr(
        "palpate.web._routes.read_picture", lambda *_: go_on.wait(30) and None
    )
    kind = {"Content-Type": "image/jpeg"}
    with connected(make_session(sensor=False)) as client:
        try:
            for _ in range(8):  # four are being read, the others wait
                answer = client.post("/api/touch/picture", content=b"x", headers=kind)
                assert answer.status_code == 503
                assert "took more than 0.2 s" in answer.json()["detail"]
                assert answer.headers["retry-after"] == "1"
            taught = {"object": "disc", "image": [[1.0, 2.0], [3.0, 4.0]]}
            assert client.post("/api/teach/touch", json=taught).status_code == 200
            with connect(socket_address(client, "?token=token")) as page:
                assert json.loads(page.recv())["kind"] == "state"
        finally:
            go_on.set()


def test_a_connection_is_not_closed_while_it_is_answered(
    make_session, connected, monkeypatch
):
    """The limit is for heads: an answer, and a websocket, may take longer."""
    monkeypatch.setattr("palpate.web._request_guard._HEAD_S", 0.2)
    monkeypatch.setattr(
        "palpate.web._routes.read_json", lambda _: time.sleep(0.8) or ({}, None)
    )
    slow = connected(make_session(sensor=False))
    with slow as client, connect(socket_address(client, "?token=token")) as page:
        assert json.loads(page.recv())["kind"] == "state"
        answer = client.post("/api/touch", content=b"{}")
        assert answer.status_code == 422
        page.send("ping")
        kinds = []
        while "pong" not in kinds:
            kinds.append(json.loads(page.recv(20))["kind"])
