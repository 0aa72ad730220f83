"""A camera inside a rubber dome that is pressed on things: the BathTip, simulated.

Rays give the gap between dome and object, the membrane's equation the dent under a
force, eight LEDs and a camera the picture. Lengths are millimetres, forces newtons,
pictures grey levels 0 to 255 with the first row at the top.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from .._checks import check_count, check_number, check_positive
from .._parallel import opencv_on_one_thread
from .._types import Floats
from ._membrane import Contact, Membrane
from ._optics import SURROUND_GREY, Optics, Plane
from ._solids import PlacedObject, SensorPose, SimObject, distances_ahead

Frame = NDArray[np.uint8]
_LEAST_SIDE = 8
_SLEEVE_RAYS = 64
# One such picture takes a second and half a gigabyte.
_MOST_PIXELS = 8_000_000


@dataclass(frozen=True, eq=False)
class DomePress:
    """One press of a dome on an object; without a touch all numbers are zero."""

    stopped_by: str  # "force", "depth", "sleeve" (that holds the dome) or "nothing"
    travel_mm: float  # from its pose to the end
    depth_mm: float  # of that, after first touching
    # Along the axis on the whole sensor, a sleeve too: less than asked for only where
    # the greatest depth came first. The dome's own share is `contact.force_n`.
    force_n: float
    area_mm2: float  # seen along the axis
    contact: Contact
    gap_mm: Floats  # way to go after first touching, (n_nodes, n_nodes)

    @property
    def touched(self) -> bool:
        """Whether anything was within reach."""
        return self.stopped_by != "nothing"


class DomeSensor(ABC):
    """What sensors with a dome have in common."""

    @property
    @abstractmethod
    def dome(self) -> "DomeCamera":
        """The membrane, its camera and its force."""

    @property
    def membrane(self) -> Membrane:
        """The rubber."""
        return self.dome.membrane

    @abstractmethod
    def image(
        self, press: DomePress | None = None, rng: np.random.Generator | None = None
    ) -> Frame:
        """Return the picture of a press, (n_rows, n_cols), by default of none."""

    def press(
        self,
        target: SimObject | PlacedObject,
        pose: SensorPose,
        *,
        force_n: float | None = None,
        depth_mm: float | None = None,
        reach_mm: float = np.inf,
    ) -> DomePress:
        """Move in from a pose until a force is reached.

        Parameters
        ----------
        target : SimObject or PlacedObject
            What to touch; an object that is not placed is where it was built.
        pose : SensorPose
            Where to start, clear of the object.
        force_n : float, optional
            Force to stop at, default the dome's own; `max_depth_mm` may come first.
        depth_mm : float, optional
            Instead, stop this far after first touching, at most `max_depth_mm`.
        reach_mm : float, default=inf
            Longest way to the first touch; beyond it nothing is touched.

        Raises
        ------
        ValueError
            The dome overlaps the object at the start.
        """
        dome = self.dome
        placed = target if isinstance(target, PlacedObject) else PlacedObject(target)
        gap = self.gap_mm(placed, pose)
        first, reason = float(gap.min()), "depth"
        if not first <= reach_mm or np.isinf(first):
            gap[:] = np.inf
            nothing = dome.membrane.pressed(gap, depth_mm=0.0)
            return DomePress("nothing", 0.0, 0.0, 0.0, 0.0, nothing, gap)
        if first < 0:
            raise ValueError(
                f"pose must be clear of the object, got one {-first:.3g} mm inside "
                f"{placed.thing.name!r}. Start further back."
            )
        force = dome.force_n if force_n is None else check_positive("force_n", force_n)
        most = dome.max_depth_mm
        if depth_mm is not None:
            if force_n is not None:
                raise ValueError("Give at most one of force_n and depth_mm.")
            most = check_number("depth_mm", depth_mm, low=0.0, high=most)
        sleeve = self.sleeve_gap_mm(placed, pose)
        if sleeve - first < most:
            most, reason = max(sleeve - first, 0.0), "sleeve"
        gap -= first
        stop_n = force if depth_mm is None else None
        contact = dome.membrane.pressed(gap, force_n=stop_n, depth_mm=most)
        depth, total, area = contact.depth_mm, contact.force_n, contact.area_mm2
        if depth < most:
            reason = "force"
        elif reason == "sleeve":
            total = force
        return DomePress(reason, first + depth, depth, total, area, contact, gap)

    def gap_mm(self, placed: PlacedObject, pose: SensorPose) -> Floats:
        """Return how far (mm) it moves until each node touches, (n_nodes, n_nodes).

        Infinity where nothing is ahead, negative in the dome. One ray per node, from
        the level of the rim, to the first surface: subtract the least to press.
        """
        x, y, drop = self.membrane.used_mm
        back = self.membrane.radius_mm
        gap = np.full(self.membrane.drop_mm.shape, np.inf)
        ahead = distances_ahead(placed, pose, x, y, back)
        gap[np.isfinite(self.membrane.drop_mm)] = ahead + drop - back
        return gap

    def sleeve_gap_mm(self, placed: PlacedObject, pose: SensorPose) -> float:
        """Return how far (mm) until the sleeve around the rim touches, or infinity."""
        rim_mm = self.dome.membrane_radius_mm
        # Three circles within the ring.
        radius = rim_mm + self.dome.sleeve_mm * np.linspace(0.05, 1, 3)[:, None]
        angle = np.arange(_SLEEVE_RAYS) * (2 * np.pi / _SLEEVE_RAYS)
        x, y = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
        return float(distances_ahead(placed, pose, x, y, rim_mm).min())

    def no_contact(self) -> Frame:
        """Return the picture of the dome touching nothing, without noise."""
        return self.image()

    def touch(
        self,
        target: SimObject | PlacedObject,
        pose: SensorPose,
        force_n: float | None = None,
        rng: np.random.Generator | None = None,
    ) -> Frame:
        """Press from a pose until a force and return the picture."""
        return self.image(self.press(target, pose, force_n=force_n), rng)


@dataclass(frozen=True)
class DomeCamera(DomeSensor):
    """Simulated dome camera.

    Parameters
    ----------
    image_shape : tuple of int, default=(480, 640)
        Rows and columns of the picture. Fewer columns cut it on the right, so that
        (n, n) is what the BathTip's square pictures show.
    force_n : float, default=0.735
        Force at which a press ends: 75 gf.
    max_depth_mm : float, default=12.0
        Depth at which it ends before that force.
    membrane_radius_mm, thickness_mm, youngs_mpa, poisson, n_nodes
        The rubber and its grid, see `Membrane`; by default 20 mm, 1.5 mm, 0.11 MPa.
        The paper gives a thickness of 1 mm, but real dents are as wide as this
        equation's are at 1.5 mm.
    sleeve_mm : float, default=1.0
        How far the rigid edge that holds the dome stands out from it; it stops the
        press where it meets the object.
    camera_distance_mm : float, default=62.0
        From the lens to the tip.
    camera_offset_mm : tuple of float, default=(0.0, 0.0)
        x and y of the lens, with its LEDs, from the dome's axis.
    disc_centre, disc_radius : default=(0.4375, 0.4438), 0.5625
        Row and column of the middle of the rim and its radius, in heights of the
        picture. The default is cut by the left, upper and lower edges.
    n_leds, led_ring_radius_mm, diffuse, specular, shininess, ambient
        The light, see `Lighting`.
    light_slope : tuple of float, default=(0.0, 0.0)
        By what share the light is more a radius of the rim farther down, and farther
        right, in the picture: LEDs that differ, or a dome that sits askew.
    gain, gamma : float, default=1.0, 2.2
        Grey = 255 (gain x light)^(1 / gamma), cut at 255.
    noise_sd : float, default=3.6
        Noise of one picture in grey levels, at 240 rows or more; binning to fewer
        rows averages it.
    texture_sd : float, default=0.03
        Mottling of the rubber, as a share of its light; the same in every picture
        with one `texture_seed`.
    exposure_drift_sd, centre_drift_sd : float, default=0.1, 0.015
        Spread, between recordings, of the logarithm of the gain and of the
        `disc_centre`; used by `drifted`.
    texture_seed : int, default=0
        Which mottling.

    Notes
    -----
    Linear elasticity of a shallow shell: no snap-through, no friction, no side
    walls, rigid and fixed objects, and beyond 0.8 of the radius the equation no
    longer holds. No shadows. The stiffness and the light are fitted to some real
    pictures (docs/explanation/how-real.md); forces were not recorded with those, so
    stiffness is only known if 75 gf is true of them. The published sensor has a sleeve
    of 19 mm radius, so the papers' "radius 40 mm" is read as a diameter.

    References
    ----------
    .. [1] T. Corradi, P. Hall, P. Iravani, "Bayesian tactile object recognition",
       ICRA 2015. doi:10.1109/ICRA.2015.7139744

    Examples
    --------
    >>> from palpate.simulation import DomeCamera
    >>> DomeCamera(image_shape=(96, 96)).no_contact().shape
    (96, 96)
    """

    image_shape: tuple[int, int] = (480, 640)
    force_n: float = 0.735
    max_depth_mm: float = 12.0
    membrane_radius_mm: float = 20.0
    thickness_mm: float = 1.5
    youngs_mpa: float = 0.11
    poisson: float = 0.48
    n_nodes: int = 48
    sleeve_mm: float = 1.0
    camera_distance_mm: float = 62.0
    camera_offset_mm: tuple[float, float] = (0.0, 0.0)
    disc_centre: tuple[float, float] = (0.4375, 0.4438)
    disc_radius: float = 0.5625
    n_leds: int = 8
    led_ring_radius_mm: float = 9.0
    diffuse: float = 0.19
    specular: float = 1.0
    shininess: float = 10.0
    ambient: float = 0.0
    light_slope: tuple[float, float] = (0.0, 0.0)
    gain: float = 1.0
    gamma: float = 2.2
    noise_sd: float = 3.6
    texture_sd: float = 0.03
    exposure_drift_sd: float = 0.1
    centre_drift_sd: float = 0.015
    texture_seed: int = 0

    def __post_init__(self) -> None:
        for name in _PAIRS.split():
            value = getattr(self, name)
            pair = tuple(value) if isinstance(value, tuple | list | np.ndarray) else ()
            if len(pair) != 2:
                raise ValueError(f"{name} must be a pair, got {value!r}.")
            if name != "image_shape":
                pair = tuple(check_number(name, number) for number in pair)
            object.__setattr__(self, name, pair)
        n_rows, n_cols = self.image_shape
        for side in self.image_shape:
            check_count("image_shape", side, at_least=_LEAST_SIDE)
        if n_rows * n_cols > _MOST_PIXELS:
            raise ValueError(
                f"image_shape must have at most {_MOST_PIXELS} pixels, got {n_rows} x "
                f"{n_cols}. Take fewer rows and columns."
            )
        for name in _POSITIVE.split():
            check_positive(name, getattr(self, name))
        for name in _NOT_NEGATIVE.split():
            check_number(name, getattr(self, name), low=0.0)
        check_count("n_leds", self.n_leds)
        check_count("texture_seed", self.texture_seed, at_least=0)
        if self.camera_distance_mm <= self.membrane_radius_mm + self.max_depth_mm:
            raise ValueError(
                "camera_distance_mm must exceed membrane_radius_mm + max_depth_mm, "
                f"got {self.camera_distance_mm}. The camera stands behind the rim."
            )
        self.membrane  # noqa: B018  refuses what is no membrane

    @property
    def dome(self) -> "DomeCamera":
        """The camera itself."""
        return self

    @cached_property
    def membrane(self) -> Membrane:
        """The rubber dome."""
        sizes = self.membrane_radius_mm, self.thickness_mm, self.youngs_mpa
        return Membrane(*sizes, self.poisson, self.n_nodes)

    def force_curve(self, press: DomePress, depths_mm: Floats) -> Floats:
        """Return the force (N) at each depth after first touching, (n_depths,)."""
        depths = np.asarray(depths_mm, dtype=np.float64)
        if not press.touched:
            return np.zeros(depths.shape)
        at = partial(self.membrane.pressed, press.gap_mm)
        forces = [at(depth_mm=depth).force_n for depth in depths.ravel()]
        return np.reshape(forces, depths.shape)

    def image(
        self, press: DomePress | None = None, rng: np.random.Generator | None = None
    ) -> Frame:
        """Return the picture of a press, (n_rows, n_cols); of no contact without one.

        With `rng`, noise is added.
        """
        flat = np.zeros((self.n_nodes, self.n_nodes), np.float32)
        dent = flat if press is None else press.contact.displacement_mm
        with opencv_on_one_thread():
            grey = self._grey(_optics(self).light(dent))
        if rng is not None and self.noise_sd > 0:
            grey += self._noise(rng)
        grey += np.float32(0.5)
        return np.clip(grey, 0, 255, out=grey).astype(np.uint8)

    def drifted(self, rng: np.random.Generator) -> Self:
        """Return this camera as another recording would find it."""
        row, col = self.disc_centre + self.centre_drift_sd * rng.standard_normal(2)
        gain = self.gain * float(np.exp(self.exposure_drift_sd * rng.standard_normal()))
        return replace(self, gain=gain, disc_centre=(float(row), float(col)))

    def remounted(self, rng: np.random.Generator) -> Self:
        """Return this sensor as it is after another mounting: camera, light, rubber.

        Exposure and place of the picture drift as between recordings of a BathTip,
        whose spread the others are too (docs/explanation/how-real.md; standard
        deviations): the light 10 % more or less glossy and 7 % brighter at one side of
        the rim than in the middle, the picture 0.3 % larger or smaller, the lens 0.3 mm
        off the axis, were half of how the rim wanders the camera's place and half its
        tilt. That the rubber is 10 % stiffer or softer is a guess.
        """
        drifted = self.drifted(rng)
        softer, gloss, size = np.exp(rng.normal(0, (0.1, 0.1, 0.003))).tolist()
        x, y = (self.camera_offset_mm + rng.normal(0, 0.3, 2)).tolist()
        slope = (self.light_slope + rng.normal(0, 0.07, 2)).tolist()
        return replace(
            drifted,
            youngs_mpa=self.youngs_mpa * softer,
            specular=self.specular * gloss,
            disc_radius=self.disc_radius * size,
            camera_offset_mm=(x, y),
            light_slope=tuple(slope),
        )

    def _grey(self, light: Plane) -> Plane:
        """Mottle the light, expose it, and draw the rim and the white around it."""
        import cv2

        mottled = light * np.float32(self.gain)
        if self.texture_sd > 0 or any(self.light_slope):
            mottled *= _mottling(self)
        np.maximum(mottled, 0, out=mottled)
        grey: Plane = np.asarray(cv2.pow(mottled, 1 / self.gamma, mottled))
        grey *= np.float32(255)
        np.minimum(grey, 255, out=grey)
        white = np.float32(SURROUND_GREY)
        return np.asarray(white + _optics(self).inside * (grey - white))

    def _noise(self, rng: np.random.Generator) -> Plane:
        """Noise of cells as fine as 240 rows; enlarged beyond, averaged below."""
        import cv2

        n_rows, n_cols = self.image_shape
        share = min(1.0, 240 / n_rows)
        shape = (round(n_rows * share), round(n_cols * share))
        noise = rng.standard_normal(shape, dtype=np.float32)
        noise *= np.float32(self.noise_sd * min(1.0, n_rows / 240))
        if share == 1:
            return noise
        return cv2.resize(noise, (n_cols, n_rows), interpolation=cv2.INTER_NEAREST)


_PAIRS = "image_shape camera_offset_mm disc_centre light_slope"
_POSITIVE = "force_n max_depth_mm camera_distance_mm disc_radius shininess gain gamma"
_NOT_NEGATIVE = (
    "sleeve_mm led_ring_radius_mm diffuse specular ambient noise_sd texture_sd "
    "exposure_drift_sd centre_drift_sd"
)


@lru_cache(maxsize=4)
def _optics(camera: DomeCamera) -> Optics:
    return Optics(camera)


@lru_cache(maxsize=4)
def _mottling(camera: DomeCamera) -> Plane:
    """Factor on each pixel: blots of a hundredth of the picture's height, the slope."""
    import cv2
    from scipy.ndimage import gaussian_filter

    optics = _optics(camera)
    rows, cols = optics.grid_shape
    noise = np.random.default_rng(camera.texture_seed).standard_normal((160, 240))
    blots = gaussian_filter(noise.astype(np.float32), 1.2)
    blots *= np.float32(camera.texture_sd) / blots.std()
    shrink = np.array([[120 / rows, 0, 0.0], [0, 120 / rows, 0.0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    field = cv2.warpAffine(blots, shrink, (cols, rows), flags=flags)
    factor = optics.enlarged(np.float32(1) + field)
    if any(camera.light_slope):
        n_rows, n_cols = camera.image_shape
        (row, col), (down, right) = camera.disc_centre, camera.light_slope
        radius = camera.disc_radius * n_rows
        factor += down * ((np.arange(n_rows) - row * n_rows) / radius)[:, np.newaxis]
        factor += right * ((np.arange(n_cols) - col * n_rows) / radius)
    return factor
