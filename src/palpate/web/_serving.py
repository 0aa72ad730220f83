"""Serving a session: its application, its token, and the server that answers."""

import errno
import os
import re
import secrets
import socket
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._durable import lock
from .._extras import needed
from ._session import LiveSession

if TYPE_CHECKING:
    from fastapi import FastAPI
    from uvicorn import Server

MAX_BODY = 16 * 2**20
RATE_HZ = 200.0
LAST_PORT = 65535
TOKEN_FILE, ADDRESS_FILE = "page.token", "page.address"
_TOKEN = re.compile(r"[\w.~-]{16,200}", re.ASCII)
# An address of documentation (RFC 5737): nothing is sent to it.
_ELSEWHERE = ("192.0.2.1", 9)


def create_app(
    session: LiveSession | Sequence[LiveSession],
    token: str,
    *,
    max_body: int = MAX_BODY,
    rate_hz: float = RATE_HZ,
    names: Collection[str] = (),
) -> "FastAPI":
    """Return the web application of a session.

    Parameters
    ----------
    session : LiveSession, or a sequence of one per sensor
        Started and stopped with the application.
    token : str
        What everybody must know: as `Authorization: Bearer TOKEN`, as the cookie that
        the page sets, or, to read, as `?token=TOKEN`.
    max_body : int, default=16 MiB
        Largest body of a request, in bytes.
    rate_hz : float, default=200
        Requests per second that one address may keep up.
    names : collection of str
        Names of this server beside localhost and its machine's: those of a proxy.
        Requests for others are refused; addresses of numbers are always right.

    Raises
    ------
    ImportError
        FastAPI is missing; the message names the extra.
    ValueError
        The token is empty, which every browser knows, or there is no session.
    """
    _require_web()
    from ._app import build_app

    if not isinstance(token, str) or not token:
        raise ValueError(
            f"token must be a text that is not empty, got {token!r}. Write for example "
            "secrets.token_urlsafe()."
        )
    sessions = (session,) if isinstance(session, LiveSession) else tuple(session)
    if not sessions:
        raise ValueError("session must be one or more, got none.")
    return build_app(sessions, token, max_body=max_body, rate_hz=rate_hz, names=names)


