"""The edges of the limits on connections, bodies and names, without a server."""

import asyncio
from types import SimpleNamespace

import pytest
from starlette.requests import HTTPConnection, Request

from palpate.web import LiveSession, _request_guard
from palpate.web._request_guard import PatientProtocol, RequestGuard, most_waiting

LIMITED = RequestGuard(None, "token", max_body=100, rate_hz=0.5)


def test_addresses_have_permits_of_their_own_up_to_a_thousand(monkeypatch):
    monkeypatch.setattr(_request_guard.time, "monotonic", lambda: 100.0)
    permits = {}

    def let_in(host):
        scope = {"type": "http", "client": host and (host, 1)}
        return LIMITED._in_time(HTTPConnection(scope), permits)

    assert all(let_in(f"host{number}") for number in range(1000))
    assert len(permits) == 1000
    assert not let_in("host999")
    assert let_in("another")  # all are forgotten
    assert len(permits) == 1
    assert let_in(None)
    assert not let_in(None)


def body_of(parts, length=None):
    """Return what the guard reads of a body in parts, and how many parts it read."""
    read = []

    async def receive():
        if len(read) == len(parts):
            return {"type": "http.request", "body": b"", "more_body": False}
        read.append(parts[len(read)])
        return {"type": "http.request", "body": read[-1], "more_body": True}

    headers = [] if length is None else [(b"content-length", length)]
    request = Request({"type": "http", "method": "POST", "headers": headers}, receive)
    body = asyncio.run(LIMITED._body(request, 100))
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
    ("name", "why"),
    [
        ("", "not be blank"),
        ("  ", "not be blank"),
        ("a" * 81, "have at most 80 characters, got 81"),
        ("a\0b", "be of letters that can be printed"),
        ("a\x1bb", "be of letters that can be printed"),
        ("a\u202eb", "be of letters that can be printed"),
        ("\u202e", "be of letters that can be printed"),
        ("\ud800", "be of letters that can be printed"),
        ("unknown", "not be 'unknown'"),
        (" unknown ", "not be 'unknown'"),
        ("nothing", "not be 'nothing'"),
        ("Nothing I know", "not be 'Nothing I know'"),
        (".", "hold a letter"),
        ("...", "hold a letter"),
        ("?!", "hold a letter"),
    ],
)
def test_names_that_name_nothing_are_refused(name, why):
    with pytest.raises(ValueError, match=f"The name of an object must {why}"):
        LiveSession.check_name(name)


@pytest.mark.parametrize("name", ["a" * 80, "C++", "☕", "7", "+", "می\u200cخواهم"])
def test_other_names_are_kept_as_they_are(name):
    assert LiveSession.check_name(name) == name
