"""Sensors by one short text: `KIND:NAME`, and after a `?` what is to be set.

`camera:USB Camera?shape=480x640&rate=30`, `serial:/dev/ttyUSB0?shape=16x16`,
`ros:/tactile?domain=0`, `replay:FOLDER?hold=4` and `sim:mug` are addresses. Options
are `NAME=VALUE`, joined by `&`; in a value `%26` is `&` and any other byte may be
written so too. A name is taken as it is written, but for `%3F`, which is a `?` in it.

Other kinds are drivers that installed packages name as entry points of the group
`palpate.sensors`: callables `(place, **options)` that return a `LiveSensor`. Their
keyword-only parameters of the types `int`, `float`, `bool`, `str` and `tuple[int, int]`
are the options of an address.

`CalibratedSensor` puts the readings of a sensor through a calibration.
"""

import inspect
import re
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, Protocol
from urllib.parse import unquote

import numpy as np

from .._checks import check_option
from .._types import Array, Floats
from ._camera import CameraSensor
from ._contract import LiveSensor, Reading, SensorError
from ._played import PlayedSensor, ReplaySensor, SimulatedStream
from ._ros import RosNode, RosSensor, open_node
from ._serial import SerialArraySensor, find_array
from .ros import Header

_TICK_S = 0.3  # between looks at whether to stop


class AddressError(ValueError):
    """An address that names no sensor, or an option that the sensor does not have."""


class _Option(NamedTuple):
    """An option of an address: the argument it is for, and how its text is read."""

    keyword: str
    read: Callable[[str], Any]
    what: str


def _shape(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})\s*[xX×]\s*(\d{1,5})", text.strip())
    if match is None:
        raise ValueError
    return int(match[1]), int(match[2])


def _whole(text: str) -> tuple[int, ...]:
    return tuple(map(int, text.split(",")))


def _word(keyword: str, **values: Any) -> _Option:
    return _Option(keyword, values.__getitem__, " or ".join(values))


_YES_NO = {"1": True, "0": False, "yes": True, "no": False}
_WIDTHS = ("uint8", "uint16", "int16", "float32")
_OPTIONS = {
    "shape": _Option("image_shape", _shape, "rows x columns such as 16x16"),
    "rate": _Option("rate_hz", float, "a number of frames a second"),
    "exposure": _Option("exposure", float, "a number in the driver's own unit"),
    "gain": _Option("gain", float, "a number in the driver's own unit"),
    "crop": _Option("crop", _whole, "row,column,rows,columns like 0,80,480,480"),
    "rotation": _Option("rotation", int, "0, 90, 180 or 270 degrees"),
    "scale": _Option("scale", float, "a share of at most 1, such as 0.5"),
    "fourcc": _Option("fourcc", str, "four letters such as MJPG"),
    "colour": _word("colour", **_YES_NO),
    "baud": _Option("baud", int, "a whole number of bits a second"),
    "framing": _word("framing", line="line", binary="binary"),
    "checksum": _word("checksum", yes=True, no=False),
    "dtype": _word("dtype", **{name: name for name in _WIDTHS}),
    "unit": _Option("unit", str, "a text"),
    "hold": _Option("hold", int, "a whole number of frames"),
    "gap": _Option("gap", int, "a whole number of frames"),
    "place": _Option("place", str, "what to put on the desk, or `nothing`"),
    "no-contact": _Option("no_contact", Path, "a picture"),
    "name-pattern": _Option("name_pattern", str, "a regular expression"),
    "domain": _Option("domain", int, "a whole number, 0 to 232"),
    "qos": _word("qos", best_effort="best_effort", reliable="reliable"),
    "wait": _Option("wait_s", float, "a number of seconds"),
    "via": _word("via", dds="dds", zenoh="zenoh"),
    "seed": _Option("random_state", int, "a whole number"),
    "services": _word("services", **_YES_NO),
}
_SHAPE_OR_AUTO = _Option(
    "image_shape",
    lambda text: text if text == "auto" else _shape(text),
    "such as 16x16, or auto",
)
_KINDS = {
    "camera": "shape rate exposure gain crop rotation scale fourcc colour",
    "serial": "shape baud framing checksum dtype unit",
    "replay": "shape rate hold gap place no-contact name-pattern colour",
    "ros": "shape domain qos wait via",
    "sim": "shape rate hold gap place seed",
}
_PUBLISHING = {"publishing": "domain via services"}
_GROUP = "palpate.sensors"
_READ: dict[str, tuple[Callable[[str], Any], str]] = {
    "int": (int, "a whole number"),
    "float": (float, "a number"),
    "str": (str, "a text"),
    "tuple[int, int]": (_shape, "rows x columns such as 16x16"),
    "bool": (_YES_NO.__getitem__, "yes or no"),
}
_NAMES = {option.keyword: name for name, option in _OPTIONS.items()}


