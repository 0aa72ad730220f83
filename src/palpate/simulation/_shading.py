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

Plane = NDArray[np.float32]
_MARCH_STEPS = 16


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
    for led in lighting.led_mm:
        lx, ly, lz = led[0] - x, led[1] - y, led[2] - z
        squared = lx * lx + ly * ly + lz * lz
        near = 1 / np.sqrt(squared)
        facing = (nx * lx + ny * ly + nz * lz) * near
        # Twice the half vector's square is 1 + cos(angle between light and view).
        between = -(lx * x + ly * y + lz * z) * near * to_camera
        half = (facing + view) / np.sqrt(2 + 2 * np.maximum(between, -0.999))
        answer = lighting.diffuse * np.maximum(facing, 0)
        answer += lighting.specular * np.maximum(half, 0) ** np.float32(
            lighting.shininess
        )
        light += answer * (distance_mm**2 / lighting.n_leds / squared)
    cosine = z * to_camera
    return light * (cosine * cosine) ** 2


class SurfaceFinder:
    """Where the rays of the camera's pixels meet a surface given as depth on a grid.

    Parameters
    ----------
    slope_x, slope_y : arrays of one shape
        Each ray's x and y per unit of depth, already shifted to the surface's axis.
    shift_mm : tuple of float
        x and y of the surface's axis in the camera's frame.
    near_mm, far_mm : float
        Depths between which the surface lies.
    half_mm, n : float and int
        The grid spans -half_mm..half_mm with n cells a side.
    """

    def __init__(
        self,
        slope_x: Plane,
        slope_y: Plane,
        shift_mm: tuple[float, float],
        near_mm: float,
        far_mm: float,
        half_mm: float,
        n: int,
    ) -> None:
        self._slopes = slope_x, slope_y
        self._shift = np.float32(shift_mm[0]), np.float32(shift_mm[1])
        self._per_mm, self._zero = np.float32(n / 2 / half_mm), np.float32(n / 2 - 0.5)
        depths = np.linspace(near_mm, far_mm, _MARCH_STEPS, dtype=np.float32)
        self._depths = depths
        self._maps = self._cells(depths[:, None, None])

    def find(self, depth: Plane) -> tuple[Plane, Plane, Plane]:
        """Return x, y (about the surface's axis) and z where each ray first meets it.

        `depth` is (n, n); rays that leave it meet its edge's depth.
        """
        z = self._march(depth)
        for _ in range(2):
            below = self._sample(depth, *self._cells(z))
            z = np.float32(0.5) * (z + below) if _ == 0 else z
        return *self.place(z), z

    def place(self, z: Plane) -> tuple[Plane, Plane]:
        """Return x and y about the surface's axis of the rays at depth z."""
        x = self._slopes[0] * z - self._shift[0]
        return x, self._slopes[1] * z - self._shift[1]

    def sample(self, values: Plane, x: Plane, y: Plane) -> Plane:
        """Return values of the grid at places x, y about its axis."""
        columns, rows = x * self._per_mm + self._zero, y * self._per_mm + self._zero
        return self._sample(values, columns, rows)

    def _march(self, depth: Plane) -> Plane:
        """Walk along the rays to the first step behind the surface, interpolate."""
        columns, rows = self._maps
        steps, height, width = rows.shape
        flat = self._sample(
            depth, columns.reshape(-1, width), rows.reshape(-1, width)
        ).reshape(rows.shape)
        over = flat - self._depths[:, None, None]
        behind = over <= 0
        behind[-1] = True
        after = np.maximum(behind.argmax(axis=0), 1)[None]
        ahead = np.take_along_axis(over, after - 1, axis=0)[0]
        past = np.take_along_axis(over, after, axis=0)[0]
        share = np.clip(ahead / np.maximum(ahead - past, np.float32(1e-6)), 0, 1)
        step = self._depths[1] - self._depths[0]
        return self._depths[after[0] - 1] + share * step

    def _cells(self, z: Any) -> tuple[Plane, Plane]:
        x = (self._slopes[0] * z - self._shift[0]) * self._per_mm + self._zero
        y = (self._slopes[1] * z - self._shift[1]) * self._per_mm + self._zero
        return x.astype(np.float32), y.astype(np.float32)

    def _sample(self, values: Plane, columns: Plane, rows: Plane) -> Plane:
        import cv2

        return cv2.remap(
            values, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
