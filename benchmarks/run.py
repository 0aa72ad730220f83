"""Run every benchmark (or the named ones) and keep the rows in benchmarks/results.json.

`make bench` calls this in an environment that also holds the peers. Figures of one
run belong together: compare ratios, not milliseconds of different machines.
"""

import json
import sys
from datetime import UTC, datetime
from pathlib import Path

from palpate import __version__
from palpate._durable import write_text
from speed import BENCHES, run_bench

RESULTS = Path(__file__).parent / "results.json"


def main(names: list[str]) -> None:
    """Measure, print and store."""
    stored = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for name in names or list(BENCHES):
        print(f"{name}...", flush=True)
        rows = run_bench(name)
        for row in rows:
            ratio = "-" if row["ratio"] is None else f"{row['ratio']:.3g}"
            peer = row["peer"] or "no peer"
            print(f"  {row['name']:60s} {row['ours_ms']:9.3f} ms  {ratio:>8s} x {peer}")
        stored[name] = {
            "palpate": __version__,
            "day": datetime.now(UTC).date().isoformat(),
            "rows": rows,
        }
        write_text(RESULTS, json.dumps(stored, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
