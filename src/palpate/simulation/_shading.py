"""What the camera inside a dome sees: eight LEDs on a bent, rather glossy membrane.

Everything is in the camera's frame: origin at its lens, z along the sensor's axis
towards the tip, x along image columns, y along rows, millimetres. A surface is given
as its depth z over (x, y). Light is relative: an LED facing a white surface at the
tip's distance gives 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[Any]  # float32 throughout: half the time of float64


@dataclass(frozen=True)
class Lighting:
    """How the membrane is lit and how it answers.

    Parameters
    ----------
    n_leds : int, default=8
        LEDs evenly spaced on a ring about the lens.
    ring_radius_mm : float, default=9.0
        Radius of that ring.
    diffuse, specular, ambient : float
        Weights of the Lambert part, the highlight and the light from all sides.
    shininess : float
        Exponent of the highlight.
    """

    n_leds: int = 8
    ring_radius_mm: float = 9.0
    diffuse: float = 0.19
    specular: float = 1.0
    ambient: float = 0.0
    shininess: float = 10.0

    @property
    def led_mm(self) -> NDArray[np.float32]:
        """Places of the LEDs, (n_leds, 3)."""
        angle = np.arange(self.n_leds) * (2 * np.pi / self.n_leds)
        x, y = self.ring_radius_mm * np.cos(angle), self.ring_radius_mm * np.sin(angle)
        return np.column_stack([x, y, 0 * x]).astype(np.float32)


def shade(
    point_mm: Sequence[Plane],
    slope: Sequence[Plane],
    lighting: Lighting,
    distance_mm: float,
) -> Plane:
    """Return the light that surface points send to the camera.

    Parameters
    ----------
    point_mm : three arrays of one shape
        x, y and depth z of the points.
    slope : two arrays of that shape
        dz/dx and dz/dy there.
    lighting : Lighting
        The LEDs and the surface.
    distance_mm : float
        Distance at which an LED gives 1.

    Notes
    -----
    Lambert plus a Blinn-Phong highlight [1]_ with inverse squares for the LEDs, and
    the cosine to the fourth of the lens. No shadows and no light from one part of
    the membrane to another but the constant `ambient`.

    References
    ----------
    .. [1] J. F. Blinn, "Models of light reflection for computer synthesized
       pictures", SIGGRAPH 1977. doi:10.1145/563858.563893
    """
    x, y, z = point_mm
    to_camera = 1 / np.sqrt(x * x + y * y + z * z)
    scale = 1 / np.sqrt(slope[0] ** 2 + slope[1] ** 2 + 1)
    # The inner side faces the camera: the normal is (dz/dx, dz/dy, -1) scaled.
    nx, ny, nz = slope[0] * scale, slope[1] * scale, -scale
    view = -(nx * x + ny * y + nz * z) * to_camera
    light = np.full_like(z, lighting.ambient)
    shininess = np.float32(lighting.shininess)
    for led in lighting.led_mm:
        lx, ly, lz = led[0] - x, led[1] - y, led[2] - z
        squared = lx * lx + ly * ly + lz * lz
        near = 1 / np.sqrt(squared)
        facing = (nx * lx + ny * ly + nz * lz) * near
        # Twice the half vector's square is 1 + cos(angle between light and view).
        between = -(lx * x + ly * y + lz * z) * near * to_camera
        half = (facing + view) / np.sqrt(2 + 2 * np.maximum(between, -0.999))
        answer = lighting.diffuse * np.maximum(facing, 0)
        answer += lighting.specular * np.maximum(half, 0) ** shininess
        light += answer * (distance_mm**2 / lighting.n_leds / squared)
    cosine = z * to_camera
    return light * (cosine * cosine) ** 2
