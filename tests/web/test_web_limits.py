"""The edges of the limits on requests, connections and names, by a set clock."""

import asyncio
from types import SimpleNamespace

import pytest
from starlette.requests import HTTPConnection, Request

from palpate.web import _request_guard
from palpate.web._request_guard import (
    OncePerMinute,
    PatientProtocol,
    RequestGuard,
    cookie_name,
    most_waiting,
)
from palpate.web._teaching import teachable_name


@pytest.fixture
def clock(monkeypatch):
    """Give a clock that a test sets."""
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(_request_guard.time, "monotonic", lambda: now.s)
    return now


def guard(rate_hz=5.0, max_body=100, names=()):
    async def app(scope, receive, send):
        raise AssertionError

    return RequestGuard(app, "t" * 20, max_body, rate_hz, names)


def connection(client="1.2.3.4", path="/api/state", query=b"", method="GET", **headers):
    named = {"host": "localhost", **headers}
    return HTTPConnection(
        {
            "type": "http",
            "method": method,
            "path": path,
            "query_string": query,
            "headers": [(k.encode(), v.encode()) for k, v in named.items()],
            "client": client and (client, 1),
            "server": ("localhost", 8765),
        }
    )


def test_twice_the_rate_at_once_and_then_the_rate(clock):
    """At 5 a second: ten, then one each 0.2 s, and ten again after a long pause."""
    limited, permits = guard(5.0), {}

    def n_let_in():
        return sum(limited._in_time(connection(), permits) for _ in range(20))

    assert n_let_in() == 10
    assert n_let_in() == 0
    clock.s += 0.125
    assert n_let_in() == 0
    clock.s += 0.125  # 1.25 permits by now
    assert n_let_in() == 1
    clock.s += 0.75  # a quarter was left
    assert n_let_in() == 4
    clock.s += 1000
    assert n_let_in() == 10


def test_one_whole_permit_lets_one_request_in(clock):
    limited, permits = guard(0.5), {}  # one at once
    assert [limited._in_time(connection(), permits) for _ in range(2)] == [True, False]
    clock.s += 2.0
    assert limited._in_time(connection(), permits)


def test_addresses_have_permits_of_their_own_up_to_a_thousand(clock):
    limited, permits = guard(0.5), {}
    for number in range(1000):
        assert limited._in_time(connection(f"host{number}"), permits)
    assert len(permits) == 1000
    assert not limited._in_time(connection("host999"), permits)
    assert limited._in_time(connection("another"), permits)  # all are forgotten
    assert len(permits) == 1
    assert limited._in_time(connection(None), permits)
    assert not limited._in_time(connection(None), permits)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"authorization": "Bearer " + "t" * 20}, None),
        ({"authorization": "bearer  " + "t" * 20 + " "}, None),
        ({"authorization": "Basic " + "t" * 20}, 401),
        ({"authorization": ""}, 401),
        ({"cookie": "palpate_token_8765=" + "t" * 20}, None),
        ({"cookie": "palpate_token_8766=" + "t" * 20}, 401),
        (
            {"authorization": "Bearer no", "cookie": "palpate_token_8765=" + "t" * 20},
            403,
        ),
    ],
)
def test_where_the_token_may_stand(headers, status):
    refusal = guard()._refusal(connection(**headers))
    assert (refusal and refusal[0]) == status
    assert cookie_name(connection()) == "palpate_token_8765"


@pytest.mark.parametrize(
    ("method", "status"), [("GET", None), ("HEAD", None), ("POST", 403), ("PUT", 403)]
)
def test_a_token_in_the_address_reads_alone(method, status):
    query = b"token=" + b"t" * 20
    refusal = guard()._refusal(connection(query=query, method=method))
    assert (refusal and refusal[0]) == status
    assert refusal is None or "Send it as Authorization: Bearer" in refusal[1]


@pytest.mark.parametrize(("n_fields", "status"), [(100, None), (101, 401)])
def test_the_token_is_looked_for_in_up_to_a_hundred_fields(n_fields, status):
    query = b"&".join([b"token=" + b"t" * 20, *[b"a=b"] * (n_fields - 1)])
    refusal = guard()._refusal(connection(query=query))
    assert (refusal and refusal[0]) == status


@pytest.mark.parametrize("path", ["/static/style.css", "/static/icon.svg"])
def test_style_and_icon_need_no_token_but_a_host_name_of_the_server(path):
    assert guard()._refusal(connection(path=path)) is None
    assert guard()._refusal(connection(path=path, host="rebound.example"))[0] == 403
    assert (
        guard(names=["Desk.Example"])._refusal(
            connection(path=path, host="desk.example:1")
        )
        is None
    )


def body_of(parts, length=None, most=100, limited=None):
    """Return what the guard reads of a body in parts, and how many parts it read."""
    read = []

    async def receive():
        if len(read) == len(parts):
            return {"type": "http.request", "body": b"", "more_body": False}
        read.append(parts[len(read)])
        return {"type": "http.request", "body": read[-1], "more_body": True}

    headers = [] if length is None else [(b"content-length", length)]
    request = Request({"type": "http", "method": "POST", "headers": headers}, receive)
    body = asyncio.run((limited or guard())._body(request, most))
    return body, len(read)


