"""What the camera inside a dome sees: eight LEDs on a bent, rather glossy membrane.

Everything is in the camera's frame: origin at its lens, z along the sensor's axis
towards the tip, x along image columns, y along rows, millimetres. Light is relative:
an LED facing a white surface at the tip's distance gives 1.

The surface is the sphere less the displacement w on the membrane's grid; each pixel
looks along one ray and sees where that first meets the surface, so that the near
side of a deep dent hides the far side. Shading is computed on at most 128 rows and
enlarged: it is smooth, and the rim, which is not, is drawn at full size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._types import Array, Bools, Singles
from ._membrane import Membrane

if TYPE_CHECKING:
    from ._dome import DomeCamera

Plane = Array  # float32 throughout: half the time of float64
SURROUND_GREY = 255.0
_SHADED_ROWS = 128
_MARCH_STEPS = 11
_STEEPEST = 0.9995
_RIM_SHARE = 0.975
_LINE = 128


@dataclass(frozen=True)
class Lighting:
    """How the membrane is lit and how it answers.

    `n_leds` stand evenly on a ring of `ring_radius_mm` about the lens; `diffuse`,
    `specular` and `ambient` are weights without unit of the Lambert part, of the
    highlight with the exponent `shininess`, and of light from all sides.
    """

    n_leds: int = 8  # evenly spaced on a ring about the lens
    ring_radius_mm: float = 9.0
    diffuse: float = 0.19  # weight of the Lambert part
    specular: float = 1.0  # weight of the highlight
    ambient: float = 0.0  # weight of the light from all sides
    shininess: float = 10.0  # exponent of the highlight

    @property
    def led_mm(self) -> Singles:
        """Places of the LEDs, (n_leds, 3)."""
        angle = np.arange(self.n_leds) * (2 * np.pi / self.n_leds)
        x, y = self.ring_radius_mm * np.cos(angle), self.ring_radius_mm * np.sin(angle)
        return np.column_stack([x, y, 0 * x]).astype(np.float32)

    def shade(
        self, point_mm: Sequence[Plane], slope: Sequence[Plane], distance_mm: float
    ) -> Plane:
        """Return the light that points (x, y, z), of slope (dz/dx, dz/dy), send back.

        Lambert plus a Blinn-Phong highlight (J. F. Blinn, SIGGRAPH 1977,
        doi:10.1145/563858.563893), inverse squares, the lens's cosine to the fourth; no
        shadows. At `distance_mm` an LED gives 1.
        """
        import cv2

        x, y, z = point_mm
        away = x * x + y * y + z * z
        to_camera = 1 / np.sqrt(away)
        scale = 1 / np.sqrt(slope[0] ** 2 + slope[1] ** 2 + 1)
        # The inner side faces the camera: the normal is (dz/dx, dz/dy, -1) scaled.
        nx, ny = slope[0] * scale, slope[1] * scale
        outward = nx * x + ny * y - scale * z
        view = -outward * to_camera
        twice, diffuse, glossy = 2 * away, np.zeros_like(z), np.zeros_like(z)
        for led_x, led_y, _ in self.led_mm:  # level with the lens
            along = (2 * led_x) * x + (2 * led_y) * y
            square = 1 / (away + (led_x**2 + led_y**2) - along)
            near = np.sqrt(square)
            facing = (led_x * nx + led_y * ny - outward) * near
            half = np.maximum(facing + view, 0)
            # Its length: twice the half vector's, whose square is 2 + 2 cos(angle).
            half *= half / (2 + (twice - along) * near * to_camera)
            gloss = np.asarray(cv2.pow(half, 0.5 * self.shininess)).reshape(z.shape)
            diffuse += np.maximum(facing, 0) * square
            glossy += gloss * square
        light = self.diffuse * diffuse + self.specular * glossy
        light = light * (distance_mm**2 / self.n_leds) + self.ambient
        cosine = z * to_camera
        return np.asarray(light * (cosine * cosine) ** 2)


class Optics:
    """Tables of one camera; `light` makes pictures of dents with them.

    `inside` is the share of each pixel within the rim, `grid_shape` the size of the
    grid on which shading is computed.
    """

    def __init__(self, camera: DomeCamera) -> None:
        membrane, deepest_mm = camera.membrane, camera.max_depth_mm
        self._camera, self._membrane = camera, membrane
        answer = camera.diffuse, camera.specular, camera.ambient, camera.shininess
        self._lighting = Lighting(camera.n_leds, camera.led_ring_radius_mm, *answer)
        n_rows, n_cols = camera.image_shape
        row = (np.arange(n_rows) + 0.5) / n_rows - camera.disc_centre[0]
        col = (np.arange(n_cols) + 0.5) / n_rows - camera.disc_centre[1]
        away = np.hypot(row[:, None], col)
        share = (camera.disc_radius - away) * n_rows + 0.5
        self.inside: Plane = np.clip(share, 0, 1).astype(np.float32)
        rows = min(n_rows, _SHADED_ROWS)
        self._scale = rows / n_rows
        # Whole rows, and the columns that the disc covers.
        covered = min(camera.disc_centre[1] + camera.disc_radius, n_cols / n_rows)
        cols = int(np.ceil(max(covered, 0) * rows)) + 1
        self.grid_shape = rows, max(2, cols)
        radius = membrane.radius_mm
        rim = camera.camera_distance_mm - radius
        rows, cols = self.grid_shape
        per_height = radius / (rim * camera.disc_radius)
        up = ((np.arange(rows) + 0.5) / rows - camera.disc_centre[0])[:, None]
        across = ((np.arange(cols) + 0.5) / rows - camera.disc_centre[1])[None]
        shift_x, shift_y = camera.camera_offset_mm
        self._slope_x = (across * per_height - shift_x / rim).astype(np.float32)
        self._slope_y = (up * per_height - shift_y / rim).astype(np.float32)
        near = max(rim - deepest_mm / 2, rim / 2)
        far = camera.camera_distance_mm
        steps = np.linspace(near, far, _MARCH_STEPS, dtype=np.float32)
        self._depths = steps
        # Rays are followed through all steps, one after the other; some see the rim.
        self._undented, at_rim = self._met_undented()
        self._rays = np.flatnonzero(~at_rim)
        slopes = np.broadcast_arrays(self._slope_x, self._slope_y)
        self._slopes = tuple(slope.take(self._rays) for slope in slopes)
        x, y = self._at(steps[:, None], self._slopes)
        self._cells = _cells(x, y, membrane).ravel()
        ahead = self._sphere(x, y) - steps[:, None]
        self._ahead = ahead.ravel()
        # Where each ray can first meet dents up to a limit.
        self._limits = np.append(np.linspace(0, deepest_mm, _MARCH_STEPS), np.inf)
        least = np.minimum.accumulate(ahead)[:-1]
        first = [np.maximum((least > mm).sum(axis=0), 1) for mm in self._limits]
        self._starts = [step * step.size + np.arange(step.size) for step in first]

    def light(self, displacement_mm: Plane) -> Plane:
        """Return the light each pixel gets, (n_rows, n_cols), of a dented dome."""
        z = self._first_met(displacement_mm)
        x, y = self._at(z)
        pitch = np.float32(self._membrane.pitch_mm)
        cells = _cells(x, y, self._membrane)
        slopes = np.gradient(displacement_mm, pitch)
        dent_y, dent_x = (_remapped(slope, cells) for slope in slopes)
        radius = np.float32(self._membrane.radius_mm)
        least = radius * np.float32(np.sqrt(1 - _STEEPEST**2))
        height = np.sqrt(np.maximum(radius**2 - x * x - y * y, least**2))
        slope = (-x / height - dent_x, -y / height - dent_y)
        shift_x, shift_y = map(np.float32, self._camera.camera_offset_mm)
        point = (x - shift_x, y - shift_y, z)
        away_mm = self._camera.camera_distance_mm
        shaded = self._lighting.shade(point, slope, away_mm)
        return self.enlarged(shaded)

    def enlarged(self, shaded: Plane) -> Plane:
        """Bring values on the shading grid to the picture's size."""
        import cv2

        n_rows, n_cols = self._camera.image_shape
        if self._scale == 1:
            wide = np.zeros(self._camera.image_shape, np.float32)
            wide[:, : shaded.shape[1]] = shaded[:, :n_cols]
            return wide
        shift = 0.5 * self._scale - 0.5
        to_grid = np.array([[self._scale, 0, shift], [0, self._scale, shift]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size, border = (n_cols, n_rows), cv2.BORDER_REPLICATE
        large = cv2.warpAffine(shaded, to_grid, size, flags=flags, borderMode=border)
        return np.asarray(large)

    def _met_undented(self) -> tuple[Plane, Bools]:
        """Exact depth where rays meet the sphere, and those at its steep rim."""
        radius = self._membrane.radius_mm
        rim = self._camera.camera_distance_mm - radius
        shift_x, shift_y = self._camera.camera_offset_mm
        across, up = self._slope_x.astype(float), self._slope_y.astype(float)
        square = 1 + across**2 + up**2
        half = rim - across * shift_x - up * shift_y
        rest = rim**2 + shift_x**2 + shift_y**2 - radius**2
        root = np.sqrt(np.maximum(half**2 - square * rest, 0))
        depth = np.maximum((half + root) / square, rim)
        x, y = self._at(depth)
        at_rim = np.hypot(x, y) > _RIM_SHARE * radius
        return depth.astype(np.float32), at_rim

    def _at(self, z: Any, slopes: Sequence[Plane] = ()) -> tuple[Plane, Plane]:
        """Where rays, by default the grid's, are at depth z, about the dome's axis."""
        slope_x, slope_y = slopes or (self._slope_x, self._slope_y)
        shift_x, shift_y = map(np.float32, self._camera.camera_offset_mm)
        return slope_x * z + shift_x, slope_y * z + shift_y

    def _sphere(self, x: Plane, y: Plane) -> Plane:
        """Depth of the undented dome; beyond the rim, of the rim."""
        radius = np.float32(self._membrane.radius_mm)
        rim = np.float32(self._camera.camera_distance_mm) - radius
        return np.asarray(rim + np.sqrt(np.maximum(radius**2 - x * x - y * y, 0)))

    def _first_met(self, displacement_mm: Plane) -> Plane:
        """Depth at which each ray first meets the surface: steps, then one secant."""
        limit = np.searchsorted(self._limits, displacement_mm.max(), "right")
        at = self._starts[limit].copy()
        left = self._left(at, displacement_mm)
        n_rays, last = at.size, self._ahead.size - at.size
        going = np.flatnonzero((left > 0) & (at < last))
        while going.size:
            there = at[going] + n_rays
            at[going] = there
            left[going] = nearer = self._left(there, displacement_mm)
            going = going[(nearer > 0) & (there < last)]
        before = self._left(at - n_rays, displacement_mm)
        step = self._depths[1] - self._depths[0]
        fall = np.maximum(before - left, np.float32(0.1) * step)
        start = self._depths.take(at // n_rays - 1)
        z = start + np.clip(before / fall, 0, 1) * step
        x, y = self._at(z, self._slopes)
        rest = self._sphere(x, y) - z
        rest -= _along(displacement_mm, _cells(x, y, self._membrane))
        met = self._undented.copy()
        met.put(self._rays, np.clip(z + rest * (step / fall), start, start + step))
        return met

    def _left(self, places: Array, displacement_mm: Plane) -> Plane:
        """Way from places on rays to the surface."""
        dents = _along(displacement_mm, self._cells.take(places))
        return np.asarray(self._ahead.take(places) - dents)


def sampled(values: Plane, x: Any, y: Any, membrane: Membrane) -> Plane:
    """Return grid values at places x, y about the axis, linear, edges repeated."""
    return _along(values, _cells(x, y, membrane).ravel()).reshape(x.shape)


def _cells(x: Any, y: Any, membrane: Membrane) -> Array:
    """Column + i row, counted in nodes, of places about the axis."""
    per_mm = np.float32(1 / membrane.pitch_mm)
    zero = np.float32(membrane.n_nodes / 2 - 0.5)
    cells = np.empty(x.shape, np.complex64)
    cells.real, cells.imag = x * per_mm + zero, y * per_mm + zero
    return cells


def _along(values: Plane, cells: Array) -> Plane:
    """Grid values at a line of cells; OpenCV wants many short lines of them."""
    lines = np.zeros((cells.size // _LINE + 1, _LINE), np.complex64)
    lines.ravel()[: cells.size] = cells
    return _remapped(values, lines).ravel()[: cells.size]


def _remapped(values: Plane, cells: Array) -> Plane:
    import cv2

    linear, border = cv2.INTER_LINEAR, cv2.BORDER_REPLICATE
    remap: Any = cv2.remap  # whose types know no pairs
    pairs = cells.view(np.float32).reshape(*cells.shape, 2)
    return np.asarray(remap(values, pairs, None, linear, borderMode=border))
