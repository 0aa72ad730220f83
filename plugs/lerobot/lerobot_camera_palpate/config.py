"""How a sensor of palpate is named in a robot's configuration."""

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig


@CameraConfig.register_subclass("palpate")
@dataclass(kw_only=True)
class PalpateCameraConfig(CameraConfig):  # type: ignore[misc]
    """A sensor by its address; readings from `low` to `high` become 0 to 255.

    Attributes
    ----------
    sensor : str
        Such as `serial:/dev/ttyUSB0?shape=16x16` or `sim:mug`; see palpate's
        docs/reference/live.md.
    low, high : float
        In the sensor's unit; 8 bits stay as they are unless these say otherwise.
    """

    sensor: str
    low: float = 0.0
    high: float = 255.0
