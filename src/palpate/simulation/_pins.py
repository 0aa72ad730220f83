"""The same dome with pins inside: a TacTip, whose camera sees the pins' white tips.

A dent moves the pins' roots inwards and tilts them, so their tips crowd round its
edge and spread over its floor. Same axes and units as `DomeCamera`.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from .._checks import check_count, check_number, check_positive
from .._types import Floats, Singles
from ._dome import DomeCamera, DomePress, DomeSensor, Frame
from ._membrane import Membrane
from ._optics import sampled

_SUBPIXEL_BITS = 4


_DOME = DomeCamera(
    image_shape=(300, 300),
    disc_centre=(0.5, 0.5),
    disc_radius=0.68,
    noise_sd=2.0,
    centre_drift_sd=0.005,
)


@dataclass(frozen=True)
class TacTipPins(DomeSensor):
    """Simulated dome with pins.

    Parameters
    ----------
    dome : DomeCamera
        Membrane, camera and force; its light is not used. By default 300 x 300
        pixels with all pins in view.
    n_rings : int, default=6
        Hexagonal rings of pins about the middle one; 6 make 127 pins.
    spread : float, default=0.85
        Distance of the outermost pins from the axis as a share of the radius.
    pin_length_mm, pin_radius_mm : float, default=2.0, 0.55
        Length of a pin, along the inward normal, and radius of its white tip.

    Notes
    -----
    Limits of `DomeCamera` hold. A real TacTip is filled with gel, which spreads a
    dent; here there is none. Pins are stiff, do not touch each other, and one behind
    another is drawn all the same.

    References
    ----------
    .. [1] C. Chorley, C. Melhuish, T. Pipe, J. Rossiter, "Development of a tactile
       sensor based on biologically inspired edge encoding", ICAR 2009.

    Examples
    --------
    >>> from palpate.simulation import TacTipPins
    >>> TacTipPins().n_pins
    127
    """

    dome: DomeCamera = _DOME
    n_rings: int = 6
    spread: float = 0.85
    pin_length_mm: float = 2.0
    pin_radius_mm: float = 0.55

    def __post_init__(self) -> None:
        check_count("n_rings", self.n_rings)
        check_number("spread", self.spread, low=0.05, high=0.94)
        check_number("pin_length_mm", self.pin_length_mm, low=0.0)
        check_positive("pin_radius_mm", self.pin_radius_mm)

    @property
    def n_pins(self) -> int:
        """Number of pins."""
        return 1 + 3 * self.n_rings * (self.n_rings + 1)

    @property
    def image_shape(self) -> tuple[int, int]:
        """(n_rows, n_cols) of the picture."""
        return self.dome.image_shape

    @property
    def membrane(self) -> Membrane:
        """The rubber dome."""
        return self.dome.membrane

    @cached_property
    def roots_mm(self) -> Singles:
        """X and y of the pins' roots about the axis, (n_pins, 2)."""
        n = self.n_rings
        steps = range(-n, n + 1)
        cells = [(a, b) for a in steps for b in steps if abs(a + b) <= n]
        a, b = np.array(cells, dtype=np.float32).T
        pitch = self.spread * self.dome.membrane_radius_mm / n
        places = (pitch * (a + b / 2), pitch * b * np.sqrt(0.75))
        return np.column_stack(places).astype(np.float32)

    def tips_mm(self, press: DomePress | None = None) -> Singles:
        """Return x, y about the axis and depth z from the lens of tips, (n_pins, 3)."""
        membrane, dome = self.membrane, self.dome
        x, y = self.roots_mm.T
        height = np.sqrt(membrane.radius_mm**2 - x * x - y * y).astype(np.float32)
        z = height + np.float32(dome.camera_distance_mm - membrane.radius_mm)
        slope_x, slope_y = -x / height, -y / height
        if press is not None:
            dent = press.contact.displacement_mm
            grids = (dent, *np.gradient(dent, np.float32(membrane.pitch_mm)))
            w, w_y, w_x = (sampled(np.asarray(v), x, y, membrane) for v in grids)
            z, slope_x, slope_y = z - w, slope_x - w_x, slope_y - w_y
        length = np.float32(self.pin_length_mm)
        length = length / np.sqrt(slope_x**2 + slope_y**2 + 1)
        tips = (x + length * slope_x, y + length * slope_y, z - length)
        return np.column_stack(tips).astype(np.float32)

    def pixels(self, press: DomePress | None = None) -> Floats:
        """Return row, column and radius of each tip in the picture, (n_pins, 3)."""
        dome, n_rows = self.dome, self.dome.image_shape[0]
        x, y, z = self.tips_mm(press).T.astype(np.float64)
        rim = dome.camera_distance_mm - dome.membrane_radius_mm
        per_slope = dome.disc_radius * rim / dome.membrane_radius_mm * n_rows
        shift_x, shift_y = dome.camera_offset_mm
        row = ((y - shift_y) / z + shift_y / rim) * per_slope
        col = ((x - shift_x) / z + shift_x / rim) * per_slope
        row += dome.disc_centre[0] * n_rows - 0.5
        col += dome.disc_centre[1] * n_rows - 0.5
        return np.column_stack([row, col, self.pin_radius_mm / z * per_slope])

    def image(
        self, press: DomePress | None = None, rng: np.random.Generator | None = None
    ) -> Frame:
        """Return the picture of a press: white discs on black, noise with `rng`."""
        import cv2

        picture = np.zeros(self.image_shape, np.uint8)
        # OpenCV's smooth discs are half a pixel larger than asked for.
        discs = (self.pixels(press) - (0, 0, 0.5)) * (1 << _SUBPIXEL_BITS)
        for row, col, radius in np.round(discs).astype(int).tolist():
            filled, smooth = cv2.FILLED, cv2.LINE_AA
            how = (max(radius, 1), 255, filled, smooth, _SUBPIXEL_BITS)
            cv2.circle(picture, (col, row), *how)
        if rng is None or self.dome.noise_sd == 0:
            return picture
        noise = rng.standard_normal(self.image_shape, dtype=np.float32)
        noisy = picture + np.float32(self.dome.noise_sd) * noise
        return np.clip(noisy + np.float32(0.5), 0, 255).astype(np.uint8)

    def drifted(self, rng: np.random.Generator) -> Self:
        """Return this sensor as another recording would find it."""
        return replace(self, dome=self.dome.drifted(rng))

    def remounted(self, rng: np.random.Generator) -> Self:
        """Return this sensor after another mounting; see `DomeCamera.remounted`."""
        return replace(self, dome=self.dome.remounted(rng))
