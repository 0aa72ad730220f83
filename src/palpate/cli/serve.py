"""`palpate serve`: a sensor on the desk, taught and asked in the browser."""

import sys
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

from ._options import AsJson, ErrorRate, MaxModelMb, Refusal, grouped, option
from ._output import print_json
from ._sensor import ADDRESS, SensorOptions, Summary

HERE = "127.0.0.1"


@grouped
def serve(
    *,
    sensor: Annotated[
        str | None, option(f"{ADDRESS} Without one touches come through the API alone.")
    ] = None,
    model: Annotated[
        Path | None,
        option(
            "Model file to start from; learning writes it. Default: "
            "model.palpate in the library."
        ),
    ] = None,
    library: Annotated[
        Path | None, option("Folder that keeps what is taught; made if missing.")
    ] = None,
    host: Annotated[
        str, option("Address to listen on; other than 127.0.0.1 is the network.")
    ] = HERE,
    port: Annotated[int, option("Port to listen on; 0 takes a free one.")] = 8765,
    token: Annotated[
        str | None,
        option(
            "What everybody must know. Default: the one kept with the library, else "
            "a new one.",
            envvar="PALPATE_TOKEN",
        ),
    ] = None,
    name: Annotated[
        list[str] | None,
        option("Another name of this server, such as its proxy's; may be repeated."),
    ] = None,
    error: ErrorRate = 0.01,
    refusal: Refusal = None,
    summary: Summary = "peak",
    options: SensorOptions,
    max_model_mb: MaxModelMb = 2000,
    as_json: AsJson = False,
) -> None:
    """Serve the page and the API of one sensor, to whoever has the printed address."""
    from .. import web
    from ..web import LiveSession, checked_token, create_app, kept_token

    web.require_web()
    how: Any = {"error": error, "refusal": refusal, "summary": summary}
    chosen = None if sensor is None else options.open(sensor)
    chosen_token = None if token is None else checked_token(token)
    with (
        closing(web.open_socket(host, port)) as socket,
        LiveSession(chosen, model=model, library=library, **how) as session,
    ):
        if chosen_token is None:
            chosen_token = web.new_token() if library is None else kept_token(library)
        app = create_app(session, chosen_token, names=[host, *(name or ())])
        _say_where(host, socket.getsockname()[1], chosen_token, as_json=as_json)
        web.run_app(app, socket)


def _say_where(host: str, port: int, token: str, *, as_json: bool) -> None:
    from ..web import address_of, qr_code

    address = address_of(host, port)
    far = host not in (HERE, "localhost", "::1")
    if far:
        print(
            f"palpate: listening on {host}: everybody on that network who knows the "
            "token may see the sensor, teach and forget; nothing is encrypted.",
            file=sys.stderr,
        )
    if as_json:
        print_json({"address": address, "token": token})
        sys.stdout.flush()
    else:
        print(f"Open {address}?token={token}", flush=True)
        if far and "utf" in (sys.stdout.encoding or "").lower():
            print(qr_code(f"{address}?token={token}"))
        print("End with Ctrl-C. What is taught is kept at once.", flush=True)
