"""CPU time of simulated touches: of a dome camera, by stage; of pressure arrays."""

from collections.abc import Callable
from itertools import count, cycle

import numpy as np

from palpate import simulation

from . import Row, cpu_ms, one_thread, row

_SHAPES = ((96, 96), (150, 150), (300, 300), (480, 640))
_TOUCHES_PER_OBJECT = 4  # a model is placed for each
_ARRAY_SIZES = (10, 16, 32)  # taxels on a side
_NO_DOME = "no other package presses a shaded dome on objects"
_NO_ARRAY = "no other package presses parts on a covered array"

Approach = tuple[simulation.PlacedObject, simulation.SensorPose]


def bench_simulate(seconds: float = 0.5) -> list[Row]:
    """Time household touches: all, rays, contact (the rest of a press), picture."""
    with one_thread():
        # Poses that meet their objects, all from the upper half, mixed.
        rng = np.random.default_rng(0)
        camera = simulation.DomeCamera()
        approaches: list[Approach] = []
        for thing in simulation.HOUSEHOLD:
            placed = simulation.PlacedObject.resting(thing)
            wanted = len(approaches) + _TOUCHES_PER_OBJECT
            while len(approaches) < wanted:
                outward = rng.normal(size=3)
                outward[2] = abs(outward[2])
                outward /= np.linalg.norm(outward)
                goal = placed.centre_mm + rng.normal(0, 5, 3)
                pose = simulation.SensorPose(goal + 300 * outward, -outward)
                if camera.press(placed, pose).touched:
                    approaches.append((placed, pose))
        return [_dome_row(shape, approaches, seconds) for shape in _SHAPES]


def bench_simulate_array(seconds: float = 0.5) -> list[Row]:
    """Time a press, the mean over 12 parts at ever new places and angles."""
    with one_thread():
        return [_array_row(size, seconds) for size in _ARRAY_SIZES]


def _dome_row(
    shape: tuple[int, int], approaches: list[Approach], seconds: float
) -> Row:
    camera, rng = simulation.DomeCamera(image_shape=shape), np.random.default_rng(0)
    presses = cycle([camera.press(placed, pose) for placed, pose in approaches])
    in_turn = cycle(approaches)

    def each_ms(stage: Callable[[], object]) -> float:
        """Time a stage for every approach, so that each run times the same mix."""
        return cpu_ms(lambda: [stage() for _ in approaches], seconds) / len(approaches)

    whole = each_ms(lambda: camera.touch(*next(in_turn), rng=rng))
    rays = each_ms(lambda: camera.gap_mm(*next(in_turn)))
    picture = each_ms(lambda: camera.image(next(presses), rng))
    return row(
        f"touch {shape[0]} x {shape[1]} uint8",
        whole,
        "none",
        reason=_NO_DOME,
        rays_ms=rays,
        contact_ms=whole - rays - picture,
        picture_ms=picture,
    )


def _array_row(size: int, seconds: float) -> Row:
    array = simulation.PressureArray(size, size)
    numbers = count()

    def press_all() -> None:
        number = next(numbers)
        for part in simulation.find_parts():
            array.press(
                part,
                x_mm=(0.37 * number) % 1,
                angle_deg=37.3 * number,
                tilt_deg=(0.1, -0.1),
                roughness_um=10.0,
                random_state=number,
            )

    ours_ms = cpu_ms(press_all, seconds) / len(simulation.find_parts())
    name = f"press {size} x {size} pitch 2 mm"
    return row(name, ours_ms, "none", reason=_NO_ARRAY)