def open_sensor(address: str, **options: Any) -> LiveSensor:
    """Return the sensor that an address names; it is not connected yet.

    Parameters
    ----------
    address : str
        `camera:NAME`, `serial:PORT`, `ros:TOPIC`, `replay:PATH` or `sim:OBJECT`, and
        after a `?` options, as in `camera:USB Camera?shape=480x640&rate=30`;
        docs/reference/live.md lists them, and so does the refusal of one that is
        unknown.
    **options
        The same as Python values or as text, named as the sensor names them:
        `image_shape`, `rate_hz`, `no_contact`...; what else the sensor takes; see
        `CameraSensor`, `SerialArraySensor`, `ReplaySensor`. None counts as not given.
        With a `calibration`, a `TaxelCalibration` or another fitted estimator of
        images, frames are in kPa.

    Raises
    ------
    ValueError
        The address names no sensor, or an option is missing, unknown, given twice, or
        given here and in the address with different values; says which there are.

    Examples
    --------
    >>> from palpate.sensors import open_sensor
    >>> open_sensor("camera:0?shape=240x320&rate=15").image_shape
    (240, 320)
    """
    base, _, written = address.partition("?")
    kind, _, place = base.partition(":")
    driver = None if kind in _KINDS else _driver(kind)
    if not place or (kind not in _KINDS and driver is None):
        others = sorted({plugged.name for plugged in entry_points(group=_GROUP)})
        more = f" (or {', '.join(others)} of packages installed)" if others else ""
        raise AddressError(
            "sensor must be camera:NAME, serial:PORT, ros:TOPIC, replay:PATH or "
            f"sim:OBJECT{more}, got {address!r}. digit:, gelsight-mini:, anyskin: and "
            'others are drivers of their own: pip install "git+https://github.com/'
            'palpate/palpate#subdirectory=plugs/drivers".'
        )
    arguments = _written(address, kind, written)
    calibration = options.pop("calibration", None)
    for keyword, value in options.items():
        if value is not None:
            arguments[keyword] = _agreed(address, kind, arguments, keyword, value)
    place = re.sub("%3f", "?", place, flags=re.IGNORECASE)
    sensor: Any
    if driver is not None:
        sensor = driver(place, **arguments)
    else:
        try:
            sensor = _sensor_of(kind, place, arguments)
        except ValueError as error:
            raise AddressError(str(error)) from error
    if not isinstance(sensor, LiveSensor):
        raise AddressError(
            f"The driver of {kind} sensors must return a LiveSensor, got "
            f"{type(sensor).__name__}. Ask its author; check_sensor tells."
        )
    return sensor if calibration is None else CalibratedSensor(sensor, calibration)


class RosPlace(NamedTuple):
    """A name to publish beliefs under, and whether services are offered beside them."""

    prefix: str
    domain: int = 0
    via: str = "dds"
    services: bool = True

    def open_node(self) -> RosNode:
        """Return a participant in the domain, over "dds" or "zenoh"."""
        return open_node(self.domain, self.via)


def ros_place(address: str) -> RosPlace:
    """Return what `ros:/palpate?domain=0&via=dds&services=yes` says.

    Raises
    ------
    ValueError
        It is another address, or has other options.
    """
    base, _, written = address.partition("?")
    kind, _, place = base.partition(":")
    if kind != "ros" or not re.fullmatch(r"/?\w+(/\w+)*", place):
        raise AddressError(
            f"address must be like ros:/palpate?domain=0, got {address!r}."
        )
    return RosPlace(f"/{place.strip('/')}", **_written(address, "publishing", written))


