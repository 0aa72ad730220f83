"""Sensors that play touches: recorded or simulated ones made into a stream of frames.

Something lies on the desk and is touched again and again: some frames of nothing,
the way in, the touch held, the way out.
"""

import threading
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from os import PathLike
from typing import Any, Self

import cv2
import numpy as np
from scipy.spatial.distance import cdist

from .. import simulation
from .._checks import ARRAY_SIDE, check_count, check_option, check_positive
from .._numbers import evenly_spaced
from .._types import Array
from ..simulation import (
    DomeCamera,
    GelCamera,
    PressureArray,
    find_objects,
    find_parts,
)
from ..touches import Touches, TouchesError
from ._contract import PLACE_COLUMNS, LiveSensor, Reading, SensorError, as_kind

_LONGEST_WAIT_S = 0.2  # between looks at whether to stop
_UNLABELLED = "recording"
_NOISE_FRAMES = 8  # drawn once, in turn
_NAMES = {"dome": "dome camera", "gel": "gel camera", "array": "pressure array"}
# Quiet pictures differ by under a tenth of what pictures that differ much do (90 % of
# the pairs differ less). They are of at least half of the objects; of one object a
# third of all, since a thing may be touched in one place a few times.
_ALIKE, _OF_PAIRS, _LEAST_QUIET, _COMPARED, _COMPARED_SIDE = 0.1, 90, 3, 300, 24
# Of each kind of simulated sensor: noise (grey levels), what lies there at first.
_KINDS = {"dome": (1.0, "mug"), "gel": (1.5, "ball"), "array": (0.5, "bar10")}


class PlayedSensor(LiveSensor):
    """Base of sensors that play touches of what is placed on the desk.

    Made as a `LiveSensor` is, with the `objects` that can be placed. A touch is `gap`
    frames of nothing, `ramp` of the way in, `hold` held, and `ramp` of the way out.
    """

    queue_length = 256
    _rest: Array | None

    def __init__(
        self,
        *described: Any,
        objects: Sequence[str],
        rate_hz: float,
        hold: int,
        gap: int,
        ramp: int = 0,
    ) -> None:
        super().__init__(*described)
        self.objects = tuple(objects)
        self.rate_hz = check_positive("rate_hz", rate_hz)
        self._hold = check_count("hold", hold)
        self._gap = check_count("gap", gap, at_least=0)
        self._ramp = check_count("ramp", ramp, at_least=0)
        self.placed: str | None = self.objects[0]
        self._frames: deque[Array] = deque()
        # What is told beside the frames of the touch under way, see `Reading`.
        self._about: dict[str, float] = {}
        self._lock = threading.Lock()
        self._due_s = 0.0

    @property
    def desk(self) -> Self:
        """Itself: things are placed before it by name."""
        return self

    def no_contact(self) -> Array | None:
        """Return the frame of touching nothing, or None where it is not known."""
        return self._rest

    def place(self, name: str | None) -> None:
        """Put one of `objects` on the desk, or nothing; the touch under way ends."""
        if name is not None:
            check_option("name", name, self.objects)
        with self._lock:
            self.placed = name
            self._frames.clear()
            self._about = {}
            if self._rest is not None:
                self._frames.extend([self._rest] * max(self._gap, 2))

    def go_on(self, n_stored: int) -> None:
        """Play other touches than before so many were stored, where they are made.

        Called before it is connected, so that a desk that is served again does not
        begin anew. The same seed and number make the same touches. A recording has
        those that it has.
        """

    @property
    def n_recorded(self) -> int | None:
        """How many touches there are of what is placed; None where they never end."""
        return None

    @abstractmethod
    def _next_touch(self, name: str) -> Array | None:
        """Return the next touch of an object, or None while it is being made."""

    def _with_noise(self, image: Array) -> Array:
        """Return a frame as the sensor would give it."""
        return image

    def _open(self) -> None:
        self._due_s = time.monotonic()

    def _close(self) -> None:
        pass

    def _grab(self) -> list[Reading]:
        self._due_s += 1 / self.rate_hz
        late_s = time.monotonic() - self._due_s
        if late_s > 1.0:  # the machine slept: go on from now, at the same rate
            self._due_s += late_s
        while (left_s := self._due_s - time.monotonic()) > 0:
            if self._stop.wait(min(left_s, _LONGEST_WAIT_S)):
                return []
        with self._lock:
            if not self._frames:
                self._frames.extend(self._cycle())
            image = self._frames.popleft() if self._frames else self._rest
            about = self._about
        return (
            [] if image is None else [Reading(self._with_noise(image), columns=about)]
        )

    def _cycle(self) -> list[Array]:
        """Return the frames of one touch, from nothing to nothing."""
        touch = None if self.placed is None else self._next_touch(self.placed)
        if touch is None:
            return []
        if (rest := self._rest) is None:
            return [touch] * self._hold
        shares = np.arange(1, self._ramp + 1) / (self._ramp + 1)
        way = touch.astype(np.float64) - rest  # a blend, not physics
        way_in = [as_kind(rest + float(share) * way, self.dtype) for share in shares]
        held = [touch] * self._hold
        return [rest] * self._gap + way_in + held + way_in[::-1]


