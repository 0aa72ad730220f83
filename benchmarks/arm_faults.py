"""What faulty arms press with, and whether it is told, for the page on exploring.

Run as `python benchmarks/arm_faults.py OUT.json`. Each fault of
`tests/exploration/faulty_arms.py`, before a ball of 1 and of 5 N/mm, on three paths:
`explore`, `gather` and a single `guarded_touch`. With another `PYTHONPATH` it measures
the code of another revision.
"""

import json
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "exploration"))

from faulty_arms import FAULTS, FaultyArm, Undecided

from palpate.exploration import (
    Guard,
    Hemisphere,
    RandomHemisphere,
    explore,
    gather,
    guarded_touch,
)

NEAR = Hemisphere(radius_mm=100)
_ASKED = {"timeout_s": 1e9, "max_travel_mm": 110.0}
_ASKED |= {"air_step_mm": 0.5, "expected_n_mm": 0.8}
KNOWN = {field.name for field in fields(Guard)}
GUARD = Guard(**{name: value for name, value in _ASKED.items() if name in KNOWN})


def exploring(arm: Any) -> Any:
    """Touch five times as `explore` does."""
    strategy, asked = RandomHemisphere(NEAR, 1), {"guard": GUARD, "max_attempts": 5}
    return explore(arm, arm, Undecided(), strategy, **asked).history


def gathering(arm: Any) -> Any:
    """Gather four touches."""
    return gather(arm, arm, RandomHemisphere(NEAR, 2), guard=GUARD, n_touches=4)


def touching(arm: Any) -> Any:
    """Touch once from where somebody has put the arm."""
    arm.pose = NEAR.pose(0.3, 0.9)
    return [guarded_touch(arm, arm, arm.pose, GUARD)]


PATHS = {"explore": exploring, "gather": gathering, "touch": touching}


def measured(fault: str, path: str, stiffness: float) -> dict[str, Any]:
    """Return the greatest true force, whether a fault was told, and how it ended."""
    arm = FaultyArm(fault, stiffness)
    attempts, error = [], ""
    try:
        attempts = PATHS[path](arm)
    except BaseException as raised:
        error = type(raised).__name__
    left = bool(arm.inside and not arm.stopped)
    return {
        "peak_n": arm.peak_n,
        "told": bool(error) or any(record.faulty for record in attempts),
        "left pressed": left and arm.force_n > GUARD.limit_n / 10,
        "error": error,
    }


def main() -> None:
    """Measure all and write the table."""
    rows = {
        f"{fault} | {path} | {stiffness:g}": measured(fault, path, stiffness)
        for fault in FAULTS
        for path in PATHS
        for stiffness in (1.0, 5.0)
    }
    Path(sys.argv[1]).write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