def test_a_body_may_be_as_long_as_its_limit():
    assert body_of([b"x" * 50] * 2)[0] == b"x" * 100
    assert body_of([b"x" * 50, b"x" * 51])[0] is None
    assert body_of([b"x" * 100], b"100")[0] == b"x" * 100
    assert body_of([b"x" * 10], b"101")[0] is None
    assert body_of([b"x" * 10], b"-1")[0] == b"x" * 10
    assert body_of([])[0] == b""


def test_of_a_body_too_large_ten_times_the_limit_is_read():
    """The first 100 bytes are kept, 1000 dropped, and the part that is more."""
    body, n_read = body_of([b"x" * 100] * 50)
    assert (body, n_read) == (None, 12)
    body, n_read = body_of([b"x" * 100] * 50, b"5000")
    assert (body, n_read) == (None, 11)


def test_a_body_too_large_is_not_waited_for(monkeypatch):
    """A body that was only announced is refused once nothing comes."""
    monkeypatch.setattr(_request_guard, "_DROP_S", 0.05)

    async def never():
        await asyncio.sleep(60)

    headers = [(b"content-length", b"101")]
    request = Request({"type": "http", "method": "POST", "headers": headers}, never)
    assert asyncio.run(guard()._body(request, 100)) is None
    monkeypatch.setattr(_request_guard, "_PART_S", 0.05)
    request = Request({"type": "http", "method": "POST", "headers": []}, never)
    with pytest.raises(TimeoutError):
        asyncio.run(guard()._body(request, 100))


@pytest.mark.parametrize(
    ("path", "most"),
    [
        ("/api/touch", 2**20),
        ("/api/touch/picture", 2**20),
        ("/api/teach/touch", 2**20),
        ("/api/teach/start", 2**16),
        ("/api/state", 2**16),
    ],
)
def test_images_may_be_large_and_words_may_not(path, most):
    sent, sizes = [], [most, most + 1]

    async def app(scope, receive, send):
        sent.append(len((await receive())["body"]))

    async def receive():
        return {"type": "http.request", "body": b"x" * sizes.pop(0), "more_body": False}

    async def send(message):
        sent.append(message.get("status"))

    scope = {**connection(path=path, method="POST").scope, "app": None}
    scope["headers"] += [(b"authorization", b"Bearer " + b"t" * 20)]
    limited = RequestGuard(app, "t" * 20, 2**20, 100.0)
    while sizes:
        asyncio.run(limited(scope, receive, send))
    assert sent[:2] == [most, 413]


def test_a_message_is_logged_again_after_a_minute_and_a_thousand_are_kept(clock):
    once = OncePerMinute()

    def logged(words):
        return once.filter(SimpleNamespace(getMessage=lambda: words))

    assert logged("a\n1")
    clock.s += 59.9
    assert not logged("a\n2")
    clock.s += 0.1
    assert logged("a")
    assert all(logged(str(number)) for number in range(999))
    assert not logged("a")  # one of a thousand
    assert logged("one more")  # and all are forgotten
    assert logged("a")


@pytest.mark.parametrize(("files", "most"), [(300, 100), (1024, 341), (10**6, 341)])
def test_waiting_connections_may_take_a_third_of_the_open_files(
    monkeypatch, files, most
):
    import resource

    monkeypatch.setattr(resource, "getrlimit", lambda _: (files, files))
    assert most_waiting() == most


class Waiting(PatientProtocol):
    """A connection that was made at a time, and says when it is aborted."""

    def __init__(self, made_s, signed_in, closing=False, busy=False):
        self.signed_in, self._made_s, self.aborted = signed_in, made_s, False
        self.cycle = SimpleNamespace(response_complete=not busy)
        self.transport = SimpleNamespace(is_closing=lambda: closing, abort=self._abort)

    def _abort(self):
        self.aborted = True


def test_the_oldest_of_each_kind_gives_way(monkeypatch):
    """Connections that are answered, or close already, do not count."""
    monkeypatch.setattr(_request_guard, "most_waiting", lambda: 2)
    strangers = [Waiting(made_s, False) for made_s in (5.0, 3.0, 4.0)]
    signed_in = [Waiting(made_s, True) for made_s in (1.0, 2.0)]
    others = [Waiting(0.0, True, closing=True), Waiting(0.0, True, busy=True)]
    for waiting in (*strangers, *signed_in, *others):
        waiting.connections = {*strangers, *signed_in, *others}
    strangers[0]._make_room()
    assert [waiting.aborted for waiting in strangers] == [False, True, False]
    assert not any(waiting.aborted for waiting in (*signed_in, *others))
    third = Waiting(6.0, True)
    third.connections = {*signed_in, third}
    third._make_room()
    assert [waiting.aborted for waiting in (*signed_in, third)] == [True, False, False]


@pytest.mark.parametrize(
    "name",
    [
        "",
        "  ",
        "a" * 81,
        "a\x1bb",
        "a\u202eb",
        "unknown",
        " unknown ",
        ".",
        "...",
        "?!",
    ],
)
def test_names_that_name_nothing_are_refused(name):
    with pytest.raises(ValueError, match="The name of an object must"):
        teachable_name(name)


def test_blanks_in_names_are_tidied():
    assert teachable_name("  red \t mug ") == "red mug"
    assert teachable_name("a" * 80) == "a" * 80
    for name in ("C++", "☕", "7", "+", "می\u200cخواهم"):
        assert teachable_name(name) == name
