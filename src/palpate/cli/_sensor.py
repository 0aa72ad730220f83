"""What the verbs with a live sensor share: its options, opening it, its baseline."""

import re
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._options import Calibration, NamePattern, NoContact, flag, option
from ._output import printable, say

if TYPE_CHECKING:
    from ..sensors import LiveSensor
    from ..web import LiveSession

ADDRESS = (
    "camera:NAME, serial:PORT, ros:TOPIC, replay:PATH or sim:OBJECT, with options as "
    "in 'camera:USB Camera?shape=480x640&rate=30'."
)
SensorAddress = Annotated[str, option("--sensor", ADDRESS)]
Summary = Annotated[
    str,
    option(
        "--summary",
        'What stands for a touch: "peak", the frame of greatest change, or '
        '"mean" over the hold.',
    ),
]
Patience = Annotated[
    float, option("--timeout", "Give up after so long without a touch.")
]
LogFile = Annotated[
    str | None,
    option(
        "--log",
        "Write frames, touches, beliefs to a file (.rrd, .mcap), or show them to a "
        "running Foxglove: ws://127.0.0.1:8765 (plugs/look).",
    ),
]
Publish = Annotated[
    str | None,
    option(
        "--publish",
        "Publish beliefs on ROS 2 and take commands there: "
        "'ros:/palpate?domain=0&via=dds'.",
    ),
]


@dataclass(frozen=True)
class SensorOptions:
    """Options of a sensor beside its address, named as the sensor names them."""

    image_shape: Annotated[
        str | None,
        option("--shape", "Rows x columns: 480x640, 16x16; of an array auto."),
    ] = None
    rate_hz: Annotated[float | None, option("--rate", "Frames per second.")] = None
    colour: Annotated[
        bool | None, flag("--colour", "Read a camera in red, green and blue.")
    ] = None
    baud: Annotated[int | None, option("Bits per second of a serial port.")] = None
    framing: Annotated[str | None, option('An array: "line" or "binary".')] = None
    checksum: Annotated[
        bool | None,
        flag("--checksum/--no-checksum", "Refuse serial lines without a checksum."),
    ] = None
    hold: Annotated[int | None, option("Frames a played touch is held.")] = None
    gap: Annotated[int | None, option("Frames of nothing between two such.")] = None
    place: Annotated[str | None, option("What lies there to be played first.")] = None
    name_pattern: NamePattern = None
    no_contact: NoContact = None
    calibration: Calibration = None

    def open(self, address: str) -> "LiveSensor":
        """Return the sensor at an address; it is not connected yet."""
        from ..sensors import AddressError, CalibratedSensor, open_sensor

        settings = {**vars(self)}
        path = settings.pop("calibration")
        try:
            sensor = open_sensor(address, **settings)
        except AddressError as error:
            raise typer.BadParameter(str(error)) from error
        if path is None:
            return sensor
        from ..images import TaxelCalibration

        return CalibratedSensor(sensor, TaxelCalibration.load(path))


def need_baseline(session: "LiveSession") -> None:
    """Take the frame of no contact where the sensor does not know it."""
    from ..sensors import ContactError

    if session.watch is not None and session.watch.sensor.unfixed:
        say(session.watch.sensor.unfixed, file=sys.stderr)
    if session.baseline is None:
        say("Leave the sensor alone: taking its baseline.", file=sys.stderr)
        try:
            session.take_baseline()
        except ContactError as error:
            question = printable(f"{error} Does nothing touch it?")
            if not sys.stdin.isatty() or not typer.confirm(question, err=True):
                raise
            session.take_baseline(force=True)


@contextmanager
def published(session: "LiveSession", address: str | None) -> Iterator[None]:
    """Publish the beliefs of a session, and let it be told what to do, on ROS 2."""
    from ..web import RosPublisher

    if address is None:
        yield
        return
    with closing(RosPublisher(session, address)):
        yield


def check_publish(address: str | None) -> None:
    """Refuse an address of --publish that is none, before anything is started."""
    from ..sensors import AddressError, ros_place

    try:
        _ = address and ros_place(address)
    except AddressError as error:
        raise typer.BadParameter(f"--publish: {error}") from error


@contextmanager
def logged(
    session: "LiveSession", place: str | Path | None, number: int = 0
) -> Iterator[None]:
    """Let what a package has for the file's ending take the events of a session.

    Entry points of the group `palpate.logs`, such as `rrd`, are called with the path,
    `ws` with an address; what they return has `take(event)` and `close()`. Of several
    sensors each has a `number`, and a file that ends in it, or the next port.
    """
    from importlib.metadata import entry_points

    if place is None:
        yield
        return
    path, served = Path(place), re.fullmatch(r"(ws://.*:)(\d+)", str(place))
    name = "ws" if served else path.suffix[1:].lower()
    plugged = [*entry_points(group="palpate.logs", name=name)]
    if not plugged:
        raise typer.BadParameter(
            "--log must end in .rrd or .mcap or be ws://HOST:PORT, and what writes "
            f"these be installed (plugs/look), got {path.name!r}."
        )
    path = path.with_stem(f"{path.stem}-{number}") if number else path
    port = served and f"{served[1]}{int(served[2]) + max(0, number - 1)}"
    with closing(plugged[0].load()(port or path)) as log:
        session.listeners.add(log.take)
        yield
