"""Sets of simulated presses: every part, many times, each time a little different.

How presses differ is fixed by what a plain press rig and machined parts are like,
and stated with `simulate_presses`; nothing here knows what recognises the touches.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from .._checks import check_count, check_number
from ..touches import Touches
from ._array import Press, PressureArray
from ._parts import PARTS, Part, find_parts

Pressed = tuple[NDArray[np.uint8], Press]
_PRESSES_PER_TASK = 50


def simulate_presses(
    parts: Iterable[Part | str | int] | Part | str | int = PARTS,
    n_presses: int = 20,
    *,
    array: PressureArray | None = None,
    load_kgf: float | tuple[float, float] = 4.0,
    max_shift_mm: float = 1.0,
    max_turn_deg: float = 180.0,
    tilt_sd_deg: float = 0.1,
    roughness_um: float = 10.0,
    random_state: int | None = None,
    n_jobs: int | None = None,
    progress: bool = False,
) -> Touches:
    """Press parts on a pressure array, each time laid down anew.

    Parameters
    ----------
    parts : Part, str, int, or a list of them, default=PARTS
        Parts, or names or numbers among `PARTS`.
    n_presses : int, default=20
        Presses of each part (20 in Liu et al. 2014).
    array : PressureArray, optional
        The device; by default that of Liu et al. One device keeps its gains.
    load_kgf : float or (float, float), default=4
        Load in kgf, or a range to draw it from evenly.
    max_shift_mm : float, default=1
        The part's middle lies evenly within so much of the array's, along x and y.
        Guess: half a pitch, so that every place relative to the taxels occurs.
    max_turn_deg : float, default=180
        The part is turned evenly by up to so much, either way; 180 is any angle
        (the paper says "slightly different"; any angle is harder).
    tilt_sd_deg : float, default=0.1
        Standard deviation of the face's tilt along x and along y. Guess: parts held
        to ISO 2768-2 class H (0.2 mm out of square on 100 mm, 0.11 degrees) in a
        fixture without a ball joint.
    roughness_um : float, default=10
        Standard deviation of the face's unevenness in µm, drawn anew every press,
        so that no single specimen's marks can be learnt. ISO 2768-2 class H allows
        a flatness of 50 µm from 10 to 30 mm, taken as five standard deviations.
    random_state : int, optional
        Same number, same touches, whatever `n_jobs`.
    n_jobs : int, optional
        Processes, as in joblib; worth while from some ten thousand presses.
    progress : bool, default=False
        Show a bar on standard error.

    Returns
    -------
    touches : Touches
        uint8 images (n_parts * n_presses, rows, cols), part after part, geometry
        "array". Columns: `object` (the part's name), `category`, `part` (its
        number), `press` (from 0), `position_mm` (x, y), `angle_deg` (0 to 360),
        `symmetry` (turns that look the same, 0 for all), `force_n`, `tilt_deg`
        (along x, y). For the set: `set_pitch_mm`.

    Examples
    --------
    >>> from palpate.simulation import simulate_presses
    >>> simulate_presses(["bar10", "disc13"], 3, random_state=0).images.shape
    (6, 10, 10)
    """
    from joblib import Parallel, delayed

    found = find_parts(parts)
    device = _device(array)
    draw = _Draw(load_kgf, max_shift_mm, max_turn_deg, tilt_sd_deg, roughness_um)
    repeated = [
        part for part in found for _ in range(check_count("n_presses", n_presses))
    ]
    seeds = np.random.SeedSequence(_seed(random_state)).spawn(len(repeated))
    tasks = [
        (
            device,
            draw,
            repeated[start : start + _PRESSES_PER_TASK],
            seeds[start : start + _PRESSES_PER_TASK],
        )
        for start in range(0, len(repeated), _PRESSES_PER_TASK)
    ]
    run = Parallel(n_jobs=n_jobs, return_as="generator")
    batches = run(delayed(_press_all)(*task) for task in tasks)
    pressed = [
        one for batch in _watched(batches, len(tasks), progress) for one in batch
    ]
    return _as_touches(repeated, pressed, n_presses, device)


class _Draw:
    """Draws presses; checked once, then asked with a generator."""

    def __init__(
        self,
        load_kgf: Any,
        max_shift_mm: float,
        max_turn_deg: float,
        tilt_sd_deg: float,
        roughness_um: float,
    ) -> None:
        self.loads = _range("load_kgf", load_kgf)
        self.shift = check_number("max_shift_mm", max_shift_mm, low=0)
        self.turn = check_number("max_turn_deg", max_turn_deg, low=0, high=180)
        self.tilt = check_number("tilt_sd_deg", tilt_sd_deg, low=0, high=2)
        self.roughness = check_number("roughness_um", roughness_um, low=0, high=1000)

    def __call__(self, rng: np.random.Generator) -> Press:
        x, y = self.shift * rng.uniform(-1, 1, size=2)
        angle = self.turn * rng.uniform(-1, 1) % 360
        load = rng.uniform(*self.loads)
        along_x, along_y = np.clip(self.tilt * rng.standard_normal(2), -10, 10)
        tilt = (float(along_x), float(along_y))
        return Press(float(x), float(y), float(angle), load, tilt, self.roughness)


def _press_all(
    array: PressureArray,
    draw: Callable[[np.random.Generator], Press],
    parts: list[Part],
    seeds: list[np.random.SeedSequence],
) -> list[Pressed]:
    """Press each part once, on one thread so that sums round alike everywhere."""
    pressed = []
    with threadpool_limits(limits=1, user_api="blas"):
        for part, seed in zip(parts, seeds, strict=True):
            rng = np.random.default_rng(seed)
            press = draw(rng)
            image = array.read(array.stress_kpa(part, press, rng), rng)
            pressed.append((image, press))
    return pressed


def _as_touches(
    parts: list[Part], pressed: list[Pressed], n_presses: int, array: PressureArray
) -> Touches:
    presses = [press for _, press in pressed]
    return Touches(
        np.stack([image for image, _ in pressed]),
        object=np.array([part.name for part in parts]),
        category=np.array([part.category for part in parts]),
        geometry="array",
        part=np.array([part.number for part in parts]),
        press=np.tile(np.arange(n_presses), len(parts) // n_presses),
        position_mm=np.array([(press.x_mm, press.y_mm) for press in presses]),
        angle_deg=np.array([press.angle_deg for press in presses]),
        symmetry=np.array([part.symmetry for part in parts]),
        force_n=np.array([press.force_n for press in presses]),
        tilt_deg=np.array([press.tilt_deg for press in presses]),
        set_pitch_mm=np.array(array.pitch_mm),
    )


def _watched(batches: Iterable[Any], total: int, progress: bool) -> Iterator[Any]:
    if not progress:
        yield from batches
        return
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    yield from track(batches, "Pressing", total=total, console=console)


def _range(name: str, value: Any) -> tuple[float, float]:
    """Return (low, high) for a range or for one number, each a valid load."""
    limits = tuple(value) if isinstance(value, tuple | list) else (value, value)
    if len(limits) != 2:
        raise ValueError(f"{name} must be one load or (low, high), got {value}.")
    low, high = limits
    for load in limits:
        Press(load_kgf=load)
    if low > high:
        raise ValueError(f"{name} must go from low to high, got {value}.")
    return float(low), float(high)


def _device(array: object) -> PressureArray:
    if array is None:
        return PressureArray()
    if not isinstance(array, PressureArray):
        raise TypeError(f"array must be a PressureArray, got {type(array).__name__}.")
    return array


def _seed(random_state: int | None) -> int | None:
    return (
        None
        if random_state is None
        else check_count("random_state", random_state, at_least=0)
    )