def is_address(text: str) -> bool:
    """Return whether a text begins as an address: with a kind of sensor and a colon."""
    kind, colon, _ = text.partition(":")
    plugged = {driver.name for driver in entry_points(group=_GROUP)}
    return bool(colon) and kind in plugged | _KINDS.keys()


def _written(address: str, kind: str, written: str) -> dict[str, Any]:
    """Return the options in an address, by the arguments they are for."""
    arguments: dict[str, Any] = {}
    for part in filter(None, written.split("&")):
        name, _, text = part.partition("=")
        option = _options(kind).get(name)
        if option is None:
            _refuse(address, kind, f"{name!r} is no option")
        if option.keyword in arguments:
            _refuse(address, kind, f"{name} must be given once, got it twice")
        arguments[option.keyword] = _read(address, kind, name, unquote(text))
    return arguments


def _driver(kind: str) -> Callable[..., Any] | None:
    """Return the driver that a package has for a kind of sensor, None without one."""
    for plugged in entry_points(group=_GROUP, name=kind):
        try:
            driver: Callable[..., Any] = plugged.load()
        except Exception as error:  # somebody else's module, which may fail in any way
            raise AddressError(
                f"The driver of {kind} sensors, {plugged.value}, cannot be loaded: "
                f"{error!r}. Install its package anew."
            ) from error
        return driver
    return None


def _options(kind: str) -> dict[str, _Option]:
    """Return the options of a kind of sensor; a driver's are its own parameters."""
    if names := (_KINDS | _PUBLISHING).get(kind):
        options = {name: _OPTIONS[name] for name in names.split()}
        return options | {"shape": _SHAPE_OR_AUTO} if kind == "serial" else options
    options = {}
    for name, parameter in inspect.signature(_driver(kind) or dict).parameters.items():
        annotation = parameter.annotation
        is_text = isinstance(annotation, str)
        written = annotation if is_text else inspect.formatannotation(annotation)
        read = _READ.get(written.removesuffix(" | None"))
        if read is not None and parameter.kind is inspect.Parameter.KEYWORD_ONLY:
            options[_NAMES.get(name, name)] = _Option(name, *read)
    return options


def _agreed(
    address: str, kind: str, arguments: dict[str, Any], keyword: str, value: Any
) -> Any:
    name = _NAMES.get(keyword, None if kind in _KINDS else keyword)
    if name is None:  # not for addresses; the sensor itself knows or refuses it
        return value
    if name not in _options(kind):
        raise AddressError(f"`{name}` must be left out: a {kind} sensor has none.")
    if isinstance(value, str):
        value = _read(address, kind, name, value)
    if keyword == "image_shape" and value != "auto":
        value = tuple(value)
    if keyword in arguments and arguments[keyword] != value:
        raise AddressError(
            f"{name}={_shown(arguments[keyword])} in {address!r} and "
            f"`{name}={_shown(value)}` contradict each other. Leave one of them out."
        )
    return value


def _read(address: str, kind: str, name: str, text: str) -> Any:
    option = _options(kind)[name]
    try:
        if not text:
            raise ValueError
        return option.read(text)
    except (KeyError, ValueError):
        _refuse(address, kind, f"{name} must be {option.what}, got {text!r}")


