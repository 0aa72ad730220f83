"""CPU time of one simulated touch of the dome camera, whole and by stage."""

from collections.abc import Callable
from itertools import cycle

import numpy as np

from ..simulation import (
    HOUSEHOLD,
    DomeCamera,
    DomePress,
    PlacedObject,
    SensorPose,
    gap_map,
)
from ._timing import cpu_ms, one_thread, row

_SHAPES = ((96, 96), (150, 150), (300, 300), (480, 640))
_TOUCHES_PER_OBJECT = 4
_REASON = "no other package presses a shaded dome on objects"

Approach = tuple[PlacedObject, SensorPose]


def bench_simulate(seconds: float = 0.5) -> list[dict[str, object]]:
    """Time touches of the ten household objects from random sides, noise included.

    A touch is all of it; its stages are the rays, the contact (everything else of a
    press) and the picture. Placing an object and building its ray tree are not
    counted: that is done once.
    """
    with one_thread():
        approaches = _approaches()
        return [_row(shape, approaches, seconds) for shape in _SHAPES]


def _approaches() -> list[Approach]:
    """Poses that meet their objects, all from the upper half, mixed."""
    rng = np.random.default_rng(0)
    camera = DomeCamera()
    found: list[Approach] = []
    for thing in HOUSEHOLD:
        placed = PlacedObject.resting(thing)
        wanted = len(found) + _TOUCHES_PER_OBJECT
        while len(found) < wanted:
            outward = rng.normal(size=3)
            outward[2] = abs(outward[2])
            outward /= np.linalg.norm(outward)
            goal = placed.centre_mm + rng.normal(0, 5, 3)
            pose = SensorPose(goal + 300 * outward, -outward)
            if camera.press(placed, pose).touched:
                found.append((placed, pose))
    return found


def _row(
    shape: tuple[int, int], approaches: list[Approach], seconds: float
) -> dict[str, object]:
    camera = DomeCamera(image_shape=shape)
    rng = np.random.default_rng(0)
    presses = [camera.press(placed, pose) for placed, pose in approaches]
    in_turn, pressed = cycle(approaches), cycle(presses)

    def touch() -> None:
        placed, pose = next(in_turn)
        camera.touch(placed, pose, rng=rng)

    def rays() -> None:
        placed, pose = next(in_turn)
        gap_map(placed, pose, camera.membrane)

    def picture() -> None:
        press: DomePress = next(pressed)
        camera.image(press, rng)

    whole, by_rays, by_picture = (
        cpu_ms(_repeated(stage, len(approaches)), seconds) / len(approaches)
        for stage in (touch, rays, picture)
    )
    name = f"touch {shape[0]} x {shape[1]} uint8"
    stages = {
        "rays_ms": by_rays,
        "contact_ms": whole - by_rays - by_picture,
        "picture_ms": by_picture,
    }
    return row(name, whole, "none", None, reason=_REASON, **stages)


def _repeated(stage: Callable[[], None], times: int) -> Callable[[], None]:
    """Run a stage for every approach, so that each run times the same mix."""

    def run() -> None:
        for _ in range(times):
            stage()

    return run