class ReplaySensor(PlayedSensor):
    """Plays recorded touches as if somebody touched things on the desk.

    Parameters
    ----------
    touches : Touches or path
        The recording: touches, an archive (`.npz`) or a folder of pictures.
    rate_hz : float, default=25
        Frames per second.
    hold, gap : int, default=8, 8
        Frames that each touch is held, and frames of nothing between two; 1 and 0
        play the pictures as they are, one after the other.
    no_contact : ndarray or path, optional
        The frame of touching nothing, where the recording has none. By default a
        pressure array (at most 48 taxels a side) is taken to read 0; of other
        recordings it is the mean of the quiet pictures among them, of touching
        nothing, which are all alike. Without any, `gap` must be 0.
    name_pattern : str, optional
        For folders: see `Touches.load`.
    colour : bool, default=False
        Whether pictures of a folder are read in red, green and blue.

    Notes
    -----
    A recording with the columns `position_mm` and `direction` tells them with each
    touch, as a device does that knows where it is (`Reading`).

    Attributes
    ----------
    objects : tuple of str
        What was recorded; `place` chooses among them. Every object's touches are
        played in the order of the recording, and again from the first when they
        are over; an object that is put back goes on where it was.

    Raises
    ------
    SensorError
        The recording cannot be read, or nothing tells what it is like between two
        touches.

    Examples
    --------
    >>> import numpy as np
    >>> from palpate import Touches
    >>> from palpate.sensors import ReplaySensor
    >>> recorded = Touches(np.ones((3, 4, 4)), object=["cup"] * 3)
    >>> with ReplaySensor(recorded, rate_hz=1000, hold=1, gap=1) as sensor:
    ...     [float(sensor.read_next().image.max()) for _ in range(4)]
    [0.0, 1.0, 0.0, 1.0]
    """

    def __init__(
        self,
        touches: Touches | str | PathLike[str],
        *,
        rate_hz: float = 25.0,
        hold: int = 8,
        gap: int = 8,
        no_contact: Array | str | PathLike[str] | None = None,
        name_pattern: str | None = None,
        colour: bool = False,
    ) -> None:
        frame: Any = no_contact if isinstance(no_contact, np.ndarray) else None
        path: Any = no_contact if frame is None else None
        try:
            recorded = touches
            if not isinstance(recorded, Touches):
                recorded = Touches.load(
                    recorded, name_pattern=name_pattern, no_contact=path, colour=colour
                )
            elif path is not None:
                recorded = recorded.with_no_contact(path)
            if frame is not None:
                recorded = recorded.with_columns(no_contact=frame)
        except TouchesError as error:
            raise SensorError(f"The recording cannot be replayed: {error}") from error
        source = "touches" if isinstance(touches, Touches) else touches
        labels = recorded.object
        if labels is None:
            labels = np.full(len(recorded), _UNLABELLED)
        self._images = recorded.images
        self._rows = {str(n): np.flatnonzero(labels == n) for n in np.unique(labels)}
        self._at = dict.fromkeys(self._rows, 0)
        self._places = _places_of(recorded)
        self._rest = recorded.no_contact
        if self._rest is not None:
            self._rest = _rest_of(self._rest, self._images.dtype)
        elif max(self._images.shape[1:3]) <= ARRAY_SIDE:
            self._rest = np.zeros_like(self._images[0])
        elif gap:
            self._rest = _quiet_mean(self._images, labels)
            if self._rest is None:
                raise SensorError(
                    "The recording must show what touching nothing looks like, got "
                    "touches alone. Give a picture of touching nothing as `no_contact`."
                )
        super().__init__(
            f"replay of {source}",
            _unit_of(recorded),
            recorded.images.shape[1:],
            recorded.images.dtype,
            recorded.geometry,
            objects=[str(name) for name in dict.fromkeys(labels.tolist())],
            rate_hz=rate_hz,
            hold=hold,
            gap=gap,
        )
        self.channels = recorded.channels

    @property
    def n_recorded(self) -> int | None:
        return None if self.placed is None else len(self._rows[self.placed])

    def _next_touch(self, name: str) -> Array:
        rows = self._rows[name]
        row = rows[self._at[name] % len(rows)]
        self._at[name] += 1
        self._about = self._places[row] if self._places else {}
        touch: Array = self._images[row]
        return touch


