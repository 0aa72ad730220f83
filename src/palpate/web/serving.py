"""Running the application on a socket, quietly, until it is told to end."""

import socket
from typing import Any

LAST_PORT = 65535


def open_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens, or say what is in the way.

    Raises
    ------
    ValueError
        There is no such port.
    OSError
        The address is taken or not ours.
    """
    if not 0 <= port <= LAST_PORT:
        raise ValueError(
            f"--port must be 0 to {LAST_PORT}, got {port}. 0 takes a free one."
        )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    opened = socket.socket(family, socket.SOCK_STREAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind((host, port))
        opened.listen(128)
    except OSError as error:
        opened.close()
        raise OSError(
            f"Cannot listen on {host} port {port}: {error.strerror}. "
            "Choose another with --port, or 0 for a free one."
        ) from error
    return opened


def run_app(app: Any, opened: socket.socket) -> None:
    """Run an ASGI application on a socket until the process is told to end."""
    import uvicorn

    config = uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,  # its lines would hold the token
        ws="websockets-sansio",
        ws_max_size=2**16,
        timeout_graceful_shutdown=3,
        server_header=False,
    )
    uvicorn.Server(config).run(sockets=[opened])
