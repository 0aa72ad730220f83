"""What a library tells of its sensors, objects and touches."""

from typing import NamedTuple

from .._checks import check_option, check_positive
from ..touches import GEOMETRIES


class SensorDescription(NamedTuple):
    """What is known of the sensor that took some touches.

    Attributes
    ----------
    name : str
        Tells this sensor from others, such as "camera:BathTip 2".
    kind : str or None
        Such as "camera", "array" or "simulated".
    unit : str or None
        Unit of the images, such as "kPa" or "grey level".
    pitch_mm : float or None
        Distance of neighbouring taxels in mm.
    geometry : {"dome", "array", "plane", "none"} or None
        How its taxels lie; None leaves it as the touches say.
    """

    name: str
    kind: str | None = None
    unit: str | None = None
    pitch_mm: float | None = None
    geometry: str | None = None

    def checked(self) -> "SensorDescription":
        """Return itself, or say what is wrong with it."""
        if not isinstance(self.name, str) or not self.name.strip():
            raise ValueError(f"sensor name must be a text, got {self.name!r}.")
        if self.pitch_mm is not None:
            check_positive("pitch_mm", self.pitch_mm)
        check_option("geometry", self.geometry, (None, *GEOMETRIES))
        return self


class ObjectRow(NamedTuple):
    """One object of a library; retracted touches do not count.

    `n_episodes` counts different pairs of session and episode.
    """

    name: str
    category: str | None
    n_touches: int
    n_episodes: int


class TouchRow(NamedTuple):
    """One touch of a library without its image.

    `time_s` is the touch's own time, `added_s` when it was added (both seconds; the
    latter since 1970), `force_n` in newtons; `reason` says why it is retracted.
    """

    id: str
    object: str | None
    category: str | None
    session: str | int | float | None
    episode: str | int | float | None
    sensor: str | None
    order: float | None
    time_s: float | None
    force_n: float | None
    n_rows: int
    n_cols: int
    dtype: str
    added_s: float
    retracted: bool
    reason: str | None


class Stats(NamedTuple):
    """How much a library holds; sizes in bytes."""

    n_touches: int
    n_retracted: int
    n_objects: int
    n_sessions: int
    n_files: int
    database_bytes: int
    image_bytes: int
    feature_bytes: int