def _refuse(address: str, kind: str, problem: str) -> NoReturn:
    names = ", ".join(_options(kind)) or "none"
    raise AddressError(f"{problem} for {address!r}. Options of {kind} are {names}.")


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "x".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _sensor_of(kind: str, place: str, arguments: dict[str, Any]) -> LiveSensor:
    placed, shape = arguments.pop("place", None), arguments.get("image_shape")
    sensor: LiveSensor
    if kind == "camera":
        sensor = CameraSensor(place, **arguments)
    elif kind == "ros":
        sensor = RosSensor(place, **arguments)
    elif kind == "sim":
        sensor = SimulatedStream(place, **arguments)
    elif kind == "replay":
        arguments.pop("image_shape", None)
        sensor = ReplaySensor(Path(place), **arguments)
    else:  # serial
        if shape is None:
            raise AddressError(
                "shape must be given for a serial array, got none. Say how many rows "
                f"and columns it has: serial:{place}?shape=16x16, or `shape=16x16`; "
                "`shape=auto` listens to it."
            )
        if shape == "auto":
            speed = {"baud": arguments["baud"]} if "baud" in arguments else {}
            listened = find_array(place, **speed)
            shape = listened["image_shape"]
            arguments = {**listened, **arguments, "image_shape": shape}
        sensor = SerialArraySensor(place, **arguments)
    if shape is not None and kind != "camera" and sensor.image_shape[:2] != shape:
        (n_rows, n_cols), (asked_rows, asked_cols) = sensor.image_shape[:2], shape
        raise AddressError(
            f"shape must be that of the {sensor.name}, {n_rows} x {n_cols}, got "
            f"{asked_rows} x {asked_cols}. Leave `shape` out."
        )
    if placed is not None and isinstance(sensor, PlayedSensor):
        check_option("place", placed, dict.fromkeys((*sensor.objects, "nothing")))
        nothing = placed == "nothing" and placed not in sensor.objects
        sensor.place(None if nothing else placed)
    return sensor


class _Calibration(Protocol):
    """A map of images to those of another unit, such as `TaxelCalibration`."""

    image_shape_: tuple[int, int]

    def transform(self, X: Array) -> Floats: ...


class CalibratedSensor(LiveSensor):
    """Another sensor's frames in kPa, by a calibration.

    Parameters
    ----------
    sensor : LiveSensor
        Not connected yet.
    calibration : Calibration
        A `TaxelCalibration`, or another fitted estimator of images in kPa.

    Raises
    ------
    ValueError
        The calibration is of an array of another size. Of a sensor that learns its
        size on connecting, that is a `SensorError` then.
    """

    queue_length = 64

    def __init__(self, sensor: LiveSensor, calibration: _Calibration) -> None:
        self.inner, self.calibration = sensor, calibration
        if misfit := self._misfit():
            raise ValueError(misfit)
        shape, geometry = sensor.image_shape, sensor.geometry
        super().__init__(sensor.name, "kPa", shape, np.float64, geometry)
        self.channels = sensor.channels
        self._next_number = 0
        self._step: float | None = None

    @property
    def step(self) -> float:
        """What one step of the sensor's numbers is in its first frame (kPa)."""
        return self._step or 0.0

    @property
    def desk(self) -> PlayedSensor | None:
        """What lets things be placed before it by name; None of a real sensor."""
        return self.inner.desk

    def header_at(self, device_time_s: float) -> Header | None:
        """Return the header of the ROS message of a frame, None where none is kept."""
        return self.inner.header_at(device_time_s)

    def no_contact(self) -> Array | None:
        """Return the frame of touching nothing, or None where it is not known."""
        rest = self.inner.no_contact()
        return None if rest is None else self._calibrated(rest)

    def _misfit(self) -> str:
        has, wants = self.inner.image_shape, tuple(self.calibration.image_shape_)
        if has == wants:
            return ""
        sizes = (" x ".join(map(str, shape)) for shape in (wants, has))
        return "The calibration is of {} taxels, the sensor has {}.".format(*sizes)

    def _calibrated(self, image: Array) -> Array:
        return np.asarray(self.calibration.transform(image[np.newaxis])[0])

    def _open(self) -> None:
        self.inner.connect()
        if misfit := self._misfit():
            raise SensorError(misfit)
        self.fixed, self.unfixed = self.inner.fixed, self.inner.unfixed
        self._next_number, self._step = 0, None

    def _grab(self) -> Sequence[Reading]:
        try:
            frame = self.inner.read_next(_TICK_S)
        except SensorError:
            self.lost = self.inner.lost
            return []
        self._count_missed(max(0, frame.number - self._next_number))
        self._next_number = frame.number + 1
        about = frame.time_s, frame.device_time_s, frame.columns
        image = self._calibrated(frame.image)
        if self._step is None:
            change = self._calibrated(frame.image + self.inner.step) - image
            self._step = float(np.sqrt(np.mean(np.nan_to_num(change) ** 2)))
        return [Reading(image, *about)]

    def _close(self) -> None:
        self.inner.disconnect()
