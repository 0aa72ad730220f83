"""What faulty arms press with, and whether it is told, for the page on exploring.

Run as `python benchmarks/arm_faults.py OUT.json`. Each fault of
`tests/exploration/faulty_arms.py`, before a ball of 1 and of 5 N/mm, on every path that
moves an arm. With another `PYTHONPATH` it measures the code of another revision.
"""

import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "exploration"))

from faulty_arms import FAULTS, GUARD, PATHS, FaultyArm


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
