"""The true force on simulated objects, whatever the force sensor reads.

    python benchmarks/guarded_force.py [--touches 12]

Prints the first tables of docs/explanation/guarded-touch.md: the greatest true force of
touches from random places of the hemisphere, with a force sensor that works and with
ones that do not.
"""

import argparse
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from palpate.exploration import Guard, RandomHemisphere, put_down
from palpate.exploration._simulated_objects import QUICK_GUARD
from palpate.simulation import (
    DomeCamera,
    SimObject,
    find_object,
    find_objects,
)

CAMERA = DomeCamera(image_shape=(32, 32))
GUARDS = {"Guard()": Guard(), "QUICK_GUARD": QUICK_GUARD}
BROKEN = ("mug", "box", "pen", "ball")


def main() -> None:
    """Touch, and print the greatest forces."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--touches", type=int, default=12, help="of each resting face")
    n_touches = parser.parse_args().touches
    print("| guard | touches | median | 99 % | greatest true force (N) |")
    print("| --- | --- | --- | --- | --- |")
    for name, guard in GUARDS.items():
        peaks = np.concatenate(
            [
                touched(thing, face, guard, n_touches)[0]
                for thing in find_objects(["household", "unseen"])
                for face in range(len(thing.resting_rotations))
            ]
        )
        middle, most = np.quantile(peaks, [0.5, 0.99])
        row = f"{len(peaks)} | {middle:.2f} | {most:.2f} | {peaks.max():.2f}"
        print(f"| `{name}` | {row} |")
    print("\n| force sensor | touches | greatest true force (N) | recorded as |")
    print("| --- | --- | --- | --- |")
    for what, (guard, sensor) in SENSORS.items():
        results = [touched(find_object(n), 0, guard, 8, sensor) for n in BROKEN]
        outcomes = Counter(outcome for _, names in results for outcome in names)
        recorded = ", ".join(f"{outcome} {n}" for outcome, n in outcomes.most_common())
        most = max(float(peaks.max()) for peaks, _ in results)
        print(f"| {what} | {sum(outcomes.values())} | {most:.2f} | {recorded} |")


def touched(
    thing: SimObject,
    face: int,
    guard: Guard,
    n_touches: int,
    make_sensor: Callable[[], Callable[[float], float]] | None = None,
) -> tuple[Any, list[str]]:
    """Return the greatest true force of each touch, and its recorded outcome."""
    stand = put_down(thing, CAMERA, face=face, yaw_rad=1.0, random_state=7)
    bench, read = stand.robot._bench, stand.robot.read_force
    strategy = RandomHemisphere(stand.hemisphere, 3)
    history: list[Any] = []
    peaks = []
    for _ in range(n_touches):
        if make_sensor is not None:
            sensor = make_sensor()
            stand.robot.read_force = lambda sensor=sensor: sensor(read())  # type: ignore
        bench.peak_force_n = 0.0
        history.append(stand.touch(strategy.next_pose(None, history), guard))
        peaks.append(bench.peak_force_n)
    return np.array(peaks), [record.outcome for record in history]


def lagging(n_readings: int) -> Callable[[float], float]:
    """Return a force sensor that gives each reading `n_readings` too late."""
    past: list[float] = []

    def sensor(force: float) -> float:
        past.append(force)
        return past[max(len(past) - 1 - n_readings, 0)]

    return sensor


def drifting(n_per_reading: float) -> Callable[[float], float]:
    """Return a force sensor that adds a little more to every reading."""
    added = [0.0]

    def sensor(force: float) -> float:
        added[0] += n_per_reading
        return force + added[0]

    return sensor


def dead() -> Callable[[float], float]:
    """Return a force sensor that gives noise alone."""
    rng = np.random.default_rng(0)
    return lambda force: 0.05 + 0.01 * float(rng.standard_normal())


def dead_in_contact() -> Callable[[float], float]:
    """Return a force sensor that gives noise about 0.3 N once it has reached that."""
    rng, stuck = np.random.default_rng(0), [False]

    def sensor(force: float) -> float:
        stuck[0] |= force > 0.3
        return 0.3 + 0.01 * float(rng.standard_normal()) if stuck[0] else force

    return sensor


# Half of what a touch of 0.1 N changes in the image of this dome (grey levels).
LOOKS = Guard(frame_change=4.0)
SENSORS: dict[str, tuple[Guard, Callable[[], Callable[[float], float]]]] = {
    "of the other sign": (Guard(), lambda: lambda force: -force),
    "reads half": (Guard(), lambda: lambda force: 0.5 * force),
    "reads double": (Guard(), lambda: lambda force: 2 * force),
    "three readings late": (Guard(), lambda: lagging(3)),
    "offset falls by 0.0005 N a reading": (Guard(), lambda: drifting(-0.0005)),
    "offset falls by 0.00005 N a reading": (Guard(), lambda: drifting(-0.00005)),
    "dead but noisy from 0.3 N on": (Guard(), dead_in_contact),
    "dead but noisy from the start": (Guard(), dead),
    "the same, with `frame_change=4`": (LOOKS, dead),
}

if __name__ == "__main__":
    main()
