"""`palpate serve`: a sensor on the desk, taught and asked in the browser."""

import re
import sys
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated, Any

from ._options import (
    AsJson,
    Deciding,
    MaxModelMb,
    grouped,
    model_file,
    option,
)
from ._output import answer, message_if_stopped, say
from .sensor import (
    ADDRESS,
    LogFile,
    Publish,
    SensorOptions,
    Summary,
    check_publish,
    logged,
    published,
)

HERE = "127.0.0.1"


@grouped
def serve(
    *,
    sensor: Annotated[
        list[str] | None,
        option(
            f"{ADDRESS} Without one touches come through the API alone; several, such "
            "as fingers, have a library each within --library."
        ),
    ] = None,
    model: Annotated[
        Path | None,
        option(
            "Model file to start from; learning writes it. Default: model.palpate in "
            "the library. A ready one by name, such as sim-dome, is copied there."
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
    deciding: Deciding,
    summary: Summary = "peak",
    log: LogFile = None,
    publish: Publish = None,
    options: SensorOptions,
    max_model_mb: MaxModelMb = 2000,
    as_json: AsJson = False,
) -> None:
    """Serve the page and the API of sensors, to whoever has the printed address."""
    if not as_json:
        say("Starting; the address follows.", flush=True)
    from ..web import LiveSession, PageServer, create_app

    check_publish(publish)
    how: Any = {**vars(deciding), "summary": summary}
    addresses = sensor or []
    kept = "" if library is None else f" What was taught is kept in {library}."
    with (
        message_if_stopped(f"nothing is served any more.{kept}"),
        closing(PageServer(host, port, library, token)) as server,
        ExitStack() as stack,
    ):
        if server.elsewhere:
            say(
                f"palpate: {library} is served already, at {server.elsewhere} (touches "
                "of both go into one library, but each page learns and shows by "
                "itself). Better open that address, or end that palpate with Ctrl-C "
                "first.",
                file=sys.stderr,
            )
        chosen: list[Any] = [options.open(address) for address in addresses] or [None]
        folders = [library]
        if len(addresses) > 1:
            folders = _folders(addresses, library, model)
        model = model and model_file(model, library)
        sessions = []
        for live, folder in zip(chosen, folders, strict=True):
            session = LiveSession(live, model=model, library=folder, **how)
            sessions.append(session)
            if session.watch is not None and len(addresses) > 1:
                session.watch.address = addresses[len(sessions) - 1]
            number = len(sessions) * (len(addresses) > 1)
            stack.enter_context(logged(session, log, number))
            stack.callback(session.stop)
        LiveSession.start_all(sessions)
        for address, session in zip(addresses, sessions, strict=False):
            if session.watch is not None and (why := session.watch.failed):
                say(f"palpate: {address}: {why}", file=sys.stderr)
        for number, session in enumerate(sessions, start=1):
            stack.enter_context(
                published(session, _of(publish, number, len(addresses)))
            )
        app = create_app(sessions, server.token, names=[host, *(name or ())])
        _say_where(host, server.address, server.token, as_json=as_json)
        server.run(app)


def _of(address: str | None, number: int, n_sensors: int) -> str | None:
    """Return the address that one of several sensors publishes at: /palpate/2."""
    if address is None or n_sensors < 2:
        return address
    place, mark, options = address.partition("?")
    return f"{place}/{number}{mark}{options}"


def _folders(
    sensors: list[str], library: Path | None, model: Path | None
) -> list[Path | None]:
    """Return a folder within the library for each of several sensors."""
    if len({*sensors}) < len(sensors):
        raise ValueError(
            f"--sensor must name each once, got {', '.join(sensors)}. Simulated ones "
            "may differ in an option: sim:mug?seed=1, sim:mug?seed=2."
        )
    places = [address.partition("?")[0] for address in sensors]
    whole = [
        address if places.count(place) > 1 else place
        for address, place in zip(sensors, places, strict=True)
    ]
    names = [re.sub(r"[^\w.-]+", "-", place) for place in whole]
    numbered = [f"{name}-{number}" for number, name in enumerate(names, start=1)]
    mixed = [
        with_number if names.count(name) > 1 else name
        for name, with_number in zip(names, numbered, strict=True)
    ]
    names = mixed if len({*mixed}) == len(mixed) else numbered
    if library and (model or (library / "library.sqlite").exists()):
        raise ValueError(
            "Several sensors have a library and a model each: leave --model out, and "
            f"name a --library that is none of one sensor, got {library}."
        )
    if library:
        library.mkdir(parents=True, exist_ok=True)  # for the token
    return [library / name if library else None for name in names]


def _say_where(host: str, address: str, token: str, *, as_json: bool) -> None:
    far = host not in (HERE, "localhost", "::1")
    if far:
        say(
            f"palpate: listening on {host}: everybody on that network who knows the "
            "token may see the sensor, teach and forget; nothing is encrypted.",
            file=sys.stderr,
        )
    if as_json:
        answer(True, {"address": address, "token": token})
    else:
        say(f"Open {address}?token={token}", flush=True)
        if far and "utf" in (sys.stdout.encoding or "").lower():
            say(_qr_code(f"{address}?token={token}"))
        say("End with Ctrl-C. What is taught is kept at once.", flush=True)


def _qr_code(text: str) -> str:
    """Return a text as a QR code of half blocks, for a dark terminal."""
    import cv2
    import numpy as np

    modules = cv2.QRCodeEncoder.create().encode(text) > 0
    light = np.pad(modules, (2, 2 + len(modules) % 2), constant_values=True)
    lines = zip(light[::2].tolist(), light[1::2].tolist(), strict=True)
    rows = (zip(top, bottom, strict=True) for top, bottom in lines)
    return "\n".join("".join(" ▄▀█"[2 * a + b] for a, b in row) for row in rows)
