"""`palpate bench`: speed and memory beside peers, measured in one run."""

import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

from ._options import AsJson, ListNames, argument
from ._output import answer, stages


def bench(
    name: Annotated[str, argument("Which benchmark; see --list.")] = "",
    list_names: ListNames = False,
    as_json: AsJson = False,
) -> None:
    """Measure speed beside peers, in a checkout: CPU time, ratios within one run."""
    speed = _speed()
    if list_names or not name:
        benches = {each: what for each, (_, what) in speed.BENCHES.items()}
        lines = (f"{each:12s} {what}" for each, what in benches.items())
        answer(as_json, {"benches": benches}, *lines)
        return
    with stages() as stage:
        stage(f"measuring {name}")
        rows = speed.run_bench(name)
    title = f"{name}: CPU ms, one thread; ratio = how much faster ours is"
    columns = ["what", "ours", "peer", "peer's", "ratio"]
    measured = title, columns, [*map(_cells, rows)]
    answer(as_json, {"bench": name, "rows": rows}, measured)


def _speed() -> Any:
    """Return what measures, from `benchmarks/speed` of a checkout, or explain."""
    roots = Path(__file__).parents[3], Path.cwd()
    places = [r / "benchmarks" for r in roots if (r / "benchmarks" / "speed").is_dir()]
    if not places:
        raise ValueError(
            "Benchmarks must be run in a checkout of palpate, got an installed one "
            f"without them in {Path.cwd()}. Clone its repository, and call it there."
        )
    if str(places[0]) not in sys.path:
        sys.path.append(str(places[0]))
    return import_module("speed")


def _cells(row: dict[str, Any]) -> list[str]:
    peer = row["peer_ms"]
    return [
        str(row["name"]),
        f"{row['ours_ms']:.3g}",
        str(row["peer"] or "-"),
        str(row.get("reason", "-")) if peer is None else f"{peer:.3g}",
        "-" if row["ratio"] is None else f"{row['ratio']:.3g}",
    ]