class PageServer:
    """A server of a page, which listens from the first; `run` answers.

    Parameters
    ----------
    host : str
        Address of this machine to listen on; other than 127.0.0.1 is the network.
    port : int
        Where to listen; 0 takes a free one.
    library : path, optional
        Folder that the page is of. Its address stands there while it is served.
    token : str, optional
        What everybody must know. By default 192 bits that nobody guesses: with a
        `library` those that are kept with it, new ones where others may read them.

    Attributes
    ----------
    address : str
        Where a browser finds it.
    elsewhere : str
        Where the library is served already, "" where it is not.

    Raises
    ------
    ImportError
        The packages of the extra `web` are missing.
    ValueError, OSError
        The token will not do, the port is none, or there is no listening there; the
        message says why.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 0,
        library: str | Path | None = None,
        token: str | None = None,
    ) -> None:
        _require_web()
        if token is not None and not _TOKEN.fullmatch(token):
            raise ValueError(
                "token must be 16 to 200 letters, digits or any of . _ ~ -, got "
                f"another text of {len(token)} characters. Leave it out for one "
                "nobody guesses."
            )
        self._library, self._chosen = library, token
        self.elsewhere = "" if library is None else _served_at(library)
        try:
            self._socket = _open_socket(host, port)
        except OSError as error:
            if not self.elsewhere:
                raise
            raise OSError(
                f"{library} is served already, at {self.elsewhere} (open that address, "
                f"or end that palpate with Ctrl-C first). {error}"
            ) from error
        self.address = _address_of(host, self._socket.getsockname()[1])

    @cached_property
    def token(self) -> str:
        """What everybody must know; a library must be there when it is first read."""
        if self._chosen is not None:
            return self._chosen
        if self._library is None:
            return secrets.token_urlsafe(24)
        return _kept_token(self._library)

    def close(self) -> None:
        """Stop listening; `run` does it when it ends."""
        self._socket.close()

    def run(self, app: Any, **options: Any) -> None:
        """Answer for an application until the process is told to end.

        `options` are of `uvicorn.Config`.
        """
        with self._kept_address():
            _server_of(app, **options).run(sockets=[self._socket])

    @contextmanager
    def running(self, app: Any, **options: Any) -> Iterator[str]:
        """Answer in a thread of its own meanwhile; yields the address."""
        server = _server_of(app, **options)
        with closing(self), self._kept_address():
            sockets = [self._socket]
            thread = threading.Thread(target=server.run, args=(sockets,), daemon=True)
            thread.start()
            while thread.is_alive() and not server.started:
                time.sleep(0.01)
            try:
                yield self.address
            finally:
                server.should_exit = True
                thread.join(10)

    @contextmanager
    def _kept_address(self) -> Iterator[None]:
        """Keep the address beside the library while it is served."""
        if self._library is None:
            yield
            return
        path = Path(self._library) / ADDRESS_FILE
        with path.open("a+", encoding="utf-8") as file:
            if lock(file):
                file.truncate(0)
                file.write(self.address)
                file.flush()
            yield


def _require_web() -> None:
    """Raise `ImportError`, naming the extra, where the web packages are missing."""
    for module in ("fastapi", "uvicorn", "websockets"):
        needed(module, "web", "The page")


def _kept_token(library: str | Path) -> str:
    """Return the token kept with a library, a new one where others may read it."""
    path = Path(library) / TOKEN_FILE
    private = os.name != "posix" or (path.exists() and not path.stat().st_mode & 0o077)
    if private and path.is_file():
        kept = path.read_text(encoding="utf-8").strip()
        if _TOKEN.fullmatch(kept):
            return kept
    token = secrets.token_urlsafe(24)
    path.unlink(missing_ok=True)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(token)
    return token


def _served_at(library: str | Path) -> str:
    """Return the address of a server of this library that is running, or ""."""
    path = Path(library) / ADDRESS_FILE
    if not path.is_file():
        return ""
    with path.open("a+", encoding="utf-8") as file:
        if lock(file):
            return ""
        file.seek(0)
        return file.read().strip()


def _open_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens, or say what is in the way."""
    if not 0 <= port <= LAST_PORT:
        raise ValueError(
            f"port must be 0 to {LAST_PORT}, got {port}. 0 takes a free one."
        )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # The protocol is named: asyncio holds answers back unless it is known to be TCP.
    opened = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind((host, port))
        opened.listen(128)
    except (OSError, TypeError, UnicodeError) as error:  # the last two: no host's name
        opened.close()
        why = getattr(error, "strerror", None) or error
        taken = getattr(error, "errno", None) == errno.EADDRINUSE
        who = " by another program, perhaps a palpate that was not ended" * taken
        raise OSError(
            f"Cannot listen on {host} port {port}: {why}{who}. Choose an address of "
            "this machine as `host`, another `port`, or 0 for a free one."
        ) from error
    return opened


def _address_of(host: str, port: int) -> str:
    """Return where a browser finds a server that listens on a host and a port."""
    if host in ("0.0.0.0", "::"):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(_ELSEWHERE)
                host = probe.getsockname()[0]
            except OSError:  # no network
                host = "127.0.0.1"
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/"


def _server_of(app: Any, **options: Any) -> "Server":
    import uvicorn

    from ._request_guard import AT_ONCE, PatientProtocol, PatientServer

    config: dict[str, Any] = {
        "log_level": "warning",
        "access_log": False,  # its lines would hold the token
        "http": PatientProtocol,
        "backlog": AT_ONCE,
        "ws": "websockets-sansio",
        "ws_max_size": 2**16,
        "ws_per_message_deflate": False,  # pictures are small already, and time is not
        "timeout_graceful_shutdown": 3,
        "server_header": False,
    }
    return PatientServer(uvicorn.Config(app, **{**config, **options}))