def _rest_of(no_contact: Array, dtype: np.dtype[Any]) -> Array:
    """Return the frame of no contact in the images' type of numbers, or refuse."""
    if dtype.kind in "iu":
        low, high, limits = no_contact.min(), no_contact.max(), np.iinfo(dtype)
        if not (low >= limits.min and high <= limits.max):  # NaN is in no limits
            raise SensorError(
                f"no_contact must hold {limits.min} to {limits.max}, as {dtype} images "
                f"do, got {low:g} to {high:g}. Give a frame of this sensor."
            )
    return as_kind(no_contact, dtype)


def _places_of(recorded: Touches) -> list[dict[str, float]]:
    """Return where each touch was made as a device tells it; empty where unknown."""
    if not {*PLACE_COLUMNS} <= {*recorded.columns}:
        return []
    places: list[dict[str, float]] = [{} for _ in range(len(recorded))]
    for name, parts in PLACE_COLUMNS.items():
        vectors = np.asarray(recorded.columns[name], dtype=np.float64)
        if vectors.shape != (len(recorded), len(parts)):
            return []
        for place, vector in zip(places, vectors.tolist(), strict=True):
            place |= dict(zip(parts, vector, strict=True))
    return [place if np.isfinite([*place.values()]).all() else {} for place in places]


def _unit_of(recorded: Touches) -> str:
    if recorded.images.dtype.kind != "u":
        return "as recorded"
    return "grey level" if recorded.channels is None else "colour level"


def _quiet_mean(images: Array, labels: Array) -> Array | None:
    """Return the mean of the pictures of touching nothing, None where none seem so.

    Touches of things differ; pictures of nothing are alike, whatever is named.
    """
    rows = evenly_spaced(len(images), _COMPARED)
    n_rows, n_cols = images.shape[1:3]
    scale = min(1.0, _COMPARED_SIDE / max(n_rows, n_cols))
    size = max(1, round(n_cols * scale)), max(1, round(n_rows * scale))
    levels = (np.nan_to_num(images[row].astype(np.float64)) for row in rows)
    small = [
        np.ravel(cv2.resize(x, size, interpolation=cv2.INTER_AREA)) for x in levels
    ]
    distances = cdist(small, small)
    alike = distances < _ALIKE * np.percentile(distances, _OF_PAIRS)
    quiet = alike[alike.sum(axis=1).argmax()]
    n_objects, n_quiet = len({*labels.tolist()}), int(quiet.sum())
    of_objects = len({*labels[rows][quiet].tolist()})
    enough = 3 * n_quiet >= len(rows) if n_objects == 1 else 2 * of_objects >= n_objects
    if n_quiet < _LEAST_QUIET or not enough:
        return None
    mean = images[rows[quiet]].mean(axis=0, dtype=np.float64)
    return as_kind(mean, images.dtype)


