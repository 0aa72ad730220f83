"""`palpate bench`: speed and memory beside peers, measured in one run."""

from typing import Annotated, Any

from ._options import AsJson, ListNames, argument
from ._output import print_json, say, stages, table


def bench(
    name: Annotated[str, argument("Which benchmark; see --list.")] = "",
    list_names: ListNames = False,
    as_json: AsJson = False,
) -> None:
    """Measure speed beside peers, in a checkout: CPU time, ratios within one run."""
    from ..bench import BENCHES, run_bench

    if list_names or not name:
        for bench, (_, what) in BENCHES.items():
            say(f"{bench:12s} {what}")
        return
    with stages() as stage:
        stage(f"measuring {name}")
        rows = run_bench(name)
    if as_json:
        print_json({"bench": name, "rows": rows})
        return
    title = f"{name}: CPU ms, one thread; ratio = how much faster ours is"
    table(title, ["what", "ours", "peer", "peer's", "ratio"], [*map(_cells, rows)])


def _cells(row: dict[str, Any]) -> list[str]:
    peer = row["peer_ms"]
    return [
        str(row["name"]),
        f"{row['ours_ms']:.3g}",
        str(row["peer"] or "-"),
        str(row.get("reason", "-")) if peer is None else f"{peer:.3g}",
        "-" if row["ratio"] is None else f"{row['ratio']:.3g}",
    ]
