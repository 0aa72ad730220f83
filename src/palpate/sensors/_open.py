"""Sensors by one short text, as the command line names them."""

from pathlib import Path
from typing import Any

from .._checks import check_option
from ._camera import CameraSensor
from ._played import PlayedSensor
from ._replay import ReplaySensor
from ._serial import SerialArraySensor
from ._simulated_stream import SimulatedStream
from ._streaming import StreamingSensor

KINDS = ("camera", "serial", "replay", "sim")


def open_sensor(
    spec: str,
    *,
    image_shape: tuple[int, int] | None = None,
    rate_hz: float | None = None,
    **options: Any,
) -> StreamingSensor:
    """Return the sensor that a text names; it is not connected yet.

    Parameters
    ----------
    spec : str
        `camera:NAME`, `serial:PORT`, `replay:PATH` or `sim:OBJECT`.
    image_shape : (int, int), optional
        (n_rows, n_cols); must be given for `serial`, is fixed for `replay`.
    rate_hz : float, optional
        Frames per second, where it can be chosen.
    **options
        What else the sensor takes; see `CameraSensor`, `SerialArraySensor`,
        `ReplaySensor` and `SimulatedStream`. None counts as not given.

    Raises
    ------
    ValueError
        The text names no sensor, or an option is missing.
    """
    kind, colon, place = spec.partition(":")
    if not colon or not place or kind not in KINDS:
        raise ValueError(
            "sensor must be camera:NAME, serial:PORT, replay:PATH or sim:OBJECT, "
            f"got {spec!r}."
        )
    given = {name: value for name, value in options.items() if value is not None}
    if rate_hz is not None:
        given["rate_hz"] = rate_hz
    sensor = _made(kind, place, image_shape, given)
    if image_shape is not None and sensor.image_shape != tuple(image_shape):
        fixed, asked = (
            f"{n_rows} x {n_cols}"
            for n_rows, n_cols in (sensor.image_shape, image_shape)
        )
        raise ValueError(
            f"image_shape must be that of the {sensor.name}, {fixed}, got {asked}. "
            "Leave it (--shape) out."
        )
    return sensor


def _made(
    kind: str,
    place: str,
    image_shape: tuple[int, int] | None,
    given: dict[str, Any],
) -> StreamingSensor:
    if kind == "replay":
        return ReplaySensor(Path(place), **given)
    if kind == "serial":
        if image_shape is None:
            raise ValueError(
                "image_shape must be given for a serial array, got None. "
                "Say how many rows and columns it has: --shape 16x16."
            )
        given.pop("rate_hz", None)
        return SerialArraySensor(place, image_shape, **given)
    if image_shape is not None:
        given["image_shape"] = image_shape
    maker = {"camera": CameraSensor, "sim": SimulatedStream}[
        check_option("kind", kind, KINDS)
    ]
    sensor: StreamingSensor = maker(place, **given)
    return sensor


def desk_of(sensor: object) -> PlayedSensor | None:
    """Return the sensor if things can be placed before it by name, else None."""
    return sensor if isinstance(sensor, PlayedSensor) else None
