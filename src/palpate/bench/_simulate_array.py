"""CPU time of one simulated press on pressure arrays of several sizes."""

from itertools import count

from ..simulation import PARTS, PressureArray
from ._timing import cpu_ms, one_thread, row

_SIZES = (10, 16, 32)
_REASON = "no other package presses parts on a covered array"


def bench_simulate_array(seconds: float = 0.5) -> list[dict[str, object]]:
    """Time a press, the mean over the 12 parts, unevenness and noise included.

    Presses differ in place and angle every time, so that nothing is timed twice.
    """
    with one_thread():
        return [_row(size, seconds) for size in _SIZES]


def _row(size: int, seconds: float) -> dict[str, object]:
    array = PressureArray(size, size)
    numbers = count()

    def press_all() -> None:
        number = next(numbers)
        for part in PARTS:
            array.press(
                part,
                x_mm=(0.37 * number) % 1,
                angle_deg=37.3 * number,
                tilt_deg=(0.1, -0.1),
                roughness_um=10.0,
                random_state=number,
            )

    ours_ms = cpu_ms(press_all, seconds) / len(PARTS)
    name = f"press {size} x {size} pitch 2 mm"
    return row(name, ours_ms, "none", None, reason=_REASON)