class SimulatedStream(PlayedSensor):
    """Plays simulated touches of one object after the other, live.

    `name` is a kind of sensor, "dome", "gel" or "array", or else what lies there at
    first: a built-in object, touched by a dome camera, or a built-in part, pressed on a
    pressure array of 10 x 10. A dome's `image_shape` is 120 x 120 by default, a gel's
    120 x 160, in colour. `objects` are all that the same sensor can touch. While frames
    of nothing are played, each touch is simulated as `simulate_touches` or
    `simulate_presses` does. The way in and out is a blend of the two pictures. Noise
    has a standard deviation of 1 grey level (dome), 1.5 (gel) or half of one (array);
    `random_state` is the seed of touches and noise.
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
        sets = ("household", "unseen", "unlike others")
        solids = [thing.name for thing in find_objects(sets)]
        parts = [part.name for part in find_parts()]
        check_option("sim:OBJECT", name, [*_KINDS, *solids, *parts])
        kind = name if name in _KINDS else "dome" if name in solids else "array"
        noise_sd, first = _KINDS[kind]
        self._random_state = random_state
        self._rng = np.random.default_rng(random_state)
        self._device: DomeCamera | GelCamera | PressureArray
        if kind == "dome":
            self._device = DomeCamera(image_shape=image_shape or (120, 120))
            rest = self._device.no_contact()
        elif kind == "gel":
            self._device = GelCamera(image_shape=image_shape or (120, 160))
            rest = self._device.no_contact()
        else:
            self._device = PressureArray()
            shape = self._device.rows, self._device.cols
            rest = np.zeros(shape, dtype=np.uint8)
        # Fields of noise, (n_frames, n_rows, n_cols), that are played round.
        self._rest, size = rest, (_NOISE_FRAMES, *rest.shape)
        noise = self._rng.normal(scale=noise_sd, size=size)
        self._noise = np.rint(noise).astype(np.int16)
        self._pool: ThreadPoolExecutor | None = None
        self._next: tuple[str, Future[Array]] | None = None
        super().__init__(
            f"simulated {_NAMES[kind]}",
            "colour level" if kind == "gel" else "grey level",
            rest.shape,
            np.uint8,
            "plane" if kind == "gel" else kind,
            objects=parts if kind == "array" else solids,
            rate_hz=rate_hz,
            hold=hold,
            gap=gap,
            ramp=ramp,
        )
        self.placed = first if name in _KINDS else name

    def go_on(self, n_stored: int) -> None:
        if n_stored:
            self._rng = np.random.default_rng([self._random_state, n_stored])

    def _open(self) -> None:
        super()._open()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="palpate simulation")

    def _close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool = self._next = None

    def _next_touch(self, name: str) -> Array | None:
        assert self._pool is not None
        if self._next is None or self._next[0] != name:
            self._next = name, self._pool.submit(self._touched, name)
        future = self._next[1]
        if not future.done():
            return None
        self._next = name, self._pool.submit(self._touched, name)
        return future.result()

    def _touched(self, name: str) -> Array:
        seed = int(self._rng.integers(2**31))
        how: Any = {"random_state": seed}
        if not isinstance(self._device, PressureArray):
            touches = simulation.simulate_touches(
                name, 1, self._device, drift=False, **how
            )
        else:
            touches = simulation.simulate_presses(name, 1, array=self._device, **how)
        return np.asarray(touches.images[0])

    def _with_noise(self, image: Array) -> Array:
        noise = self._noise[self._number % _NOISE_FRAMES]
        return np.asarray((image + noise).clip(0, 255).astype(np.uint8))
