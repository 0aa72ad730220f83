"""Two more cameras behind rubber: a gel lit in three colours, a dome with pins inside.

The gel (GelSight, DIGIT) is the wide rubber of a flat dome. Red, green and blue light
comes in from three sides along it, so that a slope of the dented surface shows as a
colour. Lengths are millimetres, pictures grey levels 0 to 255 of "r", "g" and "b".

In the dome (a TacTip) the camera sees the pins' white tips. A dent moves the pins'
roots inwards and tilts them, so their tips crowd round its edge and spread over its
floor. Same axes and units as `DomeCamera`.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import ClassVar, Self

import numpy as np

from .._checks import check_count, check_number, check_positive
from .._types import RGB, Array, Floats, Singles
from ._dome import DomeCamera, DomePress, DomeSensor, Frame
from ._optics import sampled

_SUBPIXEL_BITS = 4
_DOME = DomeCamera(
    image_shape=(300, 300),
    disc_centre=(0.5, 0.5),
    disc_radius=0.68,
    noise_sd=2.0,
    centre_drift_sd=0.005,
)

# A pad of 2 mm that is bent over 20 mm, as a DIGIT's is; it stops at 2 mm of depth.
_PAD = DomeCamera(
    image_shape=(120, 160),
    force_n=1.5,
    max_depth_mm=2.0,
    membrane_radius_mm=20.0,
    thickness_mm=1.0,
    youngs_mpa=0.15,
    n_nodes=96,
    sleeve_mm=0.0,
    noise_sd=1.5,
)


@dataclass(frozen=True)
class GelCamera(DomeSensor):
    """Simulated gel camera.

    Parameters
    ----------
    image_shape : tuple of int, default=(120, 160)
        Rows and columns of the picture.
    width_mm : float, default=18.6
        What the picture shows of the gel from left to right.
    dome : DomeCamera, optional
        The rubber, the force at which a press ends, noise and drift; by default 1 mm
        bent over a radius of 20 mm and pressed in by 2 mm at most. Of its own light and
        camera nothing is used.
    relief : float, default=0.9
        By what share of itself a colour changes with a slope of 1 towards its light.
    colours : tuple of float, default=(1.0, 1.0, 1.0)
        Brightness of the red, green and blue light.
    shift_mm : tuple of float, default=(0.0, 0.0)
        x and y of the picture's middle on the gel.

    Notes
    -----
    The pad of a DIGIT is glued to a plate, which a shell is not: dents here are wider
    and have no bulge beside them. No shadows, no printed texture. Nothing is fitted to
    pictures of a real gel, so this is to rehearse with, not to measure.

    Examples
    --------
    >>> from palpate.simulation import GelCamera
    >>> GelCamera().no_contact().shape
    (120, 160, 3)
    """

    channels: ClassVar[tuple[str, ...]] = RGB
    geometry: ClassVar[str] = "plane"
    image_shape: tuple[int, int] = (120, 160)
    width_mm: float = 18.6
    dome: DomeCamera = _PAD
    relief: float = 0.9
    colours: tuple[float, float, float] = (1.0, 1.0, 1.0)
    shift_mm: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        as_dome = replace(self.dome, image_shape=self.image_shape)  # checks it
        object.__setattr__(self, "image_shape", as_dome.image_shape)
        for name, count in {"colours": 3, "shift_mm": 2}.items():
            value = getattr(self, name)
            row = tuple(value) if isinstance(value, tuple | list | np.ndarray) else ()
            if len(row) != count:
                raise ValueError(f"{name} must be {count} numbers, got {value!r}.")
            object.__setattr__(self, name, row)
        check_positive("width_mm", self.width_mm)
        check_number("relief", self.relief, low=0.0)
        for colour in self.colours:
            check_positive("colours", colour)
        for shift in self.shift_mm:
            check_number("shift_mm", shift)

    @cached_property
    def places_mm(self) -> tuple[Singles, Singles]:
        """X and y of the middle of each pixel about the axis, (n_rows, n_cols) each."""
        n_rows, n_cols = self.image_shape
        pitch = self.width_mm / n_cols
        x = (np.arange(n_cols) - (n_cols - 1) / 2) * pitch + self.shift_mm[0]
        y = (np.arange(n_rows) - (n_rows - 1) / 2) * pitch + self.shift_mm[1]
        across, down = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
        return across, down

    def image(
        self, press: DomePress | None = None, rng: np.random.Generator | None = None
    ) -> Frame:
        """Return the picture of a press, (n_rows, n_cols, 3); with `rng`, noisy."""
        light = _rest(self)
        if press is not None:
            light = light * (1 + np.float32(self.relief) * self._slopes(press))
        levels = np.maximum(light, 0) * np.float32(255 * self.dome.gain)
        return _noisy(levels, self.dome.noise_sd, rng)

    def drifted(self, rng: np.random.Generator) -> Self:
        """Return this sensor as another recording would find it: other exposure."""
        return replace(self, dome=self.dome.drifted(rng))

    def remounted(self, rng: np.random.Generator) -> Self:
        """Return this sensor with another pad: its rubber, its place, its lights.

        Standard deviations, all guesses: lights 8 %, place 0.3 mm; the rubber's as
        `DomeCamera.remounted` says.
        """
        brighter = np.exp(rng.normal(0, 0.08, 3)) * self.colours
        shift = rng.normal(0, 0.3, 2) + self.shift_mm
        return replace(
            self,
            dome=self.dome.remounted(rng),
            colours=tuple(brighter.tolist()),
            shift_mm=tuple(shift.tolist()),
        )

    def _slopes(self, press: DomePress) -> Array:
        """Return how far each pixel leans towards each light, (n_rows, n_cols, 3)."""
        dent = press.contact.displacement_mm
        down, across = np.gradient(dent, np.float32(self.membrane.pitch_mm))
        x, y = self.places_mm
        slopes = (sampled(np.asarray(v), x, y, self.membrane) for v in (across, down))
        to_x, to_y = slopes
        length = np.sqrt(1 + to_x**2 + to_y**2)
        leaning = [(cos * to_x + sin * to_y) / length for cos, sin in _TOWARDS]
        return np.stack(leaning, axis=2)


# Red from the left, green from below on the right, blue from above on the right.
_ANGLES = np.deg2rad([180.0, 60.0, -60.0])
_TOWARDS = [(np.float32(np.cos(a)), np.float32(np.sin(a))) for a in _ANGLES]


@lru_cache(maxsize=4)
def _rest(gel: GelCamera) -> Singles:
    """Return the light of the gel at rest, (n_rows, n_cols, 3): more near each lamp."""
    x, y = gel.places_mm
    half = np.float32(gel.width_mm / 2)
    near = [(cos * x + sin * y) / half for cos, sin in _TOWARDS]
    light = np.stack([0.45 + 0.18 * nearness for nearness in near], axis=2)
    return np.asarray(light * np.array(gel.colours), dtype=np.float32)


def _noisy(levels: Array, noise_sd: float, rng: np.random.Generator | None) -> Frame:
    """Return grey levels as a picture, with noise where it is drawn by `rng`."""
    if rng is not None and noise_sd > 0:
        noise = rng.standard_normal(levels.shape, dtype=np.float32)
        levels = levels + np.float32(noise_sd) * noise
    shown: Frame = np.clip(levels + np.float32(0.5), 0, 255).astype(np.uint8)
    return shown


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
        return _noisy(picture, self.dome.noise_sd, rng)

    def drifted(self, rng: np.random.Generator) -> Self:
        """Return this sensor as another recording would find it."""
        return replace(self, dome=self.dome.drifted(rng))

    def remounted(self, rng: np.random.Generator) -> Self:
        """Return this sensor after another mounting; see `DomeCamera.remounted`."""
        return replace(self, dome=self.dome.remounted(rng))
