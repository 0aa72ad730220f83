"""What the verbs print: JSON for machines, tables and bars for people.

Text is printed as it is: square brackets, as in `palpate[plot]`, are no markup.
"""

import json
import math
import sys
from types import TracebackType
from typing import Any, Self

BAR_WIDTH = 24
SHOWN = 3


def print_json(value: dict[str, Any]) -> None:
    """Print one JSON object; numbers that are not finite become null."""
    print(json.dumps(_plain(value), allow_nan=False))


def belief_line(touch: int, posterior: dict[str, float]) -> str:
    """Return one line that shows a belief: a bar for the best, figures for the next."""
    ranked = sorted(posterior.items(), key=lambda item: -item[1])
    name, share = ranked[0]
    bar = ("█" * round(share * BAR_WIDTH)).ljust(BAR_WIDTH, "·")
    others = "  ".join(f"{n} {p:.2f}" for n, p in ranked[1:SHOWN])
    return f"  touch {touch:3d}  {bar} {share:4.2f} {name}   {others}"


def table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """Print a table on standard output."""
    from rich.console import Console
    from rich.table import Table

    drawn = Table(title=title, title_justify="left")
    for number, column in enumerate(columns):
        drawn.add_column(column, justify="left" if number == 0 else "right")
    for row in rows:
        drawn.add_row(*row)
    Console(markup=False, emoji=False).print(drawn)


def percent(value: float | None) -> str:
    """Return a share as per cent, or a dash."""
    return "-" if value is None else f"{100 * value:.1f}"


class Stages:
    """Show the present stage of long work with a running clock.

    Called with the name of each stage. Draws nothing where standard error is no
    terminal, so that logs stay readable.
    """

    def __init__(self) -> None:
        self._bar: Any = None

    def __enter__(self) -> Self:
        return self

    def __call__(self, stage: str) -> None:
        if not sys.stderr.isatty():
            return
        if self._bar is None:
            self._bar = _clock()
            self._bar.start()
            self._bar.add_task(stage, total=None)
        self._bar.update(self._bar.task_ids[0], description=stage)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _clock() -> Any:
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
