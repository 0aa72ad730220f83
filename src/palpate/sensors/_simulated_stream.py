"""A simulated sensor on the desk: a dome camera or a pressure array that runs live."""

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from .._checks import check_option
from .._types import Array
from ..simulation import (
    HOUSEHOLD,
    PARTS,
    UNLIKE_OTHERS,
    UNSEEN,
    DomeCamera,
    PressureArray,
    simulate_presses,
    simulate_touches,
)
from ._played import PlayedSensor

_NOISE_FRAMES = 8
_DOME_NOISE, _ARRAY_NOISE = 1.0, 0.5


class SimulatedStream(PlayedSensor):
    """Plays simulated touches of one object after the other, live.

    The object is a built-in one, touched by a dome camera of `image_shape` (by default
    120 x 120), or a built-in part, pressed on a pressure array of 10 x 10. `objects`
    are all that the same sensor can touch. While frames of nothing are played, each
    touch is simulated as `simulate_touches` or `simulate_presses` does. The way in and
    out is a blend of the two pictures. Noise has a standard deviation of 1 grey level
    (dome) or half of one (array); `random_state` is the seed of touches and noise.
    """

    def __init__(
        self,
        name: str = "mug",
        image_shape: tuple[int, int] | None = None,
        *,
        rate_hz: float = 25.0,
        hold: int = 6,
        gap: int = 8,
        ramp: int = 3,
        random_state: int = 0,
    ) -> None:
        solids = [thing.name for thing in (*HOUSEHOLD, *UNSEEN, *UNLIKE_OTHERS)]
        parts = [part.name for part in PARTS]
        check_option("name", name, [*solids, *parts])
        dome = name in solids
        self._rng = np.random.default_rng(random_state)
        self._device: DomeCamera | PressureArray
        if dome:
            self._device = DomeCamera(image_shape=image_shape or (120, 120))
            self._rest_image = self._device.no_contact()
        else:
            self._device = PressureArray()
            shape = self._device.rows, self._device.cols
            self._rest_image = np.zeros(shape, dtype=np.uint8)
        # Fields of noise, (n_frames, n_rows, n_cols), that are played round.
        size = _NOISE_FRAMES, *self._rest_image.shape
        noise = self._rng.normal(scale=_DOME_NOISE if dome else _ARRAY_NOISE, size=size)
        self._noise = np.rint(noise).astype(np.int16)
        self._pool: ThreadPoolExecutor | None = None
        self._made: tuple[str, Future[Array]] | None = None
        super().__init__(
            f"simulated {'dome camera' if dome else 'pressure array'}",
            "grey level",
            self._rest_image.shape,
            np.uint8,
            "dome" if dome else "array",
            objects=solids if dome else parts,
            rate_hz=rate_hz,
            hold=hold,
            gap=gap,
            ramp=ramp,
        )
        self.placed = name

    def no_contact(self) -> Array:
        """Return the frame of touching nothing, without noise."""
        return self._rest_image

    def _open(self) -> None:
        super()._open()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="palpate simulation")

    def _close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool = self._made = None

    def _next_touch(self, name: str) -> Array | None:
        assert self._pool is not None
        if self._made is None or self._made[0] != name:
            self._made = name, self._pool.submit(self._touched, name)
        future = self._made[1]
        if not future.done():
            return None
        self._made = name, self._pool.submit(self._touched, name)
        return future.result()

    def _touched(self, name: str) -> Array:
        seed = int(self._rng.integers(2**31))
        if isinstance(self._device, DomeCamera):
            made = simulate_touches(
                name, 1, self._device, drift=False, random_state=seed
            )
        else:
            made = simulate_presses(name, 1, array=self._device, random_state=seed)
        return np.asarray(made.images[0])

    def _with_noise(self, image: Array) -> Array:
        noise = self._noise[self._number % _NOISE_FRAMES]
        return np.asarray((image + noise).clip(0, 255).astype(np.uint8))
